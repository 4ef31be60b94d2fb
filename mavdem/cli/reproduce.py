"""``mavdem reproduce``: the experiments of the paper, run again, and a report on which of its claims hold."""

from pathlib import Path
from time import perf_counter

import click

from mavdem.cli.options import json_option
from mavdem.cli.output import json_text, print_json, print_result, progress
from mavdem.cli.output_files import check_output_folder
from mavdem.cli.streams import print_to_stdout
from mavdem.containers import Names
from mavdem.dem.parallel import available_workers, process_pool
from mavdem.experiments.paper import CLAIMS
from mavdem.extras import require_extra
from mavdem.files import reporting_write_errors
from mavdem.report.blocks import Blocks, Table, markdown


@click.command("reproduce")
@click.argument(
    "names", metavar="[ITEM]...", nargs=-1, type=click.Choice([claim.name for claim in CLAIMS])
)
@click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path("build/paper"),
    show_default=True,
    help="Folder for the report.",
)
@click.option(
    "--flights",
    "flights_folder",
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    metavar="FOLDER",
    help="Folder with recorded flights of the AR.Drone (.mat), examined beside the simulated ones.",
)
@json_option
@click.option(
    "--markdown", "as_markdown", is_flag=True, help="Print findings and tables in Markdown."
)
@click.option("--list", "as_list", is_flag=True, help="List the items, one a line, the name first.")
def reproduce_command(
    names: Names,
    out: Path,
    flights_folder: Path | None,
    as_json: bool,
    as_markdown: bool,
    as_list: bool,
) -> None:
    """Runs the paper's experiments again and checks its claims.

    ITEM is a name from --list; all items run unless some are named, which takes some minutes on two cores. The report
    is a folder with the page index.html and its figures, and numbers.json.

    The paper's vehicle was really flown in wind: the flights of Bos et al., "Free Energy Principle for State and Input
    Estimation of a Quadcopter Flying in Wind", are at github.com/FreddyBos97/DEM_Drone_in_wind. --flights reads them.
    The items states and inputs run the experiments of Bos et al. themselves, covariance those of Anil Meera and
    Lanillos on noise variances.

    \b
    Examples:
      mavdem reproduce --list
      mavdem reproduce noise prediction --out build/paper
      mavdem reproduce benchmark --flights DEM_Drone_in_wind
      mavdem reproduce states --markdown > states.md
    """
    if as_list:
        _list_claims(as_json=as_json)
        return
    require_extra("plot", "`mavdem reproduce`")
    # The experiments take a second to import, and need not be imported for the list.
    from mavdem.experiments.paper.flights import read_ardrone_folder
    from mavdem.experiments.paper.report import ITEMS, NUMBERS, PAGE, ItemReport, document, write
    from mavdem.experiments.paper.runner import Runner

    check_output_folder(out, (PAGE, NUMBERS))
    recorded_flights = {} if flights_folder is None else read_ardrone_folder(flights_folder)
    start_time = perf_counter()
    reports = []
    with process_pool(available_workers()) as executor:
        runner = Runner(executor, recorded_flights=recorded_flights)
        for claim, run_experiment in ITEMS.items():
            if names and claim.name not in names:
                continue
            with progress(claim.title) as show_fraction:
                runner.progress = show_fraction
                reports.append(ItemReport(claim, run_experiment(runner)))
        with progress("Writing the report", measured=False):
            seconds = perf_counter() - start_time
            with reporting_write_errors(out):
                write(out, reports, seconds)
                (out / NUMBERS).write_text(json_text(document(reports, seconds)) + "\n", "utf-8")
    if as_markdown and not as_json:
        findings: Blocks = []
        for report in reports:
            findings += report.findings()
        print_to_stdout(markdown(findings))
        return
    rows = [[report.claim.name, report.status.value, report.sentence] for report in reports]
    table = Table(["item", "status", "findings"], rows, words=True)
    print_result(document(reports, seconds), [table], as_json=as_json)
    if not as_json:
        print_to_stdout(f"Took {seconds:.0f} s. Written: {out / PAGE}")


def _list_claims(*, as_json: bool) -> None:
    """Prints the claims of the paper that can be checked, one a line with its name first, or as a JSON document."""
    if as_json:
        print_json({"claims": CLAIMS})
        return
    for claim in CLAIMS:
        print_to_stdout(f"{claim.name:14}  {claim.title} ({claim.section})")
