"""Errors whose cause is the user's data: each carries a fact (a coded finding) with the reason and the remedy."""

from mavdem.facts import Code, Fact, Figure, Level
from mavdem.facts.forecasts import ForecastFact


class Refusal(ValueError):
    """A request that cannot be fulfilled, with the reason as a fact.

    Attributes:
        fact: The reason; its sentence and its remedy are the error's message.
    """

    def __init__(self, fact: Fact | Code, **figures: Figure) -> None:
        """Creates the error from the reason why something cannot be done.

        Args:
            fact: The reason as a fact (coded finding), or only its code.
            **figures: Figures of the fact by name, where only its code is given.
        """
        self.fact = fact if isinstance(fact, Fact) else Fact(fact, **figures)
        super().__init__(self.fact)

    def __str__(self) -> str:
        """The sentence of the fact, followed by its remedy."""
        return self.fact.sentence_and_remedy

    @property
    def reason(self) -> str:
        """The sentence that states what is wrong, with its figures."""
        return self.fact.sentence

    @property
    def remedy(self) -> str:
        """What the user can change, with a command where there is one; may be empty."""
        return self.fact.remedy


class Unreadable(Refusal):
    """A source that cannot be opened, or that holds no readable data."""


class NotLearnable(Refusal):
    """Data that cannot support the request: a model fitted to them would have meaningless parameters."""


def error_message(error: Exception) -> str:
    """Returns the operating system's reason for an ``OSError``, or the message of any other error."""
    return getattr(error, "strerror", None) or str(error)


def fact_from_error(error: BaseException) -> Fact:
    """Converts an error to a fact that can be shown or written to a document.

    It is used where one of several methods or flights may fail while the others continue.

    Args:
        error: Any error.

    Returns:
        The fact of a ``Refusal``. Otherwise a fact with the error's message, and with the name of its type unless that
        is ``ValueError``, the expected error for unsuitable data.
    """
    if isinstance(error, Refusal):
        return error.fact
    type_name = "" if isinstance(error, ValueError) else type(error).__name__
    return Fact(ForecastFact.FAILED, error=type_name, text=error)


def failure_fact(code: Code, error: Exception, *, finishing: bool = False) -> Fact:
    """Reports that a step of the program failed while the program goes on without it.

    Args:
        code: Code of the fact, which says what failed.
        error: The error that was raised.
        finishing: Whether the step failed while the program was ending; the sentence of the fact says so.

    Returns:
        A fact (coded finding) with the level "watch" and the message of the error.
    """
    return Fact(code, Level.WATCH, error=error_message(error).rstrip("."), finishing=finishing)
