"""FlightRow, the one record of a flight's figures: what one log says of one vehicle and axis.

A row is made from ``report.json``'s document, stored, compared and shown. Here are also the schema of the table that
rows make, the flights and vehicles that they belong to, and the counts of a fleet.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from datetime import UTC, datetime
from functools import cache
from types import UnionType
from typing import Any, get_args, get_origin, get_type_hints

from mavdem.alignment.drive import INPUTS
from mavdem.documents import header

SCHEMA_VERSION: int = header("flights")["schema_version"]
"""Changes with the columns or with what they mean: logs whose rows have another version are read again."""

# the vehicle of a log that does not say whose it is, and health that is not known
UNKNOWN = "unknown"
OK = "ok"  # the status of a flight that was read, and the health of one as healthy ones
SHARED = "system id"  # the basis of a name that several vehicles may have
HEALTHS = ("fault", "drift", OK, UNKNOWN)  # the worst first
NOT_IDENTIFIABLE = "not identifiable"  # the status of what a flight says nothing of
AXIS_ORDER = ("roll", "pitch", "yaw")
MOTORS, DEMAND = INPUTS

Numbers = tuple[float, ...]


def at(place: str, default: str | None = None) -> Any:
    """A column that is at this place of a document of ``report.json``."""
    return field(default=default, metadata={"place": place})


@dataclass(frozen=True, kw_only=True)
class FlightRow:
    """One settled flight of a log: one vehicle, one axis. SI units, angles rad; None where a value is not known.

    A log that holds no such flight, or cannot be read, has one row whose ``status`` says why. Tuples have an entry for
    each motor, in the order of ``motors``, unless documents.toml says otherwise. Intervals are half widths, 90 %.
    """

    file: str  # path or URL of the log
    # hash of its content and its size, by which it is known again; empty if it could not be read at all
    key: str = ""
    # by what the log says of its identity; "unknown" where it says nothing
    vehicle: str = at("identity.name", UNKNOWN)
    # of the name: "board", "accelerometer", "compass", or ``SHARED``
    vehicle_basis: str | None = at("identity.basis")
    autopilot: str | None = at("identity.autopilot")  # as the log has them
    frame: str | None = at("identity.frame")
    firmware: str | None = at("identity.firmware")
    system: int | None = at("identity.system")  # MAVLink ids
    component: int | None = None
    # when the flight began, UTC; in the table without a zone
    date: datetime | None = at("identity.date")
    axis: str | None = None  # "roll" or "pitch"
    # "a" everything, "b" the slow motion and conditions, "c" conditions only
    tier: str | None = at("tier")
    tier_reason: str | None = at("reason")  # why no better one
    duration: float | None = at("condition.settled")  # of the settled flight, s
    attitude_rate: float | None = at("verdict.figures.attitude_rate")  # Hz
    motor_rate: float | None = at("verdict.figures.motor_rate")
    voltage_start: float | None = at("condition.battery.voltage_start")  # V
    voltage_end: float | None = at("condition.battery.voltage_end")
    voltage_mean: float | None = at("condition.battery.voltage_mean")
    # mean of all motors, of their range: payload and thrust
    collective: float | None = at("condition.collective")
    lean_roll: float | None = at("condition.lean.roll.mean")  # mean angles, rad
    lean_pitch: float | None = at("condition.lean.pitch.mean")
    tilt_sd: float | None = at("condition.tilt_sd")  # of the angle from level, rad
    tilt_max: float | None = at("condition.tilt_max")
    vibration: Numbers | None = at("condition.vibration.level")  # x, y, z, m/s²
    # how often an accelerometer was at its limit
    clips: int | None = at("condition.vibration.clips")
    motors: tuple[str, ...] | None = at("condition.hover.motors")  # their names
    # +1 counter-clockwise seen from above, -1 clockwise, 0 not known
    spins: tuple[int, ...] | None = None
    positions: tuple[tuple[float, float], ...] | None = None  # forward and right, in arm lengths
    trim_unit: str | None = at("condition.hover.unit")
    trim: Numbers | None = at("condition.hover.trim")  # mean output, in ``trim_unit``
    # as a share of the range, over the mean of all
    trim_share: Numbers | None = at("condition.hover.trim_share")
    trim_share_interval: Numbers | None = at("condition.share_interval")
    # left at the 99th percentile, as a share of the range
    headroom: Numbers | None = at("condition.hover.headroom")
    # share of the time at the upper stop
    saturated: Numbers | None = at("condition.hover.at_upper_limit")
    # how long it oscillated by its own controller, s
    oscillation: float | None = at("condition.oscillation.seconds")
    balance: Numbers | None = None
    balance_error: Numbers | None = None
    balance_lean: Numbers | None = None  # mean roll and pitch meanwhile, rad
    # change of each by roll and by pitch, 1/rad, row after row, and standard error
    lean_effect: Numbers | None = None
    lean_effect_error: Numbers | None = None
    # of the model, "motors" or one "demand" for the axis; without one, of ``mean_inputs``
    inputs: str | None = None
    input_unit: str | None = None
    # angular acceleration for one unit of each input, rad/s²
    effect: Numbers | None = at("physical.effect")
    effect_interval: Numbers | None = at("physical.interval_90_percent.effect")
    effect_status: str | None = at("physical.status.effect")
    damping: float | None = at("physical.damping")  # 1/s
    damping_interval: float | None = at("physical.interval_90_percent.damping")
    damping_status: str | None = at("physical.status.damping")
    lag: float | None = at("physical.lag")  # of the motors, s
    lag_interval: float | None = at("physical.interval_90_percent.lag")
    lag_status: str | None = at("physical.status.lag")
    wind_torque_sd: float | None = at("wind.sd")  # rad/s²; the interval is that of the mean
    wind_torque_mean: float | None = at("wind.mean")
    wind_torque_interval: float | None = at("wind.mean_band")
    wind_speed: float | None = None  # of the mean wind, m/s
    wind_speed_interval: Numbers | None = None  # both ends of it, m/s
    wind_direction: float | None = None  # where it comes from, rad clockwise from north
    wind_direction_interval: float | None = None  # half width, rad
    drag: Numbers | None = None  # linear along body x and y, 1/s, then quadratic, 1/m
    drag_interval: Numbers | None = None
    # over the flight, of each input and output of the model
    mean_inputs: Numbers | None = at("condition.hover.trim")
    mean_outputs: Numbers | None = None
    residual_gain_inputs: Numbers | None = None
    residual_gain_outputs: Numbers | None = None
    residual_offset: float | None = None
    # what the flight says of its vehicle, in one plain sentence
    headline: str | None = at("headline")
    # what overrides that: "oscillation", "motors", "saturation", "trim" or "data"
    overrides: tuple[str, ...] = ()
    # of squared errors, on parts held out
    error_ratio: float | None = at("forecast_over_constant_mean")
    coverage: float | None = at("inside_90_percent_band")  # share of held-out samples
    # what models of its healthy flights leave unexplained in this one, rad/s²
    residual_mean: float | None = None
    residual_mean_interval: float | None = None  # how far from 0 that is in 90 % of healthy flights
    health: str = UNKNOWN  # "ok", "drift", "fault" or "unknown"
    # that a motor works 8 % harder or more, whichever it is, from 0 to 1
    fault_probability: float | None = None
    change_probability: float | None = None  # that anything changed, from 0 to 1
    suspect_motor: int | None = None  # from 1; the number in the order of ``motors``
    health_reason: str | None = None  # what speaks for it, or what is missing
    warnings: tuple[str, ...] = ()  # one sentence each
    status: str = OK  # "ok", or why there is no flight
    page: str | None = None  # the flight's own page, relative to the folder of the fleet
    mavdem_version: str = ""  # of the program that read the log

    def __post_init__(self) -> None:
        """Brings every value to its column's type, which makes rows equal that say the same."""
        for name, kind in _kinds().items():
            object.__setattr__(self, name, _value(getattr(self, name), kind))

    @property
    def order(self) -> tuple[str, str, str, int, int, str]:
        """By which rows are sorted: nothing that depends on when they were made."""
        return (
            self.vehicle,
            self.file,
            self.key,
            self.system or 0,
            self.component or 0,
            self.axis or "",
        )

    @property
    def per_input(self) -> str:
        """The unit of the model's inputs in words: an effectiveness is for one of them."""
        return "unit of demand" if self.inputs == DEMAND else self.input_unit or "unit of input"

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON values; the date as ISO 8601."""
        values = asdict(self)
        if self.date is not None:
            values["date"] = self.date.isoformat()
        return values

    @staticmethod
    def of(report: Mapping[str, Any], **columns: Any) -> FlightRow:
        """Returns the row of a ``report.json`` document; ``columns`` come first, what it lacks is not known."""
        return FlightRow(**(_of_report(report) | columns))


@cache
def _kinds() -> dict[str, Any]:
    """The type of each column, without None."""
    hints = get_type_hints(FlightRow)
    return {
        name: get_args(hint)[0] if isinstance(hint, UnionType) else hint
        for name, hint in hints.items()
    }


def _value(value: Any, kind: Any) -> Any:
    """The value as its column has it: NaN and infinity are not known, and text is what UTF-8 can hold."""
    if value is None:
        return None
    if get_origin(kind) is tuple:
        return tuple(_value(entry, get_args(kind)[0]) for entry in value)
    if kind is float:
        return float(value) if math.isfinite(value) else None
    if kind is int:
        return int(value)
    if kind is datetime:
        when = datetime.fromisoformat(value) if isinstance(value, str) else value
        return (when if when.tzinfo else when.replace(tzinfo=UTC)).astimezone(UTC)
    return as_text(str(value))


def as_text(name: str) -> str:
    """Returns a name as text that UTF-8 can hold, which the name of a file need not be."""
    return name.encode("utf-8", "backslashreplace").decode()


def row_schema() -> Any:
    """Returns the columns as a ``pyarrow.Schema``; versions are in its metadata, and each unit in that of a column."""
    import pyarrow

    plain = {
        str: pyarrow.string(),
        float: pyarrow.float64(),
        int: pyarrow.int64(),
        # UTC without saying so: DuckDB would show it in local time
        datetime: pyarrow.timestamp("us"),
    }

    def arrow(kind: Any) -> Any:
        return pyarrow.list_(arrow(get_args(kind)[0])) if get_origin(kind) is tuple else plain[kind]

    head = header("flights")
    units = {name: {"unit": unit} for name, unit in head["units"].items()}
    columns = [
        pyarrow.field(name, arrow(kind), metadata=units.get(name))
        for name, kind in _kinds().items()
    ]
    return pyarrow.schema(
        columns, {"mavdem_schema": str(SCHEMA_VERSION), "mavdem_version": head["mavdem_version"]}
    )


def _of_report(report: Mapping[str, Any]) -> dict[str, Any]:
    """The columns that a document of ``report.json`` has; nothing is known by an empty text or list."""

    def value_at(place: str) -> Any:
        value: Any = report
        for key in place.split("."):
            value = None if value is None else value.get(key)
        return value

    places = {
        column.name: column.metadata["place"] for column in fields(FlightRow) if column.metadata
    }
    columns = {
        name: value
        for name, place in places.items()
        if (value := value_at(place)) not in (None, "", [], ())
    }
    axis = value_at("verdict.axis") if not report.get("outputs") else report["outputs"][0]
    unit = value_at("condition.hover.unit")
    inputs = None if unit is None else MOTORS
    names = list(report.get("inputs") or ())
    cautions = value_at("verdict.cautions")
    if names or report.get("physical") is not None:  # a model
        by_demand = value_at("flight.scale.name") == DEMAND or (
            len(names) == 1 and names[0].endswith(f" {DEMAND}")
        )
        unit = value_at("flight.scale.unit")
        inputs = DEMAND if by_demand else MOTORS
        cautions = report.get("cautions")
        if not by_demand:
            columns = {"motors": names or None} | columns
    overrides = report.get("overrides") or ()
    known = {
        "axis": axis,
        "inputs": inputs,
        "input_unit": unit,
        "overrides": [one["kind"] for one in overrides],
    }
    if value_at("wind.reason") or value_at("physical.status.effect") in (None, "not identifiable"):
        # It is not resolved, or what it is computed with is not identifiable.
        columns = {
            name: value for name, value in columns.items() if not name.startswith("wind_torque")
        }
    known["warnings"] = (*(override["sentence"] for override in overrides), *(cautions or ()))
    return ({} if "tier" in report else {"tier": "a"}) | columns | known


Flight = Sequence[FlightRow]
"""The rows of one flight, an axis each."""


def flights_of(rows: Iterable[FlightRow]) -> list[list[FlightRow]]:
    """Returns the rows of each flight, its axes in order; flights by date, those without one last, then by file."""
    together: dict[tuple[object, ...], list[FlightRow]] = {}
    for row in rows:
        together.setdefault((row.key, row.file, row.vehicle, row.system, row.component), []).append(
            row
        )

    def when(flight: Flight) -> tuple[object, ...]:
        row = flight[0]
        stamp = math.inf if row.date is None else row.date.timestamp()
        return stamp, row.file, row.key, row.vehicle, row.system or 0, row.component or 0

    for flight in together.values():
        flight.sort(
            key=lambda row: (
                AXIS_ORDER.index(row.axis) if row.axis in AXIS_ORDER else len(AXIS_ORDER)
            )
        )
    return sorted(together.values(), key=when)


def vehicles_of(rows: Iterable[FlightRow]) -> dict[str, list[list[FlightRow]]]:
    """Returns the flights with figures of each vehicle, by its name in order, as :func:`flights_of` has them."""
    vehicles: dict[str, list[list[FlightRow]]] = {}
    for flight in flights_of(row for row in rows if row.status == OK):
        vehicles.setdefault(flight[0].vehicle, []).append(flight)
    return dict(sorted(vehicles.items()))


def is_shared(flights: Iterable[Flight]) -> bool:
    """Returns whether the name of these flights' vehicle is one that several vehicles may have."""
    return any(row.vehicle_basis == SHARED for flight in flights for row in flight)


def worst_health(flight: Flight) -> str:
    """Returns the worst that was found in a flight: "fault", "drift" or "ok"; "unknown" if nothing was."""
    return min((row.health for row in flight), key=HEALTHS.index)


def best_tier(flight: Flight) -> str:
    """Returns the best tier of a flight's axes: what the log allows; empty where none is known."""
    return min((row.tier for row in flight if row.tier), default="")


def flown_once(flights: Sequence[list[FlightRow]]) -> list[list[FlightRow]]:
    """Returns flights of one vehicle, in order of date, each once by its best tier: those at the same time are one."""
    once: list[list[FlightRow]] = []
    for flight in flights:
        last = once[-1][0] if once else None
        date = flight[0].date
        if (
            not last
            or not last.date
            or not date
            or (date - last.date).total_seconds() >= (last.duration or 0.0)
        ):
            once.append(flight)
        else:
            once[-1] = min(once[-1], flight, key=lambda flight: best_tier(flight) or "z")
    return once


def summary(rows: Iterable[FlightRow]) -> dict[str, Any]:
    """Returns counts of a fleet's flights as plain JSON values.

    A flight has a row for each axis, and counts by its better tier and its worse health; one that several logs have
    counts once. ``vehicles`` are those with a name of their own: a system id is none. ``failed`` has file and status
    of each log without a flight.
    """
    rows = list(rows)
    vehicles = vehicles_of(rows)
    named = {
        name for name, flights in vehicles.items() if name != UNKNOWN and not is_shared(flights)
    }
    flown = [
        flight
        for name in vehicles
        for flight in (flown_once if name in named else list)(vehicles[name])
    ]
    healths = Counter(map(worst_health, flown))
    failed = dict.fromkeys((row.file, row.status) for row in rows if row.status != OK)
    return {
        "flights": len(flown),
        "vehicles": len(named),
        "tiers": dict(
            sorted(Counter(tier for flight in flown if (tier := best_tier(flight))).items())
        ),
        "health": {health: healths[health] for health in HEALTHS if healths[health]},
        "failed": [{"file": file, "status": status} for file, status in failed],
    }
