#!/usr/bin/env python
"""Gains that are advised, evaluate_flight by the truth of the simulated flights of loops.py, thinned to one rate.

The goal is that of --margins, in the rate and the attitude loop of the true plant, with the flight's control
effectiveness, and with 1.2 and 1.44 times that, as by 20 % more volts. The lean is that in the flight's wind, by the
gains advised over those of the log, in the median: of all loops, and of those that met the goal before and did not.

Usage: tools/validation/advice.py [--half NAME] [--rate HZ of the messages] [--margins NAME] [--flights N] [--jobs N]
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import click
import numpy as np
import pandas as pd
from flights import Values, command, evaluate_flights, print_table
from loops import CACHE, HALF, HALVES, PLANT, identified_loops, simulated_log

from mavdem.assessment.record import NoLoop
from mavdem.loops.advice import advise
from mavdem.loops.axis_loops import MARGIN_TARGETS, Loop, MarginTarget, margin_scores

EFFECTS = {"after": 1.0, "1.2 times": 1.2, "1.44 times": 1.44}
"""Factors on the control effectiveness of the flight, by the column of the table."""

GOALS = ["goal met before", *EFFECTS]
"""Columns that count loops with the margins."""

LEANS = {"lean": (True, False), "lean, goal met before": (True,), "lean, not met": (False,)}
"""Columns with a median lean: of all loops, and of those that had the margins before, or not."""


def evaluate_gains(
    loop: Loop, plant: list[float], gains: Mapping[str, float], target: MarginTarget
) -> Values:
    """Judges gains by the true plant.

    Args:
        loop: identified loop of the axis, with its controller and the wind.
        plant: control effectiveness, damping, lag and delay of the true plant, as in ``PLANT``.
        gains: gains to set, by the autopilot's name; those of the log for none.
        target: margins to have.

    Returns:
        "met", whether both loops of the true plant have the margins, and "lean" in the wind, degrees.
    """
    effect, *dynamics = plant
    flown = replace(loop, effectiveness=np.array([effect]), dynamics=np.array([dynamics]))
    true = flown.with_parameters(gains)
    score = margin_scores(target, true.rate, true.attitude)[0]
    met = score >= 1
    return {"met": bool(met), "lean": true.lean_in_wind}


def evaluate_flight(seed: int, rate: float, margins: str, cache: Path) -> list[Values]:
    """Returns a row for each axis with a loop in the simulated flight of a seed.

    Args:
        seed: seed of the flight.
        rate: rate of the messages, Hz.
        margins: name of the margins to have.
        cache: folder with the simulated flights.
    """
    log, truth = simulated_log(seed, cache)
    rows = []
    for axis, loop in identified_loops(log, rate).items():
        if isinstance(loop, NoLoop):
            continue
        advice = advise(loop, margins, more=True)
        row = {"advice": advice.sentence.code.name}
        rows.append(row)
        if advice.refusals:
            continue
        effect, *dynamics = (truth[axis][name] for name in PLANT)
        before = evaluate_gains(loop, [effect, *dynamics], {}, advice.target)
        row["goal met before"] = before["met"]
        for name, factor in EFFECTS.items():
            plant = [factor * effect, *dynamics]
            after = evaluate_gains(loop, plant, advice.parameters, advice.target)
            row[name] = after["met"]
            if factor == 1.0:
                row["lean"] = after["lean"] / before["lean"]
    return rows


@command(__doc__, rate=100.0, flights=24)
@click.option(
    "--margins", type=click.Choice(list(MARGIN_TARGETS)), default="default", show_default=True
)
@HALF
@CACHE
def main(half: str, rate: float, margins: str, flights: int, cache: Path, jobs: int) -> None:
    judge = partial(evaluate_flight, rate=rate, margins=margins, cache=cache)
    rows = evaluate_flights(judge, HALVES[half][:flights], jobs)
    rows = rows.reindex(columns=["advice", *GOALS, "lean"])
    for name, met in LEANS.items():
        of_kind = rows["goal met before"].isin(met)
        rows[name] = rows["lean"].where(of_kind)
    both = pd.concat([rows, rows.assign(advice="all")])
    grouped = both.groupby("advice")
    table = grouped[GOALS].sum().astype(int)
    table.insert(0, "loops", grouped.size())
    table[[*LEANS]] = grouped[[*LEANS]].median()
    print_table(f"Half {half}, {rate:g} Hz, margins {margins}", table.reset_index())


if __name__ == "__main__":
    main()
