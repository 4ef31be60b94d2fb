"""``mavdem track``: a table of many flights, and of what changed from one to the next."""

from pathlib import Path

import click

from mavdem.cli.exit_codes import EXIT_ERROR, EXIT_UNSUPPORTED
from mavdem.cli.options import NumberRange, jobs_option, json_option
from mavdem.cli.output import print_blocks, print_json, progress
from mavdem.cli.sources import refuse_link
from mavdem.cli.streams import print_to_stderr, print_to_stdout
from mavdem.containers import Names
from mavdem.dem.parallel import available_workers
from mavdem.documents.fleet import track_document
from mavdem.extras import missing_extra_fact
from mavdem.fleet.cluster import Cluster
from mavdem.fleet.difference import baseline_differences
from mavdem.fleet.flights import summary
from mavdem.fleet.rows_of_log import rows_of_log
from mavdem.fleet.store import read_rows
from mavdem.fleet.tracking import track
from mavdem.fleet.workers import JobLimits, WorkerPool
from mavdem.report.blocks import Sentence
from mavdem.report.difference import baseline_blocks
from mavdem.report.fleet import fleet_blocks
from mavdem.report.numbers import counted
from mavdem.report.pages.flight_page import flight_page
from mavdem.results import write_fleet_pages

MOST = 1_000_000  # seconds and megabytes that may be asked for: days, and a terabyte


@click.command("track")
@click.argument("logs", nargs=-1, required=True)
@click.option(
    "--out",
    "out",
    required=True,
    metavar="FLEET",
    type=click.Path(file_okay=False, path_type=Path),
    help="Folder of the fleet; further logs are added to it.",
)
@click.option(
    "--baseline",
    multiple=True,
    metavar="LOGS|FLEET",
    help="Healthy flights that the others are compared with: logs, as above, or another FLEET; may be repeated. "
    "[default: those of the last run; at first the vehicle's own flights]",
)
@jobs_option
@click.option(
    "--scheduler",
    metavar="tcp://HOST:PORT",
    help="Read them on this Dask cluster instead.",
)
@click.option(
    "--time-limit",
    type=NumberRange(1, MOST),
    default=JobLimits().seconds,
    show_default=True,
    help="Seconds of the processor that one log may take.",
)
@click.option(
    "--memory-limit",
    type=click.IntRange(256, MOST),
    default=JobLimits().megabytes,
    show_default=True,
    help="Memory in MB that the reading of one log may take.",
)
@json_option
@click.pass_context
def track_command(
    context: click.Context,
    logs: Names,
    out: Path,
    baseline: Names,
    jobs: int | None,
    scheduler: str | None,
    time_limit: float,
    memory_limit: int,
    as_json: bool,
) -> None:
    """Keeps a table of many flights, with the health of each vehicle.

    LOGS are logs, folders, patterns in quotes, and URLs: s3://, gs://, https://. Each flight gets a row for each
    vehicle and axis (roll, pitch). A log that says nothing has a row with the reason in its column `status`. Known logs
    are not read again, and a killed run goes on where it was.

    \b
    FLEET has:
      index.html    what was found; open it in a browser
      pages/        a page a flight
      flights/      the table, as Parquet, where pyarrow is installed
      fleet.sqlite  which logs are known, and what each says and cost to read

    \b
    Examples:
      mavdem track flights/ --out fleet
      mavdem track 'logs/**/*.bin' --out fleet --baseline logs/new_propellers/
      mavdem track s3://bucket/logs/ --out fleet --scheduler tcp://10.0.0.1:8786
      duckdb -c "select vehicle, date, health from 'fleet/flights/**/*.parquet' where axis = 'roll'"

    Exit codes: 0 done, whatever single logs held; 1 there is no flight in any of them; 2 a name that names no log, a
    known log that cannot be read now, or a folder that cannot be written to.
    """
    for name in logs:
        refuse_link(name)
    limits = JobLimits(time_limit, memory_limit)
    if scheduler is not None and jobs:
        refusal = "it is of this machine; with --scheduler the cluster has its own."
        raise click.BadParameter(refusal, param_hint="--jobs")
    reader = (
        Cluster(scheduler, limits, rows_of_log)
        if scheduler is not None
        else WorkerPool(jobs or available_workers(), limits, rows_of_log)
    )
    try:
        with progress("Reading logs") as bar:

            def show(done: int, of: int) -> None:
                bar(done / max(of, 1))

            tracked = track(out, logs, reader, baseline, flight_page, progress=show)
    except KeyboardInterrupt:
        print_to_stderr("What was read is kept: the same command goes on.")
        raise
    rows = read_rows(out)
    counts = summary(rows)
    changes = baseline_differences(rows, tracked.healthy) if tracked.healthy else {}
    since = {name: baseline_blocks(*change) for name, change in changes.items()}
    index = write_fleet_pages(out, rows, since)
    for problem in tracked.problems:
        print_to_stderr(f"mavdem: {problem.advised}")
    if as_json:
        print_json(track_document(out, index, tracked, counts, changes))
    else:
        print_to_stdout(
            f"{counted(tracked.logs, 'log')}, {tracked.read} of them read; copies count once.\n"
        )
        print_blocks(fleet_blocks(rows))
        for name, blocks in since.items():
            print_blocks([Sentence("", f"{name}:"), *blocks])
        print_to_stderr(f"Look: {index}")
        table = f"{out}/flights/**/*.parquet".replace("'", "''")  # as SQL quotes it
        hint = missing_extra_fact(
            "parquet", f"{out}/flights/, the table for DuckDB, Polars and pandas,"
        )
        print_to_stderr(hint or f"Query, for example in DuckDB: from '{table}'")
    if tracked.problems:
        context.exit(EXIT_ERROR)
    if not counts["flights"]:
        context.exit(EXIT_UNSUPPORTED)
