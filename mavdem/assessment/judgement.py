"""Judgement: the headline of what was found of a vehicle, and the one next step that fits its reason."""

from collections.abc import Sequence
from dataclasses import dataclass

from mavdem.assessment.axis.findings import Finding, next_step
from mavdem.assessment.evidence import Evidence
from mavdem.assessment.lights.estimator import estimator_light
from mavdem.assessment.lights.log import log_light
from mavdem.assessment.lights.margins import margins_light
from mavdem.assessment.lights.motors import motors_light
from mavdem.assessment.lights.power import power_light
from mavdem.assessment.lights.tracking import tracking_light
from mavdem.assessment.lights.vibration import vibration_light
from mavdem.assessment.lights.wind import wind_light
from mavdem.assessment.motion import FAR_ANGLE
from mavdem.facts import Fact, Level, NamedFacts
from mavdem.facts.assessment import Headline, NextStep
from mavdem.facts.ending import Ending
from mavdem.facts.events import Reported
from mavdem.facts.lights import Light, Unjudged
from mavdem.immutable import ImmutableResult

LIGHTS = {
    Light.MOTORS: motors_light,
    Light.VIBRATION: vibration_light,
    Light.TRACKING: tracking_light,
    Light.MARGINS: margins_light,
    Light.POWER: power_light,
    Light.ESTIMATOR: estimator_light,
    Light.WIND: wind_light,
    Light.LOG: log_light,
}
"""What judges by each light."""

OF_VEHICLE = [
    Light.MOTORS,
    Light.MARGINS,
    Light.TRACKING,
    Light.VIBRATION,
    Light.POWER,
    Light.ESTIMATOR,
]
"""What a vehicle is judged by, the most urgent first: a weak motor explains bad tracking."""
OF_LOG = (Light.LOG, Light.WIND)


@dataclass(frozen=True)
class Judgement(ImmutableResult):
    """The ``headline``, the ``next_step`` that fits its reason, and the eight ``lights`` by name."""

    headline: Fact
    next_step: Fact
    lights: NamedFacts


def judge(evidence: Evidence, purposes: Sequence[Finding] = (), **given: Fact) -> Judgement:
    """Returns the judgement by the ``evidence``, but for lights that are ``given`` by name.

    ``purposes`` are those of a model, graded.
    """
    lights = {str(light): given.get(light) or LIGHTS[light](evidence) for light in Light}
    if evidence.grounds:
        lights = {name: light.grounded for name, light in lights.items()}
    headline = headline_of(evidence, lights)
    of_model = next_step(purposes) if purposes else None
    return Judgement(headline, next_step_of(headline, lights, of_model), lights)


def unjudged(refusal: Fact) -> Judgement:
    """Returns the judgement where there is no evidence, because of the ``refusal``."""
    following = Fact(NextStep.DO_AS_ADVISED, because=refusal)
    unknown = Fact(Unjudged.NOT_JUDGED, because=refusal)
    return Judgement(refusal, following, dict.fromkeys(map(str, Light), unknown))


def headline_of(evidence: Evidence, lights: NamedFacts) -> Fact:
    """Returns the worst of what was found.

    How a flight that was lost ended outranks all else; then the first bad event or light, of losses the largest. A
    limit cycle goes before motors at their limits, which it explains. Without a flight it is why there is none. Of what
    is to be watched an attitude far from its setpoint comes first, and what the autopilot warned of in flight last.
    "Nothing wrong" is said of what was checked only.
    """
    oscillates = evidence.condition.oscillation is not None
    judged = [lights[light] for light in [*[Light.MARGINS] * oscillates, *OF_VEHICLE]]
    of_log = [lights[light] for light in OF_LOG]
    facts = filter(None, [evidence.ending, *evidence.events, *judged, *of_log])
    bad = [fact for fact in facts if fact.is_bad]
    if bad:
        alike = [fact for fact in bad if fact.code is bad[0].code]
        return max(alike, key=lambda fact: fact.figures.get("rise", 0.0))
    if not evidence.learnability.figures.airborne:
        return evidence.learnability.reason
    far = [event for event in evidence.events if event.figures.get("angle", 0.0) > FAR_ANGLE]
    for fact in [*far, *judged, *evidence.reported(tuple(Reported))]:
        if fact.level is Level.WATCH:
            return fact
    checked = [light for light in OF_VEHICLE if lights[light].is_good]
    unknown = [light for light in OF_VEHICLE if light not in checked]
    if not checked:
        # A log that has all that is needed is no reason.
        reason = unknown[0] if lights[Light.LOG].is_good else Light.LOG
        return Fact(Headline.NOTHING_CHECKED, because=lights[reason])
    # Nothing else shows a motor or propeller that is about to fail.
    level = Level.GOOD if Light.MOTORS in checked else Level.UNKNOWN
    loss = lights[Light.MOTORS].figures.get("most_loss")
    return Fact(Headline.NOTHING_WRONG, level, names=checked, missing=unknown, most_loss=loss)


def next_step_of(headline: Fact, lights: NamedFacts, of_model: Fact | None) -> Fact:
    """Returns what to do next: what the headline asks for or, where nothing is wrong, what would show more.

    What a bad power asks for is beside it: no other light explains that. After a loss so is what any bad light asks
    for, and the motor of a bad light is the ``suspect``. Of a vehicle that is sound and fully judged it is what its
    model is worth (``of_model``).
    """
    if headline.code is not Headline.NOTHING_WRONG:
        beside = [Light.POWER]
        if headline.code in Ending:
            beside = OF_VEHICLE
            motors = lights[Light.MOTORS]
            if motors.is_bad:
                headline = headline.but(suspect=motors.subject)
        also = [
            lights[light]
            for light in beside
            if lights[light].is_bad and lights[light].code not in Ending  # as the headline
        ]
        return Fact(NextStep.DO_AS_ADVISED, headline.level, because=headline, also=also)
    for light in (Light.LOG, *OF_VEHICLE):
        if not lights[light].is_good:
            return Fact(NextStep.DO_AS_ADVISED, because=lights[light])
    return of_model or Fact(NextStep.KEEP_MODEL)
