"""Which fault is the most urgent one for a pilot in flight, and whether it calls for a landing now."""

from enum import IntEnum

from mavdem.assessment.limits import LEVELS_BY_SEVERITY
from mavdem.facts import Fact
from mavdem.live.event_cause import is_event
from mavdem.live.recording_judgement import PERMANENT_FAULTS
from mavdem.live.session_state import SessionState


class Urgency(IntEnum):
    """How urgent a fact is for a pilot in flight, the most urgent last.

    An event, such as a loss of control, comes before other faults, such as vibration, which may be its cause.
    """

    NOT_URGENT = 0
    ALARM_TO_WATCH = 1
    BAD_EVENT_THAT_IS_OVER = 2
    BAD_FAULT = 3
    BAD_EVENT = 4


def is_urgent(session: SessionState, headline: Fact) -> bool:
    """Returns whether the pilot should land now, because of what a headline in flight states.

    That is the case for an active alarm, and for a bad fault that began in flight and is not over. Small stability
    margins, for example, are no reason: the vehicle had them at its take-off (``PERMANENT_FAULTS``).

    Args:
        session: what the session has received and found until now.
        headline: the headline, a fact about the vehicle.
    """
    if headline in session.active_alarms:
        return True
    is_permanent = headline.code in PERMANENT_FAULTS
    return headline.is_bad and not is_permanent and not _is_past_event(session, headline)


def _is_past_event(session: SessionState, fact: Fact) -> bool:
    """Returns whether a fact is an event that is over: it has an end, and no alarm on it is active any more.

    Args:
        session: what the session has received and found until now.
        fact: any fact about the flight.
    """
    is_alarm = any(
        alarm.code is fact.code and alarm.subject == fact.subject for alarm in session.active_alarms
    )
    return is_event(fact) and fact.end_time is not None and not is_alarm


def alarm_or_headline(session: SessionState, headline: Fact) -> Fact:
    """Returns the most urgent of a headline and the active alarms; of equally urgent ones the headline.

    For example, the alarm of a loss of control comes before vibration, which may be its cause.

    Args:
        session: what the session has received and found until now.
        headline: headline of the judgement: its first sentence on the screen, as a fact.
    """

    def rank(fact: Fact) -> tuple[Urgency, int]:
        """Returns the urgency of a fact and, to compare equally urgent ones, the rank of its level."""
        return _urgency(session, fact), LEVELS_BY_SEVERITY.index(fact.level)

    return max((headline, *session.active_alarms), key=rank)


def _urgency(session: SessionState, fact: Fact) -> Urgency:
    """Returns how urgent a fact is for a pilot in flight.

    Args:
        session: what the session has received and found until now.
        fact: the headline, or an active alarm.
    """
    if not fact.is_bad:
        is_alarm = fact in session.active_alarms
        return Urgency.ALARM_TO_WATCH if is_alarm else Urgency.NOT_URGENT
    if _is_past_event(session, fact):
        return Urgency.BAD_EVENT_THAT_IS_OVER
    return Urgency.BAD_EVENT if is_event(fact) else Urgency.BAD_FAULT
