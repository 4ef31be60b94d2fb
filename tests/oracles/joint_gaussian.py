"""The exact posterior of a linear system under smooth noise, by brute force: one Gaussian over all samples at once.

    ẋ = A x + B u + w,   y = C x + z,

w and z Gaussian processes with autocorrelation exp(−τ²/4s²), white noise through a Gaussian kernel of width s. Nothing
is assumed of derivatives: the states of all samples are one long Gaussian vector, whose moments are integrals of that
autocorrelation. They are computed by Gauss–Legendre quadrature within each sampling step. All integrands are entire
functions, so its error falls faster than any power of the nodes; for dt ≤ s it is below 1e-9 of the covariance
(``test_joint_posterior.py`` measures it against a closed form and against twice the nodes).

Two details make the posterior that of a flight. The noise has moved the state before the first sample, so the states
start from their broad prior ``lead`` samples earlier; by the first sample they correlate with the noise. And densely
sampled smooth noise is predictable from its past beyond the resolution of any sensor (at s = 4 dt, to 1e-11), so every
output also has a white error of ``ROUNDING`` times its noise.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, cho_factor, cho_solve, expm, toeplitz

from mavdem.dem.engine.model import pack, unpack

Array = NDArray[np.float64]

# white error of an output, in its smooth noise: far below it, far above the arithmetic's
ROUNDING = 3e-4
SLOPE_STEP = 1e-2  # of finite differences; a shorter one loses the smallest variances in rounding
CONVERGED_STEP = 0.02  # Fisher scoring stops at a shorter step, in posterior standard deviations
NODES = 6  # of the quadrature within one sampling step


def autocorrelation(lag: Array, smoothness: float) -> Array:
    """exp(−τ²/4s²): of white noise convolved with exp(−t²/2s²)."""
    return np.exp(-(lag**2) / (4 * smoothness**2))


@dataclass(frozen=True, eq=False)
class System:
    """A linear system in noise of known colour and size."""

    A: Array  # (n, n)
    B: Array  # (n, r)
    C: Array  # (m, n)
    state_noise: Array  # (n,) standard deviations of w
    output_noise: Array  # (m,) standard deviations of z
    smoothness: float  # kernel width s, seconds
    dt: float  # sampling step, seconds
    samples: int  # T
    lead: int  # samples before the first at which the states start
    start_sd: Array  # (n,) of the Gaussian, about 0, that the states start from
    # u at times (k,) seconds, the first sample's being 0: (k, r). A smooth function
    inputs: Callable[[Array], Array]
    free: NDArray[np.intp]  # (k,) places in θ of the parameters to be estimated
    nodes: int = NODES  # of the quadrature

    @property
    def theta(self) -> Array:
        """All parameters, as :func:`mavdem.dem.engine.model.pack` packs them."""
        return pack(self.A, self.B, self.C)

    def at(self, parameters: Array) -> Self:
        """The same with other values (k,) of the free parameters."""
        theta = self.theta
        theta[self.free] = parameters
        n, r = self.B.shape
        A, B, C = unpack(theta, n, r, len(self.C))
        return replace(self, A=A, B=B, C=C)

    @property
    def times(self) -> Array:
        """Of the samples, (T,)."""
        return self.dt * np.arange(self.samples, dtype=float)

    @cached_property
    def state_moments(self) -> tuple[Array, Array]:
        """Mean (T·n,) and covariance (T·n, T·n) of the sampled states, sample-major."""
        n = len(self.A)
        steps = self.lead + self.samples
        nodes, weights = np.polynomial.legendre.leggauss(self.nodes)
        within = self.dt * (nodes + 1) / 2
        weights = self.dt * weights / 2
        # x⁺ = Φ x + ξ with ξ = ∫ exp(A(dt − τ)) (B u + w) dτ, a weighted sum over the nodes.
        reach = np.array(
            [
                weight * expm(self.A * (self.dt - at))
                for at, weight in zip(within, weights, strict=True)
            ]
        )
        apart = np.arange(steps)[:, None] - np.arange(steps)
        lags = self.dt * np.arange(1 - steps, steps)[:, None, None] + within[:, None] - within
        correlation = autocorrelation(lags, self.smoothness)
        of_push = np.einsum("gab,b,hcb,lgh->lac", reach, self.state_noise**2, reach, correlation)[
            apart + steps - 1
        ]
        # Every state is a linear map of the first one and of every ξ before it.
        powers = np.array([np.linalg.matrix_power(expm(self.A * self.dt), k) for k in range(steps)])
        carried = np.where((apart >= 0)[:, :, None, None], powers[np.maximum(apart, 0)], 0.0)[
            self.lead :
        ]
        carried, of_push = (
            each.swapaxes(1, 2).reshape(len(each) * n, -1) for each in (carried, of_push[1:, 1:])
        )
        times = self.dt * (np.arange(steps - 1)[:, None] - self.lead) + within
        driven = self.inputs(times.ravel()).reshape(*times.shape, -1) @ self.B.T
        mean = carried[:, n:] @ np.einsum("gab,tgb->ta", reach, driven).ravel()
        return mean, carried @ block_diag(np.diag(self.start_sd**2), of_push) @ carried.T

    @cached_property
    def output_moments(self) -> tuple[Array, Array]:
        """Mean (T·m,) and covariance (T·m, T·m) of the outputs."""
        mean, covariance = self.state_moments
        see = np.kron(np.eye(self.samples), self.C)
        return see @ mean, see @ covariance @ see.T + self.output_noise_covariance

    @property
    def output_noise_covariance(self) -> Array:
        """Of z and the rounding, (T·m, T·m)."""
        correlation = toeplitz(autocorrelation(self.times, self.smoothness)) + ROUNDING**2 * np.eye(
            self.samples
        )
        return np.asarray(np.kron(correlation, np.diag(self.output_noise**2)), float)

    def draw(self, rng: np.random.Generator, number: int) -> tuple[Array, Array]:
        """So many series from their distribution: states (number, T, n) and outputs (number, T, m)."""
        mean, covariance = self.state_moments
        # The noise has a Cholesky factor, thanks to its white part; the states, smoother still, have none in rounding.
        states = rng.multivariate_normal(
            mean, covariance, number, check_valid="ignore", method="eigh"
        )
        factor = np.linalg.cholesky(self.output_noise_covariance)
        noise = rng.standard_normal((number, len(factor))) @ factor.T
        states = states.reshape(number, self.samples, -1)
        return states, states @ self.C.T + noise.reshape(number, self.samples, -1)

    def states_given(self, outputs: Array) -> tuple[Array, Array]:
        """Posterior mean and standard deviation of the states, (T, n) each, given all outputs (T, m)."""
        gain, sd = self._smoother
        posterior = self.state_moments[0] + gain @ (outputs.ravel() - self.output_moments[0])
        return posterior.reshape(sd.shape), sd

    @cached_property
    def _smoother(self) -> tuple[Array, Array]:
        """Gain (T·n, T·m) from outputs to states, and the states' posterior standard deviation (T, n)."""
        covariance = self.state_moments[1]
        cross = covariance @ np.kron(np.eye(self.samples), self.C).T
        gain = cho_solve(self._factor, cross.T).T
        variance = np.diag(covariance) - np.sum(gain * cross, axis=1)
        return gain, np.sqrt(variance).reshape(self.samples, -1)

    @cached_property
    def _factor(self) -> tuple[Array, bool]:
        """Cholesky's, of the outputs' covariance."""
        return cho_factor(self.output_moments[1])

    @cached_property
    def _slopes(self) -> tuple[Array, Array]:
        """Derivatives of the outputs' mean (k, T·m) and covariance (k, T·m, T·m) by the free parameters."""
        start = self.theta[self.free]
        means = []
        covariances = []
        for step in SLOPE_STEP * np.eye(len(start)):
            ahead = self.at(start + step).output_moments
            behind = self.at(start - step).output_moments
            means.append((ahead[0] - behind[0]) / (2 * SLOPE_STEP))
            covariances.append((ahead[1] - behind[1]) / (2 * SLOPE_STEP))
        return np.array(means), np.array(covariances)

    @cached_property
    def _white_slopes(self) -> tuple[Array, Array]:
        """Those times the inverse covariance."""
        means, covariances = self._slopes
        return cho_solve(self._factor, means.T).T, np.array(
            [cho_solve(self._factor, slope) for slope in covariances]
        )

    @cached_property
    def information(self) -> Array:
        """Fisher's information on the free parameters, (k, k)."""
        means, covariances = self._white_slopes
        return np.asarray(
            means @ self._slopes[0].T + 0.5 * np.einsum("iab,jba->ij", covariances, covariances)
        )

    def score(self, outputs: Array) -> Array:
        """Gradient of ln p(y | θ, λ, s), of outputs (T, m), by the free parameters, (k,)."""
        means, covariances = self._white_slopes
        error = outputs.ravel() - self.output_moments[0]
        white = cho_solve(self._factor, error)
        return np.asarray(
            means @ error
            + 0.5 * (covariances @ white @ error - np.trace(covariances, axis1=1, axis2=2))
        )


class ParameterPrior(NamedTuple):
    """Gaussian, of the free parameters."""

    mean: Array  # (k,)
    precision: Array  # (k, k)


def parameters_given(system: System, outputs: Array, prior: ParameterPrior) -> tuple[Array, Array]:
    """Posterior of the free parameters, λ being known: its maximum (k,), and Laplace's covariance (k, k) there.

    By Fisher scoring from the system's own parameters; the curvature is the expected one.
    """
    here = system
    while True:
        at = here.theta[here.free]
        curvature = here.information + prior.precision
        step = np.linalg.solve(curvature, here.score(outputs) - prior.precision @ (at - prior.mean))
        if step @ curvature @ step < CONVERGED_STEP**2:
            return at, np.asarray(np.linalg.inv(curvature), float)
        here = system.at(at + step)
