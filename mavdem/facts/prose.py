"""A sentence that is no fact yet."""

from __future__ import annotations

from enum import auto

from mavdem.facts.fact import Code, Fact


class Prose(Code):
    """Transitional: text made where it was found."""

    PROSE = auto()


def prose(text: str, remedy: str = "") -> Fact:
    """Returns a fact that holds ``text``."""
    return Fact(Prose.PROSE, text=text, remedy=remedy)
