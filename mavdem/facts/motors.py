"""Facts about motors and propellers: between flights, by their balance, and in flight."""

import re
from enum import StrEnum

from mavdem.facts.fact import Code

_MOTOR_NUMBER = re.compile(r"motor (\d+)")
"""The number of a motor in its name, such as "motor 2 (rear left)"."""


def motor_number(subject: str) -> int | None:
    """Reads the number of a motor from the subject of a fact (coded finding).

    Args:
        subject: subject of the fact, such as "motor 2 (rear left)". Of several motors, the first counts.

    Returns:
        The number, from 1; None if the subject is no motor.
    """
    named_motor = _MOTOR_NUMBER.search(subject)
    return None if named_motor is None else int(named_motor[1])


LIKELY_PROBABILITY = 0.66
"""Probability from which a weak motor is likely; from 0.33 on it is as likely as not (IPCC, calibrated language)."""


class MotorHealth(StrEnum):
    """The health of a flight's motors against that of healthy flights, the worst first."""

    FAULT = "fault"
    DRIFT = "drift"
    OK = "ok"
    UNKNOWN = "unknown"


class MotorWatchFact(Code):
    """What the watch of the motors says in flight, and why it may not."""

    MOTOR_LOST_THRUST = "motor_lost_thrust"
    MOTOR_SATURATED = "motor_saturated"
    MOTOR_RECOVERED = "motor_recovered"
    NO_LOSS_FOUND = "no_loss_found"
    STEADY_TORQUE_CHANGED = "steady_torque_changed"
    MOTOR_PLACES_UNKNOWN = "motor_places_unknown"
    MOTOR_OUTPUTS_TOO_SLOW = "motor_outputs_too_slow"
    FALSE_ALARMS = "false_alarms"


class MotorsLight(Code):
    """What the light of the motors says beside their trim and what they lost."""

    MOTORS_EVEN = "motors_even"
    MOTOR_LIMITED = "motor_limited"
    MOTORS_AT_LIMIT = "motors_at_limit"
    MOTORS_SWING = "motors_swing"
    HEADROOM_LITTLE = "headroom_little"
    MOTORS_NOT_SEEN = "motors_not_seen"


class MotorsBetween(Code):
    """How the motors of a flight compare with those of healthy flights."""

    MOTORS_UNCHANGED = "motors_unchanged"
    MOTOR_WEAK = "motor_weak"
    BALANCE_CHANGED = "balance_changed"
    BALANCE_OUTSIDE = "balance_outside"
    EFFORT_CHANGED = "effort_changed"


class Explanation(StrEnum):
    """What may explain a changed balance."""

    LOAD = "load"
    YAW = "yaw"
    OTHER = "other"
    MOTOR = "motor"


class HealthUnknown(Code):
    """Why the health of a flight's motors is not known."""

    BALANCE_UNKNOWN = "balance_unknown"
    GEOMETRY_UNKNOWN = "geometry_unknown"
    LEAN_UNKNOWN = "lean_unknown"
    HEALTHY_FLIGHTS_FEW = "healthy_flights_few"
    HEALTH_UNSURE = "health_unsure"
    VEHICLE_UNNAMED = "vehicle_unnamed"
    HEALTH_FAILED = "health_failed"


class TrimFact(Code):
    """By which pattern the motors of one flight work unevenly."""

    TRIM_EVEN = "trim_even"
    TRIM_OF_YAW = "trim_of_yaw"
    TRIM_OF_CENTRE = "trim_of_centre"
    TRIM_OF_ONE_MOTOR = "trim_of_one_motor"
    TRIM_OF_LEADING_MOTOR = "trim_of_leading_motor"
    TRIM_OF_SEVERAL = "trim_of_several"
    TRIM_NEAR_LIMIT = "trim_near_limit"
    TRIM_UNSURE = "trim_unsure"
    TRIM_UNKNOWN = "trim_unknown"
    TRIM_OF_UNKNOWN_PLACES = "trim_of_unknown_places"
