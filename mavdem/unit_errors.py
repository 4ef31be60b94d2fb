"""Detection of wrong units: an angle or rate in degrees, or time in milliseconds, is found by comparing angle and rate.

An angle changes by the integral of its rate. Where it changes 57.3 times as much, it is in degrees and its rate is not.
"""

from math import pi

import numpy as np
from numpy.typing import NDArray

from mavdem.facts import Fact
from mavdem.facts.sources import ArrayFact, UnitSlip

RATE_INTEGRATION_SPAN = 0.2
"""Time, s, over which other modules integrate a rate to compare it with the change of its angle.

One period of 5 Hz: sensor noise averages out, the roll dynamics do not.
"""

RATIO_BY_UNIT_ERROR = {
    UnitSlip.BOTH_IN_DEGREES: 1.0,
    UnitSlip.ANGLE_IN_DEGREES: 57.3,
    UnitSlip.RATE_IN_DEGREES: 1 / 57.3,
    UnitSlip.TIME_IN_MILLISECONDS: 1e-3,
    UnitSlip.TIME_IN_MICROSECONDS: 1e-6,
}
"""Change of the angle over the integral of the rate, by the unit error that explains the ratio."""

RATIO_TOLERANCE = 1.25
"""Factor by which a measured ratio may differ from such a value; wide, since the values differ by far more."""

COMPARED_STEPS = 8
"""Steps over which changes of the angle are compared with integrals of the rate, so that noise counts little."""

MIN_CORRELATION = 0.9
"""Correlation of changes and integrals below which the two columns are no angle and its rate."""


def suspected_unit_error(outputs: NDArray[np.float64], dt: float) -> Fact | None:
    """Returns the unit error that an angle and its rate show, or None if they agree or are no such pair.

    The change of the angle over ``COMPARED_STEPS`` steps is regressed on the integral of the rate over the same steps.
    The slope is 1 if both have consistent units; each unit error has a different slope (``RATIO_BY_UNIT_ERROR``).
    Columns whose correlation is below ``MIN_CORRELATION`` are not an angle and its rate. A slope of 1 also fits an
    angle and a rate that are both in degrees, which are recognised by the magnitude of the angle.

    Args:
        outputs: Angle and rate, (T, 2), expected in rad and rad/s. Other numbers of columns are not judged.
        dt: Sampling step, expected in s.

    Returns:
        A fact with the error, the ``ratio`` of change and integral, and the ``largest`` angle; None without an error.
    """
    if outputs.shape[1] != 2:
        return None
    angle, rate = outputs.T
    integrated_rate = rate.cumsum() * dt
    change = angle[COMPARED_STEPS:] - angle[:-COMPARED_STEPS]
    expected_change = integrated_rate[COMPARED_STEPS:] - integrated_rate[:-COMPARED_STEPS]

    product = change @ expected_change
    expected_power = expected_change @ expected_change
    # The product of both changes at which their correlation is just ``MIN_CORRELATION``.
    least_product = MIN_CORRELATION * (change @ change * expected_power) ** 0.5
    # Written with "not", so that NaN and overflowing products count as uncorrelated too.
    if not product > least_product:
        return None

    # Slope of the least-squares line through the origin.
    ratio = product / expected_power
    largest_angle = abs(angle).max()
    for unit_error, expected_ratio in RATIO_BY_UNIT_ERROR.items():
        if 1 / RATIO_TOLERANCE < ratio / expected_ratio < RATIO_TOLERANCE:
            # With the right ratio, only an angle beyond half a turn shows that both are in degrees.
            if unit_error is UnitSlip.BOTH_IN_DEGREES and largest_angle <= pi:
                return None
            return Fact(ArrayFact.UNIT_SLIP, slip=unit_error, ratio=ratio, largest=largest_angle)
    return None
