"""Trials: forecasts that begin all over a recorded stretch, and what they tell of those that are to come."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.dem.fit import Fit, fit
from mavdem.dem.settings import Settings

Array = NDArray[np.float64]

LONGEST_FORECAST = 1.5
"""Seconds: trials reach so far, as do the paper's 150 samples at 100 Hz."""

MOST_STARTS = 200
"""They begin at so many places of a stretch at most."""


class Trials(NamedTuple):
    """Forecasts of a stretch, physical and less the model's output trim: (starts, H, m) each."""

    measured: Array
    predicted: Array

    @property
    def mse(self) -> Array:
        """Mean squared error by horizon, (H, m)."""
        # An unstable model's forecast may overflow; an infinite error is then the answer.
        with np.errstate(over="ignore", invalid="ignore"):
            return np.asarray(((self.measured - self.predicted) ** 2).mean(axis=0))


def trials(fitted: Fit, inputs: Array, outputs: Array, dt: float) -> Trials:
    """A model's forecasts of a recorded stretch, from places all over the first part of it.

    Args:
        fitted: the model.
        inputs, outputs: (T, r), (T, m), physical.
        dt: sampling step, s.
    """
    horizon = max(1, min(round(LONGEST_FORECAST / dt), 2 * len(outputs) // 3))
    last = len(outputs) - horizon - 1
    # The filter needs a few samples to find hidden states.
    starts = np.unique(np.linspace(min(horizon // 4, last), last, MOST_STARTS).astype(int))
    scaling = fitted.scaling
    scaled = scaling.scale_outputs(outputs)
    with np.errstate(over="ignore", invalid="ignore"):
        errors = fitted.predictor.forecast_errors(scaled, scaling.scale_inputs(inputs), horizon, starts)
        measured = scaled[starts[:, None] + 1 + np.arange(horizon)]
        return Trials(measured * scaling.output_scale, (measured - errors) * scaling.output_scale)


class Unseen(NamedTuple):
    """What forecasts of each half of the data by a model of the other half tell."""

    mse: Array  # (H, m) by horizon, of the model's forecasts
    weight: Array  # (H, m), 0 to 1: of the model's forecast against the trim, for the least error
    weighted_mse: Array  # (H, m) with that weight
    motors_share: (
        float  # of the squared error of forecasts that leave the motors at their trim, taken off by the motors
    )


def unseen_forecasts(inputs: Array, outputs: Array, dt: float, settings: Settings) -> Unseen:
    """Judges settings by forecasts of data that the fit has not seen.

    An uncertain model's forecasts spread too far, so the least error is had part of the way back to the trim: where a
    model is worth nothing, all the way.

    Args:
        inputs, outputs: (T, r), (T, m), physical.
        dt: sampling step, s.
        settings: complete; without ``shrink_forecasts`` every weight is 1.

    Raises:
        numpy.linalg.LinAlgError: a fit broke down.
        ValueError: a half in which a channel does not vary.
    """
    half = len(outputs) // 2
    halves = slice(0, half), slice(len(outputs) - half, None)
    own, at_trim = [], []
    for learnt, unseen in (halves, halves[::-1]):
        fitted = fit(inputs[learnt], outputs[learnt], dt, settings)
        trim = np.broadcast_to(fitted.scaling.input_trim, inputs[unseen].shape)
        own.append(trials(fitted, inputs[unseen], outputs[unseen], dt))
        at_trim.append(trials(fitted, trim, outputs[unseen], dt))
    both, without = Trials(*np.concatenate(own, axis=1)), Trials(*np.concatenate(at_trim, axis=1))
    best = _weight(both)
    variance = outputs.var(axis=0)
    left = np.mean(_weighted(both, best).mse / variance) / np.mean(_weighted(without, _weight(without)).mse / variance)
    weight = best if settings.shrink_forecasts else np.ones_like(best)
    return Unseen(both.mse, weight, _weighted(both, weight).mse, float(1 - left))


def _weighted(both: Trials, weight: Array) -> Trials:
    return Trials(both.measured, weight * both.predicted)


def _weight(both: Trials) -> Array:
    """By least squares, (H, m); none for forecasts that overflow."""
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        weight = (both.measured * both.predicted).sum(axis=0) / (both.predicted**2).sum(axis=0)
    return np.asarray(np.clip(np.nan_to_num(weight), 0.0, 1.0))
