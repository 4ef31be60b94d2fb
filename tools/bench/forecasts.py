#!/usr/bin/env python
"""Forecasts of every window of every recorded flight, DEM against the constant mean; prints the README's table.

Usage: tools/bench/forecasts.py [--preset paper] [--settings JSON] [--json FILE]
"""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np
from flights import HOP, SHARED, TEST, TRAIN, recorded_flights
from rich.progress import track

import mavdem
from mavdem import evaluate
from mavdem.windows import windows

DOUBTFUL = 0.5
"""Of the training variance: a forecast that expects to err so much, squared, is said to doubt itself."""


def figures(name: str, train: mavdem.Flight, test: mavdem.Flight, learned: mavdem.Learned) -> dict[str, Any]:
    lower, upper = learned.forecast_band(test.inputs)
    return {
        "flight": name,
        "ratio": evaluate.relative_mspe(train, test, learned.forecast(test.inputs)),
        "inside": float(np.mean((lower <= test.outputs) & (test.outputs <= upper))),
        "cautioned": bool(learned.cautions),
        "doubted": bool(np.mean(learned.forecast_variance(test.inputs) / train.outputs.var(axis=0)) > DOUBTFUL),
        "order": learned.settings.order,
    }


def print_table(rows: list[dict[str, Any]]) -> None:
    print("| flight | windows | median ratio | worst | below 1 | in the 90 % band |")
    print("|---|---|---|---|---|---|")
    medians = []
    for name in dict.fromkeys(row["flight"] for row in rows):
        own = [row for row in rows if row["flight"] == name]
        ratios = np.array([row["ratio"] for row in own])
        medians.append(np.median(ratios))
        inside = np.mean([row["inside"] for row in own])
        print(
            f"| {name} | {len(own)} | {np.median(ratios):.3g} | {ratios.max():.3g} "
            f"| {np.mean(ratios < 1):.2f} | {inside:.2f} |"
        )
    ratios = np.array([row["ratio"] for row in rows])
    worse = ratios >= 1
    cautioned, doubted = (np.array([row[name] for row in rows]) for name in ("cautioned", "doubted"))
    print(
        f"\nGeometric mean of the medians: {np.exp(np.mean(np.log(medians))):.3g}. In the 90 % band: "
        f"{np.mean([row['inside'] for row in rows]):.2f}. Of {len(rows)} windows, {worse.sum()} were worse than the "
        f"constant mean: {np.sum(worse & cautioned)} of them cautioned against beforehand, as were "
        f"{np.sum(~worse & cautioned)} others; {np.sum(worse & doubted)} expected to err by more than {DOUBTFUL:g} of "
        f"the training variance, as did {np.sum(~worse & doubted)} others."
    )


@click.command(help=__doc__)
@click.option("--preset", type=click.Choice(["real", "paper"]), default="real", show_default=True)
@click.option("--settings", default="{}", help='Changes to the preset, such as {"order": 2}.')
@click.option("--json", "to", type=click.Path(path_type=Path), help="Also write each window's figures there.")
def main(preset: str, settings: str, to: Path | None) -> None:
    base = mavdem.Settings.paper() if preset == "paper" else mavdem.Settings()
    chosen = replace(base, **json.loads(settings))
    tried = [window for name, flight in recorded_flights() for window in windows(name, flight, TRAIN, TEST, HOP)]
    if not tried:
        sys.exit(f"There are no recorded flights in {SHARED}; name their folder in MAVDEM_SHARED_DATA.")
    answers = mavdem.learn_many((window.train, chosen) for window in tried)
    rows = []
    for window, learned in track(zip(tried, answers, strict=True), total=len(tried), description="Forecasting"):
        if isinstance(learned, ValueError):
            raise learned
        rows.append(figures(window.flight, window.train, window.test, learned))
    print_table(rows)
    if to:
        to.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
