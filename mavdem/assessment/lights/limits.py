"""Limits: from where on a figure is watched, and from where on it is bad; and which of several facts is the worst."""

from collections.abc import Iterable
from typing import NamedTuple

from mavdem.facts import Fact, Level

SEVERITY = (Level.UNKNOWN, Level.GOOD, Level.WATCH, Level.BAD)


class Limits(NamedTuple):
    """The values beyond which a figure is watched, and is bad."""

    watch: float
    bad: float

    def level(self, figure: float) -> Level:
        """Returns how a ``figure`` is judged that is worse the larger it is."""
        if figure > self.bad:
            return Level.BAD
        return Level.WATCH if figure > self.watch else Level.GOOD


def worst(facts: Iterable[Fact]) -> Fact:
    """Returns the worst of the facts, the first of such."""
    return max(facts, key=lambda fact: SEVERITY.index(fact.level))
