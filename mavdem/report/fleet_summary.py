"""The summary of many flights: vehicles that need a look, flights, logs that were not used, and their counts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from datetime import datetime
from pathlib import PurePath
from typing import NamedTuple

from mavdem.containers import JsonValues, group_by
from mavdem.facts import Level
from mavdem.facts.lights import Light
from mavdem.facts.motors import MotorHealth
from mavdem.fleet.flights import HEALTHS
from mavdem.fleet.names import NO_NAMES, GivenNames
from mavdem.fleet.row import UNKNOWN
from mavdem.report.blocks import Blocks, Sentence, Table, truncated
from mavdem.report.fleet import ANOMALOUS_HEALTHS, vehicle_label
from mavdem.report.flight_lines import FlightLine
from mavdem.report.heading import listed_headline, listed_next_step
from mavdem.report.numbers import abbreviated_list, listed
from mavdem.report.templates import (
    as_clause,
    capitalize_first,
    render_section,
)
from mavdem.report.vehicle_summary import UnusedRow, VehicleFlights, VehicleSummary

TIER_WORDS = {
    "a": "a full model",
    "b": "a model of slow motion alone",
    "c": "figures of the vehicle's condition alone",
    "": "no figures",
}
"""What the log of a flight allows, by its tier."""

SECONDS_PER_HOUR = 3600
"""Seconds of an hour."""

SECONDS_PER_MINUTE = 60
"""Seconds of a minute."""

MINUTES_PER_HOUR = 60
"""Minutes of an hour."""

MIN_WHOLE_HOURS = 10
"""Hours from which on a time is stated in whole hours."""

MAX_REASONS = 8
"""Reasons why logs were not used that are shown, the most frequent ones."""

MAX_VEHICLE_LINES = 20
"""Vehicles that need a look with a line of their own on the terminal; the page has all. A choice."""

MAX_LINES_BEFORE_LIST = 5
"""Vehicles that need a look that all have a line above the page's list: a choice, the first screen of a telephone."""

WORST_LINES = 3
"""Lines above that list where more vehicles need a look: the worst ones, and how many follow. A choice."""

FLOWN_LEAD = "Flown:"
"""Lead of the last paragraph on vehicles and flights; remarks on single logs follow it."""

MAX_UNNAMED_LINES = 3
"""Flights of unknown vehicles with a line each, the bad ones on a page and those to be watched; a choice.

Of more, the list of flights has them.
"""

MAX_FILE_LENGTH = 40
"""Letters of a file's name in a table."""


def fleet_blocks(
    summaries: Sequence[VehicleSummary],
    names: GivenNames = NO_NAMES,
    *,
    lists_follow: bool = False,
) -> Blocks:
    """Returns the summary of a fleet: a headline, the flights, and a table of the reasons why logs were not used.

    Vehicles whose logs name them are counted. Flights under a shared or unknown name are counted separately, because
    neither the number of their vehicles nor duplicates among them can be known.

    Args:
        summaries: summary of the flights under each name.
        names: names that were given to vehicles.
        lists_follow: whether lists of the vehicles and flights that need a look stand below, as on a page. Lines on
            several vehicles then state what is wrong, and the list what to do.

    Returns:
        Sentences and the table.
    """
    shared_names = _shared_names(summaries)
    vehicles_of_headline = _vehicles_of_headline(summaries)
    headline, *paragraphs = _sentences_on_fleet(
        summaries, vehicles_of_headline, names, lists_follow=lists_follow
    )
    labelled_vehicles = _labelled_by_urgency(vehicles_of_headline, names, shared_names)
    urgent_lines = _urgent_vehicle_lines(labelled_vehicles, names, lists_follow=lists_follow)
    watched_lines = []
    if not lists_follow:
        watched_lines = _watched_vehicle_lines(labelled_vehicles, names)
    watched_flights = flights_of_unknown_vehicles(Level.WATCH, summaries)
    watched_lines += _lines_on_flights(watched_flights, MAX_UNNAMED_LINES)
    # A page lists the bad ones of them below.
    bad_lines = _lines_on_flights(
        flights_of_unknown_vehicles(Level.BAD, summaries),
        MAX_UNNAMED_LINES if lists_follow else MAX_VEHICLE_LINES,
    )
    # What is to be watched comes after the reason and the next step of a single vehicle that needs a look.
    leads = [paragraph.lead for paragraph in paragraphs]
    flown_index = leads.index(FLOWN_LEAD) if FLOWN_LEAD in leads else len(leads)
    unused_rows = [row for summary in summaries for row in summary.unused if row.is_first]
    return [
        headline,
        *urgent_lines,
        *bad_lines,
        *paragraphs[:flown_index],
        *watched_lines,
        *paragraphs[flown_index:],
        *_unused_blocks(unused_rows),
    ]


def _shared_names(summaries: Sequence[VehicleSummary]) -> set[str]:
    """Returns the names under which flights of several vehicles may have been recorded, such as a MAVLink system id."""
    return {summary.name for summary in summaries if summary.has_shared_name}


def _vehicles_of_headline(summaries: Sequence[VehicleSummary]) -> dict[str, VehicleFlights]:
    """Returns the vehicles that the headline of a fleet counts, by name.

    Under a shared name flights are counted, and not vehicles. The exception is a name whose flights the user has
    declared to be of one vehicle, by comparing the health of their motors.

    Args:
        summaries: summary of the flights under each name.
    """
    shared_names = _shared_names(summaries)
    vehicles = {}
    for name, vehicle in vehicles_with_section(summaries).items():
        if name not in shared_names or vehicle.health in ANOMALOUS_HEALTHS:
            vehicles[name] = vehicle
    return vehicles


def _sentences_on_fleet(
    summaries: Sequence[VehicleSummary],
    vehicles_of_headline: Mapping[str, VehicleFlights],
    names: GivenNames,
    *,
    lists_follow: bool,
) -> list[Sentence]:
    """Returns the headline of a fleet and the paragraphs below it, as the template "fleet" makes them.

    Args:
        summaries: summary of the flights under each name.
        vehicles_of_headline: the vehicles that the headline counts, by name.
        names: names that were given to vehicles.
        lists_follow: whether lists of the vehicles and flights that need a look stand below, as on a page.
    """
    counts = _headline_counts(summaries)
    return render_section(
        "fleet",
        health=_health_summary(vehicles_of_headline, names, _shared_names(summaries)),
        vehicles=counts.named_vehicles,
        # Otherwise some of the vehicles in the headline are flights under a shared name.
        are_all_named=counts.named_vehicles == len(vehicles_of_headline),
        flown=_flown_totals(summaries),
        duplicate_logs=counts.duplicate_logs,
        unjudged=counts.unjudged_vehicles,
        unnamed_flights=counts.unnamed_flights,
        bad_unnamed_logs=len(flights_of_unknown_vehicles(Level.BAD, summaries)),
        watched_unnamed_logs=len(flights_of_unknown_vehicles(Level.WATCH, summaries)),
        simulated_flights=counts.simulated_flights,
        undecided_flights=_labels_of_possibly_simulated_flights(summaries, names),
    )


def _labels_of_possibly_simulated_flights(
    summaries: Sequence[VehicleSummary], names: GivenNames
) -> list[str]:
    """Returns labels of the flights whose logs do not show whether they were simulated: "flight.ulg, 2026-03-09".

    Args:
        summaries: summary of the flights under each name.
        names: names that were given to flights.
    """
    return [flight.label(names) for summary in summaries for flight in summary.undecided_flights]


def _urgent_vehicle_lines(
    vehicles: Sequence[_LabelledVehicle], names: GivenNames, *, lists_follow: bool
) -> list[Sentence]:
    """Returns a line for each of the vehicles that need a look, the most urgent first, and one that counts the rest.

    Args:
        vehicles: the vehicles that the headline counts, the most urgent first.
        names: names that were given to vehicles and flights.
        lists_follow: whether a list of all vehicles stands below, as on a page. It says what to do; without it each
            line does.

    Returns:
        The lines; empty for a single vehicle, which the headline itself names.
    """
    urgent = [vehicle for vehicle in vehicles if vehicle.flights.needs_look]
    if len(urgent) < 2:
        return []
    shown = urgent[: _max_vehicle_lines(len(urgent), lists_follow=lists_follow)]
    lines = []
    for vehicle in shown:
        # The list has the flight and the next step of each vehicle.
        lines.append(_finding_line(vehicle) if lists_follow else _vehicle_line(vehicle, names))
    further_count = len(urgent) - len(shown)
    return [
        *lines,
        *render_section("fleet_further", count=further_count, lists_follow=lists_follow),
    ]


def _watched_vehicle_lines(
    vehicles: Sequence[_LabelledVehicle], names: GivenNames
) -> list[Sentence]:
    """Returns a line for each vehicle that is to be watched, and one that counts the vehicles beyond the first few.

    They are for a terminal: a page has a list of all vehicles instead.

    Args:
        vehicles: the vehicles that the headline counts, the most urgent first.
        names: names that were given to vehicles and flights.

    Returns:
        At most ``MAX_VEHICLE_LINES`` lines and that of the rest. Empty if the only vehicle with a warning is one to be
        watched: the headline itself says why.
    """
    watched = [vehicle for vehicle in vehicles if _is_only_watched(vehicle.flights)]
    has_urgent_vehicle = any(vehicle.flights.needs_look for vehicle in vehicles)
    if len(watched) == 1 and not has_urgent_vehicle:
        return []
    shown = watched[:MAX_VEHICLE_LINES]
    lines = [_vehicle_line(vehicle, names) for vehicle in shown]
    further_count = len(watched) - len(shown)
    return [*lines, *render_section("fleet_further", count=further_count, lists_follow=False)]


def _finding_line(vehicle: _LabelledVehicle) -> Sentence:
    """Returns what is wrong with a vehicle, in one line, such as "quad 1: motor 2 lost about 20 % of its thrust."."""
    finding = as_clause(listed_headline(vehicle.flights.texts.finding))
    return Sentence(f"{finding}.", lead=f"{vehicle.label}:")


def _vehicle_line(vehicle: _LabelledVehicle, names: GivenNames) -> Sentence:
    """Returns the line of a vehicle: what is wrong, in which flight, and what to do.

    For example "quad 1: motor 2 lost about 20 % of its thrust (flight.ulg, 2026-03-09) · Check motor 2."

    Args:
        vehicle: the vehicle, with the label that begins the line.
        names: names that were given to flights.
    """
    texts = vehicle.flights.texts
    finding = as_clause(listed_headline(texts.finding))
    text = f"{finding} ({vehicle.flights.finding_flight.label(names)})"
    if texts.next_step:
        text = f"{text} · {listed_next_step(texts.next_step)}"
    else:
        text += "."
    is_watched = _is_only_watched(vehicle.flights)
    return Sentence(text, lead=f"{vehicle.label}, to watch:" if is_watched else f"{vehicle.label}:")


def _max_vehicle_lines(urgent_count: int, *, lists_follow: bool) -> int:
    """Returns how many of the vehicles that need a look have a line.

    Args:
        urgent_count: number of these vehicles.
        lists_follow: whether a list of all vehicles stands below.

    Returns:
        ``MAX_VEHICLE_LINES`` without a list. Above a list all of a few vehicles have one, and of more the worst.
    """
    if not lists_follow:
        return MAX_VEHICLE_LINES
    return urgent_count if urgent_count <= MAX_LINES_BEFORE_LIST else WORST_LINES


def flights_of_unknown_vehicles(
    level: Level, summaries: Sequence[VehicleSummary]
) -> list[FlightLine]:
    """Returns the flights of a level whose vehicle is not known, the simulated ones left out.

    Logs that do not name their vehicle are grouped by its MAVLink system id, a name that several vehicles may share.
    Every such flight counts, since a good one that follows may be of another vehicle. The exception is the latest
    flight under a name whose motors have a fault or drift: the fleet counts and describes that name as a vehicle.

    Args:
        level: the level, bad or to be watched.
        summaries: summary of the flights under each name.

    Returns:
        The lines of these flights in the table of all flights, the newest first and those without a date last.
    """
    vehicles = _vehicles_of_headline(summaries)
    flights: list[FlightLine] = []
    for summary in summaries:
        if not summary.has_shared_name:
            continue
        flown = [line for line in summary.lines if line.is_flight and not line.simulated]
        if summary.name in vehicles:
            flown = flown[:-1]
        flights.extend(line for line in flown if line.level is level)
    return sorted(flights, key=lambda line: line.seconds or 0.0, reverse=True)


def _lines_on_flights(flights: Sequence[FlightLine], max_lines: int) -> list[Sentence]:
    """Returns a line with file, finding and link for each flight; none at all for more flights than ``max_lines``."""
    if len(flights) > max_lines:
        return []
    lines = []
    for flight in flights:
        label = f"{flight.cell('flight')} ({flight.cell('vehicle')})"
        lead = f"{label}, to watch:" if flight.level is Level.WATCH else f"{label}:"
        lines.append(Sentence(f"{as_clause(flight.finding)}.", lead, address=flight.link))
    return lines


class _HeadlineCounts(NamedTuple):
    """Numbers of vehicles, flights and logs that the headline of a fleet states."""

    named_vehicles: int
    """Vehicles whose logs name them."""

    unjudged_vehicles: int
    """Those of them whose motors were judged in no flight."""

    unnamed_flights: int
    """Flights under a name that several vehicles may share."""

    simulated_flights: int
    """Flights that were simulated."""

    duplicate_logs: int
    """Further logs of a flight that is counted already."""


def _headline_counts(summaries: Sequence[VehicleSummary]) -> _HeadlineCounts:
    """Counts vehicles, flights and logs for the headline of a fleet.

    Args:
        summaries: summary of the flights under each name.
    """
    named_vehicles = 0
    unjudged_vehicles = 0
    unnamed_flights = 0
    simulated_flights = 0
    duplicate_logs = 0
    for summary in summaries:
        simulated_flights += summary.flown.simulated
        duplicate_logs += summary.flown.duplicates
        if summary.has_shared_name:
            unnamed_flights += summary.flown.flights
        elif summary.vehicle is not None:
            named_vehicles += 1
            if summary.vehicle.health == UNKNOWN:
                unjudged_vehicles += 1
    return _HeadlineCounts(
        named_vehicles,
        unjudged_vehicles=unjudged_vehicles,
        unnamed_flights=unnamed_flights,
        simulated_flights=simulated_flights,
        duplicate_logs=duplicate_logs,
    )


def vehicles_with_section(summaries: Sequence[VehicleSummary]) -> dict[str, VehicleFlights]:
    """Returns the vehicles that have a section of their own on a fleet's page.

    A name has none if its flights may be of several vehicles, unless something is wrong with them.

    Args:
        summaries: summary of the logs under each name.

    Returns:
        Summary of the vehicle's flights by the vehicle's name.
    """
    vehicles = {}
    for summary in summaries:
        if summary.vehicle is not None and summary.vehicle.has_section:
            vehicles[summary.name] = summary.vehicle
    return vehicles


def fleet_counts(summaries: Sequence[VehicleSummary]) -> JsonValues:
    """Counts the flights of a fleet for its JSON document.

    A log has a row for each axis, and counts by the best tier and the worst health of its rows. A tier is the kind of
    model that it allows: "a" full, "b" of the slow motion, "c" none. A flight in several logs counts once.

    Args:
        summaries: summary of the flights under each name.

    Returns:
        Plain JSON values: ``flights``; ``vehicles``, whose name is not a mere MAVLink system id; ``tiers`` and
        ``health``, logs by tier and by health; and ``failed``, the file, status and code of the status of each log
        without a flight.
    """
    flight_count = 0
    named_vehicles = 0
    logs_by_tier: Counter[str] = Counter()
    logs_by_health: Counter[str] = Counter()
    # A log may have several rows without a flight, one for each vehicle. The key makes each log count once.
    failed_logs = {}
    for summary in summaries:
        flight_count += summary.flown.flights
        logs_by_tier.update(summary.flown.tiers)
        logs_by_health.update(summary.flown.healths)
        if summary.vehicle is not None and not summary.has_shared_name:
            named_vehicles += 1
        for row in summary.unused:
            failed_logs[row.file, row.status, row.status_code] = {
                "file": row.file,
                "status": row.status,
                "status_code": row.status_code,
            }
    return {
        "flights": flight_count,
        "vehicles": named_vehicles,
        "tiers": {tier: logs_by_tier[tier] for tier in sorted(logs_by_tier) if tier},
        "health": {health: logs_by_health[health] for health in HEALTHS if logs_by_health[health]},
        "failed": list(failed_logs.values()),
    }


def motor_health_by_vehicle(summaries: Sequence[VehicleSummary]) -> dict[str, JsonValues]:
    """Returns how the motors of each vehicle are judged, for the JSON document of a fleet.

    Args:
        summaries: summary of the flights under each name.

    Returns:
        Plain JSON values by the name of the vehicle: ``health``, the ``sentence`` that lists and pages show, and
        ``next_step``. Names that several vehicles may share have none, unless their motors were judged.
    """
    motor_health: dict[str, JsonValues] = {}
    for name, vehicle in vehicles_with_section(summaries).items():
        motor_health[name] = {
            "health": vehicle.health,
            # The latest flight alone is described where its motors have no anomaly.
            "sentence": vehicle.texts.reason or vehicle.texts.latest_flight,
            "next_step": vehicle.texts.next_step,
        }
    return motor_health


class HealthSummary(NamedTuple):
    """How many vehicles of a fleet need a look, have recovered, and are healthy."""

    urgent_count: int
    """Number of vehicles that need a look: with a fault or a drift of the motors, or a bad headline."""

    urgent_list: str
    """A single one of these vehicles in words, with what was found. Empty of several, of which a line each follows."""

    watched_count: int
    """Number of vehicles that do not need a look, but whose latest flight has the level "watch"."""

    watched_list: str
    """These vehicles in words, the first with its finding; empty where another needs a look."""

    has_watched_motors: bool
    """Whether the motors are to be watched of a vehicle that shows no drift: its first flights may show the same."""

    recovered_list: str
    """The vehicles whose motors are healthy now, but had a fault or a drift in an earlier flight, in words."""

    healthy_count: int
    """Number of vehicles whose motors are healthy."""

    reason: str
    """Why the motors of the only urgent vehicle are judged as they are; empty of several."""

    flight: str
    """Name and day of the flight that shows this."""

    next_step: str
    """What to do next about the only vehicle that needs a look or, without one, that is to be watched; empty of
    several. The label of the vehicle stands before it, unless the fleet has no other one."""


def _health_summary(
    vehicles: Mapping[str, VehicleFlights],
    names: GivenNames,
    shared_names: Collection[str],
) -> HealthSummary:
    """Summarises the vehicles of a fleet for its headline: which need a look, what to do next, how many are healthy.

    Args:
        vehicles: summary of each vehicle, by its name in the logs.
        names: names that owners gave to vehicles.
        shared_names: names in the logs that are MAVLink system ids, which several vehicles may have.

    Returns:
        The summary. It names a single vehicle that needs a look, with the reason and the next step. Of several, a line
        each follows the headline (:func:`_urgent_vehicle_lines`), so that the summary only counts them.
    """
    labelled_vehicles = _labelled_by_urgency(vehicles, names, shared_names)
    urgent = [vehicle for vehicle in labelled_vehicles if vehicle.flights.needs_look]
    healthy = [vehicle for vehicle in labelled_vehicles if vehicle.flights.health == MotorHealth.OK]
    recovered_labels = [vehicle.label for vehicle in healthy if vehicle.flights.had_anomaly]
    watched = [vehicle for vehicle in labelled_vehicles if _is_only_watched(vehicle.flights)]
    urgent_list = ""
    reason = ""
    flight = ""
    next_step = ""
    described = urgent or watched
    if len(described) == 1:
        flight = described[0].flights.finding_flight.label(names)
        next_step = _next_step_of_vehicle(described[0])
    if len(urgent) == 1:
        urgent_list = _urgent_text(urgent[0])
        reason = _reason(urgent[0])
    return HealthSummary(
        urgent_count=len(urgent),
        urgent_list=urgent_list,
        watched_count=len(watched),
        watched_list="" if urgent else _watched_text(watched),
        has_watched_motors=any(_has_watched_motors(vehicle.flights) for vehicle in watched),
        recovered_list=abbreviated_list(sorted(recovered_labels)),
        healthy_count=len(healthy),
        reason=reason,
        flight=flight,
        next_step=next_step,
    )


class _LabelledVehicle(NamedTuple):
    """A vehicle of a fleet with the name by which the headline of the fleet calls it."""

    label: str
    """What it is called: a name that somebody or its logs gave, or its frame and both ends of a serial number."""

    subject: str
    """What a sentence on it begins with: the label and a colon. It is empty for the only vehicle of a fleet."""

    flights: VehicleFlights
    """What is known of it from its flights together."""


def _labelled_by_urgency(
    vehicles: Mapping[str, VehicleFlights], names: GivenNames, shared_names: Collection[str]
) -> list[_LabelledVehicle]:
    """Returns the vehicles of a fleet, the most urgent one first; of equally urgent ones the first in the alphabet.

    Args:
        vehicles: summary of each vehicle, by its name in the logs.
        names: names that owners gave to vehicles.
        shared_names: names in the logs that are MAVLink system ids, which several vehicles may have.
    """
    labelled_vehicles = []
    for name in sorted(vehicles, key=lambda name: (vehicles[name].urgency_and_age, name)):
        flights = vehicles[name]
        is_shared = name in shared_names
        label = vehicle_label(name, flights.last.frame, names, is_shared=is_shared)
        subject = "" if len(vehicles) == 1 else f"{label}: "
        labelled_vehicles.append(_LabelledVehicle(label, subject, flights))
    return labelled_vehicles


def _next_step_of_vehicle(vehicle: _LabelledVehicle) -> str:
    """Returns what to do next about a vehicle, after its label if the fleet has others; empty if it has none."""
    next_step = vehicle.flights.texts.next_step
    return f"{vehicle.subject}{next_step}" if next_step else ""


def _urgent_text(vehicle: _LabelledVehicle) -> str:
    """Returns the label of a vehicle that needs a look, and in parentheses what was found in its latest flight."""
    finding = as_clause(vehicle.flights.texts.latest_flight)
    return f"{vehicle.label} ({finding})"


def _watched_text(vehicles: Sequence[_LabelledVehicle]) -> str:
    """Returns a list, in words, of vehicles whose latest flight had a warning; the first with what was found.

    For example: "quad 1 (motor 3 works 12 % harder), quad 2"; empty without vehicles.
    """
    texts = []
    for number, vehicle in enumerate(vehicles):
        finding = vehicle.flights.texts.finding
        has_finding = number == 0 and bool(finding)
        texts.append(f"{vehicle.label} ({as_clause(finding)})" if has_finding else vehicle.label)
    return abbreviated_list(texts)


def _is_only_watched(vehicle: VehicleFlights) -> bool:
    """Returns whether the latest flight of a vehicle has a warning (level "watch"), but none that needs a look now."""
    return vehicle.last.badge_level is Level.WATCH and not vehicle.needs_look


def _has_watched_motors(vehicle: VehicleFlights) -> bool:
    """Returns whether the latest flight warns of the motors, while a comparison with other flights finds no change."""
    is_unchanged = vehicle.health == MotorHealth.OK
    return is_unchanged and vehicle.last.lights.get(Light.MOTORS) is Level.WATCH


def _reason(vehicle: _LabelledVehicle) -> str:
    """Returns why the motors of a vehicle are judged as they are, after its label; empty without a reason."""
    reason = vehicle.flights.texts.reason
    return f"{vehicle.subject}{reason}" if reason else ""


class FlownTotals(NamedTuple):
    """How much a fleet has really flown, for the template of its page; of a fleet in a simulator, all its flights."""

    flights: int
    """Number of flights."""

    logs: int
    """Number of logs with these flights, without further logs of the same ones."""

    simulated: int
    """Number of simulated flights, which are besides those above, or all of them if no flight was real."""

    are_all_simulated: bool
    """Whether no flight was real."""

    named_vehicles: int
    """Number of vehicles, named by their logs, that made any of the flights that ``flights`` counts."""

    has_unnamed_vehicle: bool
    """Whether any of these flights is of a vehicle that its log does not name."""

    settled_time: str
    """Settled flight of all of them, such as "2.5 h"."""

    air_time: str
    """Time in the air of all of them; empty if it is not known of any."""

    dates: list[datetime]
    """First and last date of a flight; empty if no date is known."""

    kinds: str
    """The kinds of model that the logs allow (their tiers), in words, with the number of logs of each kind."""

    has_slow_logs: bool
    """Whether the log of any flight has too few messages a second for a full model, and so for margins."""


def flown_time_text(seconds: float) -> str:
    """Returns a time in the air as people read it: "20 s", "48 min", "2.5 h", or "35 h"."""
    if seconds < SECONDS_PER_MINUTE:
        return f"{seconds:.0f} s"
    hours = seconds / SECONDS_PER_HOUR
    if hours < 1:
        return f"{MINUTES_PER_HOUR * hours:.0f} min"
    return f"{hours:.2g} h" if hours < MIN_WHOLE_HOURS else f"{hours:.0f} h"


def _kinds_of_model_text(logs_by_tier: Mapping[str, int]) -> str:
    """Returns how many logs allow which kind of model, such as "a full model (12) and slow motion (3)".

    Args:
        logs_by_tier: number of logs by tier, the kind of model that they allow; a tier may be missing.
    """
    texts = []
    # In the order from the best tier to none.
    for tier, model_description in TIER_WORDS.items():
        log_count = logs_by_tier.get(tier, 0)
        if log_count:
            texts.append(f"{model_description} ({log_count})")
    return listed(texts)


def _flown_totals(summaries: Sequence[VehicleSummary]) -> FlownTotals | None:
    """Adds up the real flights of a fleet, their duration, and how many logs allow each kind of model (their tier).

    Args:
        summaries: for each vehicle of the fleet, the summary of its flights.

    Returns:
        The totals, with the first and the last date of a flight. If no flight was real, those of the simulated ones;
        None without any log of a flight.
    """
    flight_count = 0
    log_count = 0
    settled_seconds = 0.0
    air_seconds = 0.0
    logs_by_tier: Counter[str] = Counter()
    dates: list[datetime] = []
    named_vehicles = 0
    has_unnamed_vehicle = False
    simulated_count = sum(summary.flown.simulated for summary in summaries)
    are_all_simulated = not any(summary.really_flown.logs for summary in summaries)
    for summary in summaries:
        flown = summary.flown if are_all_simulated else summary.really_flown
        if not flown.logs:
            continue
        if summary.has_shared_name:
            has_unnamed_vehicle = True
        else:
            named_vehicles += 1
        flight_count += flown.flights
        log_count += flown.logs
        settled_seconds += flown.seconds
        air_seconds += flown.air_seconds
        logs_by_tier.update(flown.tiers)
        # Both dates are None if the logs of the vehicle have none.
        dates += [date for date in (flown.first_date, flown.last_date) if date is not None]
    if not log_count:
        return None
    return FlownTotals(
        flights=flight_count,
        logs=log_count,
        simulated=simulated_count,
        are_all_simulated=are_all_simulated,
        named_vehicles=named_vehicles,
        has_unnamed_vehicle=has_unnamed_vehicle,
        settled_time=flown_time_text(settled_seconds),
        air_time=flown_time_text(air_seconds) if air_seconds else "",
        dates=[min(dates), max(dates)] if dates else [],
        kinds=_kinds_of_model_text(logs_by_tier),
        has_slow_logs=logs_by_tier["b"] + logs_by_tier["c"] > 0,
    )


def _unused_blocks(rows: Sequence[UnusedRow]) -> Blocks:
    """Returns a sentence on how many logs were not used, and a table of the reasons, the most frequent first.

    Logs with the same reason share a row of the table: their number, the file name of one of them, and the reason. The
    reason is the sentence on the log, which has figures of its own; several logs have the name of its code instead. At
    most ``MAX_REASONS`` are listed.

    Args:
        rows: the first row of each log that was not used.

    Returns:
        The sentence and the table; no table without such logs.
    """
    rows_by_code = group_by(rows, lambda row: row.status_code or row.status)
    # The second sort is stable, so that reasons of equal frequency stay in the order of the alphabet.
    codes = sorted(rows_by_code)
    codes.sort(key=lambda code: len(rows_by_code[code]), reverse=True)
    table_rows = []
    for code in codes[:MAX_REASONS]:
        logs = rows_by_code[code]
        if len(logs) == 1:
            reason = logs[0].status
        else:
            reason = capitalize_first(code.replace("_", " "))
        example_file = PurePath(logs[0].file).name
        table_rows.append([str(len(logs)), truncated(example_file, MAX_FILE_LENGTH), reason])
    sentences = render_section("fleet_unused", logs=len(rows))
    if not rows:
        return [*sentences]
    return [*sentences, Table(["logs", "for example", "reason"], table_rows, words=True)]
