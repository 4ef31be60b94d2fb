"""Facts about the setpoints of position and velocity, and the pilot's sticks."""

from enum import StrEnum

from mavdem.facts.fact import Code


class CommandPart(StrEnum):
    """What commands the vehicle."""

    TARGETS = "position and velocity"
    STICKS = "sticks and switches"


class CommandFact(Code):
    """What was commanded, and how it was followed."""

    TARGETS_FOLLOWED = "targets_followed"
    STICKS_MOVED = "sticks_moved"
