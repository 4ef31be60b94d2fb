"""The smoothness s of the noise, estimated by maximising F̄ᵒ."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from mavdem.confidence import LEVEL, quantile, require_probability
from mavdem.dem.engine.ascent import ascend
from mavdem.dem.engine.generative import SufficientStatistics
from mavdem.dem.engine.linalg import Array, raise_on_overflow
from mavdem.dem.fitting import generalized, generative_model, with_smoothness
from mavdem.dem.record import Record, UniformRecord
from mavdem.dem.scaling import Scaling
from mavdem.dem.settings import CompleteSettings

MIN_STEPS = 0.25  # steps: noise of a smoothness below this is white to the samples, whatever it is between them

MAX_SHARE, MAX_STEPS = 0.05, 1000.0
"""Of the longest segment: smoother noise does not change often enough to be measured. And in steps: of smoother noise
differences between samples are rounding."""

GRID_POINTS = 9  # of the first, coarse search, over ln s
CURVATURE_STEP = 0.1  # in ln s: for the curvature of F̄ᵒ by differences


class SmoothnessEstimate(NamedTuple):
    """The estimated smoothness, and how flat F̄ᵒ is around it.

    Attributes:
        smoothness: kernel width s, seconds.
        log_sd: standard deviation of ln s, from the curvature of F̄ᵒ for the effective number of samples: F̄ᵒ counts
            neighbours as independent. Infinite at an end of the range.
        tried: (k,) every s at which F̄ᵒ was computed, seconds, increasing.
        free_energy: (k,) F̄ᵒ there.
    """

    smoothness: float
    log_sd: float
    tried: Array
    free_energy: Array

    def interval(self, level: float = LEVEL) -> tuple[float, float]:
        """The interval of s with probability ``level``, seconds."""
        require_probability(level)
        span = float(np.exp(quantile(level) * self.log_sd))
        return self.smoothness / span, self.smoothness * span


def estimate_smoothness(
    train: UniformRecord | Sequence[UniformRecord], settings: CompleteSettings | None = None
) -> SmoothnessEstimate:
    """The smoothness s of a flight's noise: the maximum of F̄ᵒ over s.

    Each sample's derivatives determine s: a noise of variance 1 has a derivative of variance 1/(2s²). So the shortest
    window with two derivatives is enough, without hidden states, which would explain coloured noise as motion. Sensor
    noise is assumed small (``Settings.lambda_z``): where it is not, s is too short.

    Args:
        train: a ``Flight``, or a list of segments, as for ``learn``.
        settings: whose ``smoothness`` is not used; unless given, those described above.

    Raises:
        ValueError: no segment has a window of three samples, or no smoothness in range could be fitted.
    """
    record = Record.of(train)
    if settings is None:
        settings = CompleteSettings(order=record.outputs.shape[1], p=2, d=2, window=3, parameter_precision=1.0)
    if not record.windows(settings.window):
        raise ValueError(f"train must have a segment of at least {settings.window} samples, not {record.longest}")
    scaling = Scaling.of(*record.spread, settings)
    model = generative_model(settings, scaling, record)
    samples = SufficientStatistics.of(*generalized(settings, scaling, record))
    values: dict[float, float] = {}

    def value(log_s: float) -> float:
        if log_s not in values:
            try:
                with raise_on_overflow():
                    own = with_smoothness(model, settings, float(np.exp(log_s)), record.dt)
                    values[log_s] = float(ascend(own, samples, settings.iterations).free_energy[-1])
            except (np.linalg.LinAlgError, ValueError):
                values[log_s] = -np.inf
        return values[log_s]

    longest = min(max(MAX_SHARE * record.longest, 1.0), MAX_STEPS)
    lowest, highest = np.log([MIN_STEPS * record.dt, longest * record.dt])
    grid = np.linspace(lowest, highest, GRID_POINTS)
    best = int(np.argmax([value(place) for place in grid]))
    if not np.isfinite(value(grid[best])):
        raise ValueError("the training data do not determine the smoothness of their noise: set it")
    log_s, log_sd = float(grid[best]), np.inf
    if 0 < best < GRID_POINTS - 1 and np.isfinite([value(grid[best - 1]), value(grid[best + 1])]).all():
        bracket = grid[best - 1], grid[best + 1]
        # Where F̄ᵒ cannot be computed between the two, it counts as the lower of them.
        lowest_value = min(value(place) for place in bracket)
        found = minimize_scalar(lambda at: -max(value(at), lowest_value), bounds=bracket, options={"xatol": 0.01})
        log_s = float(found.x)
        curvature = (
            value(log_s - CURVATURE_STEP) + value(log_s + CURVATURE_STEP) - 2 * value(log_s)
        ) / CURVATURE_STEP**2
        if -np.inf < curvature < 0:
            log_sd = float(np.sqrt(_redundancy(np.exp(log_s), record.dt) / -curvature))
    tried = sorted(place for place, found in values.items() if np.isfinite(found))
    return SmoothnessEstimate(float(np.exp(log_s)), log_sd, np.exp(tried), np.array([values[place] for place in tried]))


def _redundancy(smoothness: float, dt: float) -> float:
    """Samples per effective sample: Σ_k ρ(k dt)², for the autocorrelation ρ of the noise.

    A sample's square, by which variances are estimated, is correlated with its neighbours' by ρ².
    """
    lags = np.arange(-round(10 * smoothness / dt) - 1, round(10 * smoothness / dt) + 2) * dt
    return float(np.exp(-((lags / smoothness) ** 2) / 2).sum())
