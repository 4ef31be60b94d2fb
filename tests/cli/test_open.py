"""A log dropped into the Rerun Viewer, whose loaders write a recording to standard output."""

from pathlib import Path
from unittest.mock import Mock

from command_line import run
from pytest import mark
from recorded_flights import SLOW, short_flight
from rerun.chunk import RrdReader

from mavdem.cli.learn import learn_command
from mavdem.cli.open import EXIT_INCOMPATIBLE, load

pytestmark = mark.slow


def test_a_log_is_written_as_a_dashboard_or_as_the_reason_why_there_is_no_model(
    tmp_path, capfdbinary
):
    """A viewer that waits sees what is done meanwhile."""
    options = ["--recording-id", "any", "--application-id", "dropped"]
    for log, log_options, shown_path, application, blueprints in (
        (short_flight(tmp_path), options, "/flight/angle/", "dropped", 2),
        (SLOW, options[:2], "/report", "mavdem", 1),
    ):
        assert load([str(log), *log_options]) == 0
        path = tmp_path / f"{application}.rrd"
        path.write_bytes(capfdbinary.readouterr().out)
        read = RrdReader(str(path))
        assert len(read.blueprints()) == blueprints
        assert [entry.application_id for entry in read.recordings()] == [application]
        assert any(str(chunk.entity_path).startswith(shown_path) for chunk in read.stream())


@mark.parametrize("name, content", [("a.png", b"\x89PNG\r\n"), ("a.mcap", b"\x89MCAP0\r\n")])
def test_a_file_of_others_is_left_to_them(name, content, tmp_path, capfdbinary):
    (tmp_path / name).write_bytes(content)
    assert load([str(tmp_path / name)]) == EXIT_INCOMPATIBLE and not capfdbinary.readouterr().out


def test_a_log_is_learned_from_and_shown(here, monkeypatch):
    """The command is ``mavdem learn --rrd``, whose recording tests/cli/test_learn.py reads, and then shows it."""
    learn = Mock()
    show = Mock(return_value="")
    monkeypatch.setattr(learn_command, "callback", learn)
    monkeypatch.setattr("mavdem.view.show", show)
    assert run("open", "flight.tlog", "--axis", "pitch") == 0
    options = learn.call_args.kwargs
    assert options["axis"] == "pitch" and options["rrd"] and options["source"] == "flight.tlog"
    show.assert_called_once_with(Path("flight", "flight.rrd"))
