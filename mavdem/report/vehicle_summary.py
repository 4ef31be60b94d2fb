"""What a fleet's page shows of the flights under one name, stored as JSON when they are judged.

A fleet may have ten thousand flights, of which one more log changes those of one vehicle: the page is made of the
summaries of all vehicles, and only that of the changed vehicle is made of rows.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import cache
from typing import NamedTuple

from pydantic import TypeAdapter

from mavdem.containers import group_by
from mavdem.facts import Level
from mavdem.facts.lights import Light
from mavdem.fleet.flights import (
    AxisRows,
    Flights,
    best_tier,
    distinct_flights,
    group_into_flights,
    has_shared_name,
    log_row,
    worst_health,
)
from mavdem.fleet.names import GivenNames
from mavdem.fleet.row import UNKNOWN, FlightRow, FlightRows
from mavdem.report.fleet import (
    ANOMALOUS_HEALTHS,
    UrgencyAndAge,
    VehicleTexts,
    badge,
    badge_level,
    has_section,
    light_level,
    row_of_finding,
    urgency_and_age,
    vehicle_health,
    vehicle_texts,
)
from mavdem.report.flight_lines import FlightLine, flight_line

SUMMARY_VERSION = "25"
"""Version of :class:`VehicleSummary` and of what makes it: kept summaries of another version are made again."""

WARNING_LEVELS = Level.BAD, Level.WATCH
"""Levels of a headline that says what is wrong."""

MAX_BARS = 40
"""Bars of a vehicle's latest flights: so many can be told apart on a phone."""


class FlownFlights(NamedTuple):
    """Counts of the flights under one name, each once where several logs have it and its vehicle is known."""

    flights: int
    """Number of flights; a log may have several, or none where the vehicle turned over at its take-off."""

    logs: int
    """Number of logs that have these flights, without further logs of the same ones."""

    duplicates: int
    """Number of further logs of these flights."""

    simulated: int
    """Number of the flights that were simulated."""

    seconds: float
    """Time of settled flight, s."""

    air_seconds: float
    """Time in the air, s, of the flights of which it is known."""

    first_date: datetime | None
    """Date of the first flight; None where no flight has a date."""

    last_date: datetime | None
    """Date of the last flight."""

    tiers: dict[str, int]
    """Number of logs of each tier; an empty name where it is not known."""

    healths: dict[str, int]
    """Number of logs with each health of the motors."""


class Wind(NamedTuple):
    """The mean wind of a flight."""

    direction: float
    """Direction that it came from, rad."""

    speed: float
    """Speed, m/s."""

    low: float
    """Lower end of the 90 % interval of the speed, m/s; the speed itself where no interval is known."""

    high: float
    """Upper end of that interval, m/s, likewise."""


class UnusedRow(NamedTuple):
    """A row of a log without a flight."""

    file: str
    """Path or URL of the log."""

    status: str
    """Why there is no flight."""

    status_code: str | None
    """The same as a code."""

    is_first: bool
    """Whether it is the first row of its vehicle in the log, which stands for the log."""


class LastFlight(NamedTuple):
    """The latest flight of a vehicle."""

    date: datetime | None
    """When it began."""

    frame: str
    """Kind of the vehicle's frame, such as "QUADROTOR"; empty where it is not known."""

    firmware: str
    """Version of its firmware; empty where it is not known."""

    badge: str
    """How it went, in one word."""

    badge_level: Level
    """Level of that."""

    headline: str
    """Headline of its review; empty where that says that nothing is wrong."""

    lights: dict[Light, Level]
    """Levels of its lights."""


class NamedFlight(NamedTuple):
    """A flight as sentences name it: by its file, or the name that a user gave to it, and its date."""

    file: str
    """Name of its log's file, without the folder."""

    content: str
    """Hash of the content of its log, by which users name a flight."""

    date: datetime | None
    """When it began; None where it is not known."""

    link: str
    """Address of its page; empty without one."""

    def label(self, names: GivenNames) -> str:
        """Returns the name of the flight and its day, UTC, such as "flight.ulg, 2026-03-09".

        Args:
            names: names that users gave to flights.
        """
        name = names.flights.get(self.content) or self.file
        return name if self.date is None else f"{name}, {self.date:%Y-%m-%d}"


class VehicleFlights(NamedTuple):
    """What is known of a vehicle from its flights together."""

    has_section: bool
    """Whether the page has a section on it; otherwise its name may be that of several vehicles."""

    urgency_and_age: UrgencyAndAge
    """By which vehicles are sorted."""

    health: str
    """Health of its motors in the latest flight that was judged."""

    had_anomaly: bool
    """Whether the motors had a fault or a drift in any flight."""

    texts: VehicleTexts
    """What the page says of it."""

    levels: list[Level]
    """Levels of its latest ``MAX_BARS`` flights, the newest at the end."""

    log_count: int
    """Number of its logs that hold flights."""

    last: LastFlight
    """Its latest flight."""

    finding_flight: NamedFlight
    """The flight that shows its faults; its latest flight if it has none."""

    @property
    def needs_look(self) -> bool:
        """Whether it needs a look: its latest flight was bad, or its motors have a fault or a drift."""
        return self.urgency_and_age.urgency.needs_look


@dataclass(frozen=True)
class VehicleSummary:
    """What the page of a fleet shows of the flights under one name, and of logs that hold none."""

    name: str
    """What the logs call the vehicle."""

    has_shared_name: bool
    """Whether several vehicles may have the name, whose flights are not compared."""

    really_flown: FlownFlights
    """Counts of the flights that were not simulated."""

    flown: FlownFlights
    """Counts of its flights."""

    vehicle: VehicleFlights | None
    """What is known of the vehicle; None where no log holds a flight."""

    watched_logs: int
    """Number of logs with a warning that is no bad one, the latest of them too; simulated ones do not count."""

    bad_logs: int
    """Number of logs of flights that went badly, the latest of them too; simulated ones do not count."""

    light_counts: dict[Light, dict[Level, int]]
    """Number of logs with each level, by light, of the logs that count."""

    winds: list[Wind]
    """The winds of the flights that count and whose wind is known."""

    lines: list[FlightLine]
    """The lines of its flights and logs in the table, by date, those without one last."""

    parameter_sets: list[str]
    """The different sets of control parameters that it flew with, each a JSON object: value by name."""

    undecided_flights: list[NamedFlight]
    """Flights that count as flown, but whose logs have nothing by which a simulation would show."""

    unused: list[UnusedRow]
    """The rows of logs without a flight."""


def vehicle_summaries(rows: Iterable[FlightRow]) -> list[VehicleSummary]:
    """Summarises the flights of each vehicle of a fleet, for the fleet's page.

    Args:
        rows: rows of the fleet's table, of all flights and axes, and of logs without a flight. The columns
            ``BRIEF_COLUMNS`` are enough.

    Returns:
        Summaries in the alphabetical order of the vehicles' names.
    """
    rows_by_vehicle = group_by(rows, lambda row: row.vehicle)
    summaries = []
    for name in sorted(rows_by_vehicle):
        summaries.append(summary_of_vehicle(name, rows_by_vehicle[name]))
    return summaries


def summary_of_vehicle(name: str, rows: FlightRows) -> VehicleSummary:
    """Summarises all logs under one vehicle's name, so that a fleet's page can be made without their rows.

    Args:
        name: name of the vehicle in its logs; ``UNKNOWN`` for logs without one. Several vehicles may share a name that
            is made of a MAVLink system id, and then all their flights are summarised together.
        rows: all rows of the fleet's table under this name. Each log has a row for each axis, and each log without a
            flight that can be analysed has a row with the reason.

    Returns:
        The summary, which can be stored as JSON.
    """
    # The table has one flight for each log, so grouping by flight also groups by log. Logs without a flight that can be
    # analysed are listed, but not counted as flights.
    logs = group_into_flights(rows)
    flights = group_into_flights(row for row in rows if row.has_flight)
    real_flights = [flight for flight in flights if not log_row(flight).simulated]
    vehicle = _vehicle_of_flights(name, real_flights, flights)
    counts_simulated = _counts_simulated_flights(vehicle, real_flights)
    parameter_set_numbers = _parameter_set_numbers(logs)
    lines = []
    counted_logs = []
    for log in logs:
        row = log_row(log)
        parameter_set = parameter_set_numbers.get(row.control_parameters or "")
        is_counted = counts_simulated or not row.simulated
        lines.append(flight_line(log, is_counted=is_counted, parameter_set=parameter_set))
        if is_counted:
            counted_logs.append(log)
    logs_by_level = Counter(badge_level([flight]) for flight in real_flights)
    return VehicleSummary(
        name=name,
        has_shared_name=name == UNKNOWN or has_shared_name(flights),
        really_flown=_flown_flights(name, real_flights),
        flown=_flown_flights(name, flights),
        vehicle=vehicle,
        watched_logs=logs_by_level[Level.WATCH],
        bad_logs=logs_by_level[Level.BAD],
        light_counts=_light_counts(counted_logs),
        winds=_mean_winds(counted_logs),
        lines=lines,
        parameter_sets=[*parameter_set_numbers],
        undecided_flights=_undecided_flights(real_flights),
        unused=_unused_rows(rows),
    )


def _parameter_set_numbers(logs: Flights) -> dict[str, int]:
    """Numbers the different sets of control parameters that a vehicle flew with, since most flights have the same.

    Args:
        logs: rows of each log of the vehicle.

    Returns:
        The number of each set, from 0, by the set as the rows have it: a text, the JSON object of values by name.
    """
    numbers: dict[str, int] = {}
    for log in logs:
        row = log_row(log)
        if _has_parameters(row):
            numbers.setdefault(row.control_parameters or "", len(numbers))
    return numbers


def _has_parameters(row: FlightRow) -> bool:
    """Returns whether the log of a row has control parameters of its autopilot."""
    return row.control_parameters not in (None, "", "{}")


def _undecided_flights(flights: Flights) -> list[NamedFlight]:
    """Returns the flights that may have been simulated, since their logs would not show it; they count as flown.

    The parameters of a simulator or the kind of its board show it. Some logs of ground stations have neither.

    Args:
        flights: rows of each flight that is not known to be simulated.
    """
    undecided = []
    for flight in flights:
        row = log_row(flight)
        if not row.has_own_name and not _has_parameters(row):
            undecided.append(_named_flight(row))
    return undecided


def _vehicle_of_flights(
    name: str, real_flights: Flights, flights: Flights
) -> VehicleFlights | None:
    """Summarises what all flights of a vehicle show together, such as its health; None without a flight.

    Real and simulated flights may share a MAVLink system id. Simulated ones tell nothing of the real vehicle, so that
    they are left out if there is a real one.

    Args:
        name: name of the vehicle in its logs.
        real_flights: rows of each flight that was not simulated, in the order of date.
        flights: rows of each flight, likewise.
    """
    flights_of_vehicle = real_flights or flights
    if not flights_of_vehicle:
        return None
    return _vehicle_flights(name, flights_of_vehicle)


def _counts_simulated_flights(vehicle: VehicleFlights | None, real_flights: Flights) -> bool:
    """Returns whether a fleet's page includes simulated flights where it counts the flights of a vehicle.

    It does if the vehicle has a section of its own on the page and was flown only in a simulator: its section would
    otherwise count no flight. Of a vehicle with real flights only these are counted, since simulated flights say
    nothing of a real vehicle.

    Args:
        vehicle: what is known of the vehicle from all its flights; None without a flight.
        real_flights: the flights of the vehicle that were not simulated, each as its rows in the fleet's table.
    """
    if vehicle is None or real_flights:
        return False
    return vehicle.has_section


def _mean_winds(logs: Sequence[AxisRows]) -> list[Wind]:
    """Returns the mean winds of some logs, for a drawing of the winds of a fleet.

    Args:
        logs: rows of each log in the fleet's table, one for each axis. A log is left out if the speed or the direction
            of its wind is not known.
    """
    winds = []
    for log in logs:
        row = log_row(log)
        if row.wind_direction is not None and row.wind_speed is not None:
            low, high = row.wind_speed_interval or (None, None)
            if low is None or high is None:
                low = high = row.wind_speed
            winds.append(Wind(row.wind_direction, row.wind_speed, low, high))
    return winds


@cache
def summary_adapter() -> TypeAdapter[VehicleSummary]:
    """Returns the type adapter of Pydantic that converts summaries to JSON and back."""
    return TypeAdapter(VehicleSummary)


def _flown_flights(name: str, flights: Flights) -> FlownFlights:
    """Counts the flights under one vehicle's name, and sums their durations.

    If only one vehicle can have the name, logs that overlap in time are of the same flights, which count once.

    Args:
        name: the name; ``UNKNOWN`` for logs without one.
        flights: rows of each log with flights, one for each axis, in the order of date.

    Returns:
        Number of flights and of their logs, total time in settled flight and in the air, s, first and last date, and
        numbers of logs by tier (the kind of model that a log allows) and by health of the motors.
    """
    counted_flights: Flights = flights
    is_one_vehicle = name != UNKNOWN and not has_shared_name(flights)
    if is_one_vehicle:
        counted_flights = distinct_flights([list(flight) for flight in flights])
    dates = []
    durations = []
    flight_times = []
    for flight in counted_flights:
        date = log_row(flight).past_date
        if date is not None:
            dates.append(date)
        # An axis may lack data for a part of the flight, so that the longest of its rows has the duration.
        durations.append(max(row.duration or 0.0 for row in flight))
        flight_times.append(log_row(flight).flight_time or 0.0)
    return FlownFlights(
        flights=sum(log_row(flight).flights_of_log for flight in counted_flights),
        logs=len(counted_flights),
        duplicates=len(flights) - len(counted_flights),
        simulated=sum(
            log_row(flight).flights_of_log
            for flight in counted_flights
            if log_row(flight).simulated
        ),
        seconds=sum(durations),
        air_seconds=sum(flight_times),
        first_date=min(dates, default=None),
        last_date=max(dates, default=None),
        tiers=Counter(best_tier(flight) for flight in counted_flights),
        healths=Counter(worst_health(flight) for flight in counted_flights),
    )


def _vehicle_flights(name: str, flights: Flights) -> VehicleFlights:
    """Summarises the flights of one vehicle for a fleet's page.

    Args:
        name: name of the vehicle.
        flights: the rows of each of its flights, one row per axis, in the order of date; at least one flight.

    Returns:
        How urgently it needs attention, the health of its motors, texts, the levels of its latest ``MAX_BARS`` flights,
        and what its last flight shows.
    """
    # The rows of a flight, one for each axis, have the same date, frame, firmware and headline.
    last_row = log_row(flights[-1])
    # The headline is kept only if it says what is wrong.
    headline = ""
    if last_row.headline_level in WARNING_LEVELS:
        headline = last_row.headline or ""
    last_flight = LastFlight(
        date=last_row.past_date,
        frame=last_row.frame or "",
        firmware=last_row.firmware or "",
        badge=str(badge(flights)),
        badge_level=badge_level(flights),
        headline=headline,
        lights={light: light_level(flights[-1], light) for light in Light},
    )
    return VehicleFlights(
        has_section=has_section(name, flights),
        urgency_and_age=urgency_and_age(flights),
        health=vehicle_health(flights),
        had_anomaly=any(worst_health(flight) in ANOMALOUS_HEALTHS for flight in flights),
        texts=vehicle_texts(flights),
        levels=[badge_level([flight]) for flight in flights[-MAX_BARS:]],
        log_count=len(flights),
        last=last_flight,
        finding_flight=_named_flight(row_of_finding(flights)),
    )


def _named_flight(row: FlightRow) -> NamedFlight:
    """Returns file, day and link of a flight, by which sentences name it, from one of its rows in the fleet's table."""
    line = flight_line([row])
    return NamedFlight(line.cell("flight"), line.content, row.past_date, line.link)


def _light_counts(flights: Sequence[AxisRows]) -> dict[Light, dict[Level, int]]:
    """Counts in how many flights each status light has each level.

    Args:
        flights: rows of each log in the fleet's table, one for each axis; logs without a flight are left out.

    Returns:
        By status light, such as that of the motors, and then by level, the number of flights.
    """
    counts_by_light: dict[Light, dict[Level, int]] = {}
    for light in Light:
        counts = Counter[Level]()
        for flight in flights:
            if log_row(flight).has_flight:
                counts[light_level(flight, light)] += 1
        counts_by_light[light] = counts
    return counts_by_light


def _unused_rows(rows: FlightRows) -> list[UnusedRow]:
    """Returns the rows of a fleet's table without a flight that can be analysed, each with its log and the reason.

    Args:
        rows: all rows of the table under the name of one vehicle. A log may have several rows.

    Returns:
        The rows by date, those of logs without a date last. The first one of each log is marked, so that logs can be
        counted.
    """
    unused_rows = []
    rows_without_flight = [row for row in rows if not row.has_flight]
    for rows_of_log in group_into_flights(rows_without_flight):
        for index, row in enumerate(rows_of_log):
            is_first = index == 0
            unused_rows.append(UnusedRow(row.file, row.status, row.status_code, is_first))
    return unused_rows
