"""The evidence for an event in one sentence: which measurements confirm it (its witnesses), and which contradict it."""

from collections.abc import Collection, Iterable
from math import inf
from typing import TYPE_CHECKING

from mavdem.facts import Fact, Facts, NamedFacts
from mavdem.facts.margins import MarginsLight
from mavdem.facts.witnesses import SensorFact
from mavdem.report.blocks import Sentence
from mavdem.report.templates import as_clause, headline, render_section

FACTS_OF_END = (SensorFact.LOG_ENDED, SensorFact.RESTED)
"""Facts that follow an event, though they may have no time."""

if TYPE_CHECKING:
    from mavdem.loops.axis_loops import LoopsByAxis


MAX_WITNESSES_OF_HEADLINE = 2
"""Measurements that a headline quotes as its evidence: one, and a second that confirms it. The list of all events has
the others."""


def evidence_sentences(event: Fact, max_witnesses: int | None = None) -> list[Sentence]:
    """Returns the sentence with the evidence for an event: what confirms it, and then what contradicts it.

    An event, such as a collision, is checked against measurements that are independent of each other: the accelerometer
    should show a shock, and the gyro a fast rotation. What each of them shows is a coded finding (a fact), called a
    witness. If the cause of the event has witnesses too, such as the command of the motor that failed, those that
    confirm it come first, since the witnesses of the event show only what followed.

    Args:
        event: the event, as a fact. Its figure ``witnesses`` has its witnesses.
        max_witnesses: largest number of witnesses of the event that are quoted as confirming it, the earliest ones;
            None for all.

    Returns:
        A list with one sentence; empty if the event was not checked.
    """
    # Imported here, since pages without an event, such as that of a fleet, do without this module.
    from mavdem.witnesses.sensor_facts import contradicting_facts, supporting_facts

    witnesses_of_cause = sorted(_witnesses_of_cause(event), key=_witness_time)
    witnesses_of_event = sorted(_independent_witnesses(event), key=_witness_time)
    return render_section(
        "why",
        causing=supporting_facts(witnesses_of_cause),
        supporting=supporting_facts(witnesses_of_event)[:max_witnesses],
        contradicting=contradicting_facts(witnesses_of_event),
    )


def _independent_witnesses(event: Fact) -> list[Fact]:
    """Returns the witnesses of an event that do not merely repeat it.

    A witness may be a message of the autopilot, which is then its figure "cause". If the event itself is this message,
    the witness adds no evidence, and is left out.

    Args:
        event: the event, with its witnesses as the figure ``witnesses``.
    """
    independent_witnesses = []
    for witness in event.figures.get("witnesses", ()):
        autopilot_message = witness.figures.get("cause")
        if autopilot_message is None or autopilot_message.code is not event.code:
            independent_witnesses.append(witness)
    return independent_witnesses


def _witness_time(witness: Fact) -> float:
    """Returns the time by which the findings of sensors about an event are listed, seconds on the boot clock.

    A finding without a time has the time of the autopilot's message that it repeats, if there is one. Otherwise it
    comes last (infinity) if it is about the end of the log, and first (minus infinity) if it is not: such is gravity at
    rest, which is measured over a longer time.

    Args:
        witness: a coded finding of one sensor that confirms or contradicts the event.
    """
    if witness.time is not None:
        return witness.time
    message = witness.figures.get("cause")
    if message is not None:
        return message.start_time
    return inf if witness.code in FACTS_OF_END else -inf


def headline_evidence(fact: Fact, lights: NamedFacts) -> list[Sentence]:
    """Returns the sentence below a headline, on a page and on the screen, that says which measurements confirm it.

    It quotes at most ``MAX_WITNESSES_OF_HEADLINE`` measurements. If the event has a cause, they are those of the cause,
    since what followed is in the list of events.

    Args:
        fact: the headline, a coded finding on an event.
        lights: status lights by name, each the judgement of one part of the vehicle with a level.

    Returns:
        A list with one sentence; empty if nothing confirms the headline, or if it states its evidence itself.
    """
    witnesses = _witnesses_of_cause(fact) or _independent_witnesses(fact)
    if not witnesses:
        return _light_as_evidence(fact, lights)
    headline_text = headline(fact)
    witnesses_not_in_headline = []
    for witness in witnesses:
        if as_clause(witness) not in headline_text:
            witnesses_not_in_headline.append(witness)
    event = _without_cause(fact).replace(witnesses=witnesses_not_in_headline)
    return evidence_sentences(event, MAX_WITNESSES_OF_HEADLINE)


def _light_as_evidence(event: Fact, lights: NamedFacts) -> list[Sentence]:
    """Returns the judgement of the part of the vehicle that an event is about, as evidence for the event.

    It stands for measurements of the event itself, which an event that only the autopilot reports, such as an empty
    battery, does not have.

    Args:
        event: the event, a coded finding.
        lights: status lights by name, each the judgement of one part of the vehicle with a level.

    Returns:
        A list with one sentence; empty if the part is not judged, or is not found to be at fault.
    """
    # Imported here, since pages without a headline need nothing of it.
    from mavdem.assessment.event_lights import light_of_event

    light_name = light_of_event(event)
    light = None if light_name is None else lights.get(light_name)
    if light is None or not light.is_watch_or_bad:
        return []
    if light.code is event.code:
        # The judgement is the event itself, which is no evidence for it.
        return []
    return [Sentence(light.sentence, lead="Why:")]


def _witnesses_of_cause(fact: Fact) -> Facts:
    """Returns the facts of sensors that confirm the cause of an event; empty without a cause or such facts."""
    cause = fact.figures.get("cause")
    return tuple(cause.figures.get("witnesses", ())) if isinstance(cause, Fact) else ()


def margin_sentences(fact: Fact, loops: "LoopsByAxis", margins: Iterable[Fact]) -> list[Sentence]:
    """Returns the sentence that explains stability margins that are too small: the loop's crossover, and the targets.

    It also names the other axes whose margins are too small.

    Args:
        fact: a coded finding, such as the headline, which may be about the margins of one axis.
        loops: identified control loops by axis.
        margins: findings on the margins of all axes.

    Returns:
        A list with one sentence; empty if the finding is no warning about margins, or its loop was not identified.
    """
    # Imported here, since pages without loops need nothing of it.
    from mavdem.loops.axis_loops import MARGIN_TARGETS

    axis_loop = loops.get(str(fact.figures.get("axis")))
    if not _is_on_small_margins(fact) or axis_loop is None:
        return []
    small_margins_of_other_axes = []
    for finding in margins:
        if _is_on_small_margins(finding) and finding.figures["axis"] != axis_loop.axis:
            small_margins_of_other_axes.append(finding.figures)
    # The subject of the finding is the loop of the axis that it is about: "rate" or "attitude".
    open_loop = axis_loop.open_loop(fact.subject)
    return render_section(
        "why_margins",
        fact=fact.figures,
        crossover=open_loop.crossover,
        target=MARGIN_TARGETS["default"],
        others=small_margins_of_other_axes,
    )


def _is_on_small_margins(fact: Fact) -> bool:
    """Returns whether a finding is that an identified loop has too small stability margins."""
    return fact.code is MarginsLight.LOOP_MARGINS and fact.is_watch_or_bad


def evidence_text(fact: Fact) -> str:
    """Returns all evidence for an event as text, for a list of events; empty if the event was not checked.

    Args:
        fact: the event, whose figure ``cause`` may be its cause.

    Returns:
        Text such as "Why: the barometer sank at 4.0 m/s at 2.5 s.", with the evidence for the cause first.
    """
    return joined_sentences(evidence_sentences(fact))


def evidence_texts(fact: Fact) -> frozenset[str]:
    """Returns the evidence for an event itself, and that for its cause, as texts; without those that are empty.

    A list of events shows each of them once, with the first event that has it (:func:`new_evidence_text`).

    Args:
        fact: the event.
    """
    texts = {evidence_text(_without_cause(fact)), evidence_text(_without_own_witnesses(fact))}
    return frozenset(texts - {""})


def new_evidence_text(fact: Fact, shown_texts: Collection[str]) -> str:
    """Returns the evidence for an event in a list of events, without what the list has shown for an earlier event.

    The same measurements often confirm several events: a vehicle that loses control and then hits the ground sinks
    once. They are shown with the first of these events.

    Args:
        fact: the event, whose figure ``cause`` may be its cause.
        shown_texts: texts that the reader has seen above this event: :func:`evidence_texts` of the earlier events, and
            other texts of the page.

    Returns:
        The evidence for the cause and that for the event itself, each if it was not shown; empty without any.
    """
    event = fact
    if evidence_text(_without_own_witnesses(fact)) in shown_texts:
        event = _without_cause(event)
    if evidence_text(_without_cause(fact)) in shown_texts:
        event = _without_own_witnesses(event)
    return evidence_text(event)


def _without_cause(fact: Fact) -> Fact:
    """Returns an event without its cause, so that only the evidence for the event itself remains."""
    return fact.replace(cause=None) if "cause" in fact.figures else fact


def _without_own_witnesses(fact: Fact) -> Fact:
    """Returns an event without the measurements that confirm or contradict it: the evidence for its cause remains."""
    return fact.replace(witnesses=())


def joined_sentences(sentences: Iterable[Sentence]) -> str:
    """Returns sentences as one line of text, each after its lead, such as "Why: "; empty without sentences."""
    return " ".join(f"{sentence.lead} {sentence.text}" for sentence in sentences)
