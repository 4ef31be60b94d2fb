"""Event: a fact of a flight, at the time when it became known."""

from math import isfinite, nan
from typing import NamedTuple

from mavdem.facts.fact import Fact


class Event(NamedTuple):
    """What happened.

    Attributes:
        seconds: UNIX s of the bytes that caused it for a stream, s of the vehicle's clock in a history.
        fact: what it was; its time is that of its boot's clock.
        start_time: when what a history's fact is about began, s of the same clock as ``seconds``; otherwise NaN.
        reception: UNIX s when a live session reported it; NaN of an event in a log.
        clock: the vehicle's own boot clock then, s; NaN where that was not known, or in a log.
        boot: number of that boot, from 0.
    """

    seconds: float
    fact: Fact
    start_time: float = nan
    reception: float = nan
    clock: float = nan
    boot: int = 0

    @property
    def sentence(self) -> str:
        """What happened, and what to do about it."""
        return self.fact.sentence_and_remedy

    @property
    def has_time(self) -> bool:
        """Whether its time is known: what was so before the record has no finite one."""
        return isfinite(self.seconds)

    @property
    def is_alarm(self) -> bool:
        """Whether it is bad."""
        return self.fact.is_bad
