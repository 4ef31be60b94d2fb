#!/usr/bin/env python
"""How often `mavdem diff` finds a change between two flights of a vehicle: where nothing changed, gains, or a motor.

Each vehicle of loops.py flies five times, in other wind of the same kind: twice as it is, once with P, I and D of all
rate controllers lowered by a third ("gains"), once with a motor that has lost 15 % of its thrust ("motor"), and once
with that motor and P of roll lowered by three tenths ("both"). "same" compares the first two flights, "gains" and
"motor" the first with theirs, "both" the second with the last, and "roll" the fourth with the last. Without --models no
model is learned, so that trims of motors and figures of loops are compared, and not physical parameters.

The table counts, for each comparison: "pairs" of flights; pairs in which "any" quantity is called changed that does not
follow from the gains; those in which one does ("told"); those that name the weak motor ("found") or another one
("wrong"); pairs in which one would be called changed if it were tested "alone"; "tests", the tested quantities of all
pairs; and, by kind of quantity, those that are called changed.

Usage: tools/validation/difference.py [--half NAME] [--rate HZ of the messages] [--flights N vehicles] [--models]
[--jobs N]
"""

from collections import Counter
from contextlib import suppress
from functools import partial
from itertools import filterfalse

import click
from flights import Values, command, evaluate_flights, print_table
from later_flights import thinned_log_of_flight
from loops import HALF, HALVES, drawn_flight

from mavdem.assessment.assess import assess
from mavdem.assessment.axis import Options
from mavdem.experiments.paired_test import SIGNIFICANCE
from mavdem.facts.fleet import QuantityOutcome
from mavdem.fleet.difference import VehicleDifference, vehicle_difference
from mavdem.fleet.parameter_changes import changed_parameters
from mavdem.fleet.row import FlightRows
from mavdem.fleet.rows_of_log import rows_of_assessment
from mavdem.ingest.telemetry import Parameters
from mavdem.loops.advice import GAIN_REDUCTION
from sitl_scenarios.files import scenario_of
from sitl_scenarios.scenario import Scenario

RATE_GAINS = {
    "ardupilot": [f"ATC_RAT_{axis}_{gain}" for axis in ("RLL", "PIT", "YAW") for gain in "PID"],
    "px4": [f"MC_{axis}RATE_{gain}" for axis in ("ROLL", "PITCH", "YAW") for gain in "PID"],
}
"""Parameters of the rate controllers by autopilot."""


ROLL_GAINS = "ATC_RAT_RLL_P", "MC_ROLLRATE_P"
"""P of the rate of roll by autopilot."""

ROLL_GAIN_FACTOR = 0.7
"""Factor of P of roll in the last flight."""

REMAINING_THRUST = 0.85
"""Thrust of the weak motor, as a share of a sound motor's."""

COMPARISONS = {
    "same": ("first", "second"),
    "gains": ("first", "gains"),
    "motor": ("first", "motor"),
    "both": ("second", "both"),
    "roll": ("motor", "both"),
}
"""The two flights of each comparison."""


def rows_of_flight(
    scenario: Scenario, gains: Parameters, number: int, options: Options, rate: float
) -> FlightRows:
    """Returns the rows of the fleet's table for one flight of a vehicle.

    Args:
        scenario: the vehicle and its first flight.
        gains: gains to set, by the autopilot's names.
        number: number of the flight, which changes its wind.
        options: whether a model is learned.
        rate: rate of the messages, Hz.
    """
    log = thinned_log_of_flight(scenario, gains, number, rate)
    assessment = assess(log, options=options).with_axis("pitch")
    return rows_of_assessment(assessment, f"{scenario.seed}-{number}.tlog")


def evaluate_vehicle(seed: int, rate: float, with_models: bool) -> list[Values]:
    """Compares the flights of a vehicle.

    Args:
        seed: seed of its first flight.
        rate: rate of the messages, Hz.
        with_models: whether a model is learned of each flight.

    Returns:
        A row for each of the ``COMPARISONS``, without flights in which the vehicle tumbles.
    """
    scenario, _ = drawn_flight(seed)
    parameters = scenario.vehicle.parameters
    lowered = {
        name: GAIN_REDUCTION * parameters[name]
        for names in RATE_GAINS.values()
        for name in names
        if name in parameters
    }
    lowered_roll = {
        name: ROLL_GAIN_FACTOR * parameters[name] for name in ROLL_GAINS if name in parameters
    }
    weak_motor = seed % 4 + 1
    values = scenario.model_dump(mode="json")
    values["vehicle"] |= {"weak_motor": weak_motor, "weak_thrust": REMAINING_THRUST}
    weak = scenario_of(values)
    flights = {
        "first": (scenario, {}),
        "second": (scenario, {}),
        "gains": (scenario, lowered),
        "motor": (weak, {}),
        "both": (weak, lowered_roll),
    }
    rows_by_flight = {}
    options = Options(with_model=with_models)
    for number, (name, (flown, gains)) in enumerate(flights.items(), start=1):
        # A vehicle may tumble.
        with suppress(ValueError):
            rows_by_flight[name] = rows_of_flight(flown, gains, number, options, rate)
    table = []
    for name, (before, after) in COMPARISONS.items():
        if before in rows_by_flight and after in rows_by_flight:
            changes = changed_parameters(parameters, parameters | flights[after][1])
            difference = vehicle_difference(rows_by_flight[before], rows_by_flight[after], changes)
            table.append({"compared": name} | counts(difference, weak_motor))
    return table


def counts(difference: VehicleDifference, weak_motor: int) -> Values:
    """Returns the row of one pair of flights: the counts that the module's docstring names, of which "pairs" is 1.

    Args:
        difference: comparison of the two flights.
        weak_motor: number of the weak motor.
    """
    changes = difference.changes_with(QuantityOutcome.CHANGED)
    by_gains = [*filter(difference.follows_from_gains, changes)]
    tested_changes = [*filterfalse(difference.follows_from_gains, changes)]
    motors = {change.quantity.motor for change in tested_changes if change.quantity.is_of_motor}
    by_kind = Counter(change.quantity.kind for change in tested_changes)
    return {
        "pairs": 1,
        "any": int(bool(tested_changes)),
        "told": int(bool(by_gains)),
        "found": int(weak_motor in motors),
        "wrong": int(bool(motors - {weak_motor})),
        "alone": int(any(change.p <= SIGNIFICANCE for change in difference.tested)),
        "tests": len(difference.tested),
        **by_kind,
    }


@command(__doc__, rate=100.0, flights=6)
@click.option("--models", is_flag=True)
@HALF
def main(half: str, rate: float, flights: int, jobs: int, models: bool) -> None:
    """Prints a row for each comparison: the counts of all vehicles that the module's docstring names."""
    evaluate = partial(evaluate_vehicle, rate=rate, with_models=models)
    rows = evaluate_flights(evaluate, HALVES[half][:flights], jobs)
    table = rows.fillna(0).groupby("compared", sort=False).sum().astype(int).reset_index()
    print_table(f"Half {half}, {rate:g} Hz", table)


if __name__ == "__main__":
    main()
