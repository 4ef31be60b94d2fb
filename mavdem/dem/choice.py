"""The choices that settings leave open, made by forecasts of training data that the fit has not seen.

F̄ compares models of the same data. A wider window changes the data the engine sees, and its samples, counted as if
independent, make F̄ prefer ever weaker priors; so the judge here is what the model is for. Each half of the training
data is forecast by a model of the other half.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from mavdem.dem.fit import fit
from mavdem.dem.settings import Settings

Array = NDArray[np.float64]

HIDDEN_STATES = (0, 1)
"""Candidate numbers of hidden states: none, or the lag between motor output and torque."""

WINDOWS = (0.0, 0.09, 0.25)
"""Candidate embedding windows, seconds: the shortest there is, and two that average noise and gusts away."""

PARAMETER_PRECISIONS = (0.01, 1.0, 10.0, 100.0)
"""Candidate prior precisions, from hardly a prior to one that wants much evidence."""

LONGEST_FORECAST = 1.5
"""Seconds: trial forecasts reach so far, as do the paper's 150 samples at 100 Hz."""

MOST_STARTS = 100
"""Trial forecasts begin at so many places in each half at most."""


def candidates(settings: Settings, outputs: int, samples: int, dt: float) -> tuple[Settings, ...]:
    """Every way to fill the fields that ``settings`` leaves to the data.

    Raises:
        ValueError: no window fits the samples.
    """
    orders = [settings.order] if settings.order else [outputs + hidden for hidden in HIDDEN_STATES]
    precisions = [settings.parameter_precision] if settings.parameter_precision else PARAMETER_PRECISIONS
    windows = [settings.window] if settings.window else sorted({_odd(seconds / dt, settings.p) for seconds in WINDOWS})
    # Half of each half's samples must have a whole window, or derivatives come from too few of them.
    fitting = [window for window in windows if window <= samples // 4]
    if not fitting:
        fewest = 4 * windows[0]
        raise ValueError(f"train must have at least {fewest} samples for a window of {windows[0]}, not {samples}")
    return tuple(
        replace(settings, order=order, window=window, parameter_precision=precision)
        for order, window, precision in product(orders, fitting, precisions)
    )


def _odd(samples: float, p: int) -> int:
    """The odd window next to ``samples`` that order p allows: an odd window has a sample at its centre."""
    window = max(round(samples), p + 1)
    return window + 1 - window % 2


def trial_mse(inputs: Array, outputs: Array, dt: float, settings: Settings) -> Array:
    """Mean squared error (H, m) of forecasts of each half of the data by a model of the other half, by horizon.

    Args:
        inputs, outputs: (T, r), (T, m) in physical units.
        dt: sampling step, s.
        settings: complete.

    Raises:
        numpy.linalg.LinAlgError: a fit broke down.
        ValueError: a half in which a channel does not vary.
    """
    middle = len(outputs) // 2
    halves = slice(0, middle), slice(middle, None)
    errors = [
        _forecast_mse(inputs[learnt], outputs[learnt], inputs[unseen], outputs[unseen], dt, settings)
        for learnt, unseen in (halves, halves[::-1])
    ]
    return np.asarray(np.mean(errors, axis=0))


def _forecast_mse(
    inputs: Array, outputs: Array, unseen_inputs: Array, unseen_outputs: Array, dt: float, settings: Settings
) -> Array:
    fitted = fit(inputs, outputs, dt, settings)
    # As long in both halves, of which the second may be one sample longer.
    horizon = max(1, min(round(LONGEST_FORECAST / dt), 2 * len(outputs) // 3, 2 * len(unseen_outputs) // 3))
    last = len(unseen_outputs) - horizon - 1
    # The filter needs a few samples to find hidden states.
    starts = np.unique(np.linspace(min(horizon // 4, last), last, MOST_STARTS).astype(int))
    scaling = fitted.scaling
    # An unstable model's forecast may overflow; an infinite error is then the answer.
    with np.errstate(over="ignore", invalid="ignore"):
        errors = fitted.predictor.forecast_errors(
            scaling.scale_outputs(unseen_outputs), scaling.scale_inputs(unseen_inputs), horizon, starts
        )
        return np.asarray((errors**2).mean(axis=0) * scaling.output_scale**2)
