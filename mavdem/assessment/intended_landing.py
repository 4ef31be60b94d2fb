"""Whether a vehicle that toppled when it met the ground was about to land: low, slow, level and not climbing."""

import numpy as np

from mavdem.assessment.contact_time import TOPPLE_HEIGHT_CLOSED
from mavdem.dataset.grounded import MAX_SETPOINT_DELAY
from mavdem.dataset.intervals import TimeInterval, in_intervals
from mavdem.dataset.time_series import series_of_boot
from mavdem.facts import Fact
from mavdem.witnesses.boot_sensors import BootSensors, Rest

DESCENT_SECONDS = 3 * MAX_SETPOINT_DELAY
"""Seconds before a contact over which the descent, and the closing of the throttle, are looked for; a choice."""

LANDING_STEP = 1.5
"""Height, m, of a resting place above the take-off from which on it is no ground but something that was hit."""

HARD_IMPACT_SPEED = 3.0
"""Speed downward, m/s, from which on an upright vehicle hits the ground and does not land."""

HARD_IMPACT_SPEED_CLOSED = 5.0
"""``HARD_IMPACT_SPEED``, m/s, of a vehicle that topples after the pilot closed the throttle: it falls from 1.3 m."""

TOPPLE_HEIGHT = 2.0
"""Height, m, above take-off or resting place up to which a vehicle that topples was landing."""

MAX_LANDING_LEAN = np.radians(25.0)
"""Lean, rad, above which a vehicle near the ground is not landing."""

CLIMB_STICK = 0.65
"""Travel of the throttle stick from which on the pilot commands a climb; ArduPilot's middle is 0.5 ± 0.1."""

LANDING_DESCENT = 0.3
"""Height, m, that a vehicle which lands loses in the last 3 s before it touches the ground: autopilots land at 0.3 m/s
or more, with 0.1 m/s of drift of the height."""

STICK_DELAY = 0.3
"""Seconds by which a stick may be logged later than the motion that it causes: receivers are logged at 3 to 10 Hz."""


def was_landing(
    sensors: BootSensors,
    time: float,
    rest: Rest | None,
    fall_speed: float | None,
    throttle_closing: Fact | None,
) -> bool:
    """Returns whether a vehicle that toppled was about to land: low, slow, level, and without a command to climb.

    A closed throttle or a descent must also show that a landing was intended.

    Args:
        sensors: sensors of the vehicle in one boot, with the take-off of this flight.
        time: time when it touched the ground, s since boot.
        rest: when and how the vehicle came to lie still afterwards; None if the log ended before.
        fall_speed: largest speed downward just before, m/s; None if it is not known.
        throttle_closing: fact that the pilot closed the throttle around the contact; None if nothing shows it.
    """
    max_fall_speed = HARD_IMPACT_SPEED
    max_height = TOPPLE_HEIGHT
    # If the pilot closed the throttle before the contact, the vehicle was dropped on purpose: it may be faster and
    # higher. A throttle that was closed afterwards does not change how the vehicle came to the ground.
    was_closed_before = (
        throttle_closing is not None and throttle_closing.start_time <= time + STICK_DELAY
    )
    if was_closed_before:
        max_fall_speed = HARD_IMPACT_SPEED_CLOSED
        max_height = TOPPLE_HEIGHT_CLOSED
    if fall_speed is not None and fall_speed > max_fall_speed:
        return False
    time_before = time - MAX_SETPOINT_DELAY
    if not _is_low(sensors, time_before, rest, max_height):
        return False
    if _is_leaning(sensors, time_before) or _commands_climb(sensors, (time_before, time)):
        return False
    is_landing_intended = throttle_closing is not None or _is_descending(sensors, time)
    return is_landing_intended


def _is_low(sensors: BootSensors, time: float, rest: Rest | None, max_height: float) -> bool:
    """Returns whether the vehicle was near the ground: low above its take-off, or above its later resting place.

    A vehicle that came to rest higher than it took off, such as on a roof, was not near the ground.

    Args:
        sensors: sensors of the vehicle, with the take-off of this flight.
        time: time shortly before the contact, s since boot.
        rest: when and how the vehicle came to lie still afterwards; None if the log ended before.
        max_height: largest height that counts as low, m.
    """
    height = sensors.height_at(time)
    if height is None:
        return False
    resting_height = None if rest is None else sensors.height_at(rest.time)
    if resting_height is None:
        return height <= max_height
    rests_above_ground = resting_height > LANDING_STEP
    lower_height = min(height, height - resting_height)
    return lower_height <= max_height and not rests_above_ground


def _is_descending(sensors: BootSensors, time: float) -> bool:
    """Returns whether the vehicle lost more than ``LANDING_DESCENT`` of height in the ``DESCENT_SECONDS`` before.

    Args:
        sensors: sensors of the vehicle.
        time: end of the descent, s since boot.
    """
    height_before = sensors.height_at(time - DESCENT_SECONDS)
    height = sensors.height_at(time)
    if height_before is None or height is None:
        return False
    return height_before - height > LANDING_DESCENT


def _is_leaning(sensors: BootSensors, time: float) -> bool:
    """Returns whether the vehicle leaned too far to land: roll or pitch beyond ``MAX_LANDING_LEAN``.

    The setpoint plays no part: a vehicle that leans on purpose does not land either.

    Args:
        sensors: sensors of the vehicle.
        time: the time, s since boot.
    """
    for tilt in sensors.signals.tilts:
        angle = series_of_boot(tilt.angle_series, sensors.boot)
        if angle is not None:
            if abs(np.interp(time, angle.time, angle.values)) > MAX_LANDING_LEAN:
                return True
    return False


def _commands_climb(sensors: BootSensors, interval: TimeInterval) -> bool:
    """Returns whether the pilot's throttle commanded a climb at any time of an interval; False if it was not logged."""
    stick = sensors.stick
    if stick is None:
        return False
    is_in_interval = in_intervals(stick.time, [interval])
    return bool((stick.values[is_in_interval] > CLIMB_STICK).any())
