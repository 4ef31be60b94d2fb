"""The assessment of a flight: what it says of its vehicle, what overrides that, and what its model is good for."""

from enum import StrEnum

from mavdem.facts.fact import Code, Level


class Purpose(StrEnum):
    """What a model may be used for; the names are those of screens, documents and pages."""

    CONTROL_EFFECTIVENESS = "control effectiveness"
    DAMPING_AND_TIME_CONSTANT = "damping and time constant"
    WIND_TORQUE = "wind torque"
    PREDICTION = "prediction"
    RESIDUALS = "residuals"


class Grade(StrEnum):
    """How well a model serves a purpose; docs/report.md has the scale."""

    GOOD = "GOOD"
    LIMITED = "LIMITED"
    NOT_IDENTIFIABLE = "NOT IDENTIFIABLE"

    @property
    def level(self) -> Level:
        """The level by which it is shown."""
        return {Grade.GOOD: Level.GOOD, Grade.LIMITED: Level.WATCH}.get(self, Level.BAD)


class BoundTest(StrEnum):
    """Whether correlations of residuals keep to the bounds of chance, or nearly."""

    PASSED = "passed"
    NEARLY = "nearly"
    FAILED = "failed"


class Override(Code):
    """What makes the flight itself doubtful, and overrides all grades; the values are those of documents."""

    OSCILLATION = "oscillation"
    MOTORS = "motors"
    SATURATION = "saturation"
    TRIM = "trim"
    DATA = "data"


class Headline(Code):
    """The first sentence of an assessment where nothing is wrong."""

    NOTHING_WRONG = "nothing_wrong"
    NOTHING_CHECKED = "nothing_checked"


class InShort(Code):
    """What is so of a flight, in few words."""

    OVERRIDDEN = "overridden"


class GradeReason(Code):
    """Why a purpose has its grade."""

    EFFECT_KNOWN = "effect_known"
    MOTION_KNOWN = "motion_known"
    PARAMETERS_DOUBTED = "parameters_doubted"
    SAME_AS_EFFECT = "same_as_effect"
    WIND_SIZE_KNOWN = "wind_size_known"
    EFFECT_UNKNOWN = "effect_unknown"
    WIND_NOT_ESTIMATED = "wind_not_estimated"
    FOLLOWS_FROM_DOUBTED = "follows_from_doubted"
    OWN_TORQUE = "own_torque"
    FORECASTS_COMPARED = "forecasts_compared"
    RESIDUALS_TESTED = "residuals_tested"
    FLIGHT_DOUBTED = "flight_doubted"


class Caveat(Code):
    """What must be known before a model is used."""

    BAND_TOO_NARROW = "band_too_narrow"
    ERRORS_LARGER_THAN_EXPECTED = "errors_larger_than_expected"
    UNSTABLE_MODEL = "unstable_model"
    SLOW_MOTION_ONLY = "slow_motion_only"


class NextStep(Code):
    """What to do next."""

    DO_AS_ADVISED = "do_as_advised"
    FLY_MOVEMENTS = "fly_movements"
    FLY_LONGER = "fly_longer"
    KEEP_PARAMETERS = "keep_parameters"
    KEEP_MODEL = "keep_model"
    KEEP_LOG = "keep_log"
    RECORD_NEXT_FLIGHT = "record_next_flight"
    LOAD_GAINS = "load_gains"
    FLY_BEFORE_GAINS = "fly_before_gains"
    FLY_FOR_GAINS = "fly_for_gains"
    HOVER_TO_TUNE = "hover_to_tune"
    KEEP_OR_CONFIRM_GAINS = "keep_or_confirm_gains"
    TUNE_OTHER_AXES = "tune_other_axes"
    LAND_NOW = "land_now"
    LAND_SOON = "land_soon"
    FLY_ON = "fly_on"
    FLY_ON_IF_REPAIRED = "fly_on_if_repaired"
    TAKE_OFF_IF_REPAIRED = "take_off_if_repaired"
    HOVER_FIRST = "hover_first"
    LET_LAND = "let_land"
    LAND_BY_SIGHT = "land_by_sight"
    FLY_BY_SIGHT = "fly_by_sight"


class NoModel(Code):
    """Why there is no full model."""

    NO_SETTLED_FLIGHT = "no_settled_flight"
    NOT_LEARNED = "not_learned"
    SLOW_MODEL_TOO_WEAK = "slow_model_too_weak"
    SLOW_MODEL_REFUSED = "slow_model_refused"
    REFUSED = "refused"
