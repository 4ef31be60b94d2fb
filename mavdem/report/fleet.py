"""What is said of many flights: which vehicles need a look, what was flown, and which logs could not be used."""

from collections import Counter
from collections.abc import Mapping
from pathlib import PurePath

from mavdem.containers import group_by
from mavdem.facts import Level
from mavdem.facts.motors import MotorHealth
from mavdem.fleet import flights as fleet_flights
from mavdem.fleet.difference import Flights
from mavdem.fleet.flights import HEALTHS, has_shared_name, worst_health, worst_row
from mavdem.fleet.row import UNKNOWN, FlightRows
from mavdem.report.blocks import Blocks, Rated, Table
from mavdem.report.condition import TIER_WORDS
from mavdem.report.numbers import abbreviated_list, listed
from mavdem.report.templates import as_clause, capitalize_first, render_section

TROUBLED_HEALTHS = MotorHealth.FAULT, MotorHealth.DRIFT
HEALTH_LEVELS = {
    MotorHealth.FAULT: Level.BAD,
    MotorHealth.DRIFT: Level.WATCH,
    MotorHealth.OK: Level.GOOD,
    MotorHealth.UNKNOWN: Level.UNKNOWN,
}
"""The level by which the health of motors is shown."""
NOT_USED = "not used"  # in the place of the health of a log without a flight
MAX_REASONS = 8  # why logs could not be used, the most frequent ones


def fleet_blocks(rows: FlightRows) -> Blocks:
    """Returns the summary of a fleet: a headline, what was flown, and why logs could not be used."""
    vehicles = fleet_flights.vehicles_of(rows)
    named = {name: flights for name, flights in vehicles.items() if is_one_vehicle(name, flights)}
    once = {
        name: fleet_flights.distinct_flights(flights)
        for name, flights in named.items()
        if not has_shared_name(flights)
    }
    flown = [flight for name in vehicles for flight in once.get(name, vehicles[name])]
    unjudged = [name for name in once if vehicle_health(named[name]) == UNKNOWN]
    blocks = [
        *render_section(
            "fleet",
            **_needs_a_look(named),
            vehicles=len(once),
            all_known=len(once) == len(named),
            flown=_flown(flown),
            twice=sum(len(vehicles[name]) - len(flights) for name, flights in once.items()),
            unjudged=len(unjudged),
            nameless=sum(len(flights) for name, flights in vehicles.items() if name not in once),
        )
    ]
    return blocks + _unused(
        [
            flight[0]
            for flight in fleet_flights.flights_of(row for row in rows if not row.has_flight)
        ]
    )


def is_one_vehicle(name: str, flights: Flights) -> bool:
    """Returns whether these are a vehicle's: of a system id, which many share, only if there is something to say."""
    return name != UNKNOWN and (
        not has_shared_name(flights)
        or vehicle_health(flights) != UNKNOWN
        or bad_headline(flights) != ""
    )


def vehicle_health(flights: Flights) -> str:
    """Returns what was found in a vehicle's latest flight that was judged; "unknown" if none was."""
    return next(
        (health for flight in reversed(flights) if (health := worst_health(flight)) != UNKNOWN),
        UNKNOWN,
    )


def bad_headline(flights: Flights) -> str:
    """Returns the headline of a vehicle's latest flight where that is bad, else nothing."""
    latest = flights[-1][0]
    return (latest.headline or "") if latest.headline_level == Level.BAD else ""


def badge(flights: Flights) -> str:
    """Returns how the latest of the ``flights`` went, at a glance; motors in trouble go first."""
    health = vehicle_health(flights)
    latest = flights[-1][0]
    if not latest.has_flight:
        return NOT_USED
    if health in TROUBLED_HEALTHS or latest.headline_level is None:
        return Rated(health, HEALTH_LEVELS[MotorHealth(health)])
    return Rated(latest.headline_level, Level(latest.headline_level))


def urgency(flights: Flights) -> tuple[float, float]:
    """Returns by what vehicles are sorted: the worst first, of these the one with the newest flight."""
    worst = HEALTHS.index(vehicle_health(flights))
    newest = flights[-1][0].date
    return min(worst, 1.5) if bad_headline(
        flights
    ) else worst, -newest.timestamp() if newest else 0.0


def vehicle_words(flights: Flights) -> tuple[str, str]:
    """Returns what one vehicle's latest flight that was judged shows, in a sentence, and what was found in all."""
    health = vehicle_health(flights)
    counts = Counter(map(worst_health, flights))
    reasons = (
        row.health_reason if row.is_read else row.status
        for flight in reversed(flights)
        for row in flight
    )
    troubled = (flight for flight in reversed(flights) if worst_health(flight) in TROUBLED_HEALTHS)
    conclusion, difference = render_section(
        "fleet_vehicle",
        health=health,
        in_trouble=health in TROUBLED_HEALTHS,
        doubt=bad_headline(flights),
        headline=flights[-1][0].headline,
        flights=len(flights),
        counts=counts,
        kinds=[kind for kind in TROUBLED_HEALTHS if counts[kind]],
        reason=next(filter(None, reasons), ""),
        row=next(map(worst_row, troubled), None),
        is_shared=has_shared_name(flights),
    )
    return conclusion.text, difference.text


def _needs_a_look(named: Mapping[str, Flights]) -> dict[str, object]:
    """The vehicles that need a look, the worst first, those that recovered, and how many show nothing."""
    sound = [name for name in named if vehicle_health(named[name]) == MotorHealth.OK]
    urgent = sorted((urgency(flights), name) for name, flights in named.items())
    ill = [
        f"{name} ({as_clause(vehicle_words(named[name])[0])})"
        for (level, _), name in urgent
        if level < 2
    ]
    recovered = [name for name in sound if {*TROUBLED_HEALTHS} & {*map(worst_health, named[name])}]
    return {
        "ill": len(ill),
        "named": abbreviated_list(ill),
        "recovered": abbreviated_list(sorted(recovered)),
        "judged": len(sound),
    }


def _flown(flown: Flights) -> dict[str, object] | None:
    """How much was flown, when, and at which tiers."""
    if not flown:
        return None
    seconds = (max(row.duration or 0.0 for row in flight) for flight in flown)
    tiers = Counter(map(fleet_flights.best_tier, flown))
    kinds = listed(f"{tiers[tier]} {words}" for tier, words in TIER_WORDS.items() if tiers[tier])
    dates = sorted(filter(None, (flight[0].date for flight in flown)))
    return {"flights": len(flown), "hours": sum(seconds) / 3600, "dates": dates, "kinds": kinds}


def _unused(refused: FlightRows) -> Blocks:
    """Why logs could not be used, the most frequent reason first."""
    by_reason = group_by(refused, lambda row: row.status_code or row.status)
    ranked = sorted(by_reason.items(), key=lambda item: (-len(item[1]), item[0]))
    cells = []
    for code, rows in ranked[:MAX_REASONS]:
        # a sentence has the figures of one log
        reason = rows[0].status if len(rows) == 1 else capitalize_first(code.replace("_", " "))
        cells.append(
            [truncated(reason, 70), str(len(rows)), truncated(PurePath(rows[0].file).name, 40)]
        )
    table = Table(["reason", "logs", "for example"], cells, words=True)
    return [*render_section("fleet_unused", logs=len(refused)), *([table] if refused else [])]


def truncated(text: str, longest: int) -> str:
    """Returns the text, shortened to so many letters."""
    return text if len(text) <= longest else f"{text[: longest - 1]}…"
