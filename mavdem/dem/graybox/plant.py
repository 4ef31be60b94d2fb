"""The plant of one axis: its rate, the motors' torque and the wind's, from sample to sample."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag, solve_continuous_lyapunov

from mavdem.dem.engine.linalg import Array
from mavdem.dem.engine.model import Transition, discretize
from mavdem.dem.graybox.coloured import Coloured, step_covariance


class Plant(NamedTuple):
    """x⁺ = Φ x + Γ₀ c + Γ₁ c⁺ + noise, with the state x = [rate, torque, wind's states] and the commanded torque c.

    Attributes:
        step: the transition; it has one input, c in rad/s².
        process: (n, n) covariance of the noise, which drives the wind.
        wind: (n,) the wind's torque, rad/s², out of a state.
        stationary: (n, n) covariance of the wind's states before anything is measured; 0 for rate and torque.
    """

    step: Transition
    process: Array
    wind: Array
    stationary: Array


def plant(damping: float, lag: float, components: Sequence[tuple[Coloured, float, float]], dt: float) -> Plant:
    """The plant with ``damping``, 1/s, and ``lag``, s, sampled every ``dt`` seconds.

    ``components`` of the wind are colour, standard deviation in rad/s², and time in s of each.
    """
    colours = [(colour.A / time, colour.drive / time) for colour, _, time in components]
    A = block_diag(np.array([[-damping, 1.0], [0.0, -1 / lag]]), *(own for own, _ in colours))
    drive, stationary, wind = np.zeros_like(A), np.zeros_like(A), np.zeros(len(A))
    places = np.cumsum([2, *(len(own) for own, _ in colours)])
    for (colour, size, _), (own, noise), (start, stop) in zip(components, colours, pairwise(places), strict=True):
        wind[start:stop] = size * colour.C
        drive[start:stop, start:stop] = noise
        stationary[start:stop, start:stop] = solve_continuous_lyapunov(own, -noise)
    A[0] += wind
    step = discretize(A, np.eye(len(A))[:, 1:2] / lag, dt)
    process = step_covariance(A, drive, dt)
    return Plant(step, (process + process.T) / 2, wind, stationary)
