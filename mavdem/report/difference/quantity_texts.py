"""Compared quantities in words: their names, changes with intervals, and limits."""

from collections.abc import Iterator, Sequence
from math import ceil, degrees
from typing import NamedTuple

from mavdem.containers import group_by
from mavdem.fleet.difference import VehicleDifference
from mavdem.fleet.quantities import (
    ATTITUDE_GAIN_MARGIN,
    ATTITUDE_PHASE_MARGIN,
    DAMPING,
    EFFECT,
    GAIN_MARGIN,
    LAG,
    LOGARITHMIC_KINDS,
    MAX_SENSITIVITY,
    MEAN_EFFECT,
    OVERSHOOT,
    PHASE_MARGIN,
    RISE,
    SHARE,
)
from mavdem.fleet.random_effects import QuantityChange
from mavdem.report.numbers import (
    listed,
    number_with_unit,
    plus_minus,
    rounded,
    without_remark,
)

MIN_WHOLE_PERCENT = 3.0
"""Half width, %, from which on a relative change is shown without decimals, which would mean nothing: a choice."""


class ShownQuantity(NamedTuple):
    """How a kind of quantity is shown."""

    name: str
    """Name in a sentence."""

    scale: float
    """Factor from the compared unit to the shown one."""

    unit: str
    """Shown unit."""


class ShownDifference(NamedTuple):
    """How a difference of a kind of quantity is shown."""

    scale: float
    """Factor from the compared difference to the shown one."""

    unit: str
    """Shown unit."""


SHOWN_QUANTITIES = {
    SHARE: ShownQuantity("relative trim", 100.0, "%"),
    EFFECT: ShownQuantity("control effectiveness", 100.0, "%"),
    MEAN_EFFECT: ShownQuantity("mean control effectiveness", 100.0, "%"),
    DAMPING: ShownQuantity("rate damping", 1.0, "1/s"),
    LAG: ShownQuantity("motor time constant", 1e3, "ms"),
    PHASE_MARGIN: ShownQuantity("phase margin", degrees(1.0), "°"),
    GAIN_MARGIN: ShownQuantity("gain margin", 1.0, "dB"),
    MAX_SENSITIVITY: ShownQuantity("Ms", 1.0, ""),
    ATTITUDE_PHASE_MARGIN: ShownQuantity("phase margin of the attitude", degrees(1.0), "°"),
    ATTITUDE_GAIN_MARGIN: ShownQuantity("gain margin of the attitude", 1.0, "dB"),
    OVERSHOOT: ShownQuantity("overshoot of the rate", 100.0, "%"),
    RISE: ShownQuantity("time from 10 to 90 % of a rate step", 1e3, "ms"),
}
"""How quantities are shown, by their kind."""

KINDS_WITHOUT_VALUES = (SHARE, EFFECT, MEAN_EFFECT)
"""Kinds of which the change alone is shown: their values are relative to the motors of one flight."""


def change_text(change: QuantityChange, difference: VehicleDifference) -> str:
    """Returns a change as text, such as "motor 3's relative trim −18 % ± 6 %" or "Ms on roll 1.4 → 1.6 (+0.2 ± 0.1)".

    For shares and effects of motors only the change is shown, and for all other quantities both values before it. The
    change has the half width of its 90 % interval. Quantities that are compared as ratios change by percent.

    Args:
        change: change of one quantity between two states, with its interval.
        difference: comparison of the vehicle, with the names of its motors.
    """
    interval_text = change_with_interval(change)
    if change.quantity.kind in KINDS_WITHOUT_VALUES:
        return f"{_quantity_name(change, difference)} {interval_text}"
    # No brackets stand in brackets: "(−64 %; −79 to −38 %)".
    interval_in_brackets = interval_text.removesuffix(")").replace(" (", "; ")
    return f"{change_without_interval(change, difference)} ({interval_in_brackets})"


def change_without_interval(change: QuantityChange, difference: VehicleDifference) -> str:
    """Returns a change by its values in both states, such as "Ms on roll 1.4 → 1.6"; of trims and effects as a whole.

    Args:
        change: change of one quantity between two states.
        difference: comparison of the vehicle, with the names of its motors.
    """
    if change.quantity.kind in KINDS_WITHOUT_VALUES:
        return change_text(change, difference)
    return f"{_quantity_name(change, difference)} {values_of_both_states(change)}"


def _quantity_name(change: QuantityChange, difference: VehicleDifference) -> str:
    """Returns the name of a compared quantity with its motor or axis, such as "Ms on roll".

    Args:
        change: change of the quantity between two states.
        difference: comparison of the vehicle, with the names of its motors.
    """
    quantity = change.quantity
    name = SHOWN_QUANTITIES[quantity.kind].name
    if quantity.is_of_motor:
        return f"{motor_name(change, difference)}'s {name}"
    return f"{name} on {quantity.axis}"


def values_of_both_states(change: QuantityChange) -> str:
    """Returns the values of a quantity in both states, such as "29 → 54°".

    Args:
        change: change of one quantity, which is not relative to other motors.
    """
    shown_form = SHOWN_QUANTITIES[change.quantity.kind]
    value_before = rounded(shown_form.scale * change.before)
    value_after = rounded(shown_form.scale * change.after)
    return f"{value_before} → {number_with_unit(value_after, shown_form.unit)}"


def motor_name(change: QuantityChange, difference: VehicleDifference) -> str:
    """Returns the name of the motor of a change, without its position; its number where names are not known."""
    return without_remark(motor_with_place(change.quantity.motor, difference))


def motor_with_place(motor: int, difference: VehicleDifference) -> str:
    """Returns the name of a motor with its place, such as "motor 1 (front right)"; its number where that is unknown."""
    if motor > len(difference.motors):
        return f"motor {motor}"
    return difference.motors[motor - 1]


def increase_with_interval(change: QuantityChange) -> str:
    """Returns an increase with its 90 % interval, without signs, such as "13 % (7 to 18 %)".

    Args:
        change: change of one quantity whose interval is above 0.
    """
    return change_with_interval(change).replace("+", "")


def change_without_lean(change: QuantityChange) -> str:
    """Returns how a motor's trim changed apart from what the vehicle's lean explains: "without lean −0 % (−4 to 4 %)".

    Args:
        change: change of one quantity. If its change without lean is not known, the text is empty.
    """
    if change.without_lean is None:
        return ""
    return f"without lean {change_with_interval(change.without_lean)}"


def change_with_interval(change: QuantityChange) -> str:
    """Returns a change with its 90 % interval, such as "−18 % (−24 to −12 %)", "+1.2 ± 0.8 dB" or "−17° ± 5°".

    Args:
        change: change of one quantity, which is in percent if the quantity is compared as a ratio.
    """
    if change.quantity.kind in LOGARITHMIC_KINDS:
        decimals = 0 if 100 * change.half_width >= MIN_WHOLE_PERCENT else 1

        def percentage(fraction: float) -> str:
            """Returns a relative change in percent with its sign."""
            return _signed(f"{100 * fraction:z.{decimals}f}")

        low, high = change.interval
        return f"{percentage(change.difference)} % ({percentage(low)} to {percentage(high)} %)"
    shown_form = SHOWN_QUANTITIES[change.quantity.kind]
    difference = shown_form.scale * change.difference
    half_width = shown_form.scale * change.half_width
    if abs(difference) < half_width:
        # The digits that a wide interval bears may be none of the difference, which would be shown as 0.
        number = f"{rounded(difference)} ± {rounded(half_width)}"
    else:
        number = plus_minus(difference, half_width)
    # A difference of percentages is no relative change.
    unit = "percentage points" if shown_form.unit == "%" else shown_form.unit
    return number_with_unit(_signed(number), unit)


def _signed(number: str) -> str:
    """Returns a formatted number with its sign, a minus sign in the place of a hyphen."""
    if number.startswith(("-", "(-")):
        return number.replace("-", "−")
    return f"+{number}"


def texts_of_equal_changes(
    changes: Sequence[QuantityChange], difference: VehicleDifference
) -> Iterator[str]:
    """Yields the text of each change. Motors with the same change share one: "motor 1 and motor 2's effect −5 % ± 2 %".

    Args:
        changes: changes of quantities of motors or axes.
        difference: comparison of the vehicle, with the names of its motors.
    """
    motors_by_text = dict[str, list[str]]()
    for change in changes:
        text = change_text(change, difference)
        motors = []
        if change.quantity.is_of_motor:
            motor = motor_name(change, difference)
            motors = [motor]
            # The name of the motor is put before the shared text again, with the names of the others.
            text = text.removeprefix(f"{motor}'s ")
        motors_by_text.setdefault(text, []).extend(motors)
    for text, motors in motors_by_text.items():
        yield f"{listed(motors)}'s {text}" if motors else text


def texts_by_kind(changes: Sequence[QuantityChange]) -> Iterator[str]:
    """Yields a text for each kind of quantity, such as "relative trim of motors 1 and 2 (within ±2 %)".

    The limit is the largest difference that the 90 % intervals of one kind contain, so that the text holds for each of
    its quantities.

    Args:
        changes: changes of quantities that stayed the same within their uncertainty.
    """
    changes_by_kind = group_by(changes, lambda change: change.quantity.kind)
    for kind, changes_of_kind in changes_by_kind.items():
        names = _names_of_quantities(changes_of_kind)
        yield f"{SHOWN_QUANTITIES[kind].name} of {names} (within {_bound_text(kind, changes_of_kind)})"


def bound_row(kind: str, changes: Sequence[QuantityChange], significance: float) -> list[str]:
    """Returns a table's row that says how large a change may have been missed in quantities that did not change.

    Args:
        kind: kind of the quantities, such as ``DAMPING``.
        changes: the compared quantities of this kind, at least one, such as the phase margins of pitch and roll.
        significance: p-value below which a quantity counts as changed if no other one changed.

    Returns:
        Three cells such as "phase margin of pitch and roll", "±14°" and "38°": the name, the largest change that a 90 %
        interval of one of the quantities still contains, and the change that nine of ten such comparisons would find.
    """
    name = f"{SHOWN_QUANTITIES[kind].name} of {_names_of_quantities(changes)}"
    detectable = detectable_change(kind, changes, significance)
    is_doubling_missed = any(change.detectable_difference(significance) > 1 for change in changes)
    if kind in LOGARITHMIC_KINDS and is_doubling_missed:
        # More digits would hide that not even twice the figure shows.
        detectable = "over 100 %"
    return [name, _bound_text(kind, changes), detectable]


def bound_without_lean(changes: Sequence[QuantityChange]) -> str:
    """Returns the largest change of trims without lean that their 90 % intervals contain, such as "10 %".

    Args:
        changes: changes of trims, each known without lean.
    """
    bounds = []
    for change in changes:
        assert change.without_lean is not None
        bounds.append(change.without_lean.largest_difference)
    return _limit_text(SHARE, max(bounds))


def _bound_text(kind: str, changes: Sequence[QuantityChange]) -> str:
    """Returns the largest difference that the 90 % intervals of a kind of quantity contain, such as "±14°".

    Args:
        kind: kind of the quantities, such as ``DAMPING``.
        changes: changes of quantities of this kind, at least one; the widest bound counts.
    """
    bound = max(change.largest_difference for change in changes)
    return f"±{_limit_text(kind, bound)}"


def detectable_change(kind: str, changes: Sequence[QuantityChange], significance: float) -> str:
    """Returns the smallest change of a kind of quantity that nine of ten such comparisons would find, such as "38°".

    Args:
        kind: kind of the quantities, such as ``DAMPING``.
        changes: changes of all quantities of this kind, at least one; the least precise one counts.
        significance: p-value below which one of them is called changed if it is the only one.
    """
    limit = max(change.detectable_difference(significance) for change in changes)
    return _limit_text(kind, limit)


def _names_of_quantities(changes: Sequence[QuantityChange]) -> str:
    """Returns the motors or axes of some quantities as text, such as "motors 1 and 2" or "pitch and roll"."""
    motors = [change.quantity.motor for change in changes if change.quantity.is_of_motor]
    if len(motors) == 1:
        return f"motor {motors[0]}"
    if motors:
        return f"motors {listed(motors)}"
    axes = [change.quantity.axis for change in changes]
    return listed(axes)


def _limit_text(kind: str, limit: float) -> str:
    """Returns an upper limit of a kind of quantity with its unit, such as "6 %" or "14°".

    Args:
        kind: kind of quantity, such as ``DAMPING``.
        limit: the limit, in the unit of the difference: relative for ``LOGARITHMIC_KINDS``, which from 3 % on are shown
            in whole percent and rounded up.
    """
    percent = 100 * limit
    if kind in LOGARITHMIC_KINDS and percent >= MIN_WHOLE_PERCENT:
        return f"{ceil(percent)} %"
    return _amount_text(kind, limit)


def _amount_text(kind: str, amount: float) -> str:
    """Returns an amount of a kind of quantity with its unit, such as "2 %" or "5.0 ms".

    Args:
        kind: kind of quantity, such as ``DAMPING``.
        amount: the amount, in the unit of the difference: relative for ``LOGARITHMIC_KINDS``, shown in percent.
    """
    if kind in LOGARITHMIC_KINDS:
        return f"{rounded(100 * amount)} %"
    shown_form = SHOWN_QUANTITIES[kind]
    return number_with_unit(rounded(shown_form.scale * amount), shown_form.unit)


def shown_difference(kind: str) -> ShownDifference:
    """Returns how a difference of a kind of quantity is shown: in percent if it is compared as a ratio.

    Args:
        kind: kind of quantity, such as ``DAMPING``.
    """
    if kind in LOGARITHMIC_KINDS:
        return ShownDifference(scale=100.0, unit="%")
    shown_form = SHOWN_QUANTITIES[kind]
    return ShownDifference(shown_form.scale, shown_form.unit)


def tick_label(difference: float, unit: str) -> str:
    """Returns the label of a tick on a scale of differences, such as "−12 %", "0" or "+0.5 1/s".

    Args:
        difference: the difference, in its shown unit; negative for a decrease.
        unit: that unit.
    """
    if not difference:
        return "0"
    return number_with_unit(_signed(f"{difference:g}"), unit)
