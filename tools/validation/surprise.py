#!/usr/bin/env python
"""Causes of surprise (a disturbance, or a misfit of the model) in simulated flights: how often they are named rightly.

The surprise of a sample is the drop of its free energy F(t) below the recent median, in units of the usual drops. Its
cause is a disturbance, or a misfit of the model in a manoeuvre (``mavdem.dem.online.surprise_cause``).

In three kinds of flights the pilot or the autopilot flies fast manoeuvres in light wind. In three others a gust comes,
a motor loses thrust, or a load shifts. The first table has the causes at the largest surprise of each event. An event
is the six seconds after a disturbance began, or six seconds of manoeuvres that tilt the vehicle by more than 8°. The
model is learned from the 15 s before. A manoeuvre that is called a disturbance is false, and so is a disturbance that
is called a model misfit. In fast legs both may be right: the airspeed turns the vehicle as a gust does.

The flights of each kind are numbered, and even and odd numbers are reported apart. The constants of
``surprise_cause.py`` were chosen on the even ones.

With --marks the flights are given to the online learner sample by sample. A mark is a sample that the learner reports
as unusual, because surprise stays high. The second table has the marks and their causes.

A flight takes some five seconds to simulate, and with --marks ten to learn. Logs of the flights are kept in --folder,
so that a second run does not simulate them again.

Usage: tools/validation/surprise.py [--flights N of each kind] [--jobs N] [--folder FOLDER] [--marks]
"""

from functools import partial
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np
import pandas as pd
from flights import (
    ARMING_TIME,
    TABLES,
    Values,
    command,
    draw_values,
    evaluate_flights,
    half_name,
    print_table,
    scenario_from_values,
)
from numpy.random import default_rng

from mavdem import Flight, OnlineLearner, learn, read_segments
from mavdem.arrays import Array
from mavdem.dem.fitting import generalized_data
from mavdem.dem.online.free_energy_monitor import Surprise
from mavdem.dem.online.surprise_cause import (
    cause_of_surprise,
    explained_share,
    sustained_fraction,
)
from mavdem.dem.record import Record
from mavdem.facts.online import SurpriseCause
from mavdem.files import atomic_write
from mavdem.ingest.tlog import write_tlog
from sitl_scenarios.mavlink.transmitter import recorded_stream
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.simulation import fly

SURPRISE: Values = TABLES["surprise"]
"""What the flights are drawn from: values of all flights, and of each kind."""

KINDS: Values = SURPRISE["kinds"]
"""Values of each kind of flight, by its name; a gust, a weak motor or a load is the disturbance of a kind."""


LOOP_RATE = 200.0
"""Rate of the autopilot's control loop, Hz: lower than usual, so that the simulation takes less time."""

TOOL_SEED = 70
"""Last entry of each seed, so that the flights differ from other tools' flights: an arbitrary number."""

EVENT_SECONDS = 6.0
"""Time after the beginning of an event in which its largest surprise is looked for, s: a choice."""

MARK_SECONDS = 15.0
"""Time after the beginning of a disturbance in which a mark belongs to it, s: a choice."""

TRAINING_SECONDS = 15.0
"""Time before an event from which its model is learned, s: a choice."""

MANOEUVRE_TILT = np.radians(8.0)
"""Deviation of the angle from its median, rad, that light wind does not cause: a choice."""

EVIDENCE_WEIGHT = 0.01
"""Weight of the newest sample in the exponential average of log(1 + surprise).

At 100 Hz it averages over one second, as the online learner does for its marks.
"""


class FlightPlan(NamedTuple):
    """A simulated flight."""

    scenario: Scenario
    """What is flown."""

    disturbance_start: float | None
    """When the disturbance begins, s of the recording; None of a flight of manoeuvres."""


class Mark(NamedTuple):
    """A sample of a stream that the online learner reports as unusual, because surprise stays high."""

    time: float
    """Time of the sample, s."""

    cause: SurpriseCause | None
    """What the learner names as its cause."""


def flight_plan(kind: str, number: int) -> FlightPlan:
    """Draws the scenario of a flight, and states when its disturbance begins.

    Args:
        kind: what disturbs the flight, or which manoeuvres are flown in it, a key of ``KINDS``.
        number: number of the flight among the flights of its kind. Kind and number seed the draw.

    Returns:
        The scenario, and the time since boot at which the disturbance begins, s; None for a flight without one.
    """
    rng = default_rng([list(KINDS).index(kind), number, TOOL_SEED])
    values = draw_values(SURPRISE["flight"], rng) | {"seed": number}
    kind_values = draw_values(KINDS[kind], rng)
    # The file flights.toml has one table for a gust and one for a weak motor. In a scenario the gust is one more wind,
    # and the weak motor a property of the vehicle. Other values, such as a load, are as in a scenario.
    gust = kind_values.pop("gust", None)
    weak_motor = kind_values.pop("weak", None)
    disturbance_start = None
    if gust is not None:
        disturbance_start = gust["start"]
        values["wind"] = [*values["wind"], gust]
    if weak_motor is not None:
        disturbance_start = weak_motor["start"]
        values["vehicle"] |= {
            "weak_motor": int(rng.integers(4)) + 1,
            "weak_from": disturbance_start,
            "weak_thrust": weak_motor["thrust"],
        }
    if "load" in kind_values:
        disturbance_start = kind_values["load"]["start"]
    loop_rate_parameter = SURPRISE["loop_rates"][values["stream"]["autopilot"]]
    values["vehicle"]["parameters"] = {loop_rate_parameter: LOOP_RATE}
    scenario = scenario_from_values(values | kind_values, "SERVO_OUTPUT_RAW")
    if disturbance_start is None:
        return FlightPlan(scenario, None)
    return FlightPlan(scenario, disturbance_start + ARMING_TIME)


def flown_segments(plan: FlightPlan, path: Path) -> list[Flight]:
    """Returns the settled segments of a flight, and simulates it first if there is no log of it yet.

    Args:
        plan: scenario of the flight, and when its disturbance begins.
        path: file of its log, which is written after the simulation.
    """
    if not path.exists():
        with atomic_write(path) as file:
            write_tlog(file, recorded_stream(plan.scenario, fly(plan.scenario)))
    return list(read_segments(path))


def event_starts(flight: Flight, disturbance_start: float | None) -> list[float]:
    """Returns when the events of a segment begin, s.

    The only event of a flight with a disturbance is that disturbance. A flight of manoeuvres is cut into intervals of
    ``EVENT_SECONDS``, and each interval in which the vehicle tilts by more than ``MANOEUVRE_TILT`` is an event.

    Args:
        flight: uniformly sampled inputs and outputs of one segment of flight.
        disturbance_start: when the disturbance begins, s; None of a flight of manoeuvres.

    Returns:
        Times on the clock of the segment, s, ascending.
    """
    if disturbance_start is not None:
        return [disturbance_start]
    angle = flight.outputs[:, 0]
    tilt = abs(angle - np.median(angle))
    starts = []
    # Before the first event the model of it is trained.
    first_start = flight.time[0] + TRAINING_SECONDS
    last_start = flight.time[-1] - EVENT_SECONDS
    for start in np.arange(first_start, last_start, EVENT_SECONDS):
        is_in_interval = (flight.time >= start) & (flight.time < start + EVENT_SECONDS)
        if tilt[is_in_interval].max(initial=0.0) > MANOEUVRE_TILT:
            starts.append(float(start))
    return starts


def learner_marks(flight: Flight) -> list[Mark]:
    """Returns the samples of a flight that the online learner reports as unusual, with the causes that it names.

    The flight is given to the learner sample by sample, as in a live session.

    Args:
        flight: uniformly sampled inputs and outputs of one segment of flight.

    Returns:
        Time and cause of each such sample, in the order of time.
    """
    learner = OnlineLearner(
        dt=flight.dt,
        n_inputs=flight.inputs.shape[1],
        effect_directions=flight.effect_directions,
    )
    # Marks do not depend on the wind torque and the physical parameters, which would take most of the time.
    learner.follows_torque = False
    learner.fits_physical = False
    marks = []
    for sample, time in enumerate(flight.time):
        estimate = learner.update(time, flight.outputs[sample], flight.inputs[sample])
        if estimate.unusual and estimate.latest_mark is not None:
            marks.append(Mark(time, estimate.latest_mark.cause))
    return marks


def event_row(flight: Flight, start: float) -> Values | None:
    """Decides the cause of the largest surprise of an event, by a model of the time before the event.

    The surprise of a sample is its drop of the free energy F(t), standardised by earlier samples: how unusual it is for
    the model. It is computed as the online learner does, and averaged over about a second. The cause, a disturbance or
    a misfit of the model, is decided at the sample with the largest average, from the samples up to it.

    Args:
        flight: uniformly sampled inputs and outputs of one segment of flight.
        start: when the event begins, s.

    Returns:
        The row of results: "evidence", the largest average of log(1 + surprise); "explained" and "sustained", the two
        shares by which the cause is decided; and "cause". None where too little was flown before the event, or after
        its beginning.
    """
    training_start = start - TRAINING_SECONDS
    training_first = int(np.searchsorted(flight.time, training_start))
    event_first = int(np.searchsorted(flight.time, start))
    event_stop = event_first + round(EVENT_SECONDS / flight.dt)
    is_whole = flight.time[0] <= training_start and event_stop <= len(flight)
    if not is_whole or flight.effect_directions is None:
        return None
    learned = learn(flight[training_first:event_first])
    assert learned.sample_free_energy is not None
    record = Record.from_flights(flight[training_first:event_stop])
    data = np.concatenate(generalized_data(learned.settings, learned.scaling, record))
    free_energy = learned.sample_free_energy.evaluate(data)
    # F(t) of the training samples is the past by which the event's samples are standardised.
    training_count = len(learned.free_energy_of_samples)
    surprise = Surprise(flight.dt, free_energy[:training_count])
    peak = _largest_evidence(surprise, free_energy[training_count:])
    samples_up_to_peak = slice(event_first + peak.sample + 1)
    command = flight.inputs[samples_up_to_peak] @ flight.effect_directions
    outputs = flight.outputs[samples_up_to_peak]
    cause = cause_of_surprise(command, outputs, flight.dt, learned.settings)
    return {
        "what": "event",
        "evidence": peak.evidence,
        "explained": explained_share(command, outputs, flight.dt, learned.settings),
        "sustained": sustained_fraction(command, flight.dt),
        "cause": cause_name(cause),
    }


class EvidencePeak(NamedTuple):
    """The largest evidence of a surprise in an event: the average of log(1 + surprise) over about a second."""

    sample: int
    """Number of the sample with the largest average, from the beginning of the event."""

    evidence: float
    """The average there."""


def _largest_evidence(surprise: Surprise, free_energy: Array) -> EvidencePeak:
    """Returns the largest evidence that the samples of an event do not fit the model.

    The evidence is an exponential average of log(1 + surprise). The surprise of a sample is how far its free energy
    F(t) dropped below that of the samples before, in their standard deviations; a rise counts as 0.

    Args:
        surprise: computes the surprise of each sample in turn, with the training samples as its past so far.
        free_energy: F(t) of the event's samples (N,), nats.
    """
    evidence = 0.0
    peak = EvidencePeak(sample=0, evidence=0.0)
    for sample, value in enumerate(free_energy):
        drop = max(surprise.add(value), 0.0)
        evidence += EVIDENCE_WEIGHT * (np.log1p(drop) - evidence)
        if evidence > peak.evidence:
            peak = EvidencePeak(sample, evidence)
    return peak


def cause_name(cause: SurpriseCause | None) -> str:
    """Returns the name of a cause in the tables: "undecided" for None."""
    return "undecided" if cause is None else cause.value


def evaluate_flight(case: tuple[str, int], folder: Path, marks: bool) -> list[Values]:
    """Simulates a flight, and decides the causes of its events (a disturbance, or six seconds of a manoeuvre).

    Args:
        case: kind of the flight, a key of ``KINDS``, and its number.
        folder: where logs of flights are kept.
        marks: whether the flight is also given to the online learner, whose unusual samples ("marks") get rows, too.

    Returns:
        Rows of three types, which column "what" names. All have the kind of the flight ("flights"), its "number" and
        "half" (even or odd).

        - "hours": the duration of a settled segment.
        - "event": the columns of :func:`event_row`.
        - "mark": the "cause" that the learner names, and the "delay" since the disturbance began, s (NaN without one).
    """
    kind, number = case
    plan = flight_plan(kind, number)
    flight_columns = {"flights": kind, "half": half_name(number), "number": number}
    rows: list[Values] = []
    for flight in flown_segments(plan, folder / f"{kind}_{number}.tlog"):
        rows.append({"what": "hours", "hours": len(flight) * flight.dt / 3600})
        for start in event_starts(flight, plan.disturbance_start):
            row = event_row(flight, start)
            if row is not None:
                rows.append(row)
        if marks:
            rows += [mark_row(mark, plan.disturbance_start) for mark in learner_marks(flight)]
    return [flight_columns | row for row in rows]


def mark_row(mark: Mark, disturbance_start: float | None) -> Values:
    """Returns the row of a mark: its cause, and its delay, s, since a disturbance began (NaN without one)."""
    delay = np.nan if disturbance_start is None else mark.time - disturbance_start
    return {"what": "mark", "delay": delay, "cause": cause_name(mark.cause)}


def cause_counts(rows: pd.DataFrame) -> Values:
    """Returns how many rows name each cause, by the name of the cause, "undecided" included."""
    causes = [cause.value for cause in SurpriseCause] + ["undecided"]
    return {cause: int((rows["cause"] == cause).sum()) for cause in causes}


def event_statistics(rows: pd.DataFrame) -> pd.Series:
    """Summarises the events of a group of flights: how many are called a disturbance, a misfit, or undecided.

    Args:
        rows: rows of :func:`evaluate_flight` of one kind of flight, with even or with odd numbers.

    Returns:
        The row of the first table: the number of events and of each cause, and the ranges of the two shares by which
        ``surprise_cause`` decides: of the motion that the commands explain ("explained"), and of the commands that
        are sustained.
    """
    events = rows[rows["what"] == "event"]
    line: Values = {"events": len(events)} | cause_counts(events)
    for share in ("explained", "sustained"):
        shares = events[share].astype(float)
        line[f"share {share}"] = f"{shares.min():.2f} to {shares.max():.2f}"
    return pd.Series(line)


def mark_statistics(rows: pd.DataFrame) -> pd.Series:
    """Summarises the learner's marks (unusual samples) in a group of flights: the number of each cause, and false ones.

    Within ``MARK_SECONDS`` after a disturbance began, the true cause of a mark is that disturbance. At all other times
    there are only manoeuvres and light wind, so that a mark that is called a disturbance is false.

    Args:
        rows: rows of :func:`evaluate_flight` of one kind of flight, with even or with odd numbers.

    Returns:
        The row of the second table, by its headers.
    """
    marks = rows[rows["what"] == "mark"]
    hours = rows["hours"].sum()
    follows_disturbance = (marks["delay"] >= 0.0) & (marks["delay"] <= MARK_SECONDS)
    is_called_misfit = marks["cause"] == SurpriseCause.MODEL_MISFIT
    is_called_disturbance = marks["cause"] == SurpriseCause.DISTURBANCE
    false_misfits = follows_disturbance & is_called_misfit
    false_disturbances = ~follows_disturbance & is_called_disturbance
    cells: Values = {"flights, hours": f"{hours:.2f}", "marks": len(marks)} | cause_counts(marks)
    cells["of the disturbance"] = int(follows_disturbance.sum())
    cells["of these named a misfit"] = int(false_misfits.sum())
    cells["others named a disturbance"] = int(false_disturbances.sum())
    return pd.Series(cells)


@command(__doc__, flights=6)
@click.option("--folder", type=click.Path(file_okay=False, path_type=Path), default="flights")
@click.option("--marks", is_flag=True)
def main(flights: int, folder: Path, marks: bool, jobs: int) -> None:
    """Simulates flights with and without disturbances, and prints which causes of their surprises are named.

    Surprise is the drop of a sample's free energy below its recent median. The first table has a row for each kind of
    flight, parted by even and odd numbers: how often the largest surprise of an event is called a disturbance or a
    misfit of the model.

    Args:
        flights: number of flights of each kind.
        folder: folder in which logs of the flights are kept for the next run.
        marks: whether to give the flights to the online learner too, and to print a second table: the samples that it
            marks as unusual, with their causes.
        jobs: number of processes.
    """
    folder.mkdir(parents=True, exist_ok=True)
    cases = [(kind, number) for number in range(flights) for kind in KINDS]
    evaluate = partial(evaluate_flight, folder=folder, marks=marks)
    groups = evaluate_flights(evaluate, cases, jobs).groupby(["flights", "half"], sort=False)
    print_table("The largest surprise of each event", groups.apply(event_statistics).reset_index())
    if marks:
        print_table("Marks of the learner", groups.apply(mark_statistics).reset_index())


if __name__ == "__main__":
    main()
