"""Dynamic Expectation Maximization: D, E and M steps in turn until F̄ has settled."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavdem.dem.free_energy import Belief, optimal_terms
from mavdem.dem.generative import GenerativeModel, Moments, Samples
from mavdem.dem.positive import inverse
from mavdem.dem.steps import d_step, e_step, m_step, with_optimal_precisions

Array = NDArray[np.float64]

SETTLED = 0.1
"""Two rounds that gain less than this, in nats over the whole flight, are the last: it would tell no models apart."""


@dataclass(frozen=True, eq=False)
class Ascent:
    """The climb of one fit: the final belief and what each iteration arrived at, row 0 being the start.

    Attributes:
        belief: at the end.
        state_map: L with X = L [ỹ; η̃] at the end.
        terms: each named term of F̄ᵒ, (I + 1,).
        theta, theta_sd: (I + 1, k).
        lambda_, lambda_sd: (I + 1, g).
        settled: whether F̄ stopped rising before the iterations ran out.
    """

    belief: Belief
    state_map: Array
    terms: Mapping[str, Array]
    theta: Array
    theta_sd: Array
    lambda_: Array
    lambda_sd: Array
    settled: bool

    @property
    def free_energy(self) -> Array:
        """F̄ᵒ by iteration, (I + 1,)."""
        return np.asarray(np.sum(list(self.terms.values()), axis=0))


def ascend(model: GenerativeModel, samples: Samples, iterations: int) -> Ascent:
    """Climbs F̄ from the priors' means, for at most so many rounds of D, E and M steps.

    After each step the covariances are set to their optimum, which also raises F̄; so F̄ᵒ is what rises. Steps in turn
    are slow where one part of the belief holds the others (X and θ, when noise is small), but steadily so: after every
    two rounds a third starts from where their course would lead, and is kept if it ends higher.

    Raises:
        numpy.linalg.LinAlgError: at the priors' means a curvature is not negative definite.
    """
    places = [_start(model, samples)]
    settled = False
    while not settled and len(places) < iterations:
        height = places[-1].height
        for _ in range(2):
            places.append(_round(model, samples, places[-1], places[-1].belief))
        ahead = _course(*(place.belief for place in places[-3:]))
        if ahead is not None and len(places) <= iterations:
            places.append(_round(model, samples, places[-1], ahead))
        settled = places[-1].height - height < SETTLED
    if not settled and len(places) <= iterations:
        places.append(_round(model, samples, places[-1], places[-1].belief))
    return _ascent(places, settled)


@dataclass(frozen=True, eq=False)
class _Place:
    """Where the climb has come to: a belief with optimal precisions, and F̄ᵒ there by its terms."""

    belief: Belief
    state_map: Array
    terms: Mapping[str, float]

    @property
    def height(self) -> float:
        return sum(self.terms.values())


def _start(model: GenerativeModel, samples: Samples) -> _Place:
    prior = model.prior
    theta, lambda_ = prior.theta_mean, prior.lambda_mean
    certain = np.zeros_like(prior.theta_precision)
    # The first D step takes the parameters for certain: a weak prior's mean-field term would erase the states.
    state_map = d_step(model, theta, certain, lambda_, inverse(prior.lambda_precision))
    moments = Moments.of(model, samples, state_map)
    belief = Belief(moments, np.empty(0), theta, certain, lambda_, np.empty(0))
    belief = with_optimal_precisions(model, belief)
    return _Place(belief, state_map, optimal_terms(model, samples, belief))


def _round(model: GenerativeModel, samples: Samples, now: _Place, start: Belief) -> _Place:
    """D, E and M steps from ``start``; ``now`` again if they lead no higher than that, which refuses them.

    Of steps in turn from ``now`` itself only rounding can make it so; of those from elsewhere, anything.
    """
    try:
        state_map = d_step(model, start.theta, start.theta_covariance, start.lambda_, start.lambda_covariance)
        belief = with_optimal_precisions(model, start._replace(moments=Moments.of(model, samples, state_map)))
        belief = with_optimal_precisions(model, belief._replace(theta=e_step(model, samples, belief)))
        belief = with_optimal_precisions(model, belief._replace(lambda_=m_step(model, samples, belief)))
        then = _Place(belief, state_map, optimal_terms(model, samples, belief))
    except np.linalg.LinAlgError:
        # A noise so small, or a course so wild, that the rest is lost in rounding.
        return now
    return then if then.height >= now.height else now


def _course(first: Belief, second: Belief, third: Belief) -> Belief | None:
    """Where θ and λ go on the course of three rounds; None if it does not lead beyond the third.

    Squared extrapolation of a fixed-point iteration (Varadhan and Roland 2008, scheme S3), in units of the posterior.
    """
    unit = np.sqrt(np.concatenate([np.diag(third.theta_covariance), np.diag(third.lambda_covariance)]))
    a, b, c = (np.concatenate([belief.theta, belief.lambda_]) / unit for belief in (first, second, third))
    step, bend = b - a, (c - b) - (b - a)
    if not np.linalg.norm(step) > np.linalg.norm(bend) > 0:
        return None
    length = float(np.linalg.norm(step) / np.linalg.norm(bend))
    theta, lambda_ = np.split((a + 2 * length * step + length**2 * bend) * unit, [len(third.theta)])
    return third._replace(theta=theta, lambda_=lambda_)


def _ascent(places: list[_Place], settled: bool) -> Ascent:
    beliefs = [place.belief for place in places]
    return Ascent(
        belief=beliefs[-1],
        state_map=places[-1].state_map,
        terms={name: np.array([place.terms[name] for place in places]) for name in places[0].terms},
        theta=np.array([belief.theta for belief in beliefs]),
        theta_sd=np.sqrt([np.diag(belief.theta_covariance) for belief in beliefs]),
        lambda_=np.array([belief.lambda_ for belief in beliefs]),
        lambda_sd=np.sqrt([np.diag(belief.lambda_covariance) for belief in beliefs]),
        settled=settled,
    )
