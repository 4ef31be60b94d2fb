"""Facts that the autopilot reports about a flight, in words, errors, events and states."""

from mavdem.facts.fact import Code


class ReportedEvent(Code):
    """What the autopilot reports."""

    # Ordinary events of a flight.
    MOTORS_ARMED = "motors_armed"
    MOTORS_DISARMED = "motors_disarmed"
    OFF_GROUND = "off_ground"
    ON_GROUND = "on_ground"
    LANDING_DETECTED_IN_FLIGHT = "landing_detected_in_flight"
    GROUND_REPORTED_IN_FLIGHT = "ground_reported_in_flight"
    MODE_CHANGED = "mode_changed"
    ARMING_REFUSED = "arming_refused"
    # Faults of motors and attitude.
    THRUST_LOST = "thrust_lost"
    MOTOR_FAILED = "motor_failed"
    YAW_IMBALANCED = "yaw_imbalanced"
    PROPELLER_IMBALANCED = "propeller_imbalanced"
    VIBRATION_COMPENSATED = "vibration_compensated"
    ATTITUDE_FAILED = "attitude_failed"
    ALTITUDE_FAILED = "altitude_failed"
    CRASH_DETECTED = "crash_detected"
    MOTORS_STOPPED = "motors_stopped"
    FLIGHT_TERMINATED = "flight_terminated"
    PARACHUTE_RELEASED = "parachute_released"
    # Faults of the estimator and the sensors.
    ESTIMATOR_DIVERGED = "estimator_diverged"
    ESTIMATOR_SWITCHED = "estimator_switched"
    ESTIMATOR_RESET = "estimator_reset"
    GPS_JUMPED = "gps_jumped"
    GPS_LOST = "gps_lost"
    SENSOR_FAILED = "sensor_failed"
    # Faults of links, the battery and others.
    RADIO_LOST = "radio_lost"
    GROUND_STATION_LOST = "ground_station_lost"
    BATTERY_WARNED = "battery_warned"
    BATTERY_ALARMED = "battery_alarmed"
    BATTERY_SPENT = "battery_spent"
    BOARD_VOLTAGE_LOW = "board_voltage_low"
    RESTARTED = "restarted"
    RESTARTED_IN_FLIGHT = "restarted_in_flight"
    FENCE_BREACHED = "fence_breached"
    FAILSAFE = "failsafe"
    AUTOPILOT_ERROR = "autopilot_error"
    AUTOPILOT_SAID = "autopilot_said"
