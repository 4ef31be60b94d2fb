"""Comparison: DEM and other methods on the same windows of the same flights.

``methods`` lists the methods, ``outcome`` runs one on one window, ``comparison`` runs all on all, and ``summaries``
summarises outcomes by flight and over flights.
"""

from mavdem.comparison.comparison import Comparison, compare, outcomes
from mavdem.comparison.methods import GENERALIZED_COORDINATES, METHODS, PEERS, dem
from mavdem.comparison.outcome import Method, Outcome, judge
from mavdem.comparison.summaries import AtHorizon, Loss, MethodSummary, OverFlights

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
    "MethodSummary",
    "compare",
    "dem",
    "judge",
    "outcomes",
]
