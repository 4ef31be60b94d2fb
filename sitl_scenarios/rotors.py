"""Rotors of a multirotor: positions, directions of rotation, mixer and PWM pulses, in the autopilots' motor order.

ArduPilot and PX4 number an X quadrotor alike: 1 front right, 2 rear left, 3 front left, 4 rear right. ArduPilot numbers
a + quadrotor 1 right, 2 left, 3 front, 4 rear; PX4, whose parameters hold the positions, is given the same order. In
both frames rotors 1 and 2 turn counter-clockwise seen from above
(https://ardupilot.org/copter/docs/connect-escs-and-motors.html; PX4's airframe reference). Frames of six and eight
rotors, Y6 and coaxial X8 follow ArduPilot's ``AP_MotorsMatrix.cpp``.
"""

from dataclasses import dataclass
from math import cos, hypot, radians, sin
from typing import Literal, NamedTuple

from sitl_scenarios.motion import Pair
from sitl_scenarios.vectors import Vector4

SPIN_DIRECTIONS = (1.0, 1.0, -1.0, -1.0)
"""Sign of each rotor's torque on the body about the down axis.

1: the rotor turns counter-clockwise seen from above, so that its torque turns the body clockwise, to positive yaw.
"""

IDLE_COMMAND = 0.1
"""Lowest normalised command of an armed motor, as a fraction of the full command; a choice."""

MIN_PULSE = 1000.0
"""PWM pulse width of a command of 0, µs."""

MAX_PULSE = 2000.0
"""PWM pulse width of the full command, µs."""

DISARMED_PULSE = {"px4": 900.0, "ardupilot": 1000.0}
"""PWM pulse width of a disarmed motor, µs, by autopilot: PX4's PWM_MAIN_DISn is set to 900."""


Shape = Literal["x", "plus", "hexa_x", "hexa_plus", "octa_x", "y6", "coaxial_x8"]
"""Arrangement of the rotors."""


@dataclass(frozen=True)
class RotorCircle:
    """A frame whose arms are of equal length: where each rotor is, and in which direction it turns."""

    bearings: tuple[float, ...]
    """Bearing of each rotor, degrees clockwise from the nose; two rotors of one bearing share an arm."""
    directions: str
    """A sign for each rotor: "+" turns counter-clockwise seen from above, "-" clockwise."""
    size: float
    """Length of its arms divided by the quadrotor's, so that propellers of the same size do not touch."""
    frame_class: int
    """ArduPilot's FRAME_CLASS."""
    frame_type: int
    """ArduPilot's FRAME_TYPE."""
    px4_airframe: int
    """PX4's SYS_AUTOSTART of the generic frame."""


CIRCLES = {
    "hexa_x": RotorCircle((90, -90, -30, 150, 30, -150), "-+-++-", 1.5, 2, 1, 6001),
    "hexa_plus": RotorCircle((0, 180, -120, 60, -60, 120), "-+-++-", 1.5, 2, 0, 7001),
    "octa_x": RotorCircle(
        (22.5, -157.5, 67.5, 157.5, -22.5, -112.5, -67.5, 112.5), "--++++--", 2.0, 3, 1, 8001
    ),
    "y6": RotorCircle((60, -60, -60, 180, 60, 180), "+-+--+", 1.0, 5, 0, 11001),
    "coaxial_x8": RotorCircle(
        (45, -45, -135, 135, -45, 45, 135, -135), "+-+-+-+-", 1.0, 4, 1, 12001
    ),
}
"""Frames of more than four rotors by their ``Shape`` (AP_MotorsMatrix.cpp; PX4's airframe reference)."""


class RotorFrame(NamedTuple):
    """Positions of rotors and their mixer, in the autopilots' order of motors."""

    forward: Vector4
    """Position of each rotor forward of the centre of mass, m."""
    right: Vector4
    """Position of each rotor to the right of the centre of mass, m."""
    roll: Vector4
    """What a roll demand of 1 adds to the normalised command of each motor."""
    pitch: Vector4
    """What a pitch demand of 1 adds to the normalised command of each motor."""
    yaw: Vector4
    """What a yaw demand of 1 adds to the normalised command of each motor: the sign of its torque about down."""


def rotor_count(shape: Shape) -> int:
    """Returns the number of rotors of a frame."""
    if shape in CIRCLES:
        return len(CIRCLES[shape].bearings)
    return len(SPIN_DIRECTIONS)


def rotor_frame(shape: Shape, arm: Pair) -> RotorFrame:
    """Returns the positions of a frame's rotors, and its mixer: what each demand adds to each motor's command.

    Args:
        shape: Arrangement of the rotors.
        arm: Distances forward and to the right, m, of the rotors of an X quadrotor from the centre of mass. Their
            distance from the centre is also the arm of a + quadrotor, and times ``size`` the arm of a larger frame.

    Returns:
        Positions (n,), m, and columns of the mixer (n,) for roll, pitch and yaw.
    """
    radius = hypot(*arm)
    if shape in CIRCLES:
        return _circle_frame(CIRCLES[shape], radius)
    if shape == "plus":
        # Motors 1 to 4 are right, left, in front and behind.
        forward_signs = (0.0, 0.0, 1.0, -1.0)
        right_signs = (1.0, -1.0, 0.0, 0.0)
        forward_arm, right_arm = radius, radius
    else:
        # Motors 1 to 4 are front right, rear left, front left and rear right.
        forward_signs = (1.0, -1.0, 1.0, -1.0)
        right_signs = (1.0, -1.0, -1.0, 1.0)
        forward_arm, right_arm = arm
    # Thrust acts upwards: a rotor on the left rolls the body to the right, one in front raises the nose.
    return RotorFrame(
        forward=tuple(sign * forward_arm for sign in forward_signs),
        right=tuple(sign * right_arm for sign in right_signs),
        roll=tuple(-sign for sign in right_signs),
        pitch=forward_signs,
        yaw=SPIN_DIRECTIONS,
    )


def _circle_frame(circle: RotorCircle, radius: float) -> RotorFrame:
    """Returns positions and mixer of a frame whose rotors are on a circle.

    Each column of the mixer is scaled so that its largest element is 1, as both autopilots scale theirs.

    Args:
        circle: Bearings, directions of rotation and relative size of the circle.
        radius: Length of the arms of the quadrotor of the same propellers, m.

    Returns:
        Positions (n,), m, and columns of the mixer (n,).
    """
    arm = circle.size * radius
    # Positions on a circle of radius 1. They are rounded, so that a rotor on an axis is exactly there.
    unit_forward = [round(cos(radians(bearing)), 9) for bearing in circle.bearings]
    unit_right = [round(sin(radians(bearing)), 9) for bearing in circle.bearings]
    largest_forward = max(map(abs, unit_forward))
    largest_right = max(map(abs, unit_right))
    return RotorFrame(
        forward=tuple(arm * forward for forward in unit_forward),
        right=tuple(arm * right for right in unit_right),
        # Thrust acts upwards: a rotor on the right rolls the body to the left.
        roll=tuple(-right / largest_right for right in unit_right),
        pitch=tuple(forward / largest_forward for forward in unit_forward),
        yaw=tuple(1.0 if sign == "+" else -1.0 for sign in circle.directions),
    )


def mixed_commands(frame: RotorFrame, demands: Vector4) -> Vector4:
    """Distributes demands of roll, pitch, yaw and thrust over the motors, within their limits.

    A motor's command is the thrust demand plus what roll, pitch and yaw add to it (the differential part). If a motor
    would leave its range, ``IDLE_COMMAND`` to 1, the thrust demand is raised or lowered first, so that the vehicle
    stays upright. If the differential part alone is wider than the range, roll, pitch and yaw are scaled down alike.

    Args:
        frame: Mixer of the vehicle.
        demands: (4,) roll, pitch and yaw, −1 to 1, and thrust, 0 to 1.

    Returns:
        Normalised command of each motor (n,), ``IDLE_COMMAND`` to 1.
    """
    roll, pitch, yaw, thrust = demands
    effects = zip(frame.roll, frame.pitch, frame.yaw, strict=True)
    differential = [
        roll * roll_effect + pitch * pitch_effect + yaw * yaw_effect
        for roll_effect, pitch_effect, yaw_effect in effects
    ]
    lowest = min(differential)
    highest = max(differential)
    if highest - lowest > 1.0 - IDLE_COMMAND:
        scale = (1.0 - IDLE_COMMAND) / (highest - lowest)
        differential = [part * scale for part in differential]
        lowest = lowest * scale
        highest = highest * scale
    # Range of the thrust in which no motor saturates.
    min_thrust = IDLE_COMMAND - lowest
    max_thrust = 1.0 - highest
    thrust = min(max(thrust, min_thrust), max_thrust)
    return tuple([part + thrust for part in differential])


def pulse_width(command: float) -> float:
    """Returns the PWM pulse of a normalised command, in whole µs, as the autopilots put it out."""
    microseconds = MIN_PULSE + (MAX_PULSE - MIN_PULSE) * command
    return float(round(microseconds))
