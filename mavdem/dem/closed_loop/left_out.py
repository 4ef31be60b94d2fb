"""The error to expect of a joint autoregression: of forecasts of samples that were left out when it was fitted."""

from __future__ import annotations

import numpy as np

from mavdem.dem.closed_loop.autoregression import Autoregression, ChannelUnits, LagStatistics, autoregression
from mavdem.dem.closed_loop.folds import Block, folds, without
from mavdem.dem.closed_loop.gaussian_path import filtered
from mavdem.dem.engine.linalg import Array
from mavdem.dem.record import Record

STARTS = 8  # of forecasts of each block
LARGEST_ERROR = 1e4  # squared, in training variances: a single forecast that explodes counts no more than that


def left_out_errors(record: Record, lags: int, ridge: float, steps: int) -> Array | None:
    """(L, m) mean squared error of forecasts with inputs measured, by length up to ``steps``, in training variances.

    Each fold is forecast by the model of the others; L is at most the length of its longest block. ``None`` where the
    record is too short for that.
    """
    segments = ChannelUnits.of(record).segments(record)
    whole = LagStatistics.of(segments, lags)
    m = record.outputs.shape[1]
    sums, counts = np.zeros((steps, m)), np.zeros(steps)
    for fold in folds(segments):
        kept = without(whole, lags, fold)
        if kept.rows < 1:
            continue
        model = autoregression(kept, lags, ridge)
        for block in fold:
            squares = _squared_errors(model, block, m, steps)
            sums[: squares.shape[1]] += squares.sum(axis=0)
            counts[: squares.shape[1]] += len(squares)
    forecast = counts > 0
    return np.asarray(sums[forecast] / counts[forecast, None]) if forecast.any() else None


def _squared_errors(model: Autoregression, block: Block, m: int, steps: int) -> Array:
    """(S, H, m) of forecasts from all over a block."""
    channels, first, stop = block
    first = max(first, model.lags)
    length = min(steps, stop - first)
    if length < 1:
        return np.empty((0, 0, m))
    starts = np.unique(np.linspace(first, stop - length, STARTS).astype(int))
    pasts, following = (channels[starts[:, None] + np.arange(*span)] for span in ((-model.lags, 0), (length,)))
    errors = following[..., :m] - filtered(model, pasts, following[..., m:]).mean
    return np.asarray(np.minimum(errors**2, LARGEST_ERROR))
