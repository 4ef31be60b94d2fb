#!/usr/bin/env python
"""How much of the past to learn from: forecasts of 1.5 s by models of 7 s, of 70 s or all, and of the length chosen.

The end of the training data lies at several places of each recorded flight, 30 s into it or later. The error ratio is
over the mean of the last 7 s, for every model. Prints a row for each flight, and the geometric means of the halves.

Usage: tools/bench/lengths.py [--places N] [--flight NAME]...
"""

from __future__ import annotations

from time import process_time

import click
import numpy as np
from forecasts import flights

import mavdem
from mavdem.evaluate import relative_mspe, training_length
from mavdem.evaluate.flight_windows import TEST_SECONDS, TRAIN_SECONDS, samples_in
from mavdem.evaluate.hold_out import LENGTHS
from mavdem.flight import Flight

FIRST_SECONDS = 30.0


def ratios(flight: Flight, end: int) -> tuple[list[float], float, float]:
    """Error ratios of the usual length, the longest and the chosen one; that one, and the time to choose it, s."""
    usual, test = samples_in(TRAIN_SECONDS, flight.dt), samples_in(TEST_SECONDS, flight.dt)
    before, following = flight[:end], flight[end : end + test]
    began = process_time()
    chosen = training_length(before)
    seconds = process_time() - began
    found = []
    for length in (usual, min(samples_in(LENGTHS[-1], flight.dt), end), chosen):
        learned = mavdem.learn(before[-length:])
        found.append(float(relative_mspe(before[-usual:], following, learned.forecast(following.inputs))))
    return found, chosen * flight.dt, seconds


@click.command(help=__doc__)
@click.option("--places", type=click.IntRange(min=1), default=3, show_default=True, help="Of each flight.")
@click.option("--flight", "chosen", multiple=True, help="Only flights with names that begin so.")
def main(places: int, chosen: tuple[str, ...]) -> None:
    means: dict[str, list[np.ndarray]] = {"A": [], "B": []}
    print("| flight | half | Hz | 7 s | 70 s or all | chosen | lengths, s | s to choose |")
    print("|---|---|---|---|---|---|---|---|")
    for name, number, flight in flights(rates=False):
        first = samples_in(FIRST_SECONDS, flight.dt)
        last = len(flight) - samples_in(TEST_SECONDS, flight.dt)
        if last < first or (chosen and not name.startswith(chosen)):
            continue
        rows = [ratios(flight, end) for end in np.unique(np.linspace(first, last, places).astype(int))]
        mean = np.exp(np.log([row[0] for row in rows]).mean(axis=0))
        means["AB"[number % 2]].append(mean)
        cells = " | ".join(f"{value:.3g}" for value in mean)
        lengths, seconds = ", ".join(f"{row[1]:.0f}" for row in rows), np.mean([row[2] for row in rows])
        rate = f"{1 / flight.dt:.0f}"
        print(f"| {name} | {'AB'[number % 2]} | {rate} | {cells} | {lengths} | {seconds:.1f} |", flush=True)
    for half, own in means.items():
        if own:
            cells = " | ".join(f"{value:.3g}" for value in np.exp(np.log(own).mean(axis=0)))
            print(f"| **half {half}, {len(own)} flights** | {half} | | {cells} | | |")


if __name__ == "__main__":
    main()
