#!/usr/bin/env python
"""How reviews judge simulated flights that go wrong: rightly, not at all, or wrongly; prints two tables.

In each kind of flight another thing goes wrong. The first table has a row for each kind, parted by even and odd
numbers of the flights: how many were reviewed, in how many the review says what went wrong, in how many it says nothing
of it or that it is undecided, and in how many it names another event or another motor. The second table has all kinds
together, and the sound flights with a light that is bad or to be watched. Airframe, autopilot, wind, time, motor and
size follow from kind and number. The codes that count as right stand in failures.toml. Thresholds were chosen on the
flights with even numbers.

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
    print_table,
    scenario_from_values,
)
from numpy.random import default_rng

from mavdem.assessment.assess import assess
from mavdem.assessment.judgement import LIGHT_OF_EVENT
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

MARGIN_SECONDS = 12.0
"""Time from the beginning of a mishap to the landing at least, s."""

GAINS = ("ATC_RAT_", "ATC_ANG_", "MC_ROLL", "MC_PITCH", "MC_YAW")
"""Beginnings of the names of the gains of both autopilots."""

SERIOUS = (Level.BAD, Level.WATCH)
"""Levels of facts by which a review says that something is wrong."""

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
    values = draw_values(TABLES["flight"], rng) | {"seed": number}
    if kind == "flip" and values["vehicle"]["frame"] in LARGE_FRAMES:
        values["vehicle"]["frame"] = "x"
    if values["vehicle"]["frame"] not in ("x", "plus"):
        values["vehicle"]["model"] = "iris"
    autopilot = values["stream"]["autopilot"]
    values["vehicle"]["parameters"] = {LOOP_RATES[autopilot]: LOOP_RATE}
    values["height"] = HEIGHTS.get(kind, values["height"])
    if kind in HEIGHTS:
        # The flight is longer by the climb to the greater height and the descent, and has no other excitation.
        values["duration"] += 24.0
        values["excitation"] = {"kind": "none"}
    sound = scenario_from_values(values)
    if kind == "sound":
        return sound
    # A mishap starts some time after the hover begins, which is after spin-up and climb.
    mishap = {"kind": kind} | draw_values(TABLES["mishaps"][kind], rng)
    if "start" in mishap:
        mishap["start"] += flight_times(sound).hover
        shortest = mishap["start"] + mishap.get("seconds", 0.0) + MARGIN_SECONDS
        values["duration"] = max(values["duration"], shortest)
    if KINDS[kind].get("names_motor"):
        mishap["motor"] = int(rng.integers(rotor_count(values["vehicle"]["frame"]))) + 1
    return scenario_from_values(values | {"mishap": mishap})


def flown_log(flight: Scenario, path: Path | None) -> Log:
    """Returns the telemetry of a flight, which is flown unless its log is kept already.

    Args:
        flight: What is flown.
        path: Where its log is kept; None for nowhere.
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
    """Returns a log without the gains of the rate controllers: identifying the loops would take most of the time.

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
    """Yields the facts that a review reports: headline, causes, lights and events, in this order.

    Args:
        review: the review. A fact among the figures of the headline is a cause.

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
    """Returns the codes that a kind lists under a key of failures.toml."""
    listed = set(KINDS[kind].get(key, []))
    if "@down" in listed:
        listed |= set(TABLES["down"])
    return listed


def motors_named(text: str) -> set[int]:
    """Returns the numbers of the motors that a subject names."""
    match = search(r"motors? (\d+)", text)
    return {int(match[1])} if match else set()


def is_wrong_fact(reported: ReportedFact, motor: int, permitted: set[str]) -> bool:
    """Returns whether a fact of a review is wrong: it names a sound motor, or another serious event.

    Only the headline, its cause and the light of the motors name a motor as faulty; other lights and events may mention
    motors that worked hard.

    Args:
        reported: the fact and its place in the review.
        motor: number of the motor that failed; 0 for none.
        permitted: codes that a review of this mishap may have in its headline or the cause.

    Returns:
        False also for facts of another level than "bad" and "watch".
    """
    fact, place = reported
    if fact.level not in SERIOUS:
        return False
    is_prominent = place in ("headline", "cause")
    names_other_motor = bool(motors_named(fact.subject) - {motor})
    if names_other_motor and (is_prominent or place == "motors"):
        return True
    return is_prominent and str(fact.code) not in permitted


def states_mishap(reported: ReportedFact, kind: str, motor: int) -> bool:
    """Returns whether a fact of a review states the mishap, and names the failed motor where it must.

    Args:
        reported: the fact and its place in the review.
        kind: what went wrong, a key of ``KINDS``.
        motor: number of the motor that failed; 0 for none.
    """
    fact, place = reported
    code = str(fact.code)
    is_serious = fact.level in SERIOUS
    is_prominent = place in ("headline", "cause")
    if code not in codes(kind, "expected") or not (is_serious or is_prominent):
        return False
    must_name_motor = KINDS[kind].get("names_motor", False)
    if not must_name_motor or code in codes(kind, "without_motor"):
        return True
    return is_serious and motor in motors_named(fact.subject)


def review_result(kind: str, motor: int, review: Assessment) -> str:
    """Judges what a review says of a simulated mishap, as "right", "wrong" or "none".

    A review reports facts: its headline, the cause in it, its lights and its events. Each has a code, and
    failures.toml lists the codes that a kind of mishap expects or permits.

    - "wrong": the headline or its cause states a serious event that the kind neither expects nor permits, or a motor
      is named that did not fail.
    - "right": a serious or prominent fact has an expected code, and names the failed motor where it must; or the
      kind needs no alarm, and the headline is none.
    - "none": the review says nothing wrong, but misses the mishap.

    Args:
        kind: what went wrong, a key of ``KINDS``.
        motor: number of the motor that failed; 0 for none.
        review: the review.

    Returns:
        One of ``REVIEW_RESULTS``.
    """
    permitted = codes(kind, "expected") | codes(kind, "permitted")
    permitted |= set(TABLES["always_permitted"]) | set(TABLES["remarks"])
    # The lights of tracking, margins and log say nothing of an event, unless they show the headline's event.
    light_codes = {review.lights[name].code for name in ("tracking", "margins", "log")}
    permitted |= {str(code) for code in light_codes - set(LIGHT_OF_EVENT)}
    all_facts = list(reported_facts(review))
    if any(is_wrong_fact(reported, motor, permitted) for reported in all_facts):
        return "wrong"
    if any(states_mishap(reported, kind, motor) for reported in all_facts):
        return "right"
    is_remark = str(review.headline.code) in TABLES["remarks"]
    is_alarm = review.headline.level is Level.BAD or is_remark
    if KINDS[kind].get("needs_no_alarm") and not is_alarm:
        return "right"
    return "none"


def review_row(case: tuple[str, int], folder: Path | None) -> list[Values]:
    """Flies a scenario, reviews its log, and returns what the review says, as one row of results.

    Args:
        case: kind and number of the flight, as for :func:`scenario`.
        folder: folder that keeps the logs of the flights; None to keep none.

    Returns:
        One row: "kind", "half" and "number" of the flight, "verdict", a name of ``REVIEW_RESULTS``, and as texts the
        "vehicle", the "code" and sentence of the "headline", the "lights" of a level of ``SERIOUS``, and those that
        are "false lights". A log that was refused has no vehicle and no code.
    """
    kind, number = case
    row: Values = {"kind": kind, "half": half_name(number), "number": number}
    flight = scenario(kind, number)
    path = folder / f"{kind}_{number:03}.tlog" if folder else None
    try:
        review = assess(without_gains(flown_log(flight, path)))
    except Unreadable as refusal:
        # Nothing but a log that mixes two vehicles may be refused, and that kind expects the code of the refusal.
        is_right = str(refusal.fact.code) in codes(kind, "expected")
        result = "right" if is_right else "wrong"
        return [
            row | {"verdict": result, "headline": str(refusal), "lights": "", "false lights": ""}
        ]
    motor = getattr(flight.mishap, "motor", 0)
    lights = [str(name) for name, light in review.lights.items() if light.level in SERIOUS]
    # The light of the log judges the rate of the telemetry link, which is no fault of a sound vehicle.
    false_lights = [name for name in lights if kind == "sound" and name != "log"]
    return [
        row
        | {
            "verdict": review_result(kind, motor, review),
            "vehicle": f"{flight.stream.autopilot} {flight.vehicle.frame} {motor}",
            "code": str(review.headline.code),
            "headline": review.headline.sentence,
            "lights": ", ".join(lights),
            "false lights": ", ".join(false_lights),
        }
    ]


def summary(rows: pd.DataFrame) -> list[Values]:
    """Returns a line for each kind and half: the number of flights, and of the flights with each result.

    Args:
        rows: rows of :func:`review_row`.

    Returns:
        Lines in the order in which kinds and halves come first in the rows.
    """
    lines = []
    for (kind, half), flights in rows.groupby(["kind", "half"], sort=False):
        counts = {name: int((flights["verdict"] == name).sum()) for name in REVIEW_RESULTS}
        lines.append({"kind": kind, "half": half, "flights": len(flights), **counts})
    return lines


def totals(rows: pd.DataFrame) -> list[Values]:
    """Returns a line for each half: flights that went wrong, by result, and sound flights with a false light.

    Args:
        rows: rows of :func:`review_row`.

    Returns:
        Lines of the table; shares are texts in percent.
    """
    lines = []
    for half, flights in rows.groupby("half"):
        failed = flights[flights["kind"] != "sound"]
        sound = flights[flights["kind"] == "sound"]
        line: Values = {"half": half, "flights": len(failed)}
        for name in REVIEW_RESULTS:
            line[name] = f"{(failed['verdict'] == name).mean():.0%}" if len(failed) else "–"
        line["sound flights"] = len(sound)
        line["with a false light"] = int((sound["false lights"] != "").sum())
        lines.append(line)
    return lines


@command(__doc__, count=40, first=0)
@click.option("--kind", "chosen", multiple=True, type=click.Choice(sorted(KINDS)))
@click.option("--folder", type=click.Path(file_okay=False, path_type=Path))
@click.option("--verbose", is_flag=True, help="Print the headline of every flight, too.")
def main(
    count: int, first: int, jobs: int, chosen: tuple[str, ...], folder: Path | None, verbose: bool
) -> None:
    """Simulates flights that go wrong and sound ones, and prints what the review makes of them, by kind and half.

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
        shown = rows[["kind", "number", "vehicle", "verdict", "headline", "lights"]]
        print_table("What is said of each flight", shown)
    print_table("Flights that go wrong, by kind", summary(rows))
    print_table("All kinds together", totals(rows))


if __name__ == "__main__":
    main()
