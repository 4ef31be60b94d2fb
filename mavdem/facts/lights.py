"""Lights: what every log is judged by, each a fact with a level."""

from enum import auto

from mavdem.facts.fact import Code, InWords


class Light(InWords):
    """What is judged of a vehicle and its log."""

    MOTORS = "motors"
    VIBRATION = "vibration"
    TRACKING = "tracking"
    MARGINS = "margins"
    POWER = "power"
    ESTIMATOR = "estimator"
    WIND = "wind"
    LOG = "log"


class Unjudged(Code):
    """That a light is not judged."""

    NOT_JUDGED = auto()
    JUDGED_LATER = auto()
