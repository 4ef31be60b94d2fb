"""One fit: a record and complete settings in, an ascent and the predictor it gives out; all in the engine's units."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mavdem.dem.ascent import Ascent, Rates, ascend
from mavdem.dem.breakdown import breaking_down
from mavdem.dem.coordinates import embed
from mavdem.dem.free_energy import Belief
from mavdem.dem.generative import GenerativeModel, Samples
from mavdem.dem.layout import Layout, Likelihood, layouts
from mavdem.dem.model import pack, unpack
from mavdem.dem.parts import Parts
from mavdem.dem.prediction import Predictor
from mavdem.dem.priors import (
    KINEMATIC,
    Prior,
    derivative_pairs,
    explicit_prior,
    hyperparameter_groups,
    hyperparameter_prior,
    regulated_prior,
    uniform_prior,
)
from mavdem.dem.record import Record
from mavdem.dem.scaling import Scaling
from mavdem.dem.settings import Settings
from mavdem.dem.smoothness import sampled_output_precision, sampled_state_precision, temporal_precision
from mavdem.dem.trajectory import ROUNDS, WEAK, Stretches, Trajectory, climb_by_parts

Array = NDArray[np.float64]

ROUGHEST, SMOOTHEST = 1e-3, 1e5
"""Steps: noise of a smoothness beyond these is white to the samples, or constant."""

KNOWN_INPUT = float(np.exp(12.0))
"""Precision of the constant input: as good as known."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A learnt model in the engine's units.

    Attributes:
        settings: with nothing left open.
        scaling: to physical units.
        model: the generative model that was fitted.
        smoothness: kernel width s of its noise, seconds.
        ascent: the climb.
        predictor: of the learnt model and its noises.
        trajectory: how θ climbed on; then the ascent's belief is about that θ. ``None``: it stayed where F̄ led it.
    """

    settings: Settings
    scaling: Scaling
    model: GenerativeModel
    smoothness: float
    ascent: Ascent
    predictor: Predictor
    trajectory: Trajectory | None = None

    @property
    def settled(self) -> bool:
        """Whether the last climb has ended at a maximum: the one along trajectories, where there was one."""
        return self.ascent.settled if self.trajectory is None else self.trajectory.settled


def fit(record: Record, settings: Settings, finish: bool = True) -> Fit:
    """Learns from a record, with complete settings.

    Args:
        record: the training data.
        settings: with nothing left open.
        finish: as in ``ascend``.

    Raises:
        ValueError: the record or the settings do not fit the rest.
        numpy.linalg.LinAlgError: the fit broke down.
    """
    with breaking_down():
        return _fit(record, settings, finish)


def _fit(record: Record, settings: Settings, finish: bool) -> Fit:
    scaling = Scaling.of(*record.spread, settings)
    model = generative_model(settings, scaling, record)
    segments = generalized(settings, scaling, record)
    samples = Samples.of(*segments)
    rates = Rates(settings.state_rate, settings.parameter_rate, settings.hyperparameter_rate, segments, record.dt)
    ascent = ascend(model, samples, settings.iterations, rates, finish)
    smoothness = smoothness_of(settings, record.dt)
    return Fit(settings, scaling, model, smoothness, ascent, predictor_of(model, ascent.belief, smoothness, record.dt))


def trajectory_by_parts(
    model: GenerativeModel,
    settings: Settings,
    scaling: Scaling,
    theta: Array,
    gain: Array,
    record: Record,
    rounds: int = ROUNDS,
    taken: Layout | None = None,
) -> Parts[Trajectory | None]:
    """The climb along trajectories of a record from θ (k,), with a filter of that gain (n, m); in parts.

    Under the package's own prior rotors stand as the flight tells: it climbs with the layout that was ``taken``
    for granted so far, or with hardly any, and once more from θ where another turns out to be likelier.

    ``None`` where the settings ask for none, inputs are unknown, the prior is the paper's or the record is too short.
    """
    if settings.horizon is None or settings.prior == "uniform" or not scaling.known.all():
        return None
    stretches = Stretches.of(scaling.scale_segments(record), max(1, round(settings.horizon / record.dt)))
    yield
    if stretches is None:
        return None
    (n, r, _), mean, precision = model.sizes, model.prior.theta_mean, model.prior.theta_precision
    free = np.diag(precision) < KINEMATIC
    ways: tuple[Layout, ...] = ()
    if settings.prior == "regulated":
        precision = np.where(np.outer(free, free), WEAK * np.eye(len(free)), precision)
        ways = layouts(r - scaling.constant)
    rows = np.flatnonzero(free[n * n : n * n + n * r : r])

    def with_layout(layout: Layout | None) -> Array:
        return precision if layout is None else precision + layout.added_precision(model.sizes, rows)

    def climb(layout: Layout | None) -> Parts[tuple[Trajectory, Likelihood] | None]:
        return climb_by_parts(theta, (mean, with_layout(layout)), model.sizes, gain, record.dt, stretches, rounds)

    begun = taken if any(taken is way for way in ways) else next(iter(ways), None)
    climbed = yield from climb(begun)
    if climbed is None or not ways:
        return climbed and climbed[0]
    trajectory, likelihood = climbed
    inner = np.ix_(trajectory.places, trajectory.places)

    def log_odds(layout: Layout) -> float:
        return layout.log_odds + likelihood.height(mean[trajectory.places], with_layout(layout)[inner])

    likeliest = max(ways, key=log_odds)
    if likeliest is not begun:
        climbed = yield from climb(likeliest)
        assert climbed is not None
        trajectory, _ = climbed
    return replace(trajectory, layout=likeliest)


def smoothness_of(settings: Settings, dt: float) -> float:
    """Kernel width s of the noise that complete settings mean at a sampling step ``dt``, seconds."""
    assert settings.smoothness != "learn"
    smoothness = dt if settings.smoothness is None else settings.smoothness
    if not ROUGHEST <= smoothness / dt <= SMOOTHEST:
        raise ValueError(
            f"smoothness must be between {ROUGHEST * dt:g} and {SMOOTHEST * dt:g} s where samples are {dt:g} s apart, "
            f"not {smoothness:g}"
        )
    return smoothness


def generative_model(settings: Settings, scaling: Scaling, record: Record) -> GenerativeModel:
    """The generative model that complete settings describe for a record."""
    assert settings.order is not None and settings.d is not None
    n, m, motors = settings.order, record.outputs.shape[1], record.inputs.shape[1]
    _require_seen(settings, n, m)
    r = motors + scaling.constant
    q = settings.p if settings.last_derivative_zero else settings.p - 1
    output_groups, state_groups = hyperparameter_groups(settings, n, m)
    return GenerativeModel(
        n,
        r,
        m,
        settings.p,
        settings.d,
        q,
        *_correlations(settings, q, smoothness_of(settings, record.dt), record.dt),
        output_groups,
        state_groups,
        _input_precision(settings, motors, scaling.constant),
        Prior(*_parameter_prior(settings, scaling, record, r), *hyperparameter_prior(settings, n, m)),
    )


def with_smoothness(model: GenerativeModel, settings: Settings, smoothness: float, dt: float) -> GenerativeModel:
    """The same model of noise of another smoothness, s."""
    of_z, of_w = _correlations(settings, model.q, smoothness, dt)
    return replace(model, output_correlation=of_z, state_correlation=of_w)


def _correlations(settings: Settings, q: int, smoothness: float, dt: float) -> tuple[Array, Array]:
    """S of z̃, up to order p, and of w̃, up to order q."""
    p = settings.p
    if settings.correlation == "continuous":
        return temporal_precision(p, smoothness), temporal_precision(q, smoothness)
    assert settings.window is not None
    reading = smoothness, dt, settings.window
    return sampled_output_precision(p, *reading), sampled_state_precision(q, *reading)


def _parameter_prior(settings: Settings, scaling: Scaling, record: Record, r: int) -> tuple[Array, Array]:
    """Mean and precision of the engine's θ, for r inputs with the constant."""
    assert settings.order is not None and settings.parameter_precision is not None
    n, m, motors = settings.order, record.outputs.shape[1], r - scaling.constant
    if settings.prior == "uniform":
        return uniform_prior(settings, n, r, m)
    if settings.prior == "regulated":
        return regulated_prior(settings, n, motors, scaling.constant, scaling.output_scale, derivative_pairs(record))
    places = of_vehicle(n, motors, m, scaling.constant)
    mean, precision = explicit_prior(settings.prior, settings.parameter_precision, places, scaling.parameter_scale(n))
    # Where C is free as well, the scale of x is held by nothing, and F̄ is highest where C is nothing.
    _, _, of_C = unpack(np.diag(precision), n, r, m)
    if not settings.last_derivative_zero and not (of_C >= KINEMATIC).all():
        raise ValueError(
            "last_derivative_zero must be True with a prior that leaves C free (a precision below "
            f"{KINEMATIC:g} in the units of scaling), not False"
        )
    return mean, precision


def of_vehicle(n: int, motors: int, m: int, constant: bool) -> NDArray[np.intp]:
    """Places in the engine's θ of the vehicle's: all but the column of B for the constant input."""
    A, B, C = (np.ones(shape, np.bool_) for shape in ((n, n), (n, motors + constant), (m, n)))
    B[:, motors:] = False
    return np.flatnonzero(pack(A, B, C))


def held_by_prior(precision: Array, scale: Array, settings: Settings, record: Record) -> NDArray[np.bool_]:
    """(k,) which of the vehicle's parameters the prior holds to what is known, whatever units the engine works in.

    Those it knows to a hundredth of their natural unit, which is made of the channels' standard deviations.

    Args:
        precision: (k,) of the prior, in the engine's units.
        scale: (k,) physical size of those units.
        settings, record: what was learnt, and from what.
    """
    assert settings.order is not None
    natural = Scaling.of(*record.spread, replace(settings, scaling="channel"))
    motors = of_vehicle(settings.order, record.inputs.shape[1], record.outputs.shape[1], natural.constant)
    units = natural.parameter_scale(settings.order)[motors] / scale
    return np.asarray(precision * units**2 >= KINEMATIC)


def _input_precision(settings: Settings, motors: int, constant: bool) -> Array:
    """P̃ᵛ of the engine's inputs, of which the constant is known as well as anything."""
    assert settings.d is not None
    orders, given = settings.d + 1, np.array(settings.input_precision, np.float64)
    if given.shape == (motors,):
        given = np.diag(np.tile(given, orders))
    if given.ndim and len(given) != motors * orders:
        raise ValueError(f"input_precision must be of {motors} inputs, or of their {orders} orders, not {given.shape}")
    precision = np.diag(np.full((motors + constant) * orders, KNOWN_INPUT))
    places = np.arange(len(precision)).reshape(orders, motors + constant)[:, :motors].ravel()
    precision[np.ix_(places, places)] = given if given.ndim else given * np.eye(len(places))
    return precision


def _require_seen(settings: Settings, n: int, m: int) -> None:
    """Refuses orders at which the regulated prior, with C = [I 0], leaves an output or a state to nothing."""
    if settings.prior != "regulated":
        return
    # Hidden states stand in a chain, of which each derivative of the last output sees one more.
    most = m + settings.p
    if n < m or (n > most and not settings.last_derivative_zero):
        raise ValueError(f"order must be between {m} and {most} with {m} outputs and p = {settings.p}, not {n}")


def generalized(settings: Settings, scaling: Scaling, record: Record) -> tuple[Array, ...]:
    """Generalized data [ỹ; η̃], (T′, ·) for each segment: of the samples whose whole window lies inside it.

    Outputs and inputs are read from one window about one instant, so that no derivative lags another.
    """
    assert settings.window is not None and settings.d is not None
    window, centre = settings.window, settings.window // 2
    return tuple(
        np.hstack(
            [
                embed(scaling.scale_outputs(outputs), settings.p, record.dt, window, centre),
                embed(scaling.scale_inputs(inputs), settings.d, record.dt, window, centre),
            ]
        )
        for inputs, outputs in record.segments
        if len(outputs) >= window
    )


def predictor_of(model: GenerativeModel, belief: Belief, smoothness: float, dt: float) -> Predictor:
    """The predictor of what was learnt.

    Args:
        model: that was fitted.
        belief: of θ and λ.
        smoothness: kernel width s of the noise, seconds.
        dt: sampling step, s.

    Raises:
        numpy.linalg.LinAlgError: no filter settles.
    """
    A, B, C = unpack(belief.theta, model.n, model.r, model.m)
    noise = np.exp(-belief.lambda_)
    # What is not known of the inputs moves the states as well.
    unknown = np.linalg.inv(model.input_precision)[: model.r, : model.r]
    process = np.diag(noise[model.state_groups]) + B @ unknown @ B.T
    return Predictor.of(A, B, C, dt, noise[model.output_groups], process, smoothness)
