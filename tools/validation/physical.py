#!/usr/bin/env python
"""Motor effect, damping and actuator lag of learnt models compared with simulated flights' truth; prints a table.

Each scenario is flown with several seeds and cut into windows of 700 samples. Where the rotors lag, the model has a
hidden state: the motors' total effect on roll is B₁ − A₁₂ B₂ / A₂₂, and the lag is −1/A₂₂. "Inside" is the share of
windows with the truth inside the model's 90 % interval (delta method). "Times the truth" is the median, for motors in
the direction that rolls. The gray-box rows (`mavdem.dem.graybox`) are of the windows in which the physical parameters
are identifiable, and of those in which they are not. With --steer the roll is excited as well.

Usage: tools/validation/physical.py [--flights N] [--steer DEGREES] [--settings JSON] [SCENARIO]...
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray
from rich.progress import track
from scipy.stats import norm
from scipy.stats import t as student

import mavdem
from mavdem.dem import Physical
from mavdem.dem.engine.model import pack, unpack
from mavdem.paper.flights import hover
from sitl_scenarios.files import load
from sitl_scenarios.scenario import Multisine
from sitl_scenarios.simulation import fly
from sitl_scenarios.truth import truth

Array = NDArray[np.float64]

IDENTIFIABLE, NOT_IDENTIFIABLE = "gray-box, identifiable", "gray-box, not identifiable"

SCENARIOS = ("iris_multisine", "iris_doublets", "iris_gusts", "iris_dryden", "hover_blower", "crazyflie_gusts")
TRAIN, LEVEL = 700, 0.9


def effect(A: Array, B: Array) -> Array:
    """(r,) of the motors on the rate at steady state, rad/s² per µs."""
    return np.asarray(B[1] - A[1, 2] * B[2] / A[2, 2] if len(A) > 2 else B[1])


def flown(name: str, seed: int, steer: float) -> tuple[mavdem.Flight, dict[str, float]]:
    """A scenario's settled hover as the autopilot estimates it, with another seed, and its true parameters."""
    scenario = load(name)
    scenario = scenario.model_copy(update={"seed": scenario.seed + seed})
    if steer:
        multisine = Multisine(kind="multisine", sd=steer, lowest=0.2, highest=4.0, period=10.0)
        scenario = scenario.model_copy(update={"excitation": multisine})
    motion = fly(scenario)
    flight = hover(scenario, motion)
    known = truth(scenario, motion)
    true = {
        "motors": float(np.linalg.norm(known["roll_B"][1])),
        "damping": float(known["roll_A"][1, 1]),
        "lag": float(known["lag"][0]),
    }
    way = known["roll_B"][1] / true["motors"]
    return mavdem.Flight(flight.time, flight.inputs @ np.outer(way, way), flight.outputs[:, 2:], dt=flight.dt), true


def read(physical: Physical) -> dict[str, tuple[float, float]]:
    """Each physical parameter, and the half width of its interval, whether it is identifiable or not."""
    motors = np.append(physical.motors, [0.0, 0.0])
    size = float(np.linalg.norm(motors))
    sds = [np.sqrt(motors @ physical.covariance @ motors) / size, *np.sqrt(physical.covariance.diagonal()[-2:])]
    values = {"motors": size, "damping": -physical.damping, "lag": physical.lag}
    halves = float(norm.ppf(0.5 + LEVEL / 2)) * np.array(sds)
    return {name: (value, float(half)) for (name, value), half in zip(values.items(), halves, strict=True)}


def estimates(learned: mavdem.Learned) -> dict[str, tuple[float, float]]:
    """Each parameter of the learnt model, and the half width of its interval."""
    (n, r), m = learned.model.B.shape, len(learned.model.C)
    theta = pack(learned.model.A, learned.model.B, learned.model.C)
    scatter = learned.scatter
    numbers: dict[str, Callable[[Array, Array], float]] = {
        "motors": lambda A, B: float(np.linalg.norm(effect(A, B))),
        "damping": lambda A, B: float(A[1, 1]),
    }
    if n > 2:
        numbers["lag"] = lambda A, B: float(-1 / A[2, 2])
    found = {}
    for name, number in numbers.items():
        value = number(*unpack(theta, n, r, m)[:2])
        steps = 1e-6 * np.maximum(1e-3, np.abs(theta))
        slope = [(number(*unpack(theta + step, n, r, m)[:2]) - value) / step.max() for step in np.diag(steps)]
        if scatter is None:
            found[name] = value, np.nan
            continue
        sd = float(np.sqrt(np.array(slope) @ scatter.covariance @ np.array(slope)))
        found[name] = value, float(student.ppf(0.5 + LEVEL / 2, scatter.freedom)) * sd
    return found


def cell(windows: list[tuple[dict[str, tuple[float, float]], dict[str, float]]], name: str) -> str:
    """A parameter over the windows: its median over the truth, and how often its interval contains the truth."""
    rows = [(*numbers[name], true[name]) for numbers, true in windows if name in numbers]
    if not rows:
        return "-"
    value, half, truth = np.array(rows).T
    return f"{np.median(value / truth):.2f}, {np.mean(abs(value - truth) <= half):.2f}"


@click.command(help=__doc__)
@click.argument("scenarios", nargs=-1, metavar="[SCENARIO]...")
@click.option("--flights", default=4, show_default=True, help="Flights of each scenario.")
@click.option("--steer", default=0.0, help="Degrees of roll, standard deviation, of a multisine added to each flight.")
@click.option("--settings", default="{}", help='Changes to the default settings, such as {"horizon": null}.')
def main(scenarios: tuple[str, ...], flights: int, steer: float, settings: str) -> None:
    chosen = replace(mavdem.Settings(), **json.loads(settings))
    print("| scenario | by | windows | motors: times the truth, inside | damping | lag |")
    print("|---|---|---|---|---|---|")
    for name in track(scenarios or SCENARIOS, description="Flying and learning"):
        jobs, truths = [], []
        for seed in range(flights):
            flight, true = flown(name, seed, steer)
            cuts = range(0, len(flight) - TRAIN + 1, TRAIN)
            jobs += [(flight[start : start + TRAIN], chosen) for start in cuts]
            truths += [true] * len(cuts)
        by: dict[str, list[Any]] = {"DEM": [], IDENTIFIABLE: [], NOT_IDENTIFIABLE: []}
        for answer, true in zip(mavdem.learn_many(jobs), truths, strict=True):
            if isinstance(answer, ValueError):
                continue
            by["DEM"].append((estimates(answer), true))
            if (physical := answer.physical) is not None:
                by[IDENTIFIABLE if physical.identifiable else NOT_IDENTIFIABLE].append((read(physical), true))
        for who, rows in by.items():
            if rows:
                cells = " | ".join(cell(rows, parameter) for parameter in ("motors", "damping", "lag"))
                print(f"| {name} | {who} | {len(rows)} | {cells} |", flush=True)


if __name__ == "__main__":
    main()
