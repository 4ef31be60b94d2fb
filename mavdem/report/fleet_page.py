"""The index of a fleet: what was found in words, each vehicle's figures over its flights, and all flights."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import degrees
from pathlib import PurePath
from typing import Any
from urllib.parse import quote

import numpy as np

from mavdem.condition.wind_velocity import from_point
from mavdem.facts import Level
from mavdem.facts.lights import Light
from mavdem.facts.motors import MotorHealth
from mavdem.fleet.row import (
    HEALTHS,
    NOT_IDENTIFIABLE,
    OK,
    UNKNOWN,
    Flight,
    FlightRow,
    flights_of,
    vehicles_of,
    worst_health,
)
from mavdem.report import fleet as words
from mavdem.report.blocks import Block, Rated, Table
from mavdem.report.fleet import TROUBLE, cut, doubt, urgency, vehicle_health
from mavdem.report.numbers import MOST_NAMED, TORQUE, plus_minus, rounded
from mavdem.report.page import environment
from mavdem.report.plans import rose_of_flights
from mavdem.report.vehicle_charts import vehicle_group

# vehicles, those in trouble first: with more the page takes long to make, and is too large to mail
MAX_DRAWN = 20
# lines of the table until more are asked for: a browser lays out so many while one types
FIRST_SHOWN = 50
MAX_NOTE = 320  # letters of what is said of a flight: its page has all
NOT_USED = "not used"  # in the place of the health of a log without a flight


def fleet_page(
    rows: Sequence[FlightRow], changes: Mapping[str, Sequence[Block]] | None = None
) -> str:
    """Returns the HTML of a fleet's index, the same for the same rows; ``changes`` since a baseline by vehicle."""
    since = dict(changes or {})
    # Flights that do not say whose they are may be those of several vehicles.
    vehicles = {
        name: flights
        for name, flights in vehicles_of(rows).items()
        if words.is_one_vehicle(name, flights)
    }
    ranked = sorted(vehicles, key=lambda name: (urgency(vehicles[name]), name))
    flown_often = [name for name in ranked if len(vehicles[name]) > 1]
    drawn = flown_often[:MAX_DRAWN]
    parts = [
        {
            "name": name,
            "last": flights[-1][0],
            "flights": len(flights),
            "health": (health := vehicle_health(flights)),
            "level": words.LEVELS[MotorHealth(health)],
            "conclusion": words.conclusion(flights),
            "words": words.vehicle_words(flights),
            "changes": since.get(name, ()),
            "group": vehicle_group(flights) if name in drawn else None,
            "is_open": place < MOST_NAMED and (health in TROUBLE or bool(doubt(flights))),
        }
        for place, (name, flights) in enumerate((name, vehicles[name]) for name in ranked)
    ]
    flights = flights_of(rows)
    dated = [flight for flight in flights if flight[0].date is not None]
    newest = [*reversed(dated), *flights[len(dated) :]]
    columns = {name: _cells(name, newest) for name in COLUMNS}
    kept = [name for name, cells in columns.items() if name in ALWAYS or any(cells)]
    lines = [list(line) for line in zip(*(columns[name] for name in kept), strict=True)]
    # A colon in a link would make what comes before it a scheme.
    links = [
        ("" if row.page is None else quote(row.page, safe="/"), row.file) for row, *_ in newest
    ]
    winds = [(row.wind_direction, row.wind_speed) for row, *_ in flights]
    known = np.array([wind for wind in winds if None not in wind], np.float64)
    return (
        environment()
        .get_template("fleet.html")
        .render(
            blocks=words.fleet_blocks(rows),
            vehicles=parts,
            rose=rose_of_flights(known) if len(known) else None,
            not_drawn=len(flown_often) - len(drawn),
            first=Table(kept, lines[:FIRST_SHOWN], words=True),
            table={
                "kinds": [COLUMNS[name][0] for name in kept],
                "rows": [[*link, *line] for link, line in zip(links, lines, strict=True)],
                "first": FIRST_SHOWN,
                "healths": (*TROUBLE, NOT_USED, *HEALTHS[len(TROUBLE) :]),
            },
        )
    )


def _number(
    name: str, scale: float = 1.0, digits: int = 2, estimated: bool = False
) -> Callable[[FlightRow], str]:
    """Reads a column; if ``estimated``, with its interval, rounded to what that bears."""

    def read(row: FlightRow) -> str:
        value = getattr(row, name)
        half = getattr(row, f"{name}_interval") if estimated else None
        if value is None or (estimated and getattr(row, f"{name}_status") == NOT_IDENTIFIABLE):
            return ""
        return (
            rounded(scale * value, digits)
            if half is None
            else plus_minus(scale * value, scale * half)
        )

    return read


def _effectiveness(row: FlightRow) -> str:
    """The mean size over the motors, and the unit."""
    if not row.effect or row.effect_status == NOT_IDENTIFIABLE:
        return ""
    return f"{rounded(TORQUE.scale * sum(map(abs, row.effect)) / len(row.effect), 3)} per {row.per_input}"


def _health(flight: Flight) -> Rated:
    health = MotorHealth(worst_health(flight))
    return Rated(health, words.LEVELS[health])


def _lights(row: FlightRow) -> str:
    """The lights that are not in order."""
    levels = {str(light): getattr(row, f"light_{light}") for light in Light}
    lit = (f"{name} {level}" for name, level in levels.items() if level in (Level.BAD, Level.WATCH))
    return ", ".join(lit)


def _notes(flight: Flight) -> str:
    """What is said of the flight, the most important first, a line each."""
    if flight[0].status != OK:
        return cut(flight[0].status, MAX_NOTE)
    reasons = (row.health_reason for row in flight if row.health != OK)
    said = (
        *(row.headline for row in flight),
        *reasons,
        *(one for row in flight for one in row.warnings),
    )
    return cut("\n".join(dict.fromkeys(filter(None, said))), MAX_NOTE)


def _cells(name: str, flights: Sequence[Flight]) -> list[str]:
    """A column of the flights: what their axes have in common once, else roll / pitch."""
    kind, read = COLUMNS[name]
    if kind in ("health", "notes"):
        return [read(flight) for flight in flights]
    by_axis = ([read(row) for row in flight] for flight in flights)
    return [
        one[0] if len(set(one)) == 1 else " / ".join(cell or "–" for cell in one) for one in by_axis
    ]


COLUMNS: dict[str, tuple[str, Callable[[Any], str]]] = {
    "flight": ("text", lambda row: PurePath(row.file).name or row.file),
    "vehicle": (
        "text",
        lambda row: "" if row.vehicle == UNKNOWN and row.status != OK else row.vehicle,
    ),
    "date": ("text", lambda row: "" if row.date is None else f"{row.date:%Y-%m-%d %H:%M}"),
    "tier": ("text", lambda row: row.tier or ""),
    "health": (
        "health",
        lambda flight: _health(flight) if flight[0].status == OK else NOT_USED,
    ),
    "lights": ("text", _lights),
    "motor": ("text", lambda row: "" if row.suspect_motor is None else str(row.suspect_motor)),
    "notes": ("notes", _notes),
    "settled (s)": (
        "number",
        lambda row: _number("duration", digits=3)(row) if row.status == OK else "",
    ),
    "mean effectiveness (°/s²)": ("number", _effectiveness),
    "rate damping (1/s)": ("number", _number("damping", estimated=True)),
    "motor time constant (ms)": ("number", _number("lag", 1e3, estimated=True)),
    "wind (m/s)": ("number", _number("wind_speed")),
    "from": (
        "text",
        lambda row: "" if row.wind_direction is None else from_point(degrees(row.wind_direction)),
    ),
    "wind torque (°/s²)": ("number", _number("wind_torque_sd", TORQUE.scale)),
    "error ratio": ("number", _number("error_ratio")),
}
"""What each column is sorted as, and its cell of a row (of a flight: health and notes); empty where it is not known."""
# columns that are there even if empty
ALWAYS = ("flight", "vehicle", "date", "tier", "health", "notes")
