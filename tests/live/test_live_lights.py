"""Lights and next step of a live session: each light has its own reason, and the step fits the moment."""

from dataclasses import replace

from pytest import fixture, mark

from mavdem.assessment.judgement import Judgement
from mavdem.dataset.segment_learnability import slow_streams
from mavdem.facts import Fact, Level
from mavdem.facts.assessment import Headline, NextStep
from mavdem.facts.lights import Light, Unjudged
from mavdem.facts.motors import MotorsLight
from mavdem.facts.power import PowerLight
from mavdem.facts.session import LinkFact, MissingMessages, RowsFact, SessionFact
from mavdem.facts.watch import WatchedQuantity, WatchFact
from mavdem.live.session_status import SessionStatus
from mavdem.live.vehicle_state import VehicleState
from mavdem.report.live import vehicle_text

RATES = {"ATTITUDE": 25.0, "SERVO_OUTPUT_RAW": 25.0}
SLOW = Fact(RowsFact.LIVE_RATES_TOO_LOW, can_ask=True, reason=slow_streams(RATES, "roll"))


def watch(kind, reason=None):
    code = WatchFact.NOT_WATCHED if reason else WatchFact.WATCHED
    return Fact(code, time=3.0, subject=kind, reason=reason)


@fixture
def slow():
    """The status of a flight whose rates are too low for a model; vibration does not come."""
    missing = Fact(WatchFact.MESSAGE_MISSING, name="VIBRATION", rate=None)
    facts = (
        watch(WatchedQuantity.OSCILLATION),
        watch(WatchedQuantity.MOTOR_LIMITS),
        watch(WatchedQuantity.MOTORS, Fact(SessionFact.NOT_SETTLED)),
        watch(WatchedQuantity.VIBRATION, missing),
        watch(WatchedQuantity.ESTIMATOR, missing.replace(name="EKF_STATUS_REPORT")),
    )
    return SessionStatus(
        vehicle="1:1", no_model_reason=SLOW, rates=RATES, is_flying=True, watch_facts=facts
    )


def test_each_light_has_its_own_reason(slow):
    lights = slow.overall_judgement.lights
    assert lights[Light.LOG].level is Level.WATCH
    assert lights[Light.MOTORS].code is WatchFact.NO_MOTOR_AT_LIMIT
    assert lights[Light.MARGINS].code is WatchFact.NO_OSCILLATION
    assert lights[Light.VIBRATION].figures["reason"].figures["name"] == "VIBRATION"
    assert lights[Light.ESTIMATOR].figures["reason"].figures["name"] == "EKF_STATUS_REPORT"
    sentences = [str(light) for light in lights.values()]
    assert sum("comes at 25 Hz" in sentence for sentence in sentences) == 1, "the log"


def test_the_tracking_waits_for_seconds_of_settled_flight(slow):
    watched = replace(slow, watch_facts=(*slow.watch_facts, watch(WatchedQuantity.TRACKING)))
    light = watched.overall_judgement.lights[Light.TRACKING]
    assert str(light) == "Not judged: it is known after 20 s of settled flight."


def test_a_model_does_not_hide_why_the_estimator_is_not_judged(slow):
    later = Fact(Unjudged.JUDGED_LATER, path="", reason=None)
    sound = Fact(Headline.NOTHING_CHECKED, reason=SLOW)
    lights = dict.fromkeys(map(str, Light), later)
    judged = replace(slow, no_model_reason=None, model_judgement=Judgement(sound, sound, lights))
    light = judged.overall_judgement.lights[Light.ESTIMATOR]
    assert str(light) == "Not judged in flight: no EKF_STATUS_REPORT comes."
    assert str(judged.overall_judgement.lights[Light.MOTORS]) == "Not judged in flight."


def test_without_a_light_the_headline_is_that_nothing_has_alarmed(slow):
    headline = slow.overall_judgement.headline
    assert str(headline) == str(SLOW)
    power = {Light.POWER: Fact(Unjudged.NOT_JUDGED, reason=None)}
    checked = replace(slow, worst_lights=power).overall_judgement.headline
    assert str(checked) == "No alarm so far; oscillation and motor limits are watched."


def test_rates_that_suffice_are_a_good_log(slow):
    fast = replace(slow, no_model_reason=None, rates=dict.fromkeys(RATES, 100.0))
    assert fast.overall_judgement.lights[Light.LOG].is_good


def test_the_rate_shown_is_that_of_the_messages_that_rows_are_made_of(slow):
    rates = {"ATTITUDE": 100.0, "SERVO_OUTPUT_RAW": 99.0, "ATTITUDE_QUATERNION": 25.0}
    assert replace(slow, rates=rates).row_rate == 99.0
    assert SessionStatus().row_rate == 0.0


def test_the_next_step_fits_the_moment(slow):
    learning = replace(slow, no_model_reason=None)
    assert "Fly on" in str(learning.overall_judgement.next_step)
    weak = Fact(MotorsLight.MOTOR_LIMITED, Level.WATCH, subject="motor 1", share=0.9)
    watched = replace(learning, worst_lights={Light.MOTORS: weak})
    advice = str(watched.overall_judgement.next_step)
    assert advice.startswith("Fly on. After landing: ") and advice.endswith(".")
    landing = replace(watched, state=VehicleState("Land", lands_by_itself=True))
    assert str(landing.overall_judgement.next_step).startswith("Let it land. After landing: ")
    sound = replace(landing, worst_lights={})
    assert str(sound.overall_judgement.next_step) == "Let it land."
    bad = replace(learning, worst_lights={Light.MOTORS: weak.replace(Level.BAD)})
    assert bad.overall_judgement.next_step.code is NextStep.LAND_NOW
    over = replace(bad, is_over=True)
    assert over.overall_judgement.next_step.code is NextStep.DO_AS_ADVISED


def test_nobody_is_told_to_fly_on_by_alarms_that_come_late(slow):
    learning = replace(slow, no_model_reason=None, analysis_delay=15.2)
    assert learning.overall_judgement.next_step.sentence.startswith(
        "Watch the vehicle itself: alarms come 15 s late."
    )
    weak = Fact(MotorsLight.MOTOR_LIMITED, Level.WATCH, subject="motor 1", share=0.9)
    watched = replace(learning, worst_lights={Light.MOTORS: weak})
    assert watched.overall_judgement.next_step.code is NextStep.FLY_BY_SIGHT
    landed = replace(learning, is_flying=False)
    assert landed.overall_judgement.next_step.code is not NextStep.FLY_BY_SIGHT


@mark.parametrize(
    "silence",
    [
        Fact(LinkFact.CONNECTION_LOST, cause=None, reopening=False),
        Fact(RowsFact.NOTHING_RECEIVED, subject=MissingMessages.MESSAGES, duration=3.0),
    ],
)
def test_in_flight_a_silent_link_is_what_to_look_after(slow, silence):
    judged = slow.overall_judgement
    silent = replace(slow, no_model_reason=silence, model_judgement=judged).overall_judgement
    assert silent.headline == silence
    assert silent.next_step.figures["reason"] == silence


def test_once_the_session_is_over_a_silent_link_is_not_what_the_flight_showed(slow):
    silence = Fact(RowsFact.NOTHING_RECEIVED, subject=MissingMessages.MESSAGES, duration=3.0)
    power = {Light.POWER: Fact(PowerLight.BATTERY_HELD, Level.GOOD)}
    over = replace(slow, no_model_reason=silence, is_flying=False, is_over=True, worst_lights=power)
    judgement = over.overall_judgement
    assert judgement.headline.code is Headline.NOTHING_WRONG
    assert judgement.next_step.figures.get("reason") != silence


def test_the_first_line_says_mode_arming_battery_and_the_age_of_the_last_message(slow):
    state = VehicleState("Loiter", is_armed=True, voltage=15.84, charge=76.0)
    text = vehicle_text(replace(slow, state=state, message_age=4.2))
    assert text == "1:1, mode Loiter, in flight, battery 15.8 V (76 %), last message 4 s ago."
    assert vehicle_text(SessionStatus()) == "No vehicle, nothing received yet."
