"""How sure an estimate is: the one vocabulary of physical parameters, wind, drag and their tables."""

from enum import auto

from mavdem.facts.fact import InWords


class Status(InWords):
    """Whether an estimate is reported: with its interval, though biased, or not at all."""

    REPORTED = auto()
    BIASED = auto()
    NOT_IDENTIFIABLE = auto()
