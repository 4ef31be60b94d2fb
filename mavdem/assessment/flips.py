"""Flips, as facts (coded findings): the setpoint turned the vehicle over in a mode that allows it, and it flew on."""

from collections.abc import Iterator, Sequence
from math import pi

from mavdem.assessment.commanded_overturn import lean_angle
from mavdem.assessment.descents import flies_on
from mavdem.assessment.flights import RECOVERY_SECONDS
from mavdem.dataset.axes import TILT_COLUMNS
from mavdem.dataset.extreme_tilt import MAX_TILT
from mavdem.dataset.intervals import (
    Intervals,
    TimeInterval,
    in_intervals,
    intersection,
    merge_close_intervals,
    true_intervals,
)
from mavdem.dataset.steady_flight import attitude_tracking
from mavdem.facts import Fact, Level
from mavdem.facts.ending import MotionEvent
from mavdem.witnesses.boot_sensors import BootSensors

OVERTURNING_MODES = ("Acro", "Flip")
"""Modes in which the setpoint may turn the vehicle over.

In other modes the lean that can be commanded is limited. A setpoint beyond that was dragged along by a vehicle that
tumbled, since autopilots limit the error between the two.
"""

MIN_OVERTURN = pi / 2
"""Lean, rad, of vehicle and setpoint that a flip exceeds: the vehicle is on its back."""

CLIMB_SECONDS = 2.0
"""Longest climb before a flip, s: ArduCopter's Flip throttles up at once, and gives up a flip after 2.5 s."""


def flip_events(sensors: BootSensors, flight_interval: TimeInterval) -> Iterator[Fact]:
    """Yields the flips of a flight: the setpoint turned the vehicle over in a mode that allows it, and it flew on.

    A flip is intended and therefore good, but it explains motors at their limits. Flips that follow each other within
    ``RECOVERY_SECONDS`` are one event.

    Args:
        sensors: sensors of the vehicle in one boot, which lasts from one start of the autopilot to the next.
        flight_interval: start and end of the flight, s since boot.

    Yields:
        Facts with the flight mode as subject, and the largest lean of the setpoint as ``angle``, rad.
    """
    tracking = attitude_tracking(sensors.signals, sensors.boot)
    if tracking is None:
        return
    vehicle_lean = lean_angle(tracking.angles[:, TILT_COLUMNS])
    commanded_lean = lean_angle(tracking.setpoints)
    tilted = true_intervals(tracking.time, vehicle_lean > MAX_TILT)
    tilted_in_flight = intersection(tilted, [flight_interval])
    for start, end in merge_close_intervals(tilted_in_flight, RECOVERY_SECONDS):
        is_tilted = in_intervals(tracking.time, [(start, end)])
        mode = sensors.signals.mode_at(sensors.boot, start)
        if mode not in OVERTURNING_MODES or not is_tilted.any():
            continue
        largest_commanded_lean = commanded_lean[is_tilted].max()
        # Without a setpoint its lean is NaN, which is not larger.
        is_commanded = bool(largest_commanded_lean > MIN_OVERTURN)
        is_overturned = bool(vehicle_lean[is_tilted].max() > MIN_OVERTURN)
        if is_commanded and is_overturned and flies_on(sensors, flight_interval, end):
            yield Fact(
                MotionEvent.FLIPPED,
                Level.GOOD,
                time=start,
                end_time=end,
                subject=mode,
                angle=largest_commanded_lean,
                boot=sensors.boot,
            )


def flip_intervals(events: Sequence[Fact]) -> Intervals:
    """Returns the intervals in which flips explain motors at their limits: the climb before each, to the recovery.

    Args:
        events: events of a flight.

    Returns:
        Start and end of each interval, s since boot.
    """
    flips = [event for event in events if event.code is MotionEvent.FLIPPED]
    return [
        (flip.start_time - CLIMB_SECONDS, flip.latest_time + RECOVERY_SECONDS) for flip in flips
    ]
