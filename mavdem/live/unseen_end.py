"""A flight whose end was not seen: its messages ended in the air, and the autopilot has restarted since.

The vehicle may have landed while its link was lost, or a crash or a failure of its power may have ended the flight.
"""

from dataclasses import replace

from mavdem.assessment.judgement import Judgement
from mavdem.facts import Fact
from mavdem.facts.assessment import NextStep
from mavdem.facts.ending import MotionEvent
from mavdem.facts.session import SessionFact


def judgement_with_unseen_end(judgement: Judgement) -> Judgement:
    """Returns the judgement of a flight whose end was not seen: it is not called sound, whatever was checked before.

    Args:
        judgement: judgement of the flight until its last message. A bad fault keeps headline and next step; one that is
            only to be watched becomes the ``cause`` of the new headline, which names it.
    """
    former_headline = judgement.headline
    if former_headline.is_bad:
        return judgement
    is_fault = (
        former_headline.is_watch_or_bad and former_headline.code is not MotionEvent.LOG_ENDED_IN_AIR
    )
    headline = Fact(SessionFact.END_NOT_SEEN, cause=former_headline if is_fault else None)
    next_step = Fact(NextStep.DO_AS_ADVISED, reason=headline)
    return replace(judgement, headline=headline, next_step=next_step)
