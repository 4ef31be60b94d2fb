"""Facts about control loops: their margins, their controller, the measured response, gains, and the twin."""

from enum import StrEnum

from mavdem.facts.fact import Code

ADVISED_STREAM_RATE = 95.0
"""Rate of messages, Hz, that counts as the 100 Hz of advice on logging: rates of logs vary by a few percent."""

SETTLING_BAND = 0.05
"""Distance from its final value within which a step response has settled, as a fraction of the step: the usual 5 %."""


class LoopFact(Code):
    """Of the rate and the attitude loop of one axis."""

    MARGIN_RATING = "margin_rating"
    NO_LOOP = "no_loop"
    NO_MARGINS = "no_margins"
    CROSSOVER_UNSEEN = "crossover_unseen"
    CONTROLLER_UNKNOWN = "controller_unknown"
    NO_PROPORTIONAL_GAIN = "no_proportional_gain"
    MIXER_REVERSED = "mixer_reversed"
    EFFECT_BIASED = "effect_biased"
    PARAMETERS_CHANGED = "parameters_changed"
    GAINS_OF_PART = "gains_of_part"
    GAINS_OF_AUTOTUNE = "gains_of_autotune"
    AUTOTUNED = "autotuned"
    GAINS_SINCE = "gains_since"
    NO_RATE_SETPOINT = "no_rate_setpoint"
    LOOP_TOO_SHORT = "loop_too_short"
    LOOP_NOT_FOUND = "loop_not_found"
    NOT_STEERED = "not_steered"
    MARGIN_UNCERTAIN = "margin_uncertain"
    GAIN_MARGIN_EXTRAPOLATED = "gain_margin_extrapolated"
    CROSSOVER_FAST = "crossover_fast"
    STEERING_SLOW = "steering_slow"


class ControllerFact(Code):
    """Why the parameters give no controller; and, from SLEW_LIMITED on, what of it is not modelled."""

    NO_GAINS = "no_gains"
    PARAMETERS_MISSING = "parameters_missing"
    PARAMETER_IMPOSSIBLE = "parameter_impossible"
    MIXER_IN_FILE = "mixer_in_file"
    MIXER_UNKNOWN = "mixer_unknown"
    SLEW_LIMITED = "slew_limited"
    SUM_LIMITED = "sum_limited"
    RATE_LOOP_FASTER = "rate_loop_faster"
    MIXER_BY_VOLTAGE = "mixer_by_voltage"
    DEMAND_BY_VOLTAGE = "demand_by_voltage"
    NOTCHES_MOVING = "notches_moving"
    NOTCHES_UNMODELLED = "notches_unmodelled"


class ResponseFact(Code):
    """Of the rate's response in flight beside the predicted one."""

    RESPONSE_UNEXPLAINED = "response_unexplained"
    RESPONSE_LIMITED = "response_limited"
    RESPONSE_DISAGREES = "response_disagrees"
    CONTROLLER_GAIN_DIFFERS = "controller_gain_differs"


class GainBound(StrEnum):
    """What keeps gains from being higher."""

    NOISE = "noise"
    """The gyro's noise in the motors."""
    MARGINS = "margins"
    """The margins of some models."""
    RANGE = "range"
    """The highest gain that is tried."""


class GainFact(Code):
    """Of gains to set, and why there are none."""

    KEEP_GAINS = "keep_gains"
    SET_GAINS = "set_gains"
    ROOM_FOR_GAINS = "room_for_gains"
    STEP_TOWARDS_MARGINS = "step_towards_margins"
    SHARE_OF_MODELS = "share_of_models"
    GYRO_CUTOFF_LOW = "gyro_cutoff_low"
    GYRO_FILTER_LAG = "gyro_filter_lag"
    RATIO_UNUSUAL = "ratio_unusual"
    ANGLE_FOLLOWS = "angle_follows"
    INTEGRAL_FALLS = "integral_falls"
    ATTITUDE_SLOWER = "attitude_slower"
    RATE_SLOWER = "rate_slower"
    RATE_SLUGGISH = "rate_sluggish"
    FEEDFORWARD_AMPLIFIES = "feedforward_amplifies"
    FIT_BARELY_ENOUGH = "fit_barely_enough"
    STEP_BOUND = "step_bound"
    NO_GAINS_ADVISED = "no_gains_advised"
    GAINS_CHANGED = "gains_changed"
    MOTOR_AT_LIMIT = "motor_at_limit"
    LOOP_UNSTABLE = "loop_unstable"
    LAG_UNRESOLVED = "lag_unresolved"
    STABILITY_UNKNOWN = "stability_unknown"
    LOWER_GAINS = "lower_gains"
    LOWERED_WITHOUT_MODEL = "lowered_without_model"
    GAIN_LOWERED_SINCE = "gain_lowered_since"
    GAIN_CHANGED_IN_FLIGHT = "gain_changed_in_flight"
    GAINS_ADVISED = "gains_advised"
    GAINS_LEFT = "gains_left"
    TWIN_ANGLE_ERROR = "twin_flies"
    GAINS_WRITTEN = "gains_written"
    ADVICE_WAITS = "advice_waits"
    ADVICE_AWAITED = "advice_awaited"
    ADVICE_FAILED = "advice_failed"


class TwinFact(Code):
    """Of a vehicle for simulators; each note says how sure a figure of it is."""

    NO_HOVER = "no_hover"
    CANNOT_FLY = "cannot_fly"
    MASS_NOTE = "mass_note"
    ARM_NOTE = "arm_note"
    INERTIA_NOTE = "inertia_note"
    MOMENT_NOTE = "moment_note"
    DAMPING_NOTE = "damping_note"
    LAG_NOTE = "lag_note"
    DRAG_NOTE = "drag_note"
    EFFECT_NOTE = "effect_note"


class StepResponseFact(Code):
    """Of the closed loops as measured, and beside the predicted ones."""

    STEP_MEASURED = "step_measured"
    STEP_DOUBTED = "step_doubted"
    PREDICTION_AGREES = "prediction_agrees"
    PREDICTION_DOUBTED = "prediction_doubted"
    MEASUREMENT_DOUBTED = "measurement_doubted"
    NO_SETPOINT = "no_setpoint"
    TOO_SLOW = "too_slow"
    TOO_LITTLE_FLIGHT = "too_little_flight"
    TOO_LITTLE_ASKED = "too_little_asked"
    NO_RESPONSE_WINDOW = "no_response_window"
    NOT_COHERENT = "not_coherent"
    GAIN_UNCERTAIN = "gain_uncertain"
    STEP_UNCERTAIN = "step_uncertain"
    SETPOINT_FOLLOWS = "setpoint_follows_vehicle"


class LoopAction(Code):
    """What to do about the loops of an axis; LOOPS_JUDGED has it together with what is wrong."""

    LOOPS_JUDGED = "loops_judged"
    LOAD_ADVISED_GAINS = "load_advised_gains"
    FLY_BEFORE_GAINS = "fly_before_advised_gains"
    RAISE_AS_ADVISED = "raise_as_advised"
    LOWER_BY_A_THIRD = "lower_by_a_third"
    FLY_DOUBLETS = "fly_doublets"
    HOVER_WITH_LOWER_GAINS = "hover_with_lower_gains"
    SLOWER_TURNS = "slower_turns"
    CHECK_VEHICLE = "check_vehicle"
    DO_FIRST = "do_first"
