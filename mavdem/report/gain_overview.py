"""The gains of all axes at a glance: the table with which a page of ``mavdem tune`` begins."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from types import MappingProxyType
from typing import NamedTuple

from mavdem.containers import Names
from mavdem.dataset.signals import Signals
from mavdem.ingest.telemetry import Parameters
from mavdem.loops.autopilot_parameters import GainNames
from mavdem.loops.controllers import gain_names
from mavdem.report.blocks import Sentence, Table
from mavdem.report.gain_changes import GainChanges, NewValue
from mavdem.report.templates import render_section

RATE_GAIN_HEADERS = {
    "P": "rate P",
    "I": "rate I",
    "D": "rate D",
    "FF": "rate FF",
    "D_FF": "rate D_FF",
    "K": "rate K",
}
"""Columns of the gains of the rate controller, by the end of the parameter's name, such as ATC_RAT_RLL_P."""

ANGLE_GAIN_HEADER = "angle P"
"""Column of the gain of the attitude controller, which is the last one."""

OPTIONAL_HEADERS = ("rate FF", "rate D_FF")
"""Columns of gains that most vehicles do not use: a controller without feed-forward has 0 there."""

NO_OUTCOMES: Mapping[str, str] = MappingProxyType({})
"""The outcomes of axes of which nothing was decided."""


class GainCell(NamedTuple):
    """One gain of one axis."""

    header: str
    """Header of its column."""

    name: str
    """Name of the autopilot's parameter."""

    present: str
    """Value in the log; empty if the log does not have it."""

    new: NewValue | None
    """Value to set; None if the gain stays, also if another flight is to confirm a value that was tried."""

    @property
    def is_to_be_loaded(self) -> bool:
        """Whether the gain changes before the next flight, and not only in a later one."""
        return self.new is not None and not self.remark

    @property
    def remark(self) -> str:
        """Text behind a new value that is loaded after further flights, such as "stage 2"; empty behind any other."""
        if self.new is None or self.new.later_stage is None:
            return ""
        return f"stage {self.new.later_stage:d}"


class GainOverview(NamedTuple):
    """The gains of some axes as a table: a row for each axis, with the present and any new value of each gain."""

    headers: Names
    """Header of each column after the name of the axis. A gain that the log has of no axis has no column."""

    rows: Mapping[str, tuple[GainCell, ...]]
    """The gains of each axis, one for each header."""

    outcomes: Mapping[str, str] = MappingProxyType({})
    """What becomes of the gains of each axis, such as "new gains"; an axis without an entry has none."""

    other_changes: Table | None = None
    """Parameters to set that are no gains, such as those of a notch filter; None without any."""

    @property
    def has_gains_to_load(self) -> bool:
        """Whether a gain is to be set before the next flight."""
        return any(cell.is_to_be_loaded for cell in self.cells)

    @property
    def table_rows(self) -> Mapping[str, tuple[GainCell, ...]]:
        """The rows that a page shows as a table, by axis.

        They are those of the axes with a gain to load. The other axes have sentences then
        (:attr:`sentences_on_other_rows`). If no axis has a new gain, the table has all rows.
        """
        rows_with_new_gain = {}
        for axis, row in self.rows.items():
            if any(cell.new is not None for cell in row):
                rows_with_new_gain[axis] = row
        return rows_with_new_gain or self.rows

    @property
    def sentences_on_other_rows(self) -> list[Sentence]:
        """A sentence on each axis that is not in the table: what becomes of its gains, and their values in the log."""
        sentences = []
        for axis in self.rows:
            if axis not in self.table_rows:
                sentences += self.sentences_on_axis(axis, self.outcomes.get(axis, ""))
        return sentences

    def sentences_on_axis(self, axis: str, outcome: str = "") -> list[Sentence]:
        """Returns the values that the gains of an axis have in the log, in a sentence.

        Args:
            axis: "roll", "pitch" or "yaw".
            outcome: what becomes of these gains, with which the sentence begins; empty where the reader knows it.

        Returns:
            A list with the sentence; empty for an axis without a row.
        """
        if axis not in self.rows:
            return []
        return render_section("gains_of_axis", axis=axis, cells=self.rows[axis], outcome=outcome)

    @property
    def cells(self) -> Iterator[GainCell]:
        """The gains of all axes."""
        for row in self.rows.values():
            yield from row


def gain_overview(
    signals_by_axis: Mapping[str, Signals],
    changes: GainChanges | None,
    outcomes: Mapping[str, str] = NO_OUTCOMES,
) -> GainOverview | None:
    """Returns the table of the gains of some axes, with their present values in the log and any new values to set.

    Args:
        signals_by_axis: logged time series of the vehicle by axis, with its parameters.
        changes: parameters to set; None if none are.
        outcomes: what becomes of the gains of each axis, in words.

    Returns:
        The table, also if the log lacks other parameters of the controller; None if it has no gain of any of these
        axes.
    """
    new_values = {}
    if changes is not None:
        for name, new_value in changes.new_values.items():
            if not new_value.is_tried:
                new_values[name] = new_value
    rows = {}
    for axis, signals in signals_by_axis.items():
        parameters = signals.telemetry.parameters
        names = gain_names(parameters, axis)
        if names is None:
            continue
        cells = tuple(_gains_of_axis(names, parameters, new_values))
        has_logged_gain = any(cell.present for cell in cells)
        if has_logged_gain:
            rows[axis] = cells
    if not rows:
        return None
    return _overview_of_used_gains(rows, changes)._replace(outcomes=outcomes)


def _overview_of_used_gains(
    rows: Mapping[str, tuple[GainCell, ...]], changes: GainChanges | None
) -> GainOverview:
    """Returns the table of the gains that the log has of at least one axis; other gains have no column.

    ArduPilot, for example, has no gain "rate K". A feed-forward that is 0 and stays 0 on all axes has no column either.

    Args:
        rows: all possible gains of each axis, in the order of the columns.
        changes: parameters to set, some of which may be no gains; None if none are.
    """
    all_cells = [cell for row in rows.values() for cell in row]
    logged_headers = set()
    for cell in all_cells:
        is_unused = cell.header in OPTIONAL_HEADERS and cell.present == "0" and cell.new is None
        if cell.present and not is_unused:
            logged_headers.add(cell.header)
    names_in_table = {cell.name for cell in all_cells if cell.header in logged_headers}
    shown_rows = {}
    for axis, row in rows.items():
        shown_rows[axis] = tuple(cell for cell in row if cell.header in logged_headers)
    all_headers = (*RATE_GAIN_HEADERS.values(), ANGLE_GAIN_HEADER)
    shown_headers = tuple(header for header in all_headers if header in logged_headers)
    other_changes = _table_of_other_changes(changes, names_in_table)
    return GainOverview(shown_headers, shown_rows, other_changes=other_changes)


def _gains_of_axis(
    names: GainNames, parameters: Parameters, new_values: Mapping[str, NewValue]
) -> Iterator[GainCell]:
    """Yields a cell for each gain that a controller of one axis may have, in the order of the columns.

    Args:
        names: how the autopilot names the gains of the axis.
        parameters: parameters of the log, by the autopilot's name; a gain without one has an empty present value.
        new_values: value to set by the name of the parameter.
    """
    headers_by_name = {
        names.rate_prefix + ending: header for ending, header in RATE_GAIN_HEADERS.items()
    }
    headers_by_name[names.angle_gain] = ANGLE_GAIN_HEADER
    for name, header in headers_by_name.items():
        value = parameters.get(name)
        present = "" if value is None else f"{value:.4g}"
        yield GainCell(header, name, present, new_values.get(name))


def _table_of_other_changes(
    changes: GainChanges | None, names_in_table: Iterable[str]
) -> Table | None:
    """Returns a table of the parameters to set that the table of gains does not have, such as those of a notch filter.

    Args:
        changes: parameters to set; None if none are.
        names_in_table: names of the parameters in the table of gains.

    Returns:
        The rows of ``changes`` with parameters of other names; None if there are none.
    """
    if changes is None:
        return None
    rows = []
    for table in changes.tables:
        rows += [row for row in table.rows if row[0] not in names_in_table]
    return Table(["parameter", "now", "set", "times"], rows) if rows else None
