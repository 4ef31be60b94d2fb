"""Lights: what every log is judged by, each a fact with a level."""

from enum import StrEnum

from mavdem.facts.fact import Code


class Light(StrEnum):
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

    NOT_JUDGED = "not_judged"
    JUDGED_LATER = "judged_later"
    KNOWN_BEFORE = "known_before"
    MULTIROTORS_ONLY = "multirotors_only"
