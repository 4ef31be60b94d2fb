"""A drawing of what changed between two states of a vehicle: each quantity's change with its interval (a forest plot).

Quantities have different units. So each change is drawn relative to the largest one that is called the same, its
equivalence limit: within ±1 nothing of note changed.
"""

from collections.abc import Collection
from typing import NamedTuple

from mavdem.facts.fleet import QuantityOutcome
from mavdem.fleet.difference import VehicleDifference
from mavdem.fleet.random_effects import EQUIVALENCE_LIMITS, QuantityChange
from mavdem.report.charts.chart import Plan
from mavdem.report.charts.plans import figure_as_svg
from mavdem.report.difference.quantity_texts import change_text, equivalence_limit_text
from mavdem.report.numbers import listed
from mavdem.report.templates import capitalize_first

OUTCOME_LEVELS = {
    QuantityOutcome.CHANGED: "bad",
    QuantityOutcome.UNCERTAIN: "unknown",
    QuantityOutcome.SAME: "good",
}
"""Class by which each outcome is coloured, in the order in which changes are listed."""

EVIDENCE_LEVEL = "watch"
"""Class of a change that is uncertain alone and agrees with the motor that the headline names."""

EVIDENCE_REMARK = "agrees with the weak motor"
"""What stands below such a change in the drawing."""

MAX_RELATIVE_CHANGE = 4.0
"""Largest change that has room in the drawing, in equivalence limits; a larger one ends at its edge. A choice."""

CENTER_PERCENT = 50.0
"""Position of no change, % of the width of the drawing."""

MARGIN_PERCENT = 3.0
"""Room at both sides of the drawing, % of its width."""


class DrawnChange(NamedTuple):
    """A change as it is drawn; positions are % of the width."""

    text: str
    """Quantity, change and interval in words."""
    level: str
    """Class that colours it."""
    low: float
    """Position of the lower end of the interval."""
    middle: float
    """Position of the estimate."""
    high: float
    """Position of the upper end of the interval."""
    limit: str
    """Largest difference that is called the same, with its unit."""
    beyond: int
    """1 or -1 where the estimate lies to the right or to the left of the drawing, which an arrow shows; 0 inside."""
    remark: str = ""
    """What the change is besides its own outcome; empty for most."""


def drawn_changes(difference: VehicleDifference) -> list[QuantityChange]:
    """Selects the quantities that the drawing of changes shows, and sorts them.

    Quantities that stayed the same are left out, unless all did.

    Args:
        difference: changes of a vehicle between two states, quantity by quantity.

    Returns:
        First the quantities that changed, then the uncertain ones. In each group, changes whose interval excludes "no
        change" come first.
    """
    outcomes_in_order = list(OUTCOME_LEVELS)

    def sort_key(change: QuantityChange) -> tuple[int, bool]:
        """Returns the position of the outcome, and whether "no change" is possible."""
        return outcomes_in_order.index(change.outcome), change.interval_contains_zero

    changes = []
    for change in difference.changes:
        if change.outcome is not QuantityOutcome.SAME:
            changes.append(change)
    if not changes:
        changes = list(difference.changes)
    return sorted(changes, key=sort_key)


def change_plan(
    difference: VehicleDifference, evidence: Collection[QuantityChange] = ()
) -> Plan | None:
    """Draws how much each quantity changed, with its 90 % interval, as a forest plot with a row for each quantity.

    Changes are drawn relative to the equivalence limit of their quantity, below which a change does not matter.

    Args:
        difference: changes of a vehicle between two states, quantity by quantity.
        evidence: changes that agree with a weak motor, which a light of one side names.

    Returns:
        The drawing of :func:`drawn_changes`; None if nothing was compared.
    """
    changes = drawn_changes(difference)
    if not changes:
        return None
    relative_changes = [_relative_change(change) for change in changes]
    # The axis reaches to the farthest end of an interval, and at least to the equivalence limit, which is 1.
    extent = 1.0
    for relative in relative_changes:
        extent = max(extent, abs(relative.low), abs(relative.high))
    extent = min(extent, MAX_RELATIVE_CHANGE)
    percent_per_limit = (CENTER_PERCENT - MARGIN_PERCENT) / extent

    def position(value: float) -> float:
        """Returns where a relative change is drawn, percent of the width from the left."""
        return min(max(CENTER_PERCENT + percent_per_limit * value, 0.0), 100.0)

    rows = []
    for change, relative in zip(changes, relative_changes, strict=True):
        # An arrow at the right (1) or left edge (-1) stands for a change beyond it.
        beyond = 0
        if relative.difference > extent:
            beyond = 1
        elif relative.difference < -extent:
            beyond = -1
        level = OUTCOME_LEVELS[change.outcome]
        remark = ""
        if is_uncertain_evidence(change, evidence):
            level = EVIDENCE_LEVEL
            remark = EVIDENCE_REMARK
        rows.append(
            DrawnChange(
                capitalize_first(change_text(change, difference)),
                level=level,
                low=position(relative.low),
                middle=position(relative.difference),
                high=position(relative.high),
                limit=equivalence_limit_text(change.quantity.kind),
                beyond=beyond,
                remark=remark,
            )
        )
    svg = figure_as_svg("changes", rows=rows, limit=percent_per_limit)
    texts = listed(row.text for row in rows)
    return Plan("", f"Changes with their 90 % intervals: {texts}", svg)


def is_uncertain_evidence(change: QuantityChange, evidence: Collection[QuantityChange]) -> bool:
    """Returns whether a change is drawn as evidence of a weak motor although it is not certain by itself.

    Args:
        change: change of one quantity between two states of a vehicle.
        evidence: changes that agree with a weak motor, which the judgement of one of the states names.
    """
    return change in evidence and change.outcome is not QuantityOutcome.CHANGED


class _RelativeChange(NamedTuple):
    """A change of a quantity in units of its equivalence limit."""

    difference: float
    """The difference."""
    low: float
    """Lower end of its 90 % interval."""
    high: float
    """Upper end of its 90 % interval."""


def _relative_change(change: QuantityChange) -> _RelativeChange:
    """Returns a change in units of the equivalence limit of its quantity, so that all quantities share one axis.

    Args:
        change: change of one quantity with its interval. Below the equivalence limit, a change does not matter.
    """
    limit = EQUIVALENCE_LIMITS[change.quantity.kind]
    low, high = change.interval
    return _RelativeChange(change.difference / limit, low=low / limit, high=high / limit)
