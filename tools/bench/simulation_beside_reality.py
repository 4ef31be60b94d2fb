#!/usr/bin/env python
"""Figures of simulated flights beside those of recorded ones; prints a table.

Usage: tools/bench/simulation_beside_reality.py [--windows N]

The simulated are what the autopilot knows and puts out, at the scenario's rate and without a link. Roll motors are
(left − right)/4 of the motors, µs; those of the real AR.Drone, whose PWM ends at 255, are brought to µs. The frequency
is where the roll rate has most power. The ratio is the median over windows of 700 samples learnt from and 150 forecast,
as in the README: below 1 is better than the constant mean.
"""

from __future__ import annotations

from collections.abc import Iterator

import click
import numpy as np
from flights import HOP, SHARED, TEST, TRAIN, recorded_flights
from scipy.signal import welch

import mavdem
from mavdem import evaluate
from mavdem.windows import windows
from sitl_scenarios.attitude import euler
from sitl_scenarios.files import load, names
from sitl_scenarios.frames import PAPER_ORDER
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.simulation import fly

SLOWEST = 40.0
"""Hz: scenarios that send slower are there to be refused."""

AFTER_CLIMB = 3.0
"""Seconds of hover that are left out."""

ROLL = np.array([-1.0, 1.0, 1.0, -1.0]) / 4


def simulated_flight(scenario: Scenario) -> mavdem.Flight:
    """Angle and rate of roll as the autopilot knows them, and its motors, in the settled hover."""
    motion = fly(scenario)
    hover = motion.landed_state == 2
    first, last = motion.time[hover][0] + AFTER_CLIMB, motion.time[hover][-1]
    time = np.arange(round(first * scenario.stream.rate), int(last * scenario.stream.rate)) / scenario.stream.rate
    roll = np.array([euler(attitude)[0] for attitude in motion.known_attitude.tolist()])
    columns = [np.interp(time, motion.time, column) for column in (roll, motion.known_rates[:, 0])]
    motors = [np.interp(time, motion.time, column) for column in motion.outputs.T]
    return mavdem.Flight(time, np.column_stack(motors), np.column_stack(columns), dt=1 / scenario.stream.rate)


def everything() -> Iterator[tuple[str, mavdem.Flight]]:
    for name, flight in recorded_flights():
        if name == "ardrone_tudelft":
            motors = 1000 + flight.inputs[:, np.argsort(PAPER_ORDER)] / 0.255
            flight = mavdem.Flight(flight.time, motors, flight.outputs, dt=flight.dt)
        yield f"*{name}*", flight
    for name in names():
        scenario = load(name)
        if scenario.stream.rate >= SLOWEST:
            yield name, simulated_flight(scenario)


def ratio(name: str, flight: mavdem.Flight, most: int) -> float:
    cut = windows(name, flight, TRAIN, TEST, HOP)
    cut = [cut[i] for i in np.unique(np.linspace(0, len(cut) - 1, most).astype(int))]
    learned = mavdem.learn_many([(window.train, mavdem.Settings()) for window in cut])
    ratios = [
        np.nan
        if isinstance(found, ValueError)
        else evaluate.relative_mspe(window.train, window.test, found.forecast(window.test.inputs))
        for window, found in zip(cut, learned, strict=True)
    ]
    return float(np.median(ratios))


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
