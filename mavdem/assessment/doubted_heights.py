"""Heights of events, such as a loss of control, whose source other sensors contradict, as facts (coded findings).

An event states its height by the autopilot's estimate or by the barometer. If another event of the flight says that
this source was wrong, the height is that of a better source. If it only says that barometer and satellites disagree,
nothing shows which of the two is right, and the event gets both heights.
"""

from collections.abc import Sequence
from math import isinf

from mavdem.assessment.height_disagreements import (
    MAX_AGREEMENT,
    height_difference,
    initial_difference,
)
from mavdem.dataset.time_series import TimeSeries
from mavdem.facts import Fact
from mavdem.facts.ending import MotionEvent
from mavdem.facts.witnesses import HeightSource
from mavdem.witnesses.boot_sensors import BootSensors

DOUBTS_ABOUT_BAROMETER = (MotionEvent.BAROMETER_DRIFTED, MotionEvent.HEIGHTS_DISAGREE)
"""Events of a flight that say that its barometer was, or may have been, wrong."""


def events_with_checked_heights(
    sensors: BootSensors, events: Sequence[Fact], flight_events: Sequence[Fact]
) -> list[Fact]:
    """Corrects or completes the heights of events by a barometer that was, or may have been, wrong.

    Args:
        sensors: sensors of the boot, with the take-off of the flight.
        events: events whose heights are checked. Only those with the figure ``height_source`` have a height that may
            change; without a recorded take-off none does.
        flight_events: all events of the flight. Those among them that the barometer drifted, or disagreed with the
            satellites, show that it was wrong.

    Returns:
        The events in the same order. Where the barometer drifted, the height is that by satellites. Where barometer and
        satellites disagree, the event also has the ``satellite_height``, m above the take-off.
    """
    barometer_faults = []
    for event in flight_events:
        # A disagreement whose level is good is the satellites' own: the barometer was right.
        if event.code in DOUBTS_ABOUT_BAROMETER and event.is_watch_or_bad:
            barometer_faults.append(event)
    if not barometer_faults or isinf(sensors.take_off):
        return list(events)
    difference = height_difference(sensors.signals, sensors.boot)
    if difference is None:
        return list(events)
    checked_events = []
    for event in events:
        for fault in barometer_faults:
            event = _event_with_checked_height(sensors, event, fault, difference)
        checked_events.append(event)
    return checked_events


def _event_with_checked_height(
    sensors: BootSensors, event: Fact, fault: Fact, difference: TimeSeries
) -> Fact:
    """Corrects or completes the height of an event by one fault of the barometer.

    The height above the take-off by satellites is what the barometer has risen since then, less the growth of the
    difference between barometer and satellites.

    Args:
        sensors: sensors of the boot, with the take-off of the flight.
        event: the event, such as a loss of control.
        fault: the event that the barometer drifted, or that satellites disagree with it.
        difference: how much higher the barometer reads than satellites (N,), m.

    Returns:
        A copy of the event. If the barometer drifted, its height is by satellites. If the two only disagree, it has the
        height by satellites as ``satellite_height`` too. It is unchanged if it has no height, if it was before the
        fault, or if both heights agree at its time.
    """
    has_height = event.figures.get("height_source") is not None
    if not has_height or event.time is None or event.time < fault.start_time:
        return event
    difference_at_take_off = initial_difference(difference, sensors.take_off)
    barometer_rise = sensors.height.barometer_change(sensors.take_off, event.time)
    if difference_at_take_off is None or barometer_rise is None:
        return event
    growth_since_take_off = difference.value_at(event.time) - difference_at_take_off
    if abs(growth_since_take_off) < MAX_AGREEMENT:
        return event
    satellite_height = barometer_rise - growth_since_take_off
    if fault.code is MotionEvent.BAROMETER_DRIFTED:
        return event.replace(height=satellite_height, height_source=HeightSource.SATELLITES)
    return event.replace(satellite_height=satellite_height)
