"""Which flight of a vehicle is most like another one: a comparison of both shows the vehicle, and not the weather."""

from collections.abc import Sequence

from mavdem.serve.index import LibraryEntry

MAX_DURATION_RATIO = 2.0
"""Ratio of the settled times of two similar flights, at most: a choice.

The intervals of what is estimated in both then differ by a factor of about √2 at most.
"""


def most_similar_flight(
    flight: LibraryEntry, others: Sequence[LibraryEntry]
) -> LibraryEntry | None:
    """Returns the flight that agrees with another one in most of three conditions: wind, duration, and simulator.

    Args:
        flight: the flight that is to be compared.
        others: further flights of its vehicle. Of several that agree in equally many conditions, the first is returned.

    Returns:
        The flight; None if there are no others.
    """
    return max(others, key=lambda other: _shared_conditions(flight, other), default=None)


def _shared_conditions(first: LibraryEntry, second: LibraryEntry) -> int:
    """Returns in how many conditions two flights agree, 0 to 3."""
    conditions = (
        have_similar_wind(first, second),
        have_similar_duration(first, second),
        first.simulated == second.simulated,
    )
    return sum(conditions)


def have_similar_wind(first: LibraryEntry, second: LibraryEntry) -> bool:
    """Returns whether the 90 % intervals of the wind speeds in two flights overlap; False if one is not known."""
    if first.wind_low is None or first.wind_high is None:
        return False
    if second.wind_low is None or second.wind_high is None:
        return False
    return first.wind_low <= second.wind_high and second.wind_low <= first.wind_high


def have_similar_duration(first: LibraryEntry, second: LibraryEntry) -> bool:
    """Returns whether one flight was settled for at most ``MAX_DURATION_RATIO`` times as long as the other."""
    if not first.duration or not second.duration:
        return False
    shorter, longer = sorted((first.duration, second.duration))
    return longer <= MAX_DURATION_RATIO * shorter
