"""One DEM fit: from training data and complete settings to the maximum of the free energy and a one-step predictor."""

from dataclasses import dataclass

import numpy as np
from numpy.random import default_rng

from mavdem.arrays import Array, Indices
from mavdem.dem.engine.ascent import CoordinateAscent, maximise_free_energy
from mavdem.dem.engine.free_energy import Posterior
from mavdem.dem.engine.generalized_coordinates import embed, temporal_precision
from mavdem.dem.engine.generative import GenerativeModel, ModelSizes, Prior
from mavdem.dem.engine.linalg import raise_on_overflow
from mavdem.dem.engine.model import discretize, pack, unpack
from mavdem.dem.engine.moments import SufficientStatistics
from mavdem.dem.engine.state_space import StateSpace, filter_gain
from mavdem.dem.forecast.simulation_error import SimulationFit
from mavdem.dem.priors import (
    KINEMATIC_PRECISION,
    derivative_pairs,
    explicit_prior,
    regulated_prior,
)
from mavdem.dem.record import Record
from mavdem.dem.scaling import Scaling
from mavdem.dem.settings import CompleteSettings, MeanAndPrecision

CONSTANT_INPUT_PRECISION = np.exp(12.0)
"""Prior precision of the constant input, whose value 1 is known. A choice: its standard deviation is 0.0025."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted model, in the engine's units."""

    settings: CompleteSettings
    """Settings of the fit."""

    scaling: Scaling
    """Conversion between the engine's and physical units."""

    model: GenerativeModel
    """The generative model with its priors."""

    ascent: CoordinateAscent
    """The iterations of DEM, with the posterior at the maximum of F̄."""

    posterior: Posterior
    """The posterior of the final θ: the result of DEM or, after a simulation-error fit, the posterior given its θ."""

    gain: Array
    """(n, m) gain of the Kalman filter with DEM's own parameters and noises."""

    predictor: StateSpace
    """The model with the final θ and that gain, in innovation form."""

    simulation_fit: SimulationFit | None = None
    """The simulation-error fit of θ, or ``None`` if there is none."""


@raise_on_overflow()
def fit(record: Record, settings: CompleteSettings) -> Fit:
    """Fits a model to training data by DEM, starting from the prior means.

    Args:
        record: the training data: T samples of r inputs and m outputs, in one or several segments.
        settings: order, embedding, noise, priors and iterations of the fit.

    Returns:
        The result of DEM. A simulation-error fit, which may follow, is not part of it.

    Raises:
        ValueError: the settings do not fit the data.
        numpy.linalg.LinAlgError: the fit breaks down, or the fitted model has no steady filter.
    """
    scaling = Scaling.from_record(record, settings)
    model = generative_model(settings, scaling, record)
    # DEM needs only the second moments of the data.
    samples = SufficientStatistics.from_segments(*generalized_data(settings, scaling, record))
    ascent = maximise_free_energy(model, samples, settings.iterations)
    # DEM estimates the states of each sample separately. To predict samples from earlier ones, a Kalman filter with the
    # parameters and noises of DEM propagates the state from sample to sample.
    gain = _kalman_gain(model, ascent.posterior, _noise_smoothness(settings, record.dt), record.dt)
    predictor = predictor_from_theta(ascent.posterior.theta, model.sizes, gain, record.dt)
    return Fit(
        settings,
        scaling=scaling,
        model=model,
        ascent=ascent,
        posterior=ascent.posterior,
        gain=gain,
        predictor=predictor,
    )


def _noise_smoothness(settings: CompleteSettings, dt: float) -> float:
    """Returns the kernel width s of the noises, in seconds: from the settings or, if None, the step ``dt``."""
    return dt if settings.smoothness is None else settings.smoothness


def generative_model(
    settings: CompleteSettings, scaling: Scaling, record: Record
) -> GenerativeModel:
    """Returns the generative model that the settings describe, in the engine's units.

    λ has two entries: the log precision of the measurement noise of all outputs, and the log precision of the process
    noise of all states.

    Args:
        settings: order, embedding, noise, priors and iterations of the fit.
        scaling: means and units of the channels, which convert them to the engine's units.
        record: the training data: T samples of r inputs and m outputs, in one or several segments.

    Returns:
        The model, with the priors of its parameters and noise precisions.

    Raises:
        ValueError: the data cannot determine a model of this order, or the prior has another number of parameters.
    """
    n = settings.order
    m = record.outputs.shape[1]
    p = settings.p
    d = settings.d
    motors = record.inputs.shape[1]
    if settings.prior == "regulated":
        _require_regulated_order(settings, m)
    r = motors + 1 if scaling.constant else motors
    smoothness = _noise_smoothness(settings, record.dt)
    # Highest derivative of the process noise.
    q = p if settings.models_highest_derivative else p - 1
    # One row for each derivative of the inputs; the constant input, if there is one, is the last column.
    input_precisions = np.full((d + 1, r), settings.input_precision)
    input_precisions[:, motors:] = CONSTANT_INPUT_PRECISION
    theta_mean, theta_precision = _parameter_prior(settings, scaling, record, r)
    return GenerativeModel(
        n,
        r=r,
        m=m,
        p=p,
        d=d,
        q=q,
        output_temporal_precision=temporal_precision(p, smoothness),
        state_temporal_precision=temporal_precision(q, smoothness),
        output_groups=np.zeros(m, int),
        state_groups=np.ones(n, int),
        input_precision=np.diag(input_precisions.ravel()),
        prior=Prior(
            theta_mean,
            theta_precision,
            lambda_mean=np.array([settings.lambda_z, settings.lambda_w]),
            lambda_precision=np.diag(np.exp(settings.lambda_log_precision)),
        ),
    )


def _require_regulated_order(settings: CompleteSettings, m: int) -> None:
    """Raises ValueError unless the data can determine a model with n states under the "regulated" prior.

    Under that prior (``priors.regulated_prior``) the first m states are the outputs. Each other state is hidden, and
    acts only on the derivative of the state before it: the first hidden state affects the first derivative of the last
    output, the second one the second derivative, and so on. The model has p derivatives of the outputs, so that there
    can be p hidden states.

    There can be more if the equation of motion also holds for the highest derivative of the states
    (``models_highest_derivative``): it then determines all of them together with the outputs.

    Args:
        settings: order n, embedding order p and ``models_highest_derivative`` of the fit.
        m: number of outputs.
    """
    n = settings.order
    max_order = m + settings.p
    exceeds_max_order = n > max_order and not settings.models_highest_derivative
    if n < m or exceeds_max_order:
        raise ValueError(
            f"order must be between {m} and {max_order} with {m} outputs and p = {settings.p}, not {n}"
        )


def _parameter_prior(
    settings: CompleteSettings,
    scaling: Scaling,
    record: Record,
    r: int,
) -> MeanAndPrecision:
    """Chooses the prior of the parameters θ by the settings.

    Args:
        settings: settings of the fit, whose ``prior`` is a name or a Gaussian.
        scaling: means and units of the channels, which convert them to the engine's units.
        record: training data, from which the "regulated" prior finds the outputs that are derivatives of others.
        r: number of the engine's inputs, the constant one included.

    Returns:
        Mean (k,) and precision (k, k) of the k parameters, in the engine's units.

    Raises:
        ValueError: the Gaussian prior has another number of parameters than the model, or leaves C free.
    """
    n = settings.order
    m = record.outputs.shape[1]
    motors = record.inputs.shape[1]
    if settings.prior == "uniform":
        # The prior mean of the paper, ``alg_settings``: uniform random numbers from −1 to 1.
        k = n * n + n * r + m * n
        mean = default_rng(settings.seed).uniform(-1, 1, k)
        return MeanAndPrecision(mean, np.eye(k) * settings.parameter_precision)
    # The prior of an attitude loop, with what is known of any multirotor before a flight.
    if settings.prior == "regulated":
        return regulated_prior(
            settings,
            n,
            motors,
            has_constant_input=scaling.constant,
            output_scale=scaling.output_scale,
            pairs=derivative_pairs(record),
        )
    # A Gaussian of the user is of the vehicle's parameters only. The engine may have parameters of a constant input as
    # well.
    indices = vehicle_parameter_indices(n, motors, m, has_constant_input=scaling.constant)
    prior = explicit_prior(
        settings.prior, settings.parameter_precision, indices, scaling.parameter_scale(n)
    )
    # Without dynamics of the highest derivative x has no prior. If C is free as well, nothing determines the scale of
    # x, and F̄ is highest at C = 0.
    C_precisions = unpack(np.diag(prior.precision), n, r, m).C
    leaves_C_free = not (C_precisions >= KINEMATIC_PRECISION).all()
    if leaves_C_free and not settings.models_highest_derivative:
        raise ValueError(
            'correlation must be "continuous" with a prior that leaves C free (a precision below '
            f'{KINEMATIC_PRECISION:g} in the units of scaling), not "sampled"'
        )
    return prior


def vehicle_parameter_indices(
    n: int,
    motors: int,
    m: int,
    *,
    has_constant_input: bool,
) -> Indices:
    """Returns the indices of the vehicle's parameters in θ, which has all entries of A, B and C that a fit estimates.

    B's column for the constant input, which represents the trim, is left out: it is no parameter of the vehicle.

    Args:
        n: number of states.
        motors: number of inputs without the constant one.
        m: number of outputs.
        has_constant_input: whether a constant input follows the motors.

    Returns:
        Indices in θ = [vec(Aᵀ); vec(Bᵀ); vec(Cᵀ)], increasing.
    """
    r = motors + 1 if has_constant_input else motors
    # Flags of the same shapes as A, B and C: only the column of the constant input is no parameter of the vehicle.
    is_parameter_in_A = np.ones((n, n), bool)
    is_parameter_in_B = np.ones((n, r), bool)
    is_parameter_in_B[:, motors:] = False
    is_parameter_in_C = np.ones((m, n), bool)
    return np.flatnonzero(pack(is_parameter_in_A, is_parameter_in_B, is_parameter_in_C))


def generalized_data(
    settings: CompleteSettings, scaling: Scaling, record: Record
) -> tuple[Array, ...]:
    """Embeds training data into generalized coordinates, in the engine's units.

    Outputs and inputs have the same window, centred at the same time, so that no derivative lags behind another. A
    sample has generalized data if its whole window is inside the segment.

    Args:
        settings: settings of the fit, with the embedding orders and the window.
        scaling: means and units of the channels, which convert them to the engine's units.
        record: the training data: T samples of r inputs and m outputs, in one or several segments.

    Returns:
        Generalized data [ỹ; η̃] (T', (p + 1)m + (d + 1)r) of each segment that is long enough, one row for each sample.
    """
    window = settings.window
    center = settings.window // 2
    data_of_segments = []
    for inputs, outputs in scaling.scale_segments(record):
        # A segment shorter than the window has no derivatives.
        if len(outputs) >= window:
            generalized_outputs = embed(outputs, settings.p, record.dt, window, center)
            generalized_inputs = embed(inputs, settings.d, record.dt, window, center)
            data_of_segments.append(np.hstack([generalized_outputs, generalized_inputs]))
    return tuple(data_of_segments)


def _kalman_gain(
    model: GenerativeModel,
    posterior: Posterior,
    smoothness: float,
    dt: float,
) -> Array:
    """Returns the gain of the steady-state Kalman filter with the fitted parameters and noises.

    Args:
        model: the linear model with its noises and priors, whose free energy is maximised.
        posterior: means and covariances of the parameters θ and the log noise precisions λ.
        smoothness: kernel width s of the noises, s.
        dt: sampling step, s.

    Returns:
        (n, m) gain.

    Raises:
        numpy.linalg.LinAlgError: the model has no steady-state filter.
    """
    A, B, C = unpack(posterior.theta, *model.sizes)
    noise_variances = np.exp(-posterior.lambda_)
    # Errors of the inputs act on the states through B, and are added to the process noise. The first r generalized
    # inputs are the inputs themselves, without derivatives.
    input_covariance = np.linalg.inv(model.input_precision)[: model.r, : model.r]
    process_covariance = np.diag(noise_variances[model.state_groups]) + B @ input_covariance @ B.T
    measurement_variances = noise_variances[model.output_groups]
    return filter_gain(A, C, dt, measurement_variances, process_covariance, smoothness)


def predictor_from_theta(
    theta: Array,
    sizes: ModelSizes,
    gain: Array,
    dt: float,
) -> StateSpace:
    """Returns the discrete model in innovation form, which predicts each sample from those before it.

    Args:
        theta: (k,) parameters θ = [vec(Aᵀ); vec(Bᵀ); vec(Cᵀ)], in the engine's units.
        sizes: numbers of states, inputs and outputs.
        gain: (n, m) Kalman gain, by which a sample corrects the state.
        dt: sampling step, s.

    Returns:
        The model, in the engine's units.
    """
    A, B, C = unpack(theta, *sizes)
    return StateSpace.from_transition(discretize(A, B, dt), C, gain)
