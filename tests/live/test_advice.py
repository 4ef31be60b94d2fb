"""Gains that are advised after a landing: those of ``mavdem tune`` on the recording, in a file that is new."""

from concurrent.futures import Executor, Future
from itertools import count

import pytest
from command_line import run, strict_json
from live_faults import run_session
from pytest import approx
from recorded_flights import SLOW

from mavdem.facts.loops import Gains
from mavdem.ingest.parameter_file import read_parameters
from mavdem.live.advice import Adviser, advised
from mavdem.live.raw_recording import RawRecording
from sitl_scenarios.files import load, scenario_of

TUNED_BADLY = {
    "seed": 5,
    "duration": 30.0,
    "flights": 2,
    "height": 5.0,
    "vehicle": {"parameters": {"ATC_ANG_RLL_P": 16.0}},
    "excitation": {"kind": "doublets", "amplitude": 6.0},
    "faults": {},
}


class AtOnce(Executor):
    """Runs a job where it is submitted; counts those that are running and those that are over."""

    def __init__(self):
        self.started = self.ended = 0

    def __call__(self):
        self.started += 1
        return self

    def submit(self, job, /, *args):
        made = Future()
        try:
            made.set_result(job(*args))
        except Exception as error:
            made.set_exception(error)
        return made

    def shutdown(self, wait=True, *, cancel_futures=False):
        self.ended += 1


def codes(facts):
    return [fact.code for fact in facts]


@pytest.mark.slow
@pytest.mark.usefixtures("without_wind_fits")
def test_after_a_landing_the_gains_are_those_of_tune_on_the_recording(tmp_path, capsys):
    long = load("ardupilot_faults").model_dump(mode="json")
    recorded = tmp_path / "flight.tlog"
    (tmp_path / "flight.gains.params").write_text("# of an earlier flight\n")
    start = AtOnce()
    recording = RawRecording(recorded)
    adviser = Adviser(recorded, start)
    session, _ = run_session(
        scenario_of({**long, **TUNED_BADLY}), recording=recording, adviser=adviser
    )
    session.recording.close()
    first = [event for event in session.history.events if event.fact.code in set(Gains)]
    assert first and first[0].seconds < session.history.now - 20.0, "after the first landing"
    session.advise(at_end=True)
    session.advise(at_end=True)
    facts = adviser.facts
    roll = next(fact for fact in facts if fact.subject == "roll")
    assert roll.code is Gains.GAINS_ADVISED and codes(facts)[-1] is Gains.GAINS_WRITTEN
    assert roll.figures["expected_error"] > 0 and "ATC_ANG_RLL_P 16 → " in roll.sentence
    assert run("tune", recorded, "--axis", "all", "--json") == 0
    told = strict_json(capsys.readouterr().out)
    path = facts[-1].figures["path"]
    assert read_parameters(path) == approx(told["parameters"])
    assert told["axes"]["roll"]["sentence"] in roll.sentence
    assert facts[-1].figures["because"].code == told["next_step_fact"]["code"] == "load_gains"
    assert (tmp_path / "flight.gains.params").read_text() == "# of an earlier flight\n"
    assert start.started == start.ended == 2, "no process stays"


def test_a_flight_without_a_loop_is_left_alone_in_one_sentence(tmp_path):
    recording = tmp_path / SLOW.name
    recording.write_bytes(SLOW.read_bytes())
    (left,) = advised(recording, "1:1")
    assert left.code is Gains.GAINS_LEFT and "need 40 Hz" in left.sentence
    assert [*tmp_path.iterdir()] == [recording], "nothing is written"


def test_a_busy_computer_advises_later_and_says_so(tmp_path, monkeypatch):
    start = AtOnce()
    adviser = Adviser(tmp_path / "flight.tlog", start)
    assert adviser.go_on("1:1", False, False) == () and not start.started
    adviser.is_due = True
    assert codes(adviser.go_on("1:1", True, False)) == [Gains.ADVICE_WAITS] and not start.started
    numbers = count()
    monkeypatch.setattr("mavdem.live.advice.advised", lambda *_: (next(numbers),))
    assert adviser.go_on("1:1", False, False) == (0,) and start.ended == 1
    assert adviser.go_on("1:1", False, True) == ()


@pytest.mark.parametrize("error", [TimeoutError(), OSError(28, "No space left on device")])
def test_advice_that_fails_costs_nothing_else(tmp_path, monkeypatch, error):
    def fail(*_):
        raise error

    monkeypatch.setattr("mavdem.live.advice.advised", fail)
    adviser = Adviser(tmp_path / "flight.tlog", AtOnce())
    adviser.is_due = True
    (failed,) = adviser.go_on("1:1", False, True)
    assert failed.code is Gains.ADVICE_FAILED and str(error) in failed.sentence
    assert "mavdem tune" in failed.remedy and "flight.tlog" in failed.remedy
