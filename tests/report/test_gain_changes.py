"""Gains to set on a page: a table, and files that both ground stations read back."""

from pathlib import Path
from urllib.parse import unquote

from hover import Hover
from partial_records import partial_record
from pytest import MonkeyPatch, approx

from mavdem.assessment.axis.lowered_gains import lowered_gains
from mavdem.assessment.axis.parameter_sets import stage_to_load
from mavdem.cli.tune import tune_command
from mavdem.facts import Fact
from mavdem.facts.assessment import NextStep
from mavdem.facts.loops import LoopAction, LoopFact
from mavdem.ingest.parameter_file import read_parameters
from mavdem.loops.advice import Advice, Gain
from mavdem.loops.axis_loops import MARGIN_TARGETS, Loop
from mavdem.loops.gain_design import MAX_GAIN_STEP, Stage
from mavdem.report.gain_changes import changes_on_trial, gain_changes, loading_sentences
from mavdem.report.tuning.gains import gain_row

LOWER = Fact(
    LoopAction.LOWER_BY_A_THIRD,
    subject="rate",
    axis="roll",
    # The log has float32 values.
    changes=(("ATC_RAT_RLL_P", 0.13500000536441803, 0.09000000357627869),),
)


def test_gains_to_lower_are_a_table_and_files_within_the_page(tmp_path: Path):
    vehicle = Hover().telemetry(parameters={"ATC_RAT_RLL_P": 0.13500000536441803})
    next_step = Fact(NextStep.DO_AS_ADVISED, reason=LOWER)
    changes = gain_changes("flight.bin", vehicle, {}, lowered_gains(next_step))
    assert changes.first_table.rows == [["ATC_RAT_RLL_P", "0.135", "0.09", "0.67"]]
    # Rounding to three digits makes it 0.665 here, which is the same third.
    assert gain_row("MC_ROLLRATE_P", Gain(0.20000000298, 0.133))[-1] == "0.67"
    [lowered] = changes.cautions
    assert lowered.lead == "Roll:" and "no model of the loop says" in lowered.text
    gains = {}
    for download in changes.downloads:
        path = tmp_path / download.name
        path.write_text(unquote(download.address.split(",", 1)[1]), encoding="utf-8")
        gains[download.name] = read_parameters(path)["ATC_RAT_RLL_P"]
    # The present gain is offered too, to go back to it.
    assert gains["flight.params"] == 0.09
    assert gains["flight.before.params"] == 0.135


def test_a_notch_filter_is_set_with_the_first_gains(tmp_path: Path):
    vehicle = Hover().telemetry(parameters={"INS_HNTCH_FREQ": 60.0})
    notch = {"INS_HNTCH_ENABLE": 1.0, "INS_HNTCH_FREQ": 80.0}
    next_step = Fact(NextStep.DO_AS_ADVISED, reason=LOWER)
    changes = gain_changes("flight.bin", vehicle, {}, lowered_gains(next_step), notch)
    assert changes.first_table.rows[1:] == [
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
    changes = gain_changes("a.bin", Hover().telemetry(), {"roll": advice})
    share, caution = (f"{sentence.lead} {sentence.text}" for sentence in changes.cautions)
    assert share.startswith(
        "Roll: The gains tried, which are not to be loaded, have the margins in 56 %"
    )
    assert share.endswith(
        "With the present ones 68 % lack margin: too few of either to load them before another flight."
    )
    assert "7 s of 424 s" in caution
    # Such gains are in no file, as in the folder of the command, and a sentence apart from the gains to load has them.
    assert not changes.tables and not changes.downloads and not changes.blocks
    [tried] = changes.tried_sentences
    assert (
        tried.lead.startswith("Tried, not to be loaded")
        and "ATC_RAT_RLL_P\N{NO-BREAK SPACE}0.0675" in tried.text
    )
    assert changes.tried_gains.header[2] == "tried, not to be loaded"
    assert changes.tried_gains.rows == [["ATC_RAT_RLL_P", "0.0675", "0.0568", "0.84"]]


def test_gains_of_the_second_stage_wait_for_the_flight_with_the_first(monkeypatch: MonkeyPatch):
    monkeypatch.setattr(Loop, "share_meeting", lambda loop, target: 0.9)
    gains_by_axis = {
        "yaw": (Stage.ANGLE, {"MC_YAW_P": Gain(2.0, 3.0)}),
        "roll": (Stage.RATE, {"MC_ROLLRATE_P": Gain(0.15, 0.2)}),
    }
    advice = {}
    for axis, (stage, gains) in gains_by_axis.items():
        loop = partial_record(Loop, axis=axis, cautions=())
        advice[axis] = partial_record(
            Advice, target=None, gains=gains, stage=stage, sure=0.95, before=loop
        )
    changes = gain_changes("a.ulg", Hover().telemetry(), advice)
    first, second = changes.tables
    assert first.header[0] == "gain, stage 1" and first.rows[0][0] == "MC_ROLLRATE_P"
    assert second.header[0] == "gain, stage 2" and second.rows[0][0] == "MC_YAW_P"
    _, waiting, _ = changes.blocks
    assert "after a flight with the gains of stage 1" in waiting.text
    names = [download.name for download in changes.downloads]
    assert names == ["a.stage1.param", "a.stage1.params", "a.stage2.param", "a.stage2.params"]
    assert changes.downloads[1].label == "Gains of stage 1: .params (QGroundControl)"
    assert stage_to_load(advice.values()) is Stage.RATE
    # Where nothing waits, a file still has the name of its stage, and is loaded at once.
    assert "load after a flight" in unquote(changes.downloads[3].address)
    alone = gain_changes("a.ulg", Hover().telemetry(), {"yaw": advice["yaw"]})
    assert [download.name for download in alone.downloads] == ["a.stage2.param", "a.stage2.params"]
    assert "load, hover one minute" in unquote(alone.downloads[1].address)
    # Gains to lower on an axis for which none can be computed are in the same table and file as the first ones.
    gains_to_lower = {"MC_PITCHRATE_P": Gain(0.15, 0.1)}
    both = gain_changes("a.ulg", Hover().telemetry(), {"roll": advice["roll"]}, gains_to_lower)
    [table] = both.tables
    assert [row[0] for row in table.rows] == ["MC_ROLLRATE_P", "MC_PITCHRATE_P"]
    assert [download.name for download in both.downloads] == ["a.stage1.param", "a.stage1.params"]
    for name in both.new_values:
        assert name in unquote(both.downloads[1].address)


def test_gains_that_few_models_accept_are_called_a_step_of_all_their_axes(
    monkeypatch: MonkeyPatch,
):
    monkeypatch.setattr(Loop, "share_meeting", lambda loop, target: 0.0)
    advice = {}
    for axis, sure in (("roll", 0.03), ("pitch", 0.01), ("yaw", 0.7)):
        loop = partial_record(Loop, axis=axis, cautions=())
        gains = {axis: Gain(2.0, 3.0)}
        advice[axis] = partial_record(
            Advice, target=None, gains=gains, stage=Stage.RATE, sure=sure, before=loop
        )
    few, most = gain_changes("a.ulg", Hover().telemetry(), advice).cautions
    assert few.lead == "Roll and pitch:" and "few of the vehicle models" in few.text
    assert most.lead == "Yaw:" and "in 70 % of the vehicle models" in most.text


def test_how_gains_are_loaded_is_said_once_and_for_the_first_stage_alone():
    remedies = {Stage.RATE: "Load them and hover.", Stage.ANGLE: "Load them later."}
    advice = {}
    for axis, stage, noise, sure in (
        ("roll", Stage.RATE, None, 0.95),
        ("pitch", Stage.RATE, (), 0.2),
        ("yaw", Stage.ANGLE, (), 0.95),
    ):
        advice[axis] = partial_record(
            Advice,
            gains={axis: Gain(2.0, 3.0)},
            stage=stage,
            is_sound=True,
            flights=4 if axis == "roll" else 1,
            sure=sure,
            noise=noise,
            conclusion=partial_record(Fact, remedy=remedies[stage]),
        )
    [sentence] = loading_sentences(advice)
    assert sentence.lead.startswith("Stage 1")
    assert sentence.text.startswith("Load them and hover. Check motor temperature")
    [later] = loading_sentences({"yaw": advice["yaw"]})
    assert later.lead.startswith("Stage 2") and later.text == "Load them later."
    assert loading_sentences({"yaw": Fact(NextStep.KEEP_MODEL)}) == []
    # The models of one axis of the first stage lack margin, so that its gains are on trial.
    assert changes_on_trial(advice) == 4
    assert changes_on_trial({"yaw": advice["yaw"]}) == 0


def test_a_flight_whose_gains_stay_has_no_table():
    assert gain_changes("a.bin", Hover().telemetry(), {}) is None


def test_help_and_guide_name_the_largest_step_of_a_gain():
    step = f"a factor of {MAX_GAIN_STEP:g} (half more, or a third less)"
    guide = Path(__file__).parents[2] / "docs" / "tune.md"
    for text in (tune_command.help, guide.read_text(encoding="utf-8")):
        assert step in " ".join(text.split())
