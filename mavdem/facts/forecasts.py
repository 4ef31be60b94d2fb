"""Forecasts: held-out windows, methods that are compared, and the truth of simulated flights."""

from enum import StrEnum, auto

from mavdem.facts.fact import Code, InWords


class Forecasts(Code):
    """What is said of windows, of models that are trained on them, and of truth files."""

    FLIGHT_TOO_SHORT = auto()
    NOTHING_LEFT = auto()
    NO_TEST_WINDOW = auto()
    PART_NOT_LEARNED = auto()
    FAILED = auto()
    TOO_FEW_FOR_ORDER = auto()
    TOO_FEW_STATES = auto()
    NOT_OBSERVABLE = auto()
    EM_BROKE_DOWN = auto()
    MODEL_UNSTABLE = auto()
    STILL_IMPROVING = auto()
    NO_TRUTH_FILE = auto()
    TRUTH_OF_ANOTHER_FLIGHT = auto()


class TestResult(InWords):
    """Whether one method's error is lower or higher than another's, beyond chance."""

    __test__ = False  # no test of pytest's

    LOWER = auto()
    HIGHER = auto()
    NOT_DISTINGUISHABLE = auto()


class MethodName(StrEnum):
    """Fits of DEM and the joint autoregression, as documents name them; p = 1 is without generalized coordinates."""

    JOINT = "DEM joint"
    PLANT = "DEM plant"
    PLANT_P1 = "DEM plant p=1"
    PAPER = "DEM paper"
    PAPER_P1 = "DEM paper p=1"
    JOINT_VAR = "joint VAR"


class Compared(InWords):
    """What is compared with the truth, by the names that documents have."""

    EFFECT_OF = auto()
    MEAN_EFFECT = auto()
    DAMPING = auto()
    LAG_OF_THE_MOTORS = auto()
    DELAY = auto()
    STEADY_PART = auto()


class HeldOutForecast(InWords):
    """The forecasts of held-out windows, by the names that documents have."""

    FORECAST = auto()
    PREDICTION = auto()
    CONSTANT_MEAN = auto()
    HOLD_LAST = auto()
