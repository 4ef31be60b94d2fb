"""Section V.G: forecasts with generalized coordinates, p = 2, and without, p = 1."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from typing import Any, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mavdem.evaluate import paired
from mavdem.evaluate.scores import Outcome
from mavdem.evaluate.windows import Window
from mavdem.paper.checks import Check
from mavdem.paper.claims import COORDINATES, MSPE_WITH_COORDINATES, MSPE_WITHOUT_COORDINATES
from mavdem.paper.drawing import DEM, DEM_WITHOUT, MEASURED, ink, unseen
from mavdem.paper.flights import REAL
from mavdem.paper.item import Cell, Item, ItemResult, PageTable, Picture
from mavdem.paper.runner import OURS, OURS_WITHOUT, STARTS, WITH, WITHOUT, Runner, median_draw, total_mspe
from mavdem.paper.words import number, percent
from mavdem.report.names import listed

Array = NDArray[np.float64]

SETTINGS = {"paper’s": (WITH, WITHOUT), "default": (OURS, OURS_WITHOUT)}  # with generalized coordinates, and without
MIN_SHARE = 0.8  # share of the experiments on which p = 2 must have the lower error, as on four of the paper's five


class PairedErrors(NamedTuple):
    """MSPE with and without generalized coordinates, summed over outputs, (experiments, priors) each."""

    with_: Array
    without: Array

    @property
    def medians(self) -> tuple[Array, Array]:
        """(experiments,) each: the median over priors."""
        return np.median(self.with_, axis=1), np.median(self.without, axis=1)


def run(runner: Runner) -> ItemResult:
    """Tries DEM with p = 2 and p = 1 on the five experiments, from many random priors, and on recorded flights."""
    draws = {name: runner.draws[name] for name in (WITH, WITHOUT)}
    of_default = [[[runner.outcome(name, one)] for one in runner.experiments] for name in (OURS, OURS_WITHOUT)]
    drawn = {start: _errors([own.values() for own in draws.values()], start) for start in STARTS}
    ours = {start: _errors(of_default, start) for start in STARTS}
    middle = {name: median_draw(own[runner.extent.sample], STARTS[0]) for name, own in draws.items()}
    recorded = _recorded(runner)
    return ItemResult(
        checks=(
            *(check for start in STARTS for check in checks(drawn[start], f"the paper’s settings, from {start}")),
            *_of_real_flight(recorded, "paper’s"),
        ),
        beyond=(
            *(check for start in STARTS for check in checks(ours[start], f"default settings, from {start}")),
            *_of_real_flight(recorded, "default"),
        ),
        numbers={
            "paper": {"with": MSPE_WITH_COORDINATES, "without": MSPE_WITHOUT_COORDINATES},
            **{
                f"{name}, from {start}": {"with": one.with_.tolist(), "without": one.without.tolist()}
                for name, errors in (("paper’s settings", drawn), ("default settings", ours))
                for start, one in errors.items()
            },
            "recorded_flights": recorded,
        },
        tables=(_table(runner, drawn, ours), *([_table_recorded(recorded)] if recorded else [])),
        pictures=(
            Picture(
                "coordinates-forecast",
                "Forecast with generalized coordinates (green) and without (yellow) beside the measurement (red), from "
                "the random prior with the median error.",
                partial(_forecasts, runner.sample, middle),
            ),
            Picture(
                "coordinates-mspe",
                "MSPE from each random prior (dots), their median (bar), and the paper’s number (diamond), which is of "
                "other flights.",
                partial(_spread, tuple(runner.experiments), drawn),
            ),
        ),
        remarks=(
            "The flights are simulated ones of the same vehicle in the wind of a blower, so the paper’s numbers are of "
            "comparable size only. The claim is which of the two has the lower error.",
            "p = 1 estimates its derivative from two samples and p = 2 from three: part of the difference is a delay "
            "of half a sample and not an effect of generalized coordinates (docs/engine.md).",
            *([_of_autopilots(recorded)] if recorded else []),
        ),
    )


def checks(errors: PairedErrors, what: str) -> tuple[Check, ...]:
    """Whether p = 2 has the lower error in total, and on most experiments; ``what`` names settings and start."""
    with_, without = errors.medians
    less = int((with_ < without).sum())
    return (
        Check(
            f"{what}: the total MSPE over experiments is lower with p = 2 than with p = 1, and also on at least "
            f"{percent(MIN_SHARE)} of them (median over random priors)",
            bool(with_.sum() < without.sum() and less >= MIN_SHARE * len(with_)),
            f"{what}: the total MSPE is {number(with_.sum())} with p = 2 and {number(without.sum())} with p = 1, lower "
            f"with p = 2 on {less} of {len(with_)}",
        ),
    )


def _of_real_flight(rows: list[dict[str, Any]], settings: str) -> tuple[Check, ...]:
    """Whether p = 2 has the lower error on the real flight, where it is available."""
    return tuple(
        Check(
            f"the real AR.Drone, {settings} settings, from the data: the median over windows of the error with p = 2 "
            f"over that with p = 1 is less than 1",
            row["ratio"] < 1,
            f"on the real AR.Drone, {settings} settings, the error ratio of p = 2 to p = 1 is {number(row['ratio'])}",
        )
        for row in rows
        if row["flight"] == REAL and row["settings"] == settings
    )


def _of_autopilots(rows: list[dict[str, Any]]) -> str:
    """How often p = 2 has the lower error on the autopilots' flights."""
    parts = []
    for settings in SETTINGS:
        ratios = [row["ratio"] for row in rows if row["settings"] == settings and row["flight"] != REAL]
        parts.append(f"on {sum(ratio < 1 for ratio in ratios)} of {len(ratios)} with the {settings} settings")
    return f"Beyond the paper, p = 2 has the lower error on the autopilots’ flights {listed(parts)}."


def _errors(by_method: Iterable[Iterable[list[Outcome]]], start: str) -> PairedErrors:
    """Of the outcomes by method, experiment and prior."""
    return PairedErrors(
        *(np.array([[total_mspe(one, start) for one in priors] for priors in own]) for own in by_method)
    )


def _recorded(runner: Runner) -> list[dict[str, Any]]:
    """By recorded flight: the error with generalized coordinates over that without, and on how many windows less."""
    rows: list[dict[str, Any]] = []
    for flight in runner.recorded:
        part = runner.comparison.of_flight(flight)
        by_method = dict(zip(part.methods, zip(*part.outcomes, strict=True), strict=True))
        for settings, (with_, without) in SETTINGS.items():
            ours, theirs = ([total_mspe(each, STARTS[0]) for each in by_method[name]] for name in (with_, without))
            one = paired(ours, theirs)
            rows.append({"flight": flight, "settings": settings, **one._asdict()})
    return rows


def _table(runner: Runner, drawn: dict[str, PairedErrors], ours: dict[str, PairedErrors]) -> PageTable:
    numbers = tuple(runner.experiments)
    without, with_ = (
        [values[number - 1] for number in numbers] for values in (MSPE_WITHOUT_COORDINATES, MSPE_WITH_COORDINATES)
    )
    rows = [*_pair("the paper, its flights", np.array([without]).T, np.array([with_]).T)]
    for name, errors in (("the paper’s settings", drawn), ("default settings", ours)):
        for start, one in errors.items():
            rows += _pair(f"{name}, from {start}", one.without, one.with_)
    return PageTable(
        "Influence of generalized coordinates on MSPE; over random priors the median and, small, the 10 % and "
        "90 % quantiles",
        ("DEM", *(f"expt {number}" for number in numbers), "total"),
        tuple(rows),
    )


def _pair(name: str, without: Array, with_: Array) -> list[tuple[Cell, ...]]:
    totals = [np.append(np.median(one, axis=1), np.median(one, axis=1).sum()) for one in (without, with_)]
    rows = []
    for label, one, own, other in (
        (f"{name}, p = 1", without, totals[0], totals[1]),
        (f"{name}, p = 2", with_, totals[1], totals[0]),
    ):
        spreads = [_quantiles(row) for row in one] + [""]
        cells = zip(own, other, spreads, strict=True)
        rows.append((Cell(label), *(Cell(number(a), bool(a < b), spread) for a, b, spread in cells)))
    return rows


def _quantiles(priors: Array) -> str:
    if len(priors) == 1:
        return ""
    low, high = np.percentile(priors, [10, 90])
    return f"{number(low)}–{number(high)}"


def _table_recorded(rows: list[dict[str, Any]]) -> PageTable:
    by_place = {(row["flight"], row["settings"]): row for row in rows}
    cells = []
    for flight in dict.fromkeys(row["flight"] for row in rows):
        line = [Cell("real AR.Drone" if flight == REAL else flight)]
        for settings in SETTINGS:
            row = by_place[flight, settings]
            line += [Cell(number(row["ratio"]), row["ratio"] < 1), Cell(f"{row['less']} of {row['windows']}")]
        cells.append(tuple(line))
    return PageTable(
        "Recorded flights, from the data: the median over windows of the error with p = 2 over that with p = 1 (below "
        "1, generalized coordinates help), and the number of windows in which it is lower",
        ("flight", "the paper’s settings", "lower in", "default settings", "lower in"),
        tuple(cells),
    )


def _forecasts(window: Window, middle: dict[str, Outcome]) -> Figure:
    test = window.test
    count = test.outputs.shape[1]
    figure, axes = plt.subplots(count, 2, figsize=(11, 2.1 * count), sharex=True, sharey="row")
    time = test.time - window.train.time[0]
    for column, start in enumerate(STARTS):
        for place in range(count):
            panel = axes[place, column]
            unseen(panel, time[0], time[-1])
            panel.plot(time, test.outputs[:, place], color=MEASURED, linewidth=2, label="measured")
            for name, label, colour in ((WITH, "DEM, p = 2", DEM), (WITHOUT, "DEM, p = 1", DEM_WITHOUT)):
                one = middle[name]
                forecast = one.forecast if start == STARTS[0] else one.forecast_from_zero
                if forecast is not None:
                    panel.plot(time, forecast[:, place], color=colour, label=label)
        axes[0, column].set_title(f"from {start}")
        axes[-1, column].set_xlabel("time, s")
    for place in range(count):
        axes[place, 0].set_ylabel(f"{test.output_names[place]}, {test.output_units[place]}")
    axes[0, 0].legend(ncols=3, loc="best")
    return figure


def _spread(numbers: tuple[int, ...], drawn: dict[str, PairedErrors]) -> Figure:
    figure, panels = plt.subplots(1, len(drawn), figsize=(11, 3.2), sharey=True)
    jitter = np.random.default_rng(0)
    for axes, (start, errors) in zip(panels, drawn.items(), strict=True):
        for offset, values, published, label, colour in (
            (-0.18, errors.without, MSPE_WITHOUT_COORDINATES, "p = 1", DEM_WITHOUT),
            (0.18, errors.with_, MSPE_WITH_COORDINATES, "p = 2", DEM),
        ):
            x = np.arange(len(numbers)) + offset
            for at, priors in zip(x, values, strict=True):
                axes.plot(at + jitter.uniform(-0.09, 0.09, len(priors)), priors, ".", color=colour, alpha=0.5, zorder=2)
            axes.bar(x, np.median(values, axis=1), 0.32, color=colour, alpha=0.35, label=label)
            theirs = [published[number - 1] for number in numbers]
            axes.plot(x, theirs, "D", color=colour, markeredgecolor=ink(), markersize=5, label=f"the paper, {label}")
        axes.set(title=f"from {start}", xticks=range(len(numbers)), xticklabels=[f"expt {one}" for one in numbers])
        axes.set_yscale("log")
    panels[0].set_ylabel("MSPE, rad² + (rad/s)²")
    panels[0].legend(ncols=2, fontsize=7)
    return figure


ITEM = Item(COORDINATES, run)
