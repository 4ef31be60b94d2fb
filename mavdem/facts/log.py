"""What the light of the log says of its rates, and whether its flight was simulated."""

from enum import auto

from mavdem.facts.fact import Code, InWords


class LogLight(Code):
    """How well a log shows the flight."""

    RECORDED_FAST = auto()
    RECORDED_SLOWLY = auto()
    RECORDED_WITH_GAPS = auto()
    MOTION_NOT_RECORDED = auto()
    SIMULATED = auto()


class Simulation(InWords):
    """What flew instead of a vehicle."""

    SOFTWARE = auto()
    HARDWARE = auto()
