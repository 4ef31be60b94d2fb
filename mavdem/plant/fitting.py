"""The most probable parameters of the gray-box model, by Fisher's scoring over all windows of a flight."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.linalg import LinAlgError

from mavdem.arrays import Array, ArrayPair
from mavdem.dem.engine.gauss_newton import (
    FINITE_DIFFERENCE_STEP,
    MAX_STEPS,
    Damping,
    QuadraticExpansion,
    gauss_newton,
)
from mavdem.plant.likelihood import FlightWindows, Parameters
from mavdem.plant.sampled_plant import FIRST_ORDER, GAUSSIAN_KERNEL

WINDS = ((FIRST_ORDER,), (FIRST_ORDER, GAUSSIAN_KERNEL), (GAUSSIAN_KERNEL, GAUSSIAN_KERNEL))
"""Winds to choose from: turbulence, turbulence with smooth gusts, two kinds of smooth gusts, the slow ones first."""

LONGEST_LOG_STEP = 0.7  # of any logarithm, in one step
EFFECT_SD = 0.05
UNLIKE = 1.0
"""Standard deviation of a motor's effect from the mixer's direction, relative to the mean effect, beforehand: where the
mixer is known or recognised, and where it is neither."""
# of the rate: the least white noise, below which steps of the stream are modelled and not the vehicle
FLOOR = 0.01
MAX_CHUNK = 24  # windows whose prediction errors are in memory together


class GrayBoxFit(NamedTuple):
    """The log joint about parameters θ."""

    parameters: Parameters  # what θ means
    theta: Array  # (k,)
    value: float  # of the log joint
    curvature: Array  # (k, k) of the negative log joint, prior included
    # (W,) standard deviation of each window's prediction errors, relative to what θ says
    levels: Array

    @property
    def evidence(self) -> float:
        """Laplace's evidence, up to a constant that is the same for all winds."""
        _, sd = self.parameters.prior
        return self.value - 0.5 * np.linalg.slogdet(self.curvature)[1] - np.log(sd).sum()


class LogJoint(NamedTuple):
    """The log joint of the innovations and the parameters, an ``Objective`` of Fisher's scoring.

    The level of each window's innovations is solved for: its likelihood is −N/2 log of their mean square.
    """

    parameters: Parameters
    windows: FlightWindows

    def value(self, at: Array) -> float:
        """Returns the value, NaN where there is none."""
        value = self._log_prior(at)
        for errors, _ in self.innovations(at[None]):
            value += _log_likelihood(errors[0])
        return value

    def expand(self, at: Array) -> QuadraticExpansion:
        """Returns the value to second order, by differences, all at once; ``LinAlgError`` where there is none."""
        mean, sd = self.parameters.prior
        steps = FINITE_DIFFERENCE_STEP * np.maximum(0.01, abs(at))
        value = self._log_prior(at)
        slope = (mean - at) / sd**2
        curvature = np.diag(sd**-2.0)
        for errors, _ in self.innovations(np.vstack([at, at + np.diag(steps)])):
            value += _log_likelihood(errors[0])
            errors /= np.sqrt(np.mean(errors[0] ** 2, axis=1))[:, None]
            errors[1:] -= errors[0]
            slopes = errors[1:].reshape(len(at), -1)
            slopes /= steps[:, None]
            slope -= slopes @ errors[0].ravel()
            curvature += slopes @ slopes.T
        if not (np.isfinite(value) and np.isfinite(curvature).all()):
            raise LinAlgError("nothing has a likelihood")
        return QuadraticExpansion(at, value, slope, curvature)

    def limited(self, step: Array) -> Array:
        """Returns a step that changes no logarithm by more than ``LONGEST_LOG_STEP``."""
        return step * min(1.0, LONGEST_LOG_STEP / abs(step[self.parameters.logarithms]).max())

    def innovations(self, points: Array) -> Iterator[ArrayPair]:
        """Yields those of some windows at a time, as of ``Parameters``."""
        for start in range(0, len(self.windows.rate), MAX_CHUNK):
            with np.errstate(all="ignore"):
                part = self.windows.some(slice(start, start + MAX_CHUNK))
                yield self.parameters.innovations(points, part)

    def _log_prior(self, at: Array) -> float:
        mean, sd = self.parameters.prior
        return -0.5 * np.sum(((at - mean) / sd) ** 2)


def _log_likelihood(errors: Array) -> float:
    """Of the innovations (W, N) of windows, each of a level of its own."""
    return -0.5 * errors.shape[1] * np.log(np.mean(errors**2, axis=1)).sum()


def fitted(
    parameters: Parameters, windows: FlightWindows, start: Array, promised: float = 0.0
) -> GrayBoxFit:
    """Returns the most probable parameters, from ``start`` (k,) on; ``LinAlgError`` where there is no likelihood there.

    It stays at ``start`` where less than the ``promised`` gain, in nats, is expected of the first step.
    """
    objective = LogJoint(parameters, windows)
    damping = Damping(initial=1e-2, factor=6.0, max_attempts=12, limit_step=objective.limited)
    first = objective.expand(start)
    iterations = MAX_STEPS if first.predicted_gain >= promised else 0
    trace, _ = gauss_newton(objective, first, damping, iterations)
    last = trace[-1]
    levels = [
        np.sqrt(np.mean(errors[0] ** 2, axis=1) / variance)
        for errors, variance in objective.innovations(last.point[None])
    ]
    return GrayBoxFit(parameters, last.point, last.value, last.curvature, np.concatenate(levels))


def directed(windows: FlightWindows, effect_directions: Array | None) -> tuple[Parameters, Array]:
    """Returns directions of the motors' effect, and the parameters to begin with.

    By linear regression on the innovations at the prior's mean, where there are no ``effect_directions`` (r,).
    """
    r = windows.inputs.shape[1]
    power = 2 * np.sum(abs(windows.rate) ** 2, axis=1).mean()
    plain = Parameters(np.ones(r), UNLIKE, WINDS[0], FLOOR * np.sqrt(power) / windows.samples)
    mean, _ = plain.prior
    # Effects 0 and, one after the other, 1: log effect 0 and deviations −1, but for the motor's own.
    points = np.repeat(mean[None], r + 1, axis=0)
    points[:, 0] = 0.0
    points[:, 1 : r + 1] = -1.0 + np.eye(r + 1, r, k=-1)
    errors, _ = plain.innovations(points, windows)
    target = errors[0].ravel()
    slopes = (errors[0] - errors[1:]).reshape(r, -1).T
    gram = slopes.T @ slopes
    ridge = 1e-9 * np.trace(gram) / r * np.eye(r)
    effect = np.linalg.solve(gram + ridge, slopes.T @ target)
    directions = effect if effect_directions is None else effect_directions
    deviation = UNLIKE if effect_directions is None else EFFECT_SD
    directions = directions / abs(directions).mean()
    along = (directions @ gram @ effect) / (directions @ gram @ directions + ridge[0, 0])
    # The autopilot's parameters may count turns the other way round.
    directions = directions if along >= 0 else -directions
    parameters = plain._replace(directions=directions, deviation=deviation)
    start, _ = parameters.prior
    start[0] = np.log(max(abs(along), 1e-6))
    return parameters, start
