"""Status lights, judgements of a vehicle's parts: facts (coded findings) whose shared sentences are stated once."""

from mavdem.facts import Fact, Level, NamedFacts
from mavdem.facts.lights import Unjudged

REASONED_CODES = (Unjudged.MULTIROTORS_ONLY, Unjudged.NOT_JUDGED, Unjudged.JUDGED_LATER)
"""Codes of lights that are not judged, whose sentence has the reason."""


def lights_with_reason_once(lights: NamedFacts, headline_fact: Fact | None = None) -> NamedFacts:
    """Returns the status lights of a flight for display, in which a reason that several share is stated only once.

    Of a plane, or of a vehicle that did not fly, several lights are not judged for the same reason. Repeated, it would
    fill the screen. So the first of these lights states it, and the others are only "not judged"; all are if the
    headline of the flight is the reason. JSON documents keep the reason of each light.

    Args:
        lights: the judgement of each part of the vehicle, such as its motors, by name: a fact (a coded finding) with a
            level.
        headline_fact: the most important finding, which stands above or below the lights; None if it is not known yet.

    Returns:
        The lights in the same order.
    """
    shown_lights = {}
    stated_reasons = set()
    if headline_fact is not None:
        stated_reasons.add(Fact(Unjudged.NOT_JUDGED, Level.UNKNOWN, reason=headline_fact).sentence)
    for name, fact in lights.items():
        if fact.code in REASONED_CODES:
            reason = fact.sentence
            if reason in stated_reasons:
                fact = Fact(Unjudged.NOT_JUDGED, Level.UNKNOWN, reason=None)
            stated_reasons.add(reason)
        shown_lights[name] = fact
    return shown_lights


def earlier_lights(lights: NamedFacts) -> dict[str, str]:
    """Finds the status lights that warn of the same as an earlier one, so that a list need not repeat the sentence.

    Args:
        lights: the judgement of each part of the vehicle, such as its motors, by name: a fact (a coded finding) with a
            level; in the order of the list.

    Returns:
        For each such light the name of the first light with the same sentence, to which the list refers.
    """
    first_light_by_sentence: dict[str, str] = {}
    repeated_lights = {}
    for name, fact in lights.items():
        first_light = first_light_by_sentence.setdefault(fact.sentence, name)
        if fact.is_watch_or_bad and first_light != name:
            repeated_lights[name] = first_light
    return repeated_lights
