"""Fixed-interval smoothing of the wind's torque, given the plant: exact, by the steady filter alone.

The steady filter is exact for a first state that is as uncertain as its later ones. What a first state is more
uncertain than that, Δ = P₀ − P, is one more unknown ζ of the whole segment: it appears in the innovations as C Lᵗ ζ,
with L = Φ − K C the filter's transition, and is estimated from them by least squares. So nothing runs step by step
through covariances, and every pass over the samples is a linear recursion with constant coefficients.

The backward pass is the disturbance smoother: x̂ₜ + P rₜ₋₁ with rₜ₋₁ = Cᵀ eₜ / F + Lᵀ rₜ (de Jong, "A cross-validation
filter for time series models", Biometrika 75, 1988; Durbin and Koopman, Time Series Analysis by State Space Methods,
2nd ed., sec. 4.4). It inverts no covariance of states, and that of the torque is 0.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mavdem.dem.engine.linalg import Array
from mavdem.dem.engine.model import recursion
from mavdem.dem.graybox.likelihood import Plant, delayed, steady_covariance

NEGLIGIBLE = 1e-12  # of a variance: what is less of it no longer counts


class SmoothedWind(NamedTuple):
    """Mean and variance (T,) of the wind's torque at each sample, and the motors' torque (T,); rad/s²."""

    mean: Array
    variance: Array
    motors: Array


class SteadyFilter(NamedTuple):
    """The steady Kalman filter of a plant whose rate is measured with white noise.

    Attributes:
        plant: what is filtered.
        covariance: (n, n) P of the predicted state.
        gain: (n,) K.
        variance: F of the innovations, (rad/s)².
        closed: (n, n) L = Φ − K C.
    """

    plant: Plant
    covariance: Array
    gain: Array
    variance: float
    closed: Array

    @classmethod
    def of(cls, plant: Plant, noise: float) -> SteadyFilter:
        """For a rate measured with white noise of standard deviation ``noise``, rad/s.

        Raises:
            numpy.linalg.LinAlgError: there is no steady filter.
        """
        state = plant.step.state
        P = steady_covariance(state[None], plant.process[None], np.array([noise**2]))[0]
        if not np.isfinite(P).all():
            raise np.linalg.LinAlgError("there is no steady filter")
        variance = float(P[0, 0]) + noise**2
        gain = state @ P[:, 0] / variance
        closed = state.copy()
        closed[:, 0] -= gain
        return cls(plant, P, gain, variance, closed)

    def predicted(self, commanded: Array, steps: float, rate: Array, first: Array) -> Array:
        """(T, n) the states, each given the samples before it, from the ``first`` (n,) on; else as :meth:`smoothed`."""
        early, late = delayed(commanded[:, None], steps)
        pushes = early * self.plant.step.input_now[:, 0] + late * self.plant.step.input_next[:, 0]
        return np.vstack([first, recursion(self.closed, pushes + rate[:-1, None] * self.gain, first)])

    def weights(self, number: int) -> Array:
        """(number,) of the innovations of a sample and of those after it, in the smoothed wind's torque there."""
        found = np.zeros(number)
        heard = _powers(self.closed, number)[:, 0] @ self.covariance @ self.plant.wind
        found[: len(heard)] = heard / self.variance
        return found

    def smoothed(self, commanded: Array, steps: float, rate: Array) -> SmoothedWind:
        """The wind's torque in a segment, from all of it.

        At its beginning the motors have settled at what is commanded, and of the wind nothing is known but how strong
        it is.

        Args:
            commanded: (T,) torque that the commands settle at, rad/s², with all that is steady.
            steps: delay of the commands, in samples.
            rate: (T,) measured, rad/s.
        """
        first = np.zeros(len(self.gain))
        first[:2] = rate.mean(), commanded[0]
        predicted = self.predicted(commanded, steps, rate, first)
        errors, F, wind = rate - predicted[:, 0], self.variance, self.plant.wind

        powers = _powers(self.closed, len(rate))
        heard, short = powers[:, 0], len(powers)
        excess = self.plant.stationary - self.covariance
        excess[0, 0] += np.var(rate) + F
        spread = excess @ np.linalg.inv(np.eye(len(wind)) + heard.T @ heard @ excess / F)
        zeta = spread @ heard.T @ errors[:short] / F
        errors[:short] -= heard @ zeta
        predicted[:short] += powers @ zeta

        back = np.zeros_like(predicted)
        back[:, 0] = errors[::-1] / F
        later = np.vstack([back[0], recursion(self.closed.T, back[1:], back[0])])[::-1]
        toward = self.covariance @ wind
        mean = predicted @ wind + later @ toward

        # Sums over the samples from one on: all of those, or as many as are not negligible.
        weights = heard @ toward
        known, left = np.cumsum(weights**2) / F, wind - np.cumsum(heard * weights[:, None], axis=0) / F
        following = np.minimum(np.arange(len(rate))[::-1], short - 1)
        variance = wind @ toward - known[following]
        slope = np.einsum("tij,ti->tj", powers, left[following[:short]])
        variance[:short] += np.einsum("ti,ij,tj->t", slope, spread, slope)
        return SmoothedWind(mean, np.maximum(variance, 0.0), predicted[:, 1])


def _powers(matrix: Array, number: int) -> Array:
    """(h, n, n) the powers of a stable matrix from 0 on, ``number`` of them, or as many as are not negligible."""
    powers, step = np.eye(len(matrix))[None], matrix
    while len(powers) < number and np.abs(powers[-1]).max() > NEGLIGIBLE:
        powers = np.concatenate([powers, powers @ step])
        step = step @ step
    return powers[:number]
