"""Linear-Gaussian filters and smoothers: the steady gain, the steady filter and its smoother, and the smoother of EM.

A filter of a time-invariant system becomes steady. Its covariance then solves Riccati's equation, its gain is constant,
and every pass over the samples is a linear recursion with constant coefficients, which is vectorized.

The steady filter is exact for a first state that is as uncertain as its later ones. What a first state is more
uncertain than that, Δ = P₀ − P, is one more unknown ζ of the whole segment: it appears in the innovations as C Lᵗ ζ,
with L = Φ − K C the filter's transition, and is estimated from them by least squares. Its backward pass is the
disturbance smoother: x̂ₜ + P rₜ₋₁ with rₜ₋₁ = Cᵀ eₜ / F + Lᵀ rₜ (de Jong, "A cross-validation filter for time series
models", Biometrika 75, 1988; Durbin and Koopman, Time Series Analysis by State Space Methods, 2nd ed., sec. 4.4). It
inverts no covariance of states.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mavdem.dem.engine.linalg import Array
from mavdem.dem.engine.model import recursion

MAX_DOUBLINGS, MAX_STEPS = 40, 60  # of the time over which the filter becomes steady, and single steps after it
STEADY = 1e-11  # change of a covariance, relative to its largest entry, below which it is steady
NEGLIGIBLE = 1e-12  # of a variance: what is less of it no longer counts


def steady_covariance(A: Array, C: Array, Q: Array, R: Array, S: Array | None = None) -> Array:
    """Returns (…, n, n) the covariance of the predicted state of x⁺ = A x + w, y = C x + v, once it is steady.

    ``Q`` (…, n, n), ``R`` (…, m, m) and ``S`` (…, n, m) are the covariances E wwᵀ, E vvᵀ and E wvᵀ; leading axes are
    systems side by side. By doubling of the steps (Anderson, "Second-order convergent algorithms for the steady-state
    Riccati equation", International Journal of Control 28, 1978), and by single steps where that lost digits. It
    overflows, or stays unsteady, where there is no steady filter.
    """
    eye, Ct = np.eye(A.shape[-1]), np.swapaxes(C, -1, -2)
    crossed = np.zeros((A.shape[-1], C.shape[-2])) if S is None else S
    seen = np.linalg.solve(R, C)
    across, gained = np.swapaxes(A - crossed @ seen, -1, -2), Ct @ seen
    P = Q - crossed @ np.linalg.solve(R, np.swapaxes(crossed, -1, -2))
    for _ in range(MAX_DOUBLINGS):
        solved = np.linalg.inv(eye + gained @ P)
        half, back = across @ solved, np.swapaxes(across, -1, -2)
        doubled = P + back @ P @ solved @ across
        gained, across = gained + half @ gained @ back, half @ across
        P, before = (doubled + np.swapaxes(doubled, -1, -2)) / 2, P
        if np.abs(P - before).max() <= STEADY * np.abs(P).max():
            break
    for _ in range(MAX_STEPS):
        gain = _gain(A, C, P, R, crossed)
        kept, mixed = A - gain @ C, gain @ np.swapaxes(crossed, -1, -2)
        # In Joseph's form it stays positive.
        after = kept @ P @ np.swapaxes(kept, -1, -2) + gain @ R @ np.swapaxes(gain, -1, -2) + Q
        after = after - mixed - np.swapaxes(mixed, -1, -2)
        P, before = (after + np.swapaxes(after, -1, -2)) / 2, P
        if not np.abs(P - before).max() > STEADY * np.abs(P).max():
            break
    return P


def steady_gain(A: Array, C: Array, Q: Array, R: Array, S: Array | None = None) -> tuple[Array, Array]:
    """Returns the gain (n, m) K of x̂⁺ = A x̂ + K (y − C x̂), with which A − K C is stable, and the covariance (n, n).

    The arguments are those of :func:`steady_covariance`, of one system.

    Raises:
        numpy.linalg.LinAlgError: there is no steady filter: no output shows an unstable state.
    """
    with np.errstate(all="ignore"):
        P = steady_covariance(A, C, Q, R, S)
        gain = _gain(A, C, P, R, np.zeros((len(A), len(C))) if S is None else S)
    if not (np.isfinite(gain).all() and np.abs(np.linalg.eigvals(A - gain @ C)).max() < 1):
        raise np.linalg.LinAlgError("there is no steady filter: an unstable state may not be seen in the outputs")
    return gain, P


def _gain(A: Array, C: Array, P: Array, R: Array, S: Array) -> Array:
    Ct = np.swapaxes(C, -1, -2)
    return np.swapaxes(np.linalg.solve(C @ P @ Ct + R, np.swapaxes(A @ P @ Ct + S, -1, -2)), -1, -2)


class SteadySmoothed(NamedTuple):
    """Of a segment given all of it: mean and variance (T,) of a sum of states, and the filter's states (T, n)."""

    mean: Array
    variance: Array
    states: Array


class SteadyFilter(NamedTuple):
    """The steady Kalman filter of x⁺ = Φ x + push + w, whose first state is measured with white noise.

    Attributes:
        transition: (n, n) Φ.
        covariance: (n, n) P of the predicted state.
        gain: (n,) K.
        variance: F of the innovations.
        closed: (n, n) L = Φ − K C.
    """

    transition: Array
    covariance: Array
    gain: Array
    variance: float
    closed: Array

    @classmethod
    def of(cls, transition: Array, process: Array, noise: float) -> SteadyFilter:
        """Returns that for w of covariance ``process`` (n, n), and a measurement of standard deviation ``noise``.

        Raises:
            numpy.linalg.LinAlgError: there is no steady filter.
        """
        C = np.eye(1, len(transition))
        gain, P = steady_gain(transition, C, process, np.array([[noise**2]]))
        return cls(transition, P, gain[:, 0], float(P[0, 0]) + noise**2, transition - gain @ C)

    def step(self, state: Array, push: Array, error: float) -> Array:
        """Returns (n,) the next sample's state, from a sample's and the ``error`` of its prediction."""
        return np.asarray(self.transition @ state + push + self.gain * error)

    def predicted(self, pushes: Array, measured: Array, first: Array) -> Array:
        """Returns (T, n) the states, each given the samples before it, from the ``first`` (n,) on."""
        return np.vstack([first, recursion(self.closed, pushes + measured[:-1, None] * self.gain, first)])

    def weights(self, number: int, read: Array) -> Array:
        """Returns (number,) weights of a sample's innovation and of those after it, in the smoothed ``read`` · x."""
        weights = np.zeros(number)
        heard = _powers(self.closed, number)[:, 0] @ self.covariance @ read
        weights[: len(heard)] = heard / self.variance
        return weights

    def smoothed(self, pushes: Array, measured: Array, first: Array, uncertainty: Array, read: Array) -> SteadySmoothed:
        """Returns ``read`` · x in a segment, from all of it.

        Args:
            pushes: (T − 1, n) of each sample on the state of the next.
            measured: (T,) the measurements.
            first: (n,) mean of the first state.
            uncertainty: (n, n) its covariance.
            read: (n,) the weights of the states.
        """
        predicted = self.predicted(pushes, measured, first)
        errors, F = measured - predicted[:, 0], self.variance

        powers = _powers(self.closed, len(measured))
        heard, short, excess = powers[:, 0], len(powers), uncertainty - self.covariance
        spread = excess @ np.linalg.inv(np.eye(len(read)) + heard.T @ heard @ excess / F)
        zeta = spread @ heard.T @ errors[:short] / F
        errors[:short] -= heard @ zeta
        predicted[:short] += powers @ zeta

        back = np.zeros_like(predicted)
        back[:, 0] = errors[::-1] / F
        later = np.vstack([back[0], recursion(self.closed.T, back[1:], back[0])])[::-1]
        toward = self.covariance @ read
        mean = predicted @ read + later @ toward

        # Sums over the samples from one on: all of those, or as many as are not negligible.
        weights = heard @ toward
        known, left = np.cumsum(weights**2) / F, read - np.cumsum(heard * weights[:, None], axis=0) / F
        following = np.minimum(np.arange(len(measured))[::-1], short - 1)
        variance = read @ toward - known[following]
        slope = np.einsum("tij,ti->tj", powers, left[following[:short]])
        variance[:short] += np.einsum("ti,ij,tj->t", slope, spread, slope)
        return SteadySmoothed(mean, np.maximum(variance, 0.0), predicted)


def _powers(matrix: Array, number: int) -> Array:
    """(h, n, n) the powers of a stable matrix from 0 on, ``number`` of them, or as many as are not negligible."""
    powers, step = np.eye(len(matrix))[None], matrix
    while len(powers) < number and np.abs(powers[-1]).max() > NEGLIGIBLE:
        powers = np.concatenate([powers, powers @ step])
        step = step @ step
    return powers[:number]


class GaussianModel(NamedTuple):
    """x⁺ = A x + B u + offset + w,  y = C x + D u + trim + v; w ~ N(0, Q) and v ~ N(0, R), white and independent."""

    A: Array  # (n, n)
    B: Array  # (n, k)
    offset: Array  # (n,)
    C: Array  # (m, n)
    D: Array  # (m, k)
    trim: Array  # (m,)
    Q: Array  # (n, n)
    R: Array  # (m, m)


class Smoothed(NamedTuple):
    """States of a segment given all of its outputs: means (T, n) and covariances (T, n, n).

    ``lagged`` (T − 1, n, n) are the covariances of each state but the first with the one before it.
    """

    means: Array
    covariances: Array
    lagged: Array
    log_likelihood: float


def smoothed(model: GaussianModel, start: Array, inputs: Array, outputs: Array) -> Smoothed:
    """The smoothed states of one segment (Shumway and Stoffer, Journal of Time Series Analysis 3(4), 1982).

    The first one has mean ``start`` (n,) and the identity as covariance; ``LinAlgError`` where a covariance is not
    positive or not finite.
    """
    A, C, samples = model.A, model.C, len(outputs)
    predicted, gains, filtered, precision_roots = _filter_covariances(model, samples)
    steady = len(gains) - 1
    drives, targets = inputs @ model.B.T + model.offset, outputs - inputs @ model.D.T - model.trim

    ahead = np.empty((samples, len(A)))
    ahead[0] = start
    for t in range(min(steady, samples - 1)):
        ahead[t + 1] = A @ (ahead[t] + gains[t] @ (targets[t] - C @ ahead[t])) + drives[t]
    gain = A @ gains[-1]
    pushes = drives[steady:-1] + targets[steady:-1] @ gain.T
    ahead[steady + 1 :] = recursion(A - gain @ C, pushes, ahead[min(steady, samples - 1)])

    errors = targets - ahead @ C.T
    each = np.minimum(np.arange(samples), steady)
    whitened = np.einsum("tij,tj->ti", precision_roots[each], errors)
    log_roots = np.log(np.abs(np.linalg.det(precision_roots)))[each].sum()
    log_likelihood = float(log_roots - 0.5 * (whitened**2).sum() - 0.5 * errors.size * np.log(2 * np.pi))

    means = ahead + np.einsum("tij,tj->ti", gains[each], errors)
    returns = filtered[:-1] @ A.T @ np.linalg.inv(predicted[1:]) if steady else np.empty((0, *A.shape))
    returns = np.concatenate([returns, (filtered[-1] @ A.T @ np.linalg.inv(A @ filtered[-1] @ A.T + model.Q))[None]])
    pulls = means[:-1] - np.einsum("tij,tj->ti", returns[each[:-1]], ahead[1:])
    means[steady:-1] = recursion(returns[-1], pulls[steady:][::-1], means[-1])[::-1]
    for t in range(min(steady, samples - 1) - 1, -1, -1):
        means[t] = pulls[t] + returns[t] @ means[t + 1]

    covariances = _smoothed_covariances(model, filtered, returns, samples)
    lagged = covariances[1:] @ returns[each[:-1]].swapaxes(1, 2)
    return Smoothed(means, covariances, lagged, log_likelihood)


def _filter_covariances(model: GaussianModel, samples: int) -> tuple[Array, Array, Array, Array]:
    """Of each sample until they are steady: covariance before it, gain, covariance after it, and a root of S⁻¹."""
    A, C, Q, R = model.A, model.C, model.Q, model.R
    eye = np.eye(len(A))
    predicted, gains, filtered, roots = [eye], [], [], []
    for _ in range(samples):
        before = predicted[-1]
        root = np.linalg.inv(np.linalg.cholesky(C @ before @ C.T + R))
        gain = before @ C.T @ root.T @ root
        keep = eye - gain @ C
        # In Joseph's form it stays positive.
        after = keep @ before @ keep.T + gain @ R @ gain.T
        following = A @ after @ A.T + Q
        gains.append(gain)
        filtered.append(after)
        roots.append(root)
        if np.abs(following - before).max() < STEADY * np.abs(before).max():
            break
        predicted.append(following)
    predicted = predicted[: len(gains)]
    if not np.isfinite(predicted[-1]).all():
        raise np.linalg.LinAlgError("the filter's covariance overflows")
    return np.array(predicted), np.array(gains), np.array(filtered), np.array(roots)


def _smoothed_covariances(model: GaussianModel, filtered: Array, returns: Array, samples: int) -> Array:
    """(T, n, n), backward; where gains are constant only until it is steady."""
    steady = len(filtered) - 1
    covariances = np.empty((samples, *model.A.shape))
    covariances[-1] = filtered[-1]
    t = samples - 2
    while t >= 0:
        gain, after = returns[min(t, steady)], filtered[min(t, steady)]
        ahead = model.A @ after @ model.A.T + model.Q
        covariances[t] = after + gain @ (covariances[t + 1] - ahead) @ gain.T
        change = np.abs(covariances[t] - covariances[t + 1]).max()
        if t > steady and change < STEADY * np.abs(covariances[t]).max():
            covariances[steady:t] = covariances[t]
            t = steady
        t -= 1
    return covariances
