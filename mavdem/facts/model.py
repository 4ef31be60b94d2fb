"""Facts about a model: why its physical parameters are doubted or missing, its limits, and the order of states."""

from enum import StrEnum

from mavdem.facts.fact import Code


class ModelName(StrEnum):
    """A model of mavdem, as documents, pages and dashboards name it next to its results."""

    DEM = "DEM"
    """The linear state-space model that dynamic expectation maximization learns: A, B and C, its free energy and its
    process noise."""

    JOINT_VAR = "joint VAR"
    """The Bayesian vector autoregression of motors and motion together: forecasts, predictions and their bands."""

    GRAY_BOX = "gray-box"
    """The vehicle's axis with its physical parameters and the wind torque, by recorded motors."""

    CLOSED_LOOP = "closed loop"
    """The same axis in its loop with the controller, by recorded setpoints and gains: parameters and margins."""

    WIND = "wind"
    """The vehicle with its drag in moving air: velocity and direction of the wind."""


class Refinement(StrEnum):
    """A parameter of the gray-box model that some flights have, where it predicts unseen windows better."""

    JUMPS = "jumps"
    THRUST_CURVE = "thrust curve"


class ParameterDoubt(Code):
    """Why a physical parameter is biased or not identifiable, or where it is known from otherwise."""

    WIND_SHARE_HIGH = "wind_share_high"
    INPUTS_TOO_SLOW = "inputs_too_slow"
    COMMANDS_TOO_FAST = "commands_too_fast"
    ESTIMATE_UNCERTAIN = "estimate_uncertain"
    DEPENDS_ON_WIND_SPECTRUM = "depends_on_wind_spectrum"
    FILTER_TAKEN_FOR_LAG = "filter_taken_for_lag"
    MOTORS_DIFFER = "motors_differ"
    MOTOR_CHANGED = "motor_changed"
    LAG_TOO_SHORT = "lag_too_short"
    MIXED_WITH_DELAY = "mixed_with_delay"
    FOLLOWS_FROM_EFFECT = "follows_from_effect"
    LOOP_RINGS = "loop_rings"
    KNOWN_FROM_EARLIER_FLIGHT = "known_from_earlier_flight"
    SEVERAL_DOUBTS = "several_doubts"


class NoPhysical(Code):
    """Why there are no physical parameters, no simulation by them, or no wind torque."""

    SAMPLED_TOO_SLOWLY = "sampled_too_slowly"
    MOTORS_STILL = "motors_still"
    NO_RATE = "no_rate"
    TOO_FEW_SAMPLES_WITHOUT_GAPS = "too_few_samples_without_gaps"
    NO_LIKELIHOOD = "no_likelihood"
    EFFECT_NOT_IDENTIFIABLE = "effect_not_identifiable"
    SIMULATION_FAR_OFF = "simulation_far_off"
    NO_SIMULATION_BAND = "no_simulation_band"
    WIND_TORQUE_NOT_RESOLVED = "wind_torque_not_resolved"
    MOTOR_WEAK_THROUGHOUT = "motor_weak_throughout"
    WIND_TORQUE_TOO_SHORT = "wind_torque_too_short"


class ModelCaution(Code):
    """Limits of a learned model, and of the inputs that it was learned from."""

    MODEL_GROWS = "model_grows"
    NO_SIMULATION_FIT = "no_simulation_fit"
    RECORDED = "recorded"


class ModelRefusal(Code):
    """Why a flight can be fitted by no model."""

    TOO_FEW_TO_LEARN = "too_few_to_learn"
    CHANNEL_CONSTANT = "channel_constant"
    TOO_SHORT_FOR_WINDOW = "too_short_for_window"
    FIT_BREAKS_DOWN = "fit_breaks_down"
    SEGMENTS_TOO_SHORT_FOR_LAGS = "segments_too_short_for_lags"
    TOO_FEW_TO_CHOOSE_ORDER = "too_few_to_choose_order"
    NO_ORDER_FITTED = "no_order_fitted"


class OrderFact(Code):
    """Why the free energy chooses an order, and why orders are missing."""

    ORDER_CHOSEN = "order_chosen"
    ORDER_BROKE_DOWN = "order_broke_down"
    ORDERS_NOT_FITTED = "orders_not_fitted"


class ModelFile(Code):
    """Why the document of a model cannot be opened."""

    OF_LATER_VERSION = "of_later_version"
    NO_MODEL_DOCUMENT = "no_model_document"


class WorkerFact(Code):
    """Why processes that share the work of many fits ended, or cannot begin."""

    WORKER_DIED = "worker_died"
    SCRIPT_IMPORTED_BY_WORKER = "script_imported_by_worker"


class NoPlant(Code):
    """Why a model has no plant for other programs."""

    NO_PLANT = "no_plant"
    TOO_MANY_OUTPUTS = "too_many_outputs"
