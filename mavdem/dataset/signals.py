"""Signals of one vehicle for a model of one axis: quantities in SI units, and the messages from which they come.

Names of messages and fields occur only here and in ``attitude``, ``motor_outputs`` and ``setpoints``. Every signal is a
time series on the clock of the vehicle's boot; a signal that was not recorded is None. Stamps have the resolution of
their messages: 1 ms in MAVLink, 1 µs in most logs.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import scipy

from mavdem.arrays import Array, Flags
from mavdem.dataset.attitude import TUNING_MESSAGE, Attitude, attitude_of_axis, tuning_rates
from mavdem.dataset.axes import AXES, MAX_ANGLE, TILT_AXES
from mavdem.dataset.batteries import Battery, connected_batteries
from mavdem.dataset.intervals import Intervals
from mavdem.dataset.motor_outputs import (
    INPUT_KINDS,
    THRUST_COLUMN,
    MotorOutputs,
    axis_demand,
    control_target,
    motor_outputs_or_reason,
)
from mavdem.dataset.setpoints import (
    InjectedSignal,
    Setpoint,
    near_measured_yaw,
    recorded_setpoints,
)
from mavdem.dataset.time_series import (
    TimeSeries,
    clean_series,
    float_column,
    float_columns,
    recorded_series,
)
from mavdem.dataset.vehicle_cache import cached_per_vehicle
from mavdem.ingest.flight_modes import announced_names, mode_name
from mavdem.ingest.mavlink.dialect import enum_name
from mavdem.ingest.telemetry import Columns, Telemetry, rate_without_gaps, selected_rows
from mavdem.ingest.vocabulary import (
    ARMED,
    CUSTOM_MODE,
    DEGREES_PER_UNIT,
    LANDING_MODES,
    MILLIMETRES_PER_METRE,
    Injection,
    wrapped_angle,
)

CLIMB_RATE_FIELDS = {
    "LOCAL_POSITION_NED": ("vz", -1.0),
    "GLOBAL_POSITION_INT": ("vz", -0.01),
    "VFR_HUD": ("climb", 1.0),
}
"""Messages with the vertical speed, the preferred one first: the field, and the factor to m/s upwards."""

HEIGHT_FIELDS = {
    "LOCAL_POSITION_NED": ("z", -1.0),
    "GLOBAL_POSITION_INT": ("relative_alt", 1 / MILLIMETRES_PER_METRE),
    "ALTITUDE": ("altitude_relative", 1.0),
}
"""Messages with the height, the preferred one first: the field, and the factor to m upwards."""

EARTH_RADIUS = 6_371_000.0
"""Mean radius of the Earth, m."""

HEARTBEAT_MEDIAN_SAMPLES = 3
"""Number of neighbouring heartbeats whose majority decides, so that a single stray one does not."""

MIN_STREAM_RATE = 40.0
"""Rate, Hz, of attitude and of motor outputs from which a full model can be learned.

It is ten times the roughly 4 Hz at which a multirotor's roll loop crosses over, and what remains of a 50 Hz stream on a
link that loses a fifth. On recorded flights motors add nothing to a forecast at 1 to 10 Hz and do at 50.
"""

MIN_SLOW_MOTION_RATE = 8.0
"""Rate, Hz, of attitude and of motor outputs from which a model may predict the slow motion.

Of flights decimated to 10 Hz or recorded at 10 Hz, nine in ten were predicted better than without a model. Control
effectiveness, rate damping and motor lag show only at higher frequencies.
"""

MAX_LATITUDE = 90.0
"""Largest latitude, degrees, north or south."""

MAX_LONGITUDE = 180.0
"""Largest longitude, degrees, east or west."""


class ModeChange(NamedTuple):
    """The beginning of a flight mode."""

    time: float
    """Time since boot, s."""

    mode: str
    """Name of the new mode."""


class HeartbeatFlags(NamedTuple):
    """What the heartbeats of a vehicle say, 0 or 1 each."""

    armed: TimeSeries
    """Whether the vehicle is armed (N,)."""

    landing: TimeSeries
    """Whether the autopilot is in a mode that lands by itself (N,)."""


class ModelSignals(NamedTuple):
    """The signals from which a model of an axis is learned."""

    attitude: Attitude
    """Angle and body rate of the axis."""

    inputs: MotorOutputs
    """Motor outputs, or the controller's demand."""


@dataclass(frozen=True, eq=False)
class VehicleSignals:
    """The signals of one vehicle, each derived from its messages when it is first used, and then cached."""

    telemetry: Telemetry
    """Messages of the vehicle."""

    preset_settled_intervals: Intervals | None = field(default=None, kw_only=True)
    """Settled flight of its single boot, if that is known without a look at the signals.

    See ``phases.settled_intervals``.
    """

    cache: dict[Hashable, Any] = field(default_factory=dict, kw_only=True, repr=False)
    """Results that were derived from the signals; see :func:`cached_per_vehicle`."""

    @property
    @cached_per_vehicle()
    def attitudes(self) -> tuple[Attitude, ...]:
        """Roll, pitch and yaw; empty if no attitude was recorded."""
        attitudes = [attitude_of_axis(self.telemetry, axis) for axis in AXES]
        return tuple(attitude for attitude in attitudes if attitude is not None)

    @property
    def tilts(self) -> tuple[Attitude, ...]:
        """Roll and pitch, whose angles are the tilt of the vehicle; empty if no attitude was recorded."""
        return self.attitudes[: len(TILT_AXES)]

    @property
    @cached_per_vehicle()
    def motors(self) -> MotorOutputs | None:
        """Outputs of all motors; None if no message has them."""
        motors = motor_outputs_or_reason(self.telemetry)
        return motors if isinstance(motors, MotorOutputs) else None

    @property
    @cached_per_vehicle()
    def batteries(self) -> tuple[Battery, ...]:
        """The batteries whose voltage was measured, by number; empty if none was."""
        return connected_batteries(self.telemetry)

    @property
    @cached_per_vehicle()
    def armed(self) -> TimeSeries | None:
        """Whether the vehicle was armed, 0 or 1, from HEARTBEAT; None without heartbeats of the vehicle."""
        flags = self._heartbeat_flags
        return None if flags is None else flags.armed

    @property
    @cached_per_vehicle()
    def landing(self) -> TimeSeries | None:
        """Whether the autopilot was in a mode that lands by itself, 0 or 1; None without heartbeats of the vehicle."""
        flags = self._heartbeat_flags
        return None if flags is None else flags.landing

    @property
    @cached_per_vehicle()
    def _heartbeat_flags(self) -> HeartbeatFlags | None:
        """Whether the vehicle is armed, and whether its flight mode lands it; None without heartbeats.

        Both come from the bits and modes of HEARTBEAT messages. Of a few neighbouring messages the majority decides,
        which removes single wrong ones, such as damaged messages.
        """
        columns = self.heartbeats
        if columns is None:
            return None
        mode_bits = columns["base_mode"].astype(int)
        # The meaning of custom_mode depends on the autopilot, which is the same in all rows.
        custom_modes = columns.get("custom_mode", np.zeros(len(columns["time"])))
        landing_modes = list(LANDING_MODES.get(int(columns["autopilot"][0]), ()))
        is_armed = mode_bits & ARMED > 0
        is_landing = np.isin(custom_modes, landing_modes) & (mode_bits & CUSTOM_MODE > 0)
        time, boot = columns["time"], columns["boot"]
        return HeartbeatFlags(
            armed=TimeSeries(time, boot, _majority_of_neighbours(is_armed)),
            landing=TimeSeries(time, boot, _majority_of_neighbours(is_landing)),
        )

    @property
    @cached_per_vehicle()
    def heartbeats(self) -> Columns | None:
        """Columns of the vehicle's HEARTBEAT messages, sorted by boot and time; None if there are none.

        Messages with another type of vehicle or autopilot are from other components, or damaged, and are left out.
        """
        columns = self.telemetry.messages.get("HEARTBEAT")
        if columns is None or not len(columns["time"]):
            return None
        rows = np.array(self._heartbeat_rows_of_vehicle(columns), int)
        if not len(rows):
            return None
        # The last key is the first by which ``lexsort`` sorts.
        by_boot_and_time = np.lexsort((columns["time"][rows], columns["boot"][rows]))
        return selected_rows(columns, rows[by_boot_and_time])

    def _heartbeat_rows_of_vehicle(self, heartbeats: Columns) -> list[int]:
        """Returns the rows of those HEARTBEAT messages that have the vehicle's own type and autopilot.

        Args:
            heartbeats: columns of all HEARTBEAT messages with the vehicle's ids.
        """
        telemetry = self.telemetry
        # A vehicle of unknown type sends heartbeats of type GENERIC.
        vehicle_type = "GENERIC" if telemetry.vehicle == "UNKNOWN" else telemetry.vehicle
        types_and_autopilots = zip(
            heartbeats["type"].tolist(), heartbeats["autopilot"].tolist(), strict=True
        )
        rows = []
        for row, (type_number, autopilot_number) in enumerate(types_and_autopilots):
            is_same_type = enum_name("MAV_TYPE", type_number) == vehicle_type
            is_same_autopilot = enum_name("MAV_AUTOPILOT", autopilot_number) == telemetry.autopilot
            if is_same_type and is_same_autopilot:
                rows.append(row)
        return rows

    def mode_changes(self, boot: int) -> list[ModeChange]:
        """Returns the changes of the flight mode, from CURRENT_MODE or otherwise from HEARTBEAT.

        Args:
            boot: Number of the boot; a boot lasts from one start of the autopilot to the next.

        Returns:
            Time, s, and name of each mode that was entered, with the first mode of the boot.
        """
        columns = self.telemetry.messages.get("CURRENT_MODE") or self.heartbeats
        if columns is None or "custom_mode" not in columns:
            return []
        rows = np.flatnonzero((columns["boot"] == boot) & np.isfinite(columns["custom_mode"]))
        mode_numbers = columns["custom_mode"][rows].astype(int)
        # No mode has the number −1, so that the first row counts as a change.
        changed = np.flatnonzero(np.diff(mode_numbers, prepend=-1))
        times = columns["time"][rows[changed]].tolist()
        names_by_mode = announced_names(self.telemetry.messages.get("AVAILABLE_MODES", {}))
        changes = []
        for time, number in zip(times, mode_numbers[changed].tolist(), strict=True):
            name = mode_name(
                self.telemetry.autopilot, self.telemetry.vehicle, number, names_by_mode
            )
            changes.append(ModeChange(time, name))
        return changes

    def mode_at(self, boot: int, time: float) -> str:
        """Returns the flight mode of the vehicle at one time.

        Args:
            boot: number of the boot, from 0.
            time: the time, s since that boot.

        Returns:
            The autopilot's name of the mode, such as "LOITER"; empty before the first known mode.
        """
        mode = ""
        for change in self.mode_changes(boot):
            if change.time <= time:
                mode = change.mode
        return mode

    @property
    @cached_per_vehicle()
    def landed_state(self) -> TimeSeries | None:
        """MAV_LANDED_STATE as the autopilot reports it in EXTENDED_SYS_STATE; 0 where that is undefined."""
        return recorded_series(self.telemetry, "EXTENDED_SYS_STATE", "landed_state")

    @property
    @cached_per_vehicle()
    def climb_rate(self) -> TimeSeries | None:
        """Vertical speed, m/s upwards, from LOCAL_POSITION_NED, GLOBAL_POSITION_INT or VFR_HUD."""
        return self._preferred_field(CLIMB_RATE_FIELDS)

    @property
    @cached_per_vehicle()
    def position(self) -> TimeSeries | None:
        """Position (N, 3), m north, east and down of the estimator's origin, or of the first position fix.

        LOCAL_POSITION_NED has the position itself. Without that message, latitude and longitude of GLOBAL_POSITION_INT
        are projected onto a plane that touches the earth at the first fix. None if neither was recorded.
        """
        columns = self.telemetry.messages.get("LOCAL_POSITION_NED", {})
        if "x" in columns:
            is_valid = columns["valid"].astype(bool) if "valid" in columns else None
            return clean_series(columns, float_columns(columns, ("x", "y", "z")), is_valid)
        columns = self.telemetry.messages.get("GLOBAL_POSITION_INT", {})
        if not columns:
            return None
        positions = global_positions(columns)
        if not positions.is_fix.any():
            return None
        # ``argmax`` returns the row of the first true flag, the first fix.
        origin = positions.degrees[np.argmax(positions.is_fix)]
        horizontal = plane_positions(positions.degrees, origin)
        down = -float_column(columns, "relative_alt") / MILLIMETRES_PER_METRE
        return clean_series(columns, np.column_stack([horizontal, down]), positions.is_fix)

    @property
    @cached_per_vehicle()
    def height(self) -> TimeSeries | None:
        """Height, m, above the estimator's origin or above where the flight began."""
        return self._preferred_field(HEIGHT_FIELDS)

    def _preferred_field(self, fields: Mapping[str, tuple[str, float]]) -> TimeSeries | None:
        """Returns a quantity from the first message that measures it.

        Args:
            fields: Name of the field and factor to the wanted unit, by message, the preferred message first.

        Returns:
            The quantity (N,) in the wanted unit; None if no message has it. A field that is always 0 was not measured.
        """
        for message, (name, factor) in fields.items():
            columns = self.telemetry.messages.get(message, {})
            has_samples = name in columns and len(columns["time"]) > 1
            if has_samples and columns[name].any():
                return clean_series(columns, factor * float_column(columns, name))
        return None

    @property
    @cached_per_vehicle()
    def autopilot_wind(self) -> TimeSeries | None:
        """The autopilot's estimate of the wind: velocity of the air (N, 2), m/s to the north and to the east.

        It is read from WIND_COV (PX4) or WIND (ArduPilot). None if it was not recorded, or is always 0.
        """
        wind = self._wind_messages
        # ArduCopter sends zeros unless its filter fuses drag: zeros are no estimate.
        return wind if wind is not None and wind.values.any() else None

    @property
    def zero_wind_message(self) -> str:
        """Name of the message with the autopilot's wind estimate, if all its values are 0; otherwise empty."""
        wind = self._wind_messages
        if wind is None or not len(wind.values) or wind.values.any():
            return ""
        return "WIND_COV" if "WIND_COV" in self.telemetry.messages else "WIND"

    @property
    @cached_per_vehicle()
    def _wind_messages(self) -> TimeSeries | None:
        """The messages of the autopilot's wind estimate as (N, 2) m/s, north and east; None if there are none."""
        messages = self.telemetry.messages
        if "WIND_COV" in messages:
            columns = messages["WIND_COV"]
            north = float_column(columns, "wind_x")
            east = float_column(columns, "wind_y")
        elif "WIND" in messages:
            columns = messages["WIND"]
            speed = float_column(columns, "speed")
            # The air moves opposite to the direction that the wind comes from, which WIND has in degrees.
            direction_of_origin = np.radians(float_column(columns, "direction"))
            north = -speed * np.cos(direction_of_origin)
            east = -speed * np.sin(direction_of_origin)
        else:
            return None
        return clean_series(columns, np.column_stack([north, east]))

    @property
    @cached_per_vehicle()
    def collective(self) -> TimeSeries | None:
        """Collective: mean output of all motors as a fraction of their range, 0 to 1.

        Where motors were not recorded it is the controller's demand for thrust; None if neither was.
        """
        if self.motors is not None:
            return self.motors.collective
        thrust = control_target(self.telemetry, THRUST_COLUMN)
        return thrust if thrust is not None and len(thrust.time) else None


class RateWithSetpoint(NamedTuple):
    """Body rate of one axis and its setpoint, each at the stamps of its own messages."""

    rate: TimeSeries
    """Body rate, rad/s."""

    setpoint: TimeSeries
    """Setpoint of the rate, rad/s."""


@dataclass(frozen=True, eq=False)
class Signals(VehicleSignals):
    """The signals of one vehicle for a model of one axis.

    Raises:
        ValueError: The axis or the kind of inputs is none of those below.
    """

    axis: str = "roll"
    """Axis of the model: "roll", "pitch" or "yaw"."""
    inputs: str | None = None
    """Inputs of the model: "motors" or "demand". None: the motors, unless only the demand comes fast enough."""

    def __post_init__(self) -> None:
        if self.axis not in AXES:
            raise ValueError(f"axis must be one of {', '.join(AXES)}, not {self.axis!r}")
        if self.inputs not in (None, *INPUT_KINDS):
            raise ValueError(f"inputs must be one of {', '.join(INPUT_KINDS)}, not {self.inputs!r}")

    def for_axis(self, axis: str, inputs: str | None = None) -> Signals:
        """Returns the signals for a model of another axis or with other inputs; the cache is shared."""
        return replace(self, axis=axis, inputs=inputs)

    @cached_property
    def attitude(self) -> Attitude | None:
        """Euler angle and body rate of the axis; None if no attitude was recorded."""
        attitudes = self.tilts if self.axis in TILT_AXES else self.attitudes
        return attitudes[AXES.index(self.axis)] if attitudes else None

    @cached_property
    def demand(self) -> MotorOutputs | None:
        """The controller's demand for the axis; None if it was not recorded or never moved."""
        return axis_demand(self.telemetry, self.axis)

    @cached_property
    def model_inputs(self) -> MotorOutputs | None:
        """The inputs of the model: the motor outputs, or the controller's demand for the axis.

        Motor outputs are preferred, because they contain the effects of the mixer and its limits. The demand is used if
        the caller chose it, if motor outputs were not recorded, or if only the demand has a rate of at least
        ``MIN_STREAM_RATE``. None without inputs.
        """
        if self.inputs == "demand":
            return self.demand
        if self.inputs == "motors" or self.demand is None:
            return self.motors
        if self.motors is None:
            return self.demand
        is_motor_rate_low = rate_between_outages(self.motors) < MIN_STREAM_RATE
        if is_motor_rate_low and rate_between_outages(self.demand) >= MIN_STREAM_RATE:
            return self.demand
        return self.motors

    @property
    def attitude_and_inputs(self) -> ModelSignals:
        """Attitude and inputs of the model, for logs that are known to have both: those with a learnable segment."""
        assert self.attitude is not None and self.model_inputs is not None
        return ModelSignals(self.attitude, self.model_inputs)

    @property
    @cached_per_vehicle("axis")
    def setpoints(self) -> tuple[Setpoint, ...]:
        """Setpoints of the axis: of its angle, in rad, and of its rate, in rad/s; empty if none were recorded.

        The setpoint of the yaw angle is unwrapped to within half a turn of the measured yaw, so that their difference
        is the error.
        """
        setpoints = recorded_setpoints(self.telemetry, self.axis)
        if self.axis in TILT_AXES or self.attitude is None:
            return setpoints
        measured_yaw = self.attitude.angle_series
        unwrapped_setpoints = []
        for setpoint in setpoints:
            is_angle = setpoint.unit == "rad"
            unwrapped_setpoints.append(
                near_measured_yaw(setpoint, measured_yaw) if is_angle else setpoint
            )
        return tuple(unwrapped_setpoints)

    @cached_property
    def angle_setpoint(self) -> TimeSeries | None:
        """Setpoint of the Euler angle of the axis, rad; None if it was not recorded.

        It is read from ATTITUDE_TARGET. Without that message ArduPilot's NAV_CONTROLLER_OUTPUT is used, which has roll
        and pitch in degrees.
        """
        for setpoint in self.setpoints:
            if setpoint.unit == "rad":
                return setpoint.signal
        columns = self.telemetry.messages.get("NAV_CONTROLLER_OUTPUT")
        # Only ArduPilot writes the setpoints of roll and pitch into this message.
        is_ardupilot = self.telemetry.autopilot == "ARDUPILOTMEGA"
        if columns is None or not is_ardupilot or self.axis not in TILT_AXES:
            return None
        angles = np.radians(float_column(columns, f"nav_{self.axis}"))
        angles[abs(angles) > MAX_ANGLE] = np.nan
        return clean_series(columns, angles)

    @cached_property
    def injected_signals(self) -> tuple[InjectedSignal, ...]:
        """Test signals that system identification, or PX4's autotune, added to the commands of the axis.

        The column ``axis`` of the message SIDD states the axis and the point of the controller at which a signal was
        added. Each point with a signal that is not 0 throughout has an entry, in rad, rad/s or the unit of the demand.
        """
        columns = self.telemetry.messages.get("SIDD")
        if columns is None:
            return ()
        injected_signals = []
        for point in Injection:
            # The value of ``Injection`` is the number of the point for roll; pitch and yaw have the next two numbers.
            is_selected = columns["axis"] == point + AXES.index(self.axis)
            # Angles and rates are logged in degrees.
            factor = 1.0 if point is Injection.DEMAND else np.radians(1.0)
            signal = clean_series(columns, factor * float_column(columns, "target"), is_selected)
            if signal.values.any():
                injected_signals.append(InjectedSignal(point, signal))
        return tuple(injected_signals)

    @cached_property
    def rate_and_setpoint(self) -> RateWithSetpoint | None:
        """Body rate and its setpoint, rad/s, from the faster of two sources; None if no setpoint was recorded.

        One source is PID_TUNING, which has both at the same stamps. The other is the attitude for the rate and
        ATTITUDE_TARGET for the setpoint, at different stamps. The source with more samples of the rate is used.
        """
        attitude = self.attitude
        tuning = tuning_rates(self.telemetry, self.axis, attitude)
        attitude_count = 0
        if attitude is not None and attitude.message != TUNING_MESSAGE:
            attitude_count = len(attitude.time)
        if tuning is not None and len(tuning.time) > attitude_count:
            rate, setpoint = tuning.values.T
            return RateWithSetpoint(replace(tuning, values=rate), replace(tuning, values=setpoint))
        rate_setpoints = [item.signal for item in self.setpoints if item.unit == "rad/s"]
        if attitude is None or not rate_setpoints:
            return None
        return RateWithSetpoint(attitude.rate_series, rate_setpoints[0])


class GlobalPositions(NamedTuple):
    """Geographic positions in N messages."""

    degrees: Array
    """Latitude and longitude (N, 2), degrees."""

    is_fix: Flags
    """Whether each is a position fix (N,); before a fix, receivers send zeros."""


def _majority_of_neighbours(flags: Flags) -> Array:
    """Returns for each of N flags what most of ``HEARTBEAT_MEDIAN_SAMPLES`` flags around it are, 0 or 1 (N,)."""
    # This is the running median of the flags, which a mean gives in a tenth of the time.
    mean_flags = scipy.ndimage.uniform_filter1d(
        flags.astype(float), HEARTBEAT_MEDIAN_SAMPLES, mode="nearest"
    )
    return (mean_flags > 0.5).astype(float)


def global_positions(columns: Columns) -> GlobalPositions:
    """Returns the geographic positions in a message, and which of them are position fixes.

    Args:
        columns: Fields of N messages, of which ``lat`` and ``lon``, in units of 1e-7 degrees, are used.
    """
    degrees = DEGREES_PER_UNIT * float_columns(columns, ("lat", "lon"))
    is_possible = (abs(degrees) <= [MAX_LATITUDE, MAX_LONGITUDE]).all(axis=1)
    is_fix = degrees.any(axis=1) & is_possible
    return GlobalPositions(degrees, np.asarray(is_fix))


def plane_positions(degrees: Array, origin: Array) -> Array:
    """Projects geographic positions onto the plane that touches the earth, a sphere, at one of them.

    Args:
        degrees: Latitude and longitude (N, 2), degrees.
        origin: Latitude and longitude (2,) of the point of contact, degrees.

    Returns:
        Metres north and east of it (N, 2).
    """
    # Wrapping keeps the distance small across the date line too.
    angles = wrapped_angle(np.radians(degrees - origin))
    # A degree of longitude is shorter than one of latitude, by the cosine of the latitude.
    origin_latitude, _ = np.radians(origin)
    return np.asarray(EARTH_RADIUS * angles * [1.0, np.cos(origin_latitude)])


def rate_between_outages(stream: Attitude | MotorOutputs | TimeSeries) -> float:
    """Returns the mean rate of a stream, Hz, without outages: steps of over three usual ones and changes of boot."""
    is_same_boot = np.diff(stream.boot) == 0
    return rate_without_gaps(np.diff(stream.time)[is_same_boot])
