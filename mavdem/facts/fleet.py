"""What is found of many logs: why one has no flight, what keeps a fleet from being made, what cannot be compared."""

from enum import StrEnum, auto

from mavdem.facts.fact import Code


class Reading(Code):
    """Why a log was not read, or none could be."""

    READING_TOO_LONG = auto()
    READING_TOO_LARGE = auto()
    READER_DIED = auto()
    READING_FAILED = auto()
    LOG_UNREACHABLE = auto()
    LOG_KEPT = auto()
    NO_PLAIN_FILE = auto()
    NO_VEHICLE = auto()
    READERS_NOT_STARTED = auto()
    NO_ADDRESS = auto()
    NO_SCHEDULER = auto()
    NO_CLUSTER_WORKERS = auto()
    CLUSTER_WORKERS_DIED = auto()
    CLUSTER_CANNOT_READ = auto()
    CLUSTER_OF_OTHER_VERSION = auto()


class Folder(Code):
    """What is wrong with the names of logs, or with a fleet's folder."""

    NO_LOG_NAMED = auto()
    URL_UNREADABLE = auto()
    NO_FLEET = auto()
    FLEET_DAMAGED = auto()
    FLEET_NOT_WRITTEN = auto()
    BASELINE_UNKNOWN = auto()
    BASELINE_WITHOUT_FLIGHT = auto()


class Prior(Code):
    """Why an earlier flight says nothing of the next."""

    MODEL_UNREADABLE = auto()
    MODEL_OF_OTHER_AXIS = auto()
    MODEL_WITHOUT_EFFECT = auto()
    DRAG_UNREADABLE = auto()
    DRAG_OF_THIS_FLIGHT = auto()


class Outcome(StrEnum):
    """What becomes of a quantity that is compared; uncertain where neither changed nor the same can be said."""

    CHANGED = "changed"
    SAME = "same"
    UNCERTAIN = "uncertain"


class Compared(Code):
    """What would be compared between two states of a vehicle."""

    EVERYTHING = auto()
    OF_MODELS = auto()
    QUANTITY = auto()


class Incomparable(Code):
    """Why something cannot be compared; the subject is A or B."""

    NO_FLIGHT = auto()
    OTHER_VEHICLES = auto()
    OTHER_UNITS = auto()
    OTHER_INPUTS = auto()
    NOT_IN_BOTH = auto()
    NOT_REPORTED = auto()
    NOT_ESTIMATED = auto()
    NO_COMMON_VEHICLE = auto()
    VEHICLES_UNKNOWN = auto()
    VEHICLE_MISSING = auto()
