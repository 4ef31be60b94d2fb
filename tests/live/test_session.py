"""A link, what learns from it and who is shown it, put together: with recorded flights and whatever may go wrong."""

import html
from concurrent.futures import ThreadPoolExecutor
from copy import copy
from dataclasses import replace
from functools import partial
from itertools import groupby
from unittest.mock import Mock

import numpy as np
from live_faults import error_ratios, run_session, undisturbed
from live_hover import Flight
from mavlink_streams import message
from numpy.testing import assert_allclose, assert_array_equal
from pymavlink.dialects.v20 import all as dialect
from pytest import approx, fixture, mark, param
from recorded_flights import FLIGHT
from refusals import refused
from simulated import simulated

import mavdem
from mavdem.assessment.judgement import unjudged
from mavdem.dataset.segments import MIN_SEGMENT_SECONDS
from mavdem.dem import Estimate, Settings
from mavdem.dem.online.learner import TOO_FEW_SAMPLES
from mavdem.dem.online.memory import SampleMemory
from mavdem.errors import NotLearnable
from mavdem.facts import Fact, Level
from mavdem.facts.forecasts import ForecastFact
from mavdem.facts.lights import Light, Unjudged
from mavdem.facts.loops import GainFact, LoopAction
from mavdem.facts.margins import MarginsLight
from mavdem.facts.motors import MotorWatchFact
from mavdem.facts.session import (
    LinkError,
    LinkFact,
    MissingMessages,
    RateFact,
    RecordingState,
    RowsFact,
    SessionFact,
    VehicleFact,
)
from mavdem.facts.watch import WatchFact
from mavdem.ingest.formats import read_stream
from mavdem.ingest.output_scale import OutputScale
from mavdem.live import AlignedRow, LiveStream
from mavdem.live.intake import FrameBatch
from mavdem.live.learning import FlightLearning
from mavdem.live.link import MAX_PIECES, LinkLost, ReceivedPiece
from mavdem.live.model_judgement import hover_of_segment, longest_settled_segment
from mavdem.live.raw_recording import RawRecording
from mavdem.live.session import LiveSession
from mavdem.live.session_status import SessionStatus
from mavdem.live.silence import SilenceMonitor
from mavdem.live.status_report import SEARCH_SECONDS
from mavdem.live.wind import WindEstimate
from mavdem.report.charts.timeline import live_timeline
from mavdem.report.numbers import plus_minus
from mavdem.report.pages.live_page import live_page
from mavdem.wind_velocity.vehicle_drag import Drag
from sitl_scenarios.files import load, scenario_from_table

pytestmark = mark.usefixtures("without_wind_fits")
COMPLETE = Settings(order=3, d=2, window=9, parameter_precision=10.0)
FRAMES = [(stamp / 1e6, frame) for stamp, frame in read_stream(FLIGHT).stamped_frames()]
FIRST = next(stamp for stamp, frame in FRAMES if frame[7:10] == bytes([30, 0, 0]))
"""Of ATTITUDE; the parameters come before."""
# Outputs, µs, that rotate an X quadrotor about roll.
TURNING = np.array([-99.0, 99.0, 99.0, -99.0])


class ScriptedLink:
    """Gives out the script's datagrams, in place of a socket; an exception in the script is raised."""

    has_datagrams = True
    dropped_datagrams = 0
    awaits_greeting = False
    drain_events = staticmethod(list)

    def __init__(self, script):
        self.script = script
        self.sent = b""
        self.reopened = 0

    def receive(self, timeout):
        now = self.script.pop(0) if self.script else []
        if isinstance(now, Exception):
            raise now
        return [ReceivedPiece(*piece) for piece in now]

    def send(self, frame):
        self.sent += frame

    def reopen(self):
        self.reopened += 1
        return self.reopened > 1


class Screen:
    """Keeps what it is shown."""

    log = pause = staticmethod(lambda event: None)

    def __init__(self):
        self.rows = []
        self.statuses = []
        self.setups = []

    def open(self, setup):
        self.setups.append(setup)
        return self

    def put(self, row):
        self.rows.append((row.time, row.segment, row.estimate))


def batches(seconds, start=0.0):
    """The recorded frames of so many seconds, those of each twentieth of a second together; all before them first."""
    here = [
        entry
        for entry in FRAMES
        if start <= entry[0] - FIRST < start + seconds or (not start and entry[0] < FIRST)
    ]
    return [
        list(batch)
        for _, batch in groupby(here, key=lambda entry: max((entry[0] - FIRST) // 0.05, -1.0))
    ]


def session_of(script, **options):
    """Returns a session on a link that delivers prepared batches of frames.

    With it come its screen and the list of facts that it will report.
    """
    screen = Screen()
    reported_facts = []
    link = ScriptedLink(script)
    shown = screen.open, screen.statuses.append
    session = LiveSession(
        link,
        LiveStream(),
        COMPLETE,
        *shown,
        lambda event: reported_facts.append(event.fact),
        **options,
    )
    return session, screen, reported_facts


@fixture(autouse=True)
def now(monkeypatch):
    """The session's clock, s: it stands still unless a test moves it, however busy the machine is."""
    clock = [100.0]
    monkeypatch.setattr("mavdem.live.clock.time.monotonic", lambda: clock[0])
    return clock


@fixture
def without_learning(monkeypatch):
    """For tests of other things: to learn from some seconds of flight takes longer than to receive them."""

    def take_sample(learner, *_sample):
        learner.no_model_reason = None

    monkeypatch.setattr("mavdem.OnlineLearner.update", take_sample)


def run(session):
    """Lets a session process all that its link delivers, and ends it."""
    while session.link.script:
        session.step(0.0)
    session.end()


@mark.slow
def test_motion_motors_and_battery_are_plotted_though_messages_are_too_slow_for_rows():
    """Messages at 25 Hz are too slow for a model.

    The page and the dashboard nevertheless have all charts, without repeated samples or stale wind.
    """
    slow = Flight(attitude=25.0, motors=25.0).frames(end=18.0)
    session, screen, _ = session_of([[frame] for frame in slow])
    run(session)
    history = session.history
    assert session.stream.row_format is None and history.learned_intervals == []
    for seconds, voltage in ((0.0, 12.1), (0.0, 12.1), (1.0, 12.0)):
        history.advance(history.now + seconds, history.boot)
        history.add_voltages({1: voltage, 2: 11.0})
    charts = {chart.title: chart for chart in live_timeline(history, "roll").flight_charts}
    assert {"Roll", "Pitch", "Height", "Motors", "Battery"} <= charts.keys()
    assert len(charts["Motors"].lines) == 4
    first, second = charts["Battery"].lines
    assert (first.name, second.name) == ("battery 1", "battery 2")
    assert first.y.tolist() == [12.1, 12.0] and second.y.tolist() == [11.0] * 2
    spacing = np.diff(charts["Roll"].lines[0].x)
    assert spacing.min() > 0.09 and np.median(spacing) < 0.2
    # The dashboard has them all.
    shown_times = np.array([time for time, _, _ in screen.rows])
    assert len(np.unique(shown_times)) == len(shown_times) >= len(charts["Roll"].lines[0].x)
    # Each sample has the latest outputs.
    assert np.mean(np.diff(charts["Motors"].lines[0].y) != 0) > 0.5
    # A wind that is no longer estimated is not drawn on, and a voltage that comes rarely has no gaps.
    latest = session.stream.latest_row()
    speeds = []
    for age in (1.0, 5.0):
        wind = WindEstimate(latest.row.time - age, np.array([3.0, 4.0]), np.ones(2))
        session._presentation.add_to_history(latest.row, latest.row_format, None, wind)
        speeds.append(history.table[-1, 7])
    assert_array_equal(speeds, [5.0, np.nan])
    assert first.longest_bridged_gap == 10.0


@mark.slow
@mark.parametrize("keeps_vehicle", [False, param(True, marks=mark.in_full)])
def test_a_silent_vehicle_is_succeeded_by_the_one_that_sends(now, keeps_vehicle):
    """Vehicle 1 is silent from 9 s, and vehicle 4 sends from 13 s on.

    It is followed unless the user has chosen vehicle 1.
    """
    first_vehicle_frames = Flight(attitude=10.0, motors=10.0).frames(end=9.0)
    here = Flight(attitude=10.0, motors=10.0, system=4).frames(start=13.0, end=30.0)
    session, _, reported_facts = session_of([], keeps_vehicle=keeps_vehicle)
    start = now[0]
    for time, frame in [*first_vehicle_frames, *here]:
        now[0] = start + time
        session.link.script = [[(time, frame)]]
        session.step(0.0)
        if time == 15.0:
            silent = session.status
    assert silent.vehicle == "1:1" and silent.message_age == approx(6.0, abs=0.3)
    assert silent.no_model_reason.sentence == (
        "Nothing was received from 1:1 for 3 s and more, only from others."
    )
    codes = [fact.code for fact in reported_facts]
    assert RowsFact.MESSAGES_RESUMED not in codes
    if keeps_vehicle:
        assert session.successor is None and session.status.message_age == approx(21.0, abs=0.3)
        return
    assert session.successor.name == "4:1" and codes.count(VehicleFact.VEHICLE_SUCCEEDED) == 1
    # By then the first vehicle's lost link is an alarm, too.
    (succession,) = (fact for fact in reported_facts if fact.code is VehicleFact.VEHICLE_SUCCEEDED)
    assert succession.sentence == (
        "Nothing came from 1:1 for 10 s: its session ends, and vehicle 4:1 (quadrotor, "
        "ArduPilot) is followed."
    )


@mark.slow
def test_a_successor_that_appears_late_is_not_said_to_be_found_beside_the_silent_vehicle(now):
    """Vehicle 1 is silent from 7 s, and vehicle 4 appears at 18 s, when the session already waits for a successor."""
    first_vehicle_frames = Flight(attitude=10.0, motors=10.0).frames(end=7.0)
    here = Flight(attitude=10.0, motors=10.0, system=4).frames(start=18.0, end=23.0)
    session, _, reported_facts = session_of([])
    start = now[0]
    for time, frame in [*first_vehicle_frames, *here]:
        now[0] = start + time
        session.link.script = [[(time, frame)]]
        session.step(0.0)
    codes = [fact.code for fact in reported_facts]
    assert VehicleFact.VEHICLE_SUCCEEDED in codes and VehicleFact.OTHER_VEHICLE not in codes


@mark.in_full
def test_what_is_learnt_from_is_the_flight_that_offline_reads():
    """The samples that the live learner stores are those of the same log read offline, with the same parameters."""
    session, screen, _ = session_of(batches(12.0))
    run(session)
    flight = mavdem.read_flight(FLIGHT)
    learned_record = session.flight.learning.learner._memory.record()
    (row,) = np.flatnonzero(np.all(flight.outputs == learned_record.outputs[0], axis=1))
    rows_of_record = slice(row, row + len(learned_record.outputs))
    assert_array_equal(learned_record.outputs, flight.outputs[rows_of_record])
    assert_allclose(learned_record.inputs, flight.inputs[rows_of_record], atol=0.01)
    assert len(learned_record.outputs) > 700
    live = session.flight.learning.learner.learn_now()
    assert 4.0 < session.status.settled_seconds < 0.01 * session.status.learned_rows
    assert session.status.learned_rows == len(
        [1 for *_, estimate in screen.rows if estimate is not None]
    )
    assert (
        screen.setups[0].geometry.names == flight.input_names
        and screen.rows[-1][2].model is not None
    )
    assert session.link.sent == b"", "nothing is sent unless asked for"
    physical = session.flight.learning.named_model(
        live, session.stream.parameters
    ).record.parameters
    assert physical["ATC_RAT_RLL_P"] == approx(0.2) and "SIM_WIND_SPD" not in physical


@mark.parametrize(
    "error, code",
    [
        (TimeoutError(), SessionFact.NOT_LEARNED_IN_TIME),
        (RuntimeError("the process ended"), ForecastFact.FAILED),
        (NotLearnable(TOO_FEW_SAMPLES), TOO_FEW_SAMPLES.code),
    ],
)
def test_why_there_is_no_model_at_the_end_is_a_fact(error, code):
    """A final model that cannot be learned is refused with the reason, whatever the error was."""
    session, _, _ = session_of([])
    assert session.status.no_model_reason == Fact(VehicleFact.LISTENING)
    now = session.intake.read_until
    session._silence_monitor.note_messages(now - SEARCH_SECONDS, now)
    assert session.status.no_model_reason == Fact(VehicleFact.NO_VEHICLE_YET, subject="")
    assert refused(session.final_model) == Fact(SessionFact.NO_LIVE_FLIGHT, climb_only=False)
    session.flight.learning.learner = Mock(**{"learn_now.side_effect": error})
    assert refused(session.final_model).code is code


def test_a_model_of_the_climb_alone_is_not_called_no_settled_flight():
    session, _, _ = session_of([])
    session.flight.learning.learner = Mock(learned="model", follows_torque=False)
    session.flight.learning.learn_row(Mock(is_settled=False, time=1.0), None)
    session.flight.learning.learned_rows = 300
    reason = refused(session.final_model)
    assert reason == Fact(SessionFact.NO_LIVE_FLIGHT, climb_only=True)
    assert "The first model was of the climb alone" in reason.sentence


@mark.parametrize("climb_seconds, hover_seconds", [(3.0, 10.0), (10.0, 3.0), (10.0, 0.5)])
def test_hover_figures_leave_out_the_climb_that_the_model_is_learned_from(
    climb_seconds, hover_seconds
):
    """In the climb the motors work harder than in the hover; less than a second of hover shows nothing."""
    session, _, _ = session_of([])
    learning = session.flight.learning
    learning.learner = Mock(learned=None, **{"update.return_value": None})
    memory = SampleMemory(dt=0.01, block_size=10, max_blocks=2000)
    for index in range(round((climb_seconds + hover_seconds) / 0.01)):
        is_settled = index * 0.01 >= climb_seconds
        outputs = np.full(4, 1500.0 if is_settled else 1900.0)
        row = AlignedRow(4.0 + index * 0.01, outputs, np.zeros(2), 0, is_settled, True)
        learning.learn_row(row, None)
        memory.add(row.inputs, row.outputs, row.time)
    record = replace(memory.record(), output_names=("roll", "roll rate"))
    scale = OutputScale("PWM", "µs", 1000.0, 2000.0, 1.0)
    row_format = Mock(scale=scale, geometry=Mock(names=("1", "2", "3", "4")))
    settled_segment = longest_settled_segment(record, learning.climbs)
    if hover_seconds < MIN_SEGMENT_SECONDS:
        assert settled_segment is None
    else:
        hover = hover_of_segment(settled_segment, record, row_format)
        assert hover.seconds == approx(hover_seconds)
        assert hover.trim == approx((1500.0,) * 4) and hover.headroom == approx((0.5,) * 4)


def test_why_too_little_was_learned_of_a_flight_is_the_true_reason():
    """The flight was too short, ended during the fit, or the computer skipped samples."""
    session, _, _ = session_of([])
    assert session.status.shortfall is None
    session.flight.unusable_messages_reason = Fact(RowsFact.NO_LIVE_MOTORS)
    assert session.status.shortfall == session.flight.unusable_messages_reason
    session.flight.learning.learner = Mock(no_model_reason=None)
    session.flight.learning._row_format = Mock(dt=0.01)
    reasons = []
    for session.flight.learning.learned_rows, session.flight.postponed_rows in (
        (500, 0),
        (2000, 0),
        (500, 900),
    ):
        reasons.append(session._missing_physical_parameters_reason().code)
    assert reasons == [
        SessionFact.SETTLED_TOO_SHORT,
        SessionFact.FIT_UNFINISHED,
        SessionFact.COMPUTER_TOO_SLOW,
    ]


def test_an_obstacle_with_another_reason_is_news_and_why_there_is_no_model_at_the_end(monkeypatch):
    session, _, told = session_of([])
    reasons = [Fact(RowsFact.NO_LIVE_MOTORS), Fact(RowsFact.NO_LIVE_ATTITUDE, can_ask=False)]
    slow = [Fact(RowsFact.LIVE_RATES_TOO_LOW, can_ask=False, reason=reason) for reason in reasons]
    counts = []
    for obstacle in (slow[0], slow[0], slow[1]):
        status = SessionStatus(vehicle="1:1", no_model_reason=obstacle, is_flying=True)
        monkeypatch.setattr(LiveSession, "status", status)
        monkeypatch.setattr(session._presentation, "log", told.append)
        session._report_no_model_reason(status)
        counts.append(len(told))
    assert counts == [1, 1, 2]
    assert refused(session.final_model) == slow[1]


def test_a_prior_of_another_vehicle_is_used_no_longer():
    """Neither its model nor its drag is."""
    session, _, reported_facts = session_of([], prior=Mock())
    session.stream.wind.earlier_drag = Drag.from_parameters()
    vehicles = ("PX4 quadrotor", "ArduPilot hexarotor")
    reason = Fact(SessionFact.PRIOR_OF_OTHER_VEHICLE, names=vehicles)
    session.refuse_prior(reason)
    assert reported_facts == [reason]
    assert session.stream.wind.earlier_drag is None
    for flight in (session.flight, session._new_flight()):
        assert flight.learning._prior is None


@mark.slow
def test_a_prior_of_other_inputs_is_not_used_and_says_so():
    """The prior is a model with other inputs than those of the vehicle."""
    other = mavdem.learn(simulated(samples=300, wind=1.0))
    session, _, reported_facts = session_of(batches(5.0), prior=other)
    run(session)
    assert [fact.code for fact in reported_facts].count(SessionFact.PRIOR_NOT_USED) == 1
    assert session.flight.learning.learner is not None


@mark.slow
@mark.usefixtures("without_learning")
def test_rates_are_asked_for_and_given_back(now, monkeypatch):
    """The session requests 200 Hz of two messages, and restores their former interval of 250 ms at its end."""
    monkeypatch.setattr(ScriptedLink, "awaits_greeting", True)
    script = batches(8.0)
    session, _, _ = session_of(script, requested_rate=200.0)
    now[0] += 1.0
    session.link.receive = lambda timeout: []
    session.step(0.0)
    del session.link.receive
    answers = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    for number in range(len(script)):
        now[0] += 0.05
        if number == 100:
            for entry in (30, 36):
                interval = answers.message_interval_encode(entry, 250_000).pack(answers)
                session.link.script[0].append((session.link.script[0][-1][0], interval))
        session.step(0.0)
    session.link.receive = lambda timeout: now.__setitem__(0, now[0] + timeout) or []
    session.end()
    sent = dialect.MAVLink(None).parse_buffer(bytearray(session.link.sent))
    assert sent[0].get_type() == "HEARTBEAT", "a vehicle that waits to hear of someone hears of us"
    commands = [entry for entry in sent if entry.get_type() == "COMMAND_LONG"]
    asked = [(entry.command, int(entry.param1), entry.param2) for entry in commands]
    assert asked[:2] == [(510, 30, 0), (510, 36, 0)] and (511, 30, 5_000) in asked
    # Nobody confirms it: it is sent again, and said.
    assert asked.count((511, 30, 250_000)) == 3
    unconfirmed = session.history.events[-1].fact
    assert unconfirmed.code is RateFact.RATES_NOT_RESTORED and unconfirmed.is_watch_or_bad
    assert "did not confirm" in unconfirmed.sentence
    # One that is silent in flight cannot do so.
    session._silence_monitor.message_time -= 60.0
    now[0] += 60.0
    session.end()
    assert "was silent at the end" in session.history.events[-1].fact.sentence
    # A vehicle that was switched off on the ground cannot confirm it, and nothing is to be done or said.
    reported_count = len(session.history.events)
    session.stream._phase.is_flying = False
    session._silence_monitor.message_time -= 60.0
    now[0] += 60.0
    session.end()
    assert len(session.history.events) == reported_count


def test_the_judgement_of_a_recording_waits_for_the_ground_and_for_the_end():
    by_recording = unjudged(TOO_FEW_SAMPLES)
    adviser = Mock(judgement=by_recording, **{"update.return_value": ()})
    session, _, _ = session_of([], gain_adviser=adviser)
    session.stream = Mock(is_flying=True)
    session.report_gain_advice()
    assert session.flight.judging.judgement is None and not adviser.update.called, (
        "while it still lands"
    )
    session.report_gain_advice(is_at_end=True)
    assert session.flight.judging.judgement is by_recording


def test_the_status_that_is_shown_says_that_the_recording_is_being_judged():
    adviser = Mock(is_awaited=True, recording_failure=None)
    session, _, _ = session_of([], gain_adviser=adviser)
    awaited = Fact(SessionFact.RECORDING_NOT_JUDGED, kind=RecordingState.BEING_READ)
    assert session.shown_status.recording_verdict == awaited
    adviser.is_awaited = False
    assert session.shown_status.recording_verdict is None


def test_a_recording_that_lacks_the_end_of_the_flight_does_not_judge_it():
    adviser = Mock(judgement=unjudged(TOO_FEW_SAMPLES), **{"update.return_value": ()})
    session, _, _ = session_of([], gain_adviser=adviser)
    session.intake.is_recording_cut = True
    session.stream = Mock(is_flying=False, flight_number=0)
    session.report_gain_advice()
    assert session.flight.judging.judgement is adviser.judgement, "it has the flight before it"
    session.flight.judging.judgement = None
    session.stream = Mock(is_flying=True)
    session.report_gain_advice(is_at_end=True)
    assert session.flight.judging.judgement is None and session.gain_adviser is None


@mark.slow
@mark.usefixtures("without_learning")
def test_a_landing_never_replaces_the_last_model_before_it():
    written = Fact(GainFact.GAINS_WRITTEN, reason=TOO_FEW_SAMPLES)
    by_recording = replace(unjudged(written), next_step=TOO_FEW_SAMPLES)
    adviser = Mock(
        is_due=False, facts=(written,), judgement=by_recording, **{"update.return_value": ()}
    )
    session, _, reported_facts = session_of(batches(7.0), gain_adviser=adviser)
    run(session)
    learned = mavdem.learn(simulated(samples=300, wind=1.0), COMPLETE)
    # Models of other flights, which their seeds tell apart.
    early, late, next_flight, climbing = (
        replace(learned, settings=replace(learned.settings, seed=seed), model=copy(learned.model))
        for seed in range(4)
    )
    learner = Mock(
        training_end_time=50.0,
        **{"update.return_value": None, "learn_now.side_effect": NotLearnable(TOO_FEW_SAMPLES)},
    )
    session.flight.learning.learner = learner
    row = AlignedRow(50.0, np.zeros(4), np.zeros(2), 0, True, True)
    learner.learned = climbing
    for settled in (False, True):
        session._process_row(row._replace(time=49.0, is_settled=settled), 0.0)
    assert all(model is not climbing for _, model in session.flight.learning._models)
    for at, learner.learned in ((50.0, early), (57.0, late), (57.5, late)):
        session._process_row(row._replace(time=at), 0.0)
    assert (
        session.flight.learning.named_model(late, session.stream.parameters).model
        is session.flight.learning._models[-1][1].model
    )
    learner_of_flight, session.flight.learning.learner = session.flight.learning.learner, None
    session.stream.pop_withdrawal_time = lambda: 54.0
    session._process_landing_or_loss()
    assert adviser.is_due, "the recording of a flight without a model is judged, too"
    adviser.is_due = False
    session.flight.learning.learner = learner_of_flight
    session.stream.pop_withdrawal_time = lambda: 55.0
    session.backlog.add([FrameBatch(0.0, 0.0, [])])
    session._analyse()
    learner.forget_since.assert_called_with(55.0)
    assert adviser.is_due, "gains are advised after a landing"
    adviser.is_due = False

    def kept():
        return session.final_model().settings.seed

    session.report_gain_advice(is_at_end=True)
    assert not adviser.is_due and session.flight.judging.judgement.next_step == TOO_FEW_SAMPLES, (
        "once, as what to do next"
    )
    assert kept() == 0
    session._process_row(row._replace(time=70.0), 0.0)
    assert kept() == 0, "what was learned of the landing does not come back"
    learner.learned = next_flight
    session._process_row(row._replace(time=80.0), 0.0)
    session.report_gain_advice(is_at_end=True)
    assert adviser.is_due
    assert kept() == 2 and reported_facts[-1].code is SessionFact.FORMER_MODEL_KEPT
    assert reported_facts[-1].figures["reason"] == TOO_FEW_SAMPLES
    learner.learn_now.side_effect = TimeoutError
    assert kept() == 2
    assert reported_facts[-1].figures["reason"] == TOO_FEW_SAMPLES, "it is reported once"
    alarms = [
        Fact(MotorWatchFact.MOTOR_RECOVERED, level, time=at, subject="motor 1")
        for level, at in 2 * [(Level.BAD, 118.0), (Level.GOOD, 142.0)]  # A fault comes and goes.
    ]
    for alarm in alarms:
        session._presentation.log(alarm)
    assert reported_facts[-4:] == alarms and len(reported_facts) == len(session.history.events)


@mark.slow
def test_the_last_model_has_the_parameters_and_findings_of_the_flight():
    """The model at the end of a session keeps the physical parameters of the flight.

    It is judged again, without a recording.
    """
    session, *_ = session_of(batches(6.0), recording_name="my flight.tlog")
    run(session)
    late = mavdem.read_flight(FLIGHT)[2000:4000]
    learned = mavdem.learn(late, COMPLETE)
    physical = learned.physical
    # As fitted in flight, to more than the model's own samples.
    session.flight.learning.estimate = session.flight.learning.estimate._replace(physical=physical)
    model = session.final_model()
    update = partial(
        session.flight.judging.update, 1e9, session.flight.learning, session.stream, is_busy=False
    )
    with ThreadPoolExecutor(1) as session.flight.judging._executor:
        update(has_rate_setpoint=False)
    update(has_rate_setpoint=False)
    in_flight = session.status.findings
    model = session.judge_final_model(model)
    assert (
        model.physical is physical
        and in_flight.purposes[:2] == session.flight.judging.findings.purposes[:2]
    )
    lights = session.status.overall_judgement.lights
    assert session.status.findings == session.flight.judging.findings
    assert lights["log"].level is Level.GOOD and lights["margins"].code is MarginsLight.LOOP_MARGINS
    # Less than nine of ten models of the vehicle lack margin, so that the flight is no basis for new gains.
    assert lights["margins"].remedy.startswith("Keep the gains, and fly ten small, quick doublets")
    # With a setpoint of the rate a log identifies the loop by that, so that the recording has to decide.
    session.flight.judging.judge_final_model(
        model, session.flight.learning.row_format, (), climbs=[], has_rate_setpoint=True
    )
    awaited = session.flight.judging.judgement.lights["margins"]
    assert awaited.code is Unjudged.JUDGED_LATER and "`mavdem 'my flight.tlog'`" in awaited.remedy
    assert not session.flight.judging.judgement.headline.is_watch_or_bad
    # In flight it is identified by another review.
    with ThreadPoolExecutor(1) as session.flight.judging._executor:
        session.flight.judging._next_judging_time = 0.0
        update(has_rate_setpoint=True)
    update(has_rate_setpoint=True)
    in_flight = session.flight.judging.judgement.lights["margins"]
    assert str(in_flight).startswith("No oscillation so far; margins are known after 25 s")
    # A climb, which the model is learned from, too, is no hover.
    start_time, dt = model.record.begins[0], model.record.dt
    climbing_inputs = model.record.inputs.copy()
    climbing_inputs[:100] = 1950.0
    climbing = replace(model, record=replace(model.record, inputs=climbing_inputs))
    motor_levels = []
    for climbs in ({}, {0: (start_time, start_time + 99 * dt)}):
        session.flight.learning._climb_by_segment = climbs
        session.judge_final_model(climbing)
        motor_levels.append(session.flight.judging.judgement.lights["motors"].level)
    assert motor_levels == [Level.WATCH, lights["motors"].level]
    session.flight.learning._climb_by_segment = {}
    session.judge_final_model(model)
    page = html.unescape(
        live_page("udp", "roll", session.history, session.status, session.time_account(), model)
    ).replace("\u00a0", " ")
    effect = plus_minus(*np.degrees([physical.effect[0], physical.interval().effect[0]]))
    assert effect.replace("-", "\N{MINUS SIGN}") in page
    assert all(str(purpose.reason) in page for purpose in session.flight.judging.findings.purposes)
    assert "`mavdem 'my flight.tlog'`" in lights["motors"].remedy, "no hover shows the trim"
    assert "Not judged in flight." in page and "not logged" not in page
    swing = np.sin(10 * np.pi * learned.dt * np.arange(len(late)))[:, None]
    shaken = replace(
        learned.record, inputs=late.inputs + swing * TURNING, outputs=late.outputs + swing
    )
    session.judge_final_model(replace(learned, record=shaken))
    assert session.flight.judging.judgement.lights["margins"].code is MarginsLight.OSCILLATES
    # A limit cycle is not looked for in a climb.
    climb_end = shaken.begins[0] + (len(late) - 300) * learned.dt
    session.flight.learning._climb_by_segment = {0: (shaken.begins[0], climb_end)}
    session.judge_final_model(replace(learned, record=shaken))
    assert session.flight.judging.judgement.lights["margins"].code is not MarginsLight.OSCILLATES


def test_margins_that_a_decision_states_are_reported_once():
    """The decision on the loops of an axis contains the fact about its margins.

    So that fact is not reported by itself.
    """
    session, _, reported_facts = session_of([])
    session.flight.learning.has_settled = True
    margins = Fact(
        MarginsLight.LOOP_MARGINS,
        Level.WATCH,
        subject="rate",
        axis="pitch",
        rating=Level.BAD,
        lacking="phase_margin",
        phase_margin=34.0,
        phase_margin_interval=(0.0, 55.0),
        reason=None,
    )
    decision = Fact(LoopAction.LOOPS_JUDGED, axis="pitch", reason=margins, action=None)
    judged = unjudged(TOO_FEW_SAMPLES)
    judgement = replace(judged, lights={**judged.lights, Light.MARGINS: margins})
    session._log_advice((decision,), judgement)
    assert reported_facts == [decision]
    session._log_advice(
        (decision.replace(axis="roll", reason=margins.replace(axis="roll")),), judgement
    )
    assert reported_facts == [decision, margins]
    # Gains that are written already need no command.
    action = Fact(LoopAction.LOAD_ADVISED_GAINS, arguments=("flight.tlog",))
    advised = margins.replace(axis="roll", action=action)
    written = Fact(GainFact.GAINS_WRITTEN, path="flight.gains", reason=TOO_FEW_SAMPLES)
    lights = {**judged.lights, Light.MARGINS: advised}
    session._presentation._report_times.clear()
    session._log_advice((written,), replace(judged, lights=lights))
    assert [fact.remedy for fact in reported_facts[2:]] == ["", written.remedy]
    del reported_facts[2:]
    # A flight that never settled has no gains to speak of, but its recording is judged.
    session.flight.learning.has_settled = False
    session._log_advice((Fact(GainFact.GAINS_LEFT, reason=TOO_FEW_SAMPLES),), judgement)
    assert reported_facts == [decision, margins]


def test_what_one_step_cannot_receive_counts_as_not_analysed(now):
    """As many messages wait in the link as one step receives, all from before the session: more may wait there."""
    session, *_ = session_of([])
    start_time = now[0]
    now[0] += 5.0
    _, frame = FRAMES[0]
    session.link.script = [MAX_PIECES * [(0.0, frame)]]
    for analysed_time in (start_time, now[0]):
        session.step(0.0)
        assert not session.backlog and session.backlog.analysed_until == analysed_time


@mark.parametrize("vehicle, is_sending", [(None, True), (None, False), ("1:1", True)])
def test_motion_is_missed_of_a_followed_vehicle_or_if_none_sends(now, vehicle, is_sending):
    """Of two vehicles none is followed yet.

    Only if neither sends its attitude the session says that motion is missing.
    """
    two_vehicles = Fact(VehicleFact.TWO_VEHICLES_LIVE, subject="1:1")
    session, *_ = session_of([])
    silence = session._report.silence
    silence.note_messages(now[0], now[0])
    silence.note_samples(1)
    # Other messages, which come all the time: after a silence the motion is awaited a while longer.
    for _ in range(10):
        now[0] += 1.0
        silence.note_messages(now[0], now[0])
    session.intake.receive(0.0)
    silence.note_attitudes(int(is_sending))
    status = SessionStatus(vehicle=vehicle, no_model_reason=two_vehicles)
    report = replace(session._report, stream=Mock(now=1.0, status=lambda: status))
    no_motion = Fact(RowsFact.NOTHING_RECEIVED, subject=MissingMessages.MOTION, duration=3.0)
    is_named = vehicle is None and is_sending
    assert report.status.no_model_reason == (two_vehicles if is_named else no_motion)
    assert report.status.overall_judgement.headline == report.status.no_model_reason
    if vehicle and is_sending:
        # It comes from the only vehicle, with stamps that the clock does not take, such as ones that fall.
        alone = Mock(now=1.0, status=lambda: status, other_vehicles={})
        reason = replace(report, stream=alone).status.no_model_reason
        assert str(reason).startswith("The time stamps of ATTITUDE do not rise: for 3 s and more")


@mark.in_full
@mark.usefixtures("without_learning")
def test_what_came_before_a_silence_does_not_pass_for_what_comes(now):
    """After 9 s of flight nothing arrives for 10 min, then heartbeats, then the flight goes on.

    Where motion was missing for longer than messages, the end of the silence says for how long.
    """
    session, screen, reported_facts = session_of([*batches(9.0)])
    run(session)
    assert (
        session.status.rates["ATTITUDE"] == approx(100, rel=0.1)
        and not session.status.no_model_reason
    )
    for seconds in (*[1.0] * 20, *[10.0] * 58):
        now[0] += seconds
        session.step(0.0)
    last = screen.statuses[-1]
    assert set(last.rates.values()) == {0.0}
    silent = Fact(RowsFact.NOTHING_RECEIVED, subject=MissingMessages.MESSAGES, duration=3.0)
    lost = [fact for fact in reported_facts if fact.code is LinkFact.LOST_IN_FLIGHT]
    assert last.no_model_reason == silent and silent not in reported_facts
    # It is reported once, when it is bad.
    assert [fact.level for fact in lost] == [Level.BAD]
    assert {fact.code for fact in last.watch_facts} == {WatchFact.NOT_WATCHED}
    assert {fact.figures["reason"].code for fact in last.watch_facts} == {RowsFact.NOTHING_RECEIVED}
    # A vehicle that sends nothing else says only that it is there.
    heartbeat = next(frame for _, frame in FRAMES if frame[7:10] == bytes(3))
    for batch in [batches(0.05, start=9.0)[0], *40 * [[(FIRST + 10.0, heartbeat)]]]:
        session.link.script = [batch]
        now[0] += 0.25
        session.step(0.0)
    assert (
        set(session.status.rates.values()) == {0.0}
        and session.status.no_model_reason.subject == MissingMessages.MOTION
    )
    (resumed,) = (
        fact
        for fact in reported_facts
        if fact.code is RowsFact.MESSAGES_RESUMED and fact.subject == MissingMessages.MESSAGES
    )
    assert resumed.figures["duration"] == approx(600.0, abs=1.0)
    # Its absence was an alarm, which the headline of the flight still names.
    session.link.script = batches(2.0, start=11.0)
    run(session)
    assert session.status.is_flying and session.status.link_outage == approx(600.0, abs=1.0)
    assert ", after the link was lost for 600 s" in str(session.status.overall_judgement.headline)
    assert session.status.rates["ATTITUDE"] > 50 and not session.status.no_model_reason
    # Nothing arrives for 60 s, after 30 s in which only heartbeats came: motion was missing for longer.
    reported_facts.clear()
    for _ in range(30):
        session.link.script = [[(FIRST + 13.0, heartbeat)]]
        now[0] += 1.0
        session.step(0.0)
    now[0] += 60.0
    # What is received now may have come at any time since the step before.
    session.step(0.0)
    # A heartbeat comes before the first attitude.
    session.link.script = [[(FIRST + 13.9, heartbeat)], *batches(2.0, start=14.0)]
    run(session)
    durations = {
        fact.subject: fact.figures["duration"]
        for fact in reported_facts
        if fact.code is RowsFact.MESSAGES_RESUMED
    }
    assert durations == {
        MissingMessages.MESSAGES: approx(60.0, abs=1.0),
        MissingMessages.MOTION: approx(90.0, abs=1.0),
    }


def test_what_waits_at_the_end_of_a_session_is_analysed_for_a_moment(now, monkeypatch):
    """A computer that is far behind notices a landing so; one that is too slow for that ends all the same."""
    session, _, _ = session_of([])
    analyse = session._analyse
    for analysis_seconds, waiting_batches in ((0.1, 0), (1.5, 3)):

        def analyse_slowly(seconds=analysis_seconds):
            now[0] += seconds
            analyse()

        monkeypatch.setattr(session, "_analyse", analyse_slowly)
        arrival = now[0]
        session.backlog.add([FrameBatch(arrival + second, 0.0, []) for second in range(5)])
        session.analyse_rest()
        assert len(session.backlog) == waiting_batches


@mark.slow
def test_a_computer_that_was_busy_since_its_last_look_at_the_link_reports_no_silence(now):
    """Opening the dashboard may take seconds, and messages wait in the link meanwhile."""
    session, _, _ = session_of([*batches(2.0)])
    run(session)
    now[0] += 20.0
    busy = session.status
    assert busy.message_age == approx(0.0, abs=0.1) and not busy.is_silent
    assert busy.no_model_reason.code is not RowsFact.NOTHING_RECEIVED
    # Now the link is empty.
    session.step(0.0)
    assert session.status.message_age == approx(20.0, abs=0.1)
    assert session.status.no_model_reason.code is RowsFact.NOTHING_RECEIVED


@mark.slow
def test_a_silence_is_reported_at_once_by_a_computer_that_is_still_analysing(now):
    session, _, _ = session_of([*batches(2.0)])
    run(session)
    arrival = now[0]
    now[0] += 20.0
    session.backlog.add([FrameBatch(arrival, 0.0, [])])
    session.intake.read_until = now[0]
    status = session.status
    assert status.analysis_delay == approx(20.0)
    assert status.no_model_reason.code is RowsFact.NOTHING_RECEIVED


@mark.in_full
def test_a_slow_computer_reports_it_and_puts_off_fits_then_plots_but_no_row(now, monkeypatch):
    monkeypatch.setattr("time.time", lambda: now[0])
    monkeypatch.setattr("mavdem.live.backlog.REPEAT_SECONDS", 5.0)
    arriving = [
        (stamp - FIRST + 100.0, frame) for stamp, frame in FRAMES if 0.0 <= stamp - FIRST < 25.0
    ]
    ahead = np.zeros((1, 2))
    session, screen, reported_facts = session_of([], requested_rate=100.0)
    held = Mock()
    screen.pause = held
    delays = []

    def made(_, t, y, u, *_weak):
        delays.append(now[0] - session.backlog.analysed_until)
        return Estimate(t, y, y, np.array([t + 0.25]), ahead, ahead, ahead)

    monkeypatch.setattr(mavdem.OnlineLearner, "update", made)
    take = session._process_row
    shed = []

    def slow(row, arrival_time):
        now[0] += 0.03 * (107.0 < now[0] < 118.0)  # The time grows to three times its length.
        take(row, arrival_time)

    session._process_row = slow
    while arriving or session.backlog:
        here = [piece for piece in arriving[:4000] if piece[0] <= now[0]]
        session.link.script, sent, behind = (
            [here],
            len(session.link.sent),
            session.backlog.analysed_until < now[0] - 0.6,
        )
        del arriving[: len(here)]
        session.step(0.0)
        if behind:
            assert len(session.link.sent) == sent, "no rates are asked for meanwhile"
        if session.flight.learning.learner is not None and held.called:
            shed.append((not session.flight.learning.learner.fits_physical, held.call_args[0][0]))
        now[0] += 0.01
    assert shed.index((True, False)) < shed.index((True, True)), "fits wait first, then pictures"
    assert (False, True) not in shed
    assert session.backlog.longest_delay - 1 > max(delays) > 3, (
        "estimates wait after pictures, and rows do not"
    )
    first_delay, *_ = (status.analysis_delay for status in screen.statuses if status.analysis_delay)
    assert first_delay == approx(1.5, abs=0.6)
    begin, end = (fact for fact in reported_facts if "delay" in fact.figures)
    assert (begin.code, end.code) == (SessionFact.COMPUTER_BEHIND, SessionFact.COMPUTER_KEEPS_UP)
    assert str(end).endswith(" s behind the link."), "nothing was lost"
    assert begin.figures["delay"] == approx(1.0, abs=0.05)
    assert end.figures["delay"] == session.backlog.longest_delay > 5.0
    # The analysis has caught up, and the delay is held for 30 s more, which end after the stream.
    assert not session.status.analysis_delay and session.status.delay_fact
    gaps = (
        RowsFact.MESSAGES_RESUMED,
        RowsFact.NOTHING_RECEIVED,
        RowsFact.MESSAGE_GAP,
        VehicleFact.CLOCK_JUMPED,
    )
    assert not [fact for fact in reported_facts if fact.code in gaps]
    rows = [row for row in screen.rows if row[1] >= 0]
    assert len(rows) == session.status.learned_rows + session.status.unlearned_rows > 2000
    account = session.time_account()
    assert sum(account.values()) == approx(now[0] - 100.0)
    assert account["learned"] == approx(session.status.learned_rows / 100, abs=0.3)
    assert not account["left_out"] and not account["silent"]


@mark.slow
def test_every_frame_is_recorded_whatever_happens_to_the_rest(tmp_path, monkeypatch):
    """The recording is complete although the viewer fails, learning overflows and the link breaks."""
    recording = RawRecording(tmp_path / "flight.tlog")
    session, _, reported_facts = session_of(
        [*batches(7.0), LinkLost("x", LinkError.FAILED), [], []], recording=recording
    )
    session._presentation._open_display = Mock(side_effect=RuntimeError("a mistake of the view's"))
    monkeypatch.setattr(
        mavdem.OnlineLearner, "update", Mock(side_effect=ValueError("It overflows."))
    )
    run(session)
    kept = [frame for _, frame in read_stream(tmp_path / "flight.tlog").stamped_frames()]
    assert kept == [frame for stamp, frame in FRAMES if stamp - FIRST < 7.0]
    codes = [fact.code for fact in reported_facts]
    assert codes.count(SessionFact.SAMPLE_SKIPPED) == codes.count(SessionFact.DISPLAY_FAILED) == 1
    assert codes[-2:] == [LinkFact.CONNECTION_LOST, LinkFact.LINK_OPEN_AGAIN]
    assert reported_facts[-2].figures["reopening"]


@mark.slow
def test_a_recording_that_fails_ends_alone():
    """The disk is full: that is reported, and the session goes on with all that comes."""
    full = Mock(**{"add.side_effect": OSError(28, "No space left on device")})
    session, _, reported_facts = session_of(batches(3.0), recording=full)
    run(session)
    (ended,) = (fact for fact in reported_facts if fact.code is LinkFact.STREAM_RECORDING_ENDED)
    assert ended.figures["error"] == "No space left on device" and not ended.figures["finishing"]
    assert session.stream.sample_count > 100 and session.intake.is_recording_cut


SHORT = {"duration": 40.0, "flights": 1, "height": 5.0}
FAULTS = {
    "reboot": 13.0,
    "outage": 20.0,
    "outage_seconds": 4.0,
    "clock_jump": 27.0,
    "mavproxy_rate": 4.0,
}


@mark.slow
@mark.usefixtures("coarse_physics", "without_alarms")
def test_a_session_with_all_faults_ends_with_a_good_model(monkeypatch):
    """A simulated flight has gaps, a reboot, clock jumps and lost messages.

    Its model must forecast nearly as well as one of an undisturbed log.
    """
    monkeypatch.setattr("live_faults.RATE", 50.0)
    long = load("ardupilot_faults").model_dump(mode="json")
    slower = {"SCHED_LOOP_RATE": 100.0}
    vehicle = {"model": long["vehicle"]["model"], "parameters": slower}
    scenario = scenario_from_table({**long, **SHORT, "faults": FAULTS, "vehicle": vehicle})
    session, account = run_session(scenario)
    reported_facts = {event.fact.code for event in session.history.events}
    happened = {
        VehicleFact.VEHICLE_REBOOTED,
        VehicleFact.CLOCK_JUMPED,
        RowsFact.MESSAGES_RESUMED,
    }
    assert happened <= reported_facts
    assert RowsFact.MOTOR_ORDER_ASSUMED not in reported_facts, (
        "parameters say where the motors are, and come when they are asked for"
    )
    assert sum(account.values()) == approx(43.0, abs=0.5)
    # Learned from is the time that the samples span, 0.02 s each by the vehicle's clock, not that in which some came.
    assert account["learned"] == approx(session.status.learned_rows / 50.0, abs=0.05)
    assert account["learned"] > 13.0
    assert account["silent"] > 2.5 and account["waiting"] < 25.0, account
    assert session.stream.followed_vehicle.message_counts[83] > 500, (
        "by setpoints loops are identified"
    )
    kept = session.final_model()
    test, train = (undisturbed(scenario, seed) for seed in (1001, 1002))
    ratios = error_ratios(kept, test)
    offline = error_ratios(mavdem.learn(train), test)
    assert np.all(ratios < 2 * offline) and ratios[0] < 0.1, (ratios, offline)


@mark.in_full
def test_what_is_wrong_in_a_climb_is_shown_before_there_are_rows(now):
    """From take-off on, although the model's rows begin after the climb."""
    first = next(i for i, (stamp, _) in enumerate(FRAMES) if stamp >= FIRST)
    session, screen, reported_facts = session_of([])
    ground = {"landed_state": dialect.MAV_LANDED_STATE_TAKEOFF}
    takes_off = message("EXTENDED_SYS_STATE", **ground)
    for stamp, frame in FRAMES[first : first + 1500]:
        session.link.script.append([(stamp, frame + takes_off)])
        now[0] += 0.01
        session.step(0.0)
    assert session.flight.learning.row_format is None and screen.setups and len(screen.rows) >= 2
    session.end()


def test_unexpected_motion_is_one_event_while_it_lasts_and_none_where_a_weak_motor_explains_it():
    unknown = np.zeros((1, 2))
    usual = Estimate(0.0, unknown, unknown, np.zeros(1), unknown, unknown, unknown)
    # A computer that is late leaves out samples, and its model is old.
    for seconds_to_alarm, is_late, report_count in (
        (2.0, False, 0),
        (9.0, False, 1),
        (9.0, True, 0),
    ):
        reports = []
        learning = FlightLearning("roll", Settings(), None, prior=None, log=reports.append)
        learning._gusts = Mock(**{"add.return_value": ()})
        learning._are_motors_at_idle = Mock(return_value=False)
        for time in range(80, 100):
            learning._is_motor_weak = time >= 88.0 + seconds_to_alarm
            # It lasts for two seconds from 88 s on, and comes again while the alarm lasts.
            estimate = usual._replace(unusual=time in (88, 89, 98), window_center=float(time))
            learning.note_estimate(estimate, Mock(time=float(time)), {}, is_late=is_late)
        assert [report.figures["clock"] for report in reports] == [88.0] * report_count
        for report in reports:
            assert (report.code, report.level) == (SessionFact.MOTION_UNEXPECTED, Level.WATCH)


def test_bytes_without_a_message_are_noise_and_no_silence(now):
    monitor = SilenceMonitor()
    start = monitor.message_time
    for seconds in range(6):
        monitor.note_noise(start + seconds)
    noise = monitor.missing_messages(start + 6.0)
    assert noise.sentence_and_remedy == (
        "Only bytes that are no intact MAVLink messages were received for 3 s and more. Check protocol and baud rate, "
        "and what disturbs the radio."
    )
    assert "is_noise" not in monitor.missing_messages(start + 20.0).figures


def test_of_several_vehicles_one_is_to_be_chosen_still_at_the_end():
    session, _, _ = session_of([])
    choice = Fact(VehicleFact.CHOOSE_VEHICLE, name="1:1")
    session.stream._vehicles.not_followed_reason = choice
    assert refused(session.final_model) == choice
    assert session.status.no_model_reason == choice
