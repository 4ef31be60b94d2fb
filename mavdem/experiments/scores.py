"""Scores: squared errors of one method's forecasts of one window, relative to the constant mean's.

A test part of H samples is forecast in pieces of k steps: at every k-th sample a forecast starts from all data before
it. So each sample counts once at every horizon, forecasts do not overlap, the error is the mean *up to* the k-th step,
and the constant mean's error is the same at all horizons. k = H is the MSPE of the one forecast from the end of
training.
"""

from enum import StrEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mavdem.arrays import Array, as_real_array
from mavdem.dem.engine.linalg import may_overflow
from mavdem.dem.online.learner_arguments import DEFAULT_HORIZONS
from mavdem.dem.plant_forecasts import FORECAST_HORIZON_SECONDS
from mavdem.flight import Flight

REFERENCE_RATE = 100.0
"""Hz, the sampling rate that ``HORIZONS`` are counted at. At other rates horizons last as long as at this one."""

HORIZONS = (*DEFAULT_HORIZONS, round(FORECAST_HORIZON_SECONDS * REFERENCE_RATE))
"""Horizons in steps of ``REFERENCE_RATE``: the horizons of the online learner, and the paper's, 150."""


class ForecastKind(StrEnum):
    """A kind of forecast of the outputs, by the data that it may use."""

    KNOWN_INPUTS = "known"
    """How do the outputs go on from the state at the end of training, with these future inputs?"""
    FROM_STATE_ZERO = "zero"
    """How do the outputs go on from state 0, with these future inputs?"""
    UNKNOWN_INPUTS = "unknown"
    """How do the outputs go on, if the future inputs are not known?"""


KNOWN_INPUTS, FROM_STATE_ZERO, UNKNOWN_INPUTS = ForecastKind


class Scores(NamedTuple):
    """Errors of a method's forecasts of one test part, at K horizons, for m outputs, and of the constant mean."""

    steps: tuple[int, ...]
    """(K,) horizons in steps; the last is the length of the test part"""
    squared_error: Array
    """(K, m) mean squared error, in the squares of the outputs' units"""
    inside: Array
    """(K,) share of the samples in the 90 % band; NaN without one"""
    variance: Array
    """(m,) training variance, the unit in which the errors of outputs are added up"""
    baseline: Array
    """(m,) mean squared error of the constant mean, in the squares of the outputs' units"""

    @property
    def ratio(self) -> Array:
        """Error ratio at each horizon (K,): squared error over the constant mean's, below 1 where it is better.

        Outputs differ in unit, so each counts in units of its variance in training. The ratio is the normalised mean
        squared error (NMSE) of system identification; 1 minus it is the skill score of meteorology.
        """
        error = (self.squared_error / self.variance).sum(axis=1)
        baseline_error = (self.baseline / self.variance).sum()
        return error_over(error, baseline_error)


class Mspe(NamedTuple):
    """Mean squared prediction error."""

    per_output: Array
    """(m,) in the squares of the outputs' units"""
    total: float
    """the sum over the outputs"""


@may_overflow
def mspe(measured: ArrayLike, predicted: ArrayLike) -> Mspe:
    """Computes the mean squared prediction error over samples (the paper's ``Metric for comparison``).

    :func:`mavdem.evaluate.held_out_windows` has errors on windows that no model has seen.

    Args:
        measured, predicted: (H, m) values each. A prediction that is NaN has an infinite error.

    Returns:
        The mean square for each output (m,), and their sum.

    Raises:
        ValueError: the shapes differ, or there are no samples.
    """
    measured_values = as_real_array(measured, "measured")
    predicted_values = as_real_array(predicted, "predicted")
    has_same_shape = measured_values.shape == predicted_values.shape
    if not has_same_shape or measured_values.ndim != 2 or not len(measured_values):
        raise ValueError(
            "measured and predicted must be (H, m) alike, "
            f"not {measured_values.shape} and {predicted_values.shape}"
        )
    # The forecast of an unstable model may overflow.
    squares = (measured_values - predicted_values) ** 2
    per_output = np.where(np.isnan(squares), np.inf, squares).mean(axis=0)
    return Mspe(per_output, float(per_output.sum()))


def error_over(ours: ArrayLike, theirs: ArrayLike) -> Array:
    """Returns the ratio of errors, ``ours`` over ``theirs``; 1 where both are the same, also 0 or infinite."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(np.equal(ours, theirs), 1.0, np.divide(ours, theirs))


def horizons(samples: int, dt: float) -> tuple[int, ...]:
    """Returns the horizons at which a test part is evaluated.

    Args:
        samples: length of the test part.
        dt: sampling step, s.

    Returns:
        Steps, ascending: the ``HORIZONS`` that are shorter than the test part, and its whole length.
    """
    # A horizon is the same time at every rate. At low rates several are rounded to one step, which counts once.
    steps = {max(1, round(horizon / REFERENCE_RATE / dt)) for horizon in HORIZONS}
    shorter_steps = [step for step in sorted(steps) if step < samples]
    return (*shorter_steps, samples)


class BaselineErrors(NamedTuple):
    """What the errors of a forecast are compared with, (m,) each, in the squares of the outputs' units."""

    variance: Array
    """variance of the training part"""
    constant_mean: Array
    """mean squared error of the training part's mean in the test part"""


def baseline_errors(train: Flight, test: Flight) -> BaselineErrors:
    """Returns the errors of the simplest forecast, the training mean, and the variance in which errors are measured.

    Args:
        train: training part, which gives mean and variance of the m outputs.
        test: test part, on which the mean is the forecast.

    Returns:
        Variance in training, and mean squared error of the training mean in the test part.

    Raises:
        ValueError: an output of ``train`` is constant.
    """
    if not np.ptp(train.outputs, axis=0).all():
        raise ValueError("train must vary in every output: errors are in units of its variance")
    training_mean = train.outputs.mean(axis=0)
    mean_as_forecast = np.broadcast_to(training_mean, test.outputs.shape)
    errors_of_mean = mspe(test.outputs, mean_as_forecast).per_output
    return BaselineErrors(train.outputs.var(axis=0), errors_of_mean)


def relative_mspe(train: Flight, test: Flight, forecast: ArrayLike) -> float:
    """Computes the error ratio of a forecast: its MSPE over the training mean's.

    The errors of outputs are added up in units of their training variance. Below 1 the forecast is better than the
    mean.

    Args:
        train: training data, which give mean and variances.
        test: H samples that were forecast.
        forecast: (H, m) outputs, in the units of ``test``.

    Returns:
        The ratio, without unit.

    Raises:
        ValueError: a forecast of another shape, or an output of ``train`` that is constant.
    """
    variance, errors_of_mean = baseline_errors(train, test)
    errors = mspe(test.outputs, forecast).per_output
    total_error = (errors / variance).sum()
    total_error_of_mean = (errors_of_mean / variance).sum()
    return float(error_over(total_error, total_error_of_mean))
