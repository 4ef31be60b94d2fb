"""Statements of witnesses: facts that speak for an event or against it."""

from collections.abc import Iterable
from typing import Any

from mavdem.facts import Fact, Facts
from mavdem.facts.witnesses import Side, Witness


def for_it(code: Witness, **figures: Any) -> Fact:
    """Returns the statement of a witness that supports an event, with its ``figures``, subject and time."""
    return Fact(code, side=Side.FOR, **figures)


def against(code: Witness, **figures: Any) -> Fact:
    """Returns the statement of a witness that contradicts an event, with its ``figures``, subject and time."""
    return Fact(code, side=Side.AGAINST, **figures)


def supporting(witnesses: Iterable[Fact]) -> Facts:
    """Returns the witnesses that support the event."""
    return tuple(fact for fact in witnesses if fact.figures["side"] == Side.FOR)


def contradicting(witnesses: Iterable[Fact]) -> Facts:
    """Returns the witnesses that contradict the event."""
    return tuple(fact for fact in witnesses if fact.figures["side"] == Side.AGAINST)
