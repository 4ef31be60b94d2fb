"""Linear-Gaussian filters and smoothers: the steady gain, the steady filter and its smoother, and the smoother of EM.

A filter of a time-invariant system becomes steady: every pass over the samples is then a linear recursion with constant
coefficients, which is vectorized.

The steady filter is exact for a first state that is as uncertain as its later ones. Its backward pass is the
disturbance smoother: x̂ₜ + P rₜ₋₁ with rₜ₋₁ = Cᵀ eₜ / F + Lᵀ rₜ and L = Φ − K C (Durbin and Koopman, Time Series
Analysis by State Space Methods, 2nd ed., sec. 4.4). It inverts no covariance of states.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mavdem.dem.engine.linalg import Array, inverse
from mavdem.dem.engine.model import recursion

MAX_STEPS = (
    60  # that double the time over which the filter becomes steady, and single ones after them
)
STEADY = 1e-11  # change of a covariance, relative to its largest entry, below which it is steady


def steady_covariance(A: Array, C: Array, Q: Array, R: Array, S: Array | None = None) -> Array:
    """Returns (…, n, n) the covariance of the predicted state of x⁺ = A x + w, y = C x + v, once it is steady.

    ``Q`` (…, n, n), ``R`` (…, m, m) and ``S`` (…, n, m) are the covariances E wwᵀ, E vvᵀ and E wvᵀ; leading axes are
    systems side by side. By doubling of the steps (Anderson, "Second-order convergent algorithms for the steady-state
    Riccati equation", International Journal of Control 28, 1978), and by single steps where that lost digits. It
    overflows, or stays unsteady, where there is no steady filter.
    """
    eye = np.eye(A.shape[-1])
    Ct = np.swapaxes(C, -1, -2)
    crossed = np.zeros((A.shape[-1], C.shape[-2])) if S is None else S
    seen = np.linalg.solve(R, C)
    across = np.swapaxes(A - crossed @ seen, -1, -2)
    gained = Ct @ seen
    P = Q - crossed @ np.linalg.solve(R, np.swapaxes(crossed, -1, -2))
    for _ in range(MAX_STEPS):
        solved = np.linalg.inv(eye + gained @ P)
        half = across @ solved
        back = np.swapaxes(across, -1, -2)
        doubled = P + back @ P @ solved @ across
        gained = gained + half @ gained @ back
        across = half @ across
        P, before = (doubled + np.swapaxes(doubled, -1, -2)) / 2, P
        if np.abs(P - before).max() <= STEADY * np.abs(P).max():
            break
    for _ in range(MAX_STEPS):
        P, before = _following(A, C, P, Q, R, crossed, _gain(A, C, P, R, crossed)), P
        if not np.abs(P - before).max() > STEADY * np.abs(P).max():
            break
    return P


def steady_gain(
    A: Array, C: Array, Q: Array, R: Array, S: Array | None = None
) -> tuple[Array, Array]:
    """Returns the gain (n, m) K of x̂⁺ = A x̂ + K (y − C x̂), with which A − K C is stable, and the covariance (n, n).

    The arguments are those of :func:`steady_covariance`, of one system; ``LinAlgError`` where no filter is steady.
    """
    with np.errstate(all="ignore"):
        P = steady_covariance(A, C, Q, R, S)
        gain = _gain(A, C, P, R, np.zeros((len(A), len(C))) if S is None else S)
    if not (np.isfinite(gain).all() and np.abs(np.linalg.eigvals(A - gain @ C)).max() < 1):
        raise np.linalg.LinAlgError(
            "there is no steady filter: an unstable state may not be seen in the outputs"
        )
    return gain, P


def _gain(A: Array, C: Array, P: Array, R: Array, S: Array) -> Array:
    Ct = np.swapaxes(C, -1, -2)
    return np.swapaxes(np.linalg.solve(C @ P @ Ct + R, np.swapaxes(A @ P @ Ct + S, -1, -2)), -1, -2)


def _following(A: Array, C: Array, P: Array, Q: Array, R: Array, S: Array, gain: Array) -> Array:
    """The covariance one step later; in Joseph's form it stays positive."""
    kept = A - gain @ C
    turned = np.swapaxes(gain, -1, -2)
    added = Q + (gain @ R - 2 * S) @ turned
    after = kept @ P @ np.swapaxes(kept, -1, -2) + added
    return (after + np.swapaxes(after, -1, -2)) / 2


class SteadySmoothed(NamedTuple):
    """Of a segment given all of it: mean and variance (T,) of a sum of states, and the filter's states (T, n)."""

    mean: Array
    variance: Array
    states: Array


class SteadyFilter(NamedTuple):
    """The steady Kalman filter of x⁺ = Φ x + push + w, whose first state is measured with white noise."""

    transition: Array  # (n, n) Φ
    covariance: Array  # (n, n) P of the predicted state
    gain: Array  # (n,) K
    variance: float  # F of the innovations
    closed: Array  # (n, n) L = Φ − K C

    @classmethod
    def of(cls, transition: Array, process: Array, noise: float) -> SteadyFilter:
        """Returns that for w of covariance ``process`` (n, n) and a measurement of sd ``noise``, or ``LinAlgError``."""
        C = np.eye(1, len(transition))
        gain, P = steady_gain(transition, C, process, np.array([[noise**2]]))
        return cls(transition, P, gain[:, 0], float(P[0, 0]) + noise**2, transition - gain @ C)

    def step(self, state: Array, push: Array, error: float) -> Array:
        """Returns (n,) the next sample's state, from a sample's and the ``error`` of its prediction."""
        return self.transition @ state + push + self.gain * error

    def predicted(self, pushes: Array, measured: Array, first: Array) -> Array:
        """Returns (T, n) the states, each given the samples before it, from the ``first`` (n,) on."""
        return np.vstack(
            [first, recursion(self.closed, pushes + measured[:-1, None] * self.gain, first)]
        )

    def weights(self, number: int, read: Array) -> Array:
        """Returns (number,) weights of a sample's innovation and of those after it, in the smoothed ``read`` · x."""
        first = self.covariance @ read
        following = recursion(self.closed, np.zeros((number - 1, len(read))), first)
        return np.append(first[0], following[:, 0]) / self.variance

    def smoothed(self, pushes: Array, measured: Array, first: Array, read: Array) -> SteadySmoothed:
        """Returns ``read`` (n,) · x in a segment, from all of its samples ``measured`` (T,).

        ``pushes`` (T − 1, n) are of each sample on the state of the next; the first state has mean ``first`` (n,).
        """
        predicted = self.predicted(pushes, measured, first)
        back = np.zeros_like(predicted)
        back[:, 0] = (measured - predicted[:, 0])[::-1] / self.variance
        later = np.vstack([back[0], recursion(self.closed.T, back[1:], back[0])])[::-1]
        toward = self.covariance @ read
        # Each sample is known by the innovations of those from it on.
        known = self.variance * np.cumsum(self.weights(len(measured), read) ** 2)[::-1]
        return SteadySmoothed(predicted @ read + later @ toward, read @ toward - known, predicted)


class KalmanFilter(NamedTuple):
    """The filter of x⁺ = A x + push + w, y = C x + v from an uncertain first state on, until it is steady.

    The last covariance, gain and weight are those of all later samples.
    """

    A: Array  # (n, n)
    C: Array  # (m, n)
    covariances: Array  # (h + 1, n, n) P of the state before each sample
    gains: Array  # (h, n, m) K of each sample
    weights: Array  # (h, m, m) S⁻¹ of the errors of prediction

    @classmethod
    def of(
        cls, A: Array, C: Array, Q: Array, R: Array, S: Array, first: Array, samples: int
    ) -> KalmanFilter:
        """Returns that for noises as in :func:`steady_covariance`, and a first state of covariance ``first`` (n, n).

        Where a covariance overflows, or is none, all from there on are infinite, and their gains 0.
        """
        covariances = [first]
        gains = []
        weights = []
        with np.errstate(over="ignore", invalid="ignore"):
            for _ in range(max(samples, 1)):
                P = covariances[-1]
                seen = covariances[-1] @ C.T
                try:
                    weights.append(inverse(C @ seen + R))
                except np.linalg.LinAlgError:
                    covariances.append(np.full_like(P, np.inf))
                    gains.append(np.zeros_like(S))
                    weights.append(np.zeros_like(R))
                    break
                gains.append((A @ seen + S) @ weights[-1])
                covariances.append(_following(A, C, P, Q, R, S, gains[-1]))
                if np.abs(covariances[-1] - P).max() <= STEADY * np.abs(P).max():
                    break
        return cls(A, C, np.array(covariances), np.array(gains), np.array(weights))

    def covariances_of(self, samples: int) -> Array:
        """Returns (T + 1, n, n) those before each sample and after the last."""
        return self.covariances[np.minimum(np.arange(samples + 1), len(self.covariances) - 1)]

    def states(self, start: Array, pushes: Array, measured: Array) -> tuple[Array, Array]:
        """Returns states (…, T + 1, n) before each sample and after the last, and errors (…, T, m) of predicting it.

        ``start`` is (…, n), ``pushes`` (…, T, n) act on the next state, ``measured`` is (…, T, m); leading axes are
        segments side by side.
        """
        samples = measured.shape[-2]
        last = len(self.gains) - 1
        states = np.empty((*measured.shape[:-2], samples + 1, len(self.A)))
        states[..., 0, :] = start
        single = min(last, samples) if measured.ndim == 2 else samples
        with np.errstate(over="ignore", invalid="ignore"):
            places = np.minimum(np.arange(single), last)
            closed = np.swapaxes(self.A - self.gains @ self.C, 1, 2)[places]
            driven = pushes[..., :single, :] + np.einsum(
                "...tm,tnm->...tn", measured[..., :single, :], self.gains[places]
            )
            for t in range(single):
                states[..., t + 1, :] = states[..., t, :] @ closed[t] + driven[..., t, :]
            if single < samples:
                gain = self.gains[-1]
                driven = pushes[single:] + measured[single:] @ gain.T
                states[single + 1 :] = recursion(self.A - gain @ self.C, driven, states[single])
            return states, measured - states[..., :-1, :] @ self.C.T

    def smoothed(self, states: Array, errors: Array) -> tuple[Array, Array, Array]:
        """Returns means (…, T + 1, n) and covariances (T + 1, n, n) of all states given all measurements.

        By the disturbance smoother, which inverts no covariance of states (de Jong, "Smoothing and interpolation with
        the state-space model", Journal of the American Statistical Association 84(408), 1989). The third are
        covariances (T, n, n) of each state but the first with the one before it.
        """
        samples = errors.shape[-2]
        last = len(self.gains) - 1
        n = len(self.A)
        closed = self.A - self.gains @ self.C
        heard = self.weights @ self.C
        information = np.zeros((samples + 1, n, n))
        pull = np.zeros_like(states)
        with np.errstate(over="ignore", invalid="ignore"):
            t = samples - 1
            while t >= 0:
                place = min(t, last)
                information[t] = (
                    self.C.T @ heard[place] + closed[place].T @ information[t + 1] @ closed[place]
                )
                change = np.abs(information[t] - information[t + 1]).max()
                if t > last and change <= STEADY * np.abs(information[t]).max():
                    information[last + 1 : t] = information[t]
                    t = last + 1
                t -= 1
            single = samples
            if errors.ndim == 2 and samples > last:
                single = last
                drives = (errors[last:] @ heard[-1])[::-1]
                pull[last:-1] = recursion(closed[-1].T, drives, np.zeros(n))[::-1]
            for t in range(single - 1, -1, -1):
                place = min(t, last)
                pull[..., t, :] = (
                    errors[..., t, :] @ heard[place] + pull[..., t + 1, :] @ closed[place]
                )
            P = self.covariances_of(samples)
            means = states + np.einsum("...ti,tij->...tj", pull, P)
            covariances = P - P @ information @ P
            rest = np.eye(n) - P[1:] @ information[1:]
            return means, covariances, rest @ closed[np.minimum(np.arange(samples), last)] @ P[:-1]


class GaussianModel(NamedTuple):
    """x⁺ = A x + B u + offset + w,  y = C x + trim + v; w ~ N(0, Q) and v ~ N(0, R), white and independent."""

    A: Array  # (n, n)
    B: Array  # (n, k)
    offset: Array  # (n,)
    C: Array  # (m, n)
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
    """Returns the smoothed states of one segment, and the likelihood of its outputs.

    The first state has mean ``start`` (n,) and the identity as covariance; ``LinAlgError`` where a covariance is not
    positive or not finite.
    """
    A = model.A
    C = model.C
    eye = np.eye(len(model.A))
    filtered = KalmanFilter.of(
        A, C, model.Q, model.R, np.zeros((len(A), len(C))), eye, len(outputs)
    )
    if not np.isfinite(filtered.covariances).all():
        raise np.linalg.LinAlgError("the filter's covariance overflows")
    pushes = inputs @ model.B.T + model.offset
    measured = outputs - model.trim
    states, errors = filtered.states(start, pushes, measured)
    weights = filtered.weights[np.minimum(np.arange(len(errors)), len(filtered.weights) - 1)]
    squares = np.einsum("ti,tij,tj->", errors, weights, errors)
    log_likelihood = 0.5 * (
        np.linalg.slogdet(weights)[1].sum() - squares - errors.size * np.log(2 * np.pi)
    )
    means, covariances, lagged = filtered.smoothed(states, errors)
    return Smoothed(means[:-1], covariances[:-1], lagged[:-1], float(log_likelihood))
