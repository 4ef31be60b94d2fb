"""Horizons up to which forecasts are useful: they explain half of the motion, and rarely do worse than a constant.

Every forecast becomes worse with its horizon. Whoever uses one must know how far ahead that is possible.
"""

from typing import NamedTuple

from mavdem.experiments.comparison import Comparison
from mavdem.experiments.held_out import HOLD_LAST
from mavdem.experiments.scores import ForecastKind

MAX_WORSE_SHARE = 0.1
"""Largest share of windows in which a useful forecast may be worse than a constant; a choice.

It is the share of samples that a band of 90 % leaves outside.
"""


MAX_USEFUL_RATIO = 0.5
"""Largest error ratio of a useful forecast: it then explains at least half of the variance; a choice."""


class HorizonUse(NamedTuple):
    """How the forecasts of one method compare with the trivial forecasts at one horizon, over all flights."""

    seconds: float
    """The horizon, s."""

    error_ratio: float
    """Median error ratio of the method."""

    windows: int
    """Number of windows."""

    worse_than_constant: int
    """Number of windows in which the squared error is above that of the constant mean."""

    is_hold_better: bool
    """Whether the last sample, as forecast, has at most the error ratio of the method; false if it is not compared."""

    @property
    def is_often_worse_than_constant(self) -> bool:
        """Whether more windows than ``MAX_WORSE_SHARE`` of all are worse than a constant."""
        return self.worse_than_constant > MAX_WORSE_SHARE * self.windows

    @property
    def is_inaccurate(self) -> bool:
        """Whether the forecast explains less than half of the variance (``MAX_USEFUL_RATIO``)."""
        return self.error_ratio > MAX_USEFUL_RATIO

    @property
    def is_useful(self) -> bool:
        """Whether the method is accurate, beats the last sample, and beats a constant in nearly all windows."""
        return not (self.is_inaccurate or self.is_hold_better or self.is_often_worse_than_constant)


def horizon_uses(comparison: Comparison, method: str, kind: ForecastKind) -> list[HorizonUse]:
    """Compares the forecasts of a method with the trivial forecasts at each horizon that all flights have.

    Args:
        comparison: errors of all methods on windows of one flight or several.
        method: name of the method.
        kind: kind of forecast, by the data that it may use.

    Returns:
        One entry for each horizon, the shortest first.
    """
    summaries = {summary["method"]: summary for summary in comparison.over_flights(kind)}
    of_method = summaries[method]
    of_hold = summaries.get(HOLD_LAST)
    uses = []
    for index, seconds in enumerate(of_method["horizon_seconds"]):
        error_ratio = of_method["horizons"][index]
        is_hold_better = False
        if of_hold is not None:
            is_hold_better = bool(of_hold["horizons"][index] <= error_ratio)
        uses.append(
            HorizonUse(
                seconds,
                error_ratio,
                windows=of_method["windows"],
                worse_than_constant=of_method["horizons_worse"][index],
                is_hold_better=is_hold_better,
            )
        )
    return uses
