"""Clock: the boot clock as it is shown, which goes on where a reboot sets the vehicle's own back."""

from __future__ import annotations

from math import isfinite

BACK = 2.0
"""Seconds; a boot clock that jumps back further was started anew. Lines of the log may be about a moment ago."""
PAUSE = 1.0
"""Seconds shown between the last that was heard before a reboot and the first after it."""


class Clock:
    """Places times of the boot clock on one timeline that never runs back.

    A user follows a flight from left to right. A second timeline, or one that begins anew below the first, would show
    the old flight where the new one is. So after a reboot time goes on, and ``shift`` says by how much.

    Attributes:
        shift: shown time less boot clock, s; 0 until the vehicle reboots.
        latest: the latest time shown, s.
    """

    def __init__(self) -> None:
        self.shift = 0.0
        self.latest = 0.0
        self._started = False

    def shown(self, time: float | None) -> float:
        """Where on the timeline a time of the boot clock is, s; with ``None``, or what is no time, the latest."""
        if time is None or not isfinite(time):
            return self.latest
        if self._started and time + self.shift < self.latest - BACK:
            self.shift = self.latest + PAUSE - time
        self.latest = max(self.latest, time + self.shift) if self._started else time
        self._started = True
        return time + self.shift
