"""Comparisons in sentences and tables: of forecasting methods by paired tests, and of model orders by free energy."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from math import isclose, isfinite, sqrt
from statistics import median
from types import MappingProxyType
from typing import NamedTuple

from mavdem.assessment.axis.findings import PREDICTION_LIMITS
from mavdem.containers import JsonValues
from mavdem.dem.learning import MIN_SAMPLES
from mavdem.dem.order_choice import LARGEST_ORDER, OrderChoice
from mavdem.experiments.compared_methods import (
    DEFAULT_METHOD,
    QUICK_METHOD_NAMES,
    Method,
)
from mavdem.experiments.comparison import HORIZON_TOLERANCE, Comparison
from mavdem.experiments.held_out import CONSTANT_MEAN, HOLD_LAST
from mavdem.experiments.horizon_differences import (
    HorizonDifference,
    horizon_differences,
    shown_differences,
)
from mavdem.experiments.paired_test import (
    MIN_PAIRS,
    SIGNIFICANCE,
    Paired,
    are_significant_together,
)
from mavdem.experiments.run_time import RunTimeEstimate
from mavdem.experiments.scores import KNOWN_INPUTS, UNKNOWN_INPUTS, ForecastKind
from mavdem.experiments.useful_horizons import (
    MAX_USEFUL_RATIO,
    MAX_WORSE_SHARE,
    HorizonUse,
    horizon_uses,
)
from mavdem.experiments.window import Window, disjoint_windows
from mavdem.experiments.worse_windows import worse_windows
from mavdem.facts.forecasts import MethodName, TestResult
from mavdem.flight import Flight
from mavdem.report.blocks import Block, Blocks, Sentence, Table, caution, headline_sentence
from mavdem.report.numbers import display_unit, number_with_unit, rounded, with_unit
from mavdem.report.templates import render_section

LONG_RUN = 10.0
"""Expected time of a run, s, from which it is stated before the start, with fewer methods that take less; a choice."""

MIN_DECIMAL, MAX_DECIMAL = 0.001, 1000.0
"""Limits of printed errors and p-values: beyond them only the limit is printed, since nothing depends on how far."""

SUMMARY_HORIZONS = (0.1, 0.5)
"""Horizons of the summary beside the whole test part, s: a choice, for a table of 80 columns."""

TRIVIAL_METHODS = (HOLD_LAST, CONSTANT_MEAN, "zero")
"""Names of the methods without a model."""

MAX_LISTED_FLIGHTS = 2
"""Largest number of flights whose errors are listed one by one in a sentence; of more it has the range."""

MIN_LISTED_RATIO = 1.05
"""Ratio of two methods' errors from which the report says how many windows would show it: it is not printed as 1."""

STANDARD_ORDER = 3
"""Order of the model of ``mavdem learn``: angle, rate, and the lag of the motors."""


class _MethodRank(NamedTuple):
    """How the error of one method over the whole test parts compares with that of the others."""

    method: str
    """Name of the method."""

    error_ratio: str
    """Its error ratio, as in the table."""

    worse_than_constant: int
    """Number of windows in which a constant would have been the better forecast."""

    windows: int
    """Number of all windows."""

    losses: list[str]
    """Methods with a significantly smaller error, each with its error ratio and the p-value of the paired test."""

    wins: int
    """Number of methods with a significantly larger error, by Holm's correction for all tests of this method."""

    best_smaller: str
    """Method with the smallest error in the table of those that are smaller, but not significantly; or empty."""


class _HorizonRun(NamedTuple):
    """Horizons in a row at which the errors of DEM's model differ from the first method's, all in one direction."""

    is_larger: bool
    """Whether the errors of DEM's model are the larger ones."""

    to: str
    """The longest of the horizons, with its unit."""

    ratios: str
    """The ratio of the squared errors in the median window, such as "1.3 to 1.9", over these horizons."""


class _UselessHorizon(NamedTuple):
    """The first horizon at which forecasts are not useful, and what tells why."""

    seconds: str
    """The horizon, with its unit."""

    error_ratio: str
    """Median error ratio there, as in the table."""

    use: HorizonUse
    """How the forecasts compare with the trivial ones there."""


class _UsefulHorizon(NamedTuple):
    """How far ahead the forecasts of one method are useful, and their root mean squared errors (RMSE) there."""

    method: str
    """Name of the method."""

    seconds: str
    """The longest horizon, of those that were tried, up to which they are useful, with its unit; empty for none."""

    errors: Sequence[str]
    """RMSE of the first output in each flight; of more than ``MAX_LISTED_FLIGHTS`` the least and the largest."""

    first_useless: "_UselessHorizon | None"
    """The next horizon that was tried, at which they are not useful; None if they are useful at all."""


class _Horizon(NamedTuple):
    """A horizon of forecasts."""

    seconds: float
    """Its length, s."""

    label: str
    """Its length as text, s; of flights with test parts of several lengths the shortest to the longest."""


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
    quick_methods = [method for method in methods if method.name in QUICK_METHOD_NAMES]
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
        are_fewer_quick=len(quick_methods) == len(QUICK_METHOD_NAMES) < len(methods),
    )
    return sentences + _advice_on_pairs(windows)


def comparison_report(
    comparison: Comparison,
    planned_windows: int | None = None,
    excluded: Mapping[str, Exception] = MappingProxyType({}),
    *,
    verbose: bool = True,
) -> Iterator[Block]:
    """Yields the report of a comparison of forecasting methods: who loses to whom, how far ahead, then the tables.

    All methods forecast with the recorded inputs of the test data, and some can also predict without them. Each of
    these two kinds of forecast has its own sentences and tables; without ``verbose`` the first kind alone is reported,
    in one table.

    Args:
        comparison: errors and paired tests of all methods; the first method is the one that the others are compared
            with.
        planned_windows: number of windows that were to be compared, if the run was stopped before; otherwise None.
        excluded: reason why a log is not compared, by its path.
        verbose: whether all kinds, the definitions of the figures and the errors at all horizons are reported.
    """
    kinds = compared_kinds(comparison) if verbose else [KNOWN_INPUTS]
    yield from render_section(
        "comparison_stopped", windows=len(comparison.windows), planned_windows=planned_windows
    )
    for kind in kinds:
        headline, *ranking = _headline_sentences(comparison, kind, are_both_kinds=verbose)
        yield headline_sentence(headline.text)
        yield from ranking
    yield from _useful_horizon_sentences(comparison, kinds)
    for kind in kinds:
        yield from _insignificance_sentences(comparison, kind)
        yield from _worse_window_sentences(comparison, kind)
    for source, error in excluded.items():
        yield from render_section("comparison_left_out", source=source, reason=str(error))
    if verbose:
        yield _figure_definitions("comparison_legend", comparison)
    for kind in kinds:
        # A single kind needs no name in its tables.
        prefix = f"inputs {kind}: " if verbose else ""
        yield from horizon_difference_tables(comparison, kind, prefix)
        yield _summary_table(comparison, kind, prefix)
    if verbose:
        yield from _detail_blocks(comparison, kinds)
    else:
        yield from render_section(
            "comparison_short_legend",
            reference=comparison.methods[0],
            pair_count=_pair_count(comparison),
            are_flights_pairs=comparison.are_flights_pairs,
            significance=SIGNIFICANCE,
            can_predict=bool(comparison.methods_of(UNKNOWN_INPUTS)),
            are_horizons_tested=bool(_differences_by_horizon(comparison, KNOWN_INPUTS)),
        )
    for kind in kinds:
        yield from _band_cautions(comparison, kind)
    for flight in comparison.flights:
        yield from _failure_sentences(comparison, flight)
    if planned_windows is None and len(comparison.methods) > 1:
        yield from _advice_on_pairs(comparison.windows)


def compared_kinds(comparison: Comparison) -> list[ForecastKind]:
    """Returns the kinds of forecasts that are compared: with known inputs and, if a method makes them, without."""
    if comparison.methods_of(UNKNOWN_INPUTS):
        return [KNOWN_INPUTS, UNKNOWN_INPUTS]
    return [KNOWN_INPUTS]


def _detail_blocks(comparison: Comparison, kinds: Sequence[ForecastKind]) -> Blocks:
    """Returns what stands below the summary: windows and errors of each flight, and error ratios at all horizons.

    Args:
        comparison: errors and paired tests of all methods.
        kinds: kinds of forecasts, by the data that they may use.
    """
    blocks: Blocks = []
    for flight in comparison.flights:
        blocks += _flight_sentences(comparison, flight)
    blocks.append(_figure_definitions("comparison_details_legend", comparison))
    for kind in kinds:
        blocks.append(_error_ratio_table(comparison, kind))
    if len(comparison.flights) > 1:
        blocks.append(_error_ratios_by_flight(comparison, kinds))
    return blocks


def _figure_definitions(section: str, comparison: Comparison) -> Table:
    """Returns a table that defines the figures in the tables below it, such as "error ratio" and "p".

    Args:
        section: name of the file in ``report/sections`` that has a paragraph for each figure.
        comparison: errors of all methods.
    """
    has_ranked_model = bool(set(_ranked_methods(comparison, KNOWN_INPUTS)) - set(TRIVIAL_METHODS))
    definitions = render_section(
        section,
        reference=comparison.methods[0],
        seconds=_test_length(comparison),
        can_predict=bool(comparison.methods_of(UNKNOWN_INPUTS)),
        are_flights_pairs=comparison.are_flights_pairs,
        pair_count=_pair_count(comparison),
        several=len(comparison.flights) > 1,
        significance=SIGNIFICANCE,
        is_use_stated=has_ranked_model,
        are_horizons_tested=bool(_differences_by_horizon(comparison, KNOWN_INPUTS)),
        has_hold=HOLD_LAST in comparison.methods,
        better_share=f"{1 - MAX_WORSE_SHARE:.0%}".replace("%", " %"),
        max_ratio=MAX_USEFUL_RATIO,
    )
    rows = [[definition.lead, definition.text] for definition in definitions]
    return Table(["figure", "what it is"], rows, words=True)


def _pair_count(comparison: Comparison) -> int:
    """Returns how many pairs of errors a paired test compares: one pair for each flight, or each disjoint window."""
    if comparison.are_flights_pairs:
        return len(comparison.flights)
    return len(disjoint_windows(comparison.windows))


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


def _headline_sentences(
    comparison: Comparison, kind: ForecastKind, *, are_both_kinds: bool
) -> list[Sentence]:
    """Returns in two paragraphs up to which horizon DEM's model loses to the first method, and how all methods rank.

    Args:
        comparison: errors and tests of all methods.
        kind: kind of forecast, by the data that it may use.
        are_both_kinds: whether both kinds are reported, so that the sentences name their own.

    Returns:
        Both paragraphs; the second alone if DEM's model is not compared with another first method.
    """
    methods = comparison.methods_of(kind)
    failed_methods = _failed_methods(comparison, kind)
    forecasting_methods = [method for method in methods if method not in failed_methods]
    ranks = []
    for method in _ranked_methods(comparison, kind):
        if method in forecasting_methods:
            ranks.append(_method_rank(comparison, method, kind))
    best = None
    if len(forecasting_methods) > 1:
        best = _best_rank(comparison, kind, ranks)
    differences = _differences_by_horizon(comparison, kind)
    shown = shown_differences(differences)
    return render_section(
        "comparison_headline",
        kind=kind,
        are_both_kinds=are_both_kinds,
        model=str(MethodName.PLANT),
        reference=methods[0],
        default=str(DEFAULT_METHOD),
        constant=str(CONSTANT_MEAN),
        runs=_horizon_runs(shown),
        is_difference_lost=len(shown) < len(differences),
        is_pair_compared=bool(differences),
        is_tested=_pair_count(comparison) >= MIN_PAIRS,
        pair_count=_pair_count(comparison),
        min_pairs=MIN_PAIRS,
        failed_methods=[
            method for method in _ranked_methods(comparison, kind) if method in failed_methods
        ],
        seconds=_test_length(comparison),
        best=best,
        others=[rank for rank in ranks if best is not None and rank.method != best.method],
        method_count=len(forecasting_methods),
        absent_methods=[method for method in comparison.methods if method not in methods],
    )


def _failed_methods(comparison: Comparison, kind: ForecastKind) -> list[str]:
    """Returns the methods that made no forecast in any window.

    Args:
        comparison: errors of all methods.
        kind: kind of forecast, by the data that it may use.
    """
    failed_methods = []
    for summary in comparison.over_flights(kind):
        if summary["failed"] == summary["windows"]:
            failed_methods.append(summary["method"])
    return failed_methods


def _differences_by_horizon(comparison: Comparison, kind: ForecastKind) -> list[HorizonDifference]:
    """Returns at which horizons the errors of DEM's model differ from the first method's.

    Args:
        comparison: errors of all methods.
        kind: kind of forecast, by the data that it may use.

    Returns:
        One entry for each horizon; empty if DEM's model is not compared with another first method, or one of the two
        made no forecast.
    """
    # Two names, or one if DEM's model is the first method itself or makes no such forecasts.
    ranked = _ranked_methods(comparison, kind)
    failed_methods = _failed_methods(comparison, kind)
    if len(ranked) < 2 or any(method in failed_methods for method in ranked):
        return []
    learned_model, first_method = ranked
    return horizon_differences(comparison, learned_model, first_method, kind)


def _horizon_runs(differences: Sequence[HorizonDifference]) -> list[_HorizonRun]:
    """Groups horizons in a row at which the errors of DEM's model are larger, or smaller, than the first method's.

    Args:
        differences: horizons that show a difference, the shortest first.
    """
    runs = []
    for is_larger, group in groupby(differences, key=lambda difference: difference.test.ratio > 1):
        run = list(group)
        ratios = [difference.test.ratio for difference in run]
        least, most = _short_number(min(ratios)), _short_number(max(ratios))
        range_text = least if least == most else f"{least} to {most}"
        runs.append(_HorizonRun(is_larger, _seconds_text(run[-1].seconds), range_text))
    return runs


def horizon_difference_tables(
    comparison: Comparison, kind: ForecastKind, prefix: str = ""
) -> list[Table]:
    """Returns a table of how DEM's model and the first method differ at each horizon; none if both are not compared.

    Args:
        comparison: errors and tests of all methods.
        kind: kind of forecast, by the data that it may use.
        prefix: what the header of the first column begins with, such as "inputs known: "; may be empty.
    """
    differences = _differences_by_horizon(comparison, kind)
    if not differences:
        return []
    learned_model, first_method = _ranked_methods(comparison, kind)
    rows = []
    for difference in differences:
        test = difference.test
        result = "not shown"
        if difference.is_shown:
            result = "worse" if test.ratio > 1 else "better"
        rows.append(
            [
                _seconds_text(difference.seconds),
                _short_number(difference.error_ratio),
                _short_number(difference.other_error_ratio),
                f"{test.tested_less} of {test.tested}",
                _short_number(test.p_value),
                result,
            ]
        )
    header = [
        f"{prefix}error ratio to",
        learned_model,
        f"{first_method} *",
        "better in",
        "p",
        f"{learned_model} is",
    ]
    return [Table(header, rows)]


def _ranked_methods(comparison: Comparison, kind: ForecastKind) -> list[str]:
    """Returns the methods whose rank among all the report states: the model that DEM learns, and the first method.

    The others are compared with the first method. The list has one name if that is DEM's model, or if DEM's model makes
    no such forecasts.

    Args:
        comparison: errors of all methods.
        kind: kind of forecast, by the data that it may use.
    """
    methods = comparison.methods_of(kind)
    first_method = methods[0]
    learned_model = str(MethodName.PLANT)
    if learned_model in methods and learned_model != first_method:
        return [learned_model, first_method]
    return [first_method]


def _best_rank(
    comparison: Comparison, kind: ForecastKind, ranks: Sequence[_MethodRank]
) -> _MethodRank:
    """Returns the rank of the method with the smallest error ratio over the whole test parts.

    Of methods that the tables show as equal, one of ``ranks`` is preferred, and the first method to DEM's model.

    Args:
        comparison: errors and tests of all methods.
        kind: kind of forecast, by the data that it may use.
        ranks: ranks of DEM's model and of the first method.
    """
    best_summary, *_ = comparison.over_flights(kind)
    best_ratio = _short_number(best_summary["relative"])
    for rank in reversed(ranks):
        if rank.error_ratio == best_ratio:
            return rank
    return _method_rank(comparison, best_summary["method"], kind)


def _method_rank(comparison: Comparison, method: str, kind: ForecastKind) -> _MethodRank:
    """Compares the error of one method with that of each other method, by a paired test.

    Args:
        comparison: errors of all methods in all windows.
        method: name of the method, which made a forecast in at least one window.
        kind: kind of forecast, by the data that it may use.

    Returns:
        The methods with a significantly smaller error, the number of those with a significantly larger one, and the
        best of those whose smaller error is not significant. The error is the error ratio over the whole test part:
        mean squared error over that of a constant mean (NMSE).
    """
    summaries = {summary["method"]: summary for summary in comparison.over_flights(kind)}
    error_ratios = {name: summary["relative"] for name, summary in summaries.items()}
    failed_methods = _failed_methods(comparison, kind)
    losses = []
    best_smaller = ""
    # Tests compare all methods with the reference. Their result says whether the reference has the higher error.
    tests = comparison.with_reference(method).tests(kind)
    compared_methods = [name for name in tests if name not in failed_methods]
    # In order of error, so that the first method with a smaller error is the best one.
    for other in sorted(compared_methods, key=lambda name: error_ratios[name]):
        test = tests[other]
        if test.result is TestResult.HIGHER:
            losses.append(
                f"{other} ({_short_number(error_ratios[other])}, p {_p_value_text(test)})"
            )
        elif test.result is TestResult.LOWER:
            continue
        elif not best_smaller and _is_shown_smaller(error_ratios[other], error_ratios[method]):
            best_smaller = other
    # A loss is stated by its own test. Wins over several methods count only if they are significant together.
    are_significant = are_significant_together([tests[name].p_value for name in compared_methods])
    wins = 0
    for other, is_significant in zip(compared_methods, are_significant, strict=True):
        wins += is_significant and tests[other].ratio < 1
    return _MethodRank(
        method,
        error_ratio=_short_number(error_ratios[method]),
        worse_than_constant=summaries[method]["worse_than_constant"],
        windows=summaries[method]["windows"],
        losses=losses,
        wins=wins,
        best_smaller=best_smaller,
    )


def _insignificance_sentences(comparison: Comparison, kind: ForecastKind) -> list[Sentence]:
    """Returns a sentence on what the paired test could have found, if a smaller error is not significant.

    Without it "not significantly" would read as "equal". It is on the first ranked method that has a larger error than
    another one, and on the best of the others.

    Args:
        comparison: errors of all methods.
        kind: kind of forecast, by the data that it may use.
    """
    failed_methods = _failed_methods(comparison, kind)
    for method in _ranked_methods(comparison, kind):
        if method in failed_methods:
            continue
        rank = _method_rank(comparison, method, kind)
        if not rank.best_smaller:
            continue
        ratio = comparison.typical_ratio(rank.method, rank.best_smaller, kind)
        # A ratio that is printed as 1 is no difference to look for.
        if ratio is not None and isfinite(ratio.significant) and ratio.measured > MIN_LISTED_RATIO:
            return render_section(
                "comparison_insignificance",
                kind=kind,
                seconds=_test_length(comparison),
                method=rank.method,
                better=rank.best_smaller,
                measured_ratio=_short_number(ratio.measured),
                significant_ratio=_short_number(ratio.significant),
                pairs=_pair_count(comparison),
                sufficient_pairs=ratio.sufficient_windows,
                are_flights_pairs=comparison.are_flights_pairs,
            )
    return []


def _worse_window_sentences(comparison: Comparison, kind: ForecastKind) -> list[Sentence]:
    """Returns a sentence on why DEM's model and the first method are worse than a constant in some windows.

    There is none where they are not, or where neither little motion nor an unstable model explains it.

    Args:
        comparison: errors of all methods.
        kind: kind of forecast, by the data that it may use.
    """
    explained = []
    for method in _ranked_methods(comparison, kind):
        worse = worse_windows(comparison, method, kind)
        if worse.has_little_motion or worse.unstable:
            explained.append(worse)
    return render_section("comparison_worse_windows", kind=kind, worse_windows=explained)


def _is_shown_smaller(error_ratio: float, other_ratio: float) -> bool:
    """Returns whether an error ratio is below another one, and looks so in the tables, which round to two digits."""
    is_shown_equal = _short_number(error_ratio) == _short_number(other_ratio)
    return error_ratio < other_ratio and not is_shown_equal


def _p_value_text(test: Paired) -> str:
    """Returns the p-value of a paired test with its sign: "= 0.04", or "< 0.001"."""
    return f"< {MIN_DECIMAL:g}" if test.p_value < MIN_DECIMAL else f"= {test.p_value:.2g}"


def _summary_table(comparison: Comparison, kind: ForecastKind, prefix: str) -> Table:
    """Returns a table of the methods, the best first: RMSE at three horizons, error ratio, and p-value of the test.

    The horizons are 0.1 and 0.5 s, in which a controller acts, and the whole test part. A star marks the method against
    which the others are tested.

    Args:
        comparison: errors and tests of all methods; the first method is the one that the others are compared with.
        kind: kind of forecast, by the data that it may use.
        prefix: what the header of the first column begins with, such as "inputs known: "; may be empty.
    """
    reference = comparison.methods_of(kind)[0]
    tests = comparison.tests(kind)
    train = comparison.windows[0].train
    horizons = _summary_horizons(comparison, kind)
    rows = []
    for summary in comparison.over_flights(kind):
        method = summary["method"]
        row = [f"{method} *" if method == reference else method]
        for index, unit in enumerate(train.output_units):
            for horizon in horizons:
                error = _median_rmse(comparison, method, kind, horizon.seconds, index)
                row.append(_short_number(display_unit(unit).scale * error))
        row.append(_short_number(summary["relative"]))
        row.append(_short_number(tests[method].p_value) if method in tests else "")
        rows.append(row)
    rmse_headers = _rmse_headers(train, horizons)
    return Table([f"{prefix}RMSE to (s)", *rmse_headers, "error ratio", "p"], rows)


def _rmse_headers(flight: Flight, horizons: Sequence[_Horizon]) -> list[str]:
    """Returns the headers of the columns of RMSE, such as "angle (°) 0.1": for each output one at each horizon.

    Args:
        flight: a flight with the outputs' names and units.
        horizons: lengths of the forecasts.
    """
    headers = []
    for output, unit in zip(flight.output_names, flight.output_units, strict=True):
        unit_name = display_unit(unit).name
        title = f"{output} ({unit_name})" if unit_name else output
        headers += [f"{title} {horizon.label}" for horizon in horizons]
    return headers


def _summary_horizons(comparison: Comparison, kind: ForecastKind) -> list[_Horizon]:
    """Returns the horizons of the summary: those of ``SUMMARY_HORIZONS`` that were evaluated, and the whole test part.

    Args:
        comparison: errors of all methods.
        kind: kind of forecast, by the data that it may use.
    """
    *shorter, longest = comparison.over_flights(kind)[0]["horizon_seconds"]
    horizons = []
    for seconds in shorter:
        if any(isclose(seconds, wanted, rel_tol=HORIZON_TOLERANCE) for wanted in SUMMARY_HORIZONS):
            horizons.append(_Horizon(seconds, f"{seconds:.2g}"))
    return [*horizons, _Horizon(longest, _test_length(comparison))]


def _median_rmse(
    comparison: Comparison, method: str, kind: ForecastKind, seconds: float, output_index: int
) -> float:
    """Returns the RMSE of a method's forecasts of one output, in the output's unit: the median over all flights.

    Args:
        comparison: errors of all methods.
        method: name of the method.
        kind: kind of forecast, by the data that it may use.
        seconds: length of the forecasts, s.
        output_index: index of the output among those of the model, such as 0 for the angle.
    """
    errors = []
    for flight in comparison.flights:
        squared_errors = _mean_squared_errors(comparison, flight, method, kind, seconds)
        errors.append(sqrt(squared_errors[output_index]))
    return median(errors)


def _useful_horizon_sentences(
    comparison: Comparison, kinds: Sequence[ForecastKind]
) -> list[Sentence]:
    """Returns a sentence for each kind of forecast on how far ahead it is useful, and why not farther.

    Args:
        comparison: errors of all methods.
        kinds: kinds of forecasts, by the inputs that they may use.
    """
    train = comparison.windows[0].train
    sentences = []
    for kind in kinds:
        useful_horizons = []
        for method in _ranked_methods(comparison, kind):
            if method not in TRIVIAL_METHODS:
                useful_horizons.append(_useful_horizon(comparison, method, kind))
        sentences += render_section(
            "comparison_use",
            kind=kind,
            useful_horizons=useful_horizons,
            output=train.output_names[0],
            unit=number_with_unit("", display_unit(train.output_units[0]).name),
            is_range=len(comparison.flights) > MAX_LISTED_FLIGHTS,
            reference=comparison.methods_of(kind)[0],
            best_at_horizons=_better_at_shorter_horizons(comparison, kind),
            few_pairs=_pair_count(comparison) if _pair_count(comparison) < MIN_PAIRS else None,
        )
    return sentences


def _useful_horizon(comparison: Comparison, method: str, kind: ForecastKind) -> _UsefulHorizon:
    """Returns how far ahead forecasts of a method are useful, such as 0.25 s, and their error there in each flight.

    A horizon counts only if the forecasts are useful at all shorter ones, too.

    Args:
        comparison: errors of all methods.
        method: name of the method.
        kind: kind of forecast, by the data that it may use.
    """
    longest_useful = None
    first_useless = None
    for use in horizon_uses(comparison, method, kind):
        if not use.is_useful:
            first_useless = _UselessHorizon(
                _seconds_text(use.seconds), _short_number(use.error_ratio), use
            )
            break
        longest_useful = use
    if longest_useful is None:
        return _UsefulHorizon(method, "", (), first_useless)
    errors = _angle_errors(comparison, method, kind, longest_useful.seconds)
    return _UsefulHorizon(method, _seconds_text(longest_useful.seconds), errors, first_useless)


def _angle_errors(
    comparison: Comparison, method: str, kind: ForecastKind, seconds: float
) -> list[str]:
    """Returns the RMSE of the forecast angle in each flight as text, such as "3.1" degrees.

    The angle is the first output of the model. Of more flights than ``MAX_LISTED_FLIGHTS`` only the least and the
    largest error are returned.

    Args:
        comparison: errors of all methods.
        method: name of the method.
        kind: kind of forecast, by the data that it may use.
        seconds: length of the forecasts, s.
    """
    unit = display_unit(comparison.windows[0].train.output_units[0])
    errors = []
    for flight in comparison.flights:
        squared_error, *_ = _mean_squared_errors(comparison, flight, method, kind, seconds)
        errors.append(rounded(unit.scale * sqrt(squared_error)))
    if len(errors) > MAX_LISTED_FLIGHTS:
        return [min(errors, key=float), max(errors, key=float)]
    return errors


def _seconds_text(seconds: float) -> str:
    """Returns a horizon with its unit: "0.25 s"."""
    return f"{seconds:.2g} s"


def _mean_squared_errors(
    comparison: Comparison, flight: str, method: str, kind: ForecastKind, seconds: float
) -> Sequence[float]:
    """Returns the mean squared errors of a method's forecasts in one flight, one for each output of the model.

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
        if _is_shown_smaller(error_ratios[best_method], error_ratios[reference]):
            horizons_by_method.setdefault(best_method, []).append(_seconds_text(seconds))
    return horizons_by_method


def _test_length(comparison: Comparison) -> str:
    """Returns the length of the test parts as text, s: "1.5", or "1.5–3" where those of flights differ."""
    lengths = [len(window.test) * window.test.dt for window in comparison.windows]
    shortest = f"{min(lengths):.2g}"
    longest = f"{max(lengths):.2g}"
    return shortest if shortest == longest else f"{shortest}–{longest}"


def _error_ratio_table(comparison: Comparison, kind: ForecastKind) -> Table:
    """Returns a table with the error ratio of each method at all horizons, and in how many windows it failed.

    Args:
        comparison: errors and tests of all methods.
        kind: kind of forecast, by the data that it may use.
    """
    tests = comparison.tests(kind)
    rows = []
    for summary in comparison.over_flights(kind):
        rows.append(_error_row(summary, tests.get(summary["method"])))
    header = [
        f"inputs {kind}: error ratio to (s)",
        *_horizon_header(comparison, kind),
        ">1",
        "lower in",
        "unstable",
        "band",
    ]
    return Table(header, rows)


def _band_cautions(comparison: Comparison, kind: ForecastKind) -> Blocks:
    """Returns a caution if the 90 % band of the first method holds too few of the samples; otherwise nothing.

    Args:
        comparison: errors of all methods.
        kind: kind of forecast, by the data that it may use.
    """
    reference = comparison.methods_of(kind)[0]
    for summary in comparison.over_flights(kind):
        if summary["method"] == reference and _is_band_too_narrow(summary):
            share = _coverage(summary)
            return [
                caution(
                    f"the 90 % band of {reference} holds {share} of the samples: it is too narrow."
                )
            ]
    return []


def _error_ratios_by_flight(comparison: Comparison, kinds: Sequence[ForecastKind]) -> Table:
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
    return Table([title, *methods], rows)


def _error_row(summary: JsonValues, test: Paired | None) -> list[str]:
    """Returns the row of one forecasting method in the table of error ratios.

    Args:
        summary: figures of the method over all flights, by key (``Comparison.over_flights``).
        test: paired test of the first method against this one; None for the first method itself.

    Returns:
        The name, with a mark behind that of the first method; the error ratio (NMSE) at each horizon; the number of
        windows with an error ratio above 1; the number of tested pairs in which the first method has the lower error,
        such as "5/7"; the number of windows with an unstable model; and the percentage of samples in the 90 % band.
    """
    name = summary["method"] if test is not None else f"{summary['method']} *"
    row = [name]
    for error_ratio in summary["horizons"]:
        row.append(_short_number(error_ratio))
    row.append(str(summary["worse_than_constant"]))
    row.append("" if test is None else f"{test.tested_less}/{test.tested}")
    return [*row, str(summary["unstable"]), _coverage(summary)]


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
