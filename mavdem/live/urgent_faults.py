"""Which fault is the most urgent one for a pilot in flight, and whether it calls for a landing now."""

from mavdem.assessment.limits import LEVELS_BY_SEVERITY
from mavdem.facts import Fact
from mavdem.live.event_cause import is_event
from mavdem.live.recording_judgement import PERMANENT_FAULTS
from mavdem.live.session_state import SessionState


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
    return max(
        (headline, *session.active_alarms), key=lambda fact: _urgency_in_flight(session, fact)
    )


def _urgency_in_flight(session: SessionState, fact: Fact) -> tuple[int, int]:
    """Returns how urgent a fact is for a pilot in flight: the greater of two such pairs is more urgent.

    The first number is 4 for a bad event that lasts, 3 for another bad fault that lasts, 2 for a bad event that is
    over, 1 for an alarm that is only to be watched, and 0 for anything else. The second one is the rank of the
    level.

    Args:
        session: what the session has received and found until now.
        fact: the headline, or an active alarm.
    """
    level_rank = LEVELS_BY_SEVERITY.index(fact.level)
    if fact.is_bad:
        if _is_past_event(session, fact):
            return 2, level_rank
        return (4 if is_event(fact) else 3), level_rank
    return (1 if fact in session.active_alarms else 0), level_rank
