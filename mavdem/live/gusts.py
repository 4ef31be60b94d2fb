"""LiveGusts: gusts of the wind torque of a live flight, once each, soon after they have ended."""

from collections import deque
from collections.abc import Iterator

import numpy as np

from mavdem.containers import Numbers
from mavdem.dem import Estimate
from mavdem.dem.record import Record
from mavdem.facts import Fact
from mavdem.facts.session import Session
from mavdem.plant.gusts import RUNNING_LEVEL_SECONDS, detect_gusts, min_gust_duration
from mavdem.plant.online_wind_torque import MEMORY_SECONDS


class LiveGusts:
    """The latest torque of samples ``dt`` s apart, and the gusts in it."""

    def __init__(self, dt: float) -> None:
        self._dt = dt
        self._torques: deque[Numbers] = deque(maxlen=round(MEMORY_SECONDS / dt))
        self._until = -np.inf

    def take(self, now: Estimate) -> Iterator[Fact]:
        """Yields gusts that have ended since the last time, about once a second.

        Where a motor changes, the torque is unknown for a while: what was before is no level of what comes.
        """
        if not np.isfinite(now.wind_torque):
            self._torques.clear()
            return
        self._torques.append((now.wind_time, now.wind_torque, now.wind_torque_band))
        long = len(self._torques) * self._dt >= 2 * RUNNING_LEVEL_SECONDS
        if not long or now.wind_time < self._until + 1.0:
            return
        time, torque, band = np.array(self._torques).T
        before = self._until
        self._until = time[-1]
        shortest = 0.0 if now.physical is None else min_gust_duration(now.physical, self._dt)
        series = Record(torque[:, None], torque[:, None], self._dt, (len(torque),))
        for gust in detect_gusts(torque, band, series, shortest).gusts:
            start = time[gust.sample]
            if before < start + gust.length < time[-1]:
                yield Fact(
                    Session.GUST_FELT,
                    clock=start,
                    torque=gust.size,
                    duration=gust.length,
                )
