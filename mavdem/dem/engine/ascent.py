"""Dynamic Expectation Maximization: D, E and M steps in turn until F̄ converges.

Coordinate steps converge slowly where X and θ are strongly coupled. So rounds are extrapolated.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.dem.engine import steps
from mavdem.dem.engine.free_energy import Belief, optimal_terms
from mavdem.dem.engine.generative import GeneralizedMoments, GenerativeModel, SufficientStatistics
from mavdem.dem.engine.linalg import Array, inverse, solve

# F̄ has converged when two rounds and their extrapolation gain less: so little does not separate two models
CONVERGED_NATS = 0.1


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
        return np.asarray(np.sum(list(self.terms.values()), axis=0))

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

    def __iter__(self) -> Iterator[float]:
        return iter(self.total.tolist())


@dataclass(frozen=True, eq=False)
class Learning:
    """The estimates by iteration: rows are those of :class:`FreeEnergy`.

    Attributes:
        theta, theta_sd: (I + 1, k) in physical units, θ = [vec(Aᵀ); vec(Bᵀ); vec(Cᵀ)] without the trim offset; those of
            an ``Ascent`` in the engine's, with it.
        lambda_, lambda_sd: (I + 1, g) log noise precisions in the engine's units: measurement noise, process noise.
    """

    theta: Array
    theta_sd: Array
    lambda_: Array
    lambda_sd: Array


@dataclass(frozen=True, eq=False)
class Ascent:
    """The iterations of one fit, in the engine's units."""

    belief: Belief  # at the end
    state_map: Array  # L with X = L [ỹ; η̃], of the last D step's exact limit
    free_energy: FreeEnergy
    learning: Learning
    # whether rounds gained less than ``CONVERGED_NATS`` before the iterations ran out
    converged: bool
    # (I + 1,) whether the D step followed its flow, stable and not lowering F̄, or its limit
    flowed: NDArray[np.bool_]


class Rates(NamedTuple):
    """Learning rates of Eq. ``GA_basic``; ``None`` is the exact limit k → ∞, in which each step goes to its maximum.

    ``state``: k^X, in 1/s per unit of F; ``theta`` and ``lambda_``: k^θ and k^λ, per round and unit of F̄; all in the
    engine's units. A finite k^X needs the data themselves, as ``segments``, at their sampling step ``dt``.
    """

    state: float | None = None
    theta: float | None = None
    lambda_: float | None = None
    segments: tuple[Array, ...] = ()  # of generalized data [ỹ; η̃], (T, ·) each
    dt: float = 0.0

    @property
    def exact(self) -> bool:
        """Whether every step goes to its maximum."""
        return self.state is None and self.theta is None and self.lambda_ is None


EXACT_RATES = Rates()

ROUNDS_AT_FIXED_THETA = 3  # rounds of D and M steps with θ fixed: λ and X then converge quickly
LARGEST_LAMBDA = 150.0  # noise precisions beyond e^±150 are lost in rounding


def ascend(
    model: GenerativeModel,
    samples: SufficientStatistics,
    iterations: int,
    rates: Rates = EXACT_RATES,
) -> Ascent:
    """Maximises F̄ by at most ``iterations`` rounds from the priors' means.

    After each round the covariances are set to their optimum, so F̄ᵒ increases monotonically. After every two rounds a
    third starts from an extrapolation, and is kept if F̄ᵒ increases. When they gain less than ``CONVERGED_NATS``, F̄ has
    converged. With finite rates there is no extrapolation and no convergence; a flow of X that is unstable, or that
    would lower F̄, is replaced by its exact limit in that round. ``LinAlgError`` where at the start a curvature is not
    negative definite.
    """
    ascent = CoordinateAscent(model, samples, rates)
    iterates = [ascent.start()]
    converged = False
    while not converged and len(iterates) <= iterations:
        before = iterates[-1].free_energy
        iterates += islice(ascent.rounds(iterates[-1]), iterations + 1 - len(iterates))
        gained = iterates[-1].free_energy - before
        converged = rates.exact and gained < CONVERGED_NATS
    beliefs = [iterate.belief for iterate in iterates]
    return Ascent(
        belief=beliefs[-1],
        state_map=iterates[-1].state_map,
        free_energy=FreeEnergy(
            {
                name: np.array([iterate.terms[name] for iterate in iterates])
                for name in iterates[0].terms
            }
        ),
        learning=Learning(
            np.array([belief.theta for belief in beliefs]),
            np.sqrt([np.diag(belief.theta_covariance) for belief in beliefs]),
            np.array([belief.lambda_ for belief in beliefs]),
            np.sqrt([np.diag(belief.lambda_covariance) for belief in beliefs]),
        ),
        converged=converged,
        flowed=np.array([iterate.flowed for iterate in iterates]),
    )


def plain_rounds(
    model: GenerativeModel, samples: SufficientStatistics, number: int
) -> list[Belief]:
    """The belief at the start and after each of so many rounds, without extrapolation or a test of convergence."""
    ascent = CoordinateAscent(model, samples)
    iterates = [ascent.start()]
    for _ in range(number):
        iterates.append(ascent.round(iterates[-1], iterates[-1].belief))
    return [iterate.belief for iterate in iterates]


@dataclass(frozen=True, eq=False)
class Iterate:
    """One iterate of the ascent: a belief with optimal precisions, X from the data, and the terms of F̄ᵒ by name."""

    belief: Belief
    state_map: Array
    terms: Mapping[str, float]
    flowed: bool  # whether X came of a flow at a finite rate

    @property
    def free_energy(self) -> float:
        """F̄ᵒ."""
        return sum(self.terms.values())


@dataclass(frozen=True, eq=False)
class CoordinateAscent:
    """Rounds of D, E and M steps on one model and data."""

    model: GenerativeModel
    samples: SufficientStatistics
    rates: Rates = EXACT_RATES

    def start(
        self, given: tuple[Array, Array] | None = None, lambda_covariance: Array | None = None
    ) -> Iterate:
        """At ``given`` θ (k,) and λ (g,), or the priors' means, with the prior's covariance of λ or another (g, g)."""
        prior = self.model.prior
        theta, lambda_ = given or (prior.theta_mean, prior.lambda_mean)
        certain = np.zeros_like(prior.theta_precision)
        # The first D step takes the parameters for certain: a weak prior's mean-field term would erase the states.
        uncertain = (
            inverse(prior.lambda_precision) if lambda_covariance is None else lambda_covariance
        )
        state_map = steps.d_step(self.model, theta, certain, lambda_, uncertain)
        moments = GeneralizedMoments.of(self.model, self.samples, state_map)
        return self._iterate(
            Belief(moments, np.empty(0), theta, certain, lambda_, np.empty(0)),
            state_map,
            flowed=False,
        )

    def at_belief(self, belief: Belief) -> Iterate:
        """The iterate of a belief, with X at its maximum."""
        state_map = steps.d_step(
            self.model,
            belief.theta,
            belief.theta_covariance,
            belief.lambda_,
            belief.lambda_covariance,
        )
        moments = GeneralizedMoments.of(self.model, self.samples, state_map)
        return self._iterate(belief._replace(moments=moments), state_map, flowed=False)

    def at_theta(self, theta: Array, belief: Belief) -> Iterate:
        """D and M steps in turn with θ fixed at ``theta``, from a belief: the λ and X that belong to that θ."""
        iterate = self.at_belief(belief._replace(theta=theta))
        for _ in range(ROUNDS_AT_FIXED_THETA):
            lambda_ = steps.m_step(self.model, self.samples, iterate.belief)
            iterate = self.at_belief(iterate.belief._replace(lambda_=lambda_))
            _require_sane(iterate.belief.lambda_)
        return iterate

    def rounds(self, now: Iterate) -> Iterator[Iterate]:
        """Two rounds in turn and, with exact rates, one from their extrapolation."""
        first = self.round(now, now.belief)
        yield first
        second = self.round(first, first.belief)
        yield second
        ahead = _extrapolated(now.belief, first.belief, second.belief) if self.rates.exact else None
        if ahead is not None:
            yield self.round(second, ahead)

    def round(self, now: Iterate, start: Belief) -> Iterate:
        """D, E and M steps from ``start``; ``now`` again if F̄ᵒ would decrease.

        From ``now`` itself only rounding can decrease it; from an extrapolation anything can.
        """
        for flowed in (False,) if self.rates.state is None else (True, False):
            try:
                then = self._steps(start, flowed, known=start is now.belief)
            except (np.linalg.LinAlgError, FloatingPointError):
                # An unstable flow, or noise so small, or an extrapolation so far, that the rest is lost in rounding.
                continue
            if then.free_energy >= now.free_energy:
                return then
        return now

    def _steps(self, start: Belief, flowed: bool, known: bool) -> Iterate:
        """A D step, by the flow or in its exact limit, and E and M steps after it.

        The covariances of a ``known`` start are already optimal and are updated at the end of the round: updating them
        after each step as well would raise F̄ hardly more, at twice the cost.
        """
        model = self.model
        samples = self.samples
        rates = self.rates
        _require_sane(start.lambda_)
        slope = steps.state_slope(
            model, start.theta, start.theta_covariance, start.lambda_, start.lambda_covariance
        )
        state_map = solve(slope[1], slope[0])
        if flowed:
            assert rates.state is not None
            moments = steps.StateFlow.of(model, *slope, rates.state).moments(
                model, rates.segments, rates.dt
            )
        else:
            moments = GeneralizedMoments.of(model, samples, state_map)
        belief = start._replace(moments=moments)
        if not known:
            belief = steps.with_optimal_precisions(model, belief)
        belief = belief._replace(theta=steps.e_step(model, samples, belief, rates.theta))
        belief = belief._replace(lambda_=steps.m_step(model, samples, belief, rates.lambda_))
        _require_sane(belief.lambda_)
        return self._iterate(belief, state_map, flowed)

    def _iterate(self, belief: Belief, state_map: Array, flowed: bool) -> Iterate:
        belief = steps.with_optimal_precisions(self.model, belief)
        return Iterate(belief, state_map, optimal_terms(self.model, self.samples, belief), flowed)


def _require_sane(lambda_: Array) -> None:
    if not np.abs(lambda_).max() < LARGEST_LAMBDA:
        raise np.linalg.LinAlgError("a noise precision diverges")


def _extrapolated(first: Belief, second: Belief, third: Belief) -> Belief | None:
    """θ and λ extrapolated from three rounds; None if that is not beyond the third.

    Squared extrapolation of a fixed-point iteration (Varadhan and Roland 2008, scheme S3), in units of the posterior.
    """
    unit = np.sqrt(
        np.concatenate([np.diag(third.theta_covariance), np.diag(third.lambda_covariance)])
    )
    a, b, c = (
        np.concatenate([belief.theta, belief.lambda_]) / unit for belief in (first, second, third)
    )
    step = b - a
    bend = (c - b) - (b - a)
    if not np.linalg.norm(step) > np.linalg.norm(bend) > 0:
        return None
    length = float(np.linalg.norm(step) / np.linalg.norm(bend))
    theta, lambda_ = np.split((a + 2 * length * step + length**2 * bend) * unit, [len(third.theta)])
    return third._replace(theta=theta, lambda_=lambda_)
