#!/usr/bin/env python
"""What the verdict on a vehicle's motors is worth on simulated flights; prints a row for each kind of flight.

Flown are healthy vehicles, weak motors, chipped propellers and shifted loads, in wind of 0 to 8 m/s from all sides with
the load within 5 mm: each flight against three healthy ones drawn at random, five times. "Right" is the share of
faults that name the motor.

Usage: tools/validation/propellers.py [--flights 40]
"""

import numpy as np
import pandas as pd
from flights import TABLES, Values, command, drawn, flight_of, rows_of, share, show
from numpy.random import default_rng
from scipy.spatial.transform import Rotation

from mavdem.alignment.drive import MotorGeometry
from mavdem.health.assessment import assess
from mavdem.health.balance import HealthFigures, balance_figures, motor_signatures
from mavdem.ingest.vocabulary import IN_AIR
from sitl_scenarios.dynamics import MAX_PULSE, MIN_PULSE
from sitl_scenarios.simulation import fly

MOTORS = tuple(f"motor {number}" for number in (1, 2, 3, 4))
PLACES = ((1.0, 1.0), (-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0))
QUAD_X = motor_signatures(MotorGeometry((1, 2, 3, 4), (1, 2, 3, 4), PLACES, spins=(1, 1, -1, -1)))
THRUSTS = {f"motor of {percent} % thrust": percent / 100 for percent in (95, 90, 85, 80, 70)}
CHIPPED = "chipped propeller (85 % thrust, 82 % torque)"
SHIFTS = {"load shifted by 10 mm": (7.0, 7.0), "load shifted by 20 mm": (14.0, -14.0)}  # mm
KINDS = ("healthy", *THRUSTS, CHIPPED, *SHIFTS)
DRAWS = 5  # of the healthy flights that one is compared with


def judged(case: tuple[str, int]) -> list[Values]:
    """A row: the balance of a flight of a kind, in conditions of its own, and the motor that is at fault."""
    kind, number = case
    kind_number = KINDS.index(kind)
    rng = default_rng([20, kind_number, number])
    motor = int(rng.integers(1, 5))
    values = drawn(TABLES["propellers"], rng) | {"seed": int(rng.integers(1 << 30))}
    if kind in THRUSTS:
        values["vehicle"] |= {"weak_motor": motor, "weak_thrust": THRUSTS[kind]}
    elif kind == CHIPPED:
        values["propeller"] = {"motor": motor}
    elif kind in SHIFTS:
        forward, right = SHIFTS[kind]
        values["load"]["forward"] += forward
        values["load"]["right"] += right
    motion = fly(flight_of(values))
    # At the autopilots' default rate of 10 Hz, after the climb-out.
    airborne = motion.landed_state == IN_AIR
    climbed = motion.time > motion.time[airborne][0] + 5.0
    rows = np.flatnonzero(airborne & climbed)[::25]
    time = motion.time[rows]
    commands = (motion.outputs[rows] - MIN_PULSE) / (MAX_PULSE - MIN_PULSE)
    turned = Rotation.from_quat(motion.known_attitude[rows], scalar_first=True)
    lean = turned.as_euler("ZYX")[:, :0:-1]
    seconds = float(np.ptp(time))
    balance = balance_figures([(time, commands, lean)], QUAD_X, seconds)
    figures = HealthFigures(f"{number}", MOTORS, QUAD_X, balance)
    return [{"flight": kind, "number": number, "motor": motor, "figures": figures}]


@command(__doc__, flights=40)
def main(flights: int, jobs: int) -> None:
    cases = [(kind, number) for kind in KINDS for number in range(flights)]
    flown = rows_of(judged, cases, jobs)
    healthy = flown[flown["flight"] == "healthy"]["figures"]
    found = []
    for flight in flown.itertuples():
        for draw in range(DRAWS):
            rng = default_rng([flight.number, draw])
            order = rng.permutation(flights)
            others = order[order != flight.number]
            baseline = healthy.iloc[others[:3]].tolist()
            (verdict,) = assess([flight.figures], baseline)
            right = verdict.suspect_motor == flight.motor
            found.append({"flight": flight.flight, "health": verdict.health, "right": right})
    rows = pd.DataFrame(found)
    shares = pd.crosstab(rows["flight"], rows["health"], normalize="index")
    table = shares.map("{:.0%}".format)
    faulty = rows[rows["health"] == "fault"]
    faults = faulty.groupby("flight")["right"]
    table["right"] = faults.agg(share)
    show(f"{flights} flights of each kind", table.reindex(list(KINDS)).reset_index())


if __name__ == "__main__":
    main()
