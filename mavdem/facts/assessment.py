"""The assessment of a flight: what it says of its vehicle, what overrides that, and what its model is good for."""

from enum import StrEnum, auto

from mavdem.facts.fact import Code, InWords, Level


class Purpose(InWords):
    """What a model may be used for; the names are those of screens, documents and pages."""

    CONTROL_EFFECTIVENESS = auto()
    DAMPING_AND_TIME_CONSTANT = auto()
    WIND_TORQUE = auto()
    PREDICTION = auto()
    RESIDUALS = auto()


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

    PASSED = auto()
    NEARLY = auto()
    FAILED = auto()


class Override(Code):
    """What makes the flight itself doubtful, and overrides all grades; the values are those of documents."""

    OSCILLATION = auto()
    MOTORS = auto()
    SATURATION = auto()
    TRIM = auto()
    DATA = auto()


class Headline(Code):
    """The first sentence of an assessment where nothing is wrong."""

    NOTHING_WRONG = auto()
    NOTHING_CHECKED = auto()


class InShort(Code):
    """What is so of a flight, in few words."""

    OVERRIDDEN = auto()


class Because(Code):
    """Why a purpose has its grade."""

    EFFECT_KNOWN = auto()
    MOTION_KNOWN = auto()
    PARAMETERS_DOUBTED = auto()
    SAME_AS_EFFECT = auto()
    WIND_SIZE_KNOWN = auto()
    EFFECT_UNKNOWN = auto()
    WIND_NOT_ESTIMATED = auto()
    FOLLOWS_FROM_DOUBTED = auto()
    OWN_TORQUE = auto()
    FORECASTS_COMPARED = auto()
    RESIDUALS_TESTED = auto()
    FLIGHT_DOUBTED = auto()


class Caveat(Code):
    """What must be known before a model is used."""

    BAND_TOO_NARROW = auto()
    ERRORS_LARGER_THAN_EXPECTED = auto()
    UNSTABLE_MODEL = auto()
    SLOW_MOTION_ONLY = auto()


class NextStep(Code):
    """What to do next."""

    DO_AS_ADVISED = auto()
    FLY_MOVEMENTS = auto()
    FLY_LONGER = auto()
    KEEP_PARAMETERS = auto()
    KEEP_MODEL = auto()
    LOAD_GAINS = auto()
    LAND_NOW = auto()


class NoModel(Code):
    """Why there is no full model."""

    NO_SETTLED_FLIGHT = auto()
    NOT_LEARNED = auto()
    SLOW_MODEL_TOO_WEAK = auto()
    SLOW_MODEL_REFUSED = auto()
    REFUSED = auto()
