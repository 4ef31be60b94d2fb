#!/usr/bin/env python
"""How often `mavdem diff`, a test of two flights for changed quantities, finds the changes of simulated vehicles.

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
from collections.abc import Iterable, Mapping
from contextlib import suppress
from functools import partial
from itertools import chain
from typing import NamedTuple

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
from mavdem.loops.advice import GAIN_REDUCTION
from sitl_scenarios.files import scenario_from_table
from sitl_scenarios.scenario import Scenario

RATE_GAINS = {
    "ardupilot": [f"ATC_RAT_{axis}_{gain}" for axis in ("RLL", "PIT", "YAW") for gain in "PID"],
    "px4": [f"MC_{axis}RATE_{gain}" for axis in ("ROLL", "PITCH", "YAW") for gain in "PID"],
}
"""Parameters of the rate controllers by autopilot."""


ROLL_GAINS = ("ATC_RAT_RLL_P", "MC_ROLLRATE_P")
"""P of the rate of roll: ArduPilot's parameter and PX4's."""

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


class FlownChange(NamedTuple):
    """One of a vehicle's flights: what flies, and which gains were changed before it."""

    scenario: Scenario
    """The vehicle with its first flight; a motor of it may be weak."""

    gains: dict[str, float]
    """Gains that differ from the scenario's, by the autopilot's names."""


def rows_of_flight(flight: FlownChange, number: int, options: Options, rate: float) -> FlightRows:
    """Simulates a flight, reviews its log, and returns the rows that a fleet's table, which is compared, has of it.

    Args:
        flight: the vehicle and its gains.
        number: number of the flight, which changes its wind.
        options: whether a model is learned.
        rate: rate of the messages, Hz.

    Raises:
        ValueError: the vehicle tumbles.
    """
    log = thinned_log_of_flight(flight.scenario, flight.gains, number, rate)
    assessment = assess(log, options=options).with_axis("pitch")
    return rows_of_assessment(assessment, f"{flight.scenario.seed}-{number}.tlog")


def changed_flights(scenario: Scenario, weak_motor: int) -> dict[str, FlownChange]:
    """Returns the five flights of a vehicle, by the names that ``COMPARISONS`` gives them.

    Two flights are of the vehicle as it is; the others have lower gains, a weak motor, or both.

    Args:
        scenario: the vehicle as it is.
        weak_motor: number of the motor that loses thrust in two of the flights, from 1.
    """
    parameters = scenario.vehicle.parameters
    rate_gains = chain.from_iterable(RATE_GAINS.values())
    lowered_gains = _scaled_parameters(parameters, rate_gains, GAIN_REDUCTION)
    lowered_roll_gain = _scaled_parameters(parameters, ROLL_GAINS, ROLL_GAIN_FACTOR)
    values = scenario.model_dump(mode="json")
    values["vehicle"] |= {"weak_motor": weak_motor, "weak_thrust": REMAINING_THRUST}
    scenario_with_weak_motor = scenario_from_table(values)
    return {
        "first": FlownChange(scenario, {}),
        "second": FlownChange(scenario, {}),
        "gains": FlownChange(scenario, lowered_gains),
        "motor": FlownChange(scenario_with_weak_motor, {}),
        "both": FlownChange(scenario_with_weak_motor, lowered_roll_gain),
    }


def _scaled_parameters(
    parameters: Mapping[str, float], names: Iterable[str], factor: float
) -> dict[str, float]:
    """Returns parameters of a vehicle multiplied by a factor, by name.

    Args:
        parameters: all parameters of the vehicle by name.
        names: names of the parameters to scale, of both autopilots; those that the vehicle does not have are left out.
        factor: the factor.
    """
    return {name: factor * parameters[name] for name in names if name in parameters}


def evaluate_vehicle(seed: int, rate: float, with_models: bool) -> list[Values]:
    """Flies a vehicle five times, and compares pairs of its flights.

    Args:
        seed: seed of its first flight.
        rate: rate of the messages, Hz.
        with_models: whether a model is learned of each flight.

    Returns:
        A row for each of the ``COMPARISONS``, without flights in which the vehicle tumbles.
    """
    scenario, _ = drawn_flight(seed)
    parameters = scenario.vehicle.parameters
    weak_motor = seed % 4 + 1
    flights = changed_flights(scenario, weak_motor)
    rows_by_flight = {}
    options = Options(with_model=with_models)
    for number, (name, flight) in enumerate(flights.items(), start=1):
        # A vehicle that tumbles raises the error: that flight is left out.
        with suppress(ValueError):
            rows_by_flight[name] = rows_of_flight(flight, number, options, rate)
    table = []
    for name, (before, after) in COMPARISONS.items():
        if before in rows_by_flight and after in rows_by_flight:
            changes = changed_parameters(parameters, parameters | flights[after].gains)
            difference = vehicle_difference(rows_by_flight[before], rows_by_flight[after], changes)
            table.append({"compared": name} | detection_counts(difference, weak_motor))
    return table


def detection_counts(difference: VehicleDifference, weak_motor: int) -> Values:
    """Counts which changes a comparison of two flights has found, as the row of this pair.

    A quantity, such as the trim of a motor or a phase margin, is called changed where its difference is significant
    among all that are tested. What other gains explain is not tested, and is reported apart.

    Args:
        difference: comparison of the two flights.
        weak_motor: number of the motor that is weak in some flights, from 1.

    Returns:
        Counts by column of the table, which the rows of all pairs are summed into. 0 or 1: "pairs" (always 1), "any"
        quantity changed, a change that follows from the gains was reported ("told"), the weak motor was "found", a
        sound motor was named ("wrong"), a quantity would be called changed if it were the only one tested ("alone").
        Numbers: "tests", the tested quantities, and the changed quantities by kind.
    """
    changes = difference.changes_with(QuantityOutcome.CHANGED)
    changes_by_gains = [change for change in changes if difference.follows_from_gains(change)]
    other_changes = [change for change in changes if not difference.follows_from_gains(change)]
    named_motors = {
        change.quantity.motor for change in other_changes if change.quantity.is_of_motor
    }
    is_any_significant_alone = any(change.p <= SIGNIFICANCE for change in difference.tested)
    changes_by_kind = Counter(change.quantity.kind for change in other_changes)
    return {
        "pairs": 1,
        "any": int(bool(other_changes)),
        "told": int(bool(changes_by_gains)),
        "found": int(weak_motor in named_motors),
        "wrong": int(bool(named_motors - {weak_motor})),
        "alone": int(is_any_significant_alone),
        "tests": len(difference.tested),
        **changes_by_kind,
    }


@command(__doc__, rate=100.0, flights=6)
@click.option("--models", is_flag=True)
@HALF
def main(half: str, rate: float, flights: int, jobs: int, models: bool) -> None:
    """Simulates flights of several vehicles, and prints a row of counts for each comparison of two flights.

    Args:
        half: name of the half of the vehicles: "choose" to choose methods on, "report" for results.
        rate: rate of the messages, Hz.
        flights: number of vehicles, which is the option --flights; each makes five flights.
        jobs: number of processes.
        models: whether models are learned, whose physical parameters are then compared, too.
    """
    # Each vehicle is drawn at random from a seed of its half.
    vehicle_seeds = HALVES[half][:flights]
    evaluate = partial(evaluate_vehicle, rate=rate, with_models=models)
    counts_by_vehicle = evaluate_flights(evaluate, vehicle_seeds, jobs)
    # A kind of quantity that changed in no pair of a vehicle has no count there, so that NaN stands for 0.
    counts = counts_by_vehicle.fillna(0).groupby("compared", sort=False).sum()
    table = counts.astype(int).reset_index()
    print_table(f"Half {half}, {rate:g} Hz", table)


if __name__ == "__main__":
    main()
