"""What a refusal says: its fact."""

import pytest

from mavdem.errors import Refusal
from mavdem.facts import Fact
from mavdem.facts.forecasts import Forecasts


def refused(call, *arguments, **named):
    """The fact of the refusal that a call raises."""
    with pytest.raises(Refusal) as error:
        call(*arguments, **named)
    return error.value.fact


def prose(text, remedy=""):
    """A fact that says ``text``, where it does not matter what it says."""
    return Fact(Forecasts.FAILED, error="", text=text, remedy=remedy)
