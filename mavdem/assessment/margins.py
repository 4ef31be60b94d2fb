"""The light on margins: a limit cycle, or the worst of the axes; else what keeps them from being known."""

from math import inf

from mavdem.alignment.drive import TILT_AXES
from mavdem.assessment.axis_margins import of_response
from mavdem.assessment.evidence import Evidence
from mavdem.assessment.limits import worst
from mavdem.facts import Fact, Level
from mavdem.facts.margins import MarginsLight


def margins_light(evidence: Evidence) -> Fact:
    """Returns the light on margins: a limit cycle, or the worst of the axes; else what keeps them from being known."""
    oscillation = evidence.condition.oscillation
    if oscillation is not None:
        return Fact(MarginsLight.OSCILLATES, because=evidence.lowered, **oscillation.figures)
    facts = [fact for axis in evidence.margins for fact in axis.facts]
    facts.sort(key=lambda fact: fact.figures.get("share", inf))
    if facts and (light := worst(facts)).level in (Level.BAD, Level.WATCH):
        return light.but(path=evidence.log.source)
    enough = [fact for fact in facts if fact.level is Level.GOOD]
    names = dict.fromkeys(fact.figures["axis"] for fact in enough)
    if names.keys() & set(TILT_AXES):
        return enough[0].but(names=tuple(names))
    refusals = [axis.loop for axis in evidence.margins if isinstance(axis.loop, Fact)]
    because = refusals[0] if refusals else evidence.learnability.reason
    seen = [of_response(axis.response) for axis in evidence.margins if axis.response]
    quiet = [fact.figures["rate"] for fact in seen if fact.code is MarginsLight.NO_RESONANCE]
    return Fact(MarginsLight.MARGINS_UNKNOWN, because=because, rate=max(quiet, default=None))
