"""Which flights are compared: the log, the vehicle and the date of each side."""

from collections.abc import Mapping
from datetime import datetime

from mavdem.containers import JsonValues
from mavdem.fleet.comparability import STATE_NAMES
from mavdem.fleet.report_columns import value_at
from mavdem.report.difference.identity import shown_vehicles
from mavdem.report.difference.reviewed import ReviewedDifference
from mavdem.report.numbers import counted, listed

ISO_DAY_LENGTH = len("2026-01-31")
"""Characters of the date in a time in UTC, as documents have it."""

ISO_MINUTE_LENGTH = len("2026-01-31T10:00")
"""Characters of date, hour and minute in a time in UTC, as documents have it."""

MINUTES_OF_UNITS = {"year": 525_960, "day": 1440, "hour": 60}
"""Minutes of the units in which a time between two flights is stated that has two of them, the longest first."""


def side_descriptions(names: tuple[str, str], reviewed: ReviewedDifference) -> dict[str, str]:
    """Describes the flights of each side of a comparison in one line.

    An example is "monday.bin, Quadrotor 3A0041…2B37, simulated, 2026-01-05 10:00 UTC, 85 s of settled flight". The date
    of B is followed by how long it was flown after A, or before it.

    Args:
        names: names of the logs or fleets, A and B.
        reviewed: comparison of the two states, beside the reviews of their logs.

    Returns:
        The descriptions by side, "A" and "B".
    """
    descriptions = {}
    states = zip(STATE_NAMES, names, reviewed.difference.flights, strict=True)
    for side, name, log_count in states:
        review: Mapping[str, JsonValues] = reviewed.reviews.get(side, {})
        parts = [name, listed(shown_vehicles(reviewed, side))]
        if side in reviewed.simulated_sides:
            parts.append("simulated")
        if log_count > 1:
            parts.append(counted(log_count, "log") + " (figures are their means)")
            days_text = _days_text(review)
            # A name with the chosen days may have them already.
            if days_text and days_text not in name:
                parts.append(f"flown {days_text}")
        else:
            parts += _date_texts(side, reviewed)
        settled_seconds = value_at(review, "condition.hover.seconds")
        if settled_seconds:
            parts.append(f"{settled_seconds:.0f} s of settled flight")
        known_parts = [part for part in parts if part]
        descriptions[side] = ", ".join(known_parts)
    return descriptions


def _date_texts(side: str, reviewed: ReviewedDifference) -> list[str]:
    """Returns when the flight of a side began, such as "2026-01-05 10:00 UTC"; for B also how long after A that was.

    Args:
        side: "A" or "B".
        reviewed: comparison of the two states, beside the reviews of their logs.

    Returns:
        The texts; empty if the date is not known.
    """
    texts = []
    date = value_at(reviewed.reviews.get(side, {}), "identity.date")
    if date:
        minute = str(date)[:ISO_MINUTE_LENGTH].replace("T", " ")
        texts.append(f"{minute} UTC")
    time_text = time_from_a_to_b(reviewed)
    if side == STATE_NAMES[-1] and time_text:
        texts.append(time_text)
    return texts


def _days_text(review: Mapping[str, JsonValues]) -> str:
    """Returns the days of several flights, such as "2026-01-05 to 2026-01-11"; empty where they are not known."""
    first_date = value_at(review, "identity.first_date")
    last_date = value_at(review, "identity.date")
    if not first_date or not last_date:
        return ""
    first_day = str(first_date)[:ISO_DAY_LENGTH]
    last_day = str(last_date)[:ISO_DAY_LENGTH]
    return first_day if first_day == last_day else f"{first_day} to {last_day}"


def time_from_a_to_b(reviewed: ReviewedDifference) -> str:
    """Returns how long after or before A flight B began, such as "12 days after A" or "25 minutes before A".

    Args:
        reviewed: comparison of the two states, beside the reviews of their logs.

    Returns:
        The text. It is empty if a side has several flights, if a date is not known, or if both are within a minute.
    """
    dates = [value_at(reviewed.reviews.get(side, {}), "identity.date") for side in STATE_NAMES]
    if max(reviewed.difference.flights) > 1 or not all(dates):
        return ""
    first_date, second_date = (datetime.fromisoformat(str(date)) for date in dates)
    minutes = (second_date - first_date).total_seconds() / 60
    order = "after A" if minutes > 0 else "before A"
    for unit, unit_minutes in MINUTES_OF_UNITS.items():
        count = round(abs(minutes) / unit_minutes)
        if count > 1:
            return f"{counted(count, unit)} {order}"
    whole_minutes = round(abs(minutes))
    return f"{counted(whole_minutes, 'minute')} {order}" if whole_minutes else ""
