"""Codes of what is read: why a source is refused, and what was odd or damaged in it and what was done about it."""

from enum import StrEnum, auto

from mavdem.facts.fact import Code


class Source(Code):
    """Why a file cannot be read or has nothing that can be used; how motors are known."""

    FOLDER_GIVEN = auto()
    SPECIAL_FILE = auto()
    FILE_MISSING = auto()
    FILE_NOT_OPENED = auto()
    FILE_TOO_LARGE = auto()
    FILE_EMPTY = auto()
    ARCHIVE_DAMAGED = auto()
    FORMAT_UNKNOWN = auto()
    NO_PARAMETERS_IN_FILE = auto()
    FORMAT_WITHOUT_FRAMES = auto()
    GIT_LFS_POINTER = auto()
    DIALECT_UNKNOWN = auto()
    DATAFLASH_WITHOUT_MESSAGES = auto()
    DATAFLASH_WITHOUT_FLIGHT = auto()
    ULOG_OF_LATER_FORMAT = auto()
    ULOG_WITHOUT_FLIGHT = auto()
    MCAP_OF_ROS2 = auto()
    MCAP_OF_MAVDEM = auto()
    MCAP_DAMAGED = auto()
    MCAP_WITHOUT_FLIGHT = auto()
    ROS2_DAMAGED = auto()
    MOTOR_BASIS = auto()


class Repair(Code):
    """What was odd or damaged in a source, and what was done about it."""

    FRAMES_LEFT_OUT = auto()
    PARAMETERS_ADDED = auto()
    BYTES_SKIPPED = auto()
    CARRIAGE_RETURNS_UNDONE = auto()
    STAMPS_IGNORED = auto()
    CLOCK_WRAPPED = auto()
    LOG_OF_SEVERAL_BOOTS = auto()
    CLOCK_MOVED = auto()
    UNIX_TIME_MOVED = auto()
    SYSTEM_NUMBERED = auto()
    DEFINITION_CONTRADICTED = auto()
    LOGGED_MESSAGES_LEFT_OUT = auto()
    LINES_LEFT_OUT = auto()
    LOGGER_WITHOUT_ROOM = auto()
    LOGGER_DROPPED_OUT = auto()
    CENTIDEGREES_CONVERTED = auto()
    DEMANDS_SCALED = auto()
    ATTITUDE_INTERPOLATED = auto()
    ULOG_DAMAGED = auto()
    CHUNKS_DAMAGED = auto()
    RECORDING_CUT = auto()
    JSON_OF_NO_DIALECT = auto()
    TOPICS_NOT_READ = auto()


class Flaw(StrEnum):
    """Why frames or messages were left out."""

    DAMAGE = auto()
    ANOTHER_DIALECT = auto()
    UNDECODABLE = auto()
    FAR_STAMP = auto()
    IMPOSSIBLE_STAMP = auto()
    NO_STAMP = auto()


class Package(Code):
    """What the installation lacks."""

    EXTRA_MISSING = auto()


class Arrays(Code):
    """What is wrong with arrays that a flight is made of."""

    UNIT_SLIP = auto()


class Slip(StrEnum):
    """What seems to be in another unit than rad, rad/s and s."""

    ANGLE_IN_DEGREES = auto()
    RATE_IN_DEGREES = auto()
    BOTH_IN_DEGREES = auto()
    TIME_IN_MILLISECONDS = auto()
    TIME_IN_MICROSECONDS = auto()
