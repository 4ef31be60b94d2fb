#!/usr/bin/env python
"""Health of the motors in recorded flights of one vehicle with a propeller cut shorter; prints a row for each flight.

FOLDER has the logs (.BIN). Those with "good" in their names have whole propellers and are the healthy flights that each
is compared with; a good one is compared with the others.

Usage: tools/validation/propellers.py FOLDER
"""

from pathlib import Path

import click
import numpy as np
from flights import Values, print_table

from mavdem.assessment.condition import measure_condition
from mavdem.dataset.signals import Signals
from mavdem.ingest import read_log
from mavdem.motors.balance import balance_of_steady_flight
from mavdem.motors.health import HealthAssessment, assess_motor_health
from mavdem.motors.healthy_flights import HealthFigures
from mavdem.motors.signatures import motor_signatures


def health_figures(path: Path) -> HealthFigures:
    """Measures in a log what the health of its motors is judged by: their balance in steady flight, and their effort.

    Args:
        path: a log that has motor outputs and the battery's voltage.
    """
    signals = Signals(read_log(path).vehicles[0], inputs="motors")
    condition = measure_condition(signals)
    assert signals.motors is not None, "the log has no motor outputs"
    assert condition.battery is not None, "the log has no battery voltage"
    layout = signals.motors.geometry
    return HealthFigures(
        name=path.stem,
        motors=layout.names,
        signatures=motor_signatures(layout),
        balance=balance_of_steady_flight(signals),
        # The healthy flights are chosen by their names, not by their dates.
        date=None,
        collective=condition.collective,
        voltage=condition.battery.voltage_mean,
    )


def health_row(flight: HealthFigures, assessment: HealthAssessment) -> Values:
    """Returns the row of a flight: health, probabilities, and the suspect motor.

    Args:
        flight: balance and effort of the motors in the flight.
        assessment: health of its motors, compared with healthy flights.

    Returns:
        Texts by column. "motor" says by how many percent more than in healthy flights the suspect motor works, with the
        90 % interval; it is empty without a suspect.
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
    }


@click.command(help=__doc__)
@click.argument("folder", type=click.Path(exists=True, file_okay=False, path_type=Path))
def main(folder: Path) -> None:
    """Prints a row for each log of a folder: the health of the motors, compared with the flights named "good".

    Args:
        folder: folder with logs (``.BIN``) of one vehicle.
    """
    flights = [health_figures(path) for path in sorted(folder.glob("*.BIN"))]
    healthy_flights = [flight for flight in flights if "good" in flight.name]
    other_flights = [flight for flight in flights if "good" not in flight.name]
    flights = healthy_flights + other_flights
    # A healthy flight is compared with the other healthy ones.
    assessments = assess_motor_health(flights, healthy_flights)
    rows = []
    for flight, assessment in zip(flights, assessments, strict=True):
        rows.append(health_row(flight, assessment))
    print_table("Each flight against the good ones", rows)


if __name__ == "__main__":
    main()
