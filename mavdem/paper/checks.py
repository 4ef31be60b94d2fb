"""Whether a claim of the paper is reproduced, by checks whose rules are fixed before the numbers are known.

All checks hold: reproduced. None holds: not reproduced. Otherwise: partly. Failed checks come first.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from typing import NamedTuple


class ClaimStatus(StrEnum):
    """How much of a claim is reproduced."""

    REPRODUCED = "reproduced"
    PARTLY = "partly"
    NOT = "not reproduced"
    UNTRIED = "not tried"


class Check(NamedTuple):
    """One condition for a claim; ``rule`` and ``finding`` (the result with its numbers) are clauses."""

    rule: str
    holds: bool
    finding: str


def claim_status(checks: Sequence[Check]) -> ClaimStatus:
    """The status that follows from the checks; without checks, not tried."""
    if not checks:
        return ClaimStatus.UNTRIED
    held = [check.holds for check in checks]
    return ClaimStatus.REPRODUCED if all(held) else ClaimStatus.PARTLY if any(held) else ClaimStatus.NOT


def sentence(checks: Sequence[Check]) -> str:
    """The status and the findings, in one sentence."""
    return f"{claim_status(checks).value.capitalize()}: {findings(checks)}."


def findings(checks: Sequence[Check]) -> str:
    """The findings of the checks that fail, then of those that hold."""
    parts = [check.finding for check in checks if not check.holds], [check.finding for check in checks if check.holds]
    return "; but ".join("; ".join(part) for part in parts if part)
