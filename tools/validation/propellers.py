#!/usr/bin/env python
"""What the verdict on a vehicle's motors is worth on simulated flights; prints a line for each kind of flight.

Flown are healthy vehicles, weak motors, chipped propellers and shifted loads, in wind of 0 to 8 m/s from all sides with
the load within 3 mm: each flight against three healthy ones drawn at random, five times.

Usage: tools/validation/propellers.py [--flights 40]
"""

from __future__ import annotations

from collections import Counter

import click
import numpy as np
from scipy.spatial.transform import Rotation

from mavdem.alignment.drive import MotorGeometry
from mavdem.health.assessment import assess
from mavdem.health.balance import HealthFigures, balance_figures, motor_signatures
from mavdem.ingest.vocabulary import IN_AIR
from sitl_scenarios.dynamics import MAX_PULSE, MIN_PULSE
from sitl_scenarios.files import scenario_of
from sitl_scenarios.simulation import fly

MOTORS = (
    "motor 1 (front right)",
    "motor 2 (rear left)",
    "motor 3 (front left)",
    "motor 4 (rear right)",
)
PLACES = ((1.0, 1.0), (-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0))
QUAD_X = motor_signatures(MotorGeometry((1, 2, 3, 4), (1, 2, 3, 4), PLACES, spins=(1, 1, -1, -1)))
VERDICTS = ("ok", "drift", "fault", "unknown")
KINDS: dict[str, dict[str, dict[str, float]]] = {"healthy": {}}
for percent in (95, 90, 85, 80, 70):
    weak = {"weak_motor": 1, "weak_thrust": percent / 100}
    KINDS[f"motor of {percent} % thrust"] = {"vehicle": weak}
KINDS |= {"chipped propeller (85 % thrust, 82 % torque)": {"propeller": {"motor": 1}}}
KINDS |= {"load shifted by 10 mm": {"load": {"forward": 7.0, "right": 7.0}}}
KINDS |= {"load shifted by 20 mm": {"load": {"forward": 14.0, "right": -14.0}}}


def _flown(
    rng: np.random.Generator, change: dict[str, dict[str, float]], number: int
) -> tuple[HealthFigures, int]:
    """A flight of 70 s with the ``change``, in other conditions each time, and the motor that is weak."""
    motor = int(rng.integers(1, 5))
    offset = rng.normal(scale=3.0, size=2)
    table: dict[str, dict[str, float]] = {
        "vehicle": {"battery_sag": rng.uniform(0.0, 0.1)},
        "load": {"forward": offset[0], "right": offset[1]},
    }
    for section, values in change.items():
        for name, value in values.items():
            before = table.setdefault(section, {}).get(name, 0.0)
            table[section][name] = motor if name in ("weak_motor", "motor") else before + value
    ranges = {"speed": (0.0, 8.0), "direction": (0.0, 360.0), "wind_at_20_feet": (5.0, 20.0)}
    wind = {"kind": "dryden", **{name: rng.uniform(*of) for name, of in ranges.items()}}
    flown = {
        "duration": 70.0,
        "height": 10.0,
        "seed": int(rng.integers(1 << 30)),
        **table,
        "wind": [wind],
    }
    motion = fly(scenario_of(flown))
    # At the autopilots' default rate of 10 Hz, after the climb-out.
    airborne = motion.landed_state == IN_AIR
    rows = np.flatnonzero(airborne & (motion.time > motion.time[airborne][0] + 5.0))[::25]
    commands = (motion.outputs[rows] - MIN_PULSE) / (MAX_PULSE - MIN_PULSE)
    lean = Rotation.from_quat(motion.known_attitude[rows], scalar_first=True).as_euler("ZYX")[
        :, :0:-1
    ]
    balance = balance_figures(
        [(motion.time[rows], commands, lean)], QUAD_X, float(np.ptp(motion.time[rows]))
    )
    return HealthFigures(f"{number}", MOTORS, QUAD_X, balance), motor


@click.command(help=__doc__)
@click.option("--flights", "count", default=40, help="Of each kind.")
def main(count: int) -> None:
    rng = np.random.default_rng(20)
    flown = {
        kind: [_flown(rng, change, number) for number in range(count)]
        for kind, change in KINDS.items()
    }
    healthy = flown["healthy"]
    for kind, flights in flown.items():
        verdicts = Counter[str]()
        right = list[bool]()
        for number, (flight, motor) in enumerate(flights):
            for draw in range(5):
                pick = np.random.default_rng([number, draw]).permutation(count)
                baseline = [healthy[i][0] for i in pick if i != number][:3]
                (found,) = assess([flight], baseline)
                verdicts[found.health] += 1
                if found.health == "fault":
                    right.append(found.suspect_motor == motor)
        shares = ", ".join(
            f"{name} {verdicts[name] / (5 * count):.3f}" for name in VERDICTS if verdicts[name]
        )
        print(
            f"{kind:45} {shares}{f'; right motor named in {np.mean(right):.2f} of the faults' if right else ''}"
        )


if __name__ == "__main__":
    main()
