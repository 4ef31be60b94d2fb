"""Comparisons in sentences and tables: of forecasting methods by paired tests, and of model orders by free energy."""

from collections.abc import Iterable, Iterator, Sequence
from math import isfinite, sqrt
from typing import NamedTuple

from mavdem.assessment.axis.findings import PREDICTION_LIMITS
from mavdem.containers import JsonValues
from mavdem.dem.learning import MIN_SAMPLES
from mavdem.dem.order_choice import LARGEST_ORDER, OrderChoice
from mavdem.experiments.compared_methods import (
    DEFAULT_METHOD,
    QUICK_METHODS,
    Method,
)
from mavdem.experiments.comparison import Comparison
from mavdem.experiments.held_out import CONSTANT_MEAN, HOLD_LAST
from mavdem.experiments.paired_test import MIN_PAIRS, SIGNIFICANCE, Paired
from mavdem.experiments.run_time import RunTimeEstimate
from mavdem.experiments.scores import KNOWN_INPUTS, UNKNOWN_INPUTS, ForecastKind
from mavdem.experiments.useful_horizons import (
    MAX_USEFUL_RATIO,
    MAX_WORSE_SHARE,
    HorizonUse,
    horizon_uses,
)
from mavdem.experiments.window import Window, disjoint_windows
from mavdem.facts.forecasts import TestResult
from mavdem.report.blocks import Block, Blocks, Sentence, Table, caution, headline_sentence
from mavdem.report.numbers import display_unit, number_with_unit, rounded, with_unit
from mavdem.report.templates import render_section

LONG_RUN = 10.0
"""Expected time of a run, s, from which it is stated before the start, with fewer methods that take less; a choice."""

MIN_DECIMAL, MAX_DECIMAL = 0.001, 1000.0
"""Limits of printed errors and p-values: beyond them only the limit is printed, since nothing depends on how far."""

TRIVIAL_METHODS = (HOLD_LAST, CONSTANT_MEAN, "zero")
"""Names of the methods without a model."""

MAX_LISTED_FLIGHTS = 2
"""Largest number of flights whose errors are listed one by one in a sentence; of more it has the range."""

STANDARD_ORDER = 3
"""Order of the model of ``mavdem learn``: angle, rate, and the lag of the motors."""


class _TestedMethod(NamedTuple):
    """A method in a sentence that compares the first method's error with its own."""

    name: str
    """Name of the method."""

    error_ratio: str
    """Its error ratio over the whole test part, as in the table."""

    p_value: str
    """p-value of the paired test with its sign, such as "= 0.04"."""


class _UselessHorizon(NamedTuple):
    """The first horizon at which forecasts are not useful, and what tells why."""

    seconds: str
    """The horizon, with its unit."""

    error_ratio: str
    """Median error ratio there, as in the table."""

    use: HorizonUse
    """How the forecasts compare with the trivial ones there."""


class _LongestUsefulHorizon(NamedTuple):
    """How far ahead forecasts are useful, and their root mean squared errors (RMSE) there."""

    seconds: str
    """The longest horizon, of those that were tried, up to which they are useful, with its unit."""

    first_useless: "_UselessHorizon | None"
    """The next horizon that was tried, at which they are not useful; None if they are useful at all."""

    output: str
    """Name of the first output, which the errors are of."""

    errors: Sequence[str]
    """RMSE of the output in each flight, in ``unit``; of more than ``MAX_LISTED_FLIGHTS`` the least and the largest."""

    unit: str
    """Unit of the errors as it stands behind a number, such as "°" or " m"."""

    is_range: bool
    """Whether the errors are the least and the largest of more flights."""


class _Rmse(NamedTuple):
    """Root mean squared errors of one method over the whole test parts of a flight."""

    method: str
    """Name of the method."""

    values: list[str]
    """Error of each output with its unit, such as "3.1°"."""


def plan_report(
    windows: Sequence[Window], methods: Sequence[Method], workers: int
) -> list[Sentence]:
    """Returns what a user should know before a comparison starts: its independent windows, and how long it takes.

    Args:
        windows: windows of one flight or several, at least one.
        methods: methods to compare.
        workers: number of processes that share the work.
    """
    run_time = RunTimeEstimate(methods, windows, workers)
    seconds = run_time.seconds_left(elapsed_seconds=0.0)
    quick_methods = [method for method in methods if method.name in QUICK_METHODS]
    quick_run_time = RunTimeEstimate(quick_methods, windows, workers)
    sentences = render_section(
        "comparison_plan",
        windows=windows,
        methods=methods,
        independent_count=len(disjoint_windows(windows)),
        min_pairs=MIN_PAIRS,
        workers=workers,
        seconds=seconds,
        slow_method=run_time.slow_method(),
        quick_names=",".join(method.name for method in quick_methods),
        quick_seconds=quick_run_time.seconds_left(elapsed_seconds=0.0),
        is_long=seconds >= LONG_RUN,
        are_fewer_quick=len(quick_methods) == len(QUICK_METHODS) < len(methods),
    )
    return sentences + _advice_on_pairs(windows)


def comparison_report(
    comparison: Comparison, planned_windows: int | None = None
) -> Iterator[Block]:
    """Yields the report of a comparison of forecasting methods: the result, tables of errors, failures, and a legend.

    All methods forecast with the recorded inputs of the test data, and some can also predict without them. Each of
    these two kinds of forecast has its own result and tables.

    Args:
        comparison: errors and paired tests of all methods; the first method is the one that the others are compared
            with.
        planned_windows: number of windows that were to be compared, if the run was stopped before; otherwise None.
    """
    kinds = [KNOWN_INPUTS]
    if comparison.methods_of(UNKNOWN_INPUTS):
        kinds.append(UNKNOWN_INPUTS)
    yield from render_section(
        "comparison_stopped", windows=len(comparison.windows), planned_windows=planned_windows
    )
    results = [_method_results(comparison, kind) for kind in kinds]
    summary = _summary_of_kinds(comparison, results)
    for sentence in summary:
        yield headline_sentence(sentence.text)
    for result in results:
        yield from _result_paragraphs(comparison, result, has_headline=bool(summary))
    yield _rmse_table(comparison, kinds)
    for flight in comparison.flights:
        yield from _flight_sentences(comparison, flight)
    # The key of the tables comes before them.
    yield from render_section(
        "comparison_legend",
        reference=comparison.methods[0],
        has_default=DEFAULT_METHOD in comparison.methods,
        are_flights_pairs=_are_flights_pairs(comparison),
        several=len(comparison.flights) > 1,
        significance=SIGNIFICANCE,
        is_use_stated=comparison.methods[0] not in TRIVIAL_METHODS,
        has_hold=HOLD_LAST in comparison.methods,
        better_share=f"{1 - MAX_WORSE_SHARE:.0%}".replace("%", " %"),
        max_ratio=MAX_USEFUL_RATIO,
    )
    for kind in kinds:
        yield from _error_blocks(comparison, kind)
    if len(comparison.flights) > 1:
        yield _table_by_flight(comparison, kinds)
    for flight in comparison.flights:
        yield from _failure_sentences(comparison, flight)
    if planned_windows is None and len(comparison.methods) > 1:
        yield from _advice_on_pairs(comparison.windows)


def _advice_on_pairs(windows: Sequence[Window]) -> list[Sentence]:
    """Returns in a sentence how to get enough windows for the paired test; empty if there are enough.

    The test needs ``MIN_PAIRS`` windows that do not overlap. A flight has room for more of them if the windows are far
    apart (--hop), or if they become shorter (--train); otherwise it takes more flights.

    Args:
        windows: windows of one flight or several, at least one.
    """
    flights = dict.fromkeys(window.flight for window in windows)
    # Windows and the samples that they cover, by flight.
    possible_pairs = 0
    window_lengths = []
    covered_lengths = []
    for flight in flights:
        windows_of_flight = [window for window in windows if window.flight == flight]
        window_length = windows_of_flight[0].stop - windows_of_flight[0].start
        covered_length = windows_of_flight[-1].stop - windows_of_flight[0].start
        possible_pairs += covered_length // window_length
        window_lengths.append(window_length)
        covered_lengths.append(covered_length)
    # The longest training part with which a single flight has room for enough windows.
    shorter_train = covered_lengths[0] // MIN_PAIRS - len(windows[0].test)
    if len(flights) > 1 or shorter_train < MIN_SAMPLES:
        shorter_train = 0
    return render_section(
        "comparison_more_pairs",
        pair_count=len(disjoint_windows(windows)),
        min_pairs=MIN_PAIRS,
        possible_pairs=possible_pairs,
        smaller_hop=max(window_lengths),
        shorter_train=shorter_train,
    )


class _MethodResults(NamedTuple):
    """Error ratios of all methods that make forecasts of a kind, and how each compares with the first one's."""

    kind: ForecastKind
    """Kind of forecast, by the data that it may use."""

    reference: str
    """The first method, with which the others are compared."""

    error_ratios: dict[str, float]
    """Error ratio of each method over the whole test part."""

    tests: dict[str, Paired]
    """Paired test of the first method against each other one; none of a method that failed in all windows."""

    failed_methods: list[str]
    """Methods that made no forecast in any window."""

    def methods_with(self, result: TestResult) -> list[str]:
        """Returns the methods whose error differs from the first method's in one way, such as significantly higher.

        Args:
            result: result of the paired test; ``TestResult.HIGHER`` says that the first method's error is higher.
        """
        return [method for method, test in self.tests.items() if test.result is result]

    @property
    def better_methods(self) -> list[str]:
        """Methods whose error is significantly lower than the first one's."""
        return self.methods_with(TestResult.HIGHER)


def _method_results(comparison: Comparison, kind: ForecastKind) -> _MethodResults:
    """Returns the error ratios of all methods, and how each compares with the first one's.

    Args:
        comparison: errors and tests of all methods.
        kind: kind of forecast, by the data that it may use.
    """
    reference = comparison.methods_of(kind)[0]
    failed_methods = []
    error_ratios = {}
    for summary in comparison.over_flights(kind):
        error_ratios[summary["method"]] = summary["relative"]
        if summary["failed"] == summary["windows"]:
            failed_methods.append(summary["method"])
    tests = {}
    for method, test in comparison.tests(kind).items():
        if method not in failed_methods and reference not in failed_methods:
            tests[method] = test
    return _MethodResults(kind, reference, error_ratios, tests, failed_methods)


def _summary_of_kinds(comparison: Comparison, results: Sequence[_MethodResults]) -> list[Sentence]:
    """Returns one headline on both kinds of forecasts, with and without knowledge of the inputs.

    It is about the first method, which the others are compared with, if that made forecasts of both kinds. Otherwise
    each kind of forecast has a headline of its own.

    Args:
        comparison: errors and tests of all methods.
        results: the results of each kind of forecast.

    Returns:
        A list with the sentence, which has the error ratio of each kind and the methods that are better; or empty.
    """
    reference = comparison.methods[0]
    for result in results:
        if result.reference != reference or reference in result.failed_methods:
            return []
    if len(results) == 1:
        return []
    return render_section(
        "comparison_summary",
        seconds=_test_length(comparison),
        reference=reference,
        is_default=reference == DEFAULT_METHOD,
        results=results,
        error_ratios=[_short_number(result.error_ratios[reference]) for result in results],
        is_trivial=reference in TRIVIAL_METHODS,
        useful_horizons=[_longest_useful_horizon(comparison, result.kind) for result in results],
    )


def _longest_useful_horizon(
    comparison: Comparison, kind: ForecastKind
) -> _LongestUsefulHorizon | None:
    """Returns how far ahead forecasts of the first method are useful, and their error there in each flight.

    A horizon counts only if the method is useful at all shorter ones, too.

    Args:
        comparison: errors of all methods.
        kind: kind of forecast, by the data that it may use.

    Returns:
        The horizon; None if the method is not useful at the shortest horizon.
    """
    reference = comparison.methods_of(kind)[0]
    longest_useful = None
    first_useless = None
    for use in horizon_uses(comparison, reference, kind):
        if not use.is_useful:
            first_useless = _UselessHorizon(
                _seconds_text(use.seconds), _short_number(use.error_ratio), use
            )
            break
        longest_useful = use
    if longest_useful is None:
        return None
    train = comparison.windows[0].train
    # The first output is the angle, which pilots compare with their own.
    unit = display_unit(train.output_units[0])
    errors = []
    for flight in comparison.flights:
        squared_error, *_ = _mean_squared_errors(
            comparison, flight, reference, kind, longest_useful.seconds
        )
        errors.append(rounded(unit.scale * sqrt(squared_error)))
    if len(errors) > MAX_LISTED_FLIGHTS:
        errors = [min(errors, key=float), max(errors, key=float)]
    return _LongestUsefulHorizon(
        seconds=_seconds_text(longest_useful.seconds),
        first_useless=first_useless,
        output=train.output_names[0],
        errors=errors,
        unit=number_with_unit("", unit.name),
        is_range=len(comparison.flights) > MAX_LISTED_FLIGHTS,
    )


def _mean_squared_errors(
    comparison: Comparison, flight: str, method: str, kind: ForecastKind, seconds: float
) -> Sequence[float]:
    """Returns the mean squared error of a method's forecasts in one flight, one for each output of the model.

    Args:
        comparison: errors of all methods.
        flight: name of the flight.
        method: name of the method.
        kind: kind of forecast, by the data that it may use.
        seconds: length of the forecasts, s. Flights with other sampling rates have horizons of nearly this length.
    """
    summaries = {summary["method"]: summary for summary in comparison.summaries(flight, kind)}
    horizons: Sequence[JsonValues] = summaries[method]["horizons"]
    nearest = min(horizons, key=lambda horizon: abs(horizon["seconds"] - seconds))
    squared_errors: Sequence[float] = nearest["mspe"]
    return squared_errors


def _result_paragraphs(
    comparison: Comparison, result: _MethodResults, *, has_headline: bool
) -> list[Sentence]:
    """Returns how the first method compares with the others, and where it is not useful.

    Args:
        comparison: errors and tests of all methods.
        result: the results of a kind of forecast.
        has_headline: whether a headline on both kinds of forecasts stands above.

    Returns:
        One paragraph below such a headline; without one, the first sentence is the headline and the rest a paragraph.
    """
    first_sentence, *details = _result_sentences(comparison, result, is_detail=has_headline)
    details += _use_sentences(comparison, result.kind, is_in_headline=has_headline)
    detail_text = " ".join(sentence.text for sentence in details)
    if has_headline:
        return [Sentence(f"{first_sentence.text} {detail_text}".strip(), first_sentence.lead)]
    headline = headline_sentence(first_sentence.text)
    return [headline, Sentence(detail_text)] if detail_text else [headline]


def _result_sentences(
    comparison: Comparison, result: _MethodResults, *, is_detail: bool
) -> list[Sentence]:
    """Returns sentences on how the error of the first method compares with the others', the headline first.

    The headline has the error ratios of the first method, of those that are better beyond chance, of the baselines, and
    of the best other method, as they stand in the table, with the p-values of the tests. The others are grouped by the
    result of their test. Methods that failed in all windows cannot be tested, and are named apart, as are those that
    make no forecasts of the kind.

    Args:
        comparison: errors and tests of all methods.
        result: the results of a kind of forecast.
        is_detail: whether these sentences follow a headline on both kinds, and so do not repeat it.
    """
    reference = result.reference
    all_benchmarks = _benchmarks(comparison, result.kind)
    # The headline names methods that are better already, and methods that failed have no test.
    benchmarks = [
        method
        for method in all_benchmarks
        if method in result.tests and method not in result.better_methods
    ]
    benchmarks.sort(key=lambda method: result.error_ratios[method])
    best_other = all_benchmarks[-1] if all_benchmarks else None
    return render_section(
        "comparison_result",
        is_detail=is_detail,
        kind=result.kind,
        forecasts=_forecasts_text(comparison, result.kind),
        reference=reference,
        is_default=reference == DEFAULT_METHOD,
        error_ratio=_short_number(result.error_ratios[reference]),
        are_flights_pairs=_are_flights_pairs(comparison),
        pair_count=min([test.tested for test in result.tests.values()], default=0),
        min_pairs=MIN_PAIRS,
        method_count=len(result.tests),
        losses=_tested_methods(result, result.better_methods),
        benchmarks=_tested_methods(result, benchmarks),
        best_other=best_other,
        # The error ratio of a constant is 1.
        is_best_other_worse=best_other is not None and result.error_ratios[best_other] > 1,
        trivial_methods=TRIVIAL_METHODS,
        lower=result.methods_with(TestResult.LOWER),
        similar=result.methods_with(TestResult.NOT_DISTINGUISHABLE),
        failed_methods=result.failed_methods,
        absent_methods=[
            method for method in comparison.methods if method not in result.error_ratios
        ],
        best_at_horizons=_better_at_shorter_horizons(comparison, result.kind),
    )


def _tested_methods(result: _MethodResults, names: Iterable[str]) -> list[_TestedMethod]:
    """Returns methods with their error ratio and the p-value of the test against the first method, both as text.

    Args:
        result: the results of a kind of forecast.
        names: names of methods that were tested.
    """
    methods = []
    for name in names:
        error_ratio = _short_number(result.error_ratios[name])
        methods.append(_TestedMethod(name, error_ratio, _p_value_text(result.tests[name])))
    return methods


def _benchmarks(comparison: Comparison, kind: ForecastKind) -> list[str]:
    """Returns the methods whose error a headline states: the baselines, and the best of all other methods.

    Args:
        comparison: errors of all methods; the first one is compared with the others.
        kind: kind of forecast, by the data that it may use.
    """
    reference, *others = comparison.methods_of(kind)
    benchmarks = [str(baseline) for baseline in (HOLD_LAST, CONSTANT_MEAN) if baseline in others]
    for summary in comparison.over_flights(kind):
        method = summary["method"]
        if method != reference and method not in benchmarks:
            return [*benchmarks, method]
    return benchmarks


def _p_value_text(test: Paired) -> str:
    """Returns the p-value of a paired test with its sign: "= 0.04", or "< 0.001"."""
    return f"< {MIN_DECIMAL:g}" if test.p_value < MIN_DECIMAL else f"= {test.p_value:.2g}"


def _are_flights_pairs(comparison: Comparison) -> bool:
    """Returns whether the pairs of the test are flights, of which there are enough; otherwise they are windows."""
    return len(comparison.flights) >= MIN_PAIRS


def _use_sentences(
    comparison: Comparison, kind: ForecastKind, *, is_in_headline: bool
) -> list[Sentence]:
    """Returns a sentence on how far ahead the first method is useful, and why not farther; none for a trivial method.

    Args:
        comparison: errors of all methods.
        kind: kind of forecast, by the data that it may use.
        is_in_headline: whether a headline says how far, so that only the reasons are left.
    """
    reference = comparison.methods_of(kind)[0]
    if reference in TRIVIAL_METHODS:
        return []
    uses = horizon_uses(comparison, reference, kind)
    useful = [use for use in uses if use.is_useful]
    return render_section(
        "comparison_use",
        useful=[_seconds_text(use.seconds) for use in useful],
        # Without an exception between them, the longest useful horizon says it all.
        is_useful_up_to_last=useful == uses[: len(useful)],
        first_useless="" if useful == uses else _seconds_text(uses[len(useful)].seconds),
        is_always_useful=useful == uses,
        is_in_headline=is_in_headline,
        # The error ratio over the whole test part, the last horizon, is stated before.
        inaccurate=[
            (_seconds_text(use.seconds), _short_number(use.error_ratio))
            for use in uses[:-1]
            if use.is_inaccurate
        ],
        hold_better=[_seconds_text(use.seconds) for use in uses if use.is_hold_better],
        often_worse=[
            (_seconds_text(use.seconds), use.worse_than_constant)
            for use in uses
            if use.is_often_worse_than_constant
        ],
        windows=uses[0].windows,
    )


def _seconds_text(seconds: float) -> str:
    """Returns a horizon with its unit: "0.25 s"."""
    return f"{seconds:.2g} s"


def _rmse_table(comparison: Comparison, kinds: Sequence[ForecastKind]) -> Table:
    """Returns a table of the forecast errors of the first method: rows of figures, a column for each horizon.

    For each kind of forecast it has the RMSE of each output, and the number of windows in which a constant forecast has
    the smaller error. For comparison, the last rows have the RMSE of holding the last value. It uses no inputs, so that
    it is the same for all kinds.

    Args:
        comparison: errors of all methods.
        kinds: kinds of forecasts, by the inputs that they may use.
    """
    method = comparison.methods[0]
    rows = []
    for kind in kinds:
        summaries = {summary["method"]: summary for summary in comparison.over_flights(kind)}
        if method not in summaries:
            # The method makes no forecasts of this kind.
            continue
        summary = summaries[method]
        rows += _rmse_rows(f"inputs {kind}", comparison, method, kind)
        worse_counts = [str(count) for count in summary["horizons_worse"]]
        worse_label = f"inputs {kind}: worse than constant, of {summary['windows']}"
        rows.append([worse_label, *worse_counts])
    if method != HOLD_LAST and HOLD_LAST in comparison.methods_of(KNOWN_INPUTS):
        rows += _rmse_rows(HOLD_LAST, comparison, HOLD_LAST, KNOWN_INPUTS)
    return Table([f"{method}, by horizon (s)", *_horizon_header(comparison, kinds[0])], rows)


def _rmse_rows(
    label: str, comparison: Comparison, method: str, kind: ForecastKind
) -> list[list[str]]:
    """Returns the rows of a table with the RMSE of one method by horizon, one for each output.

    Args:
        label: what the rows begin with: the kind of forecast, or the method.
        comparison: errors of all methods.
        method: name of the method.
        kind: kind of forecast, by the data that it may use.

    Returns:
        The rows; a cell has the RMSE of the flight or, of several, the least to the largest, such as "1.1–2.3".
    """
    train = comparison.windows[0].train
    horizons = comparison.over_flights(kind)[0]["horizon_seconds"]
    rows = []
    for index, output in enumerate(train.output_names):
        unit = display_unit(train.output_units[index])
        row = [f"{label}: RMSE of {output} ({unit.name})"]
        for seconds in horizons:
            errors = []
            for flight in comparison.flights:
                squared_errors = _mean_squared_errors(comparison, flight, method, kind, seconds)
                errors.append(unit.scale * sqrt(squared_errors[index]))
            row.append(_range_text(errors))
        rows.append(row)
    return rows


def _range_text(numbers: Sequence[float]) -> str:
    """Returns the least to the largest of some numbers, such as "1.1–2.3"; one number where both are shown alike."""
    least, largest = _short_number(min(numbers)), _short_number(max(numbers))
    return least if least == largest else f"{least}–{largest}"


def _horizon_header(comparison: Comparison, kind: ForecastKind) -> list[str]:
    """Returns the header of the columns with a value by horizon, s; the last is the length of the test part.

    Args:
        comparison: errors of all methods.
        kind: kind of forecast, by the data that it may use.
    """
    horizons = comparison.over_flights(kind)[0]["horizon_seconds"][:-1]
    return [*(f"{seconds:.2g}" for seconds in horizons), _test_length(comparison)]


def _better_at_shorter_horizons(comparison: Comparison, kind: ForecastKind) -> dict[str, list[str]]:
    """Returns the horizons at which a method other than the first has the lowest error ratio, by that method.

    Args:
        comparison: errors of all methods.
        kind: kind of forecast, by the data that it may use.

    Returns:
        Horizons with their unit by name of the method, without the last horizon, which has a paired test.
    """
    reference = comparison.methods_of(kind)[0]
    summaries = comparison.over_flights(kind)
    horizons_by_method: dict[str, list[str]] = {}
    for index, seconds in enumerate(summaries[0]["horizon_seconds"][:-1]):
        error_ratios = {summary["method"]: summary["horizons"][index] for summary in summaries}
        best_method = min(error_ratios, key=lambda method: error_ratios[method])
        best_ratio = error_ratios[best_method]
        # What the table shows as equal is not called lower.
        is_shown_lower = _short_number(best_ratio) != _short_number(error_ratios[reference])
        if best_ratio < error_ratios[reference] and is_shown_lower:
            horizons_by_method.setdefault(best_method, []).append(_seconds_text(seconds))
    return horizons_by_method


def _forecasts_text(comparison: Comparison, kind: ForecastKind) -> str:
    """Returns what forecasts of a kind are called, with their length: "Forecasts of 1.5 s, inputs known".

    Args:
        comparison: outcomes of all methods on windows of one flight or several.
        kind: kind of forecast, by the data that it may use.
    """
    return f"Forecasts of {_test_length(comparison)} s, inputs {kind}"


def _test_length(comparison: Comparison) -> str:
    """Returns the length of the test parts as text, s: "1.5", or "1.5–3" where those of flights differ."""
    lengths = [len(window.test) * window.test.dt for window in comparison.windows]
    shortest = f"{min(lengths):.2g}"
    longest = f"{max(lengths):.2g}"
    return shortest if shortest == longest else f"{shortest}–{longest}"


def _error_blocks(comparison: Comparison, kind: ForecastKind) -> Blocks:
    """Returns the table with the errors of all forecasting methods.

    The first method is the reference, with which each other one is compared by a paired test. A caution stands before
    the table if the 90 % band of the reference holds too few of the samples.

    Args:
        comparison: errors and tests of all methods.
        kind: kind of forecast, by the data that it may use.
    """
    reference = comparison.methods_of(kind)[0]
    tests = comparison.tests(kind)
    blocks: Blocks = []
    rows = []
    for summary in comparison.over_flights(kind):
        method = summary["method"]
        rows.append(_error_row(summary, tests.get(method)))
        if method == reference and _is_band_too_narrow(summary):
            text = f"the 90 % band of {reference} holds {_coverage(summary)} of the samples: it is too narrow."
            blocks.append(caution(text))
    header = [
        f"error ratio, inputs {kind}",
        *_horizon_header(comparison, kind),
        ">1",
        "lower in",
        "p",
        "unstable",
        "band",
    ]
    blocks.append(Table(header, rows))
    return blocks


def _table_by_flight(comparison: Comparison, kinds: Sequence[ForecastKind]) -> Table:
    """Returns a table with each method's error ratio over the whole test part in each flight.

    Args:
        comparison: errors of all methods on windows of several flights.
        kinds: kinds of forecasts, by the data that they may use; a method that makes none of a kind has empty cells.
    """
    methods = [summary["method"] for summary in comparison.over_flights(kinds[0])]
    rows = []
    for kind in kinds:
        for flight in comparison.flights:
            ratios = {}
            for summary in comparison.summaries(flight, kind):
                ratios[summary["method"]] = _short_number(summary["relative"])
            cells = [ratios.get(method, "") for method in methods]
            rows.append([f"{flight}, inputs {kind}", *cells])
    title = f"error ratio over {_test_length(comparison)} s"
    return Table([title, *map(_marked_name, methods)], rows)


def _error_row(summary: JsonValues, test: Paired | None) -> list[str]:
    """Returns the row of one forecasting method in the table of errors.

    Args:
        summary: figures of the method over all flights, by key (``Comparison.over_flights``).
        test: paired test of the reference method against this one; None for the reference itself.

    Returns:
        The name; the error ratio (NMSE) at each horizon; the number of windows with an error ratio above 1; the number
        of pairs in which the reference has the lower error, such as "9/13"; the p-value of the test; the number of
        windows with an unstable model; and the percentage of samples in the 90 % band.
    """
    row = [_marked_name(summary["method"])]
    for error_ratio in summary["horizons"]:
        row.append(_short_number(error_ratio))
    row.append(str(summary["worse_than_constant"]))
    if test is None:
        row += ["", ""]
    else:
        row += [f"{test.less}/{test.windows}", _short_number(test.p_value)]
    return [*row, str(summary["unstable"]), _coverage(summary)]


def _marked_name(method: str) -> str:
    """Returns the name of a method in a table, with a mark behind that of mavdem's default."""
    return f"{method} *" if method == DEFAULT_METHOD else method


def _short_number(number: float) -> str:
    """Returns a number with two significant digits, at most six characters: "0.013", "2.5", "<0.001", "inf"."""
    if 0 < number < MIN_DECIMAL:
        return f"<{MIN_DECIMAL:g}"
    if isfinite(number) and number >= MAX_DECIMAL:
        return f">{MAX_DECIMAL:g}"
    # Rounding to two digits by ".2g" alone would print 120 as 1.2e+02.
    return f"{float(f'{number:.2g}'):.4g}"


def _coverage(summary: JsonValues) -> str:
    """Returns the share of samples in a method's 90 % band as percent; empty for a method without a band."""
    # The last horizon is the whole test data.
    share_in_band = summary["inside"][-1]
    return "" if share_in_band is None else f"{100 * share_in_band:.0f} %"


def _is_band_too_narrow(summary: JsonValues) -> bool:
    """Returns whether a method has a 90 % band that holds clearly fewer samples (``PREDICTION_LIMITS``)."""
    share_in_band = summary["inside"][-1]
    return share_in_band is not None and share_in_band < PREDICTION_LIMITS.coverage


def _flight_sentences(comparison: Comparison, flight: str) -> Iterator[Block]:
    """Yields a sentence on one flight: its windows and, of several, the RMSE of the first method and the baselines.

    A flight is divided into windows of training and test data. Paired tests use only windows that do not overlap.

    Args:
        comparison: errors of all methods in all windows.
        flight: name of the flight.
    """
    windows = [window for window in comparison.windows if window.flight == flight]
    # All windows of a flight have the same length, so that the first one stands for them.
    yield from render_section(
        "comparison_flight",
        windows[0],
        window_count=len(windows),
        independent_count=len(disjoint_windows(windows)),
        # The table of a single flight has them.
        errors=_rmse_by_method(comparison, flight) if len(comparison.flights) > 1 else (),
    )


def _rmse_by_method(comparison: Comparison, flight: str) -> list[_Rmse]:
    """Returns the RMSE, with known inputs, of the first method and of the baselines that are compared.

    Args:
        comparison: errors of all methods in all windows.
        flight: name of the flight.
    """
    summaries = {summary["method"]: summary for summary in comparison.summaries(flight)}
    units = comparison.of_flight(flight).windows[0].train.output_units
    rmse = []
    for method in dict.fromkeys((comparison.methods[0], HOLD_LAST, CONSTANT_MEAN)):
        if method in summaries:
            values = []
            for squared_error, unit in zip(summaries[method]["mspe"], units, strict=True):
                values.append(with_unit(sqrt(squared_error), display_unit(unit)))
            rmse.append(_Rmse(str(method), values))
    return rmse


def _failure_sentences(comparison: Comparison, flight: str) -> Iterator[Block]:
    """Yields a sentence for each method that made no forecast, or a diverged one, in windows of one flight.

    Args:
        comparison: errors of all methods in all windows.
        flight: name of the flight.
    """
    for summary in comparison.summaries(flight):
        yield from render_section("comparison_failures", **summary)


def order_report(choice: OrderChoice, names: Sequence[str], are_inputs_known: bool) -> Blocks:
    """Returns the report on how many states a model should have: the reason, a table, and what to do with the result.

    The table has the free energy F̄ of each number of states (order) in each flight. F̄ is a bound of the log evidence of
    such a model. Only differences of it have a meaning, so that it is shown relative to the chosen order.

    Args:
        choice: the chosen order, with the free energy of all orders.
        names: names of the flights, one for each row of ``choice.free_energy``.
        are_inputs_known: whether the models know the inputs of the flight, as causes of its motion.
    """
    blocks: Blocks = [headline_sentence(choice.reason), _free_energy_table(choice, names)]
    legend = "F̄ in nats, minus that of the chosen order; spread: standard deviation over flights."
    blocks.append(Sentence(legend))
    blocks += [caution(remark) for remark in choice.remarks]
    blocks.append(Sentence(order_advice(choice, are_inputs_known), lead="Next:"))
    return blocks


def _free_energy_table(choice: OrderChoice, names: Sequence[str]) -> Table:
    """Returns a table of the free energy F̄ of each order in each flight, nats, relative to the chosen order.

    Args:
        choice: the chosen order, with the free energy of all orders.
        names: names of the flights, one for each row of ``choice.free_energy``. Of several flights the table also has
            the mean and the standard deviation.
    """
    has_several_flights = len(names) > 1
    # Orders count from 1, the columns of ``choice.free_energy`` from 0.
    chosen_column = choice.chosen - 1
    relative_energy = choice.free_energy - choice.free_energy[:, [chosen_column]]
    relative_mean = choice.mean - choice.mean[chosen_column]
    rows = []
    for column, order in enumerate(choice.orders):
        energies = list(relative_energy[:, column])
        if has_several_flights:
            energies += [relative_mean[column], choice.spread[column]]
        row = [f"{order}"]
        if order == choice.chosen:
            row = [f"{order} (chosen)"]
        for energy in energies:
            row.append(f"{energy:,.1f}" if isfinite(energy) else "-")
        rows.append(row)
    header = ["states", *names]
    if has_several_flights:
        header += ["mean", "spread"]
    return Table(header, rows)


def order_advice(choice: OrderChoice, are_inputs_known: bool) -> str:
    """Returns one sentence on what to do with the chosen order, such as to learn a model with ``--order``.

    Args:
        choice: the chosen number of states, with the free energy of all numbers.
        are_inputs_known: whether the models have the recorded inputs, such as motor outputs, as causes of the motion;
            otherwise they estimate the inputs too.
    """
    (paragraph,) = render_section(
        "order_advice",
        choice=choice,
        known_inputs=are_inputs_known,
        largest=LARGEST_ORDER,
        standard=STANDARD_ORDER,
    )
    return paragraph.text
