"""Why a model of an axis can or cannot be learned from a log, what makes it less reliable, and what to change."""

from mavdem.facts.fact import Code


class NotLearnableReason(Code):
    """Why a log can be learned from, or cannot."""

    LEARNABLE = "learnable"
    LOG_WITHOUT_VEHICLE = "log_without_vehicle"
    NO_SUCH_VEHICLE = "no_such_vehicle"
    SEVERAL_VEHICLES = "several_vehicles"
    NO_MULTIROTOR = "no_multirotor"
    NO_ATTITUDE = "no_attitude"
    ATTITUDE_NOT_FINITE = "attitude_not_finite"
    ATTITUDE_UNIT = "attitude_unit"
    NO_DEMAND = "no_demand"
    DEMAND_CONSTANT = "demand_constant"
    NEVER_ARMED = "never_armed"
    NO_EVIDENCE_OF_FLIGHT = "no_evidence_of_flight"
    NEVER_AIRBORNE = "never_airborne"
    TOO_SHORT = "too_short"
    STREAMS_TOO_SLOW = "streams_too_slow"
    SLOWER_THAN_LONGEST = "slower_than_longest"
    VALUES_REPEATED = "values_repeated"
    OUTPUT_CONSTANT = "output_constant"
    OUTPUT_ROUNDED = "output_rounded"
    COMMAND_ROUNDED = "command_rounded"
    RATE_CONTRADICTS_ANGLE = "rate_contradicts_angle"
    LOG_NOT_LEARNABLE = "log_not_learnable"


class UnusableOutputs(Code):
    """Why a log has no motor outputs that can be inputs of a model."""

    NO_MOTOR_MESSAGE = "no_motor_message"
    MOTORS_CONSTANT = "motors_constant"
    CHANNELS_MISSING = "channels_missing"
    CHANNELS_CONSTANT = "channels_constant"
    OUTPUTS_NOT_FINITE = "outputs_not_finite"
    MOTORS_OFF = "motors_off"


class Caution(Code):
    """What makes a model of a log less reliable."""

    IMPOSSIBLE_ATTITUDE = "impossible_attitude"
    MESSAGES_LEFT_OUT = "messages_left_out"
    DEMAND_IS_INPUT = "demand_is_input"
    VEHICLE_ASSUMED = "vehicle_assumed"
    MIXER_ASSUMED = "mixer_assumed"
    NEAR_RESOLUTION = "near_resolution"
    RATE_EXPLAINS_LITTLE = "rate_explains_little"
    SEGMENTS_LEFT_OUT = "segments_left_out"


class Resampling(Code):
    """How a stream came onto the clock of a flight."""

    SAMPLES_KEPT = "samples_kept"
    INTERPOLATED = "interpolated"
    LOW_PASSED = "low_passed"


class Remedy(Code):
    """What to change so that a log can be learned from: a flight, or the rates of attitude and motors."""

    RECORD_A_FLIGHT = "record_a_flight"
    LEAVE_OUT_MOTORS = "leave_out_motors"
    STOP_ASKING_FOR_RATES = "stop_asking_for_rates"
    DEMAND_NOT_LOGGED = "demand_not_logged"
    LOG_FAST_ATTITUDE = "log_fast_attitude"
    LOG_HIGH_RATE = "log_high_rate"
    DDS_TOPICS = "dds_topics"
    MAVROS_INTERVALS = "mavros_intervals"
    PX4_STREAMS = "px4_streams"
    ARDUPILOT_STREAMS = "ardupilot_streams"
    MESSAGE_INTERVALS = "message_intervals"
