"""The two errors whose cause is the data, not the caller."""

from __future__ import annotations


class Unreadable(ValueError):
    """A source that cannot be opened or holds nothing that can be read; the message is one sentence for the user."""


class NotLearnable(ValueError):
    """Data that cannot support the request: fitting them would give numbers that mean nothing.

    Attributes:
        reason: one sentence: what is missing, with the figures.
        remedy: what to change, a command where there is one; may be empty.
    """

    def __init__(self, reason: str, remedy: str = "") -> None:
        super().__init__(f"{reason} {remedy}".strip())
        self.reason = reason
        self.remedy = remedy
