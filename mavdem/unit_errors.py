"""Arrays that are given: real numbers, and whether angle, rate or time seem to be in degrees or milliseconds."""

from math import pi

import numpy as np
from numpy.typing import NDArray

from mavdem.facts import Fact
from mavdem.facts.sources import Arrays, Slip

# s, one period of 5 Hz, over which an angle and its rate are compared: sensor noise averages out, roll dynamics do not
RATE_INTEGRATION_SPAN = 0.2
SLIPS = {
    1.0: Slip.BOTH_IN_DEGREES,
    57.3: Slip.ANGLE_IN_DEGREES,
    1 / 57.3: Slip.RATE_IN_DEGREES,
    1e-3: Slip.TIME_IN_MILLISECONDS,
    1e-6: Slip.TIME_IN_MICROSECONDS,
}
"""What is likely by how many times as much an angle changes as its rate says; 1.0 only of angles beyond π."""


def suspected_unit_error(outputs: NDArray[np.float64], dt: float) -> Fact | None:
    """Returns what unit an angle and its rate, ``outputs`` (T, 2), or time ``dt`` seem to have instead of rad and s."""
    if outputs.shape[1] != 2:
        return None
    angle, rate = outputs.T
    turned = rate.cumsum() * dt
    # so that noise counts little
    changed = angle[8:] - angle[:-8]
    expected = turned[8:] - turned[:-8]
    power = expected @ expected
    if not changed @ expected > 0.9 * (changed @ changed * power) ** 0.5:
        return None  # no angle and its rate
    ratio = changed @ expected / power
    largest = abs(angle).max()
    slip = next((slip for factor, slip in SLIPS.items() if 0.8 < ratio / factor < 1.25), None)
    if slip is None or (slip is Slip.BOTH_IN_DEGREES and largest <= pi):
        return None
    return Fact(Arrays.UNIT_SLIP, slip=slip, ratio=ratio, largest=largest)
