"""The light on margins: a limit cycle, or the worst of the axes; else what keeps them from being known."""

from math import inf

from mavdem.assessment.axis.margins import of_response
from mavdem.assessment.evidence import Evidence
from mavdem.assessment.lights.limits import worst
from mavdem.dataset.axes import TILT_AXES
from mavdem.facts import Fact
from mavdem.facts.margins import MarginsLight
from mavdem.facts.sources import Repair


def margins_light(evidence: Evidence) -> Fact:
    """Returns the light on margins: a limit cycle, or the worst of the axes; else what keeps them from being known."""
    oscillation = evidence.condition.oscillation
    if oscillation is not None:
        return Fact(MarginsLight.OSCILLATES, because=evidence.lowered, **oscillation.figures)
    facts = [fact for axis in evidence.margins for fact in axis.facts]
    facts.sort(key=lambda fact: fact.figures.get("share", inf))
    if facts and (light := worst(facts)).warns:
        return light.but(arguments=_arguments(evidence))
    enough = [fact for fact in facts if fact.is_good]
    names = dict.fromkeys(fact.figures["axis"] for fact in enough)
    if names.keys() & set(TILT_AXES):
        return enough[0].but(names=tuple(names))
    refusals = [axis.loop for axis in evidence.margins if isinstance(axis.loop, Fact)]
    because = refusals[0] if refusals else evidence.learnability.reason
    seen = [of_response(axis.response) for axis in evidence.margins if axis.response]
    quiet = [fact.figures["rate"] for fact in seen if fact.code is MarginsLight.NO_RESONANCE]
    return Fact(MarginsLight.MARGINS_UNKNOWN, because=because, rate=max(quiet, default=None))


def _arguments(evidence: Evidence) -> list[str]:
    """What a command reads the same vehicle by: the log and, where it has several, which; and a file of parameters."""
    vehicle = evidence.signals.telemetry
    given = [evidence.log.source]
    if len(evidence.log.vehicles) > 1:
        given += ["--vehicle", f"{vehicle.system}:{vehicle.component}"]
    for repair in vehicle.repairs:
        if repair.code is Repair.PARAMETERS_ADDED:
            given += ["--params", repair.figures["path"]]
    return given
