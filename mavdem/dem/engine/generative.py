"""The generative model in generalized coordinates: how the data are assumed to arise.

    ỹ = C̃ x̃ + z̃,   D x̃ = Ã x̃ + B̃ ṽ + w̃,   ṽ = η̃ + (input noise)            Eq. ``generative_process``

Everything here is linear in the data, so the data enter the engine as one matrix of second moments.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import factorial
from typing import NamedTuple

import numpy as np
from scipy.linalg import inv
from scipy.ndimage import correlate1d

from mavdem.arrays import Array, Indices
from mavdem.dem.engine.linalg import logdet
from mavdem.dem.engine.model import unpack

Sizes = tuple[int, int, int]  # of states, inputs and outputs


def taylor_weights(
    order: int,
    dt: float,
    window: int,
    at: float,
) -> Array:
    """Returns weights that turn samples into derivatives.

    They are of the least-squares polynomial of degree ``order`` over a window. With ``window = order + 1`` the
    polynomial interpolates, which is the inverse of the Taylor matrix that the literature embeds with. A wider window
    averages measurement noise away, at the price of bandwidth. The derivatives are taken ``at`` a place in the window,
    in samples from its first, of samples ``dt`` s apart; row k of (order + 1, window) gives the k-th.
    """
    offsets = np.arange(window) - at
    # The fit is made in steps, where it is well conditioned, and scaled to seconds afterwards.
    taylor = np.stack([offsets**k / factorial(k) for k in range(order + 1)], axis=1)
    per_step = np.linalg.pinv(taylor)
    return per_step / dt ** np.arange(order + 1)[:, None]


def embed(
    samples: Array,
    order: int,
    dt: float,
    window: int,
    at: int,
) -> Array:
    """Returns generalized vectors of ``samples`` (T, m).

    There is one for each place the whole window of :func:`taylor_weights` fits, (T − window + 1, (order + 1)·m): row i
    belongs to sample ``i + at``. Nothing is padded.
    """
    weights = taylor_weights(order, dt, window, at)
    # The filter centres itself on window // 2; what it pads beyond the ends is cut off again.
    whole = slice(window // 2, len(samples) - (window - 1 - window // 2))
    return np.hstack([correlate1d(samples, row, axis=0)[whole] for row in weights])


def temporal_covariance(order: int, smoothness: float) -> Array:
    """Returns the covariance of [w, w′, …] of a noise of unit variance and kernel width s.

    It is that of Eq. ``Smatrix`` before it is inverted, (order + 1, order + 1), in powers of 1/s: entry (i, j) is (−1)ⁱ
    times the (i+j)-th derivative of the autocorrelation at zero, which vanishes where i + j is odd.
    """
    covariance = np.zeros((order + 1, order + 1))
    for i in range(order + 1):
        for j in range(i % 2, order + 1, 2):
            k = (i + j) // 2
            derivative = (-1) ** k * factorial(2 * k) / factorial(k) / (4 * smoothness**2) ** k
            covariance[i, j] = (-1) ** i * derivative
    return covariance


def temporal_precision(order: int, smoothness: float) -> Array:
    """Returns S(s²), the inverse of :func:`temporal_covariance`, (order + 1, order + 1).

    It is inverted in units of s, where its condition does not depend on the unit of time.
    """
    units = smoothness ** np.arange(order + 1)
    return inv(temporal_covariance(order, 1.0)) * np.outer(units, units)


class Prior(NamedTuple):
    """Gaussian priors of θ and λ."""

    theta_mean: Array  # (k,)
    theta_precision: Array  # (k, k)
    lambda_mean: Array  # (g,)
    lambda_precision: Array  # (g, g)

    def squared_errors(self, theta: Array, lambda_: Array) -> tuple[float, float]:
        """Returns those of θ and of λ, in units of their precision."""
        theta_error = theta - self.theta_mean
        lambda_error = lambda_ - self.lambda_mean
        return (
            float(theta_error @ self.theta_precision @ theta_error),
            float(lambda_error @ self.lambda_precision @ lambda_error),
        )


class SufficientStatistics(NamedTuple):
    """The data, as far as the steps need them: the number of generalized samples, and their second moments."""

    number: float  # whole, unless correlated neighbours count for less than one each
    gram: Array  # Σ_t [ỹ; η̃][ỹ; η̃]ᵀ

    @classmethod
    def from_segments(cls, *segments: Array) -> SufficientStatistics:
        """Returns those of generalized data [ỹ; η̃], (T, (p+1)m + (d+1)r) of each segment; their moments add up."""
        gram = np.asarray(sum(data.T @ data for data in segments))
        return cls(sum(map(len, segments)), gram)


@dataclass(frozen=True, eq=False)
class GenerativeModel:
    """Sizes, noise correlations and priors of the model; θ and λ are what is learned.

    Attributes:
        n, r, m: states, inputs, outputs.
        p, d, q: embedding orders of states and outputs, of inputs, and of the process noise.
        output_correlation: S of z̃, (p + 1, p + 1): the precision of a noise of unit variance and its derivatives.
        state_correlation: S of w̃, (q + 1, q + 1).
        output_groups, state_groups: (m,) and (n,) which entry of λ each output's and each state's noise has.
        input_precision: P̃ᵛ, ((d + 1)r, (d + 1)r).
        prior: of θ and λ.
        state_precision: of x about 0 at every sample, (n, n). ``None``: x has no prior. The density of X is then
            improper, so that F̄ of different n cannot be compared, and where θ leaves the unit of x free, F̄ is highest
            at C = 0.
    """

    n: int
    r: int
    m: int
    p: int
    d: int
    q: int
    output_correlation: Array
    state_correlation: Array
    output_groups: Indices
    state_groups: Indices
    input_precision: Array
    prior: Prior
    state_precision: Array | None = None

    @property
    def sizes(self) -> Sizes:
        """n, r and m."""
        return self.n, self.r, self.m

    @property
    def errors(self) -> tuple[slice, slice, slice]:
        """Rows of ε̃: prediction errors of outputs, of inputs, of states."""
        y = self.m * (self.p + 1)
        v = y + self.r * (self.d + 1)
        return slice(0, y), slice(y, v), slice(v, v + self.n * (self.q + 1))

    @property
    def about_zero(self) -> slice:
        """Rows of ε̃ after these: x itself, where its precision is given."""
        end = self.errors[2].stop
        return slice(end, end if self.state_precision is None else end + self.n)

    @property
    def hidden(self) -> slice:
        """Where X = [x̃; ṽ] begins in the joint vector [ỹ; η̃; X]; before it are the data."""
        return slice(self.m * (self.p + 1) + self.r * (self.d + 1), None)

    def error_operator(self, theta: Array) -> Array:
        """Returns E with ε̃ = E [ỹ; η̃; x̃; ṽ]: the three prediction errors below Eq. ``free_E``, stacked."""
        fixed, (rows, columns, parameters) = self._operator_parts
        operator = fixed.copy()
        operator[rows, columns] = -theta[parameters]
        return operator

    @cached_property
    def _operator_parts(self) -> tuple[Array, tuple[Indices, Indices, Indices]]:
        """E at θ = 0; rows and columns of the places in E that hold a parameter, and which: −C̃, −Ã and −B̃."""
        n, r, m = self.sizes
        of_y, of_v, of_x = self.errors
        y = of_y.stop
        data = of_v.stop
        v = data - y
        x = n * (self.p + 1)
        at_x = slice(data, data + x)
        at_v = slice(at_x.stop, None)
        fixed = np.zeros((self.about_zero.stop, at_x.stop + v))
        fixed[self.about_zero, at_x] = np.eye(self.about_zero.stop - self.about_zero.start, x)
        fixed[of_y, :y] = np.eye(y)
        fixed[of_v, y:data] = -np.eye(v)
        fixed[of_v, at_v] = np.eye(v)
        # D moves every block up by one order. The highest order's derivative is not modelled: D's last row is zero, or,
        # for q < p, not there.
        fixed[of_x, at_x] = np.eye(of_x.stop - of_x.start, x, k=n)
        # Numbered from 1, so that the zeros of the Kronecker products stay no parameter's place.
        A, B, C = (
            part.astype(int) for part in unpack(1.0 + np.arange(n * n + n * r + m * n), n, r, m)
        )
        number = np.zeros(fixed.shape, int)
        p = self.p + 1
        d = self.d + 1
        q = self.q + 1
        number[of_y, at_x] = np.kron(np.eye(p, dtype=int), C)
        number[of_x, at_x] = np.kron(np.eye(q, p, dtype=int), A)
        number[of_x, at_v] = np.kron(np.eye(q, d, dtype=int), B)
        rows, columns = np.nonzero(number)
        return fixed, (rows, columns, number[rows, columns] - 1)

    def _pairs(self, precision: Array, moments: Array) -> Array:
        """(P, P) precision of the errors times moments of what parameters multiply, of each pair of places in E."""
        _, (rows, columns, _) = self._operator_parts
        return precision[np.ix_(rows, rows)] * moments[np.ix_(columns, columns)]

    @cached_property
    def _of_parameters(self) -> Array:
        """(P, k) 1 where a place in E holds a parameter: adds up places by parameter."""
        _, (_, _, parameters) = self._operator_parts
        return np.eye(len(self.prior.theta_mean))[parameters]

    def parameter_precision(self, weights: Array, joint: Array) -> Array:
        """Returns (k, k) curvature by θ of ½ Σ ε̃ᵀ Π̃ ε̃.

        It is for noise precisions e^λ and second moments of [ỹ; η̃; X].
        """
        each = self._pairs(self.precision(weights), joint)
        return self._of_parameters.T @ each @ self._of_parameters

    def parameter_slope(self, weights: Array, products: Array) -> Array:
        """Returns (k,) slope by θ of −½ Σ ε̃ᵀ Π̃ ε̃.

        It is for noise precisions e^λ and second moments of ε̃ with [ỹ; η̃; X].
        """
        _, (rows, columns, _) = self._operator_parts
        return (self.precision(weights) @ products)[rows, columns] @ self._of_parameters

    def state_uncertainty(self, weights: Array, theta_covariance: Array) -> Array:
        """Returns (dim X, dim X) M with −½ XᵀM X the share of W^θ that a sample's X makes."""
        _, (rows, columns, parameters) = self._operator_parts
        unit = self.precision(weights)[np.ix_(rows, rows)]
        each = unit * theta_covariance[np.ix_(parameters, parameters)]
        size = self.n * (self.p + 1) + self.r * (self.d + 1)
        of_states = np.eye(size)[columns - self.hidden.start]
        return of_states.T @ each @ of_states

    def parameter_spread(self, joint: Array, theta_covariance: Array) -> Array:
        """Returns Σ ε̃ᵀ (S⊗Ω_g) ε̃ that the uncertainty of θ adds for each λ, (g,).

        It is for second moments of [ỹ; η̃; X].
        """
        unit, groups = self._precision_parts
        _, (rows, _, parameters) = self._operator_parts
        each = self._pairs(unit, joint) * theta_covariance[np.ix_(parameters, parameters)]
        return np.asarray(np.bincount(groups[rows], each.sum(axis=0)), float)

    def precision(self, weights: Array) -> Array:
        """Returns Π̃ = blockdiag(S⊗Πᶻ, P̃ᵛ, S⊗Πʷ) for noise precisions ``weights`` (g,), which are e^λ."""
        unit, groups = self._precision_parts
        # Ω is diagonal, so each error's column is scaled by its own noise precision; those of inputs by 1.
        return unit * np.append(weights, 1.0)[groups]

    @cached_property
    def _precision_parts(self) -> tuple[Array, Indices]:
        """Π̃ at λ = 0, and for each column its entry of λ, or −1."""
        of_y, of_v, of_x = self.errors
        unit = np.zeros((self.about_zero.stop, self.about_zero.stop))
        unit[of_y, of_y] = np.kron(self.output_correlation, np.eye(self.m))
        unit[of_v, of_v] = self.input_precision
        unit[of_x, of_x] = np.kron(self.state_correlation, np.eye(self.n))
        if self.state_precision is not None:
            unit[self.about_zero, self.about_zero] = self.state_precision
        groups = np.full(len(unit), -1)
        groups[of_y] = np.tile(self.output_groups, self.p + 1)
        groups[of_x] = np.tile(self.state_groups, self.q + 1)
        return unit, groups

    def log_precision(self, lambda_: Array) -> float:
        """Returns ln|Π̃|."""
        return float(self.log_precision_at_zero + self.log_precision_slope @ lambda_)

    @cached_property
    def log_precision_slope(self) -> Array:
        """∂ ln|Π̃| / ∂λ, (g,): ln|Π̃| is linear in λ."""
        _, groups = self._precision_parts
        return np.bincount(groups[groups >= 0]).astype(float)

    @cached_property
    def log_precision_at_zero(self) -> float:
        """ln|Π̃| at λ = 0."""
        return np.linalg.slogdet(self._precision_parts[0])[1]

    @cached_property
    def log_precision_of_priors(self) -> tuple[float, float]:
        """ln|P^θ| and ln|P^λ|."""
        return logdet(self.prior.theta_precision), logdet(self.prior.lambda_precision)

    def squared_errors(self, moments: Array) -> Array:
        """Returns Σ ε̃ᵀ (S⊗Ω_g) ε̃ for each λ, (g,), of second moments Σ ε̃ε̃ᵀ of the errors."""
        unit, groups = self._precision_parts
        noisy = groups >= 0
        squares = np.bincount(groups[noisy], (unit * moments).sum(axis=0)[noisy])
        return np.asarray(squares, float)


@dataclass(frozen=True, eq=False)
class GeneralizedMoments:
    """Second moments of data and means, Σ_t [ỹ; η̃; X][ỹ; η̃; X]ᵀ, and what the steps need of them."""

    model: GenerativeModel
    samples: SufficientStatistics
    stack: Array  # (dim [ỹ; η̃; X], dim [ỹ; η̃]): [ỹ; η̃; X] from [ỹ; η̃]

    @classmethod
    def from_state_map(
        cls, model: GenerativeModel, samples: SufficientStatistics, state_map: Array
    ) -> GeneralizedMoments:
        """Returns those of X = L [ỹ; η̃], for L = ``state_map`` (dim X, dim [ỹ; η̃])."""
        return cls(model, samples, np.vstack([np.eye(len(samples.gram)), state_map]))

    @cached_property
    def joint(self) -> Array:
        """The matrix of moments."""
        return self.stack @ self.samples.gram @ self.stack.T

    def products(self, theta: Array) -> Array:
        """Returns Σ_t ε̃ [ỹ; η̃; X]ᵀ."""
        return self.model.error_operator(theta) @ self.stack @ self.samples.gram @ self.stack.T

    def errors(self, theta: Array) -> Array:
        """Returns Σ_t ε̃ε̃ᵀ.

        The errors are taken before the moments, since they are far smaller than what they lie between.
        """
        errors = self.model.error_operator(theta) @ self.stack
        return errors @ self.samples.gram @ errors.T

    def squared_errors(self, theta: Array) -> Array:
        """Returns Σ_t ε̃ᵀ (S⊗Ω_g) ε̃ for each λ, (g,)."""
        return self.model.squared_errors(self.errors(theta))
