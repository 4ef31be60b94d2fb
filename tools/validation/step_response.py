#!/usr/bin/env python
"""Step responses of the roll loops that are measured on simulated flights, compared with the true step responses.

Vehicles, gains, autopilots, winds, manoeuvres and rates are drawn by the flight's number. The true responses are from
``sitl_scenarios.truth``: the controller, hold, rotors, body and delay, linearised. The rate loop of roll is identified
too, as in a review: it shows a rate that is too fast for its messages. It takes about four minutes on two processors.
``--rate`` sends all messages at another rate, Hz; PX4 sends at most at the 250 Hz of its loop.

Usage: tools/validation/step_response.py [--flights N] [--first N] [--rate HZ] [--jobs N]
"""

from contextlib import suppress
from functools import partial

import numpy as np
from flights import (
    TABLES,
    Values,
    command,
    draw_values,
    evaluate_flights,
    print_table,
    scenario_from_values,
)
from numpy.random import default_rng

from mavdem.arrays import Array
from mavdem.assessment.axis.loops import loop_of_axis
from mavdem.assessment.flights import settled_flight
from mavdem.dataset.signals import Signals
from mavdem.errors import NotLearnable
from mavdem.facts import Fact
from mavdem.ingest.mavlink.vehicles import assemble
from mavdem.loops.axis_loops import Loop
from mavdem.loops.identified_step import step_from_frequency_response
from mavdem.loops.margins import Complex
from mavdem.loops.step_response import attitude_step_response, rate_step_response
from sitl_scenarios.mavlink.transmitter import recorded_stream
from sitl_scenarios.motion import Motion
from sitl_scenarios.parameter_controller import controller_for
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.simulation import fly
from sitl_scenarios.truth import truth

SEED = 43
"""Seed of the flights, together with their number; another seed draws other flights."""


def evaluate_flight(number: int, rate: float) -> list[Values]:
    """Simulates the flight of a number and compares its measured step responses of roll with the true ones.

    Args:
        number: number of the flight, from which everything that is random is drawn.
        rate: rate of the messages, Hz; 0 for the one that is drawn with the flight.

    Returns:
        A row for the rate loop and one for the attitude loop: "inside" is the percentage of times at which the 90 %
        interval contains the true step response, "at 0 s" the measured response at once; the measured "overshoot" and
        the "true" one are in percent of the step; "peak" and "true peak" are the largest gains over frequency. If a
        response cannot be measured, the row has the reason, "why not".
    """
    rng = default_rng([SEED, number])
    values = draw_values(TABLES["step_response"], rng) | {"seed": number}
    if rate:
        values["stream"]["rate"] = rate
    scenario = scenario_from_values(values, "ATTITUDE_TARGET")
    motion = fly(scenario)
    log = assemble(recorded_stream(scenario, motion))
    signals = Signals(log.vehicles[0])
    loop: Loop | None = None
    with suppress(NotLearnable):
        loop = loop_of_axis(signals, log)
    settled_segments = settled_flight(signals)
    frequency, true_responses = true_closed_loops(scenario, motion)
    measured_responses = {
        "rate": rate_step_response(signals, settled_segments, loop),
        "attitude": attitude_step_response(signals, settled_segments),
    }
    rows = []
    for name, measured in measured_responses.items():
        row = {"loop": name, "flight": number}
        if isinstance(measured, Fact):
            row["why not"] = measured.code.name
        else:
            true_response = true_responses[name]
            true_step = step_from_frequency_response(frequency, true_response, measured.time)
            is_inside = abs(true_step - measured.step) <= measured.step_half
            row["inside, %"] = 100 * is_inside.mean()
            row["at 0 s"] = measured.step[0]
            row["overshoot, %"] = 100 * measured.overshoot.value
            row["true"] = 100 * (true_step.max() - 1)
            row["peak"] = measured.peak.value
            row["true peak"] = abs(true_response).max()
        rows.append(row)
    return rows


def true_closed_loops(scenario: Scenario, motion: Motion) -> tuple[Array, dict[str, Complex]]:
    """Returns the true frequency responses of the closed loops of roll, from setpoint to rate or angle.

    The attitude controller commands a rate of K times the angle error. The open attitude loop is therefore
    L = K T / (iω), with the closed rate loop T; the closed attitude loop is L / (1 + L).

    Args:
        scenario: scenario of the simulated flight: vehicle, wind, excitation, sensors and faults.
        motion: true states, rotor speeds and motor outputs of that flight, cycle by cycle.

    Returns:
        Frequencies (F,), Hz, and the complex responses (F,) of the "rate" and of the "attitude" loop.
    """
    true_arrays = truth(scenario, motion)
    frequency = true_arrays["loop_frequency"]
    attitude_open_loop = true_arrays["roll_attitude_loop"]
    attitude_gain = controller_for(scenario).attitude_gains[0]
    rate_closed_loop = attitude_open_loop * 2j * np.pi * frequency / attitude_gain
    attitude_closed_loop = attitude_open_loop / (1 + attitude_open_loop)
    return frequency, {"rate": rate_closed_loop, "attitude": attitude_closed_loop}


@command(__doc__, flights=20, first=0, rate=0.0)
def main(flights: int, first: int, rate: float, jobs: int) -> None:
    """Prints a table of all flights for the rate and the attitude loop of roll, each with a summary below.

    The summary states how many responses were measured, the share of their times at which the 90 % interval contains
    the true response, and the errors of the overshoot in percentage points.

    Args:
        flights: number of simulated flights.
        first: number of the first one, which seeds it.
        rate: rate of the messages, Hz; 0 for the one that is drawn with each flight.
        jobs: number of processes.
    """
    evaluate = partial(evaluate_flight, rate=rate)
    all_rows = evaluate_flights(evaluate, range(first, first + flights), jobs)
    for loop, rows in all_rows.groupby("loop"):
        # Rows without a measured response have no true one either.
        measured_rows = rows.dropna(subset="true")
        overshoot_errors = (measured_rows["overshoot, %"] - measured_rows["true"]).abs()
        summary = (
            f"{len(measured_rows)} of {flights}: inside {measured_rows['inside, %'].mean():.0f} %, "
            f"overshoot off by {overshoot_errors.median():.1f} points (median), "
            f"{overshoot_errors.max():.1f} at most, {(overshoot_errors <= 3).sum()} within 3."
        )
        print_table(f"The {loop} of roll", rows.drop(columns="loop"), summary)


if __name__ == "__main__":
    main()
