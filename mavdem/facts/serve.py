"""Codes of the server: why a request is refused, and how far a log is."""

from enum import StrEnum

from mavdem.facts.fact import Code


class RefusalReason(Code):
    """Why a request to the server is refused."""

    NO_RIGHT = "no_right"
    WRONG_TOKEN = "wrong_token"
    OTHER_SITE = "other_site"
    NO_SUCH_FLIGHT = "no_such_flight"
    NO_RECORDING = "no_recording"
    NO_SUCH_FILE = "no_such_file"
    NO_SUCH_PAGE = "no_such_page"
    NO_LINK = "no_link"
    UPLOAD_WITHOUT_LOG = "upload_without_log"
    UPLOAD_TOO_LARGE = "upload_too_large"
    UPLOAD_TOO_SLOW = "upload_too_slow"
    UPLOAD_BROKEN = "upload_broken"
    UPLOADS_TOO_MANY = "uploads_too_many"
    DISK_FULL = "disk_full"
    QUOTA_REACHED = "quota_reached"
    BAD_REQUEST = "bad_request"
    SEARCH_NOT_UNDERSTOOD = "search_not_understood"
    NOT_STARTED = "not_started"
    SESSION_FAILED = "session_failed"
    ANSWER_FAILED = "answer_failed"
    RESULTS_DAMAGED = "results_damaged"
    NO_SUCH_FIELD = "no_such_field"
    LOG_NOT_READ = "log_not_read"
    VEHICLE_IDENTIFIED = "vehicle_identified"
    MOTORS_BAD = "motors_bad"
    NOT_FOR_BASELINE = "not_for_baseline"
    STILL_BEING_READ = "still_being_read"


class StartFailure(Code):
    """Why the server does not start."""

    TOKEN_NEEDED = "token_needed"
    TOKEN_TOO_SHORT = "token_too_short"
    HOST_UNKNOWN = "host_unknown"
    ADDRESS_NOT_FREE = "address_not_free"
    FOLDER_NOT_WRITABLE = "folder_not_writable"


class BaselineCaution(Code):
    """What is doubtful about a baseline that was set."""

    MOTORS_WATCHED = "motors_watched"


class Stage(StrEnum):
    """How far a log is, or the making of its recordings: from waiting through learning to recording."""

    WAITING = "waiting"
    READING = "reading"
    JUDGING = "judging"
    LEARNING = "learning"
    DRAWING = "drawing"
    RECORDING = "recording"
    DONE = "done"
    FAILED = "failed"


class ListingOrder(StrEnum):
    """The order in which flights are listed; those of which the quantity is not known come last."""

    UPLOAD = "upload"
    """By the time of upload, the newest first."""
    FLIGHT = "flight"
    """By the date of the flight, the newest first."""
    TIME = "time"
    """By the flight time, the longest first."""
    DISTANCE = "distance"
    """By the distance flown, the longest first."""
    HEIGHT = "height"
    """By the largest height above the take-off, the highest first."""
    VEHICLE = "vehicle"
    """By the vehicle, the newest flight of each first."""
    URGENCY = "urgency"
    """By how urgently the flight needs a look, a crash first."""
    WIND = "wind"
    """By the mean speed of the wind, the strongest first."""


class Sharing(StrEnum):
    """Who sees a flight: its owner; whoever has its link; or everybody, and it is listed."""

    PRIVATE = "private"
    LINK = "link"
    PUBLIC = "public"


class Permission(StrEnum):
    """What one needs a right for."""

    READ = "read"
    UPLOAD = "upload"
    WRITE = "write"
    DOWNLOAD = "download"


class LimitedResource(StrEnum):
    """Of what there are too many."""

    UPLOADS = "uploads"
    LOGS = "logs"
    WATCHERS = "watchers"
    FIELDS = "fields"
