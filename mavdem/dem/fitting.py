"""One fit, from a record and complete settings to an ascent and its predictor."""

from dataclasses import dataclass

import numpy as np
from numpy.random import default_rng

from mavdem.arrays import Array, ArrayPair, Indices
from mavdem.dem.engine.ascent import CoordinateAscent, maximise_free_energy
from mavdem.dem.engine.free_energy import Posterior
from mavdem.dem.engine.generative import (
    GenerativeModel,
    ModelSizes,
    Prior,
    SufficientStatistics,
    embed,
    temporal_precision,
)
from mavdem.dem.engine.linalg import raise_on_overflow
from mavdem.dem.engine.model import discretize, pack, unpack
from mavdem.dem.engine.state_space import StateSpace, filter_gain
from mavdem.dem.forecast.simulation_error import SimulationFit
from mavdem.dem.priors import (
    KINEMATIC_PRECISION,
    Scaling,
    derivative_pairs,
    explicit_prior,
    regulated_prior,
)
from mavdem.dem.record import Record
from mavdem.dem.settings import CompleteSettings

KNOWN_INPUT = np.exp(12.0)  # precision of the constant input


@dataclass(frozen=True, eq=False)
class Fit:
    """A learned model in the engine's units.

    ``gain`` (n, m) is of the filter of the ascent's model and its noises, and ``predictor`` has that filter. Where
    there is a ``simulation_fit``, the ascent's posterior is about its θ.
    """

    settings: CompleteSettings
    scaling: Scaling
    model: GenerativeModel
    ascent: CoordinateAscent
    gain: Array
    predictor: StateSpace
    simulation_fit: SimulationFit | None = None


@raise_on_overflow()
def fit(record: Record, settings: CompleteSettings) -> Fit:
    """Fits a record from the priors' means; ``LinAlgError`` where the fit breaks down."""
    scaling = Scaling.from_record(record, settings)
    model = generative_model(settings, scaling, record)
    samples = SufficientStatistics.from_segments(*generalized_data(settings, scaling, record))
    ascent = maximise_free_energy(model, samples, settings.iterations)
    gain = gain_of(model, ascent.posterior, smoothness_of(settings, record.dt), record.dt)
    predictor = predictor_from_theta(ascent.posterior.theta, model.sizes, gain, record.dt)
    return Fit(settings, scaling, model, ascent, gain, predictor)


def smoothness_of(settings: CompleteSettings, dt: float) -> float:
    """Returns kernel width s of the noise by complete settings at a sampling step ``dt``, seconds."""
    return dt if settings.smoothness is None else settings.smoothness


def generative_model(
    settings: CompleteSettings, scaling: Scaling, record: Record
) -> GenerativeModel:
    """Returns the generative model that complete settings describe for a record."""
    n = settings.order
    m = record.outputs.shape[1]
    motors = record.inputs.shape[1]
    # Hidden states form a chain, of which each derivative of the last output depends on one more.
    most = m + settings.p
    if settings.prior == "regulated" and (
        n < m or (n > most and not settings.last_derivative_zero)
    ):
        raise ValueError(
            f"order must be between {m} and {most} with {m} outputs and p = {settings.p}, not {n}"
        )
    r = motors + scaling.constant
    p = settings.p
    s = smoothness_of(settings, record.dt)
    q = p if settings.last_derivative_zero else p - 1
    correlations = temporal_precision(p, s), temporal_precision(q, s)
    each = np.full((settings.d + 1, r), settings.input_precision)
    each[:, motors:] = KNOWN_INPUT
    # Of λ the first is of the measurement noise, the second of the process noise.
    prior = Prior(
        *_parameter_prior(settings, scaling, record, r),
        np.array([settings.lambda_z, settings.lambda_w]),
        np.diag(np.exp(settings.lambda_log_precision)),
    )
    return GenerativeModel(
        n,
        r,
        m,
        p,
        settings.d,
        q,
        *correlations,
        np.zeros(m, int),
        np.ones(n, int),
        np.diag(each.ravel()),
        prior,
    )


def _parameter_prior(
    settings: CompleteSettings,
    scaling: Scaling,
    record: Record,
    r: int,
) -> ArrayPair:
    """Mean and precision of the engine's θ, for r inputs with the constant."""
    n = settings.order
    m = record.outputs.shape[1]
    motors = r - scaling.constant
    if settings.prior == "uniform":  # the paper's, ``alg_settings``
        k = n * n + n * r + m * n
        uniform = default_rng(settings.seed).uniform(-1, 1, k)
        return uniform, np.eye(k) * settings.parameter_precision
    if settings.prior == "regulated":
        return regulated_prior(
            settings, n, motors, scaling.constant, scaling.output_scale, derivative_pairs(record)
        )
    indices = vehicle_parameter_indices(n, motors, m, scaling.constant)
    mean, precision = explicit_prior(
        settings.prior, settings.parameter_precision, indices, scaling.parameter_scale(n)
    )
    # Where C is free as well, nothing fixes the scale of x, and F̄ is largest at C = 0.
    _, _, of_C = unpack(np.diag(precision), n, r, m)
    if not settings.last_derivative_zero and not (of_C >= KINEMATIC_PRECISION).all():
        raise ValueError(
            'correlation must be "continuous" with a prior that leaves C free (a precision below '
            f'{KINEMATIC_PRECISION:g} in the units of scaling), not "sampled"'
        )
    return mean, precision


def vehicle_parameter_indices(
    n: int,
    motors: int,
    m: int,
    constant: bool,
) -> Indices:
    """Returns indices in the engine's θ of the vehicle's: all but the column of B for the constant input."""
    A, B, C = (np.ones(shape, bool) for shape in ((n, n), (n, motors + constant), (m, n)))
    B[:, motors:] = False
    return np.flatnonzero(pack(A, B, C))


def generalized_data(
    settings: CompleteSettings, scaling: Scaling, record: Record
) -> tuple[Array, ...]:
    """Returns generalized data [ỹ; η̃], (T′, ·) for each segment: of the samples whose whole window lies inside it.

    Outputs and inputs have one window about one instant, so that no derivative lags another.
    """
    window = settings.window
    centre = settings.window // 2
    return tuple(
        np.hstack(
            [
                embed(y, settings.p, record.dt, window, centre),
                embed(u, settings.d, record.dt, window, centre),
            ]
        )
        for u, y in scaling.scale_segments(record)
        if len(y) >= window
    )


def gain_of(
    model: GenerativeModel,
    posterior: Posterior,
    smoothness: float,
    dt: float,
) -> Array:
    """Returns (n, m) gain of the filter of what was learned; ``LinAlgError`` where there is no steady filter."""
    A, B, C = unpack(posterior.theta, *model.sizes)
    noise = np.exp(-posterior.lambda_)
    # The uncertainty of the inputs moves the states as well.
    unknown = np.linalg.inv(model.input_precision)[: model.r, : model.r]
    process = np.diag(noise[model.state_groups]) + B @ unknown @ B.T
    return filter_gain(A, C, dt, noise[model.output_groups], process, smoothness)


def predictor_from_theta(
    theta: Array,
    sizes: ModelSizes,
    gain: Array,
    dt: float,
) -> StateSpace:
    """Returns the predictor of θ (k,), of n states, r inputs and m outputs, with a filter of that gain (n, m)."""
    A, B, C = unpack(theta, *sizes)
    return StateSpace.from_transition(discretize(A, B, dt), C, gain)
