"""The index of a fleet: what was found in words, each vehicle's figures over its flights, and all flights."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import degrees
from pathlib import PurePath
from typing import Any
from urllib.parse import quote

from markupsafe import Markup

from mavdem.condition.wind_velocity import from_point
from mavdem.errors import downstream
from mavdem.fleet.row import HEALTHS, NOT_IDENTIFIABLE, OK, UNKNOWN, FlightRow, flights_of, vehicles_of
from mavdem.report import flights as words
from mavdem.report.blocks import Block, Table
from mavdem.report.flights import TROUBLE, cut, doubt, had_trouble, urgency, vehicle_health
from mavdem.report.numbers import TORQUE, plus_minus, rounded
from mavdem.report.page import environment

MAX_DRAWN = 20  # vehicles, those in trouble first: with more the page takes long to make, and is too large to mail
FIRST_SHOWN = 200  # lines of the table until all are asked for: a browser lays out so many at once
MAX_OPEN = 4  # vehicles whose figures are open when nothing is wrong with them
NOT_USED = "not used"  # in the place of the health of a log without a flight


def fleet_page(rows: Sequence[FlightRow], changes: Mapping[str, Sequence[Block]] | None = None) -> str:
    """Returns the HTML of a fleet's index, the same for the same rows; ``changes`` since a baseline by vehicle."""
    since = dict(changes or {})
    # Flights that do not say whose they are may be those of several vehicles.
    vehicles = {name: flights for name, flights in vehicles_of(rows).items() if words.is_one_vehicle(name, flights)}
    healths = {name: vehicle_health(flights) for name, flights in vehicles.items()}
    ranked = sorted(vehicles, key=lambda name: (urgency(vehicles[name]), name))
    flown_often = [name for name in ranked if len(vehicles[name]) > 1]
    drawn = flown_often[:MAX_DRAWN]
    parts = [
        {
            "name": words.vehicle_name(name, vehicles[name]),
            "flights": len(vehicles[name]),
            "health": healths[name],
            "words": f"{doubt(vehicles[name])} {words.vehicle_words(vehicles[name])}".strip(),
            "changes": since.get(name, ()),
            "figure": _svg(vehicles[name], name) if name in drawn else "",
            "is_open": healths[name] in TROUBLE or bool(doubt(vehicles[name])) or len(drawn) <= MAX_OPEN,
        }
        for name in ranked
        if name in drawn or name in since or had_trouble(vehicles[name]) or doubt(vehicles[name])
    ]
    flights = flights_of(rows)
    dated = [flight for flight in flights if flight[0].date is not None]
    newest = [row for flight in (*reversed(dated), *flights[len(dated) :]) for row in flight]
    columns = {name: [read(row) for row in newest] for name, (_, read) in COLUMNS.items()}
    kept = [name for name, cells in columns.items() if name in ALWAYS or any(cells)]
    # A colon in a link would make what comes before it a scheme.
    links = [("" if row.page is None else quote(row.page, safe="/"), row.file) for row in newest]
    return (
        environment()
        .get_template("fleet.html")
        .render(
            blocks=words.fleet_blocks(rows),
            vehicles=parts,
            rose=_svg(flights, "rose", "wind_rose"),
            not_drawn=len(flown_often) - len(drawn),
            table=Table(kept, [list(line) for line in zip(*(columns[name] for name in kept), strict=True)]),
            kinds=[COLUMNS[name][0] for name in kept],
            links=links,
            first_shown=FIRST_SHOWN,
            severity=(*TROUBLE, NOT_USED, *HEALTHS[len(TROUBLE) :]),
        )
    )


def _svg(flights: Sequence[Sequence[FlightRow]], name: str, draw: str = "vehicle_figure") -> Markup:
    try:
        figure = downstream("report.figures.flights", draw)(flights)
    except ValueError:  # nothing is known
        return Markup("")
    return Markup(downstream("report.figures.style", "svg")(figure, name))


def _number(name: str, scale: float = 1.0, digits: int = 2, estimated: bool = False) -> Callable[[FlightRow], str]:
    """Reads a column; if ``estimated``, with its interval, rounded to what that bears."""

    def read(row: FlightRow) -> str:
        value, half = getattr(row, name), getattr(row, f"{name}_interval") if estimated else None
        if value is None or (estimated and getattr(row, f"{name}_status") == NOT_IDENTIFIABLE):
            return ""
        return rounded(scale * value, digits) if half is None else plus_minus(scale * value, scale * half)

    return read


def _largest_share(row: FlightRow) -> str:
    if not row.trim_share:
        return ""
    return f"{max(row.trim_share):.3f} (motor {row.trim_share.index(max(row.trim_share)) + 1})"


def _effectiveness(row: FlightRow) -> str:
    """The mean size over the motors, and the unit."""
    if not row.effect or row.effect_status == NOT_IDENTIFIABLE:
        return ""
    return f"{rounded(TORQUE.scale * sum(map(abs, row.effect)) / len(row.effect), 3)} per {row.per_input}"


def _residual(row: FlightRow) -> str:
    """The figure, and how large it is in healthy flights."""
    half = row.residual_mean_interval
    usual = "" if half is None else f" (usual ±{rounded(TORQUE.scale * half)})"
    return "" if row.residual_mean is None else f"{rounded(TORQUE.scale * row.residual_mean)}{usual}"


def _notes(row: FlightRow) -> str:
    said = [row.headline, row.health_reason if row.health != OK else "", *row.warnings]
    # The page of the flight has all.
    return cut(row.status if row.status != OK else " ".join(filter(None, said)), 160)


COLUMNS: dict[str, tuple[str, Callable[[FlightRow], Any]]] = {
    "flight": ("text", lambda row: PurePath(row.file).name or row.file),
    "vehicle": ("text", lambda row: "" if row.vehicle == UNKNOWN and row.status != OK else row.vehicle),
    "date": ("text", lambda row: "" if row.date is None else f"{row.date:%Y-%m-%d %H:%M}"),
    "axis": ("text", lambda row: row.axis or ""),
    "tier": ("text", lambda row: row.tier or ""),
    "health": ("health", lambda row: row.health if row.status == OK else NOT_USED),
    "motor": ("text", lambda row: "" if row.suspect_motor is None else str(row.suspect_motor)),
    "settled (s)": ("number", lambda row: _number("duration", digits=3)(row) if row.status == OK else ""),
    "largest share": ("number", _largest_share),
    "mean effectiveness (°/s²)": ("number", _effectiveness),
    "rate damping (1/s)": ("number", _number("damping", estimated=True)),
    "motor time constant (ms)": ("number", _number("lag", 1e3, estimated=True)),
    "wind (m/s)": ("number", _number("wind_speed")),
    "from": ("text", lambda row: "" if row.wind_direction is None else from_point(degrees(row.wind_direction))),
    "wind torque (°/s²)": ("number", _number("wind_torque_sd", TORQUE.scale)),
    "residual mean (°/s²)": ("number", _residual),
    "error ratio": ("number", _number("error_ratio")),
    "notes": ("text", _notes),
}
"""What each column is sorted as, and its cell of a row: empty where the value is not known."""
ALWAYS = ("flight", "vehicle", "date", "axis", "tier", "health", "notes")  # columns that are there even if empty
