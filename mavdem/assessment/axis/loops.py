"""Control loops of a log: the plant identified in flight with its controller, or the fact (a coded finding) why not."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import NamedTuple

from mavdem.assessment.axis.figures import AxisEstimates, estimates_of_axis
from mavdem.assessment.axis.gains import (
    autotune_fact,
    changed_gains_at_end,
    margin_ratings,
    sections_with_one_gain_set,
)
from mavdem.assessment.axis.training import flights_after_start
from mavdem.dataset.axes import AXES
from mavdem.dataset.flights import usable_segments
from mavdem.dataset.signals import (
    MIN_SLOW_MOTION_RATE,
    MIN_STREAM_RATE,
    Signals,
    rate_between_outages,
)
from mavdem.dem.record import Record
from mavdem.errors import NotLearnable
from mavdem.facts import Fact
from mavdem.facts.loops import ControllerFact, LoopFact
from mavdem.facts.model import NoPhysical
from mavdem.flight import Flights
from mavdem.ingest import Log
from mavdem.ingest.telemetry import Telemetry, firmware_version
from mavdem.loops.autopilot_parameters import MOTOR_COUNT
from mavdem.loops.axis_loops import Loop
from mavdem.loops.identification import identify_plant_in_loop
from mavdem.loops.loop_construction import loop_from_plant
from mavdem.loops.resonance import controller_or_reason
from mavdem.motors.motor_changes import MotorChange
from mavdem.plant import Physical, physical


class LogLoops(NamedTuple):
    """The control loops of a log, and what the autopilot changed of them in flight."""

    loops: dict[str, Loop | Fact]
    """The loops of roll, pitch and yaw by axis, or why they are not known."""
    autotune: list[Fact]
    """A fact for each axis that AutoTune tuned, with the gains before and after as figures.

    It has a rating of both sets of gains by their margins, or none if the loop is not known.
    """


def loops_of_axes(
    log: Log,
    signals: Signals,
    start: float = 0.0,
    estimates: Mapping[str, AxisEstimates] = MappingProxyType({}),
    known_loops: Mapping[str, Loop | Fact] = MappingProxyType({}),
) -> LogLoops:
    """Identifies the control loops of roll, pitch and yaw.

    Args:
        log: the log of a flight, with the messages of each vehicle.
        signals: logged time series of the vehicle, and which of them are the inputs of the model.
        start: duration at the beginning of the settled flight that is left out, s.
        estimates: physical parameters by axis, if they were estimated before.
        known_loops: loops by axis, or why they are not known, if they were identified before.

    Returns:
        By axis the identified loop, or the fact (coded finding) that says why it was not identified; and the facts
        about AutoTune.
    """
    loops = dict[str, Loop | Fact]()
    autotune_facts = []
    for axis in AXES:
        axis_signals = signals.for_axis(axis, signals.inputs)
        if axis in known_loops:
            loop = known_loops[axis]
        else:
            loop = identified_loop_or_reason(axis_signals, log, start, estimates.get(axis))
        loops[axis] = loop
        autotune = _fact_about_autotune(axis_signals, loop)
        if autotune is not None:
            autotune_facts.append(autotune)
    return LogLoops(loops, autotune_facts)


def _fact_about_autotune(signals: Signals, loop: Loop | Fact) -> Fact | None:
    """Returns the fact (coded finding) that AutoTune changed the gains of an axis; None if it did not.

    Args:
        signals: logged time series of the vehicle, with angle, rate and setpoints of the axis.
        loop: the identified loop of the axis, or why it is not known.
    """
    if not isinstance(loop, Loop):
        return autotune_fact(signals, loop)
    # The identification of the loop has computed this fact already, and added it to the cautions.
    for caution in loop.cautions:
        if caution.code is LoopFact.AUTOTUNED:
            return caution
    return None


class AxisResults(NamedTuple):
    """What is estimated of one axis without a learned model."""

    estimates: AxisEstimates
    """Physical parameters and wind torque, or why there are none."""
    loop: Loop | Fact
    """The control loops, or why they are not known."""


def results_of_axis(
    axis: str, log: Log, signals: Signals, alarms: Sequence[MotorChange], start: float
) -> AxisResults:
    """Estimates physical parameters, wind torque and control loops of one axis without learning a model.

    A second process calls this for pitch and yaw, while the first one learns the model of roll.

    Args:
        axis: "roll", "pitch" or "yaw".
        log: the log of a flight, with the messages of each vehicle.
        signals: logged time series of the vehicle, and which of them are the inputs of the model.
        alarms: changes of the motors in flight.
        start: duration at the beginning of the settled flight that is left out of the loops, s.

    Returns:
        The estimates, or why there are none, and the loops, or why they are not known.
    """
    axis_signals = signals.for_axis(axis, signals.inputs)
    estimates = estimates_of_axis(axis_signals, log.components, alarms)
    return AxisResults(estimates, identified_loop_or_reason(axis_signals, log, start, estimates))


def identified_loop_or_reason(
    signals: Signals, log: Log, start: float = 0.0, estimates: AxisEstimates | None = None
) -> Loop | Fact:
    """Identifies the control loops of the axis of ``signals``, as :func:`loop_of_axis` does, but without raising.

    Args:
        signals, log, start, estimates: as for :func:`loop_of_axis`.

    Returns:
        The loops, or why they are not known.
    """
    mixer_fault = _fault_of_mixer(signals)
    if mixer_fault is not None:
        return mixer_fault
    try:
        return loop_of_axis(signals, log, start, estimates)
    except NotLearnable as error:
        return _with_recording(error.fact, signals)


def controller_fault(signals: Signals, loop_or_reason: Loop | Fact) -> Fact | None:
    """Returns why the logged parameters do not describe the controller or mixer of an axis, if they do not.

    Without this description no gains can be computed, whatever is flown.

    Args:
        signals: logged time series of the vehicle for the axis, with its parameters.
        loop_or_reason: the loop of the axis, or the fact (coded finding) why it is not known.

    Returns:
        The fact, for example that the firmware is too old; None if the parameters describe both.
    """
    mixer_fault = _fault_of_mixer(signals)
    if mixer_fault is not None:
        return mixer_fault
    if isinstance(loop_or_reason, Fact) and isinstance(loop_or_reason.code, ControllerFact):
        return loop_or_reason
    controller = controller_or_reason(signals)
    return _with_recording(controller, signals) if isinstance(controller, Fact) else None


def _fault_of_mixer(signals: Signals) -> Fact | None:
    """Returns the fact that the mixer of a vehicle with, for example, six motors is not known; None for a quadrotor.

    The mixer turns the controller's demand into motor outputs. It is not needed if the demand itself is the input of
    the model.

    Args:
        signals: logged time series of the vehicle for the axis.
    """
    if signals.motors is None or signals.model_inputs is signals.demand:
        return None
    motor_count = len(signals.motors.geometry.motors)
    if motor_count == MOTOR_COUNT:
        return None
    demand = signals.demand
    # A slower demand shows no loop either.
    has_demand = demand is not None and rate_between_outages(demand) >= MIN_STREAM_RATE
    return Fact(
        ControllerFact.MIXER_UNKNOWN, autopilot=None, motors=motor_count, has_demand=has_demand
    )


REASONS_WITH_RATES = (
    LoopFact.LOOP_TOO_SHORT,
    LoopFact.NOT_STEERED,
    LoopFact.MARGIN_UNCERTAIN,
)
"""Reasons for no loop that advise another flight, recorded faster if this one was recorded slowly."""

REASONS_OF_FIRMWARE = (ControllerFact.MIXER_IN_FILE, ControllerFact.PARAMETERS_MISSING)
"""Reasons for no loop that another file of parameters mends only if the firmware has the missing ones."""

FIRST_PX4_WITH_MIXER_PARAMETERS = (1, 14)
"""First version of PX4, major and minor, that always has the mixer in parameters (``CA_ROTORn_*``)."""

OLDER_THRUST_CURVE = "MOT_TCRV_ENABLE"
"""Parameter of the thrust curve that ``MOT_THST_EXPO`` replaced in ArduCopter 3.3, with the filters of the gains: a
firmware that has it has none of these, which the model of the controller needs."""


def _with_recording(reason: Fact, signals: Signals) -> Fact:
    """Adds to the reason why a loop is unknown how the flight was recorded, so that advice can name what to log.

    Args:
        reason: a fact (coded finding with figures). The reason ``NO_LOOP`` consists of others, its ``reasons``.
        signals: logged time series of the vehicle for the axis.

    Returns:
        The reason, with the ``recorder`` (such as "DataFlash"; empty for telemetry) and the ``autopilot`` (such as
        "PX4") if the rate setpoint is missing, with the rates of messages (:func:`_with_rates`) if another flight is
        advised, or with the firmware (:func:`_with_firmware`) if parameters are missing.
    """
    if reason.code is LoopFact.NO_LOOP:
        reasons = [_with_recording(each, signals) for each in reason.figures["reasons"]]
        return reason.replace(reasons=tuple(reasons))
    if reason.code is LoopFact.NO_RATE_SETPOINT:
        return reason.replace(
            recorder=signals.telemetry.translated_from,
            autopilot=signals.telemetry.autopilot,
        )
    if reason.code in REASONS_WITH_RATES:
        return _with_rates(reason, signals)
    if reason.code in REASONS_OF_FIRMWARE:
        return _with_firmware(reason, signals.telemetry)
    return reason


def _with_firmware(reason: Fact, telemetry: Telemetry) -> Fact:
    """Adds to a reason why parameters are missing whether the firmware is too old to have them.

    Args:
        reason: the fact (coded finding) that the log lacks parameters of the mixer or of the rate controller.
        telemetry: autopilot, firmware and parameters of the vehicle.

    Returns:
        The reason with the figures ``firmware``, its name, and ``is_too_old``; unchanged if the log does not show
        whether the firmware has the parameters.
    """
    if reason.code is ControllerFact.MIXER_IN_FILE:
        version = firmware_version(telemetry)
        if version is None:
            return reason
        is_too_old = version < FIRST_PX4_WITH_MIXER_PARAMETERS
    elif OLDER_THRUST_CURVE in telemetry.parameters:
        is_too_old = True
    else:
        return reason
    return reason.replace(firmware=telemetry.firmware, is_too_old=is_too_old)


def _with_rates(reason: Fact, signals: Signals) -> Fact:
    """Adds the messages with the attitude and the motor outputs to a reason: their ``names`` and ``rates``, Hz.

    A margin that is uncertain although commands explain the motion may also lack a fast setpoint, by which the commands
    are known between two messages. Then the setpoint of the rate is added.

    Args:
        reason: a fact (coded finding with figures); unchanged if neither message was recorded.
        signals: logged time series of the vehicle for the axis.
    """
    streams = [each for each in (signals.attitude, signals.model_inputs) if each is not None]
    if not streams:
        return reason
    names = [signals.telemetry.name_in_source(stream.message) for stream in streams]
    rates = [rate_between_outages(stream) for stream in streams]
    is_steered = reason.code is LoopFact.MARGIN_UNCERTAIN and reason.figures["is_steered"]
    if is_steered and signals.rate_and_setpoint is not None:
        names.append("the rate setpoint")
        rates.append(rate_between_outages(signals.rate_and_setpoint.setpoint))
    return reason.replace(names=tuple(names), rates=tuple(rates))


def loop_of_axis(
    signals: Signals, log: Log, start: float = 0.0, estimates: AxisEstimates | None = None
) -> Loop:
    """Identifies the control loops of the axis of ``signals``, with cautions on changes of the gains.

    Args:
        signals: logged time series of the vehicle, with angle, rate and setpoints of the axis.
        log: the log of a flight, with the messages of each vehicle.
        start: duration at the beginning of the settled flight that is left out, s.
        estimates: physical parameters of the axis, if they were estimated before.

    Returns:
        The loops. They are identified from the sections of flight with the gains that were flown longest. A caution
        (a fact that limits what the loops may be used for) says which other gains were flown, whether AutoTune changed
        gains, and whether the log ends with other gains.

    Raises:
        NotLearnable: the loops cannot be identified; the error says why.
    """
    segments, learnability = usable_segments(signals, log.components)
    if not segments:
        # Streams that only show the slow motion may still identify the loops, with wider intervals.
        segments, learnability = usable_segments(signals, log.components, MIN_SLOW_MOTION_RATE)
    if not segments:
        raise NotLearnable(learnability.reason)
    all_flights = flights_after_start(segments, start)
    flights, other_gains_caution = sections_with_one_gain_set(signals, all_flights)
    # The earlier estimates are of all flights, which are the selected sections only if no gains changed.
    gray_box_fit = None
    if estimates is not None and other_gains_caution is None:
        gray_box_fit = estimates.physical
    loop = loop_from_plant(
        _identified_plant(signals, flights, gray_box_fit), Record.from_flights(flights)
    )
    if other_gains_caution is not None:
        # Sections with other gains are rated by the margins that the identified plant would have with those gains.
        other_gain_sets = (dict(changes) for _, changes in other_gains_caution.figures["parts"])
        ratings = margin_ratings(loop, other_gain_sets)
        other_gains_caution = other_gains_caution.replace(ratings=ratings)
    cautions_on_gains = (
        other_gains_caution,
        autotune_fact(signals, loop),
        changed_gains_at_end(signals, loop.controller),
    )
    known_cautions = [fact for fact in cautions_on_gains if fact is not None]
    return replace(loop, cautions=(*known_cautions, *loop.cautions))


MARGIN_REFUSALS = (LoopFact.MARGIN_UNCERTAIN,)
"""Refusals of a plant that was identified in its closed loop, but too poorly for margins.

Inputs and outputs alone show the plant worse, so that the fit by these does not replace it.
"""


def _identified_plant(
    signals: Signals, flights: Flights, gray_box_fit: Physical | None
) -> Physical:
    """Identifies the plant of an axis: how the commands of the motors accelerate its body rate, rad/s².

    Two methods are tried in this order:

    1. Identification in the closed loop, which needs the logged setpoints and the gains of the controller. If its
       result is too inaccurate for stability margins, the second method is not tried: it is even less accurate.
    2. The open-loop gray-box fit, which needs only the inputs and outputs of the plant.

    Args:
        signals: logged time series of the vehicle, with angle, rate and setpoints of the axis.
        flights: flights to identify the plant from.
        gray_box_fit: result of the gray-box fit; None if it must still be computed.

    Returns:
        Control effectiveness, rate damping, motor lag and delay, with their uncertainty. If they are from the gray-box
        fit, their ``refusal`` says why the closed loop could not be used.

    Raises:
        NotLearnable: neither method identifies the plant, with the reasons.
    """
    try:
        return identify_plant_in_loop(signals, flights)
    except NotLearnable as error:
        closed_loop_reason = error.fact
        is_too_inaccurate_for_margins = closed_loop_reason.code in MARGIN_REFUSALS
        if is_too_inaccurate_for_margins:
            raise
    fit = gray_box_fit or physical(flights)
    if isinstance(fit, Physical) and fit.identifiable:
        return fit._replace(refusal=closed_loop_reason)
    # A fit that is not identifiable has the reason as its caution. Without any fit there is only the reason.
    gray_box_reason = fit.caution if isinstance(fit, Physical) else fit.reason
    raise NotLearnable(_reason_for_no_plant(closed_loop_reason, gray_box_reason))


def _reason_for_no_plant(closed_loop_reason: Fact, gray_box_reason: Fact | None) -> Fact:
    """Returns why the plant of an axis (the vehicle without its controller) could not be identified by either method.

    The first method, identification in the closed loop, is the better one, and its reason is usually enough. But if it
    only lacks the setpoint of the rate, the log lacks that for all axes, and yet the second method may have succeeded
    on others. So it is said as well why that failed here.

    Args:
        closed_loop_reason: why the identification in the closed loop failed.
        gray_box_reason: why the second method, a physical model fitted to inputs and outputs, failed; None if that is
            not known.
    """
    is_setpoint_missing = closed_loop_reason.code is LoopFact.NO_RATE_SETPOINT
    if not is_setpoint_missing or gray_box_reason is None:
        return closed_loop_reason
    if gray_box_reason.code is NoPhysical.EFFECT_NOT_IDENTIFIABLE:
        # It has up to four reasons of its own, none of which matters once the setpoint is logged.
        return closed_loop_reason.replace(is_effect_unknown=True)
    return Fact(LoopFact.NO_LOOP, reasons=(closed_loop_reason, gray_box_reason))


def loop_of_parameters_or_reason(estimates: AxisEstimates, record: Record | None) -> Loop | Fact:
    """Returns the control loops of an axis that follow from its physical parameters, or why they are not known.

    Live sessions use it. They do not identify the closed loop, since that needs a whole log.

    Args:
        estimates: estimates of the axis, with its physical parameters or the reason why there are none.
        record: the data from which these parameters were learned; None if there are no parameters.

    Returns:
        The loops of rate and attitude; or the fact (coded finding) that says why they are not known.
    """
    plant = estimates.physical
    if plant is None or record is None:
        assert estimates.reason is not None
        return estimates.reason
    try:
        return loop_from_plant(plant, record)
    except NotLearnable as error:
        return error.fact
