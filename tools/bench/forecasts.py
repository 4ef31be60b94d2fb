#!/usr/bin/env python
"""Errors of forecasts on recorded flights, relative to a forecast of the constant mean; prints a table by flight.

A window is 7 s to learn from and 1.5 s to forecast at every rate. The error ratio is the squared forecast error
relative to the error of the constant mean; the table has the median over windows. Below is the report of `mavdem
compare` beside joint autoregressions, whose ratios over flights are geometric means.

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
"""Columns of the table by flight.

"median ratio" and "worst" are of the windows' error ratios; "below 1" is the share of windows with a smaller error than
a constant forecast, "in the 90 % band" the share of samples.
"""


def evenly_chosen_windows(name: str, flight: mavdem.Flight, max_count: int | None) -> list[Window]:
    """Returns windows of a flight, evenly spread over it.

    Args:
        name: name of the flight.
        flight: the flight.
        max_count: number of windows that are chosen at most; all of them if None.
    """
    all_windows = windows(name, flight)
    count = min(max_count or len(all_windows), len(all_windows))
    indices = np.unique(np.linspace(0, len(all_windows) - 1, count).astype(int))
    return [all_windows[index] for index in indices]


def table_by_flight(comparison: Comparison) -> Table:
    """Summarises the forecasts of mavdem, the method "ours", by flight.

    Args:
        comparison: errors of all methods on all windows.

    Returns:
        A row for each flight with the ``COLUMNS``; the error ratios are without unit, shares are from 0 to 1.
    """
    rows = []
    for flight in comparison.flights:
        summaries = {summary["method"]: summary for summary in comparison.summaries(flight)}
        summary = summaries["ours"]
        # ``worse_than_constant`` is the number of windows with a larger error than the constant mean.
        share_below_1 = 1 - summary["worse_than_constant"] / summary["windows"]
        # The last horizon is the whole forecast. It has no share if the method gives no band.
        share_in_band = summary["horizons"][-1]["inside"]
        if share_in_band is None:
            share_in_band = np.nan
        rows.append(
            [
                flight,
                str(summary["windows"]),
                f"{summary['relative']:.3g}",
                f"{summary['worst']:.3g}",
                f"{share_below_1:.2f}",
                f"{share_in_band:.2f}",
            ]
        )
    return Table(COLUMNS, rows)


@click.command(help=__doc__)
@click.option(
    "--windows",
    "max_windows",
    type=click.IntRange(min=1),
    help="Of each flight, evenly over it.  [default: all]",
)
@click.option("--preset", type=click.Choice(["real", "paper"]), default="real", show_default=True)
@click.option("--settings", default="{}", help='Changes to the preset, such as {"order": 2}.')
def main(max_windows: int | None, preset: str, settings: str) -> None:
    """Forecasts windows of all recorded flights, and prints errors by flight and a comparison with joint VAR models.

    Args:
        max_windows: number of windows of a flight at most; all if None.
        preset: settings of DEM to begin with: "real" for recorded flights, "paper" for the paper's.
        settings: changes to these settings, as a JSON object.
    """
    base = mavdem.Settings.paper() if preset == "paper" else mavdem.Settings()
    changed = replace(base, **json.loads(settings))
    ours = Method("ours", partial(mavdem.learn, settings=changed), predicts=True)
    joint_var_methods = [method for method in METHODS if method.name.startswith("joint VAR")]
    chosen_windows = []
    for name, flight in recorded_flights():
        chosen_windows += evenly_chosen_windows(name, flight, max_windows)
    if not chosen_windows:
        sys.exit(
            f"There are no recorded flights in {DATA_FOLDER}; name their folder in MAVDEM_SHARED_DATA."
        )
    comparison = compare(chosen_windows, [ours, *joint_var_methods])
    print(markdown([table_by_flight(comparison), *comparison_report(comparison)]))


if __name__ == "__main__":
    main()
