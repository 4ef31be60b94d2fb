#!/usr/bin/env python
"""Compares estimated physical parameters (control effectiveness, damping, lag) with the truth of simulated flights.

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

WIND_TORQUE_COLUMNS = ["standard deviation inside", "mean inside", "course inside"]
"""Columns of :func:`wind_torque_results`."""

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


class CrazyflieAxis(NamedTuple):
    """An axis of the Crazyflie."""

    gyro_column: str
    """Column of the log with the body rate, degrees/s."""

    effect_directions: tuple[float, ...]
    """Sign of each motor's torque about the axis (4,)."""


CRAZYFLIE_AXES = {
    "roll": CrazyflieAxis("gyro.x", (-1.0, -1.0, 1.0, 1.0)),
    "pitch": CrazyflieAxis("gyro.y", (-1.0, 1.0, 1.0, -1.0)),
}
"""Axes of the Crazyflie that its flight excites."""

CRAZYFLIE_EXCITATION = (56.0, 89.0)
"""Beginning and end of the excitation in the Crazyflie's log, s."""

CRAZYFLIE_FULL_COMMAND = 65535
"""Largest command of a motor in the Crazyflie's log."""


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
    """One simulated flight: what flies, in which wind, and how it is excited."""

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

    vehicle_changes: dict[str, float]
    """Values that replace published ones of the vehicle, by the keys of a scenario."""

    seed: int
    """Seed of wind and noise."""


def cases(seed: int, every: int) -> Iterator[Case]:
    """Yields flights of every vehicle in every wind with every kind of steering, or of a random subset of them.

    Args:
        seed: seed of the subset, of the vehicles' changes, and of the flights' seeds.
        every: number of pairs of vehicle and wind of which one is drawn; 1 for all.

    Yields:
        The flights: pairs of vehicle and wind in random order, each with every kind of steering. From flight to flight
        the next pair of sampling rate and autopilot is taken, so that all are equally frequent in a subset, too.
    """
    rng = default_rng(seed)
    vehicles_and_winds = list(product(TABLES["scales"]["wind"], CONDITIONS["winds"]))
    count = len(vehicles_and_winds) // every
    chosen_pairs = rng.permutation(len(vehicles_and_winds))[:count]
    streams = cycle(product(SAMPLE_RATES, ("px4", "ardupilot")))
    for pair_number in chosen_pairs:
        vehicle, wind = vehicles_and_winds[pair_number]
        for steering in CONDITIONS["steering"]:
            rate, autopilot = next(streams)
            # Changes are drawn for every flight, so that the other random numbers do not depend on their use.
            drawn_changes = draw_vehicle_values(rng)
            is_changed = rng.random() < VARIED_SHARE
            changes = drawn_changes if is_changed else {}
            case_seed = int(rng.integers(1_000_000))
            yield Case(vehicle, wind, steering, rate, autopilot, changes, case_seed)


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
        "vehicle": {"model": case.vehicle, **case.vehicle_changes},
        "wind": CONDITIONS["winds"][case.wind],
        "moments": CONDITIONS["moments"].get(case.wind, []),
        "stream": {"rate": case.rate, "autopilot": case.autopilot},
    }
    return scenario_from_values(values | {"excitation": CONDITIONS["steering"][case.steering]})


def true_values(motion: Motion, flown_scenario: Scenario, segment: Flight) -> Values:
    """Returns the true physical parameters of roll in a segment of a simulated flight.

    The true effect of a motor depends on the speed of its rotor, so it is averaged over the segment alone.

    Args:
        motion: the simulated motion of the whole flight.
        flown_scenario: the scenario that was flown.
        segment: samples from the log of the flight, the whole of it or a window.

    Returns:
        "effect" of each motor (r,), rad/s² per µs of pulse width, at the mean motor outputs of the segment; "damping",
        1/s; "lag", s, the mean of speeding up and slowing down; and "wind", the wind torque divided by the moment of
        inertia at the samples of the segment (T,), rad/s².
    """
    is_in_segment = (motion.time >= segment.time[0]) & (motion.time <= segment.time[-1])
    is_airborne = is_in_segment & (motion.landed_state == IN_AIR)
    # ``truth`` averages the effects over all samples whose landed state is "in air". Samples outside the segment are
    # therefore declared to be on the ground.
    landed_state = np.where(is_airborne, IN_AIR, ON_GROUND).astype(np.uint8)
    true_arrays = truth(flown_scenario, replace(motion, landed_state=landed_state))
    wind_torque = np.interp(segment.time, motion.time, true_arrays["roll_disturbance"])
    # The states are angle and rate: the rate's own coefficient is the negative damping.
    damping = -float(true_arrays["roll_A"][1, 1])
    return {
        "effect": true_arrays["roll_effect"],
        "damping": damping,
        "lag": true_arrays["lag"][0],
        "wind": wind_torque,
    }


def estimate_with_half_width(plant: Physical, name: str) -> tuple[float, float]:
    """Returns a physical parameter and the half width of its 90 % interval, which is NaN if it is not identifiable.

    Args:
        plant: estimated control effectiveness, damping, time constant and delay.
        name: "effect" for the mean of all motors, "damping" or "lag".

    Returns:
        Both in the unit of the parameter: rad/s² per unit of command, 1/s or s.
    """
    if name == "effect":
        return plant.mean_effect()
    half_width = float(getattr(plant.interval(), name))
    return float(getattr(plant, name)), half_width


def windows(flight: Flight) -> list[Flight]:
    """Cuts a flight into windows of ``WINDOW_SECONDS``; a shorter remainder at its end is left out."""
    window_samples = round(WINDOW_SECONDS / flight.dt)
    starts = range(0, len(flight) - window_samples + 1, window_samples)
    return [flight[start : start + window_samples] for start in starts]


def evaluate_case(case: Case) -> list[Values]:
    """Simulates a flight, and compares the estimated physical parameters of roll with the true ones.

    Parameters are estimated from the whole flight, and from each window of ``WINDOW_SECONDS`` by itself.

    Args:
        case: what flies, in which wind, and how.

    Returns:
        A row for the whole flight (column "of" is "flights") and for each window ("7 s"), with the columns of
        :func:`parameter_results`; the whole flight has the columns of :func:`wind_torque_results`, too. Flights and
        windows whose parameters cannot be estimated have no row; the reason goes to standard error.
    """
    try:
        flown_scenario = scenario(case)
        flight = simulated_flight(flown_scenario)
        motion = fly(flown_scenario)
    except (NotLearnable, Unreadable) as reason:
        click.echo(f"{case}: refused: {reason}", err=True)
        return []
    rows = []
    for segment in (flight, *windows(flight)):
        plant = physical(segment)
        if isinstance(plant, NotIdentifiable):
            click.echo(f"{case}: refused: {plant.reason}", err=True)
            continue
        is_whole_flight = segment is flight
        true_parameters = true_values(motion, flown_scenario, segment)
        row = {"steering": case.steering, "rate": case.rate, "seed": case.seed}
        row["of"] = "flights" if is_whole_flight else "7 s"
        row |= parameter_results(plant, true_parameters)
        if is_whole_flight:
            wind_torque = estimate_wind_torque(plant, Record.from_flights(segment))
            row |= wind_torque_results(wind_torque, true_parameters["wind"])
        rows.append(row)
    return rows


def parameter_results(plant: Physical, true_parameters: Values) -> Values:
    """Compares estimated physical parameters with the true ones.

    Args:
        plant: estimated control effectiveness, damping, time constant and delay.
        true_parameters: the true values, as :func:`true_values` returns them.

    Returns:
        For each of ``PARAMETERS`` its name with "status", with "error" for the relative error of the estimate, and with
        "inside" for whether the 90 % interval holds the truth. The effect is the mean magnitude over the motors.
    """
    results: Values = {}
    for name in PARAMETERS:
        estimate, half_width = estimate_with_half_width(plant, name)
        true_value = float(np.mean(abs(true_parameters[name])))
        results[f"{name} status"] = plant.status[name]
        results[f"{name} error"] = estimate / true_value - 1
        results[f"{name} inside"] = abs(estimate - true_value) <= half_width
    return results


def wind_torque_results(torque: WindTorque, true_torque: Array) -> Values:
    """Compares an estimated wind torque with the true one: its standard deviation, its mean, and each sample.

    Args:
        torque: estimated wind torque of T samples.
        true_torque: true wind torque at the same samples (T,), rad/s².

    Returns:
        By the names of ``WIND_TORQUE_COLUMNS``: whether the 90 % intervals of standard deviation and mean hold the
        truth, and the share of the samples whose true torque is in the 90 % band. Empty for an estimate that is not
        resolved, because it is too small for the noise of the log.
    """
    if not torque.resolved:
        return {}
    sd_half_width = coverage_factor() * torque.scale_error * torque.sd
    is_sd_inside = abs(torque.sd - true_torque.std()) <= sd_half_width
    is_mean_inside = abs(torque.mean - true_torque.mean()) <= torque.mean_band
    is_sample_inside = abs(torque.torque - true_torque) <= torque.band
    results = (is_sd_inside, is_mean_inside, np.mean(is_sample_inside))
    return dict(zip(WIND_TORQUE_COLUMNS, results, strict=True))


def status_statistics(rows: Any, name: str) -> pd.Series:
    """Summarises the estimates of one physical parameter: the share of each status, and how often intervals hold.

    Args:
        rows: rows of flights or windows, as :func:`evaluate_case` returns them.
        name: name of the parameter, one of ``PARAMETERS``.

    Returns:
        By column: the number of rows; the percentage of each status; of reported estimates the percentage whose 90 %
        interval holds the truth ("inside") and the "worst" relative error; and the percentage of biased estimates whose
        interval holds the truth.
    """
    status = rows[f"{name} status"]
    reported_rows = rows[status == Status.REPORTED]
    biased_rows = rows[status == Status.BIASED]
    worst_error = max(reported_rows[f"{name} error"], key=abs, default=np.nan)
    cells: dict[str, object] = {"number": len(rows)}
    cells |= {status_name: percent_true(status == status_name) for status_name in STATUSES}
    cells["inside"] = percent_true(reported_rows[f"{name} inside"])
    cells["worst"] = f"{worst_error:+.0%}"
    cells["inside, where biased"] = percent_true(biased_rows[f"{name} inside"])
    return pd.Series(cells)


def print_simulated(seed: int, every: int, jobs: int) -> None:
    """Evaluates all simulated flights, and prints a table for each physical parameter and one for the wind torque.

    The tables of the parameters have a row for each steering, and for all flights at 50 Hz and above: the shares of
    estimates that are reported, biased and not identifiable, and how often the intervals hold the truth. The table of
    the wind torque has a row for each status of the control effectiveness.

    Args:
        seed: seed by which the flights are drawn.
        every: number of pairs of vehicle and wind of which one is flown; 1 for all.
        jobs: number of processes.
    """
    rows = evaluate_flights(evaluate_case, cases(seed, every), jobs)
    click.echo(f"{rows['seed'].nunique()} flights, seed {seed}.\n")
    is_slow = rows["rate"] == min(SAMPLE_RATES)
    slow = rows[is_slow].assign(steering="all, 50 Hz")
    quick = rows[~is_slow].assign(steering="all, 100 Hz or more")
    # Whole flights and windows ("of") have rows of their own.
    groups = pd.concat([slow, rows, quick]).groupby(["steering", "of"], sort=False)
    for name in PARAMETERS:
        table = groups.apply(status_statistics, name)
        print_table(f"**{name.capitalize()}**", table.reset_index())
    print_table("**Wind torque**, where it is resolved", wind_torque_table(rows))


def wind_torque_table(rows: pd.DataFrame) -> list[Values]:
    """Returns how often intervals of the wind torque hold the truth, by the status of the control effectiveness.

    Args:
        rows: rows of :func:`evaluate_case`. Only those of whole flights with a resolved wind torque count.

    Returns:
        A row for each status: number of flights, and percentages by ``WIND_TORQUE_COLUMNS``.
    """
    table = []
    for status in STATUSES:
        rows_of_status = rows[rows["effect status"] == status]
        resolved_rows = rows_of_status.dropna(subset=WIND_TORQUE_COLUMNS)
        shares = {column: percent_true(resolved_rows[column]) for column in WIND_TORQUE_COLUMNS}
        table.append({"effect": status, "flights": len(resolved_rows), **shares})
    return table


def row_of_estimates(flight: Flight) -> Values:
    """Estimates the physical parameters of a real flight, whose true ones are not known.

    Args:
        flight: the flight, with the motors as inputs.

    Returns:
        Texts by the names of ``PARAMETERS``: estimate and half width of its 90 % interval, such as "0.03 ± 0.004", with
        a mark of ``STATUSES`` where it is biased. Where nothing can be estimated, "effect" has the reason instead.
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
        One row, with the axis and the columns of :func:`row_of_estimates`.
    """
    log_rows = crazyflie_log(DATA_FOLDER / "real/crazyflie/roll_pitch_excitation.usdlog")
    gyro_column, effect_directions = CRAZYFLIE_AXES[axis]
    start, end = CRAZYFLIE_EXCITATION
    time = np.arange(start * CRAZYFLIE_RATE, end * CRAZYFLIE_RATE) / CRAZYFLIE_RATE
    # The log's times are in µs, its rates in degrees/s.
    log_time = log_rows["time"] / 1e6
    rate = np.interp(time, log_time, np.radians(log_rows[gyro_column]))
    commands = []
    for motor in range(1, 5):
        relative_command = log_rows[f"motor.m{motor}"] / CRAZYFLIE_FULL_COMMAND
        commands.append(np.interp(time, log_time, relative_command))
    flight = Flight(
        time,
        inputs=np.column_stack(commands),
        outputs=rate[:, None],
        dt=1 / CRAZYFLIE_RATE,
        effect_directions=np.array(effect_directions),
    )
    return [{"axis": axis} | row_of_estimates(flight)]


def steady_torque(model: LinearModel) -> float:
    """Returns the torque per moment of inertia, rad/s², that a unit of one motor's command gives in steady state.

    The hidden states of a learned model, such as the motors' lag, settle under a constant command if angle and rate are
    held at zero. The angular acceleration by the command and by the settled hidden states is the torque per moment of
    inertia, which can be compared with the control effectiveness of the gray-box model.

    Args:
        model: linear model whose states are angle, rate, and then hidden ones.

    Returns:
        The mean of its magnitude over all motors, rad/s² per unit of command.
    """
    # State 0 is the angle, state 1 the rate.
    rate = 1
    hidden = slice(2, None)
    # The hidden states h are in steady state if 0 = A_hh x_h + B_h u.
    hidden_per_command = -np.linalg.solve(model.A[hidden, hidden], model.B[hidden])
    torque_per_command = model.B[rate] + model.A[rate, hidden] @ hidden_per_command
    return float(abs(torque_per_command).mean())


def steady_torques(name: str) -> Values:
    """Compares the steady torque of a motor by DEM, its simulation-error fit and the gray-box model with the truth.

    Args:
        name: name of the scenario that is flown, one of ``STEADY_SCENARIOS``.

    Returns:
        A row of texts: name of the flight, and the true torque and each model's, rad/s² per µs, the mean over motors.
    """
    flown_scenario = load_scenario(name)
    flight = simulated_flight(flown_scenario)
    true_effects = true_values(fly(flown_scenario), flown_scenario, flight)["effect"]
    # Without a horizon, DEM is not followed by the fit of simulation errors.
    dem_model = learn(flight, Settings(horizon=None)).model
    simulation_fit_model = learn(flight, Settings()).model
    plant = physical(flight)
    gray_box_torque = np.nan
    if not isinstance(plant, NotIdentifiable):
        gray_box_torque, _ = plant.mean_effect()
    torques = {
        "truth": float(abs(true_effects).mean()),
        "DEM": steady_torque(dem_model),
        "simulation fit": steady_torque(simulation_fit_model),
        "gray-box": gray_box_torque,
    }
    return {"flight": name} | {title: f"{torque:.3f}" for title, torque in torques.items()}


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
        print_table(CRAZYFLIE_TITLE, evaluate_flights(crazyflie_rows, CRAZYFLIE_AXES, jobs))
    else:
        print_simulated(seed, every, jobs)


if __name__ == "__main__":
    main()
