"""The evidence for an event in one sentence: which measurements confirm it (its witnesses), and which contradict it."""

from collections.abc import Collection, Iterable
from math import inf
from typing import TYPE_CHECKING

from mavdem.facts import Fact, Facts, NamedFacts
from mavdem.facts.ending import Ending
from mavdem.facts.margins import MarginsLight
from mavdem.facts.witnesses import SensorFact
from mavdem.report.blocks import Sentence
from mavdem.report.templates import render_section

FACTS_OF_END = (SensorFact.LOG_ENDED, SensorFact.RESTED)
"""Facts that follow an event, though they may have no time."""

if TYPE_CHECKING:
    from mavdem.loops.axis_loops import LoopsByAxis


def evidence_sentences(fact: Fact) -> list[Sentence]:
    """Returns the sentence with the evidence for an event: the measurements that confirm it, then those that do not.

    An event is checked against measurements that are independent of each other. For a collision, for example, the
    accelerometer shows a shock, and the gyro a fast rotation. What each of them shows is a fact, called a witness. If
    the cause of the event has witnesses too, such as the command of the motor that failed, they come first: those of
    the event show only what followed.

    Args:
        fact: the event. Facts of the sensors that confirm or contradict it are its figure ``witnesses``.

    Returns:
        A list with one sentence; empty if the event was not checked.
    """
    # Imported here, since pages without an event, such as that of a fleet, need nothing of it.
    from mavdem.witnesses.sensor_facts import contradicting_facts, supporting_facts

    witnesses = []
    for witness in fact.figures.get("witnesses", ()):
        # The autopilot may be a witness by its own message, which is then the figure "cause" of the witness. If the
        # event itself is this message, the witness would only repeat it.
        message = witness.figures.get("cause")
        if message is None or message.code is not fact.code:
            witnesses.append(witness)
    return render_section(
        "why",
        causing=supporting_facts(sorted(_witnesses_of_cause(fact), key=_witness_time)),
        supporting=supporting_facts(sorted(witnesses, key=_witness_time)),
        contradicting=contradicting_facts(sorted(witnesses, key=_witness_time)),
    )


def _witness_time(witness: Fact) -> float:
    """Returns the time by which witnesses are listed, s on the boot clock.

    A report of the autopilot is its figure ``cause``, which has its time. What a sensor measured at no time of its own,
    such as gravity at rest, comes first, and what is known of the end of the log last.
    """
    message = witness.figures.get("cause")
    if witness.time is None and message is not None:
        return message.start_time
    if witness.time is None:
        return inf if witness.code in FACTS_OF_END else -inf
    return witness.time


def cause_sentences(fact: Fact) -> list[Sentence]:
    """Returns the sentence with the evidence for the cause of an event or, without a cause, for the event itself.

    Args:
        fact: the event.

    Returns:
        A list with one sentence; empty if neither was checked, or the flight was lost for an unknown cause: what
        followed is no evidence for it.
    """
    cause_witnesses = _witnesses_of_cause(fact)
    if cause_witnesses:
        return evidence_sentences(fact.replace(witnesses=()))
    return [] if fact.code in Ending else evidence_sentences(fact)


def headline_evidence(fact: Fact, lights: NamedFacts) -> list[Sentence]:
    """Returns the sentence with the evidence for a headline: that for its cause or, if that has none, for the event.

    What followed a known cause stands in the list of events. An event that only the autopilot reports, such as an empty
    battery, has what its light measured as evidence, if that warns too.

    Args:
        fact: the headline.
        lights: the judgement of each part of the vehicle, a fact with a level, by name.

    Returns:
        A list with one sentence; empty if nothing shows the headline but itself.
    """
    # Imported here, since pages without a headline need nothing of it.
    from mavdem.assessment.event_lights import light_of_event

    light = light_of_event(fact)
    measured = None if light is None else lights.get(light)
    sentences = cause_sentences(fact) or evidence_sentences(fact)
    if sentences or measured is None or not measured.warns or measured.code is fact.code:
        return sentences
    return [Sentence(measured.sentence, "Why:")]


def _witnesses_of_cause(fact: Fact) -> Facts:
    """Returns the facts of sensors that confirm the cause of an event; empty without a cause or such facts."""
    cause = fact.figures.get("cause")
    return tuple(cause.figures.get("witnesses", ())) if isinstance(cause, Fact) else ()


def margin_sentences(fact: Fact, loops: "LoopsByAxis", margins: Iterable[Fact]) -> list[Sentence]:
    """Returns the sentence that explains margins that are too small: the crossover of their loop, and the goal.

    It also names the other axes whose margins are too small.

    Args:
        fact: a finding, such as the headline, which may be about the margins of one axis.
        loops: identified loops by axis.
        margins: facts on the margins of all axes.

    Returns:
        A list with one sentence; empty if the fact does not warn of margins, or their loop was not identified.
    """
    # Imported here, since pages without loops need nothing of it.
    from mavdem.loops.axis_loops import MARGIN_TARGETS

    loop = loops.get(str(fact.figures.get("axis")))
    if fact.code is not MarginsLight.LOOP_MARGINS or not fact.warns or loop is None:
        return []
    others = []
    for other in margins:
        is_of_other_axis = other.code is fact.code and other.figures["axis"] != loop.axis
        if is_of_other_axis and other.warns:
            others.append(other.figures)
    open_loop = loop.attitude if fact.subject == "attitude" else loop.rate
    return render_section(
        "why_margins",
        fact=fact.figures,
        crossover=open_loop.crossover,
        target=MARGIN_TARGETS["default"],
        others=others,
    )


def evidence_text(fact: Fact) -> str:
    """Returns the evidence for an event as text with its lead, for a table; empty if the event was not checked."""
    return text_with_leads(evidence_sentences(fact))


def evidence_texts(fact: Fact) -> frozenset[str]:
    """Returns the texts with evidence that a list need not repeat once it has shown an event.

    They are all evidence for the event, that without the evidence for its cause, and that for its cause alone; those
    for which there is no evidence are left out.

    Args:
        fact: the event.
    """
    texts = (
        evidence_text(fact),
        evidence_text(_without_cause(fact)),
        text_with_leads(cause_sentences(fact)),
    )
    return frozenset(text for text in texts if text)


def unrepeated_evidence(fact: Fact, repeated: Collection[str]) -> str:
    """Returns the evidence for an event as text, without the evidence that a list has shown above it.

    Args:
        fact: the event.
        repeated: texts that stand above it, such as :func:`evidence_texts` of the events before.

    Returns:
        All evidence, or that for its cause alone if the rest is repeated; empty if all is.
    """
    text = evidence_text(fact)
    if evidence_text(_without_cause(fact)) in repeated:
        has_cause = "cause" in fact.figures
        text = text_with_leads(cause_sentences(fact)) if has_cause else ""
    return "" if text in repeated else text


def _without_cause(fact: Fact) -> Fact:
    """Returns an event without its cause, whose evidence is then that of the event alone."""
    return fact.replace(cause=None) if "cause" in fact.figures else fact


def text_with_leads(sentences: Iterable[Sentence]) -> str:
    """Returns sentences with their leads as one text; empty without any."""
    return " ".join(f"{sentence.lead} {sentence.text}" for sentence in sentences)
