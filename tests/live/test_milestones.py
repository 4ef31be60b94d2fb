"""Milestones of a live flight: once each, with what is known."""

from dataclasses import replace
from io import StringIO
from unittest.mock import Mock

import numpy as np
from partial_records import partial_record
from pytest import mark
from rich.console import Console

from mavdem.assessment.flight_verdict import FlightVerdict, worst_first
from mavdem.assessment.judgement import unjudged
from mavdem.assessment.lights import VEHICLE_LIGHTS
from mavdem.cli.live_status import StatusLines
from mavdem.dem import Learned
from mavdem.dem.online.estimate import Estimate
from mavdem.dem.online.learner import OnlineLearner
from mavdem.dem.settings import Settings
from mavdem.facts import Fact, Level
from mavdem.facts.assessment import Headline, NextStep
from mavdem.facts.ending import Ending
from mavdem.facts.event import Event
from mavdem.facts.identifiability import Status
from mavdem.facts.lights import Light
from mavdem.facts.log import LogLight
from mavdem.facts.margins import MarginsLight
from mavdem.facts.motors import MotorsLight
from mavdem.facts.power import PowerLight
from mavdem.facts.session import MissingMessages, RowsFact, SessionFact
from mavdem.facts.watch import WatchFact
from mavdem.ingest.output_scale import OutputScale
from mavdem.live.learning import FlightLearning
from mavdem.live.milestones import MAX_VERDICTS, Milestones
from mavdem.live.rows import AlignedRow, RowFormat
from mavdem.live.session_state import Latency
from mavdem.live.session_status import SessionStatus
from mavdem.live.unseen_end import judgement_with_unseen_end
from mavdem.live.vehicle_state import VehicleState
from mavdem.plant.parameters import Physical
from mavdem.report.live import (
    closing_lines,
    headline_and_next_step,
    unrepaired_fault_beside_next_step,
    verdict_on_present_flight,
)
from mavdem.report.templates import as_clause, headline

PHYSICAL = partial_record(
    Physical,
    effect=np.full(4, 0.05),
    damping=2.0,
    covariance=1e-6 * np.eye(7),
    status={"effect": Status.REPORTED, "damping": Status.REPORTED, "lag": Status.REPORTED},
)


def learning_with(model=None, physical=None):
    """A session's learning with a model and the physical parameters of its latest estimate."""
    learning = FlightLearning("roll", Settings(), executor=None, prior=None, log=Mock())
    learning.learner = OnlineLearner()
    learning.learner.learned = model
    learning.estimate = partial_record(Estimate, physical=physical)
    learning.learned_rows = 900
    return learning


def test_the_first_model_is_reported_once_with_the_time_since_take_off():
    """The vehicle takes off at 8 s, and the first model is there at 12.5 s."""
    facts = []
    milestones = Milestones("roll", facts.append)
    milestones.note_first_model(learning_with(), 10.0, 8.0, is_flying=True)
    # A slow computer may have it only after the landing, where it is no news.
    milestones.note_first_model(learning_with(model="model"), 12.0, 8.0, is_flying=False)
    for now in (12.5, 14.5):
        milestones.note_first_model(learning_with(model="model"), now, 8.0, is_flying=True)
    assert [str(fact) for fact in facts] == ["First model of roll at 12.5 s, 4.5 s after take-off."]


@mark.parametrize("pulse, is_reported", [(1500.0, True), (1100.0, False)])
def test_the_motion_of_a_falling_vehicle_is_no_disturbance(pulse, is_reported):
    """Below a fifth of their range, here 1200 µs, motors carry no vehicle: it falls, whatever the wind does."""
    learning = learning_with()
    learning.estimate = None
    scale = OutputScale("PWM", "µs", low=1000.0, high=2000.0, step=1.0)
    learning._row_format = partial_record(RowFormat, scale=scale)
    learning._gusts = Mock(add=Mock(return_value=()))
    unusual = partial_record(Estimate, unusual=True, latest_mark=None, window_center=30.0)
    # The report is held back for 5 s.
    for time in (30.0, 36.0):
        row = partial_record(AlignedRow, time=time, inputs=np.full(4, pulse))
        learning.note_estimate(unusual, row, {})
    assert learning._log.called is is_reported


@mark.slow
def test_a_landing_reports_what_the_flight_has_shown():
    """After the landing one sentence states parameters, margins, wind and latency of the flight."""
    facts = []
    milestones = Milestones("roll", facts.append)
    learning = learning_with("model", PHYSICAL)
    for is_flying in (True, True, False, False):
        status = SessionStatus(
            is_flying=is_flying,
            latency=Latency(0.001, 0.004, 0.02),
            landing_time=None if is_flying else 40.0,
        )
        # The landing is recognised 3 s later.
        milestones.update(learning, status, 43.0)
    assert [fact.code for fact in facts] == [
        SessionFact.PARAMETERS_KNOWN,
        SessionFact.FLIGHT_LEARNED,
    ]
    sentence = str(facts[1])
    verdict = status.verdict.judgement.headline
    assert sentence.startswith(f"Landed at 40 s. {headline(verdict)} Mean wind not known. Roll: ")
    assert "Roll: control effectiveness 2.86" in sentence
    # An all-clear waits for the recording, where that will be judged.
    assert str(facts[1].replace(margins_follow=True)).startswith(
        "Landed at 40 s. Not judged yet. Its recording is judged next. "
    )
    milestones.report_end(learning, status, 41.0, None)
    assert len(facts) == 2, "a flight is reported once"
    assert sentence.endswith(", margins not known.")
    margins = {"phase_margin": 66.0, "phase_margin_interval": (60.0, 72.0)}
    margins |= {"gain_margin": 14.9, "gain_margin_interval": (13.0, 17.0)}
    sentence_with_margins = str(facts[1].replace(**margins))
    assert sentence_with_margins.endswith("margins 66° (60 to 72) and 14.9 dB (13.0 to 17.0).")


def test_a_landing_says_why_nothing_is_known():
    """A flight without a model reports after the landing why its parameters and the wind are unknown."""
    facts = []
    milestones = Milestones("roll", facts.append)
    learning = learning_with()
    learning.learned_rows = 0
    no_time = Fact(SessionFact.FIT_UNFINISHED)
    still = Fact(RowsFact.NO_LIVE_MOTORS)
    for is_flying in (True, False, False):
        status = SessionStatus(is_flying=is_flying, shortfall=no_time, no_wind_reason=still)
        milestones.update(learning, status, 40.0)
    verdict = headline(status.verdict.judgement.headline)
    assert [str(fact) for fact in facts] == [
        f"Landed at 40 s. {verdict} Mean wind not known ({as_clause(still)}). Roll: control effectiveness, "
        "rate damping and margins not known (this computer did not fit the physical parameters in time)."
    ]
    milestones.report_end(learning, status, 41.0, None)
    assert len(facts) == 1, "a flight is reported once"


def test_a_restart_in_flight_is_no_landing_and_the_landing_after_it_is():
    facts = []
    milestones = Milestones("roll", facts.append)
    flight = [(True, 21.0, 0), (False, 1.0, 1), (True, 2.0, 1), (True, 23.0, 1), (False, 24.0, 1)]
    for is_flying, now, boot in flight:
        milestones.update(learning_with("model"), SessionStatus(is_flying=is_flying), now, boot)
    [landed] = facts
    assert str(landed).startswith("Landed at 24 s.")


def test_a_flight_whose_end_nobody_saw_has_not_landed():
    """The autopilot has restarted on the ground when the session ends."""
    facts = []
    milestones = Milestones("roll", facts.append)
    learning = learning_with("model")
    for is_flying, now, boot in ((True, 21.0, 0), (False, 2.6, 1)):
        status = SessionStatus(is_flying=is_flying)
        milestones.update(learning, status, now, boot)
    milestones.report_end(learning, status, 2.6, None)
    [report] = facts
    assert str(report).startswith("The end of the flight was not received. Mean wind")
    # Whatever was checked before, nobody calls this flight sound.
    good = Fact(LogLight.RECORDED_FAST, Level.GOOD)
    low = Fact(PowerLight.BATTERY_LOW, Level.WATCH, voltage=13.2, cells=4, voltage_limit=13.6)
    for lights, text in (
        (dict.fromkeys(VEHICLE_LIGHTS, good), "its last message in the air."),
        ({Light.POWER: low}, "before that: "),
    ):
        after_restart = replace(status, worst_lights=lights, verdicts=milestones.verdicts)
        judgement = after_restart.session_judgement
        assert judgement.headline.code is SessionFact.END_NOT_SEEN
        assert judgement.headline.level is Level.WATCH and text in str(judgement.headline)
        assert str(judgement.next_step) == judgement.headline.remedy


def reported_flights(*parts):
    """The verdicts on earlier flights; a part has boot, flight, whether it flies, and the time since take-off, s."""
    facts = []
    milestones = Milestones("roll", facts.append)
    power = {Light.POWER: Fact(PowerLight.BATTERY_HELD, Level.GOOD)}
    for now, (boot, flight, is_flying, flight_seconds) in enumerate(parts):
        status = SessionStatus(
            is_flying=is_flying,
            flight_number=flight,
            flight_seconds=flight_seconds,
            worst_lights=power,
        )
        milestones.update(learning_with("model"), status, float(now), boot)
    return [fact for fact in facts if fact.code is SessionFact.FLIGHT_VERDICT]


def test_a_flight_is_reported_with_its_verdict_when_the_next_one_begins():
    flight, ground = (0, 1, True, 75.0), (0, 1, False, None)
    assert not reported_flights((0, 0, False, None), flight, ground)
    assert not reported_flights(flight, ground, flight), "it has bounced"
    [first] = reported_flights(flight, ground, (0, 2, True, 0.5))
    assert str(first).startswith("Flight 1 (1:15 min): too little was checked")


def test_a_session_of_several_flights_ends_with_all_verdicts_the_worst_first():
    """A first flight that was lost is not forgotten because nothing is wrong in the second one."""
    milestones = Milestones("roll", Mock())
    loss = Fact(Ending.CONTROL_LOST, time=22.1, height=None, cause=None, word=None)
    lost = SessionStatus(is_flying=True, flight_number=1, flight_seconds=34.0, loss=loss)
    sound = SessionStatus(is_flying=True, flight_number=2, flight_seconds=22.0)
    for now, status in enumerate((lost, replace(lost, is_flying=False), sound)):
        milestones.update(learning_with(), status, float(now))
    assert closing_lines(replace(lost, verdicts=milestones.verdicts[:1], is_over=True)) == (
        headline_and_next_step(replace(lost, is_over=True).overall_judgement)
    )
    end = replace(sound, is_over=True, verdicts=milestones.verdicts)
    # The vehicle is in the air, so that its landing comes before any repair.
    _, next_step, first_line, second_line = closing_lines(end)
    # The landing is said once, with what follows it; and no vehicle is flown that must not fly.
    repair = lost.verdict.judgement.next_step
    assert next_step == f"Next: Land by sight. After landing: {repair}"
    assert first_line == f"Flight 1 (0:34 min): {as_clause(loss)}."
    assert second_line.startswith("Flight 2 (0:22 min): ")
    # So it does where the end of the first flight was not seen, which is no bad fault.
    unseen = judgement_with_unseen_end(sound.verdict.judgement)
    verdicts = (FlightVerdict(1, unseen, 39.0, is_lost_in_air=True), *milestones.verdicts[1:])
    _, next_step, first_line, *_ = closing_lines(replace(end, verdicts=verdicts))
    assert first_line.startswith("Flight 1 (0:39 min): how the flight ended was not seen")
    landing = "Next: Land by sight. After landing: Look at the vehicle and its power"
    assert next_step.startswith(landing)
    # In the next flight the step is that of a server whose library has such a flight: it may have been a crash.
    flying = replace(sound, verdicts=verdicts)
    end_unknown = Fact(SessionFact.FLIGHT_END_UNKNOWN, reason=None)
    on_server = replace(sound, fault_in_library=end_unknown)
    assert flying.session_judgement.next_step == on_server.session_judgement.next_step
    assert "Land unless the vehicle was inspected" in str(flying.session_judgement.next_step)


def test_the_verdict_on_a_flight_comes_at_its_end_and_not_again_at_the_next_take_off():
    """The vehicle is disarmed after a crash, or its messages end; or the recording of the flight is judged."""
    loss = Fact(Ending.CONTROL_LOST, time=22.1, height=None, cause=None, word=None)
    lost = SessionStatus(is_flying=True, flight_number=1, loss=loss, message_age=0.1)
    judged = SessionStatus(flight_number=1, is_recording_judged=True)
    for end in (replace(lost, is_flying=False), replace(lost, message_age=4.0), judged):
        log = Mock()
        milestones = Milestones("roll", log)
        next_flight = SessionStatus(is_flying=True, flight_number=2, message_age=0.1)
        counts = []
        for now, status in enumerate((lost, end, end, next_flight)):
            milestones.update(learning_with(), status, float(now))
            codes = [call.args[0].code for call in log.call_args_list]
            counts.append(codes.count(SessionFact.FLIGHT_VERDICT))
        assert counts == [0, 1, 1, 1]


@mark.slow
def test_a_take_off_does_not_hide_what_forbids_to_fly():
    """The second flight is too short to be judged, and nothing shows that the motor was inspected."""
    milestones = Milestones("roll", Mock())
    weak = {Light.MOTORS: Fact(MotorsLight.MOTOR_LIMITED, Level.BAD, subject="motor 3", share=0.9)}
    first = SessionStatus(is_flying=True, flight_number=1, flight_seconds=34.0, worst_lights=weak)
    second = SessionStatus(is_flying=True, flight_number=2, flight_seconds=9.0, vehicle="1:1")
    for now, status in enumerate((first, replace(first, is_flying=False), second)):
        milestones.update(learning_with(), status, float(now))
    [verdict, _] = milestones.verdicts
    advice = str(verdict.judgement.next_step)
    assert advice.startswith("Do not fly")

    flying = replace(second, verdicts=milestones.verdicts)
    # While that is not known, the fault comes before all that does not warn; below it stands how this flight is.
    headline = flying.session_judgement.headline
    assert headline == flying.unrepaired_fault and headline.level is Level.WATCH
    assert verdict_on_present_flight(flying) == "This flight: the model is being learned."
    limited = Fact(MotorsLight.MOTOR_LIMITED, Level.WATCH, subject="motor 1", share=0.9)
    warned = replace(flying, worst_lights={Light.MOTORS: limited})
    assert warned.session_judgement.headline == limited and not verdict_on_present_flight(warned)
    # Where lines are printed, the fault is printed at the take-off, and only once.
    lines = StringIO()
    status_lines = StatusLines(console=Console(file=lines))
    for status in (flying, flying, replace(flying, boot_clock=9.0)):
        status_lines.show_if_new(status)
    # It is the next step, so that neither that nor the verdict on the flight, if it comes now, repeats it.
    status_lines.print_event(Event(4.0, verdict.fact, reception=0.0))
    status_lines.show_status(flying)
    assert lines.getvalue().count("NEXT Flight 1 (0:34 min): motor 3") == 1
    assert lines.getvalue().count("If that was not repaired, land.") == 1
    assert "VERDICT" not in lines.getvalue() and lines.getvalue().count("NEXT") == 1
    # What the present flight advises holds only if the fault of the first one was repaired.
    next_step = str(flying.session_judgement.next_step)
    assert next_step == "Land unless the fault of flight 1 was repaired."
    # While the link is lost, what to do about that comes first.
    silence = Fact(RowsFact.NOTHING_RECEIVED, subject="messages", duration=3.0)
    silent = replace(flying, no_model_reason=silence, message_age=4.0)
    assert silent.session_judgement == silent.overall_judgement
    # It leads while the vehicle lands, too, and changes nothing of what to do then.
    landing = replace(flying, state=VehicleState("Land", lands_by_itself=True)).session_judgement
    assert landing.headline == headline and landing.next_step.code is NextStep.LET_LAND
    text = flying.unrepaired_fault.sentence_and_remedy
    assert text.startswith("Flight 1 (0:34 min): motor 3") and text.endswith(
        "If that was not repaired, land."
    )
    # Beside the next step stands only what the fault is, unless that is the headline.
    assert not unrepaired_fault_beside_next_step(flying)
    fault_alone = unrepaired_fault_beside_next_step(warned)
    assert text == f"{fault_alone} If that was not repaired, land."
    # The status of the first second of a flight comes before that flight has a verdict.
    after_first_flight = replace(flying, verdicts=milestones.verdicts[:1])
    assert after_first_flight.unrepaired_fault.sentence_and_remedy == text
    landed = replace(flying, is_flying=False)
    judgement = landed.session_judgement
    assert judgement.headline == verdict.fact and str(judgement.next_step) == advice
    assert judgement.headline.is_bad and landed.unrepaired_fault is None
    # All verdicts, and last the one next step, that of the worst flight.
    first_line, _, next_step = closing_lines(landed)
    assert [first_line, next_step] == headline_and_next_step(judgement)
    # A vehicle in the air has to land before anything is repaired.
    ended = replace(flying, is_over=True)
    judgement = ended.session_judgement
    assert judgement.headline.is_bad and judgement.headline.figures["cause"] == verdict.fact
    assert str(judgement.next_step) == f"Land by sight. After landing: {advice}"
    assert ended.unrepaired_fault is None
    lines = closing_lines(ended)
    assert lines[0] == "This session ended in flight: no alarm comes any more."
    assert lines[1] == f"Next: Land by sight. After landing: {advice}"
    assert lines[2] == str(verdict.fact)
    assert [line for line in lines if line.startswith("Next:")] == [lines[1]]
    # During an alarm the vehicle lands now, and both faults are repaired after that.
    limited = Fact(MotorsLight.MOTOR_LIMITED, Level.BAD, subject="motor 1", share=0.9)
    alarmed = replace(ended, active_alarms=(limited,), worst_lights={Light.MOTORS: limited})
    verdicts = (verdict, alarmed.verdict)
    steps = [line for line in closing_lines(replace(alarmed, verdicts=verdicts)) if "Next:" in line]
    assert len(steps) == 1 and steps[0].startswith("Next: Land now. After landing: Do not fly")
    assert "motor 1" in steps[0] and "motor 3" in steps[0] and "If that" not in steps[0]
    assert steps[0].count("Do not fly before") == 1 and steps[0].count("Nor fly before") == 1

    # A fault of the latest flight that is as bad comes first, and the earlier one is not forgotten.
    both = replace(flying, is_flying=False, worst_lights=weak)
    assert both.session_judgement == both.overall_judgement
    assert both.unrepaired_fault.remedy.endswith(f"If that was not repaired: {advice}")


def test_a_crash_before_the_session_is_not_forgotten_in_its_first_flight():
    """The session begins when the vehicle lies on the ground, and its autopilot reports the crash."""
    facts = []
    milestones = Milestones("roll", facts.append)
    crash = Fact(Ending.CONTROL_LOST, time=22.1, height=None, cause=None, word=None)
    crashed = SessionStatus(loss=crash, message_age=0.1)
    flying = SessionStatus(is_flying=True, flight_number=1, flight_seconds=22.0, vehicle="1:1")
    for now, status in enumerate((crashed, crashed, flying)):
        milestones.update(learning_with(), status, float(now))
    [verdict] = facts
    assert str(verdict) == f"The flight before this session: {as_clause(crash)}."
    flying = replace(flying, verdicts=milestones.verdicts)
    next_step = str(flying.session_judgement.next_step)
    assert next_step == "Land unless the fault of the flight before was repaired."
    first_line, *_, next_step = closing_lines(replace(flying, is_flying=False, is_over=True))
    assert first_line == str(verdict) and next_step.startswith("Next: ")


def test_a_vehicle_that_is_missing_in_the_air_is_searched_first_and_the_crash_before_is_kept():
    milestones = Milestones("roll", Mock())
    loss = Fact(Ending.CONTROL_LOST, time=22.1, height=None, cause=None, word=None)
    crashed = SessionStatus(is_flying=True, flight_number=1, flight_seconds=34.0, loss=loss)
    silent = SessionStatus(is_flying=True, flight_number=2, flight_seconds=9.0, message_age=60.0)
    for now, status in enumerate((crashed, replace(crashed, is_flying=False), silent)):
        milestones.update(learning_with(), status, float(now))
    silence = Fact(RowsFact.NOTHING_RECEIVED, subject=MissingMessages.MESSAGES, duration=3.0)
    end = replace(silent, no_model_reason=silence, is_over=True, verdicts=milestones.verdicts)
    missing_line, crash_line, next_step = closing_lines(end)
    assert missing_line.startswith("Flight 2 (0:09 min): link lost")
    assert "search" in next_step
    assert crash_line.startswith("Flight 1 (0:34 min)")
    # Another flight with a fault that forbids to fly is no lesser one.
    assert "If that was not repaired: Do not fly" in next_step


def test_a_crash_comes_before_a_weak_motor_whatever_the_order_of_the_flights():
    def verdict(number, headline):
        return FlightVerdict(number, unjudged(headline))

    weak = Fact(MotorsLight.MOTOR_LIMITED, Level.BAD, subject="motor 1", share=0.9)
    crash = Fact(Ending.CRASHED, Level.BAD)
    stopped = Fact(WatchFact.STOPPED_IN_AIR, Level.BAD, time=9.0)
    over = Fact(WatchFact.ALARM_OVER, Level.BAD, time=9.0, reason=weak)
    sound = Fact(Headline.NOTHING_WRONG, Level.GOOD)
    headlines = (sound, over, weak, crash, stopped)
    verdicts = [verdict(number, headline) for number, headline in enumerate(headlines, 1)]
    assert [each.number for each in worst_first(verdicts)] == [5, 4, 3, 2, 1]


def test_what_forbids_to_fly_comes_before_a_small_margin_of_a_later_flight():
    oscillates = Fact(MarginsLight.OSCILLATES, Level.BAD)
    small_margin = Fact(MarginsLight.LOOP_MARGINS, Level.BAD)
    verdicts = [
        FlightVerdict(1, unjudged(oscillates)),
        FlightVerdict(2, unjudged(small_margin)),
    ]
    assert [each.number for each in worst_first(verdicts)] == [1, 2]


@mark.slow
def test_a_landed_state_that_flaps_fills_no_memory_and_hides_no_crash():
    milestones = Milestones("roll", Mock())
    learning = learning_with()
    loss = Fact(Ending.CRASHED, Level.BAD)
    flights = MAX_VERDICTS + 20
    for number in range(1, flights + 1):
        crash = loss if number == 3 else None
        status = SessionStatus(is_flying=True, flight_number=number, flight_seconds=9.0, loss=crash)
        milestones.update(learning, status, float(number))
    numbers = [verdict.number for verdict in milestones.verdicts]
    assert len(numbers) == MAX_VERDICTS + 1 and 3 in numbers and numbers[-1] == flights


def test_a_flight_whose_link_was_lost_in_the_air_is_reported_too():
    flight = (0, 1, True, 11.0)
    [lost] = reported_flights(flight, (1, 1, False, None), (1, 2, True, 0.5))
    assert str(lost).startswith("Flight 1 (0:11 min): how the flight ended was not seen: the auto")
    assert str(lost.figures["reason"].remedy).startswith("Look at the vehicle and its power")
    # After a restart in the air the same flight goes on, until the next take-off.
    goes_on = [flight, (1, 1, False, None), (1, 1, True, None)]
    assert not reported_flights(*goes_on)
    [landed] = reported_flights(*goes_on, (1, 1, False, None), (1, 2, True, 0.5))
    assert "not received" not in str(landed)


def test_a_flight_that_ends_in_the_air_is_no_landing():
    """The last reports of a crashed vehicle are of a flight: that it was lost is reported once the loss is known.

    Without parameters there is nothing to add to the alarm of the loss.
    """
    facts = []
    unfitted_facts = []
    milestones = Milestones("roll", facts.append)
    unfitted_milestones = Milestones("roll", unfitted_facts.append)
    learning = learning_with("model", PHYSICAL)
    milestones._has_parameters = True
    for now, is_flying in ((39.0, True), (40.0, False), (41.0, False)):
        status = SessionStatus(is_flying=is_flying, has_landed=False)
        milestones.update(learning, status, now)
        unfitted_milestones.update(learning_with(), status, now)
    assert not facts
    lost = SessionStatus(has_landed=False, loss=Fact(Ending.CRASHED))
    milestones.update(learning, lost, 42.0)
    unfitted_milestones.update(learning_with(), lost, 42.0)
    # The verdict on a lost flight is reported at its end in any case.
    assert [fact.code for fact in unfitted_facts] == [SessionFact.FLIGHT_VERDICT]
    facts = [fact for fact in facts if fact.code is not SessionFact.FLIGHT_VERDICT]
    [lost_flight_fact] = facts
    assert lost_flight_fact.figures["is_lost"] and lost_flight_fact.figures["clock"] == 40.0


@mark.parametrize(
    "model, effectiveness",
    [
        (None, "control effectiveness, rate damping and margins not known."),
        (partial_record(Learned, physical=PHYSICAL), "control effectiveness 2.86"),
    ],
)
def test_an_end_in_flight_reports_what_is_known(model, effectiveness):
    facts = []
    milestones = Milestones("roll", facts.append)
    milestones.report_end(learning_with(), SessionStatus(is_flying=True), 40.0, model)
    assert str(facts[0]).startswith(
        f"Ended in flight at 40 s. Mean wind not known. Roll: {effectiveness}"
    )
