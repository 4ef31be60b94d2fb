#!/usr/bin/env python
"""The wind in m/s compared with the truth of simulated flights; prints a row a kind in Markdown.

Flown are the ``wind_*`` scenarios with other vehicles, drags, winds, misalignments and rates; "its drag" is after a
flight with legs of the same vehicle. (Of a recorded flight, `mavdem wind LOG` prints the same.)

Usage: tools/validation/wind.py [--seed N] [--flights N]
"""

from __future__ import annotations

from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import click
import numpy as np

from mavdem import Drag, wind
from mavdem.condition.wind_velocity import coming_from
from mavdem.paper.runner import write_log
from mavdem.report.blocks import Table, markdown
from sitl_scenarios.files import load, scenario_of
from sitl_scenarios.simulation import fly

NAMES = ("legs", "hover", "turns", "jump", "calm", "turning", "profile")
HEADS = [
    "flights",
    "number",
    "speed inside",
    "direction inside",
    "band",
    "reported",
    "right",
    "reported",
    "right",
]


def flown(
    name: str, vehicle: dict[str, Any], draw: np.random.Generator, drag: Drag | None = None
) -> tuple[Any, Drag]:
    """Returns what holds the truth, what is reported and right of speed and direction, and the drag after it."""
    table = load(f"wind_{name}").model_dump(mode="json") | {
        "seed": int(draw.integers(1_000_000)),
        "vehicle": vehicle,
    }
    factor = draw.uniform(0.4, 1.7)
    turn = draw.uniform(0, 360)
    for one in table["wind"]:
        one["speed"] *= 1 if one["kind"] == "gust" else factor
        one["direction"] = (one["direction"] + turn) % 360
    table["sensors"]["misalignment"] = draw.normal(0, 0.7, 2).tolist()
    rates = {"LOCAL_POSITION_NED": float(draw.choice([4, 10, 20]))}
    autopilot = str(draw.choice(["px4", "ardupilot"]))
    rate = float(draw.choice([8, 20, 50]))
    table["stream"] |= {
        "autopilot": autopilot,
        "rate": rate,
        "rates": rates,
        "drag_calibrated": False,
    }
    motion = fly(scenario := scenario_of(table))
    with TemporaryDirectory() as folder:
        write_log(log := Path(folder) / "flight.tlog", scenario, motion)
        found = wind(log, drag=drag)
    truth = np.column_stack(
        [np.interp(found.time, motion.time, part) for part in motion.wind[:, :2].T]
    )
    speed = float(np.hypot(*truth.mean(axis=0)))
    direction = coming_from(*truth.mean(axis=0))
    apart = abs((found.direction - direction + 180) % 360 - 180)
    low, high = found.speed_interval
    held = [low <= speed <= high or found.calm, apart <= found.direction_interval or speed < 0.3]
    band = np.mean(abs(found.velocity - truth) <= found.band)
    said = [found.status["speed"] == "reported" and not found.calm]
    said += [said[0] and abs(found.speed - speed) <= max(0.7, 0.12 * speed)]
    directed = found.status["direction"] == "reported" and found.directed
    return [*held, band, *said, directed, directed and apart <= 10], found.drag.of_next_flight()


@click.command(help=__doc__)
@click.option("--seed", default=0, show_default=True)
@click.option(
    "--flights", default=5, show_default=True, help="Of each kind: five take three minutes."
)
def main(seed: int, flights: int) -> None:
    found: dict[str, list[Any]] = {}
    for number, (kind, name) in product(range(flights), enumerate(NAMES)):
        draw = np.random.default_rng([seed, number, kind])
        linear, quadratic = np.exp(draw.uniform(np.log([0.12, 0.003]), np.log([0.7, 0.04])))
        axes = draw.uniform(0.85, 1.15) ** np.array([1, -1])
        model = str(draw.choice(["iris", "ardrone2"]))
        drags = {
            "drag_linear": (linear * axes).tolist(),
            "drag_quadratic": (quadratic * axes).tolist(),
        }
        found.setdefault(name, []).append(flown(name, {"model": model, **drags}, draw)[0])
        if name in NAMES[1:4]:
            legs, drag = flown("legs", {"model": model, **drags}, draw)
            found.setdefault("legs", []).append(legs)
            found.setdefault(f"{name}, its drag", []).append(
                flown(name, {"model": model, **drags}, draw, drag)[0]
            )
    found["all"] = [one for some in found.values() for one in some]
    rows = []
    for name, some in found.items():
        shares = np.mean(some, axis=0)[:3]
        counts = np.sum(some, axis=0)[3:]
        rows.append(
            [
                name,
                str(len(some)),
                *(f"{one:.0%}" for one in shares),
                *(f"{one:.0f}" for one in counts),
            ]
        )
    click.echo(markdown([Table(HEADS, rows, words=True)]))


if __name__ == "__main__":
    main()
