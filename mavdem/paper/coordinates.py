"""Section V.G: forecasts with generalized coordinates, p = 2, and without, p = 1."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from typing import Any

import numpy as np

from mavdem.dem.engine.linalg import Array
from mavdem.evaluate import paired
from mavdem.paper import figures
from mavdem.paper.claims import MSPE_WITH_COORDINATES, MSPE_WITHOUT_COORDINATES
from mavdem.paper.runner import (
    PLANT,
    PLANT_WITHOUT,
    REAL,
    STARTS,
    WITH,
    WITHOUT,
    Check,
    Result,
    Runner,
    Trial,
    median_draw,
    percent,
)
from mavdem.report.blocks import Block, Sentence, Table
from mavdem.report.numbers import rounded
from mavdem.report.page import Picture

SETTINGS = {"paper’s": (WITH, WITHOUT), "default": (PLANT, PLANT_WITHOUT)}  # with generalized coordinates, and without
MIN_SHARE = 0.8  # share of the experiments on which p = 2 must have the lower error, as on four of the paper's five

Errors = tuple[Array, Array]
"""MSPE with and without generalized coordinates, summed over outputs, (experiments, priors) each."""


def run(runner: Runner) -> Result:
    """Tries DEM with p = 2 and p = 1 on the five experiments, from many random priors, and on recorded flights."""
    drawn = [runner.draws[name].values() for name in (WITH, WITHOUT)]
    default = [[[runner.trial(name, number)] for number in runner.experiments] for name in (PLANT, PLANT_WITHOUT)]
    errors = {f"paper’s settings, from {start}": _errors(drawn, start) for start in STARTS}
    ours = {f"default settings, from {start}": _errors(default, start) for start in STARTS}
    middle = {
        f"p = {p}": median_draw(runner.draws[name][runner.extent.sample], STARTS[0])
        for p, name in ((2, WITH), (1, WITHOUT))
    }
    ahead = {
        f"from {start}": {p: trial.forecasts[start] for p, trial in middle.items() if trial.forecasts}
        for start in STARTS
    }
    recorded = _recorded(runner)
    return Result(
        checks=(*(check(pair, what) for what, pair in errors.items()), *_real_flight(recorded, "paper’s")),
        beyond=(*(check(pair, what) for what, pair in ours.items()), *_real_flight(recorded, "default")),
        numbers={
            "paper": {"with": MSPE_WITH_COORDINATES, "without": MSPE_WITHOUT_COORDINATES},
            **{
                name: {"with": with_.tolist(), "without": without.tolist()}
                for name, (with_, without) in (errors | ours).items()
            },
            "recorded_flights": recorded,
        },
        tables=_table(runner, errors | ours),
        pictures=(
            Picture(
                "Forecasts of the test data",
                "With generalized coordinates (p = 2) and without, each from the random prior with the median error.",
                partial(figures.forecasts, runner.sample, ahead),
                large=True,
            ),
        ),
        remarks=(
            "The flights are simulated ones of the same vehicle in the wind of a blower, so the paper’s numbers are of "
            "comparable size only. The claim is which of the two has the lower error.",
            "p = 1 estimates its derivative from two samples and p = 2 from three: part of the difference is a delay "
            "of half a sample and not an effect of generalized coordinates (docs/engine.md).",
        ),
    )


def _errors(by_method: Iterable[Iterable[list[Trial]]], start: str) -> Errors:
    """The errors of trials by method, experiment and prior."""
    with_, without = (np.array([[trial.errors[start] for trial in priors] for priors in rows]) for rows in by_method)
    return with_, without


def check(errors: Errors, what: str) -> Check:
    """Returns whether p = 2 has the lower error in total, and on most experiments; ``what`` names the settings."""
    with_, without = (np.median(priors, axis=1) for priors in errors)
    less = int((with_ < without).sum())
    return Check(
        f"{what}: the total MSPE over experiments is lower with p = 2 than with p = 1, and also on at least "
        f"{percent(MIN_SHARE)} of them (median over random priors)",
        bool(with_.sum() < without.sum() and less >= MIN_SHARE * len(with_)),
        f"{what}: the total MSPE is {rounded(with_.sum(), 3)} with p = 2 and {rounded(without.sum(), 3)} with p = 1, "
        f"lower with p = 2 on {less} of {len(with_)}",
    )


def _real_flight(rows: list[dict[str, Any]], settings: str) -> list[Check]:
    """Whether p = 2 has the lower error on the real flight, where it is available."""
    return [
        Check(
            f"the real AR.Drone, {settings} settings, from the data: the median over windows of the error with p = 2 "
            f"over that with p = 1 is less than 1",
            row["ratio"] < 1,
            f"on the real AR.Drone, {settings} settings, the error ratio of p = 2 to p = 1 is "
            f"{rounded(row['ratio'], 3)}",
        )
        for row in rows
        if row["flight"] == REAL and row["settings"] == settings
    ]


def _recorded(runner: Runner) -> list[dict[str, Any]]:
    """By recorded flight: the error with generalized coordinates over that without, and on how many windows less."""
    rows: list[dict[str, Any]] = []
    for flight in runner.recorded:
        for settings, pair in SETTINGS.items():
            ours, theirs = ([trial.errors[STARTS[0]] for trial in runner.trials[flight][name]] for name in pair)
            rows.append({"flight": flight, "settings": settings, **paired(ours, theirs)._asdict()})
    return rows


def _table(runner: Runner, errors: dict[str, Errors]) -> tuple[Block, ...]:
    numbers = list(runner.experiments)
    theirs = np.array([MSPE_WITH_COORDINATES, MSPE_WITHOUT_COORDINATES])[:, [number - 1 for number in numbers], None]
    rows = []
    for name, pair in {"the paper, its flights": (theirs[0], theirs[1]), **errors}.items():
        for p, priors in ((1, pair[1]), (2, pair[0])):
            medians = np.median(priors, axis=1)
            cells = [f"{rounded(middle, 3)}{_range(row)}" for middle, row in zip(medians, priors, strict=True)]
            rows.append([f"{name}, p = {p}", *cells, rounded(medians.sum(), 3)])
    title = Sentence(
        "over random priors the median and, in brackets, the 10 % and 90 % quantiles.",
        "Influence of generalized coordinates on MSPE:",
    )
    return title, Table(["DEM", *(f"expt {number}" for number in numbers), "total"], rows)


def _range(priors: Array) -> str:
    return f" ({'–'.join(rounded(end, 3) for end in np.percentile(priors, [10, 90]))})" if len(priors) > 1 else ""
