"""Horizons up to which forecasts are useful: where they beat the last sample, and a constant in nearly all windows.

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


class HorizonUse(NamedTuple):
    """How the forecasts of one method compare with the trivial forecasts at one horizon, over all flights."""

    seconds: float
    """The horizon, s."""

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
    def is_useful(self) -> bool:
        """Whether the method beats the last sample, and a constant in nearly all windows."""
        return not self.is_hold_better and not self.is_often_worse_than_constant


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
        is_hold_better = False
        if of_hold is not None:
            is_hold_better = bool(of_hold["horizons"][index] <= of_method["horizons"][index])
        uses.append(
            HorizonUse(
                seconds, of_method["windows"], of_method["horizons_worse"][index], is_hold_better
            )
        )
    return uses
