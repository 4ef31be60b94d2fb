"""Made-up logs, and a fleet of them: what the tests of tracking share."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from standin_rows import READ

from mavdem.fleet.dataset import read_rows
from mavdem.fleet.reading import cluster
from mavdem.fleet.reading.crew import Crew
from mavdem.fleet.reading.outcome import Limits
from mavdem.fleet.tracking import FleetTracker, TrackedLogs

LIMITS = Limits(seconds=3, megabytes=600)


def track(
    out: Path, *names: object, jobs: int = 1, limits: Limits = LIMITS, baseline: Sequence[str] = ()
) -> TrackedLogs:
    return FleetTracker(out, Crew(jobs, limits, READ)).track([str(name) for name in names], baseline)


def make_logs(folder: Path, count: int, name: str = "log") -> list[Path]:
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{name}_{number}.bin" for number in range(count)]
    for number, path in enumerate(paths):
        path.write_bytes(f"{name} {number}".encode() * (5 + number))
    return paths


def files_of(out: Path) -> dict[str, bytes]:
    """The data set, byte for byte."""
    return {str(path.relative_to(out)): path.read_bytes() for path in (out / "flights").rglob("*.parquet")}


def statuses(out: Path) -> dict[str, str]:
    return {Path(row.file).name: row.status for row in read_rows(out) if row.status != "ok"}


def is_process(process: int, path: str) -> bool:
    """Whether this is the process with that number, whatever the path."""
    return os.getpid() == process


def waiting_processes() -> int:
    """How many processes that read logs wait in this worker of a cluster."""
    return cluster._idle.qsize()
