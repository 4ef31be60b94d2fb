"""A log dropped into the Rerun Viewer, whose loaders write a recording to standard output."""

import subprocess
import sys

from command_line import PATIENCE, run
from pytest import mark
from recorded_flights import SLOW, short_flight
from rerun.chunk import RrdReader

from mavdem.cli.open import EXIT_INCOMPATIBLE, load

pytestmark = mark.slow


@mark.parametrize(
    "log, shown, application",
    [
        (short_flight, "/flight/angle/", "dropped"),
        (lambda _: SLOW, "/report", "mavdem"),
    ],
)
def test_a_log_is_written_as_a_dashboard_or_as_the_reason_why_there_is_no_model(
    log, shown, application, tmp_path
):
    """In a process of its own, which can be ended where Rerun never answers; a viewer that waits sees what is done."""
    words = [log(tmp_path), "--recording-id", "any"]
    words += ["--application-id", application] if application == "dropped" else []
    loading = "import sys; from mavdem.cli.open import load; sys.exit(load(sys.argv[1:]))"
    with (tmp_path / "shown.rrd").open("wb") as file:
        command = [sys.executable, "-c", loading, *words]
        subprocess.run(command, stdout=file, timeout=PATIENCE, check=True)
    read = RrdReader(tmp_path / "shown.rrd")
    assert len(read.blueprints()) == 1 + (application == "dropped")
    assert [entry.application_id for entry in read.recordings()] == [application]
    assert any(str(chunk.entity_path).startswith(shown) for chunk in read.stream())


@mark.parametrize("name, content", [("a.png", b"\x89PNG\r\n"), ("a.mcap", b"\x89MCAP0\r\n")])
def test_a_file_of_others_is_left_to_them(name, content, tmp_path, capfdbinary):
    (tmp_path / name).write_bytes(content)
    assert load([str(tmp_path / name)]) == EXIT_INCOMPATIBLE and not capfdbinary.readouterr().out


def test_a_log_is_learned_from_and_shown(here, monkeypatch):
    monkeypatch.setattr("mavdem.view.show", lambda path: path.unlink())
    assert run("open", short_flight(here), "--axis", "pitch") == 0
