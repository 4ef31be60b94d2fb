"""What the motion of a flight shows, how a flight was lost, and what failed first."""

from enum import auto

from mavdem.facts.fact import Code


class MotionEvent(Code):
    """What attitude, height and motors show, whatever the autopilot reports."""

    MOTOR_AT_ITS_STOP = auto()
    MOTOR_OFF = auto()
    ATTITUDE_LOST = auto()
    ATTITUDE_CAUGHT = auto()
    TIPPED = auto()
    FELL = auto()
    HIT = auto()
    CLIPPED = auto()
    LOG_ENDED_IN_AIR = auto()


class Ending(Code):
    """How a flight was lost."""

    CONTROL_LOST = auto()
    TIPPED_OVER = auto()
    CRASHED = auto()
    LOSS_REPORTED = auto()


class FailedFirst(Code):
    """What failed before control was lost."""

    LIMIT_FIRST = auto()
    OUTPUT_FROZE_FIRST = auto()
    MOTOR_OFF_FIRST = auto()
    ALL_OFF_FIRST = auto()
    LANDING_ASSUMED_FIRST = auto()
    THRUST_SPENT_FIRST = auto()
