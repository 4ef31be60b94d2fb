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
from scipy.linalg.lapack import dtrtri

from mavdem.arrays import Array, ArrayPair, Indices
from mavdem.dem.engine.kalman import KalmanFilter
from mavdem.dem.engine.linalg import ROUNDING_TOLERANCE, may_overflow
from mavdem.dem.record import ChannelStatistics, Record
from mavdem.errors import NotLearnable
from mavdem.facts.model import ModelRefusal

RIDGE = 0.01
"""Precision of the prior of the first lag's coefficients, of channels of deviation 1 and innovations of covariance Σ.
As a precision it does not grow with the number of samples."""

CONSTANT_RIDGE = 1e-8  # likewise of the offset, which the prior leaves open
# rows that are left for the innovations, where there are hardly more than coefficients
LEAST_FREEDOM = 1.0


class Forecast(NamedTuple):
    """Outputs that were forecast and the squared error to expect of them, (…, H, m) each."""

    mean: Array
    variance: Array


class ChannelScaling(NamedTuple):
    """Units in which each channel, outputs first, has mean 0 and deviation 1; a constant one keeps its unit."""

    center: Array  # (k,)
    scale: Array  # (k,)

    @classmethod
    def from_record(cls, record: Record) -> ChannelScaling:
        """Returns those of the training data."""
        inputs, outputs = record.channel_statistics
        spread = ChannelStatistics(
            *(np.concatenate(pair) for pair in zip(outputs, inputs, strict=True))
        )
        return cls(spread.mean, np.where(spread.varying, np.sqrt(spread.variance), 1.0))

    def scaled(self, channels: Array) -> Array:
        """Returns channels (…, k) in these units; or the first columns of them, as those of the outputs alone."""
        width = channels.shape[-1]
        return (channels - self.center[:width]) / self.scale[:width]

    def segments(self, record: Record) -> list[Array]:
        """Returns the channels (T, k) of each segment of ``record``, in these units."""
        return [self.scaled(np.hstack([outputs, inputs])) for inputs, outputs in record.segments]


def lagged(table: Array, lags: int) -> Array:
    """Returns (…, T − lags, lags · k): the rows before each of (…, T, k) that has so many, the latest first."""
    count = max(0, table.shape[-2] - lags)
    return np.concatenate(
        [table[..., lags - lag : lags - lag + count, :] for lag in range(1, lags + 1)], axis=-1
    )


def initial_lags(channels: Array, lags: int) -> Array:
    """Returns the last ``lags`` of ``channels`` (T, k), one at least; the first counts for any before."""
    rows = np.arange(len(channels) - lags, len(channels))
    return channels[np.maximum(rows, 0)]


class LagStatistics(NamedTuple):
    """All that the regression needs of the samples: sums over rows, which add up over segments.

    A row is [lag 1 … lag p, 1, sample], of q = (p + 1) k + 1 numbers.
    """

    rows: float  # number of samples with as many before them as there are lags
    gram: Array  # (q, q) Σ of each row times itself

    @classmethod
    def from_segments(cls, segments: Iterable[Array], lags: int) -> LagStatistics:
        """Returns those of ``segments`` of channels (T, k), at least one; no row reaches across a gap between them."""
        tables = []
        for channels in segments:
            past = lagged(channels, lags)
            tables.append(np.hstack([past, np.ones((len(past), 1)), channels[lags:][: len(past)]]))
        return cls(sum(map(len, tables)), np.asarray(sum(table.T @ table for table in tables)))

    @classmethod
    def from_record(cls, record: Record, lags: int) -> tuple[ChannelScaling, LagStatistics]:
        """Returns the units of a record's channels, and the statistics in these; ``NotLearnable`` without a row."""
        units = ChannelScaling.from_record(record)
        statistics = cls.from_segments(units.segments(record), lags)
        if statistics.rows <= 0:
            raise NotLearnable(
                ModelRefusal.SEGMENTS_TOO_SHORT_FOR_LAGS,
                samples=lags,
                longest=record.longest_segment,
            )
        return units, statistics

    def after(self, earlier: LagStatistics, share: float) -> LagStatistics:
        """Returns these with ``earlier`` ones, of which each sample counts only this ``share``."""
        return LagStatistics(self.rows + share * earlier.rows, self.gram + share * earlier.gram)

    def shortened(self, lags: int, fewer: int) -> Array:
        """Returns the ``gram`` of rows with ``fewer`` lags than these ``lags``."""
        width = len(self.gram) * lags // (lags + 1)
        k = len(self.gram) - width - 1
        places = np.r_[: fewer * k, width : len(self.gram)]
        return self.gram[np.ix_(places, places)]


class Regression(NamedTuple):
    """The posterior of the coefficients (q, k) of k channels on [lag 1 … lag p, 1]: matrix normal, exact given Σ."""

    mean: Array  # (q, k)
    root: Array  # (q, q) Rᵀ R is the inverse of the posterior precision
    covariance: Array  # (k, k) Σ of the innovations, over the rows that the coefficients leave
    terms: dict[str, float]  # of F̄, nats

    @property
    def free_energy(self) -> float:
        """F̄, nats: with the posterior exact, the logarithm of the evidence, but for that of Σ."""
        return sum(self.terms.values())


def lag_prior(lags: int, ridge: float) -> Array:
    """Returns (lags, lags), the prior precision of each lag's coefficient: ``ridge`` · i² at lag i."""
    return np.diag(ridge * np.arange(1.0, lags + 1) ** 2)


def regress(
    gram: Array,
    rows: float,
    prior: Array,
    least: float = ROUNDING_TOLERANCE,
) -> Regression:
    """Regresses samples of k channels on their lags.

    The prior is a random walk, A₁ = 1 and nothing else, with covariance Σ ⊗ ``prior``⁻¹ of the deviations from it, the
    same for every channel: for a diagonal precision (lags, lags) that grows with the lag the "Minnesota prior" (R.
    Litterman, Journal of Business & Economic Statistics 4(1), 1986). Channels have about deviation 1. Σ is the squared
    errors, the prior's among them, over the rows less the effective number of coefficients.

    Args:
        gram: Σ row rowᵀ over ``rows`` rows [lag 1 … lag p, 1, sample], of (p + 1) k + 1 numbers.
        rows: how many there were, more than 0.
        prior: (lags, lags) precision of a channel's coefficients by lag.
        least: variance of the innovations that F̄ adds to those found.
    """
    lags = len(prior)
    k = (len(gram) - 1) // (lags + 1)
    q = lags * k + 1
    precision = np.zeros((q, q))
    precision[:-1, :-1] = np.kron(prior, np.eye(k))
    precision[-1, -1] = CONSTANT_RIDGE
    before = np.eye(q, k)
    factor = np.linalg.cholesky(gram[:q, :q] + precision)
    root, _ = dtrtri(factor, lower=True)
    # Moments of the error of a random walk: small numbers, where the samples themselves are large ones.
    errors = gram.copy()
    errors[q:] -= errors[:k]
    errors[:, q:] -= errors[:, :k]
    explained = root @ errors[:q, q:]
    change = root.T @ explained
    left = errors[q:, q:] - explained.T @ explained
    # The nearest matrix without negative eigenvalues, which rounding leaves where errors vanish.
    sizes, directions = np.linalg.eigh((left + left.T) / 2)
    left = (directions * np.maximum(sizes, 0.0)) @ directions.T
    used = q - np.sum(precision * (root.T @ root))
    noise = left / rows + least * np.eye(k)
    weight = np.linalg.inv(noise)
    of_prior = np.sum(weight * (change.T @ precision @ change))
    determined = (
        2 * (np.log(factor.diagonal()).sum())
        - k * np.linalg.slogdet(prior)[1]
        - np.log(CONSTANT_RIDGE)
    )
    terms = {
        "prediction errors": -0.5 * (np.sum(weight * left) - of_prior),
        "noise entropy": -0.5 * rows * np.linalg.slogdet(2 * np.pi * noise)[1],
        "parameter errors": -0.5 * of_prior,
        "parameter entropy": -0.5 * k * determined,
    }
    return Regression(before + change, root, left / max(rows - used, LEAST_FREEDOM), terms)


class VectorAutoregression(NamedTuple):
    """The process with its parameters; samples that it takes and returns are physical."""

    coefficients: Array  # (lags, k, k) posterior means of A₁ … A_lags, in ``units``
    offset: Array  # (k,) likewise
    covariance: Array  # (k, k) Σ, of the innovations
    units: ChannelScaling  # of the channels, between the model and its arguments

    @classmethod
    def from_regression(cls, regression: Regression, units: ChannelScaling) -> VectorAutoregression:
        """Returns that of the posterior means of a regression."""
        (q, k) = regression.mean.shape
        coefficients = regression.mean.T
        lags = (q - 1) // k
        return cls(
            np.ascontiguousarray(coefficients[:, :-1].reshape(k, lags, k).swapaxes(0, 1)),
            np.ascontiguousarray(coefficients[:, -1]),
            regression.covariance,
            units,
        )

    @classmethod
    def learn(cls, record: Record, lags: int) -> VectorAutoregression:
        """Learns from training data; ``ValueError`` where no segment has more than ``lags`` samples."""
        units, statistics = LagStatistics.from_record(record, lags)
        return cls.from_regression(
            regress(statistics.gram, statistics.rows, lag_prior(lags, RIDGE)), units
        )

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
        return float(abs(np.linalg.eigvals(companion)).max())

    def past(self, record: Record) -> Array:
        """Returns (lags, k), the last samples of a record."""
        inputs, outputs = record.segments[-1]
        return initial_lags(np.hstack([outputs, inputs]), self.lags)

    def pasts(
        self,
        past: Array,
        steps: int,
        inputs: Array,
        outputs: Array,
    ) -> Array:
        """Returns (S, lags, k), the samples before every ``steps``-th of those that follow a ``past``."""
        channels = np.concatenate([past[len(past) - self.lags :], np.hstack([outputs, inputs])])
        return channels[np.arange(0, len(inputs), steps)[:, None] + np.arange(self.lags)]

    @may_overflow
    def predict(self, past: Array, steps: int) -> Forecast:
        """Returns all channels (…, steps, k) after ``past`` (…, lags, k), outputs first, the inputs unknown.

        The ``past`` ends with the latest sample; leading axes are separate pasts. Where a mean overflows it is the mean
        of the training data, with infinite variance.
        """
        maps, constants = self.ahead(steps)
        k = len(self.offset)
        latest = latest_first(self.units.scaled(past))
        mean = np.einsum("...i,hki->...hk", latest, maps, optimize=True) + constants
        # An innovation changes later samples as its own sample does.
        responses = np.concatenate([np.eye(k)[None], maps[:-1, :, :k]])
        each = np.einsum("hij,jl,hil->hi", responses, self.covariance, responses)
        return self._physical(mean, each.cumsum(axis=0))

    @may_overflow
    def ahead(self, steps: int) -> ArrayPair:
        """Returns maps (steps, k, lags k) of the lags, the latest first, and constants (steps, k), to the next samples.

        They are of samples in the model's units.
        """
        across = self.across
        k, width = across.shape
        # Rows of a later sample above those of the samples before it, of columns [lag 1 … lag p, 1].
        later = np.eye(width, width + 1)
        rows = []
        for _ in range(steps):
            first = across @ later
            first[:, -1] += self.offset
            later = np.concatenate([first, later[:-k]])
            rows.append(first)
        maps = np.array(rows)
        return np.ascontiguousarray(maps[:, :, :-1]), maps[:, :, -1]

    def latest(self, m: int) -> ArrayPair:
        """Returns a map (m, (lags + 1) k) of a sample and its lags, and a constant (m,), to its m outputs.

        They tell them from the sample's inputs, whose innovations they share, and from all before it; in ``units``.
        """
        noise = self.covariance[m:, m:] + ROUNDING_TOLERANCE * np.eye(len(self.covariance) - m)
        gain = np.linalg.solve(noise, self.covariance[m:, :m]).T
        across = self.across
        weights = np.hstack([np.zeros((m, m)), gain, across[:m] - gain @ across[m:]])
        return weights, self.offset[:m] - gain @ self.offset[m:]

    def filter(self, m: int, steps: int) -> KalmanFilter:
        """Returns the filter of the m outputs of all lags, with the inputs measured; what those add to it is known."""
        lags, k, _ = self.coefficients.shape
        n = m * lags
        r = k - m
        output_effect = self.coefficients.swapaxes(0, 1)[:, :, :m].reshape(k, n)
        A = np.eye(n, k=-m)
        A[:m] = output_effect[:m]
        Q = np.zeros((n, n))
        S = np.zeros((n, r))
        R = self.covariance[m:, m:] + ROUNDING_TOLERANCE * np.eye(r)
        Q[:m, :m] = self.covariance[:m, :m]
        S[:m] = self.covariance[:m, m:]
        return KalmanFilter.design(A, output_effect[m:], Q, R, S, np.zeros((n, n)), steps)

    def infer(self, past: Array, inputs: Array, smooth: bool = False) -> Forecast:
        """Returns the outputs (…, H, m) after ``past`` (…, lags, k), each given ``inputs`` (…, H, r) up to its sample.

        With ``smooth`` all inputs count. Overflow is as in :meth:`predict`.
        """
        (lags, k, _) = self.coefficients.shape
        steps, r = inputs.shape[-2:]
        m = k - r
        filtered = self.filter(m, steps)
        across = self.coefficients.swapaxes(0, 1)
        before = self.units.scaled(past)
        now = (inputs - self.units.center[m:]) / self.units.scale[m:]
        earlier = lagged(np.concatenate([before[..., m:], now], axis=-2), lags)
        drives = earlier @ across[:, :, m:].reshape(k, lags * r).T + self.offset
        pushes = np.zeros((*drives.shape[:-1], m * lags))
        pushes[..., :m] = drives[..., :m]
        states, errors = filtered.filter(
            latest_first(before[..., :m]), pushes, now - drives[..., m:]
        )
        covariances = filtered.predicted_covariances(steps)
        if smooth:
            states, covariances, _ = filtered.smooth(states, errors)
        variance = np.maximum(np.diagonal(covariances, axis1=1, axis2=2), 0.0)
        return self._physical(states[..., 1:, :m], variance[1:, :m])

    def infer_every(
        self,
        past: Array,
        steps: int,
        inputs: Array,
        outputs: Array,
        smooth: bool = False,
    ) -> Forecast:
        """Returns (H, m) as :meth:`infer`, begun again at every ``steps``-th sample from all samples before it."""
        length = len(inputs)
        m = outputs.shape[1]
        steps = max(1, min(steps, length))
        pasts = self.pasts(past, steps, inputs, outputs)
        states = self.infer(pasts, inputs[pieces(len(pasts), steps, length)], smooth)
        return Forecast(*(table.reshape(-1, m)[:length] for table in states))

    def predict_every(
        self,
        past: Array,
        steps: int,
        inputs: Array,
        outputs: Array,
    ) -> Forecast:
        """Returns (H, m) as :meth:`predict`, begun again at every ``steps``-th sample from all samples before it."""
        length, m = outputs.shape
        steps = max(1, min(steps, length))
        predicted = self.predict(self.pasts(past, steps, inputs, outputs), steps)
        return Forecast(*(table[..., :m].reshape(-1, m)[:length] for table in predicted))

    def one_step(self, record: Record) -> Array:
        """Returns (T, m): each sample of ``record`` from those before it in its segment and the inputs up to it."""
        m = record.outputs.shape[1]
        weights, constant = self.latest(m)
        answers = []
        for channels in self.units.segments(record):
            # Of the first sample's past nothing is known; it counts for what would be before the others'.
            before = np.concatenate([np.repeat(channels[:1], self.lags, axis=0), channels])
            past = lagged(before, self.lags)
            past[0] = 0.0
            answers.append(np.hstack([channels, past]) @ weights.T + constant)
        return self._physical(np.concatenate(answers), np.zeros(1)).mean

    def _physical(self, mean: Array, variance: Array) -> Forecast:
        center, scale = (values[: mean.shape[-1]] for values in self.units)
        finite = np.isfinite(mean)
        determined = finite & np.isfinite(variance)
        mean = center + scale * np.where(finite, mean, 0.0)
        return Forecast(
            mean, scale**2 * np.where(determined, np.broadcast_to(variance, mean.shape), np.inf)
        )


def pieces(number: int, steps: int, length: int) -> Indices:
    """Returns (S, steps), the rows of each piece of ``length`` samples; the last one stays at the end."""
    return np.minimum(np.arange(number * steps), length - 1).reshape(-1, steps)


def latest_first(past: Array) -> Array:
    """Returns (…, lags · k) of a ``past`` (…, lags, k)."""
    return past[..., ::-1, :].reshape(*past.shape[:-2], past.shape[-2] * past.shape[-1])
