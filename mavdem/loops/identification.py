"""Closed-loop identification of the plant of one axis: control effectiveness, damping, motor lag and delay.

Messages are used at their own time stamps. The model of ``plant.closed_loop`` is used, with the controller that the
autopilot's parameters describe. This file makes the data of that model from a log, refuses logs that do not determine
the plant, and converts the result to physical parameters, whose covariances contain the errors of the model.
"""

from collections.abc import Iterator, Sequence
from functools import partial
from math import isfinite
from typing import NamedTuple

import numpy as np

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
from mavdem.facts.learnability import NotLearnableReason
from mavdem.facts.loops import LoopFact
from mavdem.facts.model import ParameterDoubt
from mavdem.flight import Flight, boot_number
from mavdem.ingest.telemetry import rate_without_gaps
from mavdem.loops.axis_loops import MARGIN_TARGETS
from mavdem.loops.controllers import Controller
from mavdem.loops.filters import gyro_delay, gyro_response
from mavdem.loops.identified_plant import physical_plant
from mavdem.loops.loop_construction import inputs_per_demand, logged_controller
from mavdem.loops.margins import OpenLoop, controller_response, plant_response, rate_loop
from mavdem.plant import Physical
from mavdem.plant.closed_loop.identification import IdentifiedAxis, identify_axis
from mavdem.plant.closed_loop.likelihood import AxisPosterior
from mavdem.plant.closed_loop.reference import with_reference_from_gyro
from mavdem.plant.closed_loop.response import KnownController, Quantity
from mavdem.plant.closed_loop.spectra import (
    SPECTRUM_SECONDS,
    CrossSpectra,
    Messages,
    cross_spectra,
    with_stamps_of_cycles,
)
from mavdem.plant.identifiability import PARAMETERS
from mavdem.plant.parameters import DYNAMICS, EFFECTS, PLANT_MINIMUM

MIN_WINDOWS = 4
"""Least number of windows of ``SPECTRUM_SECONDS``, which overlap by half: a choice."""

MIN_IDENTIFIED_SECONDS = (MIN_WINDOWS + 1) * SPECTRUM_SECONDS / 2
"""Least settled flight in which a loop is identified, s: n windows that overlap by half take n + 1 half windows."""
MAX_MESSAGE_GAP = 1.0
"""Longest time without a message in a window, s: a choice."""
MAX_ROUNDING_SHARE = 0.2
"""Largest variance of the outputs' rounding, relative to the variance of the outputs themselves.

Beyond it, the loop of ArduCopter's simulator, which hardly moved and was logged at 20 Hz, was identified with a phase
margin of 66° in place of 19°.
"""
STEERED_SHARE = 0.9
"""Fraction of the rate's motion from which on commands explain nearly all of it: a choice."""
MIN_REFERENCE_SHARE = 0.6
"""Least fraction of the rate's variance that follows pilot or navigation.

With less, much of the outputs is the controller's answer to wind, which shows little of the plant. On half of the
flights of ``tools/validation/loops.py`` phase margins then erred by 14°; above, by 3°.
"""
MAX_EXPLAINED_FREQUENCY = 4.0
"""Highest frequency at which the output is compared with what the controller makes of the setpoint, Hz: a choice."""
MAX_PHASE_MARGIN_HALF_WIDTH = 10.0
"""Largest half width of the phase margin's 90 % interval, degrees, unless all of it is above the usual margin.

A tuner aims at 45° and is warned below 35°: a wider interval does not separate the two. One that lies above 45° says
that the goal is met, however wide it is.
"""
MARGIN_DRAWS = 100
"""Number of draws of the plant from which the interval of the phase margin is computed: a choice."""

STAMP_STEP = 1e-6
"""Resolution of the stamps, s: the last window of a flight may end that much late."""


def identify_plant_in_loop(signals: Signals, flights: Sequence[Flight]) -> Physical:
    """Identifies the plant of one axis in closed loop, with the known controller that flew it.

    The plant has a control effectiveness for each input, rate damping, motor lag and delay. The delay includes the
    delay of the gyro's filters. Only the boot with the longest flight is used, because messages must share a clock.

    Args:
        signals: logged time series of the vehicle, with angle, rate and setpoints of the axis.
        flights: settled flight of the vehicle.

    Returns:
        The plant, with the covariance of its parameters.

    Raises:
        NotLearnable: the controller is not known, no setpoint of the rate was logged that changes several times a
            second, the flight is too short, too little of the motion follows setpoints, or the phase margin is too
            uncertain.
    """
    # The fit takes seconds, and is cached; the rest is quick.
    flights_of_boot = tuple(flights_of_longest_boot(flights))
    fit, controller, mixer_gains = _identified_loop(signals, flights_of_boot)
    # The matrices are so small that more threads only take time. An overflow leads to an infinite value or NaN, which
    # the check refuses.
    with one_thread(), np.errstate(all="ignore"):
        plant = physical_plant(fit, mixer_gains)
        try:
            plant = _checked_plant(plant, mixer_gains, controller, fit.reference_share)
        except np.linalg.LinAlgError:
            raise NotLearnable(LoopFact.LOOP_NOT_FOUND) from None
    # The model of the fit has the gyro's filters in the controller, and not in the plant.
    return plant._replace(delay=plant.delay + gyro_delay(controller))


class _IdentifiedLoop(NamedTuple):
    """The identified parameters of one axis, with its controller."""

    fit: IdentifiedAxis
    """Posterior of the parameters."""
    controller: Controller
    """The controller of the logged parameters."""
    inputs_per_demand: Array
    """Change of each of the r inputs per unit of demand (r,)."""


@cached_per_vehicle("axis", "inputs")
def _identified_loop(signals: Signals, flights: tuple[Flight, ...]) -> _IdentifiedLoop:
    """Identifies the parameters of one axis in closed loop, from the flights of one boot.

    Cross-spectra of rate, output, setpoint and reference are estimated from the messages, and the posterior of the
    parameters given these spectra is maximised. Before the fit, flights are refused that have too few windows, outputs
    that are mostly rounding, or too little motion by setpoints. After the fit, flights are refused if according to the
    fitted model too little motion followed setpoints, or the controller has another gain than its parameters.

    Args:
        signals: logged time series of the vehicle, with angle, rate and setpoints of the axis.
        flights: flights of one boot, whose clock all messages share.

    Returns:
        The fit, with the controller and the change of each input per unit of its demand.

    Raises:
        NotLearnable: as for :func:`identify_plant_in_loop`.
    """
    record = Record.from_flights(flights)
    controller = _controller_of_record(signals, record)
    mixer_gains = inputs_per_demand(controller, record)
    messages = _loop_messages(signals, boot_number(flights[0]), controller, mixer_gains)
    window_starts = np.array(list(_window_starts(flights, messages.streams)))
    if len(window_starts) < MIN_WINDOWS:
        raise NotLearnable(LoopFact.LOOP_TOO_SHORT, least_duration=MIN_IDENTIFIED_SECONDS)
    saturated_share = _saturated_power_fraction(messages, window_starts)
    known_controller = KnownController(
        partial(controller_response, controller),
        partial(gyro_response, controller),
        controller.angle_gain,
        controller.loop_period,
    )
    with one_thread(), np.errstate(all="ignore"):
        spectra = _loop_spectra(signals, messages, window_starts, known_controller)
        # A fast check before the fit. Aliasing may halve the share that is coherent with the reference, so half of the
        # limit is enough here. An output at a limit cannot follow, so its share is added as if it followed. The
        # comparison is negated so that a share of NaN is refused.
        coherent_share = _coherent_share(spectra)
        if not coherent_share + saturated_share >= MIN_REFERENCE_SHARE / 2:
            raise NotLearnable(LoopFact.NOT_STEERED, share=coherent_share)
        posterior = AxisPosterior(spectra, known_controller, messages.rounding, saturated_share)
        fit = _checked_fit(posterior)
    return _IdentifiedLoop(fit, controller, mixer_gains)


def _controller_of_record(signals: Signals, record: Record) -> Controller:
    """Returns the rate and attitude controller of one axis, with the gains and filters of the logged parameters.

    Args:
        signals: logged time series of the vehicle for the axis, with the geometry of its motors.
        record: the flights, with the parameters of the autopilot.
    """
    assert signals.model_inputs is not None
    geometry = signals.model_inputs.geometry
    # If the positions of the motors are only assumed, the mixer must come from the autopilot's parameters.
    mixer_row = None if geometry.positions_assumed else geometry.mixer_row(signals.axis)
    return logged_controller(record.parameters, signals.axis, mixer_row)


def _checked_fit(posterior: AxisPosterior) -> IdentifiedAxis:
    """Returns the parameters of one axis that maximise their posterior, if the fit passes its checks.

    Args:
        posterior: posterior of the parameters, given the spectra of the flight.

    Raises:
        NotLearnable: the fit fails; too little of the motion followed setpoints by the fitted model; or the controller
            has another gain than its parameters.
    """
    try:
        fit = identify_axis(posterior)
        reference_share = fit.reference_share
    except np.linalg.LinAlgError:
        raise NotLearnable(LoopFact.LOOP_NOT_FOUND) from None
    # Output that the limits of the motors cut off cannot follow, so its share is added as if it followed. The
    # comparison is negated so that a share of NaN is refused.
    if not reference_share + fit.saturation_loss >= MIN_REFERENCE_SHARE:
        raise NotLearnable(LoopFact.NOT_STEERED, share=reference_share)
    # If the fitted gain of the controller differs from its parameters' gain, the model of the controller is wrong.
    if not fit.controller_consistent:
        raise NotLearnable(LoopFact.LOOP_NOT_FOUND)
    return fit


class _LoopMessages(NamedTuple):
    """The quantities of a loop at the stamps of their messages."""

    streams: list[Messages]
    """The signals in the order of ``Quantity``, on which :func:`_with_best_setpoint` relies.

    They are the rate, rad/s, the output as a demand, and then a pair for each candidate of the rate setpoint. The pair
    is the setpoint and its reference, both in rad/s: the reference is the setpoint without the feedback of the angle.
    """
    at_limit: Messages
    """1 where an output of a motor is at a limit, else 0, at the stamps of the output."""
    rounding: float
    """Resolution of the logged output, as a demand."""


def _loop_messages(
    signals: Signals, boot: int, controller: Controller, mixer_gains: Array
) -> _LoopMessages:
    """Returns the logged quantities of one axis' loop in one boot, each at the stamps of its own messages.

    Args:
        signals: logged time series of the vehicle, with angle, rate and setpoints of the axis.
        boot: number of the boot whose messages are used.
        controller: controller of the axis.
        mixer_gains: change of each input per unit of demand (r,).

    Returns:
        Streams of rate and demand, and of setpoint and reference for each candidate of the setpoint; flags of outputs
        at a limit; and the step to which the demand is rounded.

    Raises:
        NotLearnable: there is no setpoint of the rate in the boot, or it is constant. Its messages count as logged
            from ``MIN_SLOW_MOTION_RATE`` on.
    """
    attitude, inputs = signals.attitude, signals.model_inputs
    assert attitude is not None and inputs is not None
    outputs = inputs.range_fractions(boot)

    def messages_at_cycles(stream: Attitude | TimeSeries, values: Array) -> Messages:
        """Returns samples of the boot, at the times of the cycles in which they were sent."""
        messages = _messages_of_boot(stream, values, boot)
        return with_stamps_of_cycles(messages, outputs.time, controller.loop_period)

    angle = messages_at_cycles(attitude, attitude.angle)
    rate = messages_at_cycles(attitude, attitude.rate)
    setpoints = {}
    is_rate_setpoint_logged = False
    for setpoint in signals.setpoints:
        messages = messages_at_cycles(setpoint.signal, setpoint.signal.values)
        if setpoint.unit == "rad/s":
            # A few messages, or those of another boot, do not show whether the setpoint moved.
            message_rate = rate_without_gaps(np.diff(messages.time))
            is_rate_setpoint_logged = message_rate >= MIN_SLOW_MOTION_RATE
        if np.diff(messages.values).any():
            setpoints[setpoint.unit] = messages
    if "rad/s" not in setpoints:
        raise NotLearnable(
            LoopFact.NO_RATE_SETPOINT,
            is_logged=is_rate_setpoint_logged,
            least_rate=MIN_SLOW_MOTION_RATE,
        )
    output_step = np.median(np.diff(outputs.time))
    demand = controller.demand_from_outputs(outputs.values, output_step)
    candidates = _candidates_with_references(
        setpoints["rad/s"], setpoints.get("rad"), angle, controller
    )
    is_at_limit = controller.outputs_at_limit(outputs.values, inputs.scale.upper_limit)
    return _LoopMessages(
        streams=[rate, Messages(outputs.time, demand), *candidates],
        at_limit=Messages(outputs.time, is_at_limit.astype(np.float64)),
        rounding=inputs.scale.step / float(np.linalg.norm(mixer_gains)),
    )


def _candidates_with_references(
    rate_setpoint: Messages,
    angle_setpoint: Messages | None,
    angle: Messages,
    controller: Controller,
) -> list[Messages]:
    """Returns one or two candidates of the setpoint that the rate controller had, each followed by its reference.

    The attitude controller adds the error of the angle, times the angle gain, to the rate setpoint. ArduPilot's message
    ATTITUDE_TARGET lacks this correction, while its log message RATE contains it, and a log does not say which it is.
    So one candidate is the setpoint as logged, and for ArduPilot another is the setpoint with the correction added.
    :func:`_with_best_setpoint` chooses between them.

    Args:
        rate_setpoint: setpoint of the rate as logged, rad/s.
        angle_setpoint: setpoint of the angle, rad; None if none is logged.
        angle: measured angle, rad.
        controller: controller of the axis, with its angle gain, 1/s.

    Returns:
        The candidates and references in turn, rad/s, all at the stamps of the logged setpoint. A reference is the
        candidate plus angle gain × angle, which is the rate setpoint at an angle of 0.
    """
    time = rate_setpoint.time
    angle_feedback = controller.angle_gain * np.interp(time, angle.time, angle.values)
    candidates = [rate_setpoint.values]
    if controller.is_ardupilot and angle_setpoint is not None:
        angle_demand = controller.angle_gain * np.interp(
            time, angle_setpoint.time, angle_setpoint.values
        )
        candidates.append(rate_setpoint.values + angle_demand - angle_feedback)
    candidates_and_references = []
    for values in candidates:
        candidates_and_references.append(Messages(time, values))
        candidates_and_references.append(Messages(time, values + angle_feedback))
    return candidates_and_references


def _loop_spectra(
    signals: Signals, messages: _LoopMessages, window_starts: Array, controller: KnownController
) -> CrossSpectra:
    """Estimates the cross-spectra of a loop, between rate, output, setpoint and reference.

    Args:
        signals: signals of the vehicle, with the scale of the outputs.
        messages: the logged quantities, with several candidates of the rate setpoint.
        window_starts: times (W,) at which the windows begin, s.
        controller: the controller, by which one of the candidates is chosen.

    Returns:
        The spectra, with the candidate that agrees best with the controller.

    Raises:
        NotLearnable: the messages are too slow, or the outputs are mostly rounding.
    """
    spectra = cross_spectra(messages.streams, window_starts)
    if spectra.message_rate < MIN_SLOW_MOTION_RATE:
        raise NotLearnable(
            LoopFact.NO_RATE_SETPOINT, is_logged=False, least_rate=MIN_SLOW_MOTION_RATE
        )
    _require_resolution(signals, spectra, messages.rounding)
    # The reference of the setpoint as logged, which is the first candidate. That of the other one contains no angle.
    spectra = with_reference_from_gyro(spectra, controller)
    return _with_best_setpoint(spectra, controller)


def _messages_of_boot(stream: Attitude | TimeSeries, values: Array, boot: int) -> Messages:
    """Selects the samples of one boot.

    Args:
        stream: times and boots of N samples.
        values: value of each sample (N,).
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.

    Returns:
        Times and values of these samples.
    """
    is_of_boot = stream.boot == boot
    return Messages(stream.time[is_of_boot], values[is_of_boot])


def _window_starts(flights: Sequence[Flight], streams: Sequence[Messages]) -> Iterator[float]:
    """Yields the times, s, at which windows without a gap begin, from which spectra are computed.

    Windows are ``SPECTRUM_SECONDS`` long and overlap by half. A window is left out if any stream has a gap of
    ``MAX_MESSAGE_GAP`` or more in it, which would distort its spectrum.

    Args:
        flights: flights of one boot; each window lies within one of them.
        streams: messages of each quantity of the loop: rate, output and setpoint.
    """
    first_common_time = max(stream.time[0] for stream in streams)
    last_common_time = min(stream.time[-1] for stream in streams)
    for flight in flights:
        first_start = max(flight.time[0], first_common_time)
        last_start = min(flight.time[-1], last_common_time) - SPECTRUM_SECONDS
        for start in np.arange(first_start, last_start + STAMP_STEP, SPECTRUM_SECONDS / 2):
            if all(_longest_gap(stream, start) < MAX_MESSAGE_GAP for stream in streams):
                yield start


def _longest_gap(stream: Messages, start: float) -> float:
    """Returns the longest time without a message, s, in the window of ``SPECTRUM_SECONDS`` from ``start`` (s) on.

    The edges of the window count like messages, so that a gap at its beginning or end is seen too.
    """
    stamps = stream.time[_rows_of_window(stream, start)]
    return np.diff(stamps, prepend=start, append=start + SPECTRUM_SECONDS).max()


def _rows_of_window(stream: Messages, start: float) -> slice:
    """Returns the rows of a stream in the window of ``SPECTRUM_SECONDS`` that begins at ``start``, s."""
    first, end = np.searchsorted(stream.time, [start, start + SPECTRUM_SECONDS]).tolist()
    return slice(first, end)


def _saturated_power_fraction(messages: _LoopMessages, window_starts: Array) -> float:
    """Computes the fraction of the output's power that came while a motor was at a limit.

    While an output is at its limit, the loop is open: it responds neither to wind nor to the setpoint. The power is the
    sum of squares of the demand about its mean in each window.

    Args:
        messages: messages of the loop, with the output as a demand, and whether a motor was at a limit.
        window_starts: times (W,) at which the windows begin, s.

    Returns:
        The fraction, 0 to 1; 0 if the output has no power.
    """
    output = messages.streams[Quantity.OUTPUT]
    power = power_at_limit = 0.0
    for start in window_starts:
        rows_in_window = _rows_of_window(output, start)
        demand = output.values[rows_in_window]
        squares = np.square(demand - demand.mean())
        power += squares.sum()
        # The weights are 1 where an output was at a limit, otherwise 0.
        power_at_limit += squares @ messages.at_limit.values[rows_in_window]
    if power == 0:
        return 0.0
    return power_at_limit / power


def _require_resolution(signals: Signals, spectra: CrossSpectra, rounding: float) -> None:
    """Raises an error if the outputs hardly change by more than their resolution.

    A uniformly distributed rounding error has a variance of rounding² / 12. It may be at most ``MAX_ROUNDING_SHARE``
    times the variance of the output, which is its two-sided density, averaged over frequencies, times the message rate.

    Args:
        signals: signals of the vehicle, with the scale of the outputs for the message to the user.
        spectra: cross-spectra of the rate, the controller's output and the setpoints.
        rounding: resolution of the outputs, in the unit of the demand.

    Raises:
        NotLearnable: the variance of the rounding error is too large.
    """
    output_density = spectra.mean_density[:, Quantity.OUTPUT, Quantity.OUTPUT].real
    density_over_frequencies = np.average(output_density, weights=spectra.effective_samples)
    variance = density_over_frequencies * spectra.message_rate
    if rounding**2 / 12 > MAX_ROUNDING_SHARE * variance:
        assert signals.model_inputs is not None
        scale = signals.model_inputs.scale
        # The user knows the unit of the motor commands, in which the same resolution is ``scale.step``.
        command_per_demand = scale.step / rounding
        raise NotLearnable(
            NotLearnableReason.COMMAND_ROUNDED,
            axis=signals.axis,
            command=command_per_demand * np.sqrt(variance),
            command_step=scale.step,
            unit=scale.unit,
        )


def _with_best_setpoint(spectra: CrossSpectra, controller: KnownController) -> CrossSpectra:
    """Chooses the candidate of the rate setpoint that explains the output best.

    A rate setpoint may be logged with or without the attitude controller's correction, and the log does not show which.
    The rate controller computes the output u from the setpoint r and the rate p: u = C_r r − C_p p. So the true
    setpoint is the candidate with which least power of the output remains unexplained.

    Args:
        spectra: cross-spectra of rate, output, and a pair of setpoint and reference for each candidate.
        controller: the controller, with C_r from the setpoint and C_p from the rate.

    Returns:
        Cross-spectra of rate, output, and the chosen setpoint with its reference.
    """
    # From index SETPOINT on there are pairs of a candidate and its reference (:attr:`_LoopMessages.streams`).
    signal_count = len(spectra.stamp_offsets)
    assert (signal_count - Quantity.SETPOINT) % 2 == 0, "each setpoint needs its reference"
    candidates = range(Quantity.SETPOINT, signal_count, 2)
    setpoint = min(candidates, key=partial(_unexplained_power, spectra, controller))
    return spectra.select((Quantity.RATE, Quantity.OUTPUT, setpoint, setpoint + 1))


def _unexplained_power(spectra: CrossSpectra, controller: KnownController, setpoint: int) -> float:
    """Returns the power of the output that the controller does not compute from one of the logged setpoints.

    With the controller's responses C_r and C_p and the output u it is the power of u − C_r r + C_p p, the sum over
    frequencies of aᵀ S ā, with the coefficients a = (C_p, 1, −C_r) of (p, u, r) and their cross-spectral density S.

    Args:
        spectra: cross-spectra of the rate p, the output u, and the candidates of the setpoint.
        controller: frequency responses, attitude gain and cycle time of the controller that flew.
        setpoint: index of the setpoint r among the quantities of the spectra.

    Returns:
        The power up to ``MAX_EXPLAINED_FREQUENCY``, each frequency weighted by its number of independent values.
    """
    is_slow = spectra.frequency < MAX_EXPLAINED_FREQUENCY
    demand_from_setpoint, demand_from_rate = controller.transfer(spectra.frequency[is_slow])
    coefficients = np.stack(
        [demand_from_rate, np.ones(len(demand_from_rate)), -demand_from_setpoint]
    )
    quantities = (Quantity.RATE, Quantity.OUTPUT, setpoint)
    density = spectra.select(quantities).mean_density[is_slow]
    weights = spectra.effective_samples[is_slow]
    # Letters of einsum: frequency j, quantities a and b.
    power = np.einsum("j,aj,jab,bj->", weights, coefficients, density, coefficients.conj())
    return float(power.real)


def _coherent_share(spectra: CrossSpectra) -> float:
    """Computes the fraction of the rate's variance that is coherent with the reference.

    The reference is the command of pilot or navigation; the rest of the rate is caused by wind and noise. At each
    frequency the coherent part of the density is |S_pq|² / S_qq, with rate p and reference q. It and the density of the
    rate are integrated over frequency.

    Args:
        spectra: cross-spectra of rate, output, setpoint and reference.

    Returns:
        The fraction, 0 to 1.
    """
    density = spectra.mean_density
    rate_density = density[:, Quantity.RATE, Quantity.RATE].real
    reference_density = density[:, Quantity.REFERENCE, Quantity.REFERENCE].real
    cross_density = density[:, Quantity.RATE, Quantity.REFERENCE]
    coherent_density = np.abs(cross_density) ** 2 / reference_density
    bandwidth = np.gradient(spectra.frequency)
    return float((bandwidth @ coherent_density) / (bandwidth @ rate_density))


def _checked_plant(
    plant: Physical, mixer_gains: Array, controller: Controller, reference_share: float = 0.0
) -> Physical:
    """Checks an identified plant by the phase margin of its loop with the controller.

    The rate loop is computed for the estimated plant and for draws from its posterior. If the 90 % interval of its
    phase margin over the draws is wide, and not all of it above the usual margin, the flight did not determine the
    plant, and it is rejected.

    The parameters are marked as biased if two conditions hold: the loop rings, that is its phase margin is less than
    half of the usual one, and its crossover is above the corner frequency of the motors, 1 / lag. Then most of the
    motion is at frequencies at which the plant is about k / (lag s) · 1 / s. That depends only on the ratio of effect k
    and lag, so that neither is determined alone.

    Args:
        plant: the identified plant, without the gyro's filters.
        mixer_gains: (r,) change of each input per unit of demand.
        controller: rate controller of the axis, with its gains and filters.
        reference_share: fraction of the rate's motion that commands explain.

    Returns:
        The plant, with its parameters marked as biased if its loop rings.

    Raises:
        NotLearnable: the phase margin is too uncertain, or the estimated loop is unstable.
    """
    draws = plant.draws(MARGIN_DRAWS)
    effectiveness = draws[:, EFFECTS] @ mixer_gains
    dynamics = np.maximum(draws[:, DYNAMICS], PLANT_MINIMUM)
    rate = rate_loop(controller, plant_response(controller, effectiveness, dynamics))
    _require_known_margin(rate, reference_share)
    # The corner frequency of a first-order lag is at ω · lag = 1.
    is_beyond_motors = 2 * np.pi * rate.crossover * plant.lag > 1
    if is_beyond_motors and rate.phase_margin < MARGIN_TARGETS["default"].phase_margin / 2:
        rings = Fact(ParameterDoubt.LOOP_RINGS, frequency=rate.crossover)
        status = dict.fromkeys(PARAMETERS, Status.BIASED)
        return plant._replace(status=status, reasons=dict.fromkeys(PARAMETERS, rings))
    return plant


def _require_known_margin(rate: OpenLoop, reference_share: float = 0.0) -> None:
    """Raises an error if the flight does not determine the phase margin of an identified rate loop.

    The error says what to do: to steer more, unless commands explain nearly all of the motion already.

    Args:
        rate: rate loop of the estimated plant and of draws from its posterior.
        reference_share: fraction of the rate's motion that commands explain, 0 to 1.

    Raises:
        NotLearnable: the 90 % interval of the phase margin is wider than twice ``MAX_PHASE_MARGIN_HALF_WIDTH`` and not
            all of it above the usual margin, or the estimated loop is unstable although the vehicle flew.
    """
    low, high = rate.phase_margin_interval
    goal = MARGIN_TARGETS["default"].phase_margin
    is_narrow = high - low <= 2 * MAX_PHASE_MARGIN_HALF_WIDTH
    # An infinite margin, of a gain that never reaches 1, is that of a loop which controls nothing.
    meets_goal = low >= goal and isfinite(high)
    if rate.is_stable and (is_narrow or meets_goal):
        return
    # The message limits an infinite margin to half a circle.
    interval = np.clip([low, high], -180.0, 180.0)
    raise NotLearnable(
        LoopFact.MARGIN_UNCERTAIN,
        phase_margin_interval=interval,
        least_phase_margin=goal,
        is_stable=rate.is_stable,
        is_steered=reference_share >= STEERED_SHARE,
    )
