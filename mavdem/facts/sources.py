"""Codes of what is read: why a source is refused, and what was odd or damaged in it and what was done about it."""

from enum import StrEnum

from mavdem.facts.fact import Code


class SourceFact(Code):
    """Why a file cannot be read or has nothing that can be used; how motors are known."""

    FOLDER_GIVEN = "folder_given"
    SPECIAL_FILE = "special_file"
    FILE_MISSING = "file_missing"
    WEB_ADDRESS = "web_address"
    FILE_NOT_OPENED = "file_not_opened"
    FILE_TOO_LARGE = "file_too_large"
    FILE_EMPTY = "file_empty"
    ARCHIVE_DAMAGED = "archive_damaged"
    ARCHIVE_WITHOUT_ONE_LOG = "archive_without_one_log"
    FORMAT_UNKNOWN = "format_unknown"
    NO_PARAMETERS_IN_FILE = "no_parameters_in_file"
    FORMAT_WITHOUT_FRAMES = "format_without_frames"
    GIT_LFS_POINTER = "git_lfs_pointer"
    DIALECT_UNKNOWN = "dialect_unknown"
    DATAFLASH_WITHOUT_MESSAGES = "dataflash_without_messages"
    DATAFLASH_WITHOUT_DEFINITIONS = "dataflash_without_definitions"
    DATAFLASH_WITHOUT_FLIGHT = "dataflash_without_flight"
    PX4_LOG_BEFORE_ULOG = "px4_log_before_ulog"
    ULOG_ENCRYPTED = "ulog_encrypted"
    ULOG_OF_LATER_FORMAT = "ulog_of_later_format"
    ULOG_WITHOUT_FLIGHT = "ulog_without_flight"
    MCAP_OF_ROS2 = "mcap_of_ros2"
    MCAP_OF_MAVDEM = "mcap_of_mavdem"
    MCAP_DAMAGED = "mcap_damaged"
    MCAP_WITHOUT_FLIGHT = "mcap_without_flight"
    ROS2_DAMAGED = "ros2_damaged"
    TWO_VEHICLES_ONE_ID = "two_vehicles_one_id"
    LOGS_NOT_JOINED = "logs_not_joined"
    NO_GEOGRAPHIC_POSITION = "no_geographic_position"
    MOTOR_BASIS = "motor_basis"


class Repair(Code):
    """What was odd or damaged in a source, and what was done about it."""

    FRAMES_LEFT_OUT = "frames_left_out"
    PARAMETERS_ADDED = "parameters_added"
    BYTES_SKIPPED = "bytes_skipped"
    COPIES_LEFT_OUT = "copies_left_out"
    CARRIAGE_RETURNS_UNDONE = "carriage_returns_undone"
    STAMPS_IGNORED = "stamps_ignored"
    CLOCK_WRAPPED = "clock_wrapped"
    LOG_OF_SEVERAL_BOOTS = "log_of_several_boots"
    CLOCK_MOVED = "clock_moved"
    CLOCK_SET = "clock_set"
    CLOCK_SET_BACK = "clock_set_back"
    UNIX_TIME_MOVED = "unix_time_moved"
    SYSTEM_NUMBERED = "system_numbered"
    DEFINITION_CONTRADICTED = "definition_contradicted"
    LOGGED_MESSAGES_LEFT_OUT = "logged_messages_left_out"
    OLD_BLOCKS_LEFT_OUT = "old_blocks_left_out"
    OTHER_CLOCK_LEFT_OUT = "other_clock_left_out"
    LINES_LEFT_OUT = "lines_left_out"
    LOGGER_WITHOUT_ROOM = "logger_without_room"
    LOGGER_DROPPED_OUT = "logger_dropped_out"
    CENTIDEGREES_CONVERTED = "centidegrees_converted"
    DEMANDS_SCALED = "demands_scaled"
    OTHER_CORE_READ = "other_core_read"
    ATTITUDE_INTERPOLATED = "attitude_interpolated"
    ULOG_DAMAGED = "ulog_damaged"
    CHUNKS_DAMAGED = "chunks_damaged"
    RECORDING_CUT = "recording_cut"
    JSON_OF_NO_DIALECT = "json_of_no_dialect"
    TOPICS_NOT_READ = "topics_not_read"
    LOGS_JOINED = "logs_joined"


class Flaw(StrEnum):
    """Why frames or messages were left out."""

    DAMAGE = "damage"
    ANOTHER_DIALECT = "another_dialect"
    UNDECODABLE = "undecodable"
    FAR_STAMP = "far_stamp"
    IMPOSSIBLE_STAMP = "impossible_stamp"
    NO_STAMP = "no_stamp"
    UNREADABLE_NUMBER = "unreadable_number"


class Separation(StrEnum):
    """Why several logs are not those of one flight."""

    NOT_ONE_VEHICLE = "not_one_vehicle"
    OTHER_SYSTEM = "other_system"
    OTHER_FORMAT = "other_format"
    OTHER_FIRMWARE = "other_firmware"
    OTHER_BOARD = "other_board"
    OTHER_PARAMETERS = "other_parameters"
    DISARMED = "disarmed"
    OTHER_TIME = "other_time"
    SAME_TIME = "same_time"
    TIME_UNKNOWN = "time_unknown"


class PackageFact(Code):
    """What the installation lacks."""

    EXTRA_MISSING = "extra_missing"


class ArrayFact(Code):
    """What is wrong with arrays that a flight is made of."""

    UNIT_SLIP = "unit_slip"


class UnitSlip(StrEnum):
    """What seems to be in another unit than rad, rad/s and s."""

    ANGLE_IN_DEGREES = "angle_in_degrees"
    RATE_IN_DEGREES = "rate_in_degrees"
    BOTH_IN_DEGREES = "both_in_degrees"
    TIME_IN_MILLISECONDS = "time_in_milliseconds"
    TIME_IN_MICROSECONDS = "time_in_microseconds"
