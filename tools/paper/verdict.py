"""Verdict: whether a claim of the paper is reproduced, by checks whose rules are stated before the numbers are there.

All checks hold: reproduced. None does: not. Otherwise partly. What fails is said first.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from typing import NamedTuple


class Verdict(StrEnum):
    """How much of a claim is reproduced."""

    REPRODUCED = "reproduced"
    PARTLY = "partly"
    NOT = "not reproduced"
    UNTRIED = "not tried"


class Check(NamedTuple):
    """One thing that must hold for a claim to be reproduced.

    Attributes:
        rule: what is asked, in words that say when it holds.
        holds: whether it does.
        finding: what was found, a clause with its numbers, true whether the check holds or not.
    """

    rule: str
    holds: bool
    finding: str


def verdict(checks: Sequence[Check]) -> Verdict:
    """What checks come to; of none nothing was tried."""
    if not checks:
        return Verdict.UNTRIED
    held = [check.holds for check in checks]
    return Verdict.REPRODUCED if all(held) else Verdict.PARTLY if any(held) else Verdict.NOT


def sentence(checks: Sequence[Check]) -> str:
    """The verdict and why, in one sentence."""
    return f"{verdict(checks).value.capitalize()}: {found(checks)}."


def found(checks: Sequence[Check]) -> str:
    """What was found: what fails, then what holds."""
    told = [check.finding for check in checks if not check.holds], [check.finding for check in checks if check.holds]
    return "; but ".join("; ".join(findings) for findings in told if findings)
