"""Motion: states, inputs and disturbances of a simulated flight, row by row."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


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
    known_position: Array
    known_velocity: Array
    outputs: Array  # (N, 4) motor commands as the autopilot puts them out, PWM in µs, quantised as it does
    demands: Array  # (N, 4) what it asked the mixer for: roll, pitch, yaw (−1 to 1) and thrust (0 to 1)
    # Setpoints of the autopilot's loops, zero on the ground: (N, 3) roll, pitch and yaw, rad; body rates, rad/s.
    attitude_setpoint: Array
    rates_setpoint: Array
    sticks: Array  # (N, 3) what a pilot's sticks ask for: roll, pitch (rad) and yaw rate (rad/s); zero without a pilot
    rotor_speeds: Array  # (N, 4) rad/s
    battery: Array  # (N,) share of the voltage of a charged battery, and of the rotors' speed with it, that is left
    wind: Array  # (N, 3) NED, m/s, at the vehicle, where the air moves *to*
    # force (N, 3) NED, N, and moment (N, 3) body, N m, of the wind and whatever else disturbs; without rotors'
    # thrust and torque in still air, and without gravity. The air's drag and damping of roll and pitch are in them.
    # Zero on the ground.
    force: Array
    moment: Array
    armed: NDArray[np.bool_]  # (N,) bool
    landed_state: NDArray[np.uint8]  # (N,) MAV_LANDED_STATE: 1 on the ground, 2 in the air, 3 taking off, 4 landing

    def __len__(self) -> int:
        return len(self.time)
