"""Method: a name, and what learns a flight and answers a model that forecasts."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from mavdem.flight import Flight
from mavdem.forecaster import Forecaster


class Method(NamedTuple):
    """One method.

    Attributes:
        name: which tells it from others.
        learn: makes a model of training data. For other processes a function of a module, or a ``partial`` of one.
    """

    name: str
    learn: Callable[[Flight], Forecaster]
