"""The index of a fleet: what was found in words, each vehicle's figures over its flights, and all flights."""

import re
from collections.abc import Callable, Mapping, Sequence
from math import degrees
from pathlib import PurePath
from urllib.parse import quote

import numpy as np

from mavdem.facts import Level
from mavdem.facts.lights import Light
from mavdem.facts.motors import MotorHealth
from mavdem.fleet.flights import AxisRows, flights_of, vehicles_of, worst_health
from mavdem.fleet.row import FlightRow, FlightRows
from mavdem.report import fleet as words
from mavdem.report.blocks import Block, Table
from mavdem.report.charts.plans import rose_of_flights
from mavdem.report.charts.vehicle_charts import vehicle_group
from mavdem.report.fleet import TROUBLED_HEALTHS, truncated, urgency
from mavdem.report.numbers import MAX_LISTED_NAMES, listed, rounded
from mavdem.report.pages.page import environment, render_page
from mavdem.wind_velocity.compass import compass_text

# vehicles, those in trouble first: with more the page takes long to make, and is too large to mail
MAX_DRAWN = 20
# lines of the table until more are asked for: a browser lays out so many while one types
FIRST_SHOWN = 50
MAX_NOTE = 320  # letters of what is said of a flight: its page has all
BADGES = "fault", "bad", "drift", "watch", words.NOT_USED, "unknown", "ok", "good"
"""What stands in the place of the health, the most urgent first."""
TOP = re.compile(r'(?<=<main>\n)(<p class="said [^<]*</p>\n)?')
"""Of a flight's page: what is said there of the flight beside others, if anything."""


def fleet_page(rows: FlightRows, changes: Mapping[str, Sequence[Block]] | None = None) -> str:
    """Returns the HTML of a fleet's index, the same for the same rows; ``changes`` since a baseline by vehicle."""
    since = dict(changes or {})
    # Flights that do not say whose they are may be those of several vehicles.
    ranked = sorted(
        (urgency(flights), name, flights)
        for name, flights in vehicles_of(rows).items()
        if words.is_one_vehicle(name, flights)
    )
    drawn = [name for _, name, flights in ranked if len(flights) > 1][:MAX_DRAWN]
    parts = [
        {
            "name": name,
            "last": flights[-1][0],
            "flights": len(flights),
            "badge": words.badge(flights),
            "words": words.vehicle_words(flights),
            "changes": since.get(name, ()),
            "group": vehicle_group(flights) if name in drawn else None,
            "is_open": rank < MAX_LISTED_NAMES and urgent < 2,  # those that need a look
        }
        for rank, ((urgent, _), name, flights) in enumerate(ranked)
    ]
    flights = flights_of(rows)
    dated = [flight for flight in flights if flight[0].date is not None]
    newest = [*reversed(dated), *flights[len(dated) :]]
    lines = [[read(flight) for _, read in COLUMNS.values()] for flight in newest]
    # A colon in a link would make what comes before it a scheme.
    links = [
        ("" if row.page is None else quote(row.page, safe="/"), row.file) for row, *_ in newest
    ]
    winds = [(row.wind_direction, row.wind_speed) for row, *_ in flights]
    complete = np.array([wind for wind in winds if None not in wind], np.float64)
    return render_page(
        environment().get_template("fleet.html"),
        blocks=words.fleet_blocks(rows),
        vehicles=parts,
        rose=rose_of_flights(complete) if len(complete) else None,
        first=Table([*COLUMNS], lines[:FIRST_SHOWN], words=True),
        table={
            "kinds": [kind for kind, _ in COLUMNS.values()],
            "rows": [[*link, *line] for link, line in zip(links, lines, strict=True)],
            "first": FIRST_SHOWN,
            "healths": BADGES,
        },
    )


def fleet_remark(row: FlightRow) -> str:
    """Returns the HTML of how a flight differs from others of its vehicle, by its worst row; empty if it does not."""
    return render_page(
        environment().get_template("beside.html"), trouble=row, healths=words.HEALTH_LEVELS
    )


def with_fleet_remark(page: str, top: str) -> str:
    """Returns the ``page`` of a flight with this HTML above it, in place of what was said there of it beside others."""
    return TOP.sub(lambda _: top, page, count=1)


def _lights(flight: AxisRows) -> str:
    """The lights that are not in order."""
    levels = ((light, getattr(flight[0], f"light_{light}")) for light in Light)
    lit = (f"{name} {level}" for name, level in levels if level in (Level.BAD, Level.WATCH))
    return ", ".join(lit)


def _notes(flight: AxisRows) -> str:
    """What is said of the flight, the most important first, a line each."""
    if not flight[0].has_flight:
        return truncated(flight[0].status, MAX_NOTE)
    reasons = [row.health_reason for row in flight if row.health != MotorHealth.OK]
    warnings = (warning for row in flight for warning in row.warnings)
    headlines = [row.headline for row in flight]
    if worst_health(flight) in TROUBLED_HEALTHS and flight[0].headline_level != Level.BAD:
        headlines = []  # of the log alone, which did not show it
    said = (*headlines, *reasons, *warnings)
    return truncated("\n".join(dict.fromkeys(filter(None, said))), MAX_NOTE)


def _motors(flight: AxisRows) -> str:
    """Those that are suspected."""
    return listed(sorted({row.suspect_motor for row in flight if row.suspect_motor is not None}))


def _settled(flight: AxisRows) -> str:
    seconds = flight[0].duration
    return "" if seconds is None or not flight[0].is_read else rounded(seconds, 3)


def _wind(flight: AxisRows) -> str:
    """Its speed, and where it came from."""
    row = flight[0]
    speed = "" if row.wind_speed is None else rounded(row.wind_speed)
    origin = "" if row.wind_direction is None else compass_text(degrees(row.wind_direction))
    return f"{speed} {origin}".strip()


COLUMNS: dict[str, tuple[str, Callable[[AxisRows], str]]] = {
    "flight": ("text", lambda flight: PurePath(flight[0].file).name or flight[0].file),
    "vehicle": ("text", lambda flight: flight[0].vehicle),
    "date": ("text", lambda flight: f"{flight[0].date or ''}"[:16]),
    "tier": ("text", lambda flight: flight[0].tier or ""),
    "health": ("health", lambda flight: words.badge([flight])),
    "lights": ("text", _lights),
    "motor": ("text", _motors),
    "notes": ("notes", _notes),
    "settled (s)": ("number", _settled),
    "wind (m/s)": ("number", _wind),
}
"""What each column is sorted as, and its cell of a flight; empty where it is not known."""
