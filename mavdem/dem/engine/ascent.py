"""Dynamic Expectation Maximization: D, E and M steps in turn until F̄ converges."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.linalg import LinAlgError

from mavdem.arrays import Array, ArrayPair
from mavdem.dem.engine import steps
from mavdem.dem.engine.free_energy import Posterior, free_energy_terms
from mavdem.dem.engine.generative import GeneralizedMoments, GenerativeModel, SufficientStatistics
from mavdem.dem.engine.linalg import inverse

# F̄ has converged when a round gains less: so little does not separate two models
CONVERGED_ROUND_NATS = 0.02


@dataclass(frozen=True, eq=False)
class FreeEnergy:
    """F̄ᵒ by iteration, row 0 being the priors' means; behaves as its array of totals, (I + 1,).

    Attributes:
        terms: the named terms of Eq. ``F_action_opt``, (I + 1,) each, which sum to the total.
    """

    terms: Mapping[str, Array]

    @cached_property
    def total(self) -> Array:
        """F̄ᵒ by iteration, (I + 1,)."""
        return np.sum(list(self.terms.values()), axis=0)

    @property
    def gained(self) -> float:
        """Nats gained from the priors' means to the end."""
        return float(self.total[-1] - self.total[0])

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Array:
        return np.array(self.total, dtype=dtype)

    def __len__(self) -> int:
        return len(self.total)

    def __getitem__(self, index: Any) -> Any:
        return self.total[index]


@dataclass(frozen=True, eq=False)
class Learning:
    """The estimates by iteration: rows are those of :class:`FreeEnergy`.

    Attributes:
        theta, theta_sd: (I + 1, k) in physical units, θ = [vec(Aᵀ); vec(Bᵀ); vec(Cᵀ)] without the trim offset; those of
            an ``CoordinateAscent`` in the engine's, with it.
        lambda_, lambda_sd: (I + 1, g) log noise precisions in the engine's units: measurement noise, process noise.
    """

    theta: Array
    theta_sd: Array
    lambda_: Array
    lambda_sd: Array


@dataclass(frozen=True, eq=False)
class CoordinateAscent:
    """The iterations of one fit, in the engine's units."""

    posterior: Posterior  # at the end
    free_energy: FreeEnergy
    learning: Learning
    # whether a round gained less than ``CONVERGED_ROUND_NATS`` before the iterations ran out
    converged: bool


ROUNDS_AT_FIXED_THETA = 3  # rounds of D and M steps with θ fixed: λ and X then converge quickly
LARGEST_LAMBDA = 150.0  # noise precisions beyond e^±150 are lost in rounding


def maximise_free_energy(
    model: GenerativeModel, samples: SufficientStatistics, iterations: int
) -> CoordinateAscent:
    """Maximises F̄ by at most ``iterations`` rounds from the priors' means.

    After each round the covariances are set to their optimum, so F̄ᵒ increases monotonically. When a round gains less
    than ``CONVERGED_ROUND_NATS``, F̄ has converged.
    """
    iterates, converged = continued(started(model, samples), iterations)
    posteriors = [iterate.posterior for iterate in iterates]
    return CoordinateAscent(
        posterior=posteriors[-1],
        free_energy=FreeEnergy(
            {
                name: np.array([iterate.terms[name] for iterate in iterates])
                for name in iterates[0].terms
            }
        ),
        learning=Learning(
            np.array([posterior.theta for posterior in posteriors]),
            np.sqrt([np.diag(posterior.theta_covariance) for posterior in posteriors]),
            np.array([posterior.lambda_ for posterior in posteriors]),
            np.sqrt([np.diag(posterior.lambda_covariance) for posterior in posteriors]),
        ),
        converged=converged,
    )


def posterior_after_each_round(
    model: GenerativeModel, samples: SufficientStatistics, number: int
) -> list[Posterior]:
    """Returns the posterior at the start and after each of so many rounds, without a test of convergence."""
    iterates = [started(model, samples)]
    for _ in range(number):
        iterates.append(_round(iterates[-1], iterates[-1].posterior))
    return [iterate.posterior for iterate in iterates]


@dataclass(frozen=True, eq=False)
class Iterate:
    """One iterate of the ascent: a posterior with optimal precisions, and the terms of F̄ᵒ by name."""

    posterior: Posterior
    terms: Mapping[str, float]

    @property
    def free_energy(self) -> float:
        """F̄ᵒ."""
        return sum(self.terms.values())


def started(
    model: GenerativeModel,
    samples: SufficientStatistics,
    given: ArrayPair | None = None,
    lambda_covariance: Array | None = None,
) -> Iterate:
    """Starts at ``given`` θ (k,) and λ (g,), or the priors' means, with λ's prior covariance or another (g, g)."""
    prior = model.prior
    theta, lambda_ = given or (prior.theta_mean, prior.lambda_mean)
    # The first D step takes the parameters for certain: a weak prior's mean-field term would erase the states.
    certain = np.zeros_like(prior.theta_precision)
    uncertain = inverse(prior.lambda_precision) if lambda_covariance is None else lambda_covariance
    none = np.empty(0)
    unstated = GeneralizedMoments.from_state_map(model, samples, np.empty((0, len(samples.gram))))
    posterior = Posterior(unstated, none, theta, certain, lambda_, uncertain)
    return _iterate(_d_step(posterior))


def continued(start: Iterate, iterations: int) -> tuple[list[Iterate], bool]:
    """Returns the iterates from ``start`` on, after at most so many rounds, and whether F̄ has converged.

    Where X and θ are strongly coupled, rounds converge slowly. So each begins ever further along the last one's change
    of θ and λ, as long as F̄ᵒ increases (Salakhutdinov and Roweis, "Adaptive overrelaxed bound optimization", 2003).
    """
    iterates = [start]
    reach = 0.0
    while len(iterates) <= iterations:
        now = iterates[-1]
        before = iterates[-2:][0].posterior
        theta = now.posterior.theta + reach * (now.posterior.theta - before.theta)
        lambda_ = now.posterior.lambda_ + reach * (now.posterior.lambda_ - before.lambda_)
        then = _round(now, now.posterior._replace(theta=theta, lambda_=lambda_))
        gains = then.free_energy - now.free_energy > CONVERGED_ROUND_NATS
        if gains or not reach:
            iterates.append(then)
        if not gains and not reach:
            return iterates, True
        reach = 2 * reach + 0.5 if gains else 0.0
    return iterates, False


def condition_on_theta(theta: Array, posterior: Posterior) -> Posterior:
    """Takes D and M steps in turn with θ fixed at ``theta``, from a posterior, to the λ and X that belong to that θ."""
    posterior = _d_step(posterior._replace(theta=theta))
    for _ in range(ROUNDS_AT_FIXED_THETA):
        posterior = steps.with_optimal_covariances(posterior)
        posterior = posterior._replace(lambda_=_m_step(posterior))
        posterior = _d_step(posterior)
    return steps.with_optimal_covariances(posterior)


def _round(now: Iterate, start: Posterior) -> Iterate:
    """D, E and M steps from ``start``; ``now`` again if F̄ᵒ would decrease.

    From ``now`` itself only rounding can decrease it; from further on anything can. The covariances are updated at the
    end of the round: updating them after each step as well would raise F̄ hardly more, at twice the cost.
    """
    try:
        posterior = _d_step(start)
        posterior = posterior._replace(theta=steps.e_step(posterior))
        posterior = posterior._replace(lambda_=_m_step(posterior))
        then = _iterate(posterior)
    except (LinAlgError, FloatingPointError):
        # Noise so small, or a start so far, that the rest is lost in rounding.
        return now
    return then if then.free_energy >= now.free_energy else now


def _d_step(posterior: Posterior) -> Posterior:
    """A posterior with X at its maximum."""
    moments = GeneralizedMoments.from_state_map(
        posterior.model, posterior.samples, steps.d_step(posterior)
    )
    return posterior._replace(moments=moments)


def _m_step(posterior: Posterior) -> Array:
    lambda_ = steps.m_step(posterior)
    if not abs(lambda_).max() < LARGEST_LAMBDA:
        raise LinAlgError("a noise precision diverges")
    return lambda_


def _iterate(posterior: Posterior) -> Iterate:
    posterior = steps.with_optimal_covariances(posterior)
    return Iterate(posterior, free_energy_terms(posterior))
