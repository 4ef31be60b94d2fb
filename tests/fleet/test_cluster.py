"""The cluster: batches go to workers that can read them, and a worker that is killed loses nothing."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from distributed import LocalCluster
from standin_rows import READ
from tracked_logs import LIMITS, files_of, is_process, make_logs, statuses, track, waiting_processes

from mavdem.errors import Unreadable
from mavdem.fleet.dataset import read_rows
from mavdem.fleet.reading import cluster
from mavdem.fleet.reading.cluster import BATCH_BYTES, BATCH_LOGS, Cluster, batches
from mavdem.fleet.reading.sources import Source
from mavdem.fleet.tracking import FleetTracker


@pytest.fixture(scope="module")
def two_workers() -> Iterator[Any]:
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs=50) as found:
        yield found


def test_a_batch_has_few_logs_and_no_more_bytes_than_are_read_twice_gladly():
    small = [Source(f"{number}", 10, "") for number in range(2 * BATCH_LOGS + 1)]
    large = [Source("large", BATCH_BYTES, ""), Source("small", 10, ""), Source("unknown", -1, "")]
    assert [len(batch) for batch in batches(small)] == [BATCH_LOGS, BATCH_LOGS, 1]
    assert [[source.path for source in batch] for batch in batches(large)] == [["large"], ["small", "unknown"]]


@pytest.mark.slow
def test_a_killed_worker_loses_nothing(tmp_path, two_workers):
    make_logs(tmp_path / "logs", 24, "while")
    make_logs(tmp_path / "logs", 1, "crash")
    track(tmp_path / "here", tmp_path / "logs", jobs=2)
    killed = []

    def kill_one(done: int, of: int) -> None:
        if done and not killed:
            killed.append(two_workers.workers[0].pid)
            os.kill(killed[0], signal.SIGKILL)

    tracker = FleetTracker(tmp_path / "there", Cluster(two_workers.scheduler_address, LIMITS, READ))
    done = tracker.track([str(tmp_path / "logs")], progress=kill_one)
    assert done.read == 25 and killed
    with two_workers.get_client() as client:
        assert set(client.run(waiting_processes).values()) == {0}
    assert files_of(tmp_path / "there") == files_of(tmp_path / "here") and len(read_rows(tmp_path / "here")) == 49
    assert set(statuses(tmp_path / "there")) == {"crash_0.bin"}


@pytest.mark.parametrize(
    ("name", "value", "sentence"),
    [
        ("SCHEMA_VERSION", 99, r"has mavdem .* \(columns 1\) on Python .*, this machine .*install the same there"),
        (
            "readable_here",
            partial(is_process, os.getpid()),
            "No worker of .* can read .*log_0.bin: put the logs",
        ),
    ],
)
def test_workers_that_cannot_help_are_said(tmp_path, two_workers, monkeypatch, name, value, sentence):
    make_logs(tmp_path, 1)
    monkeypatch.setattr(cluster, name, value)
    with pytest.raises(Unreadable, match=sentence):
        FleetTracker(tmp_path / "fleet", Cluster(two_workers.scheduler_address, LIMITS, READ)).track([str(tmp_path)])


def test_a_cluster_that_is_not_there_is_said(tmp_path: Path, monkeypatch):
    make_logs(tmp_path, 1)
    monkeypatch.setattr(cluster, "SECONDS_TO_CONNECT", 0.5)
    with pytest.raises(Unreadable, match="There is no Dask scheduler at tcp://127.0.0.1:9"):
        FleetTracker(tmp_path / "fleet", Cluster("tcp://127.0.0.1:9", LIMITS, READ)).track([str(tmp_path)])
