#!/usr/bin/env python
"""How soon, how rightly and how falsely a motor alarm comes in simulated flights; prints a table.

For each kind of flight and each half: where a motor loses a fifth of its thrust, or a propeller chips, how many were
found within five seconds, how many of those found were named right, and delays; where a load shifts, alarms on a motor;
and the same of sound flights with gusts, steps, sticks and take-offs. The test's parameters were chosen on the half of
even numbers. Flights are simulated without MAVLink, in about forty minutes on two processors,
and kept in a folder; what a flight is follows from its kind and number.

Usage: tools/validation/alarms.py FOLDER [--rate HZ] [--flights N] [--jobs N]
"""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np

from mavdem.health.in_flight import MotorAlarm, MotorWatch
from mavdem.ingest.motors import motor_geometry
from sitl_scenarios.dynamics import MAX_PULSE, MIN_PULSE
from sitl_scenarios.files import scenario_of
from sitl_scenarios.motion import IN_AIR
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.simulation import CYCLES, fly

IN_TIME = 5.0  # s
RATE = 50.0  # Hz of the samples that are kept
SOUND, HOVER, WIND, CHIPPED, SHIFTED = "sound", "weak in hover", "weak in wind", "chipped", "shifted load"
KINDS = {SOUND: 72, HOVER: 100, WIND: 100, CHIPPED: 40, SHIFTED: 120}
"""Flights of each kind; the sound ones of ten minutes, which makes twelve hours with about ten of them settled."""
SETTLES = 5.0  # s in the air before a flight counts as settled, as ``alignment.phases`` has it


def scenario(kind: str, number: int) -> Scenario:
    """The scenario of a flight."""
    draw = np.random.default_rng([list(KINDS).index(kind), number])
    model = str(draw.choice(["iris", "iris", "iris", "ardrone2", "crazyflie"]))
    small = model == "crazyflie"
    vehicle: dict[str, object] = {"model": model, "battery_sag": round(draw.uniform(0.0, 0.12), 3)}
    if draw.random() < 0.5:
        vehicle["quadratic_thrust"] = round(draw.uniform(0.3, 0.9), 2)
    table: dict[str, object] = {
        "seed": number,
        "height": round(draw.uniform(2.0, 8.0), 1),
        "stream": {"autopilot": str(draw.choice(["px4", "ardupilot"]))},
    }
    if kind == SOUND:
        table |= {"duration": 200, "flights": 3}
    else:
        table |= {"duration": 50}
    length = 200.0 if kind == SOUND else 50.0
    direction = round(draw.uniform(0.0, 360.0))
    speed = draw.uniform(1.0, 3.0 if small else 6.0)
    winds = {
        "dryden": [{"kind": "dryden", "speed": round(speed, 1), "direction": direction, "wind_at_20_feet": 7.7}],
        "severe": [{"kind": "von_karman", "speed": round(speed, 1), "direction": direction, "wind_at_20_feet": 15.4}],
        "noise": [{"kind": "gaussian", "sd": round(speed / 4, 2), "s": round(draw.uniform(0.2, 2.0), 2)}],
        "gusts": [
            {"kind": "steady", "speed": round(speed / 2, 1), "direction": direction},
            *(
                {
                    "kind": "gust",
                    "start": round(draw.uniform(10.0, length - 5.0), 1),
                    "speed": round(speed, 1),
                    "direction": round(draw.uniform(0.0, 360.0)),
                    "rise": round(draw.uniform(0.5, 3.0), 1),
                    "hold": round(draw.uniform(0.0, 30.0), 1),
                }
                for _ in range(max(1, round(length / 40)))
            ),
        ],
    }
    calm = kind == HOVER
    if not calm:
        table["wind"] = winds[str(draw.choice(list(winds)))]
        if draw.random() < 0.4:
            sizes = {"iris": 0.03, "ardrone2": 3e-3, "crazyflie": 1.5e-5}
            axes = ("roll", "pitch", "yaw")
            moment = sizes[model]
            table["moments"] = [
                {"axis": axis, "sd": moment / (3 if axis == "yaw" else 1), "s": round(draw.uniform(0.05, 0.5), 2)}
                for axis in axes
            ]
        excitation = {
            "none": None,
            "steps": {
                "kind": "steps",
                "distance": round(draw.uniform(1, 4), 1),
                "period": round(draw.uniform(5, 10), 1),
            },
            "sticks": {"kind": "sticks", "axis": "all", "sd": round(draw.uniform(2, 6), 1), "s": 0.3},
            "doublets": {"kind": "doublets", "axis": str(draw.choice(["roll", "pitch"])), "amplitude": 8.0},
        }[str(draw.choice(["none", "steps", "steps", "sticks", "doublets"]))]
        if excitation is not None:
            table["excitation"] = excitation
    start = round(draw.uniform(24.0, 32.0), 2)
    motor = int(draw.integers(1, 5))
    if kind in (HOVER, WIND):
        vehicle |= {"weak_motor": motor, "weak_from": start, "weak_thrust": 0.8}
    elif kind == CHIPPED:
        table["propeller"] = {"motor": motor, "start": start, "thrust": 0.8, "torque": 0.76}
    elif kind == SHIFTED:
        # By up to a seventh of the arm, whose length differs by model.
        arm = {"iris": 250.0, "ardrone2": 178.0, "crazyflie": 43.0}[model]
        bearing, far = draw.uniform(0.0, 2 * np.pi), draw.uniform(0.05, 0.14) * arm
        table["load"] = {"start": start, "forward": far * float(np.cos(bearing)), "right": far * float(np.sin(bearing))}
    return scenario_of(table | {"vehicle": vehicle})


def flown(kind: str, number: int, folder: Path) -> Path:
    """Flies a flight, where ``folder`` does not hold it yet, into a file there."""
    path = folder / f"{kind.replace(' ', '_')}_{number}.npz"
    if path.exists():
        return path
    flight = scenario(kind, number)
    motion = fly(flight)
    every = round(1 / RATE / CYCLES[flight.stream.autopilot])
    time, air = motion.time[::every], motion.landed_state[::every] == IN_AIR
    since = np.where(air & ~np.concatenate([[False], air[:-1]]), time, -np.inf)
    settled = air & (time >= np.maximum.accumulate(since) + SETTLES)
    motors = (motion.outputs[::every] - MIN_PULSE) / (MAX_PULSE - MIN_PULSE)
    spec = flight.vehicle
    breaks = {CHIPPED: flight.propeller.start, SHIFTED: flight.load.start}.get(kind, spec.weak_from)
    # The first two seconds are before the arming that scenarios count from.
    at = np.inf if kind == SOUND else breaks + 2.0
    motor = 0 if kind in (SOUND, SHIFTED) else spec.weak_motor or flight.propeller.motor
    rough = path.with_suffix(".part.npz")
    np.savez(rough, time=time, motors=motors.astype(np.float32), settled=settled, breaks=at, motor=motor)
    rough.rename(path)
    return path


class Watched(NamedTuple):
    """What a watch said in one flight."""

    kind: str
    number: int
    hours: float  # settled
    breaks: float  # s
    motor: int  # at fault; 0: none
    alarms: tuple[MotorAlarm, ...]


def watched(kind: str, number: int, folder: Path, rate: float) -> Watched:
    """One flight, its motors at ``rate``, Hz."""
    every = round(RATE / rate)
    with np.load(flown(kind, number, folder)) as file:
        time, motors, settled = (file[name][::every] for name in ("time", "motors", "settled"))
        breaks, motor = float(file["breaks"]), int(file["motor"])
    layout = motor_geometry("QUADROTOR", "", {}, (1, 2, 3, 4), 8)
    assert layout is not None
    watch = MotorWatch(layout.names, layout.motors, layout.positions, layout.spins)
    for at in np.flatnonzero(settled):
        watch.take(float(time[at]), motors[at].astype(np.float64), True)
    hours = float(settled.sum() / rate / 3600)
    return Watched(kind, number, hours, breaks, motor, tuple(watch.alarms))


@click.command(help=__doc__)
@click.argument("folder", type=click.Path(path_type=Path, file_okay=False))
@click.option("--rate", default=10.0, show_default=True, help="Hz of the motors' samples, at most 50.")
@click.option("--flights", type=int, help="Of each kind at most; all by default.")
@click.option("--jobs", default=2, show_default=True, help="Processes.")
def main(folder: Path, rate: float, flights: int | None, jobs: int) -> None:
    """Prints the table of the simulated flights in FOLDER, which are flown where they are not there."""
    folder.mkdir(parents=True, exist_ok=True)
    asked = [(kind, number) for kind, count in KINDS.items() for number in range(min(count, flights or count))]
    with ProcessPoolExecutor(jobs) as pool:
        done = list(pool.map(watched, *zip(*asked, strict=True), [folder] * len(asked), [rate] * len(asked)))
    click.echo(f"Motors at {rate:g} Hz; even numbers chose the parameters, odd ones did not.\n")
    click.echo("| flights | half | number | found in 5 s | named right, of found | median delay, s | longest, s |")
    click.echo("|---|---|---|---|---|---|---|")
    for kind in KINDS:
        for half in (0, 1):
            chosen = [one for one in done if one.kind == kind and one.number % 2 == half]
            if kind not in (SOUND, SHIFTED) and chosen:
                click.echo(_faulty(kind, half, chosen))
    click.echo("\n| flights | half | number | hours settled | alarms on a motor | changes in roll and pitch |")
    click.echo("|---|---|---|---|---|---|")
    for kind in (SOUND, SHIFTED):
        for half in (0, 1):
            chosen = [one for one in done if one.kind == kind and one.number % 2 == half]
            alarms = [alarm for one in chosen for alarm in one.alarms]
            named = sum(alarm.motor is not None for alarm in alarms)
            hours = sum(one.hours for one in chosen)
            click.echo(
                f"| {kind} | {_half(half)} | {len(chosen)} | {hours:.2f} | {named} | {len(alarms) - named} |",
            )
    before = sum(alarm.time < one.breaks for one in done for alarm in one.alarms if one.motor)
    click.echo(f"\nAlarms before anything broke, in flights where a motor did: {before}.")


def _faulty(kind: str, half: int, flights: list[Watched]) -> str:
    delays, right = [], 0
    for one in flights:
        first = next((alarm for alarm in one.alarms if alarm.time >= one.breaks), None)
        delays.append(np.inf if first is None else first.time - one.breaks)
        right += first is not None and first.motor == one.motor
    found = int(np.isfinite(delays).sum())
    soon = int((np.array(delays) <= IN_TIME).sum())
    longest = max((delay for delay in delays if np.isfinite(delay)), default=np.nan)
    return (
        f"| {kind} | {_half(half)} | {len(flights)} | {soon} | {right} of {found} | {np.median(delays):.1f} | "
        f"{longest:.1f} |"
    )


def _half(half: int) -> str:
    return "odd" if half else "even"


if __name__ == "__main__":
    main()
