"""The store and its runs: what goes in comes out, what is known is not read again, and health is judged."""

import json
import math
import re
import shutil
import sqlite3
import sys
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import closing
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from unittest.mock import Mock

from pyarrow import parquet
from pytest import approx, fixture, mark, raises
from refusals import unreadable
from standin_logs import InThisProcess, fleet_of, make_logs, statuses, table_of, track

from mavdem.facts import Fact
from mavdem.facts.fleet import FleetFolderFact, ReadingFact
from mavdem.facts.motors import HealthUnknown, MotorsBetween
from mavdem.facts.sources import PackageFact
from mavdem.fleet import judgement, store, table_files
from mavdem.fleet.judgement import (
    judgement_lock,
    mark_pages_updated,
    outdated_vehicles,
    publish_judgements,
)
from mavdem.fleet.row import FlightRow
from mavdem.fleet.store import open_store
from mavdem.fleet.stored_rows import (
    BRIEF_COLUMNS,
    STORE,
    StoredRow,
    read_brief_rows,
    read_rows,
)
from mavdem.fleet.table_files import row_schema, table_path, write_file
from mavdem.fleet.tracking import assess_rows, logs_taken_for_healthy, residual_mean
from mavdem.fleet.workers import JobLimits

PAGE = (Path(__file__).parents[2] / "docs" / "fleet.md").read_text()
FULL = FlightRow(
    file="a/flight.tlog",
    vehicle="quad 7",
    system=1,
    date=datetime(2026, 11, 21, 13, 5, 1, 250_000, tzinfo=UTC),
    duration=61.5,
    motors=("motor 1 (front right)", "motor 2"),
    spins=(1, -1),
    positions=((0.7, 0.7), (-0.7, -0.7)),
    effect=(-0.31, 0.29),
    effect_interval=(0.02, math.nan),
    warnings=("It is windy.",),
)
FAILED = FlightRow.without_flight("b.bin", Fact(ReadingFact.NO_VEHICLE))


@mark.slow
def test_stored_rows_are_read_back_unchanged(tmp_path):
    rows = [FULL, FAILED, FlightRow(file="odd\udcff\n.bin")]
    fleet_of(tmp_path, rows)
    assert read_rows(tmp_path) == sorted(rows, key=lambda row: row.order)
    assert [FlightRow(**json.loads(json.dumps(row.as_dict()))) for row in rows] == rows
    assert FULL.effect_interval == (0.02, None) and rows[2].file == "odd\\udcff\n.bin"


@mark.slow
def test_the_examples_of_the_documentation_answer(here, capsys):
    """Runs the Python examples of the documentation on a made-up fleet."""
    make_logs(here / "logs", 1, "damaged")
    track(here / "fleet", here / "logs")
    columns = {"vehicle": "7", "axis": "roll", "motors": ("1", "2"), "trim_share": (1.1, 0.9)}
    columns["health_reason"] = "Motor 1."
    days = ((1, "ok"), (2, "fault"))
    example_rows = [
        FlightRow(file=f"{day}.bin", date=f"2026-11-0{day}", health=health, **columns)
        for day, health in days
    ]
    rows = [*example_rows, *read_rows(here / "fleet")]
    stored_rows = [StoredRow(json.dumps(row.as_dict()), row.file) for row in rows]
    write_file(table_path(here / "fleet"), stored_rows, here / "fleet")
    names = {}
    examples = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    for code in examples:
        exec(code, names)
    assert len(examples) == 2
    assert names["found"] == [("7", "fault", "Motor 1.", 2)]
    output = capsys.readouterr().out
    assert "status" in output


def refusal(use):
    return unreadable(use).code


def test_what_is_no_fleet_and_what_is_damaged_is_refused(tmp_path):
    assert refusal(lambda: read_rows(tmp_path / "none")) is FleetFolderFact.NO_FLEET
    (tmp_path / STORE).write_bytes(b"SQLite format 3\0 and nothing" * 99)
    assert refusal(lambda: read_rows(tmp_path)) is FleetFolderFact.FLEET_DAMAGED
    assert refusal(open_store(tmp_path).__enter__) is FleetFolderFact.FLEET_DAMAGED


def test_a_sound_store_that_is_locked_is_not_called_damaged(tmp_path, monkeypatch):
    """The remedy of a damaged store is to delete it. One that lacks its tables is damaged."""
    monkeypatch.setattr("mavdem.fleet.stored_rows.BUSY_SECONDS", 0.0)
    with closing(sqlite3.connect(tmp_path / STORE, isolation_level=None)) as other_run:
        other_run.execute("create table other (name text)")
        other_run.execute("begin exclusive")
        assert refusal(lambda: read_rows(tmp_path)) is FleetFolderFact.FLEET_NOT_READ
    assert refusal(lambda: read_rows(tmp_path)) is FleetFolderFact.FLEET_DAMAGED


@mark.slow
@mark.parametrize("row", ["[1]", "{"])
def test_a_damaged_row_is_reported(fleet, row):
    """The JSON of one row is damaged: the fleet is refused with that reason, and its other rows can be read."""
    out, folder, (log, _), _ = fleet
    with closing(sqlite3.connect(out / STORE, isolation_level=None)) as db:
        db.execute("update flights set row = ? where rowid = 1", [row])
    assert refusal(lambda: read_rows(out)) is FleetFolderFact.FLEET_DAMAGED
    with open_store(out) as store:
        query = "select row, file from flights"
        assert len([*store.sound_rows(query)]) == len([*store.db.execute(query)]) - 1
    table_path(out).unlink()
    assert refusal(lambda: track(out, folder, log)) is FleetFolderFact.FLEET_DAMAGED


@mark.slow
@mark.parametrize(
    "version, change",
    [
        (1, "json_remove(row, '$.tier', '$.status_code')"),
        (99, "json_set(row, '$.charge', 0.7)"),
    ],
)
def test_a_fleet_of_another_version_opens_with_the_columns_of_this_one(fleet, version, change):
    """What it lacks is null, what it has beside is dropped; logs that are there are read again."""
    out, folder, (log, other_log), before = fleet
    with closing(sqlite3.connect(out / STORE, isolation_level=None)) as db:
        db.execute(f"update flights set row = {change}")
        db.execute(f"pragma user_version = {version}")
    assert {row.tier for row in read_rows(out)} == {"a" if version > 1 else None}
    other_log.unlink()
    assert len(track(out, folder, other_log).problems) == 1
    rows = {Path(row.file).name: row.tier for row in read_rows(out)}
    assert rows == {log.name: "a", other_log.name: "a" if version > 1 else None}
    assert parquet.read_schema(table_path(out)).equals(row_schema())
    if version > 1:
        assert table_of(out) == before
    else:
        assert table_of(out) != before
    assert track(out, log).read == 0


@mark.slow
def test_without_pyarrow_a_fleet_has_its_rows_but_no_table_that_is_older_than_they(
    fleet, monkeypatch
):
    out, folder, *_ = fleet
    make_logs(folder, 3)
    with monkeypatch.context() as core:
        core.setitem(sys.modules, "pyarrow", None)
        track(out, folder)
        assert len(read_rows(out)) == 6 and not table_path(out).exists()
    assert track(out, folder).read == 0 and table_of(out)


@mark.slow
def test_a_second_run_waits_until_the_first_has_written(fleet, tmp_path, monkeypatch):
    """Another process holds the lock of the store for longer than a run waits."""
    out, *_ = fleet
    code_by_vehicle = sqlite3.connect(out / STORE, isolation_level=None)
    code_by_vehicle.execute("begin immediate")
    monkeypatch.setattr(store, "BUSY_SECONDS", 0.1)
    more_rows = make_logs(tmp_path / "more", 1, "other")
    assert refusal(lambda: track(out, *more_rows)) is FleetFolderFact.FLEET_NOT_WRITTEN
    code_by_vehicle.execute("rollback")
    assert track(out, tmp_path / "more").read == 1 and len(read_rows(out)) == 6


@fixture
def fleet(tmp_path):
    """A fleet, the folder of its two logs, these, and its table."""
    logs = make_logs(tmp_path / "logs", 2)
    assert track(tmp_path / "fleet", tmp_path / "logs").read == 2
    return tmp_path / "fleet", tmp_path / "logs", logs, table_of(tmp_path / "fleet")


@mark.slow
def test_what_is_known_is_not_read_again_whatever_it_is_called(fleet):
    out, folder, (log, other_log), before = fleet
    assert track(out, log, folder / "*.bin").read == 0 and table_of(out) == before
    shutil.copy(log, folder / "z_copy.bin")
    assert track(out, folder).read == 1  # The file is read, and recognised by its content.
    assert table_of(out) == before and track(out, folder).read == 0
    with open_store(out) as opened:
        assert opened.copies() == [(str(log), str(folder / "z_copy.bin"))]
    other_log.rename(folder / "renamed.bin")
    track(out, folder)
    assert sorted({Path(row.file).name for row in read_rows(out)}) == ["log_0.bin", "renamed.bin"]


def test_copies_are_hashed_and_not_read_although_logs_are_read_at_the_same_time(tmp_path):
    class AllAtOnce(InThisProcess):
        def outcomes(self, jobs):
            return super().outcomes([*jobs])

    (log, _) = make_logs(tmp_path / "logs", 2)
    for number in range(2):
        shutil.copy(log, log.with_name(f"z_copy_{number}.bin"))
    progress = Mock()
    track(tmp_path / "fleet", log.parent, reader=AllAtOnce(), progress=progress)
    endings = [outcome.ended for _, _, outcome in (call.args for call in progress.mock_calls[1:])]
    assert endings == ["read", "read", "known", "known"]


@mark.slow
def test_a_log_that_changed_is_read_anew(fleet):
    out, folder, (log, _), before = fleet
    log.write_bytes(b"another flight")
    track(out, folder)
    track(folder.parent / "new", folder)
    assert table_of(out) == table_of(folder.parent / "new") != before


@mark.slow
def test_a_table_that_could_not_be_written_is_written_by_the_next_run(fleet, monkeypatch):
    out, folder, *_ = fleet
    more_rows = make_logs(folder, 8)
    with monkeypatch.context() as disk:
        disk.setattr(
            table_files, "write_file", Mock(side_effect=OSError(28, "No space left on device"))
        )
        assert refusal(lambda: track(out, folder)) is FleetFolderFact.FLEET_NOT_WRITTEN
    assert track(out, folder).read == 0 and len(read_rows(out)) == 2 * len(more_rows)


@mark.slow
def test_another_run_may_write_while_the_table_is_written(tmp_path, monkeypatch):
    def write(path, rows, folder):
        with open_store(folder) as other_store:
            other_store.healthy = [FULL]
        write_file(path, rows, folder)

    monkeypatch.setattr(table_files, "write_file", write)
    monkeypatch.setattr(store, "BUSY_SECONDS", 0.1)
    fleet_of(tmp_path, [FULL])
    assert table_of(tmp_path)


@mark.slow
def test_no_run_judges_a_vehicle_while_another_updates_pages_by_its_rows(tmp_path):
    fleet_of(tmp_path, [FULL])
    newer = replace(FULL, file="b.bin", key="b-1")
    with open_store(tmp_path) as first_run, ThreadPoolExecutor(1) as thread:
        with judgement_lock(tmp_path):
            second_run = thread.submit(fleet_of, tmp_path, [FULL, newer])
            assert second_run not in wait([second_run], timeout=0.2).done
            mark_pages_updated(first_run, outdated_vehicles(first_run))
        second_run.result(timeout=60)
        assert outdated_vehicles(first_run) == {FULL.vehicle}


@mark.slow
def test_a_run_that_waits_judges_by_the_baseline_that_was_set_meanwhile(tmp_path):
    """The second run begins while the first holds the lock and sets a baseline."""
    fleet_of(tmp_path, [FULL])
    baselines = []

    def assess(rows, healthy_rows):
        baselines.append(healthy_rows)
        return rows

    def judge():
        with open_store(tmp_path) as second_run:
            publish_judgements(second_run, assess)

    with open_store(tmp_path) as first_run, ThreadPoolExecutor(1) as thread:
        with judgement_lock(tmp_path):
            judging = thread.submit(judge)
            assert judging not in wait([judging], timeout=0.2).done
            first_run.healthy = [FULL]
        judging.result(timeout=60)
    assert baselines == [[FULL]]


@mark.slow
def test_a_changed_vehicle_takes_the_place_of_its_rows_in_the_table(tmp_path):
    rows = [replace(FULL, file=f"{name}.bin", key=f"{name}-1", vehicle=name) for name in "cab"]
    fleet_of(tmp_path, rows)
    changed = [replace(rows[1], tier="a"), replace(FULL, file="c.bin", key="new-1", vehicle="b")]
    fleet_of(tmp_path, changed)
    spliced = parquet.read_table(table_path(tmp_path))
    table_path(tmp_path).unlink()
    with open_store(tmp_path) as whole_store:
        publish_judgements(whole_store, assess_rows)
    assert spliced.equals(parquet.read_table(table_path(tmp_path)))
    assert spliced["vehicle"].to_pylist() == ["a", "b", "b"]
    assert spliced["tier"].to_pylist() == ["a", None, None]


@mark.slow
def test_a_change_writes_only_the_file_with_the_rows_of_its_vehicle(tmp_path, monkeypatch):
    """The table has files of four rows. New rows of vehicle v5 go to the second file, a new vehicle to the last."""
    monkeypatch.setattr(table_files, "ROWS_PER_FILE", 4)
    names = [f"v{number}" for number in range(10)]
    rows = [replace(FULL, file=f"{name}.bin", key=f"{name}-1", vehicle=name) for name in names]
    fleet_of(tmp_path, rows)
    paths = [table_path(tmp_path, number) for number in range(3)]
    assert [parquet.read_metadata(path).num_rows for path in paths] == [4, 4, 2]
    contents = [path.read_bytes() for path in paths]
    more_rows = replace(FULL, file="v5_more.bin", key="more-1", vehicle="v5")
    new = replace(FULL, file="a.bin", key="a-1", vehicle="a new vehicle")
    fleet_of(tmp_path, [more_rows, new])
    changed = [path.read_bytes() != content for path, content in zip(paths, contents, strict=True)]
    assert changed == [False, True, True]
    vehicles = parquet.read_table(tmp_path / "flights")["vehicle"].to_pylist()
    assert sorted(vehicles) == ["a new vehicle", *sorted([*names, "v5"])]
    # A file that is lost is written again, and so is all where the columns of any are of another version.
    paths[1].unlink()
    fleet_of(tmp_path, [new])
    assert len(parquet.read_table(tmp_path / "flights")) == 12
    older = parquet.read_table(paths[1]).drop_columns(["tier"])
    parquet.write_table(older, paths[1])
    fleet_of(tmp_path, [replace(new, tier="a")])
    assert parquet.read_table(paths[1]).column_names == parquet.read_table(paths[0]).column_names
    with closing(sqlite3.connect(tmp_path / STORE, isolation_level=None)) as db:
        db.execute("pragma user_version = 1")
    monkeypatch.setattr(table_files, "ROWS_PER_FILE", 100)
    fleet_of(tmp_path, [new])
    assert len(parquet.read_table(table_path(tmp_path))) == 12 and not paths[2].exists()


@mark.parametrize("date", ["2026-01-01T00:00:00", "tomorrow", 5])
def test_a_row_whose_date_is_damaged_is_a_damaged_store(tmp_path, date):
    text = json.dumps(FULL.as_dict() | {"date": date})
    with raises(sqlite3.DatabaseError):
        write_file(table_path(tmp_path), [StoredRow(text, "a.bin")], tmp_path)


@mark.slow
def test_a_whole_table_that_was_not_finished_is_written_anew(tmp_path, monkeypatch):
    """The disk is full after the first of several files."""
    monkeypatch.setattr(table_files, "ROWS_PER_FILE", 2)
    rows = [replace(FULL, file=f"{name}.bin", key=f"{name}-1", vehicle=name) for name in "bcd"]
    fleet_of(tmp_path, rows)
    code_by_vehicle = replace(FULL, file="a.bin", key="a-1", vehicle="a")
    table_path(tmp_path).unlink()
    with monkeypatch.context() as disk:
        full_disk = Mock(side_effect=[None, OSError(28, "No space left on device")])
        disk.setattr(table_files, "write_file", full_disk)
        assert (
            refusal(lambda: fleet_of(tmp_path, [code_by_vehicle]))
            is FleetFolderFact.FLEET_NOT_WRITTEN
        )
    write_file(table_path(tmp_path), [], tmp_path)
    fleet_of(tmp_path, [code_by_vehicle])
    vehicles = parquet.read_table(tmp_path / "flights")["vehicle"].to_pylist()
    assert sorted(vehicles) == ["a", "b", "c", "d"]


@mark.slow
def test_the_rows_of_a_vehicle_with_any_name_are_spliced(tmp_path):
    row = replace(FULL, key="a-1", vehicle="quad\x007")
    fleet_of(tmp_path, [row])
    fleet_of(tmp_path, [replace(row, tier="a")])
    assert parquet.read_table(table_path(tmp_path))["tier"].to_pylist() == ["a"]


def make_older(folder):
    """Makes the store of a fleet one of a version without brief rows."""
    with closing(sqlite3.connect(folder / STORE, isolation_level=None)) as db:
        db.execute("drop index flights_by_page")
        for table, column in (
            ("flights", "brief"),
            ("flights", "page"),
            ("unpublished", "vehicle"),
        ):
            db.execute(f"alter table {table} drop column {column}")


@mark.slow
def test_an_older_store_is_read_before_a_run_has_opened_it(tmp_path):
    fleet_of(tmp_path, [FULL])
    make_older(tmp_path)
    (row,) = read_brief_rows(tmp_path)
    assert row.vehicle == FULL.vehicle


@mark.slow
def test_two_runs_may_open_an_older_store_at_a_time(tmp_path):
    """One run is in the middle of converting an older store while a second one opens it.

    The second waits and then succeeds.
    """
    fleet_of(tmp_path, [FULL])
    make_older(tmp_path)
    with closing(sqlite3.connect(tmp_path / STORE, isolation_level=None)) as first_run:
        first_run.execute("begin immediate")
        first_run.execute("alter table flights add column brief text")
        first_run.execute("alter table flights add column page text")
        with ThreadPoolExecutor() as executor:

            def open_it():
                with open_store(tmp_path):
                    return True

            second_run = executor.submit(open_it)
            wait([second_run], 0.5)
            first_run.execute("commit")
            assert second_run.result()


@mark.slow
def test_brief_rows_have_the_columns_of_the_index_and_are_made_for_an_older_store(tmp_path):
    fleet_of(tmp_path, [FULL, FAILED])
    brief_rows = read_brief_rows(tmp_path)
    full_rows = read_rows(tmp_path)
    for brief, full in zip(brief_rows, full_rows, strict=True):
        for name in BRIEF_COLUMNS:
            assert getattr(brief, name) == getattr(full, name)
        assert brief.effect is None
    make_older(tmp_path)
    with open_store(tmp_path):
        assert read_brief_rows(tmp_path) == brief_rows


@mark.slow
def test_a_log_that_cannot_be_reached_for_a_while_keeps_its_rows(tmp_path):
    (log,) = make_logs(tmp_path / "disk", 1)
    (tmp_path / "links").mkdir()
    (tmp_path / "links" / log.name).symlink_to(log)
    out = tmp_path / "fleet"
    assert track(out, tmp_path / "links").problems == ()
    before = table_of(out)
    (tmp_path / "disk").rename(tmp_path / "off")
    (problem,) = track(out, tmp_path / "links").problems
    assert problem.code is ReadingFact.LOG_KEPT
    assert table_of(out) == before and statuses(out) == {}


@mark.slow
def test_what_failed_is_tried_again_where_that_may_help(tmp_path, monkeypatch):
    """A log that lacks a Python package is read again in each run, one that is damaged is not.

    A fault of mavdem itself is tried again by another version.
    """
    logs = tmp_path / "logs"
    make_logs(logs, 1, "bug")
    make_logs(logs, 1, "damaged")
    (log_of_extra,) = make_logs(logs, 1, "extra")
    out = tmp_path / "fleet"
    assert track(out, logs).read == 3
    assert {Path(row.file).name: row.status_code for row in read_rows(out)} == {
        "bug_0.bin": ReadingFact.READING_FAILED,
        "damaged_0.bin": "failed",
        "extra_0.bin": PackageFact.EXTRA_MISSING,
    }
    reason = "The log needs mcap: pip install 'mavdem[mcap]'."
    assert reason in [row.status for row in read_rows(out)]
    assert track(out, logs).read == 1
    log_of_extra.unlink()
    assert track(out, logs).read == 0
    monkeypatch.setattr(store.metadata, "version", lambda name: "99.0")
    assert track(out, logs).read == 1


@mark.slow
def test_a_missing_package_that_was_stored_as_an_error_is_tried_again(tmp_path):
    def rows_of_earlier_version(path, key, page):
        raise (
            KeyError("MissingExtra: The log needs mcap") if "0" in path.name else KeyError("a bug")
        )

    logs = tmp_path / "logs"
    make_logs(logs, 2)
    out = tmp_path / "fleet"
    assert track(out, logs, reader=InThisProcess(rows_of_earlier_version)).read == 2
    with closing(sqlite3.connect(out / STORE)) as db, db:
        db.execute("update flights set row = replace(row, ?, '(')", ["(KeyError: '"])
    assert track(out, logs).read == 1


@mark.slow
@mark.parametrize(
    "limits, read", [(JobLimits(1, 600), 0), (JobLimits(2, 600), 1), (JobLimits(1, 700), 1)]
)
def test_more_time_or_memory_is_another_try(tmp_path, monkeypatch, limits, read):
    class TooSlow(InThisProcess):
        def outcomes(self, jobs):
            return (replace(outcome, ended="time") for outcome in super().outcomes(jobs))

    make_logs(tmp_path / "logs", 1)
    track(tmp_path / "fleet", tmp_path / "logs", reader=TooSlow())
    monkeypatch.setattr(InThisProcess, "limits", limits)
    assert track(tmp_path / "fleet", tmp_path / "logs").read == read


def rows_naming_baseline(rows, baseline):
    """Returns rows whose ``health_reason`` has the file names of the baseline that they were judged with."""
    return [
        replace(row, health_reason=" ".join(sorted({Path(one.file).name for one in baseline})))
        for row in rows
    ]


@mark.slow
def test_a_baseline_is_no_part_of_the_table_and_stays_until_another_is_given(tmp_path):
    """Healthy flights are compared with, but not listed.

    The next run uses the same baseline unless another is given.
    """
    healthy = make_logs(tmp_path / "healthy", 3)
    example_rows = make_logs(tmp_path / "flown", 5, "fly")
    out = tmp_path / "fleet"

    def reasons(baseline=()):
        track(out, tmp_path / "flown", baseline=baseline, assess=rows_naming_baseline)
        assert {Path(row.file).name for row in read_rows(out)} == {
            path.name for path in example_rows
        }
        return {row.health_reason for row in read_rows(out)}

    assert reasons([tmp_path / "healthy"]) == reasons() != {""}
    # The next one judges all vehicles anew; so does one of another fleet.
    assert reasons([healthy[0]]) == {"", healthy[0].name}
    track(tmp_path / "other", healthy[1])
    assert reasons([tmp_path / "other"]) == {"", healthy[1].name}
    (damaged,) = make_logs(tmp_path, 1, "damaged")
    assert refusal(lambda: reasons([tmp_path / "nothing"])) is FleetFolderFact.BASELINE_UNKNOWN
    assert refusal(lambda: reasons([damaged])) is FleetFolderFact.BASELINE_WITHOUT_FLIGHT
    bad_rows = (replace(FULL, light_motors="bad"), replace(FULL, health="fault"))
    for number, bad_row in enumerate(bad_rows):
        folder = tmp_path / f"bad {number}"
        folder.mkdir()
        fleet_of(folder, [bad_row])
        assert refusal(lambda: reasons([folder])) is FleetFolderFact.BASELINE_MOTORS_BAD  # noqa: B023
    assert reasons() == {"", healthy[1].name}


@mark.slow
def test_only_vehicles_of_which_anything_is_new_are_judged(tmp_path, monkeypatch):
    """The judgement of the first vehicle fails. The next run judges only vehicles that have new flights or failed."""
    make_logs(tmp_path / "logs", 7)
    judged_vehicles = []

    def judge(rows, baseline):
        judged_vehicles.append(rows[0].vehicle)
        if len(judged_vehicles) == 1:
            raise ValueError("a fault")
        return rows

    track(tmp_path / "fleet", tmp_path / "logs", assess=judge)
    code_by_vehicle = {row.vehicle: row.health_code for row in read_rows(tmp_path / "fleet")}
    assert sorted(judged_vehicles) == sorted(code_by_vehicle) and len(judged_vehicles) > 2
    # A fault on one vehicle's figures keeps back no other's.
    assert [name for name, code in code_by_vehicle.items() if code] == [judged_vehicles[0]]
    assert code_by_vehicle[judged_vehicles[0]] == HealthUnknown.HEALTH_FAILED
    judged_vehicles[:] = ["not the first"]
    track(tmp_path / "fleet", tmp_path / "logs", assess=judge)
    assert judged_vehicles == ["not the first"]
    # A fleet that was judged by other rules is judged again, though nothing is read.
    monkeypatch.setattr(judgement, "RULES_VERSION", judgement.RULES_VERSION + 1)
    track(tmp_path / "fleet", tmp_path / "logs", assess=judge)
    assert sorted(judged_vehicles[1:]) == sorted(code_by_vehicle)


def flight(key, means, **columns):
    """Returns a row with a model: each µs of motors 1 and 2 accelerates by 1 and -1 rad/s², with a damping of 2/s."""
    values = {
        "motors": ("1", "2"),
        "axis": "roll",
        "mean_inputs": means,
        "mean_outputs": (0.1, 0.2),
        "effect": (1.0, -1.0),
        "damping": 2.0,
    }
    return FlightRow(file=f"{key}.bin", key=key, **values | columns)


def test_the_residual_mean_is_what_healthy_models_leave_of_a_flight():
    """The models of three healthy flights explain an acceleration that differs from the measured mean by 10 rad/s²."""
    healthy = [
        flight(str(number), (1500 + number, 1500 - number), inputs="motors")
        for number in (-1, 0, 1)
    ]
    new = flight("new", (1510, 1500), inputs="motors")
    assert residual_mean(new, healthy) == approx(-10)
    faster = replace(new, mean_outputs=(0.1, 0.5))
    assert residual_mean(faster, healthy) == approx(-10 + 2 * 0.3)
    assert residual_mean(healthy[0], healthy) == approx(3)
    # Other axes, motors and inputs are other models.
    by_demand = flight("demand", (0.1,), inputs="demand", effect=(2.0,))
    for incomparable_row in (
        replace(new, axis="pitch"),
        replace(new, motors=("other", "names")),
        by_demand,
    ):
        assert residual_mean(incomparable_row, healthy) is None
    assert residual_mean(healthy[0], [*healthy, by_demand]) == approx(3)


@mark.slow
def test_health_comes_from_the_vehicle_s_healthy_flights():
    """Four flights of one vehicle.

    The last one has another balance; flights with a motor at its limit or an oscillation do not count as healthy.
    """
    balance_columns = {
        "balance": (0.0, 0.0, 0.0),
        "balance_error": (0.001,) * 3,
        "balance_lean": (0.05, 0.0),
        "lean_effect": (0.0,) * 6,
        "lean_effect_error": (0.1,) * 6,
        "duration": 60.0,
        "positions": ((1, 1), (-1, -1), (1, -1), (-1, 1)),
        "spins": (1, 1, -1, -1),
        "motors": tuple("1234"),
    }
    rows = [
        flight(
            f"{day}",
            (day, 0),
            vehicle="7",
            vehicle_basis="board",
            date=datetime(2026, 5, day, tzinfo=UTC),
            **balance_columns,
        )
        for day in range(1, 5)
    ]
    # Of nobody known they are not compared, and a log without a flight says nothing.
    unnamed_row, failed = (
        assess_rows([row], [])[0]
        for row in (
            replace(rows[0], vehicle_basis="system id", fault_probability=0.9),
            FlightRow(file="x", status="No."),
        )
    )
    assert unnamed_row.health_code == HealthUnknown.VEHICLE_UNNAMED
    assert unnamed_row.fault_probability is None and failed.health_reason is None
    # Nor is one taken for healthy in which a motor was at its limit, or which oscillated.
    for unsound in ({"saturated": (0.0, 0.0101, 0.0, 0.0)}, {"oscillation": 12.0}):
        code_by_vehicle = [replace(rows[0], **unsound), *rows[1:]]
        code_by_vehicle = assess_rows(code_by_vehicle, [])[0]
        assert code_by_vehicle.health_code == MotorsBetween.MOTORS_UNCHANGED
        assert code_by_vehicle.residual_mean == approx(2)
        assert "against 3 of the vehicle's first flights" in code_by_vehicle.health_reason
    # They end at a flight whose own log suspects a motor, although nothing differs.
    suspect_rows = [*rows[:2], replace(rows[2], watched_motor=1), rows[3]]
    assert logs_taken_for_healthy(suspect_rows) == logs_taken_for_healthy(rows[:2])
    rows[3] = replace(rows[3], balance=(0.08, 0.08, -0.08))
    assert [row.health == "ok" for row in assess_rows(rows, rows[:3])] == [True] * 3 + [False]
