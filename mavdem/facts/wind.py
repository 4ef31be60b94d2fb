"""The wind in metres a second: why there is none, and what of it a flight does not identify."""

from enum import auto

from mavdem.facts.fact import Code


class NoWind(Code):
    """Why a log has no wind."""

    NO_VELOCITY = auto()
    NO_FLIGHT_WITH_VELOCITY = auto()
    CLOCK_JUMPS = auto()
    NOT_MEASURED = auto()
    STUCK = auto()


class WindDoubt(Code):
    """What of drag, speed or direction is known too roughly."""

    DRAG_UNSURE = auto()
    SPEED_UNSURE = auto()
    DIRECTION_UNSURE = auto()


class WindShare(Code):
    """How much of a torque the mean wind explains."""

    SHARE_KNOWN = auto()
    SHARE_UNKNOWN = auto()


class WindLight(Code):
    """What the light of the wind says."""

    WIND_BLEW = auto()
    WIND_NOT_KNOWN = auto()
