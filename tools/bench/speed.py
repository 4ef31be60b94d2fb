#!/usr/bin/env python
"""Processor time of reading logs, of a fleet's rows, of reviews, and latency of live estimates; prints tables.

Usage: tools/bench/speed.py read FILE.tlog|FILE.bin|FILE.ulg|FILE.mcap ...
       tools/bench/speed.py fleet LOG ...
       tools/bench/speed.py live
       tools/bench/speed.py review LOG ... [--before CHECKOUT]
"""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout, suppress
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import click
import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from mavdem.containers import JsonValues
from mavdem.dataset import attitude, motor_outputs
from mavdem.dem.parallel import forbid_child_processes
from mavdem.errors import Unreadable
from mavdem.fleet.flights import best_tier
from mavdem.fleet.rows_of_log import rows_of_log
from mavdem.ingest import read_log
from mavdem.report.blocks import Table, markdown
from mavdem.report.pages.flight_page import flight_page

# What processes have used is measured by the means of POSIX.
assert sys.platform != "win32"

# Modules are compiled once, as where mavdem is installed, whatever this shell says.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)


def read_with_mavdem(path: str) -> int:
    """Reads a log with mavdem, decodes what a review needs first, and returns the number of frames.

    Args:
        path: path of the log.
    """
    log = read_log(path)
    for vehicle in log.vehicles:
        # Columns are decoded when they are first used.
        assert all(len(columns["time"]) for columns in vehicle.messages.values())
        attitude.attitude_of_axis(vehicle, "roll")
        motor_outputs.motor_outputs_or_reason(vehicle)
        motor_outputs.axis_demand(vehicle, "roll")
    return log.frames


def read_with_pymavlink(path: str) -> int:
    """Reads a ``.tlog`` or ``.bin`` with pymavlink, and returns the number of messages.

    Args:
        path: path of the log. Of a ``.bin`` only the kinds of messages are read that mavdem decodes.
    """
    from pymavlink import mavutil

    kinds = ["ATT", "ANG", "RATE", "IMU", "RCOU", "CTUN", "XKF1", "EV", "ARM", "PARM", "MSG"]
    chosen = {} if path.lower().endswith(".tlog") else {"type": kinds}
    log = mavutil.mavlink_connection(path, robust_parsing=True)
    message_count = 0
    while log.recv_match(**chosen) is not None:
        message_count += 1
    return message_count


def ulog(path: str) -> int:
    """Reads a ``.ulg`` with pyulog, all topics, and returns the number of samples."""
    from pyulog import ULog

    return sum(len(topic.data["timestamp"]) for topic in ULog(path).data_list)


def mcap(path: str) -> int:
    """Reads an ``.mcap`` with the library of the format, and returns the number of messages."""
    from mcap.reader import make_reader

    with open(path, "rb") as file:
        return sum(1 for _ in make_reader(file).iter_messages(log_time_order=False))


READERS = {".tlog": read_with_pymavlink, ".bin": read_with_pymavlink, ".ulg": ulog, ".mcap": mcap}
"""The usual library of each format."""


DAMAGE_SPACING = 100_000
"""Number of bytes between the damaged places of a damaged copy: a choice, some hundreds of messages."""

DAMAGED_BYTES = 64
"""Number of bytes that are overwritten at each place: a choice, one or two messages."""

MEMORY_PROGRAM = """
import sys, mavdem.ingest.ulog, mavdem.ingest.dataflash.log, mavdem.ingest.mcap.log
from mavdem.ingest import read_log
def peak_kibibytes():
    with open("/proc/self/status") as status:
        return next(int(line.split()[1]) for line in status if line.startswith("VmHWM"))
before = peak_kibibytes()
log = read_log(sys.argv[1])
print(1024 * (peak_kibibytes() - before))
"""
"""Program that reads a log and prints by how many bytes the process grew at most."""


def read(logs: tuple[Path, ...]) -> None:
    """Prints how fast logs are read by mavdem and by the usual library of their format, the fastest of three runs.

    mavdem decodes attitude, motor outputs and the roll demand of each vehicle, and the times of every message. The
    libraries: pymavlink, of .bin with the message types that mavdem reads; pyulog with all topics; mcap with all
    messages in file order, undecoded. Each log is also read with some of its bytes overwritten, after which a reader
    must find the next message. A library that gives up at damage has fewer messages. Memory is what the process grows
    by when it reads the log.

    Args:
        logs: paths of the logs.
    """
    rows = []
    with TemporaryDirectory() as folder:
        for path in logs:
            damaged_path = Path(folder, f"damaged_{path.name}")
            damaged_path.write_bytes(damaged_copy(path.read_bytes()))
            for log in (path, damaged_path):
                rows.append(reading_costs(log))
    header = [
        "log",
        "MB",
        "MB/s",
        "library, MB/s",
        "ratio",
        "messages of the library",
        "memory / size",
    ]
    print(markdown([Table(header, rows)]))


READING_RUNS = 3
"""Runs of each reader on each log, of which the fastest counts."""


def damaged_copy(content: bytes) -> bytes:
    """Returns a log with random bytes at places that are ``DAMAGE_SPACING`` apart."""
    generator = np.random.default_rng(0)
    damaged = bytearray(content)
    for start in range(DAMAGE_SPACING, len(content) - DAMAGED_BYTES, DAMAGE_SPACING):
        damaged[start : start + DAMAGED_BYTES] = generator.bytes(DAMAGED_BYTES)
    return bytes(damaged)


def reading_costs(path: Path) -> list[str]:
    """Measures how fast a log is read by mavdem and by the library of its format, and how much memory mavdem takes.

    Args:
        path: path of the log.

    Returns:
        Cells of the table's row: name; size, MB; rates of mavdem and of the library, MB/s, and their ratio; messages of
        the library; and memory relative to the size of the log.
    """
    library_reader = READERS[path.suffix.lower()]
    mavdem_times = ReadingTimes([], 0)
    library_times = ReadingTimes([], 0)
    for _ in range(READING_RUNS):
        # Both are read alternately, so that a busy machine slows both.
        mavdem_times = with_further_run(mavdem_times, read_with_mavdem, path)
        library_times = with_further_run(library_times, library_reader, path)
    megabytes = path.stat().st_size / 1e6
    mavdem_rate = megabytes / mavdem_times.least_seconds
    library_rate = megabytes / library_times.least_seconds
    # A new process prints by how many bytes it grows when it reads the log.
    growth = subprocess.run(
        [sys.executable, "-c", MEMORY_PROGRAM, str(path)],
        capture_output=True,
        text=True,
        check=True,
    )
    memory_ratio = int(growth.stdout) / path.stat().st_size
    return [
        path.name,
        f"{megabytes:.1f}",
        f"{mavdem_rate:.0f}",
        f"{library_rate:.1f}",
        f"{mavdem_rate / library_rate:.1f}",
        f"{library_times.messages}",
        f"{memory_ratio:.1f}",
    ]


class ReadingTimes(NamedTuple):
    """Processor times in which a reader has read a log."""

    seconds: list[float]
    """Processor time of each run that succeeded, s."""
    messages: int
    """Messages that the last of these runs has read; 0 if none succeeded."""

    @property
    def least_seconds(self) -> float:
        """The least processor time, s; NaN if no run succeeded."""
        return min(self.seconds, default=float("nan"))


def with_further_run(times: ReadingTimes, reader: Callable[[str], int], path: Path) -> ReadingTimes:
    """Reads a log once more, and returns the times with this run, or as they are if the reader fails.

    Args:
        times: times of former runs.
        reader: function that reads a log and returns the number of its messages.
        path: path of the log.
    """
    began = time.process_time()
    # A library may raise anything for a damaged file, and prints much.
    with suppress(Exception), redirect_stdout(StringIO()), redirect_stderr(StringIO()):
        messages = reader(str(path))
        return ReadingTimes([*times.seconds, time.process_time() - began], messages)
    return times


def fleet(logs: tuple[Path, ...]) -> None:
    """Prints the processor time that each log costs a fleet, for its rows and its page, on one core.

    The table has the number of logs, and mean, median and maximum of their processor time, s. It has a row for each
    format and each tier of logs: tier a allows a full model, b a model of slow motion only, c no model.

    Args:
        logs: paths of the logs. The first is read once before, so that importing libraries does not count.
    """
    forbid_child_processes()
    threadpool_limits(limits=1, user_api="blas")
    # This imports the libraries.
    rows_of_log(logs[0], "", flight_page)
    measurements = []
    for path in logs:
        log_format = path.suffix.lower()
        began = time.process_time()
        group = f"{log_format}, no flight"
        with suppress(Unreadable):
            tier = best_tier(rows_of_log(path, path.name, flight_page).rows)
            if tier:
                group = f"{log_format}, tier {tier}"
        measurements.append({"logs": group, "CPU s": time.process_time() - began})
    table = pd.DataFrame(measurements)
    with_all_logs = pd.concat([table, table.assign(logs="all")])
    seconds_by_group = with_all_logs.groupby("logs")["CPU s"]
    show(seconds_by_group.agg(["size", "mean", "median", "max"]).reset_index())


LINK = "127.0.0.1:14598"
"""Address at which the live session receives datagrams, and to which the simulated flight sends them."""

LIVE_RATES = (50.0, 100.0, 200.0, 400.0)
"""Message rates of the simulated flights that are sent to live sessions, Hz."""

START_SECONDS = 10.0
"""Time after which a live session has started and receives datagrams, s: a choice."""

HOVER_SCENARIO = """
duration = 30
[stream]
autopilot = "ardupilot"
only_when_asked = true
rates = {{ ATTITUDE = {rate}, SERVO_OUTPUT_RAW = {rate} }}
"""
"""Scenario file of the simulated flight, a hover of half a minute."""


def udp_speed(rate: float, folder: Path) -> JsonValues:
    """Measures a live session that receives a simulated flight of half a minute over UDP.

    Args:
        rate: rate of the messages, Hz.
        folder: folder for the files of the session.

    Returns:
        The row of the table: message rate, Hz; number of samples ("rows") and of lost messages; latencies from a
        datagram's arrival to its estimate, ms; and processor time of the session, s.
    """
    scenario = folder / "hover.toml"
    scenario.write_text(HOVER_SCENARIO.format(rate=rate))
    mavdem = [sys.executable, "-m", "mavdem"]
    live_command = [*mavdem, *f"live udpin:{LINK} --duration 50 --json".split()]
    live_command += [f"--rrd={folder}/live.rrd", f"--record={folder}/live.tlog"]
    with (folder / "live.json").open("w+") as output:
        session = subprocess.Popen(live_command, stdout=output)
        time.sleep(START_SECONDS)
        subprocess.run([*mavdem, "fly", str(scenario), "--udp", LINK], check=True)
        _, _, usage = os.wait4(session.pid, 0)
        output.seek(0)
        document = json.load(output)
    row = {"Hz": rate, "rows": sum(document["samples"].values()), "lost": document["lost"]}
    row |= {f"{name}, ms": 1e3 * seconds for name, seconds in document["latency"].items()}
    return row | {"CPU s": usage.ru_utime + usage.ru_stime}


def live() -> None:
    """Prints what `mavdem live` costs: latency from a datagram's arrival to its estimate, and CPU seconds in all.

    A table of one row is printed for each message rate. The kernel stamps the arrival. A simulated flight is sent by
    another process over UDP for half a minute; dashboard and raw stream are recorded. The session and its workers spend
    the CPU seconds.
    """
    for rate in LIVE_RATES:
        with TemporaryDirectory() as folder:
            row = udp_speed(rate, Path(folder))
            show(pd.DataFrame([row]))


REVIEW_RUNS = 3
"""Reviews of each log by each version: a choice, since other work on the machine makes some of them slower."""


class ReviewCost(NamedTuple):
    """Processor seconds of a review since its start."""

    first_words: float
    """Until the first line about the flight."""
    screen: float
    """Until the last line of the screen."""
    total: float
    """In all, with the page."""


def review(logs: tuple[Path, ...], before: Path | None) -> None:
    """Prints what `mavdem LOG` costs on a terminal: CPU seconds until its first line, until its last line, and in all.

    With an earlier checkout, each log is reviewed by both in turn, ``REVIEW_RUNS`` times, so that a busy machine slows
    both; the least of each counts, and "ratio" is now over before. The first run compiles modules and templates.

    Args:
        logs: paths of the logs.
        before: folder of an earlier checkout; None to measure only this one.
    """
    checkouts = {"now": Path.cwd()}
    if before is not None:
        checkouts["before"] = before.resolve()
    rows = []
    for path in logs:
        costs = least_costs(path.resolve(), checkouts)
        row: dict[str, object] = {"file": path.name}
        for stage in ReviewCost._fields:
            for name, cost in costs.items():
                row[f"{stage}, {name}"] = getattr(cost, stage)
            if before is not None:
                seconds_now = getattr(costs["now"], stage)
                row[f"{stage}, ratio"] = seconds_now / getattr(costs["before"], stage)
        rows.append(row)
    # Logs become columns, and stages rows.
    show(pd.DataFrame(rows).set_index("file").T.reset_index(names="CPU s"))


def least_costs(log: Path, checkouts: dict[str, Path]) -> dict[str, ReviewCost]:
    """Reviews a log by each checkout in turn, ``REVIEW_RUNS`` times, and returns the least cost of each.

    Args:
        log: the log to review.
        checkouts: checkouts of the repository by name.

    Returns:
        Costs by the names of the checkouts. Each field is the least of all runs, so that fields may be of different
        runs.
    """
    costs_by_checkout: dict[str, list[ReviewCost]] = {name: [] for name in checkouts}
    for _ in range(REVIEW_RUNS):
        for name, checkout in checkouts.items():
            costs_by_checkout[name].append(review_cost(log, checkout))
    least_cost_by_checkout = {}
    for name, costs in costs_by_checkout.items():
        least_cost_by_checkout[name] = ReviewCost(
            first_words=min(cost.first_words for cost in costs),
            screen=min(cost.screen for cost in costs),
            total=min(cost.total for cost in costs),
        )
    return least_cost_by_checkout


def review_cost(log: Path, checkout: Path) -> ReviewCost:
    """Returns what a review costs on a terminal.

    Args:
        log: the log to review.
        checkout: the checkout of the repository whose code is measured.

    Returns:
        Processor time, s, until the first line, until the last line before the path of the page, and in all.
    """
    with TemporaryDirectory() as folder:
        # Only a terminal gets the first lines before the rest.
        terminal, terminal_of_process = os.openpty()
        process = subprocess.Popen(
            [sys.executable, "-m", "mavdem", "review", str(log), "--out", folder],
            cwd=checkout,
            env=os.environ | {"PYTHONPATH": str(checkout)},
            stdout=terminal_of_process,
            stderr=subprocess.DEVNULL,
        )
        os.close(terminal_of_process)
        seconds_at_lines = []
        # Linux ends the output of a terminal whose process has ended with an error.
        with suppress(OSError), os.fdopen(terminal, encoding="utf-8") as lines:
            for line in lines:
                if line.startswith("Page: "):
                    break
                # Fields 14 to 17 of /proc/PID/stat are user and system time in ticks, of the process and of its ended
                # children. The name in field 2 may have spaces, so fields are counted from field 3, after it.
                status = Path(f"/proc/{process.pid}/stat").read_text(encoding="utf-8")
                fields = status.rpartition(")")[2].split()
                ticks = sum(int(field) for field in fields[11:15])
                seconds_at_lines.append(ticks / os.sysconf("SC_CLK_TCK"))
            lines.read()
        usage = os.wait4(process.pid, 0)[2]
    total = usage.ru_utime + usage.ru_stime
    return ReviewCost(seconds_at_lines[0], seconds_at_lines[-1], total)


def show(table: pd.DataFrame) -> None:
    """Prints a table with three significant digits."""
    print(table.to_string(index=False, float_format="{:,.3g}".format))


@click.command(help=__doc__)
@click.argument("benchmark", type=click.Choice(["read", "fleet", "live", "review"]))
@click.argument("logs", nargs=-1, type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option(
    "--before",
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    help="For review: a checkout to compare with.",
)
def main(benchmark: str, logs: tuple[Path, ...], before: Path | None) -> None:
    """Runs one benchmark and prints its table.

    Args:
        benchmark: "read" for reading logs, "fleet" for the rows of a fleet, "live" for live estimates, "review" for
            reviews.
        logs: logs to read.
        before: for reviews, another checkout of the repository that is compared with this one.
    """
    if benchmark == "review":
        review(logs, before)
    elif benchmark == "read":
        read(logs)
    elif benchmark == "fleet":
        fleet(logs)
    else:
        live()


if __name__ == "__main__":
    main()
