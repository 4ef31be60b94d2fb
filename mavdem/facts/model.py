"""What is said of a model: why its physical parameters are doubted or missing, its limits, and the order of states."""

from enum import auto

from mavdem.facts.fact import Code, InWords


class Refinement(InWords):
    """A parameter of the gray-box model that some flights have, where it predicts unseen windows better."""

    JUMPS = auto()
    THRUST_CURVE = auto()


class ParameterDoubt(Code):
    """Why a physical parameter is biased or not identifiable, or where it is known from otherwise."""

    WIND_SHARE_HIGH = auto()
    COMMANDS_TOO_FAST = auto()
    ESTIMATE_UNCERTAIN = auto()
    DEPENDS_ON_WIND_SPECTRUM = auto()
    FILTER_TAKEN_FOR_LAG = auto()
    LAG_TOO_SHORT = auto()
    FOLLOWS_FROM_EFFECT = auto()
    KNOWN_FROM_EARLIER_FLIGHT = auto()
    SEVERAL_DOUBTS = auto()


class NoPhysical(Code):
    """Why there are no physical parameters, no simulation by them, or no wind torque."""

    SAMPLED_TOO_SLOWLY = auto()
    MOTORS_STILL = auto()
    NO_RATE = auto()
    TOO_FEW_SAMPLES_WITHOUT_GAPS = auto()
    NO_STEADY_FILTER = auto()
    EFFECT_NOT_IDENTIFIABLE = auto()
    SIMULATION_FAR_OFF = auto()
    NO_SIMULATION_BAND = auto()
    WIND_TORQUE_NOT_RESOLVED = auto()


class ModelCaution(Code):
    """Limits of a learned model, and of the inputs that it was learned from."""

    MODEL_GROWS = auto()
    NO_SIMULATION_FIT = auto()
    RECORDED = auto()


class ModelRefusal(Code):
    """Why a flight can be fitted by no model."""

    TOO_FEW_TO_LEARN = auto()
    CHANNEL_CONSTANT = auto()
    TOO_SHORT_FOR_WINDOW = auto()
    FIT_BREAKS_DOWN = auto()
    SEGMENTS_TOO_SHORT_FOR_LAGS = auto()
    TOO_FEW_TO_CHOOSE_ORDER = auto()
    NO_ORDER_FITTED = auto()


class OrderFact(Code):
    """Why the free energy chooses an order, and why orders are missing."""

    ORDER_CHOSEN = auto()
    ORDER_BROKE_DOWN = auto()
    ORDERS_NOT_FITTED = auto()


class ModelFile(Code):
    """Why the document of a model cannot be opened."""

    OF_LATER_VERSION = auto()
    NO_MODEL_DOCUMENT = auto()


class Workers(Code):
    """Why processes that share the work of many fits ended, or cannot begin."""

    WORKER_DIED = auto()
    SCRIPT_IMPORTED_BY_WORKER = auto()


class Plant(Code):
    """Why a model has no plant for other programs."""

    NO_PLANT = auto()
    TOO_MANY_OUTPUTS = auto()
