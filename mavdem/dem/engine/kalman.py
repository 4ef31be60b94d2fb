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
from numpy.linalg import LinAlgError

from mavdem.arrays import Array, ArrayPair
from mavdem.dem.engine.linalg import may_overflow
from mavdem.dem.engine.model import linear_recursion

STEADY_CHANGE = (
    1e-11  # change of a covariance, relative to its largest entry, below which it is steady
)
MOST_DOUBLINGS = 60  # of steps: a covariance that then still changes has no bound


def steady_state_gain(
    A: Array,
    C: Array,
    Q: Array,
    R: Array,
    S: Array | None = None,
) -> ArrayPair:
    """Returns the gain (…, n, m) K of x̂⁺ = A x̂ + K (y − C x̂), and the covariance (…, n, n) of the predicted state.

    That is of x⁺ = A x + w, y = C x + v, once it is steady, of one system or of several side by side. ``Q`` (…, n, n),
    ``R`` (…, m, m) and ``S`` (…, n, m) are the covariances E wwᵀ, E vvᵀ and E wvᵀ. By doubling the steps of Riccati's
    equation; ``LinAlgError`` where one has no steady filter, with which A − K C is stable.

    Reference: E. K.-W. Chu, H.-Y. Fan, W.-W. Lin and C.-S. Wang, "Structure-preserving algorithms for periodic
    discrete-time algebraic Riccati equations", International Journal of Control 77 (2004).
    """
    n = A.shape[-1]
    identity = np.eye(n)
    crossed = np.zeros((n, C.shape[-2])) if S is None else S
    heard = np.linalg.solve(R, C)
    step = (A - crossed @ heard).mT
    seen = C.mT @ heard
    P = (Q + Q.mT) / 2 - crossed @ np.linalg.solve(R, crossed.mT)
    with np.errstate(all="ignore"):  # what has no bound overflows
        for _ in range(MOST_DOUBLINGS):
            solved = np.linalg.solve(identity + seen @ P, np.concatenate([step, seen], axis=-1))
            more = step.mT @ P @ solved[..., :n]
            seen = seen + step @ solved[..., n:] @ step.mT
            step = step @ solved[..., :n]
            P = P + more
            sizes = (abs(part).max(axis=(-1, -2)) for part in (more, P))
            if np.all(np.divide(*sizes) <= STEADY_CHANGE):
                gain = A @ P @ C.mT + crossed
                return gain @ np.linalg.inv(C @ P @ C.mT + R), P
    raise LinAlgError("there is no steady filter: an unstable state may not be seen")


class SmoothedSignal(NamedTuple):
    """Of a segment given all of it: mean and variance (T,) of a sum of states, and the filter's states (T, n)."""

    mean: Array
    variance: Array
    states: Array


class SteadyStateFilter(NamedTuple):
    """The steady Kalman filter of x⁺ = Φ x + push + w, whose first state is measured with white noise."""

    P: Array  # (n, n) covariance of the predicted state
    K: Array  # (n,) gain
    F: float  # variance of the innovations
    L: Array  # (n, n) Φ − K C

    @classmethod
    def design(cls, transition: Array, process: Array, noise: float) -> SteadyStateFilter:
        """Returns that for w of covariance ``process`` (n, n) and a measurement of sd ``noise``, or ``LinAlgError``."""
        C = np.eye(1, len(transition))
        gain, P = steady_state_gain(transition, C, process, np.array([[noise**2]]))
        return cls(P, gain[:, 0], P[0, 0] + noise**2, transition - gain @ C)

    @may_overflow
    def smooth(
        self,
        pushes: Array,
        measured: Array,
        first: Array,
        read: Array,
    ) -> SmoothedSignal:
        """Returns ``read`` (n,) · x in a segment, from all of its samples ``measured`` (T,).

        ``pushes`` (T − 1, n) are of each sample on the state of the next; the first state has mean ``first`` (n,).
        """
        pushed = pushes + measured[:-1, None] * self.K
        predicted = np.vstack([first, linear_recursion(self.L, pushed, first)])
        back = np.zeros_like(predicted)
        back[:, 0] = (measured - predicted[:, 0])[::-1] / self.F
        later = np.vstack([back[0], linear_recursion(self.L.T, back[1:], back[0])])[::-1]
        toward = self.P @ read
        # Each sample is known by the innovations of those from it on.
        following = linear_recursion(self.L, np.zeros_like(pushes), toward)[:, 0]
        information = np.cumsum(np.append(toward[0], following) ** 2)[::-1] / self.F
        return SmoothedSignal(
            predicted @ read + later @ toward, read @ toward - information, predicted
        )


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
    def design(
        cls,
        A: Array,
        C: Array,
        Q: Array,
        R: Array,
        S: Array,
        first: Array,
        samples: int,
    ) -> KalmanFilter:
        """Returns that for noises as in :func:`steady_state_gain`, and a first state of covariance ``first`` (n, n)."""
        covariances = [first]
        gains = []
        weights = []
        with np.errstate(all="ignore"):
            for _ in range(max(samples, 1)):
                P = covariances[-1]
                try:
                    weights.append(np.linalg.inv(C @ P @ C.T + R))
                except LinAlgError:  # after an overflow
                    weights.append(np.full_like(R, np.nan))
                gain = (A @ P @ C.T + S) @ weights[-1]
                gains.append(gain)
                # In Joseph's form it stays positive.
                kept = A - gain @ C
                after = kept @ P @ kept.T + Q + (gain @ R - 2 * S) @ gain.T
                covariances.append((after + after.T) / 2)
                if abs(covariances[-1] - P).max() <= STEADY_CHANGE * abs(P).max():
                    break
        return cls(A, C, np.array(covariances), np.array(gains), np.array(weights))

    def covariances_of(self, samples: int) -> Array:
        """Returns (T + 1, n, n) those before each sample and after the last."""
        return self.covariances[np.minimum(np.arange(samples + 1), len(self.covariances) - 1)]

    @may_overflow
    def states(self, start: Array, pushes: Array, measured: Array) -> ArrayPair:
        """Returns states (…, T + 1, n) before each sample and after the last, and errors (…, T, m) of predicting it.

        ``start`` is (…, n), ``pushes`` (…, T, n) act on the next state, ``measured`` is (…, T, m); leading axes are
        segments side by side.
        """
        samples = measured.shape[-2]
        places = np.minimum(np.arange(samples), len(self.gains) - 1)
        states = np.empty((*measured.shape[:-2], samples + 1, len(self.A)))
        states[..., 0, :] = start
        closed = (self.A - self.gains @ self.C).mT
        driven = pushes + np.einsum("...tm,tnm->...tn", measured, self.gains[places])
        for t, row in enumerate(places):
            states[..., t + 1, :] = states[..., t, :] @ closed[row] + driven[..., t, :]
        return states, measured - states[..., :-1, :] @ self.C.T

    def smooth(self, states: Array, errors: Array) -> tuple[Array, Array, Array]:
        """Returns means (…, T + 1, n) and covariances (T + 1, n, n) of all states given all measurements.

        By the disturbance smoother, which inverts no covariance of states (de Jong, "Smoothing and interpolation with
        the state-space model", Journal of the American Statistical Association 84(408), 1989). The third are
        covariances (T, n, n) of each state but the first with the one before it.
        """
        samples = errors.shape[-2]
        places = np.minimum(np.arange(samples), len(self.gains) - 1)
        n = len(self.A)
        closed = self.A - self.gains @ self.C
        heard = self.weights @ self.C
        information = np.zeros((samples + 1, n, n))
        pull = np.zeros_like(states)
        for t in range(samples - 1, -1, -1):
            step = closed[places[t]]
            seen = heard[places[t]]
            information[t] = self.C.T @ seen + step.T @ information[t + 1] @ step
            pull[..., t, :] = errors[..., t, :] @ seen + pull[..., t + 1, :] @ step
        P = self.covariances_of(samples)
        means = states + np.einsum("...ti,tij->...tj", pull, P)
        covariances = P - P @ information @ P
        rest = np.eye(n) - P[1:] @ information[1:]
        return means, covariances, rest @ closed[places] @ P[:-1]


class LinearGaussianModel(NamedTuple):
    """x⁺ = A x + B u + offset + w,  y = C x + trim + v; w ~ N(0, Q) and v ~ N(0, R), white and independent."""

    A: Array  # (n, n)
    B: Array  # (n, k)
    offset: Array  # (n,)
    C: Array  # (m, n)
    trim: Array  # (m,)
    Q: Array  # (n, n)
    R: Array  # (m, m)


class SmoothedStates(NamedTuple):
    """States of a segment given all of its outputs: means (T, n) and covariances (T, n, n).

    ``lag_one_covariances`` (T − 1, n, n) are the covariances of each state but the first with the one before it.
    """

    means: Array
    covariances: Array
    lag_one_covariances: Array
    log_likelihood: float


def smooth_states(
    model: LinearGaussianModel,
    start: Array,
    inputs: Array,
    outputs: Array,
) -> SmoothedStates:
    """Returns the smoothed states of one segment, and the likelihood of its outputs.

    The first state has mean ``start`` (n,) and the identity as covariance; ``LinAlgError`` where a covariance is not
    positive or not finite.
    """
    n = len(model.A)
    apart = np.zeros((n, len(model.C)))
    filtered = KalmanFilter.design(
        model.A, model.C, model.Q, model.R, apart, np.eye(n), len(outputs)
    )
    if not np.isfinite(filtered.covariances).all():
        raise LinAlgError("the filter's covariance overflows")
    pushes = inputs @ model.B.T + model.offset
    measured = outputs - model.trim
    states, errors = filtered.states(start, pushes, measured)
    weights = filtered.weights[np.minimum(np.arange(len(errors)), len(filtered.weights) - 1)]
    squares = np.einsum("ti,tij,tj->", errors, weights, errors)
    log_likelihood = 0.5 * (
        np.linalg.slogdet(weights)[1].sum() - squares - errors.size * np.log(2 * np.pi)
    )
    means, covariances, lagged = filtered.smooth(states, errors)
    return SmoothedStates(means[:-1], covariances[:-1], lagged[:-1], log_likelihood)
