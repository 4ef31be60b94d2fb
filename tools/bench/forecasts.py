#!/usr/bin/env python
"""Forecasts of windows of recorded flights against the constant mean; prints a table by flight and one by half.

A window is 7 s to learn from and 1.5 s to forecast at every rate. The error ratio is the squared forecast error over
that of the constant mean; the tables have the median over windows. A window from which nothing can be learned counts as
1. Every flight belongs to half A or half B: what is chosen on one half is judged on the other. Below, errors are beside
those of joint autoregressions: of forecasts over VAR(10)'s, of predictions without the motors over VAR(4)'s, geometric
means over flights of the medians over windows.

Usage: tools/bench/forecasts.py [--windows N] [--preset paper] [--settings JSON]
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from itertools import cycle
from time import perf_counter
from typing import Any

import click
import numpy as np

import mavdem
from mavdem import baselines, evaluate
from mavdem.evaluate.window import Window, windows
from mavdem.paper.runner import SHARED, recorded_flights

KNOWN = (10, 25, 50, 150)
UNKNOWN = (1, 5, 10, 25, 50)
"""Steps of forecasts, and of predictions without the motors, whose errors are shown beside an autoregression's."""


def figures(window: Window, learned: mavdem.Learned | ValueError) -> dict[str, Any]:
    """The error ratio, the share of samples in the 90 % band, and squared errors: ours, then an autoregression's."""
    if isinstance(learned, ValueError):
        return {
            "ratio": 1.0,
            "inside": np.nan,
            "known": np.ones((2, 4)),
            "unknown": np.ones((2, 5)),
        }
    train = window.train
    test = window.test
    forecast = learned.forecast(test.inputs)
    inside = np.abs(test.outputs - forecast) <= learned.forecast_band(test.inputs)

    def errors(steps: Sequence[int], *made: Any) -> Any:
        squares = [
            np.mean((one - test.outputs[: len(one)]) ** 2 / train.outputs.var(axis=0), axis=1)
            for one in made
        ]
        return np.array([[one[:step].mean() for step in steps] for one in squares])

    predictions = (model.predict(UNKNOWN[-1]) for model in (learned, baselines.var(train, order=4)))
    return {
        "ratio": float(evaluate.relative_mspe(train, test, forecast)),
        "inside": float(np.mean(inside)),
        "known": errors(KNOWN, forecast, baselines.var(train, order=10).forecast(test.inputs)),
        "unknown": errors(UNKNOWN, *predictions),
    }


def of_flight(
    name: str, flight: mavdem.Flight, half: str, most: int | None, settings: mavdem.Settings
) -> list[dict[str, Any]]:
    """The figures of each window; prints their row."""
    every = windows(name, flight)
    # Up to ``most`` windows, evenly over the flight.
    cut = [
        every[i]
        for i in np.unique(
            np.linspace(0, len(every) - 1, min(most or len(every), len(every))).astype(int)
        )
    ]
    began = perf_counter()
    found = list(mavdem.learn_many((window.train, settings) for window in cut))
    seconds = (perf_counter() - began) / max(1, len(cut))
    rows = [{"half": half} | figures(*pair) for pair in zip(cut, found, strict=True)]
    if rows:
        ratios = column(rows, "ratio")
        inside = column(rows, "inside")
        print(
            f"| {name} | {half} | {flight.inputs.shape[1]} | {1 / flight.dt:.0f} | {len(rows)} "
            f"| {np.median(ratios):.3g} | {ratios.max():.3g} | {np.mean(ratios < 1):.2f} | {np.nanmean(inside):.2f} "
            f"| {seconds:.2f} |",
            flush=True,
        )
    return rows


def column(rows: Sequence[dict[str, Any]], name: str) -> Any:
    return np.array([row[name] for row in rows])


def print_summaries(by_flight: Sequence[list[dict[str, Any]]]) -> None:
    print(
        "\n| half | flights | windows | geometric mean of medians | worse than the constant mean | worst |"
    )
    print("|---|---|---|---|---|---|")
    for half in ("A", "B", "AB"):
        if those := [rows for rows in by_flight if rows[0]["half"] in half]:
            ratios = column([row for rows in those for row in rows], "ratio")
            mean = np.exp(np.mean([np.log(np.median(column(rows, "ratio"))) for rows in those]))
            print(
                f"| {half} | {len(those)} | {len(ratios)} | {mean:.3g} | {np.sum(ratios >= 1)} | {ratios.max():.3g} |"
            )
    for question, steps in (("known", KNOWN), ("unknown", UNKNOWN)):
        for half in ("A", "B", "AB"):
            tables = [
                np.median(column(rows, question), axis=0)
                for rows in by_flight
                if rows[0]["half"] in half
            ]
            logs = [np.log(table[0]) - np.log(table[1]) for table in tables]
            over = np.exp(np.mean(logs, axis=0)) if logs else []
            listed = ", ".join(
                f"{value:.2f} at {step}" for value, step in zip(over, steps, strict=False)
            )
            print(
                f"\nMotors {question}, half {half}, over joint VAR({10 if question == 'known' else 4}): {listed} steps."
            )
    inside = column([row for rows in by_flight for row in rows], "inside")
    print(f"\nIn the 90 % band: {np.nanmean(inside):.2f} of the samples.")


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
    print(
        "| flight | half | inputs | Hz | windows | median ratio | worst | below 1 | in the 90 % band | s a window |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|")
    halved = zip(recorded_flights(), cycle("AB"), strict=False)
    by_flight = [
        rows
        for (name, flight), half in halved
        if (rows := of_flight(name, flight, half, most, chosen))
    ]
    if not by_flight:
        sys.exit(
            f"There are no recorded flights in {SHARED}; name their folder in MAVDEM_SHARED_DATA."
        )
    print_summaries(by_flight)


if __name__ == "__main__":
    main()
