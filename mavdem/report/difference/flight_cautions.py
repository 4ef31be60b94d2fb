"""Cautions on the flights of two compared states: flights that belong to both, and states that are a mixture."""

from typing import NamedTuple

from mavdem.facts import Level
from mavdem.facts.lights import Light
from mavdem.fleet.comparability import STATE_NAMES
from mavdem.fleet.report_columns import value_at
from mavdem.report.blocks import Sentence, caution
from mavdem.report.difference.lights import WARNING_LEVELS
from mavdem.report.difference.reviewed import ReviewedDifference
from mavdem.report.templates import render_section


class MixedSide(NamedTuple):
    """A side of a comparison whose motors were good in some flights and not in others."""

    side: str
    """The side, "A" or "B"."""

    good: int
    """Number of flights with good motors."""

    warned: int
    """Number of flights whose motors are bad or to be watched."""

    total: int
    """Number of all flights, also of those whose motors could not be judged."""


def flight_cautions(reviewed: ReviewedDifference) -> list[Sentence]:
    """Returns the warnings on the flights that are compared.

    One says which flights belong to both sides, and on which side they count. Another one says that the flights of a
    side are of several states of the vehicle, so that means over them are of none.

    Args:
        reviewed: comparison of two states, of which one or both are fleets.
    """
    sentences = render_section(
        "difference_flights",
        files=reviewed.common_files,
        are_same=not reviewed.counting_side,
        counting_side=reviewed.counting_side,
        mixed_sides=mixed_sides(reviewed),
    )
    return [caution(sentence.text) for sentence in sentences]


def mixed_sides(reviewed: ReviewedDifference) -> list[MixedSide]:
    """Returns the sides of a comparison whose motors were good in some flights and bad or to be watched in others.

    The means over such flights describe neither the sound vehicle nor the faulty one.

    Args:
        reviewed: comparison of two states, of which one or both are fleets.
    """
    sides = []
    for side in STATE_NAMES:
        mixed_side = _mixed_side(reviewed, side)
        if mixed_side is not None:
            sides.append(mixed_side)
    return sides


def _mixed_side(reviewed: ReviewedDifference, side: str) -> MixedSide | None:
    """Returns in how many flights of a side the motors were good, and in how many not; None unless there are both."""
    review = reviewed.reviews.get(side, {})
    levels = value_at(review, f"lights.{Light.MOTORS}.levels") or []
    good = levels.count(Level.GOOD)
    warned = sum(levels.count(level) for level in WARNING_LEVELS)
    if not good or not warned:
        return None
    return MixedSide(side, good, warned, total=len(levels))
