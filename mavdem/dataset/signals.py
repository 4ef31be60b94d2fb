"""Signals: which message means what, worked out once for a vehicle and an axis.

Message and field names occur only here, in ``attitude`` and in ``drive``. Every signal is on the vehicle's boot clock,
in time order, each stamp once, per boot; a signal that was not recorded is None.

A setpoint is a command: it holds until the next one, for ``HOLD_SECONDS`` at most, so a sample has the last one at or
before its own stamp, on average half an interval late.

Stamps have the resolution of their messages (1 ms in MAVLink, 1 µs in most logs). ArduPilot stamps ATTITUDE_TARGET when
it sends it; PX4 with the time of its attitude setpoint, and the body rates in it were 0 to 8 ms newer on a flight
recorded both ways, 4 ms at the 95th percentile, as those in its ATTITUDE are.

A rate setpoint is not the same everywhere: in ArduPilot's ATTITUDE_TARGET it is the rate of the attitude setpoint; in
DataFlash's RATE and from PX4 it corrects the error of the attitude as well.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, wraps
from typing import Any, NamedTuple, TypeVar

import numpy as np
from scipy.ndimage import median_filter

from mavdem.arrays import Array, Flags
from mavdem.dataset.attitude import TUNING_MESSAGE, Attitude, attitude_of_axis, tuning_rates
from mavdem.dataset.axes import AXES, MAX_ANGLE, MAX_BODY_RATE, TILT_AXES
from mavdem.dataset.motor_outputs import (
    INPUT_KINDS,
    THRUST_COLUMN,
    UINT16_UNKNOWN,
    MotorOutputs,
    axis_demand,
    control_target,
    motor_outputs_or_obstacle,
)
from mavdem.dataset.time_series import (
    TimeSeries,
    clean_series,
    float_column,
    float_columns,
    recorded_series,
)
from mavdem.errors import NotLearnable
from mavdem.immutable import freeze
from mavdem.ingest.flight_modes import mode_name
from mavdem.ingest.mavlink.clocks import deviates_from_median
from mavdem.ingest.mavlink.definitions import enum_name
from mavdem.ingest.telemetry import Columns, Telemetry, rate_without_gaps, selected_rows
from mavdem.ingest.vocabulary import (
    ARMED,
    CUSTOM_MODE,
    LANDING_MODES,
    Injection,
    euler_angles,
    mavlink_constant,
    wrapped_angle,
)

CLIMB_RATE_FIELDS = {
    "LOCAL_POSITION_NED": ("vz", -1.0),
    "GLOBAL_POSITION_INT": ("vz", -0.01),
    "VFR_HUD": ("climb", 1.0),
}
HEIGHT_FIELDS = {
    "LOCAL_POSITION_NED": ("z", -1.0),
    "GLOBAL_POSITION_INT": ("relative_alt", 0.001),
    "ALTITUDE": ("altitude_relative", 1.0),
}
"""Messages with vertical speed, and height, the preferred first: the field, and the factor that makes it m/s, m, up."""
BATTERY_MESSAGES = ("SYS_STATUS", "BATTERY_STATUS")  # With the state of the battery
EARTH_RADIUS = 6_371_000.0  # m, in the mean
POSSIBLE_VOLTAGE = (1.0, 1000.0)
"""V: below, there is no battery monitor, or the simulator has no battery; above, the message is damaged."""
MIN_STREAM_RATE = 40.0
"""Hz, of attitude and of motors. Ten times the roughly 4 Hz at which a multirotor's roll loop crosses over, and what is
left of a 50 Hz stream on a link that loses a fifth. On recorded flights motors add nothing to a forecast at 1-10 Hz and
do at 50."""
MIN_SLOW_MOTION_RATE = 8.0
"""Hz, of both, from which a model may predict the slow motion: of flights decimated to 10 Hz and recorded at 10 Hz,
nine in ten were predicted better than without a model. Motors' effect, damping and lag show at higher frequencies."""
SETPOINT_MESSAGE = "ATTITUDE_TARGET"
IGNORED_SETPOINT_BITS = {
    field: mavlink_constant(f"ATTITUDE_TARGET_TYPEMASK_{name}_IGNORE")
    for field, name in {
        "roll": "BODY_ROLL_RATE",
        "pitch": "BODY_PITCH_RATE",
        "yaw": "BODY_YAW_RATE",
        "attitude": "ATTITUDE",
    }.items()
}
"""Bits of ATTITUDE_TARGET.type_mask: a field with its bit set is no setpoint."""
# s: stamps have no more digits, and the sum of steps that a grid point is may fall just before one
STAMP_ROUNDING = 1e-6
MAX_SETPOINT_AGE = 2.0
"""Age beyond which a setpoint is unknown: in flight modes that have no such setpoint its messages end."""


Find = TypeVar("Find", bound=Callable[..., Any])


def cached_per_vehicle(*of: str) -> Callable[[Find], Find]:
    """Decorates functions of signals and more that find the same by the same arguments and attributes ``of`` signals.

    What they have found, or why they found nothing, is ``known`` to the signals of all axes of the vehicle.
    """

    def decorated(find: Any) -> Any:
        @wraps(find)
        def found(signals: VehicleSignals, *arguments: Hashable, **named: Hashable) -> Any:
            own = (getattr(signals, name) for name in of)
            key = (
                find.__module__,
                find.__qualname__,
                signals.telemetry,
                *own,
                *arguments,
                *named.items(),
            )
            if key not in signals.cache:
                try:
                    signals.cache[key] = freeze(find(signals, *arguments, **named))
                except NotLearnable as error:
                    signals.cache[key] = NotLearnable(error.fact)
            result = signals.cache[key]
            if isinstance(result, NotLearnable):
                raise NotLearnable(result.fact)
            return result

        return found

    return decorated


@dataclass(frozen=True, eq=False)
class Setpoint:
    """One setpoint of one axis: ``signal`` from ``message``, called ``name``, in ``unit``."""

    name: str
    unit: str
    message: str
    signal: TimeSeries


def recorded_setpoints(telemetry: Telemetry, axis: str) -> tuple[Setpoint, ...]:
    """Returns the setpoints of ``axis`` that were recorded in ATTITUDE_TARGET.

    "roll rate setpoint" (rad/s) and, not of yaw, "roll setpoint" (rad).
    """
    targets = telemetry.messages.get(SETPOINT_MESSAGE)
    logged = []
    if targets is not None:
        masks = targets.get("type_mask", np.zeros(len(targets["time"])))
        ignored = np.asarray(masks).astype(int)
        rates = np.where(
            ignored & IGNORED_SETPOINT_BITS[axis],
            np.nan,
            float_column(targets, f"body_{axis}_rate"),
        )
        rates[abs(rates) > MAX_BODY_RATE] = np.nan
        logged.append(
            Setpoint(
                f"{axis} rate setpoint", "rad/s", SETPOINT_MESSAGE, clean_series(targets, rates)
            )
        )
        if axis != "yaw":
            asked = np.atleast_2d(float_column(targets, "q"))
            with np.errstate(invalid="ignore", divide="ignore"):  # NaN where the quaternion is none
                angles = euler_angles(asked / np.linalg.norm(asked, axis=1, keepdims=True))[
                    TILT_AXES.index(axis)
                ]
            angles = np.where(ignored & IGNORED_SETPOINT_BITS["attitude"], np.nan, angles)
            logged.append(
                Setpoint(f"{axis} setpoint", "rad", SETPOINT_MESSAGE, clean_series(targets, angles))
            )
    return tuple(setpoint for setpoint in logged if len(setpoint.signal.time))


def held_setpoint(setpoint: Setpoint, boot: int, time: Array) -> Array:
    """Returns the last setpoint until ``time`` (T,) s of ``boot``; NaN where none came in ``HOLD_SECONDS``."""
    here = setpoint.signal.boot == boot
    stamps = np.append(-np.inf, setpoint.signal.time[here])
    values = np.append(np.nan, setpoint.signal.values[here])
    last = np.searchsorted(stamps, time + STAMP_ROUNDING, side="right") - 1
    return np.where(time - stamps[last] <= MAX_SETPOINT_AGE + STAMP_ROUNDING, values[last], np.nan)


class InjectedSignal(NamedTuple):
    """A known ``signal``, rad, rad/s or a demand, that the autopilot added to what ``where`` names.

    ArduCopter logs it as it is made, and adds it in the next cycle of its loop.
    """

    injection_point: Injection
    signal: TimeSeries


@dataclass(frozen=True, eq=False)
class VehicleSignals:
    """The signals of one vehicle, each worked out when first asked for, and once."""

    telemetry: Telemetry

    preset_settled_intervals: list[tuple[float, float]] | None = field(default=None, kw_only=True)
    """Settled flight of its one boot, where that is known already; see ``phases.settled_intervals``."""

    cache: dict[Hashable, Any] = field(default_factory=dict, kw_only=True, repr=False)
    """What was found and why nothing was, by what it is of; see :func:`once`."""

    @property
    @cached_per_vehicle()
    def attitudes(self) -> tuple[Attitude, ...]:
        """Roll, pitch and yaw; empty where they were not recorded."""
        attitudes = (attitude_of_axis(self.telemetry, axis) for axis in AXES)
        return tuple(each for each in attitudes if each is not None)

    @property
    def tilts(self) -> tuple[Attitude, ...]:
        """Roll and pitch, by which a vehicle is upright or not; empty where they were not recorded."""
        return self.attitudes[:2]

    @property
    @cached_per_vehicle()
    def motors(self) -> MotorOutputs | None:
        """Motor outputs."""
        motors = motor_outputs_or_obstacle(self.telemetry)
        return motors if isinstance(motors, MotorOutputs) else None

    @property
    @cached_per_vehicle()
    def voltage(self) -> TimeSeries | None:
        """Voltage of the first battery, V; None where it was not measured."""
        columns = self.telemetry.messages.get("SYS_STATUS")
        if columns is None:
            return None
        volts = float_column(columns, "voltage_battery")
        volts = np.where(volts == UINT16_UNKNOWN, np.nan, volts) / 1000
        least, most = POSSIBLE_VOLTAGE
        possible = (volts >= least) & (volts <= most)
        # damage doubles single ones
        possible[possible] = ~deviates_from_median(volts[possible], 9, volts[possible] / 2)
        # Of a battery that is not measured, single messages have a voltage by damage.
        usual = np.count_nonzero(possible) >= max(5, np.count_nonzero(~np.isnan(volts)) / 2)
        return clean_series(columns, volts, possible) if usual else None

    @property
    @cached_per_vehicle()
    def armed(self) -> TimeSeries | None:
        """Whether the vehicle was armed, from HEARTBEAT; None where no heartbeat is its own."""
        return self._beats and replace(self._beats, values=self._beats.values[:, 0])

    @property
    @cached_per_vehicle()
    def landing(self) -> TimeSeries | None:
        """Whether the autopilot was in a mode that lands by itself, from HEARTBEAT; None where none is its own."""
        return self._beats and replace(self._beats, values=self._beats.values[:, 1])

    @property
    @cached_per_vehicle()
    def _beats(self) -> TimeSeries | None:
        """Both (N, 2) of them; a single stray heartbeat is outvoted by its neighbours."""
        if (columns := self.heartbeats) is None:
            return None
        flags = columns["base_mode"].astype(int)
        modes = columns.get("custom_mode", np.zeros(len(columns["time"])))
        number = int(columns["autopilot"][0])
        lands = np.isin(modes, list(LANDING_MODES.get(number, ()))) & (flags & CUSTOM_MODE > 0)
        state = np.column_stack([flags & ARMED > 0, lands]).astype(float)
        outvoted = median_filter(state, size=(3, 1), mode="nearest")
        return TimeSeries(columns["time"], columns["boot"], outvoted)

    @property
    @cached_per_vehicle()
    def heartbeats(self) -> Columns | None:
        """HEARTBEAT of the vehicle itself, in order of time: those that name another type or autopilot are not."""
        telemetry = self.telemetry
        columns = telemetry.messages.get("HEARTBEAT")
        if columns is None or not len(columns["time"]):
            return None
        # An unknown vehicle sends heartbeats of type GENERIC.
        kind = "GENERIC" if telemetry.vehicle == "UNKNOWN" else telemetry.vehicle
        kinds = [enum_name("MAV_TYPE", number) for number in columns["type"].tolist()]
        autopilots = [
            enum_name("MAV_AUTOPILOT", number) for number in columns["autopilot"].tolist()
        ]
        own = (np.array(kinds) == kind) & (np.array(autopilots) == telemetry.autopilot)
        if not own.any():
            return None
        order = np.lexsort((columns["time"][own], columns["boot"][own]))
        return selected_rows(columns, np.flatnonzero(own)[order])

    def mode_changes(self, boot: int) -> list[tuple[float, str]]:
        """Returns when each flight mode of a ``boot`` began, s, and its name, from CURRENT_MODE or else HEARTBEAT."""
        columns = self.telemetry.messages.get("CURRENT_MODE") or self.heartbeats
        if columns is None or "custom_mode" not in columns:
            return []
        rows = np.flatnonzero((columns["boot"] == boot) & np.isfinite(columns["custom_mode"]))
        numbers = columns["custom_mode"][rows].astype(int)
        changed = np.flatnonzero(np.diff(numbers, prepend=-1))
        named = [
            mode_name(self.telemetry.autopilot, self.telemetry.vehicle, int(number))
            for number in numbers[changed]
        ]
        return list(zip(columns["time"][rows[changed]].tolist(), named, strict=True))

    @property
    @cached_per_vehicle()
    def landed_state(self) -> TimeSeries | None:
        """MAV_LANDED_STATE as the autopilot reported it in EXTENDED_SYS_STATE; 0 where that is undefined."""
        return recorded_series(self.telemetry, "EXTENDED_SYS_STATE", "landed_state")

    @property
    @cached_per_vehicle()
    def climb_rate(self) -> TimeSeries | None:
        """Vertical speed, m/s, upwards, from LOCAL_POSITION_NED, GLOBAL_POSITION_INT or VFR_HUD."""
        return self._first_of(CLIMB_RATE_FIELDS)

    @property
    @cached_per_vehicle()
    def position(self) -> TimeSeries | None:
        """The position (N, 3) where it is known, m north, east and down of where the log or the estimator began."""
        if "x" in (columns := self.telemetry.messages.get("LOCAL_POSITION_NED", {})):
            valid = columns["valid"].astype(bool) if "valid" in columns else None
            return clean_series(columns, float_columns(columns, "xyz"), valid)
        columns = self.telemetry.messages.get("GLOBAL_POSITION_INT", {})
        if columns:
            places, fixed = global_positions(columns)
            angles = np.radians(places)
            if fixed.any():
                first = angles[np.argmax(fixed)]
                moved = wrapped_angle(angles - first)  # across the date line too
                plane = EARTH_RADIUS * moved * [1.0, np.cos(first[0])]
                down = -float_column(columns, "relative_alt") / 1000
                return clean_series(columns, np.column_stack([plane, down]), fixed)
        return None

    @property
    @cached_per_vehicle()
    def height(self) -> TimeSeries | None:
        """The height, m, above where the estimator or the flight began."""
        return self._first_of(HEIGHT_FIELDS)

    def _first_of(self, fields: Mapping[str, tuple[str, float]]) -> TimeSeries | None:
        """The first message with one of these fields that is not always 0, which measures nothing, times its factor."""
        for message, (name, factor) in fields.items():
            columns = self.telemetry.messages.get(message, {})
            if name in columns and len(columns["time"]) > 1 and columns[name].any():
                return clean_series(columns, factor * float_column(columns, name))
        return None

    @property
    @cached_per_vehicle()
    def autopilot_wind(self) -> TimeSeries | None:
        """The autopilot's own estimate of the wind, (N, 2) m/s north and east, where the air moves to."""
        if (columns := self.telemetry.messages.get("WIND_COV")) is not None:
            moving = [float_column(columns, "wind_x"), float_column(columns, "wind_y")]
        elif (columns := self.telemetry.messages.get("WIND")) is not None:
            angle = np.radians(float_column(columns, "direction"))
            moving = [
                -float_column(columns, "speed") * part for part in (np.cos(angle), np.sin(angle))
            ]
        else:
            return None
        wind = clean_series(columns, np.column_stack(moving))
        # without drag fusion ArduCopter sends 0
        return wind if wind.values.any() else None

    @property
    @cached_per_vehicle()
    def collective(self) -> TimeSeries | None:
        """How hard the motors work together, 0 to 1: their mean, or the controller's thrust command."""
        if self.motors is not None:
            return self.motors.collective
        thrust = control_target(self.telemetry, THRUST_COLUMN)
        return thrust if thrust is not None and len(thrust.time) else None


@dataclass(frozen=True, eq=False)
class Signals(VehicleSignals):
    """The signals of one vehicle for a model of one axis.

    Raises ValueError: an axis or inputs that are neither.
    """

    axis: str = "roll"  # "roll", "pitch" or "yaw"
    # "motors" or "demand"; None for the motors, unless they come too slowly and the demand does not
    inputs: str | None = None

    def __post_init__(self) -> None:
        if self.axis not in AXES:
            raise ValueError(f"axis must be one of {', '.join(AXES)}, not {self.axis!r}")
        if self.inputs not in (None, *INPUT_KINDS):
            raise ValueError(f"inputs must be one of {', '.join(INPUT_KINDS)}, not {self.inputs!r}")

    def for_axis(self, axis: str, inputs: str | None = None) -> Signals:
        """Returns the signals for another ``axis`` or other ``inputs``; those of the vehicle are not read again."""
        return replace(self, axis=axis, inputs=inputs)

    @cached_property
    def attitude(self) -> Attitude | None:
        """Angle and rate of the axis."""
        attitudes = self.tilts if self.axis in TILT_AXES else self.attitudes
        return attitudes[AXES.index(self.axis)] if attitudes else None

    @cached_property
    def demand(self) -> MotorOutputs | None:
        """The controller's command for the axis."""
        return axis_demand(self.telemetry, self.axis)

    @cached_property
    def model_inputs(self) -> MotorOutputs | None:
        """The model's inputs: the motors, or the demand where that was chosen or only it comes fast enough."""
        if self.inputs is not None:
            return self.demand if self.inputs == "demand" else self.motors
        streams = [stream for stream in (self.motors, self.demand) if stream is not None]
        return max(
            streams, key=lambda each: rate_between_outages(each) >= MIN_STREAM_RATE, default=None
        )

    @property
    def attitude_and_inputs(self) -> tuple[Attitude, MotorOutputs]:
        """Attitude and inputs of the model, where there are both."""
        assert self.attitude is not None and self.model_inputs is not None
        return self.attitude, self.model_inputs

    @property
    @cached_per_vehicle("axis")
    def setpoints(self) -> tuple[Setpoint, ...]:
        """What was asked of the axis; empty where that was not recorded."""
        return recorded_setpoints(self.telemetry, self.axis)

    @cached_property
    def angle_setpoint(self) -> TimeSeries | None:
        """The angle that was asked for, rad, from ATTITUDE_TARGET, or of ArduPilot from NAV_CONTROLLER_OUTPUT."""
        for setpoint in self.setpoints:
            if setpoint.unit == "rad":
                return setpoint.signal
        columns = self.telemetry.messages.get("NAV_CONTROLLER_OUTPUT")
        is_own = self.telemetry.autopilot == "ARDUPILOTMEGA" and self.axis in TILT_AXES
        if columns is None or not is_own:
            return None
        angles = np.radians(float_column(columns, f"nav_{self.axis}"))
        angles[abs(angles) > MAX_ANGLE] = np.nan
        return clean_series(columns, angles)

    @cached_property
    def injected_signals(self) -> tuple[InjectedSignal, ...]:
        """What system identification, or PX4's autotune, added to commands of the axis; empty where nothing was."""
        columns = self.telemetry.messages.get("SIDD")
        if columns is None:
            return ()
        injected = []
        for where in Injection:
            own = columns["axis"] == where + AXES.index(self.axis)
            scale = 1.0 if where is Injection.DEMAND else np.radians(1.0)
            signal = clean_series(columns, scale * float_column(columns, "target"), own)
            if signal.values.any():
                injected.append(InjectedSignal(where, signal))
        return tuple(injected)

    @cached_property
    def rate_and_setpoint(self) -> tuple[TimeSeries, TimeSeries] | None:
        """The body rate and what was asked of it, rad/s, from where they come fastest; None without setpoints.

        That is PID_TUNING, or else attitude and rate setpoint.
        """
        attitude = self.attitude
        tuning = tuning_rates(self.telemetry, self.axis, attitude)
        others = 0 if attitude is None or attitude.message == TUNING_MESSAGE else len(attitude.time)
        if tuning is not None and len(tuning.time) > others:
            rate, asked = tuning.values.T
            return replace(tuning, values=rate), replace(tuning, values=asked)
        asked_rates = [setpoint.signal for setpoint in self.setpoints if setpoint.unit == "rad/s"]
        if attitude is None or not asked_rates:
            return None
        return attitude.rate_series, asked_rates[0]


def global_positions(columns: Columns) -> tuple[Array, Flags]:
    """Returns latitude and longitude (N, 2), degrees, of messages with a position, and which of them (N,) are fixes."""
    places = 1e-7 * float_columns(columns, ("lat", "lon"))
    valid = places.any(axis=1) & (abs(places) <= [90.0, 180.0]).all(axis=1)
    return places, np.asarray(valid)


def rate_between_outages(stream: Attitude | MotorOutputs | TimeSeries) -> float:
    """Returns messages a second between outages, steps of over three usual ones, and boots."""
    return rate_without_gaps(np.diff(stream.time)[np.diff(stream.boot) == 0])


def output_names_and_units(axis: str) -> tuple[tuple[str, str], ...]:
    """Returns name and unit of each output of a flight of ``axis``: angle and rate, of yaw the rate only.

    A heading is any angle and nothing of the dynamics depends on it.
    """
    rate = (f"{axis} rate", "rad/s")
    return ((axis, "rad"), rate) if axis in TILT_AXES else (rate,)
