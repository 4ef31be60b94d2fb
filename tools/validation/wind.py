#!/usr/bin/env python
"""Estimates of the wind (m/s) from lean and drag, compared with the true wind of simulated flights of several kinds.

Flown are the ``wind_*`` scenarios with other vehicles, drags, winds, misalignments and rates. A flight with legs (fast
straight flight in several directions) identifies the vehicle's drag, which others are estimated with again ("its
drag"). (Of a recorded flight, `mavdem wind LOG` prints the same.) A row is printed for each kind of flight.

Usage: tools/validation/wind.py [--seed N] [--flights N of each kind: five take three minutes] [--jobs N]
"""

from functools import partial
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd
from flights import (
    TABLES,
    Values,
    command,
    draw_values,
    evaluate_flights,
    percent_true,
    print_table,
)
from numpy.random import Generator, default_rng

from mavdem import Drag, WindVelocity, wind
from mavdem.arrays import Array
from mavdem.experiments.paper.flights import write_log
from mavdem.facts.identifiability import Status
from mavdem.wind_velocity.compass import meteorological_direction
from sitl_scenarios.files import load, scenario_from_table
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.simulation import fly

KINDS = ("legs", "hover", "turns", "jump", "calm", "turning", "profile")
"""Kinds of flights: the scenarios ``wind_*``."""

KINDS_AFTER_LEGS = ("hover", "turns", "jump")
"""Kinds that are also flown with the drag that a flight with legs of the same vehicle gives."""

SHARES = ("speed inside", "direction inside", "band")
"""Columns that are shares: intervals and samples of the band that hold the truth."""

WIDTHS = ("half width", "half width foretold")
"""Columns with medians of half widths of the speed's interval, m/s: as estimated, and as the advice foretells."""

COUNTS = ("speed reported", "speed right", "direction reported", "direction right")
"""Columns that are numbers of flights."""

MISALIGNMENT_SD = 0.7
"""Standard deviation of the sensors' misalignment about roll and pitch, degrees: a choice."""

SPEED_FACTORS = (0.4, 1.7)
"""Least and largest factor on the speed of a scenario's wind: a choice."""

MIN_DIRECTION_SPEED = 0.3
"""m/s; a slower wind has no direction that an interval could miss."""

MAX_SPEED_ERROR = 0.7
MAX_RELATIVE_SPEED_ERROR = 0.12
"""A reported speed is right if its error is at most 0.7 m/s or 12 %, whichever is more."""

MAX_DIRECTION_ERROR = 10.0
"""Degrees; a reported direction is right if its error is at most this."""


def draw_scenario(kind: str, vehicle: Values, rng: Generator) -> Scenario:
    """Draws a scenario of a kind: its wind scaled and turned, with misaligned sensors and other message rates.

    Args:
        kind: one of ``KINDS``.
        vehicle: the vehicle, as in a scenario's file.
        rng: generator of random numbers.

    Returns:
        The validated scenario. All its winds are turned by the same random angle; gusts keep their speed.
    """
    values = load(f"wind_{kind}").model_dump(mode="json") | {"vehicle": vehicle}
    speed_factor = rng.uniform(*SPEED_FACTORS)
    rotation = rng.uniform(0, 360)
    for wind_component in values["wind"]:
        if wind_component["kind"] != "gust":
            wind_component["speed"] *= speed_factor
        wind_component["direction"] = (wind_component["direction"] + rotation) % 360
    misalignment = rng.normal(0, MISALIGNMENT_SD, 2)
    values["sensors"]["misalignment"] = misalignment.tolist()
    stream = draw_values(TABLES["wind"]["stream"], rng)
    # The file flights.toml has the rate of the position's message among the values of the stream.
    stream["rates"] = {"LOCAL_POSITION_NED": stream.pop("position")}
    values["stream"] |= stream
    return scenario_from_table(values | {"seed": int(rng.integers(1_000_000))})


def evaluate_scenario(
    label: str, scenario: Scenario, drag: Drag | None = None
) -> tuple[Values, Drag]:
    """Simulates a flight, estimates the wind from its log and compares it with the truth.

    Args:
        label: name of the kind of flight in the table.
        scenario: scenario to fly: vehicle, wind, excitation, sensors and faults.
        drag: drag of the vehicle from an earlier flight, if there is one.

    Returns:
        The row of the flight, as :func:`agreement` returns it, and the drag for the next flight of the vehicle.
    """
    motion = fly(scenario)
    with TemporaryDirectory() as folder:
        log = Path(folder) / "flight.tlog"
        write_log(log, scenario, motion)
        estimate = wind(log, drag=drag)
    true_north, true_east, _ = motion.wind.T
    true_wind = np.column_stack(
        [
            np.interp(estimate.time, motion.time, true_north),
            np.interp(estimate.time, motion.time, true_east),
        ]
    )
    row = {"flights": label} | agreement(estimate, true_wind)
    return row, estimate.drag.for_next_flight()


def agreement(estimate: WindVelocity, true_wind: Array) -> Values:
    """Compares an estimated wind with the true one.

    Args:
        estimate: the estimate, of T samples.
        true_wind: true wind at these samples, north and east, m/s; (T, 2).

    Returns:
        By column of the table: half width of the speed's interval, and the one that the advice to fly a box foretells,
        m/s; whether mean speed and direction are "inside" their 90 % intervals, "reported", and "right" as reported;
        and "band", the share of the samples in which the wind is inside its 90 % band.
    """
    mean_wind = true_wind.mean(axis=0)
    true_speed = float(np.hypot(*mean_wind))
    true_direction = meteorological_direction(*mean_wind)
    # The difference of two directions is taken between −180 and 180 degrees.
    direction_error = abs((estimate.direction - true_direction + 180) % 360 - 180)
    speed_error = abs(estimate.speed - true_speed)
    max_speed_error = max(MAX_SPEED_ERROR, MAX_RELATIVE_SPEED_ERROR * true_speed)
    low, high = estimate.speed_interval
    reports_speed = estimate.status["speed"] is Status.REPORTED and not estimate.calm
    reports_direction = (
        estimate.status["direction"] is Status.REPORTED and estimate.direction_identifiable
    )
    has_no_direction = true_speed < MIN_DIRECTION_SPEED
    foretold = (
        np.nan if estimate.advice is None else estimate.advice.figures["expected_speed_error"]
    )
    return {
        "half width": (high - low) / 2,
        "half width foretold": foretold,
        "speed inside": low <= true_speed <= high,
        "direction inside": direction_error <= estimate.direction_interval or has_no_direction,
        "band": np.mean(abs(estimate.velocity - true_wind) <= estimate.band),
        "speed reported": reports_speed,
        "speed right": reports_speed and speed_error <= max_speed_error,
        "direction reported": reports_direction,
        "direction right": reports_direction and direction_error <= MAX_DIRECTION_ERROR,
    }


def draw_vehicle(rng: Generator) -> Values:
    """Draws a vehicle whose drag differs between its axes by up to a third.

    Args:
        rng: generator of random numbers.

    Returns:
        The section of the vehicle, as in a scenario's file.
    """
    # Ranges of the linear drag, 1/s, and the quadratic drag, 1/m, uniform in the logarithm; a choice.
    lowest = np.log([0.12, 0.003])
    highest = np.log([0.7, 0.04])
    linear_drag, quadratic_drag = np.exp(rng.uniform(lowest, highest))
    # The factors of the two horizontal body axes are reciprocal, so that the geometric mean of the drag stays.
    factor = rng.uniform(0.85, 1.15)
    axis_factors = factor ** np.array([1, -1])
    return {
        "model": str(rng.choice(["iris", "ardrone2"])),
        "drag_linear": (linear_drag * axis_factors).tolist(),
        "drag_quadratic": (quadratic_drag * axis_factors).tolist(),
    }


def evaluate_vehicle(case: tuple[int, str], seed: int) -> list[Values]:
    """Simulates one or several flights of a vehicle, and compares the estimated wind of each with the true one.

    Some kinds of flight, such as a hover, do not show the vehicle's drag, and the wind is then estimated with a typical
    one. A vehicle of these ``KINDS_AFTER_LEGS`` flies twice more: straight legs, which identify its drag, and a second
    flight of its kind, whose wind is estimated with that drag. The wind of the first is estimated again with it.

    Args:
        case: number of the vehicle, and kind of its flight.
        seed: seed of all flights.

    Returns:
        A row for each flight, as :func:`evaluate_scenario` returns it.
    """
    number, kind = case
    rng = default_rng([seed, number, KINDS.index(kind)])
    vehicle = draw_vehicle(rng)
    first_flight = draw_scenario(kind, vehicle, rng)
    row, _ = evaluate_scenario(kind, first_flight)
    if kind not in KINDS_AFTER_LEGS:
        return [row]
    legs = draw_scenario("legs", vehicle, rng)
    legs_row, identified_drag = evaluate_scenario("legs", legs)
    second_flight = draw_scenario(kind, vehicle, rng)
    second_row, _ = evaluate_scenario(f"{kind}, its drag", second_flight, identified_drag)
    # The flight that did not show its drag is evaluated with that of a flight that does, as `mavdem wind` advises.
    again_row, _ = evaluate_scenario(f"{kind}, again", first_flight, identified_drag)
    again_row["half width foretold"] = row["half width foretold"]
    return [row, legs_row, second_row, again_row]


@command(__doc__, seed=0, flights=5)
def main(seed: int, flights: int, jobs: int) -> None:
    """Simulates flights in wind, and prints how often the estimated wind agrees with the true one, by kind of flight.

    Args:
        seed: seed of all flights.
        flights: number of vehicles, each of which makes a flight of each kind.
        jobs: number of processes.
    """
    cases = product(range(flights), KINDS)
    rows = evaluate_flights(partial(evaluate_vehicle, seed=seed), cases, jobs)
    rows_with_total = pd.concat([rows, rows.assign(flights="all")])
    groups = rows_with_total.groupby("flights", sort=False)
    table = groups[[*SHARES]].agg(percent_true)
    table.insert(0, "number", groups.size())
    table[[*WIDTHS]] = groups[[*WIDTHS]].median().round(2)
    table[[*COUNTS]] = groups[[*COUNTS]].sum().astype(int)
    print_table(f"Seed {seed}", table.reset_index())


if __name__ == "__main__":
    main()
