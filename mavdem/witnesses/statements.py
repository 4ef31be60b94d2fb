"""Statements of sensors ("witnesses"): facts that support or contradict an event such as a crash, and so set its level.

The code of a statement says what the sensor shows, such as that the vehicle rotated. Its figure ``side`` says whether
it supports the event or contradicts it; its other figures are measured, such as the largest body rate.
"""

from collections.abc import Iterable
from typing import Any

from mavdem.facts import Fact, Facts, Level
from mavdem.facts.witnesses import SensorStatement, Side

MIN_SUPPORT = 2
"""Number of independent witnesses that an event needs: one sensor alone may be wrong."""

ACCELEROMETER = "accelerometer"
"""Source of a pose: the direction of gravity."""

ATTITUDE = "attitude"
"""Source of a pose without an accelerometer: the autopilot's roll and pitch."""

SOURCES = {
    SensorStatement.ROSE: "height",
    SensorStatement.SANK: "height",
    SensorStatement.GROUND_READING_CHANGED: "height",
    SensorStatement.ATTITUDE_LEFT_SETPOINT: "attitude",
    SensorStatement.ATTITUDE_ANSWERED: "attitude",
    SensorStatement.ROTATED: "gyro",
    SensorStatement.LAY_ON_ITS_SIDE: "direction of gravity",
    SensorStatement.KNOCKED: "acceleration",
    SensorStatement.GRAVITY_WRONG: "acceleration",
    SensorStatement.CLIPPED: "clipping",
    SensorStatement.VIBRATED: "vibration",
    SensorStatement.THROTTLE_CLOSED: "stick",
    SensorStatement.THROTTLE_NOT_RAISED: "stick",
    SensorStatement.MOTORS_FULL: "motors",
    SensorStatement.MOTORS_THROTTLED: "motors",
    SensorStatement.SPEED_ZERO: "speed controller",
    SensorStatement.ERRORS_COUNTED: "speed controller",
    SensorStatement.MOTOR_SLOWED: "speed controller",
    SensorStatement.COMMAND_ROSE: "motors",
    SensorStatement.COMMAND_ABOVE_OTHERS: "motors",
    SensorStatement.POSITION_INVALID: "estimator",
    SensorStatement.NO_FIX: "receiver",
    SensorStatement.SATELLITES_LEVEL: "receiver",
    SensorStatement.MODE_CHANGED: "autopilot",
    SensorStatement.AUTOPILOT_REPORTED: "autopilot",
}
"""Source of each statement. Statements from the same source count once, since one fault may cause all of them.

Statements without a source, such as that the log ended, or that the vehicle rested afterwards, are true after every
flight, so that they do not count.
"""


def supporting_statement(code: SensorStatement, **figures: Any) -> Fact:
    """Returns a statement that supports an event.

    Args:
        code: what the sensor shows.
        figures: its measured values, in the units of ``code``, and ``subject``, ``time`` and ``end_time``, if it has
            any.
    """
    return Fact(code, side=Side.FOR, **figures)


def contradicting_statement(code: SensorStatement, **figures: Any) -> Fact:
    """Returns a statement that contradicts an event.

    Args:
        code: what the sensor shows.
        figures: its measured values, in the units of ``code``, and ``subject``, ``time`` and ``end_time``, if it has
            any.
    """
    return Fact(code, side=Side.AGAINST, **figures)


def supporting_statements(witnesses: Iterable[Fact]) -> Facts:
    """Returns the witnesses that support the event."""
    return tuple(fact for fact in witnesses if fact.figures["side"] == Side.FOR)


def contradicting_statements(witnesses: Iterable[Fact]) -> Facts:
    """Returns the witnesses that contradict the event."""
    return tuple(fact for fact in witnesses if fact.figures["side"] == Side.AGAINST)


def support_count(witnesses: Iterable[Fact]) -> int:
    """Counts the independent witnesses that support an event.

    Witnesses are independent if they rest on different ``SOURCES``, such as "gyro" or "height".

    Args:
        witnesses: statements of sensors and other sources. Those that contradict the event, or have no source, such as
            that the log ended, are not counted.

    Returns:
        The number of different sources.
    """
    sources = set()
    for fact in supporting_statements(witnesses):
        code = SensorStatement(fact.code)
        if code is SensorStatement.LAY_ON_ITS_SIDE and fact.figures["source"] == ATTITUDE:
            # Without an accelerometer the pose was computed from the attitude, which is one source however often.
            sources.add(SOURCES[SensorStatement.ATTITUDE_LEFT_SETPOINT])
        elif code in SOURCES:
            sources.add(SOURCES[code])
    return len(sources)


def weighed_event(event: Fact, witnesses: Iterable[Fact]) -> Fact:
    """Adds the witnesses to an event, and lowers its level from bad to "watch" if they do not confirm it.

    A bad event is confirmed by ``MIN_SUPPORT`` independent witnesses, if they are more than those that contradict it.

    Args:
        event: the event, with the level that it has if it is confirmed.
        witnesses: statements for and against it.

    Returns:
        A copy of the event with witnesses and level. One whose level was lowered has the figure ``is_unconfirmed``.
    """
    statements = tuple(witnesses)
    support = support_count(statements)
    is_confirmed = support >= MIN_SUPPORT and support > len(contradicting_statements(statements))
    event = event.replace(witnesses=statements)
    if event.is_bad and not is_confirmed:
        return event.replace(Level.WATCH, is_unconfirmed=True)
    return event
