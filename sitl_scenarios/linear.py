"""Linear: the same dynamics about hover, ẋ = Ax + Bu, by central differences.

About hover in still air, level, nose to the north. In wind a vehicle hovers tilted, with another thrust: the effect of
its motors there is a few hundredths from what it is here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import cos, sin, tan
from typing import Literal

import numpy as np

from sitl_scenarios.dynamics import Air, dynamics
from sitl_scenarios.frames import PAPER_ORDER
from sitl_scenarios.motion import Array
from sitl_scenarios.scenario import Vehicle
from sitl_scenarios.vehicles import AIRFRAMES

STATES = (
    *("north", "east", "down", "north speed", "east speed", "down speed"),
    *("roll", "pitch", "yaw", "roll rate", "pitch rate", "yaw rate"),
    *("rotor 1", "rotor 2", "rotor 3", "rotor 4"),
)
"""m, m/s, rad, rad/s in body axes, and rad/s."""


@dataclass(frozen=True, eq=False)
class Linear:
    """A linear system.

    Attributes:
        states: their names, n of them.
        A: (n, n), 1/s and the like.
        B: (n, 4), per unit of each motor's command.
    """

    states: tuple[str, ...]
    A: Array
    B: Array

    def of(self, states: Sequence[str]) -> Linear:
        """The rows and columns of some states; what others do to them is left out."""
        kept = [self.states.index(state) for state in states]
        return Linear(tuple(states), self.A[np.ix_(kept, kept)], self.B[kept])

    def without_lag(self) -> Linear:
        """With rotors that are at once where they settle."""
        body, rotors = slice(0, 12), slice(12, 16)
        settled = -np.linalg.solve(self.A[rotors, rotors], self.B[rotors])
        return Linear(self.states[:12], self.A[body, body], self.B[body] + self.A[body, rotors] @ settled)

    def per_microsecond(self, vehicle: Vehicle) -> Linear:
        """With motor commands in µs of PWM instead of the vehicle's own unit."""
        return Linear(self.states, self.A, self.B * (AIRFRAMES[vehicle.model].full / 1000))


def linearised(vehicle: Vehicle) -> Linear:
    """All states of ``STATES``, about hover; a rotor's lag is the mean of its two.

    Motor commands are in the vehicle's own unit, in the order of ``sitl_scenarios.frames``.
    """
    body = AIRFRAMES[vehicle.model]
    derivative = _derivative(vehicle)
    hover = np.zeros(16)
    hover[12:] = body.hover_speed
    commands = np.full(4, body.hover_command)
    steps = np.repeat([1e-3, 1e-5, 1e-5, 1e-4, 1e-5 * body.hover_speed], [3, 3, 3, 3, 4])
    A = np.column_stack(
        [
            (derivative(hover + step, commands) - derivative(hover - step, commands)) / (2 * size)
            for step, size in zip(np.diag(steps), steps, strict=True)
        ]
    )
    size = 1e-5 * body.full
    B = np.column_stack(
        [
            (derivative(hover, commands + step) - derivative(hover, commands - step)) / (2 * size)
            for step in size * np.eye(4)
        ]
    )
    return Linear(STATES, A, B)


def axis(vehicle: Vehicle, axis: Literal["roll", "pitch"] = "roll", lag: bool = True) -> Linear:
    """Angle and rate about one axis, in µs of PWM: what a model of a flight is held against.

    With ``lag`` there is a third state, the angular acceleration that the rotors make, "roll drive" (rad/s²), which
    follows the commands with the rotors' time constant. Without, it is there at once.

    Args:
        vehicle: which.
        axis: which.
        lag: whether rotors lag.
    """
    everything = linearised(vehicle).per_microsecond(vehicle)
    names = (axis, f"{axis} rate")
    instant = everything.without_lag().of(names)
    tau = sum(AIRFRAMES[vehicle.model].lag) / 2
    if not lag or tau == 0:
        return instant
    A, B = np.zeros((3, 3)), np.zeros((3, 4))
    A[:2, :2] = instant.A
    A[1, 2], A[2, 2] = 1.0, -1 / tau
    B[2] = instant.B[1] / tau
    return Linear((*names, f"{axis} drive"), A, B)


def paper_system(order: Literal[1, 2, 3, 4]) -> Linear:
    """A and B of the paper's table ``tab:systems``: AR.Drone 2.0, without rotor drag and lag, PWM of 0 to 255.

    Its y points to the left and its motors are in its own order, see ``sitl_scenarios.frames.PAPER_ORDER``.

    Args:
        order: System 1 to 4: [φ̇], [φ, φ̇], [ẏ, φ, φ̇], [y, ẏ, φ, φ̇].
    """
    east = ("east", "east speed", "roll", "roll rate")[4 - order :]
    found = linearised(Vehicle(model="ardrone2", rotor_drag=False)).without_lag().of(east)
    mirror = np.diag([-1.0 if state.startswith("east") else 1.0 for state in east])
    names = tuple({"east": "y", "east speed": "ẏ", "roll": "φ", "roll rate": "φ̇"}[state] for state in east)
    return Linear(names, mirror @ found.A @ mirror, mirror @ found.B[:, PAPER_ORDER])


def _derivative(vehicle: Vehicle) -> Callable[[Array, Array], Array]:
    """Of ``STATES`` by states (16,) and commands (4,)."""
    body = AIRFRAMES[vehicle.model]
    change = dynamics(vehicle)
    # A vehicle whose rotors do not lag has no such states; any small lag leaves the same without it.
    tau = sum(body.lag) / 2 or 1e-3

    def derivative(state: Array, commands: Array) -> Array:
        roll, pitch, yaw = state[6:9]
        p, q, r = state[9:12]
        sines, cosines = [sin(a / 2) for a in (roll, pitch, yaw)], [cos(a / 2) for a in (roll, pitch, yaw)]
        (sx, sy, sz), (cx, cy, cz) = sines, cosines
        attitude = (
            cx * cy * cz + sx * sy * sz,
            sx * cy * cz - cx * sy * sz,
            cx * sy * cz + sx * cy * sz,
            cx * cy * sz - sx * sy * cz,
        )
        vn, ve, vd = state[3:6].tolist()
        o1, o2, o3, o4 = state[12:].tolist()
        acting = change(attitude, (vn, ve, vd), (float(p), float(q), float(r)), (o1, o2, o3, o4), Air())
        turning = q * sin(roll) + r * cos(roll)
        angles = (p + turning * tan(pitch), q * cos(roll) - r * sin(roll), turning / cos(pitch))
        targets = [body.rotor_speed(command) for command in commands.tolist()]
        return np.array([vn, ve, vd, *acting[:3], *angles, *acting[3:6], *(np.array(targets) - state[12:]) / tau])

    return derivative
