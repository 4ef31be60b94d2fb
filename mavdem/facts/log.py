"""What the light of the log says of its rates, and whether its flight was simulated."""

from enum import StrEnum

from mavdem.facts.fact import Code


class LogLight(Code):
    """How well a log shows the flight."""

    RECORDED_FAST = "recorded_fast"
    RECORDED_SLOWLY = "recorded_slowly"
    RECORDED_WITH_GAPS = "recorded_with_gaps"
    MOTION_NOT_RECORDED = "motion_not_recorded"
    SIMULATED = "simulated"


class Simulator(StrEnum):
    """What flew instead of a vehicle."""

    SOFTWARE = "software"
    HARDWARE = "hardware"
