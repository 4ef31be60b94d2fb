"""Learning a flight: the fit, the simulation-error fit that follows it, and the cautions about both."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np

from mavdem.dem.closed_loop.inputs import input_cautions
from mavdem.dem.engine.ascent import CoordinateAscent
from mavdem.dem.engine.free_energy import free_energy
from mavdem.dem.engine.generative import SufficientStatistics
from mavdem.dem.engine.linalg import Array, one_thread, raise_on_overflow
from mavdem.dem.engine.resumable import run_to_end
from mavdem.dem.fitting import Fit, fit, generalized, predictor_of
from mavdem.dem.forecast.noise_model import lags_of, resumable_noise_model
from mavdem.dem.forecast.simulation_error import SHORTEST_HORIZON, horizon_of, resumable_simulation_fit
from mavdem.dem.forecasts import TrainingForecasts, training_forecasts
from mavdem.dem.learned import Learned
from mavdem.dem.parallel import parallel_map
from mavdem.dem.record import Record, UniformRecord
from mavdem.dem.result import learned_of
from mavdem.dem.scaling import known_inputs
from mavdem.dem.selection import choices
from mavdem.dem.settings import CompleteSettings, Settings
from mavdem.dem.smoothness import SmoothnessEstimate, estimate_smoothness
from mavdem.dem.uncertainty import ParameterUncertainty, uncertainty_of

Job = tuple[UniformRecord | Sequence[UniformRecord], Settings | None]
"""What ``learn`` takes: a flight, and settings or ``None`` for the default ones."""

FEWEST_SAMPLES = 50  # that a model is fitted to


def learn(train: UniformRecord | Sequence[UniformRecord], settings: Settings | None = None) -> Learned:
    """Learns a linear model of a flight by Dynamic Expectation Maximization.

    Args:
        train: inputs (T, r), outputs (T, m), finite, and the sampling step dt in seconds: a ``Flight``; or a list of
            them, segments with gaps between: nothing is differentiated or forecast across a gap, and forecasts begin
            at the end of the last. Three inputs or more are taken for a multirotor's motors, unless a prior is given.
        settings: what decides the fit; ``Settings()``, for real flights, unless given.

    Returns:
        the model, its posterior, the free energy and the forecasts, in physical units.

    Raises:
        ValueError: too few samples, values that are not finite, or channels that do not vary, with their names; or
            data that no model can forecast.
    """
    if not (settings is None or isinstance(settings, Settings)):
        raise ValueError(f"settings must be a Settings, or None for the default ones, not {settings!r}")
    settings = Settings() if settings is None else settings
    record = Record.of(train)
    if len(record) < FEWEST_SAMPLES:
        raise ValueError(f"train must have at least {FEWEST_SAMPLES} samples, not {len(record)}")
    with one_thread():
        return _learn(record, settings)


def _learn(record: Record, settings: Settings) -> Learned:
    _require_moving(record, settings)
    smoothness = None
    if settings.smoothness == "learn":
        smoothness = estimate_smoothness(record)
        settings = replace(settings, smoothness=smoothness.smoothness)
    attempts = []
    for choice in choices(settings, record):
        attempt = _attempt(record, choice)
        if attempt is not None:
            attempts.append(attempt)
            if attempt.refined:
                break
    if not attempts:
        raise ValueError(
            "no model of the training data, with these settings, can forecast any part of them: where a prior is "
            "given, the states must be observable through its C"
        )
    best = min(attempts, key=lambda attempt: (not attempt.refined, attempt.error(record)))
    found = _cautions(record, best.fit, best.uncertainty, smoothness)
    data, ascent = np.concatenate(best.segments), best.fit.ascent
    energies = free_energy(best.fit.model, data, data @ ascent.state_map.T, ascent.belief)
    return learned_of(best.fit, record, best.uncertainty, energies, best.forecasts, smoothness, found)


@dataclass(frozen=True, eq=False)
class _Attempt:
    """A finished fit with complete settings, its generalized data, and forecasts of the training data by it."""

    fit: Fit
    segments: tuple[Array, ...]
    uncertainty: ParameterUncertainty
    forecasts: TrainingForecasts

    @property
    def refined(self) -> bool:
        """Whether θ is that of the simulation-error fit."""
        return self.fit.simulation_fit is not None

    def error(self, record: Record) -> float:
        """Mean squared error of the forecasts, over all lengths, in training variances."""
        return float(np.mean(self.forecasts.mse / record.outputs.var(axis=0)))


def _attempt(record: Record, settings: CompleteSettings) -> _Attempt | None:
    """A fit, with the simulation-error fit where there can be one; ``None`` where it breaks down or cannot forecast."""
    try:
        fitted = fit(record, settings)
    except np.linalg.LinAlgError:
        return None
    segments = generalized(settings, fitted.scaling, record)
    uncertainty = uncertainty_of(fitted.model, segments, fitted.ascent)
    for finished in (_with_simulation_fit(fitted, record, SufficientStatistics.of(*segments)), fitted):
        forecasts = training_forecasts(finished, record)
        if np.isfinite(forecasts.mse).all():
            if finished.simulation_fit is not None:
                scaled = forecasts.mse / finished.scaling.output_scale**2
                finished = replace(finished, simulation_fit=replace(finished.simulation_fit, mse=scaled))
            return _Attempt(finished, segments, uncertainty, forecasts)
    return None


def _require_moving(record: Record, settings: Settings) -> None:
    """Refuses channels that do not vary, in the whole record or in one half: a vehicle on the ground, say."""
    for part, where in ((record, ""), *((half, " in both halves") for half in record.halves())):
        inputs, outputs = part.spread
        known = known_inputs(settings, len(inputs.mean))
        for name, constant in (("inputs", ~inputs.moving & known), ("outputs", ~outputs.moving)):
            still = np.flatnonzero(constant)
            if len(still):
                of_one = name == "inputs" and len(still) < np.count_nonzero(known)
                missing = ". Leave out a motor that is missing or not recorded" if of_one else ""
                raise ValueError(
                    f"{name} column {still[0]} must vary{where}: constant samples determine no model{missing}"
                )


def _with_simulation_fit(fitted: Fit, record: Record, samples: SufficientStatistics) -> Fit:
    """The fit with θ of a simulation-error fit, where the settings ask for one and it succeeds; else as it was."""
    model, ascent, settings, scaling = fitted.model, fitted.ascent, fitted.settings, fitted.scaling
    try:
        with raise_on_overflow():
            refined = run_to_end(
                resumable_simulation_fit(model, settings, scaling, ascent.belief.theta, fitted.gain, record)
            )
            if refined is None:
                return fitted
            iterate = CoordinateAscent(model, samples).at_theta(refined.theta, ascent.belief)
            predictor = predictor_of(refined.theta, model.sizes, fitted.gain, record.dt)
            predictor = run_to_end(resumable_noise_model(predictor, scaling.scale_segments(record), lags_of(record.dt)))
    except np.linalg.LinAlgError:
        return fitted
    refined_ascent = replace(ascent, belief=iterate.belief, state_map=iterate.state_map)
    return replace(fitted, ascent=refined_ascent, predictor=predictor, simulation_fit=refined)


def _cautions(
    record: Record,
    fitted: Fit,
    uncertainty: ParameterUncertainty,
    smoothness: SmoothnessEstimate | None,
) -> tuple[str, ...]:
    """The cautions of a fit, with what was found of it; ``smoothness`` where it was estimated."""
    model = fitted.scaling.physical_model(fitted.ascent.belief.theta, fitted.model.n)
    found = list(input_cautions(record)) if fitted.settings.prior == "regulated" else []
    if model.spectral_abscissa > 0:
        found.append(f"The model is unstable: it grows e-fold in {1 / model.spectral_abscissa:.3g} s.")
    if fitted.simulation_fit is None and uncertainty.scatter is None:
        found.append(
            "F̄ has no maximum at these parameters: their uncertainty is not known. More iterations, or a larger "
            "prior precision, may find one."
        )
    if fitted.simulation_fit is None:
        found += _no_simulation_fit(fitted, record)
    if smoothness is not None and not np.isfinite(smoothness.log_sd):
        found.append(
            f"F̄ does not determine the smoothness of the noise: {smoothness.smoothness:.2g} s, which was used, is at "
            "an end of the range that was searched."
        )
    if fitted.settings.state_rate is not None and not fitted.ascent.flowed[1:].all():
        exact = np.count_nonzero(~fitted.ascent.flowed[1:])
        found.append(
            f"In {exact} of {len(fitted.ascent.flowed) - 1} rounds the states' flow at state_rate was unstable or "
            "decreased F̄, and its exact limit was used instead."
        )
    return tuple(found)


def _no_simulation_fit(fitted: Fit, record: Record) -> list[str]:
    """Why there is no simulation-error fit, unless the settings ask for none."""
    horizon = horizon_of(fitted.model, fitted.settings, fitted.scaling, record)
    if horizon is None:
        return []
    if horizon:
        reason = "its simulations, or forecasts by its parameters, overflow. Learn from another part of the flight"
    else:
        reason = (
            f"{len(record) * record.dt:.2g} s of samples are too few for its parameters even over {SHORTEST_HORIZON:g} "
            "s. Learn from more, or ask for fewer states"
        )
    return [f"There is no simulation-error fit: {reason}. Forecasts are worse without it."]


def learn_many(jobs: Iterable[Job], executor: Executor | None = None) -> Generator[Learned | ValueError, None, None]:
    """Learns a model for each of many jobs; yields results in the order of the jobs, as soon as they are there.

    Results are those of ``learn``, bit by bit where the workers' processors and libraries are this machine's. Jobs are
    taken from ``jobs`` a bounded number ahead of the results, so both may be endless. Closing the generator, or an
    exception, cancels what is not begun.

    By default one process works on each core this process may use, and in a worker of another pool, or for a few jobs,
    this process does by itself. The processes import the running script: call this below ``if __name__ ==
    "__main__":``. They end with the generator, as soon as the fits they are at; a given ``executor`` is left running.
    On a cluster, for instance (``pip install mavdem[dask]``)::

        with distributed.Client("tcp://scheduler:8786") as client:
            for result in mavdem.learn_many(jobs, client.get_executor()):
                ...

    Args:
        jobs: pairs of what ``learn`` takes: a flight or its segments, and settings or ``None``. For an executor of
            other processes they must pickle, as ``Flight`` and ``Settings`` do.
        executor: does the work; any ``concurrent.futures.Executor``. Threads of a process take turns.

    Yields:
        for each job what ``learn`` returned, or the ``ValueError`` that it raised.

    Raises:
        concurrent.futures.BrokenExecutor: a worker died, such as for want of memory.
        Exception: anything but a ``ValueError`` that ``learn`` raised, and what ``jobs`` raised.
    """
    return parallel_map(_learn_or_error, _pairs(jobs), executor)


def _pairs(jobs: Iterable[Job]) -> Iterator[Job]:
    for job in jobs:
        if not (isinstance(job, tuple | list) and len(job) == 2):
            raise ValueError(f"jobs must be pairs of a flight and its settings, not {job!r}")
        train, settings = job
        yield train, settings


def _learn_or_error(job: Job) -> Learned | ValueError:
    train, settings = job
    try:
        return learn(train, settings)
    except ValueError as error:
        # A traceback would keep the fit's arrays, and would not come through from another process.
        return error.with_traceback(None)
