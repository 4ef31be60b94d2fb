"""Trials: forecasts that begin all over a recorded stretch, and what they tell of those that are to come."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.dem.fit import Fit, fit
from mavdem.dem.record import Record
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


def trials(fitted: Fit, record: Record, motors_at: Array | None = None) -> Trials:
    """A model's forecasts of a record, from places all over the first part of each segment.

    Args:
        fitted: the model.
        record: what is forecast.
        motors_at: (r,) motor outputs to take throughout, in place of the recorded ones.
    """
    horizon = max(1, min(round(LONGEST_FORECAST / record.dt), 2 * record.longest // 3))
    scaling = fitted.scaling
    measured, predicted = [], []
    for inputs, outputs in record.segments:
        last = len(outputs) - horizon - 1
        if last < 0:
            continue
        # The filter needs a few samples to find hidden states.
        share = max(1, round(MOST_STARTS * len(outputs) / len(record)))
        starts = np.unique(np.linspace(min(horizon // 4, last), last, share).astype(int))
        scaled = scaling.scale_outputs(outputs)
        driven = scaling.scale_inputs(inputs if motors_at is None else np.broadcast_to(motors_at, inputs.shape))
        with np.errstate(over="ignore", invalid="ignore"):
            errors = fitted.predictor.forecast_errors(scaled, driven, horizon, starts)
            ahead = scaled[starts[:, None] + 1 + np.arange(horizon)]
            measured.append(ahead * scaling.output_scale)
            predicted.append((ahead - errors) * scaling.output_scale)
    return Trials(np.concatenate(measured), np.concatenate(predicted))


class Unseen(NamedTuple):
    """What forecasts of each half of the data by a model of the other half tell."""

    mse: Array  # (H, m) by horizon, of the model's forecasts
    weight: Array  # (H, m), 0 to 1: of the model's forecast against the trim, for the least error
    weighted_mse: Array  # (H, m) with that weight
    motors_share: (
        float  # of the squared error of forecasts that leave the motors at their trim, taken off by the motors
    )


def unseen_forecasts(record: Record, settings: Settings) -> Unseen:
    """Judges settings by forecasts of data that the fit has not seen.

    An uncertain model's forecasts spread too far, so the least error is had part of the way back to the trim: where a
    model is worth nothing, all the way.

    Args:
        record: what is learnt from.
        settings: complete; without ``shrink_forecasts`` every weight is 1.

    Raises:
        numpy.linalg.LinAlgError: a fit broke down.
        ValueError: a half in which a channel does not vary.
    """
    halves = record.halves()
    own, at_trim = [], []
    for learnt, unseen in (halves, halves[::-1]):
        fitted = fit(learnt, settings)
        own.append(trials(fitted, unseen))
        at_trim.append(trials(fitted, unseen, fitted.scaling.input_trim))
    both, without = _together(own), _together(at_trim)
    best = _weight(both)
    variance = record.outputs.var(axis=0)
    left = np.mean(_weighted(both, best).mse / variance) / np.mean(_weighted(without, _weight(without)).mse / variance)
    weight = best if settings.shrink_forecasts else np.ones_like(best)
    return Unseen(both.mse, weight, _weighted(both, weight).mse, float(1 - left))


def _together(halves: list[Trials]) -> Trials:
    """Both halves' trials, to the longest horizon that both have."""
    horizon = min(half.measured.shape[1] for half in halves)
    measured, predicted = (
        np.concatenate([getattr(half, name)[:, :horizon] for half in halves]) for name in Trials._fields
    )
    return Trials(measured, predicted)


def _weighted(both: Trials, weight: Array) -> Trials:
    return Trials(both.measured, weight * both.predicted)


def _weight(both: Trials) -> Array:
    """By least squares, (H, m); none for forecasts that overflow."""
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        weight = (both.measured * both.predicted).sum(axis=0) / (both.predicted**2).sum(axis=0)
    return np.asarray(np.clip(np.nan_to_num(weight), 0.0, 1.0))
