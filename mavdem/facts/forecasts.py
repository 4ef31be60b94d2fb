"""Forecasts: held-out windows, methods that are compared, and the truth of simulated flights."""

from enum import StrEnum

from mavdem.facts.fact import Code


class ForecastFact(Code):
    """What is said of windows, of models that are trained on them, and of truth files."""

    FLIGHT_TOO_SHORT = "flight_too_short"
    TRAINING_TOO_SHORT = "training_too_short"
    NOTHING_LEFT = "nothing_left"
    NO_TEST_WINDOW = "no_test_window"
    PART_NOT_LEARNED = "part_not_learned"
    FAILED = "failed"
    TOO_FEW_FOR_ORDER = "too_few_for_order"
    TOO_FEW_STATES = "too_few_states"
    NOT_OBSERVABLE = "not_observable"
    EM_BROKE_DOWN = "em_broke_down"
    MODEL_UNSTABLE = "model_unstable"
    STILL_IMPROVING = "still_improving"
    NO_TRUTH_FILE = "no_truth_file"
    TRUTH_OF_ANOTHER_FLIGHT = "truth_of_another_flight"
    NO_MATLAB_FILES = "no_matlab_files"
    NOT_AN_ARDRONE_FLIGHT = "not_an_ardrone_flight"


class TestResult(StrEnum):
    """Whether one method's error is lower or higher than another's, beyond chance."""

    # Without this, pytest would take the class for a test because of its name.
    __test__ = False

    LOWER = "lower"
    HIGHER = "higher"
    NOT_DISTINGUISHABLE = "not distinguishable"


class MethodName(StrEnum):
    """Fits of DEM and the joint autoregressions, as documents name them; p = 1 is without generalized coordinates."""

    JOINT = "joint VAR (Bayesian)"
    PLANT = "DEM plant"
    PLANT_P1 = "DEM plant p=1"
    PAPER = "DEM paper"
    PAPER_P1 = "DEM paper p=1"
    JOINT_VAR = "joint VAR"


class ComparedWithTruth(StrEnum):
    """What is compared with the truth, by the names that documents have."""

    EFFECT_OF = "effect of"
    MEAN_EFFECT = "mean effect"
    DAMPING = "damping"
    LAG_OF_THE_MOTORS = "lag of the motors"
    DELAY = "delay"
    STEADY_PART = "steady part"


class HeldOutForecast(StrEnum):
    """The forecasts of held-out windows, by the names that documents have."""

    FORECAST = "forecast"
    PREDICTION = "prediction"
    CONSTANT_MEAN = "constant mean"
    HOLD_LAST = "hold last"
