"""Frames: where a quadrotor's four rotors are, which way they turn, and in which order they are counted.

ArduPilot and PX4 count an X quad alike: 1 front right, 2 rear left, 3 front left, 4 rear right. ArduPilot counts a + as
1 right, 2 left, 3 front, 4 rear; under PX4, which is told the places by its parameters, it is given the same. In both
frames, 1 and 2 turn counter-clockwise seen from above. Sources: for ArduPilot
https://ardupilot.org/copter/docs/connect-escs-and-motors.html, for PX4 its airframe reference.
"""

from __future__ import annotations

from math import hypot
from typing import Literal, NamedTuple

Four = tuple[float, float, float, float]

SPINS: Four = (1.0, 1.0, -1.0, -1.0)
"""1: the rotor turns counter-clockwise seen from above, and its torque turns the body clockwise: positive yaw."""

PAPER_ORDER = (2, 0, 3, 1)
"""Which motor of an X frame, from 0 in our order, is the paper's first, second, third and fourth.

The AR.Drone counts clockwise from the front left, hence [1 −1 −1 1] in roll: front left, front right, rear right, rear
left.
"""


class Frame(NamedTuple):
    """Rotors in the autopilots' order.

    Attributes:
        forward, right: place of each rotor from the centre of mass, m.
        roll, pitch, yaw: what a demand of 1 adds to the normalised command of each motor.
    """

    forward: Four
    right: Four
    roll: Four
    pitch: Four
    yaw: Four


def frame(kind: Literal["x", "plus"], arm: tuple[float, float]) -> Frame:
    """The frame of a vehicle.

    Args:
        kind: which one.
        arm: how far forward and how far right the rotors of the X are, m; those of the + are as far from the centre.
    """
    if kind == "x":
        signs_forward: Four = (1.0, -1.0, 1.0, -1.0)
        signs_right: Four = (1.0, -1.0, -1.0, 1.0)
        ahead, aside = arm
    else:
        signs_forward, signs_right = (0.0, 0.0, 1.0, -1.0), (1.0, -1.0, 0.0, 0.0)
        ahead = aside = hypot(*arm)
    # Thrust acts upwards: a rotor on the left rolls to the right, one in front raises the nose.
    return Frame(
        forward=_scaled(signs_forward, ahead),
        right=_scaled(signs_right, aside),
        roll=_scaled(signs_right, -1.0),
        pitch=signs_forward,
        yaw=SPINS,
    )


def _scaled(four: Four, factor: float) -> Four:
    a, b, c, d = four
    return a * factor, b * factor, c * factor, d * factor
