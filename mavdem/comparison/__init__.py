"""Comparison: DEM and other methods tried on the same windows of the same flights.

``methods`` says what is compared, ``outcome`` tries one method on one window, ``comparison`` all on all, and
``standing`` what that comes to by flight and over flights, ``account`` how it is told.
"""

from mavdem.comparison.account import account
from mavdem.comparison.comparison import Comparison, compare, outcomes
from mavdem.comparison.methods import GENERALIZED_COORDINATES, METHODS, Method, dem
from mavdem.comparison.outcome import Outcome, judge
from mavdem.comparison.standing import AtHorizon, Loss, OverFlights, Standing

__all__ = [
    "GENERALIZED_COORDINATES",
    "METHODS",
    "AtHorizon",
    "Comparison",
    "Loss",
    "Method",
    "Outcome",
    "OverFlights",
    "Standing",
    "account",
    "compare",
    "dem",
    "judge",
    "outcomes",
]
