"""What the light of vibration says."""

from enum import auto

from mavdem.facts.fact import Code


class VibrationLight(Code):
    """How much the IMUs shake in flight."""

    VIBRATION_MEASURED = auto()
    VIBRATION_UNKNOWN = auto()
