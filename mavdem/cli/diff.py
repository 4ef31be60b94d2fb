"""``mavdem diff``: what changed of a vehicle between two flights, or two fleets, beyond its interval."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import click

from mavdem.analysis.figures import physical_values, wind_values
from mavdem.cli.commands import UNSUPPORTED
from mavdem.cli.options import no_option
from mavdem.cli.output import print_blocks, print_json, progress
from mavdem.cli.sources import refuse_link
from mavdem.dem import Learned
from mavdem.errors import NotLearnable, Unreadable
from mavdem.fleet.difference import vehicle_difference
from mavdem.fleet.row import AXIS_ORDER, OK, UNKNOWN, FlightRow
from mavdem.fleet.rows_of_log import rows_of_log
from mavdem.fleet.store import is_fleet, read_rows
from mavdem.report.flights import difference_blocks
from mavdem.report.numbers import listed

MAX_NAMED = 8  # vehicles in a sentence
REPORT, MODEL = "report.json", "model.json"  # of what `mavdem learn` writes, those with figures


@click.command("diff")
@click.argument("before", metavar="A", type=click.Path())
@click.argument("after", metavar="B", type=click.Path())
@click.option(
    "--vehicle",
    metavar="NAME",
    callback=no_option,
    help="Which vehicle, by its name in the fleet or, in a log with several, SYSTEM:COMPONENT.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document and nothing else.")
@click.pass_context
def diff_command(context: click.Context, before: str, after: str, vehicle: str | None, as_json: bool) -> None:
    """Reports what changed of a vehicle between A and B, and what stayed the same.

    A and B are each a log, a FLEET of `mavdem track`, or what `mavdem learn` wrote (its folder, report.json or
    model.json). Of a FLEET all flights of the vehicle count, and show how much one flight differs from the next; of
    single flights that is assumed, and said.

    \b
    Compared are, with their 90 % intervals:
      the share of each motor in the work of all
      the effect of each motor beside the others', and of all
      damping and lag of the motors

    A quantity changed if that is beyond chance for all quantities together (Holm, 5 %). Wind, battery and payload are
    conditions and no changes of the vehicle: they are reported, and widen the intervals.

    \b
    Examples:
      mavdem diff monday.tlog friday.tlog
      mavdem diff monday/report.json friday/report.json
      mavdem diff fleet_2025/ fleet_2026/ --vehicle px4-1a2b3c

    Exit codes: 0 compared, whatever changed; 1 nothing can be compared; 2 bad usage, or unreadable input.
    """
    first, second = (_rows(name, source, vehicle) for name, source in (("A", before), ("B", after)))
    if vehicle is None:
        first, second = _of_one_vehicle(first, second)
    found = vehicle_difference(first, second)
    if as_json:
        print_json({"a": before, "b": after, **found.as_dict()})
    else:
        print_blocks(difference_blocks(found))
    if not found.changes:
        context.exit(UNSUPPORTED)


def _rows(name: str, source: str, vehicle: str | None) -> list[FlightRow]:
    """The flights that A or B names; raises ``NotLearnable`` where there are none of this vehicle."""
    refuse_link(source)
    path = Path(source)
    if path.suffix == ".json" or (path / REPORT).is_file():
        return _learned_rows(path)
    if is_fleet(path):
        rows = read_rows(path)
        chosen = [row for row in rows if vehicle in (None, row.vehicle)]
        if {row.vehicle for row in chosen if row.status == OK} == {UNKNOWN}:
            raise NotLearnable(f"The logs of {name} do not say of which vehicle they are.", "Compare two logs by name.")
    else:
        with progress(f"Reading {source}", measured=False):
            rows = rows_of_log(path, source).rows
        # In a log it may be named by system and component, of which a row has the first.
        chosen = [
            row
            for row in rows
            if not vehicle or vehicle in (row.vehicle, f"{row.system}") or vehicle.partition(":")[0] == f"{row.system}"
        ]
    if not any(row.status == OK for row in chosen):
        reasons = sorted({row.status for row in chosen if row.status != OK})
        names = _names(rows)
        if vehicle is not None and names and not chosen:
            raise NotLearnable(f"{name} has no vehicle {vehicle}.", f"Choose one of: {names}.")
        raise NotLearnable(f"{name} has no flight with figures.", " ".join(reasons[:1]))
    return chosen


def _learned_rows(path: Path) -> list[FlightRow]:
    """A row an axis of what ``mavdem learn`` wrote: its folder, its report, or a model alone; raises ``Unreadable``."""
    file = path / REPORT if path.is_dir() else path
    try:
        text = file.read_text()
        report = json.loads(text)
        if "free_energy" in report and "physical" not in report:
            learned = Learned.from_json(text)
            record = learned.record
            report = {"inputs": record.input_names, "outputs": record.output_names}
            report |= {"flight": {"scale": {"unit": next(iter(record.input_units), None)}}}
            report |= {"physical": physical_values(learned.physical), "wind": wind_values(learned.wind)}
        if "physical" not in report:
            raise ValueError("no figures of a vehicle")
        source = str((report.get("flight") or {}).get("source") or path)
        # With --axis all there are figures of each axis; those of the model are one of them.
        axes = {axis: values for axis in AXIS_ORDER[:2] if (values := (report.get("axes") or {}).get(axis))}
        figures = [(report | values, {"axis": axis}) for axis, values in axes.items()] or [(report, {})]
        return [FlightRow.of(document, file=source, key=str(path), **axis) for document, axis in figures]
    except (OSError, ValueError, TypeError, KeyError, AttributeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not of `mavdem learn`"
        raise Unreadable(f"{file} cannot be read ({reason}): name a {REPORT} or a {MODEL}.") from None


def _of_one_vehicle(first: Sequence[FlightRow], second: Sequence[FlightRow]) -> tuple[list[FlightRow], list[FlightRow]]:
    """Those of the one vehicle that each has or, where one has several, of the one that both have."""
    names = [{row.vehicle for row in rows if row.status == OK} for rows in (first, second)]
    if all(len(one) == 1 for one in names):
        return list(first), list(second)
    both = (names[0] & names[1]) - {UNKNOWN}
    if len(both) != 1:
        several = "A" if len(names[0]) > 1 else "B"
        what = "several" if both else "none"
        raise NotLearnable(
            f"{several} has several vehicles, of which {what} are in both.",
            f"Choose with --vehicle: {_names([*first, *second])}.",
        )
    (name,) = both
    return [row for row in first if row.vehicle == name], [row for row in second if row.vehicle == name]


def _names(rows: Sequence[FlightRow]) -> str:
    names = sorted({row.vehicle for row in rows if row.status == OK})
    more = [f"{len(names) - MAX_NAMED} more"] if len(names) > MAX_NAMED else []
    return listed([*names[:MAX_NAMED], *more])
