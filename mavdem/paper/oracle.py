"""The authors' own code on a simulated System 2, and ours on the same data."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mavdem import baselines
from mavdem.evaluate.comparison import PAPER_SETTINGS_WITHOUT, dem, judge_job
from mavdem.evaluate.scores import Method
from mavdem.evaluate.windows import Window
from mavdem.flight import Flight
from mavdem.paper.checks import Check
from mavdem.paper.claims import ORACLE
from mavdem.paper.drawing import DEM, DEM_WITHOUT, EM, ink
from mavdem.paper.flights import SHARED, TRAIN
from mavdem.paper.item import Cell, Item, ItemResult, PageTable, Picture
from mavdem.paper.runner import PAPER, STARTS, Runner, total_mspe
from mavdem.paper.words import number, percent

Array = NDArray[np.float64]

FOLDER = SHARED / "oracle"

CENTRAL_SHARE = 0.9  # central share of our errors over random priors that must contain the authors' error


def run(runner: Runner) -> ItemResult:
    """Fits the authors' data with our DEM and EM, from several priors and starts."""
    if not runner.extent.recorded or not FOLDER.is_dir():
        return ItemResult(remarks=(f"The authors’ results are not in {FOLDER}, so there is nothing to compare with.",))
    window = authors_window()
    priors = runner.extent.priors
    jobs: list[tuple[Method, Window]] = [
        (dem(name, replace(settings, seed=seed)), window)
        for name, settings in (("DEM p=2", PAPER), ("DEM p=1", PAPER_SETTINGS_WITHOUT))
        for seed in range(priors)
    ]
    jobs += [(Method("EM", partial(baselines.em, order=2, seed=seed)), window) for seed in range(5)]
    found = runner.each(judge_job, jobs)
    errors = {
        start: {name: np.array([total_mspe(one, start) for one in found if one.method == name]) for name, *_ in RULES}
        for start in STARTS
    }
    published = authors_errors()
    return ItemResult(
        checks=tuple(
            Check(
                f"{name}, from {start}: {rule}",
                holds(errors[start][name], published[start][name]),
                _finding(name, start, errors[start][name], published[start][name]),
            )
            for name, rule, holds in RULES
            for start in STARTS
        ),
        numbers={
            "theirs": {start: {name: own.tolist() for name, own in one.items()} for start, one in published.items()},
            "ours": {start: {name: own.tolist() for name, own in one.items()} for start, one in errors.items()},
            "true_model_from_data": TRUE_MODEL,
        },
        tables=(_table(errors, published),),
        pictures=(
            Picture(
                "oracle-mspe",
                "150-step MSPE on the authors’ simulated System 2: ours from each random prior or start (dots; bar: "
                "median), theirs as diamonds.",
                partial(_drawn, errors, published),
            ),
        ),
        remarks=(
            f"The forecast of the true model, from the data, has an MSPE of {TRUE_MODEL}. The authors’ DEM result is "
            "of one random prior; its forecast from state 0 starts one sample late. Their EM learns a feedthrough term "
            "and leaves it out of the forecast.",
        ),
    )


TRUE_MODEL = 0.0033  # MSPE of the true model's forecast, from the data


def authors_window() -> Window:
    """The data of case c2: 700 training and 150 test samples."""
    data = _load("case_c2_data_p2")
    dt = data["dt"].item()
    flight = Flight(dt * np.arange(len(data["y_full"])), data["pwm"].T, data["y_full"])
    return Window("System 2, simulated by the authors’ recipe", 0, flight[:TRAIN], flight[TRAIN:])


def authors_errors() -> dict[str, dict[str, Array]]:
    """MSPE of the authors' code, by start and method."""
    em, with_, without = (_load(f"case_c2_{name}") for name in ("em", "octave_p2", "octave_p1"))
    keys = {"the data": ("mspe_x0last", "mspe_x0last_aligned"), "state 0": ("mspe_x0zero", "mspe_x0zero")}
    return {
        start: {"DEM p=2": with_[dem].ravel(), "DEM p=1": without[dem].ravel(), "EM": em[of_em].ravel()}
        for start, (dem, of_em) in keys.items()
    }


def within_ours(ours: Array, theirs: Array) -> bool:
    """Whether theirs, of one random prior, lies in the central part of ours."""
    return (1 - CENTRAL_SHARE) / 2 <= below(ours, theirs) <= (1 + CENTRAL_SHARE) / 2


def below(ours: Array, theirs: Array) -> float:
    """The share of ours with a lower error than theirs."""
    return float((ours < theirs[0]).mean())


def within_theirs(ours: Array, theirs: Array) -> bool:
    """Whether the median of ours lies within the range of theirs, of several starts."""
    return bool(theirs.min() <= np.median(ours) <= theirs.max())


RULES: tuple[tuple[str, str, Callable[[Array, Array], bool]], ...] = (
    ("DEM p=2", f"theirs lies in the central {percent(CENTRAL_SHARE)} of ours over random priors", within_ours),
    ("DEM p=1", f"theirs lies in the central {percent(CENTRAL_SHARE)} of ours over random priors", within_ours),
    ("EM", "the median of ours lies between the best and the worst of theirs", within_theirs),
)


def _load(name: str) -> dict[str, Array]:
    with np.load(FOLDER / f"{name}.npz") as saved:
        return dict(saved)


def _finding(name: str, start: str, ours: Array, theirs: Array) -> str:
    if len(theirs) > 1:
        return f"{name} from {start}: our MSPE is {_range(ours)}, theirs {_range(theirs)}"
    return (
        f"{name} from {start}: their MSPE is {number(theirs[0])}, above {percent(below(ours, theirs))} of ours (median "
        f"{number(float(np.median(ours)))})"
    )


def _range(values: Array) -> str:
    if np.ptp(values) < 1e-3 * np.abs(values).max():
        return number(float(np.median(values)))
    return f"{number(values.min())} to {number(values.max())} (median {number(float(np.median(values)))})"


def _table(errors: dict[str, dict[str, Array]], published: dict[str, dict[str, Array]]) -> PageTable:
    rows = tuple(
        (Cell(f"{name}, from {start}"), Cell(_range(published[start][name])), Cell(_range(errors[start][name])))
        for name, _, _ in RULES
        for start in STARTS
    )
    return PageTable("150-step MSPE on the authors’ data", ("method", "their code", "ours"), rows)


def _drawn(errors: dict[str, dict[str, Array]], published: dict[str, dict[str, Array]]) -> Figure:
    figure, panels = plt.subplots(1, len(STARTS), figsize=(10, 3), sharey=True)
    colours = {"DEM p=2": DEM, "DEM p=1": DEM_WITHOUT, "EM": EM}
    jitter = np.random.default_rng(0)
    for axes, start in zip(panels, STARTS, strict=True):
        for place, (name, colour) in enumerate(colours.items()):
            own, theirs = errors[start][name], published[start][name]
            axes.bar(place - 0.15, np.median(own), 0.3, color=colour, alpha=0.35)
            axes.plot(place - 0.15 + jitter.uniform(-0.1, 0.1, len(own)), own, ".", color=colour, alpha=0.7)
            axes.plot(np.full(len(theirs), place + 0.2), theirs, "D", color=colour, markeredgecolor=ink())
        axes.set(title=f"from {start}", yscale="log", xticks=range(len(colours)), xticklabels=list(colours))
        axes.axhline(TRUE_MODEL, color=ink(), linestyle=":", linewidth=1) if start == STARTS[0] else None
    panels[0].set_ylabel("MSPE, rad² + (rad/s)²")
    return figure


ITEM = Item(ORACLE, run)
