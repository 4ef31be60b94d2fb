"""Gusts while they blow: :func:`mavdem.dem.graybox.gusts.gusts` in small steps, by the samples so far."""

from __future__ import annotations

from collections import deque

import numpy as np

from mavdem.dem.graybox.gusts import (
    CERTAIN,
    END,
    LEVEL_SECONDS,
    LEVEL_STEP_SECONDS,
    NORMAL_MEDIAN,
    THRESHOLD,
    DetectedGust,
)

LEAST_SECONDS, MEMORY_SECONDS = 20.0, 60.0  # of samples, which the size of turbulence is estimated from


class GustWatch:
    """Finds gusts in a torque that comes sample by sample; a running median of the past is the level."""

    def __init__(self, dt: float) -> None:
        """Begins without a sample; ``dt`` is the sampling step, s."""
        self._dt, self._stride, self._count = dt, max(1, round(LEVEL_STEP_SECONDS / dt)), 0
        self._latest: deque[float] = deque(maxlen=round(LEVEL_SECONDS / LEVEL_STEP_SECONDS))
        self._away: deque[float] = deque(maxlen=round(MEMORY_SECONDS / LEVEL_STEP_SECONDS))
        self._level = self._sd = np.nan
        self._gust: list[float] = []  # of the one that blows
        self._certain = False

    def add(self, torque: float, band: float) -> DetectedGust | None:
        """Takes a sample and the half width of its band, rad/s²; returns the gust that has ended before it, or None."""
        if not np.isfinite(torque):
            self._gust, self._certain = [], False
            return None
        away = torque - self._level
        blows = abs(away) > END * THRESHOLD * self._sd and (not self._gust or away * self._gust[0] > 0)
        ended = None
        if blows:
            self._gust.append(away)
            self._certain |= abs(away) > max(THRESHOLD * self._sd, CERTAIN * band)
        elif self._gust:
            if self._certain:
                start = self._count - len(self._gust)
                ended = DetectedGust(start, start * self._dt, len(self._gust) * self._dt, max(self._gust, key=abs))
            self._gust, self._certain = [], False
        if self._count % self._stride == 0:
            self._remember(torque)
        self._count += 1
        return ended

    def _remember(self, torque: float) -> None:
        self._latest.append(torque)
        if len(self._latest) == self._latest.maxlen:
            self._level = float(np.median(self._latest))
            self._away.append(torque - self._level)
            self._sd = float(np.median(np.abs(self._away))) / NORMAL_MEDIAN
            if len(self._away) < LEAST_SECONDS / LEVEL_STEP_SECONDS:
                self._sd = np.nan
