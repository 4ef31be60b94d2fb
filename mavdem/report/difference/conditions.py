"""How two compared flights were flown: battery, motor output, wind, lean and vibration beside each other.

Such conditions are no changes of the vehicle. They show whether the flights can be compared: another battery, payload
or wind changes figures of a vehicle that is as before.
"""

from collections.abc import Mapping
from math import degrees, isfinite
from typing import NamedTuple

from mavdem.containers import JsonValues
from mavdem.dataset.axes import AXES
from mavdem.facts.lights import Light
from mavdem.fleet.comparability import STATE_NAMES
from mavdem.fleet.flight_conditions import Conditions
from mavdem.fleet.report_columns import NOT_IDENTIFIABLE, value_at
from mavdem.report.blocks import Sentence, Table
from mavdem.report.difference.lights import Review, vibrations_of_same_imu
from mavdem.report.difference.reviewed import ReviewedDifference
from mavdem.report.numbers import UNKNOWN_FIGURE, estimate_with_interval, rounded
from mavdem.report.templates import rounded_up

BATTERY = "battery"
MOTOR_OUTPUT = "mean motor output"
WIND = "wind"
BRIEF_CONDITIONS = (BATTERY, MOTOR_OUTPUT, WIND)
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
            return f"{self.name} {before} {self.unit}"
        if UNKNOWN_FIGURE not in self.cells:
            return f"{self.name} {before} → {after} {self.unit}"
        values = []
        for side, cell in zip(STATE_NAMES, self.cells, strict=True):
            value = "not known" if cell == UNKNOWN_FIGURE else f"{cell} {self.unit}"
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
    are_means = max(reviewed.difference.flights) > 1
    return [Table(["flown with (mean)" if are_means else "flown with", *STATE_NAMES], rows)]


def condition_sentence(reviewed: ReviewedDifference) -> list[Sentence]:
    """Returns battery, mean motor output and wind as one sentence, for the terminal; empty if none of them is known.

    An example is "battery 11.3 → 11.5 V; mean motor output 58 → 62 %; wind 3.2 (2.5 to 3.9) → below 2.8 m/s.".

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
    are_single_flights = max(reviewed.difference.flights) == 1
    voltages = (_cell(before.voltage, 1), _cell(after.voltage, 1))
    motor_outputs = (_percent_cell(before.collective), _percent_cell(after.collective))
    rows = [
        ConditionRow(BATTERY, "V", voltages),
        ConditionRow(MOTOR_OUTPUT, "%", motor_outputs),
        *(wind_rows(reviewed.reviews) if are_single_flights else _wind_rows_of_fleets(reviewed)),
        ConditionRow("mean roll and pitch", "°", (_lean_cell(before), _lean_cell(after))),
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


def _wind_rows_of_fleets(reviewed: ReviewedDifference) -> list[ConditionRow]:
    """Returns a row with the range of the wind speeds of the flights of each side, m/s, and in how many it is known.

    Args:
        reviewed: comparison of two states, one or both of several flights.
    """
    cells = []
    states = zip(reviewed.difference.conditions, reviewed.difference.flights, strict=True)
    for conditions, flight_count in states:
        speeds = conditions.wind_speeds
        if not speeds:
            cells.append(UNKNOWN_FIGURE)
            continue
        speed_range = " to ".join(dict.fromkeys((f"{speeds[0]:.1f}", f"{speeds[-1]:.1f}")))
        is_known_of_all = len(speeds) == flight_count
        cells.append(
            speed_range
            if is_known_of_all
            else f"{speed_range} ({len(speeds)} of {flight_count} flights)"
        )
    before, after = cells
    return [ConditionRow(WIND, "m/s", (before, after))]


def wind_rows(reviews_by_side: Mapping[str, Review]) -> list[ConditionRow]:
    """Returns two rows of a table of both flights: the wind speed, and the direction that the wind comes from.

    Each value has its 90 % interval.

    Args:
        reviews_by_side: review documents of the two logs that are compared, by side, "A" and "B". In a comparison of
            two fleets it is empty, since wind belongs to a single flight.
    """
    winds = []
    bounds = []
    for side in STATE_NAMES:
        # A missing review or wind is empty: then the cells say that the wind is not known.
        review = reviews_by_side.get(side) or {}
        winds.append(review.get("wind") or {})
        bounds.append(value_at(review, f"lights.{Light.WIND}.figures.reason") or {})
    before, after = winds
    bounds_before, bounds_after = bounds
    speeds = (_wind_speed_cell(before, bounds_before), _wind_speed_cell(after, bounds_after))
    return [
        ConditionRow(WIND, "m/s", speeds),
        ConditionRow("wind from", "°", (_wind_direction_cell(before), _wind_direction_cell(after))),
    ]


def vibration_rows(reviewed: ReviewedDifference) -> list[ConditionRow]:
    """Returns the mean vibration in flight of each IMU that both logs have, along its axis that vibrates most.

    Args:
        reviewed: comparison of two states.

    Returns:
        A row for each IMU; where the logs have none in common, as fleets, one row of the first IMU.
    """
    lights_by_side = {}
    for side in STATE_NAMES:
        review = reviewed.reviews.get(side) or {}
        lights_by_side[side] = value_at(review, "lights.vibration") or {}
    vibrations_by_imu = vibrations_of_same_imu(lights_by_side)
    if not vibrations_by_imu:
        # Reviews without a common IMU, as of fleets, still have the vibration of the first IMU among the conditions.
        before, after = reviewed.difference.conditions
        cells = (_rounded_cell(before.vibration), _rounded_cell(after.vibration))
        return [ConditionRow("vibration of IMU 1", "m/s²", cells)]
    rows = []
    for imu, (first_vibration, second_vibration) in vibrations_by_imu.items():
        cells = (rounded(first_vibration), rounded(second_vibration))
        rows.append(ConditionRow(f"vibration of {imu}", "m/s²", cells))
    return rows


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
