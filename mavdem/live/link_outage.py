"""A link that was lost for a while in a flight that is over: what it changes in the judgement."""

from dataclasses import replace

from mavdem.assessment.judgement import Judgement
from mavdem.facts import Fact, Level
from mavdem.facts.assessment import Headline as HeadlineCode
from mavdem.facts.assessment import NextStep
from mavdem.facts.lights import Light
from mavdem.facts.session import LinkFact, SessionFact

VERDICTS_ON_FLIGHT = (HeadlineCode.NOTHING_WRONG, SessionFact.RECORDING_JUDGED)
"""Headlines of a flight that is over that may state that nothing is wrong."""


def judgement_with_outage(judgement: Judgement, outage: float) -> Judgement:
    """Adds to the judgement of a flight that is over that the link was lost for a while in flight.

    The light of the log warns of it. Where nothing else is wrong, the headline states it and warns, too, and the next
    step is what to do about the link. A fault of the vehicle keeps headline and next step.

    Args:
        judgement: judgement of the flight by this session, or by its recording.
        outage: longest time without messages in the flight, s.
    """
    lost_link = Fact(LinkFact.WAS_LOST_IN_FLIGHT, Level.WATCH, duration=outage)
    lights = dict(judgement.lights)
    if not lights[Light.LOG].is_watch_or_bad:
        lights[Light.LOG] = lost_link
    headline = headline_with_outage(judgement.headline, outage)
    if headline == judgement.headline:
        return replace(judgement, lights=lights)
    next_step = Fact(NextStep.DO_AS_ADVISED, reason=lost_link)
    return replace(judgement, headline=headline, next_step=next_step, lights=lights)


def headline_with_outage(headline: Fact, outage: float) -> Fact:
    """Adds to a verdict without a fault of the vehicle that the link was lost for a while in flight, and makes it warn.

    Args:
        headline: headline of a flight that is over, such as the verdict of its recording. One that states a fault, or
            no verdict, is returned as it is.
        outage: longest time without messages in the flight, s.
    """
    states_no_fault = headline.code in VERDICTS_ON_FLIGHT and not headline.is_watch_or_bad
    if not states_no_fault:
        return headline
    # A verdict that too little was checked stays unknown.
    level = Level.WATCH if headline.is_good else headline.level
    headline = headline.replace(level, outage=outage)
    if headline.code is SessionFact.RECORDING_JUDGED:
        # The library's next step, such as to keep the log, is not what matters most.
        lost_link = Fact(LinkFact.WAS_LOST_IN_FLIGHT, duration=outage)
        return headline.replace(next_step=lost_link.remedy)
    return headline
