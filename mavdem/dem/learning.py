"""Learning a model of a flight: ``learn`` and ``learn_many``, from the choice of open settings to the result."""

from collections.abc import Generator, Iterable, Iterator
from concurrent.futures import Executor
from dataclasses import replace
from typing import NamedTuple

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
"""Arguments of one call of ``learn``: a flight, and settings or ``None`` for the default ones."""

MIN_SAMPLES = 50
"""Fewest samples that a model is fitted to; a choice."""

EMBEDDING_SECONDS = 0.09
"""Length of the embedding window, s: wide enough to average measurement noise, and short for a vehicle's motion."""

DEFAULT_INPUT_ORDER = 2
"""Embedding order d of the inputs, unless it is given or p is less."""

PARAMETER_PRECISION = 10.0
"""Prior precision of each free parameter under the "regulated" prior, in the units of ``scaling``; a choice."""

OTHER_PARAMETER_PRECISION = 1.0
"""Prior precision of each free parameter under the other priors."""


def learn(train: TrainingData, settings: Settings | None = None) -> Learned:
    """Learns a linear model of a flight by Dynamic Expectation Maximization.

    >>> mavdem.learn(mavdem.read_flight("flight.tlog")[:850])
    <Learned: 3 states, 4 inputs, 2 outputs from 850 samples at 100 Hz, F̄ ...>

    Args:
        train: A ``Flight``, or anything with finite inputs (T, r), outputs (T, m) and the sampling step dt in seconds.
            Or a list of them, which are segments with gaps between. Nothing is differentiated or forecast across a gap,
            and forecasts begin at the end of the last segment. If there are at least three inputs and the settings have
            no prior, the inputs are assumed to be the motors of a multirotor.
        settings: Settings of the fit; None for ``Settings()``, the settings for real flights.

    Returns:
        The model, with its posterior, its free energy and its forecasts.

    Raises:
        ValueError: There are too few samples, values that are not finite, or channels that do not vary, which the
            message names; or no model can forecast the data.
    """
    with one_thread():
        record, settings = prepared_training(train, settings)
        try:
            dem_fit = fit(record, settings)
        except LinAlgError:
            raise NotLearnable(ModelRefusal.FIT_BREAKS_DOWN) from None
        # The refinement below changes the parameters, but neither the data nor their units.
        segments = generalized_data(settings, dem_fit.scaling, record)
        refined_fit = _refined_by_simulation(dem_fit, record)
        return _learned_from_fit(refined_fit, record, np.concatenate(segments))


def learn_forecasts(train: TrainingData, settings: Settings | None) -> JointModel | Learned:
    """Learns only the model that forecasts of a flight need.

    That is the joint model, a vector autoregression of outputs and motors, unless the settings require forecasts by the
    plant. The forecasts of the joint model do not use DEM's A, B and C, which take most of the time of :func:`learn`.

    Args:
        train: A ``Flight`` or a list of its segments: inputs (T, r), outputs (T, m) and dt, s, as for :func:`learn`.
        settings: Settings of the fit; None for ``Settings()``.

    Returns:
        The joint model, or the result of :func:`learn` if the settings need DEM's model; both have the same forecasts
        as the result of :func:`learn`.

    Raises:
        ValueError: As for :func:`learn`, except that a breakdown of DEM is not an error here.
    """
    with one_thread():
        record, complete = prepared_training(train, settings)
        if complete.forecasts == "joint" and complete.known_inputs:
            return JointModel.learn(record)
        return learn(record, settings)


class PreparedTraining(NamedTuple):
    """Training data that can be learned from, with everything that the fit needs to know."""

    record: Record
    """The training data as one record."""

    settings: CompleteSettings
    """The settings, with nothing left open."""


def prepared_training(train: TrainingData, settings: Settings | None) -> PreparedTraining:
    """Checks the training data and completes the settings.

    Args:
        train: A ``Flight`` or a list of its segments: inputs (T, r), outputs (T, m) and dt, s, as for :func:`learn`.
        settings: Settings of the fit; None for ``Settings()``.

    Returns:
        The training data as a record, and the settings with a value for each field that was None.

    Raises:
        ValueError: The data are wrong or too few, or support no model, as for :func:`learn`.
    """
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
    record.require_varying(known_inputs=settings.known_inputs)
    return PreparedTraining(record, complete_settings(settings, record))


def complete_settings(settings: Settings, record: Record) -> CompleteSettings:
    """Chooses values for the settings that are None: order, input order d, embedding window and prior precision.

    The order is the number of outputs plus one, since the motors' lag is a hidden state. The window is
    ``EMBEDDING_SECONDS`` long, or the shortest possible if segments are too short.

    Args:
        settings: Settings, some of which may be ``None``.
        record: The training data: T samples of r inputs and m outputs, in one or several segments.

    Returns:
        The settings, with a value for each of the four.

    Raises:
        NotLearnable: Fewer than half of the samples have a whole window in their segment.
    """
    order = settings.order
    if order is None:
        # The additional state represents the lag between motor output and torque.
        order = record.outputs.shape[1] + 1
    d = settings.d
    if d is None:
        d = min(DEFAULT_INPUT_ORDER, settings.p)
    precision = settings.parameter_precision
    if precision is None:
        is_regulated = settings.prior == "regulated"
        precision = PARAMETER_PRECISION if is_regulated else OTHER_PARAMETER_PRECISION

    window = settings.window
    if window is None:
        # A derivative of order k needs at least k + 1 samples.
        min_window = max(settings.p, d) + 1
        window = _odd_window(EMBEDDING_SECONDS / record.dt, min_window)
        if not _has_enough_windows(record, window):
            window = _odd_window(0, min_window)
    if _has_enough_windows(record, window):
        chosen_values = {
            "order": order,
            "d": d,
            "window": window,
            "parameter_precision": precision,
        }
        return CompleteSettings(**(vars(settings) | chosen_values))
    raise NotLearnable(
        ModelRefusal.TOO_SHORT_FOR_WINDOW,
        window=window,
        least_samples=2 * window,
        samples=len(record),
        longest=record.longest_segment,
    )


def _has_enough_windows(record: Record, window: int) -> bool:
    """Returns whether at least half of the samples of a record have a whole window of samples in their segment.

    Only these samples have derivatives.
    """
    return record.window_count(window) >= len(record) // 2


def _odd_window(samples: float, min_window: int) -> int:
    """Rounds the length of an embedding window to an odd number, so that a sample is at its centre.

    Args:
        samples: Intended length, in samples; it is rounded, and an even number is increased by one.
        min_window: Shortest length, in samples.

    Returns:
        Length in samples.
    """
    window = max(round(samples), min_window)
    is_even = window % 2 == 0
    return window + 1 if is_even else window


def _refined_by_simulation(dem_fit: Fit, record: Record) -> Fit:
    """Refines the parameters θ of DEM by a simulation-error (output-error) fit, if the settings have a horizon for it.

    DEM fits the derivatives within short windows. Simulations over a longer horizon also depend on slow effects.

    Args:
        dem_fit: The fit by DEM.
        record: The training data: T samples of r inputs and m outputs, in one or several segments.

    Returns:
        The fit with the refined θ, the posterior of all other quantities given θ, and its predictor. It is ``dem_fit``
        if the settings have no horizon or the refinement fails.
    """
    model = dem_fit.model
    ascent = dem_fit.ascent
    try:
        with raise_on_overflow():
            simulation_fit = fit_simulation_error(
                model,
                dem_fit.settings,
                dem_fit.scaling,
                ascent.posterior.theta,
                dem_fit.gain,
                record,
            )
            if simulation_fit is None:
                return dem_fit
            # The noises and states are fitted again to the refined parameters. The predictor keeps DEM's filter gain.
            posterior = condition_on_theta(simulation_fit.theta, ascent.posterior)
            predictor = predictor_from_theta(
                simulation_fit.theta, model.sizes, dem_fit.gain, record.dt
            )
    except LinAlgError:
        # The result of DEM is used; its cautions say that it was not refined.
        return dem_fit
    return replace(
        dem_fit,
        posterior=posterior,
        predictor=predictor,
        simulation_fit=simulation_fit,
    )


def _learned_from_fit(fit: Fit, record: Record, data: Array) -> Learned:
    """Converts a fit from the engine's scaled units to a result in physical units.

    Args:
        fit: Model, posterior and one-step predictor that were fitted to the record.
        record: The training data: T samples of r inputs and m outputs, in one or several segments.
        data: (T′, q) generalized data of the samples with a whole window: derivatives of outputs and inputs.

    Returns:
        The result, with the parameters of the vehicle only. The column of B for the constant input becomes an offset.
    """
    order = fit.model.n
    ascent = fit.ascent
    scaling = fit.scaling
    # The scaled model may have a constant input, for the trim. Its column of B is not a parameter of the result.
    vehicle_parameters = vehicle_parameter_indices(
        order, record.inputs.shape[1], fit.model.m, has_constant_input=scaling.constant
    )
    scale = scaling.parameter_scale(order)
    # If simulations have refined θ, the posterior and the convergence are taken from the simulation-error fit.
    precision = fit.model.prior.theta_precision
    covariance = fit.posterior.theta_covariance
    converged = ascent.converged
    if fit.simulation_fit is not None:
        covariance = fit.simulation_fit.theta_covariance(inverse(precision))
        converged = fit.simulation_fit.converged
    covariance = covariance * np.outer(scale, scale)
    # F(t) is a sample's contribution to the F̄ that DEM reached before simulations refined θ.
    sample_free_energy = SampleFreeEnergy.from_posterior(ascent.posterior)
    return Learned(
        settings=fit.settings,
        model=scaling.physical_model(fit.posterior.theta, order),
        theta_covariance=covariance[np.ix_(vehicle_parameters, vehicle_parameters)],
        known=np.diag(precision)[vehicle_parameters] >= KINEMATIC_PRECISION,
        free_energy=ascent.free_energy,
        free_energy_of_samples=sample_free_energy.evaluate(data),
        sample_free_energy=sample_free_energy,
        learning=replace(
            ascent.learning,
            theta=(ascent.learning.theta * scale)[:, vehicle_parameters].copy(),
            theta_sd=(ascent.learning.theta_sd * scale)[:, vehicle_parameters].copy(),
        ),
        converged=converged,
        record=record,
        cautions=tuple(_cautions_on_fit(fit, record)),
        scaling=scaling,
        predictor=fit.predictor,
        state_map=fit.posterior.state_map,
        theta=fit.posterior.theta,
        simulation_fit=fit.simulation_fit,
    )


def _cautions_on_fit(fit: Fit, record: Record) -> Iterator[Fact]:
    """Yields cautions about a model: units that seem wrong, instability, or a failed refinement.

    Args:
        fit: Model, posterior and one-step predictor that were fitted to the record.
        record: The training data: T samples of r inputs and m outputs, in one or several segments.

    Yields:
        One fact for each of these that holds, with the numbers of its sentence.
    """
    # The regulated prior assumes that one output is the rate of another, so that their units must agree.
    unit_error = suspected_unit_error(record.outputs, record.dt)
    if unit_error is not None and fit.settings.prior == "regulated":
        yield unit_error
    # The largest real part of the eigenvalues, 1/s. Its inverse is the time in which a mode grows by the factor e.
    abscissa = fit.scaling.physical_model(fit.posterior.theta, fit.model.n).spectral_abscissa
    if abscissa > 0:
        yield Fact(ModelCaution.MODEL_GROWS, growth_time=1 / abscissa)
    if fit.simulation_fit is None:
        # The horizon is None if there was to be no such fit, and 0 if the segments are too short for it. If it is
        # positive, the fit has failed.
        horizon = simulation_horizon(fit.model, fit.settings, fit.scaling, record)
        if horizon is not None:
            is_too_short = horizon == 0
            yield Fact(
                ModelCaution.NO_SIMULATION_FIT,
                duration=len(record) * record.dt,
                least_horizon=MIN_HORIZON_SECONDS if is_too_short else None,
            )


def learn_many(
    jobs: Iterable[Job], executor: Executor | None = None
) -> Generator[Learned | ValueError, None, None]:
    """Learns a model for each of many jobs, in parallel.

    Results are yielded in the order of the jobs, each as soon as it and all earlier ones are computed. They are equal
    to those of ``learn``, to the last bit if the workers have the same processors and libraries as this machine. The
    number of jobs that are taken ahead of the results is limited, so that jobs and results may be endless. Closing the
    generator, or an exception, cancels the jobs that have not begun.

    By default one process works on each core that this process may use. In a worker of another pool, and for a few
    jobs, the work is done in this process. The processes import the running script: call this below ``if __name__ ==
    "__main__":``. They end with the generator. A given ``executor``, such as a cluster's (docs/python.md), is not
    shut down.

    Args:
        jobs: Pairs of the arguments of ``learn``: a flight or its segments, and settings or ``None``. For an executor
            of other processes they must pickle, as ``Flight`` and ``Settings`` do.
        executor: Any ``concurrent.futures.Executor``, which does the work. Threads of one process learn one at a time.

    Yields:
        The model of each job, or the ``ValueError`` that ``learn`` raised.

    Raises:
        concurrent.futures.BrokenExecutor: A worker died, for example because memory ran out.
        Exception: Any error other than a ``ValueError`` that ``learn`` raised, and any that ``jobs`` raised.
    """
    return parallel_map(_learn_or_error, _checked_jobs(jobs), executor)


def _checked_jobs(jobs: Iterable[Job]) -> Iterator[Job]:
    """Yields the jobs; raises ``ValueError`` at the first that is not a pair."""
    for job in jobs:
        if not (isinstance(job, tuple | list) and len(job) == 2):
            raise ValueError(f"jobs must be pairs of a flight and its settings, not {job!r}")
        yield job


def _learn_or_error(job: Job) -> Learned | ValueError:
    """Returns the model of a job, or the ``ValueError`` that ``learn`` raised, without its traceback."""
    try:
        return learn(*job)
    except ValueError as error:
        # The traceback would keep the arrays of the fit, and would not come through from another process.
        return error.with_traceback(None)
