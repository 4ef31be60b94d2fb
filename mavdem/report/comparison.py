"""The report of a comparison, in sentences and tables; first what the paired test says of DEM and each other method."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from math import sqrt

from mavdem.analysis.findings import PREDICTION_LIMITS
from mavdem.evaluate import HORIZONS, Paired
from mavdem.evaluate.comparison import GENERALIZED_COORDINATES, Comparison, Loss, MethodSummary, OverFlights, over
from mavdem.evaluate.paired_test import FEWEST_PAIRS, SIGNIFICANCE
from mavdem.report.blocks import Sentence, Table
from mavdem.report.names import listed, named, readable

GIVEN, PREDICTED = "What happened, given the inputs:", "What comes next, inputs unknown:"


def comparison_report(comparison: Comparison, from_zero: bool = False) -> list[Sentence | Table]:
    """The verdict on the first method, then the errors over flights and of each flight, and what the columns mean."""
    several = len(comparison.flights) > 1
    predictions = None if from_zero else comparison.predictions
    return [
        Sentence("", lead=_verdict(comparison, from_zero)),
        *([] if predictions is None else [Sentence(_verdict(predictions), PREDICTED)]),
        *([] if from_zero else _failed_bands(comparison, "forecasts")),
        *([] if predictions is None else _failed_bands(predictions, "predictions")),
        *([] if from_zero else _losses_by_horizon(comparison)),
        *(_over_flights(comparison, from_zero) if several else []),
        *_generalized_coordinates(comparison, from_zero),
        *(block for flight in comparison.flights for block in _flight(comparison, flight, from_zero)),
        _legend(comparison.methods[0], from_zero, several, predictions is not None),
    ]


def _verdict(comparison: Comparison, from_zero: bool = False) -> str:
    """Than which methods' errors the first one's is lower or higher, and from which it is not distinguishable."""
    silent = _silent(comparison)
    found = {method: one for method, one in comparison.verdicts(from_zero).items() if method not in silent}
    if not found:
        return f"No forecast was made by {listed(silent)}."
    reference, where = comparison.methods[0], _on_flights(comparison)
    without = f" No forecast was made by {listed(silent)}." if silent else ""
    pairs = min(one.tested for one in found.values())
    if pairs < FEWEST_PAIRS:
        apart = "1 window does" if pairs == 1 else f"{pairs} windows do"
        return (
            f"{reference}'s error{where} is not distinguishable from another method's: only {apart} not overlap, and "
            f"it takes {FEWEST_PAIRS}.{without}"
        )
    parts = []
    for verdict in ("higher", "not distinguishable", "lower"):
        names = [name for name, one in found.items() if one.verdict == verdict]
        if verdict == "higher":
            which = listed([f"{name} ({_times(found[name])})" for name in names])
        else:
            which = f"all {len(found)} other methods" if 1 < len(names) == len(found) else listed(names)
        if names:
            parts.append(f"{verdict} {'from' if verdict == 'not distinguishable' else 'than'} that of {which}")
    return f"{reference}'s error{where} over the whole test part is {'; '.join(parts)}.{without}"


def _times(one: Paired) -> str:
    return f"{_ratio(one.ratio)} times, p = {_p(one.p_value)}"


def _on_flights(comparison: Comparison) -> str:
    return f" on {len(comparison.flights)} flights" if len(comparison.flights) > 1 else ""


def _failed_bands(comparison: Comparison, what: str) -> list[Sentence]:
    """A caution for each flight on which the first method's band, of ``what``, holds too few samples."""
    reference, found = comparison.methods[0], []
    for flight in comparison.flights:
        share = next(one for one in comparison.summaries(flight) if one.method == reference).horizons[-1].inside
        if share is not None and share < PREDICTION_LIMITS.coverage:
            where = f" on {flight}" if len(comparison.flights) > 1 else ""
            text = f"the 90 % band of {reference}'s {what} holds {share:.0%} of the samples{where}: it is too narrow."
            found.append(Sentence(text, "Caution:"))
    return found


def _silent(comparison: Comparison) -> list[str]:
    """Methods that made no forecast at all."""
    return [one.method for one in comparison.over_flights() if one.failed == one.windows]


def _losses_by_horizon(comparison: Comparison) -> list[Sentence | Table]:
    """The ratios of one flight; of several flights, on how many the first method is worse."""
    reference, losses = comparison.methods[0], comparison.losses()
    methods = list(dict.fromkeys(loss.method for loss in losses))
    if not losses:
        return []
    if len(comparison.flights) == 1:
        horizons = [at.steps for at in comparison.summaries(comparison.flights[0])[0].horizons]
        ratio = {(loss.method, loss.steps): _marked(loss) for loss in losses}
        return [
            Table(
                [f"{reference}'s error / the method's, where above 1; steps:", *map(str, horizons)],
                [[method, *(ratio.get((method, steps), "") for steps in horizons)] for method in methods],
            )
        ]
    steps_of = {flight: [at.steps for at in comparison.summaries(flight)[0].horizons] for flight in comparison.flights}
    header, places = _shared_horizons(list(steps_of.values()))
    counts = {(method, place): [0, 0] for method in methods for place in places}
    for loss in losses:
        for place in places:
            here = loss.steps == steps_of[loss.flight][place]
            counts[loss.method, place][0] += here
            counts[loss.method, place][1] += here and loss.paired.verdict == "higher"
    cells = {key: f"{worse} ({sure})" if worse else "" for key, (worse, sure) in counts.items()}
    return [
        Table(
            [f"flights of {len(comparison.flights)} with {reference} worse (distinguishably); steps:", *header],
            [[method, *(cells[method, place] for place in places)] for method in methods],
        )
    ]


def _marked(loss: Loss) -> str:
    """The ratio, with ≈ where the two errors are not distinguishable."""
    return f"{'' if loss.paired.verdict == 'higher' else '≈ '}{_ratio(loss.ratio)}"


def _shared_horizons(steps: Sequence[Sequence[int]]) -> tuple[list[str], list[int]]:
    """What horizons that all flights have are called, as at 100 Hz, and their places; the last is the whole part."""
    shared = min(map(len, steps))
    whole = str(steps[0][-1]) if len({one[-1] for one in steps}) == 1 else "all"
    return [*map(str, HORIZONS[: shared - 1]), whole], [*range(shared - 1), -1]


def _over_flights(comparison: Comparison, from_zero: bool) -> list[Sentence | Table]:
    reference = comparison.methods[0]
    steps = [[at.steps for at in comparison.summaries(flight, from_zero)[0].horizons] for flight in comparison.flights]
    header, _ = _shared_horizons(steps)
    shown = _with_shown_bands(comparison)
    asked = [(GIVEN, comparison.over_flights(from_zero))]
    if comparison.predictions is not None and not from_zero:
        asked.append((PREDICTED, comparison.predictions.over_flights()))
    return [
        Sentence(f"{len(comparison.flights)} flights, {len(comparison.windows)} windows.", "All flights:"),
        *(
            Table(
                [f"{question} error ratio; steps:", *header, *_count_columns(reference)],
                [
                    *([one.method, *map(_ratio, one.horizons), *_counts(one, one.reference)] for one in overall),
                    *([*row, "", "", "", ""] for row in _inside([(one.method, one.inside) for one in overall], shown)),
                ],
            )
            for question, overall in asked
        ),
    ]


def _with_shown_bands(comparison: Comparison) -> Collection[str]:
    """Methods whose share in the band is shown: those that answer both questions, and the first."""
    predictions = comparison.predictions
    return {comparison.methods[0], *(() if predictions is None else predictions.methods)}


def _inside(methods: Sequence[tuple[str, Sequence[float | None]]], shown: Collection[str]) -> list[list[str]]:
    """Rows of the share of samples in the 90 % band up to each horizon, of the ``shown`` methods that have one."""
    return [
        [f"{method}: in its 90 % band", *("" if share is None else f"{share:.0%}" for share in shares)]
        for method, shares in methods
        if method in shown and any(share is not None for share in shares)
    ]


def _count_columns(reference: str) -> list[str]:
    return ["above 1", "unstable", f"{reference} / method", "p"]


def _counts(one: MethodSummary | OverFlights, paired: Paired) -> list[str]:
    return [str(one.worse_than_constant), str(one.unstable), _ratio(paired.ratio), _p(paired.p_value)]


def _generalized_coordinates(comparison: Comparison, from_zero: bool) -> list[Sentence | Table]:
    """As the paper's Table ``tab:SSE_GC``, of medians over windows."""
    pairs = [pair for pair in GENERALIZED_COORDINATES if set(pair) <= set(comparison.methods)]
    if not pairs:
        return []
    by_flight = {
        flight: {summary.method: summary.relative for summary in comparison.summaries(flight, from_zero)}
        for flight in comparison.flights
    }
    if len(by_flight) > 1:
        by_flight["all flights"] = {one.method: one.relative for one in comparison.over_flights(from_zero)}
    header = ["influence of generalized coordinates, error ratio"]
    for with_them, without in pairs:
        header += [with_them, without, "ratio"]
    rows = []
    for flight, error in by_flight.items():
        row = [flight]
        for with_them, without in pairs:
            row += [_ratio(error[with_them]), _ratio(error[without]), _ratio(over(error[with_them], error[without]))]
        rows.append(row)
    return [Table(header, rows)]


def _flight(comparison: Comparison, flight: str, from_zero: bool) -> list[Sentence | Table]:
    part, found, predictions = (
        comparison.of_flight(flight),
        comparison.summaries(flight, from_zero),
        comparison.predictions,
    )
    train, test, shown = part.windows[0].train, part.windows[0].test, _with_shown_bands(comparison)
    count = len(part.windows)
    return [
        Sentence(
            f"{count} window{'s' if count > 1 else ''} of {len(train)} training and {len(test)} test samples, at "
            f"{1 / train.dt:.0f} Hz. The paired test uses the {found[0].horizons[-1].reference.tested} that do not "
            "overlap.",
            f"{flight}:",
        ),
        _errors(part, found),
        *([] if from_zero else [_by_horizon(GIVEN, found, shown)]),
        *([] if from_zero or predictions is None else [_by_horizon(PREDICTED, predictions.summaries(flight), shown)]),
        *(Sentence(text) for one in found if (text := _without_forecast(one))),
    ]


def _without_forecast(summary: MethodSummary) -> str:
    parts = []
    if summary.failed:
        parts.append(f"made no forecast in {summary.failed} of {summary.windows} windows: {summary.failure}")
    if summary.diverged:
        parts.append(f"diverged to infinity or NaN in {summary.diverged} of {summary.windows} windows")
    return f"{summary.method} {'; and '.join(parts)}." if parts else ""


def _errors(part: Comparison, found: Sequence[MethodSummary]) -> Table:
    train, test = part.windows[0].train, part.windows[0].test
    units = [readable(unit) for unit in train.output_units]
    columns = [named(name, unit.name) for name, unit in zip(train.output_names, units, strict=True)]
    return Table(
        [
            f"RMSE, {len(test)} step{'s' if len(test) > 1 else ''} ahead",
            *columns,
            "error ratio",
            "worst",
            *_count_columns(part.methods[0]),
        ],
        [
            [
                one.method,
                *(f"{unit.scale * sqrt(square):.3g}" for unit, square in zip(units, one.mspe, strict=True)),
                _ratio(one.relative),
                _ratio(one.worst),
                *_counts(one, one.horizons[-1].reference),
            ]
            for one in found
        ],
    )


def _by_horizon(question: str, found: Sequence[MethodSummary], shown: Collection[str]) -> Table:
    return Table(
        [f"{question} error ratio; steps:", *(str(at.steps) for at in found[0].horizons)],
        [
            *([one.method, *(_ratio(at.relative) for at in one.horizons)] for one in found),
            *_inside([(one.method, [at.inside for at in one.horizons]) for one in found], shown),
        ],
    )


def _legend(reference: str, from_zero: bool, several: bool, predicted: bool) -> Sentence:
    start = "state 0, as in the paper's figures" if from_zero else "the state at the end of training"
    overall = " Over flights: the geometric mean of these medians; each flight is one pair." if several else ""
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


def _ratio(value: float) -> str:
    return f"{value:.3g}"


def _p(value: float) -> str:
    return f"{value:.2g}"
