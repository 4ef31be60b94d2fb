"""V.H: DEM beside PEM, subspace identification and EM."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from paper.drawing import DEM, DEM_WITHOUT, EM, MEASURED, ONE_STEP, OTHER, PEM, SUBSPACE, unseen
from paper.item import Cell, Found, Item, Picture, Table
from paper.laboratory import OURS, PEERS, REAL, WITH, Laboratory
from paper.published import BENCHMARK
from paper.verdict import Check
from paper.words import listed, number, percent

from mavdem.comparison import Outcome
from mavdem.windows import Window

Array = NDArray[np.float64]

STARTS = ("the data", "state 0")

COLOURS = {
    WITH: DEM,
    "subspace(2)": SUBSPACE,
    "PEM(2)": PEM,
    "EM(2)": EM,
    OURS: ONE_STEP,
    "subspace(4)": "#e08a5a",
    "ARX(2)": DEM_WITHOUT,
    "constant mean": OTHER,
}
"""Methods in the order of tables and legends: the paper's four, and what else a user may take."""

OTHERS = ("subspace(4)", "ARX(2)")
"""What a textbook offers beside the paper's peers."""

NAMES = {WITH: "DEM with the paper’s settings", OURS: "DEM with default settings"}

SHORT = {WITH: "DEM, paper’s", OURS: "DEM, default"}


class Standings(NamedTuple):
    """The error of each method on each flight.

    Attributes:
        flights: their names.
        errors: by method, (flights,).
    """

    flights: tuple[str, ...]
    errors: dict[str, Array]


def run(laboratory: Laboratory) -> Found:
    experiments = {start: _experiments(laboratory, start) for start in STARTS}
    sample = _sample(laboratory)
    by_flight = _by_flight(laboratory)
    real = _part(by_flight, tuple(name for name in laboratory.recorded if name == REAL))
    autopilots = _part(by_flight, tuple(name for name in laboratory.recorded if name != REAL))
    recorded = {"real AR.Drone": real, "autopilots’ flights": autopilots}
    return Found(
        checks=(
            *(least(experiments[start], WITH, tuple(PEERS), f"from {start}") for start in STARTS),
            _most_steps(sample, laboratory.sample),
            *([least(real, WITH, tuple(PEERS), "on the real AR.Drone")] if real.flights else []),
        ),
        beyond=(
            *(least(experiments[start], OURS, tuple(PEERS), f"from {start}") for start in STARTS),
            least(experiments[STARTS[0]], OURS, (*PEERS, *OTHERS), f"from {STARTS[0]}"),
            *([least(real, OURS, (*PEERS, *OTHERS), "on the real AR.Drone")] if real.flights else []),
            *([least(autopilots, OURS, (*PEERS, *OTHERS), "on the autopilots’ flights")] if autopilots.flights else []),
        ),
        numbers={
            **{
                f"mspe, from {start}": {name: one.errors[name].tolist() for name in one.errors}
                for start, one in experiments.items()
            },
            "squared_errors_by_step": {name: errors.tolist() for name, errors in by_step(sample, laboratory).items()},
            "all_windows": {
                "flights": list(by_flight.flights),
                "median_error_over_constant_mean": {name: own.tolist() for name, own in by_flight.errors.items()},
            },
            "unstable_models": _unstable(laboratory),
        },
        tables=(
            _losses(
                {f"experiments, from {start}": one for start, one in experiments.items()}
                | {name: one for name, one in recorded.items() if one.flights}
            ),
            *(
                _table(one, f"MSPE of the five experiments, from {start}", total=True)
                for start, one in experiments.items()
            ),
            _table(
                by_flight,
                "All windows of all flights, from the data: the median over a flight’s windows of the error over the "
                "constant mean’s (below 1 is better than knowing nothing)",
                total=False,
            ),
        ),
        pictures=(
            Picture(
                "benchmark-forecast",
                f"Forecasts of the test data of {laboratory.sample.flight}, from the data.",
                partial(_forecasts, laboratory.sample, sample),
            ),
            Picture(
                "benchmark-steps",
                f"Squared error n steps ahead on {laboratory.sample.flight}, summed over outputs.",
                partial(_steps, by_step(sample, laboratory)),
            ),
            Picture("benchmark-mspe", "MSPE of the five experiments.", partial(_bars, experiments)),
            Picture(
                "benchmark-flights",
                "All windows of all flights, from the data: the median over a flight’s windows of the error over the "
                "constant mean’s (line at 1).",
                partial(_dots, by_flight),
            ),
        ),
        remarks=(
            "MATLAB’s n4sid and pem are closed; ours are held against other libraries in tests. Number in brackets: "
            "states. DEM with the paper’s settings is the middle one of its random priors on the experiments, and one "
            "prior on all windows.",
            *(() if laboratory.recorded else ("The recorded flights are not on this machine and were left out.",)),
        ),
    )


def least(standings: Standings, ours: str, peers: tuple[str, ...], where: str) -> Check:
    """Whether one method errs less than each of some others on all flights.

    Args:
        standings: all methods on all flights.
        ours: the one.
        peers: the others.
        where: of which flights or start, for the words.
    """
    best = np.min([standings.errors[name] for name in peers], axis=0)
    own = standings.errors[ours]
    less = int((own < best).sum())
    ratio = float(np.exp(np.mean(np.log(own / best))))
    against = "the paper’s peers" if peers == tuple(PEERS) else f"all of {listed(peers)}"
    return Check(
        f"{NAMES[ours]}, {where}: it errs less than {listed(peers)} on every flight",
        less == len(own),
        f"{NAMES[ours]}, {where}, errs less than {against} on {less} of {len(own)}, {number(ratio)} times as much as "
        f"the best of them",
    )


def _losses(parts: dict[str, Standings]) -> Table:
    """On how many flights each other method errs less than DEM."""
    others = tuple(name for name in COLOURS if name not in (WITH, OURS))
    rows = []
    for ours in (WITH, OURS):
        for where, standings in parts.items():
            own, cells = standings.errors[ours], []
            for name in others:
                theirs = standings.errors[name]
                times = int((theirs < own).sum())
                ratio = float(np.exp(np.mean(np.log(own / theirs))))
                cells.append(Cell(f"{times} of {len(own)}", aside=f"{number(ratio)} ×"))
            rows.append((Cell(NAMES[ours], aside=where), *cells))
    return Table(
        "Where DEM loses: on how many flights another method errs less; below, small, DEM’s error over its (geometric "
        "mean over the flights)",
        ("", *others),
        tuple(rows),
    )


def _most_steps(sample: dict[str, Outcome], window: Window) -> Check:
    errors = np.array([_squares(sample[name], window) for name in (WITH, *PEERS)])
    share = float((errors.argmin(axis=0) == 0).mean())
    return Check(
        f"{NAMES[WITH]}, {window.flight}: of the paper’s four methods it has the least squared error at over half of "
        f"the steps",
        share > 0.5,
        f"{NAMES[WITH]} has the least squared error of the four at {percent(share)} of the steps of {window.flight}",
    )


def _squares(outcome: Outcome, window: Window) -> Array:
    """(H,) squared error of each step, summed over outputs; infinite where there is no forecast."""
    if outcome.forecast is None:
        return np.full(len(window.test), np.inf)
    return np.asarray(((outcome.forecast - window.test.outputs) ** 2).sum(axis=1))


def by_step(sample: dict[str, Outcome], laboratory: Laboratory) -> dict[str, Array]:
    """(H,) squared error of each method by step."""
    return {name: _squares(outcome, laboratory.sample) for name, outcome in sample.items()}


def _error(outcome: Outcome, start: str) -> float:
    return float((outcome.mspe if start == STARTS[0] else outcome.mspe_from_zero).sum())


def _middle(outcomes: list[Outcome], start: str) -> Outcome:
    """Of the forecasts from random priors the one whose error is the middle one."""
    return sorted(outcomes, key=lambda one: _error(one, start))[len(outcomes) // 2]


def _of(laboratory: Laboratory, name: str, experiment: int, start: str) -> Outcome:
    if name == WITH:
        return _middle(laboratory.draws[WITH][experiment], start)
    return laboratory.outcome(name, experiment)


def _experiments(laboratory: Laboratory, start: str) -> Standings:
    numbers = tuple(laboratory.experiments)
    return Standings(
        tuple(f"expt {one}" for one in numbers),
        {name: np.array([_error(_of(laboratory, name, one, start), start) for one in numbers]) for name in COLOURS},
    )


def _sample(laboratory: Laboratory) -> dict[str, Outcome]:
    return {name: _of(laboratory, name, laboratory.extent.sample, STARTS[0]) for name in COLOURS}


def _by_flight(laboratory: Laboratory) -> Standings:
    flights = laboratory.comparison.flights
    found = [{one.method: one.relative for one in laboratory.comparison.standings(flight)} for flight in flights]
    return Standings(flights, {name: np.array([one[name] for one in found]) for name in COLOURS})


def _part(standings: Standings, flights: tuple[str, ...]) -> Standings:
    places = [standings.flights.index(name) for name in flights]
    return Standings(flights, {name: errors[places] for name, errors in standings.errors.items()})


def _unstable(laboratory: Laboratory) -> dict[str, dict[str, int]]:
    compared = laboratory.comparison
    return {
        flight: {one.method: one.unstable for one in compared.standings(flight)} | {"windows": len(part.windows)}
        for flight in compared.flights
        for part in [compared.of_flight(flight)]
    }


def _table(standings: Standings, caption: str, total: bool) -> Table:
    errors = {name: np.append(own, own.sum()) if total else own for name, own in standings.errors.items()}
    least = np.min(list(errors.values()), axis=0)
    headings = (*standings.flights, "total") if total else standings.flights
    if total:
        rows = tuple(
            (Cell(NAMES.get(name, name)), *(Cell(number(a), bool(a == b)) for a, b in zip(own, least, strict=True)))
            for name, own in errors.items()
        )
        return Table(caption, ("method", *headings), rows)
    # As many flights as there are make rows better than columns.
    rows = tuple(
        (
            Cell("real AR.Drone" if flight == REAL else flight),
            *(Cell(number(own[place]), bool(own[place] == least[place])) for own in errors.values()),
        )
        for place, flight in enumerate(standings.flights)
    )
    return Table(caption, ("flight", *(SHORT.get(name, name) for name in errors)), rows)


def _forecasts(window: Window, sample: dict[str, Outcome]) -> Figure:
    test = window.test
    count = test.outputs.shape[1]
    figure, panels = plt.subplots(count, 1, figsize=(9, 2.3 * count), sharex=True, squeeze=False)
    axes = panels[:, 0]
    time = test.time - window.train.time[0]
    before = window.train[-100:]
    for place, panel in enumerate(axes):
        unseen(panel, time[0], time[-1])
        panel.plot(before.time - window.train.time[0], before.outputs[:, place], color=MEASURED, linewidth=2.2)
        panel.plot(time, test.outputs[:, place], color=MEASURED, linewidth=2.2, label="measured")
        for name, outcome in sample.items():
            if outcome.forecast is not None:
                panel.plot(time, outcome.forecast[:, place], color=COLOURS[name], label=NAMES.get(name, name))
        measured = np.concatenate([before.outputs[:, place], test.outputs[:, place]])
        # A forecast that explodes would flatten all others.
        middle, half = (measured.max() + measured.min()) / 2, np.ptp(measured) / 2
        panel.set_ylim(middle - 1.6 * half, middle + 1.6 * half)
        panel.set_ylabel(f"{test.output_names[place]}, {test.output_units[place]}")
    axes[-1].set_xlabel("time, s")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside right center")
    return figure


def _steps(errors: dict[str, Array]) -> Figure:
    figure, axes = plt.subplots(figsize=(9, 3.2))
    for name, own in errors.items():
        axes.plot(np.arange(1, len(own) + 1), own, color=COLOURS[name], linewidth=1.1, label=NAMES.get(name, name))
    axes.set(xlabel="steps ahead, n", ylabel="squared error", yscale="log")
    low = np.percentile(np.concatenate(list(errors.values())), 2)
    axes.set_ylim(bottom=float(low))
    axes.margins(x=0)
    figure.legend(loc="outside right center")
    return figure


def _bars(experiments: dict[str, Standings]) -> Figure:
    figure, panels = plt.subplots(len(experiments), 1, figsize=(9, 2.6 * len(experiments)), sharex=True)
    ceiling = 10 * max(float(one.errors["constant mean"].max()) for one in experiments.values())
    for axes, (start, standings) in zip(panels, experiments.items(), strict=True):
        width = 0.85 / len(COLOURS)
        for place, (name, own) in enumerate(standings.errors.items()):
            x = np.arange(len(own)) + (place - (len(COLOURS) - 1) / 2) * width
            axes.bar(x, np.minimum(own, ceiling), width * 0.92, color=COLOURS[name], label=NAMES.get(name, name))
        axes.set(title=f"from {start}", ylabel="MSPE", yscale="log")
        axes.set_ylim(top=ceiling)
        axes.set_xticks(range(len(standings.flights)), standings.flights)
        axes.grid(visible=False, axis="x")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside right center")
    return figure


def _dots(standings: Standings) -> Figure:
    figure, axes = plt.subplots(figsize=(9, 0.32 * len(standings.flights) + 1.2))
    y = np.arange(len(standings.flights))[::-1]
    ceiling = 100.0
    for name, own in standings.errors.items():
        if name != "constant mean":
            ours = name in (WITH, OURS)
            axes.plot(
                np.minimum(own, ceiling),
                y,
                "D" if ours else "o",
                color=COLOURS[name],
                markersize=7 if ours else 5,
                label=NAMES.get(name, name),
                zorder=3 if ours else 2,
            )
    axes.axvline(1, color=OTHER, linewidth=1)
    axes.set(xscale="log", xlabel="error over the constant mean’s (100 and more at the right edge)")
    axes.set_yticks(y, ["real AR.Drone" if name == REAL else name for name in standings.flights])
    figure.legend(loc="outside right center")
    return figure


ITEM = Item("benchmark", "DEM beside PEM, subspace identification and EM", BENCHMARK, run)
