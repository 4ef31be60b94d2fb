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
from mavdem.dem.fitting import Fit, Start, fit, generalized, of_vehicle, predictor_of
from mavdem.dem.forecast.forecasts import TrainingForecasts, training_forecasts
from mavdem.dem.forecast.noise_model import lags_of, resumable_noise_model
from mavdem.dem.forecast.simulation_error import SHORTEST_HORIZON, horizon_of, resumable_simulation_fit
from mavdem.dem.learned import Learned
from mavdem.dem.parallel import parallel_map
from mavdem.dem.priors import hyperparameter_groups
from mavdem.dem.record import Record, UniformRecord
from mavdem.dem.result import learned_of
from mavdem.dem.scaling import known_inputs
from mavdem.dem.selection import choices
from mavdem.dem.settings import CompleteSettings, Settings
from mavdem.dem.smoothness import SmoothnessEstimate, estimate_smoothness
from mavdem.dem.uncertainty import ParameterUncertainty, uncertainty_of

Job = (
    tuple[UniformRecord | Sequence[UniformRecord], Settings | None]
    | tuple[UniformRecord | Sequence[UniformRecord], Settings | None, Learned | None]
)
"""What ``learn`` takes: a flight, settings or ``None`` for the default ones, perhaps an earlier result to start at."""

FEWEST_SAMPLES = 50  # that a model is fitted to


def learn(
    train: UniformRecord | Sequence[UniformRecord], settings: Settings | None = None, start: Learned | None = None
) -> Learned:
    """Learns a linear model of a flight by Dynamic Expectation Maximization.

    Args:
        train: inputs (T, r), outputs (T, m), finite, and the sampling step dt in seconds: a ``Flight``; or a list of
            them, segments with gaps between: nothing is differentiated or forecast across a gap, and forecasts begin
            at the end of the last. Three inputs or more are taken for a multirotor's motors, unless a prior is given.
        settings: what decides the fit; ``Settings()``, for real flights, unless given.
        start: an earlier result for similar data, of which the fit begins at the estimates: it then takes a fraction of
            the time. Its settings do not count.

    Returns:
        the model, its posterior, the free energy and the forecasts, in physical units.

    Raises:
        ValueError: too few samples, values that are not finite, or channels that do not vary, with their names; a
            ``start`` of other numbers of states, inputs, outputs or noises; or data that no model can forecast.
    """
    if not (settings is None or isinstance(settings, Settings)):
        raise ValueError(f"settings must be a Settings, or None for the default ones, not {settings!r}")
    settings = Settings() if settings is None else settings
    record = Record.of(train)
    if len(record) < FEWEST_SAMPLES:
        raise ValueError(f"train must have at least {FEWEST_SAMPLES} samples, not {len(record)}")
    with one_thread():
        return _learn(record, settings, start)


def _learn(record: Record, settings: Settings, start: Learned | None) -> Learned:
    _require_moving(record, settings)
    smoothness = None
    if settings.smoothness == "learn":
        smoothness = estimate_smoothness(record)
        settings = replace(settings, smoothness=smoothness.smoothness)
    attempts = []
    for choice in choices(settings, record):
        attempt = _attempt(record, choice, start)
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


def _attempt(record: Record, settings: CompleteSettings, before: Learned | None) -> _Attempt | None:
    """A fit, with the simulation-error fit where there can be one; ``None`` where it breaks down or cannot forecast."""
    start = None if before is None else _start(record, settings, before)
    try:
        fitted = fit(record, settings, start)
    except np.linalg.LinAlgError:
        return None if before is None else _attempt(record, settings, None)
    segments = generalized(settings, fitted.scaling, record)
    uncertainty = uncertainty_of(fitted.model, segments, fitted.ascent)
    for finished in (_with_simulation_fit(fitted, record, SufficientStatistics.of(*segments), start), fitted):
        forecasts = training_forecasts(finished, record)
        if np.isfinite(forecasts.mse).all():
            if finished.simulation_fit is not None:
                scaled = forecasts.mse / finished.scaling.output_scale**2
                finished = replace(finished, simulation_fit=replace(finished.simulation_fit, mse=scaled))
            return _Attempt(finished, segments, uncertainty, forecasts)
    return None


def _start(record: Record, settings: CompleteSettings, before: Learned) -> Start:
    """The estimates of an earlier result; ``ValueError`` where these settings and this record have others."""
    sizes, groups = (
        (settings.order, record.inputs.shape[1], record.outputs.shape[1]),
        1 + max(of.max() for of in hyperparameter_groups(settings, settings.order, record.outputs.shape[1])),
    )
    of_before = (*before.model.B.shape, len(before.model.C))
    lambda_ = before.learning.lambda_[-1]
    same = before.scaling.constant == (settings.scaling == "channel")
    if not (same and of_before == sizes and len(lambda_) == groups):
        raise ValueError(
            f"start must have the states, inputs, outputs, noises and scaling of this fit: {(*sizes, groups)}, not "
            f"{(*of_before, len(lambda_))}"
        )
    last = before.theta * before.scaling.parameter_scale(settings.order)
    theta = last.copy()
    theta[of_vehicle(*sizes, before.scaling.constant)] = before.learning.theta[-1]
    if before.simulation_fit is None:
        return Start(theta, lambda_, None, None)
    return Start(theta, lambda_, last, before.simulation_fit.layout)


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


def _with_simulation_fit(fitted: Fit, record: Record, samples: SufficientStatistics, start: Start | None) -> Fit:
    """The fit with θ of a simulation-error fit, where the settings ask for one and it succeeds; else as it was."""
    model, ascent, settings, scaling = fitted.model, fitted.ascent, fitted.settings, fitted.scaling
    theta, mixer = ascent.belief.theta, None
    if start is not None and start.simulated_theta is not None:
        theta, mixer = start.simulated_theta / scaling.parameter_scale(model.n), start.mixer
    try:
        with raise_on_overflow():
            refined = run_to_end(
                resumable_simulation_fit(model, settings, scaling, theta, fitted.gain, record, geometry=mixer)
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
        jobs: tuples of what ``learn`` takes: a flight or its segments, settings or ``None``, and, if you like, a start.
            For an executor of other processes they must pickle, as ``Flight`` and ``Settings`` do.
        executor: does the work; any ``concurrent.futures.Executor``. Threads of a process take turns.

    Yields:
        for each job what ``learn`` returned, or the ``ValueError`` that it raised.

    Raises:
        concurrent.futures.BrokenExecutor: a worker died, such as for want of memory.
        Exception: anything but a ``ValueError`` that ``learn`` raised, and what ``jobs`` raised.
    """
    return parallel_map(_learn_or_error, _checked(jobs), executor)


def _checked(jobs: Iterable[Job]) -> Iterator[Job]:
    for job in jobs:
        if not (isinstance(job, tuple | list) and len(job) in (2, 3)):
            raise ValueError(f"jobs must be pairs of a flight and its settings, and maybe a start, not {job!r}")
        yield job


def _learn_or_error(job: Job) -> Learned | ValueError:
    try:
        return learn(*job)
    except ValueError as error:
        # A traceback would keep the fit's arrays, and would not come through from another process.
        return error.with_traceback(None)
