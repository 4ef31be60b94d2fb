"""Which motors were at their upper limit for the longest time, and which others were loaded as much."""

from collections.abc import Mapping, Sequence

import numpy as np

from mavdem.arrays import Array
from mavdem.containers import Names

ALIKE_RATIO = 0.5
"""Time at the limit, relative to that of the motor with the most, from which a motor counts as limited alike.

A weak motor is at its limit while the one opposite to it idles. Where another motor is there for half as long, too
little thrust of all, or gains that are too high, explain both, and neither motor is weak.
"""


def most_limited_motors(names: Names, times_at_limit: Sequence[float] | Array) -> Names:
    """Returns the motor that was at its limit for the longest time, or several if their times are similar.

    Args:
        names: Names of the k motors.
        times_at_limit: (k,) time of each at its upper limit, in any unit.

    Returns:
        Names, in the order of ``names``, of all motors with at least ``ALIKE_RATIO`` of the longest time; none if no
        motor was at its limit.
    """
    times = np.asarray(times_at_limit, dtype=np.float64)
    longest_time = times.max(initial=0.0)
    if longest_time <= 0:
        return ()
    limited_motors = []
    for name, time in zip(names, times, strict=True):
        if time >= ALIKE_RATIO * longest_time:
            limited_motors.append(name)
    return tuple(limited_motors)


def equally_loaded_motors(deviations: Mapping[str, float], motors_at_limit: Names) -> Names:
    """Returns the motors whose mean command is about as high as the command of the motors at their limit.

    A weak motor needs a higher command than every other one. If others need as much, the cause of the limit is the
    load, the wind, a twisted arm or the yaw trim, and it is chance which motor a gust drives to its limit.

    Args:
        deviations: Deviation of the mean command of each motor from the mean of all motors, by name, in any unit.
        motors_at_limit: Names of the motors that are at their limit the most.

    Returns:
        Names of the other motors whose mean command is above the mean of all motors by at least ``ALIKE_RATIO`` times
        as much as the command of the limited ones. All other motors if the limited ones do not exceed the mean.
    """
    limited_deviation = max(deviations[motor] for motor in motors_at_limit)
    motors_below_limit = [motor for motor in deviations if motor not in motors_at_limit]
    if limited_deviation <= 0:
        return tuple(motors_below_limit)
    min_deviation = ALIKE_RATIO * limited_deviation
    return tuple(motor for motor in motors_below_limit if deviations[motor] >= min_deviation)
