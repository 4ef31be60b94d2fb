"""The HTML index of a fleet: a summary, the charts of each vehicle over its flights, and a table of all flights."""

from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta
from math import ceil
from typing import NamedTuple

import numpy as np
from markupsafe import Markup

from mavdem.containers import JsonValues
from mavdem.facts import Level
from mavdem.facts.lights import Light
from mavdem.facts.urgency import Urgency
from mavdem.facts.vehicle import is_calibration_name
from mavdem.fleet.flights import group_into_flights
from mavdem.fleet.names import NO_NAMES, GivenNames
from mavdem.fleet.parameter_text import parse_parameters
from mavdem.fleet.row import UNKNOWN, FlightRows
from mavdem.ingest.telemetry import Parameters
from mavdem.report.blocks import Block, Rated, Sentence, Table
from mavdem.report.charts.chart import Plan
from mavdem.report.charts.plans import MIN_ROSE_FLIGHTS, rose_of_flights, wind_dots_of_flights
from mavdem.report.charts.vehicle_charts import vehicle_groups
from mavdem.report.fleet import (
    NOT_USED,
    is_serial,
    short_name,
    vehicle_label,
)
from mavdem.report.fleet_summary import (
    FLOWN_LEAD,
    fleet_blocks,
    flights_of_unknown_vehicles,
    flown_time_text,
    vehicles_with_section,
)
from mavdem.report.flight_lines import COLUMNS, FlightLine, flight_line
from mavdem.report.numbers import counted, listed
from mavdem.report.pages.environment import environment, render_page
from mavdem.report.vehicle_summary import LastFlight, VehicleFlights, VehicleSummary

MAX_DRAWN = 20
"""Vehicles with charts, the most urgent ones: with more, a page takes long to make and is too large to mail."""

FIRST_SHOWN = 50
"""Rows of the table that a browser without scripts shows."""

MIN_BARS = 12
"""Bars for which the list of vehicles has room at least, so that a few flights are not drawn as wide blocks."""

WHOLE_FLIGHTS = 200
"""Flights up to which the table shows all texts whole; of more, lines have one height and are drawn as needed."""

MAX_COLUMNS = 60
"""Columns of the picture of flights over time: so many can be told apart on a phone."""

MIN_CALENDAR_DAYS = 2
"""Days over which flights must be spread for that picture."""

CALENDAR_STEPS = {
    1: "a day",
    7: "a week",
    28: "four weeks",
    91: "a quarter of a year",
    364: "a year",
    3640: "ten years",
    36400: "a hundred years",
}
"""Days of a column of that picture, in ascending order, with their names."""

LEVEL_MARKS = {Level.BAD: "■", Level.WATCH: "▲", Level.GOOD: "●", Level.UNKNOWN: "○"}
"""Mark of each level, which tells levels apart without their colours, the worst first."""

BADGE_LEVELS = {
    "bad": Level.BAD,
    "watch": Level.WATCH,
    NOT_USED: Level.UNKNOWN,
    "unknown": Level.UNKNOWN,
    "good": Level.GOOD,
}
"""Level of each word in the column of the health, the most urgent word first: the order in which the page sorts."""

MAX_POINTS_OF_VEHICLE = 2000
"""Points that a line of a vehicle's charts has at most; one flight is one point."""

ChartsOfVehicle = Callable[[str], str]
"""Returns the charts of a vehicle by its name, as HTML."""


def fleet_page(
    summaries: Sequence[VehicleSummary],
    changes: Mapping[str, Sequence[Block]] | None = None,
    charts: ChartsOfVehicle = lambda _: "",
    names: GivenNames = NO_NAMES,
) -> str:
    """Renders the index of a fleet; the same flights give the same bytes, in whatever order they were read.

    Args:
        summaries: summary of the flights under each name, in the order of the names.
        changes: changes since a baseline, by vehicle; None without a baseline.
        charts: function that returns the charts of a vehicle over its flights, which are drawn for few vehicles.
        names: names that were given to vehicles and flights.
    """
    lines = _newest_first(summaries)
    shared_logs = _logs_of_several_vehicles(lines)
    cells = [_named_cells(line, names, is_log_shared=line.content in shared_logs) for line in lines]
    vehicles = _vehicle_sections(summaries, changes or {}, charts, names)
    blocks = fleet_blocks(summaries, names, lists_follow=True)
    # The page begins with the summary; the reasons why logs were not used come at its end. Without a vehicle there are
    # only such reasons, and the page begins with them.
    summary_length = _summary_length(blocks) if vehicles else len(blocks)
    serial_labels = _labels_of_serial_numbers(summaries, names)
    return render_page(
        environment().get_template("fleet.html"),
        blocks=blocks[:summary_length],
        unused_blocks=blocks[summary_length:],
        vehicles=vehicles,
        bad_unnamed_flights=_bad_unnamed_flights(summaries),
        unjudged=_move_reasons_to_table(vehicles),
        lights=[*Light],
        not_used=NOT_USED,
        least_urgency=Urgency.WATCH,
        light_counts=_light_counts(summaries),
        marks=LEVEL_MARKS,
        whole=WHOLE_FLIGHTS,
        calendar=_flight_calendar(lines),
        without_simulated=_remark_on_simulated_flights(lines),
        has_given_names=bool(names.vehicles),
        rose=_wind_drawing(summaries),
        bars=_bar_count(vehicles_with_section(summaries)),
        widths=[column.width for column in COLUMNS.values()],
        areas={name: column.area for name, column in COLUMNS.items()},
        first=_table_without_scripts(cells),
        all_logs=_number_of_logs_text(lines),
        table=_table_of_scripts(lines, cells, serial_labels)
        | _parameters_to_search(lines, summaries),
    )


def _summary_length(blocks: Sequence[Block]) -> int:
    """Returns how many blocks the summary at the top of a fleet's page has: all up to the paragraph on what was flown.

    Args:
        blocks: sentences and tables on the fleet: the summary, and then the reasons why logs were not used.
    """
    for count, block in enumerate(blocks, start=1):
        if isinstance(block, Sentence) and block.lead == FLOWN_LEAD:
            return count
    return len(blocks)


def _remark_on_simulated_flights(lines: Sequence[FlightLine]) -> str:
    """Returns words on simulated flights that do not count, for the end of a sentence; empty if the fleet has none."""
    if all(line.is_counted for line in lines):
        return ""
    return "; simulated ones only where a name says which vehicle was simulated"


def _table_without_scripts(cells: Sequence[Sequence[str]]) -> Table:
    """Returns the table of the newest flights of a fleet that a browser without scripts shows.

    Args:
        cells: text of each cell of all flights, the newest first, in the order of ``COLUMNS``.
    """
    rows = [_cells_with_rated_health(cells_of_flight) for cells_of_flight in cells[:FIRST_SHOWN]]
    return Table([*COLUMNS], rows, words=True)


def _table_of_scripts(
    lines: Sequence[FlightLine], cells: Sequence[Sequence[str]], serial_labels: Mapping[str, str]
) -> JsonValues:
    """Returns the table of all flights of a fleet as data, from which the page's script draws, sorts and searches it.

    Args:
        lines: lines of the flights, the newest first, with address and file of each and how urgent it is.
        cells: text of each cell of the same flights, in the order of ``COLUMNS``.
        serial_labels: what a vehicle is called on the page, by the serial number in its logs.
    """
    rows = []
    for line, cells_of_flight in zip(lines, cells, strict=True):
        rows.append([line.link, line.file, *cells_of_flight])
    return {
        "kinds": [column.kind for column in COLUMNS.values()],
        "rows": rows,
        "urgencies": [line.urgency for line in lines],
        "lights": [line.light_levels for line in lines],
        "counted": [line.is_counted and line.is_flight for line in lines],
        "findings": [line.finding for line in lines],
        "levels": BADGE_LEVELS,
        # In JSON the keys of an object come in the order of the alphabet, and not in that of urgency.
        "healths": [*BADGE_LEVELS],
        "labels": serial_labels,
    }


def _number_of_logs_text(lines: Sequence[FlightLine]) -> str:
    """Returns how many logs the table has, such as "12 logs with flights and 6 not used" or "12 logs"."""
    unused_count = sum(not line.is_flight for line in lines)
    if not unused_count:
        return counted(len(lines), "log")
    return f"{counted(len(lines) - unused_count, 'log')} with flights and {unused_count} not used"


def _parameters_to_search(
    lines: Sequence[FlightLine], summaries: Sequence[VehicleSummary]
) -> JsonValues:
    """Returns control parameters and heights of the flights, by which the page's script can search the table.

    Most flights of a vehicle have the same parameters, so each set is stored once and flights refer to it by number.

    Args:
        lines: lines of the flights, in the order of the table.
        summaries: summary of the flights under each name, with the vehicle's sets of parameters.

    Returns:
        Plain JSON values: ``parameters``, a list of all sets, each a value by name; ``parameter_sets``, for each flight
        the index of its set in that list; and ``heights``, m. The last two have None where they are not known.
    """
    all_sets: list[Parameters] = []
    # The sets of all vehicles follow each other in one list: the index of each vehicle's first one.
    first_index_by_vehicle = {}
    for summary in summaries:
        first_index_by_vehicle[summary.name] = len(all_sets)
        # A damaged set counts as empty.
        all_sets += [parse_parameters(text) or {} for text in summary.parameter_sets]
    set_indices: list[int | None] = []
    for line in lines:
        if line.parameter_set is None:
            set_indices.append(None)
        else:
            set_indices.append(first_index_by_vehicle[line.vehicle] + line.parameter_set)
    return {
        "parameters": all_sets,
        "parameter_sets": set_indices,
        "heights": [line.height for line in lines],
    }


def _cells_with_rated_health(cells: Sequence[str]) -> list[str]:
    """Returns the cells of a flight in the table of a fleet, with the level by which the health is coloured.

    Args:
        cells: text of each cell, in the order of ``COLUMNS``.
    """
    cells_by_column = dict(zip(COLUMNS, cells, strict=True))
    health = cells_by_column["health"]
    cells_by_column["health"] = Rated(health, BADGE_LEVELS[health])
    return list(cells_by_column.values())


def vehicle_charts(rows: FlightRows, healthy_logs: Collection[str]) -> str:
    """Renders the charts that show how one vehicle changed from flight to flight, as a part of the fleet's page.

    Args:
        rows: the rows of the vehicle in the fleet's table, with all columns.
        healthy_logs: hashes of the contents of the logs with whose flights the motors of the others are compared.

    Returns:
        HTML; empty if there is nothing to draw.
    """
    flights = group_into_flights(row for row in rows if row.has_flight)
    addresses = [flight_line(flight).link for flight in flights]
    groups = vehicle_groups(flights, addresses, healthy_logs)
    if not groups:
        return ""
    macros = environment().get_template("pictures.html").module
    return str(macros.shown(groups, MAX_POINTS_OF_VEHICLE))  # type: ignore[attr-defined]


def _newest_first(summaries: Sequence[VehicleSummary]) -> list[FlightLine]:
    """Returns the lines of all flights for the table of a fleet, the newest first and those without a date last.

    Args:
        summaries: summary of the flights under each vehicle's name, with the line of each flight.
    """
    dated_lines = []
    undated_lines = []
    for summary in summaries:
        for line in summary.lines:
            if line.seconds is None:
                undated_lines.append(line)
            else:
                dated_lines.append(line)
    # Lines of equal dates come in the reverse order of their vehicles: the sort is stable, and its result is reversed.
    dated_lines.sort(key=lambda line: line.seconds or 0.0)
    return [*reversed(dated_lines), *undated_lines]


def _logs_of_several_vehicles(lines: Iterable[FlightLine]) -> set[str]:
    """Returns the logs that hold flights of several vehicles, each of which has a line in the table of the fleet.

    Args:
        lines: lines of all flights.

    Returns:
        Hashes of the contents of these logs.
    """
    vehicles_by_log = defaultdict[str, set[str]](set)
    for line in lines:
        vehicles_by_log[line.content].add(line.vehicle)
    return {content for content, vehicles in vehicles_by_log.items() if len(vehicles) > 1}


def _named_cells(line: FlightLine, names: GivenNames, *, is_log_shared: bool = False) -> list[str]:
    """Returns the cells of a flight in the table of a fleet, with names that a user gave in the place of logged ones.

    Args:
        line: line of the flight, with a cell for each column of the table.
        names: names that users gave to vehicles and flights; those without one keep the name in their log.
        is_log_shared: whether the log has flights of several vehicles. The name of the flight then ends with the name
            of its vehicle in the log, as in "two_vehicles.tlog, px4-3".
    """
    cells = dict(zip(COLUMNS, line.cells, strict=True))
    given_flight_name = names.flights.get(line.content)
    if given_flight_name:
        cells["flight"] = given_flight_name
    if is_log_shared:
        cells["flight"] += f", {short_name(line.vehicle)}"
    if line.vehicle in names.vehicles:
        cells["vehicle"] = names.vehicle(line.vehicle)
    return list(cells.values())


class FlightBars(NamedTuple):
    """The latest flights of a vehicle as bars, one a flight, coloured by how it went."""

    words: str
    """How many flights have each level."""

    paths: Mapping[Level, str]
    """SVG path of the bars of each level; a bar is 1 wide."""


class CalendarColumn(NamedTuple):
    """The logs of flights of some days."""

    first_day: date
    """The first of the days, UTC."""

    counts: Mapping[Level, int]
    """Number of logs with each level, the worst first."""

    @property
    def words(self) -> str:
        """The day and how many logs have each level."""
        counts = listed(f"{count} {level}" for level, count in self.counts.items())
        return f"from {self.first_day}: {counts or 'no log'}"


class Calendar(NamedTuple):
    """The logs of a fleet over time: a column for each day, week or four weeks, coloured by how flights went."""

    columns: Sequence[CalendarColumn]
    """The columns, the oldest first."""

    days: int
    """Days of each column."""

    last_day: date
    """The day of the latest flight, UTC."""

    most: int
    """Largest number of flights in a column."""

    @property
    def bar_words(self) -> str:
        """How long a time each column is of, such as "a week"."""
        return CALENDAR_STEPS[self.days]


class LightCounts(NamedTuple):
    """The levels of one light in all logs."""

    name: Light
    """The light."""

    counts: Mapping[Level, int]
    """Number of logs with each level."""

    @property
    def text(self) -> str:
        """In how many logs the light is not good, by level, such as "4 bad, 2 watch"; "all good" if in none."""
        texts = []
        for level, count in self.counts.items():
            if level != Level.GOOD and count > 0:
                texts.append(f"{count} {level}")
        return ", ".join(texts) or "all good"


@dataclass
class VehicleSection:
    """What the template shows of one vehicle."""

    name: str
    """What its logs call the vehicle, such as its serial number."""
    label: str
    """What it is called: a name that somebody or its logs gave; its frame and both ends of a serial number."""
    serial: str
    """What is shown beside the label: its serial number where it has a given name, or that its logs have only a system
    id."""
    searched: str
    """The words that find its flights in the table."""
    last: LastFlight
    """Its latest flight."""
    link: str
    """Address of the page of that flight; empty without one."""
    file: str
    """Name of the log of that flight, or the name that a user gave to the flight."""
    other_lights: str
    """How many lights of that flight are good and how many unknown, as in "5 good, 2 unknown"."""
    flights: int
    """Number of its flights."""
    air_time: str
    """Time that it was in the air, such as "2.5 h"; empty if it is not known of any flight."""
    bars: FlightBars
    """Its latest flights."""
    note: str
    """What is to be known of it at a glance; empty where nothing is."""
    next_step: str
    """What to do next about it; empty where nothing is wrong."""
    summary: str
    """What was found in all its flights; may be empty."""
    is_compared: bool
    """Whether its motors were compared between its flights."""
    changes: Sequence[Block] = ()
    """What changed since the baseline."""
    charts: Markup = Markup()
    """Its charts over the flights; empty without any."""
    is_open: bool = False
    """Whether it is unfolded at first."""
    is_stated_above: bool = False
    """Whether the summary at the top of the page states its note and its next step."""

    @property
    def is_line(self) -> bool:
        """Whether the vehicle's line in the list says all that is known of it, so that there is nothing to unfold."""
        return self.flights == 1 and not (self.summary or self.changes or self.charts)


def _vehicle_sections(
    summaries: Sequence[VehicleSummary],
    changes: Mapping[str, Sequence[Block]],
    charts: ChartsOfVehicle,
    names: GivenNames,
) -> list[VehicleSection]:
    """Makes the sections of a fleet's page: one for each vehicle, with its flights, status, next step and charts.

    Sections are folded, so that all vehicles that need a look can be seen at once. If it is only one, its section is
    unfolded.

    Args:
        summaries: summary of the flights under each name.
        changes: changes since a baseline, by name of the vehicle.
        charts: function that returns the charts of a vehicle.
        names: names that were given to vehicles.

    Returns:
        The sections, the most urgent vehicle first.
    """
    vehicles = _vehicles_with_known_identity(summaries)
    summaries_by_name = {summary.name: summary for summary in summaries}
    names_by_urgency = sorted(vehicles, key=lambda name: (vehicles[name].urgency_and_age, name))
    names_with_several_flights = [name for name in names_by_urgency if vehicles[name].log_count > 1]
    # Charts make the page large, so that only the most urgent vehicles have them.
    names_with_charts = names_with_several_flights[:MAX_DRAWN]
    bar_count = _bar_count(vehicles)
    urgent_count = sum(vehicle.needs_look for vehicle in vehicles.values())
    sections = []
    for name in names_by_urgency:
        vehicle = vehicles[name]
        section = _vehicle_section(summaries_by_name[name], vehicle, bar_count, names)
        section.changes = changes.get(name, ())
        if name in names_with_charts:
            # Charts are HTML that this program made itself, so that nothing in it has to be escaped.
            section.charts = Markup(charts(name))  # noqa: S704
        if vehicle.needs_look and urgent_count == 1:
            section.is_open = True
            section.is_stated_above = True
            # The summary of the fleet has the reason, and the section what follows it.
            section.summary = section.summary.removeprefix(vehicle.texts.reason).lstrip()
        sections.append(section)
    return sections


def _vehicles_with_known_identity(
    summaries: Sequence[VehicleSummary],
) -> dict[str, VehicleFlights]:
    """Returns what is known of each vehicle whose flights are surely its own, by its name.

    These vehicles have a section on a fleet's page. A name that is a MAVLink system id may be shared by several
    vehicles. It counts as one vehicle only if its flights were compared with a baseline.

    Args:
        summaries: summary of the flights under each name.
    """
    shared_names = {summary.name for summary in summaries if summary.has_shared_name}
    vehicles = {}
    for name, vehicle in vehicles_with_section(summaries).items():
        # A baseline says that the flights under a shared name are of one vehicle, and then motors are judged.
        if name not in shared_names or vehicle.health != UNKNOWN:
            vehicles[name] = vehicle
    return vehicles


def _vehicle_section(
    summary: VehicleSummary, vehicle: VehicleFlights, bar_count: int, names: GivenNames
) -> VehicleSection:
    """Returns the folded section of a fleet's page on one vehicle, without its charts and its changes.

    Args:
        summary: summary of all logs under the vehicle's name.
        vehicle: what is known of the vehicle from its flights together.
        bar_count: largest number of bars in the section's picture, which has a bar for each of the latest flights.
        names: names that were given to vehicles and flights.
    """
    is_shared = summary.has_shared_name
    label = vehicle_label(summary.name, vehicle.last.frame, names, is_shared=is_shared)
    # In the place of a system id that vehicles may share, the table of flights has the label.
    name_in_table = label if is_shared else names.vehicle(summary.name)
    link_of_latest_flight = ""
    name_of_latest_flight = ""
    latest_line = _latest_line(summary)
    if latest_line is not None:
        link_of_latest_flight = latest_line.link
        name_of_latest_flight = _flight_name(latest_line, names)
    # Simulated flights are counted only of a vehicle that has no others.
    has_real_flights = summary.really_flown.logs > 0
    flown = summary.really_flown if has_real_flights else summary.flown
    return VehicleSection(
        name=summary.name,
        label=label,
        serial=_identification(summary.name, names, is_shared=is_shared),
        searched=name_in_table,
        last=vehicle.last,
        link=link_of_latest_flight,
        file=name_of_latest_flight,
        other_lights=_other_lights(vehicle.last),
        flights=flown.flights,
        air_time=flown_time_text(flown.air_seconds) if flown.air_seconds else "",
        bars=_level_bars(vehicle.levels, bar_count),
        note=vehicle.texts.finding,
        next_step=vehicle.texts.next_step,
        summary=vehicle.texts.all_flights,
        is_compared=vehicle.health != UNKNOWN,
    )


def _identification(logged_name: str, given_names: GivenNames, *, is_shared: bool) -> str:
    """Returns how the logs of a vehicle identify it, as a small text beside its label on a fleet's page.

    Args:
        logged_name: name of the vehicle in its logs, which may be a serial number, or made of a system id.
        given_names: names that owners gave to vehicles. The label is the given name, if there is one, and otherwise has
            the name in the logs.
        is_shared: whether the name in the logs is made of a MAVLink system id, which several vehicles may have.

    Returns:
        "by its system id only" for a shared name. For a vehicle with a given name, the name in its logs; a serial
        number is shortened. That it has no serial number, for a vehicle that its sensors' calibration identifies. Empty
        for other vehicles, since the label has the name in the logs already.
    """
    if is_shared:
        return "by its system id only"
    if given_names.vehicle(logged_name) != logged_name:
        return short_name(logged_name)
    if is_calibration_name(logged_name):
        return "no serial number, known by its sensors"
    return ""


def _flight_name(line: FlightLine, names: GivenNames) -> str:
    """Returns the name that a user gave to the flight in a line of the table, otherwise the name of its log's file."""
    cells_by_column = dict(zip(COLUMNS, _named_cells(line, names), strict=True))
    return cells_by_column["flight"]


def _latest_line(summary: VehicleSummary) -> FlightLine | None:
    """Returns the line of the latest flight under a vehicle's name.

    Args:
        summary: summary of the logs under the name, with a line for each log in order of date. A log that could not be
            used is no flight.

    Returns:
        The line; None without a flight.
    """
    for line in reversed(summary.lines):
        if line.is_flight:
            return line
    return None


def _other_lights(flight: LastFlight) -> str:
    """Returns how many status lights of a flight are good and how many unknown, such as "5 good, 2 unknown".

    The page shows the lights that warn by name.
    """
    counts_by_level = Counter(flight.lights.values())
    texts = []
    for level in (Level.GOOD, Level.UNKNOWN):
        if counts_by_level[level]:
            texts.append(f"{counts_by_level[level]} {level}")
    return ", ".join(texts)


class UnnamedFlight(NamedTuple):
    """A bad flight whose vehicle is not known."""

    link: str
    """Address of its page; empty without one."""

    file: str
    """Name of its log."""

    date: str
    """When it began, up to the minute; empty where it is not known."""

    headline: str
    """What is wrong."""


def _bad_unnamed_flights(summaries: Sequence[VehicleSummary]) -> list[UnnamedFlight]:
    """Returns the real flights that went badly, of vehicles whose logs do not name them, the newest first.

    The page lists these flights one by one, since it cannot say which vehicle made them.

    Args:
        summaries: summary of the flights under each name, with the line of each flight in the table of all flights.
    """
    flights = []
    for line in flights_of_unknown_vehicles(Level.BAD, summaries):
        flights.append(
            UnnamedFlight(line.link, line.cell("flight"), line.cell("date"), line.headline)
        )
    return flights


def _labels_of_serial_numbers(
    summaries: Sequence[VehicleSummary], names: GivenNames
) -> dict[str, str]:
    """Returns short labels for the vehicles whose logs name them by a serial number, such as "Quadrotor 001a…0c3f2a".

    A serial number is too long for a column of the table of flights. The label has the type of the frame and both ends
    of the number.

    Args:
        summaries: summary of the flights under each name.
        names: names that owners gave to vehicles; a vehicle with a given name needs no label.

    Returns:
        Labels by the serial number, which is the name of the vehicle in its logs.
    """
    labels = {}
    for summary in summaries:
        if is_serial(summary.name) and summary.name not in names.vehicles:
            frame = "" if summary.vehicle is None else summary.vehicle.last.frame
            labels[summary.name] = vehicle_label(summary.name, frame, names)
    return labels


def _bar_count(vehicles: Mapping[str, VehicleFlights]) -> int:
    """Returns for how many bars each vehicle's row of bars has room, so that all rows have the same scale.

    It is the largest number of bars that a vehicle needs, and at least ``MIN_BARS``.

    Args:
        vehicles: summary of each vehicle's flights, by name. Each of its latest flights is a bar, coloured by level.
    """
    counts = [len(vehicle.levels) for vehicle in vehicles.values()]
    return max([MIN_BARS, *counts])


def _flight_calendar(lines: Sequence[FlightLine]) -> Calendar | None:
    """Counts the logs of a fleet over time, for a bar chart with at most ``MAX_COLUMNS`` columns.

    A column is one of ``CALENDAR_STEPS``: the shortest of these with which the chart has not too many columns. It has
    the number of logs with each level, as the table has it.

    Args:
        lines: the lines of all logs; those that do not count or have no date are left out.

    Returns:
        The columns; None if all logs are of one day, or none has a date.
    """
    level_counts_by_day = _level_counts_by_day(lines)
    if not level_counts_by_day:
        return None
    first_day = min(level_counts_by_day)
    last_day = max(level_counts_by_day)
    span_days = (last_day - first_day).days + 1
    if span_days < MIN_CALENDAR_DAYS:
        return None

    column_days = next(days for days in CALENDAR_STEPS if span_days <= days * MAX_COLUMNS)
    column_count = ceil(span_days / column_days)
    counts_by_column: list[Counter[Level]] = [Counter() for _ in range(column_count)]
    for day, level_counts in level_counts_by_day.items():
        column_number = (day - first_day).days // column_days
        counts_by_column[column_number] += level_counts
    columns = []
    for number, counts in enumerate(counts_by_column):
        # The parts of a bar are drawn in the order of ``LEVEL_MARKS``.
        counts_in_order = {level: counts[level] for level in LEVEL_MARKS if counts[level]}
        column_start = first_day + timedelta(days=column_days * number)
        columns.append(CalendarColumn(column_start, counts_in_order))
    logs_of_highest_column = max(counts.total() for counts in counts_by_column)
    return Calendar(columns, column_days, last_day, logs_of_highest_column)


def _level_counts_by_day(lines: Sequence[FlightLine]) -> dict[date, Counter[Level]]:
    """Counts the logs of each day (UTC) by level: that of the headline, or of a drift or fault of the motors.

    Args:
        lines: lines of the table of all flights.

    Returns:
        Numbers of logs by day and level. Logs without a date, those that do not count, and logs that were
        not used are left out.
    """
    health_column = list(COLUMNS).index("health")
    counts = defaultdict[date, Counter[Level]](Counter)
    for line in lines:
        if line.seconds is not None and line.is_counted and line.is_flight:
            day = datetime.fromtimestamp(line.seconds, UTC).date()
            level = BADGE_LEVELS[line.cells[health_column]]
            counts[day][level] += 1
    return counts


def _level_bars(levels: Sequence[Level], bar_count: int) -> FlightBars:
    """Draws the latest flights of a vehicle as a row of bars coloured by level (good, watch, bad), the newest right.

    All bars of one level are one SVG path, which keeps the page small.

    Args:
        levels: the level of each flight, the oldest first.
        bar_count: number of bars for which the row has room; with fewer flights its left end stays empty.
    """
    path_by_level = dict.fromkeys(LEVEL_MARKS, "")
    first_column = bar_count - len(levels)
    for column, level in enumerate(levels, start=first_column):
        # A rectangle of height 1 and width 0.8, which leaves a gap before the next bar.
        path_by_level[level] += f"M{column} 0v1h.8v-1z"
    counts = Counter(levels)
    count_text = listed(f"{counts[level]} {level}" for level in LEVEL_MARKS if counts[level])
    drawn_paths = {level: path for level, path in path_by_level.items() if path}
    return FlightBars(f"Latest flights: {count_text}", drawn_paths)


def _light_counts(summaries: Sequence[VehicleSummary]) -> list[LightCounts]:
    """Counts for each status light in how many logs of a fleet it has each level.

    A status light is the judgement of one part of the vehicle, such as its motors, by a level: bad, watch, good or
    unknown.

    Args:
        summaries: summary of the flights under each vehicle's name.

    Returns:
        The counts, sorted so that the light that is bad in most logs comes first; empty if no log
        counts, as of a fleet of simulated flights of unknown vehicles.
    """
    counts = []
    has_counted_log = False
    for light in Light:
        logs_by_level: Counter[Level] = Counter()
        for summary in summaries:
            logs_by_level.update(summary.light_counts[light])
        if logs_by_level.total() > 0:
            has_counted_log = True
        counts_in_order = {level: logs_by_level[level] for level in LEVEL_MARKS}
        counts.append(LightCounts(light, counts_in_order))
    if not has_counted_log:
        return []

    def bad_and_watched(light_counts: LightCounts) -> tuple[int, int]:
        """Returns in how many logs a light is bad, and in how many it is to be watched."""
        return light_counts.counts[Level.BAD], light_counts.counts[Level.WATCH]

    return sorted(counts, key=bad_and_watched, reverse=True)


def _move_reasons_to_table(sections: Sequence[VehicleSection]) -> Table:
    """Moves the reasons why motors were not compared between flights from the vehicles' sections to one table.

    Many vehicles of a fleet lack the same thing, such as enough flights to compare, and all their sections would say
    so.

    Args:
        sections: sections of the page, one for each vehicle. The summary of a vehicle whose motors were not compared is
            the reason. If there are several such vehicles, this function empties these summaries.

    Returns:
        Rows with the number of vehicles and their reason, the most frequent first. No rows if there is only one such
        vehicle: its section keeps the reason.
    """
    rows = []
    uncompared_sections = [section for section in sections if not section.is_compared]
    if len(uncompared_sections) > 1:
        # The title above the table says that they are not compared.
        counts = Counter(
            section.summary.removeprefix("Not compared with other flights. ")
            for section in uncompared_sections
        )
        rows = [[str(count), reason] for reason, count in counts.most_common()]
        for section in uncompared_sections:
            section.summary = ""
    return Table(["vehicles", "reason"], rows, words=True)


def _wind_drawing(summaries: Sequence[VehicleSummary]) -> Plan | None:
    """Draws the mean wind of each flight of a fleet: a dot for each of a few flights, a wind rose of many.

    Args:
        summaries: summary of the flights under each name, with the mean wind of each flight.

    Returns:
        The drawing; None if no wind is known.
    """
    winds = []
    for summary in summaries:
        winds += summary.winds
    if not winds:
        return None
    winds_of_flights = np.array(winds, np.float64)
    if len(winds) < MIN_ROSE_FLIGHTS:
        return wind_dots_of_flights(winds_of_flights)
    directions_and_speeds = winds_of_flights[:, :2]
    return rose_of_flights(directions_and_speeds)
