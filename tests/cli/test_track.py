"""``mavdem track``: a fleet in one command, its answers, and how it refuses."""

import shutil
from pathlib import Path

import polars
from command_line import document_of, run
from pytest import mark
from recorded_flights import LOGS


@mark.slow
def test_a_fleet_in_one_command(tmp_path, capsys):
    flights = tmp_path / "flights"
    flights.mkdir()
    shutil.copy(LOGS / "ardupilot_default_rates.tlog", flights)
    (flights / "damaged.ulg").write_bytes(b"ULog\x01\x12\x35\x01" + bytes(99))
    out = tmp_path / "fleet"
    found = document_of(capsys, "track", flights, "--out", out, "--jobs", "1")
    assert (found["logs"], found["read"], found["flights"], found["tiers"]) == (2, 2, 1, {"c": 1})
    assert [Path(one["file"]).name for one in found["failed"]] == ["damaged.ulg"]
    rows = polars.read_parquet(out / "flights" / "**" / "*.parquet").sort("axis")
    assert rows.filter(polars.col("status") == "ok")["axis"].to_list() == ["pitch", "roll"]
    assert (out / rows["page"].drop_nulls()[0]).is_file() and (out / "index.html").is_file()
    # Again, in words.
    assert run("track", flights, "--out", out) == 0
    written = capsys.readouterr()
    assert (
        written.out.startswith("2 logs, 0 of them read; copies count once.")
        and "index.html" in written.err
    )
    # Logs without a flight are no success.
    assert run("track", flights / "damaged.ulg", "--out", tmp_path / "none", "--jobs", "1") == 1
    assert "without the topics of a flight" in capsys.readouterr().out


@mark.parametrize(
    "line, sentence",
    {
        "none.bin --out fleet": "none.bin names no log. Check the name.",
        "x.bin": "Missing option '--out'",
        "x.bin --out x.bin": "x.bin' is a file.",
        "x.bin --out fleet --jobs 2 --scheduler tcp://127.0.0.1:9": "--jobs",
        "x.bin --out fleet --memory-limit 3": "--memory-limit",
        "x.bin --out fleet --time-limit nan": "--time-limit",
        "x.bin --out fleet --scheduler tcp://foo:port": "no address",
    }.items(),
)
def test_what_cannot_be_tracked_is_said(tmp_path, monkeypatch, capsys, line, sentence):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "x.bin").write_bytes(b"?")
    assert run("track", *line.split()) == 2
    assert sentence in capsys.readouterr().err and not (tmp_path / "fleet").exists()
