"""Tracking: what is known is not read again, no log stops a run, and a killed run is resumed to the same data set."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from standin_rows import READ
from tracked_logs import LIMITS, files_of, make_logs, statuses, track

from mavdem.errors import Unreadable
from mavdem.fleet import compaction
from mavdem.fleet.dataset import read_rows
from mavdem.fleet.journal import JOURNAL, Journal
from mavdem.fleet.ledger import entry_of, read_ledger
from mavdem.fleet.lock import locked
from mavdem.fleet.reading.crew import Crew
from mavdem.fleet.reading.outcome import Limits, ReadOutcome
from mavdem.fleet.reading.sources import Source
from mavdem.fleet.row import FlightRow
from mavdem.fleet.tracking import FleetTracker


@pytest.mark.slow
def test_no_log_stops_a_run(tmp_path):
    logs = tmp_path / "logs"
    make_logs(logs / "below", 3)
    for name in ("slow", "crash", "big", "bug", "damaged", "odd\n\x1b[31m"):
        make_logs(logs, 1, name)
    (logs / "empty.ulg").touch()
    os.mkfifo(logs / "pipe.tlog")
    os.symlink("loop.bin", logs / "loop.bin")
    os.symlink(logs, logs / "below" / "up")
    os.symlink("/nowhere", logs / "gone.mcap")
    os.truncate(logs / "slow_0.bin", 1 << 40)  # sparse: its content alone takes longer to read than there is time
    done = track(tmp_path / "fleet", logs)
    assert (done.logs, done.read, done.problems) == (13, 13, ())
    found = statuses(tmp_path / "fleet")
    assert found.pop("crash_0.bin") == "The process that read it died (SIGSEGV), each of 2 times."
    assert found == {
        "slow_0.bin": "It takes longer than its time limit of 3 s.",
        "big_0.bin": "It needs more memory than its limit of 600 MB.",
        "bug_0.bin": "This should not have happened (KeyError: 'a fault of mavdem').",
        "damaged_0.bin": "It is damaged.",
        "pipe.tlog": "It is not a plain file.",
        "loop.bin": "It cannot be read (Too many levels of symbolic links).",
        "gone.mcap": "It cannot be read (No such file or directory).",
    }
    # Again, only what may be there by now is looked at.
    assert track(tmp_path / "fleet", logs).read == 3
    # With more time and memory also what these ended.
    assert track(tmp_path / "fleet", logs / "big_0.bin", limits=Limits(3, 700)).read == 1


@pytest.mark.slow
def test_what_is_known_is_not_read_again_whatever_it_is_called(tmp_path):
    out, (one, other) = tmp_path / "fleet", make_logs(tmp_path / "logs", 2)
    assert track(out, tmp_path / "logs").read == 2
    before = files_of(out)
    assert track(out, one, tmp_path / "logs" / "*.bin").read == 0 and files_of(out) == before
    shutil.copy(one, tmp_path / "logs" / "z_copy.bin")
    assert track(out, tmp_path / "logs").read == 1  # looked at, and known by its content
    assert files_of(out) == before and read_ledger(out).by_path[str(tmp_path / "logs" / "z_copy.bin")].ended == "read"
    other.rename(tmp_path / "logs" / "renamed.bin")
    track(out, tmp_path / "logs")
    assert sorted({Path(row.file).name for row in read_rows(out)}) == ["log_0.bin", "renamed.bin"]


@pytest.mark.slow
def test_a_log_that_changed_is_read_anew(tmp_path):
    out, (one, _) = tmp_path / "fleet", make_logs(tmp_path / "logs", 2)
    track(out, tmp_path / "logs")
    one.write_bytes(b"another flight")
    track(out, tmp_path / "logs")
    assert len(read_rows(out)) == 4
    track(tmp_path / "new", tmp_path / "logs")
    assert files_of(out) == files_of(tmp_path / "new")


@pytest.mark.slow
def test_a_new_schema_reads_all_logs_again(tmp_path, monkeypatch):
    out = tmp_path / "fleet"
    make_logs(tmp_path / "logs", 2)
    track(out, tmp_path / "logs")
    for module in ("row", "dataset", "ledger"):
        monkeypatch.setattr(f"mavdem.fleet.{module}.SCHEMA_VERSION", 99)
    assert track(out, tmp_path / "logs").read == 2 and len(read_rows(out)) == 4
    # A reader of all files finds each flight once, and nothing is lost.
    assert [path.name for path in (out / "flights").iterdir()] == ["schema=99"]
    assert [path.name for path in (out / "old").iterdir()] == ["schema=1"]


def test_a_log_that_cannot_be_reached_for_a_while_keeps_its_rows(tmp_path):
    (one,) = make_logs(tmp_path / "disk", 1)
    (tmp_path / "links").mkdir()
    (tmp_path / "links" / one.name).symlink_to(one)
    out = tmp_path / "fleet"
    assert track(out, tmp_path / "links").problems == ()
    before = files_of(out)
    (tmp_path / "disk").rename(tmp_path / "off")
    (problem,) = track(out, tmp_path / "links").problems
    assert problem.endswith("what is known of it is kept. It cannot be read (No such file or directory).")
    assert files_of(out) == before and statuses(out) == {}
    (tmp_path / "off").rename(tmp_path / "disk")
    done = track(out, tmp_path / "links")
    assert (done.read, done.problems) == (0, ()) and files_of(out) == before


@pytest.mark.slow
def test_a_log_that_changed_and_takes_too_long_has_a_row_that_says_so(tmp_path):
    (one,) = make_logs(tmp_path / "logs", 1)
    track(tmp_path / "fleet", one)
    os.truncate(one, 1 << 40)
    assert track(tmp_path / "fleet", one, limits=Limits(1, 600)).problems == ()
    assert statuses(tmp_path / "fleet") == {one.name: "It takes longer than its time limit of 1 s."}


@pytest.mark.parametrize("whole", [False, True])
def test_rows_that_were_deleted_are_read_again(tmp_path, whole):
    out = tmp_path / "fleet"
    make_logs(tmp_path / "logs", 2)
    track(out, tmp_path / "logs")
    before = files_of(out)
    damaged = out / min(before)
    if whole:
        shutil.rmtree(out / "flights")
    else:
        damaged.write_bytes(b"PAR1 and nothing")
        with pytest.raises(Unreadable, match="delete it, and run `mavdem track` again"):
            read_rows(out)
        damaged.unlink()
    assert track(out, tmp_path / "logs").read == (2 if whole else 1)
    assert files_of(out) == before


def test_nothing_is_said_to_be_kept_where_nothing_was_read(tmp_path):
    (one,) = make_logs(tmp_path / "logs", 1)
    (tmp_path / "fleet").mkdir()
    (tmp_path / "fleet" / "pages").touch()
    with pytest.raises(Unreadable, match=r"\(File exists\): once that is put right"):
        track(tmp_path / "fleet", one)


RUN = """
import sys
from pathlib import Path
from tracked_logs import track
track(Path(sys.argv[1]), sys.argv[2])
"""


@pytest.mark.slow
@pytest.mark.parametrize("lines", [1, 5])
def test_a_killed_run_is_resumed_to_the_same_data_set(tmp_path, lines):
    make_logs(tmp_path / "logs", 9, "while")
    track(tmp_path / "whole", tmp_path / "logs")
    out = tmp_path / "killed"
    run = subprocess.Popen(
        [sys.executable, "-c", RUN, str(out), str(tmp_path / "logs")],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )
    journal, deadline = out / JOURNAL, time.monotonic() + 30
    while not journal.exists() or journal.read_bytes().count(b"\n") < lines:
        assert time.monotonic() < deadline and run.poll() is None
        time.sleep(0.02)
    run.send_signal(signal.SIGKILL)
    run.wait()
    kept = journal.read_bytes().count(b"\n")
    with journal.open("ab") as file:
        file.write(b'{"entry": {"path": "torn')
    done = track(out, tmp_path / "logs")
    assert done.read == 9 - kept < 9
    assert files_of(out) == files_of(tmp_path / "whole") and journal.stat().st_size == 0


@pytest.mark.slow
def test_a_compaction_that_was_cut_off_is_done_again(tmp_path, monkeypatch):
    out = tmp_path / "fleet"
    make_logs(tmp_path / "logs", 8)
    track(tmp_path / "whole", tmp_path / "logs")
    written = []

    def write_group(folder: Path, group: str, rows: Sequence[FlightRow], baseline: str) -> None:
        if len(written) == 2:
            raise OSError(28, "No space left on device")
        written.append(group)
        original(folder, group, rows, baseline)

    original = compaction.write_group
    monkeypatch.setattr(compaction, "write_group", write_group)
    with pytest.raises(Unreadable, match="cannot be written to .No space left on device.*the same command goes on"):
        track(out, tmp_path / "logs")
    monkeypatch.setattr(compaction, "write_group", original)
    assert track(out, tmp_path / "logs").read == 0
    assert files_of(out) == files_of(tmp_path / "whole")


def test_one_run_at_a_time(tmp_path):
    make_logs(tmp_path / "logs", 1)
    out = tmp_path / "fleet"
    out.mkdir()
    with locked(out), pytest.raises(Unreadable, match=rf"process {os.getpid()} on .*wait until it has ended"):
        track(out, tmp_path / "logs")
    assert track(out, tmp_path / "logs").read == 1


def test_names_without_a_log_are_said_and_the_others_read(tmp_path):
    (log,) = make_logs(tmp_path / "logs", 1)
    done = track(tmp_path / "fleet", log, tmp_path / "none.bin", tmp_path / "*.ulg")
    assert done.read == 1 and [problem.split("/")[-1] for problem in done.problems] == [
        "none.bin does not exist: check the name.",
        "*.ulg names no log: check the name.",
    ]
    with pytest.raises(Unreadable, match="none.bin does not exist"):
        track(tmp_path / "other", tmp_path / "none.bin")
    assert not (tmp_path / "other").exists()


def test_a_baseline_is_kept_apart_and_stays_until_another_is_given(tmp_path):
    healthy, flown = make_logs(tmp_path / "healthy", 3), make_logs(tmp_path / "flown", 5, "fly")
    seen = []

    def second_pass(rows: Sequence[FlightRow], baseline: Sequence[FlightRow]) -> Sequence[FlightRow]:
        seen.append((rows[0].vehicle, [Path(row.file).name for row in baseline]))
        return rows

    tracker = FleetTracker(tmp_path / "fleet", Crew(1, LIMITS, READ), second_pass=second_pass)
    tracker.track([str(tmp_path / "flown")], [str(tmp_path / "healthy")])
    assert {Path(row.file).name for row in read_rows(tmp_path / "fleet")} == {path.name for path in flown}
    first = dict(seen)
    assert sum(map(bool, first.values())) > 0
    seen.clear()
    tracker.track([str(tmp_path / "flown")])
    assert not seen  # nothing is new
    tracker.track([str(tmp_path / "flown")], [str(healthy[0])])
    assert dict(seen) != first and set(dict(seen)) == set(first)
    with pytest.raises(Unreadable, match="--baseline"):
        tracker.track([str(tmp_path / "flown")], [str(tmp_path / "nothing")])


def beside(rows: Sequence[FlightRow], baseline: Sequence[FlightRow]) -> Sequence[FlightRow]:
    return [replace(row, health_reason=" ".join(sorted({Path(one.file).name for one in baseline}))) for row in rows]


def test_a_new_baseline_judges_all_vehicles_also_where_the_first_run_with_it_was_cut_off(tmp_path, monkeypatch):
    one, other = make_logs(tmp_path / "healthy", 2)
    make_logs(tmp_path / "flown", 8)
    flown = [str(tmp_path / "flown")]

    def tracker(name: str) -> FleetTracker:
        return FleetTracker(tmp_path / name, Crew(1, LIMITS, READ), second_pass=beside)

    tracker("whole").track(flown, [str(other)])
    tracker("fleet").track(flown, [str(one)])
    written = []

    def write_group(folder: Path, *arguments: Any) -> None:
        if folder == tmp_path / "fleet":
            if written:
                raise KeyboardInterrupt
            written.append(folder)
        original(folder, *arguments)

    original = compaction.write_group
    with monkeypatch.context() as cut_off, pytest.raises(KeyboardInterrupt):
        cut_off.setattr(compaction, "write_group", write_group)
        tracker("fleet").track(flown, [str(other)])
    assert written and files_of(tmp_path / "fleet") != files_of(tmp_path / "whole")
    tracker("fleet").track(flown)
    assert files_of(tmp_path / "fleet") == files_of(tmp_path / "whole")
    assert {row.health_reason for row in read_rows(tmp_path / "fleet")} == {"", other.name}


def test_a_baseline_of_another_schema_is_no_empty_one(tmp_path, monkeypatch):
    healthy, *_ = make_logs(tmp_path / "logs", 2)
    tracker = FleetTracker(tmp_path / "fleet", Crew(1, LIMITS, READ))
    tracker.track([str(tmp_path / "logs")], [str(healthy)])
    for module in ("row", "dataset", "ledger", "journal"):
        monkeypatch.setattr(f"mavdem.fleet.{module}.SCHEMA_VERSION", 99)
    with pytest.raises(Unreadable, match="name the healthy flights again with --baseline"):
        tracker.track([str(tmp_path / "logs")])
    assert tracker.track([str(tmp_path / "logs")], [str(healthy)]).read == 2
    assert {row.file for row in tracker.healthy()} == {str(healthy)}


class ReaderInTrouble:
    limits = LIMITS

    def outcomes(self, *_: object) -> Iterator[Any]:
        raise BlockingIOError(11, "Resource temporarily unavailable")
        yield


def test_trouble_of_the_reader_is_not_blamed_on_the_folder(tmp_path):
    make_logs(tmp_path / "logs", 1)
    with pytest.raises(Unreadable, match=r"^Logs cannot be read any further .Resource temporarily unavailable"):
        FleetTracker(tmp_path / "fleet", ReaderInTrouble()).track([str(tmp_path / "logs")])


def test_a_journal_of_another_schema_is_read_again(tmp_path, monkeypatch):
    outcome = ReadOutcome("read", (FlightRow(file="a.bin", key="00-1"),), "00-1")
    with Journal(tmp_path) as journal:
        journal.append(entry_of(Source("a.bin", 1, "now"), outcome, ["g00"], LIMITS), outcome.rows)
    with Journal(tmp_path) as journal:
        assert list(journal.entries) == ["a.bin"]
    monkeypatch.setattr("mavdem.fleet.journal.SCHEMA_VERSION", 99)
    with Journal(tmp_path) as journal:
        assert not journal.entries and not journal.lines and journal.path.stat().st_size == 0
