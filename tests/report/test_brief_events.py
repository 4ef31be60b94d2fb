"""The short list of events: what is bad first, and each kind once."""

from dataclasses import replace

from mavdem.assessment.axis.loop_decision import LoopDecision, LoopDiagnosis
from mavdem.assessment.judgement import unjudged
from mavdem.facts import Fact, Level
from mavdem.facts.assessment import NextStep
from mavdem.facts.ending import Ending, FailedFirst, MotionEvent
from mavdem.facts.event import Event
from mavdem.facts.events import ReportedEvent
from mavdem.facts.loops import LoopFact
from mavdem.facts.motors import MotorWatchFact
from mavdem.facts.online import SurpriseCause
from mavdem.facts.session import LinkFact, MissingMessages, RowsFact, SessionFact
from mavdem.facts.witnesses import SensorFact
from mavdem.live.history import LiveHistory
from mavdem.live.link_loss import link_loss_fact
from mavdem.report.brief_events import (
    StatedEvents,
    count_text,
    short_list,
    stated_events,
    worst_events,
)
from mavdem.report.pages.event_list import numbered_events
from mavdem.report.pages.live_event_list import numbered_live_events
from mavdem.report.pages.page import MAX_NEWEST_EVENTS, Head, PageEvent
from mavdem.report.review import _lines_of_event
from mavdem.report.tuning.decisions import decision_sentences
from mavdem.witnesses.sensor_facts import supporting_fact

TURNED = (supporting_fact(SensorFact.ROTATED, time=31.0, body_rate=5.0),)
CLIPS = [
    Fact(MotionEvent.CLIPPED, time=time, end_time=time + 1.0, count=9, boot=0)
    for time in (5.0, 12.0, 19.0, 26.0)
]
LEFT = Fact(MotionEvent.ATTITUDE_LOST, time=30.0, angle=2.0, boot=0, witnesses=TURNED)
LOST = Fact(
    Ending.CONTROL_LOST, time=30.0, height=None, cause=None, word=None, boot=0, witnesses=TURNED
)
HIT = Fact(MotionEvent.HIT, Level.WATCH, time=33.0, boot=0, witnesses=TURNED)
EVENTS = (*CLIPS, LEFT, LOST, HIT)


def test_bad_events_come_first_and_those_of_a_kind_once():
    assert worst_events(EVENTS) == [(5, 1), (6, 1), (0, 4)]
    page_events = [PageEvent(Event(event.time, event)) for event in EVENTS]
    brief = [event.brief for event in Head(Level.BAD, {}, page_events).brief_events]
    assert brief[0] == ("An accelerometer clipped 9 times from 5.0 to 6.0 s (longest of 4).")
    assert brief[1] == "Lost control."
    assert len(brief) == 3 and "hit the ground" in brief[2]


def test_what_happened_in_flight_comes_before_what_is_reported_on_the_ground():
    restarted = Fact(ReportedEvent.RESTARTED, time=1.0, boot=0)
    failed = Fact(ReportedEvent.SENSOR_FAILED, Level.WATCH, time=2.0, boot=0)
    events = (restarted, failed, *CLIPS, HIT)
    assert [events[index] for index, _ in worst_events(events)] == [
        HIT,
        failed,
        CLIPS[0],
        restarted,
    ]


def test_a_saturated_motor_is_listed_once():
    subject = "motor 4"
    at_limit = Fact(MotionEvent.MOTOR_AT_ITS_STOP, Level.WATCH, subject=subject, time=9.0)
    saturated = Fact(MotorWatchFact.MOTOR_SATURATED, Level.BAD, subject=subject, time=9.0)
    assert worst_events((at_limit, saturated)) == [(1, 1)]
    assert worst_events((at_limit.replace(time=3.0), saturated)) == [(1, 1), (0, 1)]


def test_the_longest_event_of_a_kind_stands_for_all():
    longest = CLIPS[2].replace(end_time=CLIPS[2].time + 3.0)
    events = (*CLIPS[:2], longest, CLIPS[3])
    ((index, count),) = worst_events(events)
    assert (events[index], count) == (longest, 4)
    assert count_text(longest, count) == " (longest of 4)"
    assert count_text(HIT, 2) == " (first of 2)"
    assert count_text(longest, 1) == ""


def test_a_page_says_once_what_to_do_and_what_shows_an_event():
    assert LOST.remedy
    next_step = f"{LOST.remedy} Then look at the clips."
    # The event of the motion with which the flight was lost is not listed beside the loss, which has its evidence.
    *clips, lost, hit = numbered_events(EVENTS, None, next_step=next_step)
    assert {clip.event.fact.code for clip in clips} == {MotionEvent.CLIPPED}
    assert lost.why == "Why: the gyro measured 286 °/s at 31.0 s."
    assert hit.why == ""
    # The time of an event stands beside its sentence.
    assert lost.sentence == str(LOST).replace(" at 30.0 s", "")
    first, *_ = numbered_events((LEFT, LOST, LOST), None)
    assert first.sentence == LOST.sentence_and_remedy.replace(" at 30.0 s", "")


def test_the_event_of_the_headline_is_in_the_short_list_without_its_cause():
    caused = LOST.replace(cause=Fact(FailedFirst.ALL_OFF_FIRST))
    headline = caused.replace(weak_motor=None)
    (lost,) = numbered_events((LEFT, caused), None, headline)
    assert "went to idle first" in str(caused)
    assert lost.brief == "Lost control."
    (lost,) = numbered_events((LEFT, caused), None, HIT)
    assert lost.brief == str(caused).replace(" at 30.0 s", "")


def test_what_failed_first_by_the_headline_is_in_the_short_list():
    """The headline's cause is a report of the autopilot, an event to be watched before four worse kinds."""
    report = Fact(ReportedEvent.MOTORS_STOPPED, Level.WATCH, time=29.0, boot=0)
    repeated = supporting_fact(SensorFact.AUTOPILOT_REPORTED, cause=report)
    cause = Fact(FailedFirst.ALL_OFF_FIRST, time=29.1, witnesses=(repeated,))
    lost = LOST.replace(cause=cause)
    worse = [
        LEFT.replace(Level.BAD, time=31.0 + number, subject=f"motor {number}")
        for number in range(4)
    ]
    events = numbered_events((report, lost, *worse), None, headline=lost)
    brief_events = Head(Level.BAD, {}, events).brief_events
    assert [event.number for event in brief_events] == [1, 2, 3, 4, 5]


def test_a_page_lists_the_worst_events_in_order_of_time():
    sunk = Fact(MotionEvent.CLIPPED, Level.WATCH, time=31.0, end_time=32.0, count=9, boot=0)
    head = Head(Level.BAD, {}, numbered_events((*CLIPS[1:], LOST, sunk, HIT), None))
    assert [event.number for event in head.brief_events] == [1, 4, 6]


MODE = Fact(ReportedEvent.MODE_CHANGED, Level.GOOD, subject="Guided", cause=None, boot=0)
TAKE_OFF = Fact(ReportedEvent.OFF_GROUND, Level.GOOD, boot=0, basis=())
LANDING = Fact(ReportedEvent.ON_GROUND, Level.GOOD, boot=0, basis=())
DISARMED = Fact(ReportedEvent.MOTORS_DISARMED, Level.GOOD, boot=0)


def test_the_short_list_of_a_sound_flight_has_its_take_off_modes_and_landing():
    events = [
        MODE.replace(time=0.0),
        Fact(ReportedEvent.MOTORS_ARMED, Level.GOOD, time=2.0, boot=0, is_begun=False),
        TAKE_OFF.replace(time=3.0),
        MODE.replace(time=62.0, subject="Land"),
        LANDING.replace(time=71.0),
        MODE.replace(time=71.0),
        DISARMED.replace(time=72.0),
    ]
    brief_events = Head(Level.GOOD, {}, numbered_events(events, None)).brief_events
    assert [event.number for event in brief_events] == [3, 4, 5]
    # Without a change of mode in flight, it has the mode of the take-off.
    del events[3]
    brief_events = Head(Level.GOOD, {}, numbered_events(events, None)).brief_events
    assert [event.number for event in brief_events] == [1, 3, 4]


def test_the_short_list_has_the_end_of_a_lost_link_that_it_has():
    taken_off = Fact(ReportedEvent.OFF_GROUND, time=2.0, boot=0)
    lost = Fact(LinkFact.LOST_IN_FLIGHT, Level.BAD, time=14.0, cause=None)
    resumed = Fact(RowsFact.MESSAGES_RESUMED, subject=MissingMessages.MESSAGES, duration=15.0)
    landed = Fact(ReportedEvent.ON_GROUND, time=46.0, boot=0)
    stated = StatedEvents(None, (), ())
    for events in ((taken_off, lost, resumed, landed), (taken_off, lost, landed)):
        assert [events[event.event_index] for event in short_list(events, stated)] == [*events]
    # Without the loss its end says nothing.
    assert len(short_list((taken_off, resumed, landed), stated)) == 2


def test_the_short_list_has_the_landings_and_take_offs_between_three_flights_but_not_of_more():
    def events_of(flight_count):
        starts = [100.0 * number for number in range(flight_count)]
        pairs = [(TAKE_OFF.replace(time=t), LANDING.replace(time=t + 50)) for t in starts]
        return [event for pair in pairs for event in pair]

    nothing_stated = StatedEvents(headline_index=None, cause_indices=(), light_indices=())
    assert len(short_list(events_of(3), nothing_stated)) == 6
    assert [index for index, _ in short_list(events_of(4), nothing_stated)] == [0, 7]


def test_the_short_list_of_a_lost_flight_leaves_out_other_flights_and_what_followed_the_loss():
    earlier_flight = (TAKE_OFF.replace(time=1.0), MODE.replace(time=2.0), LANDING.replace(time=9.0))
    modes = [MODE.replace(time=time) for time in (12.0, 14.0, 16.0, 18.0)]
    sensor_failed = Fact(ReportedEvent.SENSOR_FAILED, Level.WATCH, time=40.0, boot=0)
    end = LANDING.replace(time=41.0)
    take_off = TAKE_OFF.replace(time=11.0)
    events = (*earlier_flight, take_off, *modes, LOST, HIT, sensor_failed, end)
    stated = stated_events(events, LOST, {})
    listed = [events[index] for index, _ in short_list(events, stated)]
    bad_hit = HIT.replace(Level.BAD)
    assert listed == [take_off, *modes[1:], LOST, end]
    events = [bad_hit if event is HIT else event for event in events]
    assert bad_hit in [events[index] for index, _ in short_list(events, stated)]


def test_a_live_page_has_its_newest_alarm_beside_the_headline_unless_that_states_it():
    alarm = PageEvent(Event(1.0, Fact(SessionFact.ALARM, time=1.0, reason=LOST)))
    alarm_of_unknown_level = PageEvent(Event(2.0, LEFT.replace(Level.UNKNOWN)))
    head = Head(
        Level.BAD, {}, [alarm_of_unknown_level, alarm], is_newest_first=True, is_in_flight=True
    )
    assert head.newest_alarm is alarm
    assert head._replace(events=[alarm._replace(is_headline=True)]).newest_alarm is None
    # One that is over asks for nothing any more.
    assert head._replace(events=[alarm._replace(is_over=True)]).newest_alarm is None
    # On the ground the headline has what to do, and an alarm's "land now" is over.
    assert head._replace(is_in_flight=False).newest_alarm is None


NOTHING_RECEIVED = Fact(RowsFact.NOTHING_RECEIVED, subject=MissingMessages.MESSAGES, duration=3.0)


def _history_of(*events):
    """Returns the history of a live session with some events."""
    history = LiveHistory()
    for event in events:
        history.add_event(event)
    return history


def test_a_live_page_lists_states_of_the_session_apart_from_the_vehicle_and_results():
    learning = Event(0.0, Fact(SessionFact.BEING_LEARNED, time=3.0), reception=0.0)
    landing = Event(1.0, Fact(ReportedEvent.MOTORS_DISARMED, time=2.0), reception=0.0)
    model = Fact(SessionFact.FIRST_MODEL, clock=2.0, axis="roll", duration=None)
    result = Event(2.0, model, reception=0.0)
    history = _history_of(learning, landing, learning, result)
    events = numbered_live_events(history, unjudged(LOST), ())
    head = Head(Level.BAD, {}, events[::-1], is_newest_first=True)
    listed = [(one.number, one.event.fact.code) for one in head.brief_events]
    assert listed == [(2, SessionFact.FIRST_MODEL), (1, ReportedEvent.MOTORS_DISARMED)]
    states = [(one.number, one.event.fact.code) for one in head.session_events]
    assert states == [(None, SessionFact.BEING_LEARNED)] * 2


def test_an_event_of_a_silence_that_has_ended_advises_nothing_any_more():
    silence = Event(0.0, NOTHING_RECEIVED, reception=0.0)
    resumed = Event(1.0, Fact(RowsFact.MESSAGES_RESUMED, duration=9.0), reception=0.0)
    history = _history_of(silence, resumed, silence)
    before, _, again = numbered_live_events(history, unjudged(LOST), ())
    assert before.sentence == NOTHING_RECEIVED.sentence
    assert again.sentence == NOTHING_RECEIVED.sentence_and_remedy


def test_the_closing_list_of_a_live_flight_has_the_event_of_its_headline():
    """Several alarms of other kinds, and a late computer, do not fold it away."""
    history = _history_of(
        Event(0.0, Fact(SessionFact.COMPUTER_BEHIND, delay=1.0), reception=0.0),
        *[
            Event(fact.time, Fact(SessionFact.ALARM, time=fact.time, reason=fact), reception=0.0)
            for fact in (*[clip.replace(Level.BAD) for clip in CLIPS], LEFT, HIT)
        ],
        Event(40.0, Fact(ReportedEvent.MOTORS_DISARMED, time=40.0), reception=0.0),
    )
    events = numbered_live_events(history, unjudged(HIT), ())
    listed = [(one.finding.code, one.total) for one in Head(Level.BAD, {}, events).brief_events]
    assert listed == [
        (MotionEvent.CLIPPED, 4),
        (MotionEvent.ATTITUDE_LOST, 1),
        (MotionEvent.HIT, 1),
        (ReportedEvent.MOTORS_DISARMED, 1),
    ]


def test_a_live_page_keeps_the_event_of_its_headline_in_sight():
    """A motor weakens, then the link is lost and comes back: the plots have marks for listed events only."""
    left = Fact(SessionFact.ALARM, time=1.0, reason=LEFT.replace(Level.BAD))
    silence = link_loss_fact(
        NOTHING_RECEIVED, 9.0, 0.0, None, None, None, cause=LEFT.replace(Level.BAD), is_over=False
    )
    disarmed = Fact(ReportedEvent.MOTORS_DISARMED, time=4.0)
    history = _history_of(
        Event(1.0, left, reception=0.0),
        Event(2.0, silence, reception=0.0),
        *[Event(4.0, disarmed, reception=0.0)] * MAX_NEWEST_EVENTS,
    )
    events = numbered_live_events(history, unjudged(LEFT.replace(Level.BAD)), ())
    head = Head(Level.BAD, {}, events[::-1], is_newest_first=True)
    assert [one.number for one in head.newest_events] == [6, 5, 4, 3, 2, 1]
    assert head.earlier_events == []
    # The closing list leaves out what the headline states, and ends no sentence in its middle.
    assert events[1].brief == "Link lost at 00:00:00, in flight."


def test_events_of_an_earlier_flight_are_listed_without_a_place_in_the_plots():
    disarmed = Fact(ReportedEvent.MOTORS_DISARMED, time=2.0)
    history = _history_of(Event(2.0, disarmed, reception=0.0))
    history.advance(30.0, 0)
    history.advance(10.0, 1)
    history.note_flight(2, 10.0)
    # Two seconds after the take-off of a boot whose clock began 21 s after that of the first one.
    history.add_event(Event(33.0, disarmed, reception=0.0, clock=12.0, boot=1))
    earlier, latest = numbered_live_events(history, unjudged(LOST), ())
    assert (earlier.number, earlier.is_on_clock_of_charts) == (None, False)
    assert (latest.number, latest.is_on_clock_of_charts, latest.seconds) == (1, True, 12.0)


def test_loops_do_not_repeat_the_next_step():
    reason = Fact(LoopFact.NOT_STEERED, share=0.3)
    decisions = {
        axis: LoopDecision(axis, LoopDiagnosis.UNKNOWN, reason, LOST) for axis in ("roll", "pitch")
    }
    action = decisions["roll"].fact.remedy
    assert action
    (stated,) = decision_sentences(decisions)
    assert stated.text == f"{reason} {action}"
    (stated,) = decision_sentences(decisions, f"{action} Then land.")
    assert stated.text == str(reason)


def test_an_event_of_a_live_page_does_not_repeat_its_next_step():
    judgement = replace(unjudged(LOST), next_step=Fact(NextStep.DO_AS_ADVISED, reason=LOST))
    alarm = Event(1.0, LOST, reception=0.0)
    history = _history_of(alarm)
    [page_event] = numbered_live_events(history, judgement, ())
    assert LOST.remedy and page_event.sentence == str(LOST)
    judgement = replace(judgement, next_step=LEFT)
    [page_event] = numbered_live_events(history, judgement, ())
    assert page_event.sentence == LOST.sentence_and_remedy


def test_no_event_of_a_live_page_advises_to_fly_on_where_the_next_step_is_to_land():
    gust = Fact(SessionFact.MOTION_UNEXPECTED, clock=1.0, cause=SurpriseCause.DISTURBANCE)
    history = _history_of(Event(1.0, gust, reception=0.0))
    judgement = unjudged(LOST)
    [page_event] = numbered_live_events(history, judgement, ())
    assert page_event.sentence == gust.sentence_and_remedy != str(gust)
    judgement = replace(judgement, next_step=Fact(NextStep.LAND_NOW, reason=LOST))
    [page_event] = numbered_live_events(history, judgement, ())
    assert page_event.sentence == str(gust)


def test_the_time_of_a_wrong_clock_does_not_touch_the_level():
    lost = Fact(ReportedEvent.GPS_LOST, Level.WATCH, time=1_234_567.8)
    [line, *_] = _lines_of_event(lost, 1, 100)
    assert line.startswith("1234567.8 s watch")
