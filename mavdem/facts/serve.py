"""Codes of the server: why a request is refused, and how far a log is."""

from enum import StrEnum, auto

from mavdem.facts.fact import Code


class Request(Code):
    """Why a request to the server is refused."""

    NO_RIGHT = auto()
    OTHER_SITE = auto()
    NO_SUCH_FLIGHT = auto()
    UPLOAD_WITHOUT_LOG = auto()
    UPLOAD_TOO_LARGE = auto()
    UPLOAD_TOO_SLOW = auto()
    UPLOAD_BROKEN = auto()
    UPLOADS_TOO_MANY = auto()
    DISK_FULL = auto()
    QUOTA_REACHED = auto()
    BAD_REQUEST = auto()
    NOT_STARTED = auto()
    SESSION_FAILED = auto()
    ANSWER_FAILED = auto()


class Start(Code):
    """Why the server does not start."""

    TOKEN_NEEDED = auto()
    TOKEN_TOO_SHORT = auto()
    ADDRESS_NOT_FREE = auto()
    FOLDER_NOT_WRITABLE = auto()


class Stage(StrEnum):
    """How far a log is."""

    WAITING = auto()
    READING = auto()
    JUDGING = auto()
    LEARNING = auto()
    DRAWING = auto()
    DONE = auto()
    FAILED = auto()


class Sharing(StrEnum):
    """Who sees a flight: its owner; whoever has its link; or everybody, and it is listed."""

    PRIVATE = auto()
    LINK = auto()
    PUBLIC = auto()


class Use(StrEnum):
    """What one needs a right for."""

    READ = auto()
    UPLOAD = auto()
    WRITE = auto()
    DOWNLOAD = auto()


class Crowd(StrEnum):
    """Of what there are too many."""

    UPLOADS = auto()
    LOGS = auto()
    WATCHERS = auto()
