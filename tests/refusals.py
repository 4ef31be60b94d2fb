"""What a refusal says: its fact."""

from collections.abc import Callable
from typing import Any

import pytest

from mavdem.errors import Refusal
from mavdem.facts import Fact
from mavdem.facts.forecasts import Forecasts


def refused(call: Callable[..., Any], *arguments: Any) -> Fact:
    """The fact of the refusal that a call raises."""
    with pytest.raises(Refusal) as error:
        call(*arguments)
    return error.value.fact


def prose(text: str, remedy: str = "") -> Fact:
    """A fact that says ``text``, where it does not matter what it says."""
    return Fact(Forecasts.FAILED, error="", text=text, remedy=remedy)
