"""What is found of motors and propellers: between flights, by their balance, and in flight."""

from __future__ import annotations

from enum import StrEnum, auto

from mavdem.facts.fact import Code


class MotorHealth(StrEnum):
    """The health of a flight's motors against that of healthy flights, the worst first."""

    FAULT = "fault"
    DRIFT = "drift"
    OK = "ok"
    UNKNOWN = "unknown"


class InFlight(Code):
    """What the watch of the motors says in flight, and why it may not."""

    MOTOR_LOST_THRUST = auto()
    MOTOR_RECOVERED = auto()
    STEADY_TORQUE_CHANGED = auto()
    MOTOR_PLACES_UNKNOWN = auto()
    MOTOR_OUTPUTS_TOO_SLOW = auto()
    FALSE_ALARMS = auto()


class HealthUnknown(Code):
    """Why the health of a flight's motors is not known."""

    HEALTH_FAILED = auto()
