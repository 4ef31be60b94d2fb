"""Cautions on the flights of two compared states: flights that belong to both, and states that are a mixture."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from mavdem.containers import JsonValues
from mavdem.facts import Level
from mavdem.facts.lights import Light
from mavdem.fleet.comparability import STATE_NAMES
from mavdem.fleet.report_columns import value_at
from mavdem.report.blocks import Sentence, caution
from mavdem.report.difference.lights import (
    REFERENCE,
    STATES_WORST_FIRST,
    WARNING_LEVELS,
    states_in_flights,
)
from mavdem.report.difference.reviewed import ReviewedDifference
from mavdem.report.numbers import listed
from mavdem.report.templates import render_section

MAX_NAMED_FLIGHTS = 6
"""Flights of one state that a caution names, from the first on: a choice, two lines."""


class MixedSide(NamedTuple):
    """A side of a comparison whose motors warn in some flights and not in others."""

    side: str
    """The side, "A" or "B"."""

    counts: dict[str, int]
    """Number of flights by the state of their motors, such as "bad" or "reference", the worst first."""

    total: int
    """Number of all flights, also of those whose motors could not be judged."""

    are_apart_in_days: bool
    """Whether flights with a warning and flights without were flown on different days, so that days can part them."""

    smaller_group: str
    """Names of the flights with a warning or of those without, whichever are fewer, as text; empty where not known."""

    has_smaller_group_warning: bool
    """Whether these are the flights with a warning."""

    @property
    def has_sound_flights(self) -> bool:
        """Whether the motors are good in some flight, or in a flight with which others are compared as healthy."""
        return any(state in self.counts for state in (Level.GOOD, REFERENCE))

    @property
    def has_unjudged_flights(self) -> bool:
        """Whether the motors of some flight could not be judged."""
        return Level.UNKNOWN in self.counts


def flight_cautions(reviewed: ReviewedDifference) -> list[Sentence]:
    """Returns the warnings on the flights that are compared.

    One says which flights belong to both sides, and on which side they count. Another one says that the flights of a
    side are of several states of the vehicle, so that means over them are of none. The last one is a remark: a log does
    not show whether its flight was simulated as the other was.

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
    cautions = [caution(sentence.text) for sentence in sentences]
    if reviewed.simulated_sides and reviewed.sides_of_unknown_origin:
        cautions += render_section(
            "difference_unknown_origin",
            simulated_sides=reviewed.simulated_sides,
            unknown_sides=reviewed.sides_of_unknown_origin,
        )
    return cautions


def mixed_sides(reviewed: ReviewedDifference) -> list[MixedSide]:
    """Returns the sides of a comparison whose motors are bad or to be watched in some flights and not in others.

    The means over such flights describe neither the sound vehicle nor the faulty one. Flights whose motors could not
    be judged may be of either state.

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
    """Returns a side whose motors warn in some flights and not in others; None if they warn in all or in none.

    Args:
        reviewed: comparison of two states, with the review documents of both sides.
        side: "A" or "B".
    """
    light = value_at(reviewed.reviews.get(side, {}), f"lights.{Light.MOTORS}") or {}
    states = states_in_flights(light) if light else []
    warned_count = sum(states.count(level) for level in WARNING_LEVELS)
    if warned_count in (0, len(states)):
        return None
    warned_flights = []
    other_flights = []
    for state, flight in zip(states, light.get("flights") or (), strict=False):
        if state in WARNING_LEVELS:
            warned_flights.append(flight)
        else:
            other_flights.append(flight)
    is_warning_rarer = len(warned_flights) <= len(other_flights)
    return MixedSide(
        side,
        counts={state: states.count(state) for state in STATES_WORST_FIRST if state in states},
        total=len(states),
        are_apart_in_days=_are_on_different_days(warned_flights, other_flights),
        smaller_group=_flight_names(warned_flights if is_warning_rarer else other_flights),
        has_smaller_group_warning=is_warning_rarer,
    )


def _are_on_different_days(
    first_flights: Iterable[JsonValues], second_flights: Iterable[JsonValues]
) -> bool:
    """Returns whether no two flights of two groups were flown on the same day; False if some day is not known.

    Args:
        first_flights, second_flights: flights as a review document has them, each with its ``day``, empty if unknown.
    """
    first_days = {flight["day"] for flight in first_flights}
    second_days = {flight["day"] for flight in second_flights}
    are_days_known = "" not in first_days | second_days
    return are_days_known and first_days.isdisjoint(second_days)


def _flight_names(flights: Sequence[JsonValues]) -> str:
    """Returns the file names of flights as text, such as "a.bin and b.bin"; of many the first ones, and how many more.

    Args:
        flights: flights of a fleet as its review document has them, each with its ``file``.
    """
    names = [flight["file"] for flight in flights[:MAX_NAMED_FLIGHTS]]
    further_count = len(flights) - len(names)
    if further_count:
        names.append(f"{further_count} more")
    return listed(names)
