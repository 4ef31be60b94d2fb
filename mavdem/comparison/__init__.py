"""Comparison: DEM and other methods tried on the same windows of the same flights.

``method`` says what a method is and ``methods`` which are compared, ``outcome`` tries one on one window, ``comparison``
all on all, ``standing`` says what that comes to by flight and over flights, and ``account`` how it is told.
"""

from mavdem.comparison.account import account
from mavdem.comparison.comparison import Comparison, compare, outcomes
from mavdem.comparison.method import Method
from mavdem.comparison.methods import GENERALIZED_COORDINATES, METHODS, PEERS, dem
from mavdem.comparison.outcome import Outcome, judge
from mavdem.comparison.standing import AtHorizon, Loss, OverFlights, Standing

__all__ = [
    "GENERALIZED_COORDINATES",
    "METHODS",
    "PEERS",
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
