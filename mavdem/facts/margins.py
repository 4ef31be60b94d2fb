"""Facts about the margins of a vehicle's loops, and how it follows its setpoints."""

from mavdem.facts.fact import Code


class MarginsLight(Code):
    """Of the loops' margins, or else of resonances."""

    OSCILLATES = "oscillates"
    LOOP_MARGINS = "loop_margins"
    LOOP_MEASURED = "loop_measured"
    RESONATES = "resonates"
    NO_RESONANCE = "no_resonance"
    RATE_STANDS_OUT = "rate_stands_out"
    MARGINS_UNKNOWN = "margins_unknown"


class TrackingLight(Code):
    """Of attitude against what was asked."""

    FOLLOWS_SETPOINT = "follows_setpoint"
    MISSES_SETPOINT = "misses_setpoint"
    OVERSHOOTS_SETPOINT = "overshoots_setpoint"
    AMPLIFIES_SETPOINT = "amplifies_setpoint"
    RATE_FALLS_SHORT = "rate_falls_short"
    FOLLOWS_RATE_SETPOINT = "follows_rate_setpoint"
    MISSES_RATE_SETPOINT = "misses_rate_setpoint"
    TRACKING_UNKNOWN = "tracking_unknown"
