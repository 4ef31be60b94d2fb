#!/usr/bin/env python
"""Predictions without motors of windows of flights, or forecasts with them, beside the joint VAR and trivial ones.

Windows, flights and halves are those of tools/bench/forecasts.py. A window is predicted in pieces of k steps, each from
all samples before it (k at 100 Hz; as long at other rates). Rows: the geometric mean over flights of the median error
over that of the constant mean; DEM's over another's; the flight on which it is worst beside the better of the last
sample and the mean; and the share of samples in the 90 % band, the first k after training, mean over flights.

With --known the motors are known, which the joint VAR takes for measurements (causal, 10 and 4 lags, ridge 0.01).

Usage: tools/bench/predictions.py [--known] [--rates] [--windows N] [--samples TRAIN TEST]
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import click
import numpy as np
from forecasts import HalvedFlight, flights, spread
from numpy.typing import NDArray

import mavdem
from mavdem import baselines, evaluate
from mavdem.dem.closed_loop.prediction import Prediction
from mavdem.dem.parallel import parallel_map
from mavdem.dem.record import Record
from mavdem.evaluate.flight_windows import Window, samples_in, windows

Array = NDArray[np.float64]

STEPS = (1, 5, 10, 25, 50, 150)  # at 100 Hz
NAMES = ("DEM", "joint VAR(10)", "joint VAR(4)", "hold last", "constant mean")


def of_window(window: Window, known: bool, samples: bool) -> tuple[Array, Array]:
    """Errors over the constant mean's (methods, horizons), and the share in DEM's band (horizons,)."""
    train, test = window.train, window.test
    others = (baselines.var(train, 10), baselines.var(train, 4), baselines.hold(train), baselines.constant_mean(train))
    steps = [each if samples else samples_in(each / 100, test.dt) for each in STEPS]
    every: tuple[Callable[..., Array], ...]
    if known:
        learned = mavdem.learn(train)
        every = (learned.forecast_every, *(other.forecast_every for other in others))
        ahead, half = learned.forecast(test.inputs), learned.forecast_band(test.inputs)
    else:
        found = Prediction.of(Record.of(train))
        every = (found.every, *(other.predict_every for other in others))
        ahead, half = found.after(found.past, len(test)), found.half_width(len(test), 0.9)
    errors = [
        [evaluate.skill(train, test, predict(k, test.inputs, test.outputs), k).relative for k in steps]
        for predict in every
    ]
    inside = np.abs(ahead - test.outputs) <= half
    return np.array(errors), np.array([inside[:k].mean() for k in steps])


class OfFlight(NamedTuple):
    """Medians over windows of the errors, the mean share in the band, and DEM's errors of all windows."""

    errors: Array  # (methods, horizons)
    inside: Array  # (horizons,)
    ours: Array  # (windows, horizons)


def of_flight(flight: HalvedFlight, most: int | None, known: bool, samples: tuple[int, int] | None) -> OfFlight | None:
    """``None`` for a flight without a window."""
    cut = spread(windows(flight.name, flight.flight, *(samples or ())), most)
    found = list(parallel_map(partial(of_window, known=known, samples=samples is not None), cut))
    if not found:
        return None
    errors, inside = (np.array(each) for each in zip(*found, strict=True))
    return OfFlight(np.median(errors, axis=0), np.mean(inside, axis=0), errors[:, 0])


def print_half(title: str, names: Sequence[str], found: Sequence[OfFlight]) -> None:
    errors, inside = (np.array(each) for each in list(zip(*found, strict=True))[:2])
    ours = np.concatenate([each.ours for each in found])
    over = {name: errors[:, 0] / errors[:, place] for place, name in enumerate(NAMES) if place}
    trivial = np.minimum(errors[:, 3], errors[:, 4])
    rows = {name: np.exp(np.log(errors[:, place]).mean(axis=0)) for place, name in enumerate(NAMES)}
    rows |= {f"DEM / {name}": np.exp(np.log(ratio).mean(axis=0)) for name, ratio in over.items()}
    rows |= {
        "worst flight / better of hold and mean": (errors[:, 0] / trivial).max(axis=0),
        "flights above 1.05 of that": (errors[:, 0] > 1.05 * trivial).sum(axis=0),
        "worst flight / joint VAR(10)": over[NAMES[1]].max(axis=0),
        "flights above 1.3 of that": (over[NAMES[1]] > 1.3).sum(axis=0),
        "windows worse than the mean, %": 100 * np.mean(ours > 1, axis=0),
        "worst window": ours.max(axis=0),
        "in the 90 % band": inside.mean(axis=0),
        "least of a flight": inside.min(axis=0),
    }
    print(f"\n| {title}: {len(names)} flights | {' | '.join(map(str, STEPS))} |")
    print("|---|" + "---|" * len(STEPS))
    for name, values in rows.items():
        print(f"| {name} | {' | '.join(f'{value:.3g}' for value in values)} |")


@click.command(help=__doc__)
@click.option("--known", is_flag=True, help="Forecasts with the motors known.")
@click.option(
    "--samples", nargs=2, type=click.IntRange(min=1), help="Of a window, and steps in samples.  [default: 7 s, 1.5 s]"
)
@click.option("--rates", is_flag=True, help="Also autopilots' logs, and scenarios at every rate.")
@click.option("--windows", "most", type=click.IntRange(min=1), help="Of each flight, evenly over it.  [default: all]")
def main(known: bool, samples: tuple[int, int] | None, rates: bool, most: int | None) -> None:
    halves: dict[str, list[tuple[str, OfFlight]]] = {"A": [], "B": []}
    for one in flights(rates):
        if (found := of_flight(one, most, known, samples)) is not None:
            halves["AB"[one.number % 2]].append((one.name, found))
    if not (halves["A"] and halves["B"]):
        sys.exit("There are too few recorded flights; name their folder in MAVDEM_SHARED_DATA.")
    for title, rows in (*halves.items(), ("both", halves["A"] + halves["B"])):
        names, found = zip(*rows, strict=True)
        print_half(title, names, found)


if __name__ == "__main__":
    main()
