"""The process that reads logs: ``… -m mavdem.fleet.reading.worker MEGABYTES MODULE:FUNCTION SCRATCH``.

Jobs come as lines of JSON on standard input, and an outcome goes back for each, one after the other. It ends when its
input does, and then removes SCRATCH, the folder for its temporary files. What a log does to it, a hang or a crash, is
the matter of :mod:`mavdem.fleet.reading.limited_worker`, which started it.
"""

from __future__ import annotations

import json
import os
import resource
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from importlib import import_module, metadata
from pathlib import Path
from queue import SimpleQueue
from tempfile import TemporaryDirectory
from threading import Thread
from typing import Any
from urllib.parse import urlsplit

from mavdem.dem.parallel import stay_in_this_process
from mavdem.errors import Unreadable
from mavdem.fleet.reading.outcome import MEGABYTE, READY, Job, ReadOutcome, content_key, failed
from mavdem.fleet.reading.sources import fetch, is_url
from mavdem.fleet.row import FlightRow

ReadLog = Callable[[Path, Callable[..., Any] | None, str, str], list[FlightRow]]
"""From a log's path, what writes a page or None, the folder for it, and the key of the log's content, to its rows."""


def main() -> None:
    """Reads jobs from standard input until it ends."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what a library prints is no answer
    jobs: SimpleQueue[str] = SimpleQueue()
    megabytes, read, scratch = int(sys.argv[1]), named(sys.argv[2]), sys.argv[3]
    limit_memory(megabytes)
    stay_in_this_process()  # others like it have the other cores
    Thread(target=_receive, args=(jobs, scratch), daemon=True).start()
    answers.write(f"{READY}\n")
    answers.flush()
    while True:
        values = json.loads(jobs.get())
        job = Job(**values | {"known": tuple(values["known"])})
        answers.write(perform(job, read, megabytes).to_json() + "\n")
        answers.flush()


def _receive(jobs: SimpleQueue[str], scratch: str) -> None:
    for line in sys.stdin:
        jobs.put(line)
    # Whoever asked is gone, also where that was killed: nobody waits for an answer.
    shutil.rmtree(scratch, ignore_errors=True)
    os._exit(0)


def limit_memory(megabytes: int) -> None:
    """Lets allocations beyond so much fail. Linux counts what is allocated; elsewhere the limit may do nothing."""
    # Not the address space: mapped files and reserved stacks of threads take no memory.
    with suppress(ValueError, OSError):
        resource.setrlimit(resource.RLIMIT_DATA, (megabytes * MEGABYTE, megabytes * MEGABYTE))


def perform(job: Job, read: ReadLog, megabytes: int) -> ReadOutcome:
    """Reads one log."""
    began = time.perf_counter()
    _forget_peak_memory()
    try:
        outcome = _outcome(job, read)
    except MemoryError:
        outcome = failed(job, "memory", f"It needs more memory than its limit of {megabytes} MB.")
    return replace(outcome, seconds=time.perf_counter() - began, megabytes=_peak_memory())


def _outcome(job: Job, read: ReadLog) -> ReadOutcome:
    key = ""
    try:
        with _local(job.path) as path:
            with path.open("rb") as file:
                key = content_key(file)
            if key in job.known:
                return ReadOutcome("known", key=key)
            rows = read(path, named(job.page) if job.page else None, job.pages, key)
            return ReadOutcome("read", tuple(_of(row, job, path, key) for row in rows), key)
    except Unreadable as error:
        if isinstance(error.__context__, MemoryError):
            raise MemoryError from None  # with a higher limit it may be read
        return failed(job, "read" if key else "source", _nameless(str(error), job.path), key)
    except OSError as error:
        return failed(job, "source", f"It cannot be read ({error.strerror or error}).", key)
    except MemoryError:
        raise
    except Exception as error:
        return failed(job, "error", f"This should not have happened ({type(error).__name__}: {error}).", key)


def named(function: str) -> Callable[..., Any]:
    """The function of ``package.module:function``."""
    module, _, name = function.partition(":")
    found: Callable[..., Any] = getattr(import_module(module), name)
    return found


@contextmanager
def _local(path: str) -> Iterator[Path]:
    """The log as a plain file of this machine; raises ``Unreadable`` or ``OSError``."""
    if not is_url(path):
        if Path(path).exists() and not Path(path).is_file():
            raise Unreadable(f"{path} is not a plain file.")  # opening one may wait for ever
        yield Path(path)
        return
    with TemporaryDirectory(prefix="mavdem-") as folder:
        place = Path(folder) / (urlsplit(path).path.rpartition("/")[2][-100:] or "log")
        fetch(path, place)
        yield place


def _of(row: FlightRow, job: Job, path: Path, key: str) -> FlightRow:
    """The row with the name of the log, which is only there: copies of a log have equal rows."""
    return replace(
        row,
        file=job.path,
        key=key,
        status=_nameless(row.status, str(path)),
        warnings=tuple(_nameless(warning, str(path)) for warning in row.warnings),
        mavdem_version=metadata.version("mavdem"),
    )


def _nameless(sentence: str, path: str) -> str:
    """A sentence about a log without its name, which has its own column."""
    return f"It{sentence.removeprefix(path)}" if sentence.startswith(path) else sentence.replace(path, "the log")


def _forget_peak_memory() -> None:
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def _peak_memory() -> float:
    """MB, since it was last forgotten, or where that cannot be, since the process began."""
    with suppress(OSError, StopIteration, ValueError):
        lines = Path("/proc/self/status").read_text().splitlines()
        return int(next(line for line in lines if line.startswith("VmHWM")).split()[1]) / 1024
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (MEGABYTE if sys.platform == "darwin" else 1024)


if __name__ == "__main__":
    main()
