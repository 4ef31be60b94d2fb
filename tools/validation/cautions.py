#!/usr/bin/env python
"""Cautions: how well each separates windows whose forecast is good from those whose forecast is bad; prints a table.

A window is 7 s to learn from and the 1.5 s after them to forecast; windows do not overlap. It is bad if its squared
forecast error is larger than that of the constant mean, or three times what the model expected, or if nothing could be
learnt; each as the mean over the window and over outputs in units of their training variance. The likelihood ratio of a
caution is the share of bad windows that have it over the share of good ones: above 1 it says something, at 1 it is
noise. Flights are recorded ones, scenarios, and simulated ones of several vehicles, winds, steering and rates; every
other one is in half A, in which rules are chosen, the rest in half B, in which they are judged. Rules
that are no cautions, or none any more, stand below those that are.

Usage: tools/validation/cautions.py [--seed N] [--simulated N] [--windows N] [--json FILE]
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from math import sqrt
from pathlib import Path
from typing import Any

import click
import numpy as np
from physical import AXES, CRAZYFLIE, EXCITED, other_logs, usdlog
from physical_flights import cases, scenario

sys.path.append(str(Path(__file__).parents[1] / "bench"))

from forecasts import SCENARIOS, simulated, spread  # noqa: E402

import mavdem  # noqa: E402
from mavdem import evaluate  # noqa: E402
from mavdem.errors import NotLearnable  # noqa: E402
from mavdem.evaluate.flight_windows import TEST_SECONDS, TRAIN_SECONDS, Window, samples_in, windows  # noqa: E402
from mavdem.paper.flights import logged, recorded_flights  # noqa: E402

Row = dict[str, Any]

UNEXPECTED = 3.0  # squared error over the expected one, from which on a forecast is bad
KINDS = {
    "the model is unstable": "model is unstable",
    "a motor is saturated": "is saturated",
    "the inputs follow the motion in another way from some instant on": "in another way",
    "the motors' level is unusual in a part": "far from its usual level",
    "an input hardly moves": "hardly moves",
    "inputs have both signs": "has both signs",
    "F̄ has no maximum": "no maximum",
    "there is no simulation-error fit": "There is no simulation-error fit",
    "log: which motor is which is assumed": "Which motor is which",
    "log: the input is the demand": "controller's .* demand",
    "log: no heartbeat": "No heartbeat",
    "log: an output is near its resolution": "(rate|angle or rate) is near the resolution",
    "log: the rate does not explain the angle": "The rate explains only",
    "log: the rate is aliased": "upper half of the band",
    "log: messages or segments left out": "left out",
}
"""Kinds of cautions by a pattern of their sentence."""


def above(limit: float, key: str, row: Row) -> bool:
    return bool(row[key] > limit)


def below(limit: float, key: str, row: Row) -> bool:
    return bool(row[key] < limit)


def is_of(pattern: str, row: Row) -> bool:
    return any(re.search(pattern, caution) for caution in row["cautions"])


RULES: dict[str, Callable[[Row], bool]] = {
    **{
        f"expected error above {limit:g} times the constant mean's, {where}": partial(above, limit, key)
        for key, where in (("expected", "its inputs"), ("expected_before", "inputs of training"))
        for limit in (0.5, 0.9, 1.0)
    },
    "F̄ or the simulation-error fit has not converged": partial(below, 0.5, "converged"),
    **{f"the motors explain less than {limit:.0%} in training": partial(below, limit, "share") for limit in (0.2, 0.4)},
    **{f"error of forecasts in training above {limit:g}": partial(above, limit, "training") for limit in (0.5, 0.9)},
    **{f"variance of the halves differs {limit:g} times": partial(above, limit, "halves") for limit in (4.0, 8.0)},
    **{f"inputs beyond training's in {limit:.0%} of the test": partial(above, limit, "beyond") for limit in (0.1,)},
}


def all_flights(seed: int, number: int) -> Iterator[tuple[str, mavdem.Flight]]:
    """Recorded flights, the Crazyflie's, scenarios, and ``number`` of the simulated bank."""
    yield from recorded_flights()
    yield from other_logs()
    if CRAZYFLIE.exists():
        logged_columns = usdlog(CRAZYFLIE)
        for axis in AXES:
            yield f"crazyflie {axis}", crazyflie(logged_columns, axis)
    for name in SCENARIOS:
        yield name, simulated(name, 100)
    bank = cases(seed, 1)
    for case in (bank[place] for place in np.random.default_rng(seed).permutation(len(bank))[:number]):
        try:
            yield str(case), logged(scenario(case))
        except NotLearnable as reason:
            click.echo(f"{case}: {reason}", err=True)


def crazyflie(columns: dict[str, Any], axis: str, rate: float = 100.0) -> mavdem.Flight:
    """Its excited part: angle by integration, rate, four commands."""
    gyro, directions = AXES[axis]
    time = np.arange(EXCITED[0] * rate, EXCITED[1] * rate) / rate
    motors = [np.interp(time, columns["time"], columns[f"motor.m{motor}"] / 65535) for motor in range(1, 5)]
    turning = np.radians(np.interp(time, columns["time"], columns[gyro]))
    outputs = np.stack([np.cumsum(turning) / rate, turning], axis=1)
    return mavdem.Flight(time, np.stack(motors, 1), outputs, dt=1 / rate, effect_directions=np.array(directions))


def rows_of(name: str, half: str, flight: mavdem.Flight, most: int | None) -> list[Row]:
    hop = samples_in(TRAIN_SECONDS, flight.dt) + samples_in(TEST_SECONDS, flight.dt)
    of_log = flight.provenance.get("cautions", [])
    cut = spread(windows(name, flight, hop=hop), most)
    return [{"flight": name, "half": half, "start": one.start} | row_of(one, of_log) for one in cut]


def row_of(window: Window, of_log: Sequence[str]) -> Row:
    """What is bad about a window, and what could have been known before."""
    try:
        learned = mavdem.learn(window.train)
    except ValueError as reason:
        return {"cautions": list(of_log), "failure": str(reason), "ratio": np.inf}
    test, variance, inputs = window.test, window.train.outputs.var(axis=0), window.train.inputs
    middle = len(window.train) // 2
    halves = window.train[:middle], window.train[middle:]
    forecast = learned.forecast(test.inputs)
    error = float((((test.outputs - forecast) ** 2) / variance).mean())
    expected = float((learned.forecast_variance(test.inputs) / variance).mean())
    before = learned.forecast_variance(window.train.inputs[-len(test) :]) / variance
    return {
        "cautions": [*of_log, *learned.cautions],
        "failure": "",
        "ratio": float(evaluate.relative_mspe(window.train, test, forecast)),
        "error": error,
        "expected": expected,
        "expected_before": float(before.mean()),
        "share": learned.training_forecasts.motors_share,
        "converged": learned.converged,
        "training": float((learned.training_forecasts.mse / variance).mean()),
        "halves": float(np.exp(np.abs(np.log(np.divide(*(half.outputs.var(axis=0) for half in halves)))).max())),
        "beyond": float(((test.inputs < inputs.min(axis=0)) | (test.inputs > inputs.max(axis=0))).any(axis=1).mean()),
        "inside": float((np.abs(test.outputs - forecast) <= learned.forecast_band(test.inputs)).mean()),
    }


def is_bad(row: Row) -> bool:
    return bool(row["failure"]) or row["ratio"] > 1 or row["error"] > UNEXPECTED * row["expected"]


def likelihood_ratio(rows: Sequence[Row], has: Callable[[Row], bool]) -> str:
    """Shares of bad and of good windows that have a caution, their ratio, and a 90 % interval of that."""
    bad, good = [one for one in rows if is_bad(one)], [one for one in rows if not is_bad(one)]
    of_bad, of_good = sum(map(has, bad)), sum(map(has, good))
    if not of_bad + of_good:
        return "never"
    # Half a window is added to each count, so that none is 0; the log of a ratio of shares is nearly Gaussian.
    of = of_bad + 0.5, of_good + 0.5
    ratio = of[0] / (len(bad) + 1) / (of[1] / (len(good) + 1))
    width = float(np.exp(1.645 * sqrt(1 / of[0] - 1 / (len(bad) + 1) + 1 / of[1] - 1 / (len(good) + 1))))
    return f"{of_bad} of {len(bad)}, {of_good} of {len(good)}: {ratio:.2g} ({ratio / width:.2g} to {ratio * width:.2g})"


def print_table(rows: Sequence[Row]) -> None:
    bad = sum(map(is_bad, rows))
    click.echo(f"{len(rows)} windows of {len({row['flight'] for row in rows})} flights, {bad} bad.\n")
    click.echo("| caution | half A: bad, good: likelihood ratio (90 %) | half B | all |\n|---|---|---|---|")

    def line(name: str, has: Callable[[Row], bool], some: Sequence[Row]) -> None:
        halves = [[row for row in some if row["half"] in half] for half in ("A", "B", "AB")]
        click.echo(f"| {name} | {' | '.join(likelihood_ratio(half, has) for half in halves)} |")

    line("any of these", lambda row: any(is_of(pattern, row) for pattern in KINDS.values()), rows)
    for name, pattern in KINDS.items():
        line(name, partial(is_of, pattern), rows)
    known = [row for row in rows if not row["failure"]]
    for name, has in RULES.items():
        line(name, has, known)
    every = re.compile("|".join(KINDS.values()))
    for caution in sorted({one for row in rows for one in row["cautions"] if not every.search(one)}):
        click.echo(f"of no kind: {caution}", err=True)


@click.command(help=__doc__)
@click.option("--seed", default=1, show_default=True, help="Of the simulated bank.")
@click.option("--simulated", "number", default=105, show_default=True, help="Flights of the bank.")
@click.option("--windows", "most", type=click.IntRange(min=1), default=10, show_default=True, help="Of each flight.")
@click.option("--json", "to", type=click.Path(path_type=Path), help="Keep each window's figures there; read if there.")
def main(seed: int, number: int, most: int, to: Path | None) -> None:
    if to and to.exists():
        rows = json.loads(to.read_text())
    else:
        rows = []
        for place, (name, flight) in enumerate(all_flights(seed, number)):
            rows += rows_of(name, "AB"[place % 2], flight, most)
            click.echo(f"{name}: {len(rows)}", err=True)
        if to:
            to.write_text(json.dumps(rows))
    print_table(rows)


if __name__ == "__main__":
    main()
