"""Resumable calculations: generators that pause about every millisecond, and return their result at the end.

A live session advances one part at each sample, so that an update stays short without a second process.
"""

from __future__ import annotations

from collections.abc import Generator
from typing import TypeVar

Result = TypeVar("Result")
Resumable = Generator[None, None, Result]


def run_to_end(resumable: Resumable[Result]) -> Result:
    """Runs all parts; returns the result."""
    while True:
        try:
            next(resumable)
        except StopIteration as end:
            result: Result = end.value
            return result
