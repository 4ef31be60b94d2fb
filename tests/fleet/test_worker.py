"""The worker: what becomes of a log whose reader wants more memory than there is, and of what the process leaves."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from standin_rows import READ

from mavdem.errors import Unreadable
from mavdem.fleet.reading.limited_worker import LimitedWorker
from mavdem.fleet.reading.outcome import Job, Limits
from mavdem.fleet.reading.worker import perform
from mavdem.fleet.row import FlightRow


def unfit(path: Path, page: Any, pages: str, key: str) -> list[FlightRow]:
    try:
        raise MemoryError
    except MemoryError:
        raise Unreadable(f"{path} does not fit into memory.") from None


def damaged(path: Path, page: Any, pages: str, key: str) -> list[FlightRow]:
    raise Unreadable(f"{path} is damaged, and {path} is cut.")


def test_want_of_memory_is_the_limit_s_however_the_reader_says_it(tmp_path):
    (tmp_path / "x.bin").write_bytes(b"?")
    outcome = perform(Job(str(tmp_path / "x.bin")), unfit, 600)
    assert (outcome.ended, outcome.rows[0].status) == ("memory", "It needs more memory than its limit of 600 MB.")


def test_a_sentence_about_a_log_leaves_its_name_to_its_column(tmp_path):
    (tmp_path / "x.bin").write_bytes(b"?")
    outcome = perform(Job(str(tmp_path / "x.bin")), damaged, 600)
    assert (outcome.ended, outcome.rows[0].file) == ("read", str(tmp_path / "x.bin"))
    assert outcome.rows[0].key == outcome.key != "" and outcome.rows[0].status.startswith("It is damaged, and ")


def test_the_process_starts_no_others_and_leaves_nothing(tmp_path):
    (tmp_path / "where.bin").write_bytes(b"?")
    worker = LimitedWorker(Limits(30, 600), READ)
    cores, process, scratch = worker.run(Job(str(tmp_path / "where.bin"))).rows[0].status.split()
    assert cores == "1" and Path(scratch).is_dir()
    worker.close()
    assert not Path(scratch).exists()
    with pytest.raises(ProcessLookupError):  # a zombie would be there
        os.kill(int(process), 0)


READ_AND_WAIT = """
import sys, time
from standin_rows import READ
from mavdem.fleet.reading.limited_worker import LimitedWorker
from mavdem.fleet.reading.outcome import Job, Limits
worker = LimitedWorker(Limits(30, 600), READ)
print(worker.run(Job(sys.argv[1])).rows[0].status, flush=True)
time.sleep(60)
"""


def test_the_process_leaves_nothing_where_the_run_is_killed(tmp_path):
    (tmp_path / "where.bin").write_bytes(b"?")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    arguments = [sys.executable, "-c", READ_AND_WAIT, str(tmp_path / "where.bin")]
    with subprocess.Popen(arguments, env=environment, stdout=subprocess.PIPE, text=True) as run:
        assert run.stdout is not None
        scratch = Path(run.stdout.readline().split()[2])
        assert scratch.is_dir()
        run.send_signal(signal.SIGKILL)
    deadline = time.monotonic() + 20
    while scratch.exists() and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not scratch.exists()
