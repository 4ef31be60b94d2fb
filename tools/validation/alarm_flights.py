"""Simulated flights for ``alarms.py``: sound ones in gusts with steps and take-offs, and some where something breaks.

Simulated directly, without MAVLink. What a flight is follows from its kind and number; even numbers are the half that
the alarm's parameters were chosen on, odd ones the other.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sitl_scenarios.dynamics import MAX_PULSE, MIN_PULSE
from sitl_scenarios.files import scenario_of
from sitl_scenarios.motion import IN_AIR
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.simulation import CYCLES, fly

RATE = 50.0  # Hz of the samples that are kept
SOUND, HOVER, WIND, CHIPPED, SHIFTED = "sound", "weak in hover", "weak in wind", "chipped", "shifted load"
KINDS = {SOUND: 72, HOVER: 100, WIND: 100, CHIPPED: 40, SHIFTED: 120}
"""Flights of each kind; the sound ones of ten minutes, which makes twelve hours with about ten of them settled."""
SETTLES = 5.0  # s in the air before a flight counts as settled, as ``alignment.phases`` has it


@dataclass(frozen=True, eq=False)
class SimulatedFlight:
    """Motors (N, 4) as shares of their range at ``time`` (N,), s; ``settled`` (N,); when what broke of which motor."""

    kind: str
    number: int
    time: NDArray[np.float64]
    motors: NDArray[np.float64]
    settled: NDArray[np.bool_]
    breaks: float = np.inf  # s; never where nothing does
    motor: int = 0  # from 1; 0 where none is at fault


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


def read(kind: str, number: int, folder: Path) -> SimulatedFlight:
    """A flight that was ``flown``."""
    with np.load(flown(kind, number, folder)) as file:
        motors = np.asarray(file["motors"], dtype=np.float64)
        breaks, motor = float(file["breaks"]), int(file["motor"])
        return SimulatedFlight(kind, number, file["time"], motors, file["settled"], breaks, motor)
