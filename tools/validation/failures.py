#!/usr/bin/env python
"""What is said of flights in which motors failed, simulated to the ground; prints a table, and a line for each flight.

Quadrotors X and plus are flown by ``sitl_scenarios`` and recorded as MAVLink, hexarotors and octorotors by the rigid
body below, with the places and directions of ``mavdem.ingest.frames.json``. One motor fails or two do at once, and keep
none of their thrust or 30 to 70 %. A flight is over half a second after it hit the ground; of those that land by
themselves nothing must be said, and another of the kind is flown. Said right is an ending that names a motor that
failed; wrong one that names another, an ending of a flight that was not lost, and none of one that was. What a flight
is follows from its number. It takes about four minutes on two processors.

Usage: tools/validation/failures.py [--flights N] [--jobs N]
"""

from __future__ import annotations

from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from math import cos, hypot
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import click
import numpy as np

from mavdem.alignment.signals import Signals
from mavdem.assessment.ending import ending_of
from mavdem.assessment.motion import motion_events
from mavdem.facts import Fact
from mavdem.ingest import Telemetry, read_log
from mavdem.ingest.motors import MOTOR_COUNTS, MotorGeometry, motor_geometry
from mavdem.ingest.vocabulary import ARDUPILOT, attitude_target, heartbeat_fields, quaternion
from mavdem.paper.runner import write_log
from sitl_scenarios.dynamics import RotorFrame, euler, mix, turned
from sitl_scenarios.files import scenario_of
from sitl_scenarios.mavlink.transmitter import rows_of_motion
from sitl_scenarios.motion import Motion
from sitl_scenarios.scenario import Scenario, VehicleSpec
from sitl_scenarios.simulation import Simulation
from sitl_scenarios.vehicles import GRAVITY, airframe

QUADS = 40  # Of the first sixty; then hexarotors and octorotors in turn
LOST_SPEED = 3.0  # m/s at which a flight that was lost hits the ground, at least; autopilots land at 1 and less
RATES = (10.0, 50.0)
FRAMES = {"HEXAROTOR": (13, 2), "OCTOROTOR": (14, 3)}
"""MAV_TYPE and FRAME_CLASS of the vehicles with more rotors; FRAME_TYPE 0 is plus and 1 X."""


ANGLES_AND_RATES = ("roll", "pitch", "yaw", "rollspeed", "pitchspeed", "yawspeed")


class Failure(NamedTuple):
    """One flight: what failed when, s from boot, what its telemetry is, and whether it was lost."""

    what: str
    motors: tuple[int, ...]
    telemetry: Telemetry
    lost: bool


def failure(number: int, attempt: int = 0) -> Failure:
    """Returns the flight of that number, or another of the kind."""
    draw = np.random.default_rng([41, number, attempt])
    left = 0.0 if draw.random() < 0.5 else round(draw.uniform(0.3, 0.7), 2)
    rate = RATES[number % 2]
    start = round(draw.uniform(20.0, 24.0), 2)
    several = 2 if draw.random() < 0.4 else 1
    if number < QUADS:
        motors = tuple((1 + draw.choice(4, several, replace=False)).tolist())
        return _quad(draw, motors, left, rate, start)
    vehicle = list(FRAMES)[number // 2 % 2]
    count = MOTOR_COUNTS[vehicle]
    motors = tuple((1 + draw.choice(count, several, replace=False)).tolist())
    return _many(draw, vehicle, motors, left, rate, start)


def _quad(
    draw: np.random.Generator, motors: tuple[int, ...], left: float, rate: float, start: float
) -> Failure:
    frame = str(draw.choice(["x", "plus"]))
    model = str(draw.choice(["iris", "iris", "ardrone2"]))
    kept = max(left, 1e-3)
    begins = round(start - 2.0, 2)  # scenarios count from arming
    vehicle = {"model": model, "frame": frame, "weak_motor": motors[0], "weak_from": begins}
    table = {
        "seed": int(draw.integers(1 << 30)),
        "duration": 50.0,
        "height": round(draw.uniform(8.0, 30.0), 1),
        "vehicle": vehicle | {"weak_thrust": kept, "quadratic_thrust": 0.6},
        "stream": {
            "autopilot": str(draw.choice(["px4", "ardupilot"])),
            "rate": rate,
            "rates": {"ATTITUDE_TARGET": rate, "LOCAL_POSITION_NED": rate},
        },
        "wind": [{"kind": "dryden", "speed": round(draw.uniform(0.0, 5.0), 1)}],
    }
    if len(motors) > 1:
        table["propeller"] = {"motor": motors[1], "start": begins, "thrust": kept, "torque": kept}
    if draw.random() < 0.4:
        table["excitation"] = {"kind": "steps", "distance": 2.0, "period": 6.0}
    flight = scenario_of(table)
    motion, lost = _to_the_ground(flight, start)
    what = f"quad {frame} {flight.stream.autopilot} {model}"
    with TemporaryDirectory() as folder:
        write_log(path := Path(folder) / "flight.tlog", flight, motion)
        return Failure(what, motors, read_log(path).vehicles[0], lost)


def _to_the_ground(flight: Scenario, start: float) -> tuple[Motion, bool]:
    """The flight until half a second after it hit the ground, and whether it did."""
    simulation = Simulation(flight)
    second = round(1 / simulation.cycle)
    pieces = [simulation.advance(second)]
    while not simulation.finished:
        try:
            pieces.append(simulation.advance(second))
        except ValueError:  # it turns faster than anything that flies
            break
    columns = vars(pieces[0])
    motion = Motion(
        **{name: np.concatenate([getattr(piece, name) for piece in pieces]) for name in columns}
    )
    sinking = np.maximum.reduce([motion.velocity[:, 2], 0 * motion.time])
    stands = (motion.time > start) & (motion.position[:, 2] > -0.05)
    hit = int(np.argmax(stands)) if stands.any() else len(motion) - 1
    lost = not stands.any() or sinking[max(hit - second // 10, 0) : hit + 1].max() > LOST_SPEED
    end = hit + second // 2 if lost else len(motion)
    return rows_of_motion(motion, slice(0, end)), lost


def _many(
    draw: np.random.Generator,
    vehicle: str,
    motors: tuple[int, ...],
    left: float,
    rate: float,
    start: float,
) -> Failure:
    kind, frame_class = FRAMES[vehicle]
    frame_type = int(draw.integers(2))
    parameters = {"FRAME_CLASS": float(frame_class), "FRAME_TYPE": float(frame_type)}
    count = MOTOR_COUNTS[vehicle]
    parameters |= {f"SERVO{n}_FUNCTION": 32.0 + n for n in range(1, count + 1)}
    layout = motor_geometry(vehicle, "ARDUPILOTMEGA", parameters, range(1, count + 1), 8)
    assert layout is not None
    kept = np.ones(count)
    kept[[motor - 1 for motor in motors]] = left
    hover = draw.uniform(0.5, 0.65)
    rows, lost = _flown(layout, kept, start, hover, draw)
    step = round(1 / rate / STEP)
    time = rows[::step, 0]
    height, climb = rows[::step, 7:9].T
    outputs = np.round(1000 + 1000 * rows[::step, 9:])
    none = np.zeros(len(time))
    beats = time[:: round(rate)]
    motion = rows[::step, 1:7].T
    fields = {
        "ATTITUDE": dict(zip(ANGLES_AND_RATES, motion, strict=True)),
        "ATTITUDE_TARGET": attitude_target(q=quaternion(none, none, none)),
        "SERVO_OUTPUT_RAW": {"port": none}
        | {f"servo{n + 1}_raw": one for n, one in enumerate(outputs.T)},
        "LOCAL_POSITION_NED": dict.fromkeys(("x", "y", "vx", "vy"), none)
        | {"z": -height, "vz": -climb},
    }
    messages = {
        name: {"time": time, "boot": np.zeros(len(time), np.int64), **columns}
        for name, columns in fields.items()
    }
    armed = heartbeat_fields(kind, ARDUPILOT, np.ones(len(beats)))
    messages["HEARTBEAT"] = {"time": beats, "boot": np.zeros(len(beats), np.int64), **armed}
    telemetry = Telemetry(1, 1, vehicle, "ARDUPILOTMEGA", messages, parameters)
    return Failure(f"{vehicle.lower()} {('plus', 'x')[frame_type]}", motors, telemetry, lost)


BODY = airframe(VehicleSpec(model="iris"))
"""Its mass, inertia, length of arms and lag are those of all vehicles with more rotors."""
STEP = 0.0025
"""s. The drag is 1 m/s² at 3 m/s; the commands idle and stop at these."""
IDLE = 0.15
STOP = 0.95


def _flown(
    layout: MotorGeometry, kept: np.ndarray, start: float, hover: float, draw: np.random.Generator
) -> tuple[np.ndarray, bool]:
    """Rows of time, angles, rates, height, climb and commands; and whether the flight was lost."""
    arm = hypot(*BODY.arm)
    forward, right = arm * np.array(layout.positions).T
    spins = np.array(layout.spins)
    mixer = np.column_stack([-right / arm, forward / arm, spins])
    rotors = RotorFrame(tuple(forward), tuple(right), *map(tuple, mixer.T))
    arms = np.column_stack([-right, forward, 0.02 * spins])
    count = len(spins)
    full = BODY.mass * GRAVITY / count / hover**2
    slope = 2 * full * hover  # N per unit of a command, in hover
    authority = slope * (arms * mixer).sum(axis=0) / BODY.inertia
    top = draw.uniform(10.0, 25.0)
    attitude = (1.0, 0.0, 0.0, 0.0)
    rates = np.zeros(3)
    velocity = np.zeros(3)
    height = 0.0
    actual = np.zeros(count)
    trim = np.zeros(3)
    push = 0.0
    rows = []
    for number in range(round((start + 15.0) / STEP)):
        time = STEP * number
        angles = np.array(euler(attitude))
        wanted = np.clip(min(top, 2.0 * (time - 2.0)) - height, -1.0, 2.0)
        slow = wanted + velocity[2]
        push = float(np.clip(push + 0.3 * slow * STEP, -0.3, 0.3)) if height > 0 else 0.0
        asked = np.array([20.0, 20.0, 5.0]) * (-np.array([6.0, 6.0, 1.0]) * angles - rates)
        trim = np.clip(trim + STEP * asked * (height > 0), -20, 20)
        thrust = (hover + push + 0.2 * slow) / max(cos(angles[0]) * cos(angles[1]), 0.5)
        demands = *((asked + trim) / authority), thrust
        commands = np.array(mix(rotors, demands, STOP, IDLE)) if time > 1.0 else np.zeros(count)
        rows.append([time, *angles, *rates, height, -velocity[2], *commands])
        actual += (commands - actual) * STEP / BODY.lag[0]
        lift = full * actual**2 * (kept if time >= start else 1.0)
        if height <= 0 and lift.sum() < BODY.mass * GRAVITY:
            if time > start:
                break
            continue
        noise = draw.normal(0.0, 1.0, 3) * [2.0, 2.0, 0.5]
        moment = lift @ arms - np.cross(rates, np.multiply(BODY.inertia, rates))
        rates = rates + STEP * (moment / BODY.inertia + noise - 0.5 * rates)
        w, x, y, z = turned(attitude, tuple(rates * STEP / 2))
        size = float(np.linalg.norm([w, x, y, z]))
        attitude = w, x, y, z = w / size, x / size, y / size, z / size
        upright = np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
        acceleration = -upright * lift.sum() / BODY.mass - velocity * np.linalg.norm(velocity) / 9
        velocity = velocity + STEP * (acceleration + [0.0, 0.0, GRAVITY])
        height = max(height - STEP * float(velocity[2]), 0.0)
        if height == 0 and velocity[2] > 0:
            if time > start:
                rows += [[time + STEP, *angles, 0, 0, 0, 0, 0, *commands]] * round(0.5 / STEP)
                break
            velocity = np.zeros(3)
    made = np.array(rows)
    made[:, 0] = STEP * np.arange(len(made))
    return made, bool(velocity[2] > LOST_SPEED)


def judged(number: int) -> list[tuple[str, str, str]]:
    """Returns what flights were, up to the first that was lost, what was said of each, and how right that is."""
    found = list[tuple[str, str, str]]()
    lost = False
    while not lost:
        flown = failure(number, len(found))
        lost = flown.lost
        signals = Signals(flown.telemetry, inputs="motors")
        ending = ending_of(signals, motion_events(signals))
        failed = {f"motor {motor}" for motor in flown.motors}
        what = f"{flown.what}: {', '.join(sorted(failed))}"
        found.append((what, "" if ending is None else str(ending), _verdict(ending, failed, lost)))
    return found


def _verdict(ending: Fact | None, failed: set[str], lost: bool) -> str:
    if not lost:
        return "flew on, nothing said" if ending is None else "wrong: flew on"
    if ending is None:
        return "wrong: no ending"
    if not ending.subject:
        return "none named"
    is_right = any(ending.subject.startswith(name) for name in failed)
    return "right" if is_right else "wrong: another motor"


@click.command(help=__doc__)
@click.option("--flights", default=60, show_default=True, help="How many that are lost.")
@click.option("--jobs", default=2, show_default=True, help="Processes.")
def main(flights: int, jobs: int) -> None:
    with ProcessPoolExecutor(jobs) as pool:
        results = list(pool.map(judged, range(flights)))
    for number, flown in enumerate(results):
        for result in flown:
            print(number, *result, sep=" | ")
    verdicts = Counter(verdict for flown in results for _, _, verdict in flown)
    for verdict, count in verdicts.most_common():
        print(f"{verdict}: {count}")


if __name__ == "__main__":
    main()
