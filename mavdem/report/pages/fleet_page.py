"""The HTML index of a fleet: a summary, the charts of each vehicle over its flights, and a table of all flights."""

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from markupsafe import Markup

from mavdem.facts import Level
from mavdem.facts.lights import Light
from mavdem.fleet.flights import flights_of
from mavdem.fleet.names import NO_NAMES, GivenNames
from mavdem.fleet.row import FlightRow, FlightRows
from mavdem.report.blocks import Block, Rated, Table
from mavdem.report.charts.chart import Plan
from mavdem.report.charts.plans import rose_of_flights
from mavdem.report.charts.vehicle_charts import vehicle_group
from mavdem.report.fleet import HEALTH_LEVELS, MAX_URGENT_RANK, NOT_USED, VehicleWords
from mavdem.report.fleet_summary import fleet_blocks, vehicles_with_parts
from mavdem.report.flight_lines import COLUMNS, FlightLine
from mavdem.report.numbers import listed
from mavdem.report.pages.environment import environment, render_page
from mavdem.report.vehicle_summary import MAX_BARS, LastFlight, VehicleSummary

MAX_DRAWN = 20
"""Vehicles with charts, the most urgent ones: with more, a page takes long to make and is too large to mail."""

FIRST_SHOWN = 50
"""Rows of the table that a browser without scripts shows."""

SUMMARY_BLOCKS = 2
"""Paragraphs of the summary at the top of the page: the headline, and what was flown."""

MAX_NAME_LENGTH = 16
"""Letters of a vehicle's name that are shown whole; of a longer one, such as a serial number, both ends are."""

LEVEL_MARKS = {Level.BAD: "■", Level.WATCH: "▲", Level.GOOD: "●", Level.UNKNOWN: "○"}
"""Mark of each level, which tells levels apart without their colours, the worst first."""

BADGE_LEVELS = {
    "fault": Level.BAD,
    "bad": Level.BAD,
    "drift": Level.WATCH,
    "watch": Level.WATCH,
    NOT_USED: Level.UNKNOWN,
    "unknown": Level.UNKNOWN,
    "ok": Level.GOOD,
    "good": Level.GOOD,
}
"""Level of each word in the column of the health, the most urgent word first: the order in which the page sorts."""

MAX_POINTS_OF_VEHICLE = 2000
"""Points that a line of a vehicle's charts has at most; one flight is one point."""

ChartsOfVehicle = Callable[[str], str]
"""Returns the charts of a vehicle by its name, as HTML."""

REMARK_PLACE = re.compile(r'(?<=<main>\n)(<p class="said [^<]*</p>\n)?')
"""The beginning of a flight's page, with the remark about other flights of the vehicle if there is one already."""


def fleet_page(
    summaries: Sequence[VehicleSummary],
    changes: Mapping[str, Sequence[Block]] | None = None,
    charts: ChartsOfVehicle = lambda _: "",
    names: GivenNames = NO_NAMES,
) -> str:
    """Renders the index of a fleet; the same flights give the same bytes, in whatever order they were read.

    Args:
        summaries: what is known of the flights under each name, in the order of the names.
        changes: what changed since a baseline, by vehicle; None without a baseline.
        charts: returns the charts of a vehicle over its flights, which are drawn for few vehicles.
        names: names that were given to vehicles and flights.
    """
    lines = _newest_first(summaries)
    cells = [_named_cells(line, names) for line in lines]
    vehicles = _vehicle_parts(summaries, changes or {}, charts, names)
    blocks = fleet_blocks(summaries, names_vehicles=False)
    # The headline and what was flown; without a flight there is nothing but the reasons.
    first_blocks = SUMMARY_BLOCKS if vehicles else len(blocks)
    return render_page(
        environment().get_template("fleet.html"),
        blocks=blocks[:first_blocks],
        unused_blocks=blocks[first_blocks:],
        vehicles=vehicles,
        unjudged=_repeated_differences(vehicles),
        lights=[*Light],
        light_counts=_light_counts(summaries),
        marks=LEVEL_MARKS,
        bars=MAX_BARS,
        rose=_rose(summaries),
        widths=[column.width for column in COLUMNS.values()],
        areas={name: column.area for name, column in COLUMNS.items()},
        first=Table([*COLUMNS], [_rated(line) for line in cells[:FIRST_SHOWN]], words=True),
        table={
            "kinds": [column.kind for column in COLUMNS.values()],
            "rows": [
                [line.link, line.file, *line_cells]
                for line, line_cells in zip(lines, cells, strict=True)
            ],
            "levels": BADGE_LEVELS,
            "given": sorted(map(names.vehicle, names.vehicles)),
        },
    )


def _rated(cells: Sequence[str]) -> list[str]:
    """Returns the cells of a flight's line, in which the health is coloured by its level."""
    rated = dict(zip(COLUMNS, cells, strict=True))
    rated["health"] = Rated(rated["health"], BADGE_LEVELS[rated["health"]])
    return [*rated.values()]


def vehicle_charts(rows: FlightRows) -> str:
    """Renders the charts of a vehicle over its flights as HTML; empty where there is nothing to draw.

    Args:
        rows: the rows of the vehicle, with all columns.
    """
    flights = flights_of(row for row in rows if row.has_flight)
    group = vehicle_group(flights)
    if group is None:
        return ""
    macros = environment().get_template("pictures.html").module
    return str(macros.shown([group], MAX_POINTS_OF_VEHICLE))  # type: ignore[attr-defined]


def _newest_first(summaries: Sequence[VehicleSummary]) -> list[FlightLine]:
    """Returns the lines of all flights, the newest first and those without a date last.

    Args:
        summaries: what is known of the flights under each name.
    """
    dated = []
    undated = []
    for summary in summaries:
        for line in summary.lines:
            if line.seconds is None:
                undated.append(line)
            else:
                dated.append(line)
    # The sort is stable: of equal dates the lines stay in the order of their vehicles, which is then reversed.
    dated.sort(key=lambda line: line.seconds or 0.0)
    return [*reversed(dated), *undated]


def _named_cells(line: FlightLine, names: GivenNames) -> list[str]:
    """Returns the cells of a flight's line, with the names that the flight and its vehicle were given."""
    cells = dict(zip(COLUMNS, line.cells, strict=True))
    cells["flight"] = names.flights.get(line.content) or cells["flight"]
    cells["vehicle"] = names.vehicle(cells["vehicle"])
    return [*cells.values()]


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
    last: LastFlight
    """Its latest flight."""
    flights: int
    """Number of its flights."""
    bars: FlightBars
    """Its latest flights."""
    words: VehicleWords
    """What was found of it."""
    changes: Sequence[Block]
    """What changed since the baseline."""
    charts: Markup
    """Its charts over the flights; empty without any."""
    is_open: bool
    """Whether it is unfolded at first."""


def _vehicle_parts(
    summaries: Sequence[VehicleSummary],
    changes: Mapping[str, Sequence[Block]],
    charts: ChartsOfVehicle,
    names: GivenNames,
) -> list[VehiclePart]:
    """Returns what the page shows of each vehicle, the most urgent vehicle first.

    Urgency is a rank by the health of the motors and the latest headline. Flights that do not say whose they are may be
    those of several vehicles, and have no part. To keep the page small, charts are drawn only for the ``MAX_DRAWN``
    most urgent vehicles with more than one flight. Parts are folded, except the first one with charts if its vehicle
    needs a look.

    Args:
        summaries: what is known of the flights under each name.
        changes: what changed since a baseline, by name of the vehicle.
        charts: returns the charts of a vehicle.
        names: names that were given to vehicles.
    """
    vehicles = vehicles_with_parts(summaries)
    ranked = sorted(vehicles, key=lambda name: (vehicles[name].urgency, name))
    drawn = [name for name in ranked if vehicles[name].flight_count > 1][:MAX_DRAWN]
    parts = []
    for name in ranked:
        vehicle = vehicles[name]
        needs_look = vehicle.urgency.rank < MAX_URGENT_RANK
        parts.append(
            VehiclePart(
                name=name,
                short_name=short_name(name),
                given_name=names.vehicle(name) if name in names.vehicles else "",
                last=vehicle.last,
                flights=vehicle.flight_count,
                bars=_bars(vehicle.levels),
                words=vehicle.words,
                changes=changes.get(name, ()),
                # They are HTML of this program.
                charts=Markup(charts(name) if name in drawn else ""),  # noqa: S704
                is_open=needs_look and name in drawn[:1],
            )
        )
    return parts


def short_name(name: str) -> str:
    """Returns the name of a vehicle as far as a line has room: the beginning and the end of a serial number."""
    if len(name) <= MAX_NAME_LENGTH:
        return name
    return f"{name[:4]}…{name[-6:]}"


def _bars(levels: Sequence[Level]) -> FlightBars:
    """Returns the latest flights of a vehicle as bars coloured by level, the newest at the right.

    All bars of one level are one SVG path, which keeps the page small.

    Args:
        levels: the level of each flight, at most ``MAX_BARS``, the oldest first.
    """
    paths = dict.fromkeys(LEVEL_MARKS, "")
    for place, level in enumerate(levels, start=MAX_BARS - len(levels)):
        # A rectangle of height 1 and width 0.8, which leaves a gap before the next bar.
        paths[level] += f"M{place} 0v1h.8v-1z"
    counts = Counter(levels)
    words = listed(f"{counts[level]} {level}" for level in LEVEL_MARKS if counts[level])
    drawn_paths = {level: path for level, path in paths.items() if path}
    return FlightBars(f"Latest flights: {words}", drawn_paths)


def _light_counts(summaries: Sequence[VehicleSummary]) -> list[LightCounts]:
    """Returns in how many flights each light has each level, the lights with most bad flights first.

    A light is the judgement of one part of the vehicle, such as its motors, by a level: bad, watch, good or unknown.
    The list is empty without a flight.

    Args:
        summaries: what is known of the flights under each name.
    """
    if not any(summary.vehicle for summary in summaries):
        return []
    counts = []
    for light in Light:
        levels: Counter[Level] = Counter()
        for summary in summaries:
            levels.update(summary.light_counts[light])
        counts.append(LightCounts(light, {level: levels[level] for level in LEVEL_MARKS}))
    counts.sort(key=lambda one: (-one.counts[Level.BAD], -one.counts[Level.WATCH]))
    return counts


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


def _rose(summaries: Sequence[VehicleSummary]) -> Plan | None:
    """Returns the wind rose of all flights whose wind is known; None without any."""
    winds = [wind for summary in summaries for wind in summary.winds]
    return rose_of_flights(np.array(winds, np.float64)) if winds else None


def fleet_remark(row: FlightRow) -> str:
    """Renders how a flight differs from others of its vehicle, for the top of its page; empty if it does not.

    Args:
        row: row of the flight's axis with the worst health.
    """
    template = environment().get_template("beside.html")
    return render_page(template, trouble=row, healths=HEALTH_LEVELS)


def with_fleet_remark(page: str, remark: str) -> str:
    """Returns the HTML of a flight's page with a remark at its top, in the place of an earlier one."""
    return REMARK_PLACE.sub(lambda _: remark, page, count=1)
