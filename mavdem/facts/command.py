"""Codes of the command line: what it cannot read or write, and how a run ended."""

from enum import auto

from mavdem.facts.fact import Code


class Place(Code):
    """Why a file or folder cannot be written."""

    OUT_IS_A_FILE = auto()
    OUT_NOT_WRITABLE = auto()
    OUT_FAILED = auto()
    FILE_FAILED = auto()


class Source(Code):
    """Why what was named cannot be used."""

    STANDARD_INPUT_IS_NO_LOG = auto()
    LINK_IS_NO_LOG = auto()
    AS_MANY_INPUTS_NEEDED = auto()
    NO_ORDER_OF_FLIGHT = auto()


class End(Code):
    """Why a run ended early."""

    BAD_USAGE = auto()
    STANDARD_OUTPUT_FAILED = auto()
    INTERRUPTED = auto()
    OUT_OF_MEMORY = auto()
    DEFECT = auto()
