"""Light on stability margins: a limit cycle, or the worst of the axes; otherwise why the margins are not known."""

from math import inf

from mavdem.assessment.axis.margins import resonance_fact
from mavdem.assessment.evidence import Evidence
from mavdem.assessment.limits import worst_fact
from mavdem.dataset.axes import TILT_AXES
from mavdem.facts import Fact
from mavdem.facts.margins import MarginsLight


def margins_light(evidence: Evidence) -> Fact:
    """Judges the stability margins of the control loops.

    A limit cycle shows that there is no margin, and comes before all else. Otherwise the worst fact on any axis counts
    if it warns. The light is good if the margins of roll or pitch are, since yaw alone says little. In all other cases
    the margins are unknown.

    Args:
        evidence: what the log shows of the vehicle.

    Returns:
        A fact whose level is the colour of the light: good, watch, bad or unknown.
    """
    if evidence.other_vehicle is not None:
        return evidence.other_vehicle
    oscillation = evidence.condition.oscillation
    if oscillation is not None:
        advice = evidence.gain_reduction
        return Fact(MarginsLight.OSCILLATES, because=advice, **oscillation.figures)
    facts = [fact for axis in evidence.margins for fact in axis.facts]
    # The ``share`` is the margin as a share of the one to have: of several with one level the smallest is named.
    facts.sort(key=lambda fact: fact.figures.get("share", inf))
    if facts:
        worst = worst_fact(facts)
        if worst.warns:
            return worst
    good_facts = [fact for fact in facts if fact.is_good]
    # A dictionary keeps each name once, in order.
    good_axes = dict.fromkeys(fact.figures["axis"] for fact in good_facts)
    if any(axis in good_axes for axis in TILT_AXES):
        return good_facts[0].replace(names=tuple(good_axes))
    return _unknown(evidence)


def _unknown(evidence: Evidence) -> Fact:
    """Returns the fact that the stability margins are not known, with the reason.

    Args:
        evidence: what the log shows of the vehicle.

    Returns:
        A fact whose reason is why the first axis has no identified loop. Its figure ``rate`` is what is known all the
        same: the highest frequency, Hz, up to which a measured response showed no resonance; None if none was measured.
    """
    refusals = [axis.loop for axis in evidence.margins if isinstance(axis.loop, Fact)]
    because = refusals[0] if refusals else evidence.learnability.reason
    frequencies = []
    for axis in evidence.margins:
        if axis.response is None:
            continue
        fact = resonance_fact(axis.response)
        if fact.code is MarginsLight.NO_RESONANCE:
            frequencies.append(fact.figures["rate"])
    highest_frequency = max(frequencies, default=None)
    return Fact(MarginsLight.MARGINS_UNKNOWN, because=because, rate=highest_frequency)
