"""Sensor facts: what one sensor shows for or against an event, such as a knock for a crash. They decide its level.

The code of a sensor fact states what the sensor shows, such as that the vehicle rotated. Its figure ``side`` is whether
it supports the event or contradicts it; its other figures are measured, such as the largest body rate. The facts of an
event are its figure ``witnesses``.
"""

from collections.abc import Iterable
from typing import Any

from mavdem.facts import Fact, Facts, Level
from mavdem.facts.witnesses import SensorFact, Side

MIN_SUPPORT = 2
"""Number of independent sensor facts that an event needs: one sensor alone may be wrong."""

ACCELEROMETER = "accelerometer"
"""Source of a pose: the direction of gravity."""

ATTITUDE = "attitude"
"""Source of a pose without an accelerometer: the autopilot's roll and pitch."""

SOURCES = {
    SensorFact.ROSE: "height",
    SensorFact.SANK: "height",
    SensorFact.GROUND_READING_CHANGED: "height",
    SensorFact.ATTITUDE_LEFT_SETPOINT: "attitude",
    SensorFact.ATTITUDE_ANSWERED: "attitude",
    SensorFact.ROTATED: "gyro",
    SensorFact.LAY_ON_ITS_SIDE: "direction of gravity",
    SensorFact.KNOCKED: "acceleration",
    SensorFact.GRAVITY_WRONG: "acceleration",
    SensorFact.CLIPPED: "clipping",
    SensorFact.VIBRATED: "vibration",
    SensorFact.THROTTLE_CLOSED: "stick",
    SensorFact.THROTTLE_NOT_RAISED: "stick",
    SensorFact.MOTORS_FULL: "motors",
    SensorFact.MOTORS_THROTTLED: "motors",
    SensorFact.SPEED_ZERO: "speed controller",
    SensorFact.ERRORS_COUNTED: "speed controller",
    SensorFact.MOTOR_SLOWED: "speed controller",
    SensorFact.COMMAND_ROSE: "motors",
    SensorFact.COMMANDS_CHANGED: "motors",
    SensorFact.COMMAND_ABOVE_OTHERS: "motors",
    SensorFact.POSITION_INVALID: "estimator",
    SensorFact.NO_FIX: "receiver",
    SensorFact.SATELLITES_LEVEL: "receiver",
    SensorFact.MODE_CHANGED: "autopilot",
    SensorFact.AUTOPILOT_REPORTED: "autopilot",
}
"""Source of each sensor fact. Facts from the same source count once, since one fault may cause all of them.

Facts without a source, such as that the log ended, or that the vehicle rested afterwards, are true after every flight,
so that they do not count.
"""


def supporting_fact(code: SensorFact, **figures: Any) -> Fact:
    """Creates the fact (coded finding) that a sensor supports an event, such as a knock that supports a crash.

    Args:
        code: what the sensor shows, such as ``KNOCKED``; its sentence is made from this code.
        figures: measured values by name, in the units of ``code``; and ``subject``, ``time`` and ``end_time``, s, of
            the fact if it has any.

    Returns:
        The fact, which counts for the event.
    """
    return Fact(code, side=Side.FOR, **figures)


def contradicting_fact(code: SensorFact, **figures: Any) -> Fact:
    """Creates the fact (coded finding) that a sensor contradicts an event, such as an upright rest after a crash.

    Args:
        code: what the sensor shows, such as ``NO_KNOCK``; its sentence is made from this code.
        figures: measured values by name, in the units of ``code``; and ``subject``, ``time`` and ``end_time``, s, of
            the fact if it has any.

    Returns:
        The fact, which counts against the event.
    """
    return Fact(code, side=Side.AGAINST, **figures)


def supporting_facts(sensor_facts: Iterable[Fact]) -> Facts:
    """Returns the sensor facts that support the event."""
    return tuple(fact for fact in sensor_facts if fact.figures["side"] == Side.FOR)


def contradicting_facts(sensor_facts: Iterable[Fact]) -> Facts:
    """Returns the sensor facts that contradict the event."""
    return tuple(fact for fact in sensor_facts if fact.figures["side"] == Side.AGAINST)


def support_count(sensor_facts: Iterable[Fact]) -> int:
    """Counts the independent sensor facts that support an event.

    Facts are independent if they rest on different ``SOURCES``, such as "gyro" or "height".

    Args:
        sensor_facts: facts of sensors and other sources. Those that contradict the event, or have no source, such as
            that the log ended, are not counted.

    Returns:
        The number of different sources.
    """
    sources = set()
    for fact in supporting_facts(sensor_facts):
        code = SensorFact(fact.code)
        if code is SensorFact.LAY_ON_ITS_SIDE and fact.figures["source"] == ATTITUDE:
            # Without an accelerometer the pose was computed from the attitude, and is not independent of it.
            sources.add(SOURCES[SensorFact.ATTITUDE_LEFT_SETPOINT])
        elif code in SOURCES:
            sources.add(SOURCES[code])
    return len(sources)


def checked_event(event: Fact, sensor_facts: Iterable[Fact]) -> Fact:
    """Checks a bad event, such as a crash, by sensors, and lowers its level to "watch" if they do not confirm it.

    It is confirmed by ``MIN_SUPPORT`` independent facts, if they are more than those that contradict it.

    Args:
        event: the event, with the level that it has if it is confirmed.
        sensor_facts: what sensors show for and against it.

    Returns:
        A copy of the event with these facts as its figure ``witnesses`` and, if its level was lowered, the figure
        ``is_unconfirmed``.
    """
    facts = tuple(sensor_facts)
    support = support_count(facts)
    is_confirmed = support >= MIN_SUPPORT and support > len(contradicting_facts(facts))
    event = event.replace(witnesses=facts)
    if event.is_bad and not is_confirmed:
        return event.replace(Level.WATCH, is_unconfirmed=True)
    return event
