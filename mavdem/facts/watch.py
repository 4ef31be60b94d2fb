"""Quantities that are watched of a vehicle in flight without a model of it."""

from enum import StrEnum

from mavdem.facts.fact import Code


class WatchedQuantity(StrEnum):
    """What is watched."""

    CONTROL = "control"
    MOTORS = "motors"
    OSCILLATION = "oscillation"
    MOTOR_LIMITS = "motor limits"
    VIBRATION = "vibration"
    BATTERY = "battery"
    ESTIMATOR = "estimator"
    TRACKING = "tracking"
    DRIFT = "drift in wind"
    HEIGHT = "height"
    WARNINGS = "warnings"
    """Warnings of the autopilot."""


class WatchFact(Code):
    """Since when it is watched, or why it is not, and what it says."""

    WATCHED = "watched"
    NOT_WATCHED = "not_watched"
    MESSAGE_MISSING = "message_missing"
    BATTERY_NOT_JUDGED = "battery_not_judged"
    NO_MOTOR_AT_LIMIT = "no_motor_at_limit"
    NO_OSCILLATION = "no_oscillation"
    OSCILLATION_AWAITED = "oscillation_awaited"
    MARGINS_AWAITED = "margins_awaited"
    MARGINS_UNCONFIRMED = "margins_unconfirmed"
    WIND_AWAITED = "wind_awaited"
    REFERENCE_SHORT = "reference_short"
    SETTLED_FLIGHT_AWAITED = "settled_flight_awaited"
    TRACKING_AWAITED = "tracking_awaited"
    SETPOINTS_SHOW_LITTLE = "setpoints_show_little"
    ON_GROUND_NOW = "on_ground_now"
    NO_ALARM = "no_alarm"
    STOPPED_IN_AIR = "stopped_in_air"
    FALLS_AT_IDLE = "falls_at_idle"
    SINKS_AT_LIMIT = "sinks_at_limit"
    ALARM_OVER = "alarm_over"
    MOTORS_JUST_STOPPED = "motors_just_stopped"
    ARMED_AFTER_LANDING = "armed_after_landing"
    OTHER_VEHICLE_ALARM = "other_vehicle_alarm"
