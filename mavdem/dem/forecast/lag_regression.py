"""Bayesian regression on lagged samples: the statistics, prior and posterior of a vector autoregression."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import scipy

from mavdem.arrays import Array
from mavdem.dem.engine.linalg import ROUNDING_TOLERANCE
from mavdem.dem.record import Record
from mavdem.errors import NotLearnable
from mavdem.facts.model import ModelRefusal

RIDGE = 0.01
"""Prior precision of the coefficients of the first lag, of channels of variance 1, in units of Σ⁻¹.

A choice, tried on simulated and real flights. Since it is a precision, its weight against the data falls with the
number of samples.
"""

CONSTANT_RIDGE = 1e-8
"""Prior precision of the offset, which the prior leaves practically free, in units of Σ⁻¹."""

MIN_RESIDUAL_FREEDOM = 1.0
"""Fewest degrees of freedom with which Σ is estimated, if there are hardly more samples than coefficients."""


class ChannelScaling(NamedTuple):
    """Scaling of each channel, outputs first, to mean 0 and variance 1; a constant channel is only centred."""

    center: Array
    """Means of the k channels (k,), in physical units."""

    scale: Array
    """Standard deviations of the k channels (k,), in physical units; 1 for a constant channel."""

    @classmethod
    def from_record(cls, record: Record) -> ChannelScaling:
        """Returns the scaling of the outputs and inputs of a record, by their means and standard deviations.

        Args:
            record: training data, in physical units.
        """
        inputs, outputs = record.channel_statistics
        mean = np.concatenate([outputs.mean, inputs.mean])
        variance = np.concatenate([outputs.variance, inputs.variance])
        is_varying = np.concatenate([outputs.varying, inputs.varying])
        # A constant channel cannot be scaled to variance 1, and keeps its unit.
        return cls(mean, np.where(is_varying, np.sqrt(variance), 1.0))

    def scaled(self, channels: Array) -> Array:
        """Scales channels from physical units to mean 0 and variance 1.

        Args:
            channels: (…, k) values of the channels, or of the first ones only, such as the outputs.

        Returns:
            (…, k) scaled values.
        """
        count = channels.shape[-1]
        return (channels - self.center[:count]) / self.scale[:count]

    def scaled_segments(self, record: Record) -> list[Array]:
        """Returns the scaled channels (T, k) of each segment of a record, outputs first."""
        return [self.scaled(np.hstack([outputs, inputs])) for inputs, outputs in record.segments]


def lagged_rows(samples: Array, lags: int) -> Array:
    """Returns the regressors of an autoregression: for each sample, the samples before it, side by side.

    Args:
        samples: (…, T, k) samples z of k channels in time order; leading axes are independent segments.
        lags: number L of samples before each.

    Returns:
        (…, T − L, L · k) rows [z_{t−1}, …, z_{t−L}], one for each sample z_t that has L samples before it; none if T <
        L.
    """
    row_count = max(0, samples.shape[-2] - lags)
    blocks = []
    for lag in range(1, lags + 1):
        # The first row is for sample number ``lags``, from 0. Its sample ``lag`` steps before is the first of a block.
        first = lags - lag
        blocks.append(samples[..., first : first + row_count, :])
    return np.concatenate(blocks, axis=-1)


def latest_samples(channels: Array, count: int) -> Array:
    """Returns the last samples of channels; if there are too few, the first one is repeated in front of them.

    Args:
        channels: samples of k channels (T, k), at least one sample.
        count: number of samples to return.

    Returns:
        (count, k) samples.
    """
    # Rows before the first sample would be negative; the first sample, row 0, takes their place.
    rows = np.arange(len(channels) - count, len(channels))
    return channels[np.maximum(rows, 0)]


class LagStatistics(NamedTuple):
    """Sufficient statistics of the regression of samples on their lags; they add up over segments.

    A row of the regression is [z_{t−1}, …, z_{t−L}, 1, z_t], of (L + 1) k + 1 numbers.
    """

    row_count: float
    """Number of samples that have L samples before them; not an integer where earlier samples are discounted."""

    gram: Array
    """Sum of the outer product of each row with itself, ((L + 1) k + 1) squared."""

    @classmethod
    def from_segments(cls, segments: Iterable[Array], lags: int) -> LagStatistics:
        """Sums up the statistics of a regression of each sample on the L samples before it, over several segments.

        A sample is regressed on earlier samples of its own segment only, since between two segments there is a gap in
        time.

        Args:
            segments: channels (T, k) of each segment, at least one segment.
            lags: number L of lags.

        Returns:
            Number and second moments of the rows [lagged samples, 1, sample] of all segments; no rows if every segment
            has at most L samples.
        """
        regression_rows = []
        for channels in segments:
            past = lagged_rows(channels, lags)
            ones = np.ones((len(past), 1))
            # For a segment with fewer than L samples, both the past and the targets are empty.
            targets = channels[lags:][: len(past)]
            regression_rows.append(np.hstack([past, ones, targets]))
        row_count = sum(len(rows) for rows in regression_rows)
        second_moments = np.asarray(sum(rows.T @ rows for rows in regression_rows))
        return cls(row_count, second_moments)

    @classmethod
    def from_record(cls, record: Record, lags: int) -> ScaledStatistics:
        """Scales the channels of a record, and sums up the statistics of their regression on the past.

        Args:
            record: training data; its channels are the outputs and then the inputs.
            lags: number L of lags.

        Returns:
            The scaling, and the statistics of the scaled channels.

        Raises:
            NotLearnable: no segment has more than ``lags`` samples.
        """
        scaling = ChannelScaling.from_record(record)
        statistics = cls.from_segments(scaling.scaled_segments(record), lags)
        if statistics.row_count <= 0:
            raise NotLearnable(
                ModelRefusal.SEGMENTS_TOO_SHORT_FOR_LAGS,
                samples=lags,
                longest=record.longest_segment,
            )
        return ScaledStatistics(scaling, statistics)

    def plus_discounted(self, earlier_statistics: LagStatistics, weight: float) -> LagStatistics:
        """Returns the sum of these statistics and the statistics of earlier samples, multiplied by a weight.

        Args:
            earlier_statistics: statistics of the earlier samples.
            weight: weight of an earlier sample, 0 to 1.

        Returns:
            Statistics of all samples.
        """
        return LagStatistics(
            self.row_count + weight * earlier_statistics.row_count,
            self.gram + weight * earlier_statistics.gram,
        )

    def gram_of_fewer_lags(self, lags: int, kept_lags: int) -> Array:
        """Returns the Gram matrix of the same regression with fewer lags, by leaving out columns.

        The rows are the same, so that free energies with different numbers of lags are of the same data.

        Args:
            lags: number of lags L of these statistics.
            kept_lags: number of lags to keep, the latest ones, at most L.

        Returns:
            Gram matrix, square, of kept_lags · k + 1 + k columns: the k channels of each kept lag, the constant, and
            the k channels of the sample.
        """
        # The columns are the k channels of each lag, the latest lag first, the constant, and the k channels of the
        # sample: (lags + 1) k + 1 in all.
        column_count = len(self.gram)
        k = (column_count - 1) // (lags + 1)
        columns_of_kept_lags = np.arange(kept_lags * k)
        constant_column = lags * k
        constant_and_sample = np.arange(constant_column, column_count)
        columns = np.concatenate([columns_of_kept_lags, constant_and_sample])
        return self.gram[np.ix_(columns, columns)]


class ScaledStatistics(NamedTuple):
    """Statistics of scaled channels, with their scaling."""

    scaling: ChannelScaling
    """The scaling."""

    statistics: LagStatistics
    """The statistics of the scaled channels."""


class Regression(NamedTuple):
    """Posterior of the coefficients of k channels on [z_{t−1}, …, z_{t−L}, 1]: matrix normal, exact given Σ."""

    mean: Array
    """(q, k) posterior mean, q = L k + 1."""

    covariance_root: Array
    """(q, q) R with RᵀR the posterior covariance of one channel's coefficients, in units of its innovation variance."""

    innovation_covariance: Array
    """(k, k) estimate of Σ."""

    terms: dict[str, float]
    """Terms of the free energy by name, nats."""

    @property
    def free_energy(self) -> float:
        """F̄, nats: since the posterior is exact given Σ, the log evidence at the estimate of Σ."""
        return sum(self.terms.values())


def lag_prior_precision(lags: int, ridge: float) -> Array:
    """Returns the prior precision of the coefficients of a channel, which increases with the square of the lag.

    So coefficients of longer lags are shrunk more towards 0 (the Minnesota prior).

    Args:
        lags: number L of lags.
        ridge: precision at lag 1, for channels of variance 1 and so without a unit.

    Returns:
        Diagonal matrix (L, L) with ridge · i² at lag i.
    """
    return np.diag(ridge * np.arange(1.0, lags + 1) ** 2)


def regress(
    gram: Array,
    row_count: float,
    prior_precision: Array,
    noise_floor: float = ROUNDING_TOLERANCE,
) -> Regression:
    """Regresses samples of k channels on their lags, with a Gaussian prior, and computes the evidence.

    The prior mean is a random walk: A₁ = I, and all other coefficients are 0. Deviations from it have the covariance
    Σ ⊗ P⁻¹, with the same P for every channel. With a diagonal precision P that grows with the lag this is the
    "Minnesota prior" (R. Litterman, "Forecasting with Bayesian vector autoregressions", Journal of Business & Economic
    Statistics 4(1), 1986). The estimate of Σ is the sum of the squared errors, including the prior's, divided by
    the number of rows minus the effective number of coefficients.

    Args:
        gram: sum of the outer products of the rows [z_{t−1}, …, z_{t−L}, 1, z_t], (L k + 1 + k, L k + 1 + k), of
            channels with a variance of about 1.
        row_count: number of rows, more than 0.
        prior_precision: (L, L) prior precision P of a channel's coefficients by lag.
        noise_floor: variance that is added to the variances of the innovations in the free energy. Without it, a
            channel that is determined exactly by others would dominate the free energy.

    Returns:
        The posterior of the coefficients, and the terms of F̄.
    """
    lags = len(prior_precision)
    k = (len(gram) - 1) // (lags + 1)
    q = lags * k + 1
    precision = np.zeros((q, q))
    precision[:-1, :-1] = np.kron(prior_precision, np.eye(k))
    precision[-1, -1] = CONSTANT_RIDGE
    random_walk = np.eye(q, k)
    # With the Cholesky factor F Fᵀ of the posterior precision, R = F⁻¹ has RᵀR = the posterior covariance.
    factor = np.linalg.cholesky(gram[:q, :q] + precision)
    covariance_root, _ = scipy.linalg.lapack.dtrtri(factor, lower=True)
    # The targets become the changes from sample to sample, which are small compared with the samples.
    moments = gram.copy()
    moments[q:] -= moments[:k]
    moments[:, q:] -= moments[:, :k]
    # Rows and columns up to q belong to the regressors, those from q on to the targets.
    explained = covariance_root @ moments[:q, q:]
    deviation = covariance_root.T @ explained
    squared_errors = moments[q:, q:] - explained.T @ explained
    # If errors vanish, rounding makes eigenvalues negative.
    squared_errors = _nearest_positive_semidefinite(squared_errors)
    # The trace of prior precision times posterior covariance is the number of coefficients that the prior determines
    # and not the data.
    effective_coefficients = q - np.sum(precision * (covariance_root.T @ covariance_root))

    noise = squared_errors / row_count + noise_floor * np.eye(k)
    noise_precision = np.linalg.inv(noise)
    squared_deviation = np.sum(noise_precision * (deviation.T @ precision @ deviation))
    # This is ln|posterior precision| − ln|prior precision| of the coefficients of one channel.
    log_precision_ratio = (
        2 * np.log(factor.diagonal()).sum()
        - k * np.linalg.slogdet(prior_precision)[1]
        - np.log(CONSTANT_RIDGE)
    )
    terms = {
        "prediction errors": -0.5 * (np.sum(noise_precision * squared_errors) - squared_deviation),
        "noise entropy": -0.5 * row_count * np.linalg.slogdet(2 * np.pi * noise)[1],
        "parameter errors": -0.5 * squared_deviation,
        "parameter entropy": -0.5 * k * log_precision_ratio,
    }
    degrees_of_freedom = max(row_count - effective_coefficients, MIN_RESIDUAL_FREEDOM)
    return Regression(
        mean=random_walk + deviation,
        covariance_root=covariance_root,
        innovation_covariance=squared_errors / degrees_of_freedom,
        terms=terms,
    )


def _nearest_positive_semidefinite(matrix: Array) -> Array:
    """Returns the positive semidefinite matrix that is nearest to a square matrix, by the Frobenius norm.

    Negative eigenvalues of the symmetric part are set to 0 (N. Higham, "Computing a nearest symmetric positive
    semidefinite matrix", Linear Algebra and its Applications 103, 1988).
    """
    eigenvalues, eigenvectors = np.linalg.eigh((matrix + matrix.T) / 2)
    return np.asarray((eigenvectors * np.maximum(eigenvalues, 0.0)) @ eigenvectors.T)
