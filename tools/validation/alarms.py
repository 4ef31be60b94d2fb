#!/usr/bin/env python
"""How soon, how rightly and how falsely a motor alarm comes in simulated flights; prints a table.

For each kind of flight and each half: where a motor loses a fifth of its thrust, or a propeller chips, also while
another motor is weak, how many were found within five seconds, how many of those found were named right, and delays;
where a load shifts, alarms on a motor; and the same of sound flights with gusts, steps, sticks and take-offs. The
test's parameters were chosen on the half of even numbers. Flights are simulated without MAVLink, in about forty
minutes on two processors; what a flight is follows from its kind and number.

Usage: tools/validation/alarms.py [--rate HZ of the motors] [--flights N of each kind at most] [--jobs N]
"""

from __future__ import annotations

from functools import partial

import numpy as np
import pandas as pd
from flights import TABLES, Values, command, drawn, flight_of, rows_of, show

from mavdem.alignment.steadiness import strays
from mavdem.health.in_flight import MotorAlarm, MotorWatch
from mavdem.ingest.motors import motor_geometry
from mavdem.ingest.vocabulary import IN_AIR, euler_angles
from sitl_scenarios.dynamics import MAX_PULSE, MIN_PULSE
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
BROKEN = {"thrust": 0.8, "torque": 0.76}
ARMS = {"iris": 250.0, "ardrone2": 178.0, "crazyflie": 43.0}  # mm
SHIFT = (0.05, 0.14)  # of the arm


def scenario(kind: str, number: int) -> Scenario:
    """The flight of a kind and number."""
    rng = np.random.default_rng([list(KINDS).index(kind), number])
    length, flights = (200.0, 3) if kind == SOUND else (50.0, 1)
    values = drawn(TABLES["alarms"], rng) | {"seed": number, "duration": length, "flights": flights}
    if kind != HOVER:
        values |= drawn(TABLES["alarms_moved"], rng)
    start = rng.uniform(24.0, 32.0)
    second = start + rng.uniform(6.0, 14.0)
    motor, other = (rng.permutation(4)[:2] + 1).tolist()
    if kind in (HOVER, WIND, SECOND):
        values["vehicle"] |= {"weak_motor": motor, "weak_from": start, "weak_thrust": 0.8}
    if kind == CHIPPED:
        values["propeller"] = BROKEN | {"motor": motor, "start": start}
    elif kind == SECOND:
        values["propeller"] = BROKEN | {"motor": other, "start": second}
    elif kind == SHIFTED:
        far = rng.uniform(*SHIFT) * ARMS[values["vehicle"]["model"]]
        bearing = rng.uniform(0.0, 2 * np.pi)
        ahead = {"forward": far * np.cos(bearing), "right": far * np.sin(bearing)}
        values["load"] = {"start": start, **ahead}
    return flight_of(values)


def watched(flight: Scenario, rate: float) -> tuple[float, list[MotorAlarm]]:
    """Hours settled, and what a watch says in a flight, its motors at ``rate``, Hz."""
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
    return float(settled.sum() / rate / 3600), watch.alarms


def judged(case: tuple[str, int], rate: float) -> list[Values]:
    """A row: what of one flight the tables count."""
    kind, number = case
    flight = scenario(kind, number)
    hours, alarms = watched(flight, rate)
    vehicle = flight.vehicle
    propeller = flight.propeller
    begin = propeller.start if propeller.motor else max(vehicle.weak_from, flight.load.start)
    # The first two seconds are before the arming that scenarios count from.
    breaks = np.inf if kind == SOUND else begin + 2.0
    first = next((alarm for alarm in alarms if alarm.time >= breaks), None)
    row: Values = {"flights": kind, "half": ("even", "odd")[number % 2], "hours": hours}
    row["delay"] = np.inf if first is None else first.time - breaks
    row["right"] = first is not None and first.motor == (propeller.motor or vehicle.weak_motor)
    row["on a motor"] = sum(alarm.motor is not None for alarm in alarms)
    row["others"] = len(alarms) - row["on a motor"]
    row["early"] = sum(alarm.time < breaks for alarm in alarms)
    return [row]


def line_of(flights: pd.DataFrame) -> pd.Series:
    """A row: what was found where a motor broke, and the alarms on sound motors."""
    delays = flights["delay"]
    known = delays[np.isfinite(delays)]
    line: Values = {"number": len(flights), "hours settled": f"{flights['hours'].sum():.2f}"}
    line |= {"found in 5 s": (delays <= 5.0).sum(), "longest, s": f"{known.max():.1f}"}
    line["named right, of found"] = f"{flights['right'].sum()} of {len(known)}"
    line["median delay, s"] = f"{delays.median():.1f}"
    line["alarms on a motor"] = flights["on a motor"].sum()
    line["changes in roll and pitch"] = flights["others"].sum()
    return pd.Series(line)


@command(__doc__, rate=10.0, flights=120)
def main(rate: float, flights: int, jobs: int) -> None:
    asked = [
        (kind, number) for kind, count in KINDS.items() for number in range(min(count, flights))
    ]
    rows = rows_of(partial(judged, rate=rate), asked, jobs)
    is_sound = rows["flights"].isin([SOUND, SHIFTED])
    lines = rows.groupby(["flights", "half"], sort=False).apply(line_of)
    title = f"Motors at {rate:g} Hz; even numbers chose the parameters, odd ones did not."
    early = rows[~is_sound & (rows["flights"] != SECOND)]["early"].sum()
    under = f"Alarms before anything broke, in flights where a motor did: {early}."
    show(title, lines.reset_index(), under)


if __name__ == "__main__":
    main()
