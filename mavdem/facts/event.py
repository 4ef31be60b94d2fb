"""Event: a fact of a flight, at the time when it became known."""

from math import isfinite, nan
from typing import NamedTuple

from mavdem.facts.fact import Fact


class Event(NamedTuple):
    """What happened.

    Attributes:
        seconds: UNIX s of the bytes that caused it for a stream, s of the vehicle's clock in a history.
        fact: what it was; its time is that of its boot's clock.
        since: when what a history's fact is about began, s of the same clock as ``seconds``; otherwise NaN.
    """

    seconds: float
    fact: Fact
    since: float = nan

    @property
    def sentence(self) -> str:
        """What happened, and what to do about it."""
        return self.fact.advised

    @property
    def has_time(self) -> bool:
        """Whether its time is known: what was so before the record has no finite one."""
        return isfinite(self.seconds)

    @property
    def is_alarm(self) -> bool:
        """Whether it is bad."""
        return self.fact.is_bad
