"""Why an event is stated: the witnesses for it and against it, as one sentence."""

from mavdem.facts import Fact
from mavdem.report.blocks import Sentence
from mavdem.report.templates import render_section
from mavdem.witnesses.statements import contradicting_statements, supporting_statements


def why(fact: Fact) -> list[Sentence]:
    """Returns a sentence with the witnesses of a fact, those for it first; none for a fact without witnesses."""
    witnesses = fact.figures.get("witnesses", ())
    return render_section(
        "why",
        supporting=supporting_statements(witnesses),
        contradicting=contradicting_statements(witnesses),
    )


def why_text(fact: Fact) -> str:
    """Returns the same as text with its lead, for a table; empty for a fact without witnesses."""
    return " ".join(f"{sentence.lead} {sentence.text}" for sentence in why(fact))
