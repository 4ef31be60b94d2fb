"""The order of facts by severity, the worst first: of events in a short list, of flights, and of vehicles in a log."""

from mavdem.assessment.limits import LEVELS_BY_SEVERITY
from mavdem.facts import Fact
from mavdem.facts.ending import Ending, MotionEvent
from mavdem.facts.events import ReportedEvent
from mavdem.facts.watch import WatchFact

FALLS = (WatchFact.FALLS_AT_IDLE, WatchFact.STOPPED_IN_AIR, WatchFact.SINKS_AT_LIMIT)
"""Facts that a vehicle loses its height against its will."""

LESSER_EVENTS = (MotionEvent.CLIPPED, ReportedEvent.AUTOPILOT_SAID, ReportedEvent.RESTARTED)
"""Events that come after all others of their level: a peak of an accelerometer, a text of an unknown meaning, and a
restart on the ground. The one that matters most to a flight is the first."""


def severity_rank(fact: Fact) -> tuple[int, int]:
    """Returns the key by which facts are sorted from the worst to the least: level, then subject.

    Args:
        fact: an event or the headline of a flight, a coded finding with a level. Of an alarm that is over, its reason
            decides.

    Returns:
        Two numbers, both the lower the worse. The first is of the level. The second is 0 for the loss of a flight, such
        as a crash, 1 for what else happened to the vehicle, 2 for what forbids to fly before a repair, such as a weak
        motor, 3 for what else its parts or the autopilot show, such as a small margin, and from 4 on for
        ``LESSER_EVENTS``.
    """
    rank_of_level = -LEVELS_BY_SEVERITY.index(fact.level)
    if fact.code is WatchFact.ALARM_OVER:
        _, rank_of_subject = severity_rank(fact.figures["reason"])
        return rank_of_level, rank_of_subject
    if fact.code in LESSER_EVENTS:
        return rank_of_level, 4 + LESSER_EVENTS.index(fact.code)
    if isinstance(fact.code, Ending) or fact.code in FALLS:
        return rank_of_level, 0
    if isinstance(fact.code, MotionEvent):
        return rank_of_level, 1
    return rank_of_level, 2 if fact.forbids_flight else 3
