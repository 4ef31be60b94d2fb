"""Light on the motors: thrust that one lost in flight, limits, the pattern of the trim, and the headroom."""

from math import inf

from mavdem.assessment.axis.overrides import limited_motor
from mavdem.assessment.evidence import Evidence
from mavdem.assessment.limits import worst_fact
from mavdem.facts import Code, Fact, Level
from mavdem.facts.ending import MotionEvent
from mavdem.facts.events import Reported
from mavdem.facts.motors import InFlight, MotorsLight, Trim
from mavdem.loops.limit_cycles import MIN_AT_LIMIT_SHARE
from mavdem.motors.balance import MIN_STEADY_SECONDS
from mavdem.motors.hover import HoverFigures
from mavdem.motors.trim_pattern import trim_of_signals

MIN_HEADROOM = 0.1
"""Share of the motors' range to be left for gusts at the 99th percentile of the output; less is to be watched."""


def motors_light(evidence: Evidence) -> Fact:
    """Returns the worst of what a log shows of its motors.

    That is an event that names a motor, a limit cycle that drives them to their limits, a motor that is at its limit in
    the hover, the pattern of the trim, or a small headroom.

    Args:
        evidence: what the log shows of the vehicle.

    Returns:
        A fact whose level is the colour of the light: good, watch, bad or unknown.
    """
    hover = evidence.condition.hover
    facts = _events_of_motors(evidence)
    oscillation = evidence.condition.oscillation
    if oscillation is not None and oscillation.at_limit > MIN_AT_LIMIT_SHARE:
        facts.append(Fact(MotorsLight.MOTORS_SWING, share=oscillation.at_limit))
    if hover is None:
        names = _motor_names(evidence)
        not_measured = MotorsLight.MOTORS_NOT_SEEN
        facts.append(Fact(not_measured, names=names, least_duration=MIN_STEADY_SECONDS))
    else:
        limited = limited_motor(hover)
        if limited is not None and hover.seconds >= MIN_STEADY_SECONDS:
            facts.append(Fact(MotorsLight.MOTOR_LIMITED, subject=limited.name, share=limited.share))
        facts.append(_trim_or_headroom(evidence, hover))
    return worst_fact(facts)


def _motor_names(evidence: Evidence) -> tuple[str, ...]:
    """Returns the names of the motors; none if their outputs were not recorded."""
    motors = evidence.signals.motors
    return () if motors is None else tuple(motors.geometry.names)


def _events_of_motors(evidence: Evidence) -> list[Fact]:
    """Returns the ending and the warnings in flight that name a motor.

    Of several losses the largest comes first, of several limits the longest. Without a hover, which would show the
    share of the time, a moment at the limit counts too.
    """
    codes: list[Code] = [
        InFlight.MOTOR_LOST_THRUST,
        MotionEvent.MOTOR_OFF,
        Reported.MOTOR_FAILED,
        Reported.THRUST_LOST,
    ]
    if evidence.condition.hover is None:
        codes.append(MotionEvent.MOTOR_AT_ITS_STOP)
    names = _motor_names(evidence)
    facts = [
        fact
        for fact in (evidence.ending, *evidence.warnings_in_flight(codes))
        if fact is not None and fact.subject in names
    ]
    facts.sort(key=lambda fact: (-fact.figures.get("rise", inf), -_duration(fact)))
    return facts


def _duration(event: Fact) -> float:
    """Returns how long an event lasted, s; 0 for one without an end."""
    if event.until is None or event.time is None:
        return 0.0
    return event.until - event.time


def _trim_or_headroom(evidence: Evidence, hover: HoverFigures) -> Fact:
    """Returns the pattern of the trim, or that the headroom is small.

    A trim that is to be watched goes before the headroom. For an even trim the headroom is added as a figure, as a
    share of the motors' range.
    """
    trim = trim_of_signals(evidence.signals) or Fact(Trim.TRIM_UNKNOWN)
    headroom = min(hover.headroom)
    if headroom < MIN_HEADROOM and trim.level is not Level.WATCH:
        highest_trim = max(hover.trim_of_range)
        return Fact(MotorsLight.HEADROOM_LITTLE, share=headroom, trim=highest_trim)
    if trim.is_good:
        return Fact(MotorsLight.MOTORS_EVEN, headroom=headroom, **trim.figures)
    return trim
