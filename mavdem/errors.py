"""Errors whose cause is the data: each carries a fact that says why."""

from mavdem.facts import Code, Fact, Figure, Level
from mavdem.facts.forecasts import Forecasts


class Refusal(ValueError):
    """What cannot be done, and why: a ``fact``, whose sentence and remedy are the message."""

    def __init__(self, fact: Fact | Code, **figures: Figure) -> None:
        """Takes a ``fact``, or its code with ``figures``."""
        self.fact = fact if isinstance(fact, Fact) else Fact(fact, **figures)
        super().__init__(self.fact)

    def __str__(self) -> str:
        return self.fact.advised

    @property
    def reason(self) -> str:
        """The sentence: what is wrong, with the figures."""
        return self.fact.sentence

    @property
    def remedy(self) -> str:
        """What to change, with a command where there is one; may be empty."""
        return self.fact.remedy


class Unreadable(Refusal):
    """A source that cannot be opened, or that holds nothing which can be read."""


class NotLearnable(Refusal):
    """Data that cannot support the request: fitting them would give numbers that mean nothing."""


def error_message(error: Exception) -> str:
    """Returns why the operating system refused, or else what the ``error`` says."""
    return getattr(error, "strerror", None) or str(error)


def fact_from_error(error: BaseException) -> Fact:
    """Returns what an ``error`` says: the fact of a refusal, else its message, with its type where that is unusual."""
    if isinstance(error, Refusal):
        return error.fact
    kind = "" if isinstance(error, ValueError) else type(error).__name__
    return Fact(Forecasts.FAILED, error=kind, text=error)


def failure_fact(code: Code, error: Exception, finishing: bool = False) -> Fact:
    """Returns a fact of this ``code`` that says how something failed."""
    return Fact(code, Level.WATCH, error=error_message(error).rstrip("."), finishing=finishing)
