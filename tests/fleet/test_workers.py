"""Workers: what one log does to its process, and what runs leave that are killed; here and on a cluster.

Most of these start processes. And sources: which logs names stand for, here and behind URLs.
"""

import errno
import os
import pickle
import posixpath
import resource
import signal
import socket
import sqlite3
import subprocess
import sys
import threading
from contextlib import closing
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from multiprocessing import active_children
from pathlib import Path
from unittest.mock import MagicMock, Mock, PropertyMock

import psutil
from pytest import fixture, mark, param, raises
from recorded_flights import LOGS
from refusals import prose, unreadable
from standin_logs import LIMITS, make_logs, rows_of_log, table_of, track

from mavdem.errors import Unreadable
from mavdem.facts import Fact
from mavdem.facts.fleet import FleetFolderFact, ReadingFact
from mavdem.facts.sources import SourceFact
from mavdem.fleet import cluster, workers
from mavdem.fleet.cluster import Cluster
from mavdem.fleet.row import FlightRow
from mavdem.fleet.sources import copy_remote_file, find_logs
from mavdem.fleet.stored_rows import STORE, read_rows
from mavdem.fleet.workers import (
    FunctionByName,
    Job,
    JobLimits,
    LogReader,
    Supervision,
    WorkerPool,
    exit_code_of_ended,
    outcome_of,
    read_within_limits,
)
from mavdem.processes import lower_priority, peak_mebibytes


def test_an_outcome_has_the_log_s_name_and_key_and_why_it_has_no_rows(tmp_path):
    """A log is read, known by its content, of an unknown format, or too large for the memory."""
    (path,) = map(str, make_logs(tmp_path, 1))
    memory_error = Unreadable(prose("It does not fit."))
    memory_error.__context__ = MemoryError()

    outcome = outcome_of(Job(path), lambda path, key, page: ([FlightRow(file="copy")], {}))
    (row,) = outcome.rows
    assert (row.file, row.key) == (path, outcome.key) and row.mavdem_version
    assert outcome_of(Job(path, (outcome.key,)), None).ended == "known"
    unknown_format = Unreadable(Fact(SourceFact.FORMAT_UNKNOWN, path=path, name="text"))
    damaged = outcome_of(Job(path), Mock(side_effect=unknown_format))
    (row,) = damaged.rows
    assert damaged.ended == "read" and row.status_code == SourceFact.FORMAT_UNKNOWN
    assert path not in row.status
    assert (row.file, row.key) == (path, outcome.key)
    with raises(MemoryError):  # With a higher limit it may be read.
        outcome_of(Job(path), Mock(side_effect=memory_error))


def test_pipes_and_devices_are_not_opened_as_logs(tmp_path):
    os.mkfifo(tmp_path / "pipe.tlog")
    os.symlink("loop.bin", tmp_path / "loop.bin")
    codes = [
        outcome_of(Job(str(tmp_path / name)), None).rows[0].status_code
        for name in ("pipe.tlog", "loop.bin", "none")
    ]
    assert codes == [
        ReadingFact.NO_PLAIN_FILE,
        ReadingFact.LOG_UNREACHABLE,
        ReadingFact.LOG_UNREACHABLE,
    ]


@mark.slow
def test_no_log_stops_a_run(tmp_path):
    """Among eight logs one takes too long, one ends its process, and one needs too much memory."""
    logs = tmp_path / "logs"
    make_logs(logs, 3)
    for name in ("slow", "crash", "big", "where", "waits"):
        make_logs(logs, 1, name)
    # The file is sparse: its content alone takes longer to read than there is time.
    os.truncate(logs / "slow_0.bin", 1 << 40)
    healthy = make_logs(tmp_path / "healthy", 1)
    run_result = track(
        tmp_path / "fleet", logs, reader=WorkerPool(2, LIMITS, rows_of_log), baseline=healthy
    )
    assert (run_result.logs, run_result.read, run_result.problems) == (8, 8, ())
    rows_by_name = {Path(row.file).name: row for row in read_rows(tmp_path / "fleet")}
    # The process starts no others.
    assert rows_by_name["where_0.bin"].status == "1"
    assert {name: row.status_code for name, row in rows_by_name.items() if row.status_code} == {
        "slow_0.bin": ReadingFact.READING_TOO_LONG,
        "big_0.bin": ReadingFact.READING_TOO_LARGE,
        "crash_0.bin": ReadingFact.READER_DIED,
    }


def test_an_exit_code_is_waited_for_while_another_thread_collects_it(monkeypatch):
    codes = iter((None, None, errno.ENOMEM, errno.ENOMEM))
    process = Mock()
    type(process).exitcode = PropertyMock(side_effect=codes)
    assert exit_code_of_ended(process) == errno.ENOMEM
    monkeypatch.setattr(workers, "EXIT_CODE_SECONDS", 0.01)
    assert exit_code_of_ended(Mock(exitcode=None)) is None


def test_a_run_that_can_start_no_process_ends_and_says_so(tmp_path):
    _, most = limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (3, most))  # A pipe needs more open files.
    try:
        fact = unreadable(LogReader().read, Job(str(tmp_path)), LIMITS, rows_of_log)
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, limits)
    assert fact.code is ReadingFact.READERS_NOT_STARTED


@mark.slow
@mark.parametrize("name, logs", [param("log", 1, marks=mark.in_full), ("leaves", 9)])
def test_a_process_is_renewed_after_so_many_logs_or_where_memory_does_not_last(
    name, logs, tmp_path
):
    """A process reads as many logs as it may, or leaves memory allocated: another process reads the next log."""
    (path,) = make_logs(tmp_path, 1, name)
    reader = LogReader()
    processes = set()
    for _ in range(2):
        outcome = reader.read(Job(str(path)), LIMITS._replace(logs=logs), rows_of_log)
        assert outcome.ended == "read"
        processes |= {child.pid for child in active_children()}
    reader.stop()
    assert len(processes) == 2


RUN = """
import signal
import sys
from standin_logs import rows_of_log
from mavdem.cli import track
from mavdem.cli.commands import main
from mavdem.cli.termination import raise_on_termination_signals
if __name__ == "__main__":
    track.ROWS_OF_LOG = rows_of_log
    # Shells let what they start in the background ignore Ctrl-C.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    raise_on_termination_signals()
    sys.exit(main(["track", sys.argv[1], "--out", sys.argv[2], "--jobs", "2"]))
"""


@fixture
def hanging(tmp_path):
    """A run whose two processes read logs that never end, and what waits until both have ended."""
    make_logs(tmp_path / "logs", 2, "hang")
    for number, log in enumerate(make_logs(tmp_path / "logs", 4)):
        log.write_bytes(bytes(1000 + number))  # The largest logs are read first.
    gate = tmp_path / "gate"
    scratch = tmp_path / "scratch"
    os.mkfifo(gate)
    scratch.mkdir()
    script = tmp_path / "run.py"
    script.write_text(RUN)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "TMPDIR": str(scratch)}
    arguments = [sys.executable, script, tmp_path / "logs", tmp_path / "fleet"]
    reader = os.open(gate, os.O_RDONLY | os.O_NONBLOCK)
    os.set_blocking(reader, True)
    with gate.open("w") as writer:
        run = subprocess.Popen(
            arguments,
            env=environment,
            stdin=writer,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
    with open(reader, encoding="utf-8") as names:
        hanging = (name for name in names if "hang" in name)
        assert len({next(hanging), next(hanging)}) == 2
        yield run, names
    run.kill()


@mark.in_full
@mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_an_ended_run_leaves_nothing_and_is_resumed_to_the_same_table(tmp_path, hanging, number):
    """The run is interrupted or killed while two logs hang; the next run reads those that are missing."""
    run, names = hanging
    for _ in range(2):  # A second signal changes nothing.
        os.killpg(run.pid, number)
    # Both end when no process has them open any longer.
    error_output = run.communicate()[1]
    assert "hang" not in names.read()  # No further log is begun.
    assert run.returncode == (-number if number == signal.SIGKILL else 128 + number)
    assert "Traceback" not in error_output
    assert not list((tmp_path / "scratch").iterdir())
    out = tmp_path / "fleet"
    with closing(sqlite3.connect(out / STORE)) as db:
        (log_count,) = db.execute("select count(*) from logs").fetchone()
    (tmp_path / "gate").unlink()
    for log in (tmp_path / "logs").glob("hang*"):
        log.rename(log.with_name(f"log_{log.name[4:]}"))
    assert track(out, tmp_path / "logs").read == 6 - log_count == 2
    track(tmp_path / "whole", tmp_path / "logs")
    assert table_of(out) == table_of(tmp_path / "whole")


@fixture(scope="module")
def one_worker():
    # At the top of the file the import would take every worker of the tests half a second.
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=1, threads_per_worker=1, dashboard_address=None, silence_logs=50
    ) as cluster:
        yield cluster


@mark.in_full
def test_a_killed_worker_of_a_cluster_loses_nothing(tmp_path, one_worker):
    """The worker is killed after its first log and starts again; the table is the same as without that."""
    make_logs(tmp_path / "logs", 6)
    track(tmp_path / "here", tmp_path / "logs")
    killed = []

    def kill_one(run_result, of, outcome):
        if run_result and not killed:
            killed.append(one_worker.workers[0].pid)
            os.kill(killed[0], signal.SIGKILL)

    reader = Cluster(one_worker.scheduler_address, LIMITS, rows_of_log)
    run_result = track(tmp_path / "there", tmp_path / "logs", reader=reader, progress=kill_one)
    assert run_result.read == 6 and killed
    assert (
        table_of(tmp_path / "there") == table_of(tmp_path / "here")
        and len(read_rows(tmp_path / "here")) == 12
    )
    with one_worker.get_client() as client:
        assert not any(client.run(lambda: len(cluster._idle_readers)).values())


@mark.slow
@mark.parametrize(
    "client, code",
    [
        ({"run.side_effect": [{}]}, ReadingFact.NO_CLUSTER_WORKERS),
        ({"run.side_effect": ImportError("mavdem")}, ReadingFact.CLUSTER_CANNOT_READ),
        ({"run.side_effect": [{"0": "other"}]}, ReadingFact.CLUSTER_OF_OTHER_VERSION),
        ({"submit.side_effect": OSError("gone")}, ReadingFact.CLUSTER_CANNOT_READ),
        (None, ReadingFact.NO_SCHEDULER),
    ],
)
def test_a_cluster_that_cannot_read_logs_is_reported(monkeypatch, client, code):
    """A Dask cluster has no workers, no mavdem or another version, or does not answer."""
    if client is not None:
        stand_in(monkeypatch, client)
    assert (
        unreadable(
            list, Cluster("tcp://127.0.0.1:9", LIMITS, rows_of_log).outcomes(iter([Job("x.bin")]))
        ).code
        is code
    )


@mark.slow
def test_a_log_that_killed_workers_of_a_cluster_has_a_row(monkeypatch):
    from distributed import KilledWorker

    killed = KilledWorker("log", None, 3)
    stand_in(monkeypatch, {"submit.side_effect": killed})
    [outcome] = Cluster("tcp://127.0.0.1:9", LIMITS, rows_of_log).outcomes(iter([Job("x.bin")]))
    assert outcome.rows[0].status_code == ReadingFact.CLUSTER_WORKERS_DIED


def stand_in(monkeypatch, client):
    """Lets a mock be the client of a cluster with one worker, for what happens rarely."""
    client_behaviour = {
        "nthreads.return_value": {"0": 1},
        "run.side_effect": lambda *_, **__: {"0": HERE},
    }
    monkeypatch.setattr(cluster, "versions", lambda: HERE)
    monkeypatch.setattr(socket, "create_connection", Mock())
    monkeypatch.setattr(
        "distributed.Client", Mock(return_value=MagicMock(**(client_behaviour | client)))
    )


HERE = "mavdem"


def test_an_outcome_has_the_time_and_the_largest_memory_of_its_reading(monkeypatch, tmp_path):
    monkeypatch.setenv("MAVDEM_TRACEBACK", "1")
    for name in ("forbid_child_processes", "limit_memory"):
        monkeypatch.setattr(workers, name, lambda *_: None)
    largest = peak_mebibytes()
    outcome = read_within_limits(Job(str(tmp_path / "none")), JobLimits(300.0, 600), None)
    assert 0 < outcome.seconds < 60 and largest <= outcome.megabytes < 1e4


@mark.parametrize(
    "limits, ending",
    [(JobLimits(0.0, 600), "time"), (JobLimits(9.0, 1), "memory"), (JobLimits(9.0, 9999), "died")],
)
def test_a_process_is_supervised_by_its_time_and_memory(limits, ending):
    supervision = Supervision(os.getpid(), limits)
    sum(range(10**6))  # This takes some processor time.
    assert supervision.is_beyond_limits() == (ending != "died")
    assert supervision.ending == ending


def names(*given, apart_from=None):
    return [Path(log.path).name for log in find_logs([*map(str, given)], apart_from)[0]]


@fixture
def folder(tmp_path):
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
    log_names = ["a.bin", "b.ULG", "c.mcap", "d.ulg.xz", "no_ending"]
    assert names(folder, apart_from=folder / "results") == log_names
    os.symlink(folder, folder / "below" / "up")  # The folder contains itself, and is read once.
    assert names(folder) == [*log_names, "e.bin"]


def test_a_file_is_taken_whatever_it_holds_and_each_log_once(folder):
    assert names(
        folder / "notes.txt", folder / "a.bin", folder / "*.bin", f"file://{folder}/a.bin"
    ) == [
        "a.bin",
        "notes.txt",
    ]
    assert names(folder / "**" / "*.bin", apart_from=folder / "results") == ["a.bin"]
    (folder / "log[1].bin").write_bytes(b"?")  # The name looks like a pattern, but a file has it.
    assert names(folder / "log[1].bin") == ["log[1].bin"]


@fixture
def served(tmp_path):
    """A folder, and the URL of a server of it."""
    (tmp_path / "served").mkdir()

    class Silent(SimpleHTTPRequestHandler):
        def log_message(self, format, *args):
            """Says nothing."""

    server = ThreadingHTTPServer(
        ("127.0.0.1", 0), partial(Silent, directory=str(tmp_path / "served"))
    )
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield tmp_path / "served", f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    thread.join()


@mark.slow
def test_logs_behind_urls_are_read_and_known(served, tmp_path):
    """Logs on a web server are fetched. A log with the same content on the disk is recognised."""
    folder, url = served
    make_logs(folder, 3)
    (folder / "readme.txt").write_text("none")
    assert names(f"{url}/") == ["log_0.bin", "log_1.bin", "log_2.bin"]
    out = tmp_path / "fleet"
    (problem,) = track(out, f"{url}/log_0.bin", f"{url}/gone.bin").problems
    assert problem.code is FleetFolderFact.URL_UNREADABLE and not problem.figures["fetched"]
    assert [row.file for row in read_rows(out)] == [f"{url}/log_0.bin"] * 2
    # Where it is fetched to is nobody's business.
    read_function = Mock(return_value=([], {}))
    outcome_of(Job(f"{url}/log_0.bin"), read_function)
    assert read_function.call_args.args[0] == Path("log_0.bin")
    # The same content from a disk is known.
    assert track(out, folder / "log_0.bin").read == 1 and len(read_rows(out)) == 2


@mark.slow
def test_a_missing_feature_of_a_file_system_is_reported(tmp_path):
    for url in ("s3://bucket/flight.bin", "nonsense://x/flight.bin"):
        (problem,) = find_logs([url])[1]
        assert problem.code is FleetFolderFact.URL_UNREADABLE and problem.figures["path"] == url
    assert unreadable(copy_remote_file, "http://127.0.0.1:9/x.bin", tmp_path / "x.bin").figures[
        "fetched"
    ]


def test_a_process_of_low_priority_keeps_it(monkeypatch):
    """Only an administrator may raise a priority: ``nice mavdem serve`` would read no log."""
    monkeypatch.setattr(psutil.Process, "nice", nice := Mock(return_value=10))
    lower_priority(5)
    nice.assert_called_once_with()
    lower_priority(15)
    nice.assert_called_with(15)


def test_a_function_by_its_name_is_imported_where_it_is_called():
    named = FunctionByName("posixpath", "basename")
    assert named("a/b") == "b" and pickle.loads(pickle.dumps(named)) is posixpath.basename
