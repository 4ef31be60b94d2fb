"""The uncertainty of θ: the sandwich covariance (HAC), and what the data do not determine.

DEM's posterior counts every sample as independent of its neighbours and keeps X fixed for θ; both make it too small.
The estimate maximizes a sum over samples. With H the sum's curvature and J the covariance of its slope, its covariance
is H⁻¹ J H⁻¹, also for correlated samples (Huber 1967, White 1982). J is estimated from the slopes of single samples,
with a kernel as wide as their own correlation (Andrews 1991).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len

from mavdem.confidence import half_width
from mavdem.dem.engine.ascent import Ascent, theta_curvature_of_profile
from mavdem.dem.engine.free_energy import Belief, expected_weights
from mavdem.dem.engine.generative import GenerativeModel, SufficientStatistics
from mavdem.dem.engine.linalg import Array, inverse, raise_on_overflow
from mavdem.dem.engine.model import unpack

MAX_CORRELATION = 0.999  # of neighbouring slopes, in the kernel's width
MIN_DEGREES_OF_FREEDOM = 8.0  # that a covariance is estimated with: the limit of the kernel's width
SHOWN_ENTRIES = 4  # of a direction, the heaviest, in its ``repr``


class SandwichCovariance(NamedTuple):
    """The covariance of the estimate of θ over data of this kind."""

    covariance: Array  # (k, k)
    freedom: float  # degrees of freedom it is estimated with: deviations have Student's distribution

    def half_width(self, level: float) -> Array:
        """(k,) of the interval about the estimate that holds the parameter with probability ``level``."""
        return half_width(self.covariance.diagonal(), level, self.freedom)


class ParameterUncertainty(NamedTuple):
    """The uncertainty of θ at the end of a fit, in its units."""

    information: Array  # (k, k) of the data: the curvature of F̄ without its prior, samples counted as independent
    scatter: SandwichCovariance | None  # ``None`` where F̄ has no maximum


def uncertainty_of(
    model: GenerativeModel, segments: Sequence[Array], ascent: Ascent, scattered: bool = True
) -> ParameterUncertainty:
    """The uncertainty of the parameters at the end of a fit to generalized data [ỹ; η̃], (T, ·) for each segment.

    Unless ``scattered``, what the data determine is known and the sandwich covariance is not.
    """
    samples, belief, prior = SufficientStatistics.of(*segments), ascent.belief, model.prior.theta_precision
    information = np.zeros_like(prior)
    try:
        with raise_on_overflow():
            curvature = theta_curvature_of_profile(model, samples, belief)
            information = curvature - prior
            if not scattered:
                return ParameterUncertainty(information, None)
            bread = inverse(curvature)
            spread, freedom = long_run_covariance(
                [sample_slopes(model, data, data @ ascent.state_map.T, belief) for data in segments]
            )
            return ParameterUncertainty(information, SandwichCovariance(bread @ (spread + prior) @ bread, freedom))
    except np.linalg.LinAlgError:
        return ParameterUncertainty(information, None)


def sample_slopes(model: GenerativeModel, data: Array, states: Array, belief: Belief) -> Array:
    """(T, k) ∂F(t)/∂θ of samples [ỹ; η̃] (T, ·) with means of X (T, ·), but for what is the same in all of them."""
    both, _, x, _ = model.orders
    joint = np.hstack([data, states, np.zeros((len(data), 1))])
    errors = joint[:, :-1] @ model.error_operator(belief.theta).T
    of_y, _, of_x = model.errors
    weights = expected_weights(belief.lambda_, belief.lambda_covariance)
    slopes = np.zeros((len(data), len(belief.theta)))
    for rows, regressors, S, noise, part in (
        (model.parameter_rows.dynamics, both, model.state_correlation, weights[model.state_groups], of_x),
        (model.parameter_rows.observation, x, model.output_correlation, weights[model.output_groups], of_y),
    ):
        weighted = np.einsum("ik,tij->tkj", S, errors[:, part].reshape(len(data), len(S), -1)) * noise
        slopes[:, rows] = np.einsum("tkj,tka->tja", weighted, joint[:, regressors])
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
    correlation = np.clip(correlation, -MAX_CORRELATION, MAX_CORRELATION)
    # Each row counts alike: scaled by its variance, the innovations' is 1 − ρ².
    innovation = (1 - correlation**2) ** 2
    alpha = np.sum(4 * correlation**2 * innovation / (1 - correlation) ** 8) / np.sum(
        innovation / (1 - correlation) ** 4
    )
    width = min(1.3221 * (alpha * number) ** 0.2, number / MIN_DEGREES_OF_FREEDOM)
    longest = max(map(len, segments))
    lags = np.arange(1, longest)
    kernel = _quadratic_spectral(lags / width) if width > 0 else np.zeros(len(lags))
    total = np.zeros((len(mean), len(mean)))
    for rows in centred:
        total += rows.T @ rows + _lagged(rows, kernel)
    # As many rows as the kernel's width count as one; its square's integral is 1 (Priestley 1981, sec. 6.2.4).
    return total, max(number / max(width, 1.0), 1.0)


def _lagged(rows: Array, kernel: Array) -> Array:
    """Σ_l kernel(l) (Γ_l + Γ_lᵀ) with Γ_l = Σ_t rows(t) rows(t + l)ᵀ, by one convolution with the kernel."""
    lags = len(rows) - 1
    if lags < 1:
        return np.zeros((rows.shape[1], rows.shape[1]))
    both_sides = np.concatenate([kernel[:lags][::-1], [0.0], kernel[:lags]])
    size = next_fast_len(2 * len(rows) + lags, real=True)
    smoothed = np.fft.irfft(np.fft.rfft(rows, size, axis=0) * np.fft.rfft(both_sides, size)[:, None], size, axis=0)
    return np.asarray(rows.T @ smoothed[lags : lags + len(rows)])


def _quadratic_spectral(x: Array) -> Array:
    """The kernel of that name, at x ≠ 0."""
    z = 6 * np.pi * x / 5
    return np.asarray(25 / (12 * np.pi**2 * x**2) * (np.sin(z) / z - np.cos(z)))


class Direction(NamedTuple):
    """A combination of parameters that the data determine less than the prior does."""

    weights: Array  # (k,) of θ = [vec(Aᵀ); vec(Bᵀ); vec(Cᵀ)], of unit length in prior standard deviations
    share: float  # the information of the data over that of the prior, 0 to 1
    sizes: tuple[int, int, int]  # n, r and m

    def __repr__(self) -> str:
        """The heaviest entries, as ``learned.model`` is indexed."""
        indices = unpack(np.arange(len(self.weights)), *self.sizes)
        heaviest = [i for i in np.argsort(-np.abs(self.weights), kind="stable")[:SHOWN_ENTRIES] if self.weights[i]]
        entries = (
            f"{self.weights[i]:+.2g} {name}[{row},{column}]"
            for i in heaviest
            for name, matrix in zip("ABC", indices, strict=True)
            for row, column in np.argwhere(matrix == i)
        )
        rest = " …" if np.count_nonzero(self.weights) > len(heaviest) else ""
        return f"<Direction: {' '.join(entries)}{rest}, {self.share:.2g} of the prior's information from data>"


def undetermined_directions(
    information: Array, precision: Array, free: NDArray[np.bool_], sizes: tuple[int, int, int]
) -> tuple[Direction, ...]:
    """The directions among ``free`` parameters that the data determine less than the prior, the least determined first.

    ``information`` of the data and ``precision`` of the prior are (k, k).
    """
    kept = np.flatnonzero(free)
    block = np.ix_(kept, kept)
    values, vectors = np.linalg.eigh(precision[block])
    to_units = (vectors / np.sqrt(values)) @ vectors.T
    shares, modes = np.linalg.eigh(to_units @ information[block] @ to_units)
    weights = np.zeros((len(kept), len(free)))
    weights[:, kept] = modes.T
    return tuple(
        Direction(mode, max(float(share), 0.0), sizes) for share, mode in zip(shares, weights, strict=True) if share < 1
    )


def marginal_information(information: Array, precision: Array, kept: NDArray[np.intp]) -> Array:
    """Information on the parameters at indices ``kept``, with the others, under their prior, marginalised."""
    others = np.setdiff1d(np.arange(len(information)), kept)
    of_kept = information[np.ix_(kept, kept)]
    cross = information[np.ix_(kept, others)]
    of_others = information[np.ix_(others, others)] + precision[np.ix_(others, others)]
    return np.asarray(of_kept - cross @ np.linalg.pinv(of_others, hermitian=True) @ cross.T)
