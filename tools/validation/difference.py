#!/usr/bin/env python
"""How often `mavdem diff` calls a change certain between two flights of a vehicle, with the same gains and with others.

Each vehicle of loops.py flies three times, in other wind of the same kind: twice with its gains, and once with P, I and
D of all rate controllers lowered by a third. "same" compares the first flight with the second, "gains" with the third.
No model is learned, so that shares of motors and figures of loops are compared, and not physical parameters.

The table counts, for each of the two comparisons: "pairs" of flights; pairs in which "any" quantity is called changed,
where the threshold allows for how many are tested at once; pairs in which one would be called changed if it were tested
"alone"; "tests", the quantities of all pairs; and, by kind of quantity, those that are called changed.

Usage: tools/validation/difference.py [--half NAME] [--rate HZ of the messages] [--flights N vehicles] [--jobs N]
"""

from collections import Counter
from functools import partial

from flights import Values, command, evaluate_flights, print_table
from later_flights import thinned_log_of_flight
from loops import HALF, HALVES, drawn_flight

from mavdem.assessment.assess import assess
from mavdem.assessment.axis import Options
from mavdem.experiments.paired_test import SIGNIFICANCE
from mavdem.facts.fleet import QuantityOutcome
from mavdem.fleet.difference import VehicleDifference, vehicle_difference
from mavdem.fleet.row import FlightRows
from mavdem.fleet.rows_of_log import rows_of_assessment
from mavdem.ingest.telemetry import Parameters
from mavdem.loops.advice import GAIN_REDUCTION
from sitl_scenarios.scenario import Scenario

RATE_GAINS = {
    "ardupilot": [f"ATC_RAT_{axis}_{gain}" for axis in ("RLL", "PIT", "YAW") for gain in "PID"],
    "px4": [f"MC_{axis}RATE_{gain}" for axis in ("ROLL", "PITCH", "YAW") for gain in "PID"],
}
"""Parameters of the rate controllers by autopilot."""


def rows_of_flight(scenario: Scenario, gains: Parameters, number: int, rate: float) -> FlightRows:
    """Returns the rows of the fleet's table for one flight of a vehicle.

    Args:
        scenario: the vehicle and its first flight.
        gains: gains to set, by the autopilot's names.
        number: number of the flight, which changes its wind.
        rate: rate of the messages, Hz.
    """
    log = thinned_log_of_flight(scenario, gains, number, rate)
    assessment = assess(log, options=Options(with_model=False)).with_axis("pitch")
    return rows_of_assessment(assessment, f"{scenario.seed}-{number}.tlog")


def evaluate_vehicle(seed: int, rate: float) -> list[Values]:
    """Compares a flight of a vehicle with one with the same gains, and with one whose rate gains are lowered.

    Args:
        seed: seed of its first flight.
        rate: rate of the messages, Hz.

    Returns:
        A row for each comparison, "same" and "gains"; none where the vehicle tumbles with lowered gains.
    """
    scenario, _ = drawn_flight(seed)
    parameters = scenario.vehicle.parameters
    lowered = {
        name: GAIN_REDUCTION * parameters[name]
        for names in RATE_GAINS.values()
        for name in names
        if name in parameters
    }
    first = rows_of_flight(scenario, {}, 1, rate)
    rows = []
    for name, gains, number in (("same", {}, 2), ("gains", lowered, 3)):
        try:
            second = rows_of_flight(scenario, gains, number, rate)
        except ValueError:
            # The vehicle tumbles.
            continue
        rows.append({"compared": name} | counts(vehicle_difference(first, second)))
    return rows


def counts(difference: VehicleDifference) -> Values:
    """Returns the row of one pair of flights: the counts that the module's docstring names, of which "pairs" is 1.

    Args:
        difference: comparison of the two flights.
    """
    changes = difference.changes_with(QuantityOutcome.CHANGED)
    by_kind = Counter(change.quantity.kind for change in changes)
    alone = any(change.p <= SIGNIFICANCE for change in difference.changes)
    return {
        "pairs": 1,
        "any": int(bool(changes)),
        "alone": int(alone),
        "tests": len(difference.changes),
        **by_kind,
    }


@command(__doc__, rate=100.0, flights=6)
@HALF
def main(half: str, rate: float, flights: int, jobs: int) -> None:
    """Prints a row for each of the two comparisons: the counts of all vehicles that the module's docstring names."""
    evaluate = partial(evaluate_vehicle, rate=rate)
    rows = evaluate_flights(evaluate, HALVES[half][:flights], jobs)
    table = rows.fillna(0).groupby("compared", sort=False).sum().astype(int).reset_index()
    print_table(f"Half {half}, {rate:g} Hz", table)


if __name__ == "__main__":
    main()
