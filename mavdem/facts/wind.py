"""The wind in metres a second: why there is none, and what of it a flight does not identify."""

from mavdem.facts.fact import Code


class NoWind(Code):
    """Why a log has no wind."""

    NO_VELOCITY = "no_velocity"
    NO_FLIGHT_WITH_VELOCITY = "no_flight_with_velocity"
    CLOCK_JUMPS = "clock_jumps"
    NOT_MEASURED = "not_measured"
    STUCK = "stuck"
    NO_POSITION_FIX = "no_position_fix"
    BEYOND_ANY_WIND = "beyond_any_wind"
    ATTITUDE_NOT_FOLLOWED = "attitude_not_followed"


class WindDoubt(Code):
    """What of drag, speed or direction is known too roughly."""

    DRAG_UNSURE = "drag_unsure"
    SPEED_UNSURE = "speed_unsure"
    DIRECTION_UNSURE = "direction_unsure"


class WindAdvice(Code):
    """What to fly so that the wind is known better."""

    FLY_BOX = "fly_box"
    BETTER_PRIOR = "better_prior"
    TURN_HEADING = "turn_heading"


class WindShare(Code):
    """How much of a torque the mean wind explains."""

    SHARE_KNOWN = "share_known"
    SHARE_UNKNOWN = "share_unknown"


class WindLight(Code):
    """What the light of the wind says."""

    WIND_BLEW = "wind_blew"
    WIND_NOT_KNOWN = "wind_not_known"
