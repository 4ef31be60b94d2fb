"""Confidence: how probable intervals and bands are, and how wide they are for it; one level for all rooms."""

from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

# as scipy.stats has them, which takes half a second to import
from scipy.special import ndtri, stdtrit

Interval = tuple[float, float]
# probability of the intervals and bands that are shown, unless another level is asked for
CONFIDENCE_LEVEL = 0.9
INTERVAL_QUANTILES = (
    0.5 - CONFIDENCE_LEVEL / 2,
    0.5 + CONFIDENCE_LEVEL / 2,
)  # shares of draws below the ends of such an interval
MIN_SAMPLES_FOR_STATISTICS = 20  # of which a median, a spread or a share is more than chance
SIGNIFICANT_SIGMAS = 3.0  # standard deviations or errors that are no chance
# odds of 20 to 1: strong evidence by Kass and Raftery (1995)
STRONG_EVIDENCE_NATS = 3.0


def require_probability(level: float) -> None:
    """Raises ``ValueError`` unless ``level``, the probability of an interval, lies between 0 and 1."""
    if not (isinstance(level, Real) and 0 < level < 1):
        raise ValueError(f"level must be a probability between 0 and 1, not {level!r}")


def coverage_factor(level: float = CONFIDENCE_LEVEL, freedom: ArrayLike = np.inf) -> Any:
    """Returns the half width of an interval in standard deviations, a number or shaped like ``freedom``.

    Args:
        level: the probability of the interval.
        freedom: degrees of freedom that the standard deviation was estimated with (Student's t); infinite, the normal
            distribution, where it is known.

    Raises:
        ValueError: the level is no probability between 0 and 1.
    """
    require_probability(level)
    freedoms = np.asarray(freedom, np.float64)
    below = 0.5 + level / 2
    quantiles = np.where(np.isinf(freedoms), ndtri(below), stdtrit(freedoms, below))
    return quantiles if freedoms.ndim else float(quantiles)


def half_width(
    variance: ArrayLike, level: float = CONFIDENCE_LEVEL, freedom: ArrayLike = np.inf
) -> NDArray[np.float64]:
    """Returns half widths of intervals of probability ``level``.

    Args:
        variance: of the estimates, of any shape.
        level: as for :func:`coverage_factor`.
        freedom: as for :func:`coverage_factor`; it broadcasts against ``variance``.
    """
    return coverage_factor(level, freedom) * np.sqrt(variance)
