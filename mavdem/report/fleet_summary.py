"""The summary of many flights: vehicles that need a look, flights, logs that were not used, and their counts."""

from collections import Counter
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import PurePath

from mavdem.containers import JsonValues, group_by
from mavdem.facts import Level
from mavdem.facts.motors import MotorHealth
from mavdem.fleet.flights import HEALTHS
from mavdem.fleet.names import NO_NAMES, GivenNames
from mavdem.fleet.row import UNKNOWN
from mavdem.report.blocks import Blocks, Table
from mavdem.report.fleet import MAX_URGENT_RANK, truncated, vehicle_label
from mavdem.report.numbers import abbreviated_list, listed
from mavdem.report.templates import as_clause, capitalize_first, render_section
from mavdem.report.vehicle_summary import UnusedRow, VehicleFlights, VehicleSummary

TIER_WORDS = {
    "a": "with a full model",
    "b": "with a model of slow motion",
    "c": "with the vehicle's condition alone",
    "": "of unknown tier",
}
"""Names shown for the tiers."""

SECONDS_PER_HOUR = 3600
"""Seconds of an hour."""

MAX_REASONS = 8
"""Reasons why logs were not used that are shown, the most frequent ones."""

MAX_FILE_LENGTH = 40
"""Letters of a file's name in a table."""


def fleet_blocks(
    summaries: Sequence[VehicleSummary],
    *,
    names_vehicles: bool = True,
    names: GivenNames = NO_NAMES,
) -> Blocks:
    """Returns the summary of a fleet: a headline, the flights, and a table of the reasons why logs were not used.

    Vehicles with a name of their own are counted. Flights under a shared or unknown name are counted separately,
    because neither the number of their vehicles nor duplicates among them can be known.

    Args:
        summaries: summary of the flights under each name.
        names_vehicles: whether the headline names the vehicles that need attention, which a page shows below it.
        names: names that were given to vehicles.

    Returns:
        Sentences and the table.
    """
    vehicles = vehicles_with_parts(summaries)
    named_count = 0
    unjudged_count = 0
    unnamed_flights = 0
    for summary in summaries:
        if summary.has_shared_name:
            unnamed_flights += summary.flown.flights
        elif summary.vehicle is not None:
            named_count += 1
            if summary.vehicle.health == UNKNOWN:
                unjudged_count += 1
    blocks = render_section(
        "fleet",
        **_health_summary(vehicles, names),
        vehicles=named_count,
        names_vehicles=names_vehicles,
        all_known=named_count == len(vehicles),
        flown=_flown_summary(summaries),
        duplicate_logs=sum(summary.flown.duplicates for summary in summaries),
        unjudged=unjudged_count,
        unnamed_flights=unnamed_flights,
        bad_unnamed_flights=_bad_unnamed_flights(summaries, vehicles),
    )
    unused = [row for summary in summaries for row in summary.unused if row.is_first]
    return [*blocks, *_unused_blocks(unused)]


def _bad_unnamed_flights(
    summaries: Sequence[VehicleSummary], vehicles: Mapping[str, VehicleFlights]
) -> int:
    """Counts the bad flights of unknown vehicles, except flights that the headline counts as a vehicle already.

    Under a shared name, such as a system id, each flight may be of another vehicle, so that a later good one does not
    make up for a bad one.

    Args:
        summaries: summary of the flights under each name.
        vehicles: summary of the flights of each vehicle that has a part of the page, by its name. The headline counts a
            shared name as one vehicle if the last flight under it is bad.

    Returns:
        Number of flights.
    """
    count = 0
    for summary in summaries:
        if not summary.has_shared_name:
            continue
        count += summary.bad_flights
        vehicle = vehicles.get(summary.name)
        if vehicle is not None and vehicle.last.badge_level is Level.BAD:
            count -= 1
    return count


def vehicles_with_parts(summaries: Sequence[VehicleSummary]) -> dict[str, VehicleFlights]:
    """Returns what is known of each vehicle of which a page has a part, by its name."""
    vehicles = {}
    for summary in summaries:
        if summary.vehicle is not None and summary.vehicle.is_one_vehicle:
            vehicles[summary.name] = summary.vehicle
    return vehicles


def fleet_counts(summaries: Sequence[VehicleSummary]) -> JsonValues:
    """Counts the flights of a fleet.

    A flight has a row for each axis, and counts by the best tier and the worst health of its rows. A tier is the kind
    of model that a log allows: "a" full, "b" of the slow motion, "c" none. A flight in several logs counts once.

    Args:
        summaries: summary of the flights under each name.

    Returns:
        Plain JSON values: ``flights``; ``vehicles``, those with a name of their own, which a system id is not;
        ``tiers`` and ``health``, flights by tier and by health; and ``failed``, the file, status and code of the status
        of each log without a flight.
    """
    tiers: Counter[str] = Counter()
    healths: Counter[str] = Counter()
    named_vehicles = 0
    # A log may have several rows without a flight, one for each vehicle. A dictionary keeps their order.
    failures = {}
    for summary in summaries:
        tiers.update(summary.flown.tiers)
        healths.update(summary.flown.healths)
        if summary.vehicle is not None and not summary.has_shared_name:
            named_vehicles += 1
        for row in summary.unused:
            failures[row.file, row.status, row.status_code] = row
    return {
        "flights": sum(summary.flown.flights for summary in summaries),
        "vehicles": named_vehicles,
        "tiers": {tier: tiers[tier] for tier in sorted(tiers) if tier},
        "health": {health: healths[health] for health in HEALTHS if healths[health]},
        "failed": [
            {"file": row.file, "status": row.status, "status_code": row.status_code}
            for row in failures.values()
        ],
    }


def _health_summary(vehicles: Mapping[str, VehicleFlights], names: GivenNames) -> dict[str, object]:
    """Returns the values for the fleet's headline: vehicles that need a look, recovered ones, and healthy ones.

    A vehicle has recovered if its motors are healthy now, but had a fault or a drift in an earlier flight.

    Args:
        vehicles: summary of each vehicle, by its name in the logs.
        names: names that were given to vehicles.

    Returns:
        Values by the names that the template uses: "ill", "watched", "judged" and "recovered_count" are numbers of
        vehicles, "named" and "recovered" lists in words. Watched are those whose row is of that colour, but which do
        not need a look.
    """
    labels = {
        name: vehicle_label(name, vehicle.last.frame, names) for name, vehicle in vehicles.items()
    }
    urgent = []
    watched_count = 0
    for name in sorted(vehicles, key=lambda name: (vehicles[name].urgency, name)):
        vehicle = vehicles[name]
        if vehicle.urgency.rank < MAX_URGENT_RANK:
            urgent.append(f"{labels[name]} ({as_clause(vehicle.words.conclusion)})")
        elif vehicle.last.badge_level is Level.WATCH:
            watched_count += 1
    healthy = [name for name in vehicles if vehicles[name].health == MotorHealth.OK]
    recovered = [labels[name] for name in healthy if vehicles[name].was_in_trouble]
    return {
        "ill": len(urgent),
        "watched": watched_count,
        "named": abbreviated_list(urgent),
        "recovered": abbreviated_list(sorted(recovered)),
        "recovered_count": len(recovered),
        "judged": len(healthy),
    }


def _flown_summary(summaries: Sequence[VehicleSummary]) -> dict[str, object] | None:
    """Returns the number of flights, hours of settled flight, dates, and what the logs allow in words.

    Args:
        summaries: summary of the flights under each name.

    Returns:
        Values by the names that the template "fleet" uses: "flights", "hours", "dates" (first and last), and "kinds",
        the counts of logs by tier, which is the kind of model that a log allows. None without a flight.
    """
    flight_count = 0
    seconds = 0.0
    tiers: Counter[str] = Counter()
    dates: list[datetime] = []
    for summary in summaries:
        flown = summary.flown
        flight_count += flown.flights
        seconds += flown.seconds
        tiers.update(flown.tiers)
        dates += [date for date in (flown.first_date, flown.last_date) if date is not None]
    if not flight_count:
        return None
    kinds = [f"{tiers[tier]} {words}" for tier, words in TIER_WORDS.items() if tiers[tier]]
    return {
        "flights": flight_count,
        "hours": seconds / SECONDS_PER_HOUR,
        "dates": [min(dates), max(dates)] if dates else [],
        "kinds": listed(kinds),
    }


def _unused_blocks(rows: Sequence[UnusedRow]) -> Blocks:
    """Returns a sentence and a table on why logs were not used, the most frequent reasons first.

    Each row of the table has the number of logs, the file name of one of them, and the reason. Logs are grouped
    by the code of their reason where there is one, because the sentences differ in their figures. Reasons of equal
    frequency are in the order of the alphabet. At most ``MAX_REASONS`` are listed.

    Args:
        rows: the first row of each log that was not used.

    Returns:
        The sentence and the table; no table without such logs.
    """
    rows_by_reason = group_by(rows, lambda row: row.status_code or row.status)
    ranked = sorted(rows_by_reason.items(), key=lambda item: (-len(item[1]), item[0]))
    cells = []
    for code, rows_of_reason in ranked[:MAX_REASONS]:
        # The sentence of one log contains its own figures, so several logs share the name of their code.
        if len(rows_of_reason) == 1:
            reason = rows_of_reason[0].status
        else:
            reason = capitalize_first(code.replace("_", " "))
        example = PurePath(rows_of_reason[0].file).name
        cells.append([str(len(rows_of_reason)), truncated(example, MAX_FILE_LENGTH), reason])
    sentences = render_section("fleet_unused", logs=len(rows))
    if not rows:
        return [*sentences]
    return [*sentences, Table(["logs", "for example", "reason"], cells, words=True)]
