"""Statistical confidence: the level of all intervals and bands, their half widths, and thresholds of significance."""

from numbers import Real
from typing import Any, NamedTuple, Self

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

Interval = tuple[float, float]
"""Lower and upper end of an interval, in the unit of the figure."""


class IntervalEstimate(NamedTuple):
    """An estimated number with its 90 % interval, in the unit of the number."""

    value: float
    """The estimate."""
    low: float
    """Lower end of the interval."""
    high: float
    """Upper end of the interval."""

    @property
    def interval(self) -> Interval:
        """The ends of the interval."""
        return self.low, self.high

    def excludes(self, other: Self) -> bool:
        """Returns whether no value lies in both intervals."""
        return self.high < other.low or other.high < self.low


class EstimateWithHalfWidth(NamedTuple):
    """An estimate, and how far its interval reaches to either side; NaN where either is not known."""

    value: float
    """The estimate."""

    half_width: float
    """Half width of its interval, in the unit of the estimate."""


CONFIDENCE_LEVEL = 0.9
"""Probability of the intervals and bands that are shown, unless another level is asked for; a choice."""

INTERVAL_QUANTILES = 0.5 - CONFIDENCE_LEVEL / 2, 0.5 + CONFIDENCE_LEVEL / 2
"""Shares of posterior samples below the lower and the upper end of such an interval: 5 and 95 %."""

MIN_SAMPLES_FOR_STATISTICS = 20
"""Fewest samples whose median, spread or share is reported; of fewer it is mostly chance. A choice."""

SIGNIFICANT_SIGMAS = 3.0
"""Deviation, in standard errors, beyond which a difference is taken for real: the three-sigma rule."""

STRONG_EVIDENCE_NATS = 3.0
"""Difference of log evidence, in nats, that is strong evidence by Kass and Raftery (1995): odds of 20 to 1."""


def require_probability(level: float) -> None:
    """Raises ``ValueError`` unless ``level``, the probability of an interval, lies between 0 and 1."""
    if not (isinstance(level, Real) and 0 < level < 1):
        raise ValueError(f"level must be a probability between 0 and 1, not {level!r}")


def coverage_factor(level: float = CONFIDENCE_LEVEL, freedom: ArrayLike = np.inf) -> Any:
    """Returns the half width of a two-sided interval in standard deviations (the coverage factor k of the GUM).

    It is the quantile of the normal distribution if the standard deviation is known, and of Student's t distribution if
    it was estimated.

    Args:
        level: Probability of the interval.
        freedom: Degrees of freedom with which the standard deviation was estimated, a number or an array; infinite if
            it is known.

    Returns:
        A float, or an array in the shape of ``freedom``.

    Raises:
        ValueError: The level is not a probability between 0 and 1.
    """
    require_probability(level)
    freedoms = np.asarray(freedom, np.float64)
    upper_quantile = 0.5 + level / 2
    factors = np.where(
        np.isinf(freedoms),
        scipy.special.ndtri(upper_quantile),
        scipy.special.stdtrit(freedoms, upper_quantile),
    )
    return factors if freedoms.ndim else float(factors)


def half_width(
    variance: ArrayLike, level: float = CONFIDENCE_LEVEL, freedom: ArrayLike = np.inf
) -> NDArray[np.float64]:
    """Returns the half widths of two-sided intervals about estimates of known or estimated variance.

    Args:
        variance: Variances of the estimates, of any shape.
        level: Probability of the intervals.
        freedom: Degrees of freedom of the variances, broadcast against ``variance``; infinite where they are known.

    Returns:
        Half widths in the unit of the estimates, with the broadcast shape of ``variance`` and ``freedom``.

    Raises:
        ValueError: The level is no probability between 0 and 1.
    """
    return coverage_factor(level, freedom) * np.sqrt(variance)


def student_t_log_density(values: NDArray[np.float64], freedom: float) -> NDArray[np.float64]:
    """Returns the logarithms of the density of Student's t distribution.

    Args:
        values: values at which the density is computed.
        freedom: degrees of freedom, finite.
    """
    log_normalization = (
        scipy.special.gammaln((freedom + 1) / 2)
        - scipy.special.gammaln(freedom / 2)
        - np.log(freedom * np.pi) / 2
    )
    log_density: NDArray[np.float64] = log_normalization - (freedom + 1) / 2 * np.log1p(
        values**2 / freedom
    )
    return log_density
