"""How sure an estimate is: the one vocabulary of physical parameters, wind, drag and their tables."""

from __future__ import annotations

from enum import StrEnum, auto


class Status(StrEnum):
    """Whether an estimate is reported: with its interval, though biased, or not at all; values as documents hold."""

    @staticmethod
    def _generate_next_value_(name: str, start: int, count: int, last_values: list[str]) -> str:
        return name.lower().replace("_", " ")

    REPORTED = auto()
    BIASED = auto()
    NOT_IDENTIFIABLE = auto()
