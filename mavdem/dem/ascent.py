"""Dynamic Expectation Maximization: D, E and M steps in turn until F̄ has settled."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.dem.flow import StateFlow
from mavdem.dem.free_energy import Belief, optimal_terms
from mavdem.dem.generative import GenerativeModel, Moments, Samples
from mavdem.dem.parts import Parts, at_once
from mavdem.dem.positive import inverse, solve
from mavdem.dem.profile import Newton, newton_by_parts
from mavdem.dem.steps import d_step, e_step, m_step, state_slope, with_optimal_precisions

Array = NDArray[np.float64]

SETTLED = 0.1
"""Nats over the whole flight that are next to nothing: so few would tell no models apart."""

SHARES = (1.0, 0.25, 0.0625)
"""Of a Newton step, that are tried in turn."""


@dataclass(frozen=True, eq=False)
class Ascent:
    """The climb of one fit: the final belief and what each iteration arrived at, row 0 being the start.

    Attributes:
        belief: at the end.
        state_map: L with X = L [ỹ; η̃], of the last D step's exact limit.
        terms: each named term of F̄ᵒ, (I + 1,).
        theta, theta_sd: (I + 1, k).
        lambda_, lambda_sd: (I + 1, g).
        settled: whether next to nothing was left to climb before the iterations ran out.
        left: nats that the curvature still promised where no step led higher; NaN where the climb ended otherwise.
        flowed: (I + 1,) whether the D step followed its flow at the finite rate asked for, which must be stable and
            must not lower F̄, or took the exact limit.
    """

    belief: Belief
    state_map: Array
    terms: Mapping[str, Array]
    theta: Array
    theta_sd: Array
    lambda_: Array
    lambda_sd: Array
    settled: bool
    left: float
    flowed: NDArray[np.bool_]

    @property
    def free_energy(self) -> Array:
        """F̄ᵒ by iteration, (I + 1,)."""
        return np.asarray(np.sum(list(self.terms.values()), axis=0))


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


LIMIT = Rates()

ROUNDS_AROUND = 3
"""Of D and M steps about a θ that is held: with it known, λ and X hardly hold each other."""

LARGEST_LAMBDA = 150.0
"""No noise is so small, or so large: beyond e^±150 there is only rounding."""


def ascend(
    model: GenerativeModel, samples: Samples, iterations: int, rates: Rates = LIMIT, finish: bool = True
) -> Ascent:
    """Climbs F̄ for at most so many rounds of D, E and M steps.

    After each round the covariances are set to their optimum, which also raises F̄; so F̄ᵒ is what rises. Steps in turn
    are slow where one part of the belief holds the others (X and θ, when noise is small), but steadily so: after every
    two rounds a third starts from where their course would lead, and is kept if it ends higher. Where these no longer
    gain anything to speak of, the Newton step of θ and λ with X following says what is left: next to nothing, and the
    climb has settled; or more, and the next round starts from there. With finite rates, where the gradient's own course
    is what was asked for, no round starts elsewhere.

    A flow of X that is unstable, or that would lower F̄, gives way to its exact limit in that round.

    Args:
        model: of the data, with its priors.
        samples: the data.
        iterations: rounds at most.
        rates: learning rates.
        finish: whether what is left is looked for; else the climb ends where rounds no longer gain, unsettled, sooner.

    Raises:
        numpy.linalg.LinAlgError: at the start a curvature is not negative definite.
    """
    return at_once(ascend_by_parts(model, samples, iterations, rates, finish))


def ascend_by_parts(
    model: GenerativeModel, samples: Samples, iterations: int, rates: Rates = LIMIT, finish: bool = True
) -> Parts[Ascent]:
    """The same, in parts."""
    climb = Climb(model, samples, rates)
    places = [climb.start()]
    settled, promised = False, np.nan
    while not settled and len(places) <= iterations:
        height = places[-1].height
        for place in islice(climb.rounds(places[-1]), iterations + 1 - len(places)):
            places.append(place)
            yield
        if places[-1].height - height < SETTLED:
            if not finish:
                break
            left = yield from climb.left(places[-1])
            settled = left is not None and left.gain < SETTLED
            if left is None or settled or not rates.exact:
                continue
            if len(places) <= iterations:
                places.append(climb.towards(places[-1], left))
                if places[-1].height - height < SETTLED:
                    promised = left.gain
                    break
    return _ascent(places, settled, promised)


def plain_rounds(model: GenerativeModel, samples: Samples, number: int, rates: Rates = LIMIT) -> list[Belief]:
    """The belief at the start and after each of so many rounds, without extrapolation and whether settled or not.

    Args:
        model, samples, rates: as in :func:`ascend`.
        number: of rounds.
    """
    climb = Climb(model, samples, rates)
    places = [climb.start()]
    for _ in range(number):
        places.append(climb.round(places[-1], places[-1].belief))
    return [place.belief for place in places]


@dataclass(frozen=True, eq=False)
class Place:
    """Where a climb has come to.

    Attributes:
        belief: with optimal precisions.
        state_map: X from the data.
        terms: of F̄ᵒ, by name.
        flowed: whether X came of a flow at a finite rate.
    """

    belief: Belief
    state_map: Array
    terms: Mapping[str, float]
    flowed: bool

    @property
    def height(self) -> float:
        """F̄ᵒ."""
        return sum(self.terms.values())


@dataclass(frozen=True, eq=False)
class Climb:
    """The rounds of one climb.

    Attributes:
        model, samples, rates: as in :func:`ascend`.
    """

    model: GenerativeModel
    samples: Samples
    rates: Rates = LIMIT

    def start(self) -> Place:
        """At the priors' means."""
        prior = self.model.prior
        theta, lambda_ = prior.theta_mean, prior.lambda_mean
        certain = np.zeros_like(prior.theta_precision)
        # The first D step takes the parameters for certain: a weak prior's mean-field term would erase the states.
        state_map = d_step(self.model, theta, certain, lambda_, inverse(prior.lambda_precision))
        moments = Moments.of(self.model, self.samples, state_map)
        return self._place(Belief(moments, np.empty(0), theta, certain, lambda_, np.empty(0)), state_map, flowed=False)

    def resumed(self, belief: Belief) -> Place:
        """Where a belief stands, with X at its maximum."""
        state_map = d_step(self.model, belief.theta, belief.theta_covariance, belief.lambda_, belief.lambda_covariance)
        moments = Moments.of(self.model, self.samples, state_map)
        return self._place(belief._replace(moments=moments), state_map, flowed=False)

    def around(self, theta: Array, belief: Belief) -> Place:
        """D and M steps in turn with θ held elsewhere, from a belief: what its noise is there, and X."""
        place = self.resumed(belief._replace(theta=theta))
        for _ in range(ROUNDS_AROUND):
            place = self.resumed(place.belief._replace(lambda_=m_step(self.model, self.samples, place.belief)))
            _require_sane(place.belief.lambda_)
        return place

    def rounds(self, now: Place) -> Iterator[Place]:
        """Two rounds in turn and, with exact rates, one that starts where their course would lead."""
        first = self.round(now, now.belief)
        yield first
        second = self.round(first, first.belief)
        yield second
        ahead = _course(now.belief, first.belief, second.belief) if self.rates.exact else None
        if ahead is not None:
            yield self.round(second, ahead)

    def round(self, now: Place, start: Belief) -> Place:
        """D, E and M steps from ``start``; ``now`` again if they lead no higher than that, which refuses them.

        Of steps in turn from ``now`` itself only rounding can make it so; of those from elsewhere, anything.
        """
        for flowed in (False,) if self.rates.state is None else (True, False):
            try:
                then = self._steps(start, flowed, known=start is now.belief)
            except (np.linalg.LinAlgError, FloatingPointError):
                # A flow that does not hold, a noise so small, or a course so wild, that the rest is lost in rounding.
                continue
            if then.height >= now.height:
                return then
        return now

    def left(self, now: Place) -> Parts[Newton | None]:
        """What is left to climb, and the way; None where rounding hides it."""
        try:
            return (yield from newton_by_parts(self.model, self.samples, now.belief))
        except (np.linalg.LinAlgError, FloatingPointError):
            return None

    def towards(self, now: Place, left: Newton) -> Place:
        """A round from as far along the Newton step as leads higher; ``now`` if none does."""
        for share in SHARES:
            ahead = now.belief._replace(
                theta=now.belief.theta + share * left.theta, lambda_=now.belief.lambda_ + share * left.lambda_
            )
            then = self.round(now, ahead)
            if then is not now:
                return then
        return now

    def _steps(self, start: Belief, flowed: bool, known: bool) -> Place:
        """A D step, by the flow or in its exact limit, and E and M steps after it.

        The covariances of a ``known`` start are those at its maximum, and wait for the end of the round: moving them
        after each step as well would raise F̄ hardly more, at twice the cost.
        """
        model, samples, rates = self.model, self.samples, self.rates
        _require_sane(start.lambda_)
        slope = state_slope(model, start.theta, start.theta_covariance, start.lambda_, start.lambda_covariance)
        state_map = solve(slope[1], slope[0])
        if flowed:
            assert rates.state is not None
            moments = StateFlow.of(model, *slope, rates.state).moments(model, rates.segments, rates.dt)
        else:
            moments = Moments.of(model, samples, state_map)
        belief = start._replace(moments=moments)
        if not known:
            belief = with_optimal_precisions(model, belief)
        belief = belief._replace(theta=e_step(model, samples, belief, rates.theta))
        belief = belief._replace(lambda_=m_step(model, samples, belief, rates.lambda_))
        _require_sane(belief.lambda_)
        return self._place(belief, state_map, flowed)

    def _place(self, belief: Belief, state_map: Array, flowed: bool) -> Place:
        belief = with_optimal_precisions(self.model, belief)
        return Place(belief, state_map, optimal_terms(self.model, self.samples, belief), flowed)


def _require_sane(lambda_: Array) -> None:
    if not np.abs(lambda_).max() < LARGEST_LAMBDA:
        raise np.linalg.LinAlgError("a noise precision has run away")


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


def _ascent(places: list[Place], settled: bool, left: float) -> Ascent:
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
        left=left,
        flowed=np.array([place.flowed for place in places]),
    )
