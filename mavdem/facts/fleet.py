"""What is found of many logs: why one has no flight, what keeps a fleet from being made, what cannot be compared."""

from __future__ import annotations

from enum import auto

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
    SCHEDULER_GONE = auto()
    NO_CLUSTER_WORKERS = auto()
    CLUSTER_WORKERS_DIED = auto()
    CLUSTER_CANNOT_READ = auto()
    CLUSTER_WITHOUT_MAVDEM = auto()
    CLUSTER_OF_OTHER_VERSION = auto()
    CLUSTER_WITHOUT_LOG = auto()


class Folder(Code):
    """What is wrong with the names of logs, or with a fleet's folder."""

    NO_LOG_NAMED = auto()
    PATH_MISSING = auto()
    FOLDER_UNREADABLE = auto()
    URL_UNREADABLE = auto()
    NO_FLEET = auto()
    FLEET_DAMAGED = auto()
    FLEET_OF_OTHERS = auto()
    FLEET_ON_NETWORK = auto()
    FLEET_NOT_WRITTEN = auto()
    BASELINE_UNKNOWN = auto()
    BASELINE_WITHOUT_FLIGHT = auto()
