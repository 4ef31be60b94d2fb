"""The covariance of θ as the data's own scatter has it: the sandwich estimate.

DEM's posterior counts every sample as independent of its neighbours and holds X fixed while it judges θ; it is too sure
of itself by both. Its estimate maximizes a sum over samples, and how such an estimate scatters is known whatever the
samples owe to each other: with H the sum's curvature and J the covariance of its slope, by H⁻¹ J H⁻¹ (Huber 1967,
White 1982). J is estimated from the slopes of single samples, with as many lags as their own correlation asks for
(Andrews 1991).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from mavdem.dem.ascent import Ascent
from mavdem.dem.breakdown import breaking_down
from mavdem.dem.free_energy import Belief, expected_weights
from mavdem.dem.generative import GenerativeModel, Samples
from mavdem.dem.positive import inverse
from mavdem.dem.profile import theta_curvature_of_profile

Array = NDArray[np.float64]

LARGEST_CORRELATION = 0.999
"""Between neighbouring slopes, as far as the kernel's width goes by it."""

FEWEST_DEGREES = 8.0
"""Of freedom that a covariance is estimated with; no kernel is so wide that fewer are left."""


class Scatter(NamedTuple):
    """How the estimate of θ scatters.

    Attributes:
        covariance: (k, k).
        freedom: degrees of freedom that the covariance itself is estimated with: deviations in its units have
            Student's distribution with so many.
    """

    covariance: Array
    freedom: float

    def half_width(self, level: float) -> Array:
        """(k,) of the interval about the estimate that holds the parameter with probability ``level``."""
        return np.asarray(student.ppf(0.5 + level / 2, self.freedom) * np.sqrt(self.covariance.diagonal()))


class Certainty(NamedTuple):
    """What is known of θ at the end of a climb, in its units.

    Attributes:
        information: (k, k) of the data, each sample counted as independent: the curvature of F̄ without its prior.
        scatter: of the estimate; ``None`` where F̄ has no maximum.
    """

    information: Array
    scatter: Scatter | None


def certainty_of(model: GenerativeModel, segments: Sequence[Array], ascent: Ascent) -> Certainty:
    """What is known of the parameters at the end of a climb.

    Args:
        model: that was fitted.
        segments: generalized data [ỹ; η̃], (T, ·) each; slopes correlate within a segment only.
        ascent: the climb.
    """
    samples, belief, prior = Samples.of(*segments), ascent.belief, model.prior.theta_precision
    information = np.zeros_like(prior)
    try:
        with breaking_down():
            curvature = theta_curvature_of_profile(model, samples, belief)
            information = curvature - prior
            bread = inverse(curvature)
            spread, freedom = long_run_covariance(
                [sample_slopes(model, data, data @ ascent.state_map.T, belief) for data in segments]
            )
            return Certainty(information, Scatter(bread @ (spread + prior) @ bread, freedom))
    except np.linalg.LinAlgError:
        return Certainty(information, None)


def sample_slopes(model: GenerativeModel, data: Array, states: Array, belief: Belief) -> Array:
    """∂F(t)/∂θ of every sample, (T, k), but for what is the same in all of them.

    Args:
        model: the model.
        data: (T, ·) generalized data [ỹ; η̃].
        states: (T, dim X) means of X.
        belief: θ and λ.
    """
    both, _, x, _ = model.orders
    joint = np.hstack([data, states, np.zeros((len(data), 1))])
    errors = joint[:, :-1] @ model.error_operator(belief.theta).T
    of_y, _, of_x = model.errors
    weights = expected_weights(belief.lambda_, belief.lambda_covariance)
    slopes = np.zeros((len(data), len(belief.theta)))
    for rows, places, S, noise, of in (
        (model.parameter_rows.dynamics, both, model.state_correlation, weights[model.state_groups], of_x),
        (model.parameter_rows.observation, x, model.output_correlation, weights[model.output_groups], of_y),
    ):
        weighted = np.einsum("ik,tij->tkj", S, errors[:, of].reshape(len(data), len(S), -1)) * noise
        slopes[:, rows] = np.einsum("tkj,tka->tja", weighted, joint[:, places])
    return slopes


def long_run_covariance(segments: Sequence[Array]) -> tuple[Array, float]:
    """Covariance (k, k) of the sum of correlated rows (T, k) of segments, and the degrees of freedom it has.

    The quadratic spectral kernel, with its width by the plug-in of first-order autoregressions: Andrews (1991),
    Eqs. 2.7, 6.2 and 6.4.
    """
    number = sum(map(len, segments))
    mean = sum(rows.sum(axis=0) for rows in segments) / number
    centred = [rows - mean for rows in segments]
    now = np.concatenate([rows[:-1] for rows in centred])
    later = np.concatenate([rows[1:] for rows in centred])
    variance = np.sum(now**2, axis=0)
    moving = variance > 0
    if not moving.any():
        return np.zeros((len(mean), len(mean))), float(number)
    correlation = np.sum(now * later, axis=0)[moving] / variance[moving]
    correlation = np.clip(correlation, -LARGEST_CORRELATION, LARGEST_CORRELATION)
    # Each row counts alike: scaled by its variance, the innovations' is 1 − ρ².
    innovation = (1 - correlation**2) ** 2
    alpha = np.sum(4 * correlation**2 * innovation / (1 - correlation) ** 8) / np.sum(
        innovation / (1 - correlation) ** 4
    )
    width = min(1.3221 * (alpha * number) ** 0.2, number / FEWEST_DEGREES)
    longest = max(map(len, segments))
    lags = np.arange(1, longest)
    kernel = _quadratic_spectral(lags / width) if width > 0 else np.zeros(len(lags))
    total = np.zeros((len(mean), len(mean)))
    for rows in centred:
        total += rows.T @ rows + _lagged(rows, kernel)
    # As many rows as the kernel is wide count as one; its square's integral is 1 (Priestley 1981, sec. 6.2.4).
    return total, max(number / max(width, 1.0), 1.0)


def _lagged(rows: Array, kernel: Array) -> Array:
    """Σ_l kernel(l) (Γ_l + Γ_lᵀ) with Γ_l = Σ_t rows(t) rows(t + l)ᵀ, by one convolution with the kernel."""
    lags = len(rows) - 1
    if lags < 1:
        return np.zeros((rows.shape[1], rows.shape[1]))
    both_sides = np.concatenate([kernel[:lags][::-1], [0.0], kernel[:lags]])
    size = 2 * len(rows) + lags
    smoothed = np.fft.irfft(np.fft.rfft(rows, size, axis=0) * np.fft.rfft(both_sides, size)[:, None], size, axis=0)
    return np.asarray(rows.T @ smoothed[lags : lags + len(rows)])


def _quadratic_spectral(x: Array) -> Array:
    """The kernel of that name, at x ≠ 0."""
    z = 6 * np.pi * x / 5
    return np.asarray(25 / (12 * np.pi**2 * x**2) * (np.sin(z) / z - np.cos(z)))
