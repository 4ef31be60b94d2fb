#!/usr/bin/env python
"""Number of flights until the goal is met, where each flight is flown with the advised gains and identified anew.

The vehicles are those of loops.py. After each flight the gains that mavdem advises with --more for all axes are loaded,
and the vehicle flies again, in other wind of the same kind. The goal is that of --margins, in the rate and the attitude
loop of the true plant. "first plant" is the number of flights where the plant that the first flight showed is used
again in the place of later flights, as in advice.py. Both are medians over loops that meet the goal in the end.

Usage: tools/validation/later_flights.py [--half NAME] [--rate HZ] [--margins NAME] [--flights N vehicles] [--jobs N]
"""

from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import click
import pandas as pd
from advice import MAX_FLIGHTS, advised_gains, meets, true_loop
from flights import Values, command, evaluate_flights, print_table
from loops import (
    HALF,
    HALVES,
    PLANT,
    drawn_flight,
    exact_log,
    identified_loops,
    thinned,
    true_figures_of_flight,
)

from mavdem.assessment.record import NoLoop
from mavdem.experiments.paper.flights import write_log
from mavdem.ingest import Log
from mavdem.ingest.telemetry import Parameters
from mavdem.loops.advice import advise
from mavdem.loops.axis_loops import MARGIN_TARGETS, Loop
from sitl_scenarios.files import scenario_of
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.simulation import fly

RATE = 100.0
"""Rate of the messages, Hz."""

FLIGHT_SEED_STEP = 100_000
"""Difference of the seeds of two flights of a vehicle: no two flights of a half share one."""


class FirstLoop(NamedTuple):
    """A loop as the first flight showed it."""

    identified: Loop
    plant: list[float]
    """The true plant, as in ``PLANT``."""


def thinned_log_of_flight(scenario: Scenario, gains: Parameters, number: int, rate: float) -> Log:
    """Flies a vehicle with other gains, in other wind of the same kind, and returns its log, thinned to a rate.

    Args:
        scenario: the first flight.
        gains: gains to set, by the autopilot's names.
        number: number of the flight, which changes its seed.
        rate: rate of the messages, Hz.

    Raises:
        ValueError: the vehicle tumbles.
    """
    values = scenario.model_dump(mode="json")
    values["seed"] += FLIGHT_SEED_STEP * number
    values["vehicle"]["parameters"] |= gains
    changed = scenario_of(values)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "flight.tlog"
        write_log(path, changed, fly(changed))
        log = exact_log(path)
    return replace(log, vehicles=tuple(thinned(vehicle, rate) for vehicle in log.vehicles))


def reflown(scenario: Scenario, gains: Parameters, number: int) -> dict[str, Loop | NoLoop]:
    """Flies a vehicle with other gains, in other wind of the same kind, and identifies its loops.

    Args:
        scenario: the first flight.
        gains: gains to set, by the autopilot's names.
        number: number of the flight.

    Raises:
        ValueError: the vehicle tumbles.
    """
    return dict(identified_loops(thinned_log_of_flight(scenario, gains, number, RATE), RATE))


def evaluate_vehicle(seed: int, margins: str) -> list[Values]:
    """Returns a row for each axis whose loop the first flight shows: when its goal is met, flying again or not.

    Args:
        seed: seed of the first flight.
        margins: name of the margins to have.
    """
    target = MARGIN_TARGETS[margins]
    scenario, motion = drawn_flight(seed)
    truths = true_figures_of_flight(scenario, motion)
    first_loops = {}
    for axis, loop in reflown(scenario, {}, 0).items():
        if isinstance(loop, Loop):
            first_loops[axis] = FirstLoop(loop, [truths[axis][name] for name in PLANT])
    rows: dict[str, Values] = {}
    for axis, first in first_loops.items():
        before = true_loop(first.identified, first.plant)
        rows[axis] = {"axis": axis, "met before": meets(before, target), "lost": False}
        steps = enumerate(advised_gains(first.identified, margins), start=1)
        for number, axis_gains in steps:
            tuned = before.with_parameters(axis_gains)
            if "first plant" not in rows[axis] and meets(tuned, target):
                rows[axis]["first plant"] = number
    gains: dict[str, float] = {}
    loops: dict[str, Loop | NoLoop] = {
        axis: first.identified for axis, first in first_loops.items()
    }
    for number in range(1, MAX_FLIGHTS + 1):
        changes: dict[str, float] = {}
        for axis in first_loops:
            loop = loops[axis]
            if isinstance(loop, Loop):
                changes.update(advise(loop, margins, more=True).parameters)
        gains = {**gains, **changes}
        for axis, first in first_loops.items():
            final = true_loop(first.identified, first.plant).with_parameters(gains)
            rows[axis]["met"] = meets(final, target)
            if rows[axis]["met"]:
                rows[axis].setdefault("flown again", number)
        if not changes:
            break
        try:
            loops = reflown(scenario, gains, number)
        except ValueError:
            # The vehicle tumbles.
            for row in rows.values():
                row["lost"] = True
            break
    return list(rows.values())


@command(__doc__, flights=6)
@click.option(
    "--margins", type=click.Choice(list(MARGIN_TARGETS)), default="default", show_default=True
)
@HALF
def main(half: str, margins: str, flights: int, jobs: int) -> None:
    judge = partial(evaluate_vehicle, margins=margins)
    rows = pd.DataFrame(evaluate_flights(judge, HALVES[half][:flights], jobs))
    met_later = rows[rows["met"] & ~rows["met before"]]
    summary = {
        "vehicles": flights,
        "loops": len(rows),
        "met before": int(rows["met before"].sum()),
        "met in the end": int(rows["met"].sum()),
        "lost": int(rows["lost"].sum()),
        "flown again": met_later["flown again"].median(),
        "first plant": met_later["first plant"].median(),
    }
    print_table(f"Half {half}, {RATE:g} Hz, margins {margins}", [summary])


if __name__ == "__main__":
    main()
