"""Status lights, judgements of a vehicle's parts: facts (coded findings) whose shared sentences are stated once."""

from mavdem.facts import Fact, Level, NamedFacts
from mavdem.facts.lights import Unjudged

REASONED_CODES = (Unjudged.MULTIROTORS_ONLY, Unjudged.NOT_JUDGED, Unjudged.JUDGED_LATER)
"""Codes of lights that are not judged, whose sentence has the reason."""


def lights_with_reason_once(lights: NamedFacts) -> NamedFacts:
    """Returns the lights of a flight, with a reason why several are not judged on the first light that has it.

    A light is the judgement of one part of the vehicle, such as its motors. Of a plane, or of a vehicle that did not
    fly, several lights have the same reason. Repeated, it would fill the screen, so the others are only "not judged".
    Documents keep the reason of each light.

    Args:
        lights: the judgement of each part of the vehicle, a fact with a level, by name, in the order shown.
    """
    shown_lights = {}
    stated_reasons = set()
    for name, fact in lights.items():
        if fact.code in REASONED_CODES:
            reason = fact.sentence
            if reason in stated_reasons:
                fact = Fact(Unjudged.NOT_JUDGED, Level.UNKNOWN, reason=None)
            stated_reasons.add(reason)
        shown_lights[name] = fact
    return shown_lights


def earlier_lights(lights: NamedFacts) -> dict[str, str]:
    """Returns, by each light that warns of the same as an earlier one, the name of the first that says so.

    Where the lights are shown, it refers to that light instead of repeating the sentence.

    Args:
        lights: the judgement of each part of the vehicle, a fact with a level, by name, in the order shown.
    """
    first_lights: dict[str, str] = {}
    repeated_lights = {}
    for name, fact in lights.items():
        first = first_lights.setdefault(fact.sentence, name)
        if fact.warns and first != name:
            repeated_lights[name] = first
    return repeated_lights
