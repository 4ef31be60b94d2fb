"""A drawing of what changed between two states of a vehicle: each quantity's change with its interval (a forest plot).

Quantities have different units, so that each kind of them has a scale of its own. A shaded band shows the changes that
are called the same.
"""

from collections.abc import Collection, Sequence
from enum import StrEnum
from math import floor, log10
from typing import NamedTuple

from mavdem.containers import group_by
from mavdem.facts.fleet import QuantityOutcome
from mavdem.fleet.difference import VehicleDifference
from mavdem.fleet.quantities import (
    ATTITUDE_GAIN_MARGIN,
    ATTITUDE_PHASE_MARGIN,
    EFFECT,
    GAIN_MARGIN,
    LAG,
    LOGARITHMIC_KINDS,
    MAX_SENSITIVITY,
    OVERSHOOT,
    PHASE_MARGIN,
    SHARE,
)
from mavdem.fleet.random_effects import QuantityChange, equivalence_interval
from mavdem.report.charts.chart import Plan
from mavdem.report.charts.plans import figure_as_svg
from mavdem.report.difference.quantity_texts import (
    change_text,
    change_without_lean,
    shown_difference,
    tick_label,
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

PERCENT = 100.0

MAX_TICKS_PER_SIDE = 3
"""Ticks of a scale at either side of "no change": their texts have room on a phone. A choice."""

ROUND_FACTORS = (1.0, 2.0, 5.0)
"""Distances of two ticks, but for powers of 10."""

ROUND_ANGLES = (5.0, 10.0, 15.0, 30.0, 45.0, 60.0, 90.0)
"""Distances of two ticks of an angle, °."""

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


class ChangeScale(NamedTuple):
    """The scale of the changes of one kind of quantity; "no change" is in the middle of the drawing."""

    extent: float
    """Largest change that has room, in the unit of the change."""

    ticks: tuple[ScaleTick, ...] = ()
    """Its ticks."""

    band: tuple[float, float] = (CENTER_PERCENT, CENTER_PERCENT)
    """Positions of the smallest and the largest change that are called the same, % of the width."""

    def position(self, change: float) -> float:
        """Returns where a change is drawn: 50 (% of the width from the left) for no change, less for a decrease."""
        return CENTER_PERCENT + (CENTER_PERCENT - MARGIN_PERCENT) * change / self.extent


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
    scale: ChangeScale
    """Scale of its kind of quantity."""
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
    changes: Sequence[QuantityChange] | None = None,
) -> Plan | None:
    """Draws how much each quantity changed, with its 90 % interval, as a forest plot with a row for each quantity.

    The scale of each kind of quantity contains the intervals of all its changes.

    Args:
        difference: changes of a vehicle between two states, quantity by quantity.
        evidence: changes that agree with a weak motor, which a light of one side names.
        are_two_vehicles: whether the states are of two vehicles, of which neither is the better or worse one.
        changes: those of the changes that are drawn; None for :func:`drawn_changes`.

    Returns:
        The drawing; None without a change to draw.
    """
    if changes is None:
        changes = drawn_changes(difference)
    if not changes:
        return None
    changes_by_kind = group_by(changes, lambda change: change.quantity.kind)
    scales = {
        kind: _scale(kind, changes_of_kind) for kind, changes_of_kind in changes_by_kind.items()
    }
    rows = []
    for change in changes:
        is_sign_of_weak_motor = is_uncertain_sign_of_weak_motor(change, evidence)
        shape = Shape.DIAMOND if is_sign_of_weak_motor else SHAPES[change.outcome]
        scale = scales[change.quantity.kind]
        low, high = change.interval
        row = DrawnChange(
            capitalize_first(change_text(change, difference)),
            shape=shape,
            colour=_colour(change, shape, are_judged=not are_two_vehicles),
            low=scale.position(low),
            middle=scale.position(change.difference),
            high=scale.position(high),
            scale=scale,
            remark=EVIDENCE_REMARK if is_sign_of_weak_motor else "",
            without_lean=change_without_lean(change),
        )
        rows.append(row)
    svg = figure_as_svg("changes", rows=rows)
    texts = listed(row.text for row in rows)
    return Plan("", f"Changes with their 90 % intervals: {texts}", svg)


def _scale(kind: str, changes: Sequence[QuantityChange]) -> ChangeScale:
    """Returns the scale on which the changes of a kind of quantity are drawn.

    It reaches as far as the largest interval of a change, and at least to the ends of the shaded band of differences
    that are called the same.

    Args:
        kind: kind of quantity, such as ``SHARE``.
        changes: the drawn changes of this kind.
    """
    limits_of_same = equivalence_interval(kind)
    ends = [abs(limit) for limit in limits_of_same]
    ends += [change.largest_difference for change in changes]
    scale = ChangeScale(max(ends))
    ticks = _scale_ticks(kind, scale)
    low, high = limits_of_same
    return scale._replace(ticks=ticks, band=(scale.position(low), scale.position(high)))


def _scale_ticks(kind: str, scale: ChangeScale) -> tuple[ScaleTick, ...]:
    """Returns the ticks of a scale: no change, and at most ``MAX_TICKS_PER_SIDE`` round numbers at either side of it.

    Args:
        kind: kind of quantity, such as ``SHARE``.
        scale: its scale, still without ticks.
    """
    shown = shown_difference(kind)
    shown_extent = shown.scale * scale.extent
    step = _round_step(shown_extent / MAX_TICKS_PER_SIDE, is_angle=shown.unit == "°")
    tick_count = floor(shown_extent / step)
    is_ratio = kind in LOGARITHMIC_KINDS
    ticks = []
    for multiple in range(-tick_count, tick_count + 1):
        difference = multiple * step
        # No quantity falls by more than all of it.
        if is_ratio and difference < -PERCENT:
            continue
        position = scale.position(difference / shown.scale)
        ticks.append(ScaleTick(position, tick_label(difference, shown.unit)))
    return tuple(ticks)


def _round_step(smallest_step: float, *, is_angle: bool) -> float:
    """Rounds the spacing of ticks up to a round number, such as 14 to 20, or to 15 if it is an angle.

    Args:
        smallest_step: the step, above 0, in the shown unit.
        is_angle: whether it is an angle in degrees, of which 15, 30, 45, 60 and 90 are round.
    """
    if is_angle:
        for angle in ROUND_ANGLES:
            if angle >= smallest_step:
                return angle
    decade = 10.0 ** floor(log10(smallest_step))
    for factor in ROUND_FACTORS:
        if factor * decade >= smallest_step:
            return factor * decade
    return 10 * decade


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
    """Returns the colour in which the change of a quantity between two states of a vehicle is drawn.

    Args:
        change: the change.
        shape: shape by which it is drawn, which says how certain it is.
        are_judged: whether both states are of one vehicle, whose changes are for the better or the worse. Between two
            vehicles, a difference is neither.

    Returns:
        Name of a colour in the style sheet of pages: "bad" for the worse, "good" for the better, "link" (neutral) for
        neither; for what is not surely a change, "watch" if it agrees with a weak motor, or else "unknown".
    """
    if shape is Shape.DIAMOND:
        # Uncertain by itself, but it agrees with the weak motor that was found.
        return "watch"
    if shape is not Shape.SQUARE:
        # Only squares are certain changes.
        return "unknown"
    if not are_judged or change.is_explained_by_lean:
        return "link"
    kind = change.quantity.kind
    if kind in KINDS_WORSE_IF_LARGER:
        is_worse = change.difference > 0
    elif kind in KINDS_WORSE_IF_SMALLER:
        is_worse = change.difference <= 0
    else:
        return "link"
    if is_worse:
        return "bad"
    # A motor is compared with the median motor, and may seem better because others became weak.
    return "link" if kind in KINDS_OF_ONE_MOTOR else "good"
