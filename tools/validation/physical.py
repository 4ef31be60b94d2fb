#!/usr/bin/env python
"""Physical parameters compared with the truth of simulated flights, and of a Crazyflie.

"Inside" is the share of 90 % intervals that hold the truth. Progress and what is refused go to standard error.

The simulated flights are of each vehicle in each wind with each steering; rate and autopilot take turns, and three
flights in ten have another thrust curve, lag, inertia and battery.

Usage: tools/validation/physical.py simulated|crazyflie [--seed N] [--every K] [--jobs N]
"""

import re
from collections.abc import Iterator
from dataclasses import replace
from itertools import cycle, product
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np
import pandas as pd
from flights import (
    TABLES,
    Values,
    command,
    evaluate_flights,
    percent_true,
    print_table,
    scenario_from_values,
)
from numpy.random import Generator, default_rng
from numpy.typing import NDArray

from mavdem import Flight
from mavdem.confidence import coverage_factor
from mavdem.dem.record import Record
from mavdem.errors import NotLearnable, Unreadable
from mavdem.experiments.paper.flights import DATA_FOLDER, simulated_flight
from mavdem.facts.identifiability import Status
from mavdem.files import load_adjacent_toml
from mavdem.ingest.vocabulary import IN_AIR
from mavdem.plant import NotIdentifiable, Physical, WindTorque, physical
from mavdem.plant.wind_torque import estimate_wind_torque
from sitl_scenarios.motion import Motion
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.simulation import fly
from sitl_scenarios.truth import truth

Array = NDArray[np.float64]

PARAMETERS = ("effect", "damping", "lag")
# and how it marks an estimate
STATUSES = {Status.REPORTED: "", Status.BIASED: " (biased)", Status.NOT_IDENTIFIABLE: " (no)"}
FLOWN = load_adjacent_toml(__file__, "physical.toml")
RATES = (50.0, 100.0, 200.0)  # Hz
*_, RATE = RATES  # of the Crazyflie
# Column of the gyro, and the sign of each motor's torque
AXES = {"roll": ("gyro.x", [-1.0, -1.0, 1.0, 1.0]), "pitch": ("gyro.y", [-1.0, 1.0, 1.0, -1.0])}


class Case(NamedTuple):
    vehicle: str
    wind: str
    steering: str
    rate: float
    autopilot: str
    varied: dict[str, float]
    seed: int


def cases(seed: int, every: int) -> Iterator[Case]:
    """Every vehicle in every wind with every steering, or one of ``every`` so many drawn by seed."""
    rng = default_rng(seed)
    places = list(product(TABLES["scales"]["wind"], FLOWN["winds"]))
    kept = len(places) // every
    # Steering, and rates with autopilots, take turns: a part of the bank has as many of each.
    chosen = rng.permutation(len(places))[:kept]
    drawn = [[(*places[number], steering) for number in chosen] for steering in FLOWN["steering"]]
    turns = [case for some in zip(*drawn, strict=True) for case in some]
    combinations = product(RATES, ("px4", "ardupilot"))
    streams = cycle(combinations)
    for (vehicle, air, steering), (rate, autopilot) in zip(turns, streams, strict=False):
        other = varied(rng)
        other = other if rng.random() < 0.3 else {}
        seed = int(rng.integers(1_000_000))
        yield Case(vehicle, air, steering, rate, autopilot, other, seed)


def varied(rng: Generator) -> dict[str, float]:
    """Thrust curve, lag, inertia and battery that are not the published ones."""
    up = rng.uniform(0.015, 0.06)
    return {
        "quadratic_thrust": rng.uniform(0.3, 1.0),
        "lag_up": up,
        "lag_down": up * rng.uniform(1.0, 2.0),
        "inertia_scale": rng.uniform(0.7, 1.6),
        "battery_sag": rng.uniform(0.0, 0.15),
    }


def scenario(case: Case) -> Scenario:
    """The flight of a case."""
    values = {
        "duration": 60.0,
        "seed": case.seed,
        "height": 1.5 if case.wind == "jet" else 8.0,
        "vehicle": {"model": case.vehicle, **case.varied},
        "wind": FLOWN["winds"][case.wind],
        "moments": FLOWN["moments"].get(case.wind, []),
        "stream": {"rate": case.rate, "autopilot": case.autopilot},
    }
    return scenario_from_values(values | {"excitation": FLOWN["steering"][case.steering]})


def truth_of(motion: Motion, of: Scenario, part: Flight) -> Values:
    """Each motor's effect (r,) at the trim of ``part``, damping (1/s) and lag (s), the mean of up and down."""
    within = (motion.time >= part.time[0]) & (motion.time <= part.time[-1])
    airborne = within & (motion.landed_state == IN_AIR)
    landed = np.where(airborne, IN_AIR, 1).astype(np.uint8)
    truths = truth(of, replace(motion, landed_state=landed))
    turning = np.interp(part.time, motion.time, truths["roll_disturbance"])
    damping = -float(truths["roll_A"][1, 1])
    lag = truths["lag"][0]
    return {"effect": truths["roll_effect"], "damping": damping, "lag": lag, "wind": turning}


def estimate_of(plant: Physical, name: str) -> tuple[float, float]:
    """Of the mean effect, damping or lag, and the half width of its interval, NaN where it is not identifiable."""
    if name == "effect":
        return plant.mean_effect()
    half_width = float(getattr(plant.interval(), name))
    return float(getattr(plant, name)), half_width


def parts_of(flight: Flight) -> dict[int | None, Flight]:
    """The whole flight, and its windows of 7 s."""
    size = round(7.0 / flight.dt)
    numbers = range(len(flight) // size)
    windows = {number: flight[number * size :][:size] for number in numbers}
    return {None: flight} | windows


def judged(case: Case) -> list[Values]:
    """A row of each window of a flight, and of the whole: estimates and the wind torque beside the truth."""
    try:
        of = scenario(case)
        flight = simulated_flight(of)
        motion = fly(of)
    except (NotLearnable, Unreadable) as reason:
        click.echo(f"{case}: refused: {reason}", err=True)
        return []
    rows = []
    for window, part in parts_of(flight).items():
        plant = physical(part)
        if isinstance(plant, NotIdentifiable):
            click.echo(f"{case}: refused: {plant.reason}", err=True)
            continue
        truths = truth_of(motion, of, part)
        row = {"steering": case.steering, "rate": case.rate, "seed": case.seed}
        row["of"] = "flights" if window is None else "7 s"
        for name in PARAMETERS:
            value, half = estimate_of(plant, name)
            true = float(np.mean(abs(truths[name])))
            error = value / true - 1
            row |= {f"{name} status": plant.status[name], f"{name} error": error}
            row[f"{name} inside"] = abs(value - true) <= half
        if window is None:
            torque = estimate_wind_torque(plant, Record.from_flights(part))
            row |= wind_of(torque, truths["wind"])
        rows.append(row)
    return rows


def wind_of(torque: WindTorque, true: Array) -> Values:
    """Of the wind torque, where it is resolved: how much of it intervals and band hold."""
    if not torque.resolved:
        return {}
    half = coverage_factor() * torque.scale_error * torque.sd
    in_band = abs(torque.torque - true) <= torque.band
    return {
        "standard deviation inside": abs(torque.sd - true.std()) <= half,
        "mean inside": abs(torque.mean - true.mean()) <= torque.mean_band,
        "course inside": np.mean(in_band),
    }


def line_of(some: Any, name: str) -> pd.Series:
    """Of a parameter: share that is reported, and how often intervals hold the truth."""
    status = some[f"{name} status"]
    line = {"number": len(some)} | {kind: percent_true(status == kind) for kind in STATUSES}
    reported = some[status == Status.REPORTED]
    line["inside"] = percent_true(reported[f"{name} inside"])
    worst = max(reported[f"{name} error"], key=abs, default=np.nan)
    line["worst"] = f"{worst:+.0%}"
    biased = some[status == Status.BIASED]
    line["inside, where biased"] = percent_true(biased[f"{name} inside"])
    return pd.Series(line)


def simulated(seed: int, part: int, jobs: int) -> None:
    """Share that is reported, and how often intervals hold the truth, by steering; and of the wind torque."""
    rows = evaluate_flights(judged, cases(seed, part), jobs)
    click.echo(f"{rows['seed'].nunique()} flights, seed {seed}.\n")
    is_slow = rows["rate"] == 50
    slow = rows[is_slow].assign(steering="all, 50 Hz")
    quick = rows[~is_slow].assign(steering="all, 100 Hz or more")
    grouped = pd.concat([slow, rows, quick]).groupby(["steering", "of"], sort=False)
    for name in PARAMETERS:
        lines = grouped.apply(line_of, name)
        print_table(f"**{name.capitalize()}**", lines.reset_index())
    insides = ["standard deviation inside", "mean inside", "course inside"]
    table = []
    for status in STATUSES:
        alike = rows[rows["effect status"] == status]
        some = alike.dropna(subset=insides)
        shares = {inside: percent_true(some[inside]) for inside in insides}
        table.append({"effect": status, "flights": len(some), **shares})
    print_table("**Wind torque**, where it is resolved", table)


def row_of(flight: Flight) -> Values:
    """A row of a table without a truth: estimates with their intervals, marked unless they are reported."""
    plant = physical(flight)
    if isinstance(plant, NotIdentifiable):
        return {"effect": plant.reason.advised}
    row = {}
    for name in PARAMETERS:
        value, half = estimate_of(plant, name)
        row[name] = f"{value:.3g} ± {half:.2g}{STATUSES[plant.status[name]]}"
    return row


def usdlog(path: Path) -> NDArray[Any]:
    """Rows of a Crazyflie's log, version 2, of one kind of event; ``time`` in µs, other columns as logged."""
    content = path.read_bytes()
    variables = list(re.finditer(rb"([\w.]+)\((\w)\)\0", content[:1000]))
    named = [(each[1].decode(), f"<{each[2].decode()}") for each in variables]
    row = np.dtype([("event", "<u2"), ("time", "<u8"), *named])
    begin = variables[-1].end()
    # A checksum, shorter than any row, ends the file.
    count = (len(content) - begin) // row.itemsize
    return np.frombuffer(content, row, count, begin)


def crazyflie(axis: str) -> list[Values]:
    """Rows of an axis of a Crazyflie 2.1 with roll and pitch excited, really flown."""
    rows = usdlog(DATA_FOLDER / "real/crazyflie/roll_pitch_excitation.usdlog")
    gyro, directions = AXES[axis]
    time = np.arange(56.0 * RATE, 89.0 * RATE) / RATE  # where it is excited
    columns = [rows[f"motor.m{motor}"] / 65535 for motor in range(1, 5)]
    given = [*columns, np.radians(rows[gyro])]
    seconds = rows["time"] / 1e6
    *motors, turning = (np.interp(time, seconds, column) for column in given)
    inputs = np.stack(motors, 1)
    effects = np.array(directions)
    flight = Flight(time, inputs, turning[:, None], dt=1 / RATE, effect_directions=effects)
    return [{"axis": axis} | row_of(flight)]


# By published thrust curves and inertia.
TITLE = (
    "**Crazyflie** (effect in rad/s² per unit of one motor's command; published: 318–403 for roll)"
)


@command(__doc__, seed=0, every=1)
@click.argument("which", type=click.Choice(["simulated", "crazyflie"]))
def main(which: str, seed: int, every: int, jobs: int) -> None:
    if which == "crazyflie":
        print_table(TITLE, evaluate_flights(crazyflie, AXES, jobs))
    else:
        simulated(seed, every, jobs)


if __name__ == "__main__":
    main()
