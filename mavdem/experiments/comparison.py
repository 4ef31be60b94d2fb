"""Comparison of forecasting methods: all are trained and tested on the same windows of flights, then tested in pairs.

The error ratio of a window is its squared error over the constant mean's, on the whole test part. A flight has
the median over its windows, because a single diverged forecast would determine a mean; the worst window is stated
beside it. Over flights it is the geometric mean of these medians, so that each flight counts once.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import cached_property
from math import isclose
from operator import itemgetter

import numpy as np

from mavdem.containers import JsonValues, Names
from mavdem.dem.parallel import parallel_map
from mavdem.experiments.compared_methods import METHODS, Method
from mavdem.experiments.held_out import Progress
from mavdem.experiments.outcomes import Outcome, run_trial
from mavdem.experiments.paired_test import (
    MIN_PAIRS,
    Paired,
    TypicalRatio,
    paired,
    typical_ratio,
)
from mavdem.experiments.scores import (
    FROM_STATE_ZERO,
    KNOWN_INPUTS,
    UNKNOWN_INPUTS,
    ForecastKind,
)
from mavdem.experiments.window import Window, disjoint_windows

WindowOutcomes = tuple[Outcome, ...]
"""The outcomes of all methods in one window, in the order of the methods."""

HORIZON_TOLERANCE = 0.1
"""Relative difference of two flights' horizons up to which they count as the same one; a choice.

Horizons are whole samples, so that flights of different rates differ by up to half a sample.
"""

COUNTS = ("windows", "failed", "diverged", "unstable", "worse_than_constant")
"""Keys of a summary that are numbers of windows; they are summed over flights."""


def compare(
    windows: Sequence[Window],
    methods: Sequence[Method] = METHODS,
    progress: Progress = lambda _: None,
) -> Comparison:
    """Runs all methods on all windows and compares the first method with each of the others.

    Each pair of a method and a window is an independent trial, and the trials are distributed over worker processes,
    one per core. A worker imports the running script: call this function below ``if __name__ == "__main__":``.

    Args:
        windows: windows of one flight or several, at least one.
        methods: methods to compare, the reference first.
        progress: function that is called with the completed fraction of the trials, 0 to 1.

    Returns:
        Outcomes of all methods in each window.

    Raises:
        ValueError: ``windows`` is empty.
        concurrent.futures.BrokenExecutor: a worker died, for example for lack of memory.
    """
    if not windows:
        raise ValueError("windows must be one at least")
    trial_count = len(windows) * len(methods)
    completed_count = 0

    def count_outcome(outcome: Outcome) -> None:
        nonlocal completed_count
        completed_count += 1
        progress(completed_count / trial_count)

    outcomes = list(outcomes_by_window(windows, methods, count_outcome))
    return comparison_of_outcomes(windows, methods, outcomes)


def outcomes_by_window(
    windows: Sequence[Window],
    methods: Sequence[Method],
    on_outcome: Callable[[Outcome], None] = lambda _: None,
) -> Generator[WindowOutcomes, None, None]:
    """Runs all methods on one window after another; :func:`compare` says how.

    A caller that stops early has the outcomes of all windows that are complete by then.

    Args:
        windows: windows of one flight or several.
        methods: methods to compare.
        on_outcome: function that is called with each outcome, window by window in the order of the methods.

    Yields:
        The outcomes of all methods in each window, in the order of ``windows``.

    Raises:
        concurrent.futures.BrokenExecutor: a worker died, for example for lack of memory.
    """
    trials = [(method, window) for window in windows for method in methods]
    # The outcomes come in the order of the trials: all methods of a window one after the other.
    outcomes_of_window: list[Outcome] = []
    with closing(parallel_map(run_trial, trials)) as trial_outcomes:
        for outcome in trial_outcomes:
            outcomes_of_window.append(outcome)
            on_outcome(outcome)
            if len(outcomes_of_window) == len(methods):
                yield tuple(outcomes_of_window)
                outcomes_of_window = []


def comparison_of_outcomes(
    windows: Sequence[Window], methods: Sequence[Method], outcomes: Sequence[WindowOutcomes]
) -> Comparison:
    """Returns the comparison on the windows that have outcomes.

    Args:
        windows: all windows.
        methods: the methods that were compared, the reference first.
        outcomes: outcomes of all methods in the first windows, or in all, as :func:`outcomes_by_window` yields them.
    """
    names = tuple(method.name for method in methods)
    return Comparison(tuple(windows[: len(outcomes)]), names, tuple(outcomes))


@dataclass(frozen=True, eq=False)
class Comparison:
    """All outcomes of methods on windows, and their summaries.

    The first of the methods is compared with each of the others.

    Attributes:
        windows: windows of all flights; all windows of one flight have the same number of samples.
        methods: names of the methods.
        outcomes: a tuple for each window, with the outcome of each method in the order of ``methods``.
    """

    windows: tuple[Window, ...]
    methods: Names
    outcomes: tuple[WindowOutcomes, ...]

    @cached_property
    def flights(self) -> Names:
        """The names of the flights, in order of appearance."""
        return tuple(dict.fromkeys(window.flight for window in self.windows))

    def methods_of(self, kind: ForecastKind) -> Names:
        """Returns the names of the methods that make forecasts of a kind.

        Args:
            kind: kind of forecast, by the data that it may use.
        """
        return tuple(outcome.method for outcome in self.outcomes[0] if kind in outcome.scores)

    def of_flight(self, flight: str) -> Comparison:
        """Returns the comparison of the methods on the windows of one flight only.

        Args:
            flight: name of the flight.

        Returns:
            The comparison with the windows of the flight only.
        """
        windows = []
        outcomes = []
        for window, window_outcomes in zip(self.windows, self.outcomes, strict=True):
            if window.flight == flight:
                windows.append(window)
                outcomes.append(window_outcomes)
        return Comparison(tuple(windows), self.methods, tuple(outcomes))

    def with_reference(self, method: str) -> Comparison:
        """Returns the comparison with another method in the first place, with which tests compare the others.

        Args:
            method: name of the method that becomes the first; the others keep their order.
        """
        first = self.methods.index(method)
        others = [index for index in range(len(self.methods)) if index != first]
        order = [first, *others]
        methods = tuple(self.methods[index] for index in order)
        outcomes = []
        for outcomes_in_window in self.outcomes:
            outcomes.append(tuple(outcomes_in_window[index] for index in order))
        return Comparison(self.windows, methods, tuple(outcomes))

    def summaries(self, flight: str, kind: ForecastKind = KNOWN_INPUTS) -> tuple[JsonValues, ...]:
        """Returns a summary of each method over the windows of one flight, the lowest median error ratio first.

        The error ratio of a forecast is its mean squared error over the constant mean's (NMSE), on the whole test
        part of a window unless stated otherwise.

        Args:
            flight: name of the flight.
            kind: kind of forecast, by the data that it may use.

        Returns:
            For each method a dictionary with these keys:

            - ``method``: name of the method.
            - ``windows``: number of windows.
            - ``failed``: number of windows without a forecast.
            - ``failure``: why the first of these has none; None if none failed.
            - ``diverged``: number of windows with a forecast of infinite error.
            - ``unstable``: number of windows in which the trained model is unstable.
            - ``worse_than_constant``: number of windows with an error ratio above 1.
            - ``mspe``, ``mspe_total``: mean squared error per output and in total, means over windows, as in the paper.
            - ``relative``, ``worst``: median and largest error ratio over the windows.
            - ``seconds``: median processor time of the training, s.
            - ``horizons``: a dictionary for each horizon, the last for the whole test part: its length in ``steps`` and
              in ``seconds``; ``relative``, the median error ratio; ``mspe`` and ``worse_than_constant`` as above;
              ``inside``, the mean share of samples in the 90 % band, None without one; and ``reference``, the paired
              test of the first method against this one (:class:`mavdem.evaluate.Paired`).
        """
        return self._summaries[flight, kind]

    def outcomes_of(self, method: str) -> tuple[Outcome, ...]:
        """Returns the outcomes of a method, in the order of the windows.

        Args:
            method: name of the method.
        """
        return self._outcomes_by_method[method]

    @cached_property
    def _outcomes_by_method(self) -> dict[str, tuple[Outcome, ...]]:
        """The outcomes of each method, in the order of the windows."""
        columns = zip(*self.outcomes, strict=True)
        return dict(zip(self.methods, columns, strict=True))

    @cached_property
    def _summaries(self) -> dict[tuple[str, ForecastKind], tuple[JsonValues, ...]]:
        """Summaries of all methods, computed once for all flights, since tests and documents use them several times.

        The keys are the name of the flight and the kind of forecast. The values are what :meth:`summaries` returns: a
        dictionary for each method with its errors over the windows of the flight.
        """
        summaries = {}
        for flight in self.flights:
            comparison_on_flight = self.of_flight(flight)
            for kind in ForecastKind:
                summaries[flight, kind] = comparison_on_flight._sorted_summaries(kind)
        return summaries

    def _sorted_summaries(self, kind: ForecastKind) -> tuple[JsonValues, ...]:
        """Returns the summaries of all methods over the windows of this comparison, the lowest error ratio first.

        Args:
            kind: kind of forecast, by the data that it may use.

        Returns:
            A summary for each method, as JSON values.
        """
        methods = self.methods_of(kind)
        # All methods are compared with the first one. If no method makes forecasts of this kind, there is no summary.
        summaries = [self._summary(method, kind, reference=methods[0]) for method in methods]
        # The error ratio has the key "relative" in the published summaries.
        return tuple(sorted(summaries, key=itemgetter("relative")))

    def _summary(self, method: str, kind: ForecastKind, reference: str) -> JsonValues:
        """Returns the summary of a method over all windows; :meth:`summaries` explains its keys.

        Args:
            method: name of the method.
            kind: kind of forecast, by the data that it may use.
            reference: name of the method that it is compared with.

        Returns:
            Values by key.
        """
        outcomes = self._outcomes_by_method[method]
        failures = [outcome.failure for outcome in outcomes if outcome.failure is not None]
        diverged_count = 0
        for outcome in outcomes:
            if outcome.failure is None and not np.isfinite(outcome.mspe(kind)).all():
                diverged_count += 1
        ratios = np.array(self._whole_test_ratios(method, kind))
        # The last horizon is the whole test part. Squared errors have the shape (windows, outputs).
        squared_errors = np.array([outcome.scores[kind].squared_error[-1] for outcome in outcomes])
        mean_errors = squared_errors.mean(axis=0)
        return {
            "method": method,
            "windows": len(outcomes),
            "failed": len(failures),
            "failure": failures[0] if failures else None,
            "diverged": diverged_count,
            "unstable": sum(outcome.stable is False for outcome in outcomes),
            "mspe": mean_errors.tolist(),
            "mspe_total": mean_errors.sum(),
            "relative": np.median(ratios),
            "worst": ratios.max(),
            "worse_than_constant": int((ratios > 1).sum()),
            "horizons": self._horizon_summaries(method, kind, reference),
            "seconds": np.median([outcome.seconds for outcome in outcomes]),
        }

    def _horizon_summaries(
        self, method: str, kind: ForecastKind, reference: str
    ) -> list[JsonValues]:
        """Returns the summary of a method's forecasts at each horizon, over all windows.

        Args:
            method: name of the method.
            kind: kind of forecast, by the data that it may use.
            reference: name of the method that it is compared with.
        """
        scores = [outcome.scores[kind] for outcome in self._outcomes_by_method[method]]
        # Ratios and shares have the shape (windows, horizons), squared errors (windows, horizons, outputs).
        ratios = np.array([window_scores.ratio for window_scores in scores])
        squared_errors = np.array([window_scores.squared_error for window_scores in scores])
        inside_shares = np.array([window_scores.inside for window_scores in scores])
        reference_outcomes = self._outcomes_by_method[reference]
        reference_ratios = np.array([outcome.scores[kind].ratio for outcome in reference_outcomes])
        summaries = []
        for index, steps in enumerate(scores[0].steps):
            summaries.append(
                {
                    "steps": steps,
                    "seconds": steps * self.windows[0].train.dt,
                    "relative": np.median(ratios[:, index]),
                    "mspe": squared_errors[:, index].mean(axis=0).tolist(),
                    "worse_than_constant": int((ratios[:, index] > 1).sum()),
                    "reference": paired(reference_ratios[:, index], ratios[:, index], self.windows),
                    "inside": known_mean(inside_shares[:, index].tolist()),
                }
            )
        return summaries

    @property
    def are_flights_pairs(self) -> bool:
        """Whether paired tests compare whole flights; if there are too few, they compare windows of flights."""
        return len(self.flights) >= MIN_PAIRS

    def tests(self, kind: ForecastKind = KNOWN_INPUTS) -> dict[str, Paired]:
        """Tests, for each other method, whether its errors over the whole test part differ from the first method's.

        The test compares pairs of errors. A pair is a flight, with one error of each method, because the windows of one
        flight resemble each other. With fewer than ``MIN_PAIRS`` flights no test could find a difference, so that each
        window is a pair instead.

        Args:
            kind: kind of forecast, by the data that it may use.

        Returns:
            The result by name of the other method, with the first method's error over the other's.
        """
        first_method, *other_methods = self.methods_of(kind)
        tests = {}
        if self.are_flights_pairs:
            for summary in self.over_flights(kind):
                method = summary["method"]
                if method != first_method:
                    # The summary over flights has the result of the test already.
                    tests[method] = summary["reference"]
            return tests
        first_ratios = self._whole_test_ratios(first_method, kind)
        for method in other_methods:
            ratios = self._whole_test_ratios(method, kind)
            tests[method] = paired(first_ratios, ratios, self.windows)
        return tests

    def typical_ratio(self, method: str, better: str, kind: ForecastKind) -> TypicalRatio | None:
        """Returns how much larger a method's errors are than a better one's, and from which ratio that is significant.

        Args:
            method: name of the method with the larger errors.
            better: name of the method with the smaller errors.
            kind: kind of forecast, by the data that it may use.

        Returns:
            Both ratios, by the errors that :meth:`tests` uses; None if a method made no forecast in one of the windows.
        """
        return typical_ratio(
            self._independent_ratios(method, kind), self._independent_ratios(better, kind)
        )

    def _independent_ratios(self, method: str, kind: ForecastKind) -> list[float]:
        """Collects the error ratios of a method that :meth:`tests` uses: of each flight, or of disjoint windows."""
        if self.are_flights_pairs:
            ratios_of_flights = []
            for flight in self.flights:
                for summary in self.summaries(flight, kind):
                    if summary["method"] == method:
                        ratios_of_flights.append(summary["relative"])
            return ratios_of_flights
        ratios = self._whole_test_ratios(method, kind)
        return [ratios[index] for index in disjoint_windows(self.windows)]

    def _whole_test_ratios(self, method: str, kind: ForecastKind) -> list[float]:
        """Collects the error ratio of a method over the whole test part.

        Args:
            method: name of the method.
            kind: kind of forecast, by the data that it may use.

        Returns:
            One ratio for each window.
        """
        return [outcome.scores[kind].ratio[-1] for outcome in self._outcomes_by_method[method]]

    def over_flights(self, kind: ForecastKind = KNOWN_INPUTS) -> tuple[JsonValues, ...]:
        """Returns each method's summary over all flights, the lowest error first; each flight counts the same.

        Args:
            kind: kind of forecast, by the data that it may use.

        Returns:
            Plain values by name:

            - ``method``: name of the method.
            - ``flights``: number of flights.
            - ``relative``: geometric mean over flights of their median error ratio.
            - ``horizon_seconds``, ``horizons``, ``horizons_mspe``, ``horizons_worse``, ``inside``: lists with a value
              per horizon that all flights have, the last for the whole test part: its mean length, s; the geometric
              mean of the median error ratios; the mean squared error of each output, mean over flights; the number of
              windows with an error ratio above 1; and the mean share of samples in the 90 % band.
            - ``windows``, ``failed``, ``diverged``, ``unstable``, ``worse_than_constant``: sums of the numbers
              of windows.
            - ``mspe_total``: sum over flights.
            - ``reference``: the first method compared with this one, where each flight is one pair of ``relative``.
        """
        methods = self.methods_of(kind)
        summaries_by_method: dict[str, list[JsonValues]] = {method: [] for method in methods}
        for flight in self.flights:
            for summary in self.summaries(flight, kind):
                summaries_by_method[summary["method"]].append(summary)
        overall = []
        for method in methods:
            # All methods are compared with the first one.
            overall.append(
                overall_summary(summaries_by_method[method], summaries_by_method[methods[0]])
            )
        return tuple(sorted(overall, key=itemgetter("relative")))

    def to_dict(self, kind: ForecastKind = KNOWN_INPUTS) -> JsonValues:
        """Returns the comparison as values of a document; infinite errors stay infinite.

        Args:
            kind: kind of forecast, by the data that it may use.

        Returns:
            Values by name:

            - ``reference``: name of the first method; ``methods``: names of all that make forecasts of the kind.
            - ``start``: "zero" for forecasts from state 0, otherwise "data".
            - ``verdicts``: results of :meth:`tests`.
            - ``over_flights``: results of :meth:`over_flights`.
            - ``flights``: for each flight its summaries and single outcomes (``_flight_values``).
            - ``predictions``: the same dictionary for predictions, which are forecasts without knowledge of the future
              inputs. None if no method makes them, and in the dictionary of the predictions itself.
        """
        # The dictionary of the predictions is made by this method too, and then contains no other one.
        predicting_methods = self.methods_of(UNKNOWN_INPUTS)
        has_predictions = kind != UNKNOWN_INPUTS and bool(predicting_methods)
        return {
            "reference": self.methods_of(kind)[0],
            "methods": self.methods_of(kind),
            "start": "zero" if kind == FROM_STATE_ZERO else "data",
            "verdicts": self.tests(kind),
            "over_flights": self.over_flights(kind),
            "flights": [self._flight_values(flight, kind) for flight in self.flights],
            "predictions": self.to_dict(UNKNOWN_INPUTS) if has_predictions else None,
        }

    def _flight_values(self, flight: str, kind: ForecastKind) -> JsonValues:
        """Returns the values of one flight for the document.

        Args:
            flight: name of the flight.
            kind: kind of forecast, by the data that it may use.

        Returns:
            What was sampled (``dt`` in s, names and units of the outputs), numbers of samples of the training data and
            of the forecasts, ``standings`` (the results of :meth:`summaries`), and ``windows``: for each its first
            sample, its time in s, and the outcome of each method by name.
        """
        comparison = self.of_flight(flight)
        train = comparison.windows[0].train
        test = comparison.windows[0].test
        methods = self.methods_of(kind)
        windows = []
        for window, outcomes in zip(comparison.windows, comparison.outcomes, strict=True):
            outcomes_by_method = {}
            for outcome in outcomes:
                if outcome.method in methods:
                    outcomes_by_method[outcome.method] = outcome.to_dict(kind)
            windows.append(
                {
                    "start": window.start,
                    "time": window.train.time[0],
                    "methods": outcomes_by_method,
                }
            )
        return {
            "flight": flight,
            "dt": train.dt,
            "outputs": train.output_names,
            "output_units": train.output_units,
            "training_samples": len(train),
            "forecast_samples": len(test),
            "standings": self.summaries(flight, kind),
            "windows": windows,
        }


def overall_summary(
    flight_summaries: Sequence[JsonValues], reference_summaries: Sequence[JsonValues]
) -> JsonValues:
    """Averages the summaries of one method over several flights, so that each flight counts the same.

    Error ratios are averaged geometrically, squared errors and fractions of samples inside the 90 % band
    arithmetically, and numbers of windows are added up. The paired test is of whether the method's error differs from
    that of the reference, the first method of the comparison, in flights in general: its pairs are the median error
    ratios of flights and not of windows, since windows of one flight resemble each other.

    Args:
        flight_summaries: summaries of the method, one for each flight, as :meth:`Comparison.summaries` returns them.
        reference_summaries: those of the reference, in the same order of flights.

    Returns:
        Values by name; :meth:`Comparison.over_flights` explains them.
    """
    horizons = _common_horizons([summary["horizons"] for summary in flight_summaries])
    horizon_seconds = []
    error_ratios = []
    squared_errors = []
    worse_counts = []
    fractions_inside = []
    for at_horizon in horizons:
        horizon_seconds.append(np.mean([values["seconds"] for values in at_horizon]))
        error_ratios.append(geometric_mean([values["relative"] for values in at_horizon]))
        squared_errors.append(np.mean([values["mspe"] for values in at_horizon], axis=0).tolist())
        worse_counts.append(sum(values["worse_than_constant"] for values in at_horizon))
        fractions_inside.append(known_mean(values["inside"] for values in at_horizon))
    ratios_by_flight = [summary["relative"] for summary in flight_summaries]
    reference_ratios_by_flight = [summary["relative"] for summary in reference_summaries]
    counts = {}
    for name in COUNTS:
        counts[name] = sum(summary[name] for summary in flight_summaries)
    return {
        "method": flight_summaries[0]["method"],
        "flights": len(flight_summaries),
        "relative": geometric_mean(ratios_by_flight),
        "horizon_seconds": horizon_seconds,
        "horizons": error_ratios,
        "horizons_mspe": squared_errors,
        "horizons_worse": worse_counts,
        "inside": fractions_inside,
        **counts,
        "mspe_total": np.sum([summary["mspe_total"] for summary in flight_summaries]),
        "reference": paired(reference_ratios_by_flight, ratios_by_flight),
    }


def _common_horizons(horizons_by_flight: Sequence[Sequence[JsonValues]]) -> list[list[JsonValues]]:
    """Matches the horizons of flights that may have other sampling rates, by their length in seconds.

    Args:
        horizons_by_flight: values of each horizon of each flight, the last for the whole test part.

    Returns:
        Values of each flight at one horizon after the other. A horizon that one of the flights lacks is left out. The
        last one is the whole test part, whatever its length.
    """
    horizons = []
    for first_values in horizons_by_flight[0][:-1]:
        at_horizon = []
        for horizons_of_flight in horizons_by_flight:
            for values in horizons_of_flight[:-1]:
                if isclose(values["seconds"], first_values["seconds"], rel_tol=HORIZON_TOLERANCE):
                    at_horizon.append(values)
        if len(at_horizon) == len(horizons_by_flight):
            horizons.append(at_horizon)
    horizons.append([horizons_of_flight[-1] for horizons_of_flight in horizons_by_flight])
    return horizons


def known_mean(values: Iterable[float | None]) -> float | None:
    """Returns the mean of the values that are neither ``None`` nor NaN; ``None`` if there are none."""
    known_values = [value for value in values if value is not None and not np.isnan(value)]
    if not known_values:
        return None
    return float(np.mean(known_values))


def geometric_mean(values: Sequence[float]) -> float:
    """Returns the geometric mean of values that are at least 0, of which some may be infinite."""
    with np.errstate(divide="ignore"):
        return np.exp(np.mean(np.log(values)))
