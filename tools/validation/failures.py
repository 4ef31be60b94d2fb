#!/usr/bin/env python
"""Reviews of simulated flights with a known mishap: do headline, status lights and events state it? Two tables.

A review has a headline, a light (good, watch or bad) for each subject such as the motors, and events. Each is a fact: a
code with the figures of its sentence. The kind of a flight is what goes wrong in it; in a "sound" one nothing does. The
first table has a row for each kind, for flights of even and odd numbers ("half"): how many were reviewed, in how many
the review says what went wrong, in how many it says nothing of it or that it is undecided, and in how many it names
another event or another motor. The second table has all kinds together, and the sound flights with a light that is bad
or to be watched. Airframe, autopilot, wind, time, motor and size follow from kind and number. The codes that count as
right stand in failures.toml. Thresholds were chosen on the flights with even numbers.

A flight takes some five seconds, and its review one: with --folder, telemetry logs of the flights are kept there, and
not flown again.

Usage: tools/validation/failures.py [--count N of each kind] [--first N] [--jobs N] [--kind KIND ...] [--folder FOLDER]
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from re import search
from typing import NamedTuple

import click
import pandas as pd
from flights import (
    Values,
    command,
    draw_values,
    evaluate_flights,
    half_name,
    percent_true,
    print_table,
    scenario_from_values,
)
from numpy.random import Generator, default_rng

from mavdem.assessment.assess import assess
from mavdem.assessment.event_lights import LIGHT_OF_EVENT
from mavdem.assessment.record import Assessment
from mavdem.errors import Unreadable
from mavdem.facts import Fact, Level
from mavdem.files import atomic_write, load_adjacent_toml
from mavdem.ingest import Log, read_log
from mavdem.ingest.mavlink.vehicles import assemble
from mavdem.ingest.tlog import write_tlog
from sitl_scenarios.mavlink.transmitter import recorded_stream
from sitl_scenarios.plan import flight_times
from sitl_scenarios.rotors import rotor_count
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.simulation import fly

TABLES: Values = load_adjacent_toml(__file__, "failures.toml")
KINDS: Values = TABLES["kinds"]

LOOP_RATES = {"ardupilot": "SCHED_LOOP_RATE", "px4": "IMU_GYRO_RATEMAX"}
"""Parameter of the rate of each autopilot's loop."""

LOOP_RATE = 200.0
"""Rate of the autopilots' loops, Hz: lower than usual, so that flights take less time to simulate."""

HEIGHTS = {"dive": 24.0, "flip": 20.0}
"""Height of the hover of mishaps that need room, m."""

LARGE_FRAMES = ("hexa_x", "hexa_plus", "octa_x")
"""Frames with long arms, whose inertia is too large for a flip."""

QUADROTOR_FRAMES = ("x", "plus")
"""Frames with four rotors."""

LONGER_CLIMB_SECONDS = 24.0
"""Time that the climb to a height of ``HEIGHTS`` and the descent take beyond the usual ones, s."""

MARGIN_SECONDS = 12.0
"""Time from the beginning of a mishap to the landing at least, s."""

GAINS = ("ATC_RAT_", "ATC_ANG_", "MC_ROLL", "MC_PITCH", "MC_YAW")
"""Beginnings of the names of the gains of both autopilots."""

SERIOUS = (Level.BAD, Level.WATCH)
"""Levels of facts by which a review says that something is wrong."""

PROMINENT_PLACES = ("headline", "cause")
"""Places of a review that say what happened to the flight: the headline, and the cause that it gives."""

LOG_LIGHT = "log"
"""Light that judges the log itself, such as the rate of the telemetry link: no fault of a sound vehicle."""

REVIEW_RESULTS = ("right", "none", "wrong")
"""Results of :func:`review_result`: the review states the mishap, misses it, or states another one."""


def scenario(kind: str, number: int) -> Scenario:
    """Returns the scenario of a flight that goes wrong in some way, or of a sound one.

    Args:
        kind: what goes wrong, a key of ``KINDS``; "sound" for nothing.
        number: number of the flight within its kind, which seeds its random numbers.

    Returns:
        The validated scenario.
    """
    rng = default_rng([sorted(KINDS).index(kind), number])
    values = _flight_without_mishap(kind, number, rng)
    sound = scenario_from_values(values)
    if kind == "sound":
        return sound
    mishap = {"kind": kind} | draw_values(TABLES["mishaps"][kind], rng)
    if KINDS[kind].get("names_motor"):
        rotors = rotor_count(values["vehicle"]["frame"])
        # Motors are counted from 1.
        mishap["motor"] = int(rng.integers(rotors)) + 1
    if "start" in mishap:
        # The start is drawn in seconds of the hover; a scenario counts it from the arming.
        mishap["start"] += flight_times(sound).hover
        mishap_end = mishap["start"] + mishap.get("seconds", 0.0)
        values["duration"] = max(values["duration"], mishap_end + MARGIN_SECONDS)
    return scenario_from_values(values | {"mishap": mishap})


def _flight_without_mishap(kind: str, number: int, rng: Generator) -> Values:
    """Draws a flight that suits a mishap, without the mishap itself.

    Args:
        kind: what is to go wrong, a key of ``KINDS``.
        number: number of the flight within its kind.
        rng: source of the random numbers.

    Returns:
        The values of a scenario by key, as in its TOML file.
    """
    values: Values = draw_values(TABLES["flight"], rng) | {"seed": number}
    vehicle = values["vehicle"]
    if kind == "flip" and vehicle["frame"] in LARGE_FRAMES:
        vehicle["frame"] = "x"
    if vehicle["frame"] not in QUADROTOR_FRAMES:
        # A larger frame is made of an iris, with more of its rotors.
        vehicle["model"] = "iris"
    loop_rate_parameter = LOOP_RATES[values["stream"]["autopilot"]]
    vehicle["parameters"] = {loop_rate_parameter: LOOP_RATE}
    if kind in HEIGHTS:
        values["height"] = HEIGHTS[kind]
        values["duration"] += LONGER_CLIMB_SECONDS
        # The mishap itself is a manoeuvre: the pilot flies no other.
        values["excitation"] = {"kind": "none"}
    return values


def flown_log(flight: Scenario, path: Path | None) -> Log:
    """Returns the telemetry log of a simulated flight, which is flown unless its file exists already.

    Args:
        flight: scenario of the flight.
        path: file that keeps the log; None to keep none.
    """
    if path is not None and path.exists():
        return read_log(path)
    stream = recorded_stream(flight, fly(flight))
    if path is None:
        return assemble(stream)
    with atomic_write(path) as file:
        write_tlog(file, stream)
    return read_log(path)


def without_gains(log: Log) -> Log:
    """Returns a log without the parameters of rate and attitude control.

    A review then cannot identify the control loops, which would take most of its time.

    Args:
        log: the log of a flight.
    """
    vehicles = []
    for vehicle in log.vehicles:
        kept_parameters = {
            name: value for name, value in vehicle.parameters.items() if not name.startswith(GAINS)
        }
        vehicles.append(replace(vehicle, parameters=kept_parameters))
    return replace(log, vehicles=tuple(vehicles))


class ReportedFact(NamedTuple):
    """A fact (a coded finding with the numbers of its sentence) that a review reports, and where."""

    fact: Fact
    """The finding, with its code, its level, and what it is about (its subject)."""

    place: str
    """Where the review reports it: "headline", "cause", "event", or the name of a light."""


def reported_facts(review: Assessment) -> Iterator[ReportedFact]:
    """Yields the facts (coded findings) that a review reports: headline, causes, lights and events, in this order.

    Args:
        review: the review. A headline that has another fact among its figures names it as its cause.

    Yields:
        Each fact with the place at which the review reports it.
    """
    headline = review.headline
    yield ReportedFact(headline, "headline")
    for figure in headline.figures.values():
        if isinstance(figure, Fact):
            yield ReportedFact(figure, "cause")
    for name, light in review.lights.items():
        yield ReportedFact(light, name)
    for event in review.events:
        yield ReportedFact(event, "event")


def codes(kind: str, key: str) -> set[str]:
    """Returns the codes of facts that failures.toml lists for a kind of mishap.

    Args:
        kind: what went wrong, a key of ``KINDS``.
        key: "expected", "permitted" or "without_motor".

    Returns:
        The codes; the entry "@down" stands for all codes of a flight that went down.
    """
    listed = set(KINDS[kind].get(key, []))
    if "@down" in listed:
        listed |= set(TABLES["down"])
    return listed


def motors_named(text: str) -> set[int]:
    """Returns the numbers of the motors that a subject names."""
    match = search(r"motors? (\d+)", text)
    return {int(match[1])} if match else set()


def is_wrong_fact(reported: ReportedFact, failed_motor: int, permitted_codes: set[str]) -> bool:
    """Returns whether a fact of a review is wrong: it names a sound motor, or another serious event.

    Only the headline, its cause and the light of the motors name a motor as faulty; other lights and events may mention
    motors that worked hard.

    Args:
        reported: the fact and its place in the review.
        failed_motor: number of the motor that failed; 0 for none.
        permitted_codes: codes that a review of this mishap may have in its headline or the cause.

    Returns:
        False also for a fact that says of nothing that it is wrong: its level is neither bad nor watch.
    """
    fact, place_in_review = reported
    if fact.level not in SERIOUS:
        return False
    is_prominent = place_in_review in PROMINENT_PLACES
    blames_motors = is_prominent or place_in_review == "motors"
    sound_motors = motors_named(fact.subject) - {failed_motor}
    if blames_motors and sound_motors:
        return True
    return is_prominent and str(fact.code) not in permitted_codes


def states_mishap(reported: ReportedFact, kind: str, failed_motor: int) -> bool:
    """Returns whether a fact of a review states the mishap, and names the failed motor where it must.

    Args:
        reported: the fact and its place in the review.
        kind: what went wrong, a key of ``KINDS``.
        failed_motor: number of the motor that failed; 0 for none.
    """
    fact, place_in_review = reported
    code = str(fact.code)
    if code not in codes(kind, "expected"):
        return False
    is_serious = fact.level in SERIOUS
    # A good light or an event without a fault does not tell the pilot of the mishap.
    if not is_serious and place_in_review not in PROMINENT_PLACES:
        return False
    must_name_motor = KINDS[kind].get("names_motor", False)
    if not must_name_motor or code in codes(kind, "without_motor"):
        return True
    return is_serious and failed_motor in motors_named(fact.subject)


def permitted_headline_codes(kind: str, review: Assessment) -> set[str]:
    """Returns the codes of facts that are not wrong in the headline of a review of a mishap.

    They are listed in failures.toml, for this kind of mishap or for all kinds. Besides, three status lights of the
    review may be its headline, since they judge the control loops and the log, and not what happened.

    Args:
        kind: what went wrong, a key of ``KINDS``.
        review: the review of the flight, with its status lights.
    """
    permitted = codes(kind, "expected") | codes(kind, "permitted")
    permitted |= {*TABLES["always_permitted"], *TABLES["side_effects"]}
    for name in ("tracking", "margins", LOG_LIGHT):
        code = review.lights[name].code
        # A light may show an event, such as the end of the log in the air. Then it is judged as other events are.
        if code not in LIGHT_OF_EVENT:
            permitted.add(str(code))
    return permitted


def review_result(kind: str, failed_motor: int, review: Assessment) -> str:
    """Judges what a review says of a simulated mishap, as "right", "wrong" or "none".

    A review reports facts: its headline, the cause in it, its lights and its events. Each has a code, and
    failures.toml lists the codes that a kind of mishap expects or permits.

    - "wrong": the headline or its cause states a serious event that the kind neither expects nor permits, or a motor
      is named that did not fail.
    - "right": a serious or prominent fact has an expected code, and names the failed motor where it must; or the
      mishap does no harm (``needs_no_alarm``), and the headline gives no alarm.
    - "none": the review says nothing wrong, but misses the mishap.

    Args:
        kind: what went wrong, a key of ``KINDS``.
        failed_motor: number of the motor that failed; 0 for none.
        review: all results on the flight: events, status lights, model, loops and wind.

    Returns:
        One of ``REVIEW_RESULTS``.
    """
    permitted_codes = permitted_headline_codes(kind, review)
    all_facts = list(reported_facts(review))
    if any(is_wrong_fact(reported, failed_motor, permitted_codes) for reported in all_facts):
        return "wrong"
    if any(states_mishap(reported, kind, failed_motor) for reported in all_facts):
        return "right"
    # Motors with little headroom, say, are true of a hard manoeuvre, but name no event: no right answer.
    headline_is_side_effect = str(review.headline.code) in TABLES["side_effects"]
    gives_alarm = review.headline.level is Level.BAD or headline_is_side_effect
    if KINDS[kind].get("needs_no_alarm") and not gives_alarm:
        return "right"
    return "none"


def review_row(case: tuple[str, int], folder: Path | None) -> list[Values]:
    """Flies a scenario, reviews its log, and judges whether the review states what went wrong.

    Args:
        case: kind and number of the flight, as for :func:`scenario`.
        folder: folder that keeps the logs of the flights; None to keep none.

    Returns:
        One row by column. "kind", "half" (even or odd) and "number" of the flight; "result", one of
        ``REVIEW_RESULTS``. As texts: the "vehicle" with its failed motor; the "code" and the sentence of the
        "headline"; "lights", the names of the bad or watched lights; and "false lights", the ones of a sound flight. A
        log that was refused has no vehicle and no code, and the reason as its headline.
    """
    kind, number = case
    flight = scenario(kind, number)
    path = folder / f"{kind}_{number:03}.tlog" if folder else None
    row: Values = {"kind": kind, "half": half_name(number), "number": number}
    try:
        review = assess(without_gains(flown_log(flight, path)))
    except Unreadable as refusal:
        # Nothing but a log that mixes two vehicles may be refused, and that kind expects the code of the refusal.
        is_right = str(refusal.fact.code) in codes(kind, "expected")
        row["result"] = "right" if is_right else "wrong"
        return [row | {"headline": str(refusal), "lights": "", "false lights": ""}]
    failed_motor = getattr(flight.mishap, "motor", 0)
    serious_lights = [str(name) for name, light in review.lights.items() if light.level in SERIOUS]
    false_lights = []
    if kind == "sound":
        false_lights = [name for name in serious_lights if name != LOG_LIGHT]
    row |= {
        "result": review_result(kind, failed_motor, review),
        "vehicle": f"{flight.stream.autopilot} {flight.vehicle.frame} {failed_motor}",
        "code": str(review.headline.code),
        "headline": review.headline.sentence,
        "lights": ", ".join(serious_lights),
        "false lights": ", ".join(false_lights),
    }
    return [row]


def summary_by_kind(rows: pd.DataFrame) -> list[Values]:
    """Counts flights and results by kind of mishap, separately for flights of even and odd numbers.

    Args:
        rows: rows of :func:`review_row`, one for each flight.

    Returns:
        Rows of the first table, in the order in which kinds and halves come first: number of flights, and how many of
        them have each of the ``REVIEW_RESULTS``.
    """
    table_rows = []
    for (kind, half), flights in rows.groupby(["kind", "half"], sort=False):
        counts = {result: int((flights["result"] == result).sum()) for result in REVIEW_RESULTS}
        table_rows.append({"kind": kind, "half": half, "flights": len(flights), **counts})
    return table_rows


def summary_of_all_kinds(rows: pd.DataFrame) -> list[Values]:
    """Returns the second table: results of all mishaps, and false lights, for flights of even and of odd numbers.

    Args:
        rows: rows of :func:`review_row`, one for each flight.

    Returns:
        A row for each half, "even" and "odd": number of flights with a mishap, the percentage of them with each of the
        ``REVIEW_RESULTS`` as text, number of sound flights, and how many of these have a bad or watched light.
    """
    table_rows = []
    for half, flights in rows.groupby("half"):
        with_mishap = flights[flights["kind"] != "sound"]
        sound = flights[flights["kind"] == "sound"]
        row: Values = {"half": half, "flights": len(with_mishap)}
        for result in REVIEW_RESULTS:
            row[result] = percent_true(with_mishap["result"] == result)
        row["sound flights"] = len(sound)
        row["with a false light"] = int((sound["false lights"] != "").sum())
        table_rows.append(row)
    return table_rows


@command(__doc__, count=40, first=0)
@click.option("--kind", "chosen", multiple=True, type=click.Choice(sorted(KINDS)))
@click.option("--folder", type=click.Path(file_okay=False, path_type=Path))
@click.option("--verbose", is_flag=True, help="Print the headline of every flight, too.")
def main(
    count: int, first: int, jobs: int, chosen: tuple[str, ...], folder: Path | None, verbose: bool
) -> None:
    """Simulates flights with and without mishaps, and prints how many reviews are right, by kind of mishap.

    Args:
        count: number of flights of each kind.
        first: number of the first flight of each kind. Flights of larger numbers than any before are fresh ones, on
            which no threshold was chosen.
        jobs: number of processes.
        chosen: kinds of flights; all if it is empty.
        folder: folder that keeps the logs of the flights; None to keep none.
        verbose: whether to print the headline of every flight, too.
    """
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
    kinds = chosen or tuple(KINDS)
    cases = [(kind, number) for number in range(first, first + count) for kind in kinds]
    rows = evaluate_flights(partial(review_row, folder=folder), cases, jobs)
    rows = rows.sort_values(["kind", "half", "number"], kind="stable")
    if verbose:
        shown = rows[["kind", "number", "vehicle", "result", "headline", "lights"]]
        print_table("What is said of each flight", shown)
    print_table("Flights that go wrong, by kind", summary_by_kind(rows))
    print_table("All kinds together", summary_of_all_kinds(rows))


if __name__ == "__main__":
    main()
