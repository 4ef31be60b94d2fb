"""Windows in which a forecast is worse than a constant, and how they differ from the others.

The error ratio divides by the error of the constant. Where the vehicle hardly moves that error is small, so that the
constant is hard to beat; an unstable model may be worse in any window.
"""

from statistics import median
from typing import NamedTuple

from mavdem.experiments.comparison import Comparison
from mavdem.experiments.outcomes import Outcome
from mavdem.experiments.scores import ForecastKind

LITTLE_MOTION_SHARE = 0.5
"""Largest error of a constant, as a share of that elsewhere, that explains why a forecast is worse; a choice.

Half of the constant's error alone doubles the error ratio.
"""


class WorseWindows(NamedTuple):
    """The windows in which one method is worse than a constant over the whole test part; failed ones do not count."""

    method: str
    """Name of the method."""

    windows: int
    """Number of these windows."""

    unstable: int
    """How many of them have an unstable model."""

    constant_error: float
    """The constant's squared error in them, over the variance in training: the median window; NaN without any."""

    constant_error_elsewhere: float
    """The same of the other windows; NaN without any."""

    @property
    def has_little_motion(self) -> bool:
        """Whether the vehicle moves much less there: the constant's own error is below half of that elsewhere."""
        return self.constant_error < LITTLE_MOTION_SHARE * self.constant_error_elsewhere


def worse_windows(comparison: Comparison, method: str, kind: ForecastKind) -> WorseWindows:
    """Returns in how many windows a method is worse than a constant, and how much the vehicle moves there.

    An example: 5 windows, 2 of them with an unstable model; the constant's error is 0.27 there and 1.4 elsewhere.

    Args:
        comparison: outcomes of all methods on windows of one flight or several.
        method: name of the method.
        kind: kind of forecast, by the data that it may use.
    """
    worse: list[Outcome] = []
    others: list[Outcome] = []
    for outcome in comparison.outcomes_of(method):
        if outcome.failure is None:
            is_worse = outcome.scores[kind].ratio[-1] > 1
            (worse if is_worse else others).append(outcome)
    return WorseWindows(
        method,
        windows=len(worse),
        unstable=sum(outcome.stable is False for outcome in worse),
        constant_error=_median_constant_error(worse, kind),
        constant_error_elsewhere=_median_constant_error(others, kind),
    )


def _median_constant_error(outcomes: list[Outcome], kind: ForecastKind) -> float:
    """Returns the constant's squared error over the training variance, mean of the outputs and median of the windows.

    Args:
        outcomes: outcomes of one method; NaN is returned if there are none.
        kind: kind of forecast, by the data that it may use.
    """
    if not outcomes:
        return float("nan")
    errors = []
    for outcome in outcomes:
        scores = outcome.scores[kind]
        errors.append(float((scores.baseline / scores.variance).mean()))
    return median(errors)
