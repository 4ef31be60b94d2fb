"""Lights as page and screen show them."""

from mavdem.facts import Fact, Level
from mavdem.facts.lights import Unjudged
from mavdem.facts.power import PowerLight
from mavdem.report.lights import lights_with_reason_once

ONLY_MULTIROTORS = Fact(Unjudged.MULTIROTORS_ONLY, kind="SUBMARINE")
SOUND = Fact(PowerLight.SUPPLY_HELD, voltage=5.0)


def test_that_only_multirotors_are_judged_is_stated_once():
    lights = {
        "motors": ONLY_MULTIROTORS,
        "power": SOUND,
        "tracking": ONLY_MULTIROTORS,
        "wind": ONLY_MULTIROTORS,
    }
    shown_lights = lights_with_reason_once(lights)
    assert list(shown_lights) == list(lights)
    assert (shown_lights["motors"], shown_lights["power"]) == (ONLY_MULTIROTORS, SOUND)
    for name in ("tracking", "wind"):
        assert (shown_lights[name].sentence, shown_lights[name].level) == (
            "Not judged.",
            Level.UNKNOWN,
        )


def test_lights_of_a_multirotor_are_shown_as_they_are():
    lights = {"motors": SOUND, "tracking": SOUND}
    assert lights_with_reason_once(lights) == lights


def test_a_reason_that_several_lights_share_is_stated_once():
    grounded = Fact(Unjudged.NOT_JUDGED, Level.UNKNOWN, reason=ONLY_MULTIROTORS)
    other_fact = Fact(Unjudged.NOT_JUDGED, Level.UNKNOWN, reason=SOUND)
    shown_lights = lights_with_reason_once(
        {"motors": grounded, "power": other_fact, "wind": grounded}
    )
    assert (shown_lights["motors"], shown_lights["power"]) == (grounded, other_fact)
    assert shown_lights["wind"].sentence == "Not judged."


def test_a_reason_that_the_headline_states_is_not_repeated():
    grounded = Fact(Unjudged.NOT_JUDGED, Level.UNKNOWN, reason=ONLY_MULTIROTORS)
    shown_lights = lights_with_reason_once({"motors": grounded}, ONLY_MULTIROTORS)
    assert shown_lights["motors"].sentence == "Not judged."
