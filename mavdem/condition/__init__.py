"""Condition: what a log says of its vehicle at any rate: tier, identity, balance, limits, vibration, battery."""

from mavdem.condition.condition import Condition, HoverFigures, condition_of, hover, hover_figures
from mavdem.condition.inventory import Identity, identity_of
from mavdem.condition.wind_of_log import wind, wind_of
from mavdem.condition.wind_velocity import WindVelocity, estimate_wind

__all__ = [
    "Condition",
    "HoverFigures",
    "Identity",
    "WindVelocity",
    "condition_of",
    "estimate_wind",
    "hover",
    "hover_figures",
    "identity_of",
    "wind",
    "wind_of",
]
