#!/usr/bin/env python
"""Controller gains by mavdem, AutoTune and QuickTune, judged by the stability margins that true, simulated plants have.

mavdem advises gains in steps, one for each later flight (``mavdem tune --more``), always by the plant that was
identified from the first flight. The goal is the margins that --margins names, in the rate and the attitude loop of the
true plant.

The table has a row for each tuner and autopilot. "refused" is the number of loops for which mavdem gives no advice;
they do not count further. "met before" and "met" are the numbers of loops that meet the goal before and after tuning,
the columns with a factor those that meet it with so many times the control effectiveness: 1.44 times is 20 % more
voltage. The other columns are medians: the bandwidth of the rate loop and the lean in the flight's wind relative to
those before, the largest sensitivity Ms of the rate loop, and the flights after which the goal is first met.

Usage: tools/validation/advice.py [--half NAME] [--rate HZ of the messages] [--margins NAME] [--flights N] [--jobs N]
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import click
import numpy as np
import pandas as pd
from autopilot_tuners import autotune, quicktune
from flights import Values, command, evaluate_flights, print_table
from loops import CACHE, HALF, HALVES, AxisPlant, identified_loops, simulated_log

from mavdem.assessment.record import NoLoop
from mavdem.ingest.telemetry import Parameters
from mavdem.loops.advice import advise
from mavdem.loops.axis_loops import MARGIN_TARGETS, Loop, MarginTarget, margin_scores
from mavdem.loops.gain_design import bandwidth_of_estimate
from mavdem.loops.margins import FrequencyGrid
from mavdem.plant.parameters import ESTIMATE

EFFECTIVENESS_FACTORS = {"met": 1.0, "0.8 times": 0.8, "1.2 times": 1.2, "1.44 times": 1.44}
"""Factors on the control effectiveness with which final gains are judged, by column: voltage and load change it."""

MAX_FLIGHTS = 6
"""Most flights with gains of mavdem. An autopilot's tuner flies once."""

TUNER_GRID = FrequencyGrid(0.05, 60.0, 150)
"""Frequencies with which the autopilot's tuners are simulated: coarser than the result's, for speed."""

MEDIANS = ["bandwidth", "Ms", "lean", "flights"]
"""Columns with medians."""


def true_loop(loop: Loop, plant: AxisPlant, factor: float = 1.0) -> Loop:
    """Returns the loops of the true plant, with the controller and the wind of an identified loop.

    Args:
        loop: identified loop of the axis.
        plant: control effectiveness, damping, lag and delay of the simulated axis.
        factor: factor on its control effectiveness, as by more or less voltage.
    """
    effectiveness = np.array([factor * plant.effect])
    dynamics = np.array([[plant.damping, plant.lag, plant.delay]])
    return replace(loop, effectiveness=effectiveness, dynamics=dynamics)


def meets(loop: Loop, target: MarginTarget) -> bool:
    """Returns whether the rate and the attitude loop of an axis both have the margins of a target."""
    return bool(margin_scores(target, loop.rate, loop.attitude)[ESTIMATE] >= 1)


def advised_gains(loop: Loop, margins: str) -> Iterator[Parameters]:
    """Yields the gains that mavdem advises after one flight after the other; nothing if it refuses to advise.

    mavdem changes a gain by a limited factor in one flight, so that several are needed. No later flight is simulated:
    the plant that the first one identified is used with the changed gains.

    Args:
        loop: loop of the axis, as identified from the first flight.
        margins: name of the stability margins that are the goal, a key of ``MARGIN_TARGETS``.

    Yields:
        All parameters that have been changed so far, by name, after each flight. The last two are equal where nothing
        is left to change within ``MAX_FLIGHTS``.
    """
    gains: Parameters = {}
    loop_with_gains = loop
    for _ in range(MAX_FLIGHTS):
        advice = advise(loop_with_gains, margins, raises_sound_gains=True)
        if advice.refusals:
            return
        gains = {**gains, **advice.parameters}
        yield gains
        if not advice.parameters:
            return
        loop_with_gains = loop.with_parameters(gains)


def evaluate_gains(
    loop: Loop, plant: AxisPlant, gains_by_flight: Sequence[Parameters], target: MarginTarget
) -> Values:
    """Judges the gains with which a tuner ends, by the loops that they give with the true plant.

    Args:
        loop: identified loop of the axis, with its controller and the wind.
        plant: control effectiveness, damping, lag and delay of the simulated axis.
        gains_by_flight: gains after each flight of the tuner: all parameters that it has changed so far, none if it
            leaves the gains as they are. The sequence is empty if the tuner refuses to tune.
        target: stability margins that are the goal.

    Returns:
        Values by column: "refused", whether the tuner refused, and "met before", whether the loop meets the target with
        the logged gains. Only if the tuner did not refuse, also:

        - The columns of ``EFFECTIVENESS_FACTORS``: whether the final gains meet the target where the plant's control
          effectiveness is multiplied by that factor.
        - "flights": number of flights until the target is first met; missing if it was met before, or never is.
        - "bandwidth" of the rate loop and "lean" in wind, relative to the values with the logged gains.
        - "Ms": largest sensitivity of the rate loop with the final gains.
    """
    loop_before = true_loop(loop, plant)
    row: Values = {"met before": meets(loop_before, target), "refused": not gains_by_flight}
    if not gains_by_flight:
        return row
    loops_by_flight = [
        loop_before.with_parameters(gains) if gains else loop_before for gains in gains_by_flight
    ]
    if not row["met before"]:
        for number, loop_after in enumerate(loops_by_flight, start=1):
            if meets(loop_after, target):
                row["flights"] = number
                break
    final_loop = loops_by_flight[-1]
    for name, factor in EFFECTIVENESS_FACTORS.items():
        row[name] = meets(true_loop(final_loop, plant, factor), target)
    bandwidth_before = bandwidth_of_estimate(loop_before.rate)
    row["bandwidth"] = bandwidth_of_estimate(final_loop.rate) / bandwidth_before
    row["Ms"] = final_loop.rate.ms
    row["lean"] = final_loop.lean_in_wind / loop_before.lean_in_wind
    return row


def evaluate_loop(loop: Loop, plant: AxisPlant, margins: str) -> list[Values]:
    """Tunes one axis with mavdem, AutoTune and QuickTune, and returns a row for each, as :func:`evaluate_gains` does.

    Args:
        loop: identified loop of the axis, from which mavdem advises gains.
        plant: the true plant, which the autopilot's tuners fly and which judges all gains.
        margins: name of the stability margins that are the goal, a key of ``MARGIN_TARGETS``.

    Returns:
        One row for each tuner.
    """
    target = MARGIN_TARGETS[margins]
    flown_loop = replace(true_loop(loop, plant), grid=TUNER_GRID)
    # The autopilot's tuners end in one flight.
    gains_by_tuner = {
        "mavdem": list(advised_gains(loop, margins)),
        "AutoTune": [autotune(flown_loop)],
        "QuickTune": [quicktune(flown_loop)],
    }
    autopilot = "ArduPilot" if loop.controller.is_ardupilot else "PX4"
    rows = []
    for tuner, gains_by_flight in gains_by_tuner.items():
        row = {"tuner": tuner, "autopilot": autopilot, "axis": loop.axis}
        rows.append(row | evaluate_gains(loop, plant, gains_by_flight, target))
    return rows


def evaluate_flight(seed: int, rate: float, margins: str, cache: Path) -> list[Values]:
    """Simulates a flight, and tunes each axis whose loop is identified from its log by mavdem and the two tuners.

    Args:
        seed: seed of the flight.
        rate: rate of the messages, Hz.
        margins: name of the stability margins that are the goal, a key of ``MARGIN_TARGETS``.
        cache: folder with the simulated flights.

    Returns:
        The rows of :func:`evaluate_loop` for all of these axes.
    """
    log, true_figures = simulated_log(seed, cache)
    rows = []
    for axis, loop in identified_loops(log, rate).items():
        if isinstance(loop, NoLoop):
            continue
        plant = AxisPlant.from_figures(true_figures[axis])
        rows += evaluate_loop(loop, plant, margins)
    return rows


def summary_by_tuner(rows: pd.DataFrame) -> pd.DataFrame:
    """Summarises tuned loops by tuner and autopilot, and by tuner for both autopilots together.

    Args:
        rows: rows of :func:`evaluate_loop`, one for each tuner and loop.

    Returns:
        The table: number of loops, how many of them the tuner refuses and meet the goal before and after, and medians
        of the columns ``MEDIANS``.
    """
    with_both_autopilots = pd.concat([rows, rows.assign(autopilot="both")])
    rows_by_tuner = with_both_autopilots.groupby(["tuner", "autopilot"], sort=False)
    counted_columns = ["refused", "met before", *EFFECTIVENESS_FACTORS]
    table = rows_by_tuner[counted_columns].sum().astype(int)
    table.insert(0, "loops", rows_by_tuner.size())
    table[MEDIANS] = rows_by_tuner[MEDIANS].median()
    return table.reset_index()


@command(__doc__, rate=100.0, flights=24)
@click.option(
    "--margins", type=click.Choice(list(MARGIN_TARGETS)), default="default", show_default=True
)
@HALF
@CACHE
def main(half: str, rate: float, margins: str, flights: int, cache: Path, jobs: int) -> None:
    """Prints a row for each tuner and autopilot: how many loops meet the goal, and how the loops have changed.

    Args:
        half: name of the set of flights, a key of ``HALVES``: "choose" to choose methods on, "report" for results.
        rate: rate of the messages, Hz.
        margins: name of the stability margins that are the goal, a key of ``MARGIN_TARGETS``.
        flights: number of simulated flights.
        cache: folder that keeps the simulated flights.
        jobs: number of processes.
    """
    evaluate = partial(evaluate_flight, rate=rate, margins=margins, cache=cache)
    rows = evaluate_flights(evaluate, HALVES[half][:flights], jobs)
    print_table(f"Half {half}, {rate:g} Hz, margins {margins}", summary_by_tuner(rows))


if __name__ == "__main__":
    main()
