"""Comparisons in sentences and tables: of methods, and of model orders.

Of methods first what the paired test says of DEM and each other one; of orders the free energy of each.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from math import isfinite, sqrt
from typing import Any

from mavdem.analysis.findings import PREDICTION_LIMITS
from mavdem.dem.order_choice import LARGEST_ORDER, OrderChoice
from mavdem.evaluate.comparison import Comparison
from mavdem.evaluate.paired_test import FEWEST_PAIRS, SIGNIFICANCE, Paired
from mavdem.evaluate.scores import FROM_ZERO, HORIZONS, KNOWN, UNKNOWN, Question
from mavdem.facts.forecasts import TestResult
from mavdem.report.blocks import Block, Sentence, Table, caution
from mavdem.report.numbers import named, readable
from mavdem.report.words import section

WORDS = {KNOWN: "What happened, given the inputs:", UNKNOWN: "What comes next, inputs unknown:"}
Summary = dict[str, Any]
_ratio = "{:.3g}".format


def comparison_report(comparison: Comparison, from_zero: bool = False) -> list[Block]:
    """Returns the verdict on the first method of a ``comparison``, then errors, and what the columns mean."""
    first = FROM_ZERO if from_zero else KNOWN
    questions = [first, *([UNKNOWN] if not from_zero and comparison.methods_of(UNKNOWN) else [])]
    several = len(comparison.flights) > 1
    return [
        Sentence("", lead=_verdict(comparison, first)),
        *(Sentence(_verdict(comparison, question), WORDS[question]) for question in questions[1:]),
        *(
            block
            for question in questions
            if not from_zero
            for block in _failed_bands(comparison, question)
        ),
        *(_over_flights(comparison, questions) if several else []),
        *(
            block
            for flight in comparison.flights
            for block in _flight(comparison, flight, questions)
        ),
        *section(
            "comparison_legend",
            reference=comparison.methods[0],
            from_zero=from_zero,
            several=several,
            predicted=UNKNOWN in questions,
            significance=SIGNIFICANCE,
        ),
    ]


def _verdict(comparison: Comparison, question: Question) -> str:
    """Than which methods' errors the first one's is lower or higher, and from which it is not distinguishable."""
    rows = comparison.over_flights(question)
    silent = [row["method"] for row in rows if row["failed"] == row["windows"]]
    tests = comparison.verdicts(question)
    tests = {method: test for method, test in tests.items() if method not in silent}
    by_result = {
        result: {name: test for name, test in tests.items() if test.verdict is result}
        for result in (TestResult.HIGHER, TestResult.NOT_DISTINGUISHABLE, TestResult.LOWER)
    }
    (said,) = section(
        "comparison_verdict",
        reference=comparison.methods_of(question)[0],
        flights=len(comparison.flights),
        pairs=min((test.tested for test in tests.values()), default=0),
        fewest=FEWEST_PAIRS,
        tests=tests,
        results={result: known for result, known in by_result.items() if known},
        silent=silent,
    )
    return said.lead


def _failed_bands(comparison: Comparison, question: Question) -> list[Block]:
    """A caution for each flight on which the first method's band holds too few samples."""
    reference = comparison.methods_of(question)[0]
    cautions = list[Block]()
    for flight in comparison.flights:
        row = next(
            row for row in comparison.summaries(flight, question) if row["method"] == reference
        )
        share = row["horizons"][-1]["inside"]
        if share is not None and share < PREDICTION_LIMITS.coverage:
            where = f" on {flight}" if len(comparison.flights) > 1 else ""
            kind = "forecasts" if question == KNOWN else "predictions"
            what = f"{reference}'s {kind} holds {100 * share:.0f} % of the samples{where}"
            cautions.append(caution(f"the 90 % band of {what}: it is too narrow."))
    return cautions


def _shared_horizons(comparison: Comparison) -> list[str]:
    """What horizons that all flights have are called, as at 100 Hz; the last is the whole test part."""
    steps = [
        [at["steps"] for at in comparison.summaries(flight)[0]["horizons"]]
        for flight in comparison.flights
    ]
    shared = min(map(len, steps))
    whole = {own[-1] for own in steps}
    return [*map(str, HORIZONS[: shared - 1]), str(*whole) if len(whole) == 1 else "all"]


def _over_flights(comparison: Comparison, questions: Sequence[Question]) -> list[Block]:
    header = _shared_horizons(comparison)
    text = f"{len(comparison.flights)} flights, {len(comparison.windows)} windows."
    blocks: list[Block] = [Sentence(text, "All flights:")]
    for question in questions:
        rows = comparison.over_flights(question)
        table = [
            [row["method"], *map(_ratio, row["horizons"]), *_counts(row, row["reference"])]
            for row in rows
        ]
        inside = _inside([(row["method"], row["inside"]) for row in rows], comparison)
        table += [[*row, "", "", "", ""] for row in inside]
        head = f"{WORDS.get(question, WORDS[KNOWN])} error ratio; steps:"
        blocks.append(Table([head, *header, *_count_columns(comparison)], table))
    return blocks


def _inside(
    methods: Sequence[tuple[str, Sequence[float | None]]], comparison: Comparison
) -> list[list[str]]:
    """Rows of the share in the 90 % band by horizon: of the first method, and of those that answer both questions."""
    shown: Collection[str] = {comparison.methods[0], *comparison.methods_of(UNKNOWN)}
    return [
        [
            f"{method}: in its 90 % band",
            *("" if share is None else f"{100 * share:.0f} %" for share in shares),
        ]
        for method, shares in methods
        if method in shown and any(share is not None for share in shares)
    ]


def _count_columns(comparison: Comparison) -> list[str]:
    return ["above 1", "unstable", f"{comparison.methods[0]} / method", "p"]


def _counts(row: Summary, test: Paired) -> list[str]:
    return [
        str(row["worse_than_constant"]),
        str(row["unstable"]),
        _ratio(test.ratio),
        f"{test.p_value:.2g}",
    ]


def _flight(comparison: Comparison, flight: str, questions: Sequence[Question]) -> list[Block]:
    windows = [window for window in comparison.windows if window.flight == flight]
    train = windows[0].train
    test = windows[0].test
    summaries = comparison.summaries(flight, questions[0])
    reference = summaries[0]["horizons"][-1]["reference"]
    known = {"flight": flight, "windows": len(windows), "train": train, "test": test}
    heading = section("comparison_flight", **known, tested=reference.tested)
    units = [readable(unit) for unit in train.output_units]
    columns = [named(name, unit.name) for name, unit in zip(train.output_names, units, strict=True)]
    head = f"RMSE, {len(test)} step{'s' if len(test) > 1 else ''} ahead"
    errors = [
        [
            row["method"],
            *(
                f"{unit.scale * sqrt(square):.3g}"
                for unit, square in zip(units, row["mspe"], strict=True)
            ),
            _ratio(row["relative"]),
            _ratio(row["worst"]),
            *_counts(row, row["horizons"][-1]["reference"]),
        ]
        for row in summaries
    ]
    header = [head, *columns, "error ratio", "worst", *_count_columns(comparison)]
    blocks: list[Block] = [*heading, Table(header, errors)]
    for question in (question for question in questions if question in WORDS):
        rows = comparison.summaries(flight, question)
        steps = [str(at["steps"]) for at in rows[0]["horizons"]]
        table = [
            [row["method"], *(_ratio(at["relative"]) for at in row["horizons"])] for row in rows
        ]
        table += _inside(
            [(row["method"], [at["inside"] for at in row["horizons"]]) for row in rows], comparison
        )
        blocks.append(Table([f"{WORDS[question]} error ratio; steps:", *steps], table))
    for row in summaries:
        blocks += section("comparison_failures", **row)
    return blocks


STANDARD_ORDER = 3  # of `mavdem learn`: angle, rate, and the motors' lag


def order_advice(choice: OrderChoice, known_inputs: bool = True) -> str:
    """Returns what to do with the order of a ``choice``, one sentence; ``known_inputs`` as for ``choose_order``."""
    (said,) = section(
        "order_advice",
        choice=choice,
        known_inputs=known_inputs,
        largest=LARGEST_ORDER,
        standard=STANDARD_ORDER,
    )
    return said.text


def order_report(
    choice: OrderChoice, names: Sequence[str], known_inputs: bool = True
) -> list[Block]:
    """Returns F̄ by order and flight, and the chosen order with its reason, and last what to do with it.

    ``names`` are those of the flights of ``choice``; ``known_inputs`` is as for ``choose_order``.
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
    spread = " Spread: the standard deviation over the flights." if several else ""
    return [
        Sentence("", str(choice.reason)),
        Table(["states", *names, *(["mean", "spread"] if several else [])], rows),
        Sentence(f"F̄ in nats, minus that of the chosen order.{spread}"),
        *map(caution, choice.remarks),
        Sentence(order_advice(choice, known_inputs), "Next:"),
    ]
