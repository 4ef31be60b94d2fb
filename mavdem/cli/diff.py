"""``mavdem diff``: what changed of a vehicle between two flights, or two fleets, beyond its interval."""

from pathlib import Path

import click

from mavdem.cli.options import file_option, json_option, refuse_link
from mavdem.cli.output import (
    UNSUPPORTED,
    check_folder,
    files_in,
    json_text,
    print_result,
    progress,
    say_aside,
)
from mavdem.cli.results import free_folder
from mavdem.documents.fleet import Diff
from mavdem.fleet.difference import (
    STATE_NAMES,
    changed_parameters,
    states_without_gains,
    vehicle_difference,
)
from mavdem.fleet.state import of_common_vehicle, state_of
from mavdem.report.difference import difference_blocks, headline_blocks, next_blocks
from mavdem.report.pages.difference_page import comparison_page

PAGE = "diff.html"
DOCUMENT = "diff.json"


@click.command("diff")
@click.argument("before", metavar="A", type=click.Path())
@click.argument("after", metavar="B", type=click.Path())
@click.option(
    "--vehicle",
    metavar="NAME",
    help="Which vehicle, by its name in the fleet or, in a log with several, SYSTEM:COMPONENT.",
)
@file_option("--out", "Folder for diff.html and diff.json. [default: named after A and B]")
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
    folder = out or free_folder(
        f"{Path(before).stem}_and_{Path(after).stem}", DOCUMENT, {"a": before, "b": after}
    )
    check_folder(folder, (PAGE, DOCUMENT), before, after)
    states = []
    for name, source in zip(STATE_NAMES, (before, after), strict=True):
        refuse_link(source)
        with progress(f"Reading {source}", measured=False):
            states.append(state_of(name, Path(source), vehicle))
    first, second = states if vehicle else of_common_vehicle(*states)
    difference = vehicle_difference(first.rows, second.rows)
    parameters = changed_parameters(first.parameters, second.parameters)
    lacking = states_without_gains(first.parameters, second.parameters)
    headlines = {"a": first.headline, "b": second.headline}
    document = Diff.gather(
        difference, a=before, b=after, parameters=parameters, headlines=headlines
    )
    with files_in(folder, [PAGE, DOCUMENT]) as (path, place):
        place.write_text(json_text(document))
        called = Path(before).name, Path(after).name
        page = comparison_page(
            called, (first.review, second.review), difference, parameters, lacking
        )
        path.write_text(page, "utf-8", "replace")
    say_aside(f"The page is {folder / PAGE}.")
    said = [*headline_blocks(headlines), *difference_blocks(difference, parameters, lacking)]
    print_result(document, [*said, *next_blocks(difference)], as_json)
    if not difference.changes:
        context.exit(UNSUPPORTED)
