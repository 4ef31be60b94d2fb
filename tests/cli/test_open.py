"""A log dropped into the Rerun Viewer, whose loaders write a recording to standard output."""

import json
import subprocess
import sys

from command_line import run
from patience import PATIENCE
from pytest import mark
from recorded_flights import SLOW, short_flight
from rerun.chunk import RrdReader

from mavdem.cli.open import EXIT_INCOMPATIBLE, load

pytestmark = mark.slow


LOADING = """
import json, os, sys
from mavdem.cli.open import load

for recording, *words in json.loads(sys.argv[1]):
    os.dup2(os.open(recording, os.O_WRONLY | os.O_CREAT), 1)
    code = load(words)
    assert code == 0, code
"""
"""Loads logs one after the other, each with its options into a file that is standard output meanwhile."""


def test_a_log_is_written_as_a_dashboard_or_as_the_reason_why_there_is_no_model(tmp_path):
    """In a process of its own, which can be ended where Rerun never answers; a viewer that waits sees what is done."""
    dashboard, reason = str(tmp_path / "dashboard.rrd"), str(tmp_path / "reason.rrd")
    options = ["--recording-id", "any", "--application-id", "dropped"]
    jobs = [
        [dashboard, str(short_flight(tmp_path)), *options],
        [reason, str(SLOW), *options[:2]],
    ]
    command = [sys.executable, "-c", LOADING, json.dumps(jobs)]
    subprocess.run(command, timeout=PATIENCE, check=True)
    for path, shown_path, application, blueprints in (
        (dashboard, "/flight/angle/", "dropped", 2),
        (reason, "/report", "mavdem", 1),
    ):
        read = RrdReader(path)
        assert len(read.blueprints()) == blueprints
        assert [entry.application_id for entry in read.recordings()] == [application]
        assert any(str(chunk.entity_path).startswith(shown_path) for chunk in read.stream())


@mark.parametrize("name, content", [("a.png", b"\x89PNG\r\n"), ("a.mcap", b"\x89MCAP0\r\n")])
def test_a_file_of_others_is_left_to_them(name, content, tmp_path, capfdbinary):
    (tmp_path / name).write_bytes(content)
    assert load([str(tmp_path / name)]) == EXIT_INCOMPATIBLE and not capfdbinary.readouterr().out


def test_a_log_is_learned_from_and_shown(here, monkeypatch):
    monkeypatch.setattr("mavdem.view.show", lambda path: path.unlink())
    assert run("open", short_flight(here), "--axis", "pitch") == 0
