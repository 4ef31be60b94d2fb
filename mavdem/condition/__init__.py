"""Condition: what a log says of its vehicle at any rate: tier, identity, balance, limits, vibration, battery."""

from mavdem.condition.condition import Condition, HoverFigures, condition_of, hover, hover_figures
from mavdem.condition.inventory import Identity, identity_of
from mavdem.condition.oscillation import Oscillation

__all__ = [
    "Condition",
    "HoverFigures",
    "Identity",
    "Oscillation",
    "condition_of",
    "hover",
    "hover_figures",
    "identity_of",
]
