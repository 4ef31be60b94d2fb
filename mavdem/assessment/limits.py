"""Limits beyond which a figure is to be watched or bad, and the worst of several facts."""

from collections.abc import Iterable
from typing import NamedTuple

from mavdem.facts import Fact, Level

LEVELS_BY_SEVERITY = (Level.UNKNOWN, Level.GOOD, Level.WATCH, Level.BAD)
"""The levels of facts, the least severe first: a fact that is good hides one that is unknown."""


class Limits(NamedTuple):
    """Limits of a figure that is worse the larger it is.

    Limits of a voltage, which is worse the lower it is, are compared directly.
    """

    watch: float
    """The figure is to be watched beyond this."""
    bad: float
    """The figure is bad beyond this."""

    def level(self, figure: float) -> Level:
        """Returns the level of a ``figure`` that is worse the larger it is."""
        if figure > self.bad:
            return Level.BAD
        return Level.WATCH if figure > self.watch else Level.GOOD


def worst_fact(facts: Iterable[Fact]) -> Fact:
    """Returns the fact with the most severe level, the first of several; ``facts`` must not be empty."""
    return max(facts, key=lambda fact: LEVELS_BY_SEVERITY.index(fact.level))
