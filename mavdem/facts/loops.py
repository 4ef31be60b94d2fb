"""What is said of control loops: their margins, why there are none, and gains."""

from __future__ import annotations

from enum import auto

from mavdem.facts.fact import Code


class Loops(Code):
    """Of the rate and the attitude loop of one axis."""

    MARGIN_RATING = auto()
