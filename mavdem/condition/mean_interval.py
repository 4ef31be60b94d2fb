"""Means of series whose neighbouring samples are correlated, with intervals that allow for it.

The error of a mean over T seconds is decided by the slowest part of the series, below about 1/T. That part is estimated
from the first cosines: each of q projections of the series on √2 cos(π j t/T) has the mean's own variance, if the
spectrum is flat up to q/(2T). Their mean square is then its estimate, with q degrees of freedom.

References:
    E. Lazarus, D. J. Lewis, J. H. Stock and M. W. Watson, "HAR Inference: Recommendations for Practice", Journal of
    Business & Economic Statistics 36 (2018): the equal-weighted cosine estimator, and Student's t.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

LEVEL = 0.9
FASTEST = 0.05
"""Hz, of the fastest cosine: slower than gusts and the position loop, whose seconds are no mean of a flight."""
FEWEST, MOST = 4, 32  # Cosines; fewer than 4 make intervals that are mostly chance, more than 32 hardly change them


class MeanInterval(NamedTuple):
    """Means (k,) and the half widths (k,) of their 90 % intervals; infinite for series too short to tell."""

    mean: NDArray[np.float64]
    half_width: NDArray[np.float64]


def mean_interval(values: NDArray[np.float64], seconds: float) -> MeanInterval:
    """The means of the columns of ``values`` (N, k), uniformly sampled over so many ``seconds``."""
    length, mean = len(values), values.mean(axis=0)
    cosines = int(np.clip(round(2 * FASTEST * seconds), FEWEST, MOST))
    if length <= 2 * cosines:
        return MeanInterval(mean, np.full(values.shape[1], np.inf))
    phase = np.pi * (np.arange(length) + 0.5) / length
    basis = np.sqrt(2.0) * np.cos(np.arange(1, cosines + 1)[:, None] * phase) / length
    variance = np.square(basis @ (values - mean)).mean(axis=0)
    return MeanInterval(mean, float(student.ppf(0.5 + LEVEL / 2, cosines)) * np.sqrt(variance))
