"""Section V.H: DEM compared with PEM, subspace identification and EM."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mavdem.evaluate.scores import Outcome
from mavdem.evaluate.windows import Window
from mavdem.paper.checks import Check
from mavdem.paper.claims import BENCHMARK
from mavdem.paper.drawing import DEM, DEM_WITHOUT, EM, MEASURED, ONE_STEP, OTHER, PEM, SUBSPACE, unseen
from mavdem.paper.flights import REAL
from mavdem.paper.item import Cell, Item, ItemResult, PageTable, Picture
from mavdem.paper.runner import OTHERS, OURS, PEERS, STARTS, WITH, Runner, median_draw, total_mspe
from mavdem.paper.words import number, percent
from mavdem.report.names import listed

Array = NDArray[np.float64]

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
"""Methods in the order of tables and legends: the paper's four, then others."""

NAMES = {WITH: "DEM with the paper’s settings", OURS: "DEM with default settings"}

SHORT = {WITH: "DEM, paper’s", OURS: "DEM, default"}


class MethodErrors(NamedTuple):
    """The error of each method on each flight."""

    flights: tuple[str, ...]
    errors: dict[str, Array]  # by method, (flights,)


def run(runner: Runner) -> ItemResult:
    """Tries each method on the five experiments, and on all windows of all flights."""
    experiments = {start: _experiments(runner, start) for start in STARTS}
    sample = {name: _of(runner, name, runner.extent.sample, STARTS[0]) for name in COLOURS}
    squares = by_step(sample, runner.sample)
    by_flight = _by_flight(runner)
    autopilots = tuple(name for name in runner.recorded if name != REAL)
    real = {"real AR.Drone": _part(by_flight, (REAL,))} if REAL in runner.recorded else {}
    recorded = real | ({"autopilots’ flights": _part(by_flight, autopilots)} if autopilots else {})
    return ItemResult(
        checks=(
            *(least(experiments[start], WITH, PEERS, f"from {start}") for start in STARTS),
            _most_steps(squares, runner.sample.flight),
            *(least(one, WITH, PEERS, f"on the {name}") for name, one in real.items()),
        ),
        beyond=(
            *(least(experiments[start], OURS, PEERS, f"from {start}") for start in STARTS),
            least(experiments[STARTS[0]], OURS, (*PEERS, *OTHERS), f"from {STARTS[0]}"),
            *(least(one, OURS, (*PEERS, *OTHERS), f"on the {name}") for name, one in recorded.items()),
        ),
        numbers={
            **{
                f"mspe, from {start}": {name: one.errors[name].tolist() for name in one.errors}
                for start, one in experiments.items()
            },
            "squared_errors_by_step": {name: errors.tolist() for name, errors in squares.items()},
            "all_windows": {
                "flights": list(by_flight.flights),
                "median_error_over_constant_mean": {name: own.tolist() for name, own in by_flight.errors.items()},
            },
            "unstable_models": _unstable(runner),
        },
        tables=(
            _losses({f"experiments, from {start}": one for start, one in experiments.items()} | recorded),
            *(
                _table(one, f"MSPE of the five experiments, from {start}", total=True)
                for start, one in experiments.items()
            ),
            _table(
                by_flight,
                "All windows of all flights, from the data: the median over a flight’s windows of the error over the "
                "constant mean’s (below 1 is better than the mean)",
                total=False,
            ),
        ),
        pictures=(
            Picture(
                "benchmark-forecast",
                f"Forecasts of the test data of {runner.sample.flight}, from the data.",
                partial(_forecasts, runner.sample, sample),
            ),
            Picture(
                "benchmark-steps",
                f"Squared error n steps ahead on {runner.sample.flight}, summed over outputs.",
                partial(_steps, squares),
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
            "MATLAB’s n4sid and pem are not public; tests compare ours with other libraries. Number in brackets: "
            "states. DEM with the paper’s settings is the median over random priors on the experiments, and one prior "
            "on all windows.",
            *(() if runner.recorded else ("The recorded flights are not on this machine and are left out.",)),
        ),
    )


def least(standings: MethodErrors, ours: str, peers: tuple[str, ...], where: str) -> Check:
    """Whether one method has a lower error than each of its peers on all flights; ``where`` is for the sentences."""
    best = np.min([standings.errors[name] for name in peers], axis=0)
    own = standings.errors[ours]
    less = int((own < best).sum())
    ratio = float(np.exp(np.mean(np.log(own / best))))
    against = "the paper’s peers" if peers == PEERS else f"all of {listed(peers)}"
    return Check(
        f"{NAMES[ours]}, {where}: its error is lower than that of {listed(peers)} on every flight",
        less == len(own),
        f"{NAMES[ours]}, {where}, has a lower error than {against} on {less} of {len(own)}; its error is "
        f"{number(ratio)} times that of the best of them",
    )


def _losses(parts: dict[str, MethodErrors]) -> PageTable:
    """On how many flights each other method has a lower error than DEM."""
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
    return PageTable(
        "Where DEM loses: the number of flights on which another method has a lower error; small, the ratio of DEM’s "
        "error to its error (geometric mean over flights)",
        ("", *others),
        tuple(rows),
    )


def _most_steps(squares: dict[str, Array], flight: str) -> Check:
    errors = np.array([squares[name] for name in (WITH, *PEERS)])
    share = float((errors.argmin(axis=0) == 0).mean())
    return Check(
        f"{NAMES[WITH]}, {flight}: of the paper’s four methods it has the least squared error at over half of "
        f"the steps",
        share > 0.5,
        f"{NAMES[WITH]} has the least squared error of the four at {percent(share)} of the steps of {flight}",
    )


def by_step(sample: dict[str, Outcome], window: Window) -> dict[str, Array]:
    """(H,) squared error of each method by step, summed over outputs; infinite where there is no forecast."""
    return {
        name: np.full(len(window.test), np.inf)
        if forecast is None
        else np.asarray(((forecast - window.test.outputs) ** 2).sum(axis=1))
        for name, forecast in ((name, outcome.forecast) for name, outcome in sample.items())
    }


def _of(runner: Runner, name: str, experiment: int, start: str) -> Outcome:
    if name == WITH:
        return median_draw(runner.draws[WITH][experiment], start)
    return runner.outcome(name, experiment)


def _experiments(runner: Runner, start: str) -> MethodErrors:
    numbers = tuple(runner.experiments)
    return MethodErrors(
        tuple(f"expt {one}" for one in numbers),
        {name: np.array([total_mspe(_of(runner, name, one, start), start) for one in numbers]) for name in COLOURS},
    )


def _by_flight(runner: Runner) -> MethodErrors:
    flights = runner.comparison.flights
    found = [{one.method: one.relative for one in runner.comparison.summaries(flight)} for flight in flights]
    return MethodErrors(flights, {name: np.array([one[name] for one in found]) for name in COLOURS})


def _part(standings: MethodErrors, flights: tuple[str, ...]) -> MethodErrors:
    places = [standings.flights.index(name) for name in flights]
    return MethodErrors(flights, {name: errors[places] for name, errors in standings.errors.items()})


def _unstable(runner: Runner) -> dict[str, dict[str, int]]:
    compared = runner.comparison
    return {
        flight: {one.method: one.unstable for one in compared.summaries(flight)}
        | {"windows": len(compared.of_flight(flight).windows)}
        for flight in compared.flights
    }


def _table(standings: MethodErrors, caption: str, total: bool) -> PageTable:
    errors = {name: np.append(own, own.sum()) for name, own in standings.errors.items()}
    least = np.min(list(errors.values()), axis=0)
    if total:
        rows = tuple(
            (Cell(NAMES.get(name, name)), *(Cell(number(a), bool(a == b)) for a, b in zip(own, least, strict=True)))
            for name, own in errors.items()
        )
        return PageTable(caption, ("method", *standings.flights, "total"), rows)
    # There are too many flights for columns.
    rows = tuple(
        (
            Cell("real AR.Drone" if flight == REAL else flight),
            *(Cell(number(own[place]), bool(own[place] == least[place])) for own in errors.values()),
        )
        for place, flight in enumerate(standings.flights)
    )
    return PageTable(caption, ("flight", *(SHORT.get(name, name) for name in errors)), rows)


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
        # A forecast that diverges would flatten all others.
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


def _bars(experiments: dict[str, MethodErrors]) -> Figure:
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


def _dots(standings: MethodErrors) -> Figure:
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


ITEM = Item(BENCHMARK, run)
