#!/usr/bin/env python
"""Step responses measured on simulated flights, beside those of the true closed loops; prints a line for each flight.

Vehicles, gains, autopilots, winds, manoeuvres and rates are drawn by the flight's number. The truth is that of
``sitl_scenarios.truth``: the controller, hold, rotors, body and delay, linearised. Rotors are as slow to gain speed as
to lose it, and manoeuvres are small, so that a linear truth exists. It takes about two minutes on two processors.

Usage: tools/validation/step_response.py [--flights N] [--first N] [--jobs N]
"""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import click
import numpy as np

from mavdem.alignment.signals import Signals
from mavdem.condition.condition import settled_parts
from mavdem.condition.loop.margins import Complex
from mavdem.condition.step_response import (
    StepResponse,
    attitude_response,
    rate_response,
    step_of,
)
from mavdem.dem.engine.linalg import Array
from mavdem.facts import Fact
from mavdem.ingest import read_log
from mavdem.paper.runner import write_log
from sitl_scenarios.files import scenario_of
from sitl_scenarios.gains import controller_for, cycle_of
from sitl_scenarios.simulation import fly
from sitl_scenarios.truth import truth

MANOEUVRES = (
    {"kind": "doublets", "amplitude": 3.0, "width": 0.233, "period": 2.0371},
    {"kind": "multisine", "sd": 2.0, "lowest": 0.2, "highest": 8.0},
    {"kind": "sticks", "sd": 3.0, "s": 0.1},
    {"kind": "chirp", "amplitude": 2.0, "lowest": 0.2, "highest": 8.0},
)


class Result(NamedTuple):
    """Of one loop of a flight: the share of the step inside its band, and overshoots, %."""

    inside: float
    measured: float
    true: float
    peak: float
    true_peak: float


def scenario(number: int) -> dict[str, object]:
    """Returns the flight of that number."""
    draw = np.random.default_rng([43, number])
    rate = float(draw.choice([100.0, 200.0]))
    lag = round(draw.uniform(0.02, 0.05), 3)
    gain = round(float(np.exp(draw.uniform(np.log(0.7), np.log(5.0)))), 2)
    model = str(draw.choice(["iris", "ardrone2"]))
    return {
        "seed": int(draw.integers(1 << 30)),
        "duration": 80.0,
        "vehicle": {"model": model, "rate_gain": gain, "lag_up": lag, "lag_down": lag},
        "wind": [{"kind": "dryden", "speed": round(draw.uniform(0.0, 5.0), 1)}],
        "moments": [{"sd": round(draw.uniform(0.0, 0.03), 3), "s": 0.08}],
        "excitation": MANOEUVRES[int(draw.integers(len(MANOEUVRES)))],
        "stream": {
            "autopilot": str(draw.choice(["px4", "ardupilot"])),
            "rate": rate,
            "rates": {"ATTITUDE_TARGET": rate},
        },
    }


def results(number: int) -> dict[str, Result | Fact]:
    """Flies the flight of that number, and measures roll."""
    flight = scenario_of(scenario(number))
    motion = fly(flight)
    known = truth(flight, motion)
    with TemporaryDirectory() as folder:
        write_log(path := Path(folder) / "flight.tlog", flight, motion)
        signals = Signals(read_log(path).vehicles[0])
    parts = settled_parts(signals)
    outer = known["roll_attitude_loop"]
    frequency = known["loop_frequency"]
    stiff = controller_for(flight, cycle_of(flight)).stiff[0]
    closed = {"rate": outer * 2j * np.pi * frequency / stiff, "attitude": outer / (1 + outer)}
    found = {"rate": rate_response(signals, parts), "attitude": attitude_response(signals, parts)}
    compare = partial(_compared, frequency)
    return {
        loop: one if isinstance(one, Fact) else compare(closed[loop], one)
        for loop, one in found.items()
    }


def _compared(frequency: Array, closed: Complex, measured: StepResponse) -> Result:
    step = step_of(frequency, closed, measured.time)
    inside = np.abs(step - measured.step) <= measured.step_half
    return Result(
        inside=float(inside.mean()),
        measured=100 * measured.overshoot.value,
        true=100 * (float(step.max()) - 1),
        peak=measured.peak.value,
        true_peak=float(np.abs(closed).max()),
    )


@click.command()
@click.option("--flights", default=20, help="How many.")
@click.option("--first", default=0, help="Number of the first.")
@click.option("--jobs", default=2, help="Processes.")
def main(flights: int, first: int, jobs: int) -> None:
    """Prints what was measured, and what is true."""
    numbers = range(first, first + flights)
    with ProcessPoolExecutor(jobs) as pool:
        found = list(pool.map(results, numbers))
    for loop in ("rate", "attitude"):
        known = []
        for number, one in zip(numbers, found, strict=True):
            result = one[loop]
            if isinstance(result, Fact):
                print(f"{loop} {number}: {result.code}")
                continue
            known.append(result)
            print(
                f"{loop} {number}: inside {100 * result.inside:.0f} %, overshoot {result.measured:.1f} % "
                f"(true {result.true:.1f}), peak {result.peak:.2f} (true {result.true_peak:.2f})"
            )
        errors = np.abs([one.measured - one.true for one in known])
        print(
            f"{loop}: {len(known)} of {flights} flights, inside {100 * np.mean([one.inside for one in known]):.0f} %, "
            f"overshoot off by {np.median(errors):.1f} points (median), {errors.max():.1f} at most"
        )


if __name__ == "__main__":
    main()
