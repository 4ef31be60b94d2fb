#!/usr/bin/env python
"""Number of simulated flights, each with the gains that mavdem advises after the one before, until margins are met.

The vehicles are the ones of loops.py. After each flight the gains that mavdem advises with --more for all axes are
loaded, and the vehicle flies again, in other wind of the same kind. The goal is that rate and attitude loop of the true
plant have the margins that --margins names.

The table has one row. "met before" and "met in the end" are the numbers of loops that meet the goal, "lost" those whose
vehicle tumbled. "flown again" is the number of flights until the goal is met, and "first plant" the same where the
plant that the first flight identified is used in the place of later flights, as in advice.py. Both are medians over the
loops that meet the goal in the end, but not before.

Usage: tools/validation/later_flights.py [--half NAME] [--margins NAME] [--flights N vehicles] [--jobs N]
"""

from collections.abc import Sequence
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
    AxisPlant,
    drawn_flight,
    exact_log,
    identified_loops,
    thinned_telemetry,
    true_figures_of_flight,
)

from mavdem.assessment.record import NoLoop
from mavdem.experiments.paper.flights import write_log
from mavdem.ingest import Log
from mavdem.ingest.telemetry import Parameters
from mavdem.loops.advice import advise
from mavdem.loops.axis_loops import MARGIN_TARGETS, Loop
from sitl_scenarios.files import scenario_from_table
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.simulation import fly

RATE = 100.0
"""Rate of the messages, Hz: one at which most loops are identified."""

FLIGHT_SEED_STEP = 100_000
"""Difference of the seeds of two flights of a vehicle: no two flights of a half share one."""


class FirstLoop(NamedTuple):
    """The control loops of one axis in the first flight, as identified from its log, and the true plant of the axis."""

    identified: Loop
    """The rate and attitude loop that were identified from the first flight, with its gains."""
    true_plant: AxisPlant
    """The true plant."""

    def with_gains(self, gains: Parameters) -> Loop:
        """Returns the loops that the true plant has with other gains."""
        return true_loop(self.identified, self.true_plant).with_parameters(gains)


def thinned_log_of_flight(scenario: Scenario, gains: Parameters, number: int, rate: float) -> Log:
    """Simulates a further flight of a vehicle with other gains, and returns its log, thinned to a rate of messages.

    Args:
        scenario: scenario of the vehicle's first flight.
        gains: gains to set, by the autopilot's names.
        number: number of the flight, which changes the seed, and with it the wind.
        rate: rate of the messages, Hz.

    Returns:
        The log, with the exact times of the autopilot's cycles as stamps.

    Raises:
        ValueError: the vehicle tumbles.
    """
    values = scenario.model_dump(mode="json")
    values["seed"] += FLIGHT_SEED_STEP * number
    values["vehicle"]["parameters"] |= gains
    later_scenario = scenario_from_table(values)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "flight.tlog"
        write_log(path, later_scenario, fly(later_scenario))
        log = exact_log(path)
    vehicles = tuple(thinned_telemetry(vehicle, rate) for vehicle in log.vehicles)
    return replace(log, vehicles=vehicles)


def loops_of_later_flight(
    scenario: Scenario, gains: Parameters, number: int
) -> dict[str, Loop | NoLoop]:
    """Simulates a further flight of a vehicle with other gains, and identifies its control loops.

    Args:
        scenario: scenario of the vehicle's first flight.
        gains: gains to set, by the autopilot's names.
        number: number of the flight; 0 for the first one.

    Returns:
        By axis the identified loop, or why there is none.

    Raises:
        ValueError: the vehicle tumbles.
    """
    return dict(identified_loops(thinned_log_of_flight(scenario, gains, number, RATE), RATE))


def evaluate_vehicle(seed: int, margins: str) -> list[Values]:
    """Counts the flights until each axis of a vehicle has the wanted margins, by two ways to tune it.

    Either gains are advised once and for all, from the plant that the first flight identified. Or the vehicle flies
    again with the advised gains, and the next advice follows from the loops that this flight identifies.

    Args:
        seed: seed of the first flight.
        margins: name of the stability margins that are the goal, a key of ``MARGIN_TARGETS``.

    Returns:
        A row for each axis whose loop the first flight identifies: whether the goal was "met before" and is "met" in
        the end, the number of flights until then by the "first plant" and "flown again", and whether the vehicle was
        "lost", because it tumbled with advised gains.
    """
    target = MARGIN_TARGETS[margins]
    first_scenario, first_loops = _first_flight(seed)
    rows = {}
    for axis, first_loop in first_loops.items():
        rows[axis] = _row_by_first_plant(axis, first_loop, margins)
    # All gains that were changed so far, and the loops that the latest flight identified.
    gains: dict[str, float] = {}
    loops: dict[str, Loop | NoLoop] = {}
    for axis, first_loop in first_loops.items():
        loops[axis] = first_loop.identified
    for number in range(1, MAX_FLIGHTS + 1):
        changes = _advised_changes([loops[axis] for axis in first_loops], margins)
        gains = {**gains, **changes}
        for axis, first_loop in first_loops.items():
            # The true plant of the axis judges the gains.
            row = rows[axis]
            row["met"] = meets(first_loop.with_gains(gains), target)
            if row["met"] and "flown again" not in row:
                row["flown again"] = number
        if not changes:
            break
        try:
            loops = loops_of_later_flight(first_scenario, gains, number)
        except ValueError:
            # The vehicle tumbles.
            for row in rows.values():
                row["lost"] = True
            break
    return list(rows.values())


def _first_flight(seed: int) -> tuple[Scenario, dict[str, FirstLoop]]:
    """Simulates the first flight of a vehicle, and returns its scenario and the loops that are identified from its log.

    Args:
        seed: seed of the flight.

    Returns:
        The scenario, and the loops by axis, without the axes that have no identified loop.
    """
    scenario, motion = drawn_flight(seed)
    true_figures = true_figures_of_flight(scenario, motion)
    first_loops = {}
    for axis, loop in loops_of_later_flight(scenario, {}, 0).items():
        if isinstance(loop, Loop):
            true_plant = AxisPlant.from_figures(true_figures[axis])
            first_loops[axis] = FirstLoop(loop, true_plant)
    return scenario, first_loops


def _row_by_first_plant(axis: str, first_loop: FirstLoop, margins: str) -> Values:
    """Counts how often gains must be advised for an axis, by the plant of the first flight alone, as a row of results.

    mavdem limits the change of a gain in one flight. Here the advice is repeated with the plant of the first flight
    until nothing is left to change (at most ``MAX_FLIGHTS`` times), as if no later flight were needed.

    Args:
        axis: "roll", "pitch" or "yaw".
        first_loop: the loop that the first flight identified, and the true plant, which judges the gains.
        margins: name of the stability margins that are the goal, a key of ``MARGIN_TARGETS``.

    Returns:
        "axis"; "met before", whether the first flight's gains meet the goal with the true plant; if the goal is met,
        "first plant", how often gains were advised until then; and "lost", False until a later flight tumbles.
    """
    target = MARGIN_TARGETS[margins]
    meets_goal_before = meets(first_loop.with_gains({}), target)
    row: Values = {"axis": axis, "met before": meets_goal_before, "lost": False}
    for number, gains in enumerate(advised_gains(first_loop.identified, margins), start=1):
        if meets(first_loop.with_gains(gains), target):
            row["first plant"] = number
            break
    return row


def _advised_changes(loops: Sequence[Loop | NoLoop], margins: str) -> dict[str, float]:
    """Returns the gains that mavdem advises to change after a flight, also upwards where margins are good.

    Args:
        loops: the loops of all axes that the flight identified, or why there is none.
        margins: name of the stability margins that are the goal, a key of ``MARGIN_TARGETS``.

    Returns:
        New values by the autopilot's parameter names; empty if nothing is to be changed.
    """
    changes: dict[str, float] = {}
    for loop in loops:
        if isinstance(loop, Loop):
            changes.update(advise(loop, margins, raises_sound_gains=True).parameters)
    return changes


@command(__doc__, flights=6)
@click.option(
    "--margins", type=click.Choice(list(MARGIN_TARGETS)), default="default", show_default=True
)
@HALF
def main(half: str, margins: str, flights: int, jobs: int) -> None:
    """Prints one row: how many loops have the wanted margins, and after how many flights, by two ways to tune them.

    Args:
        half: name of the set of vehicles, a key of ``HALVES``: "choose" to choose methods on, "report" for results.
        margins: name of the stability margins that are the goal, a key of ``MARGIN_TARGETS``.
        flights: number of vehicles, each with a first flight of its own.
        jobs: number of processes.
    """
    evaluate = partial(evaluate_vehicle, margins=margins)
    rows = pd.DataFrame(evaluate_flights(evaluate, HALVES[half][:flights], jobs))
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
