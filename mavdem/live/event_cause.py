"""Which fact is an event, such as a loss of control, and which fact an alarm is about."""

from mavdem.assessment.severity import FALLS
from mavdem.facts import Fact
from mavdem.facts.ending import Ending, MotionEvent
from mavdem.facts.events import ReportedEvent
from mavdem.facts.session import LinkFact, SessionFact
from mavdem.facts.watch import WatchFact


def cause_of_alarm(fact: Fact) -> Fact:
    """Returns the fact that is the cause of an alarm, such as a weak motor; any other fact is returned as it is.

    Args:
        fact: an alarm, the end of one, a link that was lost after one, or another fact.
    """
    if fact.code in (SessionFact.ALARM, WatchFact.ALARM_OVER):
        reason: Fact = fact.figures["reason"]
        return reason
    if fact.code is LinkFact.LOST_IN_FLIGHT and fact.figures["cause"] is not None:
        return cause_of_alarm(fact.figures["cause"])
    return fact


def is_event(fact: Fact) -> bool:
    """Returns whether a fact is an event: a loss or fall of the vehicle, or what its motion or its autopilot shows.

    Args:
        fact: any fact. The end of an alarm counts as an event if the alarm was about one.
    """
    code = fact.code
    if code is WatchFact.ALARM_OVER:
        code = fact.figures["reason"].code
    return code in FALLS or isinstance(code, (Ending, MotionEvent, ReportedEvent))
