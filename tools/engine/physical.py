#!/usr/bin/env python
"""Motor effect, damping and actuator lag as they are learnt, beside the truth of simulated flights; prints a table.

Of every scenario, flown with several seeds, windows of 700 samples. Where the rotors lag, the model has a hidden state
for it: the effect of motors on roll is then what they have directly and through it, B₁ − A₁₂ B₂ / A₂₂, and the lag is
−1/A₂₂. "Inside" is the share of windows in which the truth lies within the model's 90 % interval, carried over to these
numbers by their slopes; "times the truth" is the median over windows, for motors along the direction that rolls. Beside
them stands the physical reading, `mavdem.dem.physical`, of the same windows: of those in which it tells an interval,
and of those in which it does not, with the interval it would have told. With --steer the roll is excited as well.

Usage: tools/engine/physical.py [--flights N] [--steer DEGREES] [--settings JSON] [SCENARIO]...
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace

import click
import numpy as np
from numpy.typing import NDArray
from rich.progress import track
from scipy.stats import norm
from scipy.stats import t as student

import mavdem
from mavdem.dem import Physical
from mavdem.dem.model import pack, unpack
from sitl_scenarios.attitude import euler
from sitl_scenarios.files import load
from sitl_scenarios.scenario import Multisine
from sitl_scenarios.simulation import fly
from sitl_scenarios.truth import truth

Array = NDArray[np.float64]

SCENARIOS = ("iris_multisine", "iris_doublets", "iris_gusts", "iris_dryden", "hover_blower", "crazyflie_gusts")
TRAIN, LEVEL, AFTER_CLIMB = 700, 0.9, 3.0


def effect(A: Array, B: Array) -> Array:
    """(r,) of the motors on the rate, rad/s² per µs, once they have settled."""
    return np.asarray(B[1] - A[1, 2] * B[2] / A[2, 2] if len(A) > 2 else B[1])


def flown(name: str, seed: int, steer: float = 0.0) -> tuple[mavdem.Flight, dict[str, float]]:
    """A flight's settled hover as the autopilot knows it, and the numbers that are true of it.

    Args:
        name: of the scenario.
        seed: added to its own.
        steer: degrees of roll, in place of its own excitation.
    """
    scenario = load(name)
    scenario = scenario.model_copy(update={"seed": scenario.seed + seed})
    if steer:
        multisine = Multisine(kind="multisine", sd=steer, lowest=0.2, highest=4.0, period=10.0)
        scenario = scenario.model_copy(update={"excitation": multisine})
    motion = fly(scenario)
    hover, rate = motion.landed_state == 2, scenario.stream.rate
    time = np.arange(round((motion.time[hover][0] + AFTER_CLIMB) * rate), int(motion.time[hover][-1] * rate)) / rate
    roll = np.array([euler(attitude)[0] for attitude in motion.known_attitude.tolist()])
    outputs = [np.interp(time, motion.time, column) for column in (roll, motion.known_rates[:, 0])]
    inputs = [np.interp(time, motion.time, column) for column in motion.outputs.T]
    known = truth(scenario, motion)
    true = {
        "motors": float(np.linalg.norm(known["roll_B"][1])),
        "damping": float(known["roll_A"][1, 1]),
        "lag": float(known["lag"][0]),
    }
    way = known["roll_B"][1] / true["motors"]
    return mavdem.Flight(
        time, np.column_stack(inputs) @ np.outer(way, way), np.column_stack(outputs), dt=1 / rate
    ), true


def read(physical: Physical) -> dict[str, tuple[float, float]]:
    """Each number of a physical reading, and the half width of its interval, whether it is told or not."""
    motors = np.append(physical.motors, [0.0, 0.0])
    size = float(np.linalg.norm(motors))
    sds = [np.sqrt(motors @ physical.covariance @ motors) / size, *np.sqrt(physical.covariance.diagonal()[-2:])]
    values = {"motors": size, "damping": -physical.damping, "lag": physical.lag}
    halves = float(norm.ppf(0.5 + LEVEL / 2)) * np.array(sds)
    return {name: (value, float(half)) for (name, value), half in zip(values.items(), halves, strict=True)}


def estimates(learned: mavdem.Learned) -> dict[str, tuple[float, float]]:
    """Each number as it was learnt, and the half width of its interval."""
    (n, r), m = learned.model.B.shape, len(learned.model.C)
    theta = pack(learned.model.A, learned.model.B, learned.model.C)
    scatter = learned.scatter
    numbers: dict[str, Callable[[Array, Array], float]] = {
        "motors": lambda A, B: float(np.linalg.norm(effect(A, B))),
        "damping": lambda A, B: float(A[1, 1]),
    }
    if n > 2:
        numbers["lag"] = lambda A, B: float(-1 / A[2, 2])
    answers = {}
    for name, number in numbers.items():
        value = number(*unpack(theta, n, r, m)[:2])
        steps = 1e-6 * np.maximum(1e-3, np.abs(theta))
        slope = [(number(*unpack(theta + step, n, r, m)[:2]) - value) / step.max() for step in np.diag(steps)]
        if scatter is None:
            answers[name] = value, np.nan
            continue
        sd = float(np.sqrt(np.array(slope) @ scatter.covariance @ np.array(slope)))
        answers[name] = value, float(student.ppf(0.5 + LEVEL / 2, scatter.freedom)) * sd
    return answers


class Cells:
    """Each number over the windows: how many times the truth, and whether its interval holds it."""

    def __init__(self) -> None:
        """None yet."""
        self.of: dict[str, list[tuple[float, bool]]] = {"motors": [], "damping": [], "lag": []}

    def add(self, numbers: dict[str, tuple[float, float]], true: dict[str, float]) -> None:
        """Those of a window."""
        for name, (value, half) in numbers.items():
            self.of[name].append((value / true[name], abs(value - true[name]) <= half))

    def __str__(self) -> str:
        """Cells of the table."""
        return " | ".join(
            f"{np.median([ratio for ratio, _ in rows]):.2f}, {np.mean([inside for _, inside in rows]):.2f}"
            if rows
            else "-"
            for rows in self.of.values()
        )


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
        by = {"DEM": Cells(), "reading, told": Cells(), "reading, not told": Cells()}
        for answer, true in zip(mavdem.learn_many(jobs), truths, strict=True):
            if isinstance(answer, ValueError):
                continue
            by["DEM"].add(estimates(answer), true)
            if answer.physical is not None:
                by["reading, told" if answer.physical.told else "reading, not told"].add(read(answer.physical), true)
        for who, cells in by.items():
            if cells.of["motors"]:
                print(f"| {name} | {who} | {len(cells.of['motors'])} | {cells} |", flush=True)


if __name__ == "__main__":
    main()
