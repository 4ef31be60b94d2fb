#!/usr/bin/env python
"""Cost of a fleet (a store of many vehicles' logs) as it grows, and speed of reading logs on a cluster of workers.

The index of thousands of logs is made of real ones: of each row that `mavdem track` has stored, jittered copies stand
for further flights of further vehicles. The generator is seeded, so that the same logs make the same index.

Usage: tools/bench/fleet.py growth LOG... [--plot FILE.svg]   # one more log, page, search and diff by number of logs
       tools/bench/fleet.py make FLEET LOG... [--logs N]      # only makes the index, to look at
       tools/bench/fleet.py cluster LOG...                    # logs a second by workers of a Dask cluster
"""

import os
import random
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Timer
from typing import Any, NamedTuple

import click

from mavdem.containers import group_by
from mavdem.fleet.judgement import publish_judgements
from mavdem.fleet.row import FlightRow, FlightRows
from mavdem.fleet.sources import LogSource, find_logs
from mavdem.fleet.store import Store, open_store
from mavdem.fleet.stored_rows import read_brief_rows, read_rows
from mavdem.fleet.tracking import assess_rows
from mavdem.fleet.workers import PAGES, JobLimits, JobOutcome
from mavdem.fleet_pages import INDEX_FILE, write_fleet_pages
from mavdem.machine import free_port
from mavdem.report.blocks import Table, markdown
from mavdem.report.fleet_summary import fleet_counts
from mavdem.report.vehicle_summary import vehicle_summaries

# What processes have used is measured by the means of POSIX.
assert sys.platform != "win32"

# Modules are compiled once, as where mavdem is installed, whatever this shell says.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

FLIGHTS_OF_A_VEHICLE = 50
"""Logs of each vehicle of a generated fleet: two flights a week for half a year."""

DAYS_BETWEEN_FLIGHTS = 3.5
"""Days from one flight of a vehicle to its next."""

FIRST_DAY = datetime(2026, 1, 5, 9, tzinfo=UTC)
"""Date of each vehicle's first flight."""

PERIOD_BEFORE = "2026-01-05..2026-01-18"
PERIOD_AFTER = "2026-03-02..2026-03-15"
"""The two weeks from ``FIRST_DAY`` on, and two later ones, whose flights are compared."""

JITTER = 0.03
"""Relative standard deviation of each figure of a generated flight about the real one."""

JITTERED_COLUMNS = (
    "duration",
    "voltage_mean",
    "collective",
    "tilt_sd",
    "vibration",
    "trim_share",
    "effect",
    "damping",
    "lag",
    "phase_margin",
    "gain_margin",
    "ms",
    "wind_torque_sd",
    "wind_speed",
    "wind_direction",
    "balance",
    "mean_inputs",
)
"""Columns whose figures differ from flight to flight."""

SEED = 71
"""Seed of the generator."""

FLEET_SIZES = 100, 1_000, 10_000
"""Numbers of logs that are measured."""


CLUSTER_SIZES = 1, 2, 4
"""Numbers of workers that are measured."""


@click.group(help=__doc__)
def main() -> None:
    """Benchmarks of a fleet."""


class GeneratedLog(NamedTuple):
    """A log that does not exist, with the rows for the fleet's table that reading it would have given."""

    source: LogSource
    """Its path, at which there is no file."""
    outcome: JobOutcome
    """Its rows, as a job that reads a log returns them."""


class LogIdentity(NamedTuple):
    """What names a generated log in the fleet's table; each differs from log to log."""

    path: str
    """Path of the log."""
    key: str
    """Digest of the log's content and size in bytes."""
    date: datetime
    """Date of its flight."""
    vehicle: str
    """Number of its vehicle, three digits."""


def generated_logs(rows: FlightRows, count: int) -> Iterator[GeneratedLog]:
    """Yields the logs of a generated fleet, each a copy of a real log whose figures are changed at random.

    All flights of a vehicle are copies of one real log. Vehicles take the real logs in turn, so that logs without a
    flight are as frequent as among the real ones.

    Args:
        rows: rows of the fleet's table for real logs; a log has a row for each of its flights.
        count: number of logs to generate.

    Yields:
        The source of each log, and the rows that reading it would have given.
    """
    random_numbers = random.Random(SEED)
    real_logs = list(group_by(rows, lambda row: row.key or row.file).values())
    for number in range(count):
        vehicle, flight = divmod(number, FLIGHTS_OF_A_VEHICLE)
        real_rows = real_logs[vehicle % len(real_logs)]
        # The size in bytes, and the key with its digest, need only differ from log to log.
        size = 1_000_000 + number
        identity = LogIdentity(
            path=f"/flights/vehicle_{vehicle:03}/{flight:03}.bin",
            key=f"{number:032x}-{size}",
            date=FIRST_DAY + timedelta(days=DAYS_BETWEEN_FLIGHTS * flight, minutes=vehicle),
            vehicle=f"{vehicle:03}",
        )
        # All rows of a log get the same factors, by which flights of a vehicle differ.
        factors = {column: random_numbers.gauss(1.0, JITTER) for column in JITTERED_COLUMNS}
        # Time and memory that reading the log would have taken are not measured here: any value does.
        outcome = JobOutcome(
            identity.path,
            ended="read",
            rows=tuple(_jittered_row(row, identity, factors, random_numbers) for row in real_rows),
            key=identity.key,
            pages={},
            seconds=1.0,
            megabytes=200.0,
        )
        yield GeneratedLog(LogSource(identity.path, size, version="1"), outcome)


def _jittered_row(
    row: FlightRow, identity: LogIdentity, factors: dict[str, float], random_numbers: random.Random
) -> FlightRow:
    """Returns a copy of a row of a real log, with figures that are changed at random, for a generated log.

    Args:
        row: the row of the real log.
        identity: names of the generated log, of its vehicle and of its page.
        factors: factor on each jittered column, which is the same for all rows of a log.
        random_numbers: source of further factors: each entry of a column that has several, such as one for each motor,
            gets one of its own.

    Returns:
        The row of the generated log.
    """
    changes: dict[str, Any] = {
        "file": identity.path,
        "key": identity.key,
        "date": identity.date,
    }
    for name, factor in factors.items():
        value = getattr(row, name)
        if isinstance(value, tuple):
            changes[name] = [entry * factor * random_numbers.gauss(1.0, JITTER) for entry in value]
        elif value is not None:
            changes[name] = value * factor
    has_vehicle_name = row.vehicle_basis is not None
    if has_vehicle_name:
        # Names are as long as real ones, since the sizes of pages are measured: the number follows the real name.
        changes["vehicle"] = f"{row.vehicle}{identity.vehicle}"
    if row.page is not None:
        changes["page"] = f"{PAGES}/{identity.key}.html"
    return replace(row, **changes)


def fill_store(store: Store, rows: FlightRows, count: int) -> None:
    """Fills a fleet's store with generated logs, assesses its vehicles and writes its table, as `mavdem track` does.

    Args:
        store: an empty SQLite store of a fleet.
        rows: rows of real logs, which the generated logs are copies of.
        count: number of logs.
    """
    limits = JobLimits()
    with store.transaction():
        sources = []
        for log in generated_logs(rows, count):
            store.add(log.source, log.outcome, limits)
            sources.append(log.source)
        store.track(sources)
    publish_judgements(store, assess_rows)


def write_stand_in_pages(folder: Path) -> None:
    """Writes a small page for each flight of a generated fleet, which `mavdem track` would otherwise read again."""
    (folder / PAGES).mkdir()
    for page in {row.page for row in read_brief_rows(folder) if row.page is not None}:
        (folder / page).write_text("<main>\n")


class Cost(NamedTuple):
    """What a command cost."""

    processor_seconds: float
    """Processor time of its processes, s."""
    seconds: float
    """Time by the clock, s."""
    megabytes: float
    """Largest memory of one of its processes, MB."""


def run_mavdem(*words: str | Path) -> Cost:
    """Measures what a command of mavdem costs, in a process of its own.

    Args:
        words: name of the command, and its arguments.

    Returns:
        Processor time and duration, s, and the largest resident memory, MB.

    Raises:
        subprocess.CalledProcessError: the command was refused. Exit code 1 is accepted: there was nothing to report.
    """
    start_time = time.perf_counter()
    process = subprocess.Popen(
        [sys.executable, "-m", "mavdem", *map(str, words)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    _, status, usage = os.wait4(process.pid, 0)
    seconds = time.perf_counter() - start_time
    exit_code = os.waitstatus_to_exitcode(status)
    if exit_code not in (0, 1):
        raise subprocess.CalledProcessError(exit_code, words)
    return Cost(usage.ru_utime + usage.ru_stime, seconds, usage.ru_maxrss / 1024)


class PageTimes(NamedTuple):
    """How long a person waits for the index page in a browser, ms."""

    opening: float
    """From the beginning until the page is laid out and can be used."""
    sorting: float
    """Until the lines are in the order of another column, the slowest of all columns."""
    searching: float
    """Until the lines with a word are shown, the slowest of some words."""


PAGE_SCRIPT = """<script>(() => {
const body = document.getElementById("flights").tBodies[0];
const timed = act => {
  const began = performance.now();
  act();
  body.getBoundingClientRect();
  return performance.now() - began;
};
body.getBoundingClientRect();
const opening = performance.now();
document.getElementById("every_flight").scrollIntoView();
const heads = [...document.querySelectorAll("#flights th button")];
const sorting = Math.max(...heads.map(head => timed(() => head.click())));
const searching = Math.max(...["m", "motors bad", "vehicle 07", "none of these", ""].map(words => timed(() => {
  const filter = document.getElementById("filter");
  filter.value = words;
  filter.dispatchEvent(new Event("input"));
})));
document.title = `measured ${opening} ${sorting} ${searching}`;
})()</script>"""
"""Measures the page at whose end it stands, after its own scripts, and leaves the figures in its title."""


def page_times(index: Path) -> PageTimes:
    """Opens an index page from its file in headless Chromium, sorts it and searches in it.

    A script that is appended to the page measures the times and writes them into its title.

    Args:
        index: file of the page.

    Returns:
        The times of opening, sorting and searching, ms.
    """
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    if chromium is None:
        raise click.UsageError("Chromium is needed.")
    with TemporaryDirectory() as folder:
        page = Path(folder, "index.html")
        page.write_text(index.read_text("utf-8") + PAGE_SCRIPT, "utf-8")
        options = ["--headless", "--no-sandbox", "--disable-gpu", "--timeout=60000", "--dump-dom"]
        profile = f"--user-data-dir={folder}/profile"
        command = [chromium, *options, profile, page.as_uri()]
        text = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    title_match = re.search(r"<title>measured (\S+) (\S+) (\S+)</title>", text)
    assert title_match is not None, "the page has not been measured"
    return PageTimes(*map(float, title_match.groups()))


def echo_header(header: list[str]) -> None:
    """Prints the header of a Markdown table, whose rows follow one by one."""
    print(markdown([Table(header, [])]), flush=True)


def echo_row(header: list[str], row: list[str]) -> None:
    """Prints a row of a Markdown table as soon as it is known: a run that is cut short keeps its first rows."""
    print(markdown([Table(header, [row])]).splitlines()[-1], flush=True)


GROWTH_HEADER = [
    "logs",
    "one more log (processor s)",
    "memory (MB)",
    "two weeks compared (processor s)",
    "page (MB)",
    "opening (ms)",
    "sorting (ms)",
    "searching (ms)",
]
"""Header of the table of a fleet's growth."""


@main.command("growth")
@click.argument("logs", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--plot", type=click.Path(path_type=Path), help="File for a picture of it.")
def measure_growth(logs: tuple[Path, ...], plot: Path | None) -> None:
    """Adds one log to fleets of 100, 1,000 and 10,000 logs, and opens their pages.

    The fleets are made of the LOGS, the first of which is the one that is added.
    """
    table = []
    with TemporaryDirectory() as folder:
        real_fleet = Path(folder, "real")
        run_mavdem("track", *logs, "--out", real_fleet)
        rows = read_rows(real_fleet)
        echo_header(GROWTH_HEADER)
        for size in FLEET_SIZES:
            fleet = Path(folder, str(size))
            row = [f"{size:,}", *_growth_figures(fleet, rows, size, logs[0])]
            echo_row(GROWTH_HEADER, row)
            table.append(row)
    click.echo(f"\n{os.cpu_count()} cores, load {os.getloadavg()[1]:.0f}.")
    if plot is not None:
        draw_growth(table, plot)


def _growth_figures(fleet: Path, rows: FlightRows, size: int, added_log: Path) -> list[str]:
    """Generates a fleet of a size, and measures the cost of three operations on it.

    They are: `mavdem track` adds a log, `mavdem diff` compares two periods of two weeks of one vehicle, and a browser
    opens, sorts and searches the index page.

    Args:
        fleet: folder in which the fleet is made.
        rows: rows of real logs, which the fleet's logs are copies of.
        size: number of the fleet's logs.
        added_log: path of the log that is added.

    Returns:
        The cells of ``GROWTH_HEADER`` after the number of logs, in the units that the header states.
    """
    with open_store(fleet) as store:
        fill_store(store, rows, size)
        write_stand_in_pages(fleet)
        # A fleet in use already has the index page of its last run.
        write_fleet_pages(store, {})
    cost_of_adding = run_mavdem("track", added_log, "--out", fleet, "--jobs", "1")
    cost_of_comparing = _cost_of_comparing(fleet)
    index = fleet / INDEX_FILE
    times = page_times(index)
    return [
        f"{cost_of_adding.processor_seconds:.1f}",
        f"{cost_of_adding.megabytes:.0f}",
        f"{cost_of_comparing.processor_seconds:.1f}",
        f"{index.stat().st_size / 1e6:.1f}",
        f"{times.opening:.0f}",
        f"{times.sorting:.0f}",
        f"{times.searching:.0f}",
    ]


def _cost_of_comparing(fleet: Path) -> Cost:
    """Runs `mavdem diff` on two periods of the flights of a fleet's first vehicle, and returns what it cost."""
    named_rows = [row for row in read_brief_rows(fleet) if row.is_read and row.has_own_name]
    vehicle = named_rows[0].vehicle
    periods = ("--days-a", PERIOD_BEFORE, "--days-b", PERIOD_AFTER)
    out = fleet / "compared"
    return run_mavdem("diff", fleet, fleet, "--vehicle", vehicle, *periods, "--out", out)


def draw_growth(table: Sequence[Sequence[str]], path: Path) -> None:
    """Draws the times in the table of ``growth`` over the number of logs, both logarithmic.

    Columns with another unit than a time, such as MB, are left out.

    Args:
        table: rows of the table, with a cell for each of ``GROWTH_HEADER``.
        path: file of the picture.
    """
    import matplotlib as mpl
    import matplotlib.pyplot as plt

    mpl.use("agg")
    # The ids in the file follow from this text, so that the same figures make the same file.
    mpl.rcParams["svg.hashsalt"] = "fleet"
    log_counts = [int(row[0].replace(",", "")) for row in table]
    seconds_per_unit = {"processor s": 1.0, "ms": 1e-3}
    figure, axes = plt.subplots(figsize=(6, 3.4), layout="constrained")
    for column, header in enumerate(GROWTH_HEADER):
        # A header ends with its unit in parentheses.
        name, _, unit = header.removesuffix(")").partition(" (")
        if unit in seconds_per_unit:
            seconds = [seconds_per_unit[unit] * float(row[column]) for row in table]
            axes.loglog(log_counts, seconds, "o-", label=name)
    axes.set(xlabel="logs", ylabel="s")
    axes.grid(alpha=0.3)
    axes.legend(fontsize="small")
    figure.savefig(path, metadata={"Date": None})


@main.command("make")
@click.argument("fleet", type=click.Path(path_type=Path))
@click.argument("logs", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--logs", "log_count", default=FLEET_SIZES[-1], help="Number of generated logs.")
def generate_fleet(fleet: Path, logs: tuple[Path, ...], log_count: int) -> None:
    """Makes a FLEET of --logs generated logs, copies of LOGS, whose pages can be opened."""
    with TemporaryDirectory() as folder:
        fleet_of_logs = Path(folder, "real")
        run_mavdem("track", *logs, "--out", fleet_of_logs)
        rows_to_copy = read_rows(fleet_of_logs)
    with open_store(fleet) as store:
        fill_store(store, rows_to_copy, log_count)
    write_stand_in_pages(fleet)
    # Tracking one more log judges all vehicles, and writes the fleet's table and its own page.
    run_mavdem("track", logs[0], "--out", fleet)


class LocalCluster(NamedTuple):
    """A running Dask cluster of this machine."""

    address: str
    """Address of the scheduler."""
    workers: list[subprocess.Popen[bytes]]
    """Processes of the workers."""


@contextmanager
def local_cluster(workers: int) -> Iterator[LocalCluster]:
    """Runs a Dask scheduler and workers on this machine, each with one thread, within the block of ``with``.

    Args:
        workers: number of workers.

    Yields:
        The address of the scheduler, and the processes of the workers.
    """
    from distributed import Client

    address = f"tcp://127.0.0.1:{free_port()}"
    python = [sys.executable, "-m"]
    quiet: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    port = address.rpartition(":")[2]
    scheduler_arguments = ["distributed.cli.dask_scheduler", "--port", port, "--no-dashboard"]
    worker_arguments = ["--nthreads", "1", "--no-nanny", "--no-dashboard"]
    with TemporaryDirectory() as folder:
        processes = [subprocess.Popen([*python, *scheduler_arguments], **quiet)]
        worker_command = [*python, "distributed.cli.dask_worker", address, *worker_arguments]
        worker_command += ["--local-directory", folder]
        for _ in range(workers):
            processes.append(subprocess.Popen(worker_command, **quiet))
        try:
            with Client(address, timeout="60s") as client:
                client.wait_for_workers(workers)
            yield LocalCluster(address, processes[1:])
        finally:
            for process in reversed(processes):
                process.kill()
                process.wait()


CLUSTER_HEADER = ["workers", "s", "logs/s", "times one worker", "flights in the table"]
"""Header of the table of clusters."""


@main.command("cluster")
@click.argument("logs", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--logs", "max_logs", default=8, help="Logs that are read, the smallest ones.")
def measure_clusters(logs: tuple[Path, ...], max_logs: int) -> None:
    """Reads LOGS on clusters of 1, 2 and 4 workers, and again where a worker is killed half way.

    The time includes the start of the command and of the readers. Each row is printed as soon as it is measured.
    """
    sources, _ = find_logs([str(log) for log in logs])
    sources.sort(key=lambda source: source.size)
    smallest_logs = [Path(source.path) for source in sources[:max_logs]]
    count = len(smallest_logs)
    echo_header(CLUSTER_HEADER)
    seconds_by_workers: dict[int, float] = {}
    for workers in CLUSTER_SIZES:
        seconds, flights = _cluster_seconds(smallest_logs, workers)
        seconds_by_workers[workers] = seconds
        gain = seconds_by_workers[CLUSTER_SIZES[0]] / seconds
        echo_row(CLUSTER_HEADER, _cluster_row(str(workers), seconds, count, gain, flights))
    # A cluster of one worker would not survive.
    for workers in CLUSTER_SIZES[1:]:
        kill_after = seconds_by_workers[workers] / 2
        seconds, flights = _cluster_seconds(smallest_logs, workers, kill_after)
        gain = seconds_by_workers[CLUSTER_SIZES[0]] / seconds
        name = f"{workers}, one killed after {kill_after:.0f} s"
        echo_row(CLUSTER_HEADER, _cluster_row(name, seconds, count, gain, flights))
    click.echo(f"\n{os.cpu_count()} cores, load {os.getloadavg()[1]:.0f}, {count} logs.")


def _cluster_row(name: str, seconds: float, logs: int, gain: float, flights: int) -> list[str]:
    """Formats the measurement of a cluster as a row of the table with ``CLUSTER_HEADER``.

    Args:
        name: number of workers, and which was killed.
        seconds: time in which the cluster has read all logs, s.
        logs: number of logs.
        gain: speed relative to one worker's.
        flights: number of flights in the fleet's table afterwards, which shows that none was lost.
    """
    return [name, f"{seconds:.0f}", f"{logs / seconds:.2f}", f"{gain:.2f}", str(flights)]


def _cluster_seconds(
    logs: Sequence[Path], workers: int, kill_after: float | None = None
) -> tuple[float, int]:
    """Reads logs into a new fleet on a new cluster, and may kill a worker meanwhile.

    Args:
        logs: the logs.
        workers: number of workers.
        kill_after: time after which one worker is killed, s; None for never.

    Returns:
        The time that reading took, s, and the number of flights in the fleet's table.
    """
    with local_cluster(workers) as running, TemporaryDirectory() as folder:
        kill_timer = None
        if kill_after is not None:
            kill_timer = Timer(kill_after, running.workers[0].kill)
            kill_timer.start()
        cost = run_mavdem("track", *logs, "--out", folder, "--scheduler", running.address)
        if kill_timer is not None:
            kill_timer.join()
        flights = fleet_counts(vehicle_summaries(read_brief_rows(Path(folder))))["flights"]
    return cost.seconds, flights


if __name__ == "__main__":
    main()
