"""At which horizons one method's forecasts differ from another's: paired tests from the shortest horizon on.

A method may forecast better over a tenth of a second and not over whole seconds, so one test of the whole test part
hides what a controller would use. Each horizon has the paired test of ``paired_test``. Many tests find a difference by
chance; here the horizons are tested in a fixed order, from the shortest on, each at the level ``SIGNIFICANCE``, until
one shows no difference. Any wrong finding then has that probability at most over all horizons, without a correction.

References:
    W. Maurer, L. A. Hothorn and W. Lehmacher, "Multiple comparisons in drug clinical trials and preclinical assays:
    a-priori ordered hypotheses", in Biometrie in der chemisch-pharmazeutischen Industrie 6 (1995) 3-18.
"""

from collections.abc import Sequence
from itertools import takewhile
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.experiments.comparison import Comparison
from mavdem.experiments.paired_test import Paired, paired
from mavdem.experiments.scores import ForecastKind
from mavdem.facts.forecasts import TestResult


class HorizonDifference(NamedTuple):
    """How the errors of a method differ from those of another one at one horizon."""

    seconds: float
    """The horizon, s."""

    error_ratio: float
    """Error ratio of the method, by which the tables order methods."""

    other_error_ratio: float
    """Error ratio of the other method."""

    test: Paired
    """The paired test of the method's errors against those of the other one."""

    is_reached: bool
    """Whether all shorter horizons show a difference; only then does the test of this one count."""

    @property
    def is_shown(self) -> bool:
        """Whether a difference is shown at this horizon."""
        return self.is_reached and self.test.result is not TestResult.NOT_DISTINGUISHABLE


def horizon_differences(
    comparison: Comparison, method: str, other: str, kind: ForecastKind
) -> list[HorizonDifference]:
    """Tests at each horizon that all flights have whether two methods' errors differ, from the shortest on.

    The pairs of errors are those of ``Comparison.tests``: flights, or windows if there are too few flights.

    Args:
        comparison: errors of all methods on windows of one flight or several.
        method: name of the method.
        other: name of the method that it is compared with.
        kind: kind of forecast, by the data that it may use.

    Returns:
        One entry for each horizon, the shortest first; the last is the whole test part.
    """
    summaries = {summary["method"]: summary for summary in comparison.over_flights(kind)}
    horizons: Sequence[float] = summaries[method]["horizon_seconds"]
    differences = []
    is_reached = True
    for index, seconds in enumerate(horizons):
        is_whole_test = index == len(horizons) - 1
        whole_or_seconds = None if is_whole_test else seconds
        test = _test_at_horizon(comparison, method, other, kind, whole_or_seconds)
        difference = HorizonDifference(
            seconds,
            error_ratio=summaries[method]["horizons"][index],
            other_error_ratio=summaries[other]["horizons"][index],
            test=test,
            is_reached=is_reached,
        )
        differences.append(difference)
        is_reached = difference.is_shown
    return differences


def shown_differences(differences: Sequence[HorizonDifference]) -> list[HorizonDifference]:
    """Returns the horizons at which a difference is shown, the shortest first; empty if the shortest shows none."""
    return list(takewhile(lambda difference: difference.is_shown, differences))


def _test_at_horizon(
    comparison: Comparison, method: str, other: str, kind: ForecastKind, seconds: float | None
) -> Paired:
    """Returns the paired test of a method's errors against those of another one at one horizon.

    Args:
        comparison: errors of all methods.
        method: name of the method.
        other: name of the method that it is compared with.
        kind: kind of forecast, by the data that it may use.
        seconds: length of the forecasts, s; None for the whole test part.
    """
    ratios = _error_ratios(comparison, method, kind, seconds)
    other_ratios = _error_ratios(comparison, other, kind, seconds)
    if not comparison.are_flights_pairs:
        return paired(ratios, other_ratios, comparison.windows)
    # Windows of one flight resemble each other: the pairs are the median windows of the flights.
    flights = np.array([window.flight for window in comparison.windows])
    medians = [np.median(ratios[flights == flight]) for flight in comparison.flights]
    other_medians = [np.median(other_ratios[flights == flight]) for flight in comparison.flights]
    return paired(medians, other_medians)


def _error_ratios(
    comparison: Comparison, method: str, kind: ForecastKind, seconds: float | None
) -> Array:
    """Returns the error ratio (W,) of a method in each window at one horizon.

    Args:
        comparison: errors of all methods on W windows.
        method: name of the method.
        kind: kind of forecast, by the data that it may use.
        seconds: length of the forecasts, s, one that all flights have; None for the whole test part.
    """
    ratios = []
    for window, outcome in zip(comparison.windows, comparison.outcomes_of(method), strict=True):
        scores = outcome.scores[kind]
        index = len(scores.steps) - 1
        if seconds is not None:
            # Flights with other sampling rates have other numbers of steps for the same horizon.
            shorter_horizons = np.array(scores.steps[:-1]) * window.train.dt
            index = int(np.argmin(abs(shorter_horizons - seconds)))
        ratios.append(scores.ratio[index])
    return np.array(ratios)
