"""Body: how a quadrotor moves through a cycle of its autopilot.

A step of h seconds: the rotors' lag is solved exactly; velocity and body rates are advanced by what acts halfway, where
they and the attitude are predicted with the accelerations before; position and attitude by the mean of the velocities
and of the rates before and after. The error of a flight is of second order in h. Commands and air are held through a
cycle.
"""

from __future__ import annotations

from math import exp, sqrt
from typing import NamedTuple

from sitl_scenarios.dynamics import Air, Change, Quaternion, Three, dynamics
from sitl_scenarios.frames import Four
from sitl_scenarios.scenario import Vehicle
from sitl_scenarios.vehicles import AIRFRAMES


class State(NamedTuple):
    """Of the vehicle.

    Attributes:
        position, velocity: NED, m and m/s.
        attitude: unit quaternion from body to NED.
        rates: in body axes, rad/s.
        rotors: speeds, rad/s.
        change: what acted last; all of it zero on the ground.
    """

    position: Three = (0.0, 0.0, 0.0)
    velocity: Three = (0.0, 0.0, 0.0)
    attitude: Quaternion = (1.0, 0.0, 0.0, 0.0)
    rates: Three = (0.0, 0.0, 0.0)
    rotors: Four = (0.0, 0.0, 0.0, 0.0)
    change: Change = (0.0,) * 12


class Body:
    """A vehicle's way from state to state.

    Args:
        vehicle: which.
        step: h, s.
    """

    def __init__(self, vehicle: Vehicle, step: float) -> None:
        self._change = dynamics(vehicle)
        self._step = step
        up, down = AIRFRAMES[vehicle.model].lag
        self._keeps = tuple(exp(-step / tau) if tau else 0.0 for tau in (up / 0.5, up, down / 0.5, down))

    def spun(self, rotors: Four, targets: Four, steps: int) -> Four:
        """Rotor speeds after some steps towards what their commands settle at, the body standing still."""
        for _ in range(steps):
            _, rotors = self._lagged(rotors, targets)
        return rotors

    def moved(self, state: State, targets: Four, air: Air, steps: int) -> State:
        """The state after some steps in the air.

        Args:
            state: before.
            targets: the speeds that the rotors' commands settle at, rad/s.
            air: about the vehicle.
            steps: how many.
        """
        change, h, half = self._change, self._step, self._step / 2
        (x, y, z), (u, v, w), (q0, q1, q2, q3), (p, q, r), rotors, last = state
        an, ae, ad, ap, aq, ar = last[:6]
        for _ in range(steps):
            middle_rotors, rotors = self._lagged(rotors, targets)
            # Half a step of rotation by the rates; their own change would be of higher order.
            hp, hq, hr = p * half / 2, q * half / 2, r * half / 2
            middle = (
                q0 - q1 * hp - q2 * hq - q3 * hr,
                q1 + q0 * hp + q2 * hr - q3 * hq,
                q2 + q0 * hq + q3 * hp - q1 * hr,
                q3 + q0 * hr + q1 * hq - q2 * hp,
            )
            last = change(
                middle,
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
            hp, hq, hr = half * (p + half * ap), half * (q + half * aq), half * (r + half * ar)
            p += h * ap
            q += h * aq
            r += h * ar
            q0, q1, q2, q3 = (
                q0 - q1 * hp - q2 * hq - q3 * hr,
                q1 + q0 * hp + q2 * hr - q3 * hq,
                q2 + q0 * hq + q3 * hp - q1 * hr,
                q3 + q0 * hr + q1 * hq - q2 * hp,
            )
            size = 1.0 / sqrt(q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3)
            q0 *= size
            q1 *= size
            q2 *= size
            q3 *= size
        return State((x, y, z), (u, v, w), (q0, q1, q2, q3), (p, q, r), rotors, last)

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
