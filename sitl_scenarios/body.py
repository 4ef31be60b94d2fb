"""Body: integrates the motion of a quadrotor through one cycle of its autopilot.

A step of h seconds: the rotors' lag is solved exactly; velocity and body rates are advanced by what acts halfway, where
they and the attitude are predicted with the accelerations before; position and attitude by the mean of the velocities
and of the rates before and after. The error of a flight is of second order in h. Commands and air are held through a
cycle.
"""

from __future__ import annotations

from math import exp, sqrt
from typing import NamedTuple

from sitl_scenarios.dynamics import Air, Change, Quaternion, Three, Wear, dynamics, turned
from sitl_scenarios.mixer import Four
from sitl_scenarios.scenario import VehicleSpec
from sitl_scenarios.vehicles import airframe


class State(NamedTuple):
    """Of the vehicle."""

    position: Three = (0.0, 0.0, 0.0)  # with velocity: NED, m and m/s
    velocity: Three = (0.0, 0.0, 0.0)
    attitude: Quaternion = (1.0, 0.0, 0.0, 0.0)  # unit quaternion from body to NED
    rates: Three = (0.0, 0.0, 0.0)  # in body axes, rad/s
    rotors: Four = (0.0, 0.0, 0.0, 0.0)  # speeds, rad/s
    change: Change = (0.0,) * 12  # what acted last; all of it zero on the ground


class Body:
    """A vehicle's way from state to state, in steps of h = ``step`` seconds."""

    def __init__(self, vehicle: VehicleSpec, step: float) -> None:
        self._vehicle = vehicle
        self._change = dynamics(vehicle)
        self._step = step
        up, down = airframe(vehicle).lag
        self._keeps = tuple(exp(-step / tau) if tau else 0.0 for tau in (up / 0.5, up, down / 0.5, down))

    def damage(self, condition: Wear) -> None:
        """From now on it is what is left of the vehicle."""
        self._change = dynamics(self._vehicle, condition)

    def spun(self, rotors: Four, targets: Four, steps: int) -> Four:
        """Rotor speeds after some steps towards what their commands settle at, the body standing still."""
        for _ in range(steps):
            _, rotors = self._lagged(rotors, targets)
        return rotors

    def moved(self, state: State, targets: Four, air: Air, steps: int) -> State:
        """The state after some steps in the air; ``targets``: what the rotors' commands settle at, rad/s."""
        change, h, half = self._change, self._step, self._step / 2
        (x, y, z), (u, v, w), attitude, (p, q, r), rotors, last = state
        an, ae, ad, ap, aq, ar = last[:6]
        for _ in range(steps):
            middle_rotors, rotors = self._lagged(rotors, targets)
            # Half a step of rotation by the rates; their own change would be of higher order.
            last = change(
                turned(attitude, (p * half / 2, q * half / 2, r * half / 2)),
                (u + half * an, v + half * ae, w + half * ad),
                (p + half * ap, q + half * aq, r + half * ar),
                middle_rotors,
                air,
            )
            an, ae, ad, ap, aq, ar, *_ = last
            x += h * (u + half * an)
            y += h * (v + half * ae)
            z += h * (w + half * ad)
            u += h * an
            v += h * ae
            w += h * ad
            halves = half * (p + half * ap), half * (q + half * aq), half * (r + half * ar)
            a, b, c, d = turned(attitude, halves)
            size = 1.0 / sqrt(a * a + b * b + c * c + d * d)
            attitude = a * size, b * size, c * size, d * size
            p += h * ap
            q += h * aq
            r += h * ar
        return State((x, y, z), (u, v, w), attitude, (p, q, r), rotors, last)

    def _lagged(self, rotors: Four, targets: Four) -> tuple[Four, Four]:
        """Speeds half a step and a step later."""
        o1, o2, o3, o4 = rotors
        t1, t2, t3, t4 = targets
        half_up, up, half_down, down = self._keeps
        d1, d2, d3, d4 = o1 - t1, o2 - t2, o3 - t3, o4 - t4
        m1, e1 = (half_up, up) if d1 < 0.0 else (half_down, down)
        m2, e2 = (half_up, up) if d2 < 0.0 else (half_down, down)
        m3, e3 = (half_up, up) if d3 < 0.0 else (half_down, down)
        m4, e4 = (half_up, up) if d4 < 0.0 else (half_down, down)
        return (
            (t1 + d1 * m1, t2 + d2 * m2, t3 + d3 * m3, t4 + d4 * m4),
            (t1 + d1 * e1, t2 + d2 * e2, t3 + d3 * e3, t4 + d4 * e4),
        )
