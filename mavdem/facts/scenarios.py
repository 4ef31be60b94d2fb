"""What is said of simulated flights."""

from enum import auto

from mavdem.facts.fact import Code


class Scenarios(Code):
    """What was wrong with a simulated flight."""

    PLACE_NOT_HELD = auto()
    MOTORS_AT_LIMITS = auto()
