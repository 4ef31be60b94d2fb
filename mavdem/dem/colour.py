"""The colour of the noise: its smoothness s, estimated as the s at which F̄ᵒ is highest."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.stats import norm

from mavdem.dem.ascent import ascend
from mavdem.dem.fit import generalized, generative_model, with_smoothness
from mavdem.dem.generative import Samples
from mavdem.dem.record import Record
from mavdem.dem.scaling import Scaling
from mavdem.dem.settings import Settings

Array = NDArray[np.float64]

SHORTEST = 0.25
"""Steps: noise of a smoothness below this is white to the samples, whatever it is between them."""

LONGEST = 0.05
"""Of the longest segment: smoother noise than this does not turn often enough to be measured."""

GRID = 9
"""Places of the first, coarse search, over ln s."""

NEARBY = 0.1
"""In ln s, from the best s: where the fall of F̄ᵒ tells its curvature."""


class Colour(NamedTuple):
    """The estimated smoothness, and how flat F̄ᵒ is about it.

    Attributes:
        smoothness: kernel width s, seconds.
        log_sd: standard deviation of ln s, from the curvature of F̄ᵒ, of which as much is believed as there are
            samples that do not tell the same: F̄ᵒ counts neighbours as independent. Infinite at an end of the range.
        tried: (k,) every s that was tried, seconds, increasing.
        free_energy: (k,) F̄ᵒ there.
    """

    smoothness: float
    log_sd: float
    tried: Array
    free_energy: Array

    def interval(self, level: float = 0.9) -> tuple[float, float]:
        """Where s lies with probability ``level``, seconds."""
        span = float(np.exp(norm.ppf(0.5 + level / 2) * self.log_sd))
        return self.smoothness / span, self.smoothness * span


def estimate_colour(record: Record, settings: Settings) -> Colour:
    """Maximizes F̄ᵒ over the smoothness of the noise.

    Each sample's derivatives tell s by themselves: a noise of variance 1 has a derivative of variance 1/(2s²).

    Args:
        record: the training data.
        settings: complete but for the smoothness.

    Raises:
        numpy.linalg.LinAlgError: no smoothness in range could be fitted.
    """
    scaling = Scaling.of(record.inputs, record.outputs, settings)
    model = generative_model(settings, scaling, record)
    samples = Samples.of(*generalized(settings, scaling, record))
    heights: dict[float, float] = {}

    def height(log_s: float) -> float:
        if log_s not in heights:
            try:
                own = with_smoothness(model, settings, float(np.exp(log_s)), record.dt)
                heights[log_s] = float(ascend(own, samples, settings.iterations).free_energy[-1])
            except (np.linalg.LinAlgError, ValueError):
                heights[log_s] = -np.inf
        return heights[log_s]

    lowest, highest = np.log([SHORTEST * record.dt, max(LONGEST * record.longest, 1.0) * record.dt])
    grid = np.linspace(lowest, highest, GRID)
    best = int(np.argmax([height(place) for place in grid]))
    if not np.isfinite(height(grid[best])):
        raise np.linalg.LinAlgError("F̄ᵒ could be had at no smoothness")
    inside = 0 < best < GRID - 1
    if inside:
        bracket = grid[best - 1], grid[best + 1]
        log_s = float(minimize_scalar(lambda at: -height(at), bounds=bracket, options={"xatol": 0.01}).x)
        curvature = (height(log_s - NEARBY) + height(log_s + NEARBY) - 2 * height(log_s)) / NEARBY**2
        log_sd = float(np.sqrt(_redundancy(np.exp(log_s), record.dt) / -curvature)) if curvature < 0 else np.inf
    else:
        log_s, log_sd = float(grid[best]), np.inf
    tried = sorted(heights)
    return Colour(float(np.exp(log_s)), log_sd, np.exp(tried), np.array([heights[place] for place in tried]))


def _redundancy(smoothness: float, dt: float) -> float:
    """How many neighbouring samples tell as much as one: Σ_k ρ(k dt)², for the autocorrelation ρ of the noise.

    A sample's square, by which variances are estimated, is correlated with its neighbours' by ρ².
    """
    lags = np.arange(-round(10 * smoothness / dt) - 1, round(10 * smoothness / dt) + 2) * dt
    return float(np.exp(-((lags / smoothness) ** 2) / 2).sum())
