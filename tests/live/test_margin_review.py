"""Margins in flight: those that the review of the recording has, or none for the same reason, at bounded cost."""

from concurrent.futures import Executor, Future
from math import inf
from types import MappingProxyType
from unittest.mock import Mock

from mavlink_streams import flight, heartbeat
from pytest import approx, fixture, mark

from mavdem.assessment.assess import assess
from mavdem.assessment.axis import Options
from mavdem.assessment.judgement import Judgement
from mavdem.experiments.paper.flights import write_log
from mavdem.facts import Fact, Level
from mavdem.facts.assessment import NextStep
from mavdem.facts.lights import Light
from mavdem.facts.loops import LoopFact
from mavdem.facts.margins import MarginsLight
from mavdem.facts.session import LinkFact
from mavdem.facts.sources import SourceFact
from mavdem.ingest import read_log
from mavdem.ingest.formats import read_stream
from mavdem.ingest.mavlink.frame_reader import FrameReader
from mavdem.ingest.tlog import tlog_from_bytes
from mavdem.live import LiveStream, margin_review
from mavdem.live.judging import ModelJudging
from mavdem.live.link_loss import LONG_LOSS_SECONDS
from mavdem.live.margin_review import (
    FIRST_REVIEW_SECONDS,
    MAX_PROCESSOR_SHARE,
    PIECE_SECONDS,
    REVIEW_PERIOD,
    FlightMessages,
    MarginReview,
    ReviewedMargins,
    review_margins,
)
from mavdem.live.model_and_checks import lights_by_checks
from mavdem.live.model_judgement import JudgedModel
from mavdem.live.session_status import SessionStatus
from mavdem.live.vehicle_selection import Component
from mavdem.report.live import light_rows
from sitl_scenarios.files import scenario_from_table
from sitl_scenarios.simulation import fly

STEERED = {
    "seed": 1956,
    "duration": 42.0,
    "height": 2.0,
    "vehicle": {"model": "iris", "rate_gain": 4.0, "parameters": {"SCHED_LOOP_RATE": 200.0}},
    "excitation": {
        "kind": "multisine",
        "axis": "roll",
        "sd": 3.0,
        "lowest": 0.2,
        "highest": 5.0,
        "period": 10.0,
    },
    "stream": {"autopilot": "ardupilot", "rate": 50.0, "rates": {"ATTITUDE_TARGET": 50.0}},
}
"""A flight whose gains lack margin."""

VEHICLE = Component(1, 1)
FIRST = round(FIRST_REVIEW_SECONDS) + 1
"""Second after the first review of a flight that begins at 0."""

BAD = Fact(
    MarginsLight.LOOP_MARGINS,
    Level.BAD,
    subject="rate",
    axis="roll",
    rating=Level.BAD,
    lacking="phase_margin",
    phase_margin=27.0,
    phase_margin_interval=(21.0, 33.0),
    gain_margin=4.8,
    gain_margin_interval=(3.4, 6.4),
    ms=3.0,
    ms_interval=(2.5, 3.6),
    share=0.6,
    is_biased=False,
    reason=None,
    action=None,
)
REVIEWED = ReviewedMargins(BAD, processor_seconds=1.0)

DOUBTED = BAD.replace(Level.WATCH, rating=Level.WATCH)
"""Margins that warn, and are no alarm."""


class LaterExecutor(Executor):
    """Keeps jobs, whose results the test sets."""

    def __init__(self):
        self.jobs = []
        self.futures = []

    def submit(self, job, /, *arguments, **options):
        self.jobs.append(arguments)
        self.futures.append(Future())
        return self.futures[-1]


class ImmediateExecutor(Executor):
    """Runs jobs when they are submitted."""

    def submit(self, job, /, *arguments, **options):
        future = Future()
        future.set_result(job(*arguments, **options))
        return future


@fixture
def stream():
    """A vehicle in flight, with setpoints of its rate."""
    return Mock(
        is_flying=True, has_rate_setpoint=True, followed_vehicle=VEHICLE, parameters={"A": 1.0}
    )


@fixture
def review():
    """A review whose executor keeps the jobs, of a vehicle on the ground."""
    made = MarginReview(LaterExecutor(), "flight.tlog")
    on_ground = Mock(is_flying=False, has_rate_setpoint=False)
    made.update(0.0, on_ground, is_busy=False, is_recording_assessed=False)
    return made


def frames_of(*contents):
    return FrameReader().feed(b"".join(contents))


def update(review, stream, start, end, *, is_recording_assessed=False):
    """Calls the review once a second, and returns at which of these times it began to judge, s."""
    begin_times = []
    for now in range(start, end):
        count = len(review._executor.jobs)
        review.update(
            float(now), stream, is_busy=False, is_recording_assessed=is_recording_assessed
        )
        if len(review._executor.jobs) > count:
            begin_times.append(now)
    return begin_times


def fly_live(path):
    """Returns the margins in flight by the seconds of a log, and after it, each as it became known."""
    review = MarginReview(ImmediateExecutor(), path.name)
    live = LiveStream()
    lights = [None]
    first_stamp = None
    second = 0
    for stamp, content in read_stream(path).stamped_frames():
        first_stamp = first_stamp or stamp
        frames = live.frame_reader.feed(content)
        live.process_without_rows(stamp / 1e6, frames)
        review.add_messages(stamp / 1e6, frames, live.followed_vehicle, live.boot)
        if (stamp - first_stamp) / 1e6 >= second:
            second += 1
            review.update(float(second), live, is_busy=False, is_recording_assessed=False)
            if review.margins is not lights[-1]:
                lights.append(review.margins)
    for _ in range(40):
        second += 1
        review.update(float(second), live, is_busy=False, is_recording_assessed=False)
    return lights[1:], review.margins


@mark.in_full
@mark.usefixtures("coarse_physics", "without_alarms")
def test_margins_in_flight_are_those_of_the_review(tmp_path, monkeypatch):
    """A simulated flight is followed live and then reviewed, by the same rules."""
    # On a slow processor, too, reviews follow each other at their period, which is short for a short flight.
    monkeypatch.setattr(margin_review, "MAX_PROCESSOR_SHARE", inf)
    monkeypatch.setattr(margin_review, "REVIEW_PERIOD", 10.0)
    scenario = scenario_from_table(STEERED)
    path = tmp_path / "flight.tlog"
    write_log(path, scenario, fly(scenario))
    in_flight, after_landing = fly_live(path)
    reviewed = assess(read_log(path), None, "roll", Options(with_model=False)).lights[Light.MARGINS]
    assert in_flight, "the flight is reviewed before its landing"
    assert (after_landing.code, after_landing.level) == (reviewed.code, reviewed.level)
    assert reviewed.code is MarginsLight.LOOP_MARGINS
    opposite_level = {Level.BAD: Level.GOOD, Level.GOOD: Level.BAD}.get(reviewed.level)
    assert opposite_level not in [light.level for light in in_flight]
    for name in ("phase_margin", "gain_margin", "ms"):
        assert after_landing.figures[name] == approx(reviewed.figures[name], rel=0.02)
        low, high = in_flight[-1].figures[f"{name}_interval"]
        assert low <= reviewed.figures[name] <= high


@mark.slow
@mark.usefixtures("coarse_physics")
def test_margins_by_outputs_alone_wait_in_flight_for_setpoints_to_show_the_loops(tmp_path):
    scenario = scenario_from_table(STEERED | {"duration": 28.0})
    path = tmp_path / "flight.tlog"
    write_log(path, scenario, fly(scenario))
    lights = []
    for is_flying in (True, False):
        reviewed = review_margins(path.read_bytes(), "live", "1:1", {}, is_flying=is_flying)
        lights.append(reviewed.margins)
    awaited, given = lights
    assert awaited.code is MarginsLight.MARGINS_UNKNOWN
    assert awaited.figures["reason"].code is LoopFact.LOOP_TOO_SHORT
    assert 0.0 < awaited.figures["reason"].figures["settled"] < 20.0
    assert given.code is MarginsLight.LOOP_MARGINS, "a log will not be longer"


def test_a_flight_is_reviewed_at_its_period_and_once_after_the_landing(review, stream):
    executor = review._executor
    assert update(review, stream, 10, 60) == [10 + FIRST_REVIEW_SECONDS], "one at a time"
    executor.futures[0].set_result(REVIEWED)
    assert update(review, stream, 60, 62) == [61] and review.margins is BAD
    executor.futures[1].set_result(REVIEWED)
    stream.is_flying = False
    assert update(review, stream, 62, 120) == [61 + REVIEW_PERIOD]
    executor.futures[2].set_result(REVIEWED)
    assert update(review, stream, 120, 200) == [], "nothing new"
    _, source, vehicle, parameters = executor.jobs[0]
    assert (source, vehicle, parameters) == ("flight.tlog", "1:1", {"A": 1.0})


def test_a_warning_of_the_margins_counts_in_flight_once_two_reviews_in_a_row_give_it(
    review, stream
):
    good = DOUBTED.replace(Level.GOOD, rating=Level.GOOD)
    other_axis = DOUBTED.replace(axis="pitch")
    second = 0
    lights = []
    unknown = DOUBTED.replace(Level.UNKNOWN)
    judged_well = (good, DOUBTED, other_axis, good, unknown, good)
    for margins in (DOUBTED, *judged_well, DOUBTED, unknown, DOUBTED, good, BAD, DOUBTED):
        update(review, stream, second, second + 30)
        review._executor.futures[-1].set_result(ReviewedMargins(margins, 1.0))
        second += 30
        update(review, stream, second, second + 1)
        lights.append(review.margins)
    unconfirmed, *next_lights, again_unconfirmed = lights
    # Good margins stay while only one judgement gives something else; an alarm is not delayed.
    assert next_lights[:6] == [good, good, other_axis, good, good, good]
    # Two that give something else end good margins even if they differ.
    assert next_lights[6:] == [good, unknown, unconfirmed, good, BAD]
    assert again_unconfirmed == unconfirmed and unconfirmed.level is Level.UNKNOWN
    flying = SessionStatus(vehicle="1:1", is_flying=True, margins=unconfirmed)
    assert not flying.overall_judgement.headline.is_watch_or_bad
    assert ("margins", "judged once more") in [(row.name, row.figure) for row in light_rows(flying)]
    assert str(unconfirmed).startswith("Margins are judged once more")
    # No further review could confirm the last one, of the whole flight.
    stream.is_flying = False
    update(review, stream, second, second + 30)
    review._executor.futures[-1].set_result(ReviewedMargins(DOUBTED, 1.0))
    update(review, stream, second + 30, second + 31)
    assert review.margins is DOUBTED


def test_a_warning_by_a_model_alone_is_confirmed_by_the_next_model():
    executor = LaterExecutor()
    judging = ModelJudging(executor, "flight.tlog")
    lights = SessionStatus(vehicle="1:1", is_flying=True).overall_judgement.lights
    warning = Judgement(
        DOUBTED, Fact(NextStep.FLY_ON, reason=None), {**lights, Light.MARGINS: DOUBTED}
    )
    for is_confirmed in (False, True):
        judging._pending = Future()
        judging._pending.set_result(JudgedModel(Mock(), warning))
        judging.update(0.0, Mock(), Mock(), is_busy=False, has_rate_setpoint=False)
        assert (judging.judgement.headline is DOUBTED) is is_confirmed
        assert (judging.judgement.lights[Light.MARGINS] is DOUBTED) is is_confirmed


def test_the_settled_flight_that_margins_need_is_counted_between_two_reviews(review):
    short = Fact(LoopFact.LOOP_TOO_SHORT, least_duration=20.0, settled=5.0, clock=30.0)
    for now, settled_start, text in (
        (30.0, 25.0, "15 s to go."),
        (37.0, 25.0, "8 s to go."),
        # A climb has ended settled flight, which began again at 36 s.
        (37.0, None, "15 s to go: climb, landing and strong tilt do not count."),
        (39.0, 36.0, "12 s to go."),
        (46.0, 25.0, "they are being judged."),
    ):
        review.margins = Fact(MarginsLight.MARGINS_UNKNOWN, reason=short, rate=None)
        assert str(review.present_margins(now, settled_start)).endswith(text)
    # Of a refused log the settled flight is not known: that which goes on is counted.
    uncounted = short.replace(settled=None)
    review.margins = Fact(MarginsLight.MARGINS_UNKNOWN, reason=uncounted, rate=None)
    assert str(review.present_margins(37.0, 25.0)).endswith("8 s to go.")
    review.margins = BAD
    assert review.present_margins(46.0, 25.0) is BAD


def test_a_landed_flight_is_not_reviewed_if_its_recording_is_assessed(review, stream):
    assert update(review, stream, 10, 12) == []
    stream.is_flying = False
    assert update(review, stream, 12, 200, is_recording_assessed=True) == []
    assert update(review, stream, 200, 202) == [200]


def test_long_reviews_are_rarer(review, stream):
    review._executor.submit = Mock(side_effect=review._executor.submit)
    update(review, stream, 0, FIRST)
    seconds = 6.0
    review._executor.futures[0].set_result(ReviewedMargins(BAD, seconds))
    begin_times = FIRST_REVIEW_SECONDS + seconds / MAX_PROCESSOR_SHARE
    assert update(review, stream, FIRST, 200) == [begin_times]


def test_without_rate_setpoints_or_time_nothing_is_reviewed(review, stream):
    stream.has_rate_setpoint = False
    assert update(review, stream, 0, 40) == [] and not review.has_rate_setpoint
    stream.has_rate_setpoint = True
    review.update(40.0, stream, is_busy=True, is_recording_assessed=False)
    assert not review._executor.jobs
    stream.has_rate_setpoint = False
    assert update(review, stream, 41, 42) == [41], "setpoints that came are kept"
    assert review.has_rate_setpoint
    # To look for them again would take time in every second of a flight.
    del stream.has_rate_setpoint
    update(review, stream, 42, 43)


@mark.parametrize("error", [ValueError("no"), MemoryError(), KeyError("no")])
def test_a_failed_review_leaves_the_one_before(review, stream, error):
    update(review, stream, 0, FIRST)
    review._executor.futures[0].set_result(REVIEWED)
    second = FIRST + round(REVIEW_PERIOD)
    update(review, stream, FIRST, second)
    review._executor.futures[1].set_exception(error)
    assert update(review, stream, second, 90) == [FIRST_REVIEW_SECONDS + 2 * REVIEW_PERIOD]
    assert review.margins is BAD


def test_another_flight_begins_without_margins(review, stream):
    update(review, stream, 0, FIRST)
    review._executor.futures[0].set_result(REVIEWED)
    update(review, stream, FIRST, 45)
    stream.is_flying = False
    update(review, stream, 45, 50)
    stream.is_flying = True
    # The review of the flight before ends after the take-off.
    review._executor.futures[1].set_result(REVIEWED)
    assert update(review, stream, 50, 70) == [] and review.margins is None


def test_messages_of_the_vehicle_are_kept_that_show_its_loops():
    """Only messages of the vehicle that is followed are stored; before one is followed, those of all vehicles are."""
    messages = FlightMessages()
    frames_of_vehicle = [heartbeat(1), *flight([1.0, 1.01], system=1)]
    messages.add(
        1.7e9,
        frames_of(*frames_of_vehicle, heartbeat(2), *flight([1.0], system=2)),
        VEHICLE,
        boot=0,
    )
    (telemetry,) = tlog_from_bytes("live", messages.records).vehicles
    assert (telemetry.system, len(telemetry.messages["ATTITUDE"]["time"])) == (1, 2)
    before = FlightMessages()
    frames_of_both = frames_of(*frames_of_vehicle, heartbeat(2), *flight([1.0], system=2))
    before.add(1.7e9, frames_of_both, None, boot=0)
    assert len(tlog_from_bytes("live", before.records).vehicles) == 2, "nobody is followed yet"


def test_the_memory_is_bounded_and_begins_with_the_latest_take_off(monkeypatch):
    messages = FlightMessages()
    sizes = []
    for number in range(5):
        frames = frames_of(*flight([float(number)]))
        messages.add(1.7e9 + PIECE_SECONDS * number, frames, VEHICLE, boot=0)
        sizes.append(len(messages.records))
    messages.forget_earlier_flights()
    (telemetry,) = tlog_from_bytes("live", messages.records).vehicles
    assert len(telemetry.messages["ATTITUDE"]["time"]) == 2
    monkeypatch.setattr(margin_review, "MAX_BYTES", sizes[0] + 10)
    messages.add(1.7e9 + PIECE_SECONDS * 5, frames_of(*flight([5.0])), VEHICLE, boot=0)
    assert len(messages.records) == sizes[0], "the oldest are forgotten"


def test_messages_that_come_too_fast_are_bounded_too(monkeypatch):
    """All of them come within one ``PIECE_SECONDS``."""
    monkeypatch.setattr(margin_review, "MAX_BYTES", 2000)
    monkeypatch.setattr(margin_review, "MAX_PIECE_BYTES", 200)
    messages = FlightMessages()
    for number in range(100):
        frames = frames_of(*flight([0.01 * number]))
        messages.add(1.7e9 + 0.01 * number, frames, VEHICLE, boot=0)
    assert 1000 < len(messages.records) <= 2000
    (telemetry,) = tlog_from_bytes("live", messages.records).vehicles
    assert round(float(telemetry.messages["ATTITUDE"]["time"][-1]), 2) == 0.99


def test_messages_of_an_earlier_boot_are_forgotten_at_a_take_off():
    """Another vehicle may have sent them: its HEARTBEATs would name an autopilot that has other parameters."""
    messages = FlightMessages()
    messages.add(1.7e9, frames_of(heartbeat(autopilot=3), *flight([9.0, 9.01])), VEHICLE, boot=0)
    messages.add(1.7e9 + 1.0, frames_of(heartbeat(autopilot=12), *flight([0.5])), VEHICLE, boot=1)
    messages.forget_earlier_flights()
    (telemetry,) = tlog_from_bytes("live", messages.records).vehicles
    assert telemetry.autopilot == "PX4"
    assert telemetry.messages["ATTITUDE"]["time"].tolist() == [0.5]


def test_gains_that_came_before_the_kept_messages_are_used(monkeypatch):
    seen = []

    def assessed(log, *_):
        seen.append(dict(log.vehicles[0].parameters))
        return Mock(lights={Light.MARGINS: BAD}, evidence=Mock(loops={"roll": None}))

    monkeypatch.setattr(margin_review, "assess", assessed)
    messages = FlightMessages()
    messages.add(1.7e9, frames_of(heartbeat(1), *flight([1.0, 1.01])), VEHICLE, boot=0)
    gains = MappingProxyType({"ATC_RAT_RLL_P": 0.2})
    assert review_margins(messages.records, "live", "1:1", gains, is_flying=True).margins is BAD
    assert seen == [{"ATC_RAT_RLL_P": 0.2}]


def test_what_cannot_be_judged_has_no_margins_and_a_reason():
    light = review_margins(b"", "live", "1:1", {}, is_flying=True).margins
    assert light.code is MarginsLight.MARGINS_UNKNOWN and light.level is Level.UNKNOWN
    assert light.figures["reason"].code is SourceFact.FORMAT_UNKNOWN


def test_the_status_shows_margins_of_the_flight_until_the_recording_is_judged():
    """Margins that were computed in flight set the light of the margins, until the whole recording was judged."""
    flying = SessionStatus(vehicle="1:1", is_flying=True, margins=BAD)
    judgement = flying.overall_judgement
    assert judgement.lights[Light.MARGINS] is BAD and judgement.headline is BAD
    assert judgement.next_step.code is NextStep.LAND_SOON, "it has flown so since its take-off"
    assert ("margins", "roll 27° (21 to 33)") in [
        (row.name, row.figure) for row in light_rows(flying)
    ]
    withheld = Fact(
        MarginsLight.MARGINS_UNKNOWN, reason=Fact(LoopFact.NOT_STEERED, share=0.2), rate=None
    )
    unknown = SessionStatus(vehicle="1:1", is_flying=True, margins=withheld)
    assert unknown.overall_judgement.lights[Light.MARGINS] is withheld
    judged = SessionStatus(
        vehicle="1:1",
        margins=BAD,
        model_judgement=judgement,
        is_recording_judged=True,
    )
    assert lights_by_checks(judged).get(Light.MARGINS) is None


def test_margins_that_lack_since_the_take_off_make_no_short_silence_an_alarm():
    lost = Fact(LinkFact.CONNECTION_LOST, cause=None, reopening=False)
    for age, level in ((2.0, Level.WATCH), (LONG_LOSS_SECONDS, Level.BAD)):
        silent = SessionStatus(
            vehicle="1:1", is_flying=True, margins=BAD, no_model_reason=lost, message_age=age
        )
        headline = silent.overall_judgement.headline
        assert (headline.code, headline.level) == (LinkFact.LOST_IN_FLIGHT, level)
        assert headline.figures["cause"] is None
        assert silent.overall_judgement.lights[Light.MARGINS] is BAD
