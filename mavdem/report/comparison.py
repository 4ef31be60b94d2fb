"""Comparisons in sentences and tables: of methods, and of model orders.

Of methods first what the paired test says of DEM and each other one; of orders the free energy of each.
"""

from collections.abc import Iterator, Sequence
from math import isfinite

from mavdem.assessment.axis.findings import PREDICTION_LIMITS
from mavdem.dem.order_choice import LARGEST_ORDER, OrderChoice
from mavdem.experiments.comparison import Comparison
from mavdem.experiments.paired_test import MIN_PAIRS, SIGNIFICANCE
from mavdem.experiments.scores import HORIZONS, KNOWN, UNKNOWN, Question
from mavdem.facts.forecasts import TestResult
from mavdem.report.blocks import Block, Blocks, Sentence, Table, caution
from mavdem.report.templates import render_section

WORDS = {KNOWN: "What happened, given the inputs:", UNKNOWN: "What comes next, inputs unknown:"}


def comparison_report(comparison: Comparison) -> Iterator[Block]:
    """Yields how the first method of a ``comparison`` does, then errors, and what the columns mean."""
    questions = [KNOWN, *([UNKNOWN] if comparison.methods_of(UNKNOWN) else [])]
    yield Sentence("", lead=_result(comparison, KNOWN))
    for question in questions[1:]:
        yield Sentence(_result(comparison, question), WORDS[question])
    for question in questions:
        yield from _errors(comparison, question)
    for flight in comparison.flights:
        yield from _flight(comparison, flight)
    yield from render_section(
        "comparison_legend",
        reference=comparison.methods[0],
        several=len(comparison.flights) > 1,
        predicted=UNKNOWN in questions,
        significance=SIGNIFICANCE,
    )


def _result(comparison: Comparison, question: Question) -> str:
    """Than which methods' errors the first one's is lower or higher, and from which it is not distinguishable."""
    rows = comparison.over_flights(question)
    silent = [row["method"] for row in rows if row["failed"] == row["windows"]]
    tests = comparison.tests(question)
    tests = {method: test for method, test in tests.items() if method not in silent}
    by_result = {
        result: {name: test for name, test in tests.items() if test.result is result}
        for result in (TestResult.HIGHER, TestResult.NOT_DISTINGUISHABLE, TestResult.LOWER)
    }
    (said,) = render_section(
        "comparison_result",
        reference=comparison.methods_of(question)[0],
        flights=len(comparison.flights),
        pairs=min((test.tested for test in tests.values()), default=0),
        fewest=MIN_PAIRS,
        tests=tests,
        results={result: names for result, names in by_result.items() if names},
        silent=silent,
    )
    return said.lead


def _errors(comparison: Comparison, question: Question) -> Blocks:
    """A row a method, the lowest error first, and a caution if the first method's band holds too few samples."""
    reference = comparison.methods_of(question)[0]
    tests = comparison.tests(question)
    blocks = [Sentence("error ratio by steps ahead.", WORDS[question])]
    table = []
    for row in comparison.over_flights(question):
        share = row["inside"][-1]
        inside = "" if share is None else f"{100 * share:.0f} %"
        test = tests.get(row["method"])
        table.append(
            [
                row["method"],
                *(f"{ratio:.3g}" for ratio in row["horizons"]),
                str(row["worse_than_constant"]),
                str(row["unstable"]),
                *(["", ""] if test is None else [f"{test.ratio:.3g}", f"{test.p_value:.2g}"]),
                inside,
            ]
        )
        if test is None and share is not None and share < PREDICTION_LIMITS.coverage:
            sentence = (
                f"the 90 % band of {reference} holds {inside} of the samples: it is too narrow."
            )
            blocks.append(caution(sentence))
    header = ["method", *_shared_horizons(comparison)]
    header += ["above 1", "unstable", f"{reference} / method", "p", "in 90 % band"]
    return [*blocks, Table(header, table)]


def _shared_horizons(comparison: Comparison) -> list[str]:
    """What horizons that all flights have are called, as at 100 Hz; the last is the whole test part."""
    counts = (len(comparison.summaries(flight)[0]["horizons"]) for flight in comparison.flights)
    return [*map(str, HORIZONS[: min(counts) - 1]), "all"]


def _flight(comparison: Comparison, flight: str) -> Iterator[Block]:
    """How much was compared of a flight, and what failed."""
    windows = [window for window in comparison.windows if window.flight == flight]
    summaries = comparison.summaries(flight)
    yield from render_section(
        "comparison_flight",
        windows[0],
        windows=len(windows),
        tested=summaries[0]["horizons"][-1]["reference"].tested,
    )
    for row in summaries:
        yield from render_section("comparison_failures", **row)


STANDARD_ORDER = 3  # of `mavdem learn`: angle, rate, and the motors' lag


def order_advice(choice: OrderChoice, known_inputs: bool) -> str:
    """Returns one sentence on what to do with the chosen order; ``known_inputs`` as for ``free_energy_by_order``."""
    (said,) = render_section(
        "order_advice",
        choice=choice,
        known_inputs=known_inputs,
        largest=LARGEST_ORDER,
        standard=STANDARD_ORDER,
    )
    return said.text


def order_report(choice: OrderChoice, names: Sequence[str], known_inputs: bool) -> Blocks:
    """Returns F̄ by order and flight, and the chosen order with its reason, and last what to do with it.

    ``names`` are those of the flights of ``choice``; ``known_inputs`` is as for ``free_energy_by_order``.
    """
    rows = []
    several = len(names) > 1
    chosen = choice.chosen - 1
    for column, order in enumerate(choice.orders):
        nats = [*(choice.free_energy[:, column] - choice.free_energy[:, chosen])]
        if several:
            nats += [choice.mean[column] - choice.mean[chosen], choice.spread[column]]
        cells = [f"{value:,.1f}" if isfinite(value) else "-" for value in nats]
        rows.append([f"{order}{' (chosen)' if order == choice.chosen else ''}", *cells])
    return [
        Sentence("", str(choice.reason)),
        Table(["states", *names, *(["mean", "spread"] if several else [])], rows),
        Sentence(
            "F̄ in nats, minus that of the chosen order; spread: standard deviation over flights."
        ),
        *map(caution, choice.remarks),
        Sentence(order_advice(choice, known_inputs), "Next:"),
    ]
