"""``mavdem track``: a table of the flights of a fleet, and what changed from one flight of a vehicle to the next."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path, PurePath
from typing import TYPE_CHECKING

import click

from mavdem.cli.exit_codes import EXIT_ERROR, EXIT_UNSUPPORTED
from mavdem.cli.links import refuse_link
from mavdem.cli.options import NumberRange, WholeNumberRange, jobs_option, json_option
from mavdem.cli.output import print_blocks, print_json, progress, progress_bar
from mavdem.cli.streams import (
    escape_unprintable,
    print_to_stderr,
    print_to_stdout,
    stderr_is_terminal,
)
from mavdem.containers import Names
from mavdem.dem.parallel import available_workers
from mavdem.extras import missing_extra_fact
from mavdem.fleet.cluster import Cluster
from mavdem.fleet.judgement import judgement_lock
from mavdem.fleet.names import (
    content_hash,
    plain_name,
    store_flight_name,
    store_vehicle_name,
)
from mavdem.fleet.row import UNKNOWN, FlightRows
from mavdem.fleet.sources import find_logs
from mavdem.fleet.store import Store, open_store
from mavdem.fleet.stored_rows import (
    is_fleet,
    read_brief_rows,
    read_rows_of_logs,
)
from mavdem.fleet.tracking import TrackedLogs, track
from mavdem.fleet.workers import FunctionByName, JobLimits, JobOutcome, WorkerPool
from mavdem.fleet_pages import FleetPages, write_fleet_pages
from mavdem.ingest.formats import looks_like_log
from mavdem.report.blocks import Blocks, headline_sentence
from mavdem.report.fleet import vehicle_label
from mavdem.report.fleet_summary import fleet_blocks, fleet_counts, motor_health_by_vehicle
from mavdem.report.numbers import abbreviated_list, counted
from mavdem.report.templates import render_section

if TYPE_CHECKING:
    from mavdem.fleet.difference import BaselineDifferences

MAX_LIMIT = 1_000_000
"""Largest --time-limit in seconds, eleven days, and largest --memory-limit in MB, a terabyte.

More is no limit, so that a mistyped number is refused.
"""

MAX_EQUAL_FILES = 4
"""Most files with the same log that are named in one line; a choice."""

ROWS_OF_LOG = FunctionByName("mavdem.fleet.rows_of_log", "rows_of_log")
"""Reads a log, in another process: this one does not import what that takes, which is most of mavdem."""

FLIGHT_PAGE = FunctionByName("mavdem.report.pages.flight_page", "flight_page")
"""Makes the page of a flight, in the same process."""

BlocksByVehicle = dict[str, Blocks]
"""What changed since the baseline, as sentences, by the vehicle's name."""


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
    "'none' takes the baseline away. [default: those of the last run; at first the vehicle's own flights]",
)
@click.option(
    "--name",
    "given_names",
    multiple=True,
    metavar="WHAT=NAME",
    help="Name of a vehicle or a flight: WHAT is the vehicle's serial number as the table has it, or the file name of "
    "a log; the fleet keeps it. Nothing after = takes it away; may be repeated.",
)
@jobs_option
@click.option(
    "--scheduler",
    metavar="tcp://HOST:PORT",
    help="Read logs on this Dask cluster instead.",
)
@click.option(
    "--time-limit",
    type=NumberRange(1, MAX_LIMIT),
    default=JobLimits().seconds,
    show_default=True,
    help="Processor time that the reading of one log may take, in seconds.",
)
@click.option(
    "--memory-limit",
    type=WholeNumberRange(256, MAX_LIMIT),
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
    given_names: Names,
    jobs: int | None,
    scheduler: str | None,
    time_limit: float,
    memory_limit: int,
    as_json: bool,
) -> None:
    """Keeps a table of many flights, with the health of each vehicle.

    LOGS are logs, folders, patterns in quotes, and URLs: s3://, gs://, https://. Each flight gets a row for each
    vehicle and axis (roll, pitch). A log that says nothing has a row with the reason in its column `status`. Known logs
    are not read again, so that the same command continues a run that was killed.

    \b
    FLEET has:
      index.html    what was found; open it in a browser
      pages/        a page a flight
      flights/      the table, as Parquet, where pyarrow is installed
      fleet.sqlite  which logs are known, their results, and what it cost to read them

    \b
    Examples:
      mavdem track flights/ --out fleet
      mavdem track 'logs/**/*.bin' --out fleet --baseline logs/new_propellers/
      mavdem track flights/ --out fleet --name 'px4-1a2b3c=Red quad' --name 'log_7.ulg=First hover'
      mavdem track s3://bucket/logs/ --out fleet --scheduler tcp://10.0.0.1:8786
      duckdb -c "select vehicle, date, health from 'fleet/flights/**/*.parquet' where axis = 'roll'"

    Exit codes: 0 done, whatever single logs held; 1 there is no flight in any of them; 2 a name that names no log, a
    known log that cannot be read now, or a folder that cannot be written to.
    """
    # Reading may take hours, so that the arguments are checked before.
    for name in logs:
        refuse_link(name)
    for given_name in given_names:
        if "=" not in given_name:
            raise click.BadParameter(f"'{given_name}' has no = before a name.", param_hint="--name")
    _refuse_names_of_other_logs(out, logs, given_names)
    reader = _log_reader(jobs, scheduler, JobLimits(time_limit, memory_limit))
    try:
        tracked = _track_with_progress(out, logs, reader, baseline)
    except (KeyboardInterrupt, SystemExit):
        # A run that is stopped keeps the logs that it has read, and so the names of all that is known by then.
        with open_store(out) as store:
            _store_known_names(store, given_names)
        raise
    blocks_by_vehicle: BlocksByVehicle = {}
    # Pages are updated by rows that no other run judges meanwhile: else an older judgement might stay.
    with (
        progress("Writing pages", measured=False),
        open_store(out) as store,
        judgement_lock(out),
    ):
        differences: BaselineDifferences = {}
        if tracked.healthy:
            differences = _differences_from_baseline(out, tracked.healthy)
            blocks_by_vehicle = _blocks_of_differences(differences)
        unknown_name = _store_names(store, given_names)
        pages = write_fleet_pages(store, blocks_by_vehicle)
        copies = store.copies()
    counts = fleet_counts(pages.summaries)
    motor_health = motor_health_by_vehicle(pages.summaries)
    names = pages.names
    for problem in tracked.problems:
        print_to_stderr(f"mavdem: {problem.sentence_and_remedy}")
    if as_json:
        from mavdem.documents.fleet import track_document

        values = counts | {"motor_health": motor_health}
        print_json(track_document(out, pages.index, tracked, values, differences, names.vehicles))
    else:
        _print_fleet(
            tracked,
            pages,
            copies,
            differences,
            blocks_by_vehicle,
            has_new_baseline=bool(baseline),
        )
        _report_index_and_table(out, pages.index)
    if unknown_name is not None:
        # The serial number may belong to a log that had to be read first. What was read is stored and reported.
        message = f"'{unknown_name}' begins with no serial number and no log of this fleet; no name was given."
        raise click.BadParameter(message, param_hint="--name")
    if tracked.problems:
        context.exit(EXIT_ERROR)
    if not any(summary.flown.logs for summary in pages.summaries):
        context.exit(EXIT_UNSUPPORTED)


def _log_reader(jobs: int | None, scheduler: str | None, limits: JobLimits) -> Cluster | WorkerPool:
    """Returns what reads the logs: processes of this machine or, if it is named, a cluster of many machines.

    Args:
        jobs: Number of processes of this machine; None for one for each core.
        scheduler: Address of the cluster's Dask scheduler; None to read on this machine.
        limits: Time, s, and memory, MiB, that one log may take.

    Raises:
        click.BadParameter: Both a cluster and a number of processes are chosen.
    """
    if scheduler is None:
        return WorkerPool(jobs or available_workers(), limits, ROWS_OF_LOG)
    if jobs:
        raise click.BadParameter(
            "it is of this machine; with --scheduler the cluster has its own.",
            param_hint="--jobs",
        )
    return Cluster(scheduler, limits, ROWS_OF_LOG)


def _blocks_of_differences(differences: "BaselineDifferences") -> BlocksByVehicle:
    """Returns the text on how the latest flight of each vehicle differs from its healthy flights, by vehicle.

    Args:
        differences: Latest flight and difference of each vehicle. Vehicles without a difference, which cannot be
            compared, are left out.
    """
    # Only runs with a baseline need this module, so that it is imported here.
    from mavdem.report.difference.baseline import baseline_blocks

    blocks_by_vehicle = {}
    for vehicle, (latest_row, difference) in differences.items():
        if difference is not None:
            blocks_by_vehicle[vehicle] = baseline_blocks(latest_row, difference)
    return blocks_by_vehicle


def _differences_from_baseline(folder: Path, healthy: FlightRows) -> "BaselineDifferences":
    """Compares the latest flight of each vehicle of a fleet with the baseline, its flights that are healthy.

    Args:
        folder: Folder of the fleet, with its SQLite store, its table and its pages.
        healthy: Rows of the baseline.

    Returns:
        The differences by vehicle.
    """
    from mavdem.fleet.difference import baseline_differences, latest_flights
    from mavdem.fleet.flights import log_row

    # Brief rows, which are read fast, show which flights are the latest. Only these are then read with all columns.
    flights_by_vehicle = latest_flights(read_brief_rows(folder), healthy)
    latest_logs = {log_row(flight).file for flight in flights_by_vehicle.values()}
    return baseline_differences(read_rows_of_logs(folder, latest_logs), healthy)


def _track_with_progress(
    folder: Path, logs: Names, reader: Cluster | WorkerPool, baseline: Names
) -> TrackedLogs:
    """Updates the table of a fleet with logs, and shows the progress on standard error.

    The progress is a bar on a terminal, otherwise a line for each log.

    Args:
        folder: Folder of the fleet, with its SQLite store, its table and its pages.
        logs: Logs, folders, patterns and URLs.
        reader: Workers that read the logs, on this machine or on a cluster.
        baseline: Logs or a fleet of healthy flights; empty for those of the last run.

    Returns:
        The logs, how many of them were read now, the healthy flights and the problems.

    Raises:
        KeyboardInterrupt: The user has pressed Ctrl-C. Logs that were read stay in the table, as a message reports.
    """
    try:
        with progress_bar("Looking for logs") as show_bar:
            show_log = partial(_show_log, show_bar)
            return track(folder, logs, reader, baseline, FLIGHT_PAGE, progress=show_log)
    except KeyboardInterrupt:
        # Each log is stored as soon as it was read, so nothing is lost.
        print_to_stderr("What was read is kept: the same command continues.")
        raise


def _show_log(
    show_bar: Callable[[float, str], None], done: int, count: int, outcome: JobOutcome | None
) -> None:
    """Shows on standard error how many of the new logs are read: by a bar on a terminal, else by a line for each log.

    Args:
        show_bar: Function that shows a bar, filled by a fraction from 0 to 1, with a title beside it.
        done: Number of logs that are read.
        count: Number of logs to read; 0 if all are known already.
        outcome: Outcome of the log that was read last; None before the first.
    """
    if stderr_is_terminal():
        if done < count:
            show_bar(done / count, f"{done} of {counted(count, 'new log')} read")
        else:
            # All logs are read; what follows takes some seconds, during which the bar stays.
            show_bar(1.0, "Comparing flights")
    elif outcome is not None:
        print_to_stderr(f"{done} of {count}: {_outcome_line(outcome)}")
    elif count > 0:
        print_to_stderr(f"Reading {counted(count, 'new log')} …")


def _outcome_line(outcome: JobOutcome) -> str:
    """Returns one line about a log that was read for the fleet: its path and how long that took.

    The reason follows if the log has no flight, or was not read because the fleet has its content already.

    Args:
        outcome: Outcome of reading the log.

    Returns:
        The line, such as "flight.ulg, 1.2 s".
    """
    line = f"{outcome.path}, {outcome.seconds:.1f} s"
    # A copy of a log that the fleet has is recognized by its content, and not read.
    is_copy = outcome.ended == "known"
    if is_copy:
        return f"{line}: its content is known"
    has_flight = any(row.has_flight for row in outcome.rows)
    if has_flight:
        return line
    # The first row stands for the log; its status is the reason.
    reason = outcome.rows[0].status
    return f"{line}: {reason}"


def _refuse_names_of_other_logs(folder: Path, logs: Names, given_names: Names) -> None:
    """Refuses a name for a log that is neither in the fleet nor to be read, before the long reading begins.

    Args:
        folder: Folder of the fleet, which may not exist yet.
        logs: Files, folders, patterns and URLs of the logs to be read.
        given_names: Arguments of --name, see :func:`_store_name`.

    Raises:
        click.BadParameter: There is no such log. Serial numbers are not checked, since they are known only after the
            reading.
    """
    # What is named stands before "=": a log, or a serial number of a vehicle.
    log_names = []
    for given_name in given_names:
        subject = given_name.partition("=")[0]
        if looks_like_log(subject):
            log_names.append(subject)
    if not log_names:
        return
    known_names: set[str] = set()
    found_logs, _ = find_logs(logs, folder)
    for source in found_logs:
        known_names.update(_file_names(source.path))
    if is_fleet(folder):
        for row in read_brief_rows(folder):
            known_names.update(_file_names(row.file))
            known_names.add(row.vehicle)
    for name in log_names:
        if name not in known_names:
            raise click.BadParameter(f"there is no log {name}.", param_hint="--name")


def _is_subject_known(rows: FlightRows, given_name: str) -> bool:
    """Returns whether the fleet has the vehicle or the log to which the user gives a name by ``--name``.

    Args:
        rows: All rows of the fleet's table, one for each axis of each flight.
        given_name: Argument of --name: vehicle or file of a log, "=", and the name, see :func:`_store_name`.

    Returns:
        Whether the text before "=" is the name of a vehicle, or of the file of a log, in the table.
    """
    subject = given_name.partition("=")[0]
    return _is_vehicle(rows, subject) or bool(_content_hashes_of_log(rows, subject))


def _store_names(store: Store, given_names: Names) -> str | None:
    """Stores the names that the user gave to vehicles and flights of a fleet; an empty name deletes the former one.

    If one of the vehicles or flights is unknown, none of the names is stored.

    Args:
        store: The open SQLite store of the fleet, with the rows of all logs.
        given_names: Arguments of --name, see :func:`_store_name`.

    Returns:
        The first that names neither a vehicle nor a log of the fleet; None if all are known.
    """
    if not given_names:
        return None
    rows = read_brief_rows(store.folder)
    for given_name in given_names:
        if not _is_subject_known(rows, given_name):
            return given_name
    _store_known_names(store, given_names)
    return None


def _store_known_names(store: Store, given_names: Names) -> None:
    """Stores those of the given names whose vehicle or log is in the fleet.

    Args:
        store: The open SQLite store of the fleet, with the rows of all logs.
        given_names: Arguments of --name, see :func:`_store_name`.
    """
    rows = read_brief_rows(store.folder)
    with store.transaction():
        for given_name in given_names:
            if _is_subject_known(rows, given_name):
                _store_name(store, rows, given_name)


def _store_name(store: Store, rows: FlightRows, given_name: str) -> None:
    """Stores the name that the user gave to a vehicle or a flight of a fleet; an empty name deletes the former one.

    Args:
        store: The open store of the fleet, in a transaction.
        rows: All rows of the fleet's table, one for each axis of each flight.
        given_name: Argument of --name: a vehicle's name in the table or the file name of a log, "=", and the name, such
            as "flight.ulg=After the new propellers".
    """
    subject, _, typed_name = given_name.partition("=")
    name = plain_name(typed_name)
    if _is_vehicle(rows, subject):
        store_vehicle_name(store.db, subject, name)
        return
    for content in _content_hashes_of_log(rows, subject):
        store_flight_name(store.db, content, name)


def _is_vehicle(rows: FlightRows, subject: str) -> bool:
    """Returns whether ``subject`` is a vehicle's name in the logs of a fleet."""
    return subject != UNKNOWN and any(row.vehicle == subject for row in rows)


def _content_hashes_of_log(rows: FlightRows, subject: str) -> set[str]:
    """Returns the hashes of the contents of all logs of a fleet that have this path, URL or file name."""
    hashes = set()
    for row in rows:
        if row.key and subject in _file_names(row.file):
            hashes.add(content_hash(row.key))
    return hashes


def _file_names(path: str) -> Names:
    """Returns the names by which a user may refer to a log: its path or URL, and the name of its file."""
    return path, PurePath(path).name


def _print_fleet(
    tracked: TrackedLogs,
    pages: FleetPages,
    copies: Sequence[Names],
    differences: "BaselineDifferences",
    blocks_by_vehicle: BlocksByVehicle,
    *,
    has_new_baseline: bool,
) -> None:
    """Prints the number of logs, the summary of the fleet, and for each vehicle what changed since its baseline.

    Args:
        tracked: Result of this run: how many logs there are, how many were read now, and the rows of the baseline.
        pages: The written pages, with the summary of each vehicle and the names that were given to vehicles.
        copies: Paths of each log that several files hold.
        differences: Comparison of the latest flight of each vehicle with its baseline, by the vehicle's name.
        blocks_by_vehicle: The same as sentences and tables, of the vehicles that the baseline has.
        has_new_baseline: Whether this run has named the baseline; otherwise one of an earlier run is stated.
    """
    # Logs in the table without a flight.
    unused_files: set[str] = set()
    for summary in pages.summaries:
        unused_files.update(row.file for row in summary.unused)
    print_to_stdout(
        f"{counted(tracked.logs, 'log')}, {tracked.read} of them read now; {len(unused_files)} in the table without a"
        f" flight.{_copies_text(copies)}\n"
    )
    print_blocks(fleet_blocks(pages.summaries, names=pages.names))
    labels_without_baseline = []
    for vehicle, (latest_row, _) in differences.items():
        label = vehicle_label(
            vehicle,
            latest_row.frame or "",
            pages.names,
            is_shared=not latest_row.has_own_name,
        )
        if vehicle in blocks_by_vehicle:
            print_blocks([headline_sentence(f"{label}:"), *blocks_by_vehicle[vehicle]])
        else:
            labels_without_baseline.append(label)
    # A log has one row for each axis, so that sets count it once.
    baseline_keys = {(row.file, row.key) for row in tracked.healthy}
    baseline_logs = {PurePath(row.file).name for row in tracked.healthy}
    print_blocks(
        render_section(
            "fleet_without_baseline",
            vehicles=abbreviated_list(labels_without_baseline),
            is_kept=bool(tracked.healthy) and not has_new_baseline,
            log_count=len(baseline_keys),
            logs=abbreviated_list(sorted(baseline_logs)),
        )
    )


def _copies_text(copies: Sequence[Names]) -> str:
    """Returns which logs of a fleet are equal, such as " Copies, which count once: a.ulg = b.ulg."; empty without any.

    Args:
        copies: Paths of each log that several files hold.
    """
    equal_files = [escape_unprintable(_equal_files_text(paths)) for paths in copies]
    return f" Copies, which count once: {abbreviated_list(equal_files)}." if equal_files else ""


def _equal_files_text(paths: Names) -> str:
    """Returns which files are equal, such as "a.ulg = b.ulg"; with folders if names are equal: "x/a.ulg = y/a.ulg".

    Args:
        paths: paths of files that hold the same log, at least two. Beyond ``MAX_EQUAL_FILES`` only their number is
            stated: "a.ulg (12 files)".
    """
    if len(paths) > MAX_EQUAL_FILES:
        return f"{PurePath(paths[0]).name} ({len(paths)} files)"
    names = list(paths)
    parts_of_paths = [PurePath(path).parts for path in paths]
    for part_count in range(1, max(len(parts) for parts in parts_of_paths)):
        ends = ["/".join(parts[-part_count:]) for parts in parts_of_paths]
        if len(set(ends)) == len(ends):
            names = ends
            break
    return " = ".join(names)


def _report_index_and_table(folder: Path, index: Path) -> None:
    """Prints on standard error where the index page is, and how to query the table of flights.

    The table is a set of Parquet files. They are written only if the optional packages for them are installed;
    otherwise it is printed how to install these.

    Args:
        folder: Folder of the fleet, with its SQLite store, its table and its pages.
        index: Path of its index page.
    """
    print_to_stderr(f"Look: {index}")
    missing_parquet = missing_extra_fact(
        "parquet", f"{folder}/flights/, the table for DuckDB, Polars and pandas,"
    )
    if missing_parquet is not None:
        print_to_stderr(missing_parquet)
        return
    # The user copies the pattern into a query, between single quotes: SQL doubles such a quote within the text.
    pattern = f"{folder}/flights/**/*.parquet".replace("'", "''")
    print_to_stderr(f"Query, for example in DuckDB: from '{pattern}'")
