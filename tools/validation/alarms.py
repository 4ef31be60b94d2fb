#!/usr/bin/env python
"""How soon, how rightly and how falsely a motor alarm comes in simulated flights; prints a table.

For each kind of flight and each half: where a motor loses a fifth of its thrust, or a propeller chips, also while
another motor is weak, how many were found within five seconds, how many of those found were named right, and delays;
where a load shifts, alarms on a motor; and the same of sound flights with gusts, steps, sticks and take-offs. The
test's parameters were chosen on the half of even numbers. Flights are simulated without MAVLink, in about forty
minutes on two processors; what a flight is follows from its kind and number.

Usage: tools/validation/alarms.py [--rate HZ] [--flights N] [--jobs N]
"""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from typing import NamedTuple

import click
import numpy as np

from mavdem.alignment.steadiness import strays
from mavdem.health.in_flight import MotorAlarm, MotorWatch
from mavdem.ingest.motors import motor_geometry
from mavdem.ingest.vocabulary import IN_AIR, euler_angles
from sitl_scenarios.dynamics import MAX_PULSE, MIN_PULSE
from sitl_scenarios.files import scenario_of
from sitl_scenarios.gains import cycle_of
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.simulation import fly

SOUND = "sound"
HOVER = "weak in hover"
WIND = "weak in wind"
CHIPPED = "chipped"
SHIFTED = "shifted load"
SECOND = "chipped while another is weak"
KINDS = {SOUND: 72, HOVER: 100, WIND: 100, CHIPPED: 40, SHIFTED: 120, SECOND: 40}
"""Flights of each kind; the sound ones of ten minutes, which makes twelve hours with about ten of them settled."""


def scenario(kind: str, number: int) -> Scenario:
    draw = np.random.default_rng([list(KINDS).index(kind), number])

    def some(low: float, high: float, digits: int | None = 1) -> float:
        return round(draw.uniform(low, high), digits)

    model = str(draw.choice(["iris", "iris", "iris", "ardrone2", "crazyflie"]))
    vehicle: dict[str, object] = {"model": model, "battery_sag": some(0.0, 0.12, 3)}
    if draw.random() < 0.5:
        vehicle["quadratic_thrust"] = some(0.3, 0.9, 2)
    length, flights = (200.0, 3) if kind == SOUND else (50.0, 1)
    table: dict[str, object] = {
        "seed": number,
        "height": some(2.0, 8.0),
        "duration": length,
        "flights": flights,
    }
    table["stream"] = {"autopilot": str(draw.choice(["px4", "ardupilot"]))}
    direction = some(0.0, 360.0, None)
    speed = draw.uniform(1.0, 3.0 if model == "crazyflie" else 6.0)
    mean: dict[str, object] = {"speed": round(speed, 1), "direction": direction}
    winds: dict[str, list[dict[str, object]]] = {
        "dryden": [{"kind": "dryden", **mean, "wind_at_20_feet": 7.7}],
        "severe": [{"kind": "von_karman", **mean, "wind_at_20_feet": 15.4}],
        "noise": [{"kind": "gaussian", "sd": round(speed / 4, 2), "s": some(0.2, 2.0, 2)}],
        "gusts": [{"kind": "steady", "speed": round(speed / 2, 1), "direction": direction}],
    }
    for _ in range(max(1, round(length / 40))):
        gust = {"kind": "gust", "start": some(10.0, length - 5.0), "speed": round(speed, 1)}
        gust |= {
            "direction": some(0.0, 360.0, None),
            "rise": some(0.5, 3.0),
            "hold": some(0.0, 30.0),
        }
        winds["gusts"].append(gust)
    if kind != HOVER:
        table["wind"] = winds[str(draw.choice(list(winds)))]
        if draw.random() < 0.4:
            moment = {"iris": 0.03, "ardrone2": 3e-3, "crazyflie": 1.5e-5}[model]
            sds = {"roll": moment, "pitch": moment, "yaw": moment / 3}
            table["moments"] = [
                {"axis": axis, "sd": sd, "s": some(0.05, 0.5, 2)} for axis, sd in sds.items()
            ]
        excitations: dict[str, dict[str, object] | None] = {
            "none": None,
            "steps": {"kind": "steps", "distance": some(1, 4), "period": some(5, 10)},
            "sticks": {"kind": "sticks", "axis": "all", "sd": some(2, 6), "s": 0.3},
            "doublets": {
                "kind": "doublets",
                "axis": str(draw.choice(["roll", "pitch"])),
                "amplitude": 8.0,
            },
        }
        table["excitation"] = excitations[
            str(draw.choice(["none", "steps", "steps", "sticks", "doublets"]))
        ]
    start = some(24.0, 32.0, 2)
    motor = int(draw.integers(1, 5))
    if kind in (HOVER, WIND, SECOND):
        vehicle |= {"weak_motor": motor, "weak_from": start, "weak_thrust": 0.8}
    if kind == SECOND:
        motor = 1 + (motor + int(draw.integers(0, 3))) % 4
        start = round(start + draw.uniform(6.0, 14.0), 2)
    if kind in (CHIPPED, SECOND):
        table["propeller"] = {"motor": motor, "start": start, "thrust": 0.8, "torque": 0.76}
    elif kind == SHIFTED:
        # By up to a seventh of the arm, whose length differs by model.
        arm = {"iris": 250.0, "ardrone2": 178.0, "crazyflie": 43.0}[model]
        bearing = draw.uniform(0.0, 2 * np.pi)
        far = draw.uniform(0.05, 0.14) * arm
        table["load"] = {
            "start": start,
            "forward": far * float(np.cos(bearing)),
            "right": far * float(np.sin(bearing)),
        }
    return scenario_of(table | {"vehicle": vehicle})


class Watched(NamedTuple):
    hours: float  # settled
    breaks: float  # s
    motor: int  # at fault; 0: none
    alarms: tuple[MotorAlarm, ...]


def watched(kind: str, number: int, rate: float) -> Watched:
    """What a watch says in one flight, its motors at ``rate``, Hz."""
    flight = scenario(kind, number)
    motion = fly(flight)
    every = round(1 / rate / cycle_of(flight))
    time = motion.time[::every]
    air = motion.landed_state[::every] == IN_AIR
    since = np.where(air & ~np.concatenate([[False], air[:-1]]), time, -np.inf)
    settled = air & (time >= np.maximum.accumulate(since) + 5.0)  # as ``alignment.phases`` has it
    motors = (motion.outputs[::every] - MIN_PULSE) / (MAX_PULSE - MIN_PULSE)
    layout = motor_geometry("QUADROTOR", "", {}, (1, 2, 3, 4), 8)
    assert layout is not None
    watch = MotorWatch(layout)
    angles = euler_angles(motion.known_attitude[::every])
    heading = np.unwrap(angles[2])
    asked = motion.attitude_setpoint[::every, :2]
    heading[strays(np.column_stack(angles[:2]), asked)] = np.nan
    for at in np.flatnonzero(settled):
        watch.take(float(time[at]), motors[at], float(heading[at]))
    spec = flight.vehicle
    hours = float(settled.sum() / rate / 3600)
    begin = (
        flight.propeller.start if flight.propeller.motor else max(spec.weak_from, flight.load.start)
    )
    # The first two seconds are before the arming that scenarios count from.
    breaks = np.inf if kind == SOUND else begin + 2.0
    motor = flight.propeller.motor or spec.weak_motor
    return Watched(hours, breaks, motor, tuple(watch.alarms))


@click.command(help=__doc__)
@click.option("--rate", default=10.0, show_default=True, help="Hz of the motors' samples.")
@click.option("--flights", type=int, help="Of each kind at most; all by default.")
@click.option("--jobs", default=2, show_default=True, help="Processes.")
def main(rate: float, flights: int | None, jobs: int) -> None:
    asked = [
        (kind, number)
        for kind, count in KINDS.items()
        for number in range(min(count, flights or count))
    ]
    with ProcessPoolExecutor(jobs) as pool:
        done = list(pool.map(watched, *zip(*asked, strict=True), [rate] * len(asked)))
    halves: dict[tuple[str, str], list[Watched]] = {
        (kind, half): [] for kind in KINDS for half in ("even", "odd")
    }
    for (kind, number), one in zip(asked, done, strict=True):
        halves[kind, ("even", "odd")[number % 2]].append(one)
    print(f"Motors at {rate:g} Hz; even numbers chose the parameters, odd ones did not.\n")
    print(
        "| flights | half | number | found in 5 s | named right, of found | median delay, s | longest, s |"
    )
    print("|---|---|---|---|---|---|---|")
    for (kind, half), chosen in halves.items():
        if kind not in (SOUND, SHIFTED) and chosen:
            print(f"| {kind} | {half} | {len(chosen)} | {_found(chosen)} |")
    print(
        "\n| flights | half | number | hours settled | alarms on a motor | changes in roll and pitch |"
    )
    print("|---|---|---|---|---|---|")
    for (kind, half), chosen in halves.items():
        if kind in (SOUND, SHIFTED):
            named = [alarm.motor is not None for one in chosen for alarm in one.alarms]
            hours = sum(one.hours for one in chosen)
            print(
                f"| {kind} | {half} | {len(chosen)} | {hours:.2f} | {sum(named)} | {len(named) - sum(named)} |"
            )
    sound = [
        one for (kind, _), one in zip(asked, done, strict=True) if one.motor and kind != SECOND
    ]
    before = sum(alarm.time < one.breaks for one in sound for alarm in one.alarms)
    print(f"\nAlarms before anything broke, in flights where a motor did: {before}.")


def _found(flights: list[Watched]) -> str:
    firsts = [
        next((alarm for alarm in one.alarms if alarm.time >= one.breaks), None) for one in flights
    ]
    pairs = list(zip(flights, firsts, strict=True))
    delays = np.array(
        [np.inf if first is None else first.time - one.breaks for one, first in pairs]
    )
    right = sum(first is not None and first.motor == one.motor for one, first in pairs)
    found = delays[np.isfinite(delays)]
    soon = int((delays <= 5.0).sum())
    return f"{soon} | {right} of {len(found)} | {np.median(delays):.1f} | {found.max() if len(found) else np.nan:.1f}"


if __name__ == "__main__":
    main()
