"""Online: why the model of a stream is not learned yet, what surprised it, and what keeps a flight's wind unknown."""

from enum import StrEnum

from mavdem.facts.fact import Code


class OnlineFact(Code):
    """What is said of the online learner."""

    TOO_FEW_SAMPLES_YET = "too_few_samples_yet"
    FIRST_LEARNING = "first_learning"
    SAMPLES_MISPLACED = "samples_misplaced"
    LEARNING_FAILED = "learning_failed"
    PROCESS_KILLED = "process_killed"


class SurpriseCause(StrEnum):
    """What made the free energy of samples drop, by the names that documents have."""

    MODEL_MISFIT = "model_misfit"
    DISTURBANCE = "disturbance"


class DragSource(StrEnum):
    """What a vehicle's drag is known from, by the names that documents have."""

    POPULATION = "population"
    PARAMETERS = "parameters"
    FLIGHT = "flight"
    EARLIER_FLIGHT = "earlier_flight"
    CALIBRATION = "calibration"


class AirflowFact(Code):
    """Why attitude and velocity give no wind."""

    MOTION_UNKNOWN = "motion_unknown"
    MOTION_TOO_SHORT = "motion_too_short"
    VELOCITY_INCONSISTENT = "velocity_inconsistent"
