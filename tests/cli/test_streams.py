"""Lines on standard output and standard error wrap at the width there is."""

from command_line import run, unwrapped
from pytest import mark
from recorded_flights import SLOW

pytestmark = mark.slow


def test_a_refusal_wraps_at_the_width_and_is_one_line_without_one(tmp_path, monkeypatch, capsys):
    monkeypatch.delenv("COLUMNS", raising=False)
    assert run("wind", SLOW, "--out", tmp_path) == 1
    refusal = capsys.readouterr().err.splitlines()[-1]
    assert len(refusal) > 100
    monkeypatch.setenv("COLUMNS", "50")
    assert run("wind", SLOW, "--out", tmp_path) == 1
    lines = capsys.readouterr().err.splitlines()
    assert max(map(len, lines)) <= 50 and refusal in unwrapped(" ".join(lines))
