"""The table of all instances of a vehicle's batteries, state estimators, sensors and outputs, with range and state."""

from collections.abc import Sequence

from mavdem.assessment.instances import Instance
from mavdem.facts import Fact
from mavdem.facts.instances import InstanceState
from mavdem.report.blocks import HARD_SPACE, Rated, Table
from mavdem.report.numbers import rounded
from mavdem.report.templates import capitalize_first, without_full_stop

HEADER = ["instance", "used", "quantity", "range in flight", "state"]
"""Header of the table of a vehicle that flew."""

HEADER_WITHOUT_FLIGHT = ["instance", "used", "quantity", "range", "state"]
"""Header where there was no flight: ranges are those of the whole log."""

SHOWN_DIGITS = 3
"""Significant digits of the range: those of a battery's voltage."""


def instance_table(instances: Sequence[Instance], vibration: Fact, *, has_flown: bool) -> Table:
    """Returns a table with a row for each instance: whether it is used, its range in flight, and its state.

    Args:
        instances: at least one, in the order of the rows.
        vibration: the judgement of the vibration, a coded finding, whose subject is the IMU that vibrates most. If it
            warns, so does the row of that IMU.
        has_flown: whether the vehicle flew; otherwise the ranges are taken from the whole log.

    Returns:
        The table.
    """
    rows = []
    for instance in instances:
        rows.append(
            [
                instance.name,
                _used_text(instance.used_share),
                instance.quantity,
                _range_text(instance),
                _state_cell(instance, vibration),
            ]
        )
    header = HEADER if has_flown else HEADER_WITHOUT_FLIGHT
    return Table(header, rows, words=True)


def _state_cell(instance: Instance, vibration: Fact) -> str:
    """Returns the state of a battery, a sensor or the like as the text of a table's cell, coloured if it is a warning.

    Args:
        instance: the battery or sensor, with its state as a fact (a coded finding).
        vibration: the judgement of the vibration, whose subject is the IMU that vibrates most. It explains the state of
            this IMU better than that it measured something, or that it clipped.

    Returns:
        ``Rated`` text, which has the colour of its level. A plain "Measured" has no colour, so that warnings stand out.
    """
    is_measured = instance.state.code is InstanceState.MEASURED
    is_clipped = instance.state.code is InstanceState.CLIPPED
    is_vibrating_imu = instance.quantity == "vibration" and instance.name == vibration.subject
    if is_vibrating_imu and vibration.is_watch_or_bad and (is_measured or is_clipped):
        return Rated(f"{capitalize_first(vibration.level)}: see vibration", vibration.level)
    state = without_full_stop(str(instance.state))
    return state if is_measured else Rated(state, instance.state.level)


def _range_text(instance: Instance) -> str:
    """Returns the range of values of a sensor or another part as text, such as "12.6 to 15.9 V".

    If both ends are the same number as shown, it is shown once. A count, whose unit is "1", is shown without a unit. No
    line ends within the text.

    Args:
        instance: one of several batteries, sensors, estimators or motor outputs, with its lowest and highest value.
    """
    low = _number_text(instance.low, instance.unit)
    high = _number_text(instance.high, instance.unit)
    text = low
    if high != low:
        text = f"{low} to {high}"
    if instance.unit != "1":
        text = f"{text} {instance.unit}"
    return text.replace(" ", HARD_SPACE)


def _number_text(value: float, unit: str) -> str:
    """Returns a value of a sensor or another part as text without its unit, with the decimals that its kind has.

    Args:
        value: the value.
        unit: its unit, "1" for counts and ratios. Counts, pulses (µs) and speeds of motors (1/min) have no decimals,
            other values below 1 have two, and the rest has ``SHOWN_DIGITS`` significant digits.
    """
    is_count = unit == "1" and float(value).is_integer()
    if is_count or unit in ("1/min", "µs"):
        return f"{value:.0f}"
    if abs(value) < 1:
        return f"{value:z.2f}"
    return rounded(value, SHOWN_DIGITS)


def _used_text(used_share: float | None) -> str:
    """Returns whether the autopilot used a sensor or another part, for a table: "yes", "no" or a percentage.

    Args:
        used_share: fraction of the time in which it was used; None if the log does not say it, which gives no text.
    """
    if used_share is None:
        return ""
    if used_share in (0.0, 1.0):
        return "yes" if used_share else "no"
    return f"{100 * used_share:.0f} %"
