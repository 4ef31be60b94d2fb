#!/usr/bin/env python
"""Compares estimated physical parameters with the truth of simulated flights, and estimates a Crazyflie's parameters.

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

VARIED_SHARE = 0.3
"""Share of the simulated flights whose vehicle is not the published one: a choice."""

WINDOW_SECONDS = 7.0
"""Length of the windows whose parameters are estimated by themselves, s: the paper's 700 samples at 100 Hz."""

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
    """Model of the vehicle, such as "iris"."""

    wind: str
    """Name of the wind, a key of ``CONDITIONS["winds"]``."""

    steering: str
    """Name of the steering, a key of ``CONDITIONS["steering"]``: how the pilot or the autopilot excites the vehicle."""

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

    Yields:
        The flights: pairs of vehicle and wind in random order, each with every steering in turn.
    """
    rng = default_rng(seed)
    vehicles_and_winds = list(product(TABLES["scales"]["wind"], CONDITIONS["winds"]))
    count = len(vehicles_and_winds) // every
    # Steering, and rates with autopilots, take turns: a part of the bank has as many of each.
    chosen_rows = rng.permutation(len(vehicles_and_winds))[:count]
    flights_by_steering = [
        [(*vehicles_and_winds[number], steering) for number in chosen_rows]
        for steering in CONDITIONS["steering"]
    ]
    flights = [flight for turn in zip(*flights_by_steering, strict=True) for flight in turn]
    combinations = product(SAMPLE_RATES, ("px4", "ardupilot"))
    streams = cycle(combinations)
    for (vehicle, wind, steering), (rate, autopilot) in zip(flights, streams, strict=False):
        # Values are drawn for every flight, so that the other random numbers do not depend on their use.
        drawn_values = draw_vehicle_values(rng)
        is_varied = rng.random() < VARIED_SHARE
        case_seed = int(rng.integers(1_000_000))
        values = drawn_values if is_varied else {}
        yield Case(vehicle, wind, steering, rate, autopilot, values, case_seed)


def draw_vehicle_values(rng: Generator) -> dict[str, float]:
    """Draws a thrust curve, rotor lags (s), an inertia (relative) and a battery's sag, other than the published ones.

    The ranges are a choice, and cover multirotors from racing quadrotors to slow, large ones.

    Args:
        rng: generator of random numbers.

    Returns:
        Values by name: share of the thrust that is quadratic in the command, time constants of speeding up and slowing
        down, s, moment of inertia relative to the published one, and share of the voltage that is lost over the flight.
    """
    lag_up = rng.uniform(0.015, 0.06)
    return {
        "quadratic_thrust": rng.uniform(0.3, 1.0),
        "lag_up": lag_up,
        "lag_down": lag_up * rng.uniform(1.0, 2.0),
        "inertia_scale": rng.uniform(0.7, 1.6),
        "battery_sag": rng.uniform(0.0, 0.15),
    }


def scenario(case: Case) -> Scenario:
    """Returns the scenario of a simulated flight: 60 s in the air, at a height at which it meets the wind.

    Args:
        case: the vehicle, its wind, its steering and its stream.
    """
    values = {
        # The jet of a blower is narrow, and only 1.5 m above the ground.
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

    Returns:
        Both in the unit of the parameter: rad/s² per unit of command, 1/s or s.
    """
    if name == "effect":
        return plant.mean_effect()
    half_width = float(getattr(plant.interval(), name))
    return float(getattr(plant, name)), half_width


def flight_and_windows(flight: Flight) -> dict[int | None, Flight]:
    """Cuts a flight into windows of ``WINDOW_SECONDS``.

    Args:
        flight: the flight; a rest at its end that is shorter than a window is in none.

    Returns:
        The whole flight by the key ``None``, and the windows by their numbers from 0.
    """
    size = round(WINDOW_SECONDS / flight.dt)
    parts: dict[int | None, Flight] = {None: flight}
    for number in range(len(flight) // size):
        parts[number] = flight[number * size : (number + 1) * size]
    return parts


def evaluate_case(case: Case) -> list[Values]:
    """Simulates a flight, and compares the estimated physical parameters with the true ones.

    Args:
        case: what flies, in which wind, and how.

    Returns:
        A row for the whole flight ("of" is "flights") and for each of its windows ("7 s"). For each parameter it has
        the status, the relative error of the estimate, and whether the 90 % interval holds the truth ("inside"). The
        row of the whole flight has the results of the wind torque, too. Refused flights and windows are named on
        standard error, and have no row.
    """
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
    """Compares an estimated wind torque with the true one: by standard deviation, by mean, and sample by sample.

    Args:
        torque: estimated wind torque; nothing is returned where it is not resolved.
        true_torque: true wind torque at the same samples (T,), rad/s².

    Returns:
        Whether the 90 % intervals of standard deviation and mean hold the truth, and the share of the samples whose
        true torque is in the 90 % band.
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

    Returns:
        Percentages as texts, the number of rows, and the worst relative error of a reported estimate.
    """
    status = rows[f"{name} status"]
    line = {"number": len(rows)} | {kind: percent_true(status == kind) for kind in STATUSES}
    reported_rows = rows[status == Status.REPORTED]
    line["inside"] = percent_true(reported_rows[f"{name} inside"])
    worst = max(reported_rows[f"{name} error"], key=abs, default=np.nan)
    line["worst"] = f"{worst:+.0%}"
    biased_rows = rows[status == Status.BIASED]
    line["inside, where biased"] = percent_true(biased_rows[f"{name} inside"])
    return pd.Series(line)


def print_simulated(seed: int, every: int, jobs: int) -> None:
    """Simulates the bank of flights, and prints a table for each physical parameter and one for the wind torque.

    The tables of the parameters have a row for each steering, and for all flights at 50 Hz and above: the shares of
    estimates that are reported, biased and not identifiable, and how often the intervals hold the truth. The table of
    the wind torque has a row for each status of the control effectiveness.

    Args:
        seed: seed by which the flights are drawn.
        every: number of flights of which one is flown; 1 for all.
        jobs: number of processes.
    """
    rows = evaluate_flights(evaluate_case, cases(seed, every), jobs)
    click.echo(f"{rows['seed'].nunique()} flights, seed {seed}.\n")
    is_slow = rows["rate"] == min(SAMPLE_RATES)
    slow = rows[is_slow].assign(steering="all, 50 Hz")
    quick = rows[~is_slow].assign(steering="all, 100 Hz or more")
    grouped = pd.concat([slow, rows, quick]).groupby(["steering", "of"], sort=False)
    for name in PARAMETERS:
        lines = grouped.apply(status_statistics, name)
        print_table(f"**{name.capitalize()}**", lines.reset_index())
    columns = ["standard deviation inside", "mean inside", "course inside"]
    table = []
    for status in STATUSES:
        rows_of_status = rows[rows["effect status"] == status]
        # Only rows of whole flights with a resolved wind torque have these columns.
        resolved = rows_of_status.dropna(subset=columns)
        shares = {column: percent_true(resolved[column]) for column in columns}
        table.append({"effect": status, "flights": len(resolved), **shares})
    print_table("**Wind torque**, where it is resolved", table)


def row_of_estimates(flight: Flight) -> Values:
    """Estimates the physical parameters of a real flight, of which no truth is known.

    Args:
        flight: the flight, with the motors as inputs.

    Returns:
        Each estimate as text with the half width of its 90 % interval, by name, such as "0.03 ± 0.004", and with a mark
        of ``STATUSES`` where it is biased. Where nothing can be estimated, the reason takes the place of the effect.
    """
    plant = physical(flight)
    if isinstance(plant, NotIdentifiable):
        return {"effect": plant.reason.sentence_and_remedy}
    row = {}
    for name in PARAMETERS:
        value, half_width = estimate_with_half_width(plant, name)
        if np.isfinite(half_width):
            row[name] = f"{value:.3g} ± {half_width:.2g}{STATUSES[plant.status[name]]}"
        else:
            row[name] = "not identifiable"
    return row


def crazyflie_log(path: Path) -> NDArray[Any]:
    """Reads the log of a Crazyflie's micro-SD card (usdlog, version 2) with a single kind of event.

    The head of the file lists the logged variables as "name(type)", each ended by a zero byte; the type is a letter of
    Python's ``struct``. Rows of fixed length follow: the number of the event, the time in µs, and the variables.

    Args:
        path: the file.

    Returns:
        Structured array (N,) with the fields ``event``, ``time`` (µs) and the variables.
    """
    content = path.read_bytes()
    # The head is shorter than 1000 bytes; what follows could look like a variable by chance.
    variables = list(re.finditer(rb"([\w.]+)\((\w)\)\0", content[:1000]))
    variable_fields = [(match[1].decode(), f"<{match[2].decode()}") for match in variables]
    row_type = np.dtype([("event", "<u2"), ("time", "<u8"), *variable_fields])
    first_row = variables[-1].end()
    # A checksum, shorter than any row, ends the file.
    count = (len(content) - first_row) // row_type.itemsize
    return np.frombuffer(content, row_type, count, first_row)


def crazyflie_rows(axis: str) -> list[Values]:
    """Estimates the physical parameters of one axis of a real Crazyflie 2.1, from a flight with the axis excited.

    Args:
        axis: "roll" or "pitch".

    Returns:
        The one row of the axis.
    """
    log_rows = crazyflie_log(DATA_FOLDER / "real/crazyflie/roll_pitch_excitation.usdlog")
    gyro, directions = AXES[axis]
    # Roll and pitch are excited from 56 to 89 s.
    time = np.arange(56.0 * CRAZYFLIE_RATE, 89.0 * CRAZYFLIE_RATE) / CRAZYFLIE_RATE
    log_time = log_rows["time"] / 1e6
    motors = []
    for motor in range(1, 5):
        # The largest command is 65535: inputs are shares of it.
        motors.append(np.interp(time, log_time, log_rows[f"motor.m{motor}"] / 65535))
    rate = np.interp(time, log_time, np.radians(log_rows[gyro]))
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

    A constant command takes the hidden states to a steady value, if angle and rate are held at zero. The angular
    acceleration by the motor and by these hidden states is then the steady torque per inertia, which can be compared
    with the control effectiveness of the gray-box model.

    Args:
        model: linear model whose states are angle, rate, and then hidden ones.

    Returns:
        The mean of its magnitude over all motors, rad/s² per unit of command.
    """
    # State 0 is the angle, state 1 the rate.
    rate = 1
    hidden = slice(2, None)
    # In steady state 0 = A_hh x_h + B_h u.
    hidden_per_command = -np.linalg.solve(model.A[hidden, hidden], model.B[hidden])
    torque = model.B[rate] + model.A[rate, hidden] @ hidden_per_command
    return float(abs(torque).mean())


def steady_torques(name: str) -> Values:
    """Compares the steady torque of a motor by DEM, its simulation-error fit and the gray-box model with the truth.

    Args:
        name: name of the scenario that is flown, one of ``STEADY_SCENARIOS``.

    Returns:
        A row of texts: the torque by each model, rad/s² per µs, the mean over the motors.
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


CRAZYFLIE_TITLE = (
    "**Crazyflie** (effect in rad/s² per unit of one motor's command; published: 318–403 for roll)"
)
"""Title of the Crazyflie's table; the published effect follows from thrust curves and inertia."""


@command(__doc__, seed=0, every=1)
@click.argument("which", type=click.Choice(["simulated", "crazyflie", "steady"]))
def main(which: str, seed: int, every: int, jobs: int) -> None:
    """Prints tables of estimated physical parameters and their true values, or of the steady torque by several models.

    Args:
        which: "simulated" for simulated flights, "crazyflie" for a real one without known truth, "steady" for the
            steady torque of a motor.
        seed: seed of the simulated flights.
        every: number of simulated flights of which one is flown; 1 for all.
        jobs: number of processes.
    """
    if which == "steady":
        title = "**Steady torque of one motor** (rad/s² per µs, mean over the motors)"
        print_table(title, [steady_torques(name) for name in STEADY_SCENARIOS])
    elif which == "crazyflie":
        print_table(CRAZYFLIE_TITLE, evaluate_flights(crazyflie_rows, AXES, jobs))
    else:
        print_simulated(seed, every, jobs)


if __name__ == "__main__":
    main()
