"""``mavdem compare`` and ``order``: documents, tables, and flights that they cannot be made of."""

import re
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
    monkeypatch.setattr("mavdem.cli.compare.STANDARD_METHODS", FEW[:2])


def test_what_cannot_be_compared_is_reported_and_the_others_are_compared(quick, tmp_path, capsys):
    assert run("compare", SLOW, FLIGHT, str(tmp_path / "missing.tlog"), "--json") == 0
    captured = capsys.readouterr()
    document = strict_json(captured.out)
    assert document["sources"] == {Path(FLIGHT).stem: FLIGHT}
    assert 0 < document["seconds"] < time.perf_counter()
    assert f"{SLOW} is left out: ATTITUDE comes at 4 Hz" in captured.err
    assert captured.err.count(" is left out: ") == 2
    assert document["left_out"].keys() == {SLOW, str(tmp_path / "missing.tlog")}
    assert "ATTITUDE comes at 4 Hz" in document["left_out"][SLOW]
    assert "4 Hz" in document_of(capsys, "compare", SLOW, code=1)["error"]["reason"]
    # A report that is kept has them too.
    assert run("compare", SLOW, FLIGHT, "--hop", "5000", "--out", str(tmp_path / "out")) == 0
    page = (tmp_path / "out" / "compare.html").read_text()
    assert "Error ratio by horizon, inputs known" in page and "Left out:" in page
    report = capsys.readouterr().out.replace("\n", " ")
    assert f"Left out: {SLOW}: ATTITUDE comes at 4 Hz" in report
    missing = [str(tmp_path / "missing.tlog"), str(tmp_path / "lost.tlog")]
    assert run("compare", missing[0], SLOW) == 1
    error_text = capsys.readouterr().err
    assert f"{missing[0]} is left out: " in error_text and f"{SLOW} is left out: " in error_text
    assert str(Fact(NamedSource.NONE_USABLE, count=2)) in error_text
    assert run("compare", *missing) == 2
    copy = tmp_path / "copy.tlog"
    copy.write_bytes(Path(FLIGHT).read_bytes())
    capsys.readouterr()
    error_text = refused(capsys, 2, "compare", FLIGHT, str(copy))
    assert f"{copy} is the same log as {FLIGHT}: each flight counts once." in error_text


def test_all_methods_are_compared_where_that_is_asked_for(quick, capsys):
    document = document_of(capsys, "compare", FLIGHT, "--hop", "5000")
    assert document["methods"] == ["hold last", "constant mean"]
    document = document_of(capsys, "compare", FLIGHT, "--hop", "5000", "--methods", "All")
    assert document["methods"] == ["hold last", "constant mean", "subspace(2)"]


def test_a_flight_too_short_says_what_fits(quick, capsys):
    error_text = refused(capsys, 1, "compare", FLIGHT, "--train", "5900")
    assert "5900 training and 150 test samples were asked for" in error_text
    # Nothing is run on windows of which no model can be learned.
    error_text = refused(capsys, 1, "compare", FLIGHT, "--train", "1")
    assert "No model is learned from 1 training sample: it takes 50." in error_text
    error_text = refused(capsys, 1, "compare", FLIGHT, "--train", "5900")
    assert run("compare", FLIGHT, *error_text.split("`")[1].split()) == 0


def test_named_methods_are_compared_on_lines_of_80_columns(quick, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setattr("mavdem.cli.compare.SECONDS_BETWEEN_LINES", 0.0)
    names = "Constant Mean, hold last"
    assert run("compare", FLIGHT, "--hop", "2500", "--methods", names, "--verbose") == 0
    captured = capsys.readouterr()
    lines = captured.out.splitlines()
    assert max(map(len, lines)) <= 80
    assert "Next: `--hop 850` cuts 6 windows that do not overlap." in lines
    assert [line for line in lines if line.startswith("constant mean")]
    assert not [line for line in lines if line.startswith("subspace")]
    summary = next(line for line in lines if line.startswith("inputs known: RMSE to (s) "))
    header = next(line for line in lines if line.startswith("inputs known: error ratio to (s) "))
    assert header.split()[6:12] == ["0.01", "0.05", "0.1", "0.25", "0.5", "1.5"]
    # What the columns are comes before their table, and the summary before the details.
    places = [captured.out.index(text) for text in ("\nRMSE to", summary, "\nband ", header)]
    assert places == sorted(places)
    errors = captured.err.replace("\n", " ")
    assert "Comparing 2 methods on 3 windows, 3 of them independent (not overlapping);" in errors
    assert errors.index("Next: `--hop 850` cuts") < errors.index("% done")
    # The time is known once all methods are done in a window.
    assert "Window 1 of 3, hold last: 17 % done." in errors
    assert re.search(r"Window 2 of 3, hold last: \d+ % done, about [01] s left", errors)
    monkeypatch.delenv("COLUMNS")
    message = refused(capsys, 2, "compare", FLIGHT, "--methods", "foo")
    assert "'foo' is none of hold last, constant mean" in message and "Did you" not in message
    assert "nor 'all'" in message
    message = refused(capsys, 2, "compare", FLIGHT, "--methods", "hold last,subspace2")
    assert "Did you mean subspace(2)?" in message
    assert "two methods" in refused(capsys, 2, "compare", FLIGHT, "--methods", "hold last")


@mark.parametrize("signal, code", [(KeyboardInterrupt(), 130), (SystemExit(143), 143)])
def test_a_run_that_is_stopped_reports_the_windows_that_are_done(signal, code, monkeypatch, capsys):
    trainings = []

    def stops_in_the_third_window(train):
        trainings.append(train)
        if len(trainings) == 3:
            raise signal
        return baselines.hold(train)

    methods = (FEW[1], Method("hold last", stops_in_the_third_window))
    monkeypatch.setattr("mavdem.cli.compare.STANDARD_METHODS", methods)
    assert run("compare", FLIGHT, "--hop", "2500") == code
    assert capsys.readouterr().out.startswith("Stopped: 2 of 3 windows are compared.")
    trainings.clear()
    document = document_of(capsys, "compare", FLIGHT, "--hop", "2500", code=code)
    assert document["planned_windows"] == 3 and len(document["flights"][0]["windows"]) == 2


def test_a_flight_of_other_inputs_is_left_out_of_an_order(capsys):
    demand = shared("real/logs/px4_default_rates_learnable.ulg")
    assert run("order", FLIGHT, demand, "--max-order", "1", "--json") == 0
    captured = capsys.readouterr()
    assert len(strict_json(captured.out)["flights"]) == 1
    assert str(Fact(NamedSource.AS_MANY_INPUTS_NEEDED, count=1, needed=4)) in captured.err
