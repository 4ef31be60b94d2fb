"""F̄ by model order: the climbs of one flight, with one state, two, and so on, each begun at several places."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from mavdem.dem.ascent import SETTLED, Climb, Place
from mavdem.dem.black_box import BlackBox
from mavdem.dem.breakdown import breaking_down
from mavdem.dem.free_energy import Belief
from mavdem.dem.generative import GenerativeModel, Moments, Samples
from mavdem.dem.starts import chain, grown, reduced

Array = NDArray[np.float64]
Answer = TypeVar("Answer")

FIRST_ROUNDS = 12
"""Of every start; the best go on."""

ROUNDS, STARTS = (36, 200), (3, 1)
"""That are then climbed at most, and of how many."""

SWEEPS = 2
"""Down from the largest order, and up again where that led higher."""

HIGHER = 1.0
"""Nats by which a climb has led higher, so that the orders beside it are worth another try."""

SMOOTHEST = 4.0
"""Widths of the kernel: what disturbs more smoothly than that is motion."""

COLOUR_ROUNDS, COLOUR_STEP = 12, 0.03
"""Rounds to follow a change of the noise's smoothness, and how closely that is looked for, relative."""

BY_COLOUR = 10.0
"""Nats that another smoothness may add; who is further below the highest place so far will not pass it."""


class Climbed(NamedTuple):
    """The highest place of one order.

    Attributes:
        model: whose it is.
        smoothness: kernel width s of its noise, seconds.
        place: where.
    """

    model: GenerativeModel
    smoothness: float
    place: Place


def climbs(box: BlackBox, most: int, smoothness: float | None) -> tuple[Climbed | None, ...]:
    """The highest place found for each order from 1 to ``most``; None where every climb broke down.

    Args:
        box: the flight.
        most: states of the largest model.
        smoothness: kernel width s of the noise, seconds; ``None``: for each order that at which its F̄ᵒ is highest.
    """
    if smoothness is not None:
        return _swept(_Climbs(box, box.counted(smoothness), smoothness), most)
    found = _swept(_Climbs(box, box.counted(box.dt), None), most)
    highest = max((one for one in found if one), key=lambda one: one.place.height, default=None)
    if highest is None:
        return found
    # Only now it is known how smooth the noise is, and so how many samples tell something new.
    recounted = _Climbs(box, box.counted(highest.smoothness), None)
    return tuple(None if one is None else recounted.again(one) for one in found)


@dataclass(frozen=True, eq=False)
class _Climbs:
    """Climbs of one flight with its samples counted in one way.

    Attributes:
        box: the flight.
        samples: of it.
        smoothness: of the noise, s; ``None`` where it is learnt.
    """

    box: BlackBox
    samples: Samples
    smoothness: float | None

    def highest(self, order: int, smoothness: float, starts: Iterable[Array], stood: float) -> Climbed | None:
        """From the starts: all climb a little, and the best ones on; the last with the smoothness that suits it.

        None where that leads no higher than where the order ``stood``.
        """
        climb = Climb(self.box.model(order, smoothness), self.samples)
        places = [place for theta in starts if (place := _up(partial(_from, climb, theta)))]
        for rounds, kept in zip(ROUNDS, STARTS, strict=True):
            places = sorted(places, key=lambda place: -place.height)[:kept]
            places = [_up(partial(_on, climb, place, rounds)) or place for place in places]
        if not places or places[0].height < stood - BY_COLOUR:
            return None
        found = self._coloured(Climbed(climb.model, smoothness, places[0]))
        return found if found.place.height > stood else None

    def again(self, climbed: Climbed) -> Climbed | None:
        """From where a climb of the samples, counted in another way, has ended."""
        climb = Climb(climbed.model, self.samples)
        place = _up(lambda: _on(climb, climb.resumed(climbed.place.belief), ROUNDS[-1]))
        return None if place is None else self._coloured(climbed._replace(place=place))

    def _coloured(self, climbed: Climbed) -> Climbed:
        """With the smoothness at which F̄ is highest, as far as the other parts of the belief follow."""
        if self.smoothness is not None:
            return climbed
        tried = {climbed.smoothness: climbed}

        def fall(log_width: float) -> float:
            # What can be told is the width of noise as it is read.
            smoothness = self.box.width * float(np.sqrt(np.expm1(2 * log_width)))
            climb = Climb(self.box.model(climbed.model.n, smoothness), self.samples)
            place = _up(lambda: _on(climb, climb.resumed(climbed.place.belief), COLOUR_ROUNDS))
            if place is None:
                return -min(one.place.height for one in tried.values())
            tried[smoothness] = Climbed(climb.model, smoothness, place)
            return -place.height

        minimize_scalar(fall, bounds=(0.0, np.log(SMOOTHEST)), method="bounded", options={"xatol": COLOUR_STEP})
        return max(tried.values(), key=lambda one: one.place.height)


def _swept(climbs: _Climbs, most: int) -> tuple[Climbed | None, ...]:
    """The highest places found by sweeping over the orders.

    Upwards, a model grows out of the one before; downwards, one is what is left of the next larger one. Each finds
    maxima that the other does not.
    """
    box, begin = climbs.box, climbs.smoothness or climbs.box.dt
    best: dict[int, Climbed] = {}

    def rises(order: int, beside: int, starts: Sequence[Callable[[], Sequence[Array | None]]]) -> bool:
        """Whether some of the starts lead higher than where that order stood."""
        smoothness = best[beside].smoothness if beside in best else begin
        made = [theta for make in starts for theta in _up(make) or () if theta is not None]
        stood = best[order].place.height if order in best else -np.inf
        found = climbs.highest(order, smoothness, made, stood)
        if found is None:
            return False
        best[order] = found
        return found.place.height > stood + HIGHER

    def grows(order: int) -> Sequence[Array]:
        return grown(box, best[order - 1].model, best[order - 1].place) if order - 1 in best else ()

    def shrinks(order: int) -> Sequence[Array]:
        return reduced(box, best[order + 1].model, best[order + 1].place) if order + 1 in best else ()

    for order in range(1, most + 1):
        rises(order, order - 1, [partial(_chain, box, order), partial(grows, order)])
    for _ in range(SWEEPS):
        higher = {order for order in range(most - 1, 0, -1) if rises(order, order + 1, [partial(shrinks, order)])}
        for order in range(2, most + 1):
            if order - 1 in higher and rises(order, order - 1, [partial(grows, order)]):
                higher.add(order)
        if not higher:
            break
    return tuple(best.get(order) for order in range(1, most + 1))


def _chain(box: BlackBox, order: int) -> Sequence[Array | None]:
    return [chain(box, order)]


def _up(climb: Callable[[], Answer]) -> Answer | None:
    """What it answers; None where it breaks down."""
    try:
        with breaking_down():
            return climb()
    except np.linalg.LinAlgError:
        return None


def _from(climb: Climb, theta: Array) -> Place:
    """A few rounds up from θ, with noise as its prior has it."""
    prior = climb.model.prior
    unseen = Moments(climb.model, climb.samples.gram, np.empty((0, 0)))
    certain, known = np.zeros_like(prior.theta_precision), np.zeros_like(prior.lambda_precision)
    start = Belief(unseen, np.empty(0), theta, certain, prior.lambda_mean, known)
    return _on(climb, climb.resumed(start), FIRST_ROUNDS)


def _on(climb: Climb, place: Place, rounds: int) -> Place:
    """So many rounds further, or fewer where they gain next to nothing."""
    done = 0
    while done < rounds:
        height = place.height
        for higher in climb.rounds(place):
            place, done = higher, done + 1
        if place.height - height < SETTLED:
            break
    return place
