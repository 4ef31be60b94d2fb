"""What is told of a comparison, in sentences and tables: first where DEM loses; who tells it lays it out."""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt

from mavdem.account import Sentence, Table
from mavdem.comparison.comparison import Comparison
from mavdem.comparison.methods import GENERALIZED_COORDINATES
from mavdem.comparison.standing import Loss, Standing, over
from mavdem.evaluate import HORIZONS
from mavdem.naming import named, readable

TOLD = 5
"""Losses that are told in a sentence; the table after them has all."""


def account(comparison: Comparison, from_zero: bool = False) -> list[Sentence | Table]:
    """What a user must know of a comparison, then what can be known, in this order.

    Args:
        comparison: of one or several flights.
        from_zero: of forecasts that begin with state 0, and not with the state at the end of training.
    """
    several = len(comparison.flights) > 1
    return [
        *_losses(comparison, from_zero),
        *(_over_flights(comparison, from_zero) if several else []),
        *_generalized_coordinates(comparison, from_zero),
        *(block for flight in comparison.flights for block in _flight(comparison, flight, from_zero)),
        _meaning(comparison.methods[0], from_zero, several),
    ]


def _losses(comparison: Comparison, from_zero: bool) -> list[Sentence | Table]:
    reference, losses = comparison.methods[0], comparison.losses(from_zero)
    several, silent = len(comparison.flights) > 1, _silent(comparison)
    if not losses:
        horizons = "" if from_zero else " at every horizon"
        where = "on every flight" if several else "on this flight"
        others = len(comparison.methods) - len(silent)
        without = f" No forecast was made by {', '.join(silent)}." if silent else ""
        return [Sentence("", lead=f"{reference} errs least of all {others} methods, {where}{horizons}.{without}")]
    whole = [loss for loss in losses if loss.steps == _longest(comparison, loss.flight)]
    blocks: list[Sentence | Table] = []
    if whole:
        told = "; ".join(_loss(loss, comparison) for loss in whole[:TOLD])
        more = f"; and in {len(whole) - TOLD} more cases" if len(whole) > TOLD else ""
        on = f" on {len({loss.flight for loss in whole})} of {len(comparison.flights)} flights" if several else ""
        blocks.append(Sentence("", lead=f"{reference} loses{on}, over the whole test part: {told}{more}."))
    else:
        blocks.append(
            Sentence("", lead=f"{reference} errs least over the whole test part, and loses at shorter horizons.")
        )
    return [*blocks, *([] if from_zero else [_losses_by_horizon(comparison, losses)])]


def _silent(comparison: Comparison) -> list[str]:
    """Methods that made no forecast at all."""
    return [one.method for one in comparison.over_flights() if one.failed == one.windows]


def _loss(loss: Loss, comparison: Comparison) -> str:
    where = f" on {loss.flight}" if len(comparison.flights) > 1 else ""
    return (
        f"to {loss.method}{where}, its median error being {_ratio(loss.ratio)} times as large (window by window "
        f"{_ratio(loss.paired.ratio)} times in the median, p = {_p(loss.paired.p_value)})"
    )


def _longest(comparison: Comparison, flight: str) -> int:
    return next(len(window.test) for window in comparison.windows if window.flight == flight)


def _losses_by_horizon(comparison: Comparison, losses: Sequence[Loss]) -> Table:
    """Of one flight the ratios; of several, on how many of them."""
    reference = comparison.methods[0]
    methods = list(dict.fromkeys(loss.method for loss in losses))
    if len(comparison.flights) == 1:
        horizons = [at.steps for at in comparison.standings(comparison.flights[0])[0].horizons]
        ratio = {(loss.method, loss.steps): _ratio(loss.ratio) for loss in losses}
        return Table(
            [f"{reference}'s median error over that of, where larger, after steps", *map(str, horizons)],
            [[method, *(ratio.get((method, steps), "") for steps in horizons)] for method in methods],
        )
    steps_of = {flight: [at.steps for at in comparison.standings(flight)[0].horizons] for flight in comparison.flights}
    header, places = _shared_horizons(list(steps_of.values()))
    counts = {(method, place): 0 for method in methods for place in places}
    for loss in losses:
        for place in places:
            counts[loss.method, place] += loss.steps == steps_of[loss.flight][place]
    return Table(
        [f"{reference} loses to, on so many of {len(comparison.flights)} flights, after steps", *header],
        [[method, *(str(counts[method, place] or "") for place in places)] for method in methods],
    )


def _shared_horizons(steps: Sequence[Sequence[int]]) -> tuple[list[str], list[int]]:
    """What horizons that all flights have are called, as at 100 Hz, and their places; the last is the whole part."""
    shared = min(map(len, steps))
    whole = str(steps[0][-1]) if len({one[-1] for one in steps}) == 1 else "all"
    return [*map(str, HORIZONS[: shared - 1]), whole], [*range(shared - 1), -1]


def _over_flights(comparison: Comparison, from_zero: bool) -> list[Sentence | Table]:
    reference, overall = comparison.methods[0], comparison.over_flights(from_zero)
    steps = [[at.steps for at in comparison.standings(flight, from_zero)[0].horizons] for flight in comparison.flights]
    header, _ = _shared_horizons(steps)
    return [
        Sentence(f"{len(comparison.flights)} flights, {len(comparison.windows)} windows.", "All flights:"),
        Table(
            [
                "over constant mean, after steps",
                *header,
                "above 1",
                "unstable",
                *_beside(reference),
            ],
            [
                [
                    one.method,
                    *map(_ratio, one.horizons),
                    str(one.worse_than_constant),
                    str(one.unstable),
                    _ratio(one.reference.ratio),
                    _p(one.reference.p_value),
                ]
                for one in overall
            ],
        ),
    ]


def _beside(reference: str) -> list[str]:
    return [f"{reference} over it", "p"]


def _generalized_coordinates(comparison: Comparison, from_zero: bool) -> list[Sentence | Table]:
    """As the paper's Table ``tab:SSE_GC``, of medians over windows."""
    pairs = [pair for pair in GENERALIZED_COORDINATES if set(pair) <= set(comparison.methods)]
    if not pairs:
        return []
    by_flight = {
        flight: {standing.method: standing.relative for standing in comparison.standings(flight, from_zero)}
        for flight in comparison.flights
    }
    if len(by_flight) > 1:
        by_flight["all flights"] = {one.method: one.relative for one in comparison.over_flights(from_zero)}
    header = ["influence of generalized coordinates, over constant mean"]
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
    part, found = comparison.of_flight(flight), comparison.standings(flight, from_zero)
    train, test = part.windows[0].train, part.windows[0].test
    count = len(part.windows)
    return [
        Sentence(
            f"{count} window{'s' if count > 1 else ''} of {len(train)} samples to learn from and {len(test)} to "
            f"forecast, at {1 / train.dt:.0f} Hz; the paired test is of {found[0].horizons[-1].reference.tested} that "
            "do not overlap.",
            f"{flight}:",
        ),
        _errors(part, found),
        *([] if from_zero else [_by_horizon(found)]),
        *(Sentence(told) for one in found if (told := _without_forecast(one))),
    ]


def _without_forecast(standing: Standing) -> str:
    told = []
    if standing.failed:
        told.append(f"made no forecast in {standing.failed} of {standing.windows} windows: {standing.failure}")
    if standing.diverged:
        told.append(f"ran beyond all numbers in {standing.diverged} of {standing.windows} windows")
    return f"{standing.method} {'; and '.join(told)}." if told else ""


def _errors(part: Comparison, found: Sequence[Standing]) -> Table:
    train, test = part.windows[0].train, part.windows[0].test
    units = [readable(unit) for unit in train.output_units]
    columns = [named(name, unit.name) for name, unit in zip(train.output_names, units, strict=True)]
    return Table(
        [
            f"{len(test)} step{'s' if len(test) > 1 else ''} ahead, rms",
            *columns,
            "over constant mean",
            "worst",
            "above 1",
            "unstable",
            *_beside(part.methods[0]),
        ],
        [
            [
                one.method,
                *(f"{unit.scale * sqrt(square):.3g}" for unit, square in zip(units, one.mspe, strict=True)),
                _ratio(one.relative),
                _ratio(one.worst),
                str(one.worse_than_constant),
                str(one.unstable),
                _ratio(one.horizons[-1].reference.ratio),
                _p(one.horizons[-1].reference.p_value),
            ]
            for one in found
        ],
    )


def _by_horizon(found: Sequence[Standing]) -> Table:
    return Table(
        ["over constant mean, after steps", *(str(at.steps) for at in found[0].horizons)],
        [[one.method, *(_ratio(at.relative) for at in one.horizons)] for one in found],
    )


def _meaning(reference: str, from_zero: bool, several: bool) -> Sentence:
    begun = "0, as in the paper's figures" if from_zero else "the state at the end of training"
    overall = " Over flights: the geometric mean of these medians, and as a pair each flight." if several else ""
    return Sentence(
        f"Forecasts begin with {begun}. Over constant mean: mean square, each output in units of its training "
        "variance, over the constant mean's; below 1 is better than knowing nothing. It is the median over windows, "
        "beside the worst, and in how many it is above 1. After k steps: the test part forecast in pieces of k, each "
        f"from the data before it. {reference} over it: the median of the windows' ratios, and p of Wilcoxon's "
        f"signed-rank test on them, two-sided, for each method by itself.{overall}"
    )


def _ratio(value: float) -> str:
    return f"{value:.3g}"


def _p(value: float) -> str:
    return f"{value:.2g}"
