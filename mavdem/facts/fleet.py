"""Facts about many logs: why one has no flight, what keeps a fleet from being made, what cannot be compared."""

from enum import StrEnum

from mavdem.facts.fact import Code


class ReadingFact(Code):
    """Why a log was not read, or none could be."""

    READING_TOO_LONG = "reading_too_long"
    READING_TOO_LARGE = "reading_too_large"
    READER_DIED = "reader_died"
    READING_FAILED = "reading_failed"
    LOG_UNREACHABLE = "log_unreachable"
    FIELDS_TOO_MANY = "fields_too_many"
    COLUMNS_TOO_LARGE = "columns_too_large"
    RECORDINGS_NOT_WRITTEN = "recordings_not_written"
    LOG_KEPT = "log_kept"
    NO_PLAIN_FILE = "no_plain_file"
    NO_VEHICLE = "no_vehicle"
    READERS_NOT_STARTED = "readers_not_started"
    NO_ADDRESS = "no_address"
    NO_SCHEDULER = "no_scheduler"
    NO_CLUSTER_WORKERS = "no_cluster_workers"
    CLUSTER_WORKERS_DIED = "cluster_workers_died"
    CLUSTER_CANNOT_READ = "cluster_cannot_read"
    CLUSTER_OF_OTHER_VERSION = "cluster_of_other_version"


class FleetFolderFact(Code):
    """What is wrong with the names of logs, or with a fleet's folder."""

    NO_LOG_NAMED = "no_log_named"
    URL_UNREADABLE = "url_unreadable"
    NO_FLEET = "no_fleet"
    FLEET_DAMAGED = "fleet_damaged"
    FLEET_NOT_READ = "fleet_not_read"
    FLEET_NOT_WRITTEN = "fleet_not_written"
    BASELINE_UNKNOWN = "baseline_unknown"
    BASELINE_WITHOUT_FLIGHT = "baseline_without_flight"
    BASELINE_MOTORS_BAD = "baseline_motors_bad"


class NoPrior(Code):
    """Why an earlier flight says nothing of the next."""

    MODEL_UNREADABLE = "model_unreadable"
    MODEL_OF_OTHER_AXIS = "model_of_other_axis"
    MODEL_WITHOUT_EFFECT = "model_without_effect"
    DRAG_UNREADABLE = "drag_unreadable"
    DRAG_OF_THIS_FLIGHT = "drag_of_this_flight"


class QuantityOutcome(StrEnum):
    """What becomes of a quantity that is compared; uncertain where neither changed nor the same can be said."""

    CHANGED = "changed"
    SAME = "same"
    UNCERTAIN = "uncertain"


class ComparedSubject(Code):
    """What would be compared between two states of a vehicle."""

    EVERYTHING = "everything"
    OF_MODELS = "of_models"
    QUANTITY = "quantity"


class Incomparable(Code):
    """Why something cannot be compared; the subject is A or B."""

    NO_FLIGHT = "no_flight"
    OTHER_VEHICLES = "other_vehicles"
    OTHER_UNITS = "other_units"
    OTHER_INPUTS = "other_inputs"
    NOT_IN_BOTH = "not_in_both"
    NOT_REPORTED = "not_reported"
    NOT_ESTIMATED = "not_estimated"
    FAILED_MOTOR = "failed_motor"
    NO_COMMON_VEHICLE = "no_common_vehicle"
    VEHICLES_UNKNOWN = "vehicles_unknown"
    VEHICLE_MISSING = "vehicle_missing"
