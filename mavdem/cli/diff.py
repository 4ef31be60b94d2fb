"""``mavdem diff``: what changed of a vehicle between two flights, or two fleets, beyond its interval."""

from pathlib import Path

import click

from mavdem.cli.exit_codes import EXIT_UNSUPPORTED
from mavdem.cli.options import file_option, json_option
from mavdem.cli.output import json_text, print_result, progress
from mavdem.cli.output_files import check_output_folder, replaced_files
from mavdem.cli.result_folders import available_folder
from mavdem.cli.sources import refuse_link
from mavdem.cli.streams import print_to_stderr
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
    folder = out or available_folder(
        f"{Path(before).stem}_and_{Path(after).stem}", DOCUMENT, {"a": before, "b": after}
    )
    check_output_folder(folder, (PAGE, DOCUMENT), before, after)
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
    with replaced_files(folder, [PAGE, DOCUMENT]) as (path, place):
        place.write_text(json_text(document))
        called = Path(before).name, Path(after).name
        page = comparison_page(
            called, (first.review, second.review), difference, parameters, lacking
        )
        path.write_text(page, "utf-8", "replace")
    print_to_stderr(f"The page is {folder / PAGE}.")
    said = [*headline_blocks(headlines), *difference_blocks(difference, parameters, lacking)]
    print_result(document, [*said, *next_blocks(difference)], as_json)
    if not difference.changes:
        context.exit(EXIT_UNSUPPORTED)
