"""What is found of motors and propellers: between flights, by their balance, and in flight."""

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


class MotorsLight(Code):
    """What the light of the motors says beside their trim and what they lost."""

    MOTORS_EVEN = auto()
    MOTOR_LIMITED = auto()
    HEADROOM_LITTLE = auto()
    MOTORS_NOT_SEEN = auto()


class MotorsBetween(Code):
    """How the motors of a flight compare with those of healthy flights."""

    MOTORS_UNCHANGED = auto()
    MOTOR_WEAK = auto()
    BALANCE_CHANGED = auto()
    BALANCE_OUTSIDE = auto()
    EFFORT_CHANGED = auto()


class Explanation(StrEnum):
    """What may explain a changed balance."""

    LOAD = "load"
    YAW = "yaw"
    OTHER = "other"
    MOTOR = "motor"


class HealthUnknown(Code):
    """Why the health of a flight's motors is not known."""

    BALANCE_UNKNOWN = auto()
    GEOMETRY_UNKNOWN = auto()
    LEAN_UNKNOWN = auto()
    HEALTHY_FLIGHTS_FEW = auto()
    HEALTH_UNSURE = auto()
    VEHICLE_UNNAMED = auto()
    HEALTH_FAILED = auto()


class Trim(Code):
    """By which pattern the motors of one flight work unevenly."""

    TRIM_EVEN = auto()
    TRIM_OF_YAW = auto()
    TRIM_OF_CENTRE = auto()
    TRIM_OF_ONE_MOTOR = auto()
    TRIM_OF_SEVERAL = auto()
    TRIM_UNSURE = auto()
    TRIM_UNKNOWN = auto()
    TRIM_OF_UNKNOWN_PLACES = auto()
