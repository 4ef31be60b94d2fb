"""A paired test over windows: whether one method errs less than another, or chance made it look so.

Methods are tried on the same windows, so each window by itself compares them: by the ratio of their errors, whose
logarithm is as far above zero where one errs twice as much as below where the other does. Wilcoxon's signed-rank test
asks whether these logarithms lie about zero. It takes windows for independent, and those that share samples are not:
what one method makes of half of a window it makes of the next window's half too. The test is therefore of windows that
do not overlap, as many as can be had; the median ratio is of all of them.

Windows of one flight still share its vehicle and its weather: a small p-value says that the ratio is no chance of the
windows *of these flights*. What holds for flights in general is a question to as many flights, one ratio of each.

References:
    F. Wilcoxon, "Individual comparisons by ranking methods", Biometrics Bulletin 1 (1945) 80-83.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import rankdata, wilcoxon

Array = NDArray[np.float64]


class Span(NamedTuple):
    """Where a window lies: samples ``start`` to ``stop`` of a flight.

    Attributes:
        flight: any name that tells flights apart.
        start, stop: first sample, and the one after the last.
    """

    flight: str
    start: int
    stop: int


class Paired(NamedTuple):
    """Our errors beside theirs.

    Attributes:
        ratio: the median over windows of our error over theirs: below 1 ours is less. NaN of no windows.
        less: in how many windows ours is less.
        windows: how many there are.
        tested: how many of them do not overlap, which the test is of.
        p_value: of Wilcoxon's signed-rank test on the logarithms of the ratios, two-sided. Of k windows it is 2¹⁻ᵏ at
            least, so fewer than six prove nothing at 0.05; 1 where there is no difference at all, or no window.
    """

    ratio: float
    less: int
    windows: int
    tested: int
    p_value: float


def paired(ours: ArrayLike, theirs: ArrayLike, spans: Sequence[Span] | None = None) -> Paired:
    """Compares two methods' errors on the same windows.

    Args:
        ours, theirs: (W,) error of each window, at least 0; infinite where a method diverged or had no answer. Two that
            are both infinite, or both 0, count as alike.
        spans: where each window lies; without, windows are taken for independent.

    Raises:
        ValueError: arrays of different lengths, or errors that are negative or NaN.
    """
    a, b = np.asarray(ours, np.float64), np.asarray(theirs, np.float64)
    if a.shape != b.shape or a.ndim != 1 or (spans is not None and len(spans) != len(a)):
        raise ValueError(f"ours, theirs and spans must be of the same windows, not {a.shape} and {b.shape}")
    if not ((a >= 0).all() and (b >= 0).all()):
        raise ValueError("ours and theirs must be errors: at least 0, and no NaN")
    with np.errstate(divide="ignore", invalid="ignore"):
        differences = np.log(a) - np.log(b)
    differences = np.where(np.isnan(differences), 0.0, differences)
    apart = np.arange(len(a)) if spans is None else disjoint(spans)
    return Paired(_ratio(differences), int((a < b).sum()), len(a), len(apart), _signed_rank(differences[apart]))


def disjoint(spans: Sequence[Span]) -> NDArray[np.intp]:
    """Places of spans that share no sample: as many as can be had, those that end first.

    Args:
        spans: in any order.
    """
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
        # Of two middle ones that are infinite either way there is no mean: as often one diverged as the other.
        return 1.0 if np.isnan(middle) else float(np.exp(middle))


def _signed_rank(differences: Array) -> float:
    differences = differences[differences != 0]
    if not len(differences):
        return 1.0
    # Only signs and ranks count, and ranks are finite where a method diverged.
    return float(wilcoxon(np.sign(differences) * rankdata(np.abs(differences))).pvalue)
