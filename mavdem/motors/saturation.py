"""Which motors were at their upper limit for the longest time."""

from collections.abc import Sequence

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
