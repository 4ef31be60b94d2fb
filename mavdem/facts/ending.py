"""What the motion of a flight shows, how a flight was lost, and what failed first."""

from mavdem.facts.fact import Code


class MotionEvent(Code):
    """What attitude, height and motors show, whatever the autopilot reports."""

    MOTOR_AT_ITS_STOP = "motor_at_its_stop"
    MOTOR_OFF = "motor_off"
    MOTOR_STOOD_STILL = "motor_stood_still"
    OUTPUT_FROZE = "output_froze"
    ATTITUDE_LOST = "attitude_lost"
    ATTITUDE_CAUGHT = "attitude_caught"
    ATTITUDE_SWUNG = "attitude_swung"
    SPUN = "spun"
    TIPPED = "tipped"
    TOPPLED = "toppled"
    LANDED_HARD = "landed_hard"
    FELL = "fell"
    DIVED = "dived"
    FLIPPED = "flipped"
    HIT = "hit"
    MOTORS_RAN_ON = "motors_ran_on"
    CLIPPED = "clipped"
    LOG_ENDED_IN_AIR = "log_ended_in_air"
    NOT_FLOWN = "not_flown"
    HEIGHT_DIVERGED = "height_diverged"
    HEIGHT_OFFSET = "height_offset"
    POSITION_LOST = "position_lost"
    BAROMETER_DRIFTED = "barometer_drifted"
    HEIGHTS_DISAGREE = "heights_disagree"
    CARRIED_AWAY = "carried_away"
    ATTITUDE_INVALID = "attitude_invalid"


class Ending(Code):
    """How a flight was lost."""

    CONTROL_LOST = "control_lost"
    TIPPED_OVER = "tipped_over"
    TOPPLED_AT_LANDING = "toppled_at_landing"
    CRASHED = "crashed"
    LOSS_REPORTED = "loss_reported"


class FailedFirst(Code):
    """What failed before control was lost."""

    LIMIT_FIRST = "limit_first"
    THRUST_MISSING_FIRST = "thrust_missing_first"
    OUTPUT_FROZE_FIRST = "output_froze_first"
    MOTOR_OFF_FIRST = "motor_off_first"
    MOTOR_STOOD_STILL_FIRST = "motor_stood_still_first"
    ALL_OFF_FIRST = "all_off_first"
    LANDING_ASSUMED_FIRST = "landing_assumed_first"
    THRUST_SPENT_FIRST = "thrust_spent_first"
    THROTTLE_CLOSED_FIRST = "throttle_closed_first"
    FAILSAFE_FIRST = "failsafe_first"
    HEIGHT_DIVERGED_FIRST = "height_diverged_first"
    OVERTURN_COMMANDED_FIRST = "overturn_commanded_first"
    THROTTLE_LOWERED_FIRST = "throttle_lowered_first"
