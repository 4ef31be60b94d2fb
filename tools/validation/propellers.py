#!/usr/bin/env python
"""What the verdict on a vehicle's motors is worth: on recorded flights with a cut propeller, by chance, simulated.

recorded: each flight of FOLDER against the good ones, and each good one against the other good ones.
chance: how often healthy flights are called otherwise, if they scatter as the prior says.
simulated: healthy flights, weak motors, chipped propellers and shifted loads in wind from all sides.

Usage: tools/validation/propellers.py [FOLDER] [--vehicles 400] [--flights 40]
"""

from __future__ import annotations

from collections import Counter
from datetime import UTC, datetime, timedelta
from pathlib import Path

import click
import numpy as np
from scipy.spatial.transform import Rotation

from mavdem.alignment.read import choose_vehicle
from mavdem.alignment.signals import Signals
from mavdem.condition import condition_of
from mavdem.dem.engine.linalg import Array
from mavdem.health.assessment import EFFORT_SCATTER, assess
from mavdem.health.balance import (
    LEAN_EFFECT,
    LEAN_EFFECT_SCATTER,
    SCATTER,
    SCATTER_FREEDOM,
    BalanceFigures,
    HealthFigures,
    balance_figures,
    balance_of_signals,
    motor_signatures,
)
from mavdem.ingest import read_log
from sitl_scenarios.dynamics import MAX_PULSE, MIN_PULSE
from sitl_scenarios.files import scenario_of
from sitl_scenarios.motion import IN_AIR
from sitl_scenarios.simulation import fly

MOTORS = ("motor 1 (front right)", "motor 2 (rear left)", "motor 3 (front left)", "motor 4 (rear right)")
QUAD_X = motor_signatures(4, [(1, 1), (-1, -1), (1, -1), (-1, 1)], [1, 1, -1, -1])
VERDICTS = ("ok", "drift", "fault", "unknown")


@click.command(help=__doc__)
@click.argument("folder", default="../shared/data/real/propeller", type=click.Path(path_type=Path))
@click.option("--vehicles", default=400, help="Made-up vehicles for the rate of false alarms.")
@click.option("--flights", default=40, help="Simulated flights of each kind.")
def main(folder: Path, vehicles: int, flights: int) -> None:
    recorded(folder)
    for healthy in (2, 3, 6):
        by_chance(healthy, vehicles)
    simulated(flights)


def recorded_flights(folder: Path) -> list[HealthFigures]:
    found = []
    for path in sorted(folder.glob("*.BIN")):
        telemetry = choose_vehicle(read_log(path).vehicles)
        signals = Signals(telemetry, inputs="motors")
        condition, motors = condition_of(signals), signals.motors
        if motors is None or condition.hover is None:
            continue
        layout, battery = motors.layout, condition.battery
        signatures = motor_signatures(len(layout.motors), layout.positions, layout.spins)
        voltage, balance = None if battery is None else battery.voltage_mean, balance_of_signals(signals)
        found.append(HealthFigures(path.stem, layout.names, signatures, balance, None, condition.collective, voltage))
    return found


def recorded(folder: Path) -> None:
    flights = recorded_flights(folder)
    if not flights:
        print(f"There are no flights in {folder}.")
        return
    good = [flight for flight in flights if "good" in flight.name]
    verdicts = assess(flights, good)
    print(f"\nRecorded: {len(flights)} flights, each alone, against {len(good)} good ones (a good one: the others)")
    print(f"{'flight':20} {'health':8} {'fault':>6} {'change':>6} motor  harder, %")
    for flight, found in zip(flights, verdicts, strict=True):
        each = (found.fault_probability, found.change_probability)
        probabilities = " ".join("     -" if one is None else f"{one:6.3f}" for one in each)
        harder = "" if found.harder is None else "{:.0f} ({:.0f} to {:.0f})".format(*found.harder)
        print(f"{flight.name:20} {found.health:8} {probabilities} {found.suspect_motor or '-':>5}  {harder}")


def by_chance(healthy: int, vehicles: int) -> None:
    """False alarms of vehicles whose flights scatter as the prior says, the first flight after the healthy ones."""
    rng = np.random.default_rng(healthy)
    first, later = Counter[str](), Counter[str]()
    for _ in range(vehicles):
        freedom = SCATTER_FREEDOM
        scatter = SCATTER * np.sqrt(freedom / rng.chisquare(freedom, 3))
        spread = EFFORT_SCATTER * np.sqrt(freedom / rng.chisquare(freedom))
        effect = rng.normal(scale=LEAN_EFFECT)
        baseline = [_made_up(rng, scatter, effect, spread, day) for day in range(healthy)]
        found = assess([_made_up(rng, scatter, effect, spread, 10 + day) for day in range(5)], baseline)
        first[found[0].health] += 1
        later.update(one.health for one in found[1:])
    print(f"\nBy chance, {vehicles} vehicles with {healthy} healthy flights, shares of other healthy flights:")
    print(f"  the next flight: {_shares(first)}; the four after it: {_shares(later)}")


def _made_up(rng: np.random.Generator, scatter: Array, effect: Array, spread: float, day: int) -> HealthFigures:
    lean = rng.normal(scale=0.05, size=2)
    # What differs from flight to flight is half real, half by manoeuvres.
    own = effect + rng.normal(scale=LEAN_EFFECT_SCATTER / np.sqrt(2), size=(3, 2))
    mean = rng.normal(scale=np.hypot(scatter, 0.003)) + own @ lean
    seen = own + rng.normal(scale=np.hypot(LEAN_EFFECT_SCATTER / np.sqrt(2), 0.15), size=(3, 2))
    balance = BalanceFigures(mean, np.full(3, 0.003), lean, seen, np.full((3, 2), 0.15), 60.0)
    when = datetime(2026, 1, 1, tzinfo=UTC) + timedelta(days=day)
    collective = 0.5 * np.exp(rng.normal(scale=spread))
    return HealthFigures(str(day), MOTORS, QUAD_X, balance, when, float(collective), 1.0)


def _shares(counts: Counter[str]) -> str:
    return ", ".join(f"{name} {counts[name] / counts.total():.3f}" for name in VERDICTS if counts[name])


KINDS: dict[str, dict[str, dict[str, float]]] = {"healthy": {}}
for percent in (95, 90, 85, 80, 70):
    weak = {"weak_motor": 1, "weak_thrust": percent / 100}
    KINDS[f"motor of {percent} % thrust"] = {"vehicle": weak}
KINDS |= {"chipped propeller (85 % thrust, 82 % torque)": {"propeller": {"motor": 1}}}
KINDS |= {"load shifted by 10 mm": {"load": {"forward": 7.0, "right": 7.0}}}
KINDS |= {"load shifted by 20 mm": {"load": {"forward": 14.0, "right": -14.0}}}


def simulated(count: int) -> None:
    """Each kind of flight against three healthy ones, all in other winds, batteries and places of the load."""
    rng = np.random.default_rng(20)
    flown = {kind: [_flown(rng, change, number) for number in range(count)] for kind, change in KINDS.items()}
    healthy = flown["healthy"]
    print(f"\nSimulated (Iris, wind of 0 to 8 m/s from all sides, load within 3 mm): {count} flights of each kind,")
    print("each against 3 healthy ones drawn at random, five times")
    for kind, flights in flown.items():
        verdicts, right = Counter[str](), list[bool]()
        for number, (flight, motor) in enumerate(flights):
            for draw in range(5):
                pick = np.random.default_rng([number, draw]).permutation(count)
                baseline = [healthy[i][0] for i in pick if i != number][:3]
                (found,) = assess([flight], baseline)
                verdicts[found.health] += 1
                if found.health == "fault":
                    right.append(found.suspect_motor == motor)
        named = f"; right motor named in {np.mean(right):.2f} of the faults" if right else ""
        print(f"  {kind:45} {_shares(verdicts)}{named}")


def _flown(rng: np.random.Generator, change: dict[str, dict[str, float]], number: int) -> tuple[HealthFigures, int]:
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
    flown = {"duration": 70.0, "height": 10.0, "seed": int(rng.integers(1 << 30)), **table, "wind": [wind]}
    motion = fly(scenario_of(flown))
    # At the autopilots' default rate of 10 Hz, after the climb-out.
    airborne = motion.landed_state == IN_AIR
    rows = np.flatnonzero(airborne & (motion.time > motion.time[airborne][0] + 5.0))[::25]
    commands = (motion.outputs[rows] - MIN_PULSE) / (MAX_PULSE - MIN_PULSE)
    lean = Rotation.from_quat(motion.known_attitude[rows], scalar_first=True).as_euler("ZYX")[:, :0:-1]
    balance = balance_figures([(motion.time[rows], commands, lean)], QUAD_X, float(np.ptp(motion.time[rows])))
    return HealthFigures(f"{number}", MOTORS, QUAD_X, balance), motor


if __name__ == "__main__":
    main()
