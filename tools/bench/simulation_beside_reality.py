#!/usr/bin/env python
"""Statistics of simulated and of recorded flights; prints a table.

Usage: tools/bench/simulation_beside_reality.py [--windows N]

Simulated flights hold the autopilot's estimates and outputs at the scenario's rate, without a link. Roll motors are
(left − right)/4 of the motors, µs; the PWM of the real AR.Drone, 0 to 255, is converted to µs. The frequency
is that of the largest power of the roll rate. The ratio is the median over windows of 700 training and 150 test
samples of the forecast error over that of the constant mean.
"""

from __future__ import annotations

from collections.abc import Iterator

import click
import numpy as np
from forecasts import error_ratio, spread
from scipy.signal import welch

import mavdem
from mavdem.evaluate.flight_windows import windows
from mavdem.paper.flights import HOP, REAL, SHARED, TEST, TRAIN, hover, recorded_flights
from sitl_scenarios.files import load, names
from sitl_scenarios.mixer import PAPER_ORDER
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.simulation import fly

MIN_RATE_HZ = 40.0  # slower scenarios exist to be refused

ROLL = np.array([-1.0, 1.0, 1.0, -1.0]) / 4


def roll_flight(scenario: Scenario) -> mavdem.Flight:
    """The settled hover with roll and roll rate as outputs."""
    flight = hover(scenario, fly(scenario))
    return mavdem.Flight(flight.time, flight.inputs, flight.outputs[:, 2:], dt=flight.dt)


def everything() -> Iterator[tuple[str, mavdem.Flight]]:
    for name, flight in recorded_flights():
        if name == REAL:
            motors = 1000 + flight.inputs[:, np.argsort(PAPER_ORDER)] / 0.255
            flight = mavdem.Flight(flight.time, motors, flight.outputs, dt=flight.dt)
        yield f"*{name}*", flight
    for name in names():
        scenario = load(name)
        if scenario.stream.rate >= MIN_RATE_HZ:
            yield name, roll_flight(scenario)


def ratio(name: str, flight: mavdem.Flight, most: int) -> float:
    cut = spread(windows(name, flight, TRAIN, TEST, HOP), most)
    found = mavdem.learn_many([(window.train, mavdem.Settings()) for window in cut])
    return float(np.median([error_ratio(*pair) for pair in zip(cut, found, strict=True)]))


@click.command(help=__doc__)
@click.option("--windows", "most", default=5, show_default=True, type=click.IntRange(min=1), help="Of each flight.")
def main(most: int) -> None:
    if not SHARED.exists():
        click.echo(f"There are no recorded flights in {SHARED}; name their folder in MAVDEM_SHARED_DATA.", err=True)
    print("| flight (*recorded*) | roll sd, ° | rate sd, °/s | frequency, Hz | roll motors sd, µs | ratio |")
    print("|---|---|---|---|---|---|")
    for name, flight in everything():
        roll, rate = np.degrees(flight.outputs).std(axis=0)
        frequencies, power = welch(flight.outputs[:, 1], 1 / flight.dt, nperseg=min(1024, len(flight)))
        print(
            f"| {name} | {roll:.2f} | {rate:.1f} | {frequencies[power.argmax()]:.1f} "
            f"| {(flight.inputs @ ROLL).std():.1f} | {ratio(name, flight, most):.2g} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
