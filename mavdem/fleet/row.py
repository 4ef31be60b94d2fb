"""FlightRow: what one log says of one vehicle and axis, and the schema of the table that such rows make."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from datetime import UTC, datetime
from functools import cache
from types import NoneType, UnionType
from typing import Any, get_args, get_origin, get_type_hints

SCHEMA_VERSION = 1
"""Changes with the columns or with what they mean: logs whose rows have another version are read again."""

UNKNOWN = "unknown"  # the vehicle of a log that does not say whose it is
OK = "ok"  # the status of a flight that was read

Numbers = tuple[float, ...]
Pairs = tuple[tuple[float, float], ...]


@dataclass(frozen=True, kw_only=True)
class FlightRow:
    """One settled flight of a log: one vehicle, one axis. SI units, angles rad; None where a value is not known.

    A log that holds no such flight, or cannot be read, has one row whose ``status`` says why. Tuples have an entry for
    each motor, in the order of ``motors``, unless their own line says otherwise. Intervals are half widths, 90 %.

    Attributes:
        file: path or URL of the log.
        key: hash of its content and its size, by which a log is known again; empty if it could not be read at all.
        vehicle: its name, by what the log says of its identity; "unknown" where it says nothing.
        vehicle_basis: what the name is made of: "board", "accelerometer", "compass", or "system id", which several
            vehicles may share.
        autopilot, frame, firmware: as the log has them.
        system, component: MAVLink ids.
        date: when the flight began, UTC; in the table without a zone.
        axis: "roll" or "pitch".
        tier: "a" everything, "b" the slow motion and conditions, "c" conditions only.
        tier_reason: why no better one.
        duration: of the settled flight, s.
        attitude_rate, motor_rate: Hz.
        voltage_start, voltage_end, voltage_mean: of the battery, V.
        collective: mean of all motors, as a share of their range: payload and thrust.
        lean_roll, lean_pitch: mean angles, rad.
        tilt_sd, tilt_max: of the angle from level, rad.
        vibration: x, y, z, m/s².
        clips: how often an accelerometer was at its limit.
        motors: their names.
        spins: +1 counter-clockwise seen from above, -1 clockwise, 0 not known.
        positions: forward and right, in arm lengths.
        trim: mean output, in ``trim_unit``.
        trim_share, trim_share_interval: the mean output as a share of the range, over its mean of all motors.
        headroom: what is left at the 99th percentile, as a share of the range.
        saturated: share of the time at full throttle.
        balance, balance_error: what is asked of the motors in roll, pitch and yaw, in shares of their mean command, and
            its standard error.
        balance_lean: mean roll and pitch meanwhile, rad.
        lean_effect, lean_effect_error: change of each by roll and by pitch, 1/rad, row after row, and its standard
            error.
        inputs, input_unit: what the model's inputs are, "motors" or, one for the axis, the controller's "demand", and
            their unit; without a model those of ``mean_inputs``.
        effect, effect_interval, effect_status: angular acceleration for one unit of each input, rad/s².
        damping, damping_interval, damping_status: 1/s.
        lag, lag_interval, lag_status: of the motors, s.
        wind_torque_sd, wind_torque_mean, wind_torque_interval: rad/s²; the interval is that of the mean.
        mean_inputs, mean_outputs: over the settled flight; an entry for each input and output of the model.
        residual_gain_inputs, residual_gain_outputs, residual_offset: the mean angular acceleration that this flight's
            frozen model leaves unexplained in another one, rad/s², is the sum of gains times that flight's means and
            the offset.
        error_ratio: squared forecast error over that of the constant mean, on parts held out.
        coverage: share of held-out samples inside the band of 90 %.
        residual_mean: what the models of the vehicle's healthy flights leave unexplained in this one, in the mean,
            rad/s².
        residual_mean_interval: how far from 0 that is in 90 % of healthy flights; no interval of this flight's figure.
        health: "ok", "drift", "fault" or "unknown".
        fault_probability: that a motor works 8 % harder or more, whichever it is, from 0 to 1.
        change_probability: that anything changed, from 0 to 1.
        suspect_motor: from 1; the number in the order of ``motors``.
        health_reason: what speaks for it, or what is missing.
        warnings: one sentence each.
        status: "ok", or why there is no flight.
        page: the flight's own page, relative to the folder of the fleet.
        mavdem_version: of the program that read the log.
    """

    file: str
    key: str = ""
    vehicle: str = UNKNOWN
    vehicle_basis: str | None = None
    autopilot: str | None = None
    frame: str | None = None
    firmware: str | None = None
    system: int | None = None
    component: int | None = None
    date: datetime | None = None
    axis: str | None = None
    tier: str | None = None
    tier_reason: str | None = None
    duration: float | None = None
    attitude_rate: float | None = None
    motor_rate: float | None = None
    voltage_start: float | None = None
    voltage_end: float | None = None
    voltage_mean: float | None = None
    collective: float | None = None
    lean_roll: float | None = None
    lean_pitch: float | None = None
    tilt_sd: float | None = None
    tilt_max: float | None = None
    vibration: Numbers | None = None
    clips: int | None = None
    motors: tuple[str, ...] | None = None
    spins: tuple[int, ...] | None = None
    positions: Pairs | None = None
    trim_unit: str | None = None
    trim: Numbers | None = None
    trim_share: Numbers | None = None
    trim_share_interval: Numbers | None = None
    headroom: Numbers | None = None
    saturated: Numbers | None = None
    balance: Numbers | None = None
    balance_error: Numbers | None = None
    balance_lean: Numbers | None = None
    lean_effect: Numbers | None = None
    lean_effect_error: Numbers | None = None
    inputs: str | None = None
    input_unit: str | None = None
    effect: Numbers | None = None
    effect_interval: Numbers | None = None
    effect_status: str | None = None
    damping: float | None = None
    damping_interval: float | None = None
    damping_status: str | None = None
    lag: float | None = None
    lag_interval: float | None = None
    lag_status: str | None = None
    wind_torque_sd: float | None = None
    wind_torque_mean: float | None = None
    wind_torque_interval: float | None = None
    mean_inputs: Numbers | None = None
    mean_outputs: Numbers | None = None
    residual_gain_inputs: Numbers | None = None
    residual_gain_outputs: Numbers | None = None
    residual_offset: float | None = None
    error_ratio: float | None = None
    coverage: float | None = None
    residual_mean: float | None = None
    residual_mean_interval: float | None = None
    health: str = UNKNOWN
    fault_probability: float | None = None
    change_probability: float | None = None
    suspect_motor: int | None = None
    health_reason: str | None = None
    warnings: tuple[str, ...] = ()
    status: str = OK
    page: str | None = None
    mavdem_version: str = ""

    def __post_init__(self) -> None:
        """Brings every value to its column's type, which makes rows equal that say the same."""
        for name, kind in _kinds().items():
            object.__setattr__(self, name, _value(getattr(self, name), kind))

    @property
    def order(self) -> tuple[str, str, str, int, int, str]:
        """By which rows are sorted: nothing that depends on when they were made."""
        return self.vehicle, self.file, self.key, self.system or 0, self.component or 0, self.axis or ""

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON values; the date as ISO 8601."""
        values = asdict(self)
        if self.date is not None:
            values["date"] = self.date.isoformat()
        return values

    def to_json(self) -> str:
        """One line."""
        return json.dumps(self.as_dict(), allow_nan=False)

    @staticmethod
    def from_dict(values: Mapping[str, Any]) -> FlightRow:
        """The row of :meth:`as_dict`, or of a line of the table; raises ``TypeError`` for other columns."""
        return FlightRow(**values)


@cache
def _kinds() -> dict[str, Any]:
    """The type of each column, without None."""
    hints = get_type_hints(FlightRow)
    return {field.name: _without_none(hints[field.name]) for field in fields(FlightRow)}


def _without_none(hint: Any) -> Any:
    if isinstance(hint, UnionType):
        (hint,) = (one for one in get_args(hint) if one is not NoneType)
    return hint


def _value(value: Any, kind: Any) -> Any:
    """The value as its column has it: NaN and infinity are not known, and text is what UTF-8 can hold."""
    if value is None:
        return None
    if get_origin(kind) is tuple:
        inner = get_args(kind)
        kinds = [inner[0]] * len(value) if inner[-1] is Ellipsis else inner
        return tuple(_value(one, each) for one, each in zip(value, kinds, strict=True))
    if kind is float:
        return float(value) if math.isfinite(value) else None
    if kind is int:
        return int(value)
    if kind is datetime:
        when = datetime.fromisoformat(value) if isinstance(value, str) else value
        return (when if when.tzinfo else when.replace(tzinfo=UTC)).astimezone(UTC)
    return as_text(str(value))


def as_text(name: str) -> str:
    """A name as text that UTF-8 can hold, which the name of a file need not be."""
    return name.encode("utf-8", "backslashreplace").decode()


def row_schema() -> Any:
    """The columns as a ``pyarrow.Schema``, with the version in its metadata."""
    import pyarrow

    plain = {
        str: pyarrow.string(),
        float: pyarrow.float64(),
        int: pyarrow.int64(),
        datetime: pyarrow.timestamp("us"),  # UTC without saying so: DuckDB would show it in local time
    }

    def arrow(kind: Any) -> Any:
        return pyarrow.list_(arrow(get_args(kind)[0])) if get_origin(kind) is tuple else plain[kind]

    columns = [pyarrow.field(name, arrow(kind)) for name, kind in _kinds().items()]
    return pyarrow.schema(columns, metadata={"mavdem_schema": str(SCHEMA_VERSION)})
