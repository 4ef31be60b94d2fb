"""Rows of a fleet: what goes in comes out, in the columns that DESIGN.md names, for every reader."""

from __future__ import annotations

import math
import random
import shutil
from datetime import UTC, datetime

import duckdb
import pandas
import polars
import pytest

from mavdem.errors import Unreadable
from mavdem.fleet.dataset import (
    UNFINISHED,
    check_free,
    durable_write,
    group_file,
    group_of,
    groups_in,
    is_fleet,
    read_rows,
    set_old_aside,
    write_rows,
)
from mavdem.fleet.row import FlightRow, row_schema

FULL = FlightRow(
    file="a/flight.tlog",
    key="00ff",
    vehicle="quad 7",
    system=1,
    date=datetime(2026, 11, 21, 13, 5, 1, 250_000, tzinfo=UTC),
    axis="roll",
    tier="a",
    duration=61.5,
    motors=("motor 1 (front right)", "motor 2"),
    spins=(1, -1),
    positions=((0.7, 0.7), (-0.7, -0.7)),
    effect=(-0.31, 0.29),
    effect_interval=(0.02, math.nan),
    trim_share=(1.04, 0.96),
    suspect_motor=2,
    warnings=("It is windy.",),
)
FAILED = FlightRow(file="b.bin", status="It is a zip archive.")


def test_rows_come_back_as_they_were(tmp_path):
    write_rows(tmp_path, [FULL, FAILED])
    assert read_rows(tmp_path) == [FULL, FAILED]
    assert FlightRow.from_dict(FAILED.as_dict()) == FAILED and FlightRow.from_dict(FULL.as_dict()) == FULL
    assert FULL.effect_interval == (0.02, None)


def test_the_columns_that_scripts_rely_on_have_their_types():
    schema = row_schema()
    expected = {
        "file": "string",
        "vehicle": "string",
        "axis": "string",
        "tier": "string",
        "duration": "double",
        "effect": "list<item: double>",
        "effect_interval": "list<item: double>",
        "damping": "double",
        "lag": "double",
        "trim_share": "list<item: double>",
        "wind_torque_sd": "double",
        "residual_mean": "double",
        "error_ratio": "double",
        "health": "string",
        "suspect_motor": "int64",
        "warnings": "list<item: string>",
        "status": "string",
    }
    assert {name: str(schema.field(name).type).replace("element", "item") for name in expected} == expected


def test_the_same_rows_in_another_order_are_the_same_bytes(tmp_path):
    rows = [FlightRow(file=f"{number}.bin", vehicle=f"quad {number % 5}", axis="roll") for number in range(40)]
    written = []
    for folder in (tmp_path / "one", tmp_path / "other"):
        random.Random(len(written)).shuffle(rows)
        write_rows(folder, rows)
        written.append({group: group_file(folder, group).read_bytes() for group in groups_in(folder)})
    assert written[0] == written[1] and set(written[0]) == {group_of(f"quad {number}") for number in range(5)}


def test_rows_that_are_gone_take_their_file_with_them(tmp_path):
    write_rows(tmp_path, [FULL, FAILED])
    write_rows(tmp_path, [FAILED])
    assert read_rows(tmp_path) == [FAILED] and groups_in(tmp_path) == [group_of("unknown")]


def test_what_a_killed_run_left_unfinished_is_no_row_and_goes_with_the_next(tmp_path):
    write_rows(tmp_path, [FULL])
    path = group_file(tmp_path, group_of(FULL.vehicle))
    before = sorted(tmp_path.rglob("*"))
    with durable_write(path, tmp_path) as file:
        file.write(b"what is there if the run is killed here")
        left = [one.relative_to(tmp_path) for one in tmp_path.rglob("*.parquet")]
        assert len(left) == 2 and len([one for one in left if one.parts[0] == "flights"]) == 1
        shutil.copytree(tmp_path / left[left[0].parts[0] == "flights"].parts[0], tmp_path / "kept")
    (tmp_path / "kept").rename(tmp_path / UNFINISHED)
    write_rows(tmp_path, [FULL])
    assert sorted(tmp_path.rglob("*")) == before and read_rows(tmp_path) == [FULL]


def test_names_that_are_no_utf_8_are_kept_in_a_readable_form(tmp_path):
    write_rows(tmp_path, [FlightRow(file="odd\udcff\n.bin")])
    assert read_rows(tmp_path)[0].file == "odd\\udcff\n.bin"


def test_duckdb_polars_and_pandas_read_it(tmp_path):
    write_rows(tmp_path, [FULL, FAILED])
    flights = f"{tmp_path}/flights/schema=1/**/*.parquet"
    found = duckdb.sql(f"select vehicle, effect, date from read_parquet('{flights}') where axis = 'roll'").fetchall()
    assert [(row[0], row[1]) for row in found] == [("quad 7", [-0.31, 0.29])]
    table = polars.scan_parquet(flights).filter(polars.col("status") == "ok").collect()
    assert table["trim_share"].to_list() == [[1.04, 0.96]]
    frame = pandas.read_parquet(tmp_path / "flights" / "schema=1")
    assert sorted(frame["file"]) == ["a/flight.tlog", "b.bin"]


def test_a_folder_of_somebody_else_is_no_fleet_and_is_not_written_to(tmp_path):
    (tmp_path / "flights").mkdir()
    check_free(tmp_path)
    (tmp_path / "flights" / "schema=3").write_text("a note")
    set_old_aside(tmp_path)
    assert not is_fleet(tmp_path) and (tmp_path / "flights" / "schema=3").exists()
    (tmp_path / "flights" / "monday.bin").touch()
    with pytest.raises(Unreadable, match="flights holds files that are not of a fleet: name another folder"):
        check_free(tmp_path)
    write_rows(tmp_path / "fleet", [FULL])
    (tmp_path / "fleet" / "flights" / "monday.bin").touch()
    check_free(tmp_path / "fleet")


def test_rows_set_aside_take_no_others_place_and_newer_ones_stay(tmp_path, monkeypatch):
    monkeypatch.setattr("mavdem.fleet.dataset.SCHEMA_VERSION", 4)
    for _ in range(3):
        for version in (3, 4):
            path = tmp_path / "flights" / f"schema={version}" / "group=g01" / "flights.parquet"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.touch()
        set_old_aside(tmp_path)
    assert sorted(path.name for path in (tmp_path / "old").iterdir()) == ["schema=3", "schema=3.2", "schema=3.3"]
    assert [path.name for path in (tmp_path / "flights").iterdir()] == ["schema=4"]
    monkeypatch.setattr("mavdem.fleet.dataset.SCHEMA_VERSION", 3)
    with pytest.raises(Unreadable, match="was written by a newer mavdem: update this one"):
        set_old_aside(tmp_path)
    assert [path.name for path in (tmp_path / "flights").iterdir()] == ["schema=4"]


def test_what_is_no_fleet_and_what_is_damaged_is_said_in_one_sentence(tmp_path):
    with pytest.raises(Unreadable, match="holds no fleet"):
        read_rows(tmp_path / "none")
    write_rows(tmp_path, [FULL])
    group_file(tmp_path, group_of(FULL.vehicle)).write_bytes(b"PAR1 and nothing")
    with pytest.raises(Unreadable, match="is damaged"):
        read_rows(tmp_path)
