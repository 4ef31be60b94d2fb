"""Lines of the table of flights on a fleet's page: the cells of a flight, such as its judgement by status lights."""

import re
from collections.abc import Callable, Iterable, Sequence
from math import degrees
from typing import NamedTuple
from urllib.parse import quote

from mavdem.facts import Level
from mavdem.facts.learnability import NotLearnableReason
from mavdem.facts.lights import Light
from mavdem.facts.motors import MotorHealth
from mavdem.facts.urgency import Urgency
from mavdem.fleet.flights import AxisRows, log_row, worst_health
from mavdem.fleet.names import NO_NAMES, content_hash
from mavdem.fleet.row import SYSTEM_ID_BASIS
from mavdem.report.fleet import (
    ANOMALOUS_HEALTHS,
    NOT_USED,
    badge,
    is_headline_replaced,
    light_level,
    urgency_and_age,
    vehicle_name_or_type,
)
from mavdem.report.heading import listed_headline
from mavdem.report.numbers import listed
from mavdem.report.templates import render_section, rounded_up
from mavdem.wind_velocity.compass import compass_text

MAX_NOTE_LENGTH = 320
"""Letters after which the table has no further notes on a flight; the page of the flight has all of them."""

DATE_LENGTH = 16
"""Letters of a date and time up to the minute, as in "2026-02-09 12:30"."""


class FlightLine(NamedTuple):
    """The line of one flight."""

    seconds: float | None
    """UNIX time of the flight's beginning, s; None where it is not known."""

    content: str
    """Hash of the content of its log, by which users name a flight."""

    link: str
    """Address of its page, relative to the page of the fleet; empty without one."""

    file: str
    """Path or URL of its log."""

    vehicle: str
    """What its log calls the vehicle."""

    simulated: bool
    """Whether the flight was simulated."""

    is_counted: bool
    """Whether it counts where flights are counted: a simulated one only if its name identifies the vehicle."""

    urgency: Urgency
    """How urgently the vehicle needs a look after this flight; a simulated one or a log without a flight needs none."""

    light_levels: str
    """Levels of all lights, in their order, separated by spaces: by them the page's filter finds "motors:good"."""

    height: float | None
    """Largest height above the take-off, m, by which the page is searched; None where it is not known."""

    parameter_set: int | None
    """Which of the vehicle's sets of control parameters (``VehicleSummary.parameter_sets``) it flew with; None where
    its log has none."""

    cells: list[str]
    """The cells, one for each of the ``COLUMNS``."""

    def cell(self, column: str) -> str:
        """Returns the cell of a column by its header, such as "notes"."""
        return self.cells[[*COLUMNS].index(column)]

    @property
    def headline(self) -> str:
        """The most serious finding in the flight, such as "Motor 2 is weak.": the first of its notes."""
        return self.cell("notes").split("\n")[0]

    @property
    def finding(self) -> str:
        """What is wrong in the flight, in few words: its shortened headline."""
        return listed_headline(self.headline)

    @property
    def is_flight(self) -> bool:
        """Whether the log has a usable flight."""
        return self.cell("health") != NOT_USED

    @property
    def level(self) -> Level:
        """The level of the flight, by its headline or its motors; unknown for a log without a usable flight."""
        return Level(self.cell("health")) if self.is_flight else Level.UNKNOWN


def flight_line(
    flight: AxisRows, *, is_counted: bool = True, parameter_set: int | None = None
) -> FlightLine:
    """Returns the line of one flight in the table of flights, with file and vehicle as the log names them.

    Args:
        flight: rows of the flight in the fleet's table, one for each axis.
        is_counted: whether the page includes the flight in its numbers of flights.
        parameter_set: number of the set of control parameters that it flew with; None where its log has none.
    """
    # Date, page and file are the same in the rows of all axes.
    first_row = log_row(flight)
    date = first_row.past_date
    unix_time = None if date is None else date.timestamp()
    # A browser takes the text before a colon for the scheme of the address, so colons are quoted too.
    link = "" if first_row.page is None else quote(first_row.page, safe="/")
    cells = [column.cell(flight) for column in COLUMNS.values()]
    return FlightLine(
        unix_time,
        content=content_hash(first_row.key),
        link=link,
        file=first_row.file,
        vehicle=first_row.vehicle,
        simulated=bool(first_row.simulated),
        is_counted=is_counted,
        urgency=_urgency(flight),
        light_levels=" ".join(light_level(flight, light) for light in Light),
        height=first_row.height,
        parameter_set=parameter_set,
        cells=cells,
    )


def _urgency(flight: AxisRows) -> Urgency:
    """Returns how urgently a vehicle needs a look after a flight; a simulated one and a log without a flight need none.

    Args:
        flight: rows of one flight in the fleet's table, one for each axis.
    """
    row = log_row(flight)
    if row.simulated or not row.has_flight:
        return Urgency.UNKNOWN
    return urgency_and_age([flight]).urgency


class Column(NamedTuple):
    """A column of the table of flights."""

    kind: str
    """How the page sorts and shows it: "text", "number", "duration", "health", "lights" or "notes"."""

    cell: Callable[[AxisRows], str]
    """Makes the cell of a flight; empty where the quantity is not known."""

    width: str
    """Width of the column on a wide screen; the notes take what is left."""

    area: str = ""
    """Place of the cell in the lines that a flight has on a phone; empty where it is left out."""


def file_name(flight: AxisRows) -> str:
    """Returns the name of a flight's log without its folder; also of a path from Windows, which has backslashes."""
    path = log_row(flight).file
    name = re.split(r"[/\\\\]", path)[-1]
    return name or path


def _vehicle(flight: AxisRows) -> str:
    """Returns the cell with the vehicle of a flight in a fleet's list: its name in the logs.

    If the logs have nothing but a MAVLink system id, the vehicle is described instead, as in "unnamed PX4 quadrotor",
    or for a simulated flight "unnamed PX4 quadrotor, simulated".

    Args:
        flight: rows of one flight in the fleet's table, one for each axis.
    """
    row = log_row(flight)
    if row.vehicle_basis != SYSTEM_ID_BASIS:
        return row.vehicle
    name = vehicle_name_or_type(row.vehicle, row.frame or "", NO_NAMES, is_shared=True)
    return f"{name}, simulated" if row.simulated else name


def _date(flight: AxisRows) -> str:
    """Returns the cell with the date of a flight in a fleet's list: date and time, up to the minute.

    A date in the future comes from a wrong clock of the vehicle. Then the cell has only its year: "clock in 2098".

    Args:
        flight: rows of one flight in the fleet's table, one for each axis.

    Returns:
        The text; empty if the date is not known.
    """
    row = log_row(flight)
    if row.date is None:
        return ""
    if row.past_date is None:
        return f"clock in {row.date.year}"
    return f"{row.date}"[:DATE_LENGTH]


def _badge(flight: AxisRows) -> str:
    """Returns the one word that says how a flight went."""
    return badge([flight])


def _warning_lights(flight: AxisRows) -> str:
    """Returns the cell with the status lights of a flight that warn, such as "motors bad, vibration watch".

    A status light is the judgement of one part of the vehicle, such as its motors, with a level. Bad ones come first,
    then those to be watched. What is to be watched of the recording is left out: it is no fault of the vehicle, and
    mostly the same in all logs.

    Args:
        flight: rows of one flight in the fleet's table, one for each axis; all have the same lights.

    Returns:
        The text; empty if no light warns.
    """
    texts = []
    for level in (Level.BAD, Level.WATCH):
        for light in Light:
            is_remark_on_recording = light is Light.LOG and level is Level.WATCH
            if light_level(flight, light) is level and not is_remark_on_recording:
                texts.append(f"{light} {level}")
    return ", ".join(texts)


def _suspect_motors(flight: AxisRows) -> str:
    """Returns the numbers of the motors to inspect after a flight, as the text of a table cell such as "2 and 4".

    These are motors that failed in the flight, or that seem weak in comparison with other flights. If there are none,
    it is the motor that the log by itself warns of, such as one that was at its limit.

    Args:
        flight: rows of one flight in the fleet's table, one for each axis.
    """
    suspect_motors = set[int]()
    watched_motors = set[int]()
    for row in flight:
        for motor in (row.failed_motor, row.suspect_motor):
            if motor is not None:
                suspect_motors.add(motor)
        if row.watched_motor is not None:
            watched_motors.add(row.watched_motor)
    return listed(sorted(suspect_motors or watched_motors))


def _notes_on_flight(flight: AxisRows) -> str:
    """Returns the cell with notes on a flight in a fleet's list, one sentence a line, the most important first.

    First comes the headline of the log, then the reason for the health of the motors, then warnings, each once. The
    cell ends before the first sentence that would make it longer than ``MAX_NOTE_LENGTH``. For a log without a flight
    the only note is why it was not used.

    Args:
        flight: rows of one flight in the fleet's table, one for each axis.
    """
    first_row = log_row(flight)
    if first_row.status_code == NotLearnableReason.NO_MULTIROTOR:
        (note,) = render_section(
            "fleet_other_vehicle", frame=first_row.frame, headline=first_row.headline
        )
        return note.text
    if not first_row.has_flight:
        return first_row.status
    notes = []
    # The headline is about this log alone. An anomaly that the comparison with other flights shows may replace it.
    has_anomaly = worst_health(flight) in ANOMALOUS_HEALTHS
    level_of_log = Level(first_row.headline_level or Level.UNKNOWN)
    if not has_anomaly or not is_headline_replaced(level_of_log):
        notes += [row.headline for row in flight]
    notes += [row.health_reason for row in flight if row.health != MotorHealth.OK]
    if not first_row.is_read:
        notes += [
            note.text for note in render_section("fleet_not_compared", reason=first_row.status)
        ]
    for row in flight:
        notes += row.warnings
    return _first_notes(note for note in notes if note)


def _first_notes(notes: Iterable[str]) -> str:
    """Returns the first of some notes, one a line and each once, as many as ``MAX_NOTE_LENGTH`` letters have room for.

    Args:
        notes: sentences, the most important first.
    """
    # A dictionary keeps each sentence once, in order.
    sentences = dict.fromkeys(notes)
    text = ""
    for sentence in sentences:
        # The first sentence, which matters most, is always shown.
        if text and len(text) + len(sentence) >= MAX_NOTE_LENGTH:
            break
        text = f"{text}\n{sentence}" if text else sentence
    return text


def minutes_text(seconds: float) -> str:
    """Returns a duration in s as minutes and seconds, such as "1:07", or "75:00" of more than an hour."""
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes}:{rest:02d}"


def _flight_time(flight: AxisRows) -> str:
    """Returns the cell with the time in the air; empty if it is not known."""
    row = log_row(flight)
    if row.flight_time is None:
        return ""
    return minutes_text(row.flight_time)


def wind_speed_text(speed: float | None, interval: Sequence[float | None] | None) -> str:
    """Returns the speed of a wind, m/s, as text: its 90 % interval if that is known, and otherwise the estimate.

    Args:
        speed: the speed; None if still air is likely too, or if the speed is not identifiable.
        interval: both ends of its 90 % interval; each None if it is not known. The lower one is 0 if
            still air is likely too.

    Returns:
        Both ends of the interval, such as "1.9 to 8.0". If still air is likely too, the upper end, such as "below 2.1".
        Without an interval the speed, such as "5.2". Empty if nothing is known.
    """
    low, high = interval or (None, None)
    if low is None or high is None:
        return "" if speed is None else f"{speed:.1f}"
    if not low:
        return f"below {rounded_up(high, 1)}"
    return f"{low:.1f} to {high:.1f}"


def _wind_text(flight: AxisRows) -> str:
    """Returns the wind of a flight for a fleet's list: speed, m/s, and where it came from, as in "4.1 to 6.3 NW".

    What is not known is left out, so that the cell is empty without a wind.

    Args:
        flight: rows of one flight in the fleet's table, one for each axis; all have the same wind.
    """
    row = log_row(flight)
    speed = wind_speed_text(row.wind_speed, row.wind_speed_interval)
    direction = ""
    if row.wind_direction is not None:
        direction = compass_text(degrees(row.wind_direction))
    return f"{speed} {direction}".strip()


COLUMNS = {
    "flight": Column("text", file_name, "13.5rem", "flight"),
    "vehicle": Column("text", _vehicle, "9.5rem", "vehicle"),
    "date": Column("text", _date, "6.5rem", "date"),
    "health": Column("health", _badge, "5.4rem", "health"),
    "lights": Column("lights", _warning_lights, "7.5rem", "lights"),
    "motor": Column("text", _suspect_motors, "3.6rem"),
    "notes": Column("notes", _notes_on_flight, "auto", "notes"),
    "time": Column("duration", _flight_time, "3.8rem", "time"),
    "wind (m/s)": Column("number", _wind_text, "6.8rem"),
}
"""Columns of the table of flights, by their headers."""
