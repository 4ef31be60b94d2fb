"""The verdict on one flight of several, in a live session or in a recording."""

from collections.abc import Sequence
from typing import NamedTuple

from mavdem.assessment.judgement import Judgement
from mavdem.assessment.severity import severity_rank
from mavdem.facts import Fact, Level
from mavdem.facts.session import LinkFact, SessionFact


class FlightVerdict(NamedTuple):
    """The verdict on one flight of a session or a recording, or on several flights of one boot of a recording."""

    number: int
    """Number of the flight, from 1, or of the first of several; 0 where no take-off was noticed."""

    judgement: Judgement
    """Its latest judgement: headline, next step and lights."""

    duration: float | None = None
    """Time from the take-off until the vehicle was in the air last, s; None where the take-off was not seen."""

    is_lost_in_air: bool = False
    """Whether the autopilot restarted after the last message in the air, so that the end of the flight is not known."""

    last_number: int | None = None
    """Number of the last flight, if the verdict is on several; None if it is on one."""

    @property
    def fact(self) -> Fact:
        """The headline of the flight, with the flight's number and duration."""
        headline = self.judgement.headline
        return Fact(
            SessionFact.FLIGHT_VERDICT,
            headline.level,
            number=self.number,
            duration=self.duration,
            is_lost_in_air=self.is_lost_in_air,
            last_number=self.last_number,
            reason=headline,
        )

    @property
    def fact_in_next_flight(self) -> Fact:
        """The headline of this flight as it is shown at the beginning of the next one.

        It is at most of level "watch": a fault of the flight before is no alarm about the present one.
        """
        fact = self.fact
        return fact.replace(Level.WATCH) if fact.is_bad else fact


def worst_first(verdicts: Sequence[FlightVerdict]) -> list[FlightVerdict]:
    """Returns the verdicts on flights from the worst to the best: a crash comes before a weak motor.

    A vehicle that is missing since it was in the air comes first: it must be searched, whatever earlier flights were.
    Of flights that are as bad (``severity_rank``) the latest comes first: its next step is the one to take.

    Args:
        verdicts: the verdicts in the order of the flights.
    """
    latest_first = reversed(verdicts)
    return sorted(latest_first, key=_order_by_severity)


def _order_by_severity(verdict: FlightVerdict) -> tuple[bool, int, int]:
    """Returns the key by which verdicts are sorted from the worst to the best.

    Args:
        verdict: the verdict on one flight.
    """
    headline = verdict.judgement.headline
    is_missing = headline.code is LinkFact.LOST_IN_FLIGHT
    return not is_missing, *severity_rank(headline)
