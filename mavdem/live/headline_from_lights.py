"""The headline that a judgement gets from its lights, and the next step that follows from it.

The headline is the fact that matters most. A light judges one part of the vehicle, such as its motors.
"""

from dataclasses import replace

from mavdem.assessment.headline import headline_by_lights
from mavdem.assessment.judgement import Judgement
from mavdem.assessment.next_step import choose_next_step
from mavdem.facts import Fact, NamedFacts
from mavdem.facts.margins import MarginsLight
from mavdem.live.event_cause import is_event


def judgement_from_headline(headline: Fact, lights: NamedFacts) -> Judgement:
    """Returns a judgement with a headline and the next step that follows from it.

    Args:
        headline: the fact that matters most.
        lights: the fact on each part of the vehicle, by the name of the part.
    """
    return Judgement(headline, choose_next_step(headline, lights), lights)


def judgement_with_summary_of_lights(judgement: Judgement) -> Judgement:
    """Replaces the headline of a judgement by one that sums up its lights: the worst of them, or that all are good.

    A headline that warns brings its own next step, unlike any other: then the next step of the judgement stays, such as
    to fly until a model is learned.

    Args:
        judgement: headline, next step (what the pilot should do), and lights: the judgement of each part of the vehicle
            as a fact with a level.
    """
    headline = headline_by_lights(judgement.lights)
    if headline.is_watch_or_bad:
        return judgement_from_headline(headline, judgement.lights)
    return replace(judgement, headline=headline)


def judgement_with_bad_lights(judgement: Judgement) -> Judgement:
    """Returns a judgement whose headline states the most important bad fault of the vehicle.

    An event, such as a loss of control, comes before what causes it, such as vibration; then an oscillation, since it
    drives the motors to their limits. Of other faults the headline's comes first, and then that of the first bad light.

    Args:
        judgement: headline, next step, and for each part of the vehicle a light, which judges it; at least one is bad.
    """
    faults = [fact for fact in (judgement.headline, *judgement.lights.values()) if fact.is_bad]
    events = [fault for fault in faults if is_event(fault)]
    oscillations = [fault for fault in faults if fault.code is MarginsLight.OSCILLATES]
    most_important_fault = (events or oscillations or faults)[0]
    if most_important_fault == judgement.headline:
        return judgement
    return judgement_from_headline(most_important_fault, judgement.lights)
