"""Closed-loop identification of the plant of one axis: control effectiveness, damping, motor lag and delay.

Messages are used at their own time stamps. The model is that of ``plant.closed_loop``, with the controller that the
autopilot's parameters describe. This file makes its data of a log, refuses logs that cannot support it, and turns the
result into physical parameters with honest covariances.
"""

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

MIN_WINDOWS = 4
"""Fewest windows of ``SPECTRUM_SECONDS``, half over each other."""
MAX_MESSAGE_GAP = 1.0
"""Longest time without a message in a window, s."""
MAX_ROUNDING_SHARE = 0.2
"""Variance of rounding by that of the outputs, at most.

The loop of ArduCopter's simulator, hardly moving at 20 Hz, had a phase margin of 66° for 19° beyond.
"""
MIN_REFERENCE_SHARE = 0.6
"""Fraction of the rate's variance that follows pilot or navigation, at least.

With less, wind that the controller answers is half of what there is to learn from, and on half of the flights of
``tools/validation/loops.py`` phase margins erred by 14°; above, by 3°.
"""
MAX_EXPLAINED_FREQUENCY = 4.0
"""Hz up to which the controller must explain the output by the setpoint."""
MAX_PHASE_MARGIN_HALF_WIDTH = 15.0
"""Half width of the phase margin's 90 % interval, degrees, at most."""
MARGIN_DRAWS = 100
"""Draws of the plant for that interval."""

LOG_MODEL_DEVIATIONS = {"effect": 0.02, "damping": 0.1, "lag": 0.0, "delay": 0.03}
"""Standard deviations of the logarithm of each parameter, besides the likelihood's.

What is sampled does not change evenly between its stamps. Chosen on half of the flights of
``tools/validation/loops.py``, as are the next four.
"""
SATURATION_EFFECT_DEVIATION = 0.1
"""The same of the effect, times the fraction that limits cut off: rotors spin up faster than they slow down."""
UNSEEN_EFFECT_DEVIATION = 1.5
"""The same of the effect, per second between messages beyond a control cycle: what moves the vehicle is not seen."""
LAG_DELAY_DEVIATION = 1 / 24
"""Standard deviation of lag and delay against each other, by the time between messages beyond a control cycle.

Messages hardly tell them apart there. It triples where limits cut off all of the output, which then jumps unseen.
"""
DELAY_PER_EFFECT = 0.2
"""Lags by which the delay is too short, where the effect is too large by one in its logarithm and the lag too long by
one lag: a flight shows best the response to quick changes, which stays the same."""


def identify_plant_in_loop(signals: Signals, flights: Sequence[Flight]) -> Physical:
    """Returns the plant of one axis, identified in closed loop with the controller that flew it.

    Its delay includes that of the gyro's filters. Of several boots, that of the longest flight counts.

    Args:
        signals: of the vehicle and the axis.
        flights: settled flight.

    Raises:
        NotLearnable: there is no known controller, or no setpoint of the rate that changes several times a second; the
            flight is too short; too little of the motion follows setpoints; or the phase margin stays unknown.
    """
    # The spectra are cached per axis. What follows is quick, and depends on them alone.
    identified = _identified_loop(signals, tuple(flights_of_longest_boot(flights)))
    with one_thread(), np.errstate(all="ignore"):
        plant = _physical_plant(identified.fit, identified.inputs_per_demand)
        try:
            plant = _checked_plant(plant, identified.inputs_per_demand, identified.controller)
        except np.linalg.LinAlgError:
            raise NotLearnable(Loops.LOOP_NOT_FOUND) from None
    return plant._replace(delay=plant.delay + gyro_delay(identified.controller))


class _IdentifiedLoop(NamedTuple):
    """The identified parameters of one axis, with its controller."""

    fit: IdentifiedAxis
    """Posterior of the parameters."""
    controller: Controller
    """The controller of the logged parameters."""
    inputs_per_demand: Array
    """(r,) how much each input changes per unit of demand."""


@cached_per_vehicle("axis", "inputs")
def _identified_loop(signals: Signals, flights: tuple[Flight, ...]) -> _IdentifiedLoop:
    """Returns the identified parameters of the axis of ``signals`` in ``flights`` of one boot.

    Messages become cross-spectra of rate, output, setpoint and reference, and the spectra a maximum of the likelihood.
    Before and after the fit, flights are refused that cannot support it: with too few windows, outputs that are mostly
    rounding, or too little motion by setpoints.

    Args:
        signals: of the vehicle and the axis.
        flights: of one boot, whose clock all messages share.

    Raises:
        NotLearnable: as :func:`identify_plant_in_loop`.
    """
    record = Record.from_flights(flights)
    assert signals.model_inputs is not None
    # Assumed positions of motors give no weights: then the autopilot's parameters must have the mixer.
    geometry = signals.model_inputs.geometry
    weights = None if geometry.positions_assumed else geometry.mixer_row(signals.axis)
    controller = logged_controller(record.parameters, signals.axis, weights)
    per_demand = inputs_per_demand(controller, record)
    messages = _loop_messages(signals, boot_number(flights[0]), controller, per_demand)
    starts = np.array(list(_window_starts(flights, messages.streams)))
    if len(starts) < MIN_WINDOWS:
        least_duration = (MIN_WINDOWS + 1) * SPECTRUM_SECONDS / 2
        raise NotLearnable(Loops.LOOP_TOO_SHORT, least_duration=least_duration)
    saturated_share = _saturated_share(messages, starts)
    known_controller = KnownController(
        partial(controller_response, controller),
        partial(gyro_response, controller),
        controller.angle_gain,
        controller.loop_period,
    )
    with one_thread(), np.errstate(all="ignore"):
        spectra = cross_spectra(messages.streams, starts)
        if spectra.message_rate < MIN_SLOW_MOTION_RATE:
            raise NotLearnable(Loops.NO_RATE_SETPOINT)
        _require_resolution(signals, spectra, messages.rounding)
        spectra = _with_best_setpoint(spectra, known_controller)
        # A first, cheap look before the fit: aliases take up to half from what is coherent with the reference, so half
        # of the limit is asked for. An output at a limit is not expected to follow anything.
        coherent_share = _coherent_share(spectra)
        if not coherent_share + saturated_share >= MIN_REFERENCE_SHARE / 2:
            raise NotLearnable(Loops.NOT_STEERED, share=coherent_share)
        posterior = AxisPosterior(spectra, known_controller, messages.rounding, saturated_share)
        try:
            fit = identify_axis(posterior)
            reference_share = fit.reference_share
        except np.linalg.LinAlgError:
            raise NotLearnable(Loops.LOOP_NOT_FOUND) from None
    # An output at a limit answers no wind.
    if not reference_share + fit.saturation_loss >= MIN_REFERENCE_SHARE:
        raise NotLearnable(Loops.NOT_STEERED, share=reference_share)
    # With a controller of another gain than its parameters', the model makes up for something else.
    if not fit.controller_consistent:
        raise NotLearnable(Loops.LOOP_NOT_FOUND)
    return _IdentifiedLoop(fit, controller, per_demand)


class _LoopMessages(NamedTuple):
    """The quantities of a loop at the stamps of their messages."""

    streams: list[Messages]
    """Rate, output as a demand, and then a pair for each candidate of the rate's setpoint.

    The pair is the setpoint and the reference, which is the setpoint plus what the attitude controller feeds back.
    """
    at_limit: Messages
    """1 where an output is at a limit, else 0, at the stamps of the output."""
    rounding: float
    """Step of the output, as a demand."""


def _loop_messages(
    signals: Signals, boot: int, controller: Controller, per_demand: Array
) -> _LoopMessages:
    """Returns the quantities of the loop of ``signals`` in one boot.

    ArduPilot's ATTITUDE_TARGET lacks the attitude controller's correction of the rate, its log message RATE has it:
    both are candidates of the setpoint.

    Args:
        signals: of the vehicle and the axis.
        boot: whose messages count.
        controller: of the axis.
        per_demand: (r,) how much each input changes per unit of demand.

    Raises:
        NotLearnable: there is no setpoint of the rate that moves.
    """
    attitude, inputs = signals.attitude, signals.model_inputs
    assert attitude is not None and inputs is not None
    angle = _messages_of_boot(attitude, attitude.angle, boot)
    rate = _messages_of_boot(attitude, attitude.rate, boot)
    setpoints = {}
    for setpoint in signals.setpoints:
        messages = _messages_of_boot(setpoint.signal, setpoint.signal.values, boot)
        if np.diff(messages.values).any():
            setpoints[setpoint.unit] = messages
    if "rad/s" not in setpoints:
        raise NotLearnable(Loops.NO_RATE_SETPOINT)
    # The reference of each candidate is its setpoint plus angle gain × angle: what would be asked for at angle 0.
    rate_setpoint = setpoints["rad/s"]
    time = rate_setpoint.time
    angle_feedback = controller.angle_gain * np.interp(time, angle.time, angle.values)
    candidates = [rate_setpoint.values]
    if controller.is_ardupilot and "rad" in setpoints:
        angle_setpoint = setpoints["rad"]
        angle_demand = controller.angle_gain * np.interp(
            time, angle_setpoint.time, angle_setpoint.values
        )
        candidates.append(rate_setpoint.values + angle_demand - angle_feedback)
    outputs = inputs.range_fractions(boot)
    output_step = np.median(np.diff(outputs.time))
    demand = controller.demand_from_outputs(outputs.values, output_step)
    streams = [rate, Messages(outputs.time, demand)]
    for values in candidates:
        streams += [Messages(time, values), Messages(time, values + angle_feedback)]
    at_limit = controller.outputs_at_limit(outputs.values, inputs.scale.stop)
    return _LoopMessages(
        streams=streams,
        at_limit=Messages(outputs.time, at_limit.astype(np.float64)),
        rounding=inputs.scale.step / float(np.linalg.norm(per_demand)),
    )


def _messages_of_boot(stream: Attitude | TimeSeries, values: Array, boot: int) -> Messages:
    """Returns ``values`` (N,) of a ``stream`` in one boot, at their stamps."""
    rows = stream.boot == boot
    return Messages(stream.time[rows], values[rows])


def _window_starts(flights: Sequence[Flight], streams: Sequence[Messages]) -> Iterator[float]:
    """Yields where windows of ``SPECTRUM_SECONDS`` begin, s, half over each other, in which all messages come.

    A spectrum of a window with a gap would be that of the interpolation across it.

    Args:
        flights: of one boot.
        streams: messages of all quantities. Each must come in a window without a gap of ``MAX_MESSAGE_GAP``.
    """
    first_common = max(stream.time[0] for stream in streams)
    last_common = min(stream.time[-1] for stream in streams)
    for flight in flights:
        first = max(flight.time[0], first_common)
        last = min(flight.time[-1], last_common) - SPECTRUM_SECONDS
        # A stamp may be rounded: so the last window may end 1 µs late.
        for start in np.arange(first, last + 1e-6, SPECTRUM_SECONDS / 2):
            if all(_longest_gap(stream, start) < MAX_MESSAGE_GAP for stream in streams):
                yield start


def _longest_gap(stream: Messages, start: float) -> float:
    """Returns the longest time without a message, s, in the window that begins at ``start``."""
    stamps = stream.time[_rows_of_window(stream, start)]
    return np.diff(stamps, prepend=start, append=start + SPECTRUM_SECONDS).max()


def _rows_of_window(stream: Messages, start: float) -> slice:
    """Returns the rows of a ``stream`` in the window of ``SPECTRUM_SECONDS`` that begins at ``start``, s."""
    first, end = np.searchsorted(stream.time, [start, start + SPECTRUM_SECONDS]).tolist()
    return slice(first, end)


def _saturated_share(messages: _LoopMessages, starts: Array) -> float:
    """Returns the fraction of the output's power that came while an output was at a limit, from 0 to 1.

    While an output is at its limit, the loop is open: it answers neither wind nor setpoint. Power is that of the demand
    about its mean in each window.

    Args:
        messages: with the output, as a demand, and whether an output was at a limit.
        starts: (W,) where the windows begin, s.
    """
    output = messages.streams[Quantity.OUTPUT]
    power = power_at_limit = 0.0
    for start in starts:
        rows = _rows_of_window(output, start)
        squares = np.square(output.values[rows] - output.values[rows].mean())
        power += squares.sum()
        # The weights are 1 where an output was at a limit, else 0.
        power_at_limit += squares @ messages.at_limit.values[rows]
    if power == 0:
        return 0.0
    return power_at_limit / power


def _require_resolution(signals: Signals, spectra: CrossSpectra, rounding: float) -> None:
    """Raises ``NotLearnable`` if the outputs hardly move by more than their resolution.

    A uniformly distributed rounding error has a variance of rounding² / 12. It is compared with the variance of the
    output, which is its spectral density, averaged over frequencies, times the rate of the samples.

    Args:
        signals: with the scale of the outputs.
        spectra: of the loop.
        rounding: resolution of the outputs, as a demand.
    """
    density = spectra.mean_density[:, Quantity.OUTPUT, Quantity.OUTPUT].real
    mean_density = np.average(density, weights=spectra.effective_samples)
    variance = mean_density * spectra.message_rate
    if rounding**2 / 12 > MAX_ROUNDING_SHARE * variance:
        assert signals.model_inputs is not None
        scale = signals.model_inputs.scale
        raise NotLearnable(
            Reason.COMMAND_ROUNDED,
            axis=signals.axis,
            command=scale.step * np.sqrt(variance) / rounding,
            command_step=scale.step,
            unit=scale.unit,
        )


def _with_best_setpoint(spectra: CrossSpectra, controller: KnownController) -> CrossSpectra:
    """Returns the spectra of rate, output, setpoint and reference, with the setpoint that explains the output best.

    A setpoint of the rate may be logged with or without the attitude controller's correction, and the log does not say
    which. The rate controller makes the output u of setpoint r and rate p: u = C_r r − C_p p. So the true setpoint is
    the one of the candidates that leaves the least power of u − C_r r + C_p p, below
    ``MAX_EXPLAINED_FREQUENCY``. With the coefficients a = (C_p, 1, −C_r) of (p, u, r) and their spectral density S,
    that power is Σ aᵀ S ā over frequencies, weighted by the number of independent values in each band.

    Args:
        spectra: of rate, output, and pairs of setpoint and reference.
        controller: C_r from the setpoint, C_p from the rate.
    """
    is_slow = spectra.frequency < MAX_EXPLAINED_FREQUENCY
    from_setpoint, from_rate = controller.transfer(spectra.frequency[is_slow])
    coefficients = np.stack([from_rate, np.ones(len(from_rate)), -from_setpoint])
    weights = spectra.effective_samples[is_slow]

    def unexplained_power(setpoint: int) -> float:
        # Indices: j is the frequency, a and b are the three quantities.
        quantities = (Quantity.RATE, Quantity.OUTPUT, setpoint)
        density = spectra.select(quantities).mean_density[is_slow]
        power = np.einsum("j,aj,jab,bj->", weights, coefficients, density, coefficients.conj())
        return power.real

    # Setpoints are every second signal, each followed by its reference.
    candidates = range(Quantity.SETPOINT, len(spectra.stamp_offsets), 2)
    setpoint = min(candidates, key=unexplained_power)
    return spectra.select((Quantity.RATE, Quantity.OUTPUT, setpoint, setpoint + 1))


def _coherent_share(spectra: CrossSpectra) -> float:
    """Returns the fraction of the rate's variance that is coherent with the reference, from 0 to 1.

    The reference is what pilot or navigation ask for. The rest of the rate is by wind and noise. At each frequency the
    coherent part of the density is |S_pq|² / S_qq, of rate p and reference q; both densities are then summed over
    frequency, Hz.
    """
    density = spectra.mean_density
    rate_density = density[:, Quantity.RATE, Quantity.RATE].real
    reference_density = density[:, Quantity.REFERENCE, Quantity.REFERENCE].real
    cross_density = density[:, Quantity.RATE, Quantity.REFERENCE]
    coherent_density = np.abs(cross_density) ** 2 / reference_density
    width = np.gradient(spectra.frequency)
    return float((width @ coherent_density) / (width @ rate_density))


def _checked_plant(plant: Physical, per_demand: Array, controller: Controller) -> Physical:
    """Returns the ``plant``, whose parameters are marked as biased where its loop rings; refuses an uncertain one.

    The rate loop is computed of the estimated plant and of draws from its posterior, with the controller that flew. If
    the 90 % interval of its phase margin over the draws is wide, the flight did not show the plant.

    A loop rings if its phase margin is less than half of the usual one. If it also crosses over beyond the corner
    frequency of the motors, 1 / lag, most of the motion is at frequencies where the plant is k / (lag s) · 1 / s. Then
    the motion depends on the ratio of effect k and lag only, and neither is known by itself.

    Args:
        plant: without the gyro's filters.
        per_demand: (r,) how much each input changes per unit of demand.
        controller: of the axis.

    Raises:
        NotLearnable: the phase margin stays unknown, or the loop is unstable, though it flew settled.
    """
    # Columns of the draws: r effects, then damping, lag and delay.
    draws = plant.draws(MARGIN_DRAWS)
    effects, dynamics = draws[:, :-3], draws[:, -3:]
    effectiveness = effects @ per_demand
    dynamics = np.maximum(dynamics, PLANT_MINIMUM)
    rate = rate_loop(controller, effectiveness, dynamics)
    low, high = rate.phase_margin_interval
    is_certain = high - low <= 2 * MAX_PHASE_MARGIN_HALF_WIDTH
    if not (is_certain and rate.stable[0]):
        # The margin is infinite where nothing crosses over.
        interval = np.clip([low, high], -180.0, 180.0)
        raise NotLearnable(Loops.MARGIN_UNCERTAIN, phase_margin_interval=interval)
    # The corner frequency of a first-order lag is at ω · lag = 1.
    is_beyond_motors = 2 * np.pi * rate.crossover * plant.lag > 1
    if is_beyond_motors and rate.phase_margin < MARGIN_TARGETS["default"].phase_margin / 2:
        rings = Fact(ParameterDoubt.LOOP_RINGS, frequency=rate.crossover)
        status = dict.fromkeys(PARAMETERS, Status.BIASED)
        return plant._replace(status=status, reasons=dict.fromkeys(PARAMETERS, rings))
    return plant


def _physical_plant(fit: IdentifiedAxis, per_demand: Array) -> Physical:
    """Returns the physical parameters of a fit, without the gyro's filters, with the errors of the model added.

    The fit has one effect, of the demand, and logarithms of all parameters. A plant has an effect of each input. So the
    effect is spread over the inputs in proportion to what a demand moves them by, and the covariance is carried over
    by the derivatives of the parameters by the logarithms.

    Args:
        fit: posterior of the logarithms of the parameters.
        per_demand: (r,) how much each input changes per unit of demand.
    """
    values = LoopParameters.from_logarithms(fit.theta)
    # Each input's effect, of which a demand has the identified one.
    effect = values.effect * per_demand / (per_demand @ per_demand)
    # Derivatives of effect, damping, lag and delay by the four logarithms, (r + 3, 4).
    jacobian = block_diag(effect[:, None], [values.damping], [values.lag], [values.delay])
    covariance = jacobian @ fit.covariance[np.ix_(PLANT, PLANT)] @ jacobian.T
    plant = Physical(
        effect=effect,
        damping=values.damping,
        lag=values.lag,
        delay=values.delay,
        covariance=covariance,
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
        windows=len(fit.posterior.spectra.densities),
        filtered=False,
    )
    return plant._replace(
        wind_share=_wind_share(plant, values, fit.posterior.spectra),
        covariance=covariance + _model_error_covariance(fit, effect, values, jacobian),
    )


def _wind_share(plant: Physical, values: LoopParameters, spectra: CrossSpectra) -> float:
    """Returns the fraction of the torque's variance that is by the wind, in the band of the vehicle's motion.

    The rest is by the motors. Their torque has the density |effect / (1 + jω lag)|² S_u, of the output u. Integrals are
    sums over the bands of the spectra, up to the highest frequency of ``MOTION_BAND_HZ``.

    Args:
        plant: with the wind's components.
        values: with the effect of a demand, rad/s², and the motors' lag, s.
        spectra: of the loop.

    Returns:
        From 0, no wind, to 1.
    """
    frequency = spectra.frequency[spectra.frequency <= MOTION_BAND_HZ[1]]
    torque_per_demand = values.effect / (1 + 2j * np.pi * frequency * values.lag)
    output_density = spectra.mean_density[: len(frequency), Quantity.OUTPUT, Quantity.OUTPUT].real
    width = np.gradient(frequency)
    by_wind = width @ wind_torque_density(plant, frequency)
    # The densities of the output are two-sided, that of the wind is one-sided.
    by_motors = 2 * width @ (np.abs(torque_per_demand) ** 2 * output_density)
    return float(by_wind / (by_wind + by_motors))


def _model_error_covariance(
    fit: IdentifiedAxis, effect: Array, values: LoopParameters, jacobian: Array
) -> Array:
    """Returns the covariance (r + 3, r + 3) of effect, damping, lag and delay by what the model does not have.

    The likelihood's covariance takes the model for exact. This one is for what samples between messages and limits of
    the outputs do. It has four independent errors, of the logarithms of effect, damping, lag and delay, with the
    standard deviations of ``LOG_MODEL_DEVIATIONS`` and those that grow with slow messages and limits.

    A flight shows best the response to quick changes, so errors leave that response as it is: an error of the effect or
    the lag comes with errors of the others that make up for it. Each column of ``directions`` is one such error.

    Args:
        fit: posterior, with the time between messages beyond a control cycle and the fraction that limits cut off.
        effect: (r,) of each input.
        values: parameters of the axis.
        jacobian: (r + 3, 4) of the parameters by their logarithms.
    """
    lag, delay = values.lag, values.delay
    effect_column, lag_column = 0, 2
    lag_and_delay_rows = slice(-2, None)
    directions = jacobian.copy()
    # With more effect by one in its logarithm, the lag is longer by one lag and the delay shorter by a part of it.
    directions[lag_and_delay_rows, effect_column] = lag, -DELAY_PER_EFFECT * lag
    # A longer lag with a shorter delay is made up for by more effect.
    directions[:, lag_column] += np.concatenate([effect, [0.0, 0.0, -lag]]) / 2
    surplus_interval = fit.posterior.densities.surplus_interval
    lag_against_delay = LAG_DELAY_DEVIATION * (1 + 2 * fit.saturation_loss) * surplus_interval
    effect_deviation = np.hypot(
        SATURATION_EFFECT_DEVIATION * fit.saturation_loss,
        UNSEEN_EFFECT_DEVIATION * surplus_interval,
    )
    # In the order of LOG_MODEL_DEVIATIONS: effect, damping, lag, delay.
    sampling_deviations = [
        effect_deviation,
        0.0,
        lag_against_delay / lag,
        lag_against_delay / delay,
    ]
    model_deviations = list(LOG_MODEL_DEVIATIONS.values())
    variances = np.square(model_deviations) + np.square(sampling_deviations)
    return directions * variances @ directions.T
