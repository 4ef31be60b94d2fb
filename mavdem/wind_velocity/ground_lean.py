"""Tilt (lean) that an autopilot measures on the ground, because the ground slopes or the autopilot is misaligned.

A misaligned autopilot reads the same roll and pitch on level ground as in a hover in still air, where they look like
wind. Ground that slopes tilts the vehicle, and then the hover is level. One place does not distinguish these, so that
both count as equally likely. Of the lean before the flight and after it, only the part that both have in common can be
that of the autopilot.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mavdem.arrays import Array
from mavdem.dataset.attitude import Attitude
from mavdem.dataset.flight_states import airborne_intervals
from mavdem.dataset.intervals import TimeInterval, in_intervals
from mavdem.dataset.signals import Signals
from mavdem.facts.online import DragSource
from mavdem.physical_constants import GRAVITY
from mavdem.wind_velocity.vehicle_drag import LEAN, Drag

STAND_SECONDS = 10.0
"""Time before a take-off, and after a landing, in which the vehicle stands, s: a choice."""

TRANSITION_SECONDS = 2.0
"""Time next to take-off and landing, s, that is left out of it: reports of both may be as late; a choice."""

MIN_STAND_SAMPLES = 4
"""Number of samples of roll and pitch that show a stand: one second at 4 Hz."""

MAX_STAND_RANGE = np.radians(0.5)
"""Range of the middle 80 % of roll and of pitch, rad, within which a vehicle stands and is not carried; a choice."""

MAX_GROUND_LEAN = np.radians(10.0)
"""Lean on the ground, rad, beyond which a vehicle does not stand on its legs; a choice."""


def with_lean_on_ground(
    drag: Drag, signals: Signals, angles: Sequence[Attitude], boot: int, flight: TimeInterval
) -> Drag:
    """Widens the prior of a vehicle's lean, so that the lean that the autopilot measured on the ground is likely too.

    The lean in flight without wind is either that of the prior, where the ground slopes, or that on the ground, where
    the autopilot is misaligned. Both count as equally likely, for each body axis by itself, since one may be a slope
    and the other a misalignment: mean and variances are those of the mixtures. A lean that an earlier flight has
    measured stays as it is.

    Args:
        drag: prior of the drag, with the prior of the lean.
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        angles: roll and pitch that the autopilot recorded.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        flight: first and last time of the motion in the flight, s since boot.

    Returns:
        The drag; unchanged where the log does not show the vehicle on the ground before and after the flight.
    """
    is_lean_measured = drag.source not in (DragSource.POPULATION, DragSource.PARAMETERS)
    if is_lean_measured:
        return drag
    ground_lean = lean_on_ground(signals, angles, boot, flight)
    if ground_lean is None:
        return drag
    # A mixture of two equally likely distributions has its mean halfway between theirs, and a variance that is larger
    # by the square of half of their distance.
    half_distance = (ground_lean - drag.lean) / 2
    mean = drag.mean.copy()
    mean[LEAN] += half_distance
    covariance = drag.covariance.copy()
    covariance[LEAN, LEAN] += np.diag(half_distance**2)
    return replace(drag, mean=mean, covariance=covariance)


def lean_on_ground(
    signals: Signals, angles: Sequence[Attitude], boot: int, flight: TimeInterval
) -> Array | None:
    """Converts the lean on the ground to the specific force that wind would need to cause the same lean in flight.

    The ground may slope at one place. So only the lean that the autopilot measures both before the flight and after it
    is returned, which is the error of a misaligned autopilot.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        angles: roll and pitch that the autopilot recorded.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        flight: first and last time of the motion in the flight, s since boot.

    Returns:
        Force (2,) along body x and y, m/s². ``None`` if the log does not show the vehicle on the ground both times.
    """
    first_time, last_time = flight
    airborne = airborne_intervals(signals, boot)
    take_offs = [start for start, end in airborne if start <= first_time <= end]
    landings = [end for start, end in airborne if start <= last_time <= end]
    if not take_offs or not landings:
        return None
    stand_end = take_offs[0] - TRANSITION_SECONDS
    lean_before_flight = _lean_while_standing(angles, boot, (stand_end - STAND_SECONDS, stand_end))
    stand_start = landings[-1] + TRANSITION_SECONDS
    lean_after_flight = _lean_while_standing(
        angles, boot, (stand_start, stand_start + STAND_SECONDS)
    )
    if lean_before_flight is None or lean_after_flight is None:
        return None
    # The smaller of two values with the same sign was there both times. Opposite signs have no common part.
    has_same_sign = lean_before_flight * lean_after_flight > 0
    common_part = np.sign(lean_before_flight) * np.minimum(
        abs(lean_before_flight), abs(lean_after_flight)
    )
    return np.where(has_same_sign, common_part, 0.0)


def _lean_while_standing(
    angles: Sequence[Attitude], boot: int, interval: TimeInterval
) -> Array | None:
    """Returns the lean of a vehicle that stands on the ground, as the specific force of wind that causes it in flight.

    Args:
        angles: roll and pitch that the autopilot recorded.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        interval: start and end of the time in which it should stand, s since boot.

    Returns:
        Force (2,) along body x and y, m/s². ``None`` if there are too few samples, the angles vary by more than
        ``MAX_STAND_RANGE``, so that the vehicle does not stand still, or it leans more than any ground.
    """
    median_angles = []
    for angle in angles:
        series = angle.angle_series.of_boot(boot)
        angles_on_ground = series.values[in_intervals(series.time, [interval])]
        if len(angles_on_ground) < MIN_STAND_SAMPLES:
            return None
        # A tenth of the samples on either side may be disturbed, as when the vehicle is set down.
        lower_end, upper_end = np.quantile(angles_on_ground, [0.1, 0.9])
        if upper_end - lower_end > MAX_STAND_RANGE:
            return None
        median_angles.append(float(np.median(angles_on_ground)))
    roll, pitch = median_angles
    if np.hypot(roll, pitch) > MAX_GROUND_LEAN:
        return None
    # A vehicle that leans nose up, or to its left, is pushed along positive body x, or y, by wind.
    return GRAVITY * np.tan([pitch, -roll])
