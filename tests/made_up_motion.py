"""A motion that nobody simulated: a hover with a roll that swings, known exactly, for tests of what is said of it."""

import numpy as np

from mavdem.ingest.vocabulary import quaternion
from mavdem.loops.autopilot_parameters import DEFAULT_LOOP_RATES
from sitl_scenarios.motion import Motion
from sitl_scenarios.rotors import DISARMED_PULSE

ARMED = 2.0
UP = 4.0
DOWN = 3.0
"""Seconds from boot to arming; from arming to the hover; from its end to the ground."""
ROLL = 0.2
"""rad, how far the roll swings, at 0.7 Hz."""


def made_up_motion(seconds=20.0, begin=0.0, autopilot="px4"):
    """A flight of so many seconds, on the ground at its ends; its boot clock begins at ``begin``."""
    cycle = 1 / DEFAULT_LOOP_RATES[autopilot]
    count = round(seconds / cycle)
    since = np.arange(count) * cycle
    time = begin + since
    end = seconds - 1.0
    armed = (since >= ARMED) & (since < end)
    state = np.select(
        [since < ARMED + 0.5, since < ARMED + UP, since < end - DOWN, since < end - 0.5],
        [1, 3, 2, 4],
        1,
    ).astype(np.uint8)
    angle = 2 * np.pi * 0.7 * since
    sine = np.sin(angle)
    flying = (state != 1).astype(float)
    roll = flying * ROLL * sine
    pitch = 0.05 + 0 * angle
    yaw = 0.3 + 0 * angle
    rates = np.column_stack(
        [
            flying * ROLL * 2 * np.pi * 0.7 * np.cos(angle),
            0.01 * np.sin(3 * angle),
            0.02 * np.cos(2 * angle),
        ]
    )
    attitude = quaternion(roll, pitch, yaw)
    position = np.column_stack([sine, np.cos(angle), -5 * flying])
    velocity = np.column_stack([np.cos(angle), -sine, 0 * angle])
    swing = 60 * flying * np.sin(angle + 1.0)
    signs = np.array([-1, 1, 1, -1])
    outputs = np.round(
        np.where(armed, 1100 + 400 * flying, DISARMED_PULSE[autopilot])[:, None]
        + swing[:, None] * signs
    )
    return Motion(
        time=time,
        position=position,
        velocity=velocity,
        attitude=attitude,
        rates=rates,
        known_attitude=attitude,
        known_rates=rates,
        gyro=rates,
        known_position=position,
        known_velocity=velocity,
        outputs=outputs,
        demands=np.column_stack([swing / 400, 0 * swing, 0 * swing, 0.5 * flying]),
        attitude_setpoint=np.column_stack([1.2 * roll, 1.1 * pitch, yaw]),
        rates_setpoint=1.3 * rates,
        sticks=np.column_stack([0.5 * roll, 0.1 * sine, 0.2 * np.cos(angle)]),
        rotor_speeds=outputs,
        battery=1.0 - 0.1 * since / seconds,
        wind=np.tile([0.0, -5.0, 0.0], (count, 1)),
        force=np.zeros((count, 3)),
        moment=np.zeros((count, 3)),
        armed=armed,
        landed_state=state,
    )
