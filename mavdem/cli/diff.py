"""``mavdem diff``: what changed of a vehicle between two flights, or two fleets, beyond its interval."""

from pathlib import Path

import click

from mavdem.assessment import Assessment
from mavdem.cli.commands import UNSUPPORTED
from mavdem.cli.options import file_option, json_option, refuse_link
from mavdem.cli.output import check_folder, files_in, print_result, progress, say_aside
from mavdem.errors import NotLearnable
from mavdem.facts.fleet import Incomparable
from mavdem.fleet.difference import changed_parameters, vehicle_difference
from mavdem.fleet.row import UNKNOWN, FlightRow, FlightRows, flights_of
from mavdem.fleet.rows_of_log import rows_of_log
from mavdem.fleet.store import is_fleet, read_rows
from mavdem.heading import Values
from mavdem.ingest import read_log
from mavdem.ingest.telemetry import Parameters
from mavdem.report.blocks import Sentence
from mavdem.report.difference import difference_blocks
from mavdem.report.difference_page import comparison_page

PAGE = "diff.html"


@click.command("diff")
@click.argument("before", metavar="A", type=click.Path())
@click.argument("after", metavar="B", type=click.Path())
@click.option(
    "--vehicle",
    metavar="NAME",
    help="Which vehicle, by its name in the fleet or, in a log with several, SYSTEM:COMPONENT.",
)
@file_option("--out", "Folder for the page diff.html.  [default: named after A and B]")
@json_option
@click.pass_context
def diff_command(
    context: click.Context,
    before: str,
    after: str,
    vehicle: str | None,
    out: Path | None,
    as_json: bool,
) -> None:
    """Reports what changed between A and B, and what did not.

    A and B are each a log, or a FLEET of `mavdem track`.
    Of a FLEET all flights of the vehicle count, and show how much one flight differs from the next; of
    single flights that is assumed, and said.

    Compared are each motor's share of the work and its control effectiveness, rate damping and motor time constant. A
    quantity changed if that is beyond chance for all together (Holm, 5 %). Wind, battery and payload are conditions:
    they widen the intervals.

    \b
    Examples:
      mavdem diff monday.tlog friday.tlog
      mavdem diff fleet_2025/ fleet_2026/ --vehicle px4-1a2b3c

    A page shows both over each other: step responses, spectra, margins, motors, wind and parameters.

    Exit codes: 0 compared, whatever changed; 1 nothing can be compared; 2 bad usage, or unreadable input.
    """
    folder = out or Path(f"{Path(before).stem}_and_{Path(after).stem}")
    check_folder(folder)
    reviews = {"A": Values(), "B": Values()}
    first, second = (
        _rows(name, source, vehicle, reviews[name])
        for name, source in (("A", before), ("B", after))
    )
    names, others = ({row.vehicle for row in rows if row.is_read} for rows in (first, second))
    if vehicle is None and max(len(names), len(others)) > 1:
        both = (names & others) - {UNKNOWN}
        if len(both) != 1:
            several = Incomparable.NO_COMMON_VEHICLE
            raise NotLearnable(several, shared=len(both), names=sorted(names | others))
        first, second = ([row for row in rows if row.vehicle in both] for rows in (first, second))
    difference = vehicle_difference(first, second)
    parameters = changed_parameters(_parameters(before, first[0]), _parameters(after, second[0]))
    headlines = {"a": latest_headline(first), "b": latest_headline(second)}
    document = {"a": before, "b": after, "parameters": parameters, **difference.as_dict()}
    first_said = [Sentence(said, f"{name.upper()}:") for name, said in headlines.items() if said]
    blocks = difference_blocks(difference, parameters)
    with files_in(folder, [PAGE]) as (path,):
        called = Path(before).name, Path(after).name
        page = comparison_page(called, (reviews["A"], reviews["B"]), difference, parameters)
        path.write_text(page, "utf-8", "replace")
    say_aside(f"The page is {folder / PAGE}.")
    print_result(document | {"headlines": headlines}, [*first_said, *blocks], as_json)
    if not difference.changes:
        context.exit(UNSUPPORTED)


def _parameters(source: str, row: FlightRow) -> Parameters:
    """Those of the vehicle of a ``row`` in a log; none of other sources."""
    path = Path(source)
    if not path.is_file():
        return {}
    return next(
        vehicle.parameters
        for vehicle in read_log(path).vehicles
        if (vehicle.system, vehicle.component) == (row.system, row.component)
    )


def latest_headline(rows: FlightRows) -> str | None:
    """Returns the headline of the latest flight among ``rows`` that has one."""
    *_, latest = [None, *(row.headline for flight in flights_of(rows) for row in flight)]
    return latest


def _rows(name: str, source: str, vehicle: str | None, review: Values) -> FlightRows:
    """The flights that A or B names, of one of which ``review`` becomes the document.

    Raises ``NotLearnable`` where there are none of this vehicle.
    """
    refuse_link(source)
    path = Path(source)
    if is_fleet(path):
        rows = read_rows(path)
        chosen = [row for row in rows if vehicle in (None, row.vehicle)]
        if {row.vehicle for row in chosen if row.is_read} == {UNKNOWN}:
            raise NotLearnable(Incomparable.VEHICLES_UNKNOWN, subject=name)
    else:
        with progress(f"Reading {source}", measured=False):

            def keep(_: str, assessment: Assessment) -> str:
                review.update(assessment.as_dict())
                return ""

            rows, _ = rows_of_log(path, source, keep)
        # In a log it may be named by system and component, of which a row has the first.
        system = "" if vehicle is None else vehicle.partition(":")[0]
        chosen = [
            row for row in rows if vehicle in (None, row.vehicle) or system == str(row.system)
        ]
    if not any(row.is_read for row in chosen):
        names = {row.vehicle for row in rows if row.is_read}
        if vehicle is not None and names and not chosen:
            lacks = Incomparable.VEHICLE_MISSING
            raise NotLearnable(lacks, subject=name, name=vehicle, names=sorted(names))
        because = min((row.status for row in chosen), default=None)
        raise NotLearnable(Incomparable.NO_FLIGHT, subject=name, because=because)
    return chosen
