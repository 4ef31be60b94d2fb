"""Facts that one sensor shows for or against an event, such as a knock for a crash: the ``witnesses`` of the event."""

from enum import StrEnum

from mavdem.facts.fact import Code


class Side(StrEnum):
    """Whether a sensor fact supports an event or contradicts it."""

    FOR = "for"
    AGAINST = "against"


class HeightSource(StrEnum):
    """What measured a height."""

    BAROMETER = "barometer"
    ESTIMATE = "estimate"
    SATELLITES = "satellites"


class SensorFact(Code):
    """What a sensor, the autopilot or a command shows for or against an event, such as a crash."""

    # Height.
    ROSE = "witness_rose"
    STAYED_LEVEL = "witness_stayed_level"
    SANK = "witness_sank"
    DID_NOT_SINK = "witness_did_not_sink"
    GROUND_READING_CHANGED = "witness_ground_reading_changed"
    SATELLITES_LEVEL = "witness_satellites_level"
    # Attitude and gyro.
    ATTITUDE_ANSWERED = "witness_attitude_answered"
    ATTITUDE_IGNORED = "witness_attitude_ignored"
    ATTITUDE_LEFT_SETPOINT = "witness_attitude_left_setpoint"
    ATTITUDE_HELD = "witness_attitude_held"
    ROTATED = "witness_rotated"
    DID_NOT_ROTATE = "witness_did_not_rotate"
    GYRO_DISAGREED = "witness_gyro_disagreed"
    LAY_ON_ITS_SIDE = "witness_lay_on_its_side"
    STOOD_UPRIGHT = "witness_stood_upright"
    # Accelerometer.
    KNOCKED = "witness_knocked"
    NO_KNOCK = "witness_no_knock"
    GRAVITY_WRONG = "witness_gravity_wrong"
    CLIPPED = "witness_clipped"
    VIBRATED = "witness_vibrated"
    # Position.
    POSITION_INVALID = "witness_position_invalid"
    NO_FIX = "witness_no_fix"
    # What followed.
    RESTED = "witness_rested"
    LOG_ENDED = "witness_log_ended"
    # Commands and the autopilot.
    THROTTLE_CLOSED = "witness_throttle_closed"
    THROTTLE_NOT_RAISED = "witness_throttle_not_raised"
    MOTORS_FULL = "witness_motors_full"
    MOTORS_THROTTLED = "witness_motors_throttled"
    # Speed controllers and their motors.
    SPEED_ZERO = "witness_speed_zero"
    ERRORS_COUNTED = "witness_errors_counted"
    MOTOR_SLOWED = "witness_motor_slowed"
    MOTOR_TURNED = "witness_motor_turned"
    COMMAND_ROSE = "witness_command_rose"
    COMMANDS_CHANGED = "witness_commands_changed"
    COMMAND_UNCHANGED = "witness_command_unchanged"
    COMMAND_ABOVE_OTHERS = "witness_command_above_others"
    MODE_CHANGED = "witness_mode_changed"
    AUTOPILOT_REPORTED = "witness_autopilot_reported"
