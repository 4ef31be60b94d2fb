"""The plant of one axis in the wind, sampled: what the wind's torque is smoothed with, and commands are simulated with.

    rate' = −damping · rate + torque + constant + wind,    torque' = (effect · u(t − delay) − torque) / lag,

torque and wind per moment of inertia, rad/s². The wind is coloured noise of one or two components.
"""

from collections.abc import Sequence
from math import factorial
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm, solve_continuous_lyapunov

from mavdem.arrays import Array, ArrayPair
from mavdem.dem.engine.kalman import SmoothedSignal, SteadyStateFilter
from mavdem.dem.engine.model import Transition, discretize


class Coloured(NamedTuple):
    """Stationary noise of variance 1, y = C x with ẋ = A x + white noise, in units of its own time."""

    A: Array  # (k, k)
    drive: Array  # (k, k) intensity of the white noise
    C: Array  # (k,)
    # of the inverse of its density, in powers of −ω², the highest first
    rarity: Array

    def density(self, turn: Array, size: Array | float, time: Array | float) -> Array:
        """Returns its two-sided spectral density at ``turn``, rad/s, with this standard deviation and time, s."""
        return np.asarray(size**2 * time / np.polyval(self.rarity, -((turn * time) ** 2)))


def step_covariance(A: Array, drive: Array, dt: float) -> Array:
    """Returns (…, n, n) covariance that white noise of intensity ``drive`` (…, n, n) adds to ẋ = A x in ``dt`` s.

    Van Loan, "Computing integrals involving the matrix exponential", 1978.
    """
    n = A.shape[-1]
    flow = expm(np.block([[-A, drive], [np.zeros_like(A), A.mT]]) * dt)
    return flow[..., n:, n:].mT @ flow[..., :n, n:]


def _autoregressive(coefficients: Array) -> Coloured:
    """Of a denominator with the leading coefficient 1, highest power first, each state of variance 1."""
    order = len(coefficients) - 1
    A = np.eye(order, k=1)
    A[-1] = -coefficients[:0:-1]
    drive = np.zeros((order, order))
    drive[-1, -1] = 1.0
    size = np.sqrt(solve_continuous_lyapunov(A, -drive).diagonal())
    drive[-1, -1] /= size[-1] ** 2
    backward = coefficients * (-1.0) ** np.arange(order, -1, -1)
    rarity = size[0] ** 2 * np.polymul(coefficients, backward)[::2]
    return Coloured(A * size / size[:, None], drive, np.eye(order)[0], rarity)


def gaussian_kernel_noise(order: int) -> Coloured:
    """Returns noise of the Gaussian kernel whose width is the unit of time, of spectrum exp(−ω²).

    1/exp(ω²) by Taylor's series in the denominator: Hartikainen and Särkkä, "Kalman filtering and smoothing solutions
    to temporal Gaussian process regression models", MLSP 2010, sec. 3.3.
    """
    series = np.zeros(2 * order + 1)
    series[::2] = [(-1) ** power / factorial(power) for power in range(order, -1, -1)]
    roots = np.roots(series)
    return _autoregressive(np.real(np.poly(roots[roots.real < 0])))


# autocorrelation exp(−|τ|): turbulence along its mean wind
FIRST_ORDER = _autoregressive(np.ones(2))

GAUSSIAN_KERNEL = gaussian_kernel_noise(4)
"""Autocorrelation exp(−τ²/4), nearly: noise with a Gaussian kernel, the noise of generalized coordinates (Eq.
``Smatrix``), to an order that is enough for the spectrum where there is power."""


def jumping(inputs: Array, sooner: float) -> Array:
    """Returns (W, N, r) inputs whose jumps between two samples come ``sooner`` than half way, in shares of a step.

    A jump is what a change has beyond the one before it, and of it alone where their signs differ.
    """
    changes = np.diff(inputs, axis=1, prepend=inputs[:, :1])
    before = np.concatenate([np.zeros_like(changes[:, :1]), changes[:, :-1]], axis=1)
    return inputs + sooner * (
        changes - np.clip(before, np.minimum(changes, 0.0), np.maximum(changes, 0.0))
    )


def delayed(inputs: Array, steps: float) -> ArrayPair:
    """Returns commands (T − 1, r) as they act at the beginning and the end of each step, interpolated."""
    whole = int(min(max(0.0, steps), len(inputs)))
    share = min(max(0.0, steps) - whole, 1.0)
    later = np.concatenate([np.repeat(inputs[:1], whole + 1, axis=0), inputs])[: len(inputs) + 1]
    moved = (1 - share) * later[1:] + share * later[:-1]
    return moved[:-1], moved[1:]


class Plant(NamedTuple):
    """x⁺ = Φ x + Γ₀ c + Γ₁ c⁺ + noise, with the state x = [rate, torque, wind's states] and the commanded torque c."""

    step: Transition  # it has one input, c in rad/s²
    process: Array  # (n, n) covariance of the noise, which drives the wind
    wind: Array  # (n,) the wind's torque, rad/s², out of a state
    jumps: float  # share of a step by which commands that jump do so sooner than half way

    def pushes(self, commanded: Array, steps: float) -> Array:
        """Returns (T − 1, n) what commands (T,), rad/s², that act so many ``steps`` later do to the next state."""
        early, late = delayed(jumping(commanded[None, :, None], self.jumps)[0], steps)
        return early * self.step.Gamma0[:, 0] + late * self.step.Gamma1[:, 0]

    def filter(self, noise: float) -> SteadyStateFilter:
        """Returns the steady filter of a rate measured with white ``noise``, rad/s; ``LinAlgError`` without one."""
        return SteadyStateFilter.design(self.step.Phi, self.process, noise)

    def smoothed(
        self,
        steady: SteadyStateFilter,
        commanded: Array,
        steps: float,
        rate: Array,
    ) -> SmoothedSignal:
        """Returns the wind's torque in a segment, rad/s², from all of its ``rate`` (T,), rad/s, by a ``steady`` filter.

        At its beginning the motors have settled at what is commanded, with all that is steady, and there is no wind.
        """
        first = np.zeros(len(self.wind))
        first[:2] = rate[0], commanded[0]
        return steady.smooth(self.pushes(commanded, steps), rate, first, self.wind)


def plant(
    damping: Array | float,
    lag: Array | float,
    components: Sequence[tuple[Coloured, Array | float, Array | float]],
    dt: float,
    jumps: float = 0.0,
) -> Plant:
    """Returns the plant with ``damping``, 1/s, ``lag``, s, and wind, sampled every ``dt`` seconds.

    ``components`` of the wind are colour, standard deviation in rad/s² (…), and time in s (…) of each. Of several (…)
    side by side its arrays have these axes first.
    """
    shape = np.shape(damping)
    n = 2 + sum(len(colour.A) for colour, _, _ in components)
    A, drive = np.zeros((2, *shape, n, n))
    B = np.zeros((*shape, n, 1))
    wind = np.zeros((*shape, n))
    start = 2
    for colour, size, time in components:
        states = slice(start, start + len(colour.A))
        pace = 1 / np.asarray(time)[..., None, None]
        A[..., states, states] = colour.A * pace
        drive[..., states, states] = colour.drive * pace
        wind[..., states] = colour.C * np.asarray(size)[..., None]
        start = states.stop
    A[..., 0, :] = wind
    A[..., 0, 0] = -damping
    A[..., 0, 1] = 1.0
    B[..., 1, 0] = 1 / lag
    A[..., 1, 1] = -B[..., 1, 0]
    process = step_covariance(A, drive, dt)
    process = (process + process.mT) / 2
    return Plant(discretize(A, B, dt), process, wind, jumps)
