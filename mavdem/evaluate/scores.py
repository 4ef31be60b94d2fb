"""Scores: squared errors of forecasts beside those of the constant mean, in one table.

A row is one method's forecasts of one window that answer one question in pieces of so many steps.

A test part of H samples is forecast in pieces of k steps: at every k-th sample a forecast starts from all data before
it. So each sample counts once at every horizon, forecasts do not overlap, the error is the mean *up to* the k-th step,
and the constant mean's error is the same at all horizons. k = H is the MSPE of the one forecast from the end of
training.

Methods run on the same windows, so each window gives one ratio of their errors. Wilcoxon's signed-rank test is on the
logarithms of these ratios: twice the error and half the error are then equally far from zero. The test assumes
independent windows, so it is applied to windows that do not overlap, as many as possible; the median ratio is of all.
A small p-value of windows of one flight is about that flight; for flights in general, use one ratio of each of several.

References:
    F. Wilcoxon, "Individual comparisons by ranking methods", Biometrics Bulletin 1 (1945) 80-83.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import nan
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mavdem.dem.engine.linalg import Array
from mavdem.errors import NotLearnable
from mavdem.flight import Flight

TRAIN_SECONDS = 7.0
TEST_SECONDS = 1.5
"""Default lengths of a training and a test part: a few periods of a vehicle's motion, as in the paper at 100 Hz."""


class Length(NamedTuple):
    """A length of flight: a number of samples, or of seconds."""

    number: float
    in_seconds: bool = True

    def samples(self, dt: float) -> int:
        """Returns the number of samples ``dt`` s apart, at least 1."""
        return max(1, round(self.number / dt)) if self.in_seconds else int(self.number)


def part_samples(
    dt: float, train: Length | None = None, test: Length | None = None
) -> tuple[int, int]:
    """Returns the samples of a training and a test part ``dt`` s apart: as asked for, else 7 s and 1.5 s."""
    return (train or Length(TRAIN_SECONDS)).samples(dt), (test or Length(TEST_SECONDS)).samples(dt)


class TooFewSamples(NotLearnable):
    """The settled flight is too short; ``lengths`` are options with windows that fit, ("--test", "40"), or empty."""

    def __init__(self, reason: str, remedy: str = "", lengths: tuple[str, ...] = ()) -> None:
        super().__init__(reason, remedy or f"Ask for shorter ones: `{' '.join(lengths)}`.")
        self.lengths = lengths

    @classmethod
    def of(
        cls, flight: Flight, start: float, train: int, test: int, least: int, remedy: str
    ) -> TooFewSamples:
        """Returns why ``train`` and ``test`` samples do not fit after ``start`` s of a ``flight``, and how many would.

        With fewer than ``least`` training samples none do, and the ``remedy`` is another.
        """
        left = len(flight) - round(min(start / flight.dt, len(flight)))
        shorter = min(test, max(left // 6, 1))
        longest = min(train, left - shorter)
        fits = longest >= least
        after = f", {left} of them from {start:g} s on" if start else ""
        return cls(
            f"The settled flight has {len(flight)} samples ({flight.duration:.1f} s){after}, but {train} training and "
            f"{test} test samples were asked for.",
            "" if fits else remedy,
            ("--train", str(longest), "--test", str(shorter)) if fits else (),
        )


@dataclass(frozen=True, eq=False)
class Window:
    """One window of the flight named ``flight``: from sample ``start`` on, ``train`` and, right after it, ``test``."""

    flight: str
    start: int
    train: Flight
    test: Flight

    @property
    def stop(self) -> int:
        """The sample of the flight after the last of the window."""
        return self.start + len(self.train) + len(self.test)


def windows(
    name: str,
    flight: Flight,
    train: int | None = None,
    test: int | None = None,
    hop: int | None = None,
) -> tuple[Window, ...]:
    """Returns every window that fits into the ``flight`` of this ``name``; none if it is too short.

    ``train`` and ``test`` samples last 7 s and 1.5 s unless given. Windows begin ``hop`` samples apart: half a window
    unless given, so that neighbours share a half.

    Raises:
        ValueError: a number of samples that is not positive.
    """
    usual = part_samples(flight.dt)
    train = usual[0] if train is None else train
    test = usual[1] if test is None else test
    hop = max(1, (train + test) // 2) if hop is None else hop
    if min(train, test, hop) < 1:
        raise ValueError(f"train, test and hop must be at least 1, not {train}, {test} and {hop}")
    return tuple(
        Window(
            name, start, flight[start : start + train], flight[start + train : start + train + test]
        )
        for start in range(0, len(flight) - train - test + 1, hop)
    )


HORIZONS = (1, 5, 10, 25, 50, 150)
"""Steps; the last is the paper's."""
USUAL_RATE = 100.0
FAST_RATE = 125.0
"""Hz: the rate of these steps, and the rate above which they last as long as at ``USUAL_RATE``."""
KNOWN = "known"
FROM_ZERO = "zero"
UNKNOWN = "unknown"
"""Questions: the outputs, given the inputs; the same from state 0, as the paper's figures; what comes next, without the
inputs."""

ScoreTable = NDArray[np.void]


def table_type(outputs: int) -> np.dtype[np.void]:
    """Returns the columns of a table of scores of so many ``outputs``.

    ``flight``, ``start`` and ``method`` say whose they are, ``question`` and ``steps`` what was forecast. Of each
    output there are the mean ``squared_error``, the training ``variance``, which is its unit, and the squared error of
    the constant mean, ``baseline``. ``inside`` is the share of the samples in the 90 % band, NaN without one.
    """
    names = [
        ("flight", object),
        ("start", int),
        ("method", object),
        ("question", object),
        ("steps", int),
    ]
    errors = [(name, float, (outputs,)) for name in ("squared_error", "variance", "baseline")]
    return np.dtype([*names, *errors, ("inside", float)])


class Mspe(NamedTuple):
    """Mean squared prediction error: ``per_output`` (m,) in the squares of their units, and ``total``, their sum."""

    per_output: Array
    total: float


def mspe(measured: ArrayLike, predicted: ArrayLike) -> Mspe:
    """Returns the mean over samples of the squared error (the paper, ``Metric for comparison``).

    Args:
        measured, predicted: (H, m) each. A prediction that is NaN has an infinite error.

    Raises:
        ValueError: shapes that differ, or no samples.

    >>> mspe([[0.0, 0.0], [2.0, 1.0]], [[0.0, 0.0], [0.0, 0.0]]).total
    2.5

    See Also:
        :func:`mavdem.evaluate.held_out_windows`: errors on windows that no model has seen.
    """
    y = np.asarray(measured, np.float64)
    yhat = np.asarray(predicted, np.float64)
    if y.shape != yhat.shape or y.ndim != 2 or not len(y):
        raise ValueError(
            f"measured and predicted must be (H, m) alike, not {y.shape} and {yhat.shape}"
        )
    # The forecast of an unstable model may overflow.
    with np.errstate(over="ignore", invalid="ignore"):
        squares = (y - yhat) ** 2
    per_output = np.where(np.isnan(squares), np.inf, squares).mean(axis=0)
    return Mspe(per_output, float(per_output.sum()))


def error_over(ours: ArrayLike, theirs: ArrayLike) -> Array:
    """Returns the ratio of errors, ``ours`` over ``theirs``; 1 if both are the same, also 0 or infinite."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(np.equal(ours, theirs), 1.0, np.divide(ours, theirs))


def horizons(samples: int, dt: float) -> tuple[int, ...]:
    """Returns the horizons, in steps, of a test part of ``samples``: those of ``HORIZONS`` in it, and all of it.

    Above 125 Hz, by the sampling step ``dt`` in s, they last as long as at 100 Hz.
    """
    steps = (
        HORIZONS
        if dt >= 1 / FAST_RATE
        else tuple(round(usual / USUAL_RATE / dt) for usual in HORIZONS)
    )
    return (*(one for one in steps if one < samples), samples)


def score(
    train: Flight,
    test: Flight,
    predicted: ArrayLike,
    steps: int | None = None,
    question: str = KNOWN,
) -> ScoreTable:
    """Returns one row: the error of ``predicted`` (H, m), forecasts of ``test`` in pieces of ``steps``, all at once.

    Raises:
        ValueError: predictions of another shape, or an output of ``train`` that is constant.
    """
    if not np.ptp(train.outputs, axis=0).all():
        raise ValueError("train must vary in every output: errors are in units of its variance")
    mean = np.broadcast_to(train.outputs.mean(axis=0), test.outputs.shape)
    ours, baseline = (mspe(test.outputs, values).per_output for values in (predicted, mean))
    row = (
        "",
        0,
        "",
        question,
        steps or len(test),
        ours,
        train.outputs.var(axis=0),
        baseline,
        np.nan,
    )
    return np.array([row], table_type(len(ours)))


def relative_mspe(train: Flight, test: Flight, forecast: ArrayLike) -> float:
    """Returns the error ratio: MSPE in units of each output's training variance, summed, over the training mean's.

    Below 1 the forecast is better than the mean.

    ``train`` gives mean and variances; ``forecast`` (H, m) is of the H samples of ``test``.

    Raises:
        ValueError: a forecast of another shape, or an output of ``train`` that is constant.
    """
    return float(ratio(score(train, test, forecast))[0])


def ratio(scores: ScoreTable) -> Array:
    """Returns the error ratio of each row of ``scores``, (N,): below 1 is better than the constant mean.

    The skill score is one minus this, and it is the NMSE of system identification.
    """
    ours, baseline = (
        (scores[column] / scores["variance"]).sum(axis=1)
        for column in ("squared_error", "baseline")
    )
    return error_over(ours, baseline)


def by_horizon(scores: ScoreTable) -> list[ScoreTable]:
    """Returns the rows of ``scores`` at each horizon, the shortest first."""
    return [scores[scores["steps"] == steps] for steps in sorted(set(scores["steps"].tolist()))]


def score_values(row: Any) -> dict[str, Any]:
    """Returns a ``row`` as plain JSON values; errors are over the training variance, ``relative`` over the mean's."""
    per_output = row["squared_error"] / row["variance"]
    return {
        "steps": int(row["steps"]),
        "per_output": per_output.tolist(),
        "total": float(per_output.sum()),
        "relative_per_output": error_over(row["squared_error"], row["baseline"]).tolist(),
        "relative": float(ratio(np.array([row]))[0]),
    }


SIGNIFICANCE = 0.05
FEWEST_PAIRS = 6
"""The level of the test, and the pairs that it takes: of k the p-value is 2¹⁻ᵏ at least."""
Verdict = Literal["lower", "higher", "not distinguishable"]


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
    def verdict(self) -> Verdict:
        """Whether our error is lower or higher than theirs, or the two cannot be told apart."""
        if not self.p_value < SIGNIFICANCE:
            return "not distinguishable"
        return "lower" if self.ratio < 1 else "higher"

    def to_dict(self) -> dict[str, Any]:
        """As plain JSON values by name."""
        return self._asdict() | {"verdict": self.verdict}


def paired(ours: ArrayLike, theirs: ArrayLike, windows: Sequence[Window] | None = None) -> Paired:
    """Returns how two methods' errors compare on the same windows, ``ours`` and ``theirs``, (W,) each and at least 0.

    They are infinite without a forecast; two that are both infinite, or both 0, count as equal. Without the
    ``windows`` these count as independent.

    Raises:
        ValueError: arrays of different lengths, or errors that are negative or NaN.
    """
    a = np.asarray(ours, np.float64)
    b = np.asarray(theirs, np.float64)
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
    ranks = np.sign(tested) * rankdata(np.abs(tested))
    p_value = float(wilcoxon(ranks).pvalue) if len(tested) else 1.0
    return Paired(middle, int((a < b).sum()), len(a), len(apart), p_value)


def disjoint(windows: Sequence[Window]) -> NDArray[np.intp]:
    """Returns the indices of ``windows`` that share no sample: as many as possible, those that end first."""
    chosen: list[int] = []
    free: dict[str, int] = {}
    for i, window in sorted(enumerate(windows), key=lambda numbered: numbered[1].stop):
        if window.start >= free.get(window.flight, window.start):
            chosen.append(i)
            free[window.flight] = window.stop
    return np.array(sorted(chosen), np.intp)
