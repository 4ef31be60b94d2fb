"""Facts about the rates of a log, and whether its flight was simulated."""

from enum import StrEnum

from mavdem.facts.fact import Code


class LogLight(Code):
    """How well a log shows the flight."""

    RECORDED_FAST = "recorded_fast"
    RECORDED_SLOWLY = "recorded_slowly"
    RECORDED_WITH_GAPS = "recorded_with_gaps"
    RECORDED_WITH_DAMAGE = "recorded_with_damage"
    COMMANDS_INCOMPLETE = "commands_incomplete"
    RECORDED_OTHER_VEHICLE = "recorded_other_vehicle"
    ATTITUDE_NOT_RECORDED = "attitude_not_recorded"
    MOTION_NOT_RECORDED = "motion_not_recorded"
    DAMAGED = "log_damaged"
    SIMULATED = "simulated"


class Simulator(StrEnum):
    """What flew instead of a vehicle."""

    SOFTWARE = "software"
    HARDWARE = "hardware"
