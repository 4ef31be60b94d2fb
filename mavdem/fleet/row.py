"""Row of a fleet's table, which has many logs as one data set: the figures of one flight, vehicle and axis.

A row is made from the document ``report.json`` of a log, and is stored, compared and shown.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass, fields
from datetime import UTC, datetime, timedelta
from functools import cache, cached_property
from typing import Annotated, Any, NamedTuple, get_args, get_origin, get_type_hints

from mavdem.containers import JsonValues, Names, Numbers
from mavdem.facts import Fact, Level
from mavdem.fleet.report_columns import DEMAND, NOT_IDENTIFIABLE, columns_of_report, report_column
from mavdem.units import (
    AngularAcceleration,
    ArmLengths,
    Decibels,
    DragCoefficient,
    EffectPerInput,
    Hertz,
    InputInStatedUnit,
    Metres,
    Number,
    PerRadian,
    PerSecond,
    Radians,
    Seconds,
    Speed,
    TrimInStatedUnit,
    UtcTime,
    Volts,
    with_unit,
)

SCHEMA_VERSION = 20
"""Version of the columns and of what they mean: logs whose rows have another version are read again."""

UNKNOWN = "unknown"
"""Name of a vehicle whose log does not identify it, and the health of motors that is not known."""

STATUS_READ = "ok"
"""Status of a row with the figures of a flight."""

SYSTEM_ID_BASIS = "system id"
"""Basis of a vehicle's name that several vehicles may have: every autopilot has the system id 1 by default."""

GIVEN_BASIS = "given"
"""Basis of a vehicle's name that a user assigned to a flight whose log has only a system id."""

MAX_CLOCK_LEAD = timedelta(days=1)
"""How far the date of a flight may be ahead of this computer's clock: two time zones differ by about a day at most."""

PHYSICAL_COLUMNS = ("effect", "damping", "lag")
"""Columns of physical parameters, each of which has a status and an interval in further columns."""

OptionalNumbers = Numbers | None
OptionalText = str | None
OptionalInteger = int | None


class RowOrder(NamedTuple):
    """Position of a row in the table of a fleet, from the most to the least significant part."""

    vehicle: str
    file: str
    """Path or URL of the log."""
    key: str
    """Key of the log's content."""
    system: int
    """MAVLink system id of the vehicle."""
    component: int
    axis: str
    """Axis of the row, in which alone the rows of a flight differ."""

    @property
    def without_axis(self) -> tuple[Any, ...]:
        """All parts but the axis: the rows of one flight, and of no other, have them in common."""
        return self[:-1]


@dataclass(frozen=True, kw_only=True)
class FlightRow:
    """One settled flight of a log: one vehicle, one axis. SI units, angles rad; None if a value is not known.

    A log that holds no such flight, or cannot be read, has one row whose ``status`` says why. Tuples have an entry for
    each motor, in the order of ``motors``, unless its docstring says otherwise. Intervals are half widths, 90 %.
    """

    file: str
    """path or URL of the log"""
    key: str = ""
    """hash of its content and its size"""
    vehicle: str = report_column("identity.name", UNKNOWN)
    """name of the vehicle, or unknown"""
    vehicle_basis: OptionalText = report_column("identity.basis")
    """what the name is made of: board, accelerometer, compass, system id, or given by a user"""
    autopilot: OptionalText = report_column("identity.autopilot")
    """MAV_AUTOPILOT"""
    frame: OptionalText = report_column("identity.frame")
    """MAV_TYPE"""
    firmware: OptionalText = report_column("identity.firmware")
    """version of the firmware, as logged"""
    system: OptionalInteger = report_column("identity.system")
    """MAVLink id"""
    component: OptionalInteger = None
    """MAVLink id"""
    date: UtcTime | None = report_column("identity.date")
    """when the flight began"""
    simulated: OptionalInteger = None
    """1 if the log shows that the flight was simulated, otherwise 0"""
    flight_count: OptionalInteger = None
    """number of flights in the log"""
    flight_time: Seconds = None
    """time off the ground, all flights and hops of the log together"""
    distance: Metres = None
    """length of the path over ground, all flights of the log together"""
    height: Metres = None
    """largest height above the take-off"""
    modes: Names | None = None
    """flight modes in order of their first use"""
    control_parameters: OptionalText = None
    """JSON object of the autopilot's control parameters: value by name"""
    axis: OptionalText = None
    """roll or pitch"""
    tier: OptionalText = report_column("tier")
    """a (full model), b (slow motion) or c (condition only)"""
    tier_reason: OptionalText = report_column("reason")
    """why the tier is no better"""
    duration: Seconds = report_column("condition.settled")
    """duration of settled flight"""
    attitude_rate: Hertz = report_column("verdict.figures.attitude_rate")
    """rate of the attitude's messages"""
    voltage_start: Volts = report_column("condition.battery.voltage_start")
    """voltage at the start, median of 2 s"""
    voltage_end: Volts = report_column("condition.battery.voltage_end")
    """voltage at the end, median of 2 s"""
    voltage_mean: Volts = report_column("condition.battery.voltage_mean")
    """mean voltage"""
    collective: Number = report_column("condition.collective")
    """mean output of all motors, as a share of their range"""
    lean_roll: Radians = report_column("condition.lean.roll.mean")
    """mean roll"""
    lean_pitch: Radians = report_column("condition.lean.pitch.mean")
    """mean pitch"""
    tilt_sd: Radians = report_column("condition.tilt_sd")
    """standard deviation of the angle from level"""
    tilt_max: Radians = report_column("condition.tilt_max")
    """largest angle from level"""
    vibration: Annotated[Numbers, with_unit("m/s²")] | None = report_column(
        "condition.vibration.level"
    )
    """mean vibration of the first IMU, x, y and z or one level"""
    vibration_imus: Annotated[Numbers, with_unit("m/s²")] | None = None
    """mean vibration of each IMU along the axis that vibrates most"""
    clips: OptionalInteger = report_column("condition.vibration.clips")
    """times that an accelerometer was out of range"""
    motors: Names | None = report_column("condition.hover.motors")
    """names of the motors; lists that have an entry a motor are in this order"""
    spins: tuple[int, ...] | None = None
    """+1 counter-clockwise seen from above, −1 clockwise, 0 not known"""
    positions: tuple[tuple[ArmLengths, ArmLengths], ...] | None = None
    """forward and right of each motor"""
    trim_unit: OptionalText = report_column("condition.hover.unit")
    """unit of trim"""
    trim: tuple[TrimInStatedUnit, ...] | None = report_column("condition.hover.trim")
    """mean output"""
    trim_share: OptionalNumbers = report_column("condition.hover.trim_share")
    """trim as a share of the range, over the mean of all motors"""
    trim_share_interval: OptionalNumbers = report_column("condition.share_interval")
    """half widths of the 90 % intervals of trim_share"""
    headroom: OptionalNumbers = report_column("condition.hover.headroom")
    """share of the range that is left at the 99th percentile of the output"""
    saturated: OptionalNumbers = report_column("condition.hover.at_upper_limit")
    """share of the time at the upper stop"""
    oscillation: Seconds = report_column("condition.oscillation.seconds")
    """duration of oscillation by its own controller"""
    balance: OptionalNumbers = None
    """what is asked of the motors in roll, pitch and yaw, as shares of their mean command"""
    balance_error: OptionalNumbers = None
    """standard error of balance"""
    balance_lean: Annotated[Numbers, with_unit("rad")] | None = None
    """mean roll and pitch while balance was measured"""
    lean_effect: tuple[PerRadian, ...] | None = None
    """change of balance by roll and by pitch, row after row"""
    lean_effect_error: tuple[PerRadian, ...] | None = None
    """standard error of lean_effect"""
    inputs: OptionalText = None
    """inputs of the model: motors or demand"""
    input_unit: OptionalText = None
    """unit of the inputs"""
    effect: tuple[EffectPerInput, ...] | None = report_column("physical.effect")
    """control effectiveness of each input"""
    effect_interval: tuple[EffectPerInput, ...] | None = report_column(
        "physical.interval_90_percent.effect"
    )
    """half widths of the 90 % intervals of effect"""
    effect_status: OptionalText = report_column("physical.status.effect")
    """status of effect: reported, biased or not identifiable"""
    damping: PerSecond = report_column("physical.damping")
    """rate damping"""
    damping_interval: PerSecond = report_column("physical.interval_90_percent.damping")
    """half width of the 90 % interval of damping"""
    damping_status: OptionalText = report_column("physical.status.damping")
    """status of damping: reported, biased or not identifiable"""
    lag: Seconds = report_column("physical.lag")
    """motor time constant"""
    lag_interval: Seconds = report_column("physical.interval_90_percent.lag")
    """half width of the 90 % interval of lag"""
    lag_status: OptionalText = report_column("physical.status.lag")
    """status of lag: reported, biased or not identifiable"""
    phase_margin: Radians = None
    """phase margin of the axis's rate loop"""
    phase_margin_interval: Radians = None
    """half width of the 90 % interval of phase_margin"""
    gain_margin: Decibels = None
    """gain margin of the axis's rate loop"""
    gain_margin_interval: Decibels = None
    """half width of the 90 % interval of gain_margin"""
    ms: Number = None
    """maximum sensitivity of the axis's rate loop"""
    ms_interval: Number = None
    """half width of the 90 % interval of ms"""
    attitude_phase_margin: Radians = None
    """phase margin of the axis's attitude loop"""
    attitude_phase_margin_interval: Radians = None
    """half width of the 90 % interval of attitude_phase_margin"""
    attitude_gain_margin: Decibels = None
    """gain margin of the axis's attitude loop"""
    attitude_gain_margin_interval: Decibels = None
    """half width of the 90 % interval of attitude_gain_margin"""
    rate_overshoot: Number = None
    """overshoot of the axis's measured rate after a step of its setpoint, as a fraction of the step"""
    rate_overshoot_interval: Number = None
    """half width of the 90 % interval of rate_overshoot"""
    rate_rise: Seconds = None
    """time of the axis's measured rate from 10 to 90 % of a step of its setpoint"""
    rate_rise_interval: Seconds = None
    """half width of the 90 % interval of rate_rise"""
    rate_step_source: OptionalText = None
    """where rate_overshoot and rate_rise come from: measured, or identified_loop where messages are too slow"""
    loop_verdict: OptionalText = None
    """what is wrong with the axis's loops: nothing_wrong, oscillates, below_goal, follows_badly or unknown"""
    loop_action: OptionalText = None
    """what to do about the axis's loops, one or two sentences; null if nothing is to be done"""
    wind_torque_sd: AngularAcceleration = report_column("wind.sd")
    """standard deviation of the wind torque"""
    wind_torque_mean: AngularAcceleration = report_column("wind.mean")
    """steady part of the wind torque"""
    wind_torque_interval: AngularAcceleration = report_column("wind.mean_band")
    """half width of the 90 % interval of wind_torque_mean"""
    wind_speed: Speed = None
    """mean of the wind speeds; null where the air may have been still"""
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
    mean_inputs: tuple[InputInStatedUnit, ...] | None = report_column("condition.hover.trim")
    """mean of each input over the flight"""
    mean_outputs: Annotated[Numbers, with_unit("rad, rad/s")] | None = None
    """mean of each output over the flight"""
    headline: OptionalText = report_column("headline")
    """the worst that was found, or how the flight was lost, one sentence"""
    headline_level: OptionalText = report_column("headline_fact.level")
    """good, watch, bad or unknown"""
    headline_rank: OptionalInteger = None
    """order among headlines of one level: 0 the vehicle was lost, 1 another event, 2 or more what its parts show"""
    next_step: OptionalText = report_column("next_step")
    """what to do next by this log alone, one sentence"""
    light_motors: OptionalText = report_column("lights.motors.level")
    """good, watch, bad or unknown"""
    light_vibration: OptionalText = report_column("lights.vibration.level")
    """good, watch, bad or unknown"""
    light_tracking: OptionalText = report_column("lights.tracking.level")
    """good, watch, bad or unknown"""
    light_margins: OptionalText = report_column("lights.margins.level")
    """good, watch, bad or unknown"""
    light_power: OptionalText = report_column("lights.power.level")
    """good, watch, bad or unknown"""
    light_estimator: OptionalText = report_column("lights.estimator.level")
    """good, watch, bad or unknown"""
    light_wind: OptionalText = report_column("lights.wind.level")
    """good, watch, bad or unknown"""
    light_log: OptionalText = report_column("lights.log.level")
    """good, watch, bad or unknown"""
    failed_motor: OptionalInteger = None
    """number of the motor that the log by itself blames, from 1, if its motors' light is bad"""
    watched_motor: OptionalInteger = None
    """number of the motor that the log by itself warns of, from 1, if its motors' light is watch"""
    overrides: Names = ()
    """what makes the flight itself doubtful: oscillation, motors, saturation, trim or data"""
    error_ratio: Number = report_column("forecast_over_constant_mean")
    """error ratio (NMSE) of forecasts in held-out windows"""
    coverage: Number = report_column("inside_90_percent_band")
    """share of held-out samples in the 90 % band"""
    residual_mean: AngularAcceleration = None
    """mean acceleration that models of its healthy flights leave unexplained in this one"""
    health: str = UNKNOWN
    """ok, drift, fault or unknown"""
    fault_probability: Number = None
    """probability that a motor works 8 % harder or more"""
    change_probability: Number = None
    """probability that anything changed"""
    suspect_motor: OptionalInteger = None
    """number of the motor that is suspected, from 1, in the order of motors"""
    health_reason: OptionalText = None
    """what speaks for the health, or what is missing to judge it"""
    health_code: OptionalText = None
    """the same as a code"""
    health_figures: OptionalText = None
    """JSON object of the figures that health_reason states: value by name"""
    reference: OptionalInteger = None
    """1 if it is one of the healthy flights with which others of its vehicle are compared, otherwise 0"""
    warnings: Names = ()
    """what must be known before its figures are used, one sentence each"""
    warning_codes: Names = ()
    """the same as codes"""
    status: str = STATUS_READ
    """ok, or why there is no flight"""
    status_code: OptionalText = None
    """why there is no flight, as a code"""
    page: OptionalText = None
    """page of the flight, relative to the folder of the fleet"""
    mavdem_version: str = ""
    """version of the program that read the log"""

    def __post_init__(self) -> None:
        """Converts every value to the type of its column, so that rows with the same content are equal.

        A parameter whose status is "not identifiable" loses its value and interval, since rows of earlier versions of
        mavdem have them.
        """
        for name, column_type in column_types().items():
            # Only physical parameters have a status: "damping_status" is for "damping" and "damping_interval".
            status = getattr(self, f"{name.removesuffix('_interval')}_status", None)
            value = None
            if status != NOT_IDENTIFIABLE:
                value = column_value(getattr(self, name), column_type)
            object.__setattr__(self, name, value)

    @property
    def is_read(self) -> bool:
        """Whether the row has the figures of a flight."""
        return self.status == STATUS_READ

    @property
    def has_own_name(self) -> bool:
        """Whether the name belongs to a single vehicle, whose flights can be compared with each other."""
        return self.vehicle != UNKNOWN and self.vehicle_basis != SYSTEM_ID_BASIS

    @property
    def past_date(self) -> datetime | None:
        """The date of the flight; None if it is in the future, as in a simulation or by a wrong clock, or not known."""
        if self.date is None or self.date > datetime.now(UTC) + MAX_CLOCK_LEAD:
            return None
        return self.date

    @property
    def has_flight(self) -> bool:
        """Whether the row is of a flight: one with figures, one that was too short for any, or one that went badly."""
        was_in_air = bool(self.flight_time) and self.headline is not None
        return self.is_read or was_in_air or self.headline_level == Level.BAD

    @property
    def flights_of_log(self) -> int:
        """Number of flights in the row's log; 1 if an earlier version of this program did not count them."""
        return 1 if self.flight_count is None else self.flight_count

    @cached_property
    def order(self) -> RowOrder:
        """The key that rows are sorted by.

        It does not depend on when the rows were made, so that the table of a fleet is the same after every order of
        reading. Missing values sort first.
        """
        return RowOrder(
            self.vehicle,
            self.file,
            key=self.key,
            system=self.system or 0,
            component=self.component or 0,
            axis=self.axis or "",
        )

    @property
    def per_input(self) -> str:
        """The unit of the model's inputs in words: effectiveness is acceleration for one such unit."""
        if self.inputs == DEMAND:
            return "unit of demand"
        return self.input_unit or "unit of input"

    @property
    def is_unjudged_reference(self) -> bool:
        """Whether other flights are compared with this one, which was not judged itself: too few others are healthy."""
        return bool(self.reference) and self.health == UNKNOWN

    def as_dict(self) -> JsonValues:
        """Returns the columns as plain JSON values, the date as ISO 8601."""
        values = {name: getattr(self, name) for name in column_types()}
        if self.date is not None:
            values["date"] = self.date.isoformat()
        return values

    @staticmethod
    def from_stored(values: JsonValues) -> FlightRow:
        """Creates a row from its stored JSON values, as :meth:`as_dict` made them, without checking their types.

        It is ten times as fast as the constructor, which checked the types before the row was stored. Only the types
        that JSON does not have are restored: tuples from lists, and the date. Parameters that are not identifiable lose
        their values, as in the constructor.

        Args:
            values: values by name of the column. Columns that are missing have the default of the class, and take no
                memory in the row.

        Returns:
            The row, as the constructor would make it from these values.

        Raises:
            TypeError: the name of the file is missing, or a column has no list where it needs one.
        """
        if "file" not in values:
            raise TypeError("a row needs the name of its file")
        row = object.__new__(FlightRow)
        columns = vars(row)
        for name, value in values.items():
            value_type = type(value)
            if value_type is str:
                # Many rows share a text, such as a level or the firmware, which is kept once.
                columns[name] = sys.intern(value)
            elif value_type is list:
                columns[name] = tuple(value)
            elif value is not None:
                columns[name] = value
        if "positions" in columns:
            columns["positions"] = tuple(tuple(arms) for arms in columns["positions"])
        if "date" in columns:
            columns["date"] = column_value(columns["date"], datetime)
        for name in PHYSICAL_COLUMNS:
            if columns.get(f"{name}_status") == NOT_IDENTIFIABLE:
                columns.pop(name, None)
                columns.pop(f"{name}_interval", None)
        return row

    @staticmethod
    def without_flight(file: str, status: Fact, **columns: Any) -> FlightRow:
        """Creates the row of a log that has no flight to analyse; the row says why.

        Args:
            file: path or URL of the log.
            status: the reason, as a fact (coded finding).
            columns: further columns, such as the system id of a vehicle.

        Returns:
            The row, whose other columns are unknown (None or empty).
        """
        return FlightRow(file=file, status=str(status), status_code=status.code, **columns)

    @staticmethod
    def from_report(report: Mapping[str, Any], **columns: Any) -> FlightRow:
        """Makes the row of a flight, with the columns that follow from its report and further ones.

        Args:
            report: the document ``report.json``; a column that it lacks is not known.
            columns: further columns, which replace the report's columns of the same names.

        Returns:
            The row. Columns that neither ``report`` nor ``columns`` has are not known.
        """
        all_columns = columns_of_report(report, fields(FlightRow))
        all_columns.update(columns)
        return FlightRow(**all_columns)


FlightRows = list[FlightRow]


@cache
def column_types() -> JsonValues:
    """Returns the type of each column's values by the name of the column, such as ``float`` for ``float | None``."""
    types = {}
    for name, hint in get_type_hints(FlightRow).items():
        alternatives = get_args(hint)
        is_optional = type(None) in alternatives
        types[name] = alternatives[0] if is_optional else hint
    return types


def column_value(value: Any, column_type: Any) -> Any:
    """Converts a value to the type of its column, so that equal flights have equal rows in SQLite, JSON and Parquet.

    NaN and infinity become None, times are converted to UTC, and text is reduced to valid UTF-8.

    Args:
        value: the value; None stays None.
        column_type: type of the column: ``str``, ``int``, ``float``, ``datetime`` or a tuple of one of these.

    Returns:
        The converted value; None for a missing one.
    """
    if value is None:
        return None
    if get_origin(column_type) is tuple:
        entry_type = get_args(column_type)[0]
        return tuple(column_value(entry, entry_type) for entry in value)
    if column_type is float:
        return float(value) if math.isfinite(value) else None
    if column_type is int:
        return int(value)
    if column_type is datetime:
        time = value
        if isinstance(value, str):
            time = datetime.fromisoformat(value)
        if not time.tzinfo:
            # A time without a zone is UTC.
            time = time.replace(tzinfo=UTC)
        return time.astimezone(UTC)
    return utf8_text(str(value))


def utf8_text(text: str) -> str:
    """Returns a text, such as the name of a file, with characters that UTF-8 cannot encode as escape sequences."""
    return text.encode("utf-8", "backslashreplace").decode()
