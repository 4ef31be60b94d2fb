"""A drawing of what changed between two states of a vehicle: each quantity's change with its interval (a forest plot).

Quantities have different units. So each change is drawn relative to the largest one that is called the same, its
equivalence limit: within ±1 nothing of note changed.
"""

from collections.abc import Collection
from enum import StrEnum
from math import floor
from typing import NamedTuple

from mavdem.facts.fleet import QuantityOutcome
from mavdem.fleet.difference import VehicleDifference
from mavdem.fleet.quantities import (
    ATTITUDE_GAIN_MARGIN,
    ATTITUDE_PHASE_MARGIN,
    EFFECT,
    GAIN_MARGIN,
    LAG,
    MAX_SENSITIVITY,
    OVERSHOOT,
    PHASE_MARGIN,
    SHARE,
)
from mavdem.fleet.random_effects import EQUIVALENCE_LIMITS, QuantityChange
from mavdem.report.charts.chart import Plan
from mavdem.report.charts.plans import figure_as_svg
from mavdem.report.difference.quantity_texts import (
    change_text,
    change_without_lean,
    scale_text,
)
from mavdem.report.numbers import listed
from mavdem.report.templates import capitalize_first

OUTCOMES_IN_ORDER = (QuantityOutcome.CHANGED, QuantityOutcome.UNCERTAIN, QuantityOutcome.SAME)
"""Order in which changes are listed."""

KINDS_WORSE_IF_LARGER = (SHARE, LAG, MAX_SENSITIVITY, OVERSHOOT)
"""Kinds of quantities of which an increase is for the worse."""

KINDS_WORSE_IF_SMALLER = (
    EFFECT,
    PHASE_MARGIN,
    GAIN_MARGIN,
    ATTITUDE_PHASE_MARGIN,
    ATTITUDE_GAIN_MARGIN,
)
"""Kinds of quantities of which a decrease is for the worse."""

KINDS_OF_ONE_MOTOR = (SHARE, EFFECT)
"""Kinds of figures beside the median motor's. One that seems better may be that of a sound motor beside a weak one."""


class Shape(StrEnum):
    """Shape by which an outcome is drawn."""

    SQUARE = "square"
    """Changed."""

    DIAMOND = "diamond"
    """Uncertain alone, but it agrees with the motor that the headline names."""

    RING = "ring"
    """Too uncertain to tell."""

    DOT = "dot"
    """The same."""


SHAPES = {
    QuantityOutcome.CHANGED: Shape.SQUARE,
    QuantityOutcome.UNCERTAIN: Shape.RING,
    QuantityOutcome.SAME: Shape.DOT,
}
"""Shape of each outcome."""

EVIDENCE_REMARK = "agrees with the weak motor"
"""What stands below such a change in the drawing."""

MAX_RELATIVE_CHANGE = 4.0
"""Largest change that has room in the drawing, in equivalence limits; a larger one ends at its edge. A choice."""

CENTER_PERCENT = 50.0
"""Position of no change, % of the width of the drawing."""

MARGIN_PERCENT = 6.0
"""Room at both sides of the drawing, % of its width: half the text of the last tick on a phone, as wide as "+120 %"."""


class ScaleTick(NamedTuple):
    """A tick of the scale below the drawing of some changes."""

    position: float
    """Position, % of the width."""

    text: str
    """Change of the quantity, with its sign and unit."""


class DrawnChange(NamedTuple):
    """A change as it is drawn; positions are % of the width."""

    text: str
    """Quantity, change and interval in words."""
    shape: Shape
    """Shape of the estimate."""
    colour: str
    """Name of its colour in the style sheet of pages, such as "bad"."""
    low: float
    """Position of the lower end of the interval."""
    middle: float
    """Position of the estimate."""
    high: float
    """Position of the upper end of the interval."""
    ticks: tuple[ScaleTick, ...]
    """Scale of its quantity."""
    beyond: int
    """1 or -1 where the estimate lies to the right or to the left of the drawing, which an arrow shows; 0 inside."""
    cut_ends: tuple[int, ...]
    """1 and -1 for an end of the interval to the right and to the left of the drawing, which an arrow shows."""
    remark: str = ""
    """What the change is besides its own outcome; empty for most."""
    without_lean: str = ""
    """What is left of the change of a trim without the part that lean makes, in words; empty where not known."""


def drawn_changes(difference: VehicleDifference) -> list[QuantityChange]:
    """Selects the quantities that the drawing of changes shows, and sorts them.

    Quantities that stayed the same are left out, unless all did.

    Args:
        difference: changes of a vehicle between two states, quantity by quantity.

    Returns:
        First the quantities that changed, then the uncertain ones. In each group, changes whose interval excludes "no
        change" come first.
    """

    def sort_key(change: QuantityChange) -> tuple[int, bool]:
        """Returns the position of the outcome, and whether "no change" is possible."""
        return OUTCOMES_IN_ORDER.index(change.outcome), change.interval_contains_zero

    changes = []
    for change in difference.changes:
        if change.outcome is not QuantityOutcome.SAME:
            changes.append(change)
    if not changes:
        changes = list(difference.changes)
    return sorted(changes, key=sort_key)


def change_plan(
    difference: VehicleDifference,
    evidence: Collection[QuantityChange] = (),
    *,
    are_two_vehicles: bool = False,
) -> Plan | None:
    """Draws how much each quantity changed, with its 90 % interval, as a forest plot with a row for each quantity.

    Changes are drawn relative to the equivalence limit of their quantity, below which a change does not matter.

    Args:
        difference: changes of a vehicle between two states, quantity by quantity.
        evidence: changes that agree with a weak motor, which a light of one side names.
        are_two_vehicles: whether the states are of two vehicles, of which neither is the better or worse one.

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
    rows = []
    for change, relative in zip(changes, relative_changes, strict=True):
        # An arrow at the right (1) or left edge (-1) stands for a change beyond it.
        beyond = 0
        if relative.difference > extent:
            beyond = 1
        elif relative.difference < -extent:
            beyond = -1
        shape = SHAPES[change.outcome]
        remark = ""
        if is_uncertain_sign_of_weak_motor(change, evidence):
            shape = Shape.DIAMOND
            remark = EVIDENCE_REMARK
        rows.append(
            DrawnChange(
                capitalize_first(change_text(change, difference)),
                shape=shape,
                colour=_colour(change, shape, are_judged=not are_two_vehicles),
                low=_position(relative.low, extent),
                middle=_position(relative.difference, extent),
                high=_position(relative.high, extent),
                ticks=_scale_ticks(change.quantity.kind, extent),
                beyond=beyond,
                cut_ends=_cut_ends(relative, extent),
                remark=remark,
                without_lean=change_without_lean(change),
            )
        )
    band = _position(-1.0, extent), _position(1.0, extent)
    svg = figure_as_svg("changes", rows=rows, band=band)
    texts = listed(row.text for row in rows)
    return Plan("", f"Changes with their 90 % intervals: {texts}", svg)


def _position(relative_change: float, extent: float) -> float:
    """Returns where a change is drawn, % of the width from the left; what has no room there lies at an edge.

    Args:
        relative_change: the change, in equivalence limits.
        extent: largest change that has room in the drawing, in equivalence limits.
    """
    percent_per_limit = (CENTER_PERCENT - MARGIN_PERCENT) / extent
    return min(max(CENTER_PERCENT + percent_per_limit * relative_change, 0.0), 100.0)


def _scale_ticks(kind: str, extent: float) -> tuple[ScaleTick, ...]:
    """Returns the ticks of a kind of quantity: no change, and the multiples of its equivalence limit.

    Args:
        kind: kind of quantity, such as ``SHARE``.
        extent: largest change that has room in the drawing, in equivalence limits.
    """
    largest_multiple = floor(extent)
    ticks = []
    for multiple in range(-largest_multiple, largest_multiple + 1):
        ticks.append(ScaleTick(_position(multiple, extent), scale_text(kind, multiple)))
    return tuple(ticks)


def _cut_ends(relative: "_RelativeChange", extent: float) -> tuple[int, ...]:
    """Returns at which edges of the drawing an interval is cut off: 1 for the right one, -1 for the left one.

    Args:
        relative: the change with its interval, in equivalence limits.
        extent: largest change that has room in the drawing, in equivalence limits.
    """
    ends = []
    if relative.low < -extent:
        ends.append(-1)
    if relative.high > extent:
        ends.append(1)
    return tuple(ends)


def is_uncertain_sign_of_weak_motor(
    change: QuantityChange, evidence: Collection[QuantityChange]
) -> bool:
    """Returns whether a change agrees with a weak motor, but is not certain by itself.

    Args:
        change: change of one quantity between two states of a vehicle.
        evidence: the changes that agree with the weak motor that was found in one of the states.
    """
    return change in evidence and change.outcome is not QuantityOutcome.CHANGED


def _colour(change: QuantityChange, shape: Shape, *, are_judged: bool) -> str:
    """Returns the colour of a drawn change: red for the worse, green for the better, and others without a judgement.

    Args:
        change: change of one quantity between two states.
        shape: shape by which it is drawn.
        are_judged: whether a change is for the better or worse, as of one vehicle.

    Returns:
        Name of a colour in the style sheet of pages.
    """
    if shape is Shape.DIAMOND:
        return "watch"
    if shape is not Shape.SQUARE:
        return "unknown"
    if not are_judged or change.is_explained_by_lean:
        return "link"
    kind = change.quantity.kind
    is_larger = change.difference > 0
    if kind not in (*KINDS_WORSE_IF_LARGER, *KINDS_WORSE_IF_SMALLER):
        return "link"
    is_worse = is_larger == (kind in KINDS_WORSE_IF_LARGER)
    if is_worse:
        return "bad"
    return "link" if kind in KINDS_OF_ONE_MOTOR else "good"


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
