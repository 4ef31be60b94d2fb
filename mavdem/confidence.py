"""Statistical confidence: the level of all intervals and bands, their half widths, and thresholds of significance."""

from functools import cache
from math import atan, cos, exp, lgamma, pi, sqrt, tan
from numbers import Real
from statistics import NormalDist
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

Interval = tuple[float, float]
"""Lower and upper end of an interval, in the unit of the figure."""

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

MIN_QUADRATURE_FREEDOM = 2.0
"""Fewest degrees of freedom for which quadrature gives the quantiles of Student's t distribution.

With fewer, the integrand is not smooth at a right angle, where the quantiles of rare values are.
"""

QUADRATURE_NODES = 32
"""Nodes of that quadrature: with them quantiles of up to 99.999 % have six correct digits."""

MAX_QUANTILE_STEPS = 50
"""Largest number of Newton steps to a quantile of Student's t distribution; ten are rarely needed."""

CONVERGED_ANGLE_STEP = 1e-14
"""Relative change of the angle in a Newton step, below which it has converged: rounding hides smaller ones."""


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
    factors = np.full(freedoms.shape, NormalDist().inv_cdf(upper_quantile))
    is_estimated = ~np.isinf(freedoms)
    # Many estimates share few numbers of degrees of freedom.
    distinct_freedoms, indices = np.unique(freedoms[is_estimated], return_inverse=True)
    quantiles = [
        student_t_quantile(upper_quantile, freedom) for freedom in distinct_freedoms.tolist()
    ]
    factors[is_estimated] = np.array(quantiles)[indices]
    return factors if freedoms.ndim else float(factors)


def student_t_quantile(probability: float, freedom: float) -> float:
    """Returns the value that is exceeded with a probability of 1 − ``probability`` under Student's t distribution.

    ``scipy.special.stdtrit`` does the same, but takes a fifth of a second to import, as long as a log at the rates of
    telemetry takes to be judged. With t = √ν tan φ for ν degrees of freedom, the distribution function is
    ½ + Γ((ν + 1) / 2) / (√π Γ(ν / 2)) ∫₀^φ cos^(ν − 1)(x) dx. Gauss-Legendre quadrature gives the integral, and
    Newton's method the angle φ.

    Args:
        probability: probability of a smaller value, at least 0.5 and below 1.
        freedom: ν, degrees of freedom, finite.
    """
    if freedom < MIN_QUADRATURE_FREEDOM:
        return float(scipy.special.stdtrit(freedom, probability))
    normalization = exp(lgamma((freedom + 1) / 2) - lgamma(freedom / 2)) / sqrt(pi)
    nodes, weights = _unit_quadrature()
    # The distribution function is concave in the angle, so that from below the angles rise to the one of the quantile.
    # The quantile of the normal distribution is smaller, as its tails are lighter.
    angle = atan(NormalDist().inv_cdf(probability) / sqrt(freedom))
    for _ in range(MAX_QUANTILE_STEPS):
        integral = angle * float(weights @ np.cos(angle * nodes) ** (freedom - 1))
        missing_integral = (probability - 0.5) / normalization - integral
        step = missing_integral / cos(angle) ** (freedom - 1)
        angle += step
        if step <= CONVERGED_ANGLE_STEP * angle:
            break
    return sqrt(freedom) * tan(angle)


@cache
def _unit_quadrature() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Returns nodes and weights of Gauss-Legendre quadrature over the interval from 0 to 1."""
    nodes, weights = np.polynomial.legendre.leggauss(QUADRATURE_NODES)
    return (nodes + 1) / 2, weights / 2


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
