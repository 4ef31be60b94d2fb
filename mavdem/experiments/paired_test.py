"""Paired tests: whether one method's errors are lower than another's on the same windows.

Methods run on the same windows, so each window gives one ratio of their errors. Wilcoxon's signed-rank test is on the
logarithms of these ratios: twice the error and half the error are then equally far from zero. The test assumes
independent windows, so it is applied to windows that do not overlap, as many as possible; the median ratio is of all.
A small p-value of windows of one flight is about that flight; for flights in general, use one ratio of each of several.

References:
    F. Wilcoxon, "Individual comparisons by ranking methods", Biometrics Bulletin 1 (1945) 80-83.
"""

from collections.abc import Sequence
from math import ceil, log2, nan
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mavdem.experiments.window import Window, disjoint
from mavdem.facts.forecasts import TestResult

SIGNIFICANCE = 0.05
FEWEST_PAIRS = ceil(1 - log2(SIGNIFICANCE))
"""The level of the test, and the pairs that it takes: of k the p-value is 2¹⁻ᵏ at least."""


class Paired(NamedTuple):
    """The errors of one method ("ours") beside those of another ("theirs").

    Attributes:
        ratio: the median over windows of our error over theirs: below 1, ours is lower. NaN without windows.
        less, windows, tested: numbers of windows in which ours is lower, of all, and of those that do not overlap,
            which the test uses.
        p_value: of the test, two-sided; 1 where there is no difference at all, or no window.
    """

    ratio: float
    less: int
    windows: int
    tested: int
    p_value: float

    @property
    def result(self) -> TestResult:
        """Whether our error is lower or higher than theirs, or the two cannot be told apart."""
        if not self.p_value < SIGNIFICANCE:
            return TestResult.NOT_DISTINGUISHABLE
        return TestResult.LOWER if self.ratio < 1 else TestResult.HIGHER


def paired(ours: ArrayLike, theirs: ArrayLike, windows: Sequence[Window] | None = None) -> Paired:
    """Returns how two methods' errors compare on the same windows, ``ours`` and ``theirs``, (W,) each and at least 0.

    They are infinite without a forecast; two that are both infinite, or both 0, count as equal. Without the
    ``windows`` these count as independent.

    Raises:
        ValueError: arrays of different lengths, or errors that are negative or NaN.
    """
    a = np.asarray(ours, float)
    b = np.asarray(theirs, float)
    if a.shape != b.shape or a.ndim != 1 or (windows is not None and len(windows) != len(a)):
        raise ValueError(
            f"ours, theirs and windows must be of the same windows, not {a.shape} and {b.shape}"
        )
    if not ((a >= 0).all() and (b >= 0).all()):
        raise ValueError("ours and theirs must be errors: at least 0, and no NaN")
    with np.errstate(divide="ignore", invalid="ignore"):
        differences = np.log(a) - np.log(b)
    differences = np.where(np.isnan(differences), 0.0, differences)
    apart = np.arange(len(a)) if windows is None else disjoint(windows)
    with np.errstate(invalid="ignore", over="ignore"):
        # Two middle ones of opposite infinity have no mean: each method diverged as often as the other.
        middle = (
            float(np.exp(np.nan_to_num(np.median(differences), posinf=np.inf, neginf=-np.inf)))
            if len(a)
            else nan
        )
    from scipy.stats import rankdata, wilcoxon  # it takes half a second to import

    # Only signs and ranks count, and ranks are finite if a method diverged.
    tested = differences[apart][differences[apart] != 0]
    ranks = np.sign(tested) * rankdata(abs(tested))
    p_value = float(wilcoxon(ranks).pvalue) if len(tested) else 1.0
    return Paired(middle, int((a < b).sum()), len(a), len(apart), p_value)
