"""What is told of bars, in sentences and tables: each beside what is asked, and then by flight."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from bars import DOUBTFUL, Array, Bars, Flags, geometric, share_of_samples

from mavdem.account import Sentence, Table

OF_ALL = "all flights"


def summary(bars: Bars) -> list[Sentence | Table]:
    """What is asked for beside what there is."""
    return [
        Table(
            [f"{bars.method}, after steps", "asked", *map(str, bars.steps)],
            [[bar.name, bar.asked, *(_told(value, bar.shown) for value in bar.reached)] for bar in bars.summary()],
        )
    ]


def details(bars: Bars) -> list[Sentence | Table]:
    """What there is by flight."""
    return [
        *(_over_best_peer(bars) if bars.peers else []),
        *(_over_peers(bars) if bars.peers else []),
        *_worse(bars),
        *_flagged(bars),
        *_inside_by_flight(bars),
        *(_over_without(bars) if bars.without else []),
    ]


def _over_best_peer(bars: Bars) -> list[Sentence | Table]:
    flights, ratio = bars.comparison.flights, bars.over_best_peer
    worst = ", ".join(
        f"{flights[place]} ({ratio[place, i]:.3g} after {steps})"
        for i, (steps, place) in enumerate(zip(bars.steps, ratio.argmax(axis=0), strict=True))
    )
    rows = _by_flight(flights, ratio)
    return [
        Table(
            [f"{bars.method}: median over the best peer's, after steps", *map(str, bars.steps)],
            [*rows, ["geometric mean", *_numbers(geometric(ratio))]],
        ),
        Sentence(f"{worst}. The best peer is chosen in hindsight, on each flight and at each horizon.", "Worst:"),
    ]


def _over_peers(bars: Bars) -> list[Sentence | Table]:
    return [
        Table(
            [f"{bars.method}: geometric mean over flights of the median over that of", *map(str, bars.steps)],
            [[peer, *_numbers(geometric(ratio))] for peer, ratio in bars.over_peers.items()],
        )
    ]


def _worse(bars: Bars) -> list[Sentence | Table]:
    rows = []
    for flight in (*bars.comparison.flights, OF_ALL):
        on = _on(bars, flight)
        relative = bars.relative[on]
        counts = map(str, (relative > 1).sum(axis=0))
        rows.append([flight, str(len(relative)), *counts, f"{relative[:, -1].max():.3g}"])
    header = ["windows", *map(str, bars.steps), f"worst after {bars.steps[-1]}"]
    return [Table([f"{bars.method}: windows worse than the constant mean, after steps", *header], rows)]


def _flagged(bars: Bars) -> list[Sentence | Table]:
    flags = {
        "cautioned": bars.cautioned,
        f"expected to err by more than {DOUBTFUL:g}": bars.doubted,
        "either": bars.cautioned | bars.doubted,
    }
    kinds = {"worse": bars.worse, "others": ~bars.worse}
    return [
        Table(
            [f"{bars.method}: windows flagged beforehand, after steps", *map(str, bars.steps)],
            [
                [f"{kind}, {name}", *map(str, (of & flag).sum(axis=0))]
                for kind, of in kinds.items()
                for name, flag in ({"all": of} | flags).items()
            ],
        ),
        Sentence(
            f"What the forecast expects to err over its first k samples, as it says itself, over what the constant "
            f"mean is expected to: flagged above {DOUBTFUL:g}."
        ),
    ]


def _inside_by_flight(bars: Bars) -> list[Sentence | Table]:
    length = bars.inside.shape[1]
    columns = {"all": range(1, length + 1)} | {str(steps): [steps] for steps in bars.steps}
    rows = []
    for flight in (*bars.comparison.flights, OF_ALL):
        inside = bars.inside[_on(bars, flight)]
        rows.append([flight, *(f"{share_of_samples(inside, numbers).mean():.2f}" for numbers in columns.values())])
    return [
        Table([f"{bars.method}: share in the 90 % band, sample number", *columns], rows),
        Sentence("Of one forecast in each window, from the end of training: its samples number k."),
    ]


def _over_without(bars: Bars) -> list[Sentence | Table]:
    (medians, each), flights = bars.over_without, bars.comparison.flights
    rows = [
        *_by_flight(flights, medians),
        ["geometric mean", *_numbers(geometric(medians))],
        [f"better, of {len(medians)} flights", *map(str, (medians < 1).sum(axis=0))],
        [f"better, of {len(each)} windows", *map(str, (each < 1).sum(axis=0))],
    ]
    return [Table([f"{bars.method}: median over that of {bars.without}, after steps", *map(str, bars.steps)], rows)]


def _told(value: float, shown: str) -> str:
    return "" if np.isnan(value) else f"{value:{shown}}"


def _on(bars: Bars, flight: str) -> Flags:
    return np.ones(len(bars.relative), bool) if flight == OF_ALL else bars.on(flight)


def _by_flight(flights: Sequence[str], values: Array) -> list[list[str]]:
    return [[flight, *_numbers(row)] for flight, row in zip(flights, values, strict=True)]


def _numbers(values: Array) -> list[str]:
    return [f"{value:.3g}" for value in values]
