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
from mavdem.report.numbers import listed, named, readable
from mavdem.report.words import advised, bare

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
        *([] if from_zero else _losses(comparison)),
        *(_over_flights(comparison, questions) if several else []),
        *(
            block
            for flight in comparison.flights
            for block in _flight(comparison, flight, questions)
        ),
        _legend(comparison.methods[0], from_zero, several, UNKNOWN in questions),
    ]


def _verdict(comparison: Comparison, question: Question) -> str:
    """Than which methods' errors the first one's is lower or higher, and from which it is not distinguishable."""
    silent = [
        row["method"]
        for row in comparison.over_flights(question)
        if row["failed"] == row["windows"]
    ]
    tests = {
        method: test
        for method, test in comparison.verdicts(question).items()
        if method not in silent
    }
    without = f" No forecast was made by {listed(silent)}." if silent else ""
    if not tests:
        return without.strip()
    flights = len(comparison.flights)
    pairs = min(test.tested for test in tests.values())
    error = f"{comparison.methods_of(question)[0]}'s error{f' on {flights} flights' if flights > 1 else ''}"
    if pairs < FEWEST_PAIRS:
        few = f"only {'1 window does' if pairs == 1 else f'{pairs} windows do'} not overlap"
        return f"{error} is not distinguishable from another method's: {few}, and it takes {FEWEST_PAIRS}.{without}"
    parts = []
    for result, than in (
        (TestResult.HIGHER, "than"),
        (TestResult.NOT_DISTINGUISHABLE, "from"),
        (TestResult.LOWER, "than"),
    ):
        if names := [name for name, test in tests.items() if test.verdict == result]:
            which = (
                f"all {len(tests)} other methods" if 1 < len(names) == len(tests) else listed(names)
            )
            if result is TestResult.HIGHER:
                found = [(name, tests[name]) for name in names]
                which = listed(
                    f"{name} ({_ratio(test.ratio)} times, p = {test.p_value:.2g})"
                    for name, test in found
                )
            parts.append(f"{result} {than} that of {which}")
    return f"{error} over the whole test part is {'; '.join(parts)}.{without}"


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


def _losses(comparison: Comparison) -> list[Block]:
    """The ratios of one flight; of several flights, on how many the first method is worse."""
    reference = comparison.methods[0]
    losses = comparison.losses()
    flights = comparison.flights
    methods = list(dict.fromkeys(loss["method"] for loss in losses))
    if not losses:
        return []
    header, columns = _shared_horizons(comparison, KNOWN)
    head = f"{reference}'s error / the method's, where above 1; steps:"
    if len(flights) > 1:
        head = f"flights of {len(flights)} with {reference} worse (distinguishably); steps:"

    def cell(method: str, steps: Collection[tuple[str, int]]) -> str:
        lost = [
            one
            for one in losses
            if one["method"] == method and (one["flight"], one["steps"]) in steps
        ]
        worse = sum(one["paired"].verdict is TestResult.HIGHER for one in lost)
        if not lost or len(flights) > 1:
            return f"{len(lost)} ({worse})" if lost else ""
        return f"{'' if worse else '≈ '}{_ratio(lost[0]['ratio'])}"

    return [
        Table(
            [head, *header],
            [[method, *(cell(method, steps) for steps in columns)] for method in methods],
        )
    ]


def _shared_horizons(
    comparison: Comparison, question: Question
) -> tuple[list[str], list[set[tuple[str, int]]]]:
    """What horizons that all flights have are called, as at 100 Hz, and flights with steps; the last is the whole."""
    horizons = {
        flight: comparison.summaries(flight, question)[0]["horizons"]
        for flight in comparison.flights
    }
    steps = {flight: [at["steps"] for at in own] for flight, own in horizons.items()}
    if len(steps) == 1:
        ((flight, own),) = steps.items()
        return [*map(str, own)], [{(flight, one)} for one in own]
    shared = min(map(len, steps.values()))
    whole = {own[-1] for own in steps.values()}
    columns = [
        {(flight, own[column]) for flight, own in steps.items()}
        for column in (*range(shared - 1), -1)
    ]
    return [*map(str, HORIZONS[: shared - 1]), str(*whole) if len(whole) == 1 else "all"], columns


def _over_flights(comparison: Comparison, questions: Sequence[Question]) -> list[Block]:
    header, _ = _shared_horizons(comparison, questions[0])
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
    text = (
        f"{len(windows)} window{'s' if len(windows) > 1 else ''} of {len(train)} training and {len(test)} test "
        f"samples, at {1 / train.dt:.0f} Hz. The paired test uses the "
        f"{summaries[0]['horizons'][-1]['reference'].tested} that do not overlap."
    )
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
    blocks: list[Block] = [Sentence(text, f"{flight}:"), Table(header, errors)]
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
        counts = (
            (
                "failed",
                "made no forecast",
                f": {bare(advised(row['failure'])) if row['failure'] else ''}",
            ),
            ("diverged", "diverged to infinity or NaN", ""),
        )
        parts = [
            f"{what} in {row[key]} of {row['windows']} windows{why}"
            for key, what, why in counts
            if row[key]
        ]
        blocks += [Sentence(f"{row['method']} {'; and '.join(parts)}.")] if parts else []
    return blocks


def _legend(reference: str, from_zero: bool, several: bool, predicted: bool) -> Sentence:
    start = (
        "state 0, as in the paper's figures" if from_zero else "the state at the end of training"
    )
    overall = (
        " Over flights: the geometric mean of these medians; each flight is one pair."
        if several
        else ""
    )
    unknown = " Inputs unknown: only what came before each prediction is used." if predicted else ""
    return Sentence(
        f"Forecasts start from {start}. Error ratio: mean squared error over the baseline's (the constant mean of the "
        "training data), with each output in units of its training variance; below 1 is better than the baseline. "
        "The tables have the median over windows, the worst window and the number of windows above 1. “unstable” "
        "counts models with a growing mode. At k steps, the test part is forecast in pieces of k steps, each from the "
        f"data before it. {reference} / method: the median over windows of the ratio of their errors. p: Wilcoxon's "
        f"signed-rank test on these ratios, two-sided, for each method by itself; from {SIGNIFICANCE:g} on, the two "
        f"errors are not distinguishable (≈).{overall}{unknown} In its 90 % "
        "band: the share of the first k samples after training, mean over windows."
    )


STANDARD_ORDER = 3  # of `mavdem learn`: angle, rate, and the motors' lag


def order_advice(choice: OrderChoice, known_inputs: bool = True) -> str:
    """Returns what to do with the order of a ``choice``, one sentence; ``known_inputs`` as for ``choose_order``."""
    order = choice.chosen
    same = "forecasts, physical parameters and wind torque do not depend on it."
    if not choice.saturated and order < LARGEST_ORDER:
        more = (
            "Fly longer, with more motion"
            if choice.remarks
            else f"Try more states with --max-order {LARGEST_ORDER}"
        )
        return f"{more}: F̄ still increases at the highest order."
    if not known_inputs:
        return (
            "Keep the standard order of `mavdem learn`: it knows the motors, and this order "
            "is of a model without them."
        )
    if order > STANDARD_ORDER:
        return f"Use `mavdem learn --order {order}` where A, B and C must have these states; {same}"
    return f"Keep the standard order of `mavdem learn`, {STANDARD_ORDER} (angle, rate, and the motors' lag); {same}"


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
