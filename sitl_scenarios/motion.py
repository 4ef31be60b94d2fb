"""Motion: states, inputs and disturbances of a simulated flight, row by row."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Pair = tuple[float, float]
Progress = Callable[[float], None]  # called with how far it is
Arrays = dict[str, NDArray[Any]]


@dataclass(frozen=True, eq=False)
class Motion:
    """Rows of a simulated flight, one each cycle of the autopilot.

    North-east-down (NED) with the origin where the vehicle stands at first; body axes forward, right, down (FRD).
    """

    time: Array  # (N,) seconds since the autopilot's boot
    position: Array  # with velocity: (N, 3) NED, m and m/s
    velocity: Array
    attitude: Array  # (N, 4) unit quaternions (w, x, y, z) from body to NED
    rates: Array  # (N, 3) body rates p, q, r, rad/s
    # The autopilot's estimates of them, with noise and delay; shapes and units likewise.
    known_attitude: Array
    known_rates: Array
    gyro: Array  # (N, 3) body rates before the gyro's filters, with what shakes it, rad/s
    known_position: Array
    known_velocity: Array
    # (N, 4) motor commands as the autopilot puts them out, PWM in µs, quantised as it does
    outputs: Array
    # (N, 4) what it asked the mixer for: roll, pitch, yaw (−1 to 1) and thrust (0 to 1)
    demands: Array
    # Setpoints of the autopilot's loops, zero on the ground: (N, 3) roll, pitch and yaw, rad; body rates, rad/s.
    attitude_setpoint: Array
    rates_setpoint: Array
    # (N, 3) what a pilot's sticks ask for: roll, pitch (rad) and yaw rate (rad/s); zero without a pilot
    sticks: Array
    rotor_speeds: Array  # (N, 4) rad/s
    # (N,) share of the voltage of a charged battery, and of the rotors' speed with it, that is left
    battery: Array
    wind: Array  # (N, 3) NED, m/s, at the vehicle, where the air moves *to*
    # force (N, 3) NED, N, and moment (N, 3) body, N m, of the wind and whatever else disturbs; without rotors'
    # thrust and torque in still air, and without gravity. The air's drag and damping of roll and pitch are in them.
    # Zero on the ground.
    force: Array
    moment: Array
    armed: Flags  # (N,) bool
    # (N,) MAV_LANDED_STATE: 1 on the ground, 2 in the air, 3 taking off, 4 landing
    landed_state: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.time)

    def __getitem__(self, rows: slice | NDArray[np.intp]) -> Motion:
        return Motion(*(column[rows] for column in vars(self).values()))


def joined(pieces: Sequence[Motion]) -> Motion:
    """Returns one motion, of pieces that follow each other."""
    columns = zip(*(vars(piece).values() for piece in pieces), strict=True)
    return Motion(*map(np.concatenate, columns))
