"""One fit: data and complete settings in, an ascent and the predictor it gives out; all in the engine's units."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavdem.dem.ascent import Ascent, ascend
from mavdem.dem.coordinates import embed
from mavdem.dem.generative import GenerativeModel, Samples
from mavdem.dem.model import unpack
from mavdem.dem.prediction import Predictor
from mavdem.dem.priors import Prior, derivative_pairs, hyperparameter_prior, regulated_prior, uniform_prior
from mavdem.dem.scaling import Scaling
from mavdem.dem.settings import Settings
from mavdem.dem.smoothness import temporal_precision

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Fit:
    """A learnt model in the engine's units.

    Attributes:
        settings: with nothing left open.
        scaling: to physical units.
        model: the generative model that was fitted.
        ascent: the climb.
        predictor: of the learnt model and its noises.
    """

    settings: Settings
    scaling: Scaling
    model: GenerativeModel
    ascent: Ascent
    predictor: Predictor


def fit(inputs: Array, outputs: Array, dt: float, settings: Settings) -> Fit:
    """Learns from inputs (T, r) and outputs (T, m), in physical units, with complete settings."""
    scaling = Scaling.of(inputs, outputs, settings)
    model = generative_model(settings, scaling, inputs.shape[1], outputs, dt)
    samples = Samples.of(*generalized(settings, scaling, inputs, outputs, dt))
    ascent = ascend(model, samples, settings.iterations)
    A, B, C = unpack(ascent.belief.theta, model.n, model.r, model.m)
    noise, smoothness = np.exp(-ascent.belief.lambda_), settings.smoothness or dt
    predictor = Predictor.of(A, B, C, dt, noise[model.output_groups], noise[model.state_groups], smoothness)
    return Fit(settings, scaling, model, ascent, predictor)


def generative_model(settings: Settings, scaling: Scaling, inputs: int, outputs: Array, dt: float) -> GenerativeModel:
    """The generative model that complete settings describe, for ``inputs`` motors and outputs (T, m)."""
    assert settings.order is not None and settings.d is not None
    n, m, r = settings.order, outputs.shape[1], inputs + scaling.constant
    _require_seen(settings, n, m)
    if settings.prior == "uniform":
        theta_prior = uniform_prior(settings, n, r, m)
    else:
        pairs = derivative_pairs(outputs, dt)
        theta_prior = regulated_prior(settings, n, inputs, scaling.constant, scaling.output_scale, pairs)
    q = settings.p if settings.last_derivative_zero else settings.p - 1
    smoothness = settings.smoothness or dt
    return GenerativeModel(
        n,
        r,
        m,
        settings.p,
        settings.d,
        q,
        temporal_precision(settings.p, smoothness),
        temporal_precision(q, smoothness),
        np.arange(m) if settings.lambda_per_channel else np.zeros(m, np.intp),
        m + np.arange(n) if settings.lambda_per_channel else np.ones(n, np.intp),
        settings.input_precision * np.eye(r * (settings.d + 1)),
        Prior(*theta_prior, *hyperparameter_prior(settings, n, m)),
    )


def _require_seen(settings: Settings, n: int, m: int) -> None:
    """Refuses orders at which the regulated prior, with C = [I 0], leaves an output or a state to nothing."""
    if settings.prior != "regulated":
        return
    # Hidden states stand in a chain, of which each derivative of the last output sees one more.
    most = m + settings.p
    if n < m or (n > most and not settings.last_derivative_zero):
        raise ValueError(f"order must be between {m} and {most} with {m} outputs and p = {settings.p}, not {n}")


def generalized(settings: Settings, scaling: Scaling, inputs: Array, outputs: Array, dt: float) -> tuple[Array, Array]:
    """Generalized outputs and inputs of the samples whose whole window lies inside the data.

    Both are read from one window about one instant, so that no derivative lags another.
    """
    assert settings.window is not None and settings.d is not None
    window, centre = settings.window, settings.window // 2
    return (
        embed(scaling.scale_outputs(outputs), settings.p, dt, window, centre),
        embed(scaling.scale_inputs(inputs), settings.d, dt, window, centre),
    )
