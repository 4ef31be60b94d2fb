#!/usr/bin/env python
"""Step responses measured on simulated flights, beside those of the true closed loops; prints a row for each flight.

Vehicles, gains, autopilots, winds, manoeuvres and rates are drawn by the flight's number. The truth is that of
``sitl_scenarios.truth``: the controller, hold, rotors, body and delay, linearised. It takes about two minutes on two
processors.

Usage: tools/validation/step_response.py [--flights N] [--first N] [--jobs N]
"""

import numpy as np
from flights import TABLES, Values, command, drawn, flight_of, rows_of, show, telemetry_of
from numpy.random import default_rng

from mavdem.assessment.flights import settled_flight
from mavdem.dataset.signals import Signals
from mavdem.facts import Fact
from mavdem.loops.step_response import (
    attitude_step_response,
    rate_step_response,
    step_from_frequency_response,
)
from sitl_scenarios.parameter_controller import controller_for
from sitl_scenarios.simulation import fly
from sitl_scenarios.truth import truth


def judged(number: int) -> list[Values]:
    """A row of the rate and one of the attitude loop of roll, in the flight of that number."""
    rng = default_rng([43, number])
    values = drawn(TABLES["step_response"], rng) | {"seed": number}
    flight = flight_of(values, "ATTITUDE_TARGET")
    motion = fly(flight)
    truths = truth(flight, motion)
    signals = Signals(telemetry_of(flight, motion))
    parts = settled_flight(signals)
    outer = truths["roll_attitude_loop"]
    frequency = truths["loop_frequency"]
    stiff = controller_for(flight).attitude_gains[0]
    rate = outer * 2j * np.pi * frequency / stiff
    closed = {"rate": rate, "attitude": outer / (1 + outer)}
    responses = {
        "rate": rate_step_response(signals, parts),
        "attitude": attitude_step_response(signals, parts),
    }
    rows = []
    for loop, measured in responses.items():
        row = {"loop": loop, "flight": number}
        if isinstance(measured, Fact):
            row["why not"] = measured.code.name
        else:
            step = step_from_frequency_response(frequency, closed[loop], measured.time)
            held = abs(step - measured.step) <= measured.step_half
            overshoot = 100 * measured.overshoot.value
            row |= {"inside, %": 100 * held.mean(), "overshoot, %": overshoot}
            row |= {"true": 100 * (step.max() - 1), "peak": measured.peak.value}
            row["true peak"] = abs(closed[loop]).max()
        rows.append(row)
    return rows


@command(__doc__, flights=20, first=0)
def main(flights: int, first: int, jobs: int) -> None:
    every = rows_of(judged, range(first, first + flights), jobs)
    for loop, rows in every.groupby("loop"):
        rated = rows.dropna(subset="true")
        errors = rated["overshoot, %"] - rated["true"]
        off = errors.abs()
        inside = f"inside {rated['inside, %'].mean():.0f} %"
        points = f"{off.median():.1f} points (median), {off.max():.1f} at most"
        within = f"{(off <= 3).sum()} within 3"
        under = f"{len(rated)} of {flights}: {inside}, overshoot off by {points}, {within}."
        show(f"The {loop} of roll", rows.drop(columns="loop"), under)


if __name__ == "__main__":
    main()
