"""Errors whose cause is the data: each carries a fact that says why."""

from __future__ import annotations

from mavdem.facts import Fact
from mavdem.facts.forecasts import Forecasts
from mavdem.facts.prose import Prose, prose

REMEDIES = [
    "attach",
    "check",
    "convert",
    "cut",
    "delete",
    "fetch",
    "give",
    "install",
    "make",
    "move",
    "name",
    "save",
]
"""Words that begin what to do; transitional, until each refusal is a fact of its own."""


class Refusal(ValueError):
    """What cannot be done, and why: a fact, whose sentence and remedy are the message."""

    def __init__(self, fact: Fact | str, remedy: str = "") -> None:
        super().__init__(fact, remedy)
        self.fact = prose(fact, remedy) if isinstance(fact, str) else fact

    def __str__(self) -> str:
        return f"{self.fact} {self.fact.remedy}".strip()

    @property
    def reason(self) -> str:
        """The sentence: what is wrong, with the figures."""
        return str(self.fact)

    @property
    def remedy(self) -> str:
        """What to change, with a command where there is one; may be empty."""
        return self.fact.remedy


class Unreadable(Refusal):
    """A source that cannot be opened, or that holds nothing which can be read."""

    def __init__(self, fact: Fact | str, remedy: str = "") -> None:
        if isinstance(fact, str):
            advice = fact.rpartition(": ")[2]
            remedy = remedy or (
                advice[:1].upper() + advice[1:] if advice.split(" ")[0] in REMEDIES else ""
            )
        super().__init__(fact, remedy)

    def __str__(self) -> str:
        return self.reason if self.fact.code is Prose.PROSE else super().__str__()


class NotLearnable(Refusal):
    """Data that cannot support the request: fitting them would give numbers that mean nothing."""


def fact_of(error: BaseException) -> Fact:
    """Returns what an ``error`` says: the fact of a refusal, else its message, with its type where that is unusual."""
    if isinstance(error, Refusal):
        return error.fact
    kind = "" if isinstance(error, ValueError) else type(error).__name__
    return Fact(Forecasts.FAILED, error=kind, text=str(error))
