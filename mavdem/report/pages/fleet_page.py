"""The HTML index of a fleet: a summary, the charts of each vehicle over its flights, and a table of all flights."""

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import degrees
from typing import NamedTuple
from urllib.parse import quote

import numpy as np

from mavdem.facts import Level
from mavdem.facts.lights import Light
from mavdem.facts.motors import MotorHealth
from mavdem.fleet.flights import AxisRows, Flights, flights_of, vehicles_of, worst_health
from mavdem.fleet.names import NO_NAMES, GivenNames
from mavdem.fleet.row import FlightRow, FlightRows
from mavdem.report import fleet as fleet_words
from mavdem.report.blocks import Block, Table
from mavdem.report.charts.chart import Group, Plan
from mavdem.report.charts.plans import rose_of_flights
from mavdem.report.charts.vehicle_charts import vehicle_group
from mavdem.report.fleet import MAX_URGENT_RANK, TROUBLED_HEALTHS, truncated, urgency
from mavdem.report.numbers import listed, rounded
from mavdem.report.pages.page import environment, render_page
from mavdem.wind_velocity.compass import compass_text

MAX_DRAWN = 20
"""Vehicles with charts, the most urgent ones: with more, a page takes long to make and is too large to mail."""

FIRST_SHOWN = 50
"""Rows of the table that a browser without scripts shows."""

SUMMARY_BLOCKS = 2
"""Paragraphs of the summary at the top of the page: the headline, and what was flown."""

MAX_BARS = 40
"""Bars of a vehicle's latest flights: so many can be told apart on a phone."""

MAX_NAME_LENGTH = 16
"""Letters of a vehicle's name that are shown whole; of a longer one, such as a serial number, both ends are."""

LEVEL_MARKS = {Level.BAD: "■", Level.WATCH: "▲", Level.GOOD: "●", Level.UNKNOWN: "○"}
"""Mark of each level, which tells levels apart without their colours, the worst first."""

MAX_NOTE_LENGTH = 320
"""Letters of the notes on a flight in the table; the page of the flight has all of them."""

DATE_LENGTH = 16
"""Letters of a date and time up to the minute, as in "2026-02-09 12:30"."""

BADGES = "fault", "bad", "drift", "watch", fleet_words.NOT_USED, "unknown", "ok", "good"
"""Words in the column of the health, the most urgent first: the order in which the page sorts."""

RowsOfVehicle = Callable[[str], FlightRows]
"""Returns the rows of a vehicle by its name, with all their columns."""

REMARK_PLACE = re.compile(r'(?<=<main>\n)(<p class="said [^<]*</p>\n)?')
"""The beginning of a flight's page, with the remark about other flights of the vehicle if there is one already."""


def fleet_page(
    rows: FlightRows,
    changes: Mapping[str, Sequence[Block]] | None = None,
    full_rows: RowsOfVehicle | None = None,
    names: GivenNames = NO_NAMES,
) -> str:
    """Renders the index of a fleet; the same rows give the same bytes, in whatever order they come.

    Args:
        rows: rows of all flights and axes; ``BRIEF_COLUMNS`` are enough.
        changes: what changed since a baseline, by vehicle; None without a baseline.
        full_rows: returns the rows of a vehicle with all columns, for its charts; ``rows`` have them unless given.
        names: names that were given to vehicles and flights.
    """
    flights = flights_of(rows)
    # Flights with a date come first, the newest at the top.
    dated_count = sum(flight[0].date is not None for flight in flights)
    newest_first = [*reversed(flights[:dated_count]), *flights[dated_count:]]
    lines = [_line(flight, names) for flight in newest_first]
    links = [_link(flight[0]) for flight in newest_first]
    vehicles = _vehicle_parts(rows, changes or {}, full_rows, names)
    blocks = fleet_words.fleet_blocks(rows, names_vehicles=False)
    # The headline and what was flown; without a flight there is nothing but the reasons.
    first_blocks = SUMMARY_BLOCKS if vehicles else len(blocks)
    return render_page(
        environment().get_template("fleet.html"),
        blocks=blocks[:first_blocks],
        unused_blocks=blocks[first_blocks:],
        vehicles=vehicles,
        unjudged=_repeated_differences(vehicles),
        lights=[*Light],
        light_counts=_light_counts(flights),
        marks=LEVEL_MARKS,
        bars=MAX_BARS,
        rose=_rose(flights),
        widths=[column.width for column in COLUMNS.values()],
        areas={name: column.area for name, column in COLUMNS.items()},
        first=Table([*COLUMNS], lines[:FIRST_SHOWN], words=True),
        table={
            "kinds": [column.kind for column in COLUMNS.values()],
            "rows": [[*link, *line] for link, line in zip(links, lines, strict=True)],
            "healths": BADGES,
            "given": sorted(map(names.vehicle, names.vehicles)),
        },
    )


class FlightBars(NamedTuple):
    """The latest flights of a vehicle as bars, one a flight, coloured by how it went."""

    words: str
    """How many flights have each level."""

    paths: Mapping[Level, str]
    """SVG path of the bars of each level; a bar is 1 wide."""


class LightCounts(NamedTuple):
    """The levels of one light in all flights."""

    name: Light
    """The light."""

    counts: Mapping[Level, int]
    """Number of flights with each level."""


@dataclass
class VehiclePart:
    """What the template shows of one vehicle."""

    name: str
    """What its logs call the vehicle, such as its serial number."""
    short_name: str
    """The same as far as it is shown in a line."""
    given_name: str
    """Name that somebody gave to the vehicle; empty without one."""
    last: FlightRow
    """A row of its latest flight."""
    flights: int
    """Number of its flights."""
    badge: str
    """How the latest flight went, with its level."""
    bars: FlightBars
    """Its latest flights."""
    lights: Mapping[Light, str]
    """Levels of the lights of its latest flight."""
    words: fleet_words.VehicleWords
    """What was found of it."""
    changes: Sequence[Block]
    """What changed since the baseline."""
    group: Group | None
    """Its charts over the flights."""
    is_open: bool
    """Whether it is unfolded at first."""


def _vehicle_parts(
    rows: FlightRows,
    changes: Mapping[str, Sequence[Block]],
    full_rows: RowsOfVehicle | None,
    names: GivenNames,
) -> list[VehiclePart]:
    """Returns what the page shows of each vehicle, the most urgent vehicle first.

    Urgency is a rank by the health of the motors and the latest headline. Flights that do not say whose they are may be
    those of several vehicles, and have no part. To keep the page small, charts are drawn only for the ``MAX_DRAWN``
    most urgent vehicles with more than one flight. Parts are folded, except the first one with charts if its vehicle
    needs a look.

    Args:
        rows: rows of all flights.
        changes: what changed since a baseline, by name of the vehicle.
        full_rows: returns the rows of a vehicle with all columns; ``rows`` have them unless given.
        names: names that were given to vehicles.
    """
    ranked = sorted(
        (urgency(flights), name, flights)
        for name, flights in vehicles_of(rows).items()
        if fleet_words.is_one_vehicle(name, flights)
    )
    with_several_flights = [name for _, name, flights in ranked if len(flights) > 1]
    drawn = with_several_flights[:MAX_DRAWN]
    parts = []
    for vehicle_urgency, name, flights in ranked:
        group = None
        if name in drawn:
            drawn_flights = flights
            if full_rows is not None:
                drawn_flights = vehicles_of(full_rows(name))[name]
            group = vehicle_group(drawn_flights)
        needs_look = vehicle_urgency.rank < MAX_URGENT_RANK
        last = flights[-1][0]
        parts.append(
            VehiclePart(
                name=name,
                short_name=short_name(name),
                given_name=names.vehicle(name) if name in names.vehicles else "",
                last=last,
                flights=len(flights),
                badge=fleet_words.badge(flights),
                bars=_bars(flights),
                lights={light: _level(last, light) for light in Light},
                words=fleet_words.vehicle_words(flights),
                changes=changes.get(name, ()),
                group=group,
                is_open=needs_look and name in drawn[:1],
            )
        )
    return parts


def _line(flight: AxisRows, names: GivenNames) -> list[str]:
    """Returns the cells of a flight in the table, with the names that the flight and its vehicle were given."""
    labelled_rows = names.labelled(flight)
    cells = {header: column.cell(labelled_rows) for header, column in COLUMNS.items()}
    cells["flight"] = names.flight(flight[0]) or cells["flight"]
    return [*cells.values()]


def short_name(name: str) -> str:
    """Returns the name of a vehicle as far as a line has room: the beginning and the end of a serial number."""
    if len(name) <= MAX_NAME_LENGTH:
        return name
    return f"{name[:4]}…{name[-6:]}"


def _level(row: FlightRow, light: Light) -> str:
    """Returns the level of a light of a flight; unknown where the log has none."""
    return getattr(row, f"light_{light}") or Level.UNKNOWN


def _bars(flights: Flights) -> FlightBars:
    """Returns the latest ``MAX_BARS`` flights of a vehicle as bars coloured by level, the newest at the right.

    All bars of one level are one SVG path, which keeps the page small.

    Args:
        flights: flights of the vehicle, the oldest first.
    """
    shown_flights = flights[-MAX_BARS:]
    paths = dict.fromkeys(LEVEL_MARKS, "")
    counts: Counter[Level] = Counter()
    for place, flight in enumerate(shown_flights, start=MAX_BARS - len(shown_flights)):
        level = fleet_words.badge_level([flight])
        counts[level] += 1
        # A rectangle of height 1 and width 0.8, which leaves a gap before the next bar.
        paths[level] += f"M{place} 0v1h.8v-1z"
    words = listed(f"{counts[level]} {level}" for level in LEVEL_MARKS if counts[level])
    drawn_paths = {level: path for level, path in paths.items() if path}
    return FlightBars(f"Latest flights: {words}", drawn_paths)


def _light_counts(flights: Flights) -> list[LightCounts]:
    """Returns in how many flights each light has each level, the lights with most bad flights first.

    A light is the judgement of one part of the vehicle, such as its motors, by a level: bad, watch, good or unknown.
    The list is empty without a flight.
    """
    counts = []
    flown = [flight[0] for flight in flights if flight[0].has_flight]
    for light in Light:
        levels = Counter(_level(row, light) for row in flown)
        counts.append(LightCounts(light, {level: levels[level] for level in LEVEL_MARKS}))
    counts.sort(key=lambda one: (-one.counts[Level.BAD], -one.counts[Level.WATCH]))
    return counts if flown else []


def _repeated_differences(parts: Sequence[VehiclePart]) -> Table:
    """Moves sentences that are the same for several vehicles from their parts of the page into one table.

    Many vehicles of a fleet lack the same thing, such as enough flights to compare. Their parts would all say so.

    Args:
        parts: what the page shows of each vehicle; those with a repeated sentence lose it.

    Returns:
        Sentence and number of vehicles, the most frequent first.
    """
    counts = Counter(part.words.difference for part in parts if part.words.difference)
    cells = []
    for sentence, count in counts.most_common():
        if count > 1:
            cells.append([sentence, str(count)])
    for part in parts:
        if counts[part.words.difference] > 1:
            part.words = part.words._replace(difference="")
    return Table(["reason", "vehicles"], cells, words=True)


def _rose(flights: Flights) -> Plan | None:
    """Returns the wind rose of all flights whose wind is known; None without any."""
    winds = []
    for flight in flights:
        row = flight[0]
        if row.wind_direction is not None and row.wind_speed is not None:
            winds.append((row.wind_direction, row.wind_speed))
    return rose_of_flights(np.array(winds, np.float64)) if winds else None


def _link(row: FlightRow) -> tuple[str, str]:
    """Returns the address of a flight's page, empty without one, and the path of its log."""
    # Colons are quoted: what stands before one would be taken for the scheme of an address.
    address = "" if row.page is None else quote(row.page, safe="/")
    return address, row.file


def fleet_remark(row: FlightRow) -> str:
    """Renders how a flight differs from others of its vehicle, for the top of its page; empty if it does not.

    Args:
        row: row of the flight's axis with the worst health.
    """
    template = environment().get_template("beside.html")
    return render_page(template, trouble=row, healths=fleet_words.HEALTH_LEVELS)


def with_fleet_remark(page: str, remark: str) -> str:
    """Returns the HTML of a flight's page with a remark at its top, in the place of an earlier one."""
    return REMARK_PLACE.sub(lambda _: remark, page, count=1)


class Column(NamedTuple):
    """A column of the table of flights."""

    kind: str
    """How the page sorts and shows it: "text", "number", "health" or "notes"."""

    cell: Callable[[AxisRows], str]
    """Makes the cell of a flight; empty where the quantity is not known."""

    width: str
    """Width of the column on a wide screen; the notes take what is left."""

    area: str = ""
    """Place of the cell in the three lines that a flight has on a phone; empty where it is left out."""


def _file_name(flight: AxisRows) -> str:
    """Returns the name of a log without its folder."""
    file = flight[0].file
    return re.split(r"[/\\\\]", file)[-1] or file


def _vehicle(flight: AxisRows) -> str:
    """Returns the name of a flight's vehicle."""
    return flight[0].vehicle


def _date(flight: AxisRows) -> str:
    """Returns date and time of a flight, up to the minute."""
    return f"{flight[0].date or ''}"[:DATE_LENGTH]


def _tier(flight: AxisRows) -> str:
    """Returns the tier of a flight: a, b or c."""
    return flight[0].tier or ""


def _badge(flight: AxisRows) -> str:
    """Returns how a flight went, in one word."""
    return fleet_words.badge([flight])


def _warning_lights(flight: AxisRows) -> str:
    """Returns the lights of a flight that are bad or to be watched, such as "motors bad, vibration watch".

    A light is the judgement of one part of the vehicle. The rows of all axes have the same lights.
    """
    texts = []
    for light in Light:
        level = getattr(flight[0], f"light_{light}")
        if level in (Level.BAD, Level.WATCH):
            texts.append(f"{light} {level}")
    return ", ".join(texts)


def _suspect_motors(flight: AxisRows) -> str:
    """Returns the numbers of the motors that are suspected on any axis."""
    motors = {row.suspect_motor for row in flight if row.suspect_motor is not None}
    return listed(sorted(motors))


def _notes(flight: AxisRows) -> str:
    """Returns what is reported about a flight, one sentence a line, the most important first, each once.

    The headline of the log comes first, then the reason for the health of the motors, then warnings.
    """
    # A log without a flight has one note: why it was not used.
    first_row = flight[0]
    if not first_row.has_flight:
        return truncated(first_row.status, MAX_NOTE_LENGTH)
    notes = []
    # The headline knows this log alone. Where only the comparison with other flights shows trouble, it says that
    # nothing is wrong, and is left out.
    is_trouble_of_fleet = worst_health(flight) in TROUBLED_HEALTHS
    if first_row.headline_level == Level.BAD or not is_trouble_of_fleet:
        notes += [row.headline for row in flight]
    notes += [row.health_reason for row in flight if row.health != MotorHealth.OK]
    for row in flight:
        notes += row.warnings
    sentences = dict.fromkeys(note for note in notes if note)
    return truncated("\n".join(sentences), MAX_NOTE_LENGTH)


def _settled_seconds(flight: AxisRows) -> str:
    """Returns the duration of settled flight, s."""
    seconds = flight[0].duration
    return "" if seconds is None or not flight[0].is_read else rounded(seconds, 3)


def _wind(flight: AxisRows) -> str:
    """Returns the wind's speed, m/s, and the direction that it came from, as far as known."""
    row = flight[0]
    speed = "" if row.wind_speed is None else rounded(row.wind_speed)
    direction = "" if row.wind_direction is None else compass_text(degrees(row.wind_direction))
    return f"{speed} {direction}".strip()


COLUMNS = {
    "flight": Column("text", _file_name, "8rem", "flight"),
    "vehicle": Column("text", _vehicle, "6.8rem", "vehicle"),
    "date": Column("text", _date, "8.8rem", "date"),
    "tier": Column("text", _tier, "3rem"),
    "health": Column("health", _badge, "5rem", "health"),
    "lights": Column("text", _warning_lights, "8rem", "lights"),
    "motor": Column("text", _suspect_motors, "4rem"),
    "notes": Column("notes", _notes, "auto", "notes"),
    "settled (s)": Column("number", _settled_seconds, "5rem"),
    "wind (m/s)": Column("number", _wind, "7rem"),
}
"""Columns of the table of flights, by their headers."""
