#!/usr/bin/env python
"""What each part of the method earns: forecasts with known motors without it, on windows of every recorded flight.

A window is 700 samples to learn from and 150 to forecast, as in the paper. The error ratio is the mean squared error of
forecasts of so many steps over the constant mean's; a table for each half of the flights has the geometric mean over
flights of the median over windows, the windows worse than the constant mean over all 150 steps, and the worst. With
--rates also scenarios flown at 200 and 400 Hz, on 7 s and 1.5 s.

Usage: tools/bench/parts.py [--windows N] [--rates] [--only PART]... [--json FILE]
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import click
import numpy as np
from forecasts import SCENARIOS, HalvedFlight, flights, simulated, spread
from rich.progress import track

import mavdem
from mavdem.dem.engine.linalg import Array
from mavdem.dem.engine.resumable import Resumable
from mavdem.dem.engine.state_space import StateSpace
from mavdem.evaluate import HORIZONS, skill_by_horizon
from mavdem.evaluate.flight_windows import Window, windows
from mavdem.paper.flights import HOP, SHARED, TEST, TRAIN

FAST_RATES = (200, 400)


def without_noise_model(predictor: StateSpace, *_: object) -> Resumable[StateSpace]:
    """The predictor as it is, in place of ``resumable_noise_model``."""
    yield
    return predictor


class Part(NamedTuple):
    """What a row leaves out or changes: settings, and functions of the package that others replace."""

    name: str
    settings: dict[str, Any]
    replaced: dict[str, Callable[..., Any]] = {}  # noqa: RUF012


PARTS = (
    Part("default", {}),
    Part("motors as causes alone: no closed loop", {"closed_loop": False}),
    Part("p = 1: no coordinates beyond the first derivative", {"p": 1, "d": 1}),
    Part("p = 1, derivatives from two samples", {"p": 1, "d": 1, "window": 2}),
    Part("p = 3", {"p": 3}),
    Part("white noise assumed", {"smoothness": 0.001}),
    Part("no hidden state", {"order": 2}),
    Part(
        "no mixer geometry", {}, {"mavdem.dem.forecast.simulation_error.mixer_priors": lambda _rotors, _directions: ()}
    ),
    Part("no noise model", {}, {"mavdem.dem.learning.resumable_noise_model": without_noise_model}),
    Part("no shrinkage", {"shrink_forecasts": False}),
    Part("no simulation-error fit", {"horizon": None}),
    Part("no simulation-error fit, p = 1", {"horizon": None, "p": 1, "d": 1}),
    Part("no simulation-error fit, white noise assumed", {"horizon": None, "smoothness": 0.001}),
)
"""A row each. Another part of the method is another line here."""


def ratios(window: Window, settings: mavdem.Settings) -> list[float]:
    """By horizon, the error ratio; 1 where nothing can be learnt."""
    try:
        learned = mavdem.learn(window.train, settings)
    except ValueError:
        return [1.0] * len(HORIZONS)
    steps = [min(k, len(window.test)) for k in HORIZONS] if window.train.dt > 1 / 125 else fast_steps(window)
    return [float(one.relative) for one in skill_by_horizon(learned, window.train, window.test, steps)]


def fast_steps(window: Window) -> list[int]:
    """As many steps as last as long as those of 100 Hz."""
    return [min(max(1, round(k / 100 / window.train.dt)), len(window.test)) for k in HORIZONS]


def every_flight(rates: bool) -> Iterator[tuple[HalvedFlight, tuple[Window, ...]]]:
    """Each flight with its windows."""
    for halved in flights(rates=False):
        yield halved, windows(halved.name, halved.flight, TRAIN, TEST, HOP)
    if rates:
        for number, name in enumerate(SCENARIOS):
            for rate in FAST_RATES:
                halved = HalvedFlight(f"{name} {rate} Hz", number, simulated(name, rate))
                yield halved, windows(halved.name, halved.flight)


def table(errors: dict[str, dict[str, Array]]) -> None:
    """Prints a row for each part, of the errors (windows, horizons) by part and flight."""
    steps = " | ".join(map(str, HORIZONS))
    print(f"| | {steps} | worse | worst | flights better than default |\n|---|{'---|' * (len(HORIZONS) + 3)}")
    default = {flight: np.median(own, axis=0) for flight, own in errors[PARTS[0].name].items()}
    for part, by_flight in errors.items():
        medians = np.array([np.median(own, axis=0) for own in by_flight.values()])
        means = " | ".join(f"{mean:.3g}" for mean in np.exp(np.log(medians).mean(axis=0)))
        last = np.concatenate([own[:, -1] for own in by_flight.values()])
        better = sum(np.median(own, axis=0)[-1] < default[flight][-1] for flight, own in by_flight.items())
        print(f"| {part} | {means} | {np.sum(last >= 1)} of {len(last)} | {last.max():.3g} | {better} |")


@click.command(help=__doc__)
@click.option("--windows", "most", type=click.IntRange(min=1), default=4, show_default=True, help="Of each flight.")
@click.option("--rates", is_flag=True, help="Also scenarios at 200 and 400 Hz.")
@click.option("--only", multiple=True, type=click.Choice([part.name for part in PARTS[1:]]), help="Only this part.")
@click.option("--json", "to", type=click.Path(path_type=Path), help="Also write every ratio there.")
def main(most: int, rates: bool, only: tuple[str, ...], to: Path | None) -> None:
    parts = [part for part in PARTS if not only or part.name in ("default", *only)]
    found: dict[str, dict[str, dict[str, Array]]] = {half: {part.name: {} for part in parts} for half in "AB"}
    jobs = [(halved, spread(cut, most)) for halved, cut in every_flight(rates) if cut]
    if not jobs:
        sys.exit(f"There are no recorded flights in {SHARED}; name their folder in MAVDEM_SHARED_DATA.")
    for (name, number, _), cut in track(jobs, description="Learning"):
        for part in parts:
            settings = replace(mavdem.Settings(), **part.settings)
            with ExitStack() as stack:
                for place, function in part.replaced.items():
                    stack.enter_context(patch(place, function))
                found["AB"[number % 2]][part.name][name] = np.array([ratios(one, settings) for one in cut])
    for half, errors in found.items():
        if errors[PARTS[0].name]:
            print(f"\nHalf {half}: {', '.join(errors[PARTS[0].name])}\n")
            table(errors)
    both = {part: found["A"][part] | found["B"][part] for part in found["A"]}
    print("\nAll flights:\n")
    table(both)
    if to:
        document = {part: {name: own.tolist() for name, own in flown.items()} for part, flown in both.items()}
        to.write_text(json.dumps(document, indent=1))


if __name__ == "__main__":
    main()
