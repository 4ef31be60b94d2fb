"""How two compared flights were flown: battery, motor output, wind, lean and vibration beside each other.

Such conditions are no changes of the vehicle. They show whether the flights can be compared: another battery, payload
or wind changes figures of a vehicle that is as before.
"""

from collections.abc import Sequence
from math import degrees, isfinite
from typing import NamedTuple

from mavdem.containers import JsonValues
from mavdem.dataset.axes import AXES
from mavdem.facts.lights import Light
from mavdem.fleet.comparability import STATE_NAMES
from mavdem.fleet.flight_conditions import Conditions, WindSpeed
from mavdem.fleet.report_columns import NOT_IDENTIFIABLE, value_at
from mavdem.report.blocks import Sentence, Table
from mavdem.report.difference.lights import vibrations_of_same_imu
from mavdem.report.difference.reviewed import ReviewedDifference
from mavdem.report.difference.side_titles import side_title
from mavdem.report.numbers import (
    UNKNOWN_FIGURE,
    estimate_with_interval,
    number_with_unit,
    rounded,
)
from mavdem.report.templates import rounded_up

BATTERY = "battery"
MOTOR_OUTPUT = "mean motor output"
OUTPUT_AT_EQUAL_VOLTAGE = "mean output at equal voltage"
WIND = "wind"
LEAN = "mean roll and pitch"
BRIEF_CONDITIONS = (BATTERY, MOTOR_OUTPUT, OUTPUT_AT_EQUAL_VOLTAGE, WIND, LEAN)
"""Names of the conditions that a terminal has room for: those that change the figures of a vehicle most."""


class ConditionRow(NamedTuple):
    """One condition in both flights."""

    name: str
    """What it is, such as "battery"."""

    unit: str
    """Its unit, such as "V"."""

    cells: tuple[str, str]
    """Its value in A and in B; ``UNKNOWN_FIGURE`` where it is not known."""

    @property
    def is_known(self) -> bool:
        """Whether it is known in A or in B."""
        return any(cell != UNKNOWN_FIGURE for cell in self.cells)

    @property
    def text(self) -> str:
        """Both values in words, such as "battery 11.3 → 11.5 V" or "wind not known in A, 3.2 m/s in B"."""
        before, after = self.cells
        if before == after:
            return f"{self.name} {number_with_unit(before, self.unit)}"
        if UNKNOWN_FIGURE not in self.cells:
            return f"{self.name} {before} → {number_with_unit(after, self.unit)}"
        values = []
        for side, cell in zip(STATE_NAMES, self.cells, strict=True):
            value = "not known" if cell == UNKNOWN_FIGURE else number_with_unit(cell, self.unit)
            values.append(f"{value} in {side}")
        return f"{self.name} {', '.join(values)}"


def condition_table(reviewed: ReviewedDifference) -> list[Table]:
    """Returns the table of the conditions of two compared flights, such as wind and speed, with a column for each.

    Args:
        reviewed: comparison of two flights, or of two groups of flights. The table has the means of a group.

    Returns:
        A list with the table; empty if no condition is known.
    """
    rows = []
    for condition in condition_rows(reviewed):
        rows.append([f"{condition.name} ({condition.unit})", *condition.cells])
    if not rows:
        return []
    log_counts = reviewed.difference.flights
    sides = []
    for side, log_count in zip(STATE_NAMES, log_counts, strict=True):
        sides.append(side_title(side, log_count))
    title = "flown with (mean)" if max(log_counts) > 1 else "flown with"
    return [Table([title, *sides], rows)]


def condition_sentence(reviewed: ReviewedDifference) -> list[Sentence]:
    """Returns battery, motor output, wind and lean as one sentence, for the terminal; empty if none of them is known.

    An example is "battery 11.3 → 11.5 V; mean motor output 58 → 62 %; mean roll and pitch +1 and 0 → −4 and +1°.".

    Args:
        reviewed: comparison of two states.
    """
    texts = [row.text for row in condition_rows(reviewed) if row.name in BRIEF_CONDITIONS]
    if not texts:
        return []
    are_means = max(reviewed.difference.flights) > 1
    return [Sentence(f"{'; '.join(texts)}.", "Flown with (mean):" if are_means else "Flown with:")]


def condition_rows(reviewed: ReviewedDifference) -> list[ConditionRow]:
    """Returns the conditions that are known of A or B, in the order in which a pilot asks for them.

    Args:
        reviewed: comparison of two states.
    """
    before, after = reviewed.difference.conditions
    voltages = (_cell(before.voltage, 1), _cell(after.voltage, 1))
    motor_outputs = (_percent_cell(before.collective), _percent_cell(after.collective))
    rows = [
        ConditionRow(BATTERY, "V", voltages),
        ConditionRow(MOTOR_OUTPUT, "%", motor_outputs),
        *effort_rows(reviewed),
        *wind_rows(reviewed),
        ConditionRow(LEAN, "°", (_lean_cell(before), _lean_cell(after))),
    ]
    for axis in AXES:
        # Standard deviation of the wind's angular acceleration, rad/s².
        torque_before = before.wind_torque.get(axis)
        torque_after = after.wind_torque.get(axis)
        if torque_before is not None and torque_after is not None:
            cells = (rounded(degrees(torque_before)), rounded(degrees(torque_after)))
            rows.append(ConditionRow(f"wind torque on {axis}", "°/s²", cells))
    rows += vibration_rows(reviewed)
    return [row for row in rows if row.is_known]


def effort_rows(reviewed: ReviewedDifference) -> list[ConditionRow]:
    """Returns the row of the mean motor output at equal battery voltage, in percent of A, such as "100" and "104".

    Args:
        reviewed: comparison of two states.

    Returns:
        A list with the row; empty where output or voltage is not known, and for two different vehicles.
    """
    effort = reviewed.difference.effort
    if effort is None or reviewed.are_two_vehicles:
        return []
    cells = ("100", f"{100 * (1 + effort.relative_change):.0f}")
    return [ConditionRow(OUTPUT_AT_EQUAL_VOLTAGE, "% of A", cells)]


def wind_rows(reviewed: ReviewedDifference) -> list[ConditionRow]:
    """Returns two rows of a table of both states: the wind speed, and the direction that the wind comes from.

    Of a log each value has its 90 % interval. Of a fleet the speed is a range over its flights, without a direction.

    Args:
        reviewed: comparison of two states, with the reviews of those that are logs.
    """
    speeds = []
    directions = []
    difference = reviewed.difference
    states = zip(STATE_NAMES, difference.conditions, difference.flights, strict=True)
    for side, conditions, log_count in states:
        # A missing review or wind is empty: then the cells say that the wind is not known.
        review = reviewed.reviews.get(side) or {}
        wind = review.get("wind") or {}
        bounds = value_at(review, f"lights.{Light.WIND}.figures.reason") or {}
        speed = _wind_speed_cell(wind, bounds)
        if speed == UNKNOWN_FIGURE:
            speed = _wind_speed_range(conditions.wind_speeds, log_count)
        speeds.append(speed)
        directions.append(_wind_direction_cell(wind))
    return [
        ConditionRow(WIND, "m/s", (speeds[0], speeds[1])),
        ConditionRow("wind from", "°", (directions[0], directions[1])),
    ]


def _wind_speed_range(winds: Sequence[WindSpeed], log_count: int) -> str:
    """Returns the range of the wind speeds of some logs, such as "1.9 to 2.8 (5 of 9 logs)".

    Args:
        winds: mean wind speed in each log in which it is known, the smallest first.
        log_count: number of all logs.

    Returns:
        The range, with the number of logs if some have no wind speed; a dash if none has one. A single speed has its
        90 % interval, as in "1.9 (0.9 to 3.4; 1 of 2 logs)".
    """
    if not winds:
        return UNKNOWN_FIGURE
    slowest, fastest = winds[0], winds[-1]
    speed_range = f"{slowest.speed:.1f}"
    if f"{fastest.speed:.1f}" != speed_range:
        speed_range += f" to {fastest.speed:.1f}"
    remarks = []
    if len(winds) == 1 and slowest.interval is not None:
        low, high = slowest.interval
        remarks.append(f"{low:.1f} to {high:.1f}")
    if len(winds) < log_count:
        remarks.append(f"{len(winds)} of {log_count} logs")
    return f"{speed_range} ({'; '.join(remarks)})" if remarks else speed_range


def vibration_rows(reviewed: ReviewedDifference) -> list[ConditionRow]:
    """Returns a row for each IMU that both logs have: its mean vibration in flight, along the axis that vibrates most.

    Args:
        reviewed: comparison of two states. Where the reviews of their logs have no IMU in common, as those of fleets,
            the rows have the means over the flights.
    """
    lights_by_side = {}
    for side in STATE_NAMES:
        review = reviewed.reviews.get(side) or {}
        lights_by_side[side] = value_at(review, "lights.vibration") or {}
    vibrations_by_imu = vibrations_of_same_imu(lights_by_side)
    if not vibrations_by_imu:
        return _mean_vibration_rows(*reviewed.difference.conditions)
    rows = []
    for imu, (first_vibration, second_vibration) in vibrations_by_imu.items():
        rows.append(_vibration_row(imu, first_vibration, second_vibration))
    return rows


def _mean_vibration_rows(before: Conditions, after: Conditions) -> list[ConditionRow]:
    """Returns a row for each IMU with its mean vibration over the flights of A and over those of B.

    Args:
        before, after: mean conditions of the flights of A and of B. If they have different numbers of IMUs, or the
            vibration of the first IMU alone, there is one row.
    """
    first_vibrations, second_vibrations = before.vibration_of_imus, after.vibration_of_imus
    if not first_vibrations or len(first_vibrations) != len(second_vibrations):
        return [_vibration_row("IMU 1", before.vibration, after.vibration)]
    rows = []
    vibrations = zip(first_vibrations, second_vibrations, strict=True)
    for number, (first_vibration, second_vibration) in enumerate(vibrations, start=1):
        rows.append(_vibration_row(f"IMU {number}", first_vibration, second_vibration))
    return rows


def _vibration_row(imu: str, before: float | None, after: float | None) -> ConditionRow:
    """Returns the row of the vibration of an IMU, such as "IMU 2", in A and in B, m/s²; None for an unknown one."""
    cells = (_rounded_cell(before), _rounded_cell(after))
    return ConditionRow(f"vibration of {imu}", "m/s²", cells)


def _cell(value: float | None, decimals: int) -> str:
    """Returns a value with so many decimals; ``UNKNOWN_FIGURE`` for one that is not known."""
    if value is None or not isfinite(value):
        return UNKNOWN_FIGURE
    return f"{value:.{decimals}f}"


def _rounded_cell(value: float | None) -> str:
    """Returns a value with two significant digits; ``UNKNOWN_FIGURE`` for one that is not known."""
    return UNKNOWN_FIGURE if value is None else rounded(value)


def _percent_cell(fraction: float | None) -> str:
    """Returns a fraction in whole percent; ``UNKNOWN_FIGURE`` for one that is not known."""
    return UNKNOWN_FIGURE if fraction is None else _cell(100 * fraction, 0)


def _lean_cell(conditions: Conditions) -> str:
    """Returns the table cell of a flight's mean roll and pitch, whole degrees, such as "+1 and −4".

    Args:
        conditions: how the flight was flown, with the mean angles, rad.

    Returns:
        Both angles with their signs; a dash if they are not known.
    """
    if conditions.lean_roll is None or conditions.lean_pitch is None:
        return UNKNOWN_FIGURE
    roll, pitch = degrees(conditions.lean_roll), degrees(conditions.lean_pitch)
    # Adding 0 makes 0 of a rounded −0.
    angles = [f"{round(angle) + 0:+d}" for angle in (roll, pitch)]
    return " and ".join(angles).replace("-", "−").replace("+0", "0")


def _wind_speed_cell(wind: JsonValues, bounds: JsonValues) -> str:
    """Returns the table cell of a flight's mean wind speed, m/s, with its 90 % interval, such as "5.2 (4.6 to 5.9)".

    It is the mean of the speeds, as the light on the wind has it. Documents of earlier versions have only the speed of
    the mean wind vector. If the air may have been still, the cell has only the upper end of the interval, such as
    "below 1.3".

    Args:
        wind: the wind in a review document; empty without a wind.
        bounds: what the light on the wind says of a speed that is not identifiable: its ``low`` and ``high`` bound,
            m/s; empty without.

    Returns:
        The text. For a speed that is not identifiable, between which bounds it is, as the light on the wind has it; a
        dash if these are not known either.
    """
    status = wind.get("status", {})
    if status.get("speed") == NOT_IDENTIFIABLE:
        if not bounds.get("high"):
            return UNKNOWN_FIGURE
        if not bounds.get("low"):
            return f"below {rounded_up(bounds['high'], 1)}"
        return f"{bounds['low']:.1f} to {bounds['high']:.1f}"
    if wind.get("calm"):
        _, upper_end = wind["speed_interval"]
        return f"below {rounded_up(upper_end, 1)}"
    key = "mean_speed" if "mean_speed" in wind else "speed"
    return estimate_with_interval(wind.get(key), wind.get(f"{key}_interval")) or UNKNOWN_FIGURE


def _wind_direction_cell(wind: JsonValues) -> str:
    """Returns the table cell of the direction that a flight's wind came from, degrees, such as "270 ± 8".

    Args:
        wind: the wind in a review document; empty without a wind.

    Returns:
        Direction and half width of its 90 % interval; a dash if the direction is not identifiable, and for still air,
        which comes from nowhere.
    """
    status = wind.get("status", {})
    if not wind or wind["calm"] or status.get("direction") == NOT_IDENTIFIABLE:
        return UNKNOWN_FIGURE
    return f"{wind['direction']:.0f} ± {wind['direction_interval']:.0f}"
