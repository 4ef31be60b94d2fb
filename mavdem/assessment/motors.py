"""The light of the motors: what they lost in flight, their limits, the pattern of their trim, and what is left."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from mavdem.analysis.overrides import limited_motor
from mavdem.assessment.evidence import Evidence
from mavdem.assessment.limits import worst
from mavdem.facts import Fact, Level
from mavdem.facts.motors import MotorsLight, Trim
from mavdem.health.balance import LEAST_SECONDS
from mavdem.health.in_flight import MotorAlarm, losses_of
from mavdem.health.trim import trim_of_signals

LITTLE_HEADROOM = 0.1  # of the motors' range


def motors_light(evidence: Evidence) -> Fact:
    """Returns the worst that a log shows of its motors: an event or alarm that names one, limits, trim, or headroom."""
    found = [*_named_by_events(evidence)]
    found += losses_of(while_controlled(evidence.alarms, evidence.ending))
    hover = evidence.condition.hover
    if hover is None:
        found.append(Fact(MotorsLight.MOTORS_NOT_SEEN, least_duration=LEAST_SECONDS))
    else:
        limited = limited_motor(hover)
        if limited is not None and hover.seconds >= LEAST_SECONDS:
            found.append(Fact(MotorsLight.MOTOR_LIMITED, Level.BAD, **limited))
        found.append(_trim(evidence, min(hover.headroom)))
    return worst(found)


def _named_by_events(evidence: Evidence) -> Iterator[Fact]:
    """How the flight was lost, and what is bad of single motors."""
    motors = evidence.signals.motors
    names = () if motors is None else motors.layout.names
    ending = [] if evidence.ending is None else [evidence.ending]
    for event in (*ending, *evidence.events):
        if event.level is Level.BAD and event.subject in names:
            yield event


def while_controlled(alarms: Sequence[MotorAlarm], ending: Fact | None) -> list[MotorAlarm]:
    """Returns the ``alarms`` of before control was lost: then the motors' balance says nothing."""
    lost = float("inf") if ending is None or ending.time is None else ending.time
    return [alarm for alarm in alarms if alarm.time < lost]


def _trim(evidence: Evidence, headroom: float) -> Fact:
    """The pattern of the trim with what is left, or that little is."""
    trim = trim_of_signals(evidence.signals) or Fact(Trim.TRIM_UNKNOWN)
    if headroom < LITTLE_HEADROOM and trim.level is not Level.WATCH:
        return Fact(MotorsLight.HEADROOM_LITTLE, Level.WATCH, share=headroom)
    if trim.level is Level.GOOD:
        known = {"headroom": headroom, **trim.figures}
        return Fact(MotorsLight.MOTORS_EVEN, Level.GOOD, **known)
    return trim
