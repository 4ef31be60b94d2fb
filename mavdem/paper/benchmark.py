"""Section V.H: DEM compared with PEM, subspace identification and EM."""

from __future__ import annotations

from functools import partial

import numpy as np

from mavdem.dem.engine.linalg import Array
from mavdem.paper import figures
from mavdem.paper.runner import (
    MEAN,
    OTHERS,
    OURS,
    PEERS,
    REAL,
    STARTS,
    WITH,
    Check,
    Result,
    Runner,
    Trial,
    median_draw,
    percent,
    plain,
)
from mavdem.report.blocks import Block, Sentence, Table
from mavdem.report.numbers import listed, rounded
from mavdem.report.page import Picture

SHOWN = (WITH, *PEERS, OURS, *OTHERS, MEAN)  # Methods in the order of tables and legends: the paper's four, then others

NAMES = {WITH: "DEM with the paper’s settings", OURS: "the joint model"}

Errors = dict[str, Array]  # The error (flights,) of each method


def run(runner: Runner) -> Result:
    """Tries each method on the five experiments, and on all windows of all flights."""
    numbers = list(runner.experiments)
    experiments = {
        start: {name: np.array([_trial(runner, name, i, start).errors[start] for i in numbers]) for name in SHOWN}
        for start in STARTS
    }
    sample = {name: _trial(runner, name, runner.extent.sample, STARTS[0]).forecasts for name in SHOWN}
    ahead = {name: forecasts[STARTS[0]] for name, forecasts in sample.items() if forecasts}
    outputs = runner.sample.test.outputs
    squares = {name: np.asarray(((forecast - outputs) ** 2).sum(axis=1)) for name, forecast in ahead.items()}
    relative = {
        flight: {name: float(np.median([trial.relative for trial in by_method[name]])) for name in SHOWN}
        for flight, by_method in runner.trials.items()
    }
    parts = {
        "real AR.Drone": [name for name in runner.recorded if name == REAL],
        "autopilots’ flights": [name for name in runner.recorded if name != REAL],
    }
    recorded = {
        where: {name: np.array([relative[flight][name] for flight in flights]) for name in SHOWN}
        for where, flights in parts.items()
        if flights
    }
    return Result(
        checks=(
            *(least(experiments[start], WITH, PEERS, f"from {start}") for start in STARTS),
            _most_steps(squares, runner.sample.flight),
            *(least(recorded[name], WITH, PEERS, f"on the {name}") for name in recorded if name == "real AR.Drone"),
        ),
        beyond=(
            *(least(experiments[start], OURS, PEERS, f"from {start}") for start in STARTS),
            least(experiments[STARTS[0]], OURS, (*PEERS, *OTHERS), f"from {STARTS[0]}"),
            *(least(errors, OURS, (*PEERS, *OTHERS), f"on the {where}") for where, errors in recorded.items()),
        ),
        numbers={
            **{f"mspe, from {start}": plain(errors) for start, errors in experiments.items()},
            "squared_errors_by_step": plain(squares),
            "all_windows": {
                "flights": list(relative),
                "median_error_over_constant_mean": {name: [row[name] for row in relative.values()] for name in SHOWN},
            },
            "unstable_models": {
                flight: {name: sum(trial.stable is False for trial in tried) for name, tried in trials.items()}
                | {"windows": len(trials[MEAN])}
                for flight, trials in runner.trials.items()
            },
        },
        tables=(
            *_losses({f"experiments, from {start}": errors for start, errors in experiments.items()} | recorded),
            *(block for start, errors in experiments.items() for block in _table(start, errors, numbers)),
            Sentence("the median over a flight’s windows of the error over the constant mean’s.", "All windows:"),
            Table(
                ["flight", *(NAMES.get(name, name) for name in SHOWN)],
                [[flight, *(rounded(ratios[name], 3) for name in SHOWN)] for flight, ratios in relative.items()],
            ),
        ),
        pictures=(
            Picture(
                "Forecasts of the test data",
                f"Of {runner.sample.flight}, from the data.",
                partial(figures.forecasts, runner.sample, {"": ahead}),
                large=True,
            ),
            Picture(
                "Squared error by step",
                f"n steps ahead on {runner.sample.flight}, summed over outputs.",
                partial(figures.lines, {"": squares}, "steps ahead, n", first=1, scale="log"),
            ),
        ),
        remarks=(
            "MATLAB’s n4sid and pem are not public; tests compare ours with other libraries. Number in brackets: "
            "states. DEM with the paper’s settings is the median over random priors on the experiments, and one prior "
            "on all windows.",
            *(() if runner.recorded else ("The recorded flights are not on this machine and are left out.",)),
        ),
    )


def _trial(runner: Runner, name: str, number: int, start: str) -> Trial:
    return median_draw(runner.draws[WITH][number], start) if name == WITH else runner.trial(name, number)


def least(errors: Errors, ours: str, peers: tuple[str, ...], where: str) -> Check:
    """Returns whether a method has a lower error than each of its peers on all flights, ``where`` for the sentences."""
    best = np.min([errors[name] for name in peers], axis=0)
    less, count = int((errors[ours] < best).sum()), len(best)
    against = "the paper’s peers" if peers == PEERS else f"all of {listed(peers)}"
    return Check(
        f"{NAMES[ours]}, {where}: its error is lower than that of {listed(peers)} on every flight",
        less == count,
        f"{NAMES[ours]}, {where}, has a lower error than {against} on {less} of {count}; its error is "
        f"{_ratio(errors[ours], best)} times that of the best of them",
    )


def _ratio(ours: Array, theirs: Array) -> str:
    return rounded(float(np.exp(np.mean(np.log(ours / theirs)))), 3)


def _most_steps(squares: dict[str, Array], flight: str) -> Check:
    errors = np.array([squares.get(name, np.full_like(squares[MEAN], np.inf)) for name in (WITH, *PEERS)])
    share = float((errors.argmin(axis=0) == 0).mean())
    return Check(
        f"{NAMES[WITH]}, {flight}: of the paper’s four methods it has the least squared error at over half of "
        f"the steps",
        share > 0.5,
        f"{NAMES[WITH]} has the least squared error of the four at {percent(share)} of the steps of {flight}",
    )


def _losses(parts: dict[str, Errors]) -> tuple[Block, ...]:
    """On how many flights each other method has a lower error than DEM."""
    others = [name for name in SHOWN if name not in (WITH, OURS)]
    rows = []
    for ours in (WITH, OURS):
        for where, errors in parts.items():
            cells = [
                f"{(errors[name] < errors[ours]).sum()} of {len(errors[name])} ({_ratio(errors[ours], errors[name])})"
                for name in others
            ]
            rows.append([f"{NAMES[ours]}, {where}", *cells])
    title = Sentence(
        "the number of flights on which another method has a lower error; in brackets, the ratio of DEM’s error to its "
        "error (geometric mean over flights).",
        "Where DEM loses:",
    )
    return title, Table(["", *others], rows)


def _table(start: str, errors: Errors, numbers: list[int]) -> tuple[Block, ...]:
    rows = [
        [NAMES.get(name, name), *(rounded(error, 3) for error in (*values, values.sum()))]
        for name, values in errors.items()
    ]
    title = Sentence("", f"MSPE of the five experiments, from {start}.")
    return title, Table(["method", *(f"expt {number}" for number in numbers), "total"], rows)
