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


def with_doubted_heights_checked(
    sensors: BootSensors, events: Sequence[Fact], flight_events: Sequence[Fact]
) -> list[Fact]:
    """Corrects or completes the heights of events whose source other events of the flight doubt.

    Args:
        sensors: sensors of the boot, with the take-off of the flight.
        events: events whose heights are checked. Only those with the figure ``height_source`` have a height that may
            change; without a recorded take-off none does.
        flight_events: all events of the flight, among which are the doubts.

    Returns:
        The events in the same order. Where the barometer drifted, the height is that by satellites. Where barometer and
        satellites disagree, the event also has the ``satellite_height``, m above the take-off.
    """
    doubts = []
    for event in flight_events:
        # A disagreement whose level is good is the satellites' own: the barometer was right.
        if event.code in DOUBTS_ABOUT_BAROMETER and event.warns:
            doubts.append(event)
    if not doubts or isinf(sensors.take_off):
        return list(events)
    difference = height_difference(sensors.signals, sensors.boot)
    if difference is None:
        return list(events)
    checked_events = []
    for event in events:
        for doubt in doubts:
            event = _with_doubt(sensors, event, doubt, difference)
        checked_events.append(event)
    return checked_events


def _with_doubt(sensors: BootSensors, event: Fact, doubt: Fact, difference: TimeSeries) -> Fact:
    """Applies one doubt about the barometer to the height of an event.

    Args:
        sensors: sensors of the boot, with the take-off of the flight.
        event: the event.
        doubt: the event that the barometer drifted, or that satellites disagree with it.
        difference: how much higher the barometer reads than satellites (N,), m.

    Returns:
        The event; unchanged if it has no height, if it was before the doubt, or if both heights agree at its time.
    """
    has_height = event.figures.get("height_source") is not None
    if not has_height or event.time is None or event.time < doubt.start_time:
        return event
    initial = initial_difference(difference, sensors.take_off)
    barometer_rise = sensors.height.barometer_change(sensors.take_off, event.time)
    if initial is None or barometer_rise is None:
        return event
    growth = difference.value_at(event.time) - initial
    if abs(growth) < MAX_AGREEMENT:
        return event
    satellite_height = barometer_rise - growth
    if doubt.code is MotionEvent.BAROMETER_DRIFTED:
        return event.replace(height=satellite_height, height_source=HeightSource.SATELLITES)
    return event.replace(satellite_height=satellite_height)
