"""Motors of a multirotor: the messages with their outputs, and channel, position and rotation of each motor.

``motor_geometry`` finds them by the autopilot's parameters, or assumes them; ``MotorGeometry`` reports which it was.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from math import atan2, degrees
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.containers import Names
from mavdem.facts import Fact
from mavdem.facts.sources import SourceFact
from mavdem.ingest.vocabulary import NAMES, UNNAMED

MOTOR_COUNTS = {
    "TRICOPTER": 3,
    "QUADROTOR": 4,
    "HEXAROTOR": 6,
    "OCTOROTOR": 8,
    "DECAROTOR": 10,
    "DODECAROTOR": 12,
}
"""Number of motors of each MAV_TYPE (without its prefix) that has a fixed number."""

MULTIROTORS = (*MOTOR_COUNTS, "GENERIC_MULTIROTOR")
"""MAV_TYPEs of vehicles that fly by fixed-pitch rotors alone."""

POSSIBLE_MULTIROTORS = (*MULTIROTORS, UNNAMED)
"""MAV_TYPEs of vehicles that are analysed: multirotors, and vehicles whose type is not known."""

PORT_OUTPUTS = 16
"""Number of output fields of SERVO_OUTPUT_RAW, servo1_raw to servo16_raw (MAVLink ``common.xml``)."""


class MotorMessage(NamedTuple):
    """How one kind of MAVLink message carries motor outputs.

    Either one array field has all outputs, or each output has a field of its own, and the field ``port`` says to which
    bank of channels they belong.
    """

    field: str
    """Name of the array field; of a message with a field per output, the pattern of their names: ``servo{}_raw``."""
    is_ported: bool = False
    """Whether the message has a field per output, and ``port``."""

    @property
    def fields(self) -> Names:
        """Names of the fields that are read: the array alone, or ``port`` and then each output's field."""
        if not self.is_ported:
            return (self.field,)
        outputs = (self.field.format(number) for number in range(1, PORT_OUTPUTS + 1))
        return ("port", *outputs)


MOTOR_MESSAGES = {
    "SERVO_OUTPUT_RAW": MotorMessage("servo{}_raw", is_ported=True),
    "ACTUATOR_OUTPUT_STATUS": MotorMessage("actuator"),
    "HIL_ACTUATOR_CONTROLS": MotorMessage("controls"),
}
"""MAVLink messages with motor outputs, the preferred first. Adding one here makes logs and live streams read it."""


class ChannelSource(StrEnum):
    """What assigned output channels to motors."""

    DEMAND = "demand"
    """There are no motors: the one input is the controller's demand."""
    PX4_FUNCTIONS = "px4_functions"
    """PX4's parameters, such as PWM_MAIN_FUNC1."""
    SERVO_FUNCTIONS = "servo_functions"
    """ArduPilot's parameters SERVO1_FUNCTION, SERVO2_FUNCTION and so on."""
    MOVING_CHANNELS = "moving_channels"
    """An assumption: the channels whose outputs change, in order."""
    FIRST_CHANNELS = "first_channels"
    """An assumption: the first channels of the bank, since some motor's output never changes."""


class PositionSource(StrEnum):
    """What gave the positions of the motors."""

    PARAMETERS = "parameters"
    """The autopilot's parameters."""
    X_QUAD = "x_quad"
    """An assumption: the X quadrotor, by far the most common frame."""
    UNKNOWN = "unknown"
    """Nothing: the positions are not known."""


Position = tuple[float, float]
"""Where a motor is from the centre of mass: (forward, right).

In metres where PX4's parameters give it, else on a circle of radius 1 (ArduPilot's parameters name a frame only).
"""


class OutputDriver(NamedTuple):
    """One output of one of PX4's output drivers, as its parameters name it: ("PWM_MAIN", 1)."""

    name: str
    """Prefix of the driver's parameters: PWM_MAIN, PWM_AUX, DSHOT, UAVCAN_EC …"""
    channel: int
    """Number of the output there, from 1."""


@dataclass(frozen=True)
class MotorGeometry:
    """The motors of one vehicle in the order of their numbers; all tuples have one element per motor."""

    motors: tuple[int, ...]
    """Numbers of the motors, from 1, ascending."""
    channels: tuple[int, ...]
    """Output channel that drives each motor, from 1."""
    positions: tuple[Position, ...]
    """Position of each motor, forward and right; empty where positions are not known."""
    channel_source: ChannelSource = ChannelSource.SERVO_FUNCTIONS
    """What assigned the channels."""
    position_source: PositionSource = PositionSource.PARAMETERS
    """What gave the positions."""
    labels: Names = ()
    """Names of the inputs where they are not motors; else empty."""
    spins: tuple[int, ...] = ()
    """1 for a propeller that turns counterclockwise seen from above, -1 for clockwise; empty where not known."""
    drivers: tuple[OutputDriver, ...] = ()
    """PX4's output driver of each channel; empty for other autopilots."""

    @property
    def channels_assumed(self) -> bool:
        """Whether the channels are an assumption, for want of parameters."""
        return self.channel_source in (ChannelSource.MOVING_CHANNELS, ChannelSource.FIRST_CHANNELS)

    @property
    def positions_assumed(self) -> bool:
        """Whether the positions are an assumption or not known, for want of parameters."""
        return self.position_source is not PositionSource.PARAMETERS

    @property
    def assumed(self) -> bool:
        """Whether channels or positions are an assumption."""
        return self.channels_assumed or self.positions_assumed

    @property
    def basis(self) -> Fact:
        """The fact that names the source of the motors' channels and positions: parameters, or which assumption."""
        return Fact(
            SourceFact.MOTOR_BASIS,
            channels_by=self.channel_source,
            places_by=self.position_source,
            count=len(self.channels),
        )

    @property
    def names(self) -> Names:
        """One name per motor: ``motor 1 (front right)``, or ``motor 1`` where positions are not known."""
        if self.labels:
            return self.labels
        if not self.positions:
            return tuple(f"motor {motor}" for motor in self.motors)
        return tuple(
            f"motor {motor} ({position_name(position)})"
            for motor, position in zip(self.motors, self.positions, strict=True)
        )

    def mixer_row(self, axis: str) -> Array | None:
        """Computes how much each motor contributes to the torque about an axis, from the geometry alone.

        Thrust acts upwards, so a motor on the left rolls the vehicle to the right (positive roll), and a motor in front
        raises the nose (positive pitch). A propeller turns the vehicle against its own direction, so one that turns
        counterclockwise yaws the nose to the right (positive yaw). On an X quadrotor the row of roll is (left motors −
        right motors) / 4.

        Args:
            axis: "roll", "pitch" or "yaw".

        Returns:
            Weights (k,) of the k motors, whose magnitudes sum to 1; None if the geometry is not known, or no motor acts
            on the axis.
        """
        levers: Iterable[float]
        if axis == "roll":
            levers = [-right for _, right in self.positions]
        elif axis == "pitch":
            levers = [forward for forward, _ in self.positions]
        else:
            # The yaw torque is the reaction to the drag of the propellers: equal for all motors except for the sign.
            levers = self.spins
        weights = np.array(levers, np.float64)
        total = abs(weights).sum()
        return weights / total if total > 0 else None


def motor_parameters(autopilot: str) -> Names:
    """Lists the parameters about the positions of motors and about their response.

    Args:
        autopilot: MAV_AUTOPILOT without its prefix ("PX4").

    Returns:
        Names of parameters, of each of the motors 1 to 8 where a parameter is of a motor; empty for an autopilot
        without such a list.
    """
    patterns = NAMES["motor_parameters"].get(autopilot, ())
    names: dict[str, None] = {}
    for pattern in patterns:
        for motor in range(1, 9):
            # ArduPilot numbers motors from 1, PX4's control allocation from 0.
            names[pattern.format(motor, motor - 1)] = None
    return tuple(names)


def control_parameters(autopilot: str) -> Names:
    """Lists the parameters of the rate and attitude controllers of all axes.

    Args:
        autopilot: MAV_AUTOPILOT without its prefix ("PX4").

    Returns:
        Names of parameters; empty for an autopilot without such a list.
    """
    patterns = NAMES["control_parameters"].get(autopilot, ())
    axes = NAMES["control_axes"].get(autopilot, ())
    names: dict[str, None] = {}
    for pattern in patterns:
        for axis in axes:
            names[pattern.format(axis)] = None
    return tuple(names)


def lean_limit_parameters(autopilot: str) -> Names:
    """Lists the parameters that limit how far the vehicle leans, by which the wind of a flight is judged.

    Args:
        autopilot: MAV_AUTOPILOT without its prefix ("PX4").

    Returns:
        Names of parameters, such as "MPC_TILTMAX_AIR"; empty for an autopilot without such a list.
    """
    return tuple(NAMES["lean_limit_parameters"].get(autopilot, ()))


def demand_geometry(axis: str) -> MotorGeometry:
    """Makes the geometry for a model whose one input is the controller's demand on an axis, not the motors.

    The demand acts like a single motor whose mixer row for this axis is 1.

    Args:
        axis: "roll", "pitch" or "yaw".

    Returns:
        A geometry with one motor.
    """
    positions = {"roll": (0.0, -1.0), "pitch": (1.0, 0.0), "yaw": (0.0, 0.0)}
    return MotorGeometry(
        motors=(1,),
        channels=(1,),
        positions=(positions[axis],),
        channel_source=ChannelSource.DEMAND,
        labels=(f"{axis} demand",),
        spins=(1,),
    )


POSITION_NAMES = {
    0: "front",
    1: "front right",
    2: "right",
    3: "rear right",
    4: "rear",
    -4: "rear",
    -3: "rear left",
    -2: "left",
    -1: "front left",
}
"""Name of each of the eight directions, by the number of eighths of a turn clockwise from the nose."""


def position_name(position: Position) -> str:
    """Returns the direction of a motor from the centre of mass, in words: ``front right``.

    The direction is rounded to the nearest multiple of 45°.

    Args:
        position: Distances forward and to the right of the centre, in any unit.
    """
    forward, right = position
    bearing = degrees(atan2(right, forward))
    return POSITION_NAMES[round(bearing / 45)]


def name_without_place(name: str) -> str:
    """Returns the name of a motor without its place, as the autopilot reports it: ``motor 1``.

    Args:
        name: A name of ``MotorGeometry.names``, such as ``motor 1 (front right)``.
    """
    return name.partition(" (")[0]
