"""The choices that settings leave open, and how the chosen model's forecasts are judged: on training data alone.

F̄ compares models of the same data. A wider window changes the data the engine sees, and its samples, counted as if
independent, make F̄ prefer ever weaker priors; so the judge here is what the model is for, its own forecasts. Every
candidate is judged on the data it was fitted to, which with so few candidates costs little in honesty and gives all of
them all the data. What the winner's forecasts are worth is then told by forecasts of data that the fit has not seen.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.dem.fit import Fit, fit
from mavdem.dem.settings import Settings

Array = NDArray[np.float64]

HIDDEN_STATES = 1
"""Beside the outputs, unless the order is given: the lag between motor output and torque."""

WINDOWS = (0.0, 0.09, 0.25)
"""Candidate embedding windows, seconds: the shortest there is, and two that average noise and gusts away."""

PARAMETER_PRECISIONS = (0.01, 1.0, 10.0, 100.0)
"""Candidate prior precisions, from hardly a prior to one that wants much evidence."""

LONGEST_FORECAST = 1.5
"""Seconds: the forecasts that judge reach so far, as do the paper's 150 samples at 100 Hz."""

MOST_STARTS = 200
"""They begin at so many places of a stretch at most."""


@dataclass(frozen=True)
class Candidate:
    """One way to fill what the settings left open, and how it forecast inside the training data.

    Attributes:
        window, parameter_precision: as in :class:`Settings`.
        error: mean squared forecast error over all horizons, in units of each output's training variance; infinite
            where the fit broke down.
    """

    window: int
    parameter_precision: float
    error: float


def candidates(settings: Settings, outputs: int, samples: int, dt: float) -> tuple[Settings, ...]:
    """Every way to fill the fields that ``settings`` leaves to the data.

    Raises:
        ValueError: no window fits the samples.
    """
    order = settings.order or outputs + HIDDEN_STATES
    d = min(2, settings.p) if settings.d is None else settings.d
    precisions = [settings.parameter_precision] if settings.parameter_precision else PARAMETER_PRECISIONS
    windows = [settings.window] if settings.window else sorted({_odd(seconds / dt, settings.p) for seconds in WINDOWS})
    # Half of each half's samples must have a whole window, or its derivatives come from too few of them.
    fitting = [window for window in windows if window <= samples // 4]
    if not fitting:
        fewest = 4 * windows[0]
        raise ValueError(f"train must have at least {fewest} samples for a window of {windows[0]}, not {samples}")
    return tuple(
        replace(settings, order=order, d=d, window=window, parameter_precision=precision)
        for window, precision in product(fitting, precisions)
    )


def _odd(samples: float, p: int) -> int:
    """The odd window next to ``samples`` that order p allows: an odd window has a sample at its centre."""
    window = max(round(samples), p + 1)
    return window + 1 - window % 2


def forecast_mse(fitted: Fit, inputs: Array, outputs: Array, dt: float) -> Array:
    """Mean squared error (H, m) of a model's forecasts of a recorded stretch, by horizon, in physical units.

    Args:
        fitted: the model.
        inputs, outputs: (T, r), (T, m), physical; forecasts begin all over the first part of them.
        dt: sampling step, s.
    """
    horizon = max(1, min(round(LONGEST_FORECAST / dt), 2 * len(outputs) // 3))
    last = len(outputs) - horizon - 1
    # The filter needs a few samples to find hidden states.
    starts = np.unique(np.linspace(min(horizon // 4, last), last, MOST_STARTS).astype(int))
    scaling = fitted.scaling
    # An unstable model's forecast may overflow; an infinite error is then the answer.
    with np.errstate(over="ignore", invalid="ignore"):
        errors = fitted.predictor.forecast_errors(
            scaling.scale_outputs(outputs), scaling.scale_inputs(inputs), horizon, starts
        )
        return np.asarray((errors**2).mean(axis=0) * scaling.output_scale**2)


class Unseen(NamedTuple):
    """Forecasts of each half of the data by a model of the other half: mean squared errors (H, m) by horizon."""

    mse: Array
    mse_at_trim: Array  # with the motors held at their trim: what the motion by itself lets one know


def unseen_forecasts(inputs: Array, outputs: Array, dt: float, settings: Settings) -> Unseen:
    """Judges settings by forecasts of data that the fit has not seen.

    Args:
        inputs, outputs: (T, r), (T, m), physical.
        dt: sampling step, s.
        settings: complete.

    Raises:
        numpy.linalg.LinAlgError: a fit broke down.
        ValueError: a half in which a channel does not vary.
    """
    half = len(outputs) // 2
    halves = slice(0, half), slice(len(outputs) - half, None)
    errors = []
    for learnt, unseen in (halves, halves[::-1]):
        fitted = fit(inputs[learnt], outputs[learnt], dt, settings)
        trim = np.broadcast_to(fitted.scaling.input_trim, inputs[unseen].shape)
        errors.append([forecast_mse(fitted, drive, outputs[unseen], dt) for drive in (inputs[unseen], trim)])
    return Unseen(*np.mean(errors, axis=0))
