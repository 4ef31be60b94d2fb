"""What the flights of one vehicle show: the motors' health, its status light, how urgently the vehicle needs a look."""

from collections import Counter
from typing import NamedTuple

from mavdem.facts import Level
from mavdem.facts.lights import Light
from mavdem.facts.motors import LIKELY_PROBABILITY, MotorHealth, MotorsBetween
from mavdem.facts.urgency import Urgency, urgency_of_headline
from mavdem.facts.vehicle import (
    autopilot_of_system_id_name,
    frame_in_name,
    is_calibration_name,
    name_without_frame,
)
from mavdem.fleet.flights import (
    AxisRows,
    Flights,
    has_shared_name,
    log_row,
    worst_health,
    worst_row,
)
from mavdem.fleet.names import GivenNames
from mavdem.fleet.row import UNKNOWN, FlightRow
from mavdem.ingest.vocabulary import AUTOPILOT_NAMES
from mavdem.report.blocks import Sentence
from mavdem.report.templates import bans_first, first_sentence, render_section

ANOMALOUS_HEALTHS = MotorHealth.FAULT, MotorHealth.DRIFT
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

NOT_USED = "not used"
"""What is shown in the place of the health of a log without a flight."""

BY_LOG_ALONE = "By this log alone:"
"""What introduces the motors' light by a flight's log alone, behind an anomaly that other flights show."""

URGENCY_OF_HEALTHS = {
    MotorHealth.FAULT: Urgency.BAD,
    MotorHealth.DRIFT: Urgency.DRIFT,
    MotorHealth.OK: Urgency.GOOD,
    MotorHealth.UNKNOWN: Urgency.UNKNOWN,
}
"""Urgency of a vehicle by the health of its motors."""


def light_level(flight: AxisRows, light: Light) -> Level:
    """Returns how one part of a vehicle did in a flight: "good", "watch", "bad", or "unknown" if it was not judged.

    Most parts are judged by the log of the flight alone. The motors are also compared with other flights of the
    vehicle, which shows smaller losses of thrust. The worse of both judgements counts for them.

    Args:
        flight: rows of the flight in the fleet's table, one for each axis.
        light: the part that is judged (its status light on the page), such as the motors.
    """
    # The level of each part is a field of the row, such as "light_motors". It is the same in the rows of all axes.
    level_of_log = Level(getattr(log_row(flight), f"light_{light}") or Level.UNKNOWN)
    if light is not Light.MOTORS:
        return level_of_log
    health_level = HEALTH_LEVELS[MotorHealth(worst_health(flight))]
    return level_beside_other_flights(level_of_log, health_level)


def level_beside_other_flights(level_of_log: Level, health_level: Level) -> Level:
    """Returns the worse of two levels of a flight: by its log alone, and by comparing its motors with other flights.

    Args:
        level_of_log: level by the log alone, of the whole flight or of its motors.
        health_level: level of the motors by the comparison. It counts only if it is "bad" or "watch", since motors as
            good as in other flights do not disprove a warning of the log.
    """
    if level_of_log is Level.BAD or health_level not in (Level.BAD, Level.WATCH):
        return level_of_log
    return health_level


def is_headline_replaced(level_of_log: Level) -> bool:
    """Returns whether weak motors, found by comparison with other flights, come before what a flight's own log shows.

    They become the headline (the most serious finding) of the flight, unless the log shows something bad, such as a
    crash. Pages, lists, searches and documents of flights follow this one rule.

    Args:
        level_of_log: level of the headline by the log alone.
    """
    return level_of_log is not Level.BAD


class UrgencyAndAge(NamedTuple):
    """What vehicles are sorted by, the most urgent first."""

    urgency: Urgency
    """How urgently the vehicle needs a look."""

    age: float
    """Minus the UNIX time of the latest flight, s; 0 where it has no date."""


class VehicleTexts(NamedTuple):
    """What a fleet's page says of one vehicle."""

    latest_flight: str
    """What the latest flight that was judged shows, such as "Motor 3: fault, probability of a fault 0.97."."""

    reason: str
    """How that flight differs from healthy ones, if its motors have a fault or drift; otherwise empty."""

    all_flights: str
    """In how many flights the motors had a fault or a drift, and the latest of these; may be empty."""

    next_step: str
    """What to do next about what is wrong; empty where nothing is."""

    finding: str
    """What is wrong with the vehicle, in sentences, the most serious first; empty where nothing is."""


def is_serial(name: str) -> bool:
    """Returns whether the name that logs have for a vehicle is too long to be shown, such as a serial number."""
    return len(name) > MAX_NAME_LENGTH


def short_name(name: str) -> str:
    """Returns the name of a vehicle, short enough for a line of text, such as "3A00…0B2B37" for a serial number.

    Args:
        name: name of the vehicle in its logs. A type of frame may follow a serial number; the short name leaves it out,
            since pages show it beside the name.
    """
    if not is_serial(name):
        return name
    number = name_without_frame(name)
    if is_calibration_name(number):
        # The hash of a calibration names a vehicle without a serial number. Its beginning is the name of the sensor,
        # which many vehicles have in common.
        return f"…{number[-SERIAL_END_LENGTH:]}"
    return f"{number[:SERIAL_START_LENGTH]}…{number[-SERIAL_END_LENGTH:]}"


def unnamed_vehicle(autopilot: str, frame: str) -> str:
    """Returns a description in the place of the name of a vehicle that its logs do not identify.

    Args:
        autopilot: MAV_AUTOPILOT without its prefix, such as "PX4"; empty where it is not known.
        frame: type of the frame, such as "QUADROTOR"; empty where it is not known.

    Returns:
        Text such as "unnamed PX4 quadrotor", or "unnamed vehicle" if nothing is known.
    """
    return f"unnamed {kind_of_vehicle(autopilot, frame)}"


def kind_of_vehicle(autopilot: str, frame: str) -> str:
    """Returns autopilot and frame of a vehicle in words, such as "PX4 quadrotor"; "vehicle" if nothing is known.

    Args:
        autopilot: MAV_AUTOPILOT without its prefix, such as "PX4"; empty where it is not known.
        frame: type of the frame, such as "QUADROTOR"; empty where it is not known.
    """
    frame_name = frame.replace("_", " ").lower() or "vehicle"
    if autopilot not in AUTOPILOT_NAMES:
        return frame_name
    return f"{AUTOPILOT_NAMES[autopilot]} {frame_name}"


def vehicle_name_or_type(
    name: str, frame: str, names: GivenNames, *, is_shared: bool = False
) -> str:
    """Returns the name of a vehicle for people to read: the best name that is known, otherwise what kind it is.

    Args:
        name: name of the vehicle in its logs, which may be a serial number, or made of a MAVLink system id, such as
            "px4-1".
        frame: type of the frame, such as "QUADROTOR"; empty where it is not known.
        names: names that owners gave to vehicles, which come before all others.
        is_shared: whether the name in the logs is made of a MAVLink system id, which several vehicles may have.

    Returns:
        The first of these that applies:

        - the name that the owner gave;
        - for a system id, a description such as "unnamed PX4 quadrotor";
        - the name in the logs, unless it is a serial number;
        - the type of the frame, such as "Quadrotor", which the name may have too, or "Vehicle" if it is not known.
    """
    if name in names.vehicles:
        return names.vehicle(name)
    # Vehicles that are not known at all have the name ``UNKNOWN``, which is shown as it is.
    is_system_id = is_shared and name != UNKNOWN
    if is_system_id:
        return unnamed_vehicle(autopilot_of_system_id_name(name), frame)
    if not is_serial(name):
        return name
    frame_name = frame or frame_in_name(name)
    return frame_name.replace("_", " ").capitalize() or "Vehicle"


def vehicle_label(name: str, frame: str, names: GivenNames, *, is_shared: bool = False) -> str:
    """Returns what a page calls a vehicle, which tells it from others, such as "Quadrotor 3A00…0B2B37".

    Args:
        name: how the logs identify the vehicle: by a name, a serial number, a hash of its calibration or a system id.
        frame: type of the frame, such as "QUADROTOR"; empty where it is not known.
        names: names that owners gave to vehicles, which come before all others.
        is_shared: whether ``name`` is made of a MAVLink system id, which several vehicles may have.

    Returns:
        The name. A vehicle without one is called by its type and a part of its serial number or of the hash, as in
        "Quadrotor …6f6923" for a hash.
    """
    name_or_type = vehicle_name_or_type(name, frame, names, is_shared=is_shared)
    has_name_of_owner = name in names.vehicles
    is_identified_by_number = is_serial(name) and not is_shared
    if has_name_of_owner or not is_identified_by_number:
        return name_or_type
    # Several vehicles have the same type, so that a part of the number follows it.
    return f"{name_or_type} {short_name(name)}"


def has_section(name: str, flights: Flights) -> bool:
    """Returns whether the flights under a name have a section of their own on a fleet's page, as a vehicle has.

    A log that does not name its vehicle is filed under its MAVLink system id, which several vehicles may share. The
    flights under such a name have a section only if there is something to report: the health of the motors was judged
    in one, or the headline of the latest flight is bad. A crash in a simulator is nothing to report.

    Args:
        name: name of the vehicle or vehicles in the logs; ``UNKNOWN`` if they have none.
        flights: rows of the flights under this name, in the order of date.
    """
    if name == UNKNOWN:
        return False
    if not has_shared_name(flights):
        return True
    latest_went_badly = bad_headline(flights) != "" and not log_row(flights[-1]).simulated
    return vehicle_health(flights) != UNKNOWN or latest_went_badly


def vehicle_health(flights: Flights) -> str:
    """Returns the health of a vehicle's motors: that in the latest flight in which it was judged.

    Args:
        flights: flights of the vehicle in order of date; each has a row for each axis.

    Returns:
        "fault", "drift" or "ok"; "unknown" if no flight was judged.
    """
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
    """Returns the one word that a fleet's page shows for a vehicle: its level, or that its latest log was not used.

    Args:
        flights: rows of the vehicle's flights, in the order of date.

    Returns:
        "good", "watch", "bad" or "unknown" (:func:`badge_level`), or ``NOT_USED``.
    """
    return str(badge_level(flights)) if log_row(flights[-1]).has_flight else NOT_USED


def badge_level(flights: Flights) -> Level:
    """Returns how well a vehicle is: "good", "watch" or "bad"; "unknown" if its latest log could not be analysed.

    The worse of two levels counts: that of the most serious finding in the latest flight (its headline), and that of
    the motors' health in comparison with other flights. If the flight has no headline, only the motors count.

    Args:
        flights: rows of the vehicle's flights, in the order of date.
    """
    latest_row = log_row(flights[-1])
    if not latest_row.has_flight:
        return Level.UNKNOWN
    health_level = HEALTH_LEVELS[MotorHealth(vehicle_health(flights))]
    if latest_row.headline_level is None:
        return health_level
    return level_beside_other_flights(Level(latest_row.headline_level), health_level)


def urgency_and_age(flights: Flights) -> UrgencyAndAge:
    """Returns the key by which vehicles are sorted, so that a list begins with the one that needs attention most.

    The more urgent of two findings counts: the most serious one of the latest flight (its headline), and the health of
    the motors. If two vehicles are equally urgent, the one that flew last comes first.

    Args:
        flights: flights of the vehicle in order of date, at least one.

    Returns:
        The key, which sorts in ascending order.
    """
    latest_row = log_row(flights[-1])
    urgency_by_health = URGENCY_OF_HEALTHS[MotorHealth(vehicle_health(flights))]
    urgency_by_headline = urgency_of_headline(latest_row.headline_level, latest_row.headline_rank)
    # Urgencies are ordered from the most urgent one on.
    urgency = min(urgency_by_health, urgency_by_headline)
    latest_date = latest_row.past_date
    # A later date sorts before an earlier one. A flight without a date sorts last.
    negative_time = -latest_date.timestamp() if latest_date else 0.0
    return UrgencyAndAge(urgency, negative_time)


def vehicle_texts(flights: Flights, *, has_reason: bool = True) -> VehicleTexts:
    """Returns the texts about one vehicle on a fleet's page: what is wrong, in which flights, and what to do.

    Two judgements are stated. The health of a flight is that of its motors by comparison with the vehicle's other
    flights: "ok", "drift", "fault" or "unknown"; a drift or a fault is an anomaly. The headline of a flight is the most
    serious fact that its own log shows, such as a crash.

    Args:
        flights: flights of the vehicle in order of date, at least one; each has a row for each axis.
        has_reason: whether the text on all flights ends with the reason for the latest anomaly.
    """
    health = vehicle_health(flights)
    has_anomaly = health in ANOMALOUS_HEALTHS
    latest_anomalous_row = _latest_anomalous_row(flights)
    counts_by_health = Counter(worst_health(flight) for flight in flights)
    anomalous_healths = [name for name in ANOMALOUS_HEALTHS if counts_by_health[name]]
    # The section has two paragraphs. The row of the latest anomaly has its motor, its probability and its reason.
    latest_flight, all_flights = render_section(
        "fleet_vehicle",
        health=health,
        has_anomaly=has_anomaly,
        bad_headline=bad_headline(flights),
        headline=log_row(flights[-1]).headline,
        log_count=len(flights),
        counts=counts_by_health,
        anomalous_healths=anomalous_healths,
        reason=_reason_for_latest_health(flights),
        latest_anomalous_row=latest_anomalous_row,
        is_shared=has_shared_name(flights),
        has_reason=has_reason,
    )
    # An anomaly of an earlier flight that the latest one no longer has is past: nothing is to be done about it.
    present_anomaly = latest_anomalous_row if has_anomaly else None
    reason = ""
    if present_anomaly is not None:
        reason = first_sentence(present_anomaly.health_reason or "")
    return VehicleTexts(
        latest_flight=latest_flight.text,
        reason=reason,
        all_flights=all_flights.text,
        next_step=_next_step(flights, present_anomaly),
        finding=_present_fault(flights, reason, latest_flight.text),
    )


def _present_fault(flights: Flights, reason: str, latest_flight_text: str) -> str:
    """Returns in sentences what is wrong with a vehicle, such as "Motor 2 lost about 20 % of its thrust.".

    A bad headline of its latest flight comes first, then an anomaly of its motors.

    Args:
        flights: rows of the vehicle's flights, in the order of date; at least one flight.
        reason: how its motors differ from those of healthy flights; empty without an anomaly, or where an anomaly has
            no reason.
        latest_flight_text: the text on the latest flight that was judged, which names the anomaly of the motors too.

    Returns:
        The sentences. If there is neither, the headline of the latest flight if that warns; otherwise an empty text.
    """
    if reason:
        return f"{bad_headline(flights)} {reason}".strip()
    if bad_headline(flights) or vehicle_health(flights) in ANOMALOUS_HEALTHS:
        return latest_flight_text
    latest_row = log_row(flights[-1])
    return (latest_row.headline or "") if latest_row.headline_level == Level.WATCH else ""


def row_of_finding(flights: Flights) -> FlightRow:
    """Returns a row of the flight that shows what is wrong with a vehicle, or of its latest flight if nothing is.

    A bad headline is that of the latest flight, and is stated first. An anomaly of the motors was found in the latest
    flight in which they were judged, after which the vehicle may have flown without being judged.

    Args:
        flights: rows of the vehicle's flights, in the order of date; at least one flight.
    """
    anomalous_row = _latest_anomalous_row(flights)
    has_anomaly = vehicle_health(flights) in ANOMALOUS_HEALTHS
    if has_anomaly and anomalous_row is not None and not bad_headline(flights):
        return anomalous_row
    return log_row(flights[-1])


def _latest_anomalous_row(flights: Flights) -> FlightRow | None:
    """Returns the row of the latest flight whose motors have a fault or a drift, for the axis in the worst health.

    Args:
        flights: rows of the vehicle's flights, in the order of date.
    """
    for flight in reversed(flights):
        if worst_health(flight) in ANOMALOUS_HEALTHS:
            return worst_row(flight)
    return None


def _next_step(flights: Flights, anomalous_row: FlightRow | None) -> str:
    """Returns what to do next about a vehicle, in sentences; an empty text if nothing is wrong with it.

    The first step is the one that the log of the latest flight advises, if the flight was bad. If it was only "watch",
    that step is left out when the motors need repair, which matters more. The step about the motors comes second.

    Args:
        flights: rows of the vehicle's flights, in the order of date; at least one flight.
        anomalous_row: row of the latest flight whose motors have a fault or a drift; None if they are healthy now.
    """
    latest_row = log_row(flights[-1])
    is_to_be_watched = latest_row.headline_level == Level.WATCH
    motors_are_healthy = anomalous_row is None
    steps = []
    if bad_headline(flights) or (is_to_be_watched and motors_are_healthy):
        steps.append(latest_row.next_step)
    if anomalous_row is not None:
        steps += [sentence.text for sentence in motor_next_step(anomalous_row)]
    # A dictionary keeps each step once, in order. A log may have no next step.
    distinct_steps = dict.fromkeys(step for step in steps if step)
    return " ".join(bans_first(distinct_steps))


def motor_next_step(row: FlightRow) -> list[Sentence]:
    """Returns the next step if a comparison with other flights of the vehicle shows a fault or a drift of its motors.

    The pages of the flight, of its vehicle and of its comparison with another flight all have this step.

    Args:
        row: row of a flight whose motors have a fault or a drift. The step is about the motor that the comparison
            suspects, or else the one that the flight's own log warns of, or else all motors and the load.

    Returns:
        A list with one sentence, whose lead is "Next:".
    """
    if row.health_code == MotorsBetween.EFFORT_CHANGED:
        return render_section("effort_next")
    motor = suspected_motor(row)
    watched_motor = f"motor {row.watched_motor}" if row.watched_motor else ""
    is_unlikely = row.fault_probability is not None and row.fault_probability < LIKELY_PROBABILITY
    return render_section(
        "difference_next",
        motor=motor or watched_motor,
        # A suspected motor gives less thrust than in other flights.
        is_weaker=bool(motor),
        is_watched=not motor and bool(watched_motor),
        needs_healthy_flight=is_unlikely,
    )


def suspected_motor(row: FlightRow) -> str:
    """Returns the motor that a comparison with other flights suspects, such as "motor 1"; empty if it suspects none."""
    return f"motor {row.suspect_motor}" if row.suspect_motor else ""


def _reason_for_latest_health(flights: Flights) -> str:
    """Returns why the motors of a vehicle were judged as they were, in its latest flight for which a reason is stored.

    For a log that could not be read, the reason is its status.

    Args:
        flights: rows of the vehicle's flights, in the order of date.

    Returns:
        The reason in sentences; empty if no flight has one.
    """
    for flight in reversed(flights):
        for row in flight:
            reason = row.health_reason if row.is_read else row.status
            if reason:
                return reason
    return ""
