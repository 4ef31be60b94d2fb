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
"""An iteration that gains less than this, in nats over the whole flight, is the last: it would tell no models apart."""


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
    """Climbs F̄ from the priors' means.

    After each step the covariances are set to their optimum, which also raises F̄; so F̄ᵒ is what rises.

    Raises:
        numpy.linalg.LinAlgError: at the priors' means a curvature is not negative definite.
    """
    prior = model.prior
    theta, lambda_ = prior.theta_mean, prior.lambda_mean
    certain = np.zeros_like(prior.theta_precision)
    # The first D step takes the parameters for certain: a weak prior's mean-field term would erase the states.
    state_map = d_step(model, theta, certain, lambda_, inverse(prior.lambda_precision))
    belief = with_optimal_precisions(
        model, Belief(Moments.of(model, samples, state_map), np.empty(0), theta, certain, lambda_, np.empty(0))
    )
    rows = [_row(model, samples, belief)]
    settled = False
    for _ in range(iterations):
        try:
            higher_map, higher = _iterate(model, samples, belief)
            row = _row(model, samples, higher)
        except np.linalg.LinAlgError:
            # A noise so small that the rest is lost in rounding: what was reached stands, and is not settled.
            break
        gain = sum(row[0].values()) - sum(rows[-1][0].values())
        if gain < 0:
            # Every step is a maximization, so only rounding can lower F̄; the step is refused.
            settled = True
            break
        state_map, belief = higher_map, higher
        rows.append(row)
        if gain < SETTLED:
            settled = True
            break
    terms, thetas, theta_sds, lambdas, lambda_sds = zip(*rows, strict=True)
    return Ascent(
        belief,
        state_map,
        {name: np.array([t[name] for t in terms]) for name in terms[0]},
        np.array(thetas),
        np.array(theta_sds),
        np.array(lambdas),
        np.array(lambda_sds),
        settled,
    )


def _iterate(model: GenerativeModel, samples: Samples, belief: Belief) -> tuple[Array, Belief]:
    state_map = d_step(model, belief.theta, belief.theta_covariance, belief.lambda_, belief.lambda_covariance)
    belief = with_optimal_precisions(model, belief._replace(moments=Moments.of(model, samples, state_map)))
    belief = with_optimal_precisions(model, belief._replace(theta=e_step(model, samples, belief)))
    belief = with_optimal_precisions(model, belief._replace(lambda_=m_step(model, samples, belief)))
    return state_map, belief


def _row(
    model: GenerativeModel, samples: Samples, belief: Belief
) -> tuple[Mapping[str, float], Array, Array, Array, Array]:
    return (
        optimal_terms(model, samples, belief),
        belief.theta,
        np.sqrt(np.diag(belief.theta_covariance)),
        belief.lambda_,
        np.sqrt(np.diag(belief.lambda_covariance)),
    )
