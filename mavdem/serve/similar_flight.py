"""Which flight of a vehicle another one is best compared with: one without a finding, flown in like conditions.

A comparison of both then shows what changed of the vehicle, and not a fault of the other flight, or the weather.
"""

from collections.abc import Collection, Sequence
from math import log
from typing import NamedTuple

from mavdem.facts import Level
from mavdem.serve.index import LibraryEntry

LEVEL_RANKS = {Level.GOOD: 0, Level.UNKNOWN: 1, Level.WATCH: 2, Level.BAD: 3}
"""Order in which levels recommend a flight for a comparison: an unknown one less than a good one."""

MIN_SPEED = 1.0
"""Speed, m/s, below which speeds count as alike: the 90 % interval of a wind speed is rarely narrower."""

MIN_DISTANCE = 10.0
"""Distance, m, below which distances count as alike: a vehicle that holds its position drifts as far."""

MIN_FLIGHT_TIME = 1.0
"""Time in the air, s, below which times count as alike."""

UNKNOWN_DIFFERENCE = log(2)
"""How much a condition differs that is not known of both flights: as much as if one value were twice the other."""


class _Suitability(NamedTuple):
    """How well a flight suits a comparison; the smallest one, compared item by item, suits best."""

    motors: int
    """Rank of its motors by ``LEVEL_RANKS``."""
    headline: int
    """Rank of its headline, the worst of what was found, likewise."""
    difference: float
    """Difference of the conditions, 0 for equal ones."""


def most_similar_flight(
    flight: LibraryEntry, others: Sequence[LibraryEntry], baseline: Collection[str] = ()
) -> LibraryEntry | None:
    """Returns the flight with which another one is best compared.

    A flight with sound motors is preferred, of these one without any finding, and of these the one in the most similar
    conditions: wind, distance, mean speed and time in the air. A simulated flight is compared with a real one only if
    there is no other.

    Args:
        flight: the flight that is to be compared.
        others: further flights of its vehicle, with the verdicts that are shown. Of several that suit equally well, the
            first is returned.
        baseline: content hashes of the flights that count as healthy, by a user or by default; these count as flights
            without a finding.

    Returns:
        The flight; None if there are no others.
    """

    def suitability(other: LibraryEntry) -> _Suitability:
        """Returns how well another flight suits the comparison."""
        difference = condition_difference(flight, other)
        if other.content_hash in baseline:
            best_rank = LEVEL_RANKS[Level.GOOD]
            return _Suitability(best_rank, best_rank, difference)
        return _Suitability(_level_rank(other.motors), _level_rank(other.level), difference)

    same_kind = [other for other in others if other.simulated == flight.simulated]
    return min(same_kind or others, key=suitability, default=None)


def _level_rank(level: str) -> int:
    """Returns the rank of a level by ``LEVEL_RANKS``; an empty one, before a log is judged, is unknown."""
    return LEVEL_RANKS[Level(level or Level.UNKNOWN)]


def condition_difference(first: LibraryEntry, second: LibraryEntry) -> float:
    """Returns how much the conditions of two flights differ: the sum of the logarithms of four ratios.

    The four are wind speed, distance, mean speed over ground and time in the air. A flight at twice the speed and
    another one at half of it differ equally from a third one.

    Args:
        first: a flight.
        second: another flight.

    Returns:
        The sum, at least 0; a quantity that is not known of both flights counts as ``UNKNOWN_DIFFERENCE``.
    """
    return (
        _log_ratio(_wind_speed(first), _wind_speed(second), MIN_SPEED)
        + _log_ratio(first.distance, second.distance, MIN_DISTANCE)
        + _log_ratio(_mean_speed(first), _mean_speed(second), MIN_SPEED)
        + _log_ratio(first.flight_time, second.flight_time, MIN_FLIGHT_TIME)
    )


def _log_ratio(first: float | None, second: float | None, resolution: float) -> float:
    """Returns the absolute logarithm of the ratio of two values; ``UNKNOWN_DIFFERENCE`` if one is not known.

    Args:
        first: a value, at least 0.
        second: the other value.
        resolution: added to both, so that values which are small beside it count as alike.
    """
    if first is None or second is None:
        return UNKNOWN_DIFFERENCE
    return abs(log((first + resolution) / (second + resolution)))


def _wind_speed(flight: LibraryEntry) -> float | None:
    """Returns the middle of the 90 % interval of the wind speed in a flight, m/s; None if it is not known."""
    if flight.wind_low is None or flight.wind_high is None:
        return flight.wind_speed
    return (flight.wind_low + flight.wind_high) / 2


def _mean_speed(flight: LibraryEntry) -> float | None:
    """Returns the mean speed over ground in a flight, m/s; None if distance or time in the air are not known."""
    if flight.distance is None or not flight.flight_time:
        return None
    return flight.distance / flight.flight_time
