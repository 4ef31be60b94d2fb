"""Checks of the paper's claims: conditions with their findings, and the result of an experiment that decides a claim.

The rules of the checks are fixed before the numbers are known.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import NamedTuple

from mavdem.arrays import Array
from mavdem.containers import JsonValues, Names
from mavdem.report.blocks import Block
from mavdem.report.figures.style import Picture


class ClaimStatus(StrEnum):
    """How much of a claim is reproduced."""

    REPRODUCED = "reproduced"
    PARTLY = "partly"
    NOT_REPRODUCED = "not reproduced"
    NOT_TRIED = "not tried"


class Check(NamedTuple):
    """One condition for a claim, and whether it holds; the names of the fields are keys of documents."""

    rule: str
    """The condition, as a clause that begins in lower case."""

    holds: bool
    """Whether the condition holds."""

    finding: str
    """What the experiment measured, with its numbers, as a clause."""


@dataclass(frozen=True)
class ExperimentResult:
    """The result of the experiment on one claim."""

    checks: tuple[Check, ...] = ()
    """Checks that decide the claim's status; empty if the experiment could not run, for a reason in ``remarks``."""

    numbers: JsonValues = field(default_factory=dict)
    """Plain JSON values by name, for ``numbers.json``."""

    tables: tuple[Block, ...] = ()
    """Tables for the page, each after the sentence that introduces it."""

    pictures: tuple[Picture, ...] = ()
    """Figures for the page."""

    remarks: Names = ()
    """Sentences on how the experiment ran, in addition to the remarks of the claim."""


def claim_status(checks: Sequence[Check]) -> ClaimStatus:
    """Returns how much of a claim of the paper is reproduced, by the number of its checks that hold.

    Args:
        checks: checks of the claim, each of which holds or not.

    Returns:
        REPRODUCED if all checks hold, PARTLY if some do, NOT_REPRODUCED if none does, and NOT_TRIED without checks.
    """
    if not checks:
        return ClaimStatus.NOT_TRIED
    if all(check.holds for check in checks):
        return ClaimStatus.REPRODUCED
    if any(check.holds for check in checks):
        return ClaimStatus.PARTLY
    return ClaimStatus.NOT_REPRODUCED


def joined_findings(checks: Sequence[Check]) -> str:
    """Joins the findings of checks into one clause.

    Args:
        checks: checks with their findings.

    Returns:
        The findings of checks that fail, then, after "but", the findings of checks that hold.
    """
    failing_findings = [check.finding for check in checks if not check.holds]
    holding_findings = [check.finding for check in checks if check.holds]
    clauses = []
    for findings in (failing_findings, holding_findings):
        if findings:
            clauses.append("; ".join(findings))
    return "; but ".join(clauses)


def percent(share: float) -> str:
    """Returns a share between 0 and 1 as text such as ``90 %``, with three digits at most."""
    return f"{100 * share:.3g} %"


def lists_by_name(errors: dict[str, Array]) -> dict[str, list[float]]:
    """Returns arrays by name as lists by name, which JSON can hold."""
    return {name: values.tolist() for name, values in errors.items()}
