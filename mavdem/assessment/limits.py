"""Limits: from where on a figure is watched, and from where on it is bad."""

from __future__ import annotations

from typing import NamedTuple

from mavdem.facts import Level


class Limits(NamedTuple):
    """The values beyond which a figure is watched, and is bad."""

    watch: float
    bad: float

    def level(self, figure: float) -> Level:
        """Returns how a ``figure`` is judged that is worse the larger it is."""
        if figure > self.bad:
            return Level.BAD
        return Level.WATCH if figure > self.watch else Level.GOOD
