"""Paired tests: whether one method's errors are lower than another's on the same windows.

Methods run on the same windows, so each window gives one ratio of their errors. Wilcoxon's signed-rank test is on the
logarithms of these ratios: twice the error and half the error are then equally far from zero. The test assumes
independent windows, so it is applied to windows that do not overlap, as many as possible; the median ratio is of all.
A small p-value of windows of one flight is about that flight; for flights in general, use one ratio of each of several.

References:
    F. Wilcoxon, "Individual comparisons by ranking methods", Biometrics Bulletin 1 (1945) 80-83.
"""

from collections.abc import Sequence
from functools import lru_cache
from math import ceil, inf, log2, nan, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mavdem.arrays import Array
from mavdem.experiments.window import Window, disjoint_windows
from mavdem.facts.forecasts import TestResult

SIGNIFICANCE = 0.05
"""The level of the test: a p-value below it is called a difference."""

MIN_PAIRS = ceil(1 - log2(SIGNIFICANCE))
"""Pairs from which a difference can be found at all: the smallest p-value of k pairs is 2¹⁻ᵏ."""


MAX_SUFFICIENT_WINDOWS = 1000
"""Most windows that are stated as enough to show a difference: more are hours of flight; a choice."""


class Paired(NamedTuple):
    """The errors of one method ("ours") compared with those of another ("theirs") on the same windows."""

    ratio: float
    """median over windows of our error over theirs: below 1, ours is lower; NaN without windows"""
    less: int
    """number of windows in which our error is lower"""
    windows: int
    """number of all windows"""
    tested: int
    """number of windows that do not overlap, which the test uses"""
    tested_less: int
    """number of these in which our error is lower"""
    p_value: float
    """two-sided p-value of the test; 1 where there is no difference at all, or no window"""

    @property
    def result(self) -> TestResult:
        """Whether our error is lower or higher than theirs, or the two cannot be distinguished."""
        if not self.p_value < SIGNIFICANCE:
            return TestResult.NOT_DISTINGUISHABLE
        return TestResult.LOWER if self.ratio < 1 else TestResult.HIGHER


def are_significant_together(p_values: Sequence[float]) -> list[bool]:
    """Returns which of several tests are significant together, by Holm's correction.

    A wrong finding among all of them then has at most the probability ``SIGNIFICANCE``.

    Args:
        p_values: p-values of the tests.

    Returns:
        Whether each test is significant, in the same order.

    References:
        S. Holm, "A simple sequentially rejective multiple test procedure", Scand. J. Stat. 6 (1979) 65-70.
    """
    are_significant = [False] * len(p_values)
    remaining_tests = len(p_values)
    for index in sorted(range(len(p_values)), key=lambda index: p_values[index]):
        if not p_values[index] * remaining_tests < SIGNIFICANCE:
            break
        are_significant[index] = True
        remaining_tests -= 1
    return are_significant


def paired(ours: ArrayLike, theirs: ArrayLike, windows: Sequence[Window] | None = None) -> Paired:
    """Compares the errors of two methods on the same windows, by the median ratio and Wilcoxon's signed-rank test.

    Args:
        ours: (W,) errors of one method, at least 0, and infinite for a window without a forecast.
        theirs: (W,) errors of the other method on the same windows. Two errors that are both infinite, or both 0, count
            as equal.
        windows: the W windows, of which overlapping ones are not independent; None if all are independent.

    Returns:
        Median ratio of the errors, number of windows in which the first method has the lower error, and p-value.

    Raises:
        ValueError: the arrays have different lengths, or errors are negative or NaN.
    """
    our_errors = np.asarray(ours, float)
    their_errors = np.asarray(theirs, float)
    has_one_each = our_errors.ndim == 1 and our_errors.shape == their_errors.shape
    if not has_one_each or (windows is not None and len(windows) != len(our_errors)):
        raise ValueError(
            "ours, theirs and windows must be of the same windows, not "
            f"{our_errors.shape} and {their_errors.shape}"
        )
    if not ((our_errors >= 0).all() and (their_errors >= 0).all()):
        raise ValueError("ours and theirs must be errors: at least 0, and no NaN")
    log_ratios = _log_ratios(our_errors, their_errors)
    # The difference of two infinite logarithms is NaN: both errors are 0, or both infinite.
    log_ratios = np.where(np.isnan(log_ratios), 0.0, log_ratios)
    is_lower = our_errors < their_errors
    count = len(our_errors)
    independent = np.arange(count) if windows is None else disjoint_windows(windows)
    return Paired(
        ratio=_median_ratio(log_ratios),
        less=int(is_lower.sum()),
        windows=count,
        tested=len(independent),
        tested_less=int(is_lower[independent].sum()),
        p_value=_signed_rank_p_value(log_ratios[independent]),
    )


def _log_ratios(ours: Array, theirs: Array) -> Array:
    """Returns the logarithms of the ratios of two methods' errors.

    Args:
        ours, theirs: (W,) errors in the same windows, at least 0.

    Returns:
        Logarithms (W,): infinite if one of both errors is 0 or infinite, and NaN if both are 0 or both infinite.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.log(ours) - np.log(theirs)


def _median_ratio(log_ratios: Array) -> float:
    """Returns the median over windows of the ratio of two methods' errors.

    Args:
        log_ratios: (W,) logarithms of the ratios; infinite if one of the methods has no finite error.

    Returns:
        The median ratio, 0 to infinity; NaN without windows.
    """
    if not len(log_ratios):
        return nan
    with np.errstate(invalid="ignore", over="ignore"):
        median = np.median(log_ratios)
        # Of an even number, the median is the mean of the two middle values. If they are of opposite infinity, it is
        # NaN: each method diverged as often as the other, so that the median ratio is 1.
        if np.isnan(median):
            return 1.0
        return float(np.exp(median))


def _signed_rank_p_value(log_ratios: Array) -> float:
    """Returns the two-sided p-value of Wilcoxon's signed-rank test of whether the ratios are centred on 1.

    Args:
        log_ratios: logarithms of error ratios of independent windows (W,), which may be infinite. Those that are 0 do
            not count, as usual in this test.

    Returns:
        The p-value; 1 where no ratio differs from 1.
    """
    # SciPy's statistics take half a second to import.
    from scipy.stats import rankdata

    differences = log_ratios[log_ratios != 0]
    if not len(differences):
        return 1.0
    # The test uses only signs, and ranks of magnitudes. SciPy does not take infinite values, so it gets the ranks.
    signed_ranks = np.sign(differences) * rankdata(abs(differences))
    return _p_value_of_ranks(tuple(signed_ranks.tolist()))


class TypicalRatio(NamedTuple):
    """How much larger one method's errors are than another's in the same windows, and how much would be significant."""

    measured: float
    """typical ratio of our error to theirs, by the estimator of Hodges and Lehmann"""
    significant: float
    """ratio from which the test would call ours higher; infinity with fewer than ``MIN_PAIRS`` windows"""
    sufficient_windows: int | None
    """about how many windows like these would make the measured ratio significant; None if ours is not higher, or if
    that takes more than ``MAX_SUFFICIENT_WINDOWS``"""


def typical_ratio(ours: ArrayLike, theirs: ArrayLike) -> TypicalRatio | None:
    """Estimates how much larger one method's errors are, and from which ratio on the test would find that.

    The scatter between windows stays as it is. Then the smallest significant logarithm of the ratio is the distance of
    its estimate from the lower end of its confidence interval, which inverts the test.

    Args:
        ours, theirs: (W,) errors of two methods on the same independent windows, at least one.

    Returns:
        Both ratios; None if an error is 0 or infinite.

    References:
        J. L. Hodges and E. L. Lehmann, "Estimates of location based on rank tests", Ann. Math. Stat. 34 (1963) 598-611.
    """
    log_ratios = _log_ratios(np.asarray(ours, float), np.asarray(theirs, float))
    if not np.isfinite(log_ratios).all():
        return None
    # The means of all pairs of windows, each window with itself too.
    first, second = np.triu_indices(len(log_ratios))
    pair_means = np.sort((log_ratios[first] + log_ratios[second]) / 2)
    estimate = np.median(pair_means)
    rank_sums = _count_of_significant_rank_sums(len(log_ratios))
    if rank_sums == 0:
        return TypicalRatio(float(np.exp(estimate)), inf, sufficient_windows=None)
    # The rank sum of negative differences is the number of negative means: it is significant if this one is positive.
    lower_end = pair_means[rank_sums - 1]
    half_width = estimate - lower_end
    # The half width of a confidence interval is inversely proportional to the root of the number of windows.
    sufficient_windows = None
    max_width_ratio = sqrt(MAX_SUFFICIENT_WINDOWS / len(log_ratios))
    if estimate > 0 and half_width <= max_width_ratio * estimate:
        sufficient_windows = ceil(len(log_ratios) * (half_width / estimate) ** 2)
    return TypicalRatio(float(np.exp(estimate)), float(np.exp(half_width)), sufficient_windows)


def _count_of_significant_rank_sums(pairs: int) -> int:
    """Returns how many rank sums of negative differences, 0, 1, 2, ..., are significant in the two-sided test.

    Without a difference each rank, 1 to ``pairs``, is negative with probability 1/2, which gives the distribution of
    their sum.
    """
    probability = np.ones(1)
    for rank in range(1, pairs + 1):
        is_positive = np.pad(probability, (0, rank))
        is_negative = np.pad(probability, (rank, 0))
        probability = (is_positive + is_negative) / 2
    return int((2 * probability.cumsum() < SIGNIFICANCE).sum())


@lru_cache(maxsize=1000)
def _p_value_of_ranks(signed_ranks: tuple[float, ...]) -> float:
    """Returns the two-sided p-value of Wilcoxon's signed-rank test, from a cache if the same ranks were tested before.

    With ties SciPy tries all combinations of signs, which takes tens of milliseconds, and a comparison often has the
    same ranks at many forecast horizons.

    Args:
        signed_ranks: rank of the magnitude of each difference, with its sign, such as (2.0, -1.0, 3.0); none is 0.
    """
    from scipy.stats import wilcoxon

    return float(wilcoxon(signed_ranks).pvalue)
