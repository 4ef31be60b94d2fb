"""Impulse response of a closed loop by regularised deconvolution, with wind and feedback acting on the setpoint.

The response T of a signal p to its setpoint r is a finite impulse response of K weights, p_t = Σ w_k r_{t−k} + noise.
Weights are fitted by generalised least squares: residuals are whitened by an autoregression, and windows with more wind
count less, which is what weights by coherence do. Their prior is a smooth, decaying Gaussian process, averaged over
variances and decays by their evidence. It tells resonances from noise without smoothing them, and shows in the
covariance what the setpoint did not excite (G. Pillonetto and G. De Nicolao, A new kernel-based approach for linear
system identification, Automatica 46(1), 2010).

Wind moves a rate's setpoint r as well, by the attitude controller: r = x − G φ, of gain G and angle φ. So the
instrument is not r itself but the part of r that follows x, what pilot or navigation ask for: x / (1 + G T / s), x = r
+ G φ, with the T of the pass before (L. Ljung, System Identification, 2nd ed., secs. 7.6 and 13.5).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_toeplitz
from scipy.special import softmax

from mavdem.arrays import Array
from mavdem.dem.engine.linalg import SMALLEST_POSITIVE, one_thread

MAX_WINDOWS = 300
"""Most windows of a fit: of more, every second, third … is taken."""
FIT_PASSES = 4
"""How often noise, weights of windows and instrument are estimated from the last fit."""
AUTOREGRESSION_ORDER = 12
"""Order of the autoregression that whitens residuals."""
MAX_WINDOW_WEIGHT_RATIO = 1e3
"""Largest spread of residuals of a window over the least that counts. A window of nothing but repeated samples leaves
no residuals, and would outweigh all the others."""
STEADY_STATE_ERROR = 0.03
"""Standard deviation of the sum of the weights, T at 0 Hz, about 1: a controller with an integrator settles there."""
INITIAL_DECAY = 5.0
"""How many times the weights of the first pass fall by a factor e over the response."""

PRIOR_LENGTH = 0.04
"""Time over which the weights are alike in the prior, by the duration of the response."""
PRIOR_DECAYS = np.geomspace(0.06, 2.0, 6)
"""Times over which the prior decays by a factor e, by the duration of the response."""
PRIOR_VARIANCES = np.geomspace(0.1, 1e5, 13)
"""Variances of the prior, in units of the step over the duration of the response, squared."""
TAIL_LENGTH = 0.2
"""Time over which the slow tail that an integrator leaves is alike, by the duration of the response."""
TAIL_DECAY = 2.0
"""Time over which this tail decays, likewise."""
TAIL_VARIANCE_RATIO = 0.03
"""Variance of this tail by that of the rest."""
JITTER = 1e-8
"""Added to the diagonal of a covariance, by its mean, so that it has a Cholesky factor."""


class ImpulseResponse(NamedTuple):
    """An estimated impulse response, and its covariance."""

    weights: Array
    """(K,) of the last K setpoints, the last first; their sum is T at 0 Hz."""
    covariance: Array
    """(K, K) of the weights."""
    windows: int
    """How many windows of flight they were estimated from."""


def estimate_impulse_response(
    sampling_rate: float, pieces: Sequence[Array], angle_gain: float, seconds: float
) -> ImpulseResponse:
    """Returns the impulse response of a signal to its setpoint, in ``FIT_PASSES`` passes.

    Noise, weights of windows and instrument depend on the response, which is what is looked for. So each pass takes
    them from the response of the pass before; the first one from an exponential decay.

    Args:
        sampling_rate: of the pieces, Hz.
        pieces: (k, N) each: setpoint, signal and, if ``angle_gain`` is not 0, the angle.
        angle_gain: of the attitude controller that feeds the angle back to the setpoint, 1/s; 0 if none does.
        seconds: duration of the response, s. A window is as long as three of them: two to explain, after one whose
            setpoints the first samples follow from.
    """
    taps = round(seconds * sampling_rate)
    size = 3 * taps
    setpoint = _overlapping_windows([piece[0] for piece in pieces], taps, size)
    signal = _overlapping_windows([piece[1] for piece in pieces], taps, size)
    decay = np.exp(-INITIAL_DECAY * (np.arange(1, taps + 1) / taps))
    weights = decay / decay.sum()
    with one_thread():
        for _ in range(FIT_PASSES):
            instrument = setpoint
            if angle_gain:
                undisturbed = [
                    _setpoint_without_wind(piece, angle_gain, weights, sampling_rate)
                    for piece in pieces
                ]
                instrument = _overlapping_windows(undisturbed, taps, size)
            # Residuals are whitened, and then scaled to a variance of 1 in each window.
            residuals = signal[:, taps:] - _past_values(setpoint, taps) @ weights
            whitening = _whitening_filter(residuals)
            spread = _filtered(residuals, whitening).std(axis=1)
            scale = np.maximum(spread, spread.max() / MAX_WINDOW_WEIGHT_RATIO + SMALLEST_POSITIVE)[
                :, None
            ]
            estimate = _regularised_estimate(
                _filtered(setpoint, whitening) / scale,
                _filtered(signal, whitening) / scale,
                _filtered(instrument, whitening) / scale,
                taps,
            )
            weights = estimate.weights
    return estimate


def _setpoint_without_wind(
    piece: Array, angle_gain: float, weights: Array, sampling_rate: float
) -> Array:
    """Returns the part of a rate's setpoint that follows what pilot or navigation ask for: x / (1 + G T / s).

    Here x = r + G φ is what they ask for, and 1 / (1 + G T / s) the closed loop of the attitude, from x to r. It is
    applied in the frequency domain. What is left out is what wind does to the setpoint through the angle.

    Args:
        piece: (3, N) setpoint r, rate and angle φ, of which x = r + G φ is made.
        angle_gain: G, 1/s.
        weights: (K,) impulse response of T.
        sampling_rate: Hz.

    Returns:
        (N,) setpoint.
    """
    size = piece.shape[1]
    outer_setpoint = piece[0] + angle_gain * piece[2]
    # The Fourier transform is periodic: mirrored, the series has no step from its end to its beginning.
    mirrored = np.append(outer_setpoint, outer_setpoint[::-1])
    transform = np.fft.rfft(mirrored)
    frequency = np.fft.rfftfreq(2 * size, 1 / sampling_rate)
    # The integral divides by s, which must not be 0.
    positive = np.maximum(frequency, frequency[1] / 100)
    s = 2j * np.pi * positive
    closed = np.fft.rfft(np.append(0.0, weights), 2 * size)
    undisturbed = transform / (1 + angle_gain * closed / s)
    return np.fft.irfft(undisturbed, 2 * size)[:size]


def _overlapping_windows(series: Sequence[Array], taps: int, size: int) -> Array:
    """Returns windows (W, size) of several series, at most ``MAX_WINDOWS``, each overlapping the last by ``taps``.

    A sample is explained by the ``taps`` setpoints before it. So the first ``taps`` samples of a window only explain
    later ones, and windows overlap by as many, so that no sample between them is left out. The first ``2 taps`` samples
    of each series are left out: there, a response may come from before its beginning.

    Args:
        series: (N,) each; those too short for a window have none.
        taps: K, samples of overlap: a window's first K samples only precede those that are explained.
        size: samples of a window.
    """
    views = [
        np.lib.stride_tricks.sliding_window_view(values[2 * taps :], size)[:: size - taps]
        for values in series
        if len(values) >= 2 * taps + size
    ]
    # An empty window makes the table two-dimensional where no series is long enough.
    windows = np.concatenate([*views, np.zeros((0, size))])
    stride = max(-(-len(windows) // MAX_WINDOWS), 1)
    return windows[::stride]


def _past_values(windows: Array, taps: int) -> Array:
    """Returns the values before each sample: the regressors of a finite impulse response.

    Args:
        windows: (W, B + taps) samples of each window.
        taps: how many values before a sample.

    Returns:
        (W, B, taps) the last value first. The first ``taps`` samples of a window, before which too few are known, have
        none.
    """
    # The last view ends with the last sample, and precedes none. Views are reversed in time.
    return np.lib.stride_tricks.sliding_window_view(windows, taps, axis=1)[:, :-1, ::-1]


def _filtered(windows: Array, coefficients: Array) -> Array:
    """Returns each window through a finite-impulse-response filter, without the filter's transient.

    Args:
        windows: (W, B) samples.
        coefficients: (P,) of the filter, that of the latest sample first.

    Returns:
        (W, B − P + 1).
    """
    views = np.lib.stride_tricks.sliding_window_view(windows, len(coefficients), axis=1)
    return views @ coefficients[::-1]


def _whitening_filter(residuals: Array) -> Array:
    """Returns the filter that makes residuals white, as least squares takes them to be.

    It is a difference, which removes their mean, followed by the prediction error of an autoregression of order
    ``AUTOREGRESSION_ORDER``, fitted by the Yule-Walker equations. Both filters in series are one, by convolution.

    Args:
        residuals: (W, B) of all windows, which share one filter.

    Returns:
        (P,) coefficients, that of the latest sample first.
    """
    differences = np.diff(residuals, axis=1)
    size = differences.shape[1]
    autocovariance = [
        np.mean(differences[:, : size - lag] * differences[:, lag:])
        for lag in range(AUTOREGRESSION_ORDER + 1)
    ]
    # A little white noise keeps the equations regular.
    autocovariance[0] *= 1 + 1e-6
    coefficients = solve_toeplitz(autocovariance[:-1], autocovariance[1:])
    prediction_error = np.append(1.0, -coefficients)
    return np.convolve(prediction_error, [1.0, -1.0])


def _regularised_estimate(
    setpoint: Array, signal: Array, instrument: Array, taps: int
) -> ImpulseResponse:
    """Returns the weights of the past setpoints that explain a signal, by a regularised instrumental-variable estimate.

    With regressors X of the setpoint, Z of the instrument, target y, prior covariance Q and the observation that the
    weights add up to 1 ± ``STEADY_STATE_ERROR``, sᵀ w = 1 / error with s = 1 / error:

        w = (I + Q (Zᵀ X + s sᵀ))⁻¹ Q (Zᵀ y + s / error)

    The covariance has three parts. The windows' scores Zᵀ residual, one of each window, show how the estimate scatters
    with noise, whatever the noise is like (as of a jackknife). The prior pulls weights that the flight does not show.
    The steady state is uncertain by its error.

    Args:
        setpoint, signal, instrument: (W, B) windows, whitened, with residuals of variance 1.
        taps: K, number of weights.
    """
    regressors = _past_values(setpoint, taps)
    instruments = _past_values(instrument, taps)
    target = signal[:, taps:]
    over_windows_and_samples = ((0, 1), (0, 1))
    instrument_products = np.tensordot(instruments, instruments, axes=over_windows_and_samples)
    regressor_products = np.tensordot(instruments, regressors, axes=over_windows_and_samples)
    target_products = np.tensordot(instruments, target, axes=over_windows_and_samples)
    steady_state = np.full(taps, 1 / STEADY_STATE_ERROR)
    steady_state_products = np.outer(steady_state, steady_state)
    precision = instrument_products + steady_state_products
    moment = target_products + steady_state / STEADY_STATE_ERROR
    prior = _prior_covariance(precision, moment)
    information = regressor_products + steady_state_products
    identity = np.eye(taps)
    inverse = np.linalg.solve(identity + prior @ information, prior)
    weights = inverse @ moment

    # Indices of the scores: w the window, b its samples, k the weights.
    residuals = target - regressors @ weights
    scores = np.einsum("wbk,wb->wk", instruments, residuals) @ inverse.T
    effective_parameters = np.trace(inverse @ regressor_products)
    windows = len(signal)
    # As of a jackknife: each window draws the estimate towards itself.
    degrees_of_freedom = max(windows - effective_parameters, windows / 4)
    sampling_covariance = scores.T @ scores * windows / degrees_of_freedom
    shrinkage = identity - inverse @ information
    shrinkage_covariance = shrinkage @ prior @ shrinkage.T
    by_steady_state = inverse @ steady_state
    steady_state_covariance = np.outer(by_steady_state, by_steady_state)
    covariance = sampling_covariance + shrinkage_covariance + steady_state_covariance
    return ImpulseResponse(weights, covariance, windows)


def _prior_covariance(precision: Array, moment: Array) -> Array:
    """Returns the prior covariance (K, K) of the weights: the mean over variances and decays by their evidence.

    A prior is λ Q of a variance λ and a shape Q = R Rᵀ that depends on the decay. With the eigenvalues v and vectors U
    of Rᵀ precision R, its log evidence is ½ Σ (λ (Uᵀ Rᵀ moment)² / (1 + λ v) − log(1 + λ v)).

    How smooth and how long a response is, is not known beforehand. So priors of several variances and decays are tried,
    and each counts by how well it explains the flight (Bayesian model averaging).

    Args:
        precision: (K, K) of the weights by the flight.
        moment: (K,) precision times the weights that the flight alone would give.
    """
    taps = len(moment)
    # From 0 to 1, with the duration of the response as the unit.
    time = np.linspace(0.0, 1.0, taps + 1)
    tail = TAIL_VARIANCE_RATIO * _decaying_matern(time, TAIL_LENGTH, TAIL_DECAY)
    shapes = []
    log_evidence = []
    for decay in PRIOR_DECAYS:
        process = _decaying_matern(time, PRIOR_LENGTH, decay) + tail
        # The response begins at 0: the process is conditioned on that.
        from_zero = process - np.outer(process[0], process[0]) / process[0, 0]
        shape = from_zero[1:, 1:] / taps**2
        jitter = JITTER * np.trace(shape) / taps * np.eye(taps)
        root = np.linalg.cholesky(shape + jitter)
        eigenvalues, eigenvectors = np.linalg.eigh(root.T @ precision @ root)
        variances = PRIOR_VARIANCES[:, None]
        gained_precision = variances * np.maximum(eigenvalues, 0.0)
        projected_moment = eigenvectors.T @ (root.T @ moment)
        explained = variances * projected_moment**2 / (1 + gained_precision)
        shapes.append(shape)
        log_evidence.append((explained - np.log1p(gained_precision)).sum(axis=1) / 2)
    # The evidence becomes weights of sum 1 over all decays (rows) and variances (columns).
    variance_by_decay = softmax(log_evidence) @ PRIOR_VARIANCES
    return np.tensordot(variance_by_decay, shapes, axes=1)


def _decaying_matern(time: Array, length: float, decay: float) -> Array:
    """Returns Matérn's covariance of order 5/2 with an exponentially decaying amplitude.

        k(t, t') = (1 + d + d² / 3) e^(−d) e^(−(t + t') / decay),    d = √5 |t − t'| / length

    Args:
        time: (K,) instants.
        length: over which values are alike, in the unit of time.
        decay: over which the variance falls by e², in the unit of time.

    Returns:
        (K, K) covariance.
    """
    difference = np.abs(np.subtract.outer(time, time))
    distance = difference * 5**0.5 / length
    polynomial = 1 + distance + distance**2 / 3
    correlation = polynomial * np.exp(-distance)
    amplitude = np.exp(-np.add.outer(time, time) / decay)
    return correlation * amplitude
