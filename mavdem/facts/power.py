"""Facts about the battery and the board's supply."""

from mavdem.facts.fact import Code


class PowerLight(Code):
    """How battery and supply held in flight."""

    BATTERY_HELD = "battery_held"
    BATTERY_LOW = "battery_low"
    CHARGE_LOW = "charge_low"
    CURRENT_UNCALIBRATED = "current_uncalibrated"
    SUPPLY_HELD = "supply_held"
    SUPPLY_LOW = "supply_low"
    SUPPLY_FELL = "supply_fell"
    CELLS_UNKNOWN = "cells_unknown"
    POWER_UNMEASURED = "power_unmeasured"
