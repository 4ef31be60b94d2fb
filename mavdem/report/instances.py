"""The table of all instances of a vehicle's batteries, estimators, sensors and outputs."""

from collections.abc import Sequence

from mavdem.assessment.instances import Instance
from mavdem.report.blocks import Rated, Table
from mavdem.report.numbers import rounded
from mavdem.report.templates import without_full_stop

HEADER = ["instance", "used", "lowest", "highest", "quantity", "state"]
"""Header of the table."""

NO_BREAK_SPACE = "\N{NO-BREAK SPACE}"
"""Space at which no line ends."""

SHOWN_DIGITS = 3
"""Significant digits of the range: those of a battery's voltage."""


def instance_table(instances: Sequence[Instance]) -> Table:
    """Returns a table with a row for each instance: whether it is used, its range in flight, and its state.

    Args:
        instances: at least one, in the order of the rows.
    """
    rows = []
    for instance in instances:
        # A number and its unit stay on one line.
        unit = "" if instance.unit == "1" else f"{NO_BREAK_SPACE}{instance.unit}"
        rows.append(
            [
                instance.name,
                _used_text(instance.used_share),
                f"{rounded(instance.low, SHOWN_DIGITS)}{unit}",
                f"{rounded(instance.high, SHOWN_DIGITS)}{unit}",
                instance.quantity,
                Rated(without_full_stop(str(instance.state)), instance.state.level),
            ]
        )
    return Table(HEADER, rows, words=True)


def _used_text(used_share: float | None) -> str:
    """Returns "yes", "no" or the percentage of the time; empty where the log does not say it."""
    if used_share is None:
        return ""
    if used_share in (0.0, 1.0):
        return "yes" if used_share else "no"
    return f"{100 * used_share:.0f} %"
