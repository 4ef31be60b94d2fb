"""Learning a flight: what the settings leave open, the fits, the cautions about them, and the result."""

from collections.abc import Generator, Iterable, Iterator
from concurrent.futures import Executor
from dataclasses import replace

import numpy as np
from numpy.linalg import LinAlgError

from mavdem.arrays import Array
from mavdem.dem.engine.ascent import condition_on_theta
from mavdem.dem.engine.free_energy import SampleFreeEnergy
from mavdem.dem.engine.linalg import inverse, one_thread, raise_on_overflow
from mavdem.dem.fitting import (
    Fit,
    fit,
    generalized_data,
    predictor_from_theta,
    vehicle_parameter_indices,
)
from mavdem.dem.forecast.joint import JointModel
from mavdem.dem.forecast.simulation_error import (
    MIN_HORIZON_SECONDS,
    fit_simulation_error,
    simulation_horizon,
)
from mavdem.dem.learned import Learned
from mavdem.dem.parallel import parallel_map
from mavdem.dem.priors import KINEMATIC_PRECISION
from mavdem.dem.record import Record, TrainingData
from mavdem.dem.settings import CompleteSettings, Settings
from mavdem.errors import NotLearnable
from mavdem.facts import Fact
from mavdem.facts.model import ModelCaution, ModelRefusal
from mavdem.unit_errors import suspected_unit_error

Job = tuple[TrainingData, Settings | None]
"""What ``learn`` takes: a flight, and settings or ``None`` for the default ones."""

MIN_SAMPLES = 50  # that a model is fitted to

EMBEDDING_SECONDS = 0.09
"""Embedding window: wide enough to average measurement noise, short beside the motion of a vehicle."""

PARAMETER_PRECISION = 10.0  # prior precision of each free parameter, in the units of ``scaling``


def learn(train: TrainingData, settings: Settings | None = None) -> Learned:
    """Learns a linear model of a flight by Dynamic Expectation Maximization.

    >>> mavdem.learn(mavdem.read_flight("flight.tlog")[:850])
    <Learned: 3 states, 4 inputs, 2 outputs from 850 samples at 100 Hz, F̄ ...>

    Args:
        train: inputs (T, r), outputs (T, m), finite, and the sampling step dt in seconds: a ``Flight``; or a list of
            them, segments with gaps between: nothing is differentiated or forecast across a gap, and forecasts begin
            at the end of the last. Three inputs or more are taken for a multirotor's motors, unless a prior is given.
        settings: what decides the fit; ``Settings()``, for real flights, unless given.

    Raises:
        ValueError: too few samples, values that are not finite, or channels that do not vary, with their names; or data
            that no model can forecast.
    """
    return learn_with_fit(train, settings)[0]


def learn_with_fit(train: TrainingData, settings: Settings | None = None) -> tuple[Learned, Fit]:
    """Returns the result of :func:`learn`, and the fit that it was made from; takes and raises the same."""
    with one_thread():
        record, settings = prepared_training(train, settings)
        try:
            fitted = fit(record, settings)
        except LinAlgError:
            raise NotLearnable(ModelRefusal.FIT_BREAKS_DOWN) from None
        segments = generalized_data(settings, fitted.scaling, record)
        refined = _with_simulation_fit(fitted, record)
        return _learned(refined, record, np.concatenate(segments)), refined


def learn_forecasts(train: TrainingData, settings: Settings | None) -> JointModel | Learned:
    """Learns what forecasts a flight: the joint model alone, unless the ``settings`` ask for another.

    DEM's A, B and C, which take most of the time of :func:`learn`, play no part in the joint model's forecasts.

    Args:
        train, settings: as for :func:`learn`.

    Raises:
        ValueError: as :func:`learn`, but not where DEM breaks down.
    """
    with one_thread():
        record, completed = prepared_training(train, settings)
        if completed.forecasts == "joint" and completed.known_inputs:
            return JointModel.learn(record)
        return learn(record, settings)


def prepared_training(
    train: TrainingData, settings: Settings | None
) -> tuple[Record, CompleteSettings]:
    """Returns the training data as one record, and the settings with nothing left open; raises as :func:`learn`."""
    if not (settings is None or isinstance(settings, Settings)):
        raise ValueError(
            f"settings must be a Settings, or None for the default ones, not {settings!r}"
        )
    settings = Settings() if settings is None else settings
    record = Record.from_flights(train)
    if len(record) < MIN_SAMPLES:
        raise NotLearnable(
            ModelRefusal.TOO_FEW_TO_LEARN, least_samples=MIN_SAMPLES, samples=len(record)
        )
    record.require_varying(settings.known_inputs)
    return record, complete_settings(settings, record)


def complete_settings(settings: Settings, record: Record) -> CompleteSettings:
    """Returns the settings with order, d, window and prior precision.

    A window that is not given lasts ``EMBEDDING_SECONDS``, or is the shortest possible where segments are too short.
    """
    # One state more than outputs: the lag between motor output and torque.
    order = settings.order or record.outputs.shape[1] + 1
    d = min(2, settings.p) if settings.d is None else settings.d
    usual = PARAMETER_PRECISION if settings.prior == "regulated" else 1.0
    fewest = max(settings.p, d) + 1
    windows = (
        [settings.window]
        if settings.window
        else [_odd(EMBEDDING_SECONDS / record.dt, fewest), _odd(0, fewest)]
    )
    for window in windows:
        # Half of the samples must have a whole window, or the derivatives come from too few of them.
        if record.window_count(window) >= len(record) // 2:
            chosen = {"order": order, "d": d, "window": window}
            chosen |= {"parameter_precision": settings.parameter_precision or usual}
            return CompleteSettings(**(vars(settings) | chosen))
    raise NotLearnable(
        ModelRefusal.TOO_SHORT_FOR_WINDOW,
        window=windows[-1],
        least_samples=2 * windows[-1],
        samples=len(record),
        longest=record.longest_segment,
    )


def _odd(samples: float, fewest: int) -> int:
    """The odd window next to ``samples``, of at least ``fewest``: an odd window has a sample at its centre."""
    window = max(round(samples), fewest)
    return window + 1 - window % 2


def _with_simulation_fit(fitted: Fit, record: Record) -> Fit:
    """The fit with θ of a simulation-error fit, where the settings ask for one and it succeeds; else as it was."""
    model = fitted.model
    ascent = fitted.ascent
    try:
        with raise_on_overflow():
            refined = fit_simulation_error(
                model, fitted.settings, fitted.scaling, ascent.posterior.theta, fitted.gain, record
            )
            if refined is None:
                return fitted
            posterior = condition_on_theta(refined.theta, ascent.posterior)
            predictor = predictor_from_theta(refined.theta, model.sizes, fitted.gain, record.dt)
    except LinAlgError:
        return fitted
    return replace(
        fitted,
        ascent=replace(ascent, posterior=posterior),
        predictor=predictor,
        simulation_fit=refined,
    )


def _learned(fit: Fit, record: Record, data: Array) -> Learned:
    """The result, in physical units, of a fit in the engine's to generalized ``data``."""
    order = fit.model.n
    ascent = fit.ascent
    scaling = fit.scaling
    vehicle = vehicle_parameter_indices(
        order, record.inputs.shape[1], fit.model.m, scaling.constant
    )
    scale = scaling.parameter_scale(order)
    precision = fit.model.prior.theta_precision
    covariance = ascent.posterior.theta_covariance
    if fit.simulation_fit is not None:
        covariance = fit.simulation_fit.theta_covariance(inverse(precision))
    covariance = covariance * np.outer(scale, scale)
    return Learned(
        settings=fit.settings,
        model=scaling.physical_model(ascent.posterior.theta, order),
        theta_covariance=covariance[np.ix_(vehicle, vehicle)],
        known=np.diag(precision)[vehicle] >= KINEMATIC_PRECISION,
        free_energy=ascent.free_energy,
        free_energy_of_samples=SampleFreeEnergy.from_posterior(ascent.posterior).evaluate(
            data, data @ ascent.posterior.state_map.T
        ),
        learning=replace(
            ascent.learning,
            theta=(ascent.learning.theta * scale)[:, vehicle].copy(),
            theta_sd=(ascent.learning.theta_sd * scale)[:, vehicle].copy(),
        ),
        converged=(fit.simulation_fit or ascent).converged,
        record=record,
        cautions=tuple(_cautions(fit, record)),
        scaling=scaling,
        predictor=fit.predictor,
        state_map=ascent.posterior.state_map,
        theta=ascent.posterior.theta,
        simulation_fit=fit.simulation_fit,
    )


def _cautions(fit: Fit, record: Record) -> Iterator[Fact]:
    """Limits of a model."""
    slip = suspected_unit_error(record.outputs, record.dt)
    if slip and fit.settings.prior == "regulated":
        yield slip
    abscissa = fit.scaling.physical_model(fit.ascent.posterior.theta, fit.model.n).spectral_abscissa
    if abscissa > 0:
        yield Fact(ModelCaution.MODEL_GROWS, growth_time=1 / abscissa)
    if fit.simulation_fit is None:
        horizon = simulation_horizon(fit.model, fit.settings, fit.scaling, record)
        if horizon is not None:
            yield Fact(
                ModelCaution.NO_SIMULATION_FIT,
                duration=len(record) * record.dt,
                least_horizon=None if horizon else MIN_HORIZON_SECONDS,
            )


def learn_many(
    jobs: Iterable[Job], executor: Executor | None = None
) -> Generator[Learned | ValueError, None, None]:
    """Learns a model for each of many jobs; yields results in the order of the jobs, as soon as they are there.

    Results are those of ``learn``, bit by bit where the workers' processors and libraries are this machine's, or the
    ``ValueError`` that it raised. Jobs are taken a bounded number ahead of the results, so both may be endless. Closing
    the generator, or an exception, cancels what is not begun.

    By default one process works on each core this process may use, and in a worker of another pool, or for a few jobs,
    this process does by itself. The processes import the running script: call this below ``if __name__ ==
    "__main__":``. They end with the generator; a given ``executor``, say a cluster's (docs/python.md), does not.

    Args:
        jobs: pairs of what ``learn`` takes: a flight or its segments, and settings or ``None``.
            For an executor of other processes they must pickle, as ``Flight`` and ``Settings`` do.
        executor: does the work; any ``concurrent.futures.Executor``. Threads of a process take turns.

    Raises:
        concurrent.futures.BrokenExecutor: a worker died, such as for want of memory.
        Exception: anything but a ``ValueError`` that ``learn`` raised, and what ``jobs`` raised.
    """
    return parallel_map(_learn_or_error, _checked(jobs), executor)


def _checked(jobs: Iterable[Job]) -> Iterator[Job]:
    for job in jobs:
        if not (isinstance(job, tuple | list) and len(job) == 2):
            raise ValueError(f"jobs must be pairs of a flight and its settings, not {job!r}")
        yield job


def _learn_or_error(job: Job) -> Learned | ValueError:
    try:
        return learn(*job)
    except ValueError as error:
        # A traceback would keep the fit's arrays, and would not come through from another process.
        return error.with_traceback(None)
