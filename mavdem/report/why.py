"""Why an event is stated: the witnesses, independent measurements that confirm or contradict it, in one sentence."""

from mavdem.facts import Fact
from mavdem.report.blocks import Sentence
from mavdem.report.templates import render_section


def why(fact: Fact) -> list[Sentence]:
    """Returns a sentence with the witnesses of a fact, the independent measurements that it was checked against.

    A witness is a fact of one sensor or another source: of a collision, for example, that the accelerometer measured a
    shock. A fact without witnesses has no such sentence.

    Args:
        fact: the fact, which may have ``witnesses`` among its figures.

    Returns:
        The sentence, first the witnesses that support the fact, then those that contradict it; empty without witnesses.
    """
    # Imported here, since pages without an event, such as that of a fleet, need nothing of it.
    from mavdem.witnesses.sensor_facts import contradicting_facts, supporting_facts

    witnesses = []
    for witness in fact.figures.get("witnesses", ()):
        reported = witness.figures.get("cause")
        # What the autopilot reports is one of its own witnesses: the fact says so itself.
        if reported is None or reported.code is not fact.code:
            witnesses.append(witness)
    return render_section(
        "why",
        supporting=supporting_facts(witnesses),
        contradicting=contradicting_facts(witnesses),
    )


def why_text(fact: Fact) -> str:
    """Returns the same as text with its lead, for a table; empty for a fact without witnesses."""
    return " ".join(f"{sentence.lead} {sentence.text}" for sentence in why(fact))
