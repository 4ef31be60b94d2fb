"""A vector autoregression z_t = Σᵢ Aᵢ z_{t−i} + offset + e_t of outputs and inputs, with exact forecasts.

In closed loop the motors follow from the motion. So outputs and inputs are one process z = [outputs, inputs] of
k = m + r channels,

    z_t = Σᵢ Aᵢ z_{t−i} + offset + e_t,    e_t ~ N(0, Σ),    i = 1 … L lags,

and the outputs after a known past can be forecast with the inputs unknown, known up to each sample, or all known. Given
the parameters these forecasts are Gaussian and exact. Known inputs are measurements without noise, so that the only
uncertain quantities are the outputs since the past ended: the state of a Kalman filter whose process and measurement
noises are correlated.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array, Indices
from mavdem.dem.engine.kalman import KalmanFilter
from mavdem.dem.engine.linalg import ROUNDING_TOLERANCE, may_overflow
from mavdem.dem.forecast.lag_regression import (
    RIDGE,
    ChannelScaling,
    LagStatistics,
    Regression,
    lag_prior_precision,
    lagged_rows,
    latest_samples,
    regress,
)
from mavdem.dem.record import Record


class Forecast(NamedTuple):
    """Forecast outputs with their uncertainty."""

    mean: Array
    """Expected outputs (…, H, m) at H samples."""

    variance: Array
    """Expected squared errors of the mean (…, H, m)."""


class AffineMap(NamedTuple):
    """A linear function of samples, with a constant: constant + weights @ samples."""

    weights: Array
    """(…, k, w) factors of the w numbers of the samples."""

    constant: Array
    """(…, k) constant."""


class VectorAutoregression(NamedTuple):
    """The vector autoregression z_t = Σᵢ Aᵢ z_{t−i} + offset + e_t of k channels z: m outputs, then r inputs; L lags.

    Its methods take and return samples in physical units.
    """

    coefficients: Array
    """(L, k, k) A₁ … A_L, of scaled channels."""

    offset: Array
    """(k,) constant of each step, of scaled channels."""

    innovation_covariance: Array
    """(k, k) covariance Σ of the innovations, of scaled channels."""

    scaling: ChannelScaling
    """Scaling of the channels."""

    @classmethod
    def from_regression(
        cls, regression: Regression, scaling: ChannelScaling
    ) -> VectorAutoregression:
        """Returns the autoregression with the posterior means of a regression of scaled channels.

        Args:
            regression: posterior of the coefficients, (L k + 1, k), the latest lag first, the constant last.
            scaling: means and standard deviations of the channels.

        Returns:
            The autoregression in scaled channels, with the innovation covariance of the regression.
        """
        q, k = regression.mean.shape
        # Each row contains the coefficients of one channel: its rows of A₁ … A_L side by side, and its offset last.
        coefficients = regression.mean.T
        lags = (q - 1) // k
        return cls(
            np.ascontiguousarray(coefficients[:, :-1].reshape(k, lags, k).swapaxes(0, 1)),
            np.ascontiguousarray(coefficients[:, -1]),
            regression.innovation_covariance,
            scaling,
        )

    @classmethod
    def learn(cls, record: Record, lags: int) -> VectorAutoregression:
        """Learns an autoregression of all outputs and inputs from training data, with the ridge :data:`RIDGE`.

        Args:
            record: the training data: T samples of r inputs and m outputs, in one or several segments.
            lags: number L of lags.

        Returns:
            The autoregression with the posterior means of its coefficients.

        Raises:
            NotLearnable: no segment has more than ``lags`` samples.
        """
        scaling, statistics = LagStatistics.from_record(record, lags)
        prior_precision = lag_prior_precision(lags, RIDGE)
        regression = regress(statistics.gram, statistics.row_count, prior_precision)
        return cls.from_regression(regression, scaling)

    @property
    def lags(self) -> int:
        """Number L of earlier samples that each sample depends on."""
        return len(self.coefficients)

    @property
    def stacked_coefficients(self) -> Array:
        """(k, L k): [A₁ … A_L] side by side, which multiply [z_{t−1}; …; z_{t−L}]."""
        lags, k, _ = self.coefficients.shape
        return self.coefficients.swapaxes(0, 1).reshape(k, lags * k)

    @property
    def spectral_radius(self) -> float:
        """Largest magnitude of the eigenvalues of the companion matrix: above 1 the autoregression is unstable."""
        k, width = self.stacked_coefficients.shape
        companion = np.eye(width, k=-k)
        companion[:k] = self.stacked_coefficients
        return float(abs(np.linalg.eigvals(companion)).max())

    def last_samples(self, record: Record) -> Array:
        """Returns the last L samples of a record, (L, k): the past of a forecast of what follows it."""
        inputs, outputs = record.segments[-1]
        return latest_samples(np.hstack([outputs, inputs]), self.lags)

    def _pasts_of_forecasts(
        self,
        past: Array,
        steps: int,
        inputs: Array,
        outputs: Array,
    ) -> Array:
        """Returns the L samples before each of S rolling forecasts, which start at every ``steps``-th sample.

        Args:
            past: at least L samples of all channels before the first forecast (T, k).
            steps: number of samples from one forecast to the next.
            inputs: inputs from the first forecast on (H, r).
            outputs: outputs from the first forecast on (H, m).

        Returns:
            Samples before each forecast (S, L, k), the latest last, in physical units.
        """
        latest_past = past[len(past) - self.lags :]
        channels = np.concatenate([latest_past, np.hstack([outputs, inputs])])
        # The L samples of the past come first, so that sample i is in row L + i, and the samples before it are in the
        # rows i to i + L − 1.
        first_samples = np.arange(0, len(inputs), steps)
        rows = first_samples[:, None] + np.arange(self.lags)
        return channels[rows]

    @may_overflow
    def forecast_unknown_inputs(self, past: Array, steps: int) -> Forecast:
        """Forecasts all channels, outputs and inputs, from the past alone.

        The process has linear forecasts, so the mean at each step is a linear map of the past. The variance grows with
        each step by the covariance of one more innovation.

        Args:
            past: (…, L, k) samples up to the forecast, the latest last; leading axes are separate forecasts.
            steps: number of samples to forecast.

        Returns:
            Means (…, steps, k) and variances (steps, k) of the channels, outputs first. A mean that overflows is
            replaced by the mean of the training data, with infinite variance.
        """
        # Step h of the forecast is the h-th map of the past, plus the h-th constant.
        maps, constants = self.prediction_maps(steps)
        k = len(self.offset)
        past_latest_first = _latest_first(self.scaling.scaled(past))
        # Letters of einsum: step h of the forecast, signal k, entry i of the past.
        mean = np.einsum("...i,hki->...hk", past_latest_first, maps, optimize=True) + constants
        # Ψ_h is the response of sample t + h to the innovation e_t. Since e_t is added to z_t, the process responds to
        # e_t as to z_t. So Ψ_0 is the identity, and Ψ_h is the first k columns of the h-th map, which multiply the
        # latest sample.
        responses = np.concatenate([np.eye(k)[None], maps[:-1, :, :k]])
        # Each further step adds the variance diag(Ψ Σ Ψᵀ) of one more innovation, where Ψ is the response to it.
        # Letters of einsum: step h, signal i, innovations j and l.
        added_variances = np.einsum(
            "hij,jl,hil->hi", responses, self.innovation_covariance, responses
        )
        return self._physical_forecast(mean, added_variances.cumsum(axis=0))

    @may_overflow
    def prediction_maps(self, steps: int) -> AffineMap:
        """Returns the expected next samples as linear functions of the past, for scaled channels.

        Args:
            steps: number of samples ahead.

        Returns:
            Maps (steps, k, L k) that multiply [z_{t−1}; …; z_{t−L}], and constants (steps, k).
        """
        coefficients = self.stacked_coefficients
        k, width = coefficients.shape
        # The L latest samples, the latest first, as functions of the past: columns are [lag 1, …, lag L, constant].
        latest_map = np.eye(width, width + 1)
        predictions = []
        for _ in range(steps):
            prediction = coefficients @ latest_map
            prediction[:, -1] += self.offset
            latest_map = np.concatenate([prediction, latest_map[:-k]])
            predictions.append(prediction)
        maps = np.array(predictions)
        return AffineMap(np.ascontiguousarray(maps[:, :, :-1]), maps[:, :, -1])

    def output_map(self, m: int) -> AffineMap:
        """Returns the expected outputs of a sample as a linear function of the inputs of the same sample and the past.

        The inputs u of the sample help to predict its outputs y, since their innovations are correlated:
        E[y | u, past] = E[y | past] + Σ_yu Σ_uu⁻¹ (u − E[u | past]).

        Args:
            m: number of outputs.

        Returns:
            A map (m, (L + 1) k) that multiplies [z_t; z_{t−1}; …; z_{t−L}], and a constant (m,), for scaled channels.
            The columns of the map for the outputs in z_t are 0.
        """
        Sigma = self.innovation_covariance
        # The tolerance keeps Σ_uu invertible where an input does not vary.
        Sigma_uu = Sigma[m:, m:] + ROUNDING_TOLERANCE * np.eye(len(Sigma) - m)
        gain = np.linalg.solve(Sigma_uu, Sigma[m:, :m]).T
        # E[z | past] is linear in the past; its rows up to m are E[y | past], the others E[u | past].
        coefficients = self.stacked_coefficients
        past_map = coefficients[:m] - gain @ coefficients[m:]
        weights = np.hstack([np.zeros((m, m)), gain, past_map])
        return AffineMap(weights, self.offset[:m] - gain @ self.offset[m:])

    def output_filter(self, m: int, steps: int) -> KalmanFilter:
        """Returns the Kalman filter that estimates the outputs from the inputs, after a known past.

        Its state is [y_{t−1}; …; y_{t−L}], the outputs of all lags, and its measurement is the input u_t. The effect of
        earlier inputs on both is known; the caller adds it as a forcing term, and subtracts it from the measurement.

        Args:
            m: number of outputs.
            steps: number of samples to which the filter will be applied.

        Returns:
            The filter of scaled channels; its initial covariance is 0, since the past is known.
        """
        lags, k, _ = self.coefficients.shape
        n = m * lags
        r = k - m
        Sigma = self.innovation_covariance
        output_coefficients = self.coefficients.swapaxes(0, 1)[:, :, :m].reshape(k, n)
        # The identity below the diagonal moves the outputs of each lag to the next lag. The first m rows compute the
        # next outputs from the outputs of all lags.
        A = np.eye(n, k=-m)
        A[:m] = output_coefficients[:m]
        # The innovations of the outputs are the process noise, with covariance Q. The innovations of the inputs are the
        # measurement noise, with covariance R. The two are correlated, with covariance S.
        Q = np.zeros((n, n))
        S = np.zeros((n, r))
        R = Sigma[m:, m:] + ROUNDING_TOLERANCE * np.eye(r)
        Q[:m, :m] = Sigma[:m, :m]
        S[:m] = Sigma[:m, m:]
        known_past = np.zeros((n, n))
        return KalmanFilter.design(A, output_coefficients[m:], Q, R, S, known_past, steps)

    def forecast_known_inputs(self, past: Array, inputs: Array, smooth: bool = False) -> Forecast:
        """Forecasts the outputs y, given the inputs u, by a Kalman filter that uses the inputs as measurements of y.

        In closed loop the controller computes the inputs from the motion, so that the inputs contain information on the
        outputs. The steps:

        1. The state of the filter of :meth:`output_filter` is the outputs of the last L samples. At the start they are
           known from the past.
        2. In the process each channel is a sum over earlier outputs, which are the filter's state, and over earlier
           inputs and the offset, which are known. The effect of the known ones is computed for all samples beforehand.
        3. The known effect on y is added to the state at each step, as a forcing term. The known effect on u is
           subtracted from the measured u, and the difference is the measurement of the filter.
        4. The filter runs forward and, if ``smooth``, the smoother runs backward.

        Args:
            past: (…, L, k) samples up to the forecast, the latest last; leading axes are separate forecasts.
            inputs: (…, H, r) inputs of the forecast.
            smooth: whether each sample is estimated from all H inputs, or only from those up to that sample.

        Returns:
            Means and variances of the outputs (…, H, m) in physical units; overflow is treated as in
            :meth:`forecast_unknown_inputs`.
        """
        lags, k, _ = self.coefficients.shape
        steps, r = inputs.shape[-2:]
        m = k - r
        kalman_filter = self.output_filter(m, steps)
        coefficients = self.coefficients.swapaxes(0, 1)
        scaled_past = self.scaling.scaled(past)
        scaled_inputs = (inputs - self.scaling.center[m:]) / self.scaling.scale[m:]
        # The known effect on each sample, (…, H, k): of earlier inputs and of the offset on all k channels.
        # The first m channels are the outputs, the other r the inputs.
        earlier_inputs = lagged_rows(
            np.concatenate([scaled_past[..., m:], scaled_inputs], axis=-2), lags
        )
        input_coefficients = coefficients[:, :, m:].reshape(k, lags * r)
        known_effect = earlier_inputs @ input_coefficients.T + self.offset
        # The state starts with the latest m outputs, so the known effect on the outputs is added to its first m
        # entries. The other entries are only moved from lag to lag, and nothing is added to them.
        forcing = np.zeros((*known_effect.shape[:-1], m * lags))
        forcing[..., :m] = known_effect[..., :m]
        states, innovations = kalman_filter.filter(
            _latest_first(scaled_past[..., :m]), forcing, scaled_inputs - known_effect[..., m:]
        )
        covariances = kalman_filter.predicted_covariances(steps)
        if smooth:
            states, covariances, _ = kalman_filter.smooth(states, innovations)
        variances = np.maximum(np.diagonal(covariances, axis1=1, axis2=2), 0.0)
        # State t + 1 begins with the outputs of sample t. So the outputs of the H samples are the first m entries of
        # the states 1 to H; state 0 is the known past.
        return self._physical_forecast(states[..., 1:, :m], variances[1:, :m])

    def rolling_forecast_known_inputs(
        self,
        past: Array,
        steps: int,
        inputs: Array,
        outputs: Array,
        smooth: bool = False,
    ) -> Forecast:
        """Forecasts outputs given the inputs, starting again at every ``steps``-th sample.

        Args:
            past: samples before the first forecast, at least L of them (T, k).
            steps: number of samples from one forecast to the next.
            inputs: (H, r) inputs.
            outputs: (H, m) measured outputs; each forecast uses those before it.
            smooth: whether each forecast sample also uses the inputs after it, up to the end of its forecast.

        Returns:
            Means and variances of the outputs (H, m), as :meth:`forecast_known_inputs` returns them.
        """
        length = len(inputs)
        m = outputs.shape[1]
        # If there are fewer samples than ``steps``, a single forecast covers them all.
        steps = max(1, min(steps, length))
        pasts = self._pasts_of_forecasts(past, steps, inputs, outputs)
        inputs_by_forecast = inputs[_rows_by_forecast(len(pasts), steps, length)]
        forecasts = self.forecast_known_inputs(pasts, inputs_by_forecast, smooth)
        # The forecasts (S, steps, m) are joined; the last may reach beyond the H samples, and is cut off there.
        return Forecast(
            forecasts.mean.reshape(-1, m)[:length], forecasts.variance.reshape(-1, m)[:length]
        )

    def rolling_forecast_unknown_inputs(
        self,
        past: Array,
        steps: int,
        inputs: Array,
        outputs: Array,
    ) -> Forecast:
        """Forecasts outputs without knowing later inputs, starting again at every ``steps``-th sample.

        Args:
            past: samples before the first forecast, at least L of them (T, k).
            steps: number of samples from one forecast to the next.
            inputs: (H, r) inputs; each forecast uses those before it.
            outputs: (H, m) measured outputs; each forecast uses those before it.

        Returns:
            Means and variances of the outputs (H, m), as :meth:`forecast_unknown_inputs` returns them.
        """
        length, m = outputs.shape
        # If there are fewer samples than ``steps``, a single forecast covers them all.
        steps = max(1, min(steps, length))
        pasts = self._pasts_of_forecasts(past, steps, inputs, outputs)
        forecasts = self.forecast_unknown_inputs(pasts, steps)
        # The first m of the k channels are the outputs. The S forecasts of ``steps`` samples each are joined; the last
        # may reach beyond the H samples, and is cut off there.
        return Forecast(
            forecasts.mean[..., :m].reshape(-1, m)[:length],
            forecasts.variance[..., :m].reshape(-1, m)[:length],
        )

    def one_step_predictions(self, record: Record) -> Array:
        """Predicts the outputs of each sample of a record from its inputs and from the samples before it.

        Args:
            record: T samples in any number of segments, in physical units.

        Returns:
            Predicted outputs (T, m) of all segments in order, in physical units. No segment uses samples of another.
        """
        m = record.outputs.shape[1]
        weights, constant = self.output_map(m)
        predictions = []
        for channels in self.scaling.scaled_segments(record):
            # The samples before the segment are assumed to equal its first sample. The first sample itself is predicted
            # as if its past were the mean of the training data, which is 0 here.
            padded_channels = np.concatenate([np.repeat(channels[:1], self.lags, axis=0), channels])
            past = lagged_rows(padded_channels, self.lags)
            past[0] = 0.0
            predictions.append(np.hstack([channels, past]) @ weights.T + constant)
        return self._physical_forecast(np.concatenate(predictions), np.zeros(1)).mean

    def _physical_forecast(self, mean: Array, variance: Array) -> Forecast:
        """Converts a forecast of scaled channels to physical units.

        Args:
            mean: (…, H, c) means of the first c channels.
            variance: (…, H, c) variances, or an array that broadcasts to that shape.

        Returns:
            The forecast. A mean that is not finite is replaced by the mean of the training data, with infinite
            variance.
        """
        channel_count = mean.shape[-1]
        center = self.scaling.center[:channel_count]
        scale = self.scaling.scale[:channel_count]
        is_mean_finite = np.isfinite(mean)
        is_determined = is_mean_finite & np.isfinite(variance)
        # In scaled channels, the mean of the training data is 0.
        scaled_mean = np.where(is_mean_finite, mean, 0.0)
        scaled_variance = np.where(is_determined, np.broadcast_to(variance, mean.shape), np.inf)
        return Forecast(center + scale * scaled_mean, scale**2 * scaled_variance)


def _rows_by_forecast(forecasts: int, steps: int, length: int) -> Indices:
    """Returns the indices of the samples that each rolling forecast covers.

    Forecasts follow one another without overlap. The last one may extend beyond the last sample; then it has that
    sample again in place of those that are missing.

    Args:
        forecasts: number S of forecasts.
        steps: number of samples of each forecast.
        length: number of samples, which is the number of rows.

    Returns:
        Indices of rows (S, steps).
    """
    last_row = length - 1
    rows = np.minimum(np.arange(forecasts * steps), last_row)
    return rows.reshape(-1, steps)


def _latest_first(past_samples: Array) -> Array:
    """Flattens samples to the order of the coefficients, which begin with the latest sample's.

    Args:
        past_samples: (…, L, k) samples of k channels, the latest last.

    Returns:
        (…, L · k) the samples side by side, the latest first.
    """
    *leading_lengths, sample_count, channel_count = past_samples.shape
    return past_samples[..., ::-1, :].reshape(*leading_lengths, sample_count * channel_count)
