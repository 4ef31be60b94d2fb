"""Sensors: the autopilot's estimates of the motion, with noise and delay."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from math import sqrt
from typing import NamedTuple

import numpy as np

from sitl_scenarios.body import State
from sitl_scenarios.dynamics import Quaternion, Three, turned
from sitl_scenarios.scenario import Sensors


class Known(NamedTuple):
    """The autopilot's estimates; units as in ``State``."""

    position: Three
    velocity: Three
    attitude: Quaternion
    rates: Three


class Sensing:
    """The way from states to what is known of them.

    The delay is exact: the state is interpolated between two cycles. Noise is white from cycle to cycle.
    """

    def __init__(self, sensors: Sensors, cycle: float, noise: np.random.Generator) -> None:
        late = sensors.delay / cycle
        self._whole = int(late)
        self._share = late - self._whole
        self._seen: deque[State] = deque(maxlen=self._whole + 2)
        sds = (sensors.position_sd, sensors.velocity_sd, sensors.attitude_sd / 2, sensors.rate_sd)
        self._noise = _rows(np.repeat(sds, 3), noise)

    def known(self, state: State) -> Known:
        """What is known once the vehicle is in ``state``; one call each cycle."""
        self._seen.append(state)
        last = len(self._seen) - 1
        new, old = self._seen[max(last - self._whole, 0)], self._seen[max(last - self._whole - 1, 0)]
        k, m = 1.0 - self._share, self._share
        (x, y, z), (u, v, w), (a, b, c, d), (p, q, r) = new[:4]
        (x0, y0, z0), (u0, v0, w0), (a0, b0, c0, d0), (p0, q0, r0) = old[:4]
        nx, ny, nz, nu, nv, nw, ea, eb, ec, np_, nq, nr = next(self._noise)
        a, b, c, d = k * a + m * a0, k * b + m * b0, k * c + m * c0, k * d + m * d0
        a, b, c, d = turned((a, b, c, d), (ea, eb, ec))
        size = 1.0 / sqrt(a * a + b * b + c * c + d * d)
        return Known(
            (k * x + m * x0 + nx, k * y + m * y0 + ny, k * z + m * z0 + nz),
            (k * u + m * u0 + nu, k * v + m * v0 + nv, k * w + m * w0 + nw),
            (a * size, b * size, c * size, d * size),
            (k * p + m * p0 + np_, k * q + m * q0 + nq, k * r + m * r0 + nr),
        )


def _rows(sds: np.typing.NDArray[np.float64], noise: np.random.Generator) -> Iterator[list[float]]:
    while True:
        yield from (noise.standard_normal((1000, len(sds))) * sds).tolist()
