"""Airflow: the wind as a coloured unknown cause of the specific force that drag makes, given attitude and velocity.

On a grid of some tenths of a second, the specific force along body x and y is measured,

    f = b − (c + q |u|) u + e,   u = Rᵀ (v − m − w),

with velocity v, attitude R, mean wind m, white noise e, and the unknown cause w, an Ornstein-Uhlenbeck process of mean
η = 0. An extended Kalman filter runs for many values of c, q, lean b, and sizes of w and e side by side. Its likelihood
weighs them; its smoother, averaged over them, is the estimate.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.dem.airflow.drag import coefficients
from mavdem.dem.engine.linalg import Array

GRAVITY, WIND_SD = 9.80665, 4.0  # m/s²; m/s along each axis, of the mean wind before the flight: 3 to 10 are usual
FREEDOM = 8.0  # of Student's t that innovations have: a position reset or a touch of the ground is no wind
MAX_FORCE, BRIDGED = 25.0, 10.0  # m/s² across the thrust axis, beyond which the velocity jumped; s to the next data
WIND, MEAN = slice(0, 2), slice(2, 4)  # of the four states
TOTAL = np.kron([[1.0, 1.0]], np.eye(2))  # (2, 4) w + m of the states


class Motion(NamedTuple):
    """Attitude, velocity and specific force on a grid of ``step`` s; NaN where a step has no samples."""

    time: Array  # (T,) s, of each step's middle
    axes: Array  # (T, 2, 3) body x and y in north, east, down
    velocity: Array  # (T, 3) m/s, relative to the ground, or to the air where that is known
    force: Array  # (T, 2) m/s², along body x and y
    step: float

    @property
    def known(self) -> NDArray[np.bool_]:
        """(T,) which steps have all of it."""
        return np.asarray(np.isfinite(self.force).all(axis=1) & np.isfinite(self.velocity).all(axis=1))

    def at(self, rows: NDArray[np.bool_] | slice) -> Motion:
        """Returns those steps."""
        return Motion(self.time[rows], self.axes[rows], self.velocity[rows], self.force[rows], self.step)


def motion(time: Array, attitude: Array, velocity: Array, step: float, wind: Array | None = None) -> Motion:
    """Returns the motion on a grid: means over steps, the acceleration the ``velocity``'s difference over two of them.

    ``time`` (T,) and ``step`` are in s; ``attitude`` (T, 3), roll, pitch and yaw in rad, and velocity (T, 3), m/s
    north, east and down, are averaged as that is; a known ``wind`` (T, 2), m/s, is taken off the velocity.
    """
    (cr, cp, cy), (sr, sp, sy) = np.cos(attitude).T, np.sin(attitude).T
    x, y = (cp * cy, cp * sy, -sp), (sr * sp * cy - cr * sy, sr * sp * sy + cr * cy, sr * cp)
    air = np.zeros((len(time), 2)) if wind is None else wind
    count = int((time[-1] - time[0]) / step + 1e-6) + 1
    place = np.minimum(((time - time[0]) / step + 1e-6).astype(int), count - 1)
    number = np.bincount(place, minlength=count)
    sums = [np.bincount(place, column, count) for column in (*x, *y, *velocity.T, *air.T)]
    means = np.where(number > 0, np.array(sums) / np.maximum(number, 1), np.nan).T
    smooth = (means[:-2] + 2 * means[1:-1] + means[2:]) / 4
    axes, speed = smooth[:, :6].reshape(-1, 2, 3), smooth[:, 6:9].copy()
    force = np.einsum("tij,tj->ti", axes, (means[2:, 6:9] - means[:-2, 6:9]) / (2 * step)) - GRAVITY * axes[:, :, 2]
    force[~(np.abs(force) < MAX_FORCE).all(axis=1)] = np.nan
    speed[:, :2] -= smooth[:, 9:]
    grid, reach = Motion(time[0] + step * np.arange(1.5, count - 1), axes, speed, force, step), int(BRIDGED / step)
    return grid.at(np.convolve([*grid.known, False], np.ones(2 * reach + 1))[reach : reach + len(force)] > 0)


class Filter:
    """Runs an extended Kalman filter for each of G ``parameters`` side by side, step by step of a grid.

    ``parameters`` (G, 9): those of ``Drag.mean``, and logarithms of the wind's sd (m/s) and time (s) and of e's sd. It
    is linearized first about the wind that the median force of ``start`` stands for.

    Attributes:
        states, spreads: (G, 4) and (G, 4, 4) so far.
        total: (G,) log likelihoods.
        decay: (G, 4) of the states in a step.
    """

    def __init__(self, parameters: Array, start: Motion) -> None:
        self._linear, self._quadratic = linear, quadratic = coefficients(parameters)
        self._lean, (wind_sd, wind_seconds, noise) = parameters[:, 4:6], np.exp(parameters[:, 6:]).T
        G, phi, known = len(parameters), np.exp(-start.step / wind_seconds), start.known
        self.decay, self.states, self.total = np.ones((G, 4)), np.zeros((G, 4)), np.zeros(G)
        self.decay[:, WIND] = phi[:, None]
        self.spreads, self._process = np.zeros((2, G, 4, 4))
        self.spreads[:, WIND, WIND] = wind_sd[:, None, None] ** 2 * np.eye(2)
        self.spreads[:, MEAN, MEAN] = WIND_SD**2 * np.eye(2)
        self._process[:, WIND, WIND] = (wind_sd**2 * (1 - phi**2))[:, None, None] * np.eye(2)
        self._fade = self.decay[:, :, None] * self.decay[:, None, :]
        self._noise = (noise**2)[:, None, None] * np.eye(2)
        force = np.median(np.einsum("tij,ti->tj", start.axes[known][:, :, :2], start.force[known]), axis=0)
        speed = air_speed(linear.mean(axis=1), quadratic.mean(axis=1), size := float(np.hypot(*force)))
        self.states[:, MEAN] = np.median(start.velocity[known, :2], axis=0) + force / max(size, 1e-9) * speed[:, None]

    def predict(self) -> None:
        """Goes on by a step."""
        self.states, self.spreads = self.states * self.decay, self.spreads * self._fade + self._process

    def update(self, axes: Array, velocity: Array, force: Array) -> tuple[Array, Array]:
        """Takes what a step of ``Motion`` measured; returns error (2,) and covariance of the first prediction."""
        x, P = self.states, self.spreads
        u = axes @ velocity - (x[:, WIND] + x[:, MEAN]) @ axes[:, :2].T
        speed = np.sqrt((u * u).sum(axis=1) + 1e-4)[:, None]
        drag = self._linear + self._quadratic * speed
        slope = drag[:, :, None] * np.eye(2) + (self._quadratic / speed * u)[:, :, None] * u[:, None, :]
        H = slope @ axes[:, :2] @ TOTAL
        error = force + drag * u - self._lean
        PH = P @ H.transpose(0, 2, 1)
        S = H @ PH + self._noise
        det = S[:, 0, 0] * S[:, 1, 1] - S[:, 0, 1] ** 2
        inverse = np.stack([S[:, 1, 1], -S[:, 0, 1], -S[:, 0, 1], S[:, 0, 0]], axis=1).reshape(len(S), 2, 2)
        inverse /= det[:, None, None]
        squares = np.einsum("gi,gij,gj->g", error, inverse, error)
        self.total -= np.log(det) / 2 + (FREEDOM + 2) / 2 * np.log1p(squares / FREEDOM)
        K = PH @ inverse * np.minimum((FREEDOM + 2) / (FREEDOM + squares), 1.0)[:, None, None]
        self.states, self.spreads = x + np.einsum("gij,gj->gi", K, error), P - K @ PH.transpose(0, 2, 1)
        return error[0], S[0]


def filtered(parameters: Array, motion: Motion, keep: bool = False) -> tuple[Array, Array, tuple[Array, ...]]:
    """Returns the log likelihoods (G,) of a ``Filter``; where ``keep``, innovations and what is smoothed.

    The innovations (T, 2) are of the first of the ``parameters``, in standard deviations, NaN where the ``motion`` is
    not known.
    """
    run, known, kept = Filter(parameters, motion), motion.known, len(motion.force) if keep else 0
    states, spreads = np.empty((2, kept, *run.states.shape)), np.empty((2, kept, *run.spreads.shape))
    innovations = np.full((kept, 2), np.nan)
    for t in range(len(motion.force)):
        if t:
            run.predict()
        if keep:
            states[0, t], spreads[0, t] = run.states, run.spreads
        if known[t]:
            error, S = run.update(motion.axes[t], motion.velocity[t], motion.force[t])
            if keep:
                innovations[t] = error / np.sqrt(np.diag(S))
        if keep:
            states[1, t], spreads[1, t] = run.states, run.spreads
    return run.total, innovations, (*states, *spreads, run.decay)


def air_speed(linear: Array, quadratic: Array, force: float) -> Array:
    """Returns the air speed, m/s, at which ``linear`` and ``quadratic`` drag makes a ``force``, m/s²."""
    return np.asarray(2 * force / (linear + np.sqrt(linear**2 + 4 * quadratic * force)))


def smoothed(x_before: Array, states: Array, P_before: Array, spreads: Array, decay: Array) -> tuple[Array, Array]:
    """Returns states (T, G, 4) and covariances given all steps, in place (Rauch, Tung and Striebel, 1965)."""
    gains = np.linalg.solve(P_before[1:], (spreads[:-1] * decay[:, None, :]).swapaxes(2, 3)).swapaxes(2, 3)
    for t in range(len(states) - 2, -1, -1):
        states[t] += np.einsum("gij,gj->gi", gains[t], states[t + 1] - x_before[t + 1])
        spreads[t] += gains[t] @ (spreads[t + 1] - P_before[t + 1]) @ gains[t].transpose(0, 2, 1)
    return states, spreads


def drawn(mean: Array, covariance: Array, number: int) -> Array:
    """Returns a ``number`` of Gaussian draws whose own ``mean`` and ``covariance`` are these; the same every time."""
    half = np.linalg.qr(np.random.default_rng(1).standard_normal((number // 2, len(mean))))[0] * np.sqrt(number / 2)
    return np.asarray(mean + np.vstack([half, -half]) @ np.linalg.cholesky(covariance).T)


def posterior(
    log_likelihood: Callable[[Array], Array], mean: Array, covariance: Array, draws: int, rounds: int
) -> tuple[Array, Array]:
    """Returns moments of a Gaussian prior of ``mean`` and ``covariance`` times the ``log_likelihood`` of (N, k).

    By population Monte Carlo (Cappé and others, 2004): in ``rounds``, the Gaussian that ``draws`` come from follows
    weights flattened until a quarter of the draws counts.
    """
    centre, spread = mean, covariance

    def normal(apart: Array, covariance: Array) -> Array:
        return np.asarray(-np.einsum("gi,ij,gj->g", apart, np.linalg.inv(covariance), apart) / 2)

    for _ in range(rounds):
        wide = 1.44 * (spread + 1e-3 * covariance)
        places = drawn(centre, wide, draws)
        logs = log_likelihood(places) + normal(places - mean, covariance) - normal(places - centre, wide)
        logs = np.where(np.isfinite(logs), logs - logs[np.isfinite(logs)].max(), -np.inf)
        flat = [np.exp(share * logs) for share in 0.85 ** np.arange(40)]
        weights = next((one for one in flat if one.sum() ** 2 / (one**2).sum() >= draws / 4), flat[-1])
        weights /= weights.sum()
        centre = weights @ places
        spread = (places - centre).T * weights @ (places - centre)
    return centre, spread
