#!/usr/bin/env python
"""How rightly the cause of a surprise is named in simulated flights, and how often falsely; prints two tables.

In three kinds of flights the pilot or the autopilot flies fast manoeuvres in light wind; in three others a gust comes,
a motor loses thrust, or a load shifts. The first table has the causes at the largest surprise of each event: a
disturbance in the six seconds after it began, a manoeuvre in each six seconds that tilt the vehicle by more than 8°.
The model is learned from the 15 s before. A manoeuvre that is called a disturbance is false, and so is a disturbance
that is called a model misfit. In fast legs both may be right: the airspeed turns the vehicle as a gust does. The
constants of ``surprise_cause.py`` were chosen on the half of even numbers.

With --marks the flights are given to the online learner sample by sample, and the second table has its marks.

A flight takes some five seconds to simulate, and with --marks ten to learn: logs of the flights are kept in --folder,
and not flown again.

Usage: tools/validation/surprise.py [--flights N of each kind] [--jobs N] [--folder FOLDER] [--marks]
"""

from functools import partial
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np
import pandas as pd
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

from mavdem import Flight, OnlineLearner, learn, read_segments
from mavdem.dem.fitting import generalized_data
from mavdem.dem.online.free_energy_monitor import Surprise
from mavdem.dem.online.surprise_cause import (
    cause_of_surprise,
    explained_share,
    sustained_share,
)
from mavdem.dem.record import Record
from mavdem.facts.online import SurpriseCause
from mavdem.files import atomic_write
from mavdem.ingest.tlog import write_tlog
from sitl_scenarios.mavlink.transmitter import recorded
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.simulation import fly

SURPRISE: Values = TABLES["surprise"]
"""What the flights are drawn from: values of all flights, and of each kind."""

KINDS: Values = SURPRISE["kinds"]

ARMING = 2.0
"""Seconds from the beginning of a recording to the arming, from which scenarios count."""

EVENT_SECONDS = 6.0
"""Time after the beginning of an event in which its largest surprise is looked for, s."""

MARK_SECONDS = 15.0
"""Time after the beginning of a disturbance in which a mark belongs to it, s."""

FIRST_SECONDS = 15.0
"""Time before an event from which its model is learned, s."""

MANOEUVRE_TILT = np.radians(8.0)
"""Deviation of the angle from its median, rad, that light wind does not cause: a choice."""

EVIDENCE_STEP = 0.01
"""Weight of a sample in the average of log(1 + surprise): as of the learner's marks at 100 Hz."""


class FlightPlan(NamedTuple):
    """A simulated flight."""

    scenario: Scenario
    """What is flown."""

    disturbance_start: float | None
    """When the disturbance begins, s of the recording; None of a flight of manoeuvres."""


class Mark(NamedTuple):
    """A marked sample of a stream."""

    time: float
    """Time of the sample, s."""

    cause: SurpriseCause | None
    """What the learner names as its cause."""


def flight_plan(kind: str, number: int) -> FlightPlan:
    """Returns the flight of a kind and number."""
    rng = default_rng([list(KINDS).index(kind), number, 70])
    values = draw_values(SURPRISE["flight"], rng) | {"seed": number}
    drawn = draw_values(KINDS[kind], rng)
    start = None
    gust = drawn.pop("gust", None)
    weak = drawn.pop("weak", None)
    if gust is not None:
        start = gust["start"]
        values["wind"] = [*values["wind"], gust]
    if weak is not None:
        start = weak["start"]
        values["vehicle"] |= {
            "weak_motor": int(rng.integers(4)) + 1,
            "weak_from": start,
            "weak_thrust": weak["thrust"],
        }
    if "load" in drawn:
        start = drawn["load"]["start"]
    loop_rate = SURPRISE["loop_rates"][values["stream"]["autopilot"]]
    values["vehicle"]["parameters"] = {loop_rate: 200.0}
    scenario = scenario_from_values(values | drawn, "SERVO_OUTPUT_RAW")
    return FlightPlan(scenario, None if start is None else start + ARMING)


def flown_segments(plan: FlightPlan, path: Path) -> list[Flight]:
    """Returns the settled segments of a flight, which is flown unless its log is kept already."""
    if not path.exists():
        with atomic_write(path) as file:
            write_tlog(file, recorded(plan.scenario, fly(plan.scenario)))
    return list(read_segments(path))


def event_starts(flight: Flight, disturbance_start: float | None) -> list[float]:
    """Returns when the events of a segment begin, s: its disturbance, or each six seconds with a manoeuvre."""
    if disturbance_start is not None:
        return [disturbance_start]
    tilt = abs(flight.outputs[:, 0] - np.median(flight.outputs[:, 0]))
    starts = []
    first = flight.time[0] + FIRST_SECONDS
    for start in np.arange(first, flight.time[-1] - EVENT_SECONDS, EVENT_SECONDS):
        is_in_event = (flight.time >= start) & (flight.time < start + EVENT_SECONDS)
        if tilt[is_in_event].max(initial=0.0) > MANOEUVRE_TILT:
            starts.append(float(start))
    return starts


def learner_marks(flight: Flight) -> list[Mark]:
    """Gives a segment to the online learner, and returns its marks in the order of time."""
    learner = OnlineLearner(
        dt=flight.dt,
        n_inputs=flight.inputs.shape[1],
        effect_directions=flight.effect_directions,
    )
    # The wind torque and the physical parameters play no part, and take most of the time.
    learner.follows_torque = False
    learner.fits_physical = False
    marks = []
    for sample, time in enumerate(flight.time):
        estimate = learner.update(time, flight.outputs[sample], flight.inputs[sample])
        if estimate.unusual and estimate.latest_mark is not None:
            marks.append(Mark(time, estimate.latest_mark.cause))
    return marks


def event_row(flight: Flight, start: float) -> Values | None:
    """Returns the row of an event: the cause at its largest surprise by the model of the time before.

    Args:
        flight: the segment.
        start: when the event begins, s.

    Returns:
        The row; None where too little was flown before the event, or after its beginning.
    """
    first = int(np.searchsorted(flight.time, start - FIRST_SECONDS))
    begin = int(np.searchsorted(flight.time, start))
    end = begin + round(EVENT_SECONDS / flight.dt)
    is_whole = flight.time[0] <= start - FIRST_SECONDS and end <= len(flight)
    if not is_whole or flight.effect_directions is None:
        return None
    learned = learn(flight[first:begin])
    assert learned.sample_free_energy is not None
    event = Record.from_flights(flight[first:end])
    data = np.concatenate(generalized_data(learned.settings, learned.scaling, event))
    free_energy = learned.sample_free_energy.evaluate(data)
    # Surprise as of the learner, by the past before the event, and its average as of the marks.
    training_count = len(learned.free_energy_of_samples)
    surprise = Surprise(flight.dt, free_energy[:training_count])
    evidence = 0.0
    largest_evidence = 0.0
    largest_sample = begin
    for number, value in enumerate(free_energy[training_count:]):
        evidence += EVIDENCE_STEP * (np.log1p(max(surprise.add(value), 0.0)) - evidence)
        if evidence > largest_evidence:
            largest_evidence = evidence
            largest_sample = begin + number
    samples = slice(largest_sample + 1)
    command = flight.inputs[samples] @ flight.effect_directions
    arguments = command, flight.outputs[samples], flight.dt, learned.settings
    return {
        "what": "event",
        "evidence": largest_evidence,
        "explained": explained_share(*arguments),
        "sustained": sustained_share(command, flight.dt),
        "cause": cause_name(cause_of_surprise(*arguments)),
    }


def cause_name(cause: SurpriseCause | None) -> str:
    """Returns the column of a cause in the tables."""
    return "undecided" if cause is None else cause.value


def evaluate_flight(case: tuple[str, int], folder: Path, marks: bool) -> list[Values]:
    """Returns a row for each event of a flight, and one for its length; also one for each mark if they are asked for.

    Args:
        case: kind and number of the flight.
        folder: where logs of flights are kept.
        marks: whether the flight is given to the online learner.
    """
    kind, number = case
    plan = flight_plan(kind, number)
    common = {"flights": kind, "half": ("even", "odd")[number % 2], "number": number}
    rows: list[Values] = []
    for flight in flown_segments(plan, folder / f"{kind}_{number}.tlog"):
        rows.append(common | {"what": "hours", "hours": len(flight) * flight.dt / 3600})
        for start in event_starts(flight, plan.disturbance_start):
            row = event_row(flight, start)
            if row is not None:
                rows.append(common | row)
        for mark in learner_marks(flight) if marks else ():
            delay = np.nan
            if plan.disturbance_start is not None:
                delay = mark.time - plan.disturbance_start
            rows.append(common | {"what": "mark", "delay": delay, "cause": cause_name(mark.cause)})
    return rows


def counted(rows: pd.DataFrame) -> Values:
    """Returns how many rows name each cause."""
    causes = [*(cause.value for cause in SurpriseCause), "undecided"]
    return {cause: int((rows["cause"] == cause).sum()) for cause in causes}


def event_statistics(rows: pd.DataFrame) -> pd.Series:
    """Returns the row of the events of one kind and half: causes named, and explained shares."""
    events = rows[rows["what"] == "event"]
    line: Values = {"events": len(events)} | counted(events)
    for share in ("explained", "sustained"):
        shares = events[share].astype(float)
        line[f"share {share}"] = f"{shares.min():.2f} to {shares.max():.2f}"
    return pd.Series(line)


def mark_statistics(rows: pd.DataFrame) -> pd.Series:
    """Returns the row of the marks of one kind and half: causes named, and false marks."""
    marks = rows[rows["what"] == "mark"]
    hours = rows["hours"].sum()
    is_of_disturbance = (marks["delay"] >= 0.0) & (marks["delay"] <= MARK_SECONDS)
    is_misfit = marks["cause"] == SurpriseCause.MODEL_MISFIT
    # After a disturbance its cause is a disturbance; at all other times nothing but manoeuvres and light wind.
    false_disturbances = (~is_of_disturbance & (marks["cause"] == SurpriseCause.DISTURBANCE)).sum()
    line: Values = {"flights, hours": f"{hours:.2f}", "marks": len(marks)} | counted(marks)
    line["of the disturbance"] = int(is_of_disturbance.sum())
    line["of these named a misfit"] = int((is_of_disturbance & is_misfit).sum())
    line["others named a disturbance"] = int(false_disturbances)
    return pd.Series(line)


@command(__doc__, flights=6)
@click.option("--folder", type=click.Path(file_okay=False, path_type=Path), default="flights")
@click.option("--marks", is_flag=True)
def main(flights: int, folder: Path, marks: bool, jobs: int) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    cases = [(kind, number) for number in range(flights) for kind in KINDS]
    evaluate = partial(evaluate_flight, folder=folder, marks=marks)
    groups = evaluate_flights(evaluate, cases, jobs).groupby(["flights", "half"], sort=False)
    print_table("The largest surprise of each event", groups.apply(event_statistics).reset_index())
    if marks:
        print_table("Marks of the learner", groups.apply(mark_statistics).reset_index())


if __name__ == "__main__":
    main()
