"""Folds: parts of the training data, each left out of the statistics in turn, which shows true errors."""

from __future__ import annotations

import numpy as np

from mavdem.dem.closed_loop.autoregression import LagStatistics
from mavdem.dem.engine.linalg import Array

FOLDS = 4

Block = tuple[Array, int, int]
"""Channels (T, k) of a segment, and the first and the last sample but one of a part of it."""


def folds(segments: list[Array]) -> list[list[Block]]:
    """The samples of all ``segments`` (T, k) in parts of about equal length, each in blocks of one segment."""
    ends = np.cumsum([len(channels) for channels in segments])
    cuts = np.linspace(0, ends[-1], FOLDS + 1).astype(int)
    found = []
    for first, last in zip(cuts[:-1], cuts[1:], strict=True):
        begins = ends - [len(channels) for channels in segments]
        blocks = zip(segments, np.maximum(first - begins, 0), np.minimum(last, ends) - begins, strict=True)
        found.append([(channels, int(start), int(stop)) for channels, start, stop in blocks if start < stop])
    return [fold for fold in found if fold]


def without(whole: LagStatistics, lags: int, fold: list[Block]) -> LagStatistics:
    """The statistics of all samples but those of the ``fold``."""
    return whole - LagStatistics.of([channels[max(0, start - lags) : stop] for channels, start, stop in fold], lags)
