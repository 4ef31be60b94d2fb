"""The store: what goes in comes out, in the columns that DESIGN.md names, for every reader of the table."""

import json
import math
import re
import sqlite3
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from standin_logs import LIMITS, make_logs, table_of, track

from mavdem.errors import Unreadable
from mavdem.fleet import store
from mavdem.fleet.row import FlightRow, row_schema
from mavdem.fleet.sources import Source
from mavdem.fleet.store import STORE, TABLE, opened, read_rows, write_rows
from mavdem.fleet.workers import Outcome

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
FAILED = FlightRow(file="b.bin", status="It is a zip archive.")


def test_rows_come_back_as_they_were(tmp_path):
    rows = [FULL, FAILED, FlightRow(file="odd\udcff\n.bin")]
    write_rows(tmp_path, rows)
    assert read_rows(tmp_path) == rows
    assert [FlightRow(**json.loads(json.dumps(row.as_dict()))) for row in rows] == rows
    assert FULL.effect_interval == (0.02, None) and rows[2].file == "odd\\udcff\n.bin"


def test_logs_in_another_order_give_the_same_bytes(tmp_path):
    rows = [FlightRow(file=f"{n}.bin", key=f"{n}-1", vehicle=f"quad {n % 5}", axis="roll") for n in range(20)]
    for name, order in (("one", rows), ("other", rows[::-1])):
        with opened(tmp_path / name) as fleet:
            for row in order:
                fleet.add(Source(row.file, 1, "now"), Outcome(row.file, "read", (row,), row.key), LIMITS)
            fleet.track([Source(row.file, 1, "now") for row in order])
            fleet.publish(lambda rows, _: rows)
    assert table_of(tmp_path / "one") == table_of(tmp_path / "other")
    assert read_rows(tmp_path / "one") == sorted(rows, key=lambda row: row.order)


def test_the_examples_of_the_documentation_answer(tmp_path, monkeypatch, capsys):
    make_logs(tmp_path / "logs", 1, "damaged")
    track(tmp_path / "fleet", tmp_path / "logs")
    known = {"vehicle": "7", "axis": "roll", "motors": ("1", "2"), "trim_share": (1.1, 0.9)}
    known["health_reason"] = "Motor 1."
    days = ((1, "ok"), (2, "fault"))
    flown = [FlightRow(file=f"{day}.bin", date=f"2026-11-0{day}", health=health, **known) for day, health in days]
    write_rows(tmp_path / "fleet", [*flown, *read_rows(tmp_path / "fleet")])
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    examples = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    for code in examples:
        exec(code, names)
    assert len(examples) == 3
    assert names["found"] == [("7", "fault", "Motor 1.", 2)]
    assert names["shares"]["trim_share"].to_list() == [1.1, 0.9] * 2
    said = capsys.readouterr().out
    assert "It is damaged." in said and "megabytes" in said


def test_the_documentation_names_columns_that_there_are():
    table = PAGE.partition("| column | what it is |")[2].partition("\n\n")[0]
    named = set(re.findall(r"`([a-z]\w+)`", " ".join(line.split("|")[1] for line in table.splitlines() if line)))
    columns = set(row_schema().names)
    assert named <= columns
    derived = {name for name in columns if re.search(r"_(interval|status|error)$|^residual_|^mean_|^balance_", name)}
    assert columns - named <= derived


def test_a_folder_of_somebody_else_and_a_disk_of_another_machine_are_refused(tmp_path, monkeypatch):
    (tmp_path / "flights").mkdir()
    (tmp_path / "flights" / "monday.bin").touch()
    with pytest.raises(Unreadable, match="flights holds files that are not of this fleet"), opened(tmp_path):
        pass
    assert [path.name for path in tmp_path.iterdir()] == ["flights"]
    monkeypatch.setattr(store, "_disk", lambda folder: "nfs4")
    with pytest.raises(Unreadable, match=r"\(nfs4\), where SQLite's lock does not hold"), opened(tmp_path / "fleet"):
        pass


def test_what_is_no_fleet_and_what_is_damaged_is_said_in_one_sentence(tmp_path):
    with pytest.raises(Unreadable, match="holds no fleet"):
        read_rows(tmp_path / "none")
    write_rows(tmp_path, [FULL])
    (tmp_path / TABLE).write_bytes(b"PAR1 and nothing")
    with pytest.raises(Unreadable, match="is damaged .*delete it, and run `mavdem track` again"):
        read_rows(tmp_path)
    (tmp_path / STORE).write_bytes(b"SQLite format 3\0 and nothing" * 99)
    with pytest.raises(Unreadable, match="fleet.sqlite is damaged .*delete it, and all logs"), opened(tmp_path):
        pass


def test_the_columns_of_another_version_are_refused_and_stay(tmp_path, monkeypatch):
    make_logs(tmp_path / "logs", 1)
    track(tmp_path / "fleet", tmp_path / "logs")
    before = table_of(tmp_path / "fleet")
    monkeypatch.setattr(store, "SCHEMA_VERSION", 99)
    with pytest.raises(Unreadable, match="columns of another version of mavdem: name another folder"):
        track(tmp_path / "fleet", tmp_path / "logs")
    assert table_of(tmp_path / "fleet") == before


def test_a_second_run_waits_until_the_first_has_written(tmp_path, monkeypatch):
    make_logs(tmp_path / "logs", 1)
    track(tmp_path / "fleet", tmp_path / "logs")
    first = sqlite3.connect(tmp_path / "fleet" / STORE, isolation_level=None)
    first.execute("begin immediate")
    monkeypatch.setattr(store, "BUSY_SECONDS", 0.1)
    with pytest.raises(Unreadable, match="cannot be written to .database is locked.: once that is put right"):
        track(tmp_path / "fleet", *make_logs(tmp_path / "more", 1, "other"))
    first.execute("rollback")
    assert track(tmp_path / "fleet", tmp_path / "more").read == 1 and len(read_rows(tmp_path / "fleet")) == 4
