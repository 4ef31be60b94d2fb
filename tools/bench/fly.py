#!/usr/bin/env python
"""Time to simulate a flight of five minutes on one core, and many shorter ones on all cores; prints a table.

Usage: tools/bench/fly.py [--flights N] [--seconds S]
"""

from __future__ import annotations

import os
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from time import perf_counter
from timeit import repeat

import click

from sitl_scenarios.files import load
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.simulation import MAX_STEP_SECONDS, Simulation, fly


def flight(name: str, **changes: object) -> Scenario:
    return Scenario.model_validate(load(name).model_dump() | changes)


def flown(scenario: Scenario) -> int:
    return len(fly(scenario))


@click.command(help=__doc__)
@click.option("--flights", "count", default=100, show_default=True, type=click.IntRange(min=1))
@click.option("--seconds", "duration", default=60.0, show_default=True, type=click.FloatRange(min=20))
def main(count: int, duration: float) -> None:
    print("| flights | simulated, s | taken, s | times real time | µs a step |")
    print("|---|---|---|---|---|")
    for name, label in (("iris_gusts", "PX4, 1000 steps a second"), ("ardupilot_steps", "ArduPilot, 1200")):
        scenario = flight(name, duration=300.0)
        taken = min(repeat(partial(fly, scenario), number=1, repeat=3))
        cycle = Simulation(scenario).cycle
        steps = 303 / cycle * -(-round(cycle * 1e6) // round(MAX_STEP_SECONDS * 1e6))
        print(f"| one of five minutes, {label} | 303 | {taken:.2f} | {303 / taken:.0f} | {taken / steps * 1e6:.1f} |")
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    scenarios = [flight("iris_gusts", duration=duration, seed=seed) for seed in range(count)]
    began = perf_counter()
    with ProcessPoolExecutor(cores) as executor:
        rows = sum(executor.map(flown, scenarios))
    taken = perf_counter() - began
    simulated = rows * Simulation(scenarios[0]).cycle
    each = taken * cores / (simulated / MAX_STEP_SECONDS) * 1e6
    print(
        f"| {count} of {duration:g} s, PX4, on {cores} cores | {simulated:.0f} | {taken:.1f} | {simulated / taken:.0f} "
        f"| {each:.1f} |"
    )


if __name__ == "__main__":
    main()
