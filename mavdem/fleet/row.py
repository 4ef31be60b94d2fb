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
from typing import Annotated, Any, get_args, get_origin, get_type_hints

from mavdem.containers import JsonValues, Names, Numbers, group_by
from mavdem.dataset.axes import AXES
from mavdem.dataset.motor_outputs import INPUT_KINDS
from mavdem.document_heading import document_heading
from mavdem.facts import Fact, Level
from mavdem.facts.identifiability import Status
from mavdem.facts.motors import MotorHealth
from mavdem.units import (
    AngularAcceleration,
    ArmLengths,
    Decibels,
    DragCoefficient,
    EffectPerInput,
    Hertz,
    InputInStatedUnit,
    Number,
    PerRadian,
    PerSecond,
    Radians,
    Seconds,
    Speed,
    TrimInStatedUnit,
    UtcTime,
    Volts,
    field_units,
    with_unit,
)

SCHEMA_VERSION = 8
"""Changes with the columns or with what they mean: logs whose rows have another version are read again."""

# the vehicle of a log that does not say whose it is, and health that is not known
UNKNOWN = "unknown"
READ = "ok"  # the status of a flight that was read
SHARED = "system id"  # the basis of a name that several vehicles may have
HEALTHS = tuple(MotorHealth)  # the worst first
NOT_IDENTIFIABLE = Status.NOT_IDENTIFIABLE  # the status of what a flight says nothing of
AXIS_ORDER = (*AXES, "")
MOTORS, DEMAND = INPUT_KINDS

Many = Numbers | None
Text = str | None
Whole = int | None
"""Columns whose value need not be known."""


def at(path: str, default: str | None = None) -> Any:
    """Returns a column that is at this place of a document of ``report.json``."""
    return field(default=default, metadata={"place": path})


@dataclass(frozen=True, kw_only=True)
class FlightRow:
    """One settled flight of a log: one vehicle, one axis. SI units, angles rad; None where a value is not known.

    A log that holds no such flight, or cannot be read, has one row whose ``status`` says why. Tuples have an entry for
    each motor, in the order of ``motors``, unless its docstring says otherwise. Intervals are half widths, 90 %.
    """

    file: str
    """path or URL of the log"""
    key: str = ""
    """hash of its content and its size"""
    vehicle: str = at("identity.name", UNKNOWN)
    """name of the vehicle, or unknown"""
    vehicle_basis: Text = at("identity.basis")
    """what the name is made of: board, accelerometer, compass or system id"""
    autopilot: Text = at("identity.autopilot")
    """MAV_AUTOPILOT"""
    frame: Text = at("identity.frame")
    """MAV_TYPE"""
    firmware: Text = at("identity.firmware")
    """version of the firmware, as logged"""
    system: Whole = at("identity.system")
    """MAVLink id"""
    component: Whole = None
    """MAVLink id"""
    date: UtcTime | None = at("identity.date")
    """when the flight began"""
    axis: Text = None
    """roll or pitch"""
    tier: Text = at("tier")
    """a (full model), b (slow motion) or c (condition only)"""
    tier_reason: Text = at("reason")
    """why the tier is no better"""
    duration: Seconds = at("condition.settled")
    """duration of settled flight"""
    attitude_rate: Hertz = at("verdict.figures.attitude_rate")
    """rate of the attitude's messages"""
    voltage_start: Volts = at("condition.battery.voltage_start")
    """voltage at the start, median of 2 s"""
    voltage_end: Volts = at("condition.battery.voltage_end")
    """voltage at the end, median of 2 s"""
    voltage_mean: Volts = at("condition.battery.voltage_mean")
    """mean voltage"""
    collective: Number = at("condition.collective")
    """mean output of all motors, as a share of their range"""
    lean_roll: Radians = at("condition.lean.roll.mean")
    """mean roll"""
    lean_pitch: Radians = at("condition.lean.pitch.mean")
    """mean pitch"""
    tilt_sd: Radians = at("condition.tilt_sd")
    """standard deviation of the angle from level"""
    tilt_max: Radians = at("condition.tilt_max")
    """largest angle from level"""
    vibration: Annotated[Numbers, with_unit("m/s²")] | None = at("condition.vibration.level")
    """mean vibration of the first IMU, x, y and z or one level"""
    clips: Whole = at("condition.vibration.clips")
    """times that an accelerometer was out of range"""
    motors: Names | None = at("condition.hover.motors")
    """names of the motors; lists that have an entry a motor are in this order"""
    spins: tuple[int, ...] | None = None
    """+1 counter-clockwise seen from above, −1 clockwise, 0 not known"""
    positions: tuple[tuple[ArmLengths, ArmLengths], ...] | None = None
    """forward and right of each motor"""
    trim_unit: Text = at("condition.hover.unit")
    """unit of trim"""
    trim: tuple[TrimInStatedUnit, ...] | None = at("condition.hover.trim")
    """mean output"""
    trim_share: Many = at("condition.hover.trim_share")
    """trim as a share of the range, over the mean of all motors"""
    trim_share_interval: Many = at("condition.share_interval")
    """half widths of the 90 % intervals of trim_share"""
    headroom: Many = at("condition.hover.headroom")
    """share of the range that is left at the 99th percentile of the output"""
    saturated: Many = at("condition.hover.at_upper_limit")
    """share of the time at the upper stop"""
    oscillation: Seconds = at("condition.oscillation.seconds")
    """duration of oscillation by its own controller"""
    balance: Many = None
    """what is asked of the motors in roll, pitch and yaw, as shares of their mean command"""
    balance_error: Many = None
    """standard error of balance"""
    balance_lean: Annotated[Numbers, with_unit("rad")] | None = None
    """mean roll and pitch while balance was measured"""
    lean_effect: tuple[PerRadian, ...] | None = None
    """change of balance by roll and by pitch, row after row"""
    lean_effect_error: tuple[PerRadian, ...] | None = None
    """standard error of lean_effect"""
    inputs: Text = None
    """inputs of the model: motors or demand"""
    input_unit: Text = None
    """unit of the inputs"""
    effect: tuple[EffectPerInput, ...] | None = at("physical.effect")
    """control effectiveness of each input"""
    effect_interval: tuple[EffectPerInput, ...] | None = at("physical.interval_90_percent.effect")
    """half widths of the 90 % intervals of effect"""
    effect_status: Text = at("physical.status.effect")
    """status of effect: reported, biased or not identifiable"""
    damping: PerSecond = at("physical.damping")
    """rate damping"""
    damping_interval: PerSecond = at("physical.interval_90_percent.damping")
    """half width of the 90 % interval of damping"""
    damping_status: Text = at("physical.status.damping")
    """status of damping: reported, biased or not identifiable"""
    lag: Seconds = at("physical.lag")
    """motor time constant"""
    lag_interval: Seconds = at("physical.interval_90_percent.lag")
    """half width of the 90 % interval of lag"""
    lag_status: Text = at("physical.status.lag")
    """status of lag: reported, biased or not identifiable"""
    phase_margin: Radians = None
    """phase margin of the axis's rate loop"""
    phase_margin_interval: Radians = None
    """half width of the 90 % interval of phase_margin"""
    gain_margin: Decibels = None
    """gain margin of the axis's rate loop"""
    gain_margin_interval: Decibels = None
    """half width of the 90 % interval of gain_margin"""
    wind_torque_sd: AngularAcceleration = at("wind.sd")
    """standard deviation of the wind torque"""
    wind_torque_mean: AngularAcceleration = at("wind.mean")
    """steady part of the wind torque"""
    wind_torque_interval: AngularAcceleration = at("wind.mean_band")
    """half width of the 90 % interval of wind_torque_mean"""
    wind_speed: Speed = None
    """speed of the mean wind; null where the air may have been still"""
    wind_speed_interval: Annotated[Numbers, with_unit("m/s")] | None = None
    """ends of the 90 % interval of wind_speed"""
    wind_direction: Radians = None
    """where the wind comes from, clockwise from north"""
    wind_direction_interval: Radians = None
    """half width of the 90 % interval of wind_direction"""
    drag: tuple[DragCoefficient, ...] | None = None
    """linear drag along body x and y, then quadratic"""
    drag_interval: tuple[DragCoefficient, ...] | None = None
    """half widths of the 90 % intervals of drag"""
    mean_inputs: tuple[InputInStatedUnit, ...] | None = at("condition.hover.trim")
    """mean of each input over the flight"""
    mean_outputs: Annotated[Numbers, with_unit("rad, rad/s")] | None = None
    """mean of each output over the flight"""
    headline: Text = at("headline")
    """the worst that was found, or how the flight was lost, one sentence"""
    headline_level: Text = at("headline_fact.level")
    """good, watch, bad or unknown"""
    light_motors: Text = at("lights.motors.level")
    """good, watch, bad or unknown"""
    light_vibration: Text = at("lights.vibration.level")
    """good, watch, bad or unknown"""
    light_tracking: Text = at("lights.tracking.level")
    """good, watch, bad or unknown"""
    light_margins: Text = at("lights.margins.level")
    """good, watch, bad or unknown"""
    light_power: Text = at("lights.power.level")
    """good, watch, bad or unknown"""
    light_estimator: Text = at("lights.estimator.level")
    """good, watch, bad or unknown"""
    light_wind: Text = at("lights.wind.level")
    """good, watch, bad or unknown"""
    light_log: Text = at("lights.log.level")
    """good, watch, bad or unknown"""
    overrides: Names = ()
    """what makes the flight itself doubtful: oscillation, motors, saturation, trim or data"""
    error_ratio: Number = at("forecast_over_constant_mean")
    """error ratio (NMSE) of forecasts in held-out windows"""
    coverage: Number = at("inside_90_percent_band")
    """share of held-out samples in the 90 % band"""
    residual_mean: AngularAcceleration = None
    """mean acceleration that models of its healthy flights leave unexplained in this one"""
    health: str = UNKNOWN
    """ok, drift, fault or unknown"""
    fault_probability: Number = None
    """probability that a motor works 8 % harder or more"""
    change_probability: Number = None
    """probability that anything changed"""
    suspect_motor: Whole = None
    """number of the motor that is suspected, from 1, in the order of motors"""
    health_reason: Text = None
    """what speaks for the health, or what is missing to judge it"""
    health_code: Text = None
    """the same as a code"""
    warnings: Names = ()
    """what must be known before its figures are used, one sentence each"""
    warning_codes: Names = ()
    """the same as codes"""
    status: str = READ
    """ok, or why there is no flight"""
    status_code: Text = None
    """why there is no flight, as a code"""
    page: Text = None
    """page of the flight, relative to the folder of the fleet"""
    mavdem_version: str = ""
    """version of the program that read the log"""

    def __post_init__(self) -> None:
        """Brings every value to its column's type, which makes rows equal that say the same.

        What is not identifiable has no value, in rows of earlier versions either.
        """
        for name, kind in _kinds().items():
            status = getattr(self, f"{name.removesuffix('_interval')}_status", None)
            value = None if status == NOT_IDENTIFIABLE else _value(getattr(self, name), kind)
            object.__setattr__(self, name, value)

    @property
    def is_read(self) -> bool:
        """Whether it has figures of a flight, not why there are none."""
        return self.status == READ

    @property
    def has_flight(self) -> bool:
        """Whether it is of a flight: one with figures, or one whose assessment is bad without any."""
        return self.is_read or self.headline_level == Level.BAD

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

    def as_dict(self) -> JsonValues:
        """Returns plain JSON values; the date as ISO 8601."""
        values = asdict(self)
        if self.date is not None:
            values["date"] = self.date.isoformat()
        return values

    @staticmethod
    def without_flight(file: str, status: Fact, **columns: Any) -> FlightRow:
        """Returns the row of a log that holds no flight, for the reason ``status``."""
        return FlightRow(file=file, status=str(status), status_code=status.code, **columns)

    @staticmethod
    def of(report: Mapping[str, Any], **columns: Any) -> FlightRow:
        """Returns the row of a ``report.json`` document; ``columns`` come first, what it lacks is not known."""
        return FlightRow(**(_of_report(report) | columns))


FlightRows = list[FlightRow]


@cache
def _kinds() -> JsonValues:
    """The type of each column, without None."""
    hints = get_type_hints(FlightRow)
    return {
        name: get_args(hint)[0] if type(None) in get_args(hint) else hint
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

    units = {name: {"unit": unit} for name, unit in field_units(FlightRow).items()}
    head = document_heading("flights", SCHEMA_VERSION, {})
    columns = [
        pyarrow.field(name, arrow(kind), metadata=units.get(name))
        for name, kind in _kinds().items()
    ]
    return pyarrow.schema(
        columns, {"mavdem_schema": str(SCHEMA_VERSION), "mavdem_version": head["mavdem_version"]}
    )


def _of_report(report: Mapping[str, Any]) -> JsonValues:
    """The columns that a document of ``report.json`` has; nothing is known by an empty text or list."""
    places = {
        column.name: column.metadata["place"] for column in fields(FlightRow) if column.metadata
    }
    columns = {
        name: value
        for name, path in places.items()
        if (value := value_at(report, path)) not in (None, "", [], ())
    }
    if value_at(report, "wind.reason") or columns.get("effect_status") in (None, NOT_IDENTIFIABLE):
        # It is not resolved, or what it is computed with is not identifiable.
        columns = {
            name: value for name, value in columns.items() if not name.startswith("wind_torque")
        }
    cautions = value_at(report, "verdict.cautions")
    unit = columns.get("trim_unit")
    inputs = None if unit is None else MOTORS
    if "flight" in report:  # a model
        cautions = report["cautions"]
        unit = value_at(report, "flight.scale.unit")
        inputs = MOTORS
        if value_at(report, "flight.scale.name") == DEMAND:
            inputs = DEMAND
        else:
            columns = {"motors": report["inputs"]} | columns
    overrides = report.get("overrides", ())
    warnings = [*overrides, *(cautions or ())]
    figures = {
        "inputs": inputs,
        "input_unit": unit,
        "overrides": [override.code for override in overrides],
        "warnings": warnings,
        "warning_codes": [fact.code for fact in warnings],
    }
    return columns | figures


def value_at(report: Mapping[str, Any], path: str) -> Any:
    """Returns what a document, also of records, has at a place; None of what is not known."""
    value: Any = report
    for key in path.split("."):
        value = value.get(key) if isinstance(value, Mapping) else getattr(value, key, None)
    return value.tolist() if hasattr(value, "tolist") else value


Flight = Sequence[FlightRow]
"""The rows of one flight, an axis each."""


def flights_of(rows: Iterable[FlightRow]) -> list[FlightRows]:
    """Returns the rows of each flight, its axes in order; flights by date, those without one last, then by vehicle."""
    together = group_by(rows, lambda row: row.order[:-1])

    def when(flight: Flight) -> tuple[object, ...]:
        row = flight[0]
        return math.inf if row.date is None else row.date.timestamp(), row.order

    for flight in together.values():
        flight.sort(key=lambda row: AXIS_ORDER.index(row.axis or ""))
    return sorted(together.values(), key=when)


def vehicles_of(rows: Iterable[FlightRow]) -> dict[str, list[FlightRows]]:
    """Returns the flights of each vehicle, by its name in order, as :func:`flights_of` has them."""
    flights = flights_of(row for row in rows if row.has_flight)
    return dict(sorted(group_by(flights, lambda flight: flight[0].vehicle).items()))


def is_shared(flights: Iterable[Flight]) -> bool:
    """Returns whether the name of these flights' vehicle is one that several vehicles may have."""
    return any(row.vehicle_basis == SHARED for flight in flights for row in flight)


def worst_health(flight: Flight) -> str:
    """Returns the worst that was found in a flight: "fault", "drift" or "ok"; "unknown" if nothing was."""
    return worst_row(flight).health


def worst_row(flight: Flight) -> FlightRow:
    """Returns the row of the axis whose health is worst, the first of equal ones."""
    return min(flight, key=lambda row: HEALTHS.index(row.health))


def best_tier(flight: Flight) -> str:
    """Returns the best tier of a flight's axes: what the log allows; empty where none is known."""
    return min((row.tier for row in flight if row.tier), default="")


def flown_once(flights: Sequence[FlightRows]) -> list[FlightRows]:
    """Returns flights of one vehicle, in order of date, each once by its best tier: those at the same time are one."""
    once: list[FlightRows] = []
    for flight in flights:
        same = [flight]
        if once and (last := once[-1][0]).date and flight[0].date:
            seconds = (flight[0].date - last.date).total_seconds()
            if seconds < (last.duration or 0.0):
                same.append(once.pop())
        once.append(min(reversed(same), key=lambda flight: best_tier(flight) or "z"))
    return once


def summary(rows: Iterable[FlightRow]) -> JsonValues:
    """Returns counts of a fleet's flights as plain JSON values.

    A flight has a row for each axis, and counts by its better tier and its worse health; one that several logs have
    counts once. ``vehicles`` are those with a name of their own: a system id is none. ``failed`` has file, status and
    its code of each log without a flight.
    """
    rows = list(rows)
    named = 0
    flown = []
    for name, flights in vehicles_of(rows).items():
        is_named = name != UNKNOWN and not is_shared(flights)
        named += is_named
        flown += flown_once(flights) if is_named else flights
    healths = Counter(map(worst_health, flown))
    tiers = Counter(filter(None, map(best_tier, flown)))
    failed = dict.fromkeys(
        (row.file, row.status, row.status_code) for row in rows if not row.has_flight
    )
    return {
        "flights": len(flown),
        "vehicles": named,
        "tiers": dict(sorted(tiers.items())),
        "health": {health: healths[health] for health in HEALTHS if healths[health]},
        "failed": [
            {"file": file, "status": status, "status_code": code} for file, status, code in failed
        ],
    }
