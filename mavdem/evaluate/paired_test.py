"""A paired test over windows: whether one method has a lower error than another, beyond chance.

Methods run on the same windows, so each window gives one ratio of their errors. Wilcoxon's signed-rank test is on the
logarithms of these ratios: twice the error and half the error are then equally far from zero. The test assumes
independent windows, and those that share samples are correlated. It is therefore applied to windows that do not
overlap, as many as possible; the median ratio is of all.

Windows of one flight still share its vehicle and its weather: a small p-value is about windows *of these flights*. For
flights in general, use one ratio of each of several flights.

References:
    F. Wilcoxon, "Individual comparisons by ranking methods", Biometrics Bulletin 1 (1945) 80-83.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import rankdata, wilcoxon

from mavdem.dem.engine.linalg import Array

SIGNIFICANCE = 0.05
"""The level of the test. Of fewer than ``FEWEST_PAIRS`` pairs no p-value is below it, whatever they are."""

FEWEST_PAIRS = 6

Verdict = Literal["lower", "higher", "not distinguishable"]


class SampleSpan(Protocol):
    """Part of the flight named ``flight``: its first sample ``start``, and ``stop``, the one after the last."""

    @property
    def flight(self) -> str: ...  # noqa: D102
    @property
    def start(self) -> int: ...  # noqa: D102
    @property
    def stop(self) -> int: ...  # noqa: D102


class Paired(NamedTuple):
    """The errors of one method ("ours") beside those of another ("theirs").

    Attributes:
        ratio: the median over windows of our error over theirs: below 1, ours is lower. NaN without windows.
        less: number of windows in which ours is lower.
        windows: number of windows.
        tested: number of windows that do not overlap, which the test uses.
        p_value: of Wilcoxon's signed-rank test on the logarithms of the ratios, two-sided. Of k windows it is 2¹⁻ᵏ at
            least, so fewer than six prove nothing at 0.05; 1 where there is no difference at all, or no window.
    """

    ratio: float
    less: int
    windows: int
    tested: int
    p_value: float

    @property
    def verdict(self) -> Verdict:
        """Whether our error is lower or higher than theirs, or the two cannot be told apart."""
        if not self.p_value < SIGNIFICANCE:
            return "not distinguishable"
        return "lower" if self.ratio < 1 else "higher"

    def to_dict(self) -> dict[str, Any]:
        """As plain JSON values by name."""
        return self._asdict() | {"verdict": self.verdict}


def paired(ours: ArrayLike, theirs: ArrayLike, windows: Sequence[SampleSpan] | None = None) -> Paired:
    """Compares two methods' errors on the same windows, ``ours`` and ``theirs``, (W,) each and at least 0.

    They are infinite if a method diverged or had no forecast; two that are both infinite, or both 0, count as equal.
    Without the ``windows``, or others with their flight, start and stop, these count as independent.

    Raises:
        ValueError: arrays of different lengths, or errors that are negative or NaN.
    """
    a, b = np.asarray(ours, np.float64), np.asarray(theirs, np.float64)
    if a.shape != b.shape or a.ndim != 1 or (windows is not None and len(windows) != len(a)):
        raise ValueError(f"ours, theirs and windows must be of the same windows, not {a.shape} and {b.shape}")
    if not ((a >= 0).all() and (b >= 0).all()):
        raise ValueError("ours and theirs must be errors: at least 0, and no NaN")
    with np.errstate(divide="ignore", invalid="ignore"):
        differences = np.log(a) - np.log(b)
    differences = np.where(np.isnan(differences), 0.0, differences)
    apart = np.arange(len(a)) if windows is None else disjoint(windows)
    return Paired(_ratio(differences), int((a < b).sum()), len(a), len(apart), _signed_rank(differences[apart]))


def disjoint(spans: Sequence[SampleSpan]) -> NDArray[np.intp]:
    """Places of spans that share no sample: as many as possible, those that end first."""
    chosen: list[int] = []
    free: dict[str, int] = {}
    for place in sorted(range(len(spans)), key=lambda place: spans[place].stop):
        span = spans[place]
        if span.start >= free.get(span.flight, span.start):
            chosen.append(place)
            free[span.flight] = span.stop
    return np.array(sorted(chosen), np.intp)


def _ratio(differences: Array) -> float:
    if not len(differences):
        return float("nan")
    with np.errstate(invalid="ignore", over="ignore"):
        middle = np.median(differences)
        # Two middle ones of opposite infinity have no mean: each method diverged as often as the other.
        return 1.0 if np.isnan(middle) else float(np.exp(middle))


def _signed_rank(differences: Array) -> float:
    differences = differences[differences != 0]
    if not len(differences):
        return 1.0
    # Only signs and ranks count, and ranks are finite if a method diverged.
    return float(wilcoxon(np.sign(differences) * rankdata(np.abs(differences))).pvalue)
