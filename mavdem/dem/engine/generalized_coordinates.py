"""Generalized coordinates: signals with their time derivatives, and the covariance of smooth noise with its own.

Eq. ``Smatrix`` of the paper is the inverse of that covariance.
"""

from math import factorial

import numpy as np
import scipy

from mavdem.arrays import Array


def taylor_weights(
    order: int,
    dt: float,
    window: int,
    position: float,
) -> Array:
    """Returns the weights of the samples of a window in estimates of a signal and its derivatives.

    They belong to the least-squares polynomial of degree ``order`` over the window (a Savitzky-Golay filter). With
    ``window = order + 1`` the polynomial interpolates the samples, and the weights are the inverse of the Taylor
    matrix, which is the embedding in the DEM literature. A wider window averages measurement noise, but reduces the
    bandwidth.

    Args:
        order: highest derivative.
        dt: sampling step, s.
        window: number of samples, more than ``order``.
        position: position in the window at which the derivatives are taken, in samples from the first one.

    Returns:
        Weights (order + 1, window): row k times the samples is the k-th derivative, per second to the k.
    """
    # The fit is computed in units of the sampling step, in which it is well conditioned, and then scaled to seconds.
    steps_from_position = np.arange(window) - position
    taylor_terms = [steps_from_position**k / factorial(k) for k in range(order + 1)]
    taylor_matrix = np.stack(taylor_terms, axis=1)
    weights_per_step = np.linalg.pinv(taylor_matrix)
    derivative_orders = np.arange(order + 1)
    return weights_per_step / dt ** derivative_orders[:, None]


def embed(
    samples: Array,
    order: int,
    dt: float,
    window: int,
    position: int,
) -> Array:
    """Embeds samples into generalized coordinates, by the polynomial fit of :func:`taylor_weights`.

    Args:
        samples: (T, m) uniformly sampled signals.
        order: highest derivative.
        dt: sampling step, s.
        window: number of samples of the polynomial fit.
        position: sample of the window at which the derivatives are taken.

    Returns:
        Generalized vectors (T − window + 1, (order + 1) · m), order after order. Row i belongs to sample
        i + ``position``. Samples near the ends, whose window would reach beyond the samples, have no row.
    """
    weights = taylor_weights(order, dt, window, position)
    # The correlation centres its window on window // 2 and pads the ends; the padded rows are cut off again.
    samples_before_center = window // 2
    samples_after_center = window - 1 - samples_before_center
    complete_windows = slice(samples_before_center, len(samples) - samples_after_center)
    derivatives = []
    for derivative_weights in weights:
        derivative = scipy.ndimage.correlate1d(samples, derivative_weights, axis=0)
        derivatives.append(derivative[complete_windows])
    return np.hstack(derivatives)


def temporal_covariance(order: int, smoothness: float) -> Array:
    """Returns the covariance of [w, w', w'', …] for smooth noise w of variance 1.

    The noise is white noise filtered by a Gaussian kernel of width s, with the autocorrelation ρ(τ) = exp(−τ²/4s²).
    Entry (i, j) is (−1)ⁱ times the (i + j)-th derivative of ρ at 0, which is zero where i + j is odd (the matrix that
    Eq. ``Smatrix`` inverts).

    Args:
        order: highest derivative of w.
        smoothness: width s of the Gaussian kernel, in seconds.

    Returns:
        Covariance (order + 1, order + 1), entry (i, j) in s^−(i + j).
    """
    covariance = np.zeros((order + 1, order + 1))
    for i in range(order + 1):
        # All j for which i + j = 2k is even.
        for j in range(i % 2, order + 1, 2):
            k = (i + j) // 2
            # The 2k-th derivative of ρ(τ) = exp(−τ²/4s²) at τ = 0, from its Taylor series.
            rho_derivative = (-1) ** k * factorial(2 * k) / factorial(k) / (4 * smoothness**2) ** k
            covariance[i, j] = (-1) ** i * rho_derivative
    return covariance


def temporal_precision(order: int, smoothness: float) -> Array:
    """Returns S(s²), Eq. ``Smatrix``: the precision of [w, w', w'', …] for smooth noise w of variance 1.

    It is the inverse of :func:`temporal_covariance`, computed with the width s as the unit of time: the condition of
    the matrix then does not depend on s.

    Args:
        order: highest derivative of w.
        smoothness: width s of the Gaussian kernel, in seconds.

    Returns:
        Precision (order + 1, order + 1), entry (i, j) in s^(i + j).
    """
    precision_in_widths = scipy.linalg.inv(temporal_covariance(order, smoothness=1.0))
    width_powers = smoothness ** np.arange(order + 1)
    return precision_in_widths * np.outer(width_powers, width_powers)
