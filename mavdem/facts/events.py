"""What the autopilot reports of a flight, in words, errors, events and states."""

from enum import auto

from mavdem.facts.fact import Code


class Reported(Code):
    """What the autopilot reports."""

    # what is ordinary
    MOTORS_ARMED = auto()
    MOTORS_DISARMED = auto()
    OFF_GROUND = auto()
    ON_GROUND = auto()
    MODE_CHANGED = auto()
    ARMING_REFUSED = auto()
    # motors and attitude
    THRUST_LOST = auto()
    MOTOR_FAILED = auto()
    YAW_IMBALANCED = auto()
    PROPELLER_IMBALANCED = auto()
    VIBRATION_COMPENSATED = auto()
    ATTITUDE_FAILED = auto()
    ALTITUDE_FAILED = auto()
    CRASH_DETECTED = auto()
    MOTORS_STOPPED = auto()
    FLIGHT_TERMINATED = auto()
    PARACHUTE_RELEASED = auto()
    # estimator and sensors
    ESTIMATOR_DIVERGED = auto()
    ESTIMATOR_SWITCHED = auto()
    ESTIMATOR_RESET = auto()
    GPS_JUMPED = auto()
    GPS_LOST = auto()
    SENSOR_FAILED = auto()
    # links, battery and others
    RADIO_LOST = auto()
    GROUND_STATION_LOST = auto()
    BATTERY_WARNED = auto()
    BATTERY_ALARMED = auto()
    BOARD_VOLTAGE_LOW = auto()
    RESTARTED = auto()
    FENCE_BREACHED = auto()
    FAILSAFE = auto()
    AUTOPILOT_ERROR = auto()
    AUTOPILOT_SAID = auto()
