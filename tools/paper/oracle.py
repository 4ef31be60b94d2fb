"""The authors' own code on a simulated System 2, and ours on the same data."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import matplotlib.pyplot as plt
import numpy as np
from bench.flights import SHARED
from matplotlib.figure import Figure
from numpy.typing import NDArray
from paper.drawing import DEM, DEM_WITHOUT, EM, ink
from paper.item import Cell, Found, Item, Picture, Table
from paper.laboratory import PAPER, PAPER_WITHOUT, Laboratory
from paper.published import ORACLE
from paper.verdict import Check
from paper.words import number, percent

import mavdem
from mavdem import baselines
from mavdem.comparison import Method, Outcome, dem, judge
from mavdem.windows import TRAIN, Window

Array = NDArray[np.float64]

FOLDER = SHARED / "oracle"

STARTS = ("the data", "state 0")

PROBABLE = 0.9
"""Central share of our errors, over random priors, among which theirs must lie to be one of them."""


def run(laboratory: Laboratory) -> Found:
    if not laboratory.extent.recorded or not FOLDER.is_dir():
        return Found(remarks=(f"The authors’ results are not in {FOLDER}, so nothing could be compared.",))
    window = authors_window()
    priors = laboratory.extent.priors
    jobs: list[tuple[Method, Window]] = [
        (dem(name, replace(settings, seed=seed)), window)
        for name, settings in (("DEM p=2", PAPER), ("DEM p=1", PAPER_WITHOUT))
        for seed in range(priors)
    ]
    jobs += [(Method("EM", partial(baselines.em, order=2, seed=seed)), window) for seed in range(5)]
    found = laboratory.each(_judge, jobs)
    errors = {
        start: {
            name: np.array([_error(one, start) for one in found if one.method == name])
            for name in ("DEM p=2", "DEM p=1", "EM")
        }
        for start in STARTS
    }
    published = authors_errors()
    return Found(
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
                "150-step MSPE on the authors’ simulated System 2: ours from each random prior or start (dots, bar: "
                "the middle one), theirs as diamonds.",
                partial(_drawn, errors, published),
            ),
        ),
        remarks=(
            f"The true model’s own forecast errs {TRUE_MODEL} from the data. Theirs of DEM is one random prior, and "
            "its forecast from state 0 is of a state one sample late; their EM learns a feedthrough and leaves it out.",
        ),
    )


TRUE_MODEL = 0.0033
"""MSPE of the true model's forecast, from the data."""


def authors_window() -> Window:
    """The data of case c2: 700 samples to learn from, 150 to forecast."""
    data = _load("case_c2_data_p2")
    dt = data["dt"].item()
    flight = mavdem.Flight(dt * np.arange(len(data["y_full"])), data["pwm"].T, data["y_full"])
    return Window("System 2, simulated by the authors’ recipe", 0, flight[:TRAIN], flight[TRAIN:])


def authors_errors() -> dict[str, dict[str, Array]]:
    """MSPE of the authors' code, by start and method."""
    em, with_, without = (_load(f"case_c2_{name}") for name in ("em", "octave_p2", "octave_p1"))
    return {
        "the data": {
            "DEM p=2": with_["mspe_x0last"].ravel(),
            "DEM p=1": without["mspe_x0last"].ravel(),
            "EM": em["mspe_x0last_aligned"].ravel(),
        },
        "state 0": {
            "DEM p=2": with_["mspe_x0zero"].ravel(),
            "DEM p=1": without["mspe_x0zero"].ravel(),
            "EM": em["mspe_x0zero"].ravel(),
        },
    }


def within_ours(ours: Array, theirs: Array) -> bool:
    """Whether theirs, of one random prior, is like one of ours."""
    return (1 - PROBABLE) / 2 <= below(ours, theirs) <= (1 + PROBABLE) / 2


def below(ours: Array, theirs: Array) -> float:
    """The share of ours that err less than the one of theirs."""
    return float((ours < theirs[0]).mean())


def within_theirs(ours: Array, theirs: Array) -> bool:
    """Whether the middle one of ours lies among theirs, of several starts."""
    return bool(theirs.min() <= np.median(ours) <= theirs.max())


RULES: tuple[tuple[str, str, Callable[[Array, Array], bool]], ...] = (
    ("DEM p=2", f"theirs lies in the central {percent(PROBABLE)} of ours over random priors", within_ours),
    ("DEM p=1", f"theirs lies in the central {percent(PROBABLE)} of ours over random priors", within_ours),
    ("EM", "the middle one of ours lies between the best and the worst of theirs", within_theirs),
)


def _load(name: str) -> dict[str, Array]:
    with np.load(FOLDER / f"{name}.npz") as saved:
        return dict(saved)


def _judge(job: tuple[Method, Window]) -> Outcome:
    return judge(*job)


def _error(outcome: Outcome, start: str) -> float:
    return float((outcome.mspe if start == STARTS[0] else outcome.mspe_from_zero).sum())


def _finding(name: str, start: str, ours: Array, theirs: Array) -> str:
    if len(theirs) > 1:
        return f"{name} from {start}: ours errs {_range(ours)}, theirs {_range(theirs)}"
    return (
        f"{name} from {start}: theirs errs {number(theirs[0])}, more than {percent(below(ours, theirs))} of ours "
        f"(middle one {number(float(np.median(ours)))})"
    )


def _range(values: Array) -> str:
    if np.ptp(values) < 1e-3 * np.abs(values).max():
        return number(float(np.median(values)))
    return f"{number(values.min())} to {number(values.max())} (middle {number(float(np.median(values)))})"


def _table(errors: dict[str, dict[str, Array]], published: dict[str, dict[str, Array]]) -> Table:
    rows = tuple(
        (Cell(f"{name}, from {start}"), Cell(_range(published[start][name])), Cell(_range(errors[start][name])))
        for name, _, _ in RULES
        for start in STARTS
    )
    return Table("150-step MSPE on the authors’ data", ("method", "their code", "ours"), rows)


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


ITEM = Item("oracle", "The authors’ own code on simulated data", ORACLE, run)
