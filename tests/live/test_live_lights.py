"""Lights and next step of a live session: each light has its own reason, and the step fits the moment."""

import re
from dataclasses import replace

import numpy as np
from pytest import fixture, mark

from mavdem.assessment.flight_verdict import FlightVerdict
from mavdem.assessment.judgement import Judgement, unjudged
from mavdem.assessment.lights import VEHICLE_LIGHTS
from mavdem.assessment.next_step import choose_next_step
from mavdem.dataset.segment_learnability import slow_streams
from mavdem.facts import Fact, Level
from mavdem.facts.assessment import Headline, NextStep, Override
from mavdem.facts.ending import Ending, MotionEvent
from mavdem.facts.event import Event
from mavdem.facts.lights import Light, Unjudged
from mavdem.facts.log import LogLight
from mavdem.facts.loops import LoopAction, LoopFact
from mavdem.facts.margins import MarginsLight, TrackingLight
from mavdem.facts.motors import MotorsLight, MotorWatchFact, TrimFact
from mavdem.facts.power import PowerLight
from mavdem.facts.session import (
    LinkFact,
    MissingMessages,
    RecordingState,
    RowsFact,
    SessionFact,
)
from mavdem.facts.vibration import VibrationLight
from mavdem.facts.watch import WatchedQuantity, WatchFact
from mavdem.live.global_position import GlobalPosition
from mavdem.live.lights_after_landing import reason_for_no_model
from mavdem.live.recent_messages import RecentMessages
from mavdem.live.session_state import Latency
from mavdem.live.session_status import SessionStatus
from mavdem.live.silence import SilenceMonitor
from mavdem.live.takeoff_place import Displacement
from mavdem.live.tracking_watch import TrackingWatch
from mavdem.live.vehicle_state import VehicleState
from mavdem.live.wind import WindEstimate
from mavdem.motors.motor_changes import CauseProbabilities, MotorChange, SuspectedMotor
from mavdem.report.live import (
    brief_light_figures,
    headline_and_next_step,
    headline_reason,
    light_rows,
    live_alarm,
    recorded_light_figures,
    statement_of_headline,
    status_line_text,
    vehicle_text,
)
from mavdem.report.templates import headline, render_section

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
    assert str(light) == "Not judged: no EKF_STATUS_REPORT comes."
    assert str(judged.overall_judgement.lights[Light.MOTORS]) == "Not judged in flight."


def test_without_a_light_the_headline_is_that_nothing_has_alarmed(slow):
    headline = slow.overall_judgement.headline
    assert str(headline) == str(SLOW)
    assert headline_and_next_step(slow.overall_judgement)[0] == (
        "Messages come too slowly: 25 of 40 Hz."
    )
    power = {Light.POWER: Fact(Unjudged.NOT_JUDGED, reason=None)}
    checked = replace(slow, worst_lights=power).overall_judgement.headline
    assert str(checked) == "No alarm now in what is watched: oscillation and motor limits."


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
    landed = replace(bad, is_over=True, is_flying=False).overall_judgement
    assert landed.next_step.code is NextStep.DO_AS_ADVISED
    in_land_mode = replace(bad, state=VehicleState("Land", lands_by_itself=True))
    assert str(in_land_mode.overall_judgement.next_step) == "Let it land."
    returning = replace(bad, state=VehicleState("RTL", lands_by_itself=True))
    assert str(returning.overall_judgement.next_step) == "Land now."
    # A session that has ended in flight asks for the landing first.
    in_flight = replace(bad, is_over=True).overall_judgement
    assert str(in_flight.next_step).startswith("Land now. After landing: ")
    for status, step in (
        (sound, "Land by sight."),
        (watched, "Land by sight. After landing: "),
    ):
        ended = replace(status, is_over=True, state=None).overall_judgement
        assert str(ended.next_step).startswith(step)
        # What would have made the model better in this flight is out of date.
        assert "Fly on" not in str(ended.next_step)
    # A hover is no step of a vehicle on the ground.
    hover = Fact(NextStep.DO_AS_ADVISED, reason=Fact(TrimFact.TRIM_UNKNOWN, least_duration=15.0))
    hover_step = "Land by sight. In the next flight: Hover for 15 s or longer without turning."
    assert str(Fact(NextStep.LAND_BY_SIGHT, reason=hover)) == hover_step


def test_a_session_that_ends_far_behind_does_not_say_that_the_link_was_lost_in_flight(slow):
    """The vehicle may have landed, and been switched off, in the messages that were not analysed."""
    silent = Fact(RowsFact.NOTHING_RECEIVED, subject="messages", duration=3.0)
    unread = Fact(SessionFact.RECORDING_NOT_JUDGED, kind=RecordingState.READ_AT_NEXT_START)
    behind = replace(
        slow, no_model_reason=silent, message_age=9.0, analysis_delay=12.0, recording_verdict=unread
    )
    assert behind.link_loss is not None, (
        "while it goes on, a pilot must know of the silence at once"
    )
    ended = replace(behind, is_over=True)
    assert ended.link_loss is None
    assert str(ended.overall_judgement.headline).startswith(
        "This session ended with its last 12 s not analysed, in flight until then"
    )


def test_a_session_that_ends_in_flight_puts_the_landing_before_the_repair_of_an_earlier_fault(slow):
    weak = Fact(
        MotorWatchFact.MOTOR_LOST_THRUST, Level.BAD, subject="motor 1", loss=(0.2, 0.4), time=9.0
    )
    repair = Fact(NextStep.DO_AS_ADVISED, reason=weak)
    first = FlightVerdict(1, replace(unjudged(weak), next_step=repair))
    ended = replace(slow, no_model_reason=None, is_over=True, flight_number=2, verdicts=(first,))
    judgement = ended.session_judgement
    assert judgement.headline.is_bad
    assert str(judgement.headline).startswith(
        "This session ended in flight: no alarm comes any more; before that: flight 1: motor 1"
    )
    assert str(judgement.next_step).startswith("Land by sight. After landing: Do not fly before")
    assert ended.unrepaired_fault is None, "the headline states it"
    landed = replace(ended, is_flying=False)
    assert landed.session_judgement.headline == first.fact


def test_a_server_that_ends_in_flight_leaves_no_light_good(slow):
    unread = Fact(SessionFact.RECORDING_NOT_JUDGED, kind=RecordingState.READ_AT_NEXT_START)
    battery = {Light.POWER: Fact(PowerLight.BATTERY_HELD, Level.GOOD)}
    left = replace(slow, is_over=True, worst_lights=battery, recording_verdict=unread)
    judgement = left.overall_judgement
    assert judgement.headline.is_bad
    assert str(judgement.next_step).startswith("Land by sight.")
    assert not any(light.is_good for light in judgement.lights.values())
    landed = replace(left, is_flying=False, flight_number=1).overall_judgement
    assert landed.lights[Light.POWER].is_good


def test_a_hover_comes_before_movements_of_the_sticks(slow):
    """The watch of the thrust needs it, while the model, which movements improve, is already being learned."""
    short = Fact(WatchFact.REFERENCE_SHORT, duration=8.0, remaining_duration=5.0)
    facts = (*slow.watch_facts, watch(WatchedQuantity.MOTORS, short))
    learning = replace(slow, no_model_reason=None, watch_facts=facts)
    assert str(learning.overall_judgement.next_step) == (
        "Hover: whether a motor loses thrust is not watched yet."
    )
    # As long as it is awaited, it is not 0 s.
    soon = watch(WatchedQuantity.MOTORS, short.replace(remaining_duration=0.2))
    soon_watched = replace(learning, watch_facts=(*slow.watch_facts, soon))
    assert brief_light_figures(soon_watched)[Light.MOTORS] == "hover 1 s more"
    # Nothing is asked of a vehicle that lands by itself.
    landing = replace(soon_watched, state=VehicleState("Land", lands_by_itself=True))
    assert brief_light_figures(landing)[Light.MOTORS] == "thrust not watched"


def test_nobody_is_told_to_fly_on_by_alarms_that_come_late(slow):
    learning = replace(slow, no_model_reason=None, analysis_delay=15.2)
    assert learning.overall_judgement.next_step.sentence.startswith(
        "Watch the vehicle itself: alarms come up to 15 s late."
    )
    weak = Fact(MotorsLight.MOTOR_LIMITED, Level.WATCH, subject="motor 1", share=0.9)
    watched = replace(learning, worst_lights={Light.MOTORS: weak})
    assert watched.overall_judgement.next_step.code is NextStep.FLY_BY_SIGHT
    landed = replace(learning, is_flying=False)
    assert landed.overall_judgement.next_step.code is not NextStep.FLY_BY_SIGHT


def test_alarms_that_come_late_are_the_headline_and_leave_no_light_good(slow):
    battery = {Light.POWER: Fact(PowerLight.BATTERY_HELD, Level.GOOD)}
    late = replace(slow, no_model_reason=None, analysis_delay=4.0, worst_lights=battery)
    judgement = late.overall_judgement
    assert str(judgement.headline).startswith("This computer is up to 4 s behind the vehicle: ")
    assert judgement.headline.level is Level.WATCH
    assert not any(light.is_good for light in judgement.lights.values())
    assert replace(late, analysis_delay=31.0).overall_judgement.headline.is_bad
    assert replace(late, analysis_delay=1.2).overall_judgement.lights[Light.POWER].is_good
    # Just after the analysis has caught up, the judgement is still the same, unless the session is over.
    caught_up = replace(late, analysis_delay=0.0, held_alarm_delay=4.0)
    assert caught_up.overall_judgement == judgement
    assert replace(caught_up, is_over=True).delay_fact is None
    weak = Fact(MotorsLight.MOTOR_LIMITED, Level.BAD, subject="motor 1", share=0.9)
    alarmed = replace(late, active_alarms=(weak,), worst_lights={Light.MOTORS: weak})
    assert alarmed.overall_judgement.headline == weak


@mark.slow
def test_an_all_clear_after_a_landing_waits_for_the_recording(slow):
    battery = {Light.POWER: Fact(PowerLight.BATTERY_HELD, Level.GOOD)}
    awaited = Fact(SessionFact.RECORDING_NOT_JUDGED, kind=RecordingState.BEING_READ)
    flown = replace(slow, no_model_reason=None, rates={}, flight_number=1, worst_lights=battery)
    landed = replace(flown, is_flying=False, recording_verdict=awaited)
    judgement = landed.overall_judgement
    assert judgement.headline == awaited and judgement.headline.level is Level.UNKNOWN
    assert str(judgement.next_step) == "Wait for the result before the next flight."
    # No advice on gains by the margins in flight, which the recording may contradict.
    assert judgement.lights[Light.MARGINS].figures["reason"] == awaited
    assert not judgement.lights[Light.MARGINS].remedy
    # What is only to be watched so far is no verdict, and has no advice of its own.
    low = Fact(PowerLight.BATTERY_LOW, Level.WATCH, voltage=13.2, cells=4, voltage_limit=13.6)
    watched = replace(landed, worst_lights={Light.POWER: low}).overall_judgement
    assert watched.headline.level is Level.WATCH
    assert str(watched.headline).startswith(
        "Not judged yet: the log is being read. So far: battery"
    )
    assert watched.next_step == judgement.next_step
    # A bad fault that was found in flight stays the headline, until the recording is judged.
    weak = Fact(MotorsLight.MOTOR_LIMITED, Level.BAD, subject="motor 1", share=0.9)
    warned = replace(landed, worst_lights={Light.MOTORS: weak})
    assert warned.overall_judgement.headline == weak
    # Small margins, which the flight had from its beginning, are judged by the recording: no gains change yet.
    margins = Fact(MarginsLight.LOOP_MARGINS, Level.BAD, reason=None)
    unsteady = replace(landed, margins=margins, worst_lights={}).overall_judgement
    assert unsteady.headline.is_bad and unsteady.headline.figures["so_far"] == margins
    assert unsteady.next_step == judgement.next_step
    levels = dict.fromkeys(Light, "good") | {Light.POWER: "watch", Light.MOTORS: "unknown"}
    judged = Fact(
        SessionFact.RECORDING_JUDGED,
        Level.WATCH,
        headline="Too little margin.",
        next_step="Lower the gains.",
        levels=levels,
        light_sentences={Light.POWER: "The battery sagged to 3.1 V."},
    )
    by_recording = replace(warned, recording_verdict=judged).overall_judgement
    assert by_recording.headline == judged and str(by_recording.next_step) == "Lower the gains."
    # No light contradicts the recording, and what that leaves unknown stays as it was found in flight.
    assert by_recording.lights[Light.POWER].level is Level.WATCH
    assert str(by_recording.lights[Light.POWER]) == "The battery sagged to 3.1 V."
    # A figure of the recording is as short as one in flight; without one its sentence stands there.
    figures = {"light_figures": {Light.POWER: "down to 3.1 V"}}
    for verdict, text in (
        (judged, "the battery sagged to 3.1 V"),
        (judged.replace(**figures), "down to 3.1 V"),
    ):
        rows = light_rows(replace(warned, recording_verdict=verdict))
        assert text in [row.figure for row in rows]
    assert by_recording.lights[Light.MOTORS] == weak
    # What was good in flight or to be watched is unknown as in the library, and the verdict that counts it is the same.
    # The light states what was good in flight, and why the recording shows less.
    unknown = "Too little of the hover was recorded."
    unsure = judged.replace(
        Level.UNKNOWN,
        headline="Too little was checked: power and others were checked; motors unknown.",
        levels=levels | {Light.POWER: "good", Light.MARGINS: "unknown"},
        light_sentences={Light.MOTORS: unknown},
    )
    even = Fact(MotorWatchFact.NO_LOSS_FOUND, clock=63.0)
    withdrawn = (
        "Good in flight: no motor has lost thrust since 63 s, when the watch of its balance began. "
        f"The recording does not confirm it. {unknown}"
    )
    # Before the recording is judged, a loss from before the watch began may be there.
    unjudged = replace(landed, worst_lights={Light.MOTORS: even}).overall_judgement
    assert unjudged.lights[Light.MOTORS].level is Level.UNKNOWN
    for light_in_flight, text in ((even, withdrawn), (weak.replace(Level.WATCH), unknown)):
        unlike = replace(landed, worst_lights={Light.MOTORS: light_in_flight})
        shown = replace(unlike, recording_verdict=unsure)
        motors = shown.overall_judgement.lights[Light.MOTORS]
        assert motors.level is Level.UNKNOWN and str(motors) == text
        assert shown.overall_judgement.headline == unsure
        if light_in_flight == even:
            assert brief_light_figures(shown)[Light.MOTORS] == "good in flight only"
    assert replace(flown, recording_verdict=awaited).overall_judgement.headline != awaited


@mark.parametrize(
    "message, unknown",
    [
        ("VIBRATION", Fact(VibrationLight.VIBRATION_UNKNOWN, recorder="")),
        (
            "ATTITUDE_TARGET",
            Fact(TrackingLight.TRACKING_UNKNOWN, recorder="", axis="roll", asked=False),
        ),
    ],
)
def test_a_recording_does_not_advise_to_ask_for_what_was_asked_for_in_vain(slow, message, unknown):
    step = unknown.remedy
    assert message in step
    figures = {"levels": dict.fromkeys(map(str, Light), "good"), "light_sentences": {}}
    judged = Fact(
        SessionFact.RECORDING_JUDGED, Level.GOOD, headline="Sound.", next_step=step, **figures
    )
    flown = replace(slow, is_flying=False, flight_number=1, recording_verdict=judged)
    assert str(flown.overall_judgement.next_step) == step
    asked = replace(flown, absent_messages=frozenset({message}))
    # The step is that of the light, also in the line of the verdict.
    part = "vibration" if message == "VIBRATION" else "tracking"
    judgement = asked.overall_judgement
    assert str(judgement.next_step) == f"Look for the {part} in the autopilot's own log."
    assert judgement.headline.sentence_and_remedy == f"Sound. {judgement.next_step}"


def test_a_flight_whose_link_was_lost_for_a_while_is_not_called_sound_afterwards(slow):
    monitor = SilenceMonitor()
    outages = []
    for silence, is_flying in ((0.0, True), (15.0, True), (0.0, False), (60.0, False), (0.0, True)):
        monitor.note_outage(silence, is_flying=is_flying)
        outages.append(monitor.outage)
    assert outages == [None, 15.0, 15.0, 15.0, None], "it is kept until the next take-off"
    lights = dict.fromkeys(VEHICLE_LIGHTS, Fact(LogLight.RECORDED_FAST, Level.GOOD))
    landed = SessionStatus("1:1", flight_number=1, worst_lights=lights, link_outage=15.0)
    judged = Fact(
        SessionFact.RECORDING_JUDGED,
        Level.GOOD,
        headline="Nothing wrong found: power was checked.",
        next_step="Keep this log.",
        levels=dict.fromkeys(Light, "good"),
        light_sentences={},
    )
    for verdict, statement in (
        (None, "Nothing wrong found but the link, lost for 15 s in flight: motors"),
        (judged, "The link was lost for 15 s in flight. Nothing wrong found: power was checked."),
    ):
        judgement = replace(landed, recording_verdict=verdict).overall_judgement
        assert str(judgement.headline).startswith(statement)
        assert judgement.headline.level is judgement.lights[Light.LOG].level is Level.WATCH
        assert "antennas" in str(judgement.next_step)
    assert judgement.headline.remedy == str(judgement.next_step), "its line in the list, too"
    assert "link lost 15 s" in [row.figure for row in light_rows(landed)]
    # That too little was checked has other reasons than the link.
    few = replace(landed, worst_lights={Light.POWER: lights[Light.POWER]}).overall_judgement
    verdict = "Too little was checked to call it sound, and the link was lost for 15 s: power"
    assert str(few.headline).startswith(verdict)
    # A fault of the vehicle stays the headline, with its own next step.
    fault = judged.replace(Level.BAD, headline="Motor 3 is weak.", next_step="Inspect motor 3.")
    judgement = replace(landed, recording_verdict=fault).overall_judgement
    assert judgement.headline == fault and str(judgement.next_step) == "Inspect motor 3."
    assert judgement.lights[Light.LOG].code is LinkFact.WAS_LOST_IN_FLIGHT


def test_no_all_clear_returns_where_the_recording_could_not_be_read(slow):
    failed = Fact(SessionFact.RECORDING_NOT_JUDGED, kind=RecordingState.FAILED, path="a b.tlog")
    battery = {Light.POWER: Fact(PowerLight.BATTERY_HELD, Level.GOOD)}
    flown = replace(slow, is_flying=False, flight_number=1, worst_lights=battery)
    judgement = replace(flown, recording_verdict=failed).overall_judgement
    assert judgement.headline == failed and not judgement.headline.is_good
    assert str(judgement.next_step) == "Judge it later: `mavdem 'a b.tlog'`."


def test_before_an_oscillation_can_show_nothing_says_that_there_is_none(slow):
    awaited = Fact(WatchFact.OSCILLATION_AWAITED, duration=4.4)
    facts = (watch(WatchedQuantity.OSCILLATION, awaited), *slow.watch_facts[1:])
    just_flying = replace(slow, no_model_reason=None, rates={}, watch_facts=facts)
    judgement = just_flying.overall_judgement
    assert judgement.next_step.code is NextStep.HOVER_FIRST
    assert judgement.lights[Light.MARGINS].figures["reason"] == awaited
    texts = [row.figure for row in light_rows(just_flying)]
    assert "after 4 s of flight" in texts and "no oscillation" not in texts
    weak = Fact(MotorsLight.MOTOR_LIMITED, Level.WATCH, subject="motor 1", share=0.9)
    warned = replace(just_flying, worst_lights={Light.MOTORS: weak}).overall_judgement
    assert str(warned.next_step).startswith("Hover: whether the vehicle oscillates")


def test_the_state_of_a_vehicle_that_crashed_has_its_last_position(slow):
    state = VehicleState("Loiter", is_armed=False, voltage=15.84)
    crashed = replace(
        slow,
        is_flying=False,
        state=state,
        message_age=9.0,
        loss=Fact(Ending.CONTROL_LOST, Level.BAD, time=22.1),
        last_position=GlobalPosition(47.3977421, -8.5455938, 20.4, 1e9),
    )
    assert "disarmed, last position 47.39774, -8.54559" in vehicle_text(crashed, has_table=True)
    assert "position" not in vehicle_text(replace(crashed, loss=None))


def test_after_a_short_flight_no_light_says_that_the_vehicle_is_on_the_ground(slow):
    ground = Fact(WatchFact.ON_GROUND_NOW)
    facts = tuple(watch(fact.subject, ground) for fact in slow.watch_facts)
    landed = replace(
        slow,
        is_flying=False,
        flight_number=1,
        watch_facts=facts,
        learned_rows=9,
        no_model_reason=Fact(SessionFact.NOT_FLYING),
        rates={},
    )
    judgement = landed.overall_judgement
    assert str(judgement.headline) == (
        "The vehicle could not be judged: the settled flight was too short."
    )
    assert str(judgement.lights[Light.MOTORS]) == "Not judged: the settled flight was too short."
    before = replace(landed, flight_number=0).overall_judgement
    assert str(before.lights[Light.MOTORS]) == "Not judged: the vehicle is on the ground."
    # Where this computer had no time to learn, the flight may have been long enough.
    late = replace(landed, postponed_rows=900, is_recorded=True)
    too_slow = "this computer was too slow; the recording can still be judged."
    assert str(late.overall_judgement.headline) == f"The vehicle could not be judged: {too_slow}"
    assert str(late.overall_judgement.lights[Light.MARGINS]) == f"Not judged: {too_slow}"
    assert brief_light_figures(late)[Light.MARGINS] == "computer too slow"


def test_a_flight_of_which_nothing_was_checked_has_a_verdict_of_its_own():
    for code in (SessionFact.NOT_SETTLED, SessionFact.FLIGHT_OVER):
        over = SessionStatus(flight_number=1, no_model_reason=Fact(code, reason=None))
        judgement = over.overall_judgement
        assert judgement.headline.code is Headline.NOTHING_CHECKED
        assert "too short" in str(judgement.headline)
        assert str(over.verdict.judgement.headline).lower().count("not judged") == 0


def test_after_a_flight_no_light_waits_for_more_of_it(slow):
    short = Fact(LoopFact.LOOP_TOO_SHORT, least_duration=20.0, settled=2.0, clock=13.0)
    landed = replace(
        slow,
        is_flying=False,
        flight_number=1,
        no_model_reason=Fact(RowsFact.NOTHING_RECEIVED, subject="messages", duration=3.0),
        margins=Fact(MarginsLight.MARGINS_UNKNOWN, rate=None, reason=short),
        worst_lights={Light.LOG: Fact(LogLight.RECORDED_WITH_GAPS, Level.WATCH)},
    )
    figures = {row.name: row.figure for row in light_rows(landed)}
    assert figures["margins"] == "flight too short"
    assert figures["tracking"] == "not in this flight"
    assert "again" not in str(landed.overall_judgement.lights[Light.MARGINS])


@mark.parametrize(
    "reviewed, figure, code",
    [
        (2.0, "computer too slow", SessionFact.TOO_SLOW_TO_JUDGE),
        (30.0, "flight too short", LoopFact.LOOP_TOO_SHORT),
    ],
)
def test_a_flight_that_was_long_enough_for_margins_was_not_too_short(slow, reviewed, figure, code):
    """The computer did not review it again; a review of all of it found gaps, which no other one would fill."""
    short = Fact(LoopFact.LOOP_TOO_SHORT, least_duration=20.0, settled=reviewed, clock=13.0)
    margins = Fact(MarginsLight.MARGINS_UNKNOWN, rate=None, reason=short)
    landed = replace(
        slow,
        is_flying=False,
        flight_number=1,
        settled_seconds=45.0,
        learned_rows=4000,
        margins=margins,
    )
    assert {row.name: row.figure for row in light_rows(landed)}["margins"] == figure
    assert landed.overall_judgement.lights[Light.MARGINS].figures["reason"].code is code
    landing = replace(landed, is_flying=True, state=VehicleState("Land", lands_by_itself=True))
    assert {row.name: row.figure for row in light_rows(landing)}["margins"] == "being judged"
    assert reason_for_no_model(replace(landed, margins=None)).code is SessionFact.TOO_SLOW_TO_JUDGE


def test_a_voltage_that_is_not_judged_is_as_old_as_the_silence_of_the_link(slow):
    unmeasured = Fact(PowerLight.POWER_UNMEASURED, voltage=12.6, airborne=True, is_constant=True)
    lost = replace(
        slow,
        state=VehicleState(voltage=12.6),
        no_model_reason=Fact(RowsFact.NOTHING_RECEIVED, subject="messages", duration=3.0),
        message_age=14.0,
        worst_lights={Light.POWER: unmeasured},
    )
    figures = {row.name: row.figure for row in light_rows(lost)}
    assert figures["power"] == "12.6 V 14 s ago"
    assert str(lost.overall_judgement.lights[Light.POWER]).startswith("14 s ago: nothing measures")


def test_each_state_of_motors_and_log_has_its_detail_on_the_terminal(slow):
    sinking = Fact(WatchFact.SINKS_AT_LIMIT, Level.BAD, subject="", names=(), share=1.0, speed=2.0)
    two = Fact(MotorsLight.MOTOR_LIMITED, subject="", names=("motor 1", "motor 2"), share=0.9)
    gaps = Fact(LogLight.RECORDED_WITH_GAPS, Level.WATCH)
    uneven = Fact(
        TrimFact.TRIM_OF_SEVERAL,
        names=(),
        shift=(0.0, 0.0, 0.1),
        worst="",
        deviation=0.12,
        half=0.02,
    )
    for light, fact, text in (
        (Light.MOTORS, sinking, "all motors at the limit"),
        (Light.MOTORS, two, "2 motors at the limit"),
        (Light.MOTORS, two.replace(names=("motor 1 (front right)",)), "motor 1 at the limit"),
        (Light.MOTORS, uneven, "uneven trim"),
        (Light.LOG, gaps, "gaps"),
    ):
        status = replace(slow, no_model_reason=None, rates={}, worst_lights={light: fact})
        assert text in [row.figure for row in light_rows(status)]


def test_lights_of_a_recording_have_figures_of_their_own(slow):
    sagged = Fact(PowerLight.BATTERY_HELD, voltage=11.17)
    slowly = Fact(LogLight.RECORDED_SLOWLY, rate=4.0, motor_rate=10.0)
    lights = {**slow.overall_judgement.lights, Light.POWER: sagged, Light.LOG: slowly}
    swing = Fact(MotionEvent.ATTITUDE_SWUNG, Level.BAD, time=33.0, angle_error=0.6)
    # A wind that is known only roughly is good where the vehicle leans little: the figure says so.
    wind = WindEstimate(time=3.0, velocity=np.array([0.0, -5.4]), band=np.full(2, 2.9)).light
    blew = wind.replace(Level.GOOD, share=0.31)
    figures = recorded_light_figures(lights | {Light.TRACKING: swing, Light.WIND: blew})
    assert figures.keys() == set(Light)
    assert figures["wind"] == "mean 2.5–8.3 m/s 90°, lean 31 % of limit"
    assert (figures["power"], figures["log"]) == ("down to 11.2 V", "4.0 Hz")
    assert figures["tracking"] == "at 33.0 s"


def test_each_light_of_a_flight_has_a_figure_or_says_what_it_lacks(slow):
    figures = {row.name: row.figure for row in light_rows(slow)}
    assert figures.keys() == set(Light)
    assert figures["vibration"] == "no VIBRATION" and figures["estimator"] == "no EKF_STATUS_REPORT"
    assert figures["wind"] == "after 6 to 9 s" and figures["log"] == "25 Hz"
    fast = light_rows(replace(slow, no_model_reason=None, rates=dict.fromkeys(RATES, 100.0)))
    assert fast[-1].figure == "100 Hz"
    # What is watched from the take-off on is judged later: that is no contradiction.
    watched = replace(slow, worst_lights={}, watch_facts=(watch(WatchedQuantity.VIBRATION),))
    figures = {row.name: row.figure for row in light_rows(watched)}
    assert figures["vibration"] == "alarm on, level in settled flight"


def test_what_shows_a_fault_stands_below_its_short_headline():
    lost = Fact(
        MotorWatchFact.MOTOR_LOST_THRUST,
        Level.BAD,
        subject="motor 3",
        time=47.0,
        end_time=None,
        loss=(0.18, 0.41),
        probability=0.97,
        rise=0.26,
        boot=0,
        assumed=False,
    )
    # A sentence that only repeats the headline is no reason.
    assert headline_reason(Judgement(Fact(SessionFact.ALARM, reason=lost), lost, {})) == []
    assert headline_reason(Judgement(SLOW.replace(Level.UNKNOWN), SLOW, {})) == []
    # The headline leaves out the other battery, and says already why.
    other = Fact(
        PowerLight.BATTERY_HELD,
        voltage=11.4,
        cells=3,
        subject="battery 1",
        current=None,
        resistance=None,
        end_time=None,
    )
    empty = Fact(PowerLight.CHARGE_LOW, Level.BAD, share=0.0, share_limit=0.07, batteries=(other,))
    assert headline_reason(Judgement(empty, empty, {})) == []


def test_the_last_line_has_the_present_delay_and_none_of_earlier_estimates(slow):
    keeps_up = replace(slow, latency=Latency(median=0.1, p99=4.06, longest=5.5))
    late = replace(keeps_up, analysis_delay=1.1)
    lines = [
        render_section("live_status", status=status, time=0.0)[0].text
        for status in (keeps_up, late)
    ]
    assert "late" not in lines[0] and lines[1].endswith(" Hz; 1.1 s late.")


def test_nobody_is_told_in_flight_to_start_mavdem_with_another_option(slow):
    step = slow.overall_judgement.next_step
    assert step.code is NextStep.FLY_ON and "--request-rate" in str(step)


def test_the_wind_is_that_of_now_only_while_the_vehicle_is_received_in_time(slow):
    wind = WindEstimate(time=3.0, velocity=np.zeros(2), band=np.ones(2))
    blowing = replace(slow, wind=wind, message_age=0.2)
    assert blowing.present_wind is wind
    # Its light states the same wind as the table of lights, the map and the line; the mean follows in the verdict.
    present = replace(wind, velocity=np.array([0.0, -3.0]))
    mean = replace(wind, velocity=np.array([3.0, 4.0]), band=2 * np.ones(2))
    windy = replace(blowing, wind=present, mean_wind=mean)
    stated = str(windy.overall_judgement.lights[Light.WIND])
    assert stated.startswith("Wind 3.0 m/s (2.0 to 4.0) from E (90°)") and "Mean" not in stated
    assert "; wind now 2–4 m/s 90°;" in status_line_text(windy)
    landed = str(replace(windy, is_flying=False).overall_judgement.lights[Light.WIND])
    assert landed.startswith("Mean wind")
    for change in ({"message_age": 29.0}, {"analysis_delay": 5.0}, {"is_flying": False}):
        assert replace(blowing, **change).present_wind is None


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
    assert silent.headline.code is LinkFact.LOST_IN_FLIGHT
    assert silent.headline.figures["reason"] == silence
    assert silent.next_step.figures["reason"] == silent.headline


@fixture
def silent():
    """The status of a vehicle that was sound in flight, 4 s after its last message."""
    sound = {
        Light.MOTORS: Fact(MotorWatchFact.NO_LOSS_FOUND, Level.GOOD, clock=63.0),
        Light.POWER: Fact(PowerLight.BATTERY_HELD, Level.GOOD),
    }
    return SessionStatus(
        "1:1",
        no_model_reason=Fact(
            RowsFact.NOTHING_RECEIVED, subject=MissingMessages.MESSAGES, duration=3.0
        ),
        is_flying=True,
        state=VehicleState("Loiter", is_armed=True, voltage=15.84),
        displacement=Displacement(distance=34.0, height=12.0),
        message_age=4.2,
        motion_age=4.2,
        worst_lights=sound,
    )


def test_a_link_lost_in_flight_says_for_how_long_where_the_vehicle_was_and_what_to_do(silent):
    judgement = silent.overall_judgement
    assert judgement.headline.level is Level.WATCH
    assert str(judgement.headline) == (
        "Link lost 4 s ago, in flight: last 12 m above the take-off, 34 m from it, battery 15.8 V; "
        "no latitude and longitude received in this flight."
    )
    assert str(judgement.next_step).startswith(
        "Watch the vehicle itself: no alarm can come while the link is lost. Check"
    )
    long = replace(silent, message_age=12.0)
    assert long.overall_judgement.headline.is_bad
    assert str(long.overall_judgement.next_step).startswith(
        "Land by sight: no alarm can come while the link is lost."
    )
    assert long.alarms == (long.link_loss,) and silent.alarms == () == long.further_alarms
    over = replace(long, is_over=True, last_reception=1e9).overall_judgement.headline
    assert re.match(r"Link lost at \d\d:\d\d:\d\d, in flight", str(over))
    position = GlobalPosition(47.3977421, -8.5455938, 20.4, 1e9)
    placed = str(replace(silent, last_position=position).link_loss)
    assert re.search(r"15\.8 V; last position 47\.39774, -8\.54559 at \d\d:\d\d:\d\d\.$", placed)
    # Where the take-off was not seen, the height is that above the home position.
    unseen = str(replace(silent, last_position=position, displacement=None).link_loss)
    assert ", in flight: last position 47.39774, -8.54559, 20 m above home, at " in unseen
    # A position as new as the link's last message has no time of its own.
    timed = replace(silent, last_position=position, last_reception=1e9 + 0.5)
    assert str(timed.link_loss).endswith("; last position 47.39774, -8.54559.")
    # What came before the silence may not have been read: the vehicle may have landed in it.
    behind = replace(timed, analysis_delay=17.2)
    assert str(behind.link_loss).startswith(
        "No message for 4 s, and this computer still reads the 13 s before: last 12 m above"
    )
    still_reading = replace(behind, message_age=12.0)
    assert still_reading.alarms == () and live_alarm(still_reading) == ""
    advice = str(still_reading.overall_judgement.next_step)
    assert advice == "Watch the vehicle itself: alarms come late."
    assert replace(still_reading, analysis_delay=0.0).alarms, "all is read, and the link is lost"
    landed = replace(long, is_flying=False)
    assert landed.link_loss is None and landed.overall_judgement.lights[Light.MOTORS].is_good


def test_no_light_is_good_while_a_flying_vehicle_is_silent(silent):
    lights = silent.overall_judgement.lights
    assert not any(light.is_good for light in lights.values())
    assert str(lights[Light.MOTORS]).startswith("Not known for 4 s; before that good: no motor ")
    [motors, *_] = light_rows(silent)
    assert motors.level is Level.UNKNOWN and motors.figure == "good 4 s ago"
    # What the messages showed before the silence counts too, such as their rate; an analysis that is late knows less.
    before = replace(silent, no_model_reason=None, rates=dict.fromkeys(RATES, 100.0))
    late = replace(silent, status_before_silence=before, analysis_delay=40.0)
    assert {row.name: row.figure for row in light_rows(late)}["log"] == "good 40 s ago"
    # A message that never came, not the silence, is why a light was unknown.
    missing = Fact(WatchFact.MESSAGE_MISSING, name="ESTIMATOR_STATUS", rate=None)
    without = replace(before, watch_facts=(watch(WatchedQuantity.ESTIMATOR, missing),))
    shown = light_rows(replace(silent, worst_lights={}, status_before_silence=without))
    assert {row.name: row.figure for row in shown}["estimator"] == "no ESTIMATOR_STATUS"
    mean_wind = WindEstimate(time=3.0, velocity=np.array([3.0, 4.0]), band=np.ones(2))
    windy = replace(silent, mean_wind=mean_wind)
    [wind] = [row for row in light_rows(windy) if row.name == Light.WIND]
    assert wind.level is Level.UNKNOWN and wind.figure == "known 4 s ago"
    # A wind that was not known before is not called so.
    rough_wind = WindEstimate(time=3.0, velocity=np.array([1.0, 2.0]), band=2 * np.ones(2))
    doubtful = replace(silent, mean_wind=rough_wind)
    [wind] = [row for row in light_rows(doubtful) if row.name == Light.WIND]
    assert wind.figure == "not known"
    stated = str(doubtful.overall_judgement.lights[Light.WIND])
    assert stated.startswith("4 s ago: ") and "ot known for" not in stated
    # Messages of the battery still come where only those of the motion do not.
    motion = Fact(RowsFact.NOTHING_RECEIVED, subject=MissingMessages.MOTION, duration=3.0)
    still = replace(silent, no_model_reason=motion, message_age=0.1).overall_judgement
    assert still.lights[Light.POWER].is_good and not still.lights[Light.MOTORS].is_good
    assert str(still.headline).startswith("No attitude and no motor outputs for 4 s, in flight: ")


def test_an_alarm_before_a_lost_link_is_in_its_headline_and_decides_what_to_do(silent):
    weak = Fact(
        MotorWatchFact.MOTOR_LOST_THRUST, Level.BAD, subject="motor 1", loss=(0.09, 0.26), time=9.0
    )
    alarmed = replace(silent, active_alarms=(weak,), worst_lights={Light.MOTORS: weak})
    judgement = alarmed.overall_judgement
    assert judgement.headline.is_bad and judgement.headline.figures["cause"] == weak
    assert judgement.next_step == Fact(NextStep.LAND_NOW, reason=judgement.headline)
    # An alarm that was over before says so behind its fault.
    ended = Fact(WatchFact.ALARM_OVER, Level.BAD, time=44.0, reason=weak)
    for text in (str, headline):
        sentence = text(judgement.headline.replace(cause=ended))
        assert re.search("before that[,:] motor 1 .* [(]over since 44 s[)]", sentence)
    # The age of the link comes first: what was advised before may be out of date.
    assert live_alarm(alarmed) == "⚠ Link lost 4 s ago, in flight; before that: Motor 1: land now"
    assert live_alarm(silent) == "⚠ Link lost 4 s ago, in flight"
    # While older messages are read, only what they have shown is an alarm.
    reading = replace(alarmed, analysis_delay=40.0)
    assert reading.overall_judgement.headline == weak and reading.alarms == (weak,)
    assert live_alarm(reading) == "⚠ Motor 1: land now"
    over = replace(alarmed, is_over=True).overall_judgement
    assert over.headline.figures["cause"] == weak
    assert str(over.next_step) == (
        "If it still flies, land by sight; otherwise search where it was last. "
        "Do not fly before motor 1, its propeller, connector and controller are inspected."
    )
    assert judgement.lights[Light.MOTORS] == weak and alarmed.further_alarms == ()
    # A vehicle that is lost is not missed.
    crashed = Fact(Ending.CRASHED, time=50.0, height=0.0, speed=5.0, cause=None, mode="", word=None)
    assert replace(alarmed, loss=crashed).overall_judgement.headline == crashed


def test_once_the_session_is_over_a_silent_link_is_not_what_the_flight_showed(slow):
    silence = Fact(RowsFact.NOTHING_RECEIVED, subject=MissingMessages.MESSAGES, duration=3.0)
    power = {Light.POWER: Fact(PowerLight.BATTERY_HELD, Level.GOOD)}
    over = replace(slow, no_model_reason=silence, is_flying=False, is_over=True, worst_lights=power)
    judgement = over.overall_judgement
    assert judgement.headline.code is Headline.NOTHING_WRONG
    assert judgement.next_step.figures.get("reason") != silence


def test_after_a_flight_whose_rates_were_too_low_that_is_still_what_to_change(slow):
    silence = Fact(RowsFact.NOTHING_RECEIVED, subject=MissingMessages.MESSAGES, duration=3.0)
    power = {Light.POWER: Fact(PowerLight.BATTERY_HELD, Level.GOOD)}
    landed = replace(slow, no_model_reason=silence, is_flying=False, worst_lights=power, rates={})
    assert landed.overall_judgement.lights[Light.LOG].level is Level.UNKNOWN
    judgement = replace(landed, shortfall=SLOW).overall_judgement
    assert judgement.lights[Light.LOG] == SLOW.figures["reason"].replace(Level.WATCH)
    assert judgement.next_step.figures["reason"] == judgement.lights[Light.LOG]


def test_the_first_line_says_mode_arming_battery_and_the_age_of_the_last_message(slow):
    state = VehicleState("Loiter", is_armed=True, voltage=15.84, charge=76.0)
    text = vehicle_text(replace(slow, state=state, message_age=4.2))
    assert text == "1:1, mode Loiter, in flight, battery 15.8 V (76 %), last message 4 s ago."
    second = replace(slow, state=state._replace(battery="battery 2"))
    assert "in flight, battery 2 15.8 V (76 %)" in vehicle_text(second)
    assert vehicle_text(SessionStatus()) == "Waiting for a vehicle; nothing received yet."


def test_while_the_vehicle_oscillates_motors_and_tracking_are_not_called_sound():
    oscillation = Fact(
        MarginsLight.OSCILLATES,
        Level.BAD,
        subject="roll",
        axes=(("roll", 16.0, 2.0), ("pitch", 16.0, 2.0)),
        frequency=16.0,
        turn_rate=2.0,
    )
    lights = {
        Light.MARGINS: oscillation,
        Light.MOTORS: Fact(MotorWatchFact.NO_LOSS_FOUND, clock=10.0),
        Light.TRACKING: Fact(TrackingLight.FOLLOWS_SETPOINT, Level.GOOD),
    }
    status = SessionStatus(
        "1:1",
        is_flying=True,
        worst_lights=lights,
        active_alarms=(oscillation,),
        no_model_reason=SLOW,
    )
    for name in (Light.MOTORS, Light.TRACKING):
        light = status.overall_judgement.lights[name]
        assert light.level is Level.UNKNOWN and light.figures["reason"] == oscillation
        # Once that is over, what was judged before counts again.
        calm = replace(status, active_alarms=())
        assert calm.overall_judgement.lights[name].is_good
    # A loss from before the watch began shows in the headroom, which is judged with the first model.
    awaited = replace(status, active_alarms=(), no_model_reason=None)
    assert awaited.overall_judgement.lights[Light.MOTORS].level is Level.UNKNOWN
    [motors] = [row for row in light_rows(status) if row.name == Light.MOTORS]
    assert motors.figure == "it oscillates"
    assert live_alarm(status) == "⚠ Roll and pitch: land now"


def test_an_oscillation_stays_first_after_the_landing_before_the_motor_limits_that_it_caused():
    """Motors at their limits by the model are its consequence; a loss of the vehicle comes before both."""
    oscillation = Fact(
        MarginsLight.OSCILLATES,
        Level.BAD,
        subject="roll",
        axes=(("roll", 16.0, 2.0),),
        frequency=16.0,
        turn_rate=2.0,
    )
    saturation = Fact(Override.SATURATION, Level.BAD, subject="motor 1", share=0.2)
    by_model = replace(unjudged(saturation), headline=saturation)
    limited = Fact(MotorsLight.MOTOR_LIMITED, Level.BAD, subject="motor 1", share=0.2)
    landed = SessionStatus(
        "1:1",
        flight_number=1,
        is_over=True,
        worst_lights={Light.MARGINS: oscillation, Light.MOTORS: limited},
    )
    for is_recording_judged in (False, True):
        for judgement in (None, by_model):
            status = replace(
                landed, model_judgement=judgement, is_recording_judged=is_recording_judged
            )
            shown = status.overall_judgement
            assert shown.headline == oscillation
            assert shown.next_step == choose_next_step(oscillation, shown.lights)
    lost = replace(landed, model_judgement=by_model, loss=Fact(Ending.CONTROL_LOST, Level.BAD))
    assert lost.overall_judgement.headline.code is Ending.CONTROL_LOST


def test_a_small_margin_that_the_recording_shows_is_no_alarm():
    margin = Fact(MarginsLight.LOOP_MARGINS, Level.BAD)
    decision = Fact(LoopAction.LOOPS_JUDGED, Level.BAD, reason=margin)
    oscillation = Fact(MarginsLight.OSCILLATES, Level.BAD)
    assert not Event(60.0, margin).is_alarm and not Event(60.0, decision).is_alarm
    assert Event(60.0, oscillation).is_alarm


def test_a_flight_is_called_sound_in_the_air_only_once_all_is_judged():
    """All is good but the margins, which take longer; after the landing that is enough to be called sound."""
    good = Fact(LogLight.RECORDED_FAST, Level.GOOD)
    waiting = Fact(
        MarginsLight.MARGINS_UNKNOWN,
        reason=Fact(LoopFact.LOOP_TOO_SHORT, least_duration=20.0, settled=8.0, clock=31.0),
        rate=None,
    )
    lights = dict.fromkeys(VEHICLE_LIGHTS, good) | {Light.MARGINS: waiting}
    flying = SessionStatus("1:1", is_flying=True, worst_lights=lights)
    headline = flying.overall_judgement.headline
    assert headline.level is Level.UNKNOWN
    statement = statement_of_headline(str(headline), headline)
    assert statement == "No alarm now, but margins and wind are not judged."
    [margins] = [row for row in light_rows(flying) if row.name == Light.MARGINS]
    assert margins.figure == "12 s more settled"
    long_enough = waiting.replace(reason=waiting.figures["reason"].replace(settled=21.0))
    for change, text in (
        ({"worst_lights": lights | {Light.MARGINS: long_enough}}, "being judged"),
        ({"state": VehicleState("Land", lands_by_itself=True)}, "flight too short"),
    ):
        rows = light_rows(replace(flying, **change))
        assert [row.figure for row in rows if row.name == Light.MARGINS] == [text]
    assert str(waiting) == "Margins take 20 s of settled flight without gaps, 12 s to go."
    judged = replace(flying, worst_lights=dict.fromkeys(VEHICLE_LIGHTS, good))
    assert judged.overall_judgement.headline.is_good
    assert replace(flying, is_flying=False).overall_judgement.headline.is_good


def test_a_vehicle_whose_motors_have_just_stopped_is_not_called_sound():
    """A disarming in the air is found a moment later, and so is a vehicle that topples over."""
    lights = dict.fromkeys(VEHICLE_LIGHTS, Fact(LogLight.RECORDED_FAST, Level.GOOD))
    stopped = SessionStatus("1:1", flight_number=1, has_landed=False, worst_lights=lights)
    judgement = stopped.overall_judgement
    assert judgement.headline.code is WatchFact.MOTORS_JUST_STOPPED
    assert judgement.headline.level is Level.UNKNOWN and str(judgement.next_step) == "Keep clear."
    landed = replace(
        stopped,
        has_landed=True,
        state=VehicleState("Land", is_armed=True),
        is_armed_since_landing=True,
    )
    assert str(landed.overall_judgement.next_step) == "Disarm it.", "it may still topple over"
    just_landed = replace(landed, landing_time=60.0, boot_clock=62.0)
    assert str(just_landed.overall_judgement.next_step) == "Keep clear: it may disarm itself."
    long_landed = replace(just_landed, boot_clock=71.0)
    assert str(long_landed.overall_judgement.next_step) == "Disarm it."
    rearmed = replace(landed, is_armed_since_landing=False)
    assert rearmed.overall_judgement.headline.is_good, "it is about to begin another flight"
    disarmed = replace(landed, state=VehicleState("Land", is_armed=False))
    assert disarmed.overall_judgement.headline.is_good


def test_what_to_do_against_an_event_ends_with_the_event():
    """The height estimate diverged from 23 s to 28 s; afterwards the throttle need not be taken any more."""
    diverged = Fact(MotionEvent.HEIGHT_DIVERGED, time=23.0, climb_rate=-1.6, speed=4.9, cause=None)
    lasting = SessionStatus(
        "1:1",
        is_flying=True,
        worst_lights={Light.ESTIMATOR: diverged},
        active_alarms=(diverged,),
    )
    assert lasting.overall_judgement.next_step.code is NextStep.LAND_NOW
    over = diverged.replace(end_time=28.0)
    past = replace(lasting, worst_lights={Light.ESTIMATOR: over}, active_alarms=())
    assert past.overall_judgement.headline == over
    assert past.overall_judgement.next_step.code is NextStep.LAND_SOON
    shaken = Fact(VibrationLight.VIBRATION_MEASURED, Level.BAD)
    assert replace(past, active_alarms=(shaken,)).overall_judgement.headline == shaken


def test_the_next_step_names_what_nothing_measures(slow):
    """Neither VIBRATION nor messages of the estimator come, and the voltage of the battery never changes."""
    constant = Fact(WatchFact.BATTERY_NOT_JUDGED, cause="", is_constant=True)
    battery = watch(WatchedQuantity.BATTERY, constant)
    measured = [fact for fact in slow.watch_facts if fact.code is WatchFact.WATCHED]
    assert len(measured) < len(slow.watch_facts)
    for watch_facts, step in (
        (
            (*slow.watch_facts, battery),
            "Fly on only if you can do without a watch on vibration, battery and estimator: nothing measures them.",
        ),
        (
            (*measured, battery),
            "Fly on only if you can do without a watch on battery: nothing measures it.",
        ),
        (tuple(measured), "Fly on."),
    ):
        reason = Fact(SessionFact.NOT_SETTLED)
        status = replace(slow, no_model_reason=reason, watch_facts=watch_facts)
        assert str(status.overall_judgement.next_step) == step
        if "only if" in step:
            # It stays while a model is learned, and comes before what that needs.
            learning = replace(status, no_model_reason=None)
            assert str(learning.overall_judgement.next_step) == step
            too_slow = str(replace(status, no_model_reason=SLOW).overall_judgement.next_step)
            assert too_slow.startswith(f"{step} After landing: ")


def test_a_light_whose_reason_has_no_short_form_has_its_first_clause(slow):
    constant = Fact(WatchFact.BATTERY_NOT_JUDGED, cause="", is_constant=True)
    light = Fact(Unjudged.NOT_JUDGED, reason=constant)
    status = replace(slow, worst_lights={Light.ESTIMATOR: light})
    figures = {row.name: row.figure for row in light_rows(status)}
    assert figures["estimator"] == "nothing measures it"


def test_the_error_of_a_good_tracking_is_shown_with_the_delay_that_it_leaves_out(slow):
    """The terminal has 21 characters for it."""
    figures = {"axis": "roll", "angle_error": np.radians(0.46), "rate_error": None}
    for delay, figure in ((0.12, "0.46°, 0.12 s late"), (None, "roll to 0.46° (RMS)")):
        follows = Fact(TrackingLight.FOLLOWS_SETPOINT, Level.GOOD, delay=delay, **figures)
        status = replace(slow, worst_lights={Light.TRACKING: follows})
        assert brief_light_figures(status)[Light.TRACKING] == figure


def test_the_lights_of_a_judged_recording_take_the_place_of_those_in_flight():
    unknown = Fact(Unjudged.NOT_JUDGED, reason=Fact(SessionFact.NOT_SETTLED))
    judged = unjudged(unknown)
    lights = {**judged.lights, Light.MOTORS: unknown}
    good = Fact(MotorWatchFact.NO_LOSS_FOUND, clock=63.0)
    status = SessionStatus(
        model_judgement=replace(judged, lights=lights), worst_lights={Light.MOTORS: good}
    )
    assert status.overall_judgement.lights[Light.MOTORS] == good
    recorded = replace(status, is_recording_judged=True)
    # What was good in flight is unknown where the recording shows too little, and the light says so.
    assert recorded.overall_judgement.lights[Light.MOTORS] == Fact(
        SessionFact.GOOD_IN_FLIGHT_ALONE, in_flight=good, reason=unknown
    )
    near_limit = Fact(MotorsLight.MOTOR_LIMITED, Level.WATCH, subject="motor 1", share=0.1)
    flown = replace(recorded, worst_lights={Light.MOTORS: near_limit})
    assert flown.overall_judgement.lights[Light.MOTORS] == unknown
    # A fault in flight is not taken back, and what the recording shows counts.
    weak = Fact(MotorsLight.MOTOR_LIMITED, Level.BAD, subject="motor 1", share=0.9)
    warned = replace(recorded, worst_lights={Light.MOTORS: weak})
    assert warned.overall_judgement.lights[Light.MOTORS] == weak
    # Where the recording judges the part, also as good, its judgement counts, as in the library.
    sound = replace(judged, lights={**lights, Light.MOTORS: good})
    by_log = replace(warned, model_judgement=sound)
    assert by_log.overall_judgement.lights[Light.MOTORS] == good
    even = replace(judged, lights={**lights, Light.MOTORS: weak})
    shown = replace(recorded, model_judgement=even)
    assert shown.overall_judgement.lights[Light.MOTORS] == weak


def test_gains_are_advised_by_a_command_that_names_the_recording():
    named = Fact(LoopAction.LOAD_ADVISED_GAINS, arguments=("flight.tlog",))
    assert str(named) == "Load the gains that `mavdem tune flight.tlog --axis all` advises."
    unnamed = Fact(LoopAction.LOAD_ADVISED_GAINS, arguments=())
    assert str(unnamed) == (
        "Load the gains that `mavdem tune RECORDING --axis all` advises after landing."
    )


def test_the_table_has_every_light_with_its_figure(slow):
    """Each light has a row with its level and its most important figure, such as the voltage of the battery."""
    state = VehicleState("Loiter", is_armed=True, voltage=15.84, charge=76.0)
    vibration = Fact(
        VibrationLight.VIBRATION_MEASURED, Level.GOOD, subject="IMU 1", vibration=7.42, clips=0
    )
    weak = Fact(
        MotorWatchFact.MOTOR_LOST_THRUST,
        Level.BAD,
        subject="motor 2 (rear left)",
        loss=(0.09, 0.26),
    )
    status = replace(
        slow, state=state, worst_lights={Light.VIBRATION: vibration, Light.MOTORS: weak}
    )
    rows = {row.name: row for row in light_rows(status)}
    assert [*rows] == [str(light) for light in Light]
    assert rows["power"].figure == "15.8 V (76 %)"
    assert rows["vibration"].level is Level.GOOD and rows["vibration"].figure == "7.4 m/s²"
    assert rows["motors"].figure == "motor 2: −9 to −26 %"
    assert rows["margins"].figure == "no oscillation"
    # A time on the boot clock, and no duration.
    watched = Fact(MotorWatchFact.NO_LOSS_FOUND, clock=63.0)
    [motors, *_] = light_rows(replace(status, worst_lights={Light.MOTORS: watched}))
    assert motors.figure == "no new loss of thrust"
    # The rates are too low for a model.
    assert rows["log"].level is Level.WATCH and rows["log"].figure == "25 Hz"
    # Once the link is silent, what warns is still that the attitude came too slowly, and not that there was none.
    for message_age, figure in ((0.5, "no attitude"), (20.0, "too slow")):
        quiet = light_rows(replace(status, rates={}, message_age=message_age))
        assert next(row.figure for row in quiet if row.name == "log") == figure
    # A loss that the trim suggests has its mean first: it is no interval, and stays out of the table.
    trim = Fact(
        TrimFact.TRIM_OF_ONE_MOTOR, Level.WATCH, subject="motor 2 (rear left)", loss=(0.2, 0.1, 0.3)
    )
    rows = {row.name: row for row in light_rows(replace(status, worst_lights={Light.MOTORS: trim}))}
    assert rows["motors"].figure == "motor 2"


def test_the_time_in_flight_is_in_the_first_line(slow):
    state = VehicleState("Loiter", is_armed=True, voltage=15.84)
    flying = replace(
        slow,
        state=state,
        message_age=0.2,
        flight_seconds=754.9,
        position=(3.0, 20.4, -12.0),
        takeoff_position=(3.0, 0.0, -1.7),
    )
    # The table below has the battery, and a message that is less than a second old needs no words.
    assert "last message" not in vehicle_text(flying)
    assert vehicle_text(flying, has_table=True) == (
        "1:1, Loiter, in flight for 12:34 min, 10 m above the take-off, 20 m from it."
    )
    assert "in flight for 12:34 min, 20 m from the take-off" in vehicle_text(flying)
    # Whether a silent vehicle flies on is not known.
    assert "in flight, last heard 12:34 min after take-off, " in vehicle_text(
        replace(flying, message_age=29.0)
    )
    # A console that was left open does not count seconds for ever.
    assert vehicle_text(replace(flying, message_age=2039.0)).endswith("last message 33:59 min ago.")


def test_the_light_of_the_tracking_says_which_message_and_rate_it_lacks(slow):
    """Without setpoints the attitude error is unknown, and with them it is judged after 20 s of settled flight."""
    missing = Fact(WatchFact.MESSAGE_MISSING, name="ATTITUDE_TARGET", rate=None, needed_rate=8.0)
    status = replace(
        slow, watch_facts=(*slow.watch_facts, watch(WatchedQuantity.TRACKING, missing))
    )
    rows = {row.name: row for row in light_rows(status)}
    assert rows["tracking"].figure == "no ATTITUDE_TARGET"
    light = status.overall_judgement.lights[Light.TRACKING]
    assert str(light) == "Not judged: no ATTITUDE_TARGET comes; 8 Hz of it are needed."
    awaited = Fact(WatchFact.TRACKING_AWAITED, duration=20.0)
    status = replace(
        slow, watch_facts=(*slow.watch_facts, watch(WatchedQuantity.TRACKING, awaited))
    )
    rows = {row.name: row for row in light_rows(status)}
    assert rows["tracking"].figure == "after 20 s settled"
    landing = replace(status, state=VehicleState("RTL", lands_by_itself=True))
    assert brief_light_figures(landing)[Light.TRACKING] == "not judged"
    counted = watch(WatchedQuantity.TRACKING, awaited.replace(remaining_duration=11.2))
    rows = {row.name: row for row in light_rows(replace(slow, watch_facts=(counted,)))}
    assert rows["tracking"].figure == "12 s more settled"
    # The count does not begin again once the settled flight is complete.
    complete = watch(WatchedQuantity.TRACKING, awaited.replace(remaining_duration=0.0))
    rows = {row.name: row for row in light_rows(replace(slow, watch_facts=(complete,)))}
    assert rows["tracking"].figure == "being judged"
    tracking = TrackingWatch(RecentMessages())
    assert (
        tracking.remaining_seconds(30.0, 5.0) == 0.0 and tracking.remaining_seconds(9.0, 5.0) == 16
    )
    assert tracking.remaining_seconds(30.0, None) is None


def test_a_lasting_shift_of_the_trims_warns_in_flight_and_names_the_suspected_motor():
    """A change of roll and pitch trims is watched, whoever caused it; a probable motor is a reason to land soon."""
    causes = CauseProbabilities(
        load=0.09, motor=0.9, likeliest_motor=2, likeliest_motor_probability=0.9
    )
    shift = MotorChange(40.0, 26.0, None, "", 0.03, 0.99, cause_probabilities=causes)
    suspect = SuspectedMotor("motor 3 (front left)", probability=0.9, rise=0.09)
    even = {Light.MOTORS: Fact(WatchFact.NO_MOTOR_AT_LIMIT, reason=None)}
    flying = SessionStatus(
        "1:1",
        is_flying=True,
        flight_number=1,
        worst_lights=even,
        motor_alarms_of_flight=(shift._replace(suspect=suspect),),
    )
    judgement = flying.overall_judgement
    assert judgement.lights[Light.MOTORS] == judgement.headline
    assert judgement.headline.level is Level.WATCH
    assert (
        "probably motor 3 (front left) lost thrust (probability 0.90), since its command rose by 9 %"
        in str(judgement.headline)
    )
    advice = "heck motor 3 (front left), its propeller and arm, then what the vehicle carries, before the next flight."
    assert str(judgement.next_step) == f"Land soon. After landing: C{advice}"
    landed = replace(flying, is_flying=False).overall_judgement
    assert str(landed.next_step) == f"C{advice}"
    assert landed.headline == judgement.headline
    # Where no motor is probable enough, none is named.
    unnamed = replace(flying, motor_alarms_of_flight=(shift,)).overall_judgement
    assert unnamed.headline.level is Level.WATCH
    assert unnamed.next_step.code is NextStep.FLY_ON
