"""Sources: which logs names stand for, here and behind URLs."""

import os
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from standin_logs import make_logs, track

from mavdem.errors import Unreadable
from mavdem.fleet.sources import fetch, find_logs
from mavdem.fleet.store import read_rows

LOGS = Path(__file__).parents[2] / "logs"


def names(*given: object, apart_from: Path | None = None) -> list[str]:
    return [Path(log.path).name for log in find_logs([*map(str, given)], apart_from)[0]]


@pytest.fixture
def folder(tmp_path: Path):
    for name in ("a.bin", "below/b.ULG", "below/c.mcap", "below/d.ulg.xz", "results/e.bin"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"?")
    (tmp_path / "no_ending").write_bytes((LOGS / "ardupilot_default_rates.tlog").read_bytes()[:9000])
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
    assert names(folder / "notes.txt", folder / "a.bin", folder / "*.bin", f"file://{folder}/a.bin") == [
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

    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Silent, directory=str(tmp_path / "served")))
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
