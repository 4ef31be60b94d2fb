"""Lights as a page and a screen show them: a reason that holds for several lights is stated once."""

from mavdem.facts import Fact, Level, NamedFacts
from mavdem.facts.lights import Unjudged


def lights_with_reason_once(lights: NamedFacts) -> NamedFacts:
    """Returns lights in which only the first of those that judge multirotors only says that, with the vehicle's type.

    The others are shown as not judged. Documents keep the reason of each light.

    Args:
        lights: by name, in the order in which they are shown.
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
