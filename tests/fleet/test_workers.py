"""Workers: what one log does to its process, and what runs leave that are killed; here and on a cluster.

Most of these start processes. And sources: which logs names stand for, here and behind URLs.
"""

import os
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from contextlib import suppress
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
from distributed import LocalCluster
from recorded_flights import LOGS
from standin_logs import LIMITS, READ, make_logs, seen_by, statuses, table_of, track

from mavdem.errors import Unreadable
from mavdem.fleet import workers
from mavdem.fleet.row import FlightRow
from mavdem.fleet.sources import fetch, find_logs
from mavdem.fleet.store import STORE, read_rows
from mavdem.fleet.workers import Cluster, Job, LogRows, WorkerPool, outcome_of


def test_an_outcome_has_the_log_s_name_and_key_and_why_it_has_no_rows(tmp_path):
    (path,) = make_logs(tmp_path, 1)
    memory = Unreadable("It does not fit.")
    memory.__context__ = MemoryError()

    def failing(error: Exception) -> Any:
        def read(*_: object) -> LogRows:
            raise error

        return read

    found = outcome_of(Job(str(path)), lambda path, key, page: ([FlightRow(file="copy")], {}))
    assert (
        found.rows[0].file == str(path)
        and found.rows[0].key == found.key
        and found.rows[0].mavdem_version
    )
    assert outcome_of(Job(str(path), (found.key,)), None).ended == "known"
    damaged = outcome_of(
        Job(str(path)), failing(Unreadable(f"{path} is damaged, and {path} is cut."))
    )
    assert (damaged.ended, damaged.rows[0].status) == ("read", "It is damaged, and the log is cut.")
    assert (damaged.rows[0].file, damaged.rows[0].key) == (str(path), found.key)
    with pytest.raises(MemoryError):  # with a higher limit it may be read
        outcome_of(Job(str(path)), failing(memory))


def test_what_is_no_plain_file_is_not_opened(tmp_path):
    os.mkfifo(tmp_path / "pipe.tlog")
    os.symlink("loop.bin", tmp_path / "loop.bin")
    said = [
        outcome_of(Job(str(tmp_path / name)), None).rows[0].status
        for name in ("pipe.tlog", "loop.bin", "none")
    ]
    assert said == [
        "It is not a plain file.",
        "It cannot be read (Too many levels of symbolic links).",
        "It cannot be read (No such file or directory).",
    ]


@pytest.mark.slow
def test_no_log_stops_a_run(tmp_path):
    logs = tmp_path / "logs"
    make_logs(logs, 3)
    for name in ("slow", "crash", "big", "where", "waits"):
        make_logs(logs, 1, name)
    # sparse: its content alone takes longer to read than there is time
    os.truncate(logs / "slow_0.bin", 1 << 40)
    healthy = make_logs(tmp_path / "healthy", 1)
    done = track(tmp_path / "fleet", logs, reader=WorkerPool(2, LIMITS, READ), baseline=healthy)
    assert (done.logs, done.read, done.problems) == (8, 8, ())
    found = statuses(tmp_path / "fleet")
    # The process starts no others, and leaves nothing.
    cores, scratch = found.pop("where_0.bin").split()
    assert cores == "1" and not Path(scratch).exists()
    assert found == {
        "slow_0.bin": "It takes longer than its time limit of 2 s.",
        "big_0.bin": "It needs more memory than its limit of 600 MB.",
        "crash_0.bin": "The process that read it died (SIGSEGV), each of 2 times.",
    }


RUN = """
import sys
from pathlib import Path
from standin_logs import LIMITS, READ
from mavdem.fleet.tracking import track
from mavdem.fleet.workers import WorkerPool
if __name__ == "__main__":
    track(Path(sys.argv[1]), [sys.argv[2]], WorkerPool(2, LIMITS, READ))
"""


@pytest.mark.slow
def test_a_killed_run_leaves_nothing_and_is_resumed_to_the_same_table(tmp_path):
    make_logs(tmp_path / "logs", 6, "while")
    track(tmp_path / "whole", tmp_path / "logs")
    out = tmp_path / "killed"
    script = tmp_path / "run.py"
    scratch = tmp_path / "scratch"
    script.write_text(RUN)
    scratch.mkdir()
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "TMPDIR": str(scratch)}
    run = subprocess.Popen([sys.executable, script, out, tmp_path / "logs"], env=environment)

    def kept() -> int:
        with suppress(sqlite3.OperationalError):  # it is not there yet
            return int(
                sqlite3.connect(out / STORE).execute("select count(*) from logs").fetchone()[0]
            )
        return 0

    deadline = time.monotonic() + 60
    while kept() < 2:
        assert time.monotonic() < deadline and run.poll() is None
        time.sleep(0.02)
    run.send_signal(signal.SIGKILL)
    run.wait()
    before = kept()
    done = track(out, tmp_path / "logs")
    assert done.read == 6 - before < 6 and table_of(out) == table_of(tmp_path / "whole")
    while list(scratch.iterdir()):
        assert time.monotonic() < deadline
        time.sleep(0.05)


@pytest.fixture(scope="module")
def two_workers():
    with LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs=50
    ) as found:
        yield found


@pytest.mark.slow
def test_a_killed_worker_of_a_cluster_loses_nothing(tmp_path, two_workers):
    make_logs(tmp_path / "logs", 6, "while")
    track(tmp_path / "here", tmp_path / "logs")
    killed = []

    def kill_one(done: int, of: int) -> None:
        if done and not killed:
            killed.append(two_workers.workers[0].pid)
            os.kill(killed[0], signal.SIGKILL)

    reader = Cluster(two_workers.scheduler_address, LIMITS, READ)
    done = track(tmp_path / "there", tmp_path / "logs", reader=reader, progress=kill_one)
    assert done.read == 6 and killed
    assert (
        table_of(tmp_path / "there") == table_of(tmp_path / "here")
        and len(read_rows(tmp_path / "here")) == 12
    )
    with two_workers.get_client() as client:
        assert not any(client.run(lambda: len(workers._pools)).values())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "value", "sentence"),
    [
        (
            "SCHEMA_VERSION",
            99,
            r"has mavdem .* \(columns 3\) on Python .*, this machine .*install the same there",
        ),
        (
            "machine",
            partial(seen_by, os.getpid()),
            "The worker .* cannot read .*log_0.bin: put the logs",
        ),
    ],
)
def test_workers_that_cannot_help_are_said(
    tmp_path, two_workers, monkeypatch, name, value, sentence
):
    make_logs(tmp_path, 1)
    monkeypatch.setattr(workers, name, value)
    with pytest.raises(Unreadable, match=sentence):
        list(
            Cluster(two_workers.scheduler_address, LIMITS, READ).outcomes(
                iter([Job(str(tmp_path / "log_0.bin"))])
            )
        )


def test_a_cluster_that_is_not_there_is_said():
    with pytest.raises(Unreadable, match="There is no Dask scheduler at tcp://127.0.0.1:9"):
        list(Cluster("tcp://127.0.0.1:9", LIMITS, READ).outcomes(iter([Job("x.bin")])))


def names(*given: object, apart_from: Path | None = None) -> list[str]:
    return [Path(log.path).name for log in find_logs([*map(str, given)], apart_from)[0]]


@pytest.fixture
def folder(tmp_path: Path):
    for name in ("a.bin", "below/b.ULG", "below/c.mcap", "below/d.ulg.xz", "results/e.bin"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"?")
    (tmp_path / "no_ending").write_bytes(
        (LOGS / "ardupilot_default_rates.tlog").read_bytes()[:9000]
    )
    (tmp_path / "server.log").write_text("text, not a flight\n" * 99)
    (tmp_path / "photo.jpg").write_bytes(b"\xff\xd8\xff\xe0\x00\x10JF\xfd" + bytes(999))
    (tmp_path / "notes.txt").write_text("none")
    return tmp_path


def test_a_folder_gives_what_looks_like_a_log_by_its_name_or_its_first_bytes(folder):
    found = ["a.bin", "b.ULG", "c.mcap", "d.ulg.xz", "no_ending"]
    assert names(folder, apart_from=folder / "results") == found
    os.symlink(folder, folder / "below" / "up")  # is its own part, and read once
    assert names(folder) == [*found, "e.bin"]


def test_a_file_is_taken_whatever_it_holds_and_each_log_once(folder):
    assert names(
        folder / "notes.txt", folder / "a.bin", folder / "*.bin", f"file://{folder}/a.bin"
    ) == [
        "a.bin",
        "notes.txt",
    ]
    assert names(folder / "**" / "*.bin", apart_from=folder / "results") == ["a.bin"]
    (folder / "log[1].bin").write_bytes(b"?")  # looks like a pattern, and is a file first
    assert names(folder / "log[1].bin") == ["log[1].bin"]


@pytest.fixture
def served(tmp_path: Path):
    """A folder, and the URL of a server of it."""
    (tmp_path / "served").mkdir()

    class Silent(SimpleHTTPRequestHandler):
        def log_message(self, format: str, *args: object) -> None:
            """Says nothing."""

    server = ThreadingHTTPServer(
        ("127.0.0.1", 0), partial(Silent, directory=str(tmp_path / "served"))
    )
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield tmp_path / "served", f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    thread.join()


@pytest.mark.slow
def test_logs_behind_urls_are_read_and_known(served, tmp_path):
    folder, url = served
    make_logs(folder, 3)
    (folder / "readme.txt").write_text("none")
    assert names(f"{url}/") == ["log_0.bin", "log_1.bin", "log_2.bin"]
    out = tmp_path / "fleet"
    (problem,) = track(out, f"{url}/log_0.bin", f"{url}/gone.bin").problems
    assert problem.startswith(f"{url}/gone.bin cannot be read")
    assert [row.file for row in read_rows(out)] == [f"{url}/log_0.bin"] * 2
    # The same content from a disk is known.
    assert track(out, folder / "log_0.bin").read == 1 and len(read_rows(out)) == 2


def test_what_a_file_system_lacks_is_said(tmp_path, monkeypatch):
    (problem,) = find_logs(["s3://bucket/flight.bin"])[1]
    assert "s3fs" in problem or "cannot be read" in problem
    assert "cannot be read" in find_logs(["nonsense://x/flight.bin"])[1][0]
    with pytest.raises(Unreadable, match="cannot be fetched"):
        fetch("http://127.0.0.1:9/x.bin", tmp_path / "x.bin")
