"""Which output channels drive motors, where each motor is, which way it turns, and the scale of the outputs.

Channels and positions come from the autopilot's parameters, or are assumed, which ``MotorGeometry`` reports.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import product
from math import atan2, cos, degrees, radians, sin
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.confidence import Interval
from mavdem.containers import Names, Numbers
from mavdem.facts import Fact
from mavdem.facts.sources import Source
from mavdem.files import load_adjacent_toml
from mavdem.ingest.telemetry import Parameters
from mavdem.ingest.vocabulary import NAMES, UNNAMED


class ChannelSource(StrEnum):
    """What says which output channel drives which motor."""

    DEMAND = "demand"
    PX4_FUNCTIONS = "px4_functions"
    SERVO_FUNCTIONS = "servo_functions"
    MOVING_CHANNELS = "moving_channels"
    FIRST_CHANNELS = "first_channels"


class PositionSource(StrEnum):
    """What says where motors are."""

    PARAMETERS = "parameters"
    X_QUAD = "x_quad"
    UNKNOWN = "unknown"


Driver = tuple[str, int]  # PX4's, and the channel there, from 1: ("PWM_MAIN", 1)
Position = tuple[float, float]
"""(forward, right) of the centre of mass: metres from the autopilot's parameters, else on a unit circle."""
MOTOR_COUNTS = {
    "TRICOPTER": 3,
    "QUADROTOR": 4,
    "HEXAROTOR": 6,
    "OCTOROTOR": 8,
    "DECAROTOR": 10,
    "DODECAROTOR": 12,
}
"""Number of motors of each MAV_TYPE that has one."""
MULTIROTORS = (*MOTOR_COUNTS, "GENERIC_MULTIROTOR")  # The MAV_TYPEs of vehicles with fixed rotors
POSSIBLE_MULTIROTORS = (*MULTIROTORS, UNNAMED)


class MotorMessage(NamedTuple):
    """How a message carries outputs: in one array ``field``, or in a field a channel, of which ports have a message."""

    field: str
    is_ported: bool = False

    @property
    def fields(self) -> Names:
        """The names of all its fields with outputs, and of the port's."""
        channels = (self.field.format(n) for n in range(1, 17))
        return ("port", *channels) if self.is_ported else (self.field,)


MOTOR_MESSAGES = {
    "SERVO_OUTPUT_RAW": MotorMessage("servo{}_raw", is_ported=True),
    "ACTUATOR_OUTPUT_STATUS": MotorMessage("actuator"),
    "HIL_ACTUATOR_CONTROLS": MotorMessage("controls"),
}
"""Messages with motor outputs, the preferred first."""


def motor_parameters(autopilot: str) -> Names:
    """Returns the parameters of a MAV_AUTOPILOT that say where motors are and how they respond; none if not known."""
    names = NAMES["motor_parameters"].get(autopilot, ())
    return tuple(dict.fromkeys(name.format(n, n - 1) for name in names for n in range(1, 9)))


def control_parameters(autopilot: str) -> Names:
    """Returns the parameters of a MAV_AUTOPILOT that its rate and attitude control need; none if not known."""
    names = NAMES["control_parameters"].get(autopilot, ())
    axes = NAMES["control_axes"].get(autopilot, ())
    return tuple(dict.fromkeys(name.format(axis) for name in names for axis in axes))


@dataclass(frozen=True)
class MotorGeometry:
    """The motors of one vehicle, in the order of their numbers, and the output channel that drives each, all from 1.

    ``positions`` and ``spins`` are empty when unknown; ``channel_source`` and ``position_source`` say what gave them,
    or what was assumed. A spin is 1 for a propeller that turns counterclockwise seen from above, -1 for one that turns
    clockwise. ``labels`` are names of the inputs, where they are not motors. ``drivers`` are PX4's driver of each and
    its channel there, from 1: ("PWM_MAIN", 1).
    """

    motors: tuple[int, ...]
    channels: tuple[int, ...]
    positions: tuple[Position, ...]
    channel_source: ChannelSource = ChannelSource.SERVO_FUNCTIONS
    position_source: PositionSource = PositionSource.PARAMETERS
    labels: Names = ()
    spins: tuple[int, ...] = ()
    drivers: tuple[Driver, ...] = ()

    @property
    def channels_assumed(self) -> bool:
        """Whether channels are those that move, or the first, for want of parameters."""
        return self.channel_source in (ChannelSource.MOVING_CHANNELS, ChannelSource.FIRST_CHANNELS)

    @property
    def positions_assumed(self) -> bool:
        """Whether positions are those of an X quad, or not known, for want of parameters."""
        return self.position_source is not PositionSource.PARAMETERS

    @property
    def assumed(self) -> bool:
        """Whether any of that is assumed."""
        return self.channels_assumed or self.positions_assumed

    @property
    def basis(self) -> Fact:
        """The source of channels and positions, or what was assumed."""
        return Fact(
            Source.MOTOR_BASIS,
            channels_by=self.channel_source,
            places_by=self.position_source,
            count=len(self.channels),
        )

    @property
    def names(self) -> Names:
        """One name a motor: ``motor 1 (front right)``, without the place when it is unknown."""
        if self.labels:
            return self.labels
        if not self.positions:
            return tuple(f"motor {motor}" for motor in self.motors)
        return tuple(
            f"motor {motor} ({position_name(at)})"
            for motor, at in zip(self.motors, self.positions, strict=True)
        )

    def mixer_row(self, axis: str) -> Array | None:
        """Returns (k,) weights of the motors in the torque about ``axis``, magnitudes summing to 1; None when unknown.

        Thrust acts upwards, so a motor on the left rolls to the right (positive roll) and a motor in front raises the
        nose (positive pitch). On an X quad, roll is (left motors − right motors)/4. A propeller turns the vehicle the
        other way than itself, so one that turns counterclockwise turns the nose to the right (positive yaw).
        """
        turning = {
            "roll": [-right for _, right in self.positions],
            "pitch": [forward for forward, _ in self.positions],
            "yaw": self.spins,
        }
        weights = np.array(turning[axis], np.float64)
        total = abs(weights).sum()
        return weights / total if total > 0 else None


def demand_geometry(axis: str) -> MotorGeometry:
    """Returns the controller's demand on an axis as the one input: like a motor with effect 1 about it."""
    arm = {"roll": (0.0, -1.0), "pitch": (1.0, 0.0), "yaw": (0.0, 0.0)}[axis]
    return MotorGeometry(
        (1,), (1,), (arm,), ChannelSource.DEMAND, labels=(f"{axis} demand",), spins=(1,)
    )


def motor_geometry(
    vehicle: str, autopilot: str, parameters: Parameters, moving: Sequence[int], bank: int
) -> MotorGeometry | None:
    """Returns the motors of a vehicle; None when no channel can be one.

    ``vehicle`` and ``autopilot`` are MAV_TYPE and MAV_AUTOPILOT without prefixes, ``moving`` the channels, from 1,
    whose outputs change, ``bank`` how many channels a bank has (PX4 numbers those of each driver, and bank, from 1).
    """
    drivers: dict[int, Driver] = {}
    channel_of: dict[int, int] = {}
    places = {}
    turns = {}
    others = set()
    if autopilot == "PX4":
        channel_of, drivers = _px4_channels(parameters, moving, bank)
        # n of the control allocation is motor n + 1
        for n in range(min(int(parameters.get("CA_ROTOR_COUNT", 0)), 12)):
            x, y, moment = (parameters.get(f"CA_ROTOR{n}_{name}") for name in ("PX", "PY", "KM"))
            if x is not None and y is not None:
                places[n + 1] = x, y
            # Torque over thrust is positive for a rotor that turns counterclockwise.
            if moment:
                turns[n + 1] = 1 if moment > 0 else -1
        channels_by = ChannelSource.PX4_FUNCTIONS
    else:
        # SERVOn_FUNCTION 33 to 40 are motors 1 to 8, 82 to 85 motors 9 to 12; of several channels the first.
        motor_of = {33 + i: 1 + i for i in range(8)} | {82 + i: 9 + i for i in range(4)}
        for channel in range(32, 0, -1):
            function = int(parameters.get(f"SERVO{channel}_FUNCTION", 0))
            if function in motor_of:
                channel_of[motor_of[function]] = channel
            # Before ArduCopter 3.5 motors have no function, and gimbals have RCn_FUNCTION.
            if parameters.get(f"RC{channel}_FUNCTION", function) not in (0, *motor_of):
                others.add(channel)
        moving = [channel for channel in moving if channel not in others]
        if vehicle == "TRICOPTER":
            channel_of.pop(7, None)  # the servo that tilts the rear motor
        frame_class = int(parameters.get("FRAME_CLASS", 0))
        frame_type = int(parameters.get("FRAME_TYPE", -1))
        if "FRAME_CLASS" not in parameters and "FRAME" in parameters:
            # Before ArduCopter 3.5 the class was compiled in and FRAME was the type.
            frame_class = {"QUADROTOR": 1, "HEXAROTOR": 2, "OCTOROTOR": 3}.get(vehicle, 0)
            frame_type = int(parameters["FRAME"])
        places, turns = _placed(*_FRAMES.get(str(frame_class), {}).get(str(frame_type), ((), "")))
        if frame_class == 7:  # a tricopter
            places, turns = _placed((60, -60, 0, 180), "")
            del places[3]  # its servo has another number, and it has no motor of this one
        channels_by = ChannelSource.SERVO_FUNCTIONS
    # some of the parameters did not come
    if len(channel_of) < MOTOR_COUNTS.get(vehicle, 1):
        count = MOTOR_COUNTS.get(vehicle, len(moving))
        moved = sorted(moving)[:count]
        channels_by = ChannelSource.MOVING_CHANNELS
        first = (min(moving, default=1) - 1) // bank * bank + 1
        usual = [n for n in range(first, 33) if n not in others][:count]
        # A motor whose output never changes is one all the same. A tricopter's are on no row of channels.
        if count / 2 <= len(moved) < count and set(moved) <= set(usual) and vehicle != "TRICOPTER":
            moved = usual
            channels_by = ChannelSource.FIRST_CHANNELS
        channel_of = dict(enumerate(moved, 1))
    motors = tuple(sorted(channel_of))
    channels = tuple(channel_of[motor] for motor in sorted(channel_of))
    if not channels:
        return None
    places_by = PositionSource.PARAMETERS
    if not places.keys() >= set(motors):
        # ArduPilot and PX4 number the motors of an X quad, by far the most common frame, the same way.
        is_quad = motors == (1, 2, 3, 4)
        places_by = PositionSource.X_QUAD if is_quad else PositionSource.UNKNOWN
        places, turns = _placed(*_FRAMES["1"]["1"]) if is_quad else ({}, {})
    positions = tuple(places[motor] for motor in motors) if places else ()
    spins = tuple(turns[motor] for motor in motors) if turns.keys() >= set(motors) else ()
    places_of = tuple(drivers[channel] for channel in channels if channel in drivers)
    return MotorGeometry(
        motors, channels, positions, channels_by, places_by, spins=spins, drivers=places_of
    )


def position_name(position: Position) -> str:
    """Returns where a motor is, in words: ``front right``."""
    bearing = radians(45 * round(degrees(atan2(position[1], position[0])) / 45))
    along = {1: "front", 0: "", -1: "rear"}[round(cos(bearing))]
    across = {1: "right", 0: "", -1: "left"}[round(sin(bearing))]
    return f"{along} {across}".strip()


_FRAMES = load_adjacent_toml(__file__, "frames.toml")


def _placed(bearings: Numbers, directions: str) -> tuple[dict[int, Position], dict[int, int]]:
    """Place and spin of each motor."""
    places = ((round(cos(radians(at)), 6), round(sin(radians(at)), 6)) for at in bearings)
    return dict(enumerate(places, 1)), {
        n: 1 if spin == "+" else -1 for n, spin in enumerate(directions, 1)
    }


def _px4_channels(
    parameters: Parameters, moving: Sequence[int], bank: int
) -> tuple[dict[int, int], dict[int, Driver]]:
    """The channel of each motor ({driver}_FUNCn 101 to 112 are 1 to 12), and the driver behind each channel.

    Of drivers whose channels move, in the first such bank; then of those of which half move.
    """
    channels: dict[int, int] = {}
    # Before PX4 1.13, which has no *_FUNCn, the first bank is that of the main outputs.
    drivers = {
        n: ("PWM_MAIN", n) if n <= bank else ("PWM_AUX", n - bank) for n in range(1, 2 * bank + 1)
    }
    banks = [0, bank]
    for most, driver in product((0.0, 0.5), NAMES["px4_drivers"]):
        motor_of = {n: int(parameters.get(f"{driver}_FUNC{n}", 0)) - 100 for n in range(1, 17)}
        # A motor on two drivers is on a spare one.
        further = {
            motor: n for n, motor in motor_of.items() if 1 <= motor <= 12 and motor not in channels
        }
        still = {first: len({first + n for n in further.values()} - set(moving)) for first in banks}
        first = next((first for first in banks if still[first] <= most * len(further)), None)
        if further and first is not None:
            channels |= {motor: first + n for motor, n in further.items()}
            drivers |= {first + n: (driver, n) for n in further.values()}
            banks.remove(first)
    return channels, drivers


@dataclass(frozen=True)
class OutputScale:
    """How motor outputs are expressed: "PWM" in µs, "normalised", "0-1000", "DShot", "UAVCAN" or "unknown".

    ``low`` and ``high`` are outputs at no and at full throttle, ``step`` is the smallest difference between two values.
    ``stop`` is the share of the range beyond which the autopilot sends no motor; 1 where that is not known.
    """

    name: str
    unit: str
    low: float
    high: float
    step: float
    stop: float = 1.0

    def fraction(self, outputs: Array) -> Array:
        """Returns outputs as a share of the range, 0 at ``low`` or off, 1 at ``high``.

        Disarmed, they are below 0 on some autopilots.
        """
        return np.where(
            (outputs == 0) & (self.low > 0), 0.0, (outputs - self.low) / (self.high - self.low)
        )


# PX4's outputs at full throttle
MAX_DSHOT = 1999.0
MAX_UAVCAN = 8191.0


def output_scale(
    outputs: Array,
    parameters: Parameters,
    drivers: Sequence[Driver] = (),
) -> OutputScale:
    """Returns the scale of motor outputs of any shape, as sent, also while disarmed; non-finite values are ignored.

    Pulse widths never fall below 750 µs except to 0 for "off"; PX4's DShot runs to 1999 and idles far below that, and
    its simulators send 150..1000. The range is that of the parameters, where it holds the outputs: of PX4's ``drivers``
    (``MotorGeometry.drivers``), or ArduPilot's MOT_PWM_MIN and MOT_PWM_MAX; where they are 0, and in ArduCopter before
    3.4, which has neither, that of the throttle's input.
    """
    values = np.unique(outputs[np.isfinite(outputs)])
    running = values[values > 0]
    if not len(running):
        return OutputScale("unknown", "", 0.0, 1.0, 0.0)
    step = float(np.diff(values).min()) if len(values) > 1 else 0.0
    least = float(running[0])
    most = float(running[-1])
    driver = drivers[0][0] if drivers else ""
    own = _px4_range(drivers, parameters)
    if not driver.startswith("PWM") and 1.05 < most <= own[1]:
        return OutputScale("UAVCAN" if driver.startswith("UAVCAN") else "0-1000", "", *own, step)
    if least >= 750 and 1000 < most <= 2300:
        throttle = f"RC{parameters['RCMAP_THROTTLE']:.0f}" if "RCMAP_THROTTLE" in parameters else ""
        ends = (
            (parameters.get(f"{name}_MIN", 0.0), parameters.get(f"{name}_MAX", 0.0))
            for name in (() if drivers else ("MOT_PWM", throttle))
        )
        # Pulse widths outside are of disarmed and arming motors, or damaged; 300 µs is a speed controller's range.
        low, high = next(
            (
                (low, high)
                for low, high in (own, *ends)
                if low > 0
                and high - low >= 300
                and np.mean((running < low) | (running > high + 1)) <= 0.5
            ),
            (1000.0, 2000.0),
        )
        stop = _ardupilot_stop(parameters)
        return OutputScale("PWM", "µs", low, high, step, stop)
    if drivers and 10 < most <= 2047 and "DSHOT_MIN" in parameters:
        return OutputScale(
            "DShot", "", float(round(parameters["DSHOT_MIN"] * MAX_DSHOT)), MAX_DSHOT, step
        )
    # By the largest value; from 1.05 to 10 it is DShot too, hardly above idle.
    scales = [
        (1.05, "normalised", 1.0),
        (10.0, "DShot", 2000.0),
        (1000.0, "0-1000", 1000.0),
        (2047.0, "DShot", 2000.0),
    ]
    scales += [(MAX_UAVCAN, "UAVCAN", MAX_UAVCAN)] if drivers else []
    name, high = next(
        ((name, high) for bound, name, high in scales if most <= bound), ("unknown", most)
    )
    return OutputScale(name, "", 0.0, high, step)


def _px4_range(drivers: Sequence[Driver], parameters: Parameters) -> Interval:
    """Outputs at no and at full throttle, the mean over the motors; 0 and 0 where one has none.

    A channel has a range of its own or, where that is -1 and before PX4 1.12, that of its driver.
    """
    ends: tuple[list[float], list[float]] = [], []
    for driver, n in drivers:
        for values, end in zip(ends, ("MIN", "MAX"), strict=True):
            names = (
                f"{driver}_{end}{n}",
                f"{driver}_{end}",
                f"PWM_{end}" if driver == "PWM_MAIN" else "",
            )
            values += [parameters[name] for name in names if parameters.get(name, 0.0) > 0][:1]
    whole = min(map(len, ends)) == len(drivers) > 0
    return (float(np.mean(ends[0])), float(np.mean(ends[1]))) if whole else (0.0, 0.0)


def _ardupilot_stop(parameters: Parameters) -> float:
    """The share of the range at which ArduPilot's mixer stops, by the parameter of its version; 1 without one.

    MOT_SPIN_MAX from ArduCopter 3.4 on; MOT_THST_MAX in 3.3, of what is above THR_MIN; MOT_TCRV_MAXPCT before. Source:
    ``AP_MotorsMulticopter`` and, before, ``AP_Motors`` of https://github.com/ArduPilot/ardupilot.
    """
    stop = 1.0
    idle = parameters.get("THR_MIN", 0.0) / 1000
    if "MOT_SPIN_MAX" in parameters:
        stop = parameters["MOT_SPIN_MAX"]
    elif "MOT_THST_MAX" in parameters:
        stop = idle + (1 - idle) * parameters["MOT_THST_MAX"]
    elif parameters.get("MOT_TCRV_ENABLE"):
        stop = parameters.get("MOT_TCRV_MAXPCT", 100.0) / 100
    return stop if 0.5 <= stop <= 1 else 1.0
