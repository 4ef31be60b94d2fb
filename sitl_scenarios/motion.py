"""Motion: what a simulated vehicle did and what drove it, row by row."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Motion:
    """Rows of a simulated flight, one each cycle of the autopilot.

    North-east-down (NED) with the origin where the vehicle stands at first; body axes forward, right, down (FRD).

    Attributes:
        time: (N,) seconds since the autopilot's boot.
        position, velocity: (N, 3) NED, m and m/s.
        attitude: (N, 4) unit quaternions (w, x, y, z) from body to NED.
        rates: (N, 3) body rates p, q, r, rad/s.
        known_attitude, known_rates, known_position, known_velocity: what the autopilot knows of them, with noise and
            delay; shapes and units likewise.
        outputs: (N, 4) motor commands as the autopilot puts them out, PWM in µs, quantised as it does.
        demands: (N, 4) what it asked the mixer for: roll, pitch, yaw (−1 to 1) and thrust (0 to 1).
        rotor_speeds: (N, 4) rad/s.
        battery: (N,) share of the voltage of a charged battery, and of the rotors' speed with it, that is left.
        wind: (N, 3) NED, m/s, at the vehicle, where the air moves *to*.
        force: (N, 3) NED, N, and moment: (N, 3) body, N m, of the wind and whatever else disturbs; without rotors'
            thrust and torque in still air, and without gravity. What the air does to a vehicle that moves is in them:
            drag, and damping of roll and pitch. Zero on the ground.
        armed: (N,) bool.
        landed_state: (N,) MAV_LANDED_STATE: 1 on the ground, 2 in the air, 3 taking off, 4 landing.
    """

    time: Array
    position: Array
    velocity: Array
    attitude: Array
    rates: Array
    known_attitude: Array
    known_rates: Array
    known_position: Array
    known_velocity: Array
    outputs: Array
    demands: Array
    rotor_speeds: Array
    battery: Array
    wind: Array
    force: Array
    moment: Array
    armed: NDArray[np.bool_]
    landed_state: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.time)
