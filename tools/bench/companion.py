#!/usr/bin/env python
"""Cost of `mavdem live` on a small computer beside the autopilot: one core with a limit; prints a table.

Usage: tools/bench/companion.py [--rate HZ ...] [--share SHARE] [--python PYTHON] [--checkout FOLDER]

A simulated flight of a minute is sent over UDP by another process on another core. The session and all processes
that it starts share one core. Their share of it is limited by a control group of Linux; where there is none, busy
processes beside them take the rest, and the table says so.
"""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from threading import Thread
from typing import NamedTuple

import click
import psutil

from mavdem.ingest import read_log
from mavdem.report.blocks import Table, markdown

# Shares of a core and of memory are measured by the means of Linux.
assert sys.platform == "linux"

# Modules are compiled once, as where mavdem is installed, whatever this shell says.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

LINK = "127.0.0.1:14596"
"""Where the flight is sent to."""

SCENARIO = """
description = "An Iris on a small computer's link: all axes excited over their whole band, in a light wind."
duration = 60
seed = 35
[vehicle]
model = "iris"
[[wind]]
kind = "gaussian"
sd = 0.5
s = 0.2
[excitation]
kind = "multisine"
axis = "all"
sd = 2
lowest = 0.2
highest = 6
period = 10
[stream]
autopilot = "ardupilot"
rates = {{ ATTITUDE = {rate}, ATTITUDE_TARGET = {rate}, SERVO_OUTPUT_RAW = {rate} }}
"""
"""Flight whose physical parameters and loops are identifiable, so that learning and the margins in flight run."""

STARTING_SECONDS = 180.0
"""Longest time for the session to start on its share of a core, s."""

SETTLING_SECONDS = 5.0
"""Time between the start of the session and the flight, and between the flight and the end of the session, s."""

QUOTA_PERIOD = 0.02
"""Period of the limit, s: within each, the processes run for their share of it, and then wait."""

SAMPLING_PERIOD = 0.5
"""Time between two looks at processor time and memory, s."""

CONTROL_GROUPS = Path("/sys/fs/cgroup")
"""Where Linux has its control groups: version 2 in this folder, version 1 in ``cpu`` below it."""


class Usage(NamedTuple):
    """Processor time and memory of a process with all its children at one time."""

    time: float
    """Time, s of the monotonic clock."""

    processor: float
    """Processor time so far, s."""

    memory: float
    """Memory, MB: of what several processes share, each has its part (proportional set size)."""


class LiveRun(NamedTuple):
    """A live session, as it was observed from outside."""

    document: dict[str, object]
    """What ``--json`` printed."""

    usages: list[Usage]
    """Processor time and memory over time."""

    lines: list[tuple[float, str]]
    """Lines on standard error, with the time of each, s of the monotonic clock."""

    sender_start: float
    """When the first message came, s of that clock."""

    sender_end: float
    """When the last message was sent, s of that clock."""


@contextmanager
def control_group(share: float) -> Iterator[Path | None]:
    """Makes a Linux control group (cgroup, version 2 or 1) whose processes get a share of one core.

    The group is removed at the end, which fails if a process is still in it.

    Args:
        share: share of one core, 0 to 1.

    Yields:
        The file of the group to which process ids are written; None if this machine does not allow to make a group.
    """
    period = round(1e6 * QUOTA_PERIOD)
    quota = round(share * period)
    version_2 = CONTROL_GROUPS / "mavdem-bench"
    version_1 = CONTROL_GROUPS / "cpu" / "mavdem-bench"
    # Period and quota are in µs. The weights are ten times the default (100 in version 2, 1024 in version 1), so that
    # the quota limits the group, and not what else this machine does.
    quota_of_period = {"cpu.cfs_period_us": str(period), "cpu.cfs_quota_us": str(quota)}
    files_by_folder = {
        version_2: {"cpu.max": f"{quota} {period}", "cpu.weight": "1000"},
        version_1: {**quota_of_period, "cpu.shares": "10240"},
    }
    for folder, values in files_by_folder.items():
        # A folder of control groups has this file; elsewhere a new folder would be an ordinary one.
        if not (folder.parent / "cgroup.procs").exists():
            continue
        try:
            folder.mkdir(exist_ok=True)
            for name, value in values.items():
                (folder / name).write_text(value)
        except OSError:
            continue
        try:
            yield folder / "cgroup.procs"
        finally:
            folder.rmdir()
        return
    yield None


@contextmanager
def background_load(core: int, share: float) -> Iterator[None]:
    """Keeps a processor core busy within the block, so that one more process on it gets only a fraction of its time.

    The scheduler divides a core evenly between processes that are always ready: n busy ones leave 1 / (n + 1).

    Args:
        core: number of the core.
        share: fraction of its time that is left, above 0 to 1.
    """
    busy_loop = f"import os; os.sched_setaffinity(0, {{{core}}})\nwhile True: pass"
    busy_count = round(1 / share) - 1
    processes = []
    for _ in range(busy_count):
        processes.append(subprocess.Popen([sys.executable, "-c", busy_loop]))
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.wait()


def usage_now(session: psutil.Process) -> Usage:
    """Returns processor time, s, and memory, MB, of a process and all its children.

    Memory is the proportional set size (PSS), in which pages that processes share count once.

    Args:
        session: the process.
    """
    processor = 0.0
    memory = 0.0
    for process in (session, *session.children(recursive=True)):
        with suppress(psutil.Error):
            times = process.cpu_times()
            processor += times.user + times.system
            memory += process.memory_full_info().pss / 1e6
    return Usage(time.monotonic(), processor, memory)


def compile_modules(python: str, checkout: Path) -> None:
    """Compiles the modules of a checkout, as pip does in an installation: else the session would compile them."""
    compiling = [python, "-m", "compileall", "-q", str(checkout / "mavdem")]
    subprocess.run(compiling, check=True)


class ObservedSession:
    """A live session that runs in a process of its own, and is observed from outside by threads until it ends.

    Attributes:
        process: the process.
        lines: the lines that it has printed to standard error, with the time of each, s of the monotonic clock.
        output: what it has printed to standard output, once that is complete.
        usages: processor time and memory over time.
    """

    def __init__(self, process: subprocess.Popen[str]) -> None:
        """Begins to observe.

        Args:
            process: the process, with pipes for standard output and standard error.
        """
        self.process = process
        self.lines: list[tuple[float, str]] = []
        self.output = ""
        self.usages: list[Usage] = []
        self._threads = [
            Thread(target=self._read_lines, daemon=True),
            Thread(target=self._read_output, daemon=True),
            Thread(target=self._measure, daemon=True),
        ]
        for thread in self._threads:
            thread.start()

    def wait_for_line(self, text: str) -> None:
        """Waits until the session has printed a line that contains a text, at most ``STARTING_SECONDS``."""
        deadline = time.monotonic() + STARTING_SECONDS
        while not any(text in line for _, line in self.lines):
            assert time.monotonic() < deadline, "the session does not start"
            time.sleep(SAMPLING_PERIOD)

    def end(self) -> None:
        """Ends the session as Ctrl-C does, and waits until all that it prints is read."""
        self.process.send_signal(signal.SIGINT)
        self.process.wait()
        for thread in self._threads:
            thread.join(timeout=5.0)

    def _read_lines(self) -> None:
        """Collects the lines on standard error, each with the time at which it came."""
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self.lines.append((time.monotonic(), line.rstrip()))

    def _read_output(self) -> None:
        """Collects standard output, which is the JSON document."""
        assert self.process.stdout is not None
        self.output = self.process.stdout.read()

    def _measure(self) -> None:
        """Records the session's use of the machine until it ends."""
        observed = psutil.Process(self.process.pid)
        with suppress(psutil.Error):
            while True:
                self.usages.append(usage_now(observed))
                time.sleep(SAMPLING_PERIOD)


def live_run(rate: float, python: str, checkout: Path, core: int, group: Path | None) -> LiveRun:
    """Runs a live session while a flight is sent to it, and observes it.

    Args:
        rate: rate of attitude and motors, Hz.
        python: interpreter of the session.
        checkout: folder whose ``mavdem`` it runs.
        core: core that it runs on; the flight is sent from the others.
        group: file of the control group to which the session's process id is written; None without a group.

    Returns:
        The document and the lines that the session printed, its use of processor and memory over time, and the times at
        which the flight began and ended.
    """
    compile_modules(python, checkout)
    with TemporaryDirectory() as name:
        folder = Path(name)
        scenario = folder / "flight.toml"
        scenario.write_text(SCENARIO.format(rate=rate))
        recording = folder / "live.tlog"
        session = ObservedSession(_start_session(python, checkout, recording, core, group))
        session.wait_for_line("Listening on")
        time.sleep(SETTLING_SECONDS)
        other_cores = set(range(os.cpu_count() or 1)) - {core} or {core}
        subprocess.run(
            [sys.executable, "-m", "mavdem", "fly", str(scenario), "--udp", LINK],
            check=True,
            stderr=subprocess.DEVNULL,
            preexec_fn=lambda: os.sched_setaffinity(0, other_cores),
        )
        sender_end = time.monotonic()
        time.sleep(SETTLING_SECONDS)
        session.end()
        document = json.loads(session.output)
        document["recorded"] = read_log(recording).frames
    # The first message shows in this line. If none came, the flight has no duration.
    times_of_vehicle = [when for when, line in session.lines if "Following vehicle" in line]
    sender_start = min(times_of_vehicle, default=sender_end)
    return LiveRun(document, session.usages, session.lines, sender_start, sender_end)


def _start_session(
    python: str, checkout: Path, recording: Path, core: int, group: Path | None
) -> subprocess.Popen[str]:
    """Starts a live session, which records what it receives and prints a JSON document at its end.

    Args:
        python: interpreter of the session.
        checkout: folder whose ``mavdem`` it runs.
        recording: file in which it records; its other files are written beside it.
        core: core that it runs on.
        group: file of the control group to which its process id is written; None without a group.
    """

    def limit() -> None:
        """Binds the new process to the core, and puts it into the control group."""
        os.sched_setaffinity(0, {core})
        if group is not None:
            group.write_text(str(os.getpid()))

    words = f"-m mavdem live udpin:{LINK} --plain --json --record".split()
    return subprocess.Popen(
        [python, *words, str(recording)],
        cwd=recording.parent,
        env=os.environ | {"PYTHONPATH": str(checkout)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=limit,
    )


def table_row(run: LiveRun, rate: float) -> dict[str, object]:
    """Returns the row of the table for one run, by the headers of the columns.

    Processor time and memory are summed over all processes of the session. "core" and "memory" (the median) are of the
    flight, from the first message to the last. "processor in all" and "memory at most" are of the whole session, which
    judges the recording after the flight.

    Args:
        run: the live session, with its document, the lines that it printed, and its use of the machine over time.
        rate: rate of attitude and motors, Hz.

    Returns:
        Numbers in the units that the headers state, or counts; "first model" is the text of the line, or "none".
    """
    usages_in_flight = [
        usage for usage in run.usages if run.sender_start <= usage.time <= run.sender_end
    ]
    first, last = usages_in_flight[0], usages_in_flight[-1]
    core_share = (last.processor - first.processor) / (last.time - first.time)
    document: dict[str, dict[str, float]] = run.document  # type: ignore[assignment]
    latency = document["latency"]
    # The text of the line follows the time of day and the time of the vehicle's clock.
    first_models = [
        line[line.index("First model") :] for _, line in run.lines if "First model" in line
    ]
    return {
        "Hz": rate,
        "rows": sum(document["samples"].values()),
        "latest sample, s": latency["max"],
        "p99, ms": 1e3 * latency["p99"],
        "core, %": 100 * core_share,
        "processor in all, s": max(usage.processor for usage in run.usages),
        "memory, MB": median(usage.memory for usage in usages_in_flight),
        "memory at most, MB": max(usage.memory for usage in run.usages),
        "frames lost": document["lost"],
        "recorded": run.document["recorded"],
        "first model": first_models[0] if first_models else "none",
    }


@click.command(help=__doc__)
@click.option("--rate", "rates", multiple=True, type=float, default=(100.0, 400.0))
@click.option("--share", default=0.25, help="Share of one core, 1 for all of it.")
@click.option(
    "--python", default=sys.executable, help="Interpreter, as of an install without Rerun."
)
@click.option(
    "--checkout",
    default=Path(__file__).parents[2],
    type=click.Path(exists=True, path_type=Path),
    help="Checkout of the repository whose live session is measured.",
)
def main(rates: tuple[float, ...], share: float, python: str, checkout: Path) -> None:
    """Measures live sessions on one core, and prints a table of their costs with a row for each message rate.

    A small computer is imitated by a share of the core: the quota of a Linux control group. Where no group can be made,
    busy processes on the same core leave the session that share.

    Args:
        rates: rates of the messages of attitude and motors, Hz.
        share: share of the core that a session gets; from 1 on it has the whole core.
        python: interpreter of the session.
        checkout: repository whose session is measured.
    """
    core = max(os.sched_getaffinity(0))
    load = os.getloadavg()[0]
    with ExitStack() as stack:
        group = None
        if share >= 1:
            print(f"One core, no limit; load before: {load:.1f}.")
        else:
            group = stack.enter_context(control_group(share))
            if group is not None:
                limit = f"limited to {share:.0%} by {group.parent}"
                print(f"One core, {limit}; load before: {load:.1f}.")
            else:
                print(f"One core with a load beside it that leaves {share:.0%}.")
                stack.enter_context(background_load(core, share))
        rows = []
        for rate in rates:
            run = live_run(rate, python, checkout, core, group)
            rows.append(table_row(run, rate))
    header = list(rows[0])
    cells = [[_cell(value) for value in row.values()] for row in rows]
    print("\n" + markdown([Table(header, cells)]))


def _cell(value: object) -> str:
    """Returns the text of a cell: a float with three significant digits."""
    return f"{value:,.3g}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    main()
