"""Gains that are advised after a landing: those of ``mavdem tune`` on the recording, in files that are new."""

from pathlib import Path
from unittest.mock import MagicMock, Mock

from command_line import run, strict_json
from partial_records import partial_record
from pytest import mark, raises
from recorded_flights import SLOW

from mavdem.assessment.assess import assess
from mavdem.assessment.axis import Options
from mavdem.assessment.axis.loop_decision import LoopDecision, LoopDiagnosis
from mavdem.assessment.axis.tuning import Tuning
from mavdem.assessment.axis.twin import predicted_errors
from mavdem.assessment.judgement import unjudged
from mavdem.dem.online.learner import TOO_FEW_SAMPLES
from mavdem.dem.parallel import LOW_PRIORITY
from mavdem.facts import Fact, Level
from mavdem.facts.assessment import NextStep
from mavdem.facts.lights import Light
from mavdem.facts.loops import GainFact, LoopFact, TwinFact
from mavdem.facts.margins import MarginsLight
from mavdem.facts.motors import MotorWatchFact
from mavdem.facts.session import RecordingState
from mavdem.ingest import read_log
from mavdem.live.gain_advice import (
    GainAdvice,
    GainAdviser,
    _write_gain_files,
    advise_gains,
    facts_of_tuning,
)
from mavdem.loops.advice import Advice, Gain
from mavdem.loops.axis_loops import MARGIN_TARGETS
from mavdem.loops.gain_design import SURE_SHARE

TUNED_BADLY = """
seed = 5
duration = 30.0
height = 5.0
vehicle = { parameters = { ATC_ANG_RLL_P = 16.0, SCHED_LOOP_RATE = 200.0 } }
excitation = { kind = "doublets", amplitude = 6.0 }
stream = { autopilot = "ardupilot", rates = { ATTITUDE_TARGET = 100.0 } }
"""


def at_once(niceness):
    """An executor that runs a job when its result is asked for."""
    made = lambda job, *given: Mock(**{"result.side_effect": lambda _: job(*given)})  # noqa: E731
    executor = MagicMock(submit=made)
    executor.__enter__.return_value = executor
    return executor


def adviser_of(tmp_path):
    return GainAdviser(tmp_path / "flight.tlog", Mock(side_effect=at_once))


@mark.slow
@mark.usefixtures("coarse_physics", "without_pages")
def test_the_files_beside_a_recording_are_new_and_those_that_tune_writes(tmp_path, capsys):
    """A session advises gains after a flight that is tuned badly: its files are those of ``mavdem tune``.

    They get another name than files of an earlier flight, which stay.
    """
    scenario = tmp_path / "tuned_badly.toml"
    scenario.write_text(TUNED_BADLY)
    recording = tmp_path / "flight.tlog"
    assert run("fly", scenario, "--out", recording) == 0
    before = tmp_path / "flight.gains.stage2.param"
    before.write_text("# of an earlier flight\n")
    capsys.readouterr()
    advice = advise_gains(recording, "1:1")
    roll, *_, twin, written = advice.facts
    assert roll.code is GainFact.GAINS_ADVISED and roll.figures["expected_error"] > 0
    assert "ATC_ANG_RLL_P 16 → " in roll.sentence
    assert (twin.code, twin.subject) == (GainFact.TWIN_ANGLE_ERROR, "roll")
    assert 0 < twin.figures["expected_error"] < 6 and 0 < twin.figures["present_error"] < 6
    evidence = assess(read_log(recording), options=Options(with_model=False)).evidence
    (refused,) = predicted_errors(evidence, {"ATC_ANG_RLL_P": -1.0})
    assert refused.code is TwinFact.CANNOT_FLY
    assert run("tune", recording, "--axis", "all", "--json", "--out", tmp_path) == 0
    document = strict_json(capsys.readouterr().out)
    sentence = document["axes"]["roll"]["sentence"]
    assert sentence.split(" Load them")[0] == roll.figures["reason"].sentence
    assert "flight.gains-1.stage2.params and .stage2.param;" in written.sentence
    assert advice.judgement.next_step.code is NextStep.LOAD_GAINS
    assert written.figures["reason"].code == document["next_step_fact"]["code"] == "load_gains"
    for ending in ("stage2.params", "stage2.param"):
        path = tmp_path / f"flight.gains-1.{ending}"
        assert path.read_text() == (tmp_path / f"gains.{ending}").read_text()
    assert before.read_text() == "# of an earlier flight\n"


@mark.slow
def test_a_flight_without_a_loop_is_left_alone_in_one_sentence(tmp_path):
    recording = tmp_path / SLOW.name
    recording.write_bytes(SLOW.read_bytes())
    ((left,), judgement) = advise_gains(recording, "1:1")
    assert judgement.lights[Light.MARGINS].code is not MarginsLight.LOOP_MARGINS
    assert left.code is GainFact.GAINS_LEFT and "needs 40 Hz" in left.sentence
    assert [*tmp_path.iterdir()] == [recording], "nothing is written"
    # A motor that was found weak in flight withholds gains, also where the recording ends too soon to show it.
    weak = Fact(MotorWatchFact.MOTOR_LOST_THRUST, Level.BAD, subject="motor 3", loss=(0.1, 0.3))
    weak = weak.replace(time=48.0, rise=0.19, probability=0.99, assumed=False, boot=0)
    ((withheld,), _) = advise_gains(recording, "1:1", weak)
    assert withheld.sentence.startswith("No gains are advised: motor 3 lost 10 to 30 %")


def test_a_decision_among_the_events_names_its_axis():
    reason = Fact(LoopFact.NO_MARGINS, reason=Fact(GainFact.ADVICE_WAITS))
    decision = LoopDecision("pitch", LoopDiagnosis.UNKNOWN, reason, Fact(GainFact.ADVICE_WAITS))
    named = decision.fact.replace(is_named=True)
    assert named.sentence.startswith("Pitch: no margins: ")


@mark.parametrize("share_of_models", [0.95, 0.5])
def test_gains_that_another_flight_is_to_confirm_are_not_listed(share_of_models):
    loop = Mock(axis="roll", lean_in_wind=0.1, **{"share_meeting.return_value": 0.5})
    advice = partial_record(
        Advice,
        before=loop,
        after=loop,
        target=MARGIN_TARGETS["default"],
        gains={"MC_ROLLRATE_P": Gain(0.15, 0.2)},
        sure=share_of_models,
        conclusion=Fact(GainFact.ADVICE_WAITS),
    )
    reason = Fact(LoopFact.NO_MARGINS, reason=Fact(GainFact.ADVICE_WAITS))
    decision = LoopDecision("roll", LoopDiagnosis.BELOW_GOAL, reason, Fact(GainFact.ADVICE_WAITS))
    judgement = Mock(loop_decisions={"roll": decision})
    (fact,) = facts_of_tuning(
        partial_record(Tuning, axes={"roll": advice}, advice=(advice,), judgement=judgement)
    )
    assert (fact.code is GainFact.GAINS_ADVISED) is (share_of_models >= SURE_SHARE)
    assert (fact == decision.fact.replace(is_named=True)) is (share_of_models < SURE_SHARE)


def test_axes_whose_gains_stay_for_the_same_reason_share_a_line():
    """Of good gains the least share of vehicle models is stated, which holds for all axes."""
    goals = {
        "phase_margin": 45.0,
        "gain_margin": 6.0,
        "ms": 2.0,
        "can_go_on": False,
        "share_as_flown": 1.0,
    }
    shares = {"roll": 0.93, "pitch": 0.91, "yaw": 0.99}
    conclusions = {
        axis: Fact(GainFact.KEEP_GAINS, share=share, has_room=False, **goals)
        for axis, share in shares.items()
    }
    judgement = Mock(loop_decisions={})
    (kept,) = facts_of_tuning(partial_record(Tuning, axes=conclusions, judgement=judgement))
    assert kept.sentence.startswith("No new gains for roll, pitch and yaw. Keep the gains:")
    assert "91 %" in kept.sentence
    # A weak motor is the reason for all axes, and its remedy is the verdict's.
    weak_motor = Fact(GainFact.MOTOR_AT_LIMIT, subject="motor 3", share=0.3)
    axes = dict.fromkeys(shares, weak_motor)
    (left,) = facts_of_tuning(partial_record(Tuning, axes=axes, judgement=judgement))
    assert left.sentence == f"No gains are advised: a{weak_motor.sentence[1:]}"


def test_a_busy_computer_advises_later_and_says_so(tmp_path, monkeypatch):
    adviser = adviser_of(tmp_path)
    assert adviser.update("1:1", is_busy=False, is_at_end=True) == (), "nothing has landed"
    adviser.is_due = True
    assert [fact.code for fact in adviser.update("1:1", is_busy=True, is_at_end=False)] == [
        GainFact.ADVICE_WAITS
    ]
    assert not adviser._start_executor.called
    monkeypatch.setattr("mavdem.live.gain_advice.advise_gains", lambda *_: GainAdvice(("gains",)))
    assert adviser.update("1:1", is_busy=False, is_at_end=False) == ("gains",)
    assert adviser.update("1:1", is_busy=False, is_at_end=True) == () and not adviser.is_awaited


def test_the_judgement_of_an_earlier_flight_ends_with_the_next_one(tmp_path):
    adviser = adviser_of(tmp_path)
    adviser.judgement = unjudged(TOO_FEW_SAMPLES)
    adviser.update("1:1", is_busy=False, is_at_end=False)
    assert adviser.judgement is not None
    adviser.is_due = True
    adviser.update("1:1", is_busy=True, is_at_end=False)
    assert adviser.judgement is None


def test_only_at_the_end_advice_has_the_priority_of_other_programs(tmp_path):
    adviser = adviser_of(tmp_path)
    for is_at_end in (False, True):
        adviser.is_due = True
        adviser.update("1:1", is_busy=False, is_at_end=is_at_end)
    assert [call.args for call in adviser._start_executor.mock_calls] == [(LOW_PRIORITY,), (0,)]


@mark.parametrize("error", [TimeoutError(), OSError(28, "No space left on device")])
def test_advice_that_fails_costs_nothing_else(tmp_path, monkeypatch, error):
    monkeypatch.setattr("mavdem.live.gain_advice.advise_gains", Mock(side_effect=error))
    adviser = adviser_of(tmp_path)
    adviser.is_due = True
    (failed,) = adviser.update("1:1", is_busy=True, is_at_end=True)
    reason = error.strerror or "within 60 s"
    assert failed.code is GainFact.ADVICE_FAILED and reason in failed.sentence
    assert failed.remedy == f"Run `mavdem tune {tmp_path}/flight.tlog --axis all`."
    assert adviser.recording_failure.figures["kind"] is RecordingState.FAILED
    # After the next landing the recording is read again.
    adviser.is_due = True
    assert adviser.recording_failure is None


def test_files_of_gains_that_do_not_fit_on_the_disk_are_not_left_partly_written(
    tmp_path, monkeypatch
):
    write = Path.write_text

    def write_first(path, text, **how):
        if path.suffix == ".param":
            raise OSError(28, "No space left on device")
        write(path, text, **how)

    monkeypatch.setattr(Path, "write_text", write_first)
    texts = {".stage1.params": "# gains", ".stage1.param": "# gains"}
    with raises(OSError, match="No space left"):
        _write_gain_files(tmp_path / "flight.tlog", texts, Fact(NextStep.LOAD_GAINS))
    assert [*tmp_path.iterdir()] == []
