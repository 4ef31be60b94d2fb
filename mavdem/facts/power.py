"""What the light of power says of the battery and of the board's supply."""

from enum import auto

from mavdem.facts.fact import Code


class PowerLight(Code):
    """How battery and supply held in flight."""

    BATTERY_HELD = auto()
    BATTERY_LOW = auto()
    CHARGE_LOW = auto()
    SUPPLY_HELD = auto()
    SUPPLY_LOW = auto()
    SUPPLY_FELL = auto()
    CELLS_UNKNOWN = auto()
    POWER_UNMEASURED = auto()
