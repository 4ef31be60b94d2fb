"""The geometry of a multirotor's motors from its parameters: output channel, position and rotation of each.

Where parameters are missing, channels are assumed from the outputs that change, and positions from the X quadrotor.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from math import cos, radians, sin
from typing import TypeVar

from mavdem.containers import Numbers
from mavdem.files import load_adjacent_toml
from mavdem.ingest.motors import (
    MOTOR_COUNTS,
    ChannelSource,
    MotorGeometry,
    OutputDriver,
    Position,
    PositionSource,
)
from mavdem.ingest.telemetry import Parameters
from mavdem.ingest.vocabulary import NAMES


@dataclass
class _Wiring:
    """Which output channel drives which motor, as an autopilot's parameters say it."""

    channel_of_motor: dict[int, int]
    """Output channel, from 1, by number of the motor, from 1; motors without a parameter are missing."""
    source: ChannelSource
    driver_of_channel: dict[int, OutputDriver] = field(default_factory=dict)
    """PX4's driver of each channel."""
    non_motor_channels: set[int] = field(default_factory=set)
    """Channels that the parameters give to something else, such as a gimbal."""


@dataclass
class _Rotors:
    """Positions and directions of rotation by number of the motor, from 1, as far as they are known."""

    positions: dict[int, Position] = field(default_factory=dict)
    spins: dict[int, int] = field(default_factory=dict)
    """1 for counterclockwise seen from above, -1 for clockwise."""


def motor_geometry(
    vehicle: str,
    autopilot: str,
    parameters: Parameters,
    moving_channels: Sequence[int],
    bank_size: int,
) -> MotorGeometry | None:
    """Finds the motors of a vehicle: channels, positions and directions of rotation.

    Parameters say which output channel drives which motor, and where motors are. What they do not say is assumed:
    channels from the outputs that change, positions of an X quadrotor.

    Args:
        vehicle: MAV_TYPE without its prefix ("QUADROTOR").
        autopilot: MAV_AUTOPILOT without its prefix; any but "PX4" is taken for ArduPilot.
        parameters: The autopilot's parameters by name, as far as the log has them.
        moving_channels: Output channels, from 1, whose outputs change.
        bank_size: Number of channels of a bank. Channels count through all banks; PX4 counts the outputs of each
            driver, which fills a bank, from 1.

    Returns:
        The geometry; None if no channel can be a motor's.
    """
    if autopilot == "PX4":
        wiring = _px4_wiring(parameters, moving_channels, bank_size)
    else:
        wiring = _ardupilot_wiring(vehicle, parameters)
    channel_of_motor = wiring.channel_of_motor
    channel_source = wiring.source
    # With fewer channels than the vehicle has motors, some of the parameters did not arrive. Then the channels are
    # assumed from those whose outputs change, and numbered as motors 1, 2, … in their order.
    if len(channel_of_motor) < MOTOR_COUNTS.get(vehicle, 1):
        candidates = [
            channel for channel in moving_channels if channel not in wiring.non_motor_channels
        ]
        channels, channel_source = _assumed_channels(
            vehicle, candidates, bank_size, wiring.non_motor_channels
        )
        channel_of_motor = dict(enumerate(channels, 1))
    if not channel_of_motor:
        return None
    motors = tuple(sorted(channel_of_motor))
    channels = [channel_of_motor[motor] for motor in motors]
    if autopilot == "PX4":
        rotors = _px4_rotors(parameters)
    else:
        rotors = _ardupilot_rotors(vehicle, parameters, motors)
    rotors, position_source = _rotors_or_assumption(rotors, motors)
    drivers = [
        wiring.driver_of_channel[channel]
        for channel in channels
        if channel in wiring.driver_of_channel
    ]
    return MotorGeometry(
        motors,
        tuple(channels),
        _values_of_all(rotors.positions, motors),
        channel_source,
        position_source,
        spins=_values_of_all(rotors.spins, motors),
        drivers=tuple(drivers),
    )


Value = TypeVar("Value")


def _values_of_all(values: Mapping[int, Value], motors: Sequence[int]) -> tuple[Value, ...]:
    """Returns the value of each motor, or an empty tuple where the value of any motor is not known."""
    if not all(motor in values for motor in motors):
        return ()
    return tuple(values[motor] for motor in motors)


def _assumed_channels(
    vehicle: str, moving_channels: Sequence[int], bank_size: int, non_motor_channels: set[int]
) -> tuple[list[int], ChannelSource]:
    """Guesses the motors' channels from those whose outputs change, where parameters do not state them.

    Usually each motor's output changes. But a motor that stands still, or is at its limit all the time, has a constant
    output. So if at least half as many channels change as there are motors, and all of them are among the first
    channels of a bank, the motors are assumed on these first channels. Tricopters are excepted, since their motors are
    not on consecutive channels.

    Args:
        vehicle: MAV_TYPE without its prefix ("QUADROTOR").
        moving_channels: Channels, from 1, whose outputs change, without ``non_motor_channels``.
        bank_size: Number of channels of a bank.
        non_motor_channels: Channels that drive something else.

    Returns:
        The channels in the order of the motors, and which assumption gave them.
    """
    # If the vehicle's type does not state the number of motors, every channel that changes is taken for one.
    motor_count = MOTOR_COUNTS.get(vehicle, len(moving_channels))
    moving_motors = sorted(moving_channels)[:motor_count]

    # The first channels of the bank with the lowest changing channel, without those that drive something else.
    lowest_channel = min(moving_channels, default=1)
    banks_before = (lowest_channel - 1) // bank_size
    first_channel = banks_before * bank_size + 1
    first_channels: list[int] = []
    for channel in range(first_channel, MAX_SERVO_CHANNELS + 1):
        if channel not in non_motor_channels and len(first_channels) < motor_count:
            first_channels.append(channel)

    some_are_constant = motor_count / 2 <= len(moving_motors) < motor_count
    are_among_first = set(moving_motors) <= set(first_channels)
    if some_are_constant and are_among_first and vehicle != "TRICOPTER":
        return first_channels, ChannelSource.FIRST_CHANNELS
    return moving_motors, ChannelSource.MOVING_CHANNELS


X_QUAD_MOTORS = (1, 2, 3, 4)
"""Motor numbers of a quadrotor. ArduPilot and PX4 number the motors of an X quadrotor in the same order."""


def _rotors_or_assumption(
    rotors: _Rotors, motors: tuple[int, ...]
) -> tuple[_Rotors, PositionSource]:
    """Returns the rotors if the positions of all motors are known, otherwise those of an assumed X quadrotor, or none.

    The X quadrotor is by far the most common frame; it is assumed if the motors are numbers 1 to 4.

    Args:
        rotors: Positions and spins by number of the motor, as far as the parameters have them.
        motors: Numbers of the motors, from 1.

    Returns:
        The rotors, and the source of their positions.
    """
    if all(motor in rotors.positions for motor in motors):
        return rotors, PositionSource.PARAMETERS
    if motors == X_QUAD_MOTORS:
        return _frame_rotors(FRAME_CLASS_QUAD, FRAME_TYPE_X), PositionSource.X_QUAD
    return _Rotors(), PositionSource.UNKNOWN


# ArduPilot.

MAX_SERVO_CHANNELS = 32
"""Number of ArduPilot's output channels: SERVO1_FUNCTION to SERVO32_FUNCTION."""

MOTOR_OF_FUNCTION = {33 + n: 1 + n for n in range(8)} | {82 + n: 9 + n for n in range(4)}
"""Number of the motor by value of SERVOn_FUNCTION: 33 to 40 are motors 1 to 8, 82 to 85 motors 9 to 12.

Source: https://ardupilot.org/copter/docs/parameters.html#servo1-function.
"""

NO_FUNCTION = 0
"""Value of SERVOn_FUNCTION and RCn_FUNCTION of a channel that has no function (Disabled)."""

TRICOPTER_TAIL_SERVO = 7
"""Motor number of a tricopter's servo that tilts the rear motor (ArduPilot ``AP_MotorsTri``, AP_MOTORS_CH_TRI_YAW)."""


def _ardupilot_wiring(vehicle: str, parameters: Parameters) -> _Wiring:
    """Reads from SERVOn_FUNCTION which channel drives which motor; of several channels of a motor, the lowest counts.

    Before ArduCopter 3.5 motors have no function, but a gimbal's channels have RCn_FUNCTION.

    Args:
        vehicle: MAV_TYPE without its prefix ("QUADROTOR").
        parameters: The autopilot's parameters by name.

    Returns:
        The channel of each motor, and the channels that drive something else.
    """
    channel_of_motor: dict[int, int] = {}
    non_motor_channels = set()
    for channel in range(1, MAX_SERVO_CHANNELS + 1):
        function = int(parameters.get(f"SERVO{channel}_FUNCTION", NO_FUNCTION))
        if function in MOTOR_OF_FUNCTION:
            motor = MOTOR_OF_FUNCTION[function]
            # Of several channels the first, lowest one is kept.
            channel_of_motor.setdefault(motor, channel)
        # A log has only one of the two parameters, depending on the version.
        old_function = parameters.get(f"RC{channel}_FUNCTION", function)
        if old_function != NO_FUNCTION and old_function not in MOTOR_OF_FUNCTION:
            non_motor_channels.add(channel)
    if vehicle == "TRICOPTER":
        channel_of_motor.pop(TRICOPTER_TAIL_SERVO, None)
    return _Wiring(
        channel_of_motor, ChannelSource.SERVO_FUNCTIONS, non_motor_channels=non_motor_channels
    )


FRAMES = load_adjacent_toml(__file__, "frames.toml")
"""Motor bearings and directions of rotation of ArduPilot's frames, by FRAME_CLASS and FRAME_TYPE as texts."""

FRAME_CLASS_QUAD = 1
FRAME_TYPE_X = 1
"""Values of ArduPilot's FRAME_CLASS and FRAME_TYPE of an X quadrotor."""

FRAME_CLASS_TRI = 7
"""Value of ArduPilot's FRAME_CLASS of a tricopter."""

TRICOPTER_BEARINGS = {1: 60.0, 2: -60.0, 4: 180.0}
"""Bearing of each motor of a tricopter, degrees clockwise from the nose (``AP_MotorsTri``); there is no motor 3."""

OLD_FRAME_CLASSES = {"QUADROTOR": 1, "HEXAROTOR": 2, "OCTOROTOR": 3}
"""FRAME_CLASS by MAV_TYPE before ArduCopter 3.5, where the class was compiled in and FRAME was the type."""


def _ardupilot_rotors(vehicle: str, parameters: Parameters, motors: Sequence[int]) -> _Rotors:
    """Looks up the rotors of the frame that ArduPilot's parameters name.

    FRAME_CLASS is the class of the frame (quadrotor, hexarotor, …), FRAME_TYPE its arrangement (plus, X, …). Before
    ArduCopter 3.5 the class was compiled in and follows from the vehicle's MAV_TYPE, and FRAME was the type. Logs of
    these versions may lack the MAV_TYPE too; then a vehicle with exactly the motors 1 to 4 is a quadrotor.

    Args:
        vehicle: MAV_TYPE without its prefix ("QUADROTOR").
        parameters: The autopilot's parameters by name.
        motors: Numbers of the motors, ascending.

    Returns:
        The rotors on a circle of radius 1; none if the frame is not known.
    """
    frame_class = int(parameters.get("FRAME_CLASS", 0))
    frame_type = int(parameters.get("FRAME_TYPE", -1))
    if "FRAME_CLASS" not in parameters and "FRAME" in parameters:
        default_class = FRAME_CLASS_QUAD if motors == X_QUAD_MOTORS else 0
        frame_class = OLD_FRAME_CLASSES.get(vehicle, default_class)
        frame_type = int(parameters["FRAME"])
    if frame_class == FRAME_CLASS_TRI:
        positions = {motor: _on_circle(bearing) for motor, bearing in TRICOPTER_BEARINGS.items()}
        return _Rotors(positions)
    return _frame_rotors(frame_class, frame_type)


def _frame_rotors(frame_class: int, frame_type: int) -> _Rotors:
    """Returns the rotors of one of ArduPilot's frames; none if ``frames.toml`` does not have it.

    The table has, for each frame, the bearings of the motors from the nose, degrees clockwise, and a text with a sign
    for each motor, "+" for counterclockwise rotation and "-" for clockwise.

    Args:
        frame_class: ArduPilot's FRAME_CLASS: quadrotor, hexarotor and so on.
        frame_type: Number of its arrangement, FRAME_TYPE.

    Returns:
        Positions on a circle of radius 1, and spins, 1 for counterclockwise and -1 for clockwise, by motor from 1.
    """
    frames_of_class = FRAMES.get(str(frame_class), {})
    bearings: Numbers
    spin_signs: str
    bearings, spin_signs = frames_of_class.get(str(frame_type), ((), ""))
    positions = {motor: _on_circle(bearing) for motor, bearing in enumerate(bearings, 1)}
    spins = {motor: 1 if sign == "+" else -1 for motor, sign in enumerate(spin_signs, 1)}
    return _Rotors(positions, spins)


def _on_circle(bearing: float) -> Position:
    """Returns the position on the unit circle at a bearing, degrees clockwise from the nose."""
    angle = radians(bearing)
    # Rounded, so that a motor on an axis is exactly there.
    return round(cos(angle), 6), round(sin(angle), 6)


# PX4.

MAX_PX4_ROTORS = 12
"""Number of motors of PX4's control allocation: CA_ROTOR0 to CA_ROTOR11, and output functions 101 to 112."""

PX4_MOTOR_FUNCTION_OFFSET = 100
"""Value of {driver}_FUNCn less the number of the motor: 101 is Motor 1 (PX4 ``output_functions.yaml``)."""

MAX_PX4_DRIVER_OUTPUTS = 16
"""Number of outputs of a driver of PX4 at most: {driver}_FUNC1 to {driver}_FUNC16."""

MAX_CONSTANT_FRACTIONS = (0.0, 0.5)
"""Fraction of a driver's motor outputs that may be constant for the driver to fit a bank: first none, then half.

A bank all of whose motor channels change fits for certain. In the second pass half of them may be constant, since a
motor that never ran, or is at its limit, does not change its output.
"""


FRAME_OF_PX4_AIRFRAME = {
    4001: (1, 1),
    5001: (1, 0),
    6001: (2, 1),
    7001: (2, 0),
    8001: (3, 1),
    9001: (3, 0),
}
"""ArduPilot's FRAME_CLASS and FRAME_TYPE by PX4's SYS_AUTOSTART, for PX4's generic multirotors with arms in an X or +.

Their motors have the same numbers, places and spins with both autopilots. Source: the airframe reference
(https://docs.px4.io/main/en/airframes/airframe_reference.html) and PX4's ``MultirotorMixer/geometries``.
"""


def _px4_rotors(parameters: Parameters) -> _Rotors:
    """Reads the rotors from the geometry of PX4's control allocation, CA_ROTORn_PX, _PY and _KM, or from its airframe.

    The allocation counts rotors from 0. KM, torque over thrust, is positive for a rotor that turns counterclockwise.
    Versions before it have the geometry in a file, which only SYS_AUTOSTART names.

    Args:
        parameters: The autopilot's parameters by name.

    Returns:
        Positions (forward, right), m, or on a circle of radius 1 for an airframe, and spins, by motor from 1, as far as
        the parameters have them.
    """
    airframe = int(parameters.get("SYS_AUTOSTART", 0))
    if "CA_ROTOR_COUNT" not in parameters and airframe in FRAME_OF_PX4_AIRFRAME:
        frame_class, frame_type = FRAME_OF_PX4_AIRFRAME[airframe]
        return _frame_rotors(frame_class, frame_type)
    rotors = _Rotors()
    count = min(int(parameters.get("CA_ROTOR_COUNT", 0)), MAX_PX4_ROTORS)
    for index in range(count):
        motor = index + 1
        forward = parameters.get(f"CA_ROTOR{index}_PX")
        right = parameters.get(f"CA_ROTOR{index}_PY")
        moment_ratio = parameters.get(f"CA_ROTOR{index}_KM")
        if forward is not None and right is not None:
            rotors.positions[motor] = (forward, right)
        if moment_ratio:
            rotors.spins[motor] = 1 if moment_ratio > 0 else -1
    return rotors


def _px4_wiring(parameters: Parameters, moving_channels: Sequence[int], bank_size: int) -> _Wiring:
    """Finds which bank of channels each of PX4's output drivers fills, and so the channel of each motor.

    A driver, such as PWM_AUX, has a number of outputs, and a bank is a block of channels in the log. A parameter such
    as PWM_AUX_FUNC3 names the motor on an output of a driver, but no message states which bank of channels belongs to
    which driver. Drivers are tried in a fixed order, the most common first: each gets the first free bank in which all
    its motor outputs change. Drivers without such a bank are tried again, with a limit at which half of their outputs
    may be constant (``MAX_CONSTANT_FRACTIONS``).

    Args:
        parameters: The autopilot's parameters by name.
        moving_channels: Channels, from 1, whose outputs change.
        bank_size: Number of channels of a bank; there are two banks.

    Returns:
        The channel of each motor, and driver and output of each channel.
    """
    wiring = _Wiring({}, ChannelSource.PX4_FUNCTIONS)
    # Before PX4 1.13, which has no *_FUNCn, the first bank has the main outputs, the second the auxiliary ones.
    for channel in range(1, bank_size + 1):
        wiring.driver_of_channel[channel] = OutputDriver("PWM_MAIN", channel)
        wiring.driver_of_channel[bank_size + channel] = OutputDriver("PWM_AUX", channel)
    # A bank is given by the number of channels before it.
    free_banks = [0, bank_size]
    for max_constant_fraction in MAX_CONSTANT_FRACTIONS:
        for driver in NAMES["px4_drivers"]:
            outputs = _px4_motor_outputs(parameters, driver)
            # An output for a motor that already has a channel of an earlier driver is a spare one, and is left out.
            new_outputs = {
                motor: output
                for motor, output in outputs.items()
                if motor not in wiring.channel_of_motor
            }
            bank = _matching_bank(
                free_banks, new_outputs.values(), moving_channels, max_constant_fraction
            )
            if bank is None:
                continue
            free_banks.remove(bank)
            for motor, output in new_outputs.items():
                wiring.channel_of_motor[motor] = bank + output
                wiring.driver_of_channel[bank + output] = OutputDriver(driver, output)
    return wiring


def _px4_motor_outputs(parameters: Parameters, driver: str) -> dict[int, int]:
    """Returns the output of each motor that a driver drives, by its parameters {driver}_FUNCn.

    Args:
        parameters: The autopilot's parameters by name.
        driver: Name of the driver, such as "PWM_AUX".

    Returns:
        Outputs, from 1, by motor, from 1.
    """
    outputs = {}
    for output in range(1, MAX_PX4_DRIVER_OUTPUTS + 1):
        function = int(parameters.get(f"{driver}_FUNC{output}", 0))
        motor = function - PX4_MOTOR_FUNCTION_OFFSET
        if 1 <= motor <= MAX_PX4_ROTORS:
            outputs[motor] = output
    return outputs


def _matching_bank(
    free_banks: Sequence[int],
    motor_outputs: Iterable[int],
    moving_channels: Sequence[int],
    max_constant_fraction: float,
) -> int | None:
    """Returns the first bank of output channels that can be the outputs of one of PX4's output drivers.

    The log has the driver's outputs in a block of successive channels, a bank, but does not state in which. If the bank
    is right, the outputs to which motors are connected change in flight.

    Args:
        free_banks: Banks without a driver, each given by the number of channels before it: output n of a driver is on
            channel bank + n.
        motor_outputs: The driver's outputs to which motors are connected, from 1.
        moving_channels: Channels, from 1, whose outputs change.
        max_constant_fraction: Fraction of the motor outputs that may be constant, 0 to 1.

    Returns:
        The number of channels before the bank; None if no bank matches.
    """
    distinct_outputs = set(motor_outputs)
    if not distinct_outputs:
        return None
    for bank in free_banks:
        channels = {bank + output for output in distinct_outputs}
        constant_channels = channels - set(moving_channels)
        if len(constant_channels) <= max_constant_fraction * len(channels):
            return bank
    return None
