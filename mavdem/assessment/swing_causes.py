"""Causes of a swinging attitude, by other events at the same time; all events are facts (coded findings)."""

from collections.abc import Sequence

from mavdem.assessment.motor_events import LASTING_SECONDS
from mavdem.facts import Fact, Level
from mavdem.facts.ending import MotionEvent


def with_causes_of_swings(events: Sequence[Fact]) -> list[Fact]:
    """Adds to each event of a swinging attitude the causes that other events at the same time show.

    Args:
        events: events of all boots of the autopilot, each with its time.

    Returns:
        All events, in the same order.
    """
    completed_events = []
    for event in events:
        completed_event = event
        if event.code is MotionEvent.ATTITUDE_SWUNG:
            concurrent_events = [
                other_event for other_event in events if _share_time(event, other_event)
            ]
            completed_event = _with_causes(event, concurrent_events)
        completed_events.append(completed_event)
    return completed_events


def _with_causes(swing: Fact, concurrent_events: Sequence[Fact]) -> Fact:
    """Adds to the event of an attitude oscillation its attitude error and the motors that were saturated in it.

    Args:
        swing: the event: roll or pitch oscillated by tens of degrees.
        concurrent_events: other events at the same time, such as a loss of attitude or a motor at its upper limit.
    """
    return _with_saturated_motors(_with_attitude_error(swing, concurrent_events), concurrent_events)


def _with_attitude_error(swing: Fact, concurrent_events: Sequence[Fact]) -> Fact:
    """Makes a swing of the attitude bad if the attitude was far from its setpoint in it.

    It is bad even if the vehicle recovered, since the autopilot did not control the attitude.

    Args:
        swing: the event that roll or pitch swung to and fro.
        concurrent_events: other events at the same time, such as a lost attitude.

    Returns:
        The event with the largest error of roll or pitch, rad, as ``angle_error``; unchanged if there is none.
    """
    angle_errors = [
        event.figures["angle"] for event in concurrent_events if _is_lost_from_setpoint(event)
    ]
    if not angle_errors:
        return swing
    return swing.replace(Level.BAD, angle_error=max(angle_errors))


def _with_saturated_motors(swing: Fact, concurrent_events: Sequence[Fact]) -> Fact:
    """Adds to an attitude oscillation the motors that stayed at their upper limit without full throttle of the pilot.

    Returns:
        The event with their ``names`` and with ``least_duration``, s, the time that each of them stayed there at least;
        unchanged if there are no such motors.
    """
    saturated_motors = [event.subject for event in concurrent_events if _has_no_reserve(event)]
    if not saturated_motors:
        return swing
    # Each motor is named once, in the order of its first event.
    names = tuple(dict.fromkeys(saturated_motors))
    return swing.replace(names=names, least_duration=LASTING_SECONDS)


def _is_lost_from_setpoint(event: Fact) -> bool:
    """Returns whether an event is a loss of attitude whose figure ``angle`` is the distance from the setpoint.

    Without a setpoint, ``angle`` is the whole lean, and the event has the figure ``is_lean``.
    """
    return event.code is MotionEvent.ATTITUDE_CAUGHT and "is_lean" not in event.figures


def _has_no_reserve(event: Fact) -> bool:
    """Returns whether an event is a motor at its upper limit, without the full throttle that would explain it."""
    return event.code is MotionEvent.MOTOR_AT_ITS_STOP and "is_full_throttle" not in event.figures


def _share_time(event: Fact, other_event: Fact) -> bool:
    """Returns whether two events of one boot overlap; an event without an end lasts to the end of the record."""
    if event.figures["boot"] != other_event.figures["boot"]:
        return False
    start = max(event.start_time, other_event.start_time)
    return start <= min(event.latest_time, other_event.latest_time)
