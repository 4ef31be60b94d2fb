"""V.G: forecasts with generalized coordinates, p = 2, and without, p = 1."""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from paper.drawing import DEM, DEM_WITHOUT, MEASURED, ink, unseen
from paper.item import Cell, Found, Item, Picture, Table
from paper.laboratory import OURS, OURS_WITHOUT, REAL, WITH, WITHOUT, Laboratory
from paper.published import COORDINATES, MSPE_WITH_COORDINATES, MSPE_WITHOUT_COORDINATES
from paper.verdict import Check
from paper.words import listed, number, percent

from mavdem.comparison import Outcome
from mavdem.evaluate import paired
from mavdem.windows import Window

Array = NDArray[np.float64]

STARTS = ("the data", "state 0")

SETTINGS = {"paper’s": (WITH, WITHOUT), "default": (OURS, OURS_WITHOUT)}
"""With generalized coordinates, and without."""

MOST = 0.8
"""Share of the experiments on which p = 2 must err less: it does on four of the paper's own five."""


class Errors(NamedTuple):
    """MSPE with and without generalized coordinates, summed over outputs.

    Attributes:
        with_, without: (experiments, priors) each; one column where the prior is not random.
    """

    with_: Array
    without: Array

    @property
    def medians(self) -> tuple[Array, Array]:
        """(experiments,) each: the middle one of the priors."""
        return np.median(self.with_, axis=1), np.median(self.without, axis=1)


def run(laboratory: Laboratory) -> Found:
    drawn = {start: _drawn(laboratory, start) for start in STARTS}
    ours = {start: _ours(laboratory, start) for start in STARTS}
    recorded = _recorded(laboratory)
    return Found(
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
        tables=(_table(laboratory, drawn, ours), *([_table_recorded(recorded)] if recorded else [])),
        pictures=(
            Picture(
                "coordinates-forecast",
                "Forecast with generalized coordinates (green) and without (yellow) beside the measurement (red), from "
                "the random prior whose error is the middle one.",
                partial(_forecasts, laboratory.sample, _middle(laboratory)),
            ),
            Picture(
                "coordinates-mspe",
                "MSPE from each random prior (dots), the middle one (bar), and the paper’s number (diamond), which is "
                "of other flights.",
                partial(_spread, tuple(laboratory.experiments), drawn),
            ),
        ),
        remarks=(
            "The flights are simulated ones of the same vehicle in a blower’s wind, so the paper’s numbers compare in "
            "size only; what is to be reproduced is which of the two errs less.",
            "p = 1 reads its derivative from two samples and p = 2 from three: part of the difference is half a sample "
            "of delay and no generalized coordinate (docs/engine.md).",
            *([_of_autopilots(recorded)] if recorded else []),
        ),
    )


def checks(errors: Errors, what: str) -> tuple[Check, ...]:
    """Whether p = 2 errs less in total, and on most experiments.

    Args:
        errors: of both.
        what: the settings and the start.
    """
    with_, without = errors.medians
    less = int((with_ < without).sum())
    return (
        Check(
            f"{what}: the total MSPE over experiments is less with p = 2 than with p = 1, and so it is on at least "
            f"{percent(MOST)} of them (of random priors the middle one)",
            bool(with_.sum() < without.sum() and less >= MOST * len(with_)),
            f"{what}: p = 2 errs {number(with_.sum())} in total and p = 1 {number(without.sum())}, less on {less} of "
            f"{len(with_)}",
        ),
    )


def _of_real_flight(rows: list[dict[str, Any]], settings: str) -> tuple[Check, ...]:
    """Whether p = 2 errs less on the real flight, where it is."""
    return tuple(
        Check(
            f"the real AR.Drone, {settings} settings, from the data: the median over windows of the error with p = 2 "
            f"over that with p = 1 is less than 1",
            row["ratio"] < 1,
            f"on the real AR.Drone, {settings} settings, p = 2 errs {number(row['ratio'])} times as much as p = 1",
        )
        for row in rows
        if row["flight"] == REAL and row["settings"] == settings
    )


def _of_autopilots(rows: list[dict[str, Any]]) -> str:
    """How often p = 2 errs less on the autopilots' flights."""
    told = []
    for settings in SETTINGS:
        ratios = [row["ratio"] for row in rows if row["settings"] == settings and row["flight"] != REAL]
        told.append(f"on {sum(ratio < 1 for ratio in ratios)} of {len(ratios)} with the {settings} settings")
    return f"Beyond the paper, on the autopilots’ flights p = 2 errs less {listed(told)}."


def _error(outcome: Outcome, start: str) -> float:
    return float((outcome.mspe if start == STARTS[0] else outcome.mspe_from_zero).sum())


def _drawn(laboratory: Laboratory, start: str) -> Errors:
    by_method = laboratory.draws
    return Errors(
        *(
            np.array([[_error(one, start) for one in priors] for priors in by_method[name].values()])
            for name in (WITH, WITHOUT)
        )
    )


def _ours(laboratory: Laboratory, start: str) -> Errors:
    return Errors(
        *(
            np.array([[_error(laboratory.outcome(name, number), start)] for number in laboratory.experiments])
            for name in (OURS, OURS_WITHOUT)
        )
    )


def _middle(laboratory: Laboratory) -> dict[str, Outcome]:
    """Of the sample experiment's forecasts from random priors the one whose error is the middle one, by method."""
    found = {}
    for name in (WITH, WITHOUT):
        ranked = sorted(laboratory.draws[name][laboratory.extent.sample], key=lambda one: _error(one, STARTS[0]))
        found[name] = ranked[len(ranked) // 2]
    return found


def _recorded(laboratory: Laboratory) -> list[dict[str, Any]]:
    """By recorded flight: the error with generalized coordinates over that without, and on how many windows less."""
    rows: list[dict[str, Any]] = []
    for flight in laboratory.recorded:
        part = laboratory.comparison.of_flight(flight)
        by_method = dict(zip(part.methods, zip(*part.outcomes, strict=True), strict=True))
        for settings, (with_, without) in SETTINGS.items():
            ours, theirs = ([_error(each, STARTS[0]) for each in by_method[name]] for name in (with_, without))
            one = paired(ours, theirs)
            rows.append({"flight": flight, "settings": settings, **one._asdict()})
    return rows


def _table(laboratory: Laboratory, drawn: dict[str, Errors], ours: dict[str, Errors]) -> Table:
    numbers = tuple(laboratory.experiments)
    without, with_ = (
        [values[number - 1] for number in numbers] for values in (MSPE_WITHOUT_COORDINATES, MSPE_WITH_COORDINATES)
    )
    rows = [*_pair("the paper, its flights", np.array([without]).T, np.array([with_]).T)]
    for name, errors in (("the paper’s settings", drawn), ("default settings", ours)):
        for start, one in errors.items():
            rows += _pair(f"{name}, from {start}", one.without, one.with_)
    return Table(
        "Influence of generalized coordinates on MSPE; from random priors the middle one and, small, the 10th and 90th "
        "of a hundred",
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
        spreads = [_told_spread(row) for row in one] + [""]
        cells = zip(own, other, spreads, strict=True)
        rows.append((Cell(label), *(Cell(number(a), bool(a < b), spread) for a, b, spread in cells)))
    return rows


def _told_spread(priors: Array) -> str:
    if len(priors) == 1:
        return ""
    low, high = np.percentile(priors, [10, 90])
    return f"{number(low)}–{number(high)}"


def _table_recorded(rows: list[dict[str, Any]]) -> Table:
    by_place = {(row["flight"], row["settings"]): row for row in rows}
    cells = []
    for flight in dict.fromkeys(row["flight"] for row in rows):
        line = [Cell("real AR.Drone" if flight == REAL else flight)]
        for settings in SETTINGS:
            row = by_place[flight, settings]
            line += [Cell(number(row["ratio"]), row["ratio"] < 1), Cell(f"{row['less']} of {row['windows']}")]
        cells.append(tuple(line))
    return Table(
        "Recorded flights, from the data: the median over windows of the error with p = 2 over that with p = 1 (below "
        "1 generalized coordinates help), and in how many windows it is less",
        ("flight", "the paper’s settings", "less in", "default settings", "less in"),
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


def _spread(numbers: tuple[int, ...], drawn: dict[str, Errors]) -> Figure:
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


ITEM = Item("coordinates", "Influence of generalized coordinates", COORDINATES, run)
