"""Facts about vibration."""

from mavdem.facts.fact import Code


class VibrationLight(Code):
    """How much the IMUs shake in flight."""

    VIBRATION_MEASURED = "vibration_measured"
    VIBRATION_UNKNOWN = "vibration_unknown"
