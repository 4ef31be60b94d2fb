"""What the light of the estimator says of the filter, of GPS and of the compass."""

from enum import auto

from mavdem.facts.fact import Code


class EstimatorLight(Code):
    """How well the filter's estimate and its measurements agreed in flight, and how good GPS was."""

    FILTER_AGREED = auto()
    FILTER_DOUBTED = auto()
    FIX_POOR = auto()
    GPS_GLITCHED = auto()
    COMPASS_DISTURBED = auto()
    ESTIMATOR_UNMEASURED = auto()
