#!/usr/bin/env python
"""Forecasts of windows of recorded flights against the constant mean; prints a table by flight, and what is over all.

A window is 7 s to learn from and 1.5 s to forecast at every rate. The error ratio is the squared forecast error over
that of the constant mean; the table has the median over windows. A window from which nothing can be learnt counts as 1.
Below, errors are beside those of joint autoregressions: of forecasts over VAR(10)'s, of predictions without the motors
over VAR(4)'s, geometric means over flights of the medians over windows.

Usage: tools/bench/forecasts.py [--windows N] [--preset paper] [--settings JSON]
"""

from __future__ import annotations

import json
import sys
from dataclasses import replace
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
    name: str, flight: mavdem.Flight, most: int | None, settings: mavdem.Settings
) -> pd.DataFrame:
    """The figures of up to ``most`` windows, evenly over the flight; prints the flight's row."""
    every = windows(name, flight)
    places = np.linspace(0, len(every) - 1, min(most or len(every), len(every)))
    cut = [every[place] for place in np.unique(places.astype(int))]
    found = list(mavdem.learn_many((window.train, settings) for window in cut))
    rows = pd.DataFrame([figures(*pair) for pair in zip(cut, found, strict=True)])
    if len(rows):
        ratio = rows["ratio"]
        shares = f"{(ratio < 1).mean():.2f}", f"{rows['inside'].mean():.2f}"
        print_row(name, len(rows), f"{ratio.median():.3g}", f"{ratio.max():.3g}", *shares)
    return rows.assign(name=name)


def print_row(*cells: object) -> None:
    print(f"| {' | '.join(map(str, cells))} |", flush=True)


def print_summary(rows: pd.DataFrame) -> None:
    """Prints what is over all flights, and errors over those of autoregressions."""
    flights = rows.groupby("name")
    mean = np.exp(np.log(flights["ratio"].median()).mean())
    print(f"\nGeometric mean of the medians: {mean:.3g}.")
    print(f"Worse than the constant mean: {(rows['ratio'] >= 1).sum()} of {len(rows)} windows.")
    logs = np.log(flights[ERRORS].median()).mean()
    for question, steps, order in (("known", KNOWN, 10), ("unknown", UNKNOWN, 4)):
        over = [
            np.exp(logs[question, one, "ours"] - logs[question, one, "theirs"]) for one in steps
        ]
        at = ", ".join(f"{one:.2f} at {step}" for one, step in zip(over, steps, strict=True))
        print(f"Motors {question}, over joint VAR({order}): {at} steps.")
    print(f"In the 90 % band: {rows['inside'].mean():.2f} of the samples.")


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
    print_row("flight", "windows", "median ratio", "worst", "below 1", "in the 90 % band")
    print_row(*["---"] * 6)
    tables = [of_flight(*named, most, chosen) for named in recorded_flights()]
    if not tables:
        sys.exit(
            f"There are no recorded flights in {SHARED}; name their folder in MAVDEM_SHARED_DATA."
        )
    print_summary(pd.concat(tables))


if __name__ == "__main__":
    main()
