#!/usr/bin/env python
"""The wind in m/s compared with the truth of simulated flights; prints a row a kind in Markdown.

Flown are the ``wind_*`` scenarios with other vehicles, drags, winds, misalignments and rates; "its drag" is after a
flight with legs of the same vehicle. (Of a recorded flight, `mavdem wind LOG` prints the same.)

Usage: tools/validation/wind.py [--seed N] [--flights N of each kind: five take three minutes] [--jobs N]
"""

from functools import partial
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd
from flights import TABLES, Values, command, drawn, rows_of, share, show
from numpy.random import Generator, default_rng

from mavdem import Drag, wind
from mavdem.experiments.paper.flights import write_log
from mavdem.facts.identifiability import Status
from mavdem.wind_velocity.compass import meteorological_direction
from sitl_scenarios.files import load, scenario_of
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.simulation import fly

NAMES = ("legs", "hover", "turns", "jump", "calm", "turning", "profile")
AFTER_LEGS = ("hover", "turns", "jump")
SHARES = ("speed inside", "direction inside", "band")
COUNTS = ("speed reported", "speed right", "direction reported", "direction right")


def scenario(name: str, vehicle: Values, rng: Generator) -> Scenario:
    """A scenario with another vehicle, in other wind."""
    values = load(f"wind_{name}").model_dump(mode="json") | {"vehicle": vehicle}
    factor = rng.uniform(0.4, 1.7)
    turn = rng.uniform(0, 360)
    for part in values["wind"]:
        if part["kind"] != "gust":
            part["speed"] *= factor
        turned = part["direction"] + turn
        part["direction"] = turned % 360
    tilts = rng.normal(0, 0.7, 2)
    values["sensors"]["misalignment"] = tilts.tolist()
    stream = drawn(TABLES["wind"]["stream"], rng)
    stream["rates"] = {"LOCAL_POSITION_NED": stream.pop("position")}
    values["stream"] |= stream
    return scenario_of(values | {"seed": int(rng.integers(1_000_000))})


def flown(name: str, flight: Scenario, drag: Drag | None = None) -> tuple[Values, Drag]:
    """Returns what holds the truth, what is reported and right of speed and direction, and the drag after it."""
    motion = fly(flight)
    with TemporaryDirectory() as folder:
        log = Path(folder) / "flight.tlog"
        write_log(log, flight, motion)
        estimated = wind(log, drag=drag)
    north, east = (np.interp(estimated.time, motion.time, part) for part in motion.wind[:, :2].T)
    truth = np.column_stack([north, east])
    mean = truth.mean(axis=0)
    speed = float(np.hypot(*mean))
    direction = meteorological_direction(*mean)
    apart = abs((estimated.direction - direction + 180) % 360 - 180)
    low, high = estimated.speed_interval
    has_speed = estimated.status["speed"] is Status.REPORTED and not estimated.calm
    has_direction = (
        estimated.status["direction"] is Status.REPORTED and estimated.direction_identifiable
    )
    row: Values = {"flights": name}
    row["speed inside"] = low <= speed <= high or estimated.calm
    row["direction inside"] = apart <= estimated.direction_interval or speed < 0.3
    in_band = abs(estimated.velocity - truth) <= estimated.band
    row["band"] = np.mean(in_band)
    row["speed reported"] = has_speed
    limit = max(0.7, 0.12 * speed)
    error = abs(estimated.speed - speed)
    row["speed right"] = has_speed and error <= limit
    row["direction reported"] = has_direction
    row["direction right"] = has_direction and apart <= 10
    return row, estimated.drag.for_next_flight()


def judged(case: tuple[int, str], seed: int) -> list[Values]:
    """Rows of the flights of one vehicle."""
    number, name = case
    name_number = NAMES.index(name)
    rng = default_rng([seed, number, name_number])
    lowest = np.log([0.12, 0.003])
    highest = np.log([0.7, 0.04])
    linear, quadratic = np.exp(rng.uniform(lowest, highest))
    axes = rng.uniform(0.85, 1.15) ** np.array([1, -1])
    vehicle = {"model": str(rng.choice(["iris", "ardrone2"]))}
    vehicle["drag_linear"] = (linear * axes).tolist()
    vehicle["drag_quadratic"] = (quadratic * axes).tolist()
    flight = scenario(name, vehicle, rng)
    row, _ = flown(name, flight)
    if name not in AFTER_LEGS:
        return [row]
    first = scenario("legs", vehicle, rng)
    legs, drag = flown("legs", first)
    second = scenario(name, vehicle, rng)
    again, _ = flown(f"{name}, its drag", second, drag)
    return [row, legs, again]


@command(__doc__, seed=0, flights=5)
def main(seed: int, flights: int, jobs: int) -> None:
    cases = product(range(flights), NAMES)
    rows = rows_of(partial(judged, seed=seed), cases, jobs)
    both = pd.concat([rows, rows.assign(flights="all")])
    grouped = both.groupby("flights", sort=False)
    table = grouped[[*SHARES]].agg(share)
    table.insert(0, "number", grouped.size())
    sums = grouped[[*COUNTS]].sum()
    table[[*COUNTS]] = sums.astype(int)
    show(f"Seed {seed}", table.reset_index())


if __name__ == "__main__":
    main()
