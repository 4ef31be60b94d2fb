"""The Kalman filter and the smoother of Rauch, Tung and Striebel: what is expected of states, given all outputs.

Covariances do not depend on the data and soon become steady. From there on gains are constant, and the recursions of
the means are vectorized.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mavdem.dem.engine.linalg import Array
from mavdem.dem.engine.model import recursion

STEADY_TOLERANCE = 1e-11
"""A covariance whose change in a step, relative to its largest entry, is less than this is taken as steady."""


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
        if np.abs(following - before).max() < STEADY_TOLERANCE * np.abs(before).max():
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
        if t > steady and change < STEADY_TOLERANCE * np.abs(covariances[t]).max():
            covariances[steady:t] = covariances[t]
            t = steady
        t -= 1
    return covariances
