"""Times in which a vehicle is tilted so far that it does not hover: in a tumble, on its side or back, or in a flip."""

import numpy as np

from mavdem.dataset.intervals import Intervals, complement, true_intervals
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import AVERAGING_SECONDS
from mavdem.dataset.vehicle_cache import cached_per_vehicle

MAX_TILT = np.radians(60.0)
"""Roll or pitch, rad, beyond which no model of hover holds.

There half the thrust no longer carries the vehicle, and derivatives of Euler angles are no longer the body rates.
"""


@cached_per_vehicle()
def extreme_tilt_intervals(signals: Signals, boot: int) -> Intervals:
    """Returns the intervals of a boot in which roll or pitch exceeds ``MAX_TILT``, and a second around them.

    A vehicle that tumbles is upright again and again for a moment. With half of ``AVERAGING_SECONDS`` before and after
    each extreme tilt, a tumble is one interval, and no moving average outside of it contains any of it.

    Args:
        signals: Logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: Number of the boot; a boot lasts from one start of the autopilot to the next.

    Returns:
        Ascending intervals without overlap, s since boot; none if no attitude was recorded.
    """
    widened_intervals = []
    for tilt in signals.tilts:
        angle = tilt.angle_series.of_boot(boot)
        for start, end in true_intervals(angle.time, abs(angle.values) >= MAX_TILT):
            widened_intervals.append((start - AVERAGING_SECONDS / 2, end + AVERAGING_SECONDS / 2))
    # The complement of overlapping intervals joins them.
    return complement(complement(sorted(widened_intervals)))
