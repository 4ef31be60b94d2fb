"""Gains to set on a page: a table, and files that both ground stations read back."""

from pathlib import Path
from urllib.parse import unquote

from hover import Hover
from partial_records import partial_record
from pytest import MonkeyPatch, approx

from mavdem.cli.tune import tune_command
from mavdem.facts import Fact
from mavdem.facts.assessment import NextStep
from mavdem.facts.loops import LoopAction, LoopFact
from mavdem.ingest.parameter_file import read_parameters
from mavdem.loops.advice import Advice, Gain
from mavdem.loops.axis_loops import MARGIN_TARGETS, Loop
from mavdem.loops.gain_design import MAX_GAIN_STEP, Stage
from mavdem.report.gain_changes import gain_changes

LOWER = Fact(
    LoopAction.LOWER_BY_A_THIRD,
    subject="rate",
    axis="roll",
    changes=(("ATC_RAT_RLL_P", 0.135, 0.09),),
)


def test_gains_to_lower_are_a_table_and_files_within_the_page(tmp_path: Path):
    vehicle = Hover().telemetry(parameters={"ATC_RAT_RLL_P": 0.135})
    next_step = Fact(NextStep.DO_AS_ADVISED, reason=LOWER)
    changes = gain_changes("flight.bin", vehicle, {}, next_step)
    assert changes.table.rows == [["ATC_RAT_RLL_P", "0.135", "0.09", "0.67"]]
    gains = {}
    for download in changes.downloads:
        path = tmp_path / download.name
        path.write_text(unquote(download.address.split(",", 1)[1]), encoding="utf-8")
        gains[download.name] = read_parameters(path)["ATC_RAT_RLL_P"]
    # The present gain is offered too, to go back to it.
    assert gains["flight.params"] == approx(0.09)
    assert gains["flight.before.params"] == approx(0.135)


def test_a_notch_filter_is_set_with_the_first_gains(tmp_path: Path):
    vehicle = Hover().telemetry(parameters={"INS_HNTCH_FREQ": 60.0})
    notch = {"INS_HNTCH_ENABLE": 1.0, "INS_HNTCH_FREQ": 80.0}
    next_step = Fact(NextStep.DO_AS_ADVISED, reason=LOWER)
    changes = gain_changes("flight.bin", vehicle, {}, next_step, notch)
    assert changes.table.rows[1:] == [
        ["INS_HNTCH_ENABLE", "", "1", ""],
        ["INS_HNTCH_FREQ", "60", "80", ""],
    ]
    path = tmp_path / changes.downloads[0].name
    path.write_text(unquote(changes.downloads[0].address.split(",", 1)[1]), encoding="utf-8")
    assert read_parameters(path) == {"ATC_RAT_RLL_P": approx(0.09), **notch}


def test_what_limits_advised_gains_stands_beside_them(monkeypatch: MonkeyPatch):
    """The gains were advised from 7 s of 424 s, and only 56 % of the plants have their margins."""
    part = Fact(LoopFact.GAINS_OF_PART, names=(), parts=(), ratings=(), duration=7.0, settled=424.0)
    result = Fact(
        LoopFact.AUTOTUNED, subject="roll", changes=(), ratings=(), time=1.0, end_time=2.0
    )
    monkeypatch.setattr(Loop, "share_meeting", lambda loop, target: 0.32)
    advice = partial_record(
        Advice,
        target=MARGIN_TARGETS["default"],
        gains={"ATC_RAT_RLL_P": Gain(0.0675, 0.0568)},
        stage=Stage.RATE,
        sure=0.56,
        before=partial_record(Loop, cautions=(part, result)),
    )
    next_step = Fact(NextStep.KEEP_MODEL)
    changes = gain_changes("a.bin", Hover().telemetry(), {"roll": advice}, next_step)
    share, caution = (f"{sentence.lead} {sentence.text}" for sentence in changes.cautions)
    assert share.startswith("Roll: The gains to set have the margins in 56 %")
    assert share.endswith(
        "With the present ones 68 % lack margin: too few of either to load them before another flight."
    )
    assert "7 s of 424 s" in caution


def test_a_flight_whose_gains_stay_has_no_table():
    assert gain_changes("a.bin", Hover().telemetry(), {}, Fact(NextStep.KEEP_MODEL)) is None


def test_help_and_guide_name_the_largest_step_of_a_gain():
    step = f"a factor of {MAX_GAIN_STEP:g} (half more, or a third less)"
    guide = Path(__file__).parents[2] / "docs" / "tune.md"
    for text in (tune_command.help, guide.read_text(encoding="utf-8")):
        assert step in " ".join(text.split())
