"""Residuals: one-step prediction errors of a model, tested for autocorrelation and correlation with the command."""

from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.confidence import coverage_factor
from mavdem.dem import Learned
from mavdem.facts.assessment import BoundTest

BOUND_LEVEL = 0.99
"""Probability with which a correlation by chance stays within its bound."""

MAX_LAG = 0.5
"""Largest lag of the correlations, s: several times the time constants of the motors and of the attitude."""

FAILED_BOUND_RATIO = 3.0
"""Correlation over its bound above which the test has failed. Up to it the test is nearly passed: with so many samples
small deviations are significant that do no harm."""


class LargestCorrelations(NamedTuple):
    """Largest absolute values of the correlations of residuals."""

    autocorrelation: float
    """That of the residuals at lags above 0."""

    command: float
    """That of the residuals with past commands."""


class Residuals(NamedTuple):
    """One-step residuals of one output, and their correlations at L + 1 lags with the bounds that chance keeps."""

    errors: Array
    """(T,) residuals of T samples, in the output's unit; NaN where nothing was predicted."""
    lag: Array
    """(L + 1,) s, from 0 on."""
    autocorrelation: Array
    """(L + 1,) of the residuals."""
    command_correlation: Array
    """(L + 1,) of the residuals with the command a lag before."""
    bounds: tuple[float, float]
    """Bounds of the absolute values of both correlations. The second allows for the autocorrelation of both series (L.
    Ljung, System Identification, 2nd ed., sec. 16.6)."""

    @property
    def largest_correlations(self) -> LargestCorrelations:
        """Largest absolute value of the autocorrelation, and of the correlation with the command.

        The autocorrelation at lag 0 is left out: it is always 1.
        """
        largest_autocorrelation = float(abs(self.autocorrelation[1:]).max())
        largest_command_correlation = float(abs(self.command_correlation).max())
        return LargestCorrelations(largest_autocorrelation, largest_command_correlation)

    @property
    def outcome(self) -> BoundTest:
        """Outcome of the test that the residuals are white and independent of past commands.

        Each correlation is divided by its bound, and the larger ratio decides: up to 1 the test is passed, up to
        ``FAILED_BOUND_RATIO`` nearly.
        """
        ratio = max(np.divide(self.largest_correlations, self.bounds))
        if ratio <= 1:
            return BoundTest.PASSED
        return BoundTest.NEARLY if ratio <= FAILED_BOUND_RATIO else BoundTest.FAILED


def residuals(learned: Learned, output: int = -1) -> Residuals:
    """Computes the one-step residuals of an output in the training data, and their correlations.

    Residuals of a model without missing dynamics are white: they do not correlate with each other, nor with past
    commands. Both are tested as in L. Ljung, System Identification, 2nd ed., sec. 16.6.

    Args:
        learned: the linear model that was learned from a flight, with its training data.
        output: index of the output; by default the last one, the rate.

    Returns:
        The T residuals, and their correlations at the lags from 0 to ``MAX_LAG`` seconds, with the bounds of the test.
    """
    record = learned.record
    # The inputs of all motors, combined to one command of the axis.
    command = record.inputs @ command_weights(input_directions(learned))
    errors = record.outputs[:, output] - learned.one_step()[:, output]
    # The first sample of a segment is not predicted.
    errors[record.segment_starts] = np.nan
    is_predicted = ~np.isnan(errors)
    # Unpredicted samples are set to the mean, so that they add nothing to the correlations.
    centred_errors = np.where(is_predicted, errors - errors[is_predicted].mean(), 0.0)
    centred_command = command - command.mean()
    max_lag = round(MAX_LAG / learned.dt)
    autocorrelation = lagged_correlation(centred_errors, centred_errors, max_lag)
    autocorrelation_of_command = lagged_correlation(centred_command, centred_command, max_lag)
    command_correlation = lagged_correlation(centred_command, centred_errors, max_lag)
    # A correlation of two white series of T samples has the variance 1/T.
    white_bound = float(coverage_factor(BOUND_LEVEL) / np.sqrt(len(is_predicted)))
    # That of independent series with autocorrelations r and q is larger by the factor 1 + 2 Σ r q over the lags.
    variance_factor = 1 + 2 * float(autocorrelation[1:] @ autocorrelation_of_command[1:])
    command_bound = white_bound * float(np.sqrt(max(variance_factor, 1.0)))
    lag_times = np.arange(max_lag + 1.0) * learned.dt
    bounds = (white_bound, command_bound)
    return Residuals(errors, lag_times, autocorrelation, command_correlation, bounds)


def lagged_correlation(earlier_series: Array, later_series: Array, max_lag: int) -> Array:
    """Computes the cross-correlation of two series at lags from 0 on, by Fourier transforms (Wiener-Khinchin).

    Args:
        earlier_series: (T,) series with mean 0.
        later_series: (T,) series with mean 0. Its samples are correlated with earlier samples of the other series.
        max_lag: largest lag L, in samples.

    Returns:
        (L + 1,) correlations of ``earlier_series`` with ``later_series`` 0, 1, …, L samples after it; 0 if one of
        them is constant.
    """
    # Padding with as many zeros keeps the end of a series from being correlated with its beginning.
    padded_size = 2 * len(earlier_series)
    earlier_transform = np.fft.rfft(earlier_series, padded_size)
    later_transform = np.fft.rfft(later_series, padded_size)
    cross_spectrum = np.conj(earlier_transform) * later_transform
    cross_products = np.fft.irfft(cross_spectrum, padded_size)[: max_lag + 1]
    earlier_power = float(earlier_series @ earlier_series)
    later_power = float(later_series @ later_series)
    norm = np.sqrt(earlier_power * later_power)
    if not norm:
        return np.zeros(max_lag + 1)
    return cross_products / norm


def input_directions(learned: Learned) -> Array:
    """Returns how strongly, and in which direction, each input of a model rotates the vehicle, relative to the others.

    Residuals are correlated with one command, to which the inputs are combined by these numbers
    (:func:`command_weights`). They are the row of the mixer if it is known, otherwise the estimated effects of the
    inputs. If all of these are 0, every input counts alike.

    Args:
        learned: the model, with r inputs.

    Returns:
        Relative effects (r,), with sign.
    """
    record = learned.record
    if record.effect_directions is not None:
        return record.effect_directions
    input_count = record.inputs.shape[1]
    if input_count == 1:
        # The one input is the controller's demand.
        return np.ones(1)
    if learned.physical is not None:
        effects = learned.physical.effect
    else:
        # The last output is the body rate: its row of B is the angular acceleration by each input.
        effects = learned.model.B[-1]
    if not effects.any():
        return np.ones(len(effects))
    return effects


def command_weights(directions: Array) -> Array:
    """Returns the weights with which the inputs sum to the command of an axis.

    The command is the weighted mean of the inputs that rotate the vehicle in the positive direction, minus the weighted
    mean of the inputs that rotate it in the negative one. So it has the unit of the inputs, however many there are.

    Args:
        directions: (r,) how strongly each of r inputs rotates the vehicle, positive or negative, in any unit.

    Returns:
        (r,) weights; the positive ones sum to 1, and the negative ones to -1, if there are such inputs.
    """
    weights = np.zeros(len(directions))
    for sign in (1, -1):
        effects = np.maximum(sign * directions, 0.0)
        if effects.any():
            weights = weights + sign * effects / effects.sum()
    return weights
