"""``mavdem compare`` and ``order``: documents, tables, and flights that they cannot be made of."""

import time
from pathlib import Path

from command_line import document_of, refused, run, strict_json
from pytest import fixture, mark
from recorded_flights import FLIGHT, SLOW, shared

from mavdem import baselines
from mavdem.experiments.compared_methods import Method
from mavdem.facts import Fact
from mavdem.facts.command import NamedSource

pytestmark = mark.slow

FLIGHT = str(FLIGHT)
SLOW = str(SLOW)
FEW = (
    Method("hold last", baselines.hold),
    Method("constant mean", baselines.constant_mean),
    Method("subspace(2)", baselines.subspace),
)


@fixture
def quick(monkeypatch):
    """Methods that take no time."""
    monkeypatch.setattr("mavdem.cli.compare.METHODS", FEW)


def test_what_cannot_be_compared_is_reported_and_the_others_are_compared(quick, tmp_path, capsys):
    assert run("compare", SLOW, FLIGHT, str(tmp_path / "missing.tlog"), "--json") == 0
    captured = capsys.readouterr()
    document = strict_json(captured.out)
    assert document["sources"] == {Path(FLIGHT).stem: FLIGHT}
    assert 0 < document["seconds"] < time.perf_counter()
    assert f"{SLOW} is left out: ATTITUDE comes at 4 Hz" in captured.err
    assert captured.err.count(" is left out: ") == 2
    assert "4 Hz" in document_of(capsys, "compare", SLOW, code=1)["error"]["reason"]


def test_a_flight_too_short_says_what_fits(quick, capsys):
    error_text = refused(capsys, 1, "compare", FLIGHT, "--train", "5900")
    assert "5900 training and 150 test samples were asked for" in error_text
    assert run("compare", FLIGHT, *error_text.split("`")[1].split()) == 0


def test_a_flight_of_other_inputs_is_left_out_of_an_order(capsys):
    demand = shared("real/logs/px4_default_rates_learnable.ulg")
    assert run("order", FLIGHT, demand, "--max-order", "1", "--json") == 0
    captured = capsys.readouterr()
    assert len(strict_json(captured.out)["flights"]) == 1
    assert str(Fact(NamedSource.AS_MANY_INPUTS_NEEDED, count=1, needed=4)) in captured.err
