"""The vector autoregression of outputs and inputs as one process: each sample from those before it.

In closed loop the motors follow from the motion: z = [outputs, inputs] is one process of k = m + r channels,

    z_t = Σᵢ Aᵢ z_{t−i} + offset + e_t,    e_t ~ N(0, Σ), i = 1 … lags.

Outputs after a known past follow with the inputs unknown, measured up to the sample itself, or all measured. Given the
parameters the answers are Gaussian and exact. Inputs are measured without noise, so that what is uncertain are the
outputs since the past ended: the state of a Kalman filter whose noises of measurement and process are correlated.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from mavdem.dem.engine.kalman import KalmanFilter
from mavdem.dem.engine.linalg import Array, inverse, solve
from mavdem.dem.record import Record, Spread

RIDGE = 0.01
"""Precision of the prior of the first lag's coefficients, of channels of deviation 1 and innovations of covariance Σ.
As a precision it does not grow with the number of samples."""

CONSTANT_RIDGE = 1e-8  # likewise of the offset, which the prior leaves open
LAG_POWER = 2  # the precision of lag i is the ridge · i to this power
LEAST_FREEDOM = 1.0  # rows that are left for the innovations, where there are hardly more than coefficients

INPUT_NOISE = 1e-9
"""Variance added to the innovations of inputs: one that is constant, or depends on others, has none of its own."""


class Forecast(NamedTuple):
    """Outputs that were forecast and the squared error to expect of them, (…, H, m) each."""

    mean: Array
    variance: Array


class ChannelUnits(NamedTuple):
    """Units in which each channel, outputs first, has mean 0 and deviation 1; a constant one keeps its unit."""

    center: Array  # (k,)
    scale: Array  # (k,)

    @classmethod
    def of(cls, record: Record) -> ChannelUnits:
        """Returns those of the training data."""
        inputs, outputs = record.spread
        spread = Spread(*(np.concatenate(pair) for pair in zip(outputs, inputs, strict=True)))
        return cls(spread.mean, np.where(spread.moving, np.sqrt(spread.variance), 1.0))

    def scaled(self, channels: Array) -> Array:
        """Returns channels (…, k) in these units; or the first columns of them, as those of the outputs alone."""
        width = channels.shape[-1]
        return np.asarray((channels - self.center[:width]) / self.scale[:width])

    def scaled_inputs(self, inputs: Array) -> Array:
        """Returns inputs (…, r), the last channels, in these units."""
        start = len(self.center) - inputs.shape[-1]
        return np.asarray((inputs - self.center[start:]) / self.scale[start:])

    def segments(self, record: Record) -> list[Array]:
        """Returns the channels (T, k) of each segment of ``record``, in these units."""
        return [self.scaled(np.hstack([outputs, inputs])) for inputs, outputs in record.segments]


def lagged(table: Array, lags: int) -> Array:
    """Returns (…, T − lags, lags · k): the rows before each of (…, T, k) that has so many, the latest first."""
    count = max(0, table.shape[-2] - lags)
    return np.concatenate([table[..., lags - lag : lags - lag + count, :] for lag in range(1, lags + 1)], axis=-1)


def initial_lags(channels: Array, lags: int) -> Array:
    """Returns the last ``lags`` samples of ``channels`` (T, k); the first counts for those that would be before it."""
    filled = np.zeros((lags, channels.shape[1]))
    if len(channels):
        filled[:] = channels[0]
        filled[max(0, lags - len(channels)) :] = channels[-lags:]
    return filled


class LagStatistics(NamedTuple):
    """All that the regression needs of the samples: sums over rows, which add up over segments and can be taken off.

    A row is [lag 1 … lag p, 1, sample], of q = (p + 1) k + 1 numbers.
    """

    rows: float  # number of samples with as many before them as there are lags
    gram: Array  # (q, q) Σ of each row times itself

    @classmethod
    def of(cls, segments: Iterable[Array], lags: int) -> LagStatistics:
        """Returns those of ``segments`` of channels (T, k), at least one; no row reaches across a gap between them."""
        tables = []
        for channels in segments:
            past = lagged(channels, lags)
            tables.append(np.hstack([past, np.ones((len(past), 1)), channels[lags:][: len(past)]]))
        if not tables:
            raise ValueError("segments must hold at least one segment")
        return cls(sum(map(len, tables)), np.asarray(sum(table.T @ table for table in tables)))

    def __add__(self, other: LagStatistics) -> LagStatistics:  # type: ignore[override]
        return LagStatistics(self.rows + other.rows, self.gram + other.gram)

    def __sub__(self, other: LagStatistics) -> LagStatistics:
        return LagStatistics(self.rows - other.rows, self.gram - other.gram)

    def forgotten(self, share: float) -> LagStatistics:
        """Returns what is left of them when each sample counts only this ``share``."""
        return LagStatistics(share * self.rows, share * self.gram)

    def in_own_units(self, lags: int, least: float) -> tuple[LagStatistics, ChannelUnits]:
        """Returns them in units in which channels have mean 0 and deviation 1, no scale below ``least``; and these."""
        one = len(self.gram) * lags // (lags + 1)
        center = self.gram[one, one + 1 :] / self.gram[one, one]
        variance = self.gram.diagonal()[one + 1 :] / self.gram[one, one] - center**2
        scale = np.sqrt(np.maximum(variance, least**2))
        step = np.diag(np.concatenate([np.tile(1 / scale, lags), [1.0], 1 / scale]))
        step[:one, one] = -np.tile(center / scale, lags)
        step[one + 1 :, one] = -center / scale
        return LagStatistics(self.rows, step @ self.gram @ step.T), ChannelUnits(center, scale)


class Var(NamedTuple):
    """The fitted model; samples that it takes and returns are physical.

    Given Σ, the coefficients of channels i and j have covariance Σ_ij G⁻¹.
    """

    coefficients: Array  # (lags, k, k) posterior means of A₁ … A_lags, in ``units``
    offset: Array  # (k,) likewise
    covariance: Array  # (k, k) Σ, of the innovations
    precision: Array  # (lags k + 1, lags k + 1) G of the regressors [lag 1 … lag p, 1]
    units: ChannelUnits  # of the channels, between the model and its arguments

    @classmethod
    def fit(cls, statistics: LagStatistics, lags: int, ridge: float = RIDGE, units: ChannelUnits | None = None) -> Var:
        """Regresses a sample on its ``lags``, in Bayes' way and exact given Σ: the posterior is matrix normal.

        The prior is a random walk, A₁ = 1 and nothing else, with precision ``ridge`` · i² at lag i: the "Minnesota
        prior" (R. Litterman, Journal of Business & Economic Statistics 4(1), 1986), for channels of about deviation 1.
        Σ is the squared errors, the prior's among them, over the rows that the coefficients leave (rows less their
        effective number). The ``statistics`` are of channels in ``units``, the channels' own unless given.
        ``ValueError`` for no rows, or statistics of another number of lags.
        """
        width = len(statistics.gram)
        k, left = divmod(width - 1, lags + 1)
        if left or k < 1:
            raise ValueError(f"statistics must be of {lags} lags: {width} columns are not (lags + 1) · channels + 1")
        if statistics.rows <= 0:
            raise ValueError(f"segments must have more than {lags} samples: none has so many before it")
        prior = np.append(ridge * np.repeat(np.arange(1.0, lags + 1) ** LAG_POWER, k), CONSTANT_RIDGE)
        before = np.eye(lags * k + 1, k)
        precision = statistics.gram[:-k, :-k] + np.diag(prior)
        # Moments of the error of a random walk: small numbers, where the samples themselves are large ones.
        walk = np.vstack([np.eye(width - k, width), np.hstack([-before.T, np.eye(k)])])
        gram = walk @ statistics.gram @ walk.T
        change = solve(precision, gram[:-k, -k:])
        errors = gram[-k:, -k:] - gram[-k:, :-k] @ change
        # The nearest matrix without negative eigenvalues, which rounding leaves where errors vanish.
        sizes, directions = np.linalg.eigh((errors + errors.T) / 2)
        used = width - k - float(prior @ inverse(precision).diagonal())
        freedom = max(statistics.rows - used, LEAST_FREEDOM)
        coefficients = (before + change).T
        return cls(
            np.ascontiguousarray(coefficients[:, :-1].reshape(k, lags, k).swapaxes(0, 1)),
            np.ascontiguousarray(coefficients[:, -1]),
            np.asarray((directions * np.maximum(sizes, 0.0)) @ directions.T) / freedom,
            precision,
            ChannelUnits(np.zeros(k), np.ones(k)) if units is None else units,
        )

    @classmethod
    def learn(cls, record: Record, lags: int, ridge: float = RIDGE) -> Var:
        """Learns from training data; ``ValueError`` where no segment has more than ``lags`` samples."""
        units = ChannelUnits.of(record)
        return cls.fit(LagStatistics.of(units.segments(record), lags), lags, ridge, units)

    @property
    def lags(self) -> int:
        """Number of samples before each that it depends on."""
        return len(self.coefficients)

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

    def past(self, record: Record) -> Array:
        """Returns (lags, k), the last samples of a record."""
        inputs, outputs = record.segments[-1]
        return initial_lags(np.hstack([outputs, inputs]), self.lags)

    def pasts(self, past: Array, steps: int, inputs: Array, outputs: Array) -> Array:
        """Returns (S, lags, k), the samples before every ``steps``-th of those that follow a ``past``."""
        channels = np.concatenate([past[len(past) - self.lags :], np.hstack([outputs, inputs])])
        return np.asarray(channels[np.arange(0, len(inputs), steps)[:, None] + np.arange(self.lags)])

    def predict(self, past: Array, steps: int) -> Forecast:
        """Returns all channels (…, steps, k) after ``past`` (…, lags, k), outputs first, the inputs unknown.

        The ``past`` ends with the latest sample; leading axes are separate pasts. Where a mean overflows it is the mean
        of the training data, with infinite variance.
        """
        k, across = len(self.offset), self.across
        # Rows of Ψ, the response of a sample to each innovation before it.
        response = np.eye(self.lags * k, k)
        variance = np.empty((steps, k))
        with np.errstate(over="ignore", invalid="ignore"):
            for step in range(steps):
                variance[step] = np.einsum("ij,jl,il->i", response[:k], self.covariance, response[:k])
                response = np.concatenate([across @ response, response[:-k]])
            return self._physical(self._predicted(past, steps), variance.cumsum(axis=0))

    def predicted(self, past: Array, steps: int) -> Array:
        """Returns the mean of :meth:`predict`."""
        return self._physical(self._predicted(past, steps), np.zeros(1)).mean

    def _predicted(self, past: Array, steps: int) -> Array:
        k, lags, across = len(self.offset), self.lags, self.across.T.copy()
        # All samples in one array, the latest first, so that the lags of each step are a slice of it.
        samples = np.empty((*past.shape[:-2], (steps + lags) * k))
        samples[..., steps * k :] = _latest_first(self.units.scaled(past))
        with np.errstate(over="ignore", invalid="ignore"):
            for start in range((steps - 1) * k, -1, -k):
                lagged_samples = samples[..., start + k : start + (lags + 1) * k]
                samples[..., start : start + k] = lagged_samples @ across + self.offset
        return samples[..., : steps * k].reshape(*past.shape[:-2], steps, k)[..., ::-1, :]

    def ahead(self, horizons: tuple[int, ...], outputs: int) -> tuple[Array, Array]:
        """Returns maps (H, m, lags k) of the lags, the latest first, and constants (H, m), to the first ``outputs``.

        They are of samples in the model's units, and predict so many samples ahead.
        """
        across, k, width = self.across, len(self.offset), self.lags * len(self.offset)
        # Rows of a later sample above those of the samples before it, of columns [lag 1 … lag p, 1].
        later, rows = np.eye(width, width + 1), {}
        with np.errstate(over="ignore", invalid="ignore"):
            for horizon in range(1, horizons[-1] + 1):
                first = across @ later
                first[:, -1] += self.offset
                later = np.concatenate([first, later[:-k]])
                rows[horizon] = first[:outputs]
        maps = np.array([rows[horizon] for horizon in horizons])
        return np.ascontiguousarray(maps[:, :, :-1]), maps[:, :, -1]

    def infer(self, past: Array, inputs: Array, smooth: bool = False) -> Forecast:
        """Returns the outputs (…, H, m) after ``past`` (…, lags, k), each given ``inputs`` (…, H, r) up to its sample.

        With ``smooth`` all inputs count. Overflow is as in :meth:`predict`.
        """
        (lags, k, _), r, steps = self.coefficients.shape, inputs.shape[-1], inputs.shape[-2]
        m, n = k - r, (k - r) * lags
        # The state is the outputs of all lags; what the inputs of the lags add is known.
        across = self.coefficients.swapaxes(0, 1)
        output_effect, A = across[:, :, :m].reshape(k, n), np.eye(n, k=-m)
        A[:m] = output_effect[:m]
        Q, S, R = np.zeros((n, n)), np.zeros((n, r)), self.covariance[m:, m:] + INPUT_NOISE * np.eye(r)
        Q[:m, :m], S[:m] = self.covariance[:m, :m], self.covariance[:m, m:]
        filtered = KalmanFilter.of(A, output_effect[m:], Q, R, S, np.zeros((n, n)), steps)
        before, now = self.units.scaled(past), self.units.scaled_inputs(inputs)
        earlier = lagged(np.concatenate([before[..., m:], now], axis=-2), lags)
        drives = earlier @ across[:, :, m:].reshape(k, lags * r).T + self.offset
        pushes = np.zeros((*drives.shape[:-1], n))
        pushes[..., :m] = drives[..., :m]
        states, errors = filtered.states(_latest_first(before[..., :m]), pushes, now - drives[..., m:])
        covariances = filtered.covariances_of(steps)
        if smooth:
            states, covariances, _ = filtered.smoothed(states, errors)
        variance = np.maximum(np.diagonal(covariances, axis1=1, axis2=2), 0.0)
        return self._physical(states[..., 1:, :m], variance[1:, :m])

    def infer_every(self, past: Array, steps: int, inputs: Array, outputs: Array, smooth: bool = False) -> Forecast:
        """Returns (H, m) as :meth:`infer`, begun again at every ``steps``-th sample from all samples before it."""
        length, m = len(inputs), outputs.shape[1]
        steps = max(1, min(steps, length))
        pasts = self.pasts(past, steps, inputs, outputs)
        found = self.infer(pasts, inputs[_pieces(len(pasts), steps, length)], smooth)
        return Forecast(*(table.reshape(-1, m)[:length] for table in found))

    def predict_every(self, past: Array, steps: int, inputs: Array, outputs: Array) -> Array:
        """Returns (H, m): the samples that follow, by a new prediction from every ``steps``-th on."""
        length, m = len(inputs), outputs.shape[1]
        mean = self.predicted(self.pasts(past, steps, inputs, outputs), max(1, min(steps, length)))
        return np.asarray(mean[..., :m].reshape(-1, m)[:length])

    def one_step(self, record: Record) -> Array:
        """Returns (T, m): each sample of ``record`` from those before it in its segment and the inputs up to it."""
        answers = []
        for inputs, outputs in record.segments:
            channels = np.hstack([outputs, inputs])
            begins = (channels[max(0, t - self.lags) : t] for t in range(len(outputs)))
            pasts = np.array([initial_lags(past, self.lags) for past in begins])
            pasts[0] = self.units.center
            answers.append(self.infer(pasts, inputs[:, None]).mean[:, 0])
        return np.concatenate(answers)

    def leverage(self, past: Array, steps: int, inputs: Array, outputs: Array, forecast: Array) -> Array:
        """Returns (H,) how far each sample's regressors are from the training data's, whose mean square is 1.

        Mahalanobis distances by the posterior's precision, in proportion to which the parameters' uncertainty grows.
        ``forecast`` (H, m) begins at every ``steps``-th sample of ``inputs`` (H, r) and ``outputs`` (H, m).
        """
        length, pasts = len(inputs), self.pasts(past, steps, inputs, outputs)
        rows = _pieces(len(pasts), steps, length)
        channels = np.concatenate([pasts, np.hstack([forecast, inputs])[rows]], axis=1)
        with np.errstate(over="ignore", invalid="ignore"):
            regressors = np.concatenate([lagged(self.units.scaled(channels), self.lags), np.ones((*rows.shape, 1))], 2)
            distance = np.sum(regressors @ inverse(self.precision) * regressors, axis=2)
        # The offset's precision is the number of rows; x' G⁻¹ x has mean q / rows over them.
        return np.asarray(distance.reshape(-1)[:length] * self.precision[-1, -1] / len(self.precision))

    def _physical(self, mean: Array, variance: Array) -> Forecast:
        center, scale = (values[: mean.shape[-1]] for values in self.units)
        finite = np.isfinite(mean)
        known = finite & np.isfinite(variance)
        mean = center + scale * np.where(finite, mean, 0.0)
        return Forecast(mean, scale**2 * np.where(known, np.broadcast_to(variance, mean.shape), np.inf))


def _pieces(number: int, steps: int, length: int) -> np.typing.NDArray[np.intp]:
    """(S, steps) rows of each piece of ``length`` samples; the last one stays at the end."""
    return np.minimum(np.arange(number * steps), length - 1).reshape(-1, steps)


def _latest_first(past: Array) -> Array:
    """(…, lags · k) of (…, lags, k)."""
    return past[..., ::-1, :].reshape(*past.shape[:-2], past.shape[-2] * past.shape[-1])
