"""Analysis of one vehicle and axis: the model and its parameters, or facts (coded findings) why there are none.

Learnability and tier decide what the log allows. The model is trained on the settled flight, tested on windows that no
model was trained on, and graded by the findings. A model of the slow motion is kept only if it predicts better than the
baselines.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace

from mavdem.assessment.axis.figures import (
    ALL_AXES,
    AxisEstimates,
    LogAnalysis,
    estimates_of_axis,
    motor_changes,
    physical_parameters,
)
from mavdem.assessment.axis.findings import with_vehicle_made_torque_marked
from mavdem.assessment.axis.options import Options, ShowStep, show_nothing
from mavdem.assessment.axis.training import TestedModel, train_and_test
from mavdem.assessment.condition import measure_condition
from mavdem.assessment.identity import identify_vehicle
from mavdem.assessment.motor_alarms import motor_alarms
from mavdem.assessment.tier import log_tier
from mavdem.dataset.axes import AXES, TILT_AXES
from mavdem.dataset.flights import usable_segments
from mavdem.dataset.learnability import learnability_of
from mavdem.dataset.segment_learnability import Learnability
from mavdem.dataset.signals import MIN_SLOW_MOTION_RATE, Signals, rate_between_outages
from mavdem.dem import Learned
from mavdem.errors import NotLearnable
from mavdem.experiments.truth import compare_with_truth, read_truth_of_flight
from mavdem.experiments.window import TooFewSamples
from mavdem.facts import Fact
from mavdem.facts.assessment import Caveat, NoModel
from mavdem.flight import Flights
from mavdem.immutable import ReadOnlyDict
from mavdem.ingest import Log
from mavdem.motors.balance_blocks import MIN_SAMPLE_RATE, SAMPLE_RATE_TOLERANCE
from mavdem.motors.motor_changes import MotorChange
from mavdem.motors.trim_pattern import trim_of_signals
from mavdem.plant import Physical
from mavdem.plant.wind_torque import estimate_wind_torque

EstimatesOfAxes = Callable[[], Mapping[str, AxisEstimates]]
"""Returns estimates of some axes by name, once they are computed."""


def no_estimates() -> Mapping[str, AxisEstimates]:
    """Returns the estimates of no axis: the default of :func:`analyse`."""
    return {}


def analyse(
    log: Log,
    signals: Signals,
    axis: str = "roll",
    options: Options | None = None,
    *,
    progress: ShowStep = show_nothing,
    other_axis: LogAnalysis | None = None,
    estimates_of_other_axes: EstimatesOfAxes = no_estimates,
) -> LogAnalysis:
    """Analyses one axis of a vehicle: what the log allows, the model and its test, and the physical parameters.

    The model is trained on the whole settled flight of the longest segment's boot and judged by held-out windows. With
    ``options.train`` it is trained on this duration of the longest segment, and tested once on what follows.

    Args:
        log: the log, as ``mavdem.ingest.read_log`` returns it.
        signals: signals of the vehicle, for any axis and inputs.
        axis: "roll" or "pitch"; "all" for a model of roll, and the physical parameters of roll, pitch and yaw.
        options: choices of the user; None for the defaults.
        progress: shows the steps of the work.
        other_axis: an earlier analysis of the vehicle, of another axis or without a model. Its results that are the
            same for all axes are not computed again, nor its physical parameters of this axis if they are of the same
            flights.
        estimates_of_other_axes: returns estimates of pitch and yaw by axis that another process has computed meanwhile;
            results that it does not return are computed here.

    Returns:
        The analysis. If no model can be learned, it contains the reason.

    Raises:
        NotLearnable: the flight is too short for the ``start``, ``train`` or ``test`` of the options.
        Unreadable: ``truth`` is not the truth of this flight.
        ValueError: unknown axis or inputs.
    """
    options = options or Options()
    signals = signals.for_axis(AXES[0] if axis == ALL_AXES else axis, options.inputs)
    segments: Flights = ()
    if options.with_model or options.with_motors:
        segments, learnability = usable_segments(signals, log.components)
    else:
        learnability = learnability_of(signals, log.components)
    with progress("Examining the motors", measured=False):
        analysis = _analysis_without_model(
            log, signals, learnability, other_axis, with_motors=options.with_motors
        )
    # In tier "b" the messages are too slow for a full model, but fast enough for one of the slow motion.
    is_slow = analysis.tier.tier == "b" and signals.axis in TILT_AXES
    if is_slow:
        segments, slow_learnability = usable_segments(signals, log.components, MIN_SLOW_MOTION_RATE)
        if not segments:
            return _with_reason_of_no_slow_model(analysis, slow_learnability.reason)
    if not segments or not (options.with_model or is_slow):
        return analysis
    try:
        trained_model = train_and_test(segments, options, progress, is_slow=is_slow)
    except NotLearnable as error:
        has_chosen_durations = options.start or options.train or options.test
        if isinstance(error, TooFewSamples) and has_chosen_durations:
            # The user has chosen durations that do not fit into the flight: that is an error, and no result.
            raise
        if is_slow:
            return _with_reason_of_no_slow_model(analysis, error.fact)
        return replace(analysis, reason=error.fact)
    axis_estimates = None if other_axis is None else other_axis.axes.get(axis)
    analysis = _with_trained_model(
        analysis, trained_model, signals, axis_estimates, options, is_slow=is_slow
    )
    if axis == ALL_AXES:
        analysis = _with_other_axes(analysis, log, signals, progress, estimates_of_other_axes)
    return analysis


def _with_trained_model(
    analysis: LogAnalysis,
    trained_model: TestedModel,
    signals: Signals,
    axis_estimates: AxisEstimates | None,
    options: Options,
    *,
    is_slow: bool,
) -> LogAnalysis:
    """Adds a trained model to the analysis of a log, with its cautions, physical parameters and forecast errors.

    Args:
        analysis: what the log shows without a model.
        trained_model: the model, with its training data and its forecasts of held-out windows.
        signals: signals of the vehicle, for the axis of the model.
        axis_estimates: physical parameters of the axis, if they were estimated before; None otherwise.
        options: choices of the user, of which the truth of a simulated flight is used here.
        is_slow: whether the streams were so slow that the model describes the slow motion only.

    Returns:
        A copy of the analysis with the model; with the comparison to the truth, if that is known.

    Raises:
        Unreadable: ``truth`` is not the truth of this flight.
    """
    flights = trained_model.flights
    learned = _with_cautions(trained_model.learned, flights, is_slow=is_slow)
    learned = _with_physical_parameters(
        learned, signals, flights, analysis, axis_estimates, is_slow=is_slow
    )
    is_oscillating = analysis.condition.oscillation is not None
    learned = with_vehicle_made_torque_marked(learned, vehicle_made_torque=is_oscillating)
    held_out = replace(trained_model.held_out, model=learned.forecast_model)
    analysis = replace(analysis, flights=flights, learned=learned, held_out=held_out)
    if options.truth is not None:
        truth = read_truth_of_flight(flights, options.truth)
        analysis = replace(analysis, truth=compare_with_truth(learned, flights, truth))
    return analysis


def analyse_without_model(
    log: Log, signals: Signals, axis: str = ALL_AXES, options: Options | None = None
) -> LogAnalysis:
    """Analyses one vehicle's log without learning a model, which takes little time.

    A caller that wants the model too passes the result to :func:`analyse` as ``other_axis``, so that nothing is
    computed twice.

    Args:
        log: the log of a flight, with the messages of each vehicle.
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        axis: "roll", "pitch", "yaw", or ``ALL_AXES``, which stands for roll here.
        options: choices of the user; None for the defaults.

    Returns:
        The analysis: what the log allows, the condition and identity of the vehicle, and the changes of its motors. Its
        ``learned`` is None.
    """
    options = options or Options()
    first_axis = AXES[0] if axis == ALL_AXES else axis
    axis_signals = signals.for_axis(first_axis, options.inputs)
    _, learnability = usable_segments(axis_signals, log.components)
    return _analysis_without_model(
        log, axis_signals, learnability, other_axis=None, with_motors=options.with_motors
    )


def _analysis_without_model(
    log: Log,
    signals: Signals,
    learnability: Learnability,
    other_axis: LogAnalysis | None,
    *,
    with_motors: bool,
) -> LogAnalysis:
    """Returns the analysis of a vehicle's log without a model, with the reason why it allows no full one.

    Args:
        log: the log of a flight, with the messages of each vehicle.
        signals: logged time series of the vehicle, with angle, rate and setpoints of one axis.
        learnability: whether a full model of the axis can be learned.
        other_axis: analysis of another axis of the same vehicle, whose results that are the same for all axes are not
            computed again; None for the first axis.
        with_motors: whether the flight is searched for weak motors and oscillations.

    Returns:
        The analysis.
    """
    alarms: tuple[MotorChange, ...] = ()
    trim = None
    if other_axis is not None:
        condition = other_axis.condition
        identity = other_axis.identity
        alarms = other_axis.alarms
        trim = other_axis.trim
        motors_are_watched = other_axis.motors_are_watched
    else:
        condition = measure_condition(signals, with_oscillation=with_motors)
        identity = identify_vehicle(signals, log.receive_time[0])
        if with_motors:
            alarms = motor_alarms(signals)
            trim = trim_of_signals(signals)
        motors_are_watched = _is_motor_loss_detectable(signals)
    # The tier says what the rates of the log allow: "a" a full model, "b" one of the slow motion, "c" no model.
    tier = log_tier(learnability, condition)
    reason = None if tier.allows_full_model else tier.tier_reason
    quality = learnability.figures
    if tier.tier is None and quality.airborne and not quality.segments:
        reason = Fact(NoModel.NO_SETTLED_FLIGHT, duration=quality.airborne)
    return LogAnalysis(
        learnability,
        tier,
        condition,
        identity,
        reason,
        alarms=alarms,
        trim=trim,
        motors_are_watched=motors_are_watched,
    )


def _is_motor_loss_detectable(signals: Signals) -> bool:
    """Returns whether a motor that weakens in flight would have been detected.

    The detector of lost thrust needs the positions of the motors, and their outputs at ``MIN_SAMPLE_RATE`` or faster.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
    """
    motors = signals.motors
    if motors is None or not motors.geometry.positions:
        return False
    return rate_between_outages(motors) >= SAMPLE_RATE_TOLERANCE * MIN_SAMPLE_RATE


def _with_reason_of_no_slow_model(analysis: LogAnalysis, slow_model_reason: Fact) -> LogAnalysis:
    """Adds to an analysis without a model the reason why there is no model of the slow motion either.

    A log whose messages are too slow for a full model may still allow a model of the slow motion. If that cannot be
    learned either, the user reads two sentences: what prevents the full model, and what prevents the slow one.

    Args:
        analysis: the analysis, whose ``reason`` says why there is no full model. If it has none, the analysis is
            returned unchanged.
        slow_model_reason: reason why there is no model of the slow motion. If it equals the reason for the full model,
            nothing is added.

    Returns:
        A copy of the analysis whose ``reason`` contains both.
    """
    full_model_reason = analysis.reason
    if full_model_reason is None or slow_model_reason == full_model_reason:
        return analysis
    both_reasons = Fact(
        NoModel.SLOW_MODEL_REFUSED, reason=full_model_reason, refusal=slow_model_reason
    )
    return replace(analysis, reason=both_reasons)


def _with_cautions(learned: Learned, flights: Flights, *, is_slow: bool) -> Learned:
    """Adds cautions about a model's data before its other cautions.

    A caution is a sentence that limits what the model may be used for. Reports show cautions in their order, so the
    most general comes first: that the model describes slow motion only, then cautions about the training data, such as
    missing samples, and last those that learning itself has found.

    Args:
        learned: the linear model that was learned from a flight, with its training data.
        flights: training data, at least one flight. All come from one log and axis, so the cautions of the first one
            count.
        is_slow: whether the streams were so slow that the model describes the slow motion only.

    Returns:
        A copy of the model with all cautions.
    """
    cautions = [*flights[0].cautions, *learned.cautions]
    if is_slow:
        cautions.insert(0, Fact(Caveat.SLOW_MOTION_ONLY))
    return replace(learned, cautions=tuple(cautions))


def _with_physical_parameters(
    learned: Learned,
    signals: Signals,
    flights: Flights,
    analysis: LogAnalysis,
    axis_estimates: AxisEstimates | None,
    *,
    is_slow: bool,
) -> Learned:
    """Adds physical parameters to a model, and the wind torque that follows from them.

    Physical parameters are control effectiveness, rate damping, motor time constant and delay. The wind torque is the
    angular acceleration, rad/s², that these parameters leave unexplained by the motors.

    1. Estimates for the same axis that an earlier analysis has computed from the same flights are reused, because the
       estimation is slow.
    2. Otherwise the parameters are estimated, except for a model of the slow motion, because only fast motion
       determines them.
    3. If a motor gained or lost thrust in flight, the wind torque is estimated again, with a new beginning at each such
       time. Otherwise the changed torque of that motor would be attributed to wind.

    Args:
        learned: the linear model that was learned from a flight, with its training data.
        signals: signals of the vehicle, for the axis of the model.
        flights: the flights that the model was trained on.
        analysis: analysis of the vehicle, for the changes of its motors in flight.
        axis_estimates: estimates for the axis from an earlier analysis; None if there is none.
        is_slow: whether the model is one of the slow motion.

    Returns:
        A copy of the model with physical parameters and wind torque.
    """
    if axis_estimates is not None and axis_estimates.physical:
        # Flights with the same numbers of samples are the same flights: both are of this vehicle and axis.
        lengths = tuple(len(flight) for flight in axis_estimates.flights)
        if lengths == learned.record.lengths:
            learned = learned.with_physical(axis_estimates.physical)
            return learned.with_wind_torque(axis_estimates.wind)
    changes = motor_changes(analysis.alarms, flights)
    if not is_slow:
        parameters = physical_parameters(signals, flights)
        if isinstance(parameters, Physical):
            parameters = changes.checked_parameters(parameters)
        learned = learned.with_physical(parameters)
    # The wind torque by these parameters assumes that no motor changed during the flight.
    has_changed = bool(changes.samples) or changes.has_weak_motor.any()
    if has_changed and learned.physical is not None and learned.wind_torque is not None:
        torque = estimate_wind_torque(learned.physical, learned.record, *changes)
        learned = learned.with_wind_torque(torque)
    return learned


def _with_other_axes(
    analysis: LogAnalysis,
    log: Log,
    signals: Signals,
    progress: ShowStep,
    estimates_of_other_axes: EstimatesOfAxes,
) -> LogAnalysis:
    """Adds the physical parameters of pitch and yaw to the analysis of roll.

    Args:
        analysis: what the log shows of roll: model, physical parameters and condition.
        log: the log of a flight, with the messages of each vehicle.
        signals: logged time series of the vehicle, and which of them are the inputs of the model.
        progress: shows the fraction of the axes that are done.
        estimates_of_other_axes: a function that returns estimates by axis which a second process has computed; axes
            that are missing in them are computed here.

    Returns:
        A copy of the analysis with all three axes.
    """
    estimates_by_axis = {**analysis.estimates_by_axis}
    with progress("Estimating the physical parameters") as show_share:
        # The second process may still be running: then this call waits for it.
        computed_estimates = estimates_of_other_axes()
        for axis in AXES[1:]:
            if axis in computed_estimates:
                estimates_by_axis[axis] = computed_estimates[axis]
            else:
                axis_signals = signals.for_axis(axis, signals.inputs)
                estimates_by_axis[axis] = estimates_of_axis(
                    axis_signals, log.components, analysis.alarms
                )
            show_share(len(estimates_by_axis) / len(AXES))
    return replace(analysis, axes=ReadOnlyDict(estimates_by_axis))
