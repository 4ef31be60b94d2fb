"""Online: why the model of a stream is not learned yet, or not again; and what keeps a flight's wind unknown."""

from enum import StrEnum, auto

from mavdem.facts.fact import Code


class Online(Code):
    """What is said of the online learner."""

    TOO_FEW_SAMPLES_YET = auto()
    FIRST_LEARNING = auto()
    SAMPLES_MISPLACED = auto()
    LEARNING_FAILED = auto()


class DragSource(StrEnum):
    """What a vehicle's drag is known from, by the names that documents have."""

    POPULATION = auto()
    PARAMETERS = auto()
    FLIGHT = auto()
    CALIBRATION = auto()


class Airflow(Code):
    """Why attitude and velocity give no wind."""

    MOTION_UNKNOWN = auto()
    MOTION_TOO_SHORT = auto()
    VELOCITY_INCONSISTENT = auto()
