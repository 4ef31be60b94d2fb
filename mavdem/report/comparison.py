"""Comparisons in sentences and tables: of forecasting methods by paired tests, and of model orders by free energy."""

from collections.abc import Iterator, Sequence
from math import isfinite
from typing import NamedTuple

from mavdem.assessment.axis.findings import PREDICTION_LIMITS
from mavdem.containers import JsonValues
from mavdem.dem.learning import MIN_SAMPLES
from mavdem.dem.order_choice import LARGEST_ORDER, OrderChoice
from mavdem.experiments.comparison import Comparison
from mavdem.experiments.paired_test import MIN_PAIRS, SIGNIFICANCE, Paired
from mavdem.experiments.scores import HORIZONS, KNOWN_INPUTS, UNKNOWN_INPUTS, ForecastKind
from mavdem.facts.forecasts import TestResult
from mavdem.report.blocks import Block, Blocks, Sentence, Table, caution, headline_sentence
from mavdem.report.templates import render_section

LEAD_BY_KIND = {
    KNOWN_INPUTS: "What happened, given the inputs:",
    UNKNOWN_INPUTS: "What comes next, inputs unknown:",
}
"""What stands before a sentence about the forecasts of a kind."""

RESULT_ORDER = (TestResult.HIGHER, TestResult.NOT_DISTINGUISHABLE, TestResult.LOWER)
"""Order in which the results of paired tests are reported."""

MIN_DECIMAL, MAX_DECIMAL = 0.001, 1000.0
"""Limits within which errors are printed without an exponent: two digits then take at most six characters."""

STANDARD_ORDER = 3
"""Order of the model of ``mavdem learn``: angle, rate, and the lag of the motors."""


class _Horizons(NamedTuple):
    """The horizons of a table of errors."""

    unit: str
    """Unit of the horizons: "seconds" or "samples"."""

    lengths: list[str]
    """Length of each horizon as the header of its column; the last one is the whole test part."""


def comparison_report(
    comparison: Comparison, planned_windows: int | None = None
) -> Iterator[Block]:
    """Yields the report of a comparison of forecasting methods: the result, a key, tables of errors, and failures.

    All methods forecast with the recorded inputs of the test data, and some can also forecast without them. Each of
    these two kinds of forecast has its own sentence and table.

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
    yield headline_sentence(_result_text(comparison, KNOWN_INPUTS))
    if planned_windows is None:
        yield from _advice_on_pairs(comparison)
    for kind in kinds[1:]:
        yield Sentence(_result_text(comparison, kind), LEAD_BY_KIND[kind])
    for flight in comparison.flights:
        yield from _flight_sentences(comparison, flight)
    yield from render_section(
        "comparison_legend",
        reference=comparison.methods[0],
        several=len(comparison.flights) > 1,
        predicted=UNKNOWN_INPUTS in kinds,
        significance=SIGNIFICANCE,
    )
    for kind in kinds:
        yield from _error_blocks(comparison, kind)
    for flight in comparison.flights:
        yield from _failure_sentences(comparison, flight)


def _advice_on_pairs(comparison: Comparison) -> list[Sentence]:
    """Returns in a sentence how to get enough windows for the paired test; empty if there are enough.

    The test needs ``MIN_PAIRS`` windows that do not overlap. A flight has room for more of them if the windows are far
    apart (--hop), or if they become shorter (--train); otherwise it takes more flights.

    Args:
        comparison: outcomes of all methods on windows of one flight or several.
    """
    pair_counts = [test.tested for test in comparison.tests().values()]
    # Windows and the samples that they cover, by flight.
    possible_pairs = 0
    window_lengths = []
    covered_lengths = []
    for flight in comparison.flights:
        windows = [window for window in comparison.windows if window.flight == flight]
        window_length = windows[0].stop - windows[0].start
        covered_length = windows[-1].stop - windows[0].start
        possible_pairs += covered_length // window_length
        window_lengths.append(window_length)
        covered_lengths.append(covered_length)
    # The longest training part with which a single flight has room for enough windows.
    shorter_train = covered_lengths[0] // MIN_PAIRS - len(comparison.windows[0].test)
    if len(comparison.flights) > 1 or shorter_train < MIN_SAMPLES:
        shorter_train = 0
    return render_section(
        "comparison_more_pairs",
        pair_count=min(pair_counts, default=MIN_PAIRS),
        min_pairs=MIN_PAIRS,
        possible_pairs=possible_pairs,
        smaller_hop=max(window_lengths),
        shorter_train=shorter_train,
    )


def _result_text(comparison: Comparison, kind: ForecastKind) -> str:
    """Returns in a sentence whether the errors of the first method are lower or higher than those of the other methods.

    The first method is the reference of all paired tests. The others are grouped by the result of their test. Methods
    that failed in all windows cannot be tested, and are named apart.

    Args:
        comparison: errors and tests of all methods.
        kind: ``KNOWN_INPUTS`` for forecasts with recorded inputs, ``UNKNOWN_INPUTS`` for those without.
    """
    summaries = comparison.over_flights(kind)
    failed_methods = []
    for summary in summaries:
        if summary["failed"] == summary["windows"]:
            failed_methods.append(summary["method"])
    # The test of each other method against the reference, by its result and then by the method.
    tests_by_result: dict[TestResult, dict[str, Paired]] = {result: {} for result in RESULT_ORDER}
    pair_counts = []
    for method, test in comparison.tests(kind).items():
        if method not in failed_methods:
            tests_by_result[test.result][method] = test
            pair_counts.append(test.tested)
    (paragraph,) = render_section(
        "comparison_result",
        reference=comparison.methods_of(kind)[0],
        flight_count=len(comparison.flights),
        pair_count=min(pair_counts, default=0),
        min_pairs=MIN_PAIRS,
        test_count=len(pair_counts),
        tests_by_result={result: tests for result, tests in tests_by_result.items() if tests},
        failed_methods=failed_methods,
    )
    return paragraph.lead


def _error_blocks(comparison: Comparison, kind: ForecastKind) -> Blocks:
    """Returns the table with the errors of all forecasting methods, after a sentence that says what it shows.

    The first method is the reference, with which each other one is compared by a paired test. A caution stands before
    the table if the 90 % band of the reference holds too few of the samples.

    Args:
        comparison: errors and tests of all methods.
        kind: kind of forecast, by the data that it may use.
    """
    reference = comparison.methods_of(kind)[0]
    tests = comparison.tests(kind)
    horizons = _common_horizons(comparison)
    blocks: Blocks = [Sentence(f"error ratio by {horizons.unit} ahead.", LEAD_BY_KIND[kind])]
    rows = []
    for summary in comparison.over_flights(kind):
        method = summary["method"]
        rows.append(_error_row(summary, tests.get(method)))
        if method == reference and _is_band_too_narrow(summary):
            text = f"the 90 % band of {reference} holds {_coverage(summary)} of the samples: it is too narrow."
            blocks.append(caution(text))
    header = ["method", *horizons.lengths, ">1", "reference/method", "p", "unstable", "band"]
    return [*blocks, Table(header, rows)]


def _error_row(summary: JsonValues, test: Paired | None) -> list[str]:
    """Returns the row of one forecasting method in the table of errors.

    Args:
        summary: figures of the method over all flights, by key (``Comparison.over_flights``).
        test: paired test of the reference method against this one; None for the reference itself.

    Returns:
        The name; the error ratio (NMSE) at each horizon; the number of windows with an error ratio above 1; ratio and
        p-value of the test; the number of windows with an unstable model; and the percentage of samples in the 90 %
        band.
    """
    row = [summary["method"]]
    for error_ratio in summary["horizons"]:
        row.append(_short_number(error_ratio))
    row.append(str(summary["worse_than_constant"]))
    if test is None:
        row += ["", ""]
    else:
        row += [_short_number(test.ratio), f"{test.p_value:.2g}"]
    return [*row, str(summary["unstable"]), _coverage(summary)]


def _short_number(number: float) -> str:
    """Returns a number with two digits in at most six characters, such as "0.013", "1.1e-5", "2.5" or "inf"."""
    if MIN_DECIMAL <= number < MAX_DECIMAL or number == 0 or not isfinite(number):
        return f"{number:.2g}"
    mantissa, exponent = f"{number:.1e}".split("e")
    return f"{mantissa}e{int(exponent)}"


def _coverage(summary: JsonValues) -> str:
    """Returns the share of samples in a method's 90 % band as percent; empty for a method without a band."""
    # The last horizon is the whole test data.
    share_in_band = summary["inside"][-1]
    return "" if share_in_band is None else f"{100 * share_in_band:.0f} %"


def _is_band_too_narrow(summary: JsonValues) -> bool:
    """Returns whether a method has a 90 % band that holds clearly fewer samples (``PREDICTION_LIMITS``)."""
    share_in_band = summary["inside"][-1]
    return share_in_band is not None and share_in_band < PREDICTION_LIMITS.coverage


def _common_horizons(comparison: Comparison) -> _Horizons:
    """Returns the horizons at which all flights were evaluated.

    Args:
        comparison: outcomes of all methods on windows of one flight or several.

    Returns:
        The horizons in seconds if they last as long in all flights, otherwise in samples, with "all" for the whole
        test part.
    """
    steps_by_flight = []
    seconds_by_flight = []
    for flight in comparison.flights:
        summary_of_first_method = comparison.summaries(flight)[0]
        steps = [horizon["steps"] for horizon in summary_of_first_method["horizons"]]
        dt = comparison.of_flight(flight).windows[0].train.dt
        steps_by_flight.append(steps)
        seconds_by_flight.append([f"{count * dt:.2g}" for count in steps])
    if all(seconds == seconds_by_flight[0] for seconds in seconds_by_flight):
        return _Horizons("seconds", seconds_by_flight[0])
    # The last horizon of a flight is its whole test part, and not one of ``HORIZONS``.
    common_count = min(len(steps) for steps in steps_by_flight) - 1
    return _Horizons("samples", [*map(str, HORIZONS[:common_count]), "all"])


def _flight_sentences(comparison: Comparison, flight: str) -> Iterator[Block]:
    """Yields a sentence on one flight of a comparison of forecasting methods: how much of it was compared.

    A flight is divided into windows of training and test data. Paired tests use only windows that do not overlap.

    Args:
        comparison: errors of all methods in all windows.
        flight: name of the flight.
    """
    windows = [window for window in comparison.windows if window.flight == flight]
    summaries = comparison.summaries(flight)
    # The paired test of any method states how many windows it uses, so that the first one will do.
    longest_horizon = summaries[0]["horizons"][-1]
    tested_count = longest_horizon["reference"].tested
    # All windows of a flight have the same length, so that the first one stands for them.
    yield from render_section(
        "comparison_flight", windows[0], window_count=len(windows), tested_count=tested_count
    )


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
