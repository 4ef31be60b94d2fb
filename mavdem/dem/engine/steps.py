"""The D, E and M steps: each raises F̄ over one part of the belief with the others held.

X and θ enter F̄ quadratically, so their steps are exact; λ enters through e^λ and takes guarded Newton steps. With a
learning rate k a step follows its gradient flow, Eq. ``GA_basic``, for a while; with k → ∞ to its end, the maximum.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from mavdem.dem.engine.free_energy import (
    Belief,
    expected_weights,
    lambda_curvature,
    state_curvature,
    theta_curvature,
)
from mavdem.dem.engine.generative import (
    GeneralizedMoments,
    GenerativeModel,
    SufficientStatistics,
    derivative_operator,
)
from mavdem.dem.engine.linalg import Array, inverse, solve
from mavdem.dem.engine.model import discretize, recursion

NEWTON_STEPS = 50
LONGEST_STEP = 4.0
"""A step of λ changes a noise precision at most by e⁴: far from the maximum the curvature says little."""
SHORTEST_STEP = 1e-6
"""A step of λ shorter than this ends the M step: Newton's method has then converged to twice as many digits."""


def d_step(
    model: GenerativeModel,
    theta: Array,
    theta_covariance: Array,
    lambda_: Array,
    lambda_covariance: Array,
) -> Array:
    """The D step in the exact limit k → ∞: every sample's X at the maximum of F.

    F is quadratic in X with the same curvature at every sample, so X(t) = L [ỹ(t); η̃(t)] with one L (dim X,
    dim [ỹ; η̃]), which is returned. For finite k^X see :class:`StateFlow`.
    """
    of_data, precision = state_slope(model, theta, theta_covariance, lambda_, lambda_covariance)
    return solve(precision, of_data)


def state_slope(
    model: GenerativeModel,
    theta: Array,
    theta_covariance: Array,
    lambda_: Array,
    lambda_covariance: Array,
) -> tuple[Array, Array]:
    """G (dim X, dim [ỹ; η̃]) and P (dim X, dim X) with ∂F/∂X = G [ỹ; η̃] − P X, mean-field terms of θ and λ included."""
    E = model.error_operator(theta)
    data = E[:, : model.hidden.start]
    X = E[:, model.hidden]
    weighted = X.T @ model.precision(expected_weights(lambda_, lambda_covariance))
    uncertainty = model.state_uncertainty(np.exp(lambda_), theta_covariance)
    return -weighted @ data, weighted @ X + uncertainty


def e_step(
    model: GenerativeModel,
    samples: SufficientStatistics,
    belief: Belief,
    rate: float | None = None,
) -> Array:
    """The E step: θ along the gradient of F̄ given the rest, Eq. ``GA_basic``.

    At a finite ``rate`` k^θ the flow is followed for one unit of its time, exactly, F̄ being quadratic; else to its end.
    """
    gradient, precision = theta_slope(model, samples, belief)
    return belief.theta + _flow(gradient, precision, rate)


def theta_slope(
    model: GenerativeModel, samples: SufficientStatistics, belief: Belief
) -> tuple[Array, Array]:
    """∂F̄/∂θ (k,) and −∂²F̄/∂θ² (k, k), the mean-field terms of X and of λ included."""
    prior = model.prior
    weights = np.exp(belief.lambda_)
    expected = expected_weights(belief.lambda_, belief.lambda_covariance)
    spread = np.zeros_like(belief.moments.joint)
    spread[model.hidden, model.hidden] = samples.number * belief.state_covariance
    gradient = (
        prior.theta_precision @ (prior.theta_mean - belief.theta)
        + model.parameter_slope(expected, belief.moments.products(belief.theta))
        + model.parameter_slope(weights, model.error_operator(belief.theta) @ spread)
    )
    precision = (
        prior.theta_precision
        + model.parameter_precision(expected, belief.moments.joint)
        + model.parameter_precision(weights, spread)
    )
    return gradient, precision


def m_step(
    model: GenerativeModel,
    samples: SufficientStatistics,
    belief: Belief,
    rate: float | None = None,
) -> Array:
    """The M step: λ along the gradient of F̄ given the rest, by steps that are shortened until F̄ rises.

    At a finite ``rate`` k^λ it is one step, as in :func:`e_step` but on the curvature at its start; else Newton's
    method goes to the maximum: F̄ is concave in λ.
    """
    of_lambda = _FreeEnergyOfLambda.of(model, samples, belief)
    lambda_ = belief.lambda_
    value = of_lambda.value(lambda_)
    for _ in range(NEWTON_STEPS if rate is None else 1):
        step = np.clip(_flow(*of_lambda.slope(lambda_), rate), -LONGEST_STEP, LONGEST_STEP)
        while (raised := of_lambda.value(lambda_ + step)) < value and np.abs(
            step
        ).max() > SHORTEST_STEP:
            step = step / 2
        if raised < value:
            break
        lambda_ = lambda_ + step
        value = raised
        if np.abs(step).max() <= SHORTEST_STEP:
            break
    return lambda_


def lambda_slope(
    model: GenerativeModel, samples: SufficientStatistics, belief: Belief
) -> tuple[Array, Array]:
    """∂F̄/∂λ (g,) and −∂²F̄/∂λ² (g, g), the mean-field terms of X and of θ included."""
    return _FreeEnergyOfLambda.of(model, samples, belief).slope(belief.lambda_)


class _FreeEnergyOfLambda(NamedTuple):
    """F̄ as a function of λ alone: −½ Σ_g c_g e^{λ_g} + gain·λ − ½ (λ−η)ᵀP(λ−η) and a constant."""

    cost: Array  # (g,)
    gain: Array  # (g,)
    mean: Array  # (g,)
    precision: Array  # (g, g)

    @classmethod
    def of(
        cls, model: GenerativeModel, samples: SufficientStatistics, belief: Belief
    ) -> _FreeEnergyOfLambda:
        of_X = model.error_operator(belief.theta)[:, model.hidden]
        squares = belief.moments.squared_errors(belief.theta)
        spread = samples.number * model.squared_errors(of_X @ belief.state_covariance @ of_X.T)
        cost = (
            squares * (1.0 + 0.5 * belief.lambda_covariance.diagonal())
            + spread
            + model.parameter_spread(belief.moments.joint, belief.theta_covariance)
        )
        gain = 0.5 * samples.number * model.log_precision_slope
        return cls(cost, gain, model.prior.lambda_mean, model.prior.lambda_precision)

    def value(self, lambda_: Array) -> float:
        error = lambda_ - self.mean
        return float(
            -0.5 * self.cost @ np.exp(lambda_)
            + self.gain @ lambda_
            - 0.5 * error @ self.precision @ error
        )

    def slope(self, lambda_: Array) -> tuple[Array, Array]:
        pull = 0.5 * self.cost * np.exp(lambda_)
        return self.gain - pull - self.precision @ (lambda_ - self.mean), np.diag(
            pull
        ) + self.precision


def _flow(gradient: Array, precision: Array, rate: float | None) -> Array:
    """Where dϑ/da = k (gradient − precision · ϑ) leads from 0 within one unit of a; its limit for an infinite k."""
    if rate is None:
        return solve(precision, gradient)
    values, modes = np.linalg.eigh(precision)
    # Rounding may take the least of very unequal eigenvalues below zero; with none, the flow runs straight on.
    values = np.maximum(values, np.finfo(np.float64).tiny)
    return np.asarray(modes @ (-np.expm1(-rate * values) / values * (modes.T @ gradient)))


def with_optimal_precisions(model: GenerativeModel, belief: Belief) -> Belief:
    """The belief with every covariance at the maximum of F̄, Eq. ``Pi_curvature``."""
    weights = np.exp(belief.lambda_)
    return belief._replace(
        state_covariance=inverse(-state_curvature(model, belief.theta, weights)),
        theta_covariance=inverse(-theta_curvature(model, belief.moments, weights)),
        lambda_covariance=inverse(
            -lambda_curvature(model, belief.moments, belief.theta, belief.lambda_)
        ),
    )


@dataclass(frozen=True, eq=False)
class StateFlow:
    """The flow of X for one F."""

    motion: Array  # J = D − k P, (dim X, dim X) 1/s
    drive: Array  # k G, (dim X, dim [ỹ; η̃])
    # X at a segment's first sample, from its [ỹ; η̃]: the maximum of F, (dim X, dim [ỹ; η̃])
    start: Array

    @classmethod
    def of(
        cls,
        model: GenerativeModel,
        of_data: Array,
        precision: Array,
        rate: float,
    ) -> StateFlow:
        """The flow at k^X = ``rate`` up F, whose slope is ``of_data`` and ``precision`` of ``steps.state_slope``."""
        D = block_diag(derivative_operator(model.p, model.n), derivative_operator(model.d, model.r))
        return cls(D - rate * precision, rate * of_data, solve(precision, of_data))

    @property
    def spectral_abscissa(self) -> float:
        """The largest real part among the eigenvalues of J, 1/s: the flow is stable while it is negative."""
        return float(np.linalg.eigvals(self.motion).real.max())

    def states(self, data: Array, dt: float) -> Array:
        """X at every sample, (T, dim X), for generalized data [ỹ; η̃] (T, ·) that run linearly between samples."""
        transition = discretize(self.motion, self.drive, dt)
        pushes = data[:-1] @ transition.input_now.T + data[1:] @ transition.input_next.T
        first = self.start @ data[0]
        return np.vstack([first, recursion(transition.state, pushes, first)])

    def moments(
        self, model: GenerativeModel, segments: Sequence[Array], dt: float
    ) -> GeneralizedMoments:
        """Second moments of data and X over segments, each of which starts anew; ``LinAlgError`` where unstable."""
        if not self.spectral_abscissa < 0:
            raise np.linalg.LinAlgError("the flow of X is unstable")
        joint = [np.hstack([data, self.states(data, dt)]) for data in segments if len(data)]
        gram = sum((both.T @ both for both in joint), np.zeros(()))
        if not np.isfinite(gram).all():
            raise np.linalg.LinAlgError("the flow of X overflows")
        return GeneralizedMoments(model, gram, np.eye(len(gram)))
