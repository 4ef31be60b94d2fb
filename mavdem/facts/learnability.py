"""Why a model of an axis can or cannot be learned from a log, what makes it less reliable, and what to change."""

from enum import auto

from mavdem.facts.fact import Code


class Reason(Code):
    """Why a log can be learned from, or cannot."""

    LEARNABLE = auto()
    LOG_WITHOUT_VEHICLE = auto()
    NO_SUCH_VEHICLE = auto()
    SEVERAL_VEHICLES = auto()
    NO_MULTIROTOR = auto()
    NO_ATTITUDE = auto()
    ATTITUDE_NOT_FINITE = auto()
    ATTITUDE_UNIT = auto()
    NO_DEMAND = auto()
    DEMAND_CONSTANT = auto()
    NEVER_ARMED = auto()
    NO_EVIDENCE_OF_FLIGHT = auto()
    NEVER_AIRBORNE = auto()
    TOO_SHORT = auto()
    STREAMS_TOO_SLOW = auto()
    SLOWER_THAN_LONGEST = auto()
    VALUES_REPEATED = auto()
    OUTPUT_CONSTANT = auto()
    OUTPUT_ROUNDED = auto()
    COMMAND_ROUNDED = auto()
    RATE_CONTRADICTS_ANGLE = auto()
    LOG_NOT_LEARNABLE = auto()


class MotorObstacle(Code):
    """Why a log has no motor outputs that can be inputs of a model."""

    NO_MOTOR_MESSAGE = auto()
    MOTORS_CONSTANT = auto()
    CHANNELS_MISSING = auto()
    CHANNELS_CONSTANT = auto()
    OUTPUTS_NOT_FINITE = auto()
    MOTORS_OFF = auto()


class Caution(Code):
    """What makes a model of a log less reliable."""

    IMPOSSIBLE_ATTITUDE = auto()
    MESSAGES_LEFT_OUT = auto()
    DEMAND_IS_INPUT = auto()
    VEHICLE_ASSUMED = auto()
    MIXER_ASSUMED = auto()
    NEAR_RESOLUTION = auto()
    RATE_EXPLAINS_LITTLE = auto()
    SEGMENTS_LEFT_OUT = auto()


class Resampling(Code):
    """How a stream came onto the clock of a flight."""

    SAMPLES_KEPT = auto()
    INTERPOLATED = auto()
    LOW_PASSED = auto()


class Remedy(Code):
    """What to change so that a log can be learned from: a flight, or the rates of attitude and motors."""

    RECORD_A_FLIGHT = auto()
    LEAVE_OUT_MOTORS = auto()
    STOP_ASKING_FOR_RATES = auto()
    DEMAND_NOT_LOGGED = auto()
    LOG_FAST_ATTITUDE = auto()
    LOG_HIGH_RATE = auto()
    DDS_TOPICS = auto()
    MAVROS_INTERVALS = auto()
    PX4_STREAMS = auto()
    ARDUPILOT_STREAMS = auto()
    MESSAGE_INTERVALS = auto()
