"""What is said of control loops: their margins, the controller behind them, the measured response, gains, the twin."""

from enum import auto

from mavdem.facts.fact import Code


class Loops(Code):
    """Of the rate and the attitude loop of one axis."""

    MARGIN_RATING = auto()
    NO_LOOP = auto()
    NO_MARGINS = auto()
    CROSSOVER_UNSEEN = auto()
    CONTROLLER_UNKNOWN = auto()
    NO_PROPORTIONAL_GAIN = auto()
    MIXER_REVERSED = auto()
    EFFECT_BIASED = auto()
    PARAMETERS_CHANGED = auto()
    GAINS_OF_PART = auto()
    GAINS_OF_AUTOTUNE = auto()
    AUTOTUNED = auto()
    NO_RATE_SETPOINT = auto()
    LOOP_TOO_SHORT = auto()
    LOOP_NOT_FOUND = auto()
    NOT_STEERED = auto()
    MARGIN_UNCERTAIN = auto()
    GAIN_MARGIN_EXTRAPOLATED = auto()


class Controllers(Code):
    """Why the parameters give no controller; and, from SLEW_LIMITED on, what of it is not modelled."""

    NO_GAINS = auto()
    PARAMETERS_MISSING = auto()
    PARAMETER_IMPOSSIBLE = auto()
    MIXER_UNKNOWN = auto()
    SLEW_LIMITED = auto()
    SUM_LIMITED = auto()
    RATE_LOOP_FASTER = auto()
    MIXER_BY_VOLTAGE = auto()
    DEMAND_BY_VOLTAGE = auto()
    NOTCHES_MOVING = auto()
    NOTCHES_UNMODELLED = auto()


class Responses(Code):
    """Of the rate's response in flight beside the predicted one."""

    RESPONSE_UNEXPLAINED = auto()
    RESPONSE_DISAGREES = auto()
    CONTROLLER_GAIN_DIFFERS = auto()


class Gains(Code):
    """Of gains to set, and why there are none."""

    KEEP_GAINS = auto()
    SET_GAINS = auto()
    STEP_TOWARDS_MARGINS = auto()
    NO_GAINS_ADVISED = auto()
    GAINS_CHANGED = auto()
    MOTOR_AT_LIMIT = auto()
    LOOP_UNSTABLE = auto()
    LOWER_GAINS = auto()
    GAINS_ADVISED = auto()
    GAINS_LEFT = auto()
    TWIN_FLIES = auto()
    GAINS_WRITTEN = auto()
    ADVICE_WAITS = auto()
    ADVICE_FAILED = auto()


class Twins(Code):
    """Of a vehicle for simulators; each note says how sure a figure of it is."""

    NO_HOVER = auto()
    CANNOT_FLY = auto()
    MASS_NOTE = auto()
    ARM_NOTE = auto()
    INERTIA_NOTE = auto()
    MOMENT_NOTE = auto()
    DAMPING_NOTE = auto()
    LAG_NOTE = auto()
    DRAG_NOTE = auto()
    EFFECT_NOTE = auto()


class StepResponses(Code):
    """Of the closed loops as measured, and beside the predicted ones."""

    STEP_MEASURED = auto()
    PREDICTION_AGREES = auto()
    PREDICTION_DOUBTED = auto()
    MEASUREMENT_DOUBTED = auto()
    NO_SETPOINT = auto()
    TOO_SLOW = auto()
    TOO_LITTLE_FLIGHT = auto()
    TOO_LITTLE_ASKED = auto()
