#!/usr/bin/env python
"""Health of the motors in recorded flights of one vehicle with a propeller cut shorter; prints a row for each flight.

FOLDER has the logs (.BIN). Those with "good" in their names have whole propellers and are the healthy flights that each
is compared with; a good one is compared with the others. Each flight is judged alone, and in order of date as `mavdem
track` does, where what an earlier flight shows is the prior of the next one. A second table compares each flight with
every earlier good one alone, as `mavdem diff` does of two logs. A third one judges vehicles of few flights without a
baseline: one to three good flights, then two with a propeller cut by 20 or 25 mm.

Usage: tools/validation/propellers.py FOLDER
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import click
import numpy as np
from flights import Values, print_table

from mavdem.assessment.condition import measure_condition
from mavdem.assessment.identity import identify_vehicle
from mavdem.dataset.signals import Signals
from mavdem.facts.motors import MotorHealth
from mavdem.ingest import read_log
from mavdem.motors.balance import balance_of_steady_flight
from mavdem.motors.health import HealthAssessment, assess_motor_health
from mavdem.motors.healthy_flights import HealthFigures
from mavdem.motors.signatures import motor_signatures

FOUND_CUTS = ("cut20mm", "cut25mm")
"""Words in the names of flights whose propeller is cut so far that it should be found."""


def health_figures(path: Path) -> HealthFigures:
    """Measures in a log the figures by which the health of its motors is judged.

    They are the balance of the motors in steady flight, from which a weak motor deviates, and the effort of all: their
    mean command at the voltage of the battery.

    Args:
        path: a log that has motor outputs and the battery's voltage.
    """
    signals = Signals(read_log(path).vehicles[0], inputs="motors")
    condition = measure_condition(signals)
    assert signals.motors is not None, "the log has no motor outputs"
    assert condition.battery is not None, "the log has no battery voltage"
    geometry = signals.motors.geometry
    return HealthFigures(
        name=path.stem,
        motors=geometry.names,
        signatures=motor_signatures(geometry),
        balance=balance_of_steady_flight(signals),
        date=identify_vehicle(signals).date,
        collective=condition.collective,
        voltage=condition.battery.voltage_mean,
    )


def health_row(
    flight: HealthFigures, assessment: HealthAssessment, by_date: HealthAssessment
) -> Values:
    """Returns the row of a flight in the table of results: health of the motors, probabilities, and suspected motor.

    Args:
        flight: balance and effort of the motors in the flight.
        assessment: health of its motors, judged by comparison with all healthy flights, whatever their dates.
        by_date: the same, judged with the knowledge from the flights before it alone.

    Returns:
        Texts by column. "motor" states by how many percent more than in healthy flights the suspected motor works, with
        the 90 % interval; it is empty if none is suspected.
    """
    motor = ""
    if assessment.suspect_motor is not None:
        rise, low, high = 100 * np.asarray(assessment.fact.figures["rise"], float)
        motor = f"{assessment.suspect_motor}, {rise:.0f} % ({low:.0f} to {high:.0f}) harder"
    return {
        "flight": flight.name,
        "health": assessment.health.value,
        "probability of a fault": f"{assessment.fault_probability:.2f}",
        "of any change": f"{assessment.change_probability:.2f}",
        "motor": motor,
        "health by date": by_date.health.value,
        "fault by date": f"{by_date.fault_probability:.2f}",
    }


def pair_row(flight: HealthFigures, good_flights: Sequence[HealthFigures]) -> Values:
    """Returns the row of a flight whose motors are compared with those of a single good flight before it, for each.

    Args:
        flight: balance and effort of the motors in the flight.
        good_flights: flights with sound motors; those after the flight are left out.

    Returns:
        Texts by column: the number of such pairs of flights, in how many of them the flight has a fault or a drift of
        the motors, how often each motor is named, and the smallest and the largest probability of a fault.
    """
    pairs_by_health = Counter[str]()
    pairs_by_motor = Counter[int]()
    probabilities = []
    for good_flight in good_flights:
        if good_flight.start_time >= flight.start_time:
            continue
        _, assessment = assess_motor_health([good_flight, flight])
        pairs_by_health[assessment.health] += 1
        if assessment.suspect_motor is not None:
            pairs_by_motor[assessment.suspect_motor] += 1
        assert assessment.fault_probability is not None
        probabilities.append(assessment.fault_probability)
    named_motors = [f"motor {motor} in {count}" for motor, count in sorted(pairs_by_motor.items())]
    lowest, highest = min(probabilities), max(probabilities)
    return {
        "flight": flight.name,
        "pairs": str(len(probabilities)),
        "fault": str(pairs_by_health[MotorHealth.FAULT]),
        "drift": str(pairs_by_health[MotorHealth.DRIFT]),
        "named": ", ".join(named_motors),
        "probability of a fault": f"{lowest:.2f} to {highest:.2f}",
    }


def row_without_baseline(
    good_count: int, good_flights: Sequence[HealthFigures], cut_flights: Sequence[HealthFigures]
) -> Values:
    """Returns the row of vehicles whose user named no healthy flight: good flights, then two with a cut propeller.

    Args:
        good_count: number of good flights of each vehicle.
        good_flights: flights with sound motors.
        cut_flights: flights with a propeller that is cut so far that it should be found.

    Returns:
        Texts by column: the number of vehicles, how many of all their cut flights are a fault, a drift, ok, and taken
        for healthy, and how many of all their good flights are a fault or a drift.
    """
    vehicles = []
    for good in combinations(good_flights, good_count):
        for cut in combinations(cut_flights, 2):
            vehicles.append(assess_motor_health([*good, *cut]))
    judged_cut = [assessment for vehicle in vehicles for assessment in vehicle[good_count:]]
    judged_good = [assessment for vehicle in vehicles for assessment in vehicle[:good_count]]
    cut_by_health = Counter(assessment.health for assessment in judged_cut)
    good_by_health = Counter(assessment.health for assessment in judged_good)
    return {
        "good flights": str(good_count),
        "vehicles": str(len(vehicles)),
        "cut: fault": str(cut_by_health[MotorHealth.FAULT]),
        "drift": str(cut_by_health[MotorHealth.DRIFT]),
        "ok": str(cut_by_health[MotorHealth.OK]),
        "motor 1 named": str(sum(assessment.suspect_motor == 1 for assessment in judged_cut)),
        "taken for healthy": str(sum(assessment.is_healthy for assessment in judged_cut)),
        "good: fault or drift": str(
            good_by_health[MotorHealth.FAULT] + good_by_health[MotorHealth.DRIFT]
        ),
    }


@click.command(help=__doc__)
@click.argument("folder", type=click.Path(exists=True, file_okay=False, path_type=Path))
def main(folder: Path) -> None:
    """Prints a row for each log of a folder: the health of the motors, compared with the flights named "good".

    Args:
        folder: folder with logs (``.BIN``) of one vehicle.
    """
    healthy_flights = []
    other_flights = []
    for path in sorted(folder.glob("*.BIN")):
        flight = health_figures(path)
        if "good" in flight.name:
            healthy_flights.append(flight)
        else:
            other_flights.append(flight)
    flights = healthy_flights + other_flights
    # A healthy flight is compared with the other healthy ones. With dates the assessment of a flight is the prior of
    # the next one; without dates each flight is assessed by itself.
    assessments_by_date = assess_motor_health(flights, healthy_flights)
    undated_healthy_flights = [replace(flight, date=None) for flight in healthy_flights]
    undated_other_flights = [replace(flight, date=None) for flight in other_flights]
    assessments = assess_motor_health(
        undated_healthy_flights + undated_other_flights, undated_healthy_flights
    )
    rows = []
    for flight, assessment, by_date in zip(flights, assessments, assessments_by_date, strict=True):
        rows.append(health_row(flight, assessment, by_date))
    print_table("Each flight against the good ones", rows)
    first_flight = min(healthy_flights, key=lambda flight: flight.start_time)
    pair_rows = [
        pair_row(flight, healthy_flights) for flight in flights if flight is not first_flight
    ]
    print_table("Each flight beside one earlier good flight", pair_rows)
    cut_flights = [flight for flight in other_flights if flight.name.split("_")[1] in FOUND_CUTS]
    rows_without_baseline = [
        row_without_baseline(good_count, healthy_flights, cut_flights)
        for good_count in range(1, len(healthy_flights) + 1)
    ]
    print_table("Good flights, then two cut ones, without a baseline", rows_without_baseline)


if __name__ == "__main__":
    main()
