#!/usr/bin/env python
"""Compares estimated physical parameters with the truth of simulated flights, and estimates those of a Crazyflie.

"simulated" flies each vehicle in each wind with each steering. Sampling rate and autopilot take turns, and three
flights in ten have another thrust curve, lag, inertia and battery. The tables have the shares of estimates by status,
and how often their 90 % intervals hold the truth ("inside").

"crazyflie" prints the estimates from the log of a real Crazyflie 2.1.

"steady" compares the steady torque of a motor by three models: DEM alone, DEM with its simulation-error fit, and the
gray-box model.

Progress and flights that are refused go to standard error.

Usage: tools/validation/physical.py simulated|crazyflie|steady [--seed N] [--every K] [--jobs N]
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

from mavdem import Flight, Settings, learn
from mavdem.confidence import coverage_factor
from mavdem.dem import LinearModel
from mavdem.dem.record import Record
from mavdem.errors import NotLearnable, Unreadable
from mavdem.experiments.paper.flights import DATA_FOLDER, simulated_flight
from mavdem.facts.identifiability import Status
from mavdem.files import load_adjacent_toml
from mavdem.ingest.vocabulary import IN_AIR, ON_GROUND
from mavdem.plant import NotIdentifiable, Physical, WindTorque, physical
from mavdem.plant.wind_torque import estimate_wind_torque
from sitl_scenarios.files import load as load_scenario
from sitl_scenarios.motion import Motion
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.simulation import fly
from sitl_scenarios.truth import truth

Array = NDArray[np.float64]

PARAMETERS = ("effect", "damping", "lag")
"""Names of the physical parameters that are compared with the truth."""

STATUSES = {Status.REPORTED: "", Status.BIASED: " (biased)", Status.NOT_IDENTIFIABLE: " (no)"}
"""Mark of an estimate in a table, by its status."""

CONDITIONS = load_adjacent_toml(__file__, "physical.toml")
"""Winds, steering and moments of the simulated flights."""

SAMPLE_RATES = (50.0, 100.0, 200.0)
"""Rates of the simulated streams, Hz."""

CRAZYFLIE_RATE = 200.0
"""Rate to which the Crazyflie's log is resampled, Hz."""

AXES = {"roll": ("gyro.x", [-1.0, -1.0, 1.0, 1.0]), "pitch": ("gyro.y", [-1.0, 1.0, 1.0, -1.0])}
"""Column of the Crazyflie's gyro, and the sign of each motor's torque, by axis."""


STEADY_SCENARIOS = (
    "iris_identification",
    "iris_identification_wind",
    "iris_gusts",
    "hover_blower",
    "iris_von_karman",
    "iris_dryden",
)
"""Simulated flights of which the steady torque is compared: steered in calm air and in wind, then hovering in wind."""


class Case(NamedTuple):
    """A simulated flight of the bank: what flies, in which wind, and how."""

    vehicle: str
    """Model of the vehicle."""

    wind: str
    """Name of the wind."""

    steering: str
    """Name of the steering."""

    rate: float
    """Rate of the stream, Hz."""

    autopilot: str
    """"px4" or "ardupilot"."""

    varied: dict[str, float]
    """Values of the vehicle that are not the published ones."""

    seed: int
    """Seed of wind and noise."""


def cases(seed: int, every: int) -> Iterator[Case]:
    """Yields the flights of the bank: every vehicle in every wind with every steering, or a part of them.

    Args:
        seed: seed by which the part, and what varies, is drawn.
        every: number of flights of which one is drawn; 1 for all.
    """
    rng = default_rng(seed)
    vehicles_and_winds = list(product(TABLES["scales"]["wind"], CONDITIONS["winds"]))
    count = len(vehicles_and_winds) // every
    # Steering, and rates with autopilots, take turns: a part of the bank has as many of each.
    chosen = rng.permutation(len(vehicles_and_winds))[:count]
    flights_by_steering = [
        [(*vehicles_and_winds[number], steering) for number in chosen]
        for steering in CONDITIONS["steering"]
    ]
    flights = [flight for turn in zip(*flights_by_steering, strict=True) for flight in turn]
    combinations = product(SAMPLE_RATES, ("px4", "ardupilot"))
    streams = cycle(combinations)
    for (vehicle, wind, steering), (rate, autopilot) in zip(flights, streams, strict=False):
        values = varied(rng)
        values = values if rng.random() < 0.3 else {}
        seed = int(rng.integers(1_000_000))
        yield Case(vehicle, wind, steering, rate, autopilot, values, seed)


def varied(rng: Generator) -> dict[str, float]:
    """Draws a thrust curve, rotor lags, inertia and a battery's sag that are not the published ones."""
    lag_up = rng.uniform(0.015, 0.06)
    return {
        "quadratic_thrust": rng.uniform(0.3, 1.0),
        "lag_up": lag_up,
        "lag_down": lag_up * rng.uniform(1.0, 2.0),
        "inertia_scale": rng.uniform(0.7, 1.6),
        "battery_sag": rng.uniform(0.0, 0.15),
    }


def scenario(case: Case) -> Scenario:
    """Returns the scenario of a case."""
    values = {
        "duration": 60.0,
        "seed": case.seed,
        "height": 1.5 if case.wind == "jet" else 8.0,
        "vehicle": {"model": case.vehicle, **case.varied},
        "wind": CONDITIONS["winds"][case.wind],
        "moments": CONDITIONS["moments"].get(case.wind, []),
        "stream": {"rate": case.rate, "autopilot": case.autopilot},
    }
    return scenario_from_values(values | {"excitation": CONDITIONS["steering"][case.steering]})


def true_values(motion: Motion, flown_scenario: Scenario, part: Flight) -> Values:
    """Returns the true physical parameters of roll in a part of a simulated flight.

    The true effect of a motor depends on the speed of its rotor, so it is averaged over the part alone.

    Args:
        motion: the simulated motion.
        flown_scenario: the scenario that was flown.
        part: the part of the flight.

    Returns:
        "effect" of each motor (r,) at the trim of the part, "damping", 1/s, "lag", s, the mean of speeding up and
        slowing down, and "wind", the wind torque at the samples of the part (T,), rad/s².
    """
    is_in_part = (motion.time >= part.time[0]) & (motion.time <= part.time[-1])
    is_airborne = is_in_part & (motion.landed_state == IN_AIR)
    # ``truth`` averages the effects over all samples whose landed state is "in air". Samples outside the part are
    # therefore declared to be on the ground.
    landed_state = np.where(is_airborne, IN_AIR, ON_GROUND).astype(np.uint8)
    truths = truth(flown_scenario, replace(motion, landed_state=landed_state))
    wind_torque = np.interp(part.time, motion.time, truths["roll_disturbance"])
    damping = -float(truths["roll_A"][1, 1])
    lag = truths["lag"][0]
    return {"effect": truths["roll_effect"], "damping": damping, "lag": lag, "wind": wind_torque}


def estimate_with_half_width(plant: Physical, name: str) -> tuple[float, float]:
    """Returns an estimate and the half width of its 90 % interval, NaN where it is not identifiable.

    Args:
        plant: physical parameters.
        name: "effect" for the mean of all motors, "damping" or "lag".
    """
    if name == "effect":
        return plant.mean_effect()
    half_width = float(getattr(plant.interval(), name))
    return float(getattr(plant, name)), half_width


def flight_and_windows(flight: Flight) -> dict[int | None, Flight]:
    """Returns the whole flight by the key ``None``, and its windows of 7 s by their numbers."""
    size = round(7.0 / flight.dt)
    numbers = range(len(flight) // size)
    windows = {number: flight[number * size :][:size] for number in numbers}
    return {None: flight} | windows


def evaluate_case(case: Case) -> list[Values]:
    """Returns a row for each window of a simulated flight, and for the whole: errors of estimates and intervals."""
    try:
        flown_scenario = scenario(case)
        flight = simulated_flight(flown_scenario)
        motion = fly(flown_scenario)
    except (NotLearnable, Unreadable) as reason:
        click.echo(f"{case}: refused: {reason}", err=True)
        return []
    rows = []
    for window, part in flight_and_windows(flight).items():
        plant = physical(part)
        if isinstance(plant, NotIdentifiable):
            click.echo(f"{case}: refused: {plant.reason}", err=True)
            continue
        truths = true_values(motion, flown_scenario, part)
        row = {"steering": case.steering, "rate": case.rate, "seed": case.seed}
        row["of"] = "flights" if window is None else "7 s"
        for name in PARAMETERS:
            value, half_width = estimate_with_half_width(plant, name)
            true_value = float(np.mean(abs(truths[name])))
            error = value / true_value - 1
            row |= {f"{name} status": plant.status[name], f"{name} error": error}
            row[f"{name} inside"] = abs(value - true_value) <= half_width
        if window is None:
            torque = estimate_wind_torque(plant, Record.from_flights(part))
            row |= wind_torque_results(torque, truths["wind"])
        rows.append(row)
    return rows


def wind_torque_results(torque: WindTorque, true_torque: Array) -> Values:
    """Returns whether the intervals of the wind torque hold the truth, and how much of it the band holds.

    Args:
        torque: estimated wind torque; nothing is returned where it is not resolved.
        true_torque: true wind torque at the same samples (T,), rad/s².
    """
    if not torque.resolved:
        return {}
    half_width = coverage_factor() * torque.scale_error * torque.sd
    in_band = abs(torque.torque - true_torque) <= torque.band
    return {
        "standard deviation inside": abs(torque.sd - true_torque.std()) <= half_width,
        "mean inside": abs(torque.mean - true_torque.mean()) <= torque.mean_band,
        "course inside": np.mean(in_band),
    }


def status_statistics(rows: Any, name: str) -> pd.Series:
    """Returns the share of each status of a parameter, and how often its intervals hold the truth.

    Args:
        rows: rows of flights or windows, as :func:`evaluate_case` returns them.
        name: name of the parameter.
    """
    status = rows[f"{name} status"]
    line = {"number": len(rows)} | {kind: percent_true(status == kind) for kind in STATUSES}
    reported = rows[status == Status.REPORTED]
    line["inside"] = percent_true(reported[f"{name} inside"])
    worst = max(reported[f"{name} error"], key=abs, default=np.nan)
    line["worst"] = f"{worst:+.0%}"
    biased = rows[status == Status.BIASED]
    line["inside, where biased"] = percent_true(biased[f"{name} inside"])
    return pd.Series(line)


def simulated(seed: int, part: int, jobs: int) -> None:
    """Prints the shares that are reported, and how often intervals hold the truth, by steering and status."""
    rows = evaluate_flights(evaluate_case, cases(seed, part), jobs)
    click.echo(f"{rows['seed'].nunique()} flights, seed {seed}.\n")
    is_slow = rows["rate"] == 50
    slow = rows[is_slow].assign(steering="all, 50 Hz")
    quick = rows[~is_slow].assign(steering="all, 100 Hz or more")
    grouped = pd.concat([slow, rows, quick]).groupby(["steering", "of"], sort=False)
    for name in PARAMETERS:
        lines = grouped.apply(status_statistics, name)
        print_table(f"**{name.capitalize()}**", lines.reset_index())
    insides = ["standard deviation inside", "mean inside", "course inside"]
    table = []
    for status in STATUSES:
        rows_of_status = rows[rows["effect status"] == status]
        resolved = rows_of_status.dropna(subset=insides)
        shares = {inside: percent_true(resolved[inside]) for inside in insides}
        table.append({"effect": status, "flights": len(resolved), **shares})
    print_table("**Wind torque**, where it is resolved", table)


def row_of_estimates(flight: Flight) -> Values:
    """Returns a row of estimates with their intervals, marked unless they are reported, where no truth is known."""
    plant = physical(flight)
    if isinstance(plant, NotIdentifiable):
        return {"effect": plant.reason.advised}
    row = {}
    for name in PARAMETERS:
        value, half_width = estimate_with_half_width(plant, name)
        if np.isfinite(half_width):
            row[name] = f"{value:.3g} ± {half_width:.2g}{STATUSES[plant.status[name]]}"
        else:
            row[name] = "not identifiable"
    return row


def crazyflie_log(path: Path) -> NDArray[Any]:
    """Returns the rows of a Crazyflie's log, version 2, of one kind of event; ``time`` in µs."""
    content = path.read_bytes()
    variables = list(re.finditer(rb"([\w.]+)\((\w)\)\0", content[:1000]))
    named = [(each[1].decode(), f"<{each[2].decode()}") for each in variables]
    row = np.dtype([("event", "<u2"), ("time", "<u8"), *named])
    begin = variables[-1].end()
    # A checksum, shorter than any row, ends the file.
    count = (len(content) - begin) // row.itemsize
    return np.frombuffer(content, row, count, begin)


def crazyflie(axis: str) -> list[Values]:
    """Returns the row of one axis of a Crazyflie 2.1 with roll and pitch excited, really flown."""
    rows = crazyflie_log(DATA_FOLDER / "real/crazyflie/roll_pitch_excitation.usdlog")
    gyro, directions = AXES[axis]
    # Roll and pitch are excited from 56 to 89 s.
    time = np.arange(56.0 * CRAZYFLIE_RATE, 89.0 * CRAZYFLIE_RATE) / CRAZYFLIE_RATE
    seconds = rows["time"] / 1e6
    motors = [np.interp(time, seconds, rows[f"motor.m{motor}"] / 65535) for motor in range(1, 5)]
    rate = np.interp(time, seconds, np.radians(rows[gyro]))
    flight = Flight(
        time,
        np.stack(motors, 1),
        rate[:, None],
        dt=1 / CRAZYFLIE_RATE,
        effect_directions=np.array(directions),
    )
    return [{"axis": axis} | row_of_estimates(flight)]


def steady_torque(model: LinearModel) -> float:
    """Returns the steady angular acceleration by one unit of one motor, rad/s², of a linear model of angle and rate.

    With angle and rate held at zero, the hidden states settle, and what they and the motors then do to the rate is the
    torque. It compares with the control effectiveness of the gray-box model. It is the mean magnitude over the motors.

    Args:
        model: states are angle and rate, then hidden ones.
    """
    hidden = slice(2, None)
    settled = -np.linalg.solve(model.A[hidden, hidden], model.B[hidden])
    torque = model.B[1] + model.A[1, hidden] @ settled
    return float(abs(torque).mean())


def steady_torques(name: str) -> Values:
    """Returns a row of the steady torque per motor of a simulated flight, rad/s² per µs: truth, and by each model.

    Args:
        name: of the scenario.
    """
    flown_scenario = load_scenario(name)
    flight = simulated_flight(flown_scenario)
    truths = true_values(fly(flown_scenario), flown_scenario, flight)
    by_dem = learn(flight, Settings(horizon=None)).model
    by_simulation = learn(flight, Settings()).model
    plant = physical(flight)
    by_gray_box = np.nan if isinstance(plant, NotIdentifiable) else plant.mean_effect()[0]
    figures = {
        "truth": float(abs(truths["effect"]).mean()),
        "DEM": steady_torque(by_dem),
        "simulation fit": steady_torque(by_simulation),
        "gray-box": by_gray_box,
    }
    return {"flight": name} | {title: f"{value:.3f}" for title, value in figures.items()}


TITLE = (
    "**Crazyflie** (effect in rad/s² per unit of one motor's command; published: 318–403 for roll)"
)
"""Title of the Crazyflie's table; the published effect follows from thrust curves and inertia."""


@command(__doc__, seed=0, every=1)
@click.argument("which", type=click.Choice(["simulated", "crazyflie", "steady"]))
def main(which: str, seed: int, every: int, jobs: int) -> None:
    if which == "steady":
        title = "**Steady torque of one motor** (rad/s² per µs, mean over the motors)"
        print_table(title, [steady_torques(name) for name in STEADY_SCENARIOS])
        return
    if which == "crazyflie":
        print_table(TITLE, evaluate_flights(crazyflie, AXES, jobs))
    else:
        simulated(seed, every, jobs)


if __name__ == "__main__":
    main()
