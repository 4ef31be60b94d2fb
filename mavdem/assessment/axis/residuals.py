"""Residuals: one-step prediction errors of a model, and the tests whether they are white and free of the command."""

from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.confidence import Interval, coverage_factor
from mavdem.dem import Learned
from mavdem.facts.assessment import BoundTest

BOUND_LEVEL = 0.99  # of the bounds that chance alone keeps to
LAG_SECONDS = 0.5  # s, up to which residuals are correlated


class Residuals(NamedTuple):
    """One-step residuals of one output with their correlations by lag, and the 99 % bounds of these."""

    errors: Array  # (T,) in the output's unit; NaN where nothing was predicted
    lag: Array  # (L + 1,) s, from 0 on
    auto: Array  # (L + 1,) autocorrelation
    across: Array  # (L + 1,) correlation with the command, so long after it
    # of both; the second allows for the autocorrelation of both (Ljung, sec. 16.6)
    bounds: Interval

    @property
    def largest(self) -> Interval:
        """The largest correlations, but for the first of ``auto``."""
        return float(abs(self.auto[1:]).max()), float(abs(self.across).max())

    @property
    def outcome(self) -> BoundTest:
        """By the larger beside its bound: beyond it is nearly passed; by three times it is no chance, and failed."""
        beyond = max(np.divide(self.largest, self.bounds))
        if beyond <= 1:
            return BoundTest.PASSED
        return BoundTest.NEARLY if beyond <= 3 else BoundTest.FAILED


def residuals(learned: Learned, output: int = -1) -> Residuals:
    """Returns the residuals of an ``output`` of the training data, the last one unless given."""
    record = learned.record
    command = learned.record.inputs @ weights(directions(learned))
    errors = record.outputs[:, output] - learned.one_step()[:, output]
    errors[record.segment_starts] = np.nan  # a segment's first is not predicted
    finite = ~np.isnan(errors)
    centred = np.where(finite, errors - errors[finite].mean(), 0.0)
    driven = command - command.mean()
    lags = round(LAG_SECONDS / learned.dt)
    auto = correlation(centred, centred, lags)
    driven_auto = correlation(driven, driven, lags)
    width = float(coverage_factor(BOUND_LEVEL) / np.sqrt(len(finite)))
    # The variance of a correlation of two independent series.
    joint = float(np.sqrt(max(1 + 2 * float(auto[1:] @ driven_auto[1:]), 1.0)))
    lag = np.arange(lags + 1.0) * learned.dt
    return Residuals(errors, lag, auto, correlation(driven, centred, lags), (width, width * joint))


def correlation(first: Array, other: Array, lags: int) -> Array:
    """Returns (lags + 1,) of ``first`` at a time with ``other`` 0, 1, … samples later."""
    size = 2 * len(first)
    products = np.fft.irfft(np.conj(np.fft.rfft(first, size)) * np.fft.rfft(other, size), size)[
        : lags + 1
    ]
    scale = np.sqrt(float(first @ first) * float(other @ other))
    return products / scale if scale else np.zeros(lags + 1)


def directions(learned: Learned) -> Array:
    """Returns (r,) how each input turns the vehicle, relative to the others: by the mixer, or else as estimated."""
    fitted = learned.record.effect_directions
    if fitted is not None:
        return fitted
    if learned.record.inputs.shape[1] == 1:  # the controller's demand
        return np.ones(1)
    effect = learned.model.B[-1] if learned.physical is None else learned.physical.effect
    return effect if effect.any() else np.ones(len(effect))


def weights(directions: Array) -> Array:
    """Returns (r,) the share of each input in the command of the axis: those that turn up it sum to 1, others to -1."""
    up = np.maximum(directions, 0.0)
    down = np.maximum(-directions, 0.0)
    return np.asarray(
        sum(sign * side / side.sum() for sign, side in ((1, up), (-1, down)) if side.any())
    )
