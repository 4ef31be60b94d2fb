#!/usr/bin/env python
"""Forecasts of windows of recorded flights against the constant mean; prints a table by flight, and what is over all.

A window is 7 s to learn from and 1.5 s to forecast at every rate. The error ratio is the squared forecast error over
that of the constant mean; the table has the median over windows. Below is the report of `mavdem compare` beside joint
autoregressions, whose ratios over flights are geometric means.

Usage: tools/bench/forecasts.py [--windows N] [--preset paper] [--settings JSON]
"""

import json
import sys
from dataclasses import replace
from functools import partial

import click
import numpy as np

import mavdem
from mavdem.evaluate import METHODS, Comparison, Method, Window, compare, windows
from mavdem.experiments.paper.flights import DATA_FOLDER, recorded_flights
from mavdem.report.blocks import Table, markdown
from mavdem.report.comparison import comparison_report

COLUMNS = ["flight", "windows", "median ratio", "worst", "below 1", "in the 90 % band"]


def cut(name: str, flight: mavdem.Flight, most: int | None) -> list[Window]:
    """Up to ``most`` windows, evenly over the flight."""
    every = windows(name, flight)
    count = min(most or len(every), len(every))
    places = np.linspace(0, len(every) - 1, count)
    chosen = np.unique(places.astype(int))
    return [every[number] for number in chosen]


def by_flight(compared: Comparison) -> Table:
    """A row of our forecasts of each flight."""
    rows = []
    for flight in compared.flights:
        (ours,) = (row for row in compared.summaries(flight) if row["method"] == "ours")
        below = 1 - ours["worse_than_constant"] / ours["windows"]
        inside = ours["horizons"][-1]["inside"] or np.nan
        shares = [f"{share:.2f}" for share in (below, inside)]
        ratios = [f"{ours[name]:.3g}" for name in ("relative", "worst")]
        count = str(ours["windows"])
        rows.append([flight, count, *ratios, *shares])
    return Table(COLUMNS, rows)


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
    ours = Method("ours", partial(mavdem.learn, settings=chosen), predicts=True)
    joint = [method for method in METHODS if method.name.startswith("joint VAR")]
    parts = [window for named in recorded_flights() for window in cut(*named, most)]
    if not parts:
        sys.exit(
            f"There are no recorded flights in {DATA_FOLDER}; name their folder in MAVDEM_SHARED_DATA."
        )
    compared = compare(parts, [ours, *joint])
    print(markdown([by_flight(compared), *comparison_report(compared)]))


if __name__ == "__main__":
    main()
