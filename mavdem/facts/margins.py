"""What is said of the margins of a vehicle's loops, and of how it follows its setpoints."""

from enum import auto

from mavdem.facts.fact import Code


class MarginsLight(Code):
    """Of the loops' margins, or else of resonances."""

    OSCILLATES = auto()
    LOOP_MARGINS = auto()
    LOOP_MEASURED = auto()
    RESONATES = auto()
    NO_RESONANCE = auto()
    RATE_STANDS_OUT = auto()
    MARGINS_UNKNOWN = auto()


class TrackingLight(Code):
    """Of attitude against what was asked."""

    FOLLOWS_SETPOINT = auto()
    MISSES_SETPOINT = auto()
    OVERSHOOTS_SETPOINT = auto()
    TRACKING_UNKNOWN = auto()
