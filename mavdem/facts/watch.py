"""What is watched of a vehicle in flight without a model of it."""

from enum import auto

from mavdem.facts.fact import Code, InWords


class Watched(InWords):
    """What is watched."""

    MOTORS = auto()
    OSCILLATION = auto()
    MOTOR_LIMITS = auto()
    VIBRATION = auto()
    BATTERY = auto()
    WARNINGS = auto()  # of the autopilot


class Watch(Code):
    """Since when it is watched, or why it is not, and what it says."""

    WATCHED = auto()
    NOT_WATCHED = auto()
    MESSAGE_MISSING = auto()
    REFERENCE_SHORT = auto()
    ON_GROUND_NOW = auto()
    ALARM_OVER = auto()
    OTHER_VEHICLE_ALARM = auto()
