"""Lights as a page and a screen show them: a reason that holds for several lights is stated once."""

from mavdem.facts import Fact, Level, NamedFacts
from mavdem.facts.lights import Unjudged


def lights_with_reason_once(lights: NamedFacts) -> NamedFacts:
    """Returns the lights of a flight with the reason "only multirotors are judged" on the first light that has it.

    A light is the judgement of one part of the vehicle, such as its motors. Of a plane, several lights have this same
    reason, which names the vehicle's type. Repeated, it would fill the screen, so the others are only "not judged".
    Documents keep the reason of each light.

    Args:
        lights: the fact of each light by its name, in the order in which they are shown.
    """
    shown_lights = {}
    is_stated = False
    for name, fact in lights.items():
        is_for_multirotors = fact.code is Unjudged.MULTIROTORS_ONLY
        if is_for_multirotors and is_stated:
            fact = Fact(Unjudged.NOT_JUDGED, Level.UNKNOWN, because=None)
        is_stated = is_stated or is_for_multirotors
        shown_lights[name] = fact
    return shown_lights
