"""Joint vector autoregression of outputs and inputs: each sample from those before it, with the uncertainty of that.

In closed loop the motors follow from the motion, so that they are predicted and observed like the outputs:
z = [outputs, inputs] is one process of k = m + r channels,

    z_t = Σᵢ Aᵢ z_{t−i} + offset + e_t,    e_t ~ N(0, Σ), i = 1 … lags.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from mavdem.dem.engine.linalg import Array, inverse, solve
from mavdem.dem.record import Record, Spread

RIDGE = 0.01
"""Precision of the prior of the first lag's coefficients, of channels of deviation 1 and innovations of covariance Σ.
As a precision it does not grow with the number of samples."""

CONSTANT_RIDGE = 1e-8  # likewise of the offset, which the prior leaves open
LAG_POWER = 2  # the precision of lag i is RIDGE · i to this power
LEAST_FREEDOM = 1.0  # rows that are left for the innovations, where there are hardly more than coefficients


class ChannelUnits(NamedTuple):
    """Units in which each channel, outputs first, has mean 0 and deviation 1; a constant one keeps its unit."""

    center: Array  # (k,)
    scale: Array  # (k,)

    @classmethod
    def of(cls, record: Record) -> ChannelUnits:
        """Those of the training data."""
        inputs, outputs = record.spread
        spread = Spread(*(np.concatenate(pair) for pair in zip(outputs, inputs, strict=True)))
        return cls(spread.mean, np.where(spread.moving, np.sqrt(spread.variance), 1.0))

    def scaled(self, channels: Array) -> Array:
        """Channels (…, k) in these units; or the first columns of them, as those of the outputs alone."""
        width = channels.shape[-1]
        return np.asarray((channels - self.center[:width]) / self.scale[:width])

    def scaled_inputs(self, inputs: Array) -> Array:
        """Inputs (…, r), the last channels, in these units."""
        start = len(self.center) - inputs.shape[-1]
        return np.asarray((inputs - self.center[start:]) / self.scale[start:])

    def segments(self, record: Record) -> list[Array]:
        """The channels (T, k) of each segment of ``record``, in these units."""
        return [self.scaled(np.hstack([outputs, inputs])) for inputs, outputs in record.segments]


class LagStatistics(NamedTuple):
    """All that the regression needs of the samples: sums over rows, which add up over segments and can be taken off.

    Attributes:
        rows: number of samples with as many before them as there are lags.
        gram: (q, q) Σ of each row times itself; a row is [lag 1 … lag p, 1, sample], q = (p + 1) k + 1.
    """

    rows: int
    gram: Array

    @classmethod
    def of(cls, segments: Iterable[Array], lags: int) -> LagStatistics:
        """Those of ``segments`` of channels (T, k); no row reaches across a gap between them.

        Raises:
            ValueError: no segment.
        """
        parts = [_rows(channels, lags) for channels in segments]
        if not parts:
            raise ValueError("segments must hold at least one segment")
        return cls(sum(map(len, parts)), np.asarray(sum(part.T @ part for part in parts)))

    def __add__(self, other: LagStatistics) -> LagStatistics:  # type: ignore[override]
        """Those of the samples of both."""
        return LagStatistics(self.rows + other.rows, self.gram + other.gram)

    def __sub__(self, other: LagStatistics) -> LagStatistics:
        """Those of the samples of this one without the other's, which must be among them."""
        return LagStatistics(self.rows - other.rows, self.gram - other.gram)


class Autoregression(NamedTuple):
    """The model, in the units of the channels it was made from.

    Attributes:
        coefficients: (lags, k, k) posterior means of A₁ … A_lags.
        offset: (k,) likewise.
        covariance: (k, k) Σ, of the innovations.
        precision: (lags k + 1, lags k + 1) G of the regressors [lag 1 … lag p, 1]: given Σ, the coefficients of
            channels i and j have covariance Σ_ij G⁻¹.
    """

    coefficients: Array
    offset: Array
    covariance: Array
    precision: Array

    @property
    def lags(self) -> int:
        """Number of samples before each that it depends on."""
        return len(self.coefficients)

    @property
    def channels(self) -> int:
        """Number of outputs and inputs together."""
        return len(self.offset)

    @property
    def across(self) -> Array:
        """(k, lags k): [A₁ … A_lags], of the lags side by side, the latest sample first."""
        lags, k, _ = self.coefficients.shape
        return self.coefficients.swapaxes(0, 1).reshape(k, lags * k)

    @property
    def spectral_radius(self) -> float:
        """The largest magnitude among the eigenvalues of the step from one set of lags to the next."""
        k, width = self.across.shape
        companion = np.eye(width, k=-k)
        companion[:k] = self.across
        return float(np.abs(np.linalg.eigvals(companion)).max())


def autoregression(statistics: LagStatistics, lags: int, ridge: float = RIDGE) -> Autoregression:
    """Bayesian linear regression of a sample on its ``lags``, exact given Σ: the posterior is matrix normal.

    The prior is a random walk, A₁ = 1 and nothing else, with precision ``ridge`` · i² at lag i: the "Minnesota prior"
    (R. Litterman, "Forecasting with Bayesian vector autoregressions: five years of experience", Journal of Business &
    Economic Statistics 4(1), 1986). It supposes channels of about deviation 1. Σ is the squared errors, the prior's
    among them, over the rows that the coefficients leave (rows less their effective number).

    Raises:
        ValueError: no rows, or statistics of another number of lags.
    """
    width = len(statistics.gram)
    k, left = divmod(width - 1, lags + 1)
    if left or k < 1:
        raise ValueError(f"statistics must be of {lags} lags: {width} columns are not (lags + 1) · channels + 1")
    if statistics.rows < 1:
        raise ValueError(f"segments must have more than {lags} samples: none has so many before it")
    weights = ridge * np.repeat(np.arange(1.0, lags + 1) ** LAG_POWER, k)
    prior = np.append(weights, CONSTANT_RIDGE)
    before = np.zeros((lags * k + 1, k))
    before[:k] = np.eye(k)
    precision = statistics.gram[:-k, :-k] + np.diag(prior)
    # Moments of the error of a random walk: small numbers, where the samples themselves are large ones.
    walk = np.vstack([np.eye(width - k, width), np.hstack([-before.T, np.eye(k)])])
    gram = walk @ statistics.gram @ walk.T
    change = solve(precision, gram[:-k, -k:])
    errors = gram[-k:, -k:] - gram[-k:, :-k] @ change
    used = width - k - float(prior @ inverse(precision).diagonal())
    covariance = _positive(errors) / max(statistics.rows - used, LEAST_FREEDOM)
    coefficients = (before + change).T
    return Autoregression(
        np.ascontiguousarray(coefficients[:, :-1].reshape(k, lags, k).swapaxes(0, 1)),
        np.ascontiguousarray(coefficients[:, -1]),
        covariance,
        precision,
    )


def _rows(channels: Array, lags: int) -> Array:
    """(T − lags, (lags + 1) k + 1) rows of :class:`LagStatistics`."""
    count, k = max(0, len(channels) - lags), channels.shape[1]
    columns = [channels[lags - lag : lags - lag + count] for lag in range(1, lags + 1)]
    if not count:
        return np.empty((0, (lags + 1) * k + 1))
    return np.hstack([*columns, np.ones((count, 1)), channels[lags:]])


def _positive(matrix: Array) -> Array:
    """The nearest symmetric matrix without negative eigenvalues, which rounding leaves where errors vanish."""
    sizes, directions = np.linalg.eigh((matrix + matrix.T) / 2)
    return np.asarray((directions * np.maximum(sizes, 0.0)) @ directions.T)
