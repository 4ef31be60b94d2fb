"""Climber: a model that is improved, a few rounds at a time, with whatever its memory holds."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.dem.ascent import SETTLED, Climb, Place, ascend_by_parts
from mavdem.dem.breakdown import breaking_down
from mavdem.dem.fit import generative_model, predictor_of, smoothness_of, trajectory_by_parts
from mavdem.dem.free_energy import Belief, SampleEnergy
from mavdem.dem.generative import GenerativeModel
from mavdem.dem.innovations import with_innovations_by_parts
from mavdem.dem.memory import Memory
from mavdem.dem.model import LinearModel, unpack
from mavdem.dem.one_thread import one_thread_if_free
from mavdem.dem.parts import Parts
from mavdem.dem.positive import inverse
from mavdem.dem.prediction import Predictor
from mavdem.dem.scaling import Scaling
from mavdem.dem.settings import Settings
from mavdem.dem.sliding import SlidingMoments, in_engine
from mavdem.dem.trajectory import ROUNDS, Trajectory

Array = NDArray[np.float64]


FEW_ROUNDS = 2
"""Along trajectories, once there: the next samples are about to come."""


class Snapshot(NamedTuple):
    """A model as it stands, and what judging and predicting a sample by it takes.

    Attributes:
        model, model_sd: physical; DEM's posterior standard deviations, NaN for offset and trims.
        log_precisions: (g,) λ.
        free_energy_action: F̄ᵒ.
        scaling, predictor: as of a ``Fit``.
        to_engine: [ỹ; η̃] in the engine's units from the moments' g.
        state_map: X from [ỹ; η̃].
        energy: F(t) from both.
        disturbance: (n, dim X) w from X, in the states' physical units per second.
        until: time of the last sample it was learnt from, s.
    """

    model: LinearModel
    model_sd: LinearModel
    log_precisions: Array
    free_energy_action: float
    scaling: Scaling
    predictor: Predictor
    to_engine: Array
    state_map: Array
    energy: SampleEnergy
    disturbance: Array
    until: float


class Climber:
    """The climb of one model, with complete settings, over a memory that moves on.

    It is advanced in parts of about a millisecond, so that samples need not wait for it.

    Attributes:
        settings: with nothing left open.
        moments: of the memory.
    """

    def __init__(self, settings: Settings, memory: Memory, dt: float) -> None:
        """Begins at the priors' means, with the blocks that a ``memory`` of sampling step ``dt`` holds."""
        self.settings, self._memory, self._dt = settings, memory, dt
        self.moments = SlidingMoments(memory, settings, dt)
        self._stand: tuple[Scaling, Belief, Trajectory | None] | None = None
        self._parts: Parts[Snapshot] | None = None

    def begin(self) -> None:
        """Begins to climb over what the memory holds by then: all the way at first, then a few rounds at a time."""
        self._parts = self._climb()

    @property
    def climbing(self) -> bool:
        """Whether there is a part to climb."""
        return self._parts is not None

    def advance(self) -> Snapshot | None:
        """Climbs a part further, unless another thread has its turn; answers where it has led, once it is the last.

        Raises:
            ValueError: a channel that does not vary, or no whole window.
            numpy.linalg.LinAlgError: the fit broke down; the next climb begins at the priors' means again.
        """
        with one_thread_if_free() as free:
            if not free:
                return None
            parts, self._parts = self._parts, None
            assert parts is not None
            try:
                with breaking_down():
                    next(parts)
            except StopIteration as end:
                snapshot: Snapshot = end.value
                return snapshot
            self._parts = parts
            return None

    def _climb(self) -> Parts[Snapshot]:
        yield from self.moments.catch_up()
        # Of one moment: the next block may come in the next pause.
        counted, record, until = self.moments.total(), self._memory.record(), self._memory.blocks[-1].until
        yield
        stand, self._stand = self._stand, None
        scaling = Scaling.of(*record.spread, self.settings)
        to_engine = self.moments.to_engine(scaling)
        samples = in_engine(counted, to_engine)
        if not samples.number:
            raise ValueError(f"no segment has a window of {self.settings.window} samples")
        model = generative_model(self.settings, scaling, record)
        yield
        if stand is None:
            ascent = yield from ascend_by_parts(model, samples, self.settings.iterations)
            belief, state_map, height = ascent.belief, ascent.state_map, float(ascent.free_energy[-1])
        else:
            start = _in_units(stand[1], stand[0], scaling, model.n)
            place = yield from _further(Climb(model, samples), start)
            belief, state_map, height = place.belief, place.state_map, place.height
        predictor = predictor_of(model, belief, smoothness_of(self.settings, self._dt), self._dt)
        yield
        theta, layout = belief.theta, None
        if stand is not None and stand[2] is not None:
            theta, layout = stand[2].theta * _ratio(stand[0], scaling, model.n), stand[2].layout
        rounds = ROUNDS if stand is None else FEW_ROUNDS
        onward = yield from trajectory_by_parts(
            model, self.settings, scaling, theta, predictor.gain, record, rounds, layout
        )
        self._stand = scaling, belief, onward
        covariance = belief.theta_covariance
        if onward is not None:
            yield
            place = Climb(model, samples).around(onward.theta, belief)
            belief, state_map = place.belief, place.state_map
            predictor = predictor.of_theta(onward.theta, model.sizes, self._dt)
            covariance = onward.theta_covariance(inverse(model.prior.theta_precision))
            yield
            predictor = yield from with_innovations_by_parts(predictor, scaling.scale_segments(record))
            yield
        return _snapshot(model, scaling, predictor, belief, covariance, state_map, to_engine, height, until)


def _further(climb: Climb, belief: Belief) -> Parts[Place]:
    """A few rounds and a Newton step from a belief about other samples.

    Rounds alone creep where one part of the belief holds another, and would never catch up with the samples.
    """
    place = climb.resumed(belief)
    yield
    for higher in climb.rounds(place):
        place = higher
        yield
    left = yield from climb.left(place)
    if left is not None and left.gain >= SETTLED:
        place = climb.towards(place, left)
        yield
    return place


def _in_units(belief: Belief, old: Scaling, new: Scaling, order: int) -> Belief:
    """A belief in the units of another scaling; noise precisions find theirs in the first round."""
    ratio = _ratio(old, new, order)
    covariance = belief.theta_covariance * np.outer(ratio, ratio)
    return belief._replace(theta=belief.theta * ratio, theta_covariance=covariance)


def _ratio(old: Scaling, new: Scaling, order: int) -> Array:
    """(k,) of θ in the new units to θ in the old."""
    return old.parameter_scale(order) / new.parameter_scale(order)


def _snapshot(
    model: GenerativeModel,
    scaling: Scaling,
    predictor: Predictor,
    belief: Belief,
    covariance: Array,
    state_map: Array,
    to_engine: Array,
    height: float,
    until: float,
) -> Snapshot:
    n, motors = model.n, len(scaling.input_trim)
    sd = np.sqrt(covariance.diagonal()) * scaling.parameter_scale(n)
    A_sd, B_sd, C_sd = unpack(sd, n, model.r, model.m)
    nan = [np.full(size, np.nan) for size in (n, motors, model.m)]
    A, B, _ = unpack(belief.theta, n, model.r, model.m)
    # w = x′ − A x − B v, at order 0.
    disturbance = np.zeros((n, len(state_map)))
    if model.p:
        disturbance[:, n : 2 * n] = np.eye(n)
    disturbance[:, :n] -= A
    disturbance[:, n * (model.p + 1) :][:, : model.r] -= B
    return Snapshot(
        scaling.physical_model(belief.theta, n),
        LinearModel(A_sd, B_sd[:, :motors], C_sd, *nan),
        belief.lambda_,
        height,
        scaling,
        predictor,
        to_engine,
        state_map,
        SampleEnergy.of(model, belief),
        disturbance * scaling.state_scale(n)[:, None],
        until,
    )
