"""The index of a fleet: what was found in words, each vehicle's figures over its flights, and all flights."""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from typing import NamedTuple

from mavdem.fleet.row import HEALTHS, FlightRow, flights_of, vehicles_of
from mavdem.page.fleet_charts import FleetDrawing, vehicle_drawings
from mavdem.page.fleet_table import NOT_USED, flight_table
from mavdem.report.blocks import Block
from mavdem.report.flights import (
    TROUBLE,
    fleet_blocks,
    had_trouble,
    is_one_vehicle,
    vehicle_health,
    vehicle_words,
)
from mavdem.report.page import environment

MIN_FLIGHTS = 2  # of a vehicle whose figures are drawn
MAX_DRAWN = 60  # vehicles, those in trouble first: a page with more is too large to mail
FIRST_SHOWN = 200  # lines of the table until all are asked for: a browser lays out so many at once
RATING = {"fault": "bad", "drift": "fair", "ok": "good", "unknown": "none"}
"""The class of a colour, beside the word."""
MAX_OPEN = 4  # vehicles whose charts are open when nothing is wrong with them


class VehiclePart(NamedTuple):
    """What the page says of one vehicle.

    Attributes:
        name, flights: which, and how many it flew.
        health: what was found in its latest flight that was judged: "fault", "drift", "ok" or "unknown".
        words: what was found, a sentence.
        changes: what changed since the baseline, if one was given.
        drawings: its figures over its flights.
        is_open: whether they are shown without asking.
    """

    name: str
    flights: int
    health: str
    words: str
    changes: Sequence[Block]
    drawings: Sequence[FleetDrawing]
    is_open: bool

    @property
    def rating(self) -> str:
        """The class of the colour of its health."""
        return RATING[self.health]


def fleet_page(rows: Sequence[FlightRow], changes: Mapping[str, Sequence[Block]] | None = None) -> str:
    """The HTML of a fleet's index. The same rows give the same bytes, in whatever order they come.

    Args:
        rows: of ``mavdem.fleet.dataset.read_rows``.
        changes: what changed since a baseline, by vehicle.
    """
    told = dict(changes or {})
    # Flights that do not say whose they are may be those of several vehicles.
    vehicles = {name: flights for name, flights in vehicles_of(rows).items() if is_one_vehicle(name, flights)}
    ranked = sorted(vehicles, key=lambda name: (HEALTHS.index(vehicle_health(vehicles[name])), name))
    flown_often = [name for name in ranked if len(vehicles[name]) >= MIN_FLIGHTS]
    drawn = set(flown_often[:MAX_DRAWN])
    parts = [
        VehiclePart(
            name,
            len(vehicles[name]),
            health := vehicle_health(vehicles[name]),
            vehicle_words(vehicles[name]),
            told.get(name, ()),
            vehicle_drawings(vehicles[name]) if name in drawn else (),
            health in TROUBLE or len(drawn) <= MAX_OPEN,
        )
        for name in ranked
        if name in drawn or name in told or had_trouble(vehicles[name])
    ]
    header, lines = flight_table([row for flight in _newest_first(rows) for row in flight])
    return (
        environment("mavdem.page")
        .get_template("fleet.html")
        .render(
            blocks=fleet_blocks(rows),
            vehicles=parts,
            not_drawn=len(flown_often) - len(drawn),
            header=header,
            lines=lines,
            first_shown=FIRST_SHOWN,
            severity=(*TROUBLE, NOT_USED, *HEALTHS[len(TROUBLE) :]),
            made_by=f"mavdem {version('mavdem')}, Python {platform.python_version()}",
        )
    )


def _newest_first(rows: Sequence[FlightRow]) -> list[list[FlightRow]]:
    """The flights, those without a date last."""
    flights = flights_of(rows)
    dated = [flight for flight in flights if flight[0].date is not None]
    return [*reversed(dated), *flights[len(dated) :]]
