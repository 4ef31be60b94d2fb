"""Impulse response of a closed loop by regularised deconvolution: values at knots, with a Gaussian process as prior.

The response of a signal p to its setpoint r is p(t) = ∫ h(τ) r(t − τ) dτ + noise. The impulse response h is causal: it
is 0 at τ = 0 and before, and at the end of its duration. Otherwise it is linear between knots, which are closest where
it rises. The values at the K inner knots are fitted by generalised least squares: residuals are whitened by an
autoregression, and windows with more wind count less, which is what weights by coherence do. Their prior is a smooth,
decaying Gaussian process, averaged over variances, lengths and decays by their evidence. It distinguishes resonances
from noise without smoothing them, and shows in the covariance what the setpoint did not excite (G. Pillonetto and G. De
Nicolao, A new kernel-based approach for linear system identification, Automatica 46(1), 2010).

Wind moves a rate's setpoint r as well, by the attitude controller: r = x − G φ, of gain G and angle φ. So the
instrument is not r itself but the part of r that follows x, the command of pilot or navigation: x / (1 + G T / s) with
x = r + G φ and the T of the pass before (L. Ljung, System Identification, 2nd ed., secs. 7.6 and 13.5).
"""

from collections.abc import Sequence
from functools import lru_cache
from itertools import product
from math import ceil
from typing import NamedTuple

import numpy as np
import scipy

from mavdem.arrays import SMALLEST_POSITIVE, Array
from mavdem.containers import Numbers
from mavdem.dem.engine.linalg import one_thread
from mavdem.loops.margins import Complex

MAX_WINDOWS = 300
"""Largest number of windows of a fit; of more, only every second, third … is used. A choice, for speed."""
FIT_PASSES = 4
"""Number of times that noise, weights of windows and instrument are estimated from the last fit: a choice."""
AUTOREGRESSION_ORDER = 12
"""Order of the autoregression that whitens residuals: a choice."""
MAX_WINDOW_WEIGHT_RATIO = 1e3
"""Largest ratio of the residuals' standard deviations of two windows.

A window of nothing but repeated samples leaves no residuals, and would outweigh all the others.
"""
STEADY_STATE_ERROR = 0.03
"""Standard deviation of the response's integral, T at 0 Hz, about 1: a controller with an integrator settles there."""
INITIAL_DECAY = 5.0
"""Decay of the response that the first pass begins with, as exponent over the duration of the response: a choice."""

NODE_SPACING_RATIO = 0.02
"""Spacing of the inner knots, relative to their lag, since a response changes fastest at short lags. A choice."""

PRIOR_LENGTHS = 0.01, 0.03, 0.1
"""Length scales of the prior that are averaged over, relative to the duration of the response.

Values within a length are similar. Of the rate loop these are 5 to 50 ms, of the attitude loop 20 to 200 ms.
"""
PRIOR_DECAYS = np.geomspace(0.06, 2.0, 6)
"""Decay times of the prior's amplitude that are averaged over, relative to the duration of the response."""
PRIOR_VARIANCES = np.geomspace(0.1, 1e5, 13)
"""Variances of the prior that are averaged over, in units of 1 / (duration of the response in samples)²."""
TAIL_LENGTH = 0.2
"""Length scale of the slow tail that an integrator leaves, relative to the duration of the response: a choice."""
TAIL_DECAY = 2.0
"""Decay time of this tail, relative to the duration of the response: a choice."""
TAIL_VARIANCE_RATIO = 0.03
"""Variance of this tail, relative to the variance of the rest of the prior: a choice."""
ROUNDING = 1e-6
"""Tolerance of a number of steps, for rates that are not exactly the rates of their messages."""
JITTER = 1e-8
"""White noise added to a covariance, relative to its mean variance, so that rounding leaves it a Cholesky factor."""
WHITE_NOISE_SHARE = 1e-6
"""White noise added to an autocovariance, relative to its variance, to keep the Yule-Walker equations regular."""
MIN_FREEDOM_SHARE = 0.25
"""Least degrees of freedom of the scatter between windows, relative to the number of windows: a choice."""

CACHED_PRIOR_SHAPES = 2
"""Numbers of inner knots whose prior shapes are kept: of a rate loop and of an attitude loop, some MB each."""


class ImpulseResponse(NamedTuple):
    """An estimated impulse response: 0 at the first and the last knot, and linear between knots."""

    sampling_rate: float
    """Rate of the samples that it was estimated from, Hz."""
    knots: Array
    """Lags (K + 2,), in samples: 0, then of the K inner knots, and the duration of the response."""
    values: Array
    """Values at the inner knots (K,), per sample."""
    covariance: Array
    """Covariance of these (K, K)."""
    windows: int
    """Number of windows of flight that it was estimated from."""

    def step_responses(self, values: Array, time: Array) -> Array:
        """Returns the responses to a step of 1: the integrals of impulse responses.

        Args:
            values: N sets of values at the inner knots (N, K), such as draws.
            time: times after the step (T,), s.

        Returns:
            Step responses (N, T).
        """
        # The impulse response is a sum of hat functions, each a weighted sum of three ramps max(lag, 0) that begin at
        # neighbouring knots (:func:`second_differences`). So its integral is a sum of the ramps' integrals.
        lags = self.sampling_rate * time[:, None] - self.knots
        ramp_integrals = np.maximum(lags, 0.0) ** 2 / 2
        hat_integrals = ramp_integrals @ second_differences(self.knots)
        return np.asarray(values @ hat_integrals.T)

    def frequency_responses(self, values: Array, frequency: Array) -> Complex:
        """Computes the frequency responses of impulse responses, which are linear between knots, by Fourier transform.

        Args:
            values: N sets of values of the response at the inner knots (N, K), such as draws from its posterior.
            frequency: frequencies (F,), Hz, above 0.

        Returns:
            Complex responses (N, F).
        """
        # The angular frequency ω in radians per sample, since knots count in samples.
        angular_frequency = 2 * np.pi * frequency[:, None] / self.sampling_rate
        # The response is a weighted sum of ramps (:func:`second_differences`). The Fourier transform of the ramp that
        # begins at knot k is e^(−iωk) / (iω)².
        ramp_transforms = -np.exp(-1j * angular_frequency * self.knots) / angular_frequency**2
        hat_transforms = ramp_transforms @ second_differences(self.knots)
        return np.asarray(values @ hat_transforms.T)


def response_knots(taps: int, steps_per_sample: int) -> Array:
    """Returns the lags between which an impulse response is linear, from 0 to ``taps``.

    Their spacing increases with the lag: it is ``NODE_SPACING_RATIO`` times the lag, but at least one step.

    Args:
        taps: duration of the response, in samples.
        steps_per_sample: number of steps into which a sampling interval is divided.

    Returns:
        Lags (K + 2,), in samples, ascending.
    """
    # Lags are counted in steps until they are converted to samples.
    last_lag = taps * steps_per_sample
    lag = 0
    lags = [lag]
    while lag < last_lag:
        spacing = max(1, round(NODE_SPACING_RATIO * lag))
        lag = min(lag + spacing, last_lag)
        lags.append(lag)
    return np.array(lags) / steps_per_sample


def second_differences(knots: Array) -> Array:
    """Returns the weights by which hat functions are sums of ramps that begin at the knots.

    The hat function of an inner knot is 1 there, 0 at the two neighbouring knots and beyond, and linear between. The
    ramp of a knot k is max(lag − k, 0). A hat is a weighted sum of the ramps of three neighbouring knots, at which its
    slope changes; the weights are these changes. So integrals and transforms of hats follow from the ramps', which
    are simple.

    Args:
        knots: lags (K + 2,), ascending; all except the first and the last are inner knots.

    Returns:
        Weights (K + 2, K): of the ramp of each knot (rows) in the hat of each inner knot (columns).
    """
    spacing = np.diff(knots)
    # A hat rises to 1 over the spacing before its knot, and falls to 0 over the spacing after it.
    rising_slope = 1 / spacing[:-1]
    falling_slope = -1 / spacing[1:]
    hat = np.arange(len(knots) - 2)
    # Hat j belongs to knot j + 1, since the first knot has none: it begins at knot j and ends at knot j + 2.
    begin, middle, end = hat, hat + 1, hat + 2
    weights = np.zeros((len(knots), len(hat)))
    weights[begin, hat] = rising_slope
    weights[middle, hat] = falling_slope - rising_slope
    weights[end, hat] = -falling_slope
    return weights


def hat_areas(knots: Array) -> Array:
    """Returns the integrals of the hat functions of the inner knots (K,), in samples."""
    return np.asarray((knots[2:] - knots[:-2]) / 2)


def estimate_impulse_response(
    sampling_rate: float,
    pieces: Sequence[Array],
    angle_gain: float,
    seconds: float,
    resolution: float,
) -> ImpulseResponse | None:
    """Estimates the impulse response of a signal to its setpoint, such as a body rate.

    The signal is regressed on the setpoint's convolutions with hat functions. The filter that whitens the residuals,
    the weights of the windows and the instrument depend on the impulse response. So the fit is repeated ``FIT_PASSES``
    times, and each pass computes them from the response of the pass before; the first one begins with an exponential
    decay.

    Args:
        sampling_rate: rate of the samples, Hz.
        pieces: pieces of flight, (k, N) each, with setpoint, signal and, if ``angle_gain`` is not 0, the angle in rows.
        angle_gain: gain of the attitude controller that feeds the angle back to the setpoint, 1/s; 0 if none does.
        seconds: duration of the response, s. A window is three times as long. Of its first third only the setpoints are
            used; the samples of the other two thirds are explained.
        resolution: longest time between the two closest inner knots, s. It may be shorter than a sample.

    Returns:
        The impulse response. None if no piece is as long as a window and what is left out before it, or if the
        setpoint is constant in all windows. None also if the signal is exactly the response, so that the weights of the
        windows cannot be computed from the noise, or if values are so large that their products overflow.
    """
    taps = round(seconds * sampling_rate)
    window_size = 3 * taps
    steps_per_sample = max(ceil(1 / (sampling_rate * resolution) - ROUNDING), 1)
    knots = response_knots(taps, steps_per_sample)
    setpoint = _overlapping_windows([piece[0] for piece in pieces], taps, window_size)
    signal = _overlapping_windows([piece[1] for piece in pieces], taps, window_size)
    if not np.ptp(setpoint, axis=1).any():
        return None
    decay = np.exp(-INITIAL_DECAY * knots[1:-1] / taps)
    response_at_knots = decay / (hat_areas(knots) @ decay)
    estimate = None
    with one_thread():
        setpoint_convolutions = _hat_convolutions(setpoint, knots)
        for _ in range(FIT_PASSES):
            instrument = None
            if angle_gain:
                undisturbed = [
                    _setpoint_without_wind(
                        piece, angle_gain, response_at_knots, knots, sampling_rate
                    )
                    for piece in pieces
                ]
                instrument = _overlapping_windows(undisturbed, taps, window_size)
            response = np.tensordot(response_at_knots, setpoint_convolutions, axes=1)
            residuals = signal[:, taps:] - response
            variation = np.ptp(residuals, axis=1)
            # Residuals are all equal if the signal is the response exactly, and not finite after an overflow.
            if not variation.any() or not np.isfinite(variation).all():
                return None
            whitening = _whitening_filter(residuals)
            deviation = _noise_deviations(residuals, whitening)
            if instrument is not None:
                instrument = _filtered_windows(instrument, whitening) / deviation
            estimate = _regularised_estimate(
                _filtered_windows(setpoint, whitening) / deviation,
                _filtered_windows(signal, whitening) / deviation,
                instrument,
                knots,
                sampling_rate,
            )
            response_at_knots = estimate.values
            if not np.isfinite(response_at_knots).all():
                return None
    return estimate


def _noise_deviations(residuals: Array, whitening: Array) -> Array:
    """Returns the standard deviation of the noise in each window of the flight: of its whitened residuals.

    All signals of a window are divided by it (weighted least squares), so that windows with more wind have less weight.

    Args:
        residuals: residuals of W windows of B samples (W, B), in the unit of the response.
        whitening: coefficients of the filter that makes them white (P,).

    Returns:
        Standard deviations (W, 1) in the same unit, positive: at least the largest one divided by
        ``MAX_WINDOW_WEIGHT_RATIO``, so that no quiet window decides the estimate alone.
    """
    deviations = _filtered_windows(residuals, whitening).std(axis=1, keepdims=True)
    least_deviation = deviations.max() / MAX_WINDOW_WEIGHT_RATIO + SMALLEST_POSITIVE
    return np.maximum(deviations, least_deviation)


def _hat_convolutions(windows: Array, knots: Array) -> Array:
    """Returns the convolutions of a signal with the hat functions of the inner knots: the regressors of the response.

    A hat is a weighted sum of the ramps max(lag − knot, 0) of three neighbouring knots (:func:`second_differences`).
    The convolution of the signal with such a ramp is the signal's double integral, delayed by the knot. The signal is
    assumed to be linear between its samples. It is integrated twice and delayed by each knot, and the delayed integrals
    are summed with the weights of the hats.

    Args:
        windows: samples of each window (W, B + D), where D is the duration of the response, in samples.
        knots: lags (K + 2,) in samples, from 0 to D. The K inner knots are all except the first and the last.

    Returns:
        The convolutions with each of the K hats, for the last B samples of each window (K, W, B).
    """
    # Between a sample and the next, with the time t in samples, the signal is sample + slope · t. Its integral and its
    # double integral from the window's beginning are polynomials of degree 2 and 3 there. All three are continuous.
    sample = windows[:, :-1]
    slope = np.diff(windows, axis=1)
    zeros = np.zeros((len(windows), 1))
    integral = np.hstack([zeros, np.cumsum(sample + slope / 2, axis=1)])[:, :-1]
    increments = integral + sample / 2 + slope / 6
    double_integral = np.hstack([zeros, np.cumsum(increments, axis=1)])
    duration = int(knots[-1])
    size = windows.shape[1]
    # The convolution with the ramp of each knot.
    ramp_convolutions = np.empty((len(knots), len(windows), size - duration))
    for index, lag in enumerate(knots.tolist()):
        # If a lag is not a whole number of samples, the delayed time is between two samples, a fraction of the interval
        # after the earlier one. There the double integral follows from the polynomial of that interval.
        whole_samples = ceil(lag)
        fraction = whole_samples - lag
        earlier = slice(duration - whole_samples, size - whole_samples)
        delayed = double_integral[:, earlier]
        if fraction:
            delayed = (
                delayed
                + fraction * integral[:, earlier]
                + fraction**2 / 2 * sample[:, earlier]
                + fraction**3 / 6 * slope[:, earlier]
            )
        ramp_convolutions[index] = delayed
    # This is equal to the product with ``second_differences``. Each hat has only three weights, so that differences of
    # neighbours, divided by the spacing of the knots, are faster to compute.
    slopes = np.diff(ramp_convolutions, axis=0)
    slopes /= np.diff(knots)[:, None, None]
    return np.diff(slopes, axis=0)


def _sampled_response(values: Array, knots: Array) -> Array:
    """Returns the response to a setpoint of 1 at one sample, which falls to 0 linearly to both sides (taps,)."""
    taps = int(knots[-1])
    impulse = np.zeros((1, 2 * taps))
    impulse[0, taps] = 1.0
    return np.tensordot(values, _hat_convolutions(impulse, knots), axes=1)[0]


def _setpoint_without_wind(
    piece: Array, angle_gain: float, values: Array, knots: Array, sampling_rate: float
) -> Array:
    """Returns the part of a rate setpoint that follows pilot or navigation, and not the wind: x / (1 + G T / s).

    With the rate setpoint r and the angle φ, x = r + G φ is the command of pilot or navigation, and 1 / (1 + G T / s)
    the closed attitude loop from x to r, which is applied in the frequency domain. The rest of r is caused by wind,
    through the feedback of the angle.

    Args:
        piece: (3, N) setpoint r, rate, and angle φ.
        angle_gain: gain G of the attitude controller, 1/s.
        values: (K,) impulse response of T, from rate setpoint to rate, at the inner knots, per sample.
        knots: (K + 2,) lags of the inner knots and the ends of the response, in samples.
        sampling_rate: rate of the samples, Hz.

    Returns:
        (N,) setpoint without the effect of wind.
    """
    size = piece.shape[1]
    rate_setpoint, _, angle = piece[:3]
    outer_setpoint = rate_setpoint + angle_gain * angle
    # The discrete Fourier transform treats the series as periodic. Appending its mirror image avoids a step from its
    # end to its beginning.
    mirrored = np.append(outer_setpoint, outer_setpoint[::-1])
    transform = np.fft.rfft(mirrored)
    frequency = np.fft.rfftfreq(2 * size, 1 / sampling_rate)
    # The frequency 0 is replaced by a small one, to avoid the division by s = 0.
    positive_frequency = np.maximum(frequency, frequency[1] / 100)
    s = 2j * np.pi * positive_frequency
    closed_rate_loop = np.fft.rfft(_sampled_response(values, knots), 2 * size)
    undisturbed = transform / (1 + angle_gain * closed_rate_loop / s)
    return np.fft.irfft(undisturbed, 2 * size)[:size]


def _overlapping_windows(series: Sequence[Array], taps: int, size: int) -> Array:
    """Cuts several series into windows that overlap by the length of the impulse response.

    A response depends on the ``taps`` setpoints before it. So the first ``taps`` samples of a window are only used as
    inputs, and windows overlap by that number, so that every later sample is an output once. The first ``2 taps``
    samples of each series are left out, since responses there may come from before its beginning.

    Args:
        series: values (N,) of each piece of flight; pieces too short for a window are ignored.
        taps: number of samples of the impulse response, by which windows overlap.
        size: number of samples of a window.

    Returns:
        (W, size) windows, evenly thinned to at most ``MAX_WINDOWS``.
    """
    samples_between_starts = size - taps
    # The empty array makes the result two-dimensional if no series is long enough.
    windows_of_series = [np.zeros((0, size))]
    for values in series:
        usable_values = values[2 * taps :]
        if len(usable_values) >= size:
            windows_at_all_samples = np.lib.stride_tricks.sliding_window_view(usable_values, size)
            windows_of_series.append(windows_at_all_samples[::samples_between_starts])
    windows = np.concatenate(windows_of_series)
    thinning = max(ceil(len(windows) / MAX_WINDOWS), 1)
    return windows[::thinning]


def _filtered_windows(windows: Array, coefficients: Array) -> Array:
    """Applies a finite-impulse-response filter to each window, and leaves out the filter's transient.

    Args:
        windows: samples of each window (W, B).
        coefficients: coefficients of the filter (P,), the latest sample's first.

    Returns:
        Filtered samples (W, B − P + 1).
    """
    views = np.lib.stride_tricks.sliding_window_view(windows, len(coefficients), axis=1)
    return views @ coefficients[::-1]


def _whitening_filter(residuals: Array) -> Array:
    """Returns the filter that makes residuals white, as least squares assumes them to be.

    The filter computes differences, which removes the mean, and then the prediction errors of an autoregression of
    order ``AUTOREGRESSION_ORDER``, which is fitted to the differences by the Yule-Walker equations.

    Args:
        residuals: residuals of all windows (W, B), which share one filter.

    Returns:
        Coefficients (P,), the latest sample's first; P is the order of the autoregression plus 2.
    """
    differences = np.diff(residuals, axis=1)
    sample_count = differences.shape[1]
    # Entry k is the mean product of samples that are k samples apart.
    autocovariance = []
    for lag in range(AUTOREGRESSION_ORDER + 1):
        earlier_samples = differences[:, : sample_count - lag]
        later_samples = differences[:, lag:]
        autocovariance.append(np.mean(earlier_samples * later_samples))
    # A little white noise keeps the Yule-Walker equations well conditioned.
    autocovariance[0] *= 1 + WHITE_NOISE_SHARE
    coefficients = scipy.linalg.solve_toeplitz(autocovariance[:-1], autocovariance[1:])
    prediction_error_filter = np.append(1.0, -coefficients)
    difference_filter = [1.0, -1.0]
    return np.convolve(prediction_error_filter, difference_filter)


def _regularised_estimate(
    setpoint: Array, signal: Array, instrument: Array | None, knots: Array, sampling_rate: float
) -> ImpulseResponse:
    """Estimates the impulse response that explains a signal by its setpoint, by regularised instrumental variables.

    X are the convolutions of the setpoint with the hats, Z of the instrument with the hats, y the signal, and Q the
    prior covariance of the values w. The integral of the response is 1 ± ``STEADY_STATE_ERROR``. This is one more
    observation, sᵀ w = 1 / error, in which s are the areas of the hats divided by the error. The estimate is

        w = (I + Q (Zᵀ X + s sᵀ))⁻¹ Q (Zᵀ y + s / error)

    Its covariance is the sum of three. The first is the variance by noise, which follows from the scores
    Zᵀ (y − X w) of the windows without assumptions on the noise (a sandwich covariance, like a jackknife over
    windows). The second is the error because the prior shrinks values that the flight does not determine. The third is
    the error of the steady state.

    Args:
        setpoint: windows of the setpoint (W, B), whitened and scaled so that residuals have a variance of 1.
        signal: windows of the signal (W, B), whitened and scaled likewise.
        instrument: windows of the instrument (W, B), likewise; None if the setpoint is its own instrument.
        knots: lags between which the response is linear (K + 2,), in samples.
        sampling_rate: rate of the samples, Hz.

    Returns:
        The impulse response with its covariance.
    """
    taps = int(knots[-1])
    regressors = _hat_convolutions(setpoint, knots)
    instruments = regressors if instrument is None else _hat_convolutions(instrument, knots)
    target = signal[:, taps:]
    over_windows_and_samples = ((1, 2), (1, 2))
    instrument_products = np.tensordot(instruments, instruments, axes=over_windows_and_samples)
    regressor_products = instrument_products
    if instrument is not None:
        regressor_products = np.tensordot(instruments, regressors, axes=over_windows_and_samples)
    target_products = np.tensordot(instruments, target, axes=2)
    steady_state = hat_areas(knots) / STEADY_STATE_ERROR
    steady_state_products = np.outer(steady_state, steady_state)
    precision = instrument_products + steady_state_products
    weighted_estimate = target_products + steady_state / STEADY_STATE_ERROR
    prior = _prior_covariance(precision, weighted_estimate, knots)
    information = regressor_products + steady_state_products
    identity = np.eye(len(weighted_estimate))
    inverse = np.linalg.solve(identity + prior @ information, prior)
    values = inverse @ weighted_estimate

    # Indices of the scores: w the window, b its samples, k the inner knots.
    residuals = target - np.tensordot(values, regressors, axes=1)
    scores = np.einsum("kwb,wb->wk", instruments, residuals) @ inverse.T
    effective_parameters = np.trace(inverse @ regressor_products)
    windows = len(signal)
    # The estimate was fitted to the windows, so their scores are too small. The degrees of freedom correct that.
    degrees_of_freedom = max(windows - effective_parameters, windows * MIN_FREEDOM_SHARE)
    sampling_covariance = scores.T @ scores * windows / degrees_of_freedom
    shrinkage = identity - inverse @ information
    shrinkage_covariance = shrinkage @ prior @ shrinkage.T
    steady_state_error = inverse @ steady_state
    steady_state_covariance = np.outer(steady_state_error, steady_state_error)
    covariance = sampling_covariance + shrinkage_covariance + steady_state_covariance
    return ImpulseResponse(sampling_rate, knots, values, covariance, windows)


def _prior_covariance(precision: Array, weighted_estimate: Array, knots: Array) -> Array:
    """Returns the prior covariance of an impulse response at its inner knots, averaged over priors by their evidence.

    It is not known beforehand how large, how smooth and how long the response is. So priors with several variances λ,
    length scales and decays are averaged, weighted by their evidence: how well each explains the flight (Bayesian model
    averaging). A shape is the covariance of one length scale and decay for λ = 1; it has a Cholesky factor too, by
    which the evidence is computed.

    Args:
        precision: precision of the values at the K inner knots by the flight alone (K, K).
        weighted_estimate: precision times the estimate of the values by the flight alone (K,).
        knots: lags of the knots (K + 2,): 0, K inner ones, and the duration of the response, in samples.

    Returns:
        Covariance (K, K).
    """
    shapes = _prior_shapes(tuple(knots.tolist()))
    log_evidence = _log_evidence_of_priors(precision, weighted_estimate, shapes.cholesky_factors)
    # The weights sum to 1 over all shapes (rows) and variances (columns).
    weights = scipy.special.softmax(log_evidence)
    return np.tensordot(weights @ PRIOR_VARIANCES, shapes.covariances, axes=1)


def _log_evidence_of_priors(
    precision: Array, weighted_estimate: Array, cholesky_factors: Array
) -> Array:
    """Returns the log evidence of normal priors of each shape with each of the ``PRIOR_VARIANCES`` λ.

    A prior has mean 0 and the covariance λ R Rᵀ. By the flight alone the values at the inner knots have the precision P
    and the weighted estimate m, which is P times the estimate. The log evidence is then, up to a constant,

        ½ (λ gᵀ (I + λ A)⁻¹ g − ln det (I + λ A)),    A = Rᵀ P R,  g = Rᵀ m

    A is transformed to a tridiagonal matrix once for each shape, and both terms follow from that for all λ at once.

    Args:
        precision: precision of the values at the K inner knots by the flight alone (K, K).
        weighted_estimate: precision times the estimate of the values by the flight alone (K,).
        cholesky_factors: Cholesky factors R of the S shapes of the prior (S, K, K).

    Returns:
        Log evidence (S, V) for the V variances, nats, up to a constant.
    """
    # A and g for each shape, in a basis in which A is tridiagonal and g is along the first basis vector.
    forms = []
    for R in cholesky_factors:
        forms.append(_tridiagonal_form(R.T @ precision @ R, R.T @ weighted_estimate))
    # Entries of A (K, S, 1) and (K − 1, S, 1), and |g| (S, 1), to be multiplied by the V variances.
    diagonals_of_a = np.array([form.diagonal for form in forms]).T[:, :, None]
    off_diagonals_of_a = np.array([form.off_diagonal for form in forms]).T[:, :, None]
    lengths_of_g = np.array([form.vector_length for form in forms])[:, None]
    # Entries of the matrices I + λ A.
    diagonals = 1 + PRIOR_VARIANCES * diagonals_of_a
    squared_off_diagonals = (PRIOR_VARIANCES * off_diagonals_of_a) ** 2
    # Gaussian elimination from the last row up: the determinant is the product of the pivots. As A has no negative
    # eigenvalues, a pivot can only be less than 1 by rounding.
    last_row = len(weighted_estimate) - 1
    pivot = np.maximum(diagonals[last_row], 1.0)
    log_determinant = np.log(pivot)
    for row in reversed(range(last_row)):
        pivot = np.maximum(diagonals[row] - squared_off_diagonals[row] / pivot, 1.0)
        log_determinant += np.log(pivot)
    # After the elimination, the first entry of (I + λ A)⁻¹ is 1 over the pivot of the first row, which was the last one
    # to be computed. Only this entry counts, since g is along the first basis vector.
    quadratic_term = PRIOR_VARIANCES * lengths_of_g**2 / pivot
    return np.asarray(quadratic_term - log_determinant) / 2


class _TridiagonalForm(NamedTuple):
    """A symmetric matrix and a vector in an orthonormal basis whose first vector is along that vector."""

    diagonal: Array
    """Diagonal of the matrix (K,), which is tridiagonal in this basis."""
    off_diagonal: Array
    """Entries next to the diagonal (K − 1,)."""
    vector_length: float
    """Length of the vector, its only entry in this basis; the sign is arbitrary."""


def _tridiagonal_form(matrix: Array, vector: Array) -> _TridiagonalForm:
    """Transforms a symmetric matrix to tridiagonal form, in a basis whose first vector is along a given vector.

    Householder reflections are used (Golub and Van Loan, Matrix Computations, 4th ed., sec. 8.3). That takes a third of
    the time of eigenvalues and eigenvectors.

    Args:
        matrix: (K, K) symmetric matrix.
        vector: (K,) vector.

    Returns:
        Both in the new basis.
    """
    size = len(vector)
    # The reflections turn the first column, below its first entry, to the first basis vector. So the vector is put in
    # front of the matrix as that column; its length is then the first entry next to the diagonal.
    bordered = np.zeros((size + 1, size + 1))
    bordered[1:, 0] = vector
    bordered[1:, 1:] = matrix
    _, diagonal, off_diagonal, _, _ = scipy.linalg.lapack.dsytrd(bordered, lower=1)
    return _TridiagonalForm(diagonal[1:], off_diagonal[1:], off_diagonal[0])


class _PriorShapes(NamedTuple):
    """Prior covariances of an impulse response at its K inner knots for a variance of 1, by length scale and decay."""

    covariances: Array
    """Covariances (S, K, K) of S length scales and decays, for a variance of 1."""
    cholesky_factors: Array
    """Cholesky factors of the covariances (S, K, K)."""


@lru_cache(maxsize=CACHED_PRIOR_SHAPES)
def _prior_shapes(knots: Numbers) -> _PriorShapes:
    """Returns the prior covariances of an impulse response at its inner knots, for each length scale and decay.

    The prior is a Gaussian process with the covariance of a Matérn process whose amplitude decays over the duration of
    the response, plus a small, slow and smooth process: the slow tail that an integrator leaves in a response. The
    variance of the whole is not included: it multiplies the covariance later.

    The covariances depend only on the knots, and are cached: all iterations of a fit, and all axes of a flight, have
    the same.

    Args:
        knots: lags of the knots (K + 2,): 0, K inner ones, and the duration of the response, in samples.

    Returns:
        The covariances of S = ``PRIOR_LENGTHS`` × ``PRIOR_DECAYS`` shapes, and their Cholesky factors.
    """
    duration = knots[-1]
    # Times of the first end and the inner knots, in units of the duration of the response, 0 to 1. At the last end the
    # response is 0, and is not estimated.
    time = np.array(knots[:-1]) / duration
    knot_count = len(time) - 1
    tail = TAIL_VARIANCE_RATIO * _decaying_matern(time, TAIL_LENGTH, TAIL_DECAY)
    covariances = []
    roots = []
    for length, decay in product(PRIOR_LENGTHS, PRIOR_DECAYS):
        process = _decaying_matern(time, length, decay) + tail
        # The response is 0 at time 0: the Gaussian process is conditioned on that.
        conditioned = process - np.outer(process[0], process[0]) / process[0, 0]
        covariance = conditioned[1:, 1:] / duration**2
        # A little white noise keeps the covariance positive definite in spite of rounding.
        mean_variance = np.trace(covariance) / knot_count
        white_noise = JITTER * mean_variance * np.eye(knot_count)
        covariances.append(covariance)
        roots.append(np.linalg.cholesky(covariance + white_noise))
    return _PriorShapes(np.array(covariances), np.array(roots))


def _decaying_matern(time: Array, length: float, decay: float) -> Array:
    """Returns Matérn's covariance of order 5/2 with an exponentially decaying amplitude.

        k(t, t') = (1 + d + d² / 3) e^(−d) e^(−(t + t') / decay),    d = √5 |t − t'| / length

    Args:
        time: times (K,), in any unit.
        length: length scale of the correlation, in the unit of the times.
        decay: time over which the amplitude falls by a factor e, in the unit of the times.

    Returns:
        Covariance (K, K).
    """
    difference = np.abs(np.subtract.outer(time, time))
    distance = difference * 5**0.5 / length
    polynomial = 1 + distance + distance**2 / 3
    correlation = polynomial * np.exp(-distance)
    amplitude = np.exp(-np.add.outer(time, time) / decay)
    return correlation * amplitude
