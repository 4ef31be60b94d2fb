#!/usr/bin/env python
"""Cautions about inputs: on how many windows of sound flights each is given, and on how many that were spoilt.

Sound windows are 7 s of every recorded flight and of scenarios at every rate, in halves A and B. Real events are among
them: a motor that fails, jumps of the wind. Spoilt windows: every motor clipped at a quantile of its own; the second
half from another flight with the motors in the same unit, of the same vehicle or of another.

Usage: tools/validation/input_cautions.py [--rates]
"""

from __future__ import annotations

import sys
from collections import Counter
from itertools import permutations
from pathlib import Path

import click
import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "bench"))

from forecasts import RATES, SCENARIOS, HalvedFlight, flights, simulated  # noqa: E402

from mavdem.dem.closed_loop.inputs import input_cautions  # noqa: E402
from mavdem.dem.record import Record  # noqa: E402
from mavdem.evaluate.flight_windows import TRAIN_SECONDS, samples_in  # noqa: E402
from mavdem.flight import Flight  # noqa: E402

KINDS = ("hardly moves", "both signs", "demand,", "saturated", "usual level", "another way")
MOTORS = 4


def kinds(flight: Flight) -> list[str]:
    """Which cautions a window has; none where an input is constant, which is refused."""
    if not flight.inputs.std(axis=0).all():
        return []
    found = input_cautions(Record.of(flight))
    return [kind for kind in KINDS if any(kind in caution for caution in found)]


def cut(flight: Flight) -> list[Flight]:
    size = samples_in(TRAIN_SECONDS, flight.dt)
    return [flight[start : start + size] for start in range(0, len(flight) - size + 1, size)]


def clipped(flight: Flight, quantile: float) -> Flight:
    return Flight(
        flight.time,
        np.minimum(flight.inputs, np.quantile(flight.inputs, quantile, axis=0)),
        flight.outputs,
        dt=flight.dt,
    )


def spliced(first: Flight, second: Flight) -> Flight:
    """The first half of one window and the second of another."""
    half = len(first) // 2
    inputs, outputs = (
        np.vstack([one[:half], other[half:]])
        for one, other in ((first.inputs, second.inputs), (first.outputs, second.outputs))
    )
    return Flight(first.time, inputs, outputs, dt=first.dt)


def vehicle(name: str) -> str:
    """Which of the simulated vehicles flew: those of one autopilot are alike, but for one with another inertia."""
    return name.split("_")[0] + ("_inertia" if "inertia" in name else "")


@click.command(help=__doc__)
@click.option("--rates", is_flag=True, help="Also scenarios at every rate; takes minutes.")
def main(rates: bool) -> None:
    sound = list(flights(rates=False))
    if rates:
        sound += [HalvedFlight(name, i, simulated(name, rate)) for i, name in enumerate(SCENARIOS) for rate in RATES]
    print(f"| windows | | {' | '.join(KINDS)} |\n|---|---|{'---|' * len(KINDS)}")

    def row(title: str, given: list[Flight]) -> None:
        counts = Counter(kind for one in given for kind in kinds(one))
        print(f"| {title} | {len(given)} | {' | '.join(str(counts[kind]) for kind in KINDS)} |", flush=True)

    for half in (0, 1):
        row(f"half {'AB'[half]}", [one for flown in sound if flown.number % 2 == half for one in cut(flown.flight)])
    motors = [flown for flown in sound if flown.flight.inputs.shape[1] == MOTORS]
    for quantile in (0.8, 0.9, 0.95):
        row(f"clipped at {quantile}", [clipped(one, quantile) for flown in motors for one in cut(flown.flight)[::3]])
    alike = [flown for flown in motors if abs(1 / flown.flight.dt - 100) < 1]
    pairs = [(a, b) for a, b in permutations(alike, 2) if len(cut(a.flight)) and len(cut(b.flight))]
    for title, same in (("spliced, same vehicle", True), ("spliced, another vehicle", False)):
        chosen = [(a, b) for a, b in pairs if (vehicle(a.name) == vehicle(b.name)) == same]
        row(title, [spliced(a.flight[500:1200], b.flight[500:1200]) for a, b in chosen])


if __name__ == "__main__":
    main()
