"""The order in which vehicles need a look."""

from mavdem.assessment.severity import severity_rank
from mavdem.facts import Fact, Level
from mavdem.facts.ending import Ending, MotionEvent
from mavdem.facts.urgency import Urgency, urgency_of_headline
from mavdem.facts.watch import WatchFact


def test_a_loss_ranks_above_other_bad_headlines_and_these_above_what_is_to_be_watched():
    headlines = [
        (Level.UNKNOWN, WatchFact.NO_OSCILLATION),
        (Level.GOOD, WatchFact.NO_OSCILLATION),
        (Level.WATCH, Ending.CRASHED),
        (Level.BAD, WatchFact.NO_OSCILLATION),
        (Level.BAD, MotionEvent.HIT),
        (Level.BAD, Ending.CRASHED),
    ]
    urgencies = []
    for level, code in headlines:
        _, rank = severity_rank(Fact(code, level))
        urgencies.append(urgency_of_headline(level, rank))
    assert urgencies == sorted(urgencies, reverse=True)
    assert len(set(urgencies)) == len(headlines)
    assert [urgency.needs_look for urgency in urgencies] == [False] * 3 + [True] * 3


def test_of_a_headline_of_an_earlier_version_only_the_level_is_known():
    assert urgency_of_headline("bad", None) is Urgency.BAD
