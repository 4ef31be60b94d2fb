"""OnlineRefit: a model that is fitted on, a few rounds at a time, to the samples of a memory."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mavdem.dem.engine.ascent import CONVERGED_NATS, CoordinateAscent, Iterate, resumable_ascend
from mavdem.dem.engine.free_energy import Belief, SampleEnergy
from mavdem.dem.engine.linalg import Array, inverse, one_thread_if_free, raise_on_overflow
from mavdem.dem.engine.model import LinearModel, unpack
from mavdem.dem.engine.resumable import Resumable
from mavdem.dem.engine.state_space import StateSpace
from mavdem.dem.fitting import gain_of, generative_model, predictor_of, smoothness_of
from mavdem.dem.forecast.noise_model import lags_of, resumable_noise_model
from mavdem.dem.forecast.simulation_error import MAX_ITERATIONS, SimulationFit, horizon_of, resumable_simulation_fit
from mavdem.dem.online.memory import Memory, SlidingStatistics, engine_statistics
from mavdem.dem.scaling import Scaling
from mavdem.dem.settings import CompleteSettings

WARM_ROUNDS = 2  # of a simulation-error fit that begins at the last one: the next samples are about to come


class Snapshot(NamedTuple):
    """The current model, and what filtering, predicting and evaluating a sample takes."""

    model: LinearModel  # physical
    model_sd: LinearModel  # DEM's posterior standard deviations, NaN for offset and trims
    log_precisions: Array
    free_energy_action: float  # F̄ᵒ
    scaling: Scaling
    predictor: StateSpace
    to_engine: Array  # [ỹ; η̃] in the engine's units from the statistics' g
    state_map: Array
    energy: SampleEnergy
    disturbance: Array  # (n, dim X) w from X, in the states' physical units per second
    until: float  # time of the last sample it was learnt from, s


class OnlineRefit:
    """The fit of one model, with complete settings, to a memory that changes.

    It advances in steps of about a millisecond, so that samples need not wait for it.
    """

    def __init__(self, settings: CompleteSettings, memory: Memory, dt: float) -> None:
        """Begins at the priors' means, with the blocks of a ``memory`` of sampling step ``dt``, s."""
        self.settings, self._memory, self._dt = settings, memory, dt
        self.statistics = SlidingStatistics(memory, settings, dt)
        self._last_fit: tuple[Scaling, Belief, SimulationFit | None] | None = None
        self._steps: Resumable[Snapshot] | None = None
        self._begun = 0

    def begin(self) -> None:
        """Starts a fit to what the memory holds: to convergence at first, a few rounds from the last fit later."""
        self._steps = self._refit()
        self._begun += 1

    @property
    def running(self) -> bool:
        """Whether a fit has steps left."""
        return self._steps is not None

    @property
    def begins(self) -> bool:
        """Whether the first fit has steps left."""
        return self.running and self._begun == 1

    def advance(self) -> Snapshot | None:
        """One step of the fit, unless another thread is computing; returns the model after the last step.

        Raises:
            ValueError: a channel that does not vary, or no whole window.
            numpy.linalg.LinAlgError: the fit broke down; the next one begins at the priors' means again.
        """
        with one_thread_if_free() as free:
            if not free:
                return None
            steps, self._steps = self._steps, None
            assert steps is not None
            try:
                with raise_on_overflow():
                    next(steps)
            except StopIteration as end:
                snapshot: Snapshot = end.value
                return snapshot
            self._steps = steps
            return None

    def _refit(self) -> Resumable[Snapshot]:
        yield from self.statistics.catch_up()
        # All at one instant: the next block may come in the next pause.
        counted, record, until = self.statistics.total(), self._memory.record(), self._memory.blocks[-1].until
        yield
        last, self._last_fit = self._last_fit, None
        scaling = Scaling.of(*record.spread, self.settings)
        to_engine = self.statistics.to_engine(scaling)
        samples = engine_statistics(counted, to_engine)
        if not samples.number:
            raise ValueError(f"no segment has a window of {self.settings.window} samples")
        model = generative_model(self.settings, scaling, record)
        yield
        if last is None:
            ascent = yield from resumable_ascend(model, samples, self.settings.iterations)
            belief, state_map, free_energy = ascent.belief, ascent.state_map, float(ascent.free_energy[-1])
        else:
            start = _in_units(last[1], last[0], scaling, model.n)
            place = yield from _resumed(CoordinateAscent(model, samples), start)
            belief, state_map, free_energy = place.belief, place.state_map, place.free_energy
        gain = gain_of(model, belief, smoothness_of(self.settings, self._dt), self._dt)
        predictor = predictor_of(belief.theta, model.sizes, gain, self._dt)
        yield
        theta, layout = belief.theta, None
        if last is not None and last[2] is not None:
            theta, layout = last[2].theta * _ratio(last[0], scaling, model.n), last[2].layout
        rounds, onward = MAX_ITERATIONS if last is None else WARM_ROUNDS, None
        longest = round((self.settings.horizon or 0.0) / self._dt)
        # The first model soon: few samples leave a shorter horizon only, and that fit takes two seconds of samples.
        if last is not None or (horizon_of(model, self.settings, scaling, record) or 0) >= longest:
            onward = yield from resumable_simulation_fit(
                model, self.settings, scaling, theta, gain, record, rounds, layout
            )
        self._last_fit = scaling, belief, onward
        covariance = belief.theta_covariance
        if onward is not None:
            yield
            place = CoordinateAscent(model, samples).at_theta(onward.theta, belief)
            belief, state_map = place.belief, place.state_map
            predictor = predictor_of(onward.theta, model.sizes, gain, self._dt)
            covariance = onward.theta_covariance(inverse(model.prior.theta_precision))
            yield
            predictor = yield from resumable_noise_model(predictor, scaling.scale_segments(record), lags_of(self._dt))
            yield
        n, motors = model.n, len(scaling.input_trim)
        A_sd, B_sd, C_sd = unpack(np.sqrt(covariance.diagonal()) * scaling.parameter_scale(n), *model.sizes)
        nan = [np.full(size, np.nan) for size in (n, motors, model.m)]
        A, B, _ = unpack(belief.theta, *model.sizes)
        # w = x′ − A x − B v, at order 0.
        disturbance = np.zeros((n, len(state_map)))
        if model.p:
            disturbance[:, n : 2 * n] = np.eye(n)
        disturbance[:, :n] -= A
        disturbance[:, n * (model.p + 1) :][:, : model.r] -= B
        return Snapshot(
            model=scaling.physical_model(belief.theta, n),
            model_sd=LinearModel(A_sd, B_sd[:, :motors], C_sd, *nan),
            log_precisions=belief.lambda_,
            free_energy_action=free_energy,
            scaling=scaling,
            predictor=predictor,
            to_engine=to_engine,
            state_map=state_map,
            energy=SampleEnergy.of(model, belief),
            disturbance=disturbance * scaling.state_scale(n)[:, None],
            until=until,
        )


def _resumed(ascent: CoordinateAscent, belief: Belief) -> Resumable[Iterate]:
    """A few rounds and a Newton step from a belief about other samples.

    Rounds alone converge slowly where parts of the belief are correlated, and would never catch up with the samples.
    """
    place = ascent.at_belief(belief)
    yield
    for higher in ascent.rounds(place):
        place = higher
        yield
    left = yield from ascent.resumable_newton(place)
    if left is not None and left.gain >= CONVERGED_NATS:
        place = ascent.along(place, left)
        yield
    return place


def _in_units(belief: Belief, old: Scaling, new: Scaling, order: int) -> Belief:
    """A belief in the units of another scaling; noise precisions follow in the first round."""
    ratio = _ratio(old, new, order)
    covariance = belief.theta_covariance * np.outer(ratio, ratio)
    return belief._replace(theta=belief.theta * ratio, theta_covariance=covariance)


def _ratio(old: Scaling, new: Scaling, order: int) -> Array:
    """(k,) of θ in the new units to θ in the old."""
    return old.parameter_scale(order) / new.parameter_scale(order)
