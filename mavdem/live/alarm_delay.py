"""By how much the alarms of a live session come late, held for some seconds so that the advice to a pilot stays put."""

from collections import deque
from typing import NamedTuple

MAX_ALARM_DELAY = 3.0
"""Delay of the alarms from which on a pilot must not rely on them, s: a choice; a vehicle may fall within it."""

RELIABLE_ALARM_DELAY = MAX_ALARM_DELAY / 2
"""Delay of the alarms below which a pilot may rely on them again, s: a choice, the ratio of postponed tasks."""

HOLD_SECONDS = 30.0
"""Time without a longer delay than ``RELIABLE_ALARM_DELAY`` after which alarms are reliable again, s: a choice.

A busy computer is late again and again: the same advice must not come and go every few seconds.
"""


class TimedDelay(NamedTuple):
    """A measured delay of the analysis."""

    time: float
    """When it was measured, s of the monotonic clock."""

    delay: float
    """How long the oldest frames had waited then, s."""


class AlarmDelay:
    """Holds the delay of late alarms: one long delay counts at once, and until none was long for ``HOLD_SECONDS``.

    Attributes:
        seconds: the longest delay of the last ``HOLD_SECONDS``, s; 0 while a pilot may rely on the alarms.
    """

    def __init__(self) -> None:
        """Begins with alarms that come in time."""
        self.seconds = 0.0
        self._latest = deque[TimedDelay]()

    def update(self, delay: float, now: float) -> None:
        """Takes the present delay into account.

        Args:
            delay: how long the oldest frames that are not analysed have waited, s.
            now: present time, s of the monotonic clock.
        """
        self._latest.append(TimedDelay(now, delay))
        while now - self._latest[0].time > HOLD_SECONDS:
            self._latest.popleft()
        longest_delay = max(measured.delay for measured in self._latest)
        were_alarms_late = self.seconds > 0.0
        limit = RELIABLE_ALARM_DELAY if were_alarms_late else MAX_ALARM_DELAY
        self.seconds = longest_delay if longest_delay >= limit else 0.0
