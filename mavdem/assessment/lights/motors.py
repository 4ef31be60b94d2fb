"""Status light of the motors, judged by facts (coded findings): lost thrust, outputs at a limit, trim and headroom."""

from math import inf

import numpy as np

from mavdem.assessment.axis.overrides import limited_motors
from mavdem.assessment.evidence import Evidence
from mavdem.assessment.failure_by_commands import SPENT_THRUST_SHARE
from mavdem.assessment.flights import total_duration
from mavdem.assessment.limits import worst_fact
from mavdem.assessment.motor_speeds import REPORTS_OF_MOTOR
from mavdem.dataset.motor_outputs import MotorOutputs, motor_outputs_or_reason
from mavdem.dataset.quality import LIMIT_MARGIN, samples_at_limits
from mavdem.dataset.segments import Segments, in_segments, settled_segments
from mavdem.errors import NotLearnable
from mavdem.facts import Code, Fact, Level
from mavdem.facts.ending import FailedFirst, MotionEvent
from mavdem.facts.learnability import UnusableOutputs
from mavdem.facts.motors import MotorsLight, MotorWatchFact, TrimFact
from mavdem.ingest.motors import name_without_place
from mavdem.loops.limit_cycles import MIN_AT_LIMIT_SHARE, Oscillation
from mavdem.motors.balance import MIN_STEADY_SECONDS
from mavdem.motors.change_hypotheses import FAULT_RISE
from mavdem.motors.hover import HoverFigures, hover_figures
from mavdem.motors.motor_changes import MIN_LOSS_SECONDS
from mavdem.motors.saturation import most_limited_motors
from mavdem.motors.trim_pattern import trim_of_signals

MAX_HOVER_COMMAND = 0.8
"""Mean command, as a fraction of the range, up to which a hover does not need full throttle; a choice."""

MIN_HEADROOM = 0.1
"""Fraction of the motors' range to be left for gusts at the 99th percentile of the output; less is to be watched."""

MIN_HEADROOM_RATIO = 2.0
"""Ratio of every other motor's headroom to that of one motor from which this motor stands out: a choice."""

MIN_MOST_FRACTION = 0.5
"""Fraction of the flight at the limit above which a motor is there for most of the flight, whatever the vehicle did."""

UNKNOWN_TRIMS = (TrimFact.TRIM_UNKNOWN, TrimFact.TRIM_UNSURE, TrimFact.TRIM_OF_UNKNOWN_PLACES)
"""Facts that say why it is not known how evenly the motors work."""

MIN_TOGETHER_FRACTION = 0.5
"""Fraction of the samples with a motor at its limit above which the motors count as limited together: most of them."""


def motors_light(evidence: Evidence) -> Fact:
    """Judges the motors by the worst fact about them in a log.

    Of equally bad facts the first one is returned, in this order:

    1. Events that name a motor.
    2. A limit cycle (an oscillation of the control loops) that drives motors to their limits.
    3. An uneven trim or a small headroom or, if no hover was measured, that the motors were not seen in a hover.
    4. A motor at its limit in the hover or, if the hover was too short, for most of the flight.

    Args:
        evidence: signals, events and measurements of the vehicle.

    Returns:
        A fact whose level is the colour of the light: good, watch, bad or unknown.
    """
    if evidence.other_vehicle is not None:
        return evidence.other_vehicle
    hover = evidence.condition.hover
    facts = _events_of_motors(evidence)
    swinging_motors = motors_at_limits_in_oscillation(evidence.condition.oscillation)
    if swinging_motors is not None:
        facts.append(swinging_motors)
    if hover is None:
        facts.append(_missing_hover(evidence))
    else:
        facts.append(_trim_or_headroom(evidence, hover))
    motors_at_limit = _limited_motors_of_flight(evidence, hover)
    if motors_at_limit is not None:
        facts.append(_with_yaw_trim(evidence, motors_at_limit))
    return worst_fact(facts)


def motors_at_limits_in_oscillation(oscillation: Oscillation | None) -> Fact | None:
    """Returns the fact that an oscillation of the vehicle drives motors to their limits, in a log or in flight.

    Such motors cannot be compared with each other, and leave the controller little thrust to steer with.

    Args:
        oscillation: the limit cycle, an oscillation that the vehicle's own controller sustains; None without one.

    Returns:
        The fact, with the fraction of the time with a motor at a limit as ``share``; None if that is below
        ``MIN_AT_LIMIT_SHARE``.
    """
    if oscillation is None:
        return None
    limited_share = max(cycle.at_limit for cycle in (oscillation, *oscillation.other_axes))
    if limited_share < MIN_AT_LIMIT_SHARE:
        return None
    return Fact(MotorsLight.MOTORS_SWING, share=limited_share)


def _missing_hover(evidence: Evidence) -> Fact:
    """Returns the fact that the motors were not seen in a hover.

    Args:
        evidence: signals, events and measurements of the vehicle.

    Returns:
        A fact with the names of the motors. If their outputs were not recorded, it has no names. If outputs were
        recorded that do not belong to motors, it has the reason for that.
    """
    names = _motor_names(evidence)
    return Fact(
        MotorsLight.MOTORS_NOT_SEEN,
        names=names,
        least_duration=MIN_STEADY_SECONDS,
        reason=None if names else _reason_outputs_are_unusable(evidence),
    )


def _limited_motors_of_flight(evidence: Evidence, hover: HoverFigures | None) -> Fact | None:
    """Returns the fact which motors were at their upper limit for long, so that no thrust was left to steer with.

    A hover shows best how hard the motors work. But a motor that is always at its limit may keep the vehicle from
    settling, so that the hover is shorter than ``MIN_STEADY_SECONDS`` or missing. Then the whole flight is judged. A
    manoeuvre may drive motors to their limit, too; so they must have been there in most of that time, more than
    ``MIN_MOST_FRACTION``, and not because of a hard climb.

    Args:
        evidence: signals, events and measurements of the vehicle.
        hover: outputs of its motors in the hover; None if none was measured.

    Returns:
        The fact, whose figure ``is_settled`` says whether it is about the hover; None if no motor was at its limit for
        long, or if something else explains the full throttle.
    """
    motors = evidence.signals.motors
    if motors is None or _has_explained_full_throttle(evidence):
        return None
    has_long_hover = hover is not None and hover.seconds >= MIN_STEADY_SECONDS
    if has_long_hover:
        segments = settled_segments(evidence.signals)
        motor_statistics = hover
    else:
        segments = evidence.flight_segments(motors.boot)
        motor_statistics = motor_figures_of_all_flight(evidence)
    if motor_statistics is None:
        return None
    motors_at_limit = limited_motors(motor_statistics)
    if motors_at_limit is None:
        return None
    is_long_enough = has_long_hover or motors_at_limit.share > MIN_MOST_FRACTION
    if not is_long_enough or _are_limited_by_hard_climb(motors, segments, motor_statistics):
        return None
    return motors_at_limit.fact(MotorsLight.MOTOR_LIMITED).replace(is_settled=has_long_hover)


def _with_yaw_trim(evidence: Evidence, limited_motors_fact: Fact) -> Fact:
    """Adds the yaw trim to the fact that motors were at their limit, if that trim explains it.

    The yaw trim is how much harder the motors of one spin direction work than those of the other, to hold the heading.
    A twisted arm or motor causes it, and the motors that work harder reach their limit first. So it explains the fact
    if all motors at their limit are among these.

    Args:
        evidence: signals, events and measurements of the vehicle.
        limited_motors_fact: the fact (a coded finding), with the ``names`` of the motors.

    Returns:
        The fact with two further figures: ``yaw_trim``, a fraction that is positive if counterclockwise motors work
        harder, and ``assumed``, whether the motors' numbers are an assumption. Unchanged if the trim does not explain
        it.
    """
    trim = trim_of_signals(evidence.signals)
    if trim is None or trim.code is not TrimFact.TRIM_OF_YAW:
        return limited_motors_fact
    assert evidence.signals.motors is not None
    geometry = evidence.signals.motors.geometry
    spin_by_name = dict(zip(geometry.names, geometry.spins, strict=True))
    yaw_trim = trim.figures["share"]
    for name in limited_motors_fact.figures["names"]:
        # Spins are 1 counterclockwise and −1 clockwise, so that the product is positive for motors that work harder.
        works_harder = spin_by_name[name] * yaw_trim > 0
        if not works_harder:
            return limited_motors_fact
    return limited_motors_fact.replace(yaw_trim=yaw_trim, assumed=trim.figures["assumed"])


def motor_figures_of_all_flight(evidence: Evidence) -> HoverFigures | None:
    """Computes the mean command, the headroom and the time at the limits of each motor over all flight.

    These figures are usually of hover alone. This function is for a flight with too little of it, and manoeuvres are in
    its figures.

    Args:
        evidence: signals, events and measurements of the vehicle.

    Returns:
        The figures, fractions of the range of the outputs. None without motor outputs, if all flight lasted less than
        ``MIN_STEADY_SECONDS``, if no output was recorded in it, or if the motors were off throughout.
    """
    motors = evidence.signals.motors
    if motors is None:
        return None
    segments = evidence.flight_segments(motors.boot)
    duration = total_duration(segments)
    outputs_in_flight = motors.outputs[in_segments(motors, *segments)]
    if duration < MIN_STEADY_SECONDS or not len(outputs_in_flight):
        return None
    try:
        return hover_figures(
            motors.geometry.names,
            motors.scale,
            duration,
            outputs_in_flight,
            # The mean lean of the vehicle is a part of these figures that is not used here.
            lean={},
        )
    except NotLearnable:
        # The motors were off throughout.
        return None


def _has_explained_full_throttle(evidence: Evidence) -> bool:
    """Returns whether the flight had full throttle for a known reason, so that limits are no sign of weak motors.

    The reasons are a diverged height estimate, which the height controller may follow at full throttle, and the
    recovery from a dive or a flip.

    Args:
        evidence: signals, events and measurements of the vehicle.
    """
    for event in evidence.events:
        if event.code in (MotionEvent.DIVED, MotionEvent.FLIPPED):
            return True
        if event.code is MotionEvent.HEIGHT_DIVERGED and event.is_bad:
            return True
    return False


def _are_limited_by_hard_climb(
    motors: MotorOutputs, segments: Segments, motor_statistics: HoverFigures
) -> bool:
    """Returns whether motors were at their limits only because the vehicle climbed hard, so that none of them is weak.

    In a hard climb all motors together are near their limits, though the vehicle hovers well below full throttle. If
    its mean command is near full throttle too, it always lacks thrust, and the result is False.

    Args:
        motors: outputs of the motors.
        segments: the segments of flight that are judged.
        motor_statistics: mean output of each motor in these segments, as a fraction of the range.
    """
    mean_command = np.mean(motor_statistics.trim_of_range)
    if mean_command > MAX_HOVER_COMMAND:
        return False
    commands = motors.scale.fraction(motors.outputs[in_segments(motors, *segments)])
    is_at_upper_limit, _ = samples_at_limits(commands, motors.scale)
    is_any_at_limit = is_at_upper_limit.any(axis=1)
    if not is_any_at_limit.any():
        return False
    # In these samples some motor is at its limit. If the mean of all motors is near the limit too, all are.
    commands_of_all = commands[is_any_at_limit].mean(axis=1)
    are_all_near_limit = commands_of_all >= SPENT_THRUST_SHARE * motors.scale.upper_limit
    return bool(are_all_near_limit.mean() > MIN_TOGETHER_FRACTION)


def _motor_names(evidence: Evidence) -> tuple[str, ...]:
    """Returns the names of the motors; none if their outputs were not recorded."""
    motors = evidence.signals.motors
    return () if motors is None else tuple(motors.geometry.names)


def _reason_outputs_are_unusable(evidence: Evidence) -> Fact | None:
    """Returns the reason why recorded outputs do not belong to motors, such as that none of them ever changes.

    Args:
        evidence: signals, events and measurements of the vehicle.

    Returns:
        The reason; None if the outputs belong to motors, or none were recorded.
    """
    outputs_or_reason = motor_outputs_or_reason(evidence.signals.telemetry)
    if not isinstance(outputs_or_reason, Fact):
        return None
    reason = outputs_or_reason
    return None if reason.code is UnusableOutputs.NO_MOTOR_MESSAGE else reason


def _events_of_motors(evidence: Evidence) -> list[Fact]:
    """Returns the events that show a fault of one motor of this vehicle, the most important first.

    1. How the flight was lost, such as by a crash, if a motor failed first, or all thrust was used up.
    2. Warnings in flight without a figure of the lost thrust, such as a motor that was off.
    3. Losses of thrust, the largest first, equal ones by their duration.
    4. Lasting shifts of the trims in flight, which name no motor: the weak one may hide behind a shifted load.
    5. Reports of the autopilot about a motor.
    6. The motor that was longest at its limit, if it alone was there for ``MIN_LOSS_SECONDS`` at a time, such as in a
       descent. In a hover the fraction of the time is judged. If no hover was measured, motors count that were there
       for most of the flight, too, however short that was (:func:`_is_limited_for_most_of_flight`).

    Args:
        evidence: signals, events and measurements of the vehicle.

    Returns:
        Facts whose subject is a motor, or, where all thrust was used up or the trims shifted, all motors.
    """
    names = _motor_names(evidence)
    facts = []
    ending = evidence.ending
    if ending is not None and (ending.subject in names or _is_thrust_spent(ending)):
        facts.append(ending)
    codes_of_faults: list[Code] = [
        MotorWatchFact.MOTOR_LOST_THRUST,
        MotorWatchFact.MOTOR_SATURATED,
        MotionEvent.MOTOR_OFF,
        MotionEvent.MOTOR_STOOD_STILL,
        MotionEvent.OUTPUT_FROZE,
    ]
    warnings = [
        fact for fact in evidence.warnings_in_flight(codes_of_faults) if fact.subject in names
    ]
    # The figure "rise" is the increase of the motor's command that compensates its loss, as a fraction of the range. An
    # event without it, such as a motor that was off, counts as infinitely large.
    warnings.sort(key=lambda fact: (-fact.figures.get("rise", inf), -_event_duration(fact)))
    facts += warnings
    facts += evidence.warnings_in_flight([MotorWatchFact.STEADY_TORQUE_CHANGED])
    facts += _autopilot_reports(evidence, names)
    for motors_at_limit in _motors_longest_at_limit(evidence, names):
        # The subject of a fact about several motors is none of the names.
        is_single_motor = motors_at_limit.subject in names
        is_long = is_single_motor and motors_at_limit.figures["duration"] >= MIN_LOSS_SECONDS
        if is_long or _is_limited_for_most_of_flight(evidence):
            facts.append(motors_at_limit)
    return facts


def _autopilot_reports(evidence: Evidence, names: tuple[str, ...]) -> list[Fact]:
    """Returns the reports of the autopilot in flight on one of this vehicle's motors.

    Args:
        evidence: signals, events and measurements of the vehicle.
        names: names of its motors, with their places, such as "motor 1 (front right)".

    Returns:
        Facts whose subject is the motor without its place, such as "motor 1": the autopilot knows only its number.
    """
    names_without_places = {name_without_place(name) for name in names}
    return [
        fact
        for fact in evidence.warnings_in_flight(REPORTS_OF_MOTOR)
        if name_without_place(fact.subject) in names_without_places
    ]


def _is_limited_for_most_of_flight(evidence: Evidence) -> bool:
    """Returns whether some motor was at its upper limit for most of a flight that has no hover.

    A correction of the attitude, or full throttle in a hop, drives a motor to its limit for a moment. Only a motor that
    is there for more than half of the flight shows that the flight itself needs that thrust.

    Args:
        evidence: signals, events and measurements of the vehicle.
    """
    motors = evidence.signals.motors
    if evidence.condition.hover is not None or motors is None:
        return False
    seconds_at_limit = dict.fromkeys(motors.geometry.names, 0.0)
    for event in evidence.warnings_in_flight([MotionEvent.MOTOR_AT_ITS_STOP]):
        seconds_at_limit[event.subject] += event.figures["duration"]
    flight_seconds = total_duration(evidence.flight_segments(motors.boot))
    return max(seconds_at_limit.values()) > MIN_MOST_FRACTION * flight_seconds


def _is_thrust_spent(ending: Fact) -> bool:
    """Returns whether a flight was lost because its motors had no thrust left."""
    cause = ending.figures.get("cause")
    return cause is not None and cause.code is FailedFirst.THRUST_SPENT_FIRST


def _motors_longest_at_limit(evidence: Evidence, names: tuple[str, ...]) -> list[Fact]:
    """Returns the fact about the motor that was longest at its upper limit in flight, or about several such motors.

    The durations of all events of a motor are added. All motors with at least half of the longest time are named
    together (:func:`mavdem.motors.saturation.most_limited_motors`), since then no single motor is weak.

    Args:
        evidence: signals, events and measurements of the vehicle.
        names: names of its motors.

    Returns:
        A list with one fact: for one motor its longest event, for several a fact with their names and the time of their
        first event. Empty if no motor was at its limit.
    """
    events = list(evidence.warnings_in_flight([MotionEvent.MOTOR_AT_ITS_STOP]))
    seconds_at_limit = dict.fromkeys(names, 0.0)
    for event in events:
        seconds_at_limit[event.subject] += event.figures["duration"]
    longest_limited = most_limited_motors(names, list(seconds_at_limit.values()))
    if not longest_limited:
        return []
    their_events = [event for event in events if event.subject in longest_limited]
    if len(longest_limited) > 1:
        first_time = their_events[0].time
        return [Fact(MotorsLight.MOTORS_AT_LIMIT, names=longest_limited, time=first_time)]
    longest_event = max(their_events, key=lambda event: event.figures["duration"])
    return [longest_event]


def _event_duration(event: Fact) -> float:
    """Returns the duration of an event, s: infinite if it lasted to the end of the record, 0 if it has no time."""
    if event.time is None:
        return 0.0
    return event.latest_time - event.time


def _lacks_headroom_in_one_motor(hover: HoverFigures) -> bool:
    """Returns whether a single motor has much less headroom than all others in the hover.

    Then it or its propeller may be weak; too much load would take the headroom of all motors. Gusts and manoeuvres make
    the motors of a sound vehicle differ too. So every other motor must have at least ``MIN_HEADROOM``, and at least
    ``MIN_HEADROOM_RATIO`` times the headroom of this one, and no other motor may have been at its limit for longer.

    Args:
        hover: outputs of the motors in the hover, with the headroom of each, the fraction of its range above the 99th
            percentile of its output, and the fraction of the time that each was at its limit.
    """
    if len(hover.headroom) == 1:
        return False
    ascending_headrooms = sorted(hover.headroom)
    smallest, second_smallest = ascending_headrooms[0], ascending_headrooms[1]
    motor = hover.headroom.index(smallest)
    is_longest_at_limit = hover.at_upper_limit[motor] >= max(hover.at_upper_limit)
    has_much_less = second_smallest >= max(MIN_HEADROOM, MIN_HEADROOM_RATIO * smallest)
    return has_much_less and is_longest_at_limit


def _trim_or_headroom(evidence: Evidence, hover: HoverFigures) -> Fact:
    """Returns the pattern of the trim, or that the headroom is small.

    The trim is the mean output of each motor in the hover; an uneven one shows a weak motor, a shifted load or a
    crooked arm. The headroom is the fraction of a motor's range above the 99th percentile of its output. A trim that is
    to be watched is returned rather than a small headroom, since it may be the reason for that.

    Args:
        evidence: signals, events and measurements of the vehicle.
        hover: outputs of its motors in the hover.

    Returns:
        One of four facts: that the headroom is little, with the motors of least headroom; the trim to watch, with the
        smallest ``headroom`` of a motor as a fraction of its range if that is small; that the motors work evenly, with
        the headroom, None if full throttle used it up; or any other fact of the trim, unchanged.
    """
    trim = trim_of_signals(evidence.signals) or Fact(TrimFact.TRIM_UNKNOWN)
    smallest_headroom = min(hover.headroom)
    # Full throttle for another reason uses up the headroom, which then does not show how hard the motors work.
    is_headroom_known = not _has_explained_full_throttle(evidence)
    is_headroom_small = is_headroom_known and smallest_headroom < MIN_HEADROOM
    if is_headroom_small and trim.level is Level.WATCH:
        # The trim may be the reason for the small headroom, but the pilot must know of both.
        return trim.replace(headroom=smallest_headroom)
    if is_headroom_small:
        return _little_headroom(hover, is_trim_unknown=trim.code in UNKNOWN_TRIMS)
    if trim.is_good:
        return Fact(
            MotorsLight.MOTORS_EVEN,
            headroom=smallest_headroom if is_headroom_known else None,
            **trim.figures,
        )
    return trim


def _little_headroom(hover: HoverFigures, *, is_trim_unknown: bool) -> Fact:
    """Returns the fact that motors have little headroom in the hover, with what it shows of a weak motor.

    Args:
        hover: outputs of the motors in the hover.
        is_trim_unknown: whether it is not known how evenly the motors work, for example because of lean.

    Returns:
        A fact with these figures:

        - ``names``: the motors whose headroom is the smallest, within ``LIMIT_MARGIN``.
        - ``share``: their headroom, as a fraction of the range.
        - ``trim``: the largest mean output of a motor, as a fraction of the range.
        - ``is_by_commands``: present and True if the mean of the hover leaves enough of the range to all motors
          (:data:`MAX_HOVER_COMMAND`), so that fast commands, as when the vehicle is steered, take the rest.
        - ``excess``: by what fraction a single named motor works harder than the mean of all motors, if the trim is
          unknown and the fraction is above ``FAULT_RISE``; otherwise None. Then the motor may be weak.
        - ``is_only_motor``: present and True if all other motors have much more headroom.
    """
    smallest_headroom = min(hover.headroom)
    names = []
    for name, headroom in zip(hover.motors, hover.headroom, strict=True):
        if headroom - smallest_headroom < LIMIT_MARGIN:
            names.append(name)
    excess = None
    if is_trim_unknown and len(names) == 1:
        motor_index = hover.motors.index(names[0])
        # The imbalance is in per cent of the mean of all motors.
        fraction_above_mean = hover.imbalance[motor_index] / 100
        if fraction_above_mean > FAULT_RISE:
            excess = fraction_above_mean
    fact = Fact(
        MotorsLight.HEADROOM_LITTLE,
        names=names,
        share=smallest_headroom,
        trim=max(hover.trim_of_range),
        excess=excess,
    )
    if _lacks_headroom_in_one_motor(hover):
        return fact.replace(is_only_motor=True)
    is_by_commands = excess is None and max(hover.trim_of_range) <= MAX_HOVER_COMMAND
    return fact.replace(is_by_commands=True) if is_by_commands else fact


def is_range_taken_by_commands(motors: Fact) -> bool:
    """Returns whether motors have little headroom because of fast commands, and not because of the hover itself.

    Args:
        motors: the fact of the status light of the motors.
    """
    return motors.code is MotorsLight.HEADROOM_LITTLE and "is_by_commands" in motors.figures
