"""Condition: what a log says of its vehicle at any rate: tier, identity, balance, limits, vibration, battery."""

from mavdem.condition.condition import Condition, HoverFigures, condition_of, hover, hover_figures
from mavdem.condition.inventory import Identity, identity_of

__all__ = ["Condition", "HoverFigures", "Identity", "condition_of", "hover", "hover_figures", "identity_of"]
