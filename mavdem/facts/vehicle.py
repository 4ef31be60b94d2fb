"""What a log says of its vehicle: the tier that it allows, and what the vehicle's name is made of."""

from enum import auto

from mavdem.facts.fact import Code, InWords


class Basis(InWords):
    """What a vehicle's name is made of; the last is shared by many."""

    BOARD = auto()
    ACCELEROMETER = auto()
    COMPASS = auto()
    SYSTEM_ID = auto()


class Allowed(Code):
    """What a tier allows; its remedy is what a log needs for it."""

    TIER_A = auto()
    TIER_B = auto()
    TIER_C = auto()
