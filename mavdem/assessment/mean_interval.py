"""Confidence intervals of the mean of correlated samples, by the equal-weighted cosine estimator.

Neighbouring samples of a flight are correlated, so that the variance of a mean is not the variance of the samples
divided by their number. The error of a mean over T seconds is decided by the slowest part of the series, below about
1/T. The estimator projects the series on q cosines, √2 cos(π j t/T) for j = 1 … q. Each projection has the variance of
the mean, if the spectrum is flat up to q/(2T). So the mean square of the projections estimates that variance, with q
degrees of freedom.

References:
    E. Lazarus, D. J. Lewis, J. H. Stock and M. W. Watson, "HAR Inference: Recommendations for Practice", Journal of
    Business & Economic Statistics 36 (2018): the equal-weighted cosine estimator, and Student's t.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from mavdem.arrays import Array
from mavdem.confidence import half_width

MAX_COSINE_FREQUENCY = 0.05
"""Largest frequency of a cosine, Hz. The spectrum counts as flat below it: gusts and the position loop are faster."""

MIN_COSINES = 4
"""Number of cosines below which intervals would be mostly chance: Student's t with fewer degrees of freedom is wide."""

MAX_COSINES = 32
"""Number of cosines above which intervals hardly become narrower."""


@dataclass(frozen=True)
class MeanFigure:
    """The mean of a quantity over settled flight."""

    mean: float
    """In the unit of the quantity."""
    interval: float | None
    """Half width of the 90 % interval of the mean; None if the flight is too short for one."""
    sd: float
    """Standard deviation of the samples."""


def mean_figure(values: Array, duration: float) -> MeanFigure:
    """Returns mean, interval and standard deviation of (N,) values, uniformly sampled over a duration in s."""
    (half_width_of_mean,) = mean_interval(values[:, None], duration)
    return MeanFigure(values.mean(), finite_or_none(half_width_of_mean), values.std())


def mean_interval(values: Array, duration: float) -> Array:
    """Computes the half widths of the 90 % confidence intervals of the means of autocorrelated series.

    The variance of the mean follows from the spectrum near frequency 0. It is estimated by the mean square of the first
    projections of the series on cosines (the equal-weighted cosine estimator), with Student's t.

    Args:
        values: (N, k) uniform samples of k series.
        duration: time from the first to the last sample, s.

    Returns:
        (k,) half widths in the unit of the series; infinite if there are fewer than two samples for each cosine.
    """
    sample_count = len(values)
    cosine_count = int(
        np.clip(round(2 * MAX_COSINE_FREQUENCY * duration), MIN_COSINES, MAX_COSINES)
    )
    if sample_count <= 2 * cosine_count:
        return np.full(values.shape[1], np.inf)
    # The type-II transform of SciPy is 2 Σ x cos; its first row belongs to the mean, which is 0 here.
    cosine_sums = scipy.fft.dct(values - values.mean(axis=0), axis=0, overwrite_x=True)
    projections = cosine_sums[1 : cosine_count + 1] / (np.sqrt(2.0) * sample_count)
    return half_width(np.square(projections).mean(axis=0), freedom=cosine_count)


def finite_or_none(value: float) -> float | None:
    """Returns a number as Python's float; None if it is infinite or NaN."""
    return float(value) if np.isfinite(value) else None
