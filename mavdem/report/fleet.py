"""The summary of many flights in sentences: vehicles that need a look, what was flown, and logs that were not used."""

from collections import Counter
from collections.abc import Mapping
from pathlib import PurePath
from typing import NamedTuple

from mavdem.containers import group_by
from mavdem.facts import Level
from mavdem.facts.motors import MotorHealth
from mavdem.fleet import flights as fleet_flights
from mavdem.fleet.flights import HEALTHS, Flights, has_shared_name, worst_health, worst_row
from mavdem.fleet.names import NO_NAMES, GivenNames
from mavdem.fleet.row import UNKNOWN, FlightRows
from mavdem.report.blocks import Blocks, Rated, Table
from mavdem.report.condition import TIER_WORDS
from mavdem.report.numbers import abbreviated_list, listed
from mavdem.report.templates import as_clause, capitalize_first, render_section

TROUBLED_HEALTHS = MotorHealth.FAULT, MotorHealth.DRIFT
"""Healths of the motors with which a vehicle needs a look."""

HEALTH_LEVELS = {
    MotorHealth.FAULT: Level.BAD,
    MotorHealth.DRIFT: Level.WATCH,
    MotorHealth.OK: Level.GOOD,
    MotorHealth.UNKNOWN: Level.UNKNOWN,
}
"""The level by which a page colours the health of the motors."""

NOT_USED = "not used"
"""What is shown in the place of the health of a log without a flight."""

MAX_URGENT_RANK = 2
"""Ranks of :func:`urgency` below this one need a look: a fault, a bad headline, or a drift."""

BAD_HEADLINE_RANK = 1.5
"""Rank of a vehicle whose latest flight has a bad headline: after a drift, which has 1, before healthy motors."""

MAX_REASONS = 8
"""Reasons why logs were not used that are shown, the most frequent ones."""

MAX_REASON_LENGTH = 70
"""Letters of such a reason in a table."""

MAX_FILE_LENGTH = 40
"""Letters of a file's name in a table."""


class Urgency(NamedTuple):
    """What vehicles are sorted by, the most urgent first."""

    rank: float
    """Rank of the health, 0 for a fault; below ``MAX_URGENT_RANK`` the vehicle needs a look."""

    age: float
    """Minus the UNIX time of the latest flight, s; 0 where it has no date."""


class VehicleWords(NamedTuple):
    """What a page says of one vehicle."""

    conclusion: str
    """What the latest judged flight shows."""

    difference: str
    """What was found in all flights; may be empty."""


def fleet_blocks(
    rows: FlightRows, names_vehicles: bool = True, names: GivenNames = NO_NAMES
) -> Blocks:
    """Returns the summary of a fleet: a headline, what was flown, and a table of why logs were not used.

    Vehicles with a name of their own are counted as such. Flights under a shared or unknown name are counted apart,
    because neither the number of their vehicles nor duplicates among them can be known.

    Args:
        rows: rows of all flights and axes, and of logs without a flight.
        names_vehicles: whether the headline names the vehicles that need a look, which a page shows below it.
        names: names that were given to vehicles.
    """
    vehicles = fleet_flights.vehicles_of(rows)
    shown_vehicles = {
        name: flights for name, flights in vehicles.items() if is_one_vehicle(name, flights)
    }
    # Two logs of one flight count once, where it is certain that they are of one vehicle.
    distinct_flights = {
        name: fleet_flights.distinct_flights(flights)
        for name, flights in shown_vehicles.items()
        if not has_shared_name(flights)
    }
    flown = []
    nameless_count = 0
    duplicate_count = 0
    for name, flights in vehicles.items():
        if name in distinct_flights:
            flown += distinct_flights[name]
            duplicate_count += len(flights) - len(distinct_flights[name])
        else:
            flown += flights
            nameless_count += len(flights)
    unjudged = [name for name in distinct_flights if vehicle_health(vehicles[name]) == UNKNOWN]
    summary = render_section(
        "fleet",
        **_health_summary(shown_vehicles, names),
        vehicles=len(distinct_flights),
        names_vehicles=names_vehicles,
        all_known=len(distinct_flights) == len(shown_vehicles),
        flown=_flown_summary(flown),
        twice=duplicate_count,
        unjudged=len(unjudged),
        nameless=nameless_count,
    )
    unused = fleet_flights.flights_of(row for row in rows if not row.has_flight)
    return [*summary, *_unused_blocks([flight[0] for flight in unused])]


def is_one_vehicle(name: str, flights: Flights) -> bool:
    """Returns whether a page has a part of its own for the flights under a name.

    Where logs do not name their vehicle, its MAVLink system id is its name, which several vehicles may share. Such
    flights have a part only if there is something to report: a judged health, or a bad headline of the latest flight.

    Args:
        name: name of the vehicle or vehicles.
        flights: the flights under this name.
    """
    if name == UNKNOWN:
        return False
    if not has_shared_name(flights):
        return True
    return vehicle_health(flights) != UNKNOWN or bad_headline(flights) != ""


def vehicle_health(flights: Flights) -> str:
    """Returns the health of a vehicle's motors in its latest flight that was judged; "unknown" if none was."""
    for flight in reversed(flights):
        health = worst_health(flight)
        if health != UNKNOWN:
            return health
    return UNKNOWN


def bad_headline(flights: Flights) -> str:
    """Returns the headline of a vehicle's latest flight if its level is bad, otherwise an empty text."""
    latest = flights[-1][0]
    if latest.headline_level != Level.BAD:
        return ""
    return latest.headline or ""


def badge(flights: Flights) -> str:
    """Returns how the latest of a vehicle's flights went in one word, with its level.

    It is the health of the motors where they are in trouble, otherwise the level of the flight's headline.
    """
    latest = flights[-1][0]
    if not latest.has_flight:
        return NOT_USED
    health = vehicle_health(flights)
    if health in TROUBLED_HEALTHS or latest.headline_level is None:
        return Rated(health, HEALTH_LEVELS[MotorHealth(health)])
    return Rated(latest.headline_level, Level(latest.headline_level))


def badge_level(flights: Flights) -> Level:
    """Returns the level of the :func:`badge` of flights; unknown for a log that was not used."""
    word = badge(flights)
    return word.level if isinstance(word, Rated) else Level.UNKNOWN


def urgency(flights: Flights) -> Urgency:
    """Returns the key by which the vehicles of a fleet are sorted: the worst first, of equal ones the latest flown.

    The rank is the position of the motors' health in ``HEALTHS``, which begins with the worst. If the headline of the
    latest flight is bad, the vehicle ranks at least just behind one whose motors drift.

    Args:
        flights: flights of the vehicle in order of date, at least one.
    """
    rank: float = HEALTHS.index(MotorHealth(vehicle_health(flights)))
    if bad_headline(flights):
        rank = min(rank, BAD_HEADLINE_RANK)
    latest_date = flights[-1][0].date
    return Urgency(rank, -latest_date.timestamp() if latest_date else 0.0)


def vehicle_words(flights: Flights) -> VehicleWords:
    """Returns two texts on a vehicle: the conclusion of its latest judged flight, and a summary of all its flights.

    The health of a flight is the judgement of its motors, such as "ok", "drift" or "fault". A vehicle whose motors are
    in trouble has a drift or a fault now. The latest flight with a drift or fault gives the figures of the texts.

    Args:
        flights: flights of the vehicle in order of date, at least one; each has a row for each axis.

    Returns:
        The texts, whose words come from the template "fleet_vehicle".
    """
    health = vehicle_health(flights)
    counts = Counter(worst_health(flight) for flight in flights)
    worst_troubled_row = None
    for flight in reversed(flights):
        if worst_health(flight) in TROUBLED_HEALTHS:
            worst_troubled_row = worst_row(flight)
            break
    conclusion, difference = render_section(
        "fleet_vehicle",
        health=health,
        in_trouble=health in TROUBLED_HEALTHS,
        doubt=bad_headline(flights),
        headline=flights[-1][0].headline,
        flights=len(flights),
        counts=counts,
        kinds=[kind for kind in TROUBLED_HEALTHS if counts[kind]],
        reason=_latest_reason(flights),
        row=worst_troubled_row,
        is_shared=has_shared_name(flights),
    )
    return VehicleWords(conclusion.text, difference.text)


def _latest_reason(flights: Flights) -> str:
    """Returns the latest reason for a health, or why a log was not read; empty without any."""
    for flight in reversed(flights):
        for row in flight:
            reason = row.health_reason if row.is_read else row.status
            if reason:
                return reason
    return ""


def _health_summary(vehicles: Mapping[str, Flights], names: GivenNames) -> dict[str, object]:
    """Returns the values for the fleet's headline: vehicles that need a look, recovered ones, and healthy ones.

    A vehicle has recovered if its motors are healthy now, but had a fault or a drift in an earlier flight.

    Args:
        vehicles: flights of each vehicle, by what its logs call it.
        names: names that were given to vehicles.

    Returns:
        Values by the names that the template uses: "ill", "judged" and "recovered_count" are numbers of vehicles,
        "named" and "recovered" lists in words.
    """
    ranked = sorted((urgency(flights), name) for name, flights in vehicles.items())
    urgent = [
        f"{names.vehicle(name)} ({as_clause(vehicle_words(vehicles[name]).conclusion)})"
        for (rank, _), name in ranked
        if rank < MAX_URGENT_RANK
    ]
    healthy = [name for name in vehicles if vehicle_health(vehicles[name]) == MotorHealth.OK]
    recovered = []
    for name in healthy:
        healths = {worst_health(flight) for flight in vehicles[name]}
        if not healths.isdisjoint(TROUBLED_HEALTHS):
            recovered.append(names.vehicle(name))
    return {
        "ill": len(urgent),
        "named": abbreviated_list(urgent),
        "recovered": abbreviated_list(sorted(recovered)),
        "recovered_count": len(recovered),
        "judged": len(healthy),
    }


def _flown_summary(flights: Flights) -> dict[str, object] | None:
    """Returns the number of flights, settled hours, dates, and counts of tiers in words; None without a flight.

    The rows of a flight may have different durations, since an axis may lack data; the longest counts.
    """
    if not flights:
        return None
    seconds = sum(max(row.duration or 0.0 for row in flight) for flight in flights)
    tiers = Counter(fleet_flights.best_tier(flight) for flight in flights)
    kinds = [f"{tiers[tier]} {words}" for tier, words in TIER_WORDS.items() if tiers[tier]]
    dates = sorted(flight[0].date for flight in flights if flight[0].date)
    return {
        "flights": len(flights),
        "hours": seconds / 3600,
        "dates": dates,
        "kinds": listed(kinds),
    }


def _unused_blocks(rows: FlightRows) -> Blocks:
    """Returns a sentence and a table on why logs were not used, the most frequent reasons first.

    Each row of the table has a reason, the number of logs with it, and the file name of one of them. Logs are grouped
    by the code of their reason where there is one, because the sentences differ in their figures. Reasons of equal
    frequency are in the order of the alphabet. At most ``MAX_REASONS`` are listed.

    Args:
        rows: the first row of each log that was not used.

    Returns:
        The sentence and the table; no table without such logs.
    """
    by_reason = group_by(rows, lambda row: row.status_code or row.status)
    ranked = sorted(by_reason.items(), key=lambda item: (-len(item[1]), item[0]))
    cells = []
    for code, same_reason in ranked[:MAX_REASONS]:
        # The sentence of one log contains its own figures, so several logs share the name of their code.
        if len(same_reason) == 1:
            reason = same_reason[0].status
        else:
            reason = capitalize_first(code.replace("_", " "))
        example = PurePath(same_reason[0].file).name
        cells.append(
            [
                truncated(reason, MAX_REASON_LENGTH),
                str(len(same_reason)),
                truncated(example, MAX_FILE_LENGTH),
            ]
        )
    sentences = render_section("fleet_unused", logs=len(rows))
    if not rows:
        return [*sentences]
    return [*sentences, Table(["reason", "logs", "for example"], cells, words=True)]


def truncated(text: str, max_length: int) -> str:
    """Returns a text of at most so many letters; a longer one is cut, with "…"."""
    return text if len(text) <= max_length else f"{text[: max_length - 1]}…"
