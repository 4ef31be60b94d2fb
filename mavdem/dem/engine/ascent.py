"""Iteration of DEM: steps for states X (D), parameters θ (E), noise precisions λ (M) until the free energy F̄ converges.

Dynamic Expectation Maximization (DEM) fits a model by maximising its free energy F̄.

The steps are coordinate ascent on one function: each maximises F̄ over one quantity, so F̄ never decreases. A round is
one D, one E and one M step, after which the covariances are set to their optimum. F̄ᵒ is F̄ at optimal covariances.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.linalg import LinAlgError

from mavdem.arrays import Array
from mavdem.dem.engine import steps
from mavdem.dem.engine.free_energy import Posterior, free_energy_terms
from mavdem.dem.engine.generative import GenerativeModel
from mavdem.dem.engine.linalg import inverse
from mavdem.dem.engine.moments import GeneralizedMoments, SufficientStatistics

CONVERGED_ROUND_NATS = 0.02
"""Gain of F̄ by a round, nats, below which F̄ has converged.

A choice: strong evidence for one of two models is 3 nats or more, so such a gain does not decide between models.
"""

ROUNDS_AT_FIXED_THETA = 3
"""Rounds of D and M steps for a given θ; λ and the states converge within a few, since only θ couples them slowly."""

FIRST_EXTRAPOLATION = 0.5
"""Extrapolation of the first round that extrapolates, in units of the last change of θ and λ.

A choice: after every gain it is doubled, and increased by this number.
"""

MAX_ABS_LAMBDA = 150.0
"""Largest log noise precision; beyond e^±150 all other terms are lost in rounding."""


@dataclass(frozen=True, eq=False)
class FreeEnergy:
    """The free energy action F̄ᵒ by iteration, nats; row 0 is at the prior means.

    It behaves like the array of its totals, (I + 1,), where I is the number of iterations.
    """

    terms: Mapping[str, Array]
    """The named terms of Eq. ``F_action_opt``, (I + 1,) each, which sum to the total."""

    @cached_property
    def total(self) -> Array:
        """F̄ᵒ by iteration, (I + 1,), nats."""
        return np.sum(list(self.terms.values()), axis=0)

    @property
    def gained(self) -> float:
        """Increase of F̄ᵒ from the prior means to the last iteration, nats."""
        return float(self.total[-1] - self.total[0])

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Array:
        return np.array(self.total, dtype=dtype)

    def __len__(self) -> int:
        return len(self.total)

    def __getitem__(self, index: Any) -> Any:
        return self.total[index]


@dataclass(frozen=True, eq=False)
class Learning:
    """Estimates of parameters and noise precisions by iteration; the rows are as in :class:`FreeEnergy`.

    A result has θ = [vec(Aᵀ); vec(Bᵀ); vec(Cᵀ)] in physical units, without the column of B for the trim. A
    :class:`CoordinateAscent` has it in the units of the engine, with that column.
    """

    theta: Array
    """(I + 1, k) posterior means of θ."""

    theta_sd: Array
    """(I + 1, k) posterior standard deviations of θ."""

    lambda_: Array
    """(I + 1, g) log noise precisions in the units of the engine: of measurement noise, then of process noise."""

    lambda_sd: Array
    """(I + 1, g) their posterior standard deviations."""


@dataclass(frozen=True, eq=False)
class CoordinateAscent:
    """All iterations of one fit, in the units of the engine."""

    posterior: Posterior
    """The posterior after the last iteration."""

    free_energy: FreeEnergy
    """F̄ᵒ by iteration."""

    learning: Learning
    """Estimates by iteration."""

    converged: bool
    """Whether F̄ converged before the iterations ran out."""


@dataclass(frozen=True, eq=False)
class Iterate:
    """One iterate of the ascent: a posterior with optimal covariances, and its free energy."""

    posterior: Posterior
    """Means and optimal covariances of X, θ and λ."""

    terms: Mapping[str, float]
    """The terms of F̄ᵒ by name, nats."""

    @property
    def free_energy(self) -> float:
        """F̄ᵒ, nats."""
        return sum(self.terms.values())


def maximise_free_energy(
    model: GenerativeModel, samples: SufficientStatistics, iterations: int
) -> CoordinateAscent:
    """Maximises the free energy F̄ by rounds of D, E and M steps, starting from the prior means of θ and λ.

    Args:
        model: the linear model with its noises and priors, whose free energy is maximised.
        samples: statistics of the generalized data.
        iterations: largest number of rounds.

    Returns:
        The last posterior, whether F̄ converged, and the course of F̄, θ and λ: one row for each iteration, the prior
        means first.

    Raises:
        numpy.linalg.LinAlgError: a curvature at the prior means is not negative definite.
    """
    iterates, converged = run_rounds(initial_iterate(model, samples), iterations)
    # The terms of F̄ by name, each over the iterations.
    terms = {}
    for name in iterates[0].terms:
        terms[name] = np.array([iterate.terms[name] for iterate in iterates])
    posteriors = [iterate.posterior for iterate in iterates]
    theta_variances = [np.diag(posterior.theta_covariance) for posterior in posteriors]
    lambda_variances = [np.diag(posterior.lambda_covariance) for posterior in posteriors]
    learning = Learning(
        theta=np.array([posterior.theta for posterior in posteriors]),
        theta_sd=np.sqrt(theta_variances),
        lambda_=np.array([posterior.lambda_ for posterior in posteriors]),
        lambda_sd=np.sqrt(lambda_variances),
    )
    return CoordinateAscent(posteriors[-1], FreeEnergy(terms), learning, converged)


def posterior_after_each_round(
    model: GenerativeModel, samples: SufficientStatistics, rounds: int
) -> list[Posterior]:
    """Runs a fixed number of rounds from the prior means, without extrapolation and without a test of convergence.

    Args:
        model: the linear model with its noises and priors, whose free energy is maximised.
        samples: statistics of the generalized data.
        rounds: number of rounds.

    Returns:
        The posterior at the start and after each round, ``rounds`` + 1 in all.
    """
    iterates = [initial_iterate(model, samples)]
    for _ in range(rounds):
        iterates.append(_next_iterate(iterates[-1], iterates[-1].posterior))
    return [iterate.posterior for iterate in iterates]


def initial_iterate(
    model: GenerativeModel,
    samples: SufficientStatistics,
    theta: Array | None = None,
    lambda_covariance: Array | None = None,
) -> Iterate:
    """Returns the first estimate of DEM: given θ and λ, a D step has estimated the states.

    The D step alone cannot use the uncertainty of θ: with a weak prior, its mean-field term would shrink the states to
    0. So this first step treats θ as exact. Afterwards all covariances are set to their optimal values.

    Args:
        model: the linear model with its noises and priors, whose free energy is maximised.
        samples: statistics of the generalized data.
        theta: (k,) θ to start from; None for its prior mean. λ starts from its prior mean.
        lambda_covariance: (g, g) covariance of λ in the first D step; None for the prior's.

    Returns:
        This θ and λ with the states that are optimal for them, optimal covariances, and the free energy F̄ᵒ.

    Raises:
        numpy.linalg.LinAlgError: a curvature at the start is not negative definite.
    """
    prior = model.prior
    if theta is None:
        theta = prior.theta_mean
    if lambda_covariance is None:
        lambda_covariance = inverse(prior.lambda_precision)
    # The D step needs the data and a posterior of θ and λ, but no earlier estimate of the states.
    no_states = GeneralizedMoments.from_state_map(
        model, samples, state_map=np.empty((0, len(samples.gram)))
    )
    posterior = Posterior(
        moments=no_states,
        # The first D step estimates the states, and does not use their covariance.
        state_covariance=np.empty(0),
        theta=theta,
        theta_covariance=np.zeros_like(prior.theta_precision),
        lambda_=prior.lambda_mean,
        lambda_covariance=lambda_covariance,
    )
    return _optimal_iterate(_after_d_step(posterior))


def run_rounds(start: Iterate, iterations: int) -> tuple[list[Iterate], bool]:
    """Runs rounds of D, E and M steps until F̄ converges.

    If the states and θ are strongly coupled, plain rounds converge slowly. So each round starts from θ and λ that are
    extrapolated along their last change, and the extrapolation grows as long as F̄ᵒ increases. A round that does not
    increase F̄ᵒ is discarded, and the next one starts without extrapolation (Salakhutdinov and Roweis, "Adaptive
    overrelaxed bound optimization methods", ICML 2003).

    Args:
        start: the posterior, with its free energy, from which the iteration starts.
        iterations: largest number of iterates after it.

    Returns:
        The iterates, ``start`` first, and whether F̄ has converged: a round without extrapolation increased it by less
        than ``CONVERGED_ROUND_NATS``.
    """
    iterates = [start]
    extrapolation = 0.0
    while len(iterates) <= iterations:
        current = iterates[-1]
        previous = iterates[-2].posterior if len(iterates) > 1 else current.posterior
        theta_change = current.posterior.theta - previous.theta
        lambda_change = current.posterior.lambda_ - previous.lambda_
        extrapolated_posterior = current.posterior._replace(
            theta=current.posterior.theta + extrapolation * theta_change,
            lambda_=current.posterior.lambda_ + extrapolation * lambda_change,
        )
        candidate = _next_iterate(current, extrapolated_posterior)
        has_gained = candidate.free_energy - current.free_energy > CONVERGED_ROUND_NATS
        if has_gained:
            iterates.append(candidate)
            extrapolation = 2 * extrapolation + FIRST_EXTRAPOLATION
        elif extrapolation:
            # The extrapolation went too far. The candidate is discarded, and a plain round follows.
            extrapolation = 0.0
        else:
            # Even a round without extrapolation hardly increases F̄ᵒ.
            iterates.append(candidate)
            return iterates, True
    return iterates, False


def condition_on_theta(theta: Array, posterior: Posterior) -> Posterior:
    """Estimates the noise precisions and the states for parameters that another method has estimated.

    D and M steps alternate with fixed θ for ``ROUNDS_AT_FIXED_THETA`` rounds.

    Args:
        theta: (k,) the parameters.
        posterior: posterior whose λ and covariances the iteration starts from.

    Returns:
        The posterior with the given θ, and with the λ, states and covariances that are optimal for it.
    """
    posterior = _after_d_step(posterior._replace(theta=theta))
    for _ in range(ROUNDS_AT_FIXED_THETA):
        posterior = steps.with_optimal_covariances(posterior)
        posterior = posterior._replace(lambda_=_bounded_m_step(posterior))
        posterior = _after_d_step(posterior)
    return steps.with_optimal_covariances(posterior)


def iterate_at(theta: Array, lambda_: Array, posterior: Posterior) -> Iterate:
    """Returns the posterior at given parameters and noise precisions, with the states that are optimal for them.

    Args:
        theta: (k,) parameters: the entries of the matrices A, B and C.
        lambda_: (g,) log noise precisions.
        posterior: posterior of similar parameters, whose covariances are used in the D step.

    Returns:
        The posterior with optimal covariances, and its free energy F̄ᵒ.

    Raises:
        numpy.linalg.LinAlgError: a curvature is not negative definite, or a noise precision vanishes or diverges.
    """
    _require_bounded(lambda_)
    return _optimal_iterate(_after_d_step(posterior._replace(theta=theta, lambda_=lambda_)))


def _next_iterate(current: Iterate, start: Posterior) -> Iterate:
    """Performs one round of D, E and M steps, and rejects its result if the free energy F̄ᵒ has decreased.

    If the round starts from the current posterior, only rounding can decrease F̄ᵒ; from an extrapolated one the result
    may be lower. The covariances are updated only at the end of the round: updates after each step would take twice the
    time for hardly any improvement.

    Args:
        current: the latest iterate.
        start: the posterior from which the round starts: the one in ``current``, or an extrapolated one.

    Returns:
        The new iterate, or ``current`` if F̄ᵒ of the new one is lower or the round breaks down.
    """
    try:
        posterior = _after_d_step(start)
        posterior = posterior._replace(theta=steps.e_step(posterior))
        posterior = posterior._replace(lambda_=_bounded_m_step(posterior))
        candidate = _optimal_iterate(posterior)
    except (LinAlgError, FloatingPointError):
        # The noise is so small, or the start so far from the maximum, that all other terms are lost in rounding.
        return current
    return candidate if candidate.free_energy >= current.free_energy else current


def _after_d_step(posterior: Posterior) -> Posterior:
    """Returns the posterior with the states at the maximum of F."""
    moments = GeneralizedMoments.from_state_map(
        posterior.model, posterior.samples, steps.d_step(posterior)
    )
    return posterior._replace(moments=moments)


def _bounded_m_step(posterior: Posterior) -> Array:
    """Returns λ (g,) of the M step; raises ``LinAlgError`` if a noise precision vanishes or diverges."""
    lambda_ = steps.m_step(posterior)
    _require_bounded(lambda_)
    return lambda_


def _require_bounded(lambda_: Array) -> None:
    """Raises ``LinAlgError`` if a log noise precision of λ (g,) is beyond ``MAX_ABS_LAMBDA``, or NaN."""
    if not abs(lambda_).max() < MAX_ABS_LAMBDA:
        raise LinAlgError("a noise precision diverges")


def _optimal_iterate(posterior: Posterior) -> Iterate:
    """Returns the iterate of a posterior's means, with optimal covariances and its free energy."""
    posterior = steps.with_optimal_covariances(posterior)
    return Iterate(posterior, free_energy_terms(posterior))
