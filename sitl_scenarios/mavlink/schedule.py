"""When each stream of messages is due.

An autopilot's loop looks in each cycle which messages are due, and a message is due again its interval after it *was*
due, not after it was sent: so PX4's loop of 4 ms, asked for 100 Hz, sends after 12 and 8 ms by turns, and the mean rate
is the one asked for. What was due several times in one cycle is sent once. Sources: ``MavlinkStream::update`` in PX4's
``mavlink_stream.cpp``; ``GCS_MAVLINK::update_send`` in ArduPilot's ``GCS_Common.cpp``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

EARLY = 0.5e-6
"""Seconds before it is due that a message may be sent: half of what times are rounded to, so that none is a tie."""


@dataclass
class _Course:
    """Messages due at ``first``, ``first + interval``, …, of which ``sent`` have been."""

    first: float
    interval: float
    sent: int = 0


class Schedule:
    """The streams that are being sent.

    Attributes:
        usual: Hz by message that it begins with; 0 for one that is not sent.
    """

    def __init__(self, usual: Mapping[str, float], start: float, cycle: float, step: float, apart: bool) -> None:
        """Begins at the time ``start``, s, every stream a ``cycle``, s, after the one before if they are ``apart``.

        Intervals are rounded down to whole numbers of ``step``, s, and none is shorter than a cycle.
        """
        self.usual = dict(usual)
        self._step, self._cycle = step, cycle
        self._courses: dict[str, _Course] = {}
        for place, (name, rate) in enumerate(usual.items()):
            self.set(name, 1 / rate if rate else np.inf, start + place * cycle * apart)

    def set(self, name: str, interval: float, start: float) -> None:
        """From ``start`` on, s, sends a message every ``interval`` s; never, when that is infinite."""
        if np.isfinite(interval / self._step):
            # The loop looks once in a cycle: what is due more often is sent once.
            interval = max(int(interval / self._step + 1e-6) * self._step, self._cycle)
        self._courses[name] = _Course(start, interval)

    def interval(self, name: str) -> float:
        """Seconds between one message and the next; infinite for none."""
        return self._courses[name].interval

    def due(self, name: str, times: NDArray[np.float64]) -> NDArray[np.intp]:
        """In which of the next cycles, at ``times`` (N,), s, ascending, a message is sent.

        The times of one call come after those of the call before.
        """
        course = self._courses[name]
        if not np.isfinite(course.interval):
            return np.empty(0, dtype=np.intp)
        # One more than there can be: which of them are due is for one comparison to decide, since two might differ.
        until = int(np.floor((times[-1] + EARLY - course.first) / course.interval)) + 2
        due = course.first + course.interval * np.arange(course.sent, until)
        rows = np.searchsorted(times, due - EARLY)
        rows = rows[rows < len(times)]
        course.sent += len(rows)
        return np.unique(rows)
