"""A sentence that is no fact yet."""

from __future__ import annotations

from enum import auto

from mavdem.facts.fact import Code, Fact


class Prose(Code):
    """Transitional: text made where it was found."""

    PROSE = auto()


def prose(text: str | Fact, remedy: str = "") -> Fact:
    """Returns a fact that holds ``text``; one that is a fact already as it is."""
    if isinstance(text, Fact):
        return text
    return Fact(Prose.PROSE, text=text, remedy=remedy)
