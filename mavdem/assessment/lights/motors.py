"""The light of the motors: what they lost in flight, their limits, the pattern of their trim, and what is left."""

from math import inf

from mavdem.assessment.axis.overrides import limited_motor
from mavdem.assessment.evidence import Evidence
from mavdem.assessment.lights.limits import worst
from mavdem.facts import Fact, Level
from mavdem.facts.ending import MotionEvent
from mavdem.facts.events import Reported
from mavdem.facts.motors import InFlight, MotorsLight, Trim
from mavdem.loops.limit_cycles import MIN_AT_LIMIT_SHARE
from mavdem.motors.balance import LEAST_SECONDS
from mavdem.motors.hover import HoverFigures
from mavdem.motors.trim_pattern import trim_of_signals

LITTLE_HEADROOM = 0.1  # of the motors' range


def motors_light(evidence: Evidence) -> Fact:
    """Returns the worst that a log shows of its motors: an event or alarm that names one, limits, trim, or headroom."""
    motors = evidence.signals.motors
    names = () if motors is None else motors.geometry.names
    hover = evidence.condition.hover
    # Where there was no hover to judge, a moment at the limit is all that shows.
    telling = [
        InFlight.MOTOR_LOST_THRUST,
        MotionEvent.MOTOR_OFF,
        Reported.MOTOR_FAILED,
        Reported.THRUST_LOST,
    ]
    if hover is None:
        telling.append(MotionEvent.MOTOR_AT_ITS_STOP)
    events = filter(None, (evidence.ending, *evidence.reported(telling)))
    weak = [event for event in events if event.subject in names]
    # Of several losses the largest is named, and of several stops the longest, not the earliest.
    weak.sort(key=lambda event: (-event.figures.get("rise", inf), -_lasted(event)))
    cycle = evidence.condition.oscillation
    if cycle is not None and cycle.at_limit > MIN_AT_LIMIT_SHARE:
        weak.append(Fact(MotorsLight.MOTORS_SWING, share=cycle.at_limit))
    if hover is None:
        weak.append(Fact(MotorsLight.MOTORS_NOT_SEEN, names=names, least_duration=LEAST_SECONDS))
    else:
        limited = limited_motor(hover)
        if limited is not None and hover.seconds >= LEAST_SECONDS:
            weak.append(Fact(MotorsLight.MOTOR_LIMITED, **limited))
        weak.append(_trim(evidence, hover))
    return worst(weak)


def _lasted(event: Fact) -> float:
    """How long it lasted, s; 0 of what has no end."""
    return 0.0 if event.until is None or event.time is None else event.until - event.time


def _trim(evidence: Evidence, hover: HoverFigures) -> Fact:
    """The pattern of the trim with what is left, or that little is."""
    trim = trim_of_signals(evidence.signals) or Fact(Trim.TRIM_UNKNOWN)
    headroom = min(hover.headroom)
    if headroom < LITTLE_HEADROOM and trim.level is not Level.WATCH:
        return Fact(
            MotorsLight.HEADROOM_LITTLE,
            share=headroom,
            trim=max(hover.trim_of_range),
        )
    if trim.is_good:
        return Fact(MotorsLight.MOTORS_EVEN, headroom=headroom, **trim.figures)
    return trim
