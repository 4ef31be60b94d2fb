"""Rotor frame and mixer: where the rotors are, and from demands to motor commands in µs.

ArduPilot and PX4 count an X quad alike: 1 front right, 2 rear left, 3 front left, 4 rear right. ArduPilot counts a + as
1 right, 2 left, 3 front, 4 rear; PX4, whose parameters hold the places, is given the same. In both
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
"""Which motor of an X frame, from 0 in our order, is the paper's first, second, third and fourth. The AR.Drone counts
clockwise from the front left, hence [1 −1 −1 1] in roll: front left, front right, rear right, rear left."""


class RotorFrame(NamedTuple):
    """Rotors in the autopilots' order."""

    forward: Four  # with right: place of each rotor from the centre of mass, m
    right: Four
    roll: Four  # with pitch, yaw: what a demand of 1 adds to the normalised command of each motor
    pitch: Four
    yaw: Four


def frame(kind: Literal["x", "plus"], arm: tuple[float, float]) -> RotorFrame:
    """The frame of a vehicle; ``arm``: how far forward and right the rotors of the X are, m; of the + as far out."""
    forward: Four = (1.0, -1.0, 1.0, -1.0)
    right: Four = (1.0, -1.0, -1.0, 1.0)
    if kind == "plus":
        forward, right, arm = (0.0, 0.0, 1.0, -1.0), (1.0, -1.0, 0.0, 0.0), (hypot(*arm),) * 2
    # Thrust acts upwards: a rotor on the left rolls to the right, one in front raises the nose.
    return RotorFrame(_scaled(forward, arm[0]), _scaled(right, arm[1]), _scaled(right, -1.0), forward, SPINS)


def _scaled(four: Four, factor: float) -> Four:
    a, b, c, d = four
    return a * factor, b * factor, c * factor, d * factor


IDLE_COMMAND = 0.1  # Of full command: what an armed motor turns at, at least


def mix(frame: RotorFrame, demands: Four) -> Four:
    """Normalised commands of the motors, ``IDLE_COMMAND`` to 1.

    ``demands`` are roll, pitch, yaw (−1 to 1) and thrust (0 to 1). Where a motor would saturate, thrust gives way
    first, so that the vehicle stays upright, and then all of roll, pitch and yaw alike.
    """
    roll, pitch, yaw, thrust = demands
    a, b, c, d = (roll * r + pitch * p + yaw * s for r, p, s in zip(frame.roll, frame.pitch, frame.yaw, strict=True))
    lowest, highest = min(a, b, c, d), max(a, b, c, d)
    if highest - lowest > 1.0 - IDLE_COMMAND:
        scale = (1.0 - IDLE_COMMAND) / (highest - lowest)
        a, b, c, d = a * scale, b * scale, c * scale, d * scale
        lowest, highest = lowest * scale, highest * scale
    thrust = min(max(thrust, IDLE_COMMAND - lowest), 1.0 - highest)
    return a + thrust, b + thrust, c + thrust, d + thrust


MIN_PULSE, MAX_PULSE = 1000.0, 2000.0  # Of no command and of a full one
DISARMED_PULSE = {"px4": 900.0, "ardupilot": 1000.0}  # µs of a disarmed motor, by autopilot


def pulse(command: float) -> float:
    """A normalised command as it is put out: whole µs."""
    return float(round(MIN_PULSE + (MAX_PULSE - MIN_PULSE) * command))
