"""Made-up logs, whose names say what becomes of their reader, and a fleet of them.

Workers import this by its name, and none of what only the tests themselves need.
"""

import ctypes
import signal
import time
from pathlib import Path

from mavdem.dem.parallel import available_workers
from mavdem.errors import Unreadable
from mavdem.extras import MissingExtra
from mavdem.facts import Fact
from mavdem.facts.sources import PackageFact
from mavdem.fleet.row import FlightRow
from mavdem.fleet.workers import JobLimits, JobOutcome, outcome_of

LIMITS = JobLimits(seconds=1, megabytes=600)
_held = []
_read = []  # Names of the logs that this process has read.


def rows_of_log(path, key, page):
    """Two rows of one of seven vehicles, by the log's size."""
    name = path.name
    if (gate := path.absolute().parents[1] / "gate").is_fifo():
        # It ends when the last process that reads logs has ended.
        _held.append(gate.open("a", buffering=1))
        _held[-1].write(f"{name}\n")
    if "hang" in name:
        signal.pause()
    size = path.stat().st_size
    if "slow" in name:
        time.sleep(60)
    if "waits" in name:  # It waits for a disk or other processes, longer than its processor time.
        time.sleep(LIMITS.seconds + 0.5)
    if "crash" in name:
        time.sleep(0.1)
        ctypes.string_at(0)
    if "big" in name:
        bytearray(3 << 30)
    _read.append(name)
    if "leaves" in name and len(_read) > 1:
        raise MemoryError
    if "bug" in name:
        raise KeyError("a fault of mavdem")
    if "extra" in name:
        raise MissingExtra(
            Fact(PackageFact.EXTRA_MISSING, subject=path, extra="mcap", names=["mcap"])
        )
    if "where" in name:
        return [FlightRow(file=str(path), status=str(available_workers()))], {}
    if "damaged" in name:
        # Only here: it imports pytest, which every process that reads logs would wait for.
        from refusals import prose

        raise Unreadable(prose(f"{path} is damaged."))
    axes = ("roll", "pitch")
    return [
        FlightRow(file=str(path), vehicle=f"quad {size % 7}", axis=axis, tier="a") for axis in axes
    ], {}


class InThisProcess:
    """A reader without processes, of stand-ins unless another function makes the rows of a log."""

    limits = LIMITS

    def __init__(self, rows=None):
        self.rows = rows or rows_of_log

    def outcomes(self, jobs):
        return (outcome_of(job, self.rows) for job in jobs)


def track(
    out,
    *names,
    baseline=(),
    reader=None,
    **options,
):
    from mavdem.fleet import tracking

    reader = reader or InThisProcess()
    return tracking.track(out, [*map(str, names)], reader, [*map(str, baseline)], **options)


def make_logs(folder, count, name="log"):
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{name}_{number}.bin" for number in range(count)]
    for number, path in enumerate(paths):
        path.write_bytes(f"{name} {number}".encode() * (5 + number))
    return paths


def table_of(out):
    """The table, byte for byte."""
    from mavdem.fleet.table_files import table_path

    assert not list(out.glob(".unfinished"))
    return table_path(out).read_bytes()


def fleet_of(out, rows):
    """Creates a fleet with these rows, none of which is judged."""
    from mavdem.fleet.judgement import publish_judgements
    from mavdem.fleet.sources import LogSource
    from mavdem.fleet.store import open_store

    with open_store(out) as fleet:
        for file in dict.fromkeys(row.file for row in rows):
            of_log = tuple(row for row in rows if row.file == file)
            fleet.add(
                LogSource(file, 1, "now"), JobOutcome(file, "read", of_log, of_log[0].key), LIMITS
            )
        fleet.track([LogSource(row.file, 1, "now") for row in rows])
        publish_judgements(fleet, lambda rows, _: rows)


def statuses(out):
    from mavdem.fleet.stored_rows import read_rows

    return {Path(row.file).name: row.status for row in read_rows(out) if row.status != "ok"}
