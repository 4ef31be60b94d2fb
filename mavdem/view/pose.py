"""Pose: what is shown of a simulated flight."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

CARRYING = 0.7
"""Share of the median speed of armed rotors above which they are taken to carry the vehicle."""
MOST_ROWS = 50_000
"""The viewer draws every one."""
SPOOLING = 0.5
"""Seconds that rotors take to speed up and to slow down."""


@dataclass(frozen=True, eq=False)
class Pose:
    """A flight to be shown: N rows, NED and body axes forward, right, down.

    Attributes:
        time: (N,) s.
        position: (N, 3) m.
        attitude, known_attitude: (N, 4) unit quaternions (w, x, y, z), body to NED, and what the autopilot knew of it.
        rates, known_rates: (N, 3) body rates, rad/s, likewise.
        outputs: (N, 4) of the motors, µs.
        rotor_speeds: (N, 4) rad/s.
        wind: (N, 3) NED, m/s, where the air moves to.
        moment: (N, 3) of what disturbs, body, N m.
        armed: (N,) bool.
        rotors: (4, 2) where the rotors are, forward and right of the centre of mass, m.
    """

    time: Array
    position: Array
    attitude: Array
    known_attitude: Array
    rates: Array
    known_rates: Array
    outputs: Array
    rotor_speeds: Array
    wind: Array
    moment: Array
    armed: NDArray[np.bool_]
    rotors: Array

    @property
    def arm(self) -> float:
        """How far the farthest rotor is from the centre of mass, m."""
        return float(np.hypot(*self.rotors.T).max())

    def carries(self) -> NDArray[np.bool_]:
        """(N,) where the rotors carry the vehicle, not just now or only just; everywhere, if they never do."""
        speed = self.rotor_speeds.mean(axis=1)
        hover = float(np.median(speed[self.armed])) if self.armed.any() else np.inf
        carried = self.time[speed > CARRYING * hover]
        if not len(carried) or carried[-1] - carried[0] < 3 * SPOOLING:
            return np.ones(len(speed), dtype=np.bool_)
        return np.asarray((self.time > carried[0] + SPOOLING) & (self.time < carried[-1] - SPOOLING))

    def at(self, rate: float) -> NDArray[np.intp]:
        """Rows of the flight, evenly, at about ``rate`` Hz, no faster than there are, and fewer of a long flight."""
        step, count = float(np.median(np.diff(self.time))), len(self.time)
        return np.arange(0, count, max(round(1 / rate / step), ceil(count / MOST_ROWS)))
