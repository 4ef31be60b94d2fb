"""The colour of the noise: its smoothness s, estimated as the s at which F̄ᵒ is highest."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.stats import norm

from mavdem.dem.ascent import ascend
from mavdem.dem.breakdown import breaking_down
from mavdem.dem.fit import generalized, generative_model, with_smoothness
from mavdem.dem.generative import Samples
from mavdem.dem.level import require_probability
from mavdem.dem.record import Record
from mavdem.dem.scaling import Scaling
from mavdem.dem.settings import Settings

Array = NDArray[np.float64]

SHORTEST = 0.25
"""Steps: noise of a smoothness below this is white to the samples, whatever it is between them."""

LONGEST, LONGEST_STEPS = 0.05, 1000.0
"""Of the longest segment: smoother noise does not turn often enough to be measured. And in steps: of smoother noise
than that, differences between samples are rounding."""

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
        require_probability(level)
        span = float(np.exp(norm.ppf(0.5 + level / 2) * self.log_sd))
        return self.smoothness / span, self.smoothness * span


def estimate_colour(record: Record, settings: Settings | None = None) -> Colour:
    """Maximizes F̄ᵒ over the smoothness of the noise.

    Each sample's derivatives tell s by themselves: a noise of variance 1 has a derivative of variance 1/(2s²). So no
    more is needed than the shortest window with two derivatives; and no hidden state, which would take the colour of
    the noise for motion of its own. What the sensors add is taken to be small (``Settings.lambda_z``): white noise of
    theirs, where it is not, makes s too short.

    Args:
        record: the training data.
        settings: complete but for the smoothness; unless given, those that suit.

    Raises:
        ValueError: no window of three samples in the record.
        numpy.linalg.LinAlgError: no smoothness in range could be fitted.
    """
    if settings is None:
        settings = Settings(order=record.outputs.shape[1], p=2, d=2, window=3, parameter_precision=1.0)
    if not record.windows(settings.window or 1):
        raise ValueError(f"train must have a segment of at least {settings.window} samples, not {record.longest}")
    scaling = Scaling.of(*record.spread, settings)
    model = generative_model(settings, scaling, record)
    samples = Samples.of(*generalized(settings, scaling, record))
    heights: dict[float, float] = {}

    def height(log_s: float) -> float:
        if log_s not in heights:
            try:
                with breaking_down():
                    own = with_smoothness(model, settings, float(np.exp(log_s)), record.dt)
                    heights[log_s] = float(ascend(own, samples, settings.iterations).free_energy[-1])
            except (np.linalg.LinAlgError, ValueError):
                heights[log_s] = -np.inf
        return heights[log_s]

    longest = min(max(LONGEST * record.longest, 1.0), LONGEST_STEPS)
    lowest, highest = np.log([SHORTEST * record.dt, longest * record.dt])
    grid = np.linspace(lowest, highest, GRID)
    best = int(np.argmax([height(place) for place in grid]))
    if not np.isfinite(height(grid[best])):
        raise np.linalg.LinAlgError("F̄ᵒ could be had at no smoothness")
    log_s, log_sd = float(grid[best]), np.inf
    if 0 < best < GRID - 1 and np.isfinite([height(grid[best - 1]), height(grid[best + 1])]).all():
        bracket = grid[best - 1], grid[best + 1]
        # Between two heights that could be had lies none that could not; were there one, it would not be the highest.
        lowest_height = min(height(place) for place in bracket)
        found = minimize_scalar(lambda at: -max(height(at), lowest_height), bounds=bracket, options={"xatol": 0.01})
        log_s = float(found.x)
        curvature = (height(log_s - NEARBY) + height(log_s + NEARBY) - 2 * height(log_s)) / NEARBY**2
        if -np.inf < curvature < 0:
            log_sd = float(np.sqrt(_redundancy(np.exp(log_s), record.dt) / -curvature))
    tried = sorted(place for place, value in heights.items() if np.isfinite(value))
    return Colour(float(np.exp(log_s)), log_sd, np.exp(tried), np.array([heights[place] for place in tried]))


def _redundancy(smoothness: float, dt: float) -> float:
    """How many neighbouring samples tell as much as one: Σ_k ρ(k dt)², for the autocorrelation ρ of the noise.

    A sample's square, by which variances are estimated, is correlated with its neighbours' by ρ².
    """
    lags = np.arange(-round(10 * smoothness / dt) - 1, round(10 * smoothness / dt) + 2) * dt
    return float(np.exp(-((lags / smoothness) ** 2) / 2).sum())
