"""Status light of the stability margins, a fact (a coded finding): a limit cycle, the worst of the axes, or unknown."""

from collections.abc import Sequence
from math import inf

from mavdem.assessment.axis.margins import resonance_fact
from mavdem.assessment.evidence import Evidence
from mavdem.assessment.limits import worst_fact
from mavdem.dataset.axes import TILT_AXES
from mavdem.facts import Fact
from mavdem.facts.margins import MarginsLight


def margins_light(evidence: Evidence) -> Fact:
    """Returns the status light of the stability margins, such as that pitch has too small a phase margin.

    The first of these facts that a flight has is the light:

    1. The vehicle is no multirotor, so that its loops are not judged.
    2. It is in a limit cycle, in which there is no margin.
    3. The margins of an axis are too small: the fact about the worst axis.
    4. The margins of roll or pitch are good; good margins of yaw alone do not suffice.
    5. Roll or pitch has its margins by the estimate, but the log is too slow to be sure.
    6. The margins are unknown.

    Args:
        evidence: signals, events and measurements of the vehicle.

    Returns:
        A fact whose level is the colour of the light: good, watch, bad or unknown.
    """
    if evidence.other_vehicle is not None:
        return evidence.other_vehicle
    oscillation = evidence.condition.oscillation
    if oscillation is not None:
        advice = evidence.gain_reduction
        return Fact(MarginsLight.OSCILLATES, reason=advice, **oscillation.figures)
    facts = _facts_by_margin(evidence)
    if facts:
        worst_margin = worst_fact(facts)
        if worst_margin.is_watch_or_bad:
            return worst_margin
    return (
        _smallest_good_margin(facts)
        or _smallest_margins_by_slow_log(evidence)
        or _unknown_margins(evidence)
    )


def _smallest_good_margin(facts: Sequence[Fact]) -> Fact | None:
    """Returns the fact about the smallest of the good margins, with the names of all axes that have good ones.

    One sentence of the light then states that margin and names these axes, such as roll and pitch.

    Args:
        facts: facts (coded findings) about the margins of all axes, the smallest margin first.

    Returns:
        The fact, whose figure ``names`` has the axes; None if neither roll nor pitch has a good margin: yaw alone does
        not decide the light.
    """
    # The axis of a fact is "roll", "pitch" or "yaw". An axis with several good facts is named once.
    good_facts = [fact for fact in facts if fact.is_good]
    axes = dict.fromkeys(fact.figures["axis"] for fact in good_facts)
    if not any(axis in axes for axis in TILT_AXES):
        return None
    # The first of the good facts has the smallest of the good margins.
    return good_facts[0].replace(names=tuple(axes))


def _facts_by_margin(evidence: Evidence) -> list[Fact]:
    """Collects the facts about the margins of all axes, the smallest margin first.

    In this order the light names the axis with the smallest margin if several facts have the same level. The figure
    ``share`` of a fact is the margin over the required one; a fact without it, such as a resonance, comes last.

    Args:
        evidence: signals, events and measurements of the vehicle.

    Returns:
        The facts, the smallest margin first.
    """
    facts = list[Fact]()
    for axis_margins in evidence.margins:
        facts += axis_margins.facts
    facts.sort(key=lambda fact: fact.figures.get("share", inf))
    return facts


def _smallest_margins_by_slow_log(evidence: Evidence) -> Fact | None:
    """Returns the fact about the smallest margins that the vehicle seems to have, if its log is too slow to be sure.

    Args:
        evidence: signals, events and measurements of the vehicle, with the margins of each axis.

    Returns:
        The fact (a coded finding); its figure ``names`` has all axes whose log is too slow. None if neither roll nor
        pitch is among them: yaw alone does not decide the light of the margins.
    """
    facts_by_axis = {}
    for axis_margins in evidence.margins:
        if axis_margins.margins_by_slow_log is not None:
            facts_by_axis[axis_margins.axis] = axis_margins.margins_by_slow_log
    if not any(axis in facts_by_axis for axis in TILT_AXES):
        return None
    smallest_margin = min(facts_by_axis.values(), key=lambda fact: fact.figures["share"])
    return smallest_margin.replace(names=tuple(facts_by_axis))


def _unknown_margins(evidence: Evidence) -> Fact:
    """Returns the fact that the stability margins are not known, with the reason.

    Args:
        evidence: signals, events and measurements of the vehicle.

    Returns:
        A fact with the reason why the first axis has no identified loop, or why the log allows no model. Its figure
        ``rate`` is the highest frequency, Hz, up to which the measured response of some axis has no resonance; None if
        no response was measured.
    """
    reasons = []
    frequencies_without_resonance = []
    for axis_margins in evidence.margins:
        if isinstance(axis_margins.loop, Fact):
            reasons.append(axis_margins.loop)
        if axis_margins.response is not None:
            response_fact = resonance_fact(axis_margins.response)
            if response_fact.code is MarginsLight.NO_RESONANCE:
                frequencies_without_resonance.append(response_fact.figures["rate"])
    return Fact(
        MarginsLight.MARGINS_UNKNOWN,
        reason=reasons[0] if reasons else evidence.learnability.reason,
        rate=max(frequencies_without_resonance, default=None),
    )
