"""How urgently a vehicle needs a look, by which the lists of a fleet and of a library begin with the worst."""

from enum import IntEnum

from mavdem.facts.fact import Level


class Urgency(IntEnum):
    """How urgently a vehicle needs a look; lists are sorted by it, the most urgent first.

    What has happened comes before what is probable: a crash ranks above a motor that probably lost thrust.
    """

    LOST = 0
    """The vehicle was lost in flight."""

    INCIDENT = 1
    """Something else that is bad happened to the vehicle."""

    BAD = 2
    """A part is bad, such as a motor with a fault."""

    DRIFT = 3
    """Figures of the motors drift away from those of healthy flights."""

    WATCH = 4
    """Something is to be watched."""

    GOOD = 5
    """Nothing wrong was found."""

    UNKNOWN = 6
    """Nothing could be judged."""

    @property
    def needs_look(self) -> bool:
        """Whether the vehicle needs a look before its next flight."""
        return self <= Urgency.DRIFT


URGENCY_OF_LEVELS = {
    Level.BAD: Urgency.BAD,
    Level.WATCH: Urgency.WATCH,
    Level.GOOD: Urgency.GOOD,
    Level.UNKNOWN: Urgency.UNKNOWN,
}
"""Urgency by the level of a headline alone."""

URGENCY_OF_BAD_RANKS = {0: Urgency.LOST, 1: Urgency.INCIDENT}
"""Urgency of bad headlines by their rank among those of their level (``assessment.severity.severity_rank``)."""


def urgency_of_headline(level: str | None, rank: int | None) -> Urgency:
    """Returns how urgently a vehicle needs a look, by the headline (the most serious fact) of its latest flight.

    The level of the headline decides. Among bad headlines the rank decides too: the loss of a vehicle is more urgent
    than another incident, and that is more urgent than a bad part.

    Args:
        level: level of the headline: "good", "watch", "bad" or "unknown"; None or empty for a flight without a
            headline.
        rank: rank of the headline among those of its level: 0 for the loss of the vehicle, 1 for another incident, more
            for anything else (``assessment.severity.severity_rank``). None where it is not known, as in tables that
            earlier versions wrote.
    """
    if not level:
        return Urgency.UNKNOWN
    urgency = URGENCY_OF_LEVELS[Level(level)]
    if urgency is Urgency.BAD and rank in URGENCY_OF_BAD_RANKS:
        return URGENCY_OF_BAD_RANKS[rank]
    return urgency
