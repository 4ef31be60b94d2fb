#!/usr/bin/env python
"""Gains of mavdem, of AutoTune and of QuickTune, judged by the true plants of the simulated flights of loops.py.

mavdem advises gains in steps, one for each later flight (``mavdem tune --more``), always by the plant that was
identified from the first flight. The goal is the margins that --margins names, in the rate and the attitude loop of the
true plant.

The table has a row for each tuner and autopilot. "refused" is the number of loops for which mavdem gives no advice;
they do not count further. "met before" and "met" are the numbers of loops that meet the goal before and after tuning,
the columns with a factor those that meet it with so many times the control effectiveness: 1.44 times is 20 % more
voltage. The other columns are medians: the bandwidth of the rate loop and the lean in the flight's wind relative to
those before, the largest sensitivity Ms of the rate loop, and the flights after which the goal is first met.

Usage: tools/validation/advice.py [--half NAME] [--rate HZ of the messages] [--margins NAME] [--flights N] [--jobs N]
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import click
import numpy as np
import pandas as pd
from autopilot_tuners import autotune, quicktune
from flights import Values, command, evaluate_flights, print_table
from loops import CACHE, HALF, HALVES, AxisPlant, identified_loops, simulated_log

from mavdem.assessment.record import NoLoop
from mavdem.ingest.telemetry import Parameters
from mavdem.loops.advice import advise
from mavdem.loops.axis_loops import MARGIN_TARGETS, Loop, MarginTarget, margin_scores
from mavdem.loops.gain_design import bandwidth_of_estimate
from mavdem.loops.margins import FrequencyGrid
from mavdem.plant.parameters import ESTIMATE

EFFECTS = {"met": 1.0, "0.8 times": 0.8, "1.2 times": 1.2, "1.44 times": 1.44}
"""Factors on the control effectiveness of the flight, by the column of the table."""

MAX_FLIGHTS = 6
"""Most flights with gains of mavdem. An autopilot's tuner flies once."""

TUNER_GRID = FrequencyGrid(0.05, 60.0, 150)
"""Frequencies with which the autopilot's tuners are simulated: coarser than the result's, for speed."""

MEDIANS = ["bandwidth", "Ms", "lean", "flights"]
"""Columns with medians."""


def true_loop(loop: Loop, plant: AxisPlant, factor: float = 1.0) -> Loop:
    """Returns the loops of the true plant, with the controller and the wind of an identified loop.

    Args:
        loop: identified loop of the axis.
        plant: the true plant.
        factor: factor on its control effectiveness, as by more or less voltage.
    """
    effectiveness = np.array([factor * plant.effect])
    dynamics = np.array([[plant.damping, plant.lag, plant.delay]])
    return replace(loop, effectiveness=effectiveness, dynamics=dynamics)


def meets(loop: Loop, target: MarginTarget) -> bool:
    """Returns whether the rate and the attitude loop of an axis both have the margins of a target."""
    return bool(margin_scores(target, loop.rate, loop.attitude)[ESTIMATE] >= 1)


def advised_gains(loop: Loop, margins: str) -> Iterator[Parameters]:
    """Yields the gains to set for one flight after the other; nothing if no gains are advised.

    Args:
        loop: identified loop of the axis, which stands for the loops that later flights would identify.
        margins: name of the stability margins that are the goal, a key of ``MARGIN_TARGETS``.

    Yields:
        All parameters that have been changed so far, by name, after each flight.
    """
    gains: Parameters = {}
    for _ in range(MAX_FLIGHTS):
        advice = advise(
            loop.with_parameters(gains) if gains else loop, margins, raises_sound_gains=True
        )
        if advice.refusals:
            return
        gains = {**gains, **advice.parameters}
        yield gains
        if not advice.parameters:
            return


def evaluate_gains(
    loop: Loop, plant: AxisPlant, steps: Iterator[Parameters], target: MarginTarget
) -> Values:
    """Judges the gains with which a tuner ends, by the loops that they give with the true plant.

    Args:
        loop: identified loop of the axis, with its controller and the wind.
        plant: the true plant.
        steps: gains after each flight of the tuner, as all parameters that it has changed so far. Without a step the
            tuner refuses to tune, and with an empty one it leaves the gains as they are.
        target: stability margins that are the goal.

    Returns:
        Values by name. "met before": whether the loop meets the target with the logged gains. The names of ``EFFECTS``:
        whether it does so with the final gains if the plant's effect is multiplied by that factor. "flights": number of
        flights until it first does so, if it did not before. "refused": whether the tuner refused to tune, and then
        "met before" is the only other value. "bandwidth" and "lean": those with the final gains over those with the
        logged ones. "Ms": maximum sensitivity with the final gains.
    """
    before = true_loop(loop, plant)
    row: Values = {"met before": meets(before, target), "refused": True}
    final = before
    for number, gains in enumerate(steps, start=1):
        row["refused"] = False
        if gains:
            final = before.with_parameters(gains)
        if "flights" not in row and not row["met before"] and meets(final, target):
            row["flights"] = number
    if row["refused"]:
        return row
    for name, factor in EFFECTS.items():
        row[name] = meets(true_loop(final, plant, factor), target)
    row["bandwidth"] = bandwidth_of_estimate(final.rate) / bandwidth_of_estimate(before.rate)
    row["Ms"] = final.rate.ms
    row["lean"] = final.lean_in_wind / before.lean_in_wind
    return row


def evaluate_loop(loop: Loop, plant: AxisPlant, margins: str) -> list[Values]:
    """Tunes one axis with mavdem, AutoTune and QuickTune, and returns a row for each, as :func:`evaluate_gains` does.

    Args:
        loop: identified loop of the axis, from which mavdem advises gains.
        plant: the true plant, which the autopilot's tuners fly and which judges all gains.
        margins: name of the stability margins that are the goal, a key of ``MARGIN_TARGETS``.

    Returns:
        One row for each tuner.
    """
    target = MARGIN_TARGETS[margins]
    flown_loop = replace(true_loop(loop, plant), grid=TUNER_GRID)
    tuners = {
        "mavdem": advised_gains(loop, margins),
        "AutoTune": iter([autotune(flown_loop)]),
        "QuickTune": iter([quicktune(flown_loop)]),
    }
    autopilot = "ArduPilot" if loop.controller.is_ardupilot else "PX4"
    rows = []
    for name, steps in tuners.items():
        row = {"tuner": name, "autopilot": autopilot, "axis": loop.axis}
        rows.append(row | evaluate_gains(loop, plant, steps, target))
    return rows


def evaluate_flight(seed: int, rate: float, margins: str, cache: Path) -> list[Values]:
    """Returns the rows of all axes with a loop in the simulated flight of a seed.

    Args:
        seed: seed of the flight.
        rate: rate of the messages, Hz.
        margins: name of the stability margins that are the goal, a key of ``MARGIN_TARGETS``.
        cache: folder with the simulated flights.
    """
    log, true_figures = simulated_log(seed, cache)
    rows = []
    for axis, loop in identified_loops(log, rate).items():
        if isinstance(loop, NoLoop):
            continue
        rows += evaluate_loop(loop, AxisPlant.from_figures(true_figures[axis]), margins)
    return rows


def summary(rows: pd.DataFrame) -> pd.DataFrame:
    """Returns the table: counts of loops and medians by tuner and autopilot, and by tuner for both autopilots.

    Args:
        rows: rows of :func:`evaluate_gains` with tuner and autopilot.
    """
    with_both_autopilots = pd.concat([rows, rows.assign(autopilot="both")])
    rows_by_tuner = with_both_autopilots.groupby(["tuner", "autopilot"], sort=False)
    table = rows_by_tuner[["refused", "met before", *EFFECTS]].sum().astype(int)
    table.insert(0, "loops", rows_by_tuner.size())
    table[MEDIANS] = rows_by_tuner[MEDIANS].median()
    return table.reset_index()


@command(__doc__, rate=100.0, flights=24)
@click.option(
    "--margins", type=click.Choice(list(MARGIN_TARGETS)), default="default", show_default=True
)
@HALF
@CACHE
def main(half: str, rate: float, margins: str, flights: int, cache: Path, jobs: int) -> None:
    """Prints a row for each tuner and autopilot: how many loops meet the goal, and how the loops have changed."""
    evaluate = partial(evaluate_flight, rate=rate, margins=margins, cache=cache)
    rows = evaluate_flights(evaluate, HALVES[half][:flights], jobs)
    print_table(f"Half {half}, {rate:g} Hz, margins {margins}", summary(rows))


if __name__ == "__main__":
    main()
