#!/usr/bin/env python
"""Forecasts of windows of recorded flights against the constant mean; prints a table by flight and one by half.

A window is 7 s to learn from and 1.5 s to forecast at every rate. The error ratio is the squared forecast error over
that of the constant mean; the tables have the median over windows. A window from which nothing can be learnt counts as
1. Every flight belongs to half A or half B: what is chosen on one half is judged on the other. Below, errors are beside
those of joint autoregressions: of forecasts over VAR(10)'s, of predictions without the motors over VAR(4)'s, geometric
means over flights of the medians over windows.

Usage: tools/bench/forecasts.py [--windows N] [--preset paper] [--settings JSON]
"""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from itertools import cycle
from time import perf_counter
from typing import Any

import click
import numpy as np
import pandas as pd

import mavdem
from mavdem import baselines, evaluate
from mavdem.evaluate.window import Window, windows
from mavdem.paper.runner import SHARED, recorded_flights

KNOWN = (10, 25, 50, 150)
UNKNOWN = (1, 5, 10, 25, 50)
"""Steps of forecasts, and of predictions without the motors, whose errors are shown beside an autoregression's."""
ERRORS = [
    (question, step, by)
    for question, steps in (("known", KNOWN), ("unknown", UNKNOWN))
    for step in steps
    for by in ("ours", "theirs")
]
HALVES = ("A", "B", "AB")


def figures(window: Window, learned: mavdem.Learned | ValueError) -> dict[Any, float]:
    """The error ratio, the share of samples in the 90 % band, and squared errors: ours, then an autoregression's."""
    if isinstance(learned, ValueError):
        return {"ratio": 1.0, "inside": np.nan} | dict.fromkeys(ERRORS, 1.0)
    train = window.train
    test = window.test
    forecast = learned.forecast(test.inputs)
    inside = np.abs(test.outputs - forecast) <= learned.forecast_band(test.inputs)
    made = {
        ("known", "ours"): forecast,
        ("known", "theirs"): baselines.var(train, order=10).forecast(test.inputs),
        ("unknown", "ours"): learned.predict(UNKNOWN[-1]),
        ("unknown", "theirs"): baselines.var(train, order=4).predict(UNKNOWN[-1]),
    }
    scale = train.outputs.var(axis=0)
    squares = {key: (one - test.outputs[: len(one)]) ** 2 / scale for key, one in made.items()}
    row = {"ratio": float(evaluate.relative_mspe(train, test, forecast)), "inside": inside.mean()}
    return row | {key: squares[key[0], key[2]][: key[1]].mean() for key in ERRORS}


def of_flight(
    name: str, flight: mavdem.Flight, half: str, most: int | None, settings: mavdem.Settings
) -> pd.DataFrame:
    """The figures of up to ``most`` windows, evenly over the flight; prints the flight's row."""
    every = windows(name, flight)
    places = np.linspace(0, len(every) - 1, min(most or len(every), len(every)))
    cut = [every[place] for place in np.unique(places.astype(int))]
    began = perf_counter()
    found = list(mavdem.learn_many((window.train, settings) for window in cut))
    seconds = (perf_counter() - began) / max(1, len(cut))
    rows = pd.DataFrame([figures(*pair) for pair in zip(cut, found, strict=True)])
    if len(rows):
        ratio = rows["ratio"]
        row = [name, half, flight.inputs.shape[1], f"{1 / flight.dt:.0f}", len(rows)]
        row += [f"{ratio.median():.3g}", f"{ratio.max():.3g}", f"{(ratio < 1).mean():.2f}"]
        print_row(*row, f"{rows['inside'].mean():.2f}", f"{seconds:.2f}")
    return rows.assign(name=name, half=half)


def print_row(*cells: object) -> None:
    print(f"| {' | '.join(map(str, cells))} |", flush=True)


def print_summaries(rows: pd.DataFrame) -> None:
    """Prints a row of each half, and errors over those of autoregressions."""
    print()
    shown = ("geometric mean of medians", "worse than the constant mean", "worst")
    print_row("half", "flights", "windows", *shown)
    print_row(*["---"] * 6)
    for half in HALVES:
        those = rows[rows["half"].isin([*half])]
        ratio = those["ratio"]
        mean = np.exp(np.log(those.groupby("name")["ratio"].median()).mean())
        counts = [those["name"].nunique(), len(those), f"{mean:.3g}", (ratio >= 1).sum()]
        print_row(half, *counts, f"{ratio.max():.3g}")
    for question, steps in (("known", KNOWN), ("unknown", UNKNOWN)):
        for half in HALVES:
            those = rows[rows["half"].isin([*half])]
            logs = np.log(those.groupby("name")[ERRORS].median())
            over = [(logs[question, one, "ours"] - logs[question, one, "theirs"]) for one in steps]
            listed = [f"{np.exp(ratio.mean()):.2f}" for ratio in over]
            at = ", ".join(f"{one} at {step}" for one, step in zip(listed, steps, strict=True))
            order = 10 if question == "known" else 4
            print(f"\nMotors {question}, half {half}, over joint VAR({order}): {at} steps.")
    print(f"\nIn the 90 % band: {rows['inside'].mean():.2f} of the samples.")


@click.command(help=__doc__)
@click.option(
    "--windows",
    "most",
    type=click.IntRange(min=1),
    help="Of each flight, evenly over it.  [default: all]",
)
@click.option("--preset", type=click.Choice(["real", "paper"]), default="real", show_default=True)
@click.option("--settings", default="{}", help='Changes to the preset, such as {"order": 2}.')
def main(most: int | None, preset: str, settings: str) -> None:
    base = mavdem.Settings.paper() if preset == "paper" else mavdem.Settings()
    chosen = replace(base, **json.loads(settings))
    shown = ("median ratio", "worst", "below 1", "in the 90 % band", "s a window")
    print_row("flight", "half", "inputs", "Hz", "windows", *shown)
    print_row(*["---"] * 10)
    halved = zip(recorded_flights(), cycle("AB"), strict=False)
    tables = [of_flight(*named, half, most, chosen) for named, half in halved]
    if not tables:
        sys.exit(
            f"There are no recorded flights in {SHARED}; name their folder in MAVDEM_SHARED_DATA."
        )
    print_summaries(pd.concat(tables))


if __name__ == "__main__":
    main()
