"""A log dropped into the Rerun Viewer, whose loaders write a recording to standard output."""

import pytest
from command_line import LOGS
from rerun.chunk import RrdReader

from mavdem.cli.commands import main
from mavdem.cli.open import INCOMPATIBLE, load


@pytest.mark.slow
@pytest.mark.parametrize(
    ("log", "shown"),
    [("ardupilot_wind5_steps", "/outputs/roll/"), ("ardupilot_default_rates", "/report")],
)
def test_a_log_is_written_as_a_dashboard_or_as_the_reason_why_there_is_no_model(
    log, shown, tmp_path, capfdbinary
):
    assert load([str(LOGS / f"{log}.tlog"), "--recording-id", "any"]) == 0
    (tmp_path / "shown.rrd").write_bytes(capfdbinary.readouterr().out)
    read = RrdReader(tmp_path / "shown.rrd")
    assert len(read.blueprints()) == 1 and any(
        str(chunk.entity_path).startswith(shown) for chunk in read.stream()
    )


def test_the_viewer_shows_under_its_own_name_what_is_being_done_until_the_dashboard_is_there(
    tmp_path, capfdbinary
):
    assert load([str(LOGS / "ardupilot_wind5_steps.tlog"), "--application-id", "dropped"]) == 0
    (tmp_path / "shown.rrd").write_bytes(capfdbinary.readouterr().out)
    read = RrdReader(tmp_path / "shown.rrd")
    assert len(read.blueprints()) > 2 and [entry.application_id for entry in read.recordings()] == [
        "dropped"
    ]


@pytest.mark.parametrize(
    ("name", "content"), [("a.png", b"\x89PNG\r\n"), ("a.mcap", b"\x89MCAP0\r\n")]
)
def test_a_file_of_others_is_left_to_them(name, content, tmp_path, capfdbinary):
    (tmp_path / name).write_bytes(content)
    assert load([str(tmp_path / name)]) == INCOMPATIBLE and not capfdbinary.readouterr().out


@pytest.mark.slow
def test_a_log_is_learned_from_and_shown(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("mavdem.view.show", lambda path: path.unlink())
    assert main(["open", str(LOGS / "ardupilot_wind5_steps.tlog"), "--axis", "pitch"]) == 0
