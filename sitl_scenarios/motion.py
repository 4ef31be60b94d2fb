"""Motion: states, inputs and disturbances of a simulated flight, one row per cycle of the autopilot."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sitl_scenarios.vectors import euler_angles

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

Pair = tuple[float, float]
"""Two floats."""

Progress = Callable[[float], None]
"""Function that is called with the progress of a flight."""

Arrays = dict[str, NDArray[Any]]
"""Arrays by name."""


@dataclass(frozen=True, eq=False)
class Motion:
    """Rows of a simulated flight, one for each cycle of the autopilot.

    Positions and velocities are north-east-down (NED), with the origin where the vehicle stands at first. Body axes
    are forward, right, down (FRD). Truth files hold each field under its name.
    """

    time: Array
    """(N,) seconds since the autopilot's boot."""
    position: Array
    """(N, 3) position, NED, m."""
    velocity: Array
    """(N, 3) velocity, NED, m/s."""
    attitude: Array
    """(N, 4) unit quaternions (w, x, y, z) from body axes to NED."""
    rates: Array
    """(N, 3) body rates p, q, r, rad/s."""
    known_attitude: Array
    """(N, 4) attitude as the autopilot estimates it, with noise and delay."""
    known_rates: Array
    """(N, 3) body rates as the autopilot estimates them, after the gyro's filters, rad/s."""
    gyro: Array
    """(N, 3) body rates before the gyro's filters, with the vibration of rotors and frame, rad/s."""
    known_position: Array
    """(N, 3) position as the autopilot estimates it, NED, m."""
    known_velocity: Array
    """(N, 3) velocity as the autopilot estimates it, NED, m/s."""
    outputs: Array
    """(N, 4) motor commands as the autopilot puts them out: PWM pulses in whole µs."""
    demands: Array
    """(N, 4) demands to the mixer: roll, pitch and yaw, −1 to 1, and thrust, 0 to 1."""
    attitude_setpoint: Array
    """(N, 3) setpoints of roll, pitch and yaw, rad; zero on the ground."""
    rates_setpoint: Array
    """(N, 3) setpoints of the body rates, rad/s; zero on the ground."""
    sticks: Array
    """(N, 3) pilot's demands of roll and pitch, rad, and yaw rate, rad/s; zero without a pilot."""
    rotor_speeds: Array
    """(N, 4) rotor speeds, rad/s."""
    battery: Array
    """(N,) remaining fraction of the voltage of a charged battery, and of the rotor speeds with it."""
    wind: Array
    """(N, 3) velocity of the air at the vehicle, where it moves *to*, NED, m/s."""
    force: Array
    """(N, 3) force of the disturbance, NED, N; zero on the ground.

    The disturbance is everything but gravity and the rotors' thrust and torque in still air: the air's drag and its
    damping of roll and pitch are in it.
    """
    moment: Array
    """(N, 3) moment of the disturbance in body axes, N m; zero on the ground."""
    armed: Flags
    """(N,) whether the motors are armed."""
    landed_state: NDArray[np.uint8]
    """(N,) MAV_LANDED_STATE: 1 on the ground, 2 in the air, 3 taking off, 4 landing."""

    def __len__(self) -> int:
        return len(self.time)

    def __getitem__(self, rows: slice | NDArray[np.intp] | Flags) -> Motion:
        return type(self)(*(column[rows] for column in vars(self).values()))


def joined(pieces: Sequence[Motion]) -> Motion:
    """Concatenates pieces of a motion that follow each other in time."""
    columns = zip(*(vars(piece).values() for piece in pieces), strict=True)
    return type(pieces[0])(*map(np.concatenate, columns))


def estimated_angles(motion: Motion) -> Array:
    """Returns roll, pitch and yaw as the autopilot estimates them, rad; (N, 3)."""
    return np.array([euler_angles(attitude) for attitude in motion.known_attitude.tolist()])
