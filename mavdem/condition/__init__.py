"""Condition: what a log says of its vehicle at any rate: tier, identity, balance, limits, vibration, battery."""

from mavdem.condition.condition import Condition, condition_of
from mavdem.condition.identity import Identity, identity_of

__all__ = ["Condition", "Identity", "condition_of", "identity_of"]
