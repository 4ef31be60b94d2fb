"""``mavdem track``: a fleet in one command, its answers, and how it refuses."""

import json
import shutil
from pathlib import Path
from unittest.mock import Mock

from command_line import document_of, refused, run
from fleet_rows import fleet_rows
from pytest import mark
from recorded_flights import LOGS
from standin_logs import InThisProcess, fleet_of, make_logs, track

from mavdem.cli import track as cli_track
from mavdem.cli.exit_codes import EXIT_INTERRUPTED
from mavdem.fleet.names import read_names
from mavdem.fleet.rows_of_log import rows_of_log
from mavdem.fleet.store import open_store
from mavdem.fleet.stored_rows import read_rows
from mavdem.fleet_pages import write_fleet_pages


@mark.slow
def test_a_fleet_in_one_command(tmp_path, capsys, monkeypatch):
    """A folder with a sound log and a damaged one is tracked several times."""
    flights = tmp_path / "flights"
    flights.mkdir()
    shutil.copy(LOGS / "ardupilot_default_rates.tlog", flights)
    damaged = flights / "damaged.ulg"
    damaged.write_bytes(b"ULog\x01\x12\x35\x01" + bytes(99))
    out = tmp_path / "fleet"
    assert run("track", flights, "--out", out, "--jobs", "1", "--json") == 0
    printed = capsys.readouterr()
    document = json.loads(printed.out)
    first, *lines = printed.err.splitlines()
    assert first == "Reading 2 new logs …"
    assert lines[0].startswith("1 of 2: ") and lines[1].startswith("2 of 2: ")
    assert {"logs": 2, "read": 2, "flights": 1, "tiers": {"c": 1}}.items() <= document.items()
    assert [Path(failed_log["file"]).name for failed_log in document["failed"]] == ["damaged.ulg"]
    # At the top of the file the import would take every worker of the tests half a second.
    import polars

    rows = polars.read_parquet(out / "flights" / "**" / "*.parquet").sort("axis")
    assert rows.filter(polars.col("status") == "ok")["axis"].to_list() == ["pitch", "roll"]
    page = out / rows["page"].drop_nulls()[0]
    page.unlink()
    # Again, in words; a page that is gone is made again. Another process would take a second to import what reads logs.
    monkeypatch.setattr("mavdem.cli.track.WorkerPool", lambda *_: InThisProcess(rows_of_log))
    assert run("track", flights, "--out", out) == 0
    written = capsys.readouterr()
    first_line = "2 logs, 1 of them read now; 1 in the table without a flight.\n"
    assert written.out.startswith(first_line)
    assert page.is_file() and "index.html" in written.err
    log = flights / "ardupilot_default_rates.tlog"
    assert run("track", flights, "--out", out, "--baseline", log) == 0
    assert "of an earlier run" not in capsys.readouterr().out
    assert run("track", flights, "--out", out) == 0
    kept_baseline_text = "Baseline: 1 log of an earlier run, since no --baseline was given: "
    assert kept_baseline_text + log.name in " ".join(capsys.readouterr().out.split())
    assert run("track", flights, "--out", out, "--baseline", "none") == 0
    assert "Baseline:" not in capsys.readouterr().out
    # Logs without a flight are no success.
    assert run("track", damaged, "--out", tmp_path / "none", "--jobs", "1") == 1
    assert "without the topics of a flight" in capsys.readouterr().out


def test_copies_are_named_so_that_they_differ():
    copies = [("/x/1/a.ulg", "/x/2/a.ulg"), ("/x/b.ulg", "/x/c\x1b.ulg"), ("/x/d.ulg",) * 12]
    text = cli_track._copies_text(copies)
    assert "1/a.ulg = 2/a.ulg, b.ulg = c" in text and "d.ulg (12 files)" in text
    assert "\x1b" not in text


@mark.slow
def test_names_are_given_kept_and_taken_away(tmp_path, capsys, monkeypatch):
    """The user names a vehicle and a flight by --name, and removes the name of the vehicle."""
    paths = make_logs(tmp_path / "logs", 1)
    out = tmp_path / "fleet"
    track(out, *paths)
    (vehicle,) = {row.vehicle for row in read_rows(out)}
    # The log is known, so that the command reads nothing.
    command = ("track", *paths, "--out", out, "--jobs", "1")
    document = document_of(
        capsys, *command, "--name", f"{vehicle}=Red <b> quad", "--name", f"{paths[0].name}=First"
    )
    assert (document["read"], document["vehicle_names"]) == (0, {vehicle: "Red <b> quad"})
    document_of(capsys, *command)
    page = (out / "index.html").read_text()
    assert "Red &lt;b&gt; quad" in page and "<b> quad" not in page
    assert vehicle in page and '"First"' in page
    assert document_of(capsys, *command, "--name", f"{vehicle}=")["vehicle_names"] == {}
    # Of several names none is stored where one names nothing, but what was read is kept.
    (out / "index.html").unlink()
    names = ("--name", f"{vehicle}=Green", "--name", "quad 9=Blue")
    assert run(*command, *names) == 2
    written = capsys.readouterr()
    assert "'quad 9=Blue' begins with no serial number and no log" in written.err
    assert written.out.startswith("1 log, 0 of them read now")
    assert "Green" not in (out / "index.html").read_text()
    # A run that is stopped keeps the names of what is known by then.
    monkeypatch.setattr(cli_track, "_track_with_progress", Mock(side_effect=KeyboardInterrupt))
    assert run(*command, "--name", f"{vehicle}=Green") == EXIT_INTERRUPTED
    with open_store(out) as store:
        assert read_names(store.db).vehicles == {vehicle: "Green"}


@mark.slow
def test_a_page_says_what_its_row_says_now(tmp_path):
    page = tmp_path / "pages/quad-1-1.html"
    page.parent.mkdir()
    page_alone = '<main>\n<section id="result" class="blocks assessment">\n</section>\n'
    page.write_text(page_alone)
    fleet_of(tmp_path, fleet_rows(7))
    with open_store(tmp_path) as store:
        write_fleet_pages(store, {})
    assert '<p class="headline"><strong>motor 3' in page.read_text()
    fleet_of(tmp_path, fleet_rows(10))
    with open_store(tmp_path) as store:
        write_fleet_pages(store, {})
    assert page.read_text() == page_alone, "its fault is that of a later flight"


@mark.parametrize(
    "line, sentence",
    {
        "none.bin --out fleet": "There is no log of the name none.bin, nor in a folder of that name. Check the name.",
        "x.bin --out x.bin": "x.bin' is a file.",
        "x.bin --out fleet --jobs 2 --scheduler tcp://127.0.0.1:9": "--jobs",
        "x.bin --out fleet --memory-limit 3": "--memory-limit",
        "x.bin --out fleet --name quad": "has no =",
        "x.bin --out fleet --name y.bin=Blue": "there is no log y.bin",
        "x.bin --out fleet --time-limit nan": "--time-limit",
        "x.bin --out fleet --scheduler tcp://foo:port": "no address",
    }.items(),
)
def test_logs_that_cannot_be_tracked_are_reported(here, capsys, line, sentence):
    """A wrong path or option ends the command with exit code 2, and creates no fleet."""
    (here / "x.bin").write_bytes(b"?")
    assert sentence in refused(capsys, 2, "track", *line.split())
    assert not (here / "fleet").exists()


class Interrupted(InThisProcess):
    """A reader whose user presses Ctrl-C after the first log."""

    def outcomes(self, jobs):
        yield next(iter(super().outcomes(jobs)))
        raise KeyboardInterrupt


@mark.slow
def test_ctrl_c_keeps_what_was_read_and_the_same_command_continues(tmp_path, capsys, monkeypatch):
    make_logs(tmp_path / "logs", 3)
    command = ("track", tmp_path / "logs", "--out", tmp_path / "fleet", "--jobs", "1")
    monkeypatch.setattr("mavdem.cli.track.WorkerPool", lambda *_: Interrupted())
    assert run(*command) == EXIT_INTERRUPTED
    assert capsys.readouterr().err.count("What was read is kept") == 1
    monkeypatch.setattr("mavdem.cli.track.WorkerPool", lambda *_: InThisProcess())
    assert run(*command) == 0
    assert capsys.readouterr().out.startswith("3 logs, 2 of them read now;")
