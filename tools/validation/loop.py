#!/usr/bin/env python
"""Margins of simulated flights compared with their linearised loops, and recorded responses with predicted ones.

Vehicles, winds and steering are those of `physical.py`; gains and the delay of the sensors vary from flight to flight.
"Inside" is the share of 90 % intervals that hold the truth, of which the limits are 10 %, 6° and 1.5 dB.

Usage: tools/validation/loop.py [LOG]… [--seed N] [--every K]
"""

from __future__ import annotations

from pathlib import Path

import click
import numpy as np
from physical import cases, log, scenario, share, table

from mavdem.alignment import read_segments
from mavdem.condition.loop import Loop, loop_of
from mavdem.dem import NotIdentifiable, physical
from mavdem.dem.record import Record
from mavdem.errors import NotLearnable
from mavdem.paper.runner import logged
from sitl_scenarios.simulation import fly
from sitl_scenarios.truth import truth

LIMITS = {"crossover": 0.1, "phase_margin": 6.0, "gain_margin": 1.5, "ms": 0.1}
"""Of the error: Hz and Ms as a share of the truth, degrees and dB as they are; in the order of the truth's margins."""


def loop(record: Record) -> Loop:
    plant = physical(record)
    if isinstance(plant, NotIdentifiable):
        raise NotLearnable(plant.reason)
    return loop_of(plant, record)


def simulated(seed: int, every: int) -> None:
    """How far margins are from the truth, by status of the plant's effect and loop."""
    rng, rows = np.random.default_rng(seed), list[tuple[str, str, list[float], list[bool]]]()
    for number, case in enumerate(cases(seed, every), start=1):
        varied = case.varied | {"rate_gain": float(np.exp(rng.uniform(-0.5, 0.8)))}
        of = scenario(case._replace(varied=varied))
        of = of.model_copy(update={"sensors": of.sensors.model_copy(update={"delay": rng.uniform(0.002, 0.012)})})
        try:
            found, known = loop(Record.of(logged(of))), truth(of, fly(of))
        except (NotLearnable, ValueError) as reason:
            log(f"{number}: {case.vehicle}, {case.wind}, {case.steering}: {reason}")
            continue
        for name in ("rate", "attitude"):
            one, true = getattr(found, name), dict(zip(LIMITS, known[f"roll_{name}_margins"], strict=True))
            pairs = {figure: (getattr(one, figure), getattr(one, f"{figure}_interval")) for figure in LIMITS}
            shares = [true[figure] if figure in ("crossover", "ms") else 1.0 for figure in LIMITS]
            off = [(pairs[figure][0] - true[figure]) / unit for figure, unit in zip(LIMITS, shares, strict=True)]
            inside = [pairs[figure][1][0] <= true[figure] <= pairs[figure][1][1] for figure in LIMITS]
            rows.append((found.plant.status["effect"], name, off, inside))
    for status in ("reported", "biased"):
        for name in ("rate", "attitude"):
            some = [row for row in rows if row[:2] == (status, name)]
            errors = np.array([row[2] for row in some]).reshape(-1, len(LIMITS))
            body = [
                [figure, f"{np.median(column):+.2g}", share(np.abs(column) < limit), share(row[3][at] for row in some)]
                for at, ((figure, limit), column) in enumerate(zip(LIMITS.items(), errors.T, strict=True))
                if len(some)
            ]
            table(
                f"**{name} loop**, effect {status}, {len(some)} flights", ["", "median error", "within", "inside"], body
            )


def recorded(paths: tuple[Path, ...]) -> None:
    """Fit and agreement of the measured response."""
    rows = []
    for path in paths:
        try:
            found = loop(Record.of(read_segments(path)))
            seen = found.measured
            shown = [f"{seen.band[1]:.1f}", f"{seen.fit:.0f}", f"{seen.agreement:.0f}"] if seen else ["", "", ""]
            rows.append([path.name, f"{found.phase_margin:.0f}", f"{found.gain_margin:.1f}", *shown, str(found.agrees)])
        except NotLearnable as reason:
            log(f"{path.name}: {reason}")
    table(
        "**Recorded**", ["log", "phase margin, °", "gain margin, dB", "to Hz", "fit, %", "agreement, %", "agrees"], rows
    )


@click.command(help=__doc__)
@click.argument("logs", nargs=-1, type=click.Path(path_type=Path, exists=True))
@click.option("--seed", default=0, show_default=True, help="Of the simulated flights.")
@click.option("--every", default=3, show_default=True, help="One of so many of these, drawn by seed.")
def main(logs: tuple[Path, ...], seed: int, every: int) -> None:
    recorded(logs) if logs else simulated(seed, every)


if __name__ == "__main__":
    main()
