"""How sure an estimate is: the one vocabulary of physical parameters, wind, drag and their tables."""

from enum import StrEnum


class Status(StrEnum):
    """Whether an estimate is reported: with its interval, though biased, or not at all."""

    REPORTED = "reported"
    BIASED = "biased"
    NOT_IDENTIFIABLE = "not identifiable"
