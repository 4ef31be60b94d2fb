"""The plant of a loop as it flies: from messages at their own stamps, with the controller of the parameters."""

from collections.abc import Iterator, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from mavdem.arrays import Array
from mavdem.dataset.attitude import Attitude
from mavdem.dataset.flights import flights_of_longest_boot
from mavdem.dataset.signals import MIN_SLOW_MOTION_RATE, Signals
from mavdem.dataset.time_series import TimeSeries
from mavdem.dataset.vehicle_cache import cached_per_vehicle
from mavdem.dem.engine.linalg import one_thread
from mavdem.dem.record import Record
from mavdem.errors import NotLearnable
from mavdem.facts import Fact
from mavdem.facts.identifiability import Status
from mavdem.facts.learnability import Reason
from mavdem.facts.loops import Loops
from mavdem.facts.model import ParameterDoubt
from mavdem.flight import Flight, boot_number
from mavdem.loops.axis_loops import MARGIN_TARGETS
from mavdem.loops.controllers import Controller
from mavdem.loops.filters import gyro_delay, gyro_response
from mavdem.loops.loop_construction import inputs_per_demand, logged_controller
from mavdem.loops.margins import controller_response, rate_loop
from mavdem.plant import Physical
from mavdem.plant.closed_loop.identification import IdentifiedAxis, identify_axis
from mavdem.plant.closed_loop.likelihood import AxisPosterior
from mavdem.plant.closed_loop.parameters import PLANT, LoopParameters
from mavdem.plant.closed_loop.response import KnownController, Quantity
from mavdem.plant.closed_loop.spectra import (
    SPECTRUM_SECONDS,
    CrossSpectra,
    Messages,
    cross_spectra,
)
from mavdem.plant.estimation import MOTION_BAND_HZ
from mavdem.plant.identifiability import PARAMETERS
from mavdem.plant.parameters import PLANT_MINIMUM, wind_torque_density
from mavdem.plant.sampled_plant import FIRST_ORDER, GAUSSIAN_KERNEL, WindComponent

FEWEST_WINDOWS = 4
MODEL_ERRORS = {"effect": 0.02, "damping": 0.1, "lag": 0.0, "delay": 0.03}
"""Standard deviations of the logarithm of each parameter, beside the likelihood's: what is sampled does not change
evenly between its stamps. Chosen on half of the flights of ``tools/validation/loops.py``, as those below."""
BY_LIMITS, SHORTER = 0.1, 0.2
"""Likewise of the effect, by what limits cut off: rotors spin up faster than they slow down. And of a lag: how much
shorter a delay comes with an effect too large by one in its logarithm, and with a lag as much too long. What a flight
shows best is the response to quick changes."""
BETWEEN, UNSEEN = 1 / 24, 1.5
"""Of the time between messages less a cycle: standard deviation of lag less delay, which the messages hardly tell apart
there, and of the delay by itself. It triples where limits cut off all that is asked: outputs jump unseen then. And of
the effect's logarithm, 1/s: what turns the vehicle between messages is not seen."""
WIDEST = 15.0  # degrees, of the phase margin's 90 % interval to each side
MOST_ROUNDED = 0.2
"""Of the outputs' power, by resolution: ArduCopter's simulator, hardly moving at 20 Hz, had 66° for 19° beyond."""
LEAST_STEERED = 0.6
"""Of the rate's variance, by what was asked: below, wind that the controller answers is half of what there is to learn
from, and on half of the flights of ``tools/validation/loops.py`` phases erred by 14° (above by 3°)."""
EXPLAINED_FREQUENCY = 4.0  # Hz, up to which a setpoint must explain the output


def identify_plant_in_loop(signals: Signals, flights: Sequence[Flight]) -> Physical:
    """Returns the plant of the axis of ``signals`` in ``flights``, identified with the controller that flew it.

    Its delay has that of the gyro's filters. Of several boots, that of the longest flight counts. Raises
    ``NotLearnable``: no controller, no setpoints that change several times a second, too few seconds, too little was
    asked of it, or the phase margin stays unknown.
    """
    identified = _in_loop(signals, tuple(flights_of_longest_boot(flights)))
    with one_thread(), np.errstate(all="ignore"):
        plant = _physical(identified.fit, identified.directions)
        try:
            plant = _checked(plant, identified.directions, identified.controller)
        except np.linalg.LinAlgError:
            raise NotLearnable(Loops.LOOP_NOT_FOUND) from None
    return plant._replace(delay=plant.delay + gyro_delay(identified.controller))


class _InLoop(NamedTuple):
    """The identified parameters of one axis with its controller, and the inputs of a demand of 1."""

    fit: IdentifiedAxis
    controller: Controller
    directions: Array


@cached_per_vehicle("axis", "inputs")
def _in_loop(signals: Signals, flights: tuple[Flight, ...]) -> _InLoop:
    """Of the axis of ``signals``; what it takes is that of :func:`identify_plant_in_loop`."""
    boot = boot_number(flights[0])
    record = Record.from_flights(flights)
    assert signals.model_inputs is not None
    layout = signals.model_inputs.geometry
    weights = None if layout.positions_assumed else layout.mixer_row(signals.axis)
    controller = logged_controller(record.parameters, signals.axis, weights)
    directions = inputs_per_demand(controller, record)
    streams, limited, rounding = _streams(signals, boot, controller, directions)
    starts = np.array(list(_windows(flights, streams)))
    if len(starts) < FEWEST_WINDOWS:
        least_duration = (FEWEST_WINDOWS + 1) * SPECTRUM_SECONDS / 2
        raise NotLearnable(Loops.LOOP_TOO_SHORT, least_duration=least_duration)
    limited_share = _limited_share(streams[Quantity.OUTPUT], limited, starts)
    known_controller = KnownController(
        partial(controller_response, controller),
        partial(gyro_response, controller),
        controller.angle_gain,
        controller.loop_period,
    )
    with one_thread(), np.errstate(all="ignore"):
        seen = cross_spectra(streams, starts)
        if seen.message_rate < MIN_SLOW_MOTION_RATE:
            raise NotLearnable(Loops.NO_RATE_SETPOINT)
        density = seen.mean_density[:, Quantity.OUTPUT, Quantity.OUTPUT].real
        power = np.average(density, weights=seen.effective_samples) * seen.message_rate
        if rounding**2 / 12 > MOST_ROUNDED * power:
            scale = signals.model_inputs.scale
            command = scale.step * np.sqrt(power) / rounding
            raise NotLearnable(
                Reason.COMMAND_ROUNDED,
                axis=signals.axis,
                command=command,
                command_step=scale.step,
                unit=scale.unit,
            )
        used = _used(seen, known_controller)
        # Folding takes up to half from what is coherent with what was asked.
        rate, asked = (
            used.mean_density[:, quantity, quantity].real
            for quantity in (Quantity.RATE, Quantity.REFERENCE)
        )
        coherent = np.abs(used.mean_density[:, Quantity.RATE, Quantity.REFERENCE]) ** 2 / asked
        width = np.gradient(used.frequency)
        share = (width @ coherent) / (width @ rate)
        if not share + limited_share >= LEAST_STEERED / 2:
            raise NotLearnable(Loops.NOT_STEERED, share=share)
        axis = AxisPosterior(used, known_controller, rounding, limited_share)
        try:
            fit = identify_axis(axis)
            steered = fit.reference_share
        except np.linalg.LinAlgError:
            raise NotLearnable(Loops.LOOP_NOT_FOUND) from None
    # An output at a limit answers no wind.
    if not steered + fit.saturation_loss >= LEAST_STEERED:
        raise NotLearnable(Loops.NOT_STEERED, share=steered)
    # A controller of another gain than its parameters': the model makes up for something else.
    if not fit.controller_consistent:
        raise NotLearnable(Loops.LOOP_NOT_FOUND)
    return _InLoop(fit, controller, directions)


def _streams(
    signals: Signals,
    boot: int,
    controller: Controller,
    directions: Array,
) -> tuple[list[Messages], Messages, float]:
    """Rate, output as a demand, each setpoint with what was asked; whether an output was at a limit; its steps."""
    attitude, drive = signals.attitude, signals.model_inputs
    assert attitude is not None and drive is not None

    def here(stream: Attitude | TimeSeries, values: Array) -> Messages:
        rows = stream.boot == boot
        return Messages(stream.time[rows], values[rows])

    outputs = drive.range_fractions(boot)
    step = np.median(np.diff(outputs.time))
    demand = Messages(outputs.time, controller.demand_from_outputs(outputs.values, step))
    angle = here(attitude, attitude.angle)
    asked = {given.unit: here(given.signal, given.signal.values) for given in signals.setpoints}
    asked = {unit: messages for unit, messages in asked.items() if np.diff(messages.values).any()}
    if "rad/s" not in asked:
        raise NotLearnable(Loops.NO_RATE_SETPOINT)
    setpoint = asked["rad/s"]
    turned = controller.angle_gain * np.interp(setpoint.time, *angle)
    candidates = [setpoint.values]
    if controller.derivative_of_error and "rad" in asked:
        # ArduPilot's ATTITUDE_TARGET lacks the correction of the angle's error, its RATE has it
        wanted = controller.angle_gain * np.interp(setpoint.time, *asked["rad"])
        candidates.append(setpoint.values + wanted - turned)
    streams = [here(attitude, attitude.rate), demand]
    for values in candidates:
        streams += [Messages(setpoint.time, wanted) for wanted in (values, values + turned)]
    limited = controller.outputs_at_limit(outputs.values, drive.scale.stop).astype(np.float64)
    rounding = drive.scale.step / float(np.linalg.norm(directions))
    return streams, Messages(outputs.time, limited), rounding


def _windows(flights: Sequence[Flight], streams: Sequence[Messages]) -> Iterator[float]:
    """Where windows begin, s: every half of one, in settled flight, where all messages come."""
    begin = max(stream.time[0] for stream in streams)
    end = min(stream.time[-1] for stream in streams)
    for flight in flights:
        first = max(flight.time[0], begin)
        last = min(flight.time[-1], end) - SPECTRUM_SECONDS
        for start in np.arange(first, last + 1e-6, SPECTRUM_SECONDS / 2):
            edges = {"prepend": start, "append": start + SPECTRUM_SECONDS}
            if all(
                np.diff(stream.time[_inside(stream, start)], **edges).max() < 1
                for stream in streams
            ):
                yield start


def _inside(stream: Messages, start: float) -> slice:
    return slice(*np.searchsorted(stream.time, [start, start + SPECTRUM_SECONDS]).tolist())


def _limited_share(output: Messages, limited: Messages, starts: Array) -> float:
    """Of the output's power in windows from ``starts`` on: what came while an output was at a limit."""
    power = at_limit = 0.0
    for start in starts:
        rows = _inside(output, start)
        squared = np.square(output.values[rows] - output.values[rows].mean())
        power += squared.sum()
        at_limit += squared @ limited.values[rows]
    return at_limit / power if power else 0.0


def _used(spectra: CrossSpectra, controller: KnownController) -> CrossSpectra:
    """Of rate, output and that setpoint which explains the output better by the controller."""
    slow = spectra.frequency < EXPLAINED_FREQUENCY
    forward, back = controller.transfer(spectra.frequency[slow])
    unlike = np.stack([back, np.ones(len(back)), -forward])

    def left(setpoint: int) -> float:
        power = spectra.select((Quantity.RATE, Quantity.OUTPUT, setpoint)).mean_density[slow]
        counts = spectra.effective_samples[slow]
        return np.einsum("j,aj,jab,bj->", counts, unlike, power, unlike.conj()).real

    best = min(range(2, len(spectra.stamp_offsets), 2), key=left)
    return spectra.select((Quantity.RATE, Quantity.OUTPUT, best, best + 1))


def _checked(plant: Physical, directions: Array, controller: Controller) -> Physical:
    """The ``plant``, biased where its loop rings; raises ``NotLearnable`` where the phase margin stays unknown."""
    drawn = plant.draws(100)
    rate = rate_loop(
        controller, drawn[:, :-3] @ directions, np.maximum(drawn[:, -3:], PLANT_MINIMUM)
    )
    low, high = rate.phase_margin_interval
    # what flew settled was not unstable
    if not (high - low <= 2 * WIDEST and rate.stable[0]):
        within = np.clip([low, high], -180.0, 180.0)  # infinite where nothing crosses over
        raise NotLearnable(Loops.MARGIN_UNCERTAIN, phase_margin_interval=within)
    # Most of the motion is then beyond the motors' corner frequency, where only the effect over the lag counts.
    is_beyond = 2 * np.pi * rate.crossover * plant.lag > 1
    if is_beyond and rate.phase_margin < MARGIN_TARGETS["default"].phase_margin / 2:
        rings = Fact(ParameterDoubt.LOOP_RINGS, frequency=rate.crossover)
        status = dict.fromkeys(PARAMETERS, Status.BIASED)
        return plant._replace(status=status, reasons=dict.fromkeys(PARAMETERS, rings))
    return plant


def _physical(fit: IdentifiedAxis, directions: Array) -> Physical:
    """Without the gyro's filters, and with what the model lacks."""
    values = LoopParameters.from_logarithms(fit.theta)
    effect, damping, lag, delay = (getattr(values, name) for name in MODEL_ERRORS)
    seen = fit.posterior.spectra
    motors = effect * directions / (directions @ directions)
    slopes = block_diag(motors[:, None], damping, lag, delay)
    whole = slopes @ fit.covariance[np.ix_(PLANT, PLANT)] @ slopes.T
    plant = Physical(
        effect=motors,
        damping=damping,
        lag=lag,
        delay=delay,
        covariance=whole,
        status=dict.fromkeys(PARAMETERS, Status.REPORTED),
        reasons=dict.fromkeys(PARAMETERS),
        bias=0.0,
        wind_share=np.nan,
        components=(
            WindComponent(FIRST_ORDER, values.drift_size, values.drift_time),
            WindComponent(FIRST_ORDER, values.eddy_size, values.eddy_time),
            WindComponent(GAUSSIAN_KERNEL, values.gust_size, values.gust_time),
        ),
        noise=np.hypot(values.gyro_noise, values.filtered_noise),
        refinements={},
        windows=len(seen.densities),
        filtered=False,
    )
    at = seen.frequency[seen.frequency <= MOTION_BAND_HZ[1]]
    motor = np.abs(effect / (1 + 2j * np.pi * at * lag)) ** 2
    width = np.gradient(at)
    by_wind = width @ wind_torque_density(plant, at)
    by_motors = (
        2 * width @ (motor * seen.mean_density[: len(at), Quantity.OUTPUT, Quantity.OUTPUT].real)
    )
    wind_share = by_wind / (by_wind + by_motors)
    slopes[-2:, 0] = lag, -SHORTER * lag
    # a longer lag with a shorter delay is made up for by more effect
    slopes[:, 2] += np.concatenate([motors, [0.0, 0.0, -lag]]) / 2
    between = BETWEEN * (1 + 2 * fit.saturation_loss) * fit.posterior.densities.surplus_interval
    unseen = np.hypot(
        BY_LIMITS * fit.saturation_loss, UNSEEN * fit.posterior.densities.surplus_interval
    )
    further = [unseen, 0.0, between / lag, between / delay]
    variances = np.square(list(MODEL_ERRORS.values())) + np.square(further)
    covariance = whole + slopes * variances @ slopes.T
    return plant._replace(wind_share=wind_share, covariance=covariance)
