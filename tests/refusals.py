"""What a refusal says: its fact."""

from functools import partial

from pytest import raises

from mavdem.errors import NotLearnable, Unreadable
from mavdem.facts import Fact
from mavdem.facts.forecasts import ForecastFact


def refused(call, *arguments, kind=NotLearnable, **named):
    """The fact of the refusal, of a kind, that a call raises."""
    with raises(kind) as error:
        call(*arguments, **named)
    return error.value.fact


unreadable = partial(refused, kind=Unreadable)


def prose(text, remedy=""):
    """A fact that says ``text``, where it does not matter what it says."""
    return Fact(ForecastFact.FAILED, error="", text=text, remedy=remedy)
