"""What the flights of one vehicle show: the motors' health, its status light, how urgently the vehicle needs a look."""

from collections import Counter
from typing import NamedTuple

from mavdem.facts import Level
from mavdem.facts.lights import Light
from mavdem.facts.motors import MotorHealth
from mavdem.facts.vehicle import autopilot_of_system_id_name
from mavdem.fleet.flights import (
    HEALTHS,
    AxisRows,
    Flights,
    has_shared_name,
    log_row,
    worst_health,
    worst_row,
)
from mavdem.fleet.names import GivenNames
from mavdem.fleet.row import UNKNOWN
from mavdem.report.blocks import Rated
from mavdem.report.templates import render_section

TROUBLED_HEALTHS = MotorHealth.FAULT, MotorHealth.DRIFT
"""Healths of the motors with which a vehicle needs a look."""

HEALTH_LEVELS = {
    MotorHealth.FAULT: Level.BAD,
    MotorHealth.DRIFT: Level.WATCH,
    MotorHealth.OK: Level.GOOD,
    MotorHealth.UNKNOWN: Level.UNKNOWN,
}
"""The level by which a page colours the health of the motors."""

MAX_NAME_LENGTH = 16
"""Letters of a vehicle's name that are shown whole; longer ones are serial numbers, of which the end is shown."""

SERIAL_START_LENGTH = 4
SERIAL_END_LENGTH = 6
"""First and last letters of a serial number that are shown: boards of one make differ in these.

It has the place of the processor on its wafer, which ArduPilot writes first and PX4 last, and the lot of the wafer,
which such boards share.
"""

AUTOPILOT_NAMES = {"ARDUPILOTMEGA": "ArduPilot", "PX4": "PX4"}
"""Names of autopilots by their MAV_AUTOPILOT."""

NOT_USED = "not used"
"""What is shown in the place of the health of a log without a flight."""

MAX_URGENT_RANK = 2
"""Ranks of :func:`urgency` below this one need a look: a fault, a bad headline, or a drift."""

BAD_HEADLINE_RANK = 1.5
"""Rank of a vehicle whose latest flight has a bad headline: after a drift, which has 1, before healthy motors."""


def light_level(flight: AxisRows, light: Light) -> Level:
    """Returns the level of a light of a flight; unknown if the log has none.

    A light is the judgement of one part of the vehicle, such as its motors. That of the motors is judged by the flight
    alone, and their health in comparison with other flights of the vehicle, which shows smaller losses. On pages of a
    fleet the light is at least as bad as the health, so that both say the same.

    Args:
        flight: rows of the flight, one for each axis.
        light: name of the status light, its subject, such as "motors".
    """
    # The rows of all axes have the same lights, in a field "light_motors", "light_power", … each.
    level_of_log = Level(getattr(log_row(flight), f"light_{light}") or Level.UNKNOWN)
    if light is not Light.MOTORS:
        return level_of_log
    return motors_level(level_of_log, HEALTH_LEVELS[MotorHealth(worst_health(flight))])


def motors_level(level_of_log: Level, health_level: Level) -> Level:
    """Returns the level of the light of the motors on pages of a fleet: the worse of two judgements.

    Args:
        level_of_log: level of the light by the log of the flight alone.
        health_level: level of the motors' health, for which the flight is compared with others of the vehicle. It
            counts only if it is worse.
    """
    if level_of_log is Level.BAD or health_level not in (Level.BAD, Level.WATCH):
        return level_of_log
    return health_level


class Urgency(NamedTuple):
    """What vehicles are sorted by, the most urgent first."""

    rank: float
    """Rank of the health, 0 for a fault; below ``MAX_URGENT_RANK`` the vehicle needs a look."""

    age: float
    """Minus the UNIX time of the latest flight, s; 0 where it has no date."""


class VehicleTexts(NamedTuple):
    """What a fleet's page says of one vehicle."""

    latest_flight: str
    """What the latest flight that was judged shows, such as "Motor 3: fault, probability of a fault 0.97."."""

    reason: str
    """How that flight differs from healthy ones, if its motors are in trouble; otherwise empty."""

    all_flights: str
    """In how many flights the motors had a fault or a drift, and the latest of these; may be empty."""


def is_serial(name: str) -> bool:
    """Returns whether the name that logs have for a vehicle is too long to be shown, such as a serial number."""
    return len(name) > MAX_NAME_LENGTH


def short_name(name: str) -> str:
    """Returns the name of a vehicle; a serial number is shortened to its first and last characters, as a line needs."""
    if not is_serial(name):
        return name
    return f"{name[:SERIAL_START_LENGTH]}…{name[-SERIAL_END_LENGTH:]}"


def unnamed_vehicle(autopilot: str, frame: str) -> str:
    """Returns the description of a vehicle whose logs do not identify it, such as "unnamed PX4 quadrotor".

    Args:
        autopilot: MAV_AUTOPILOT without its prefix; empty where it is not known.
        frame: kind of its frame, such as "QUADROTOR"; empty where it is not known.
    """
    frame_words = frame.replace("_", " ").lower() or "vehicle"
    autopilot_name = AUTOPILOT_NAMES.get(autopilot, "")
    return " ".join(word for word in ("unnamed", autopilot_name, frame_words) if word)


def vehicle_type(name: str, frame: str, names: GivenNames, *, is_shared: bool = False) -> str:
    """Returns the name of a vehicle at the beginning of its line; its type if its logs have only a serial number.

    Args:
        name: name of the vehicle in its logs.
        frame: kind of its frame, such as "QUADROTOR"; empty where it is not known.
        names: names that were given to vehicles.
        is_shared: whether its logs have a system id only, which several vehicles may have.
    """
    if name in names.vehicles:
        return names.vehicle(name)
    if is_shared and name != UNKNOWN:
        return unnamed_vehicle(autopilot_of_system_id_name(name), frame)
    if not is_serial(name):
        return name
    return frame.replace("_", " ").capitalize() or "Vehicle"


def vehicle_label(name: str, frame: str, names: GivenNames, *, is_shared: bool = False) -> str:
    """Returns the name of a vehicle in a sentence; its type and a shortened serial number if it has no other name.

    Args:
        name: name of the vehicle in its logs.
        frame: kind of its frame, such as "QUADROTOR"; empty where it is not known.
        names: names that were given to vehicles.
        is_shared: whether its logs have a system id only, which several vehicles may have.
    """
    label = vehicle_type(name, frame, names, is_shared=is_shared)
    if is_shared or name in names.vehicles or not is_serial(name):
        return label
    return f"{label} {short_name(name)}"


def has_section(name: str, flights: Flights) -> bool:
    """Returns whether a fleet's page has a section on the flights under a name, as on a vehicle.

    A log that does not name its vehicle has the MAVLink system id as its name, which several vehicles may share. Such
    flights have a section only if there is something to report: the health of the motors was judged in one, or the
    headline of the latest flight is bad.

    Args:
        name: name of the vehicle or vehicles in the logs; ``UNKNOWN`` if they have none.
        flights: rows of the flights under this name, in the order of date.
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
    latest_row = log_row(flights[-1])
    if latest_row.headline_level != Level.BAD:
        return ""
    return latest_row.headline or ""


def badge(flights: Flights) -> str:
    """Returns one word on the latest of a vehicle's flights, with its level.

    The word is the health of the motors if they are in trouble, and otherwise the level of the flight's headline.

    Args:
        flights: rows of the vehicle's flights, in the order of date.
    """
    latest_row = log_row(flights[-1])
    if not latest_row.has_flight:
        return NOT_USED
    health = vehicle_health(flights)
    if health in TROUBLED_HEALTHS or latest_row.headline_level is None:
        return Rated(health, HEALTH_LEVELS[MotorHealth(health)])
    return Rated(latest_row.headline_level, Level(latest_row.headline_level))


def badge_level(flights: Flights) -> Level:
    """Returns the level of the :func:`badge` of flights; unknown for a log that was not used."""
    badge_text = badge(flights)
    return badge_text.level if isinstance(badge_text, Rated) else Level.UNKNOWN


def urgency(flights: Flights) -> Urgency:
    """Returns the sort key of a vehicle in a list that begins with the vehicle that needs attention most.

    Of equal vehicles the one with the latest flight comes first. The rank is the position of the motors' health in
    ``HEALTHS``, which begins with the worst. If the headline of its latest flight is bad, a vehicle ranks directly
    after vehicles with drifting motors, unless its health ranks higher.

    Args:
        flights: flights of the vehicle in order of date, at least one.

    Returns:
        The key, which sorts in ascending order.
    """
    rank: float = HEALTHS.index(MotorHealth(vehicle_health(flights)))
    if bad_headline(flights):
        rank = min(rank, BAD_HEADLINE_RANK)
    latest_date = log_row(flights[-1]).past_date
    # A later date sorts before an earlier one. A flight without a date sorts last.
    negative_time = -latest_date.timestamp() if latest_date else 0.0
    return Urgency(rank, negative_time)


def vehicle_texts(flights: Flights) -> VehicleTexts:
    """Returns the texts on a vehicle for a fleet's page: on its latest judged flight, and on all its flights.

    The health of a flight is the judgement of its motors beside the vehicle's other flights: "ok", "drift", "fault" or
    "unknown". Motors with a drift or a fault are in trouble.

    Args:
        flights: flights of the vehicle in order of date, at least one; each has a row for each axis.
    """
    health = vehicle_health(flights)
    is_in_trouble = health in TROUBLED_HEALTHS
    # The latest flight with trouble gives the motor, the probability and the reason.
    latest_trouble = None
    for flight in reversed(flights):
        if worst_health(flight) in TROUBLED_HEALTHS:
            latest_trouble = worst_row(flight)
            break
    counts = Counter(worst_health(flight) for flight in flights)
    latest_flight, all_flights = render_section(
        "fleet_vehicle",
        health=health,
        is_in_trouble=is_in_trouble,
        bad_headline=bad_headline(flights),
        headline=log_row(flights[-1]).headline,
        flight_count=len(flights),
        counts=counts,
        troubled_healths=[health for health in TROUBLED_HEALTHS if counts[health]],
        reason=_reason_for_latest_health(flights),
        latest_trouble=latest_trouble,
        is_shared=has_shared_name(flights),
    )
    reason = ""
    if latest_trouble is not None and is_in_trouble:
        reason = first_sentence(latest_trouble.health_reason or "")
    return VehicleTexts(latest_flight.text, reason, all_flights.text)


def _reason_for_latest_health(flights: Flights) -> str:
    """Returns the reason for the health of the latest flight that has one, or why its log was not read; else "".

    Args:
        flights: rows of the vehicle's flights, in the order of date. The status of a row is why its log was not read.
    """
    for flight in reversed(flights):
        for row in flight:
            reason = row.health_reason if row.is_read else row.status
            if reason:
                return reason
    return ""


def first_sentence(text: str) -> str:
    """Returns the first sentence of a text; all of it where it has only one."""
    first, separator, _ = text.partition(". ")
    return f"{first}." if separator else text


def truncated(text: str, max_length: int) -> str:
    """Returns a text of at most so many letters; a longer one is cut, with "…"."""
    return text if len(text) <= max_length else f"{text[: max_length - 1]}…"
