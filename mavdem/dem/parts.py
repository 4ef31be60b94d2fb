"""Calculations in parts, for who cannot wait for the whole: generators that pause, and in the end return their answer.

A part takes about a millisecond.
"""

from __future__ import annotations

from collections.abc import Generator
from typing import TypeVar

Answer = TypeVar("Answer")
Parts = Generator[None, None, Answer]


def at_once(parts: Parts[Answer]) -> Answer:
    """Goes through all parts, and answers what they come to."""
    while True:
        try:
            next(parts)
        except StopIteration as end:
            answer: Answer = end.value
            return answer
