"""What the autopilot reports at a critical level is an alarm in flight with its own step; the rest is a line."""

from math import inf

from pytest import mark

from mavdem.assessment.repeated_reports import REPEAT_SECONDS
from mavdem.facts import Fact, Level
from mavdem.facts.estimator import EstimatorLight
from mavdem.facts.events import ReportedEvent
from mavdem.facts.session import SessionFact
from mavdem.facts.watch import WatchFact
from mavdem.live.report_alarms import ReportAlarms, is_moment_or_reported_end
from mavdem.live.report_limit import MAX_REPORTS_OF_KIND, ReportLimit


def report(code, severity="critical", **figures):
    return Fact(code, time=20.0, boot=0, severity=severity, text="as sent", **figures)


@mark.parametrize(
    "fact, level",
    [
        (report(ReportedEvent.MOTOR_FAILED, "warning"), Level.BAD),
        (report(ReportedEvent.GPS_JUMPED), Level.WATCH),
        (report(ReportedEvent.GPS_JUMPED, "warning"), None),
        (report(ReportedEvent.AUTOPILOT_SAID, "error"), None),
        (report(ReportedEvent.RADIO_LOST, "warning"), Level.WATCH),
        (report(ReportedEvent.RADIO_LOST, None), None),
        (Fact(ReportedEvent.FAILSAFE, time=20.0, boot=0), Level.WATCH),
        (Fact(ReportedEvent.SENSOR_FAILED, time=20.0, boot=0), None),
        (Fact(ReportedEvent.MODE_CHANGED, time=20.0, boot=0, cause=""), None),
    ],
)
def test_the_severity_decides_what_is_an_alarm(fact, level):
    """A report of the autopilot becomes a bad alarm, one to watch, or none, by its kind and severity."""
    event = ReportAlarms().add_report(fact, 20.0)
    if level is None:
        assert event is fact
    else:
        assert event.code is SessionFact.ALARM and event.level is level
        assert event.figures["reason"] is fact


def test_a_critical_report_that_the_vehicle_can_fly_with_is_no_reason_to_land_at_once():
    alarm = ReportAlarms().add_report(report(ReportedEvent.GPS_JUMPED), 20.0)
    assert alarm.remedy.startswith("Fly by hand in a mode without position")
    assert (
        ReportAlarms()
        .add_report(report(ReportedEvent.THRUST_LOST), 20.0)
        .remedy.startswith("Land now")
    )


def test_a_bad_report_lasts_until_the_flight_ends_and_another_while_it_is_repeated():
    """A failed motor stays an alarm; a GPS jump is over ``REPEAT_SECONDS`` after its last report at 30 s."""
    alarms = ReportAlarms()
    failed = report(ReportedEvent.MOTOR_FAILED)
    jumped = report(ReportedEvent.GPS_JUMPED)
    for fact in (failed, jumped):
        alarms.add_report(fact, 20.0)
    alarms.update([failed, jumped.replace(end_time=30.0)], 35.0)
    alarms.update([], 29.0 + REPEAT_SECONDS)
    assert alarms.active == (failed, jumped)
    alarms.update([], 31.0 + REPEAT_SECONDS)
    assert alarms.active == (failed,)
    alarms.update([], inf)
    assert alarms.active == (failed,)
    alarms.end_flight()
    assert not alarms.active


def test_a_glitch_is_over_when_the_autopilot_says_so():
    """The autopilot reports a glitch at 20 s, and at 26 s that it is cleared: nothing more is advised then."""
    alarms = ReportAlarms()
    glitch = report(ReportedEvent.GPS_JUMPED)
    warning = alarms.add_report(glitch, 20.0)
    assert warning.sentence.startswith("Warning: ") and warning.remedy
    assert alarms.update([glitch], 25.0) == [] and alarms.active == (glitch,)
    [end] = alarms.update([glitch.replace(end_time=26.0, is_over=True)], 26.5)
    assert not alarms.active
    assert (end.code, end.time, end.remedy) == (WatchFact.ALARM_OVER, 26.0, "")
    assert "glitch for 6.0 s" in end.sentence


@mark.parametrize(
    "fault, is_no_news",
    [
        (report(ReportedEvent.ESTIMATOR_RESET), True),
        (report(ReportedEvent.GPS_JUMPED, end_time=26.0, is_over=True), True),
        (Fact(ReportedEvent.GPS_LOST, time=20.0, end_time=26.0), False),
        (Fact(EstimatorLight.FILTER_DOUBTED, time=20.0), False),
    ],
)
def test_the_end_of_a_moment_is_no_news(fault, is_no_news):
    """A reset of the estimator has no duration, and the end of a glitch was reported by the autopilot."""
    assert is_moment_or_reported_end(fault) is is_no_news


def test_a_flood_of_texts_is_counted_and_hides_no_known_fault():
    texts = ReportLimit()
    quoted = []
    for second in range(3 * MAX_REPORTS_OF_KIND):
        text = Fact(ReportedEvent.AUTOPILOT_SAID, time=20.0, text=f"fault {second}")
        alarm = Fact(SessionFact.ALARM, reason=text)
        quoted.append(texts.admits(alarm if second % 2 else text, 100.0 + 0.1 * second))
    assert quoted.count(True) == quoted.index(False) == MAX_REPORTS_OF_KIND
    failed = Fact(SessionFact.ALARM, reason=report(ReportedEvent.MOTOR_FAILED))
    assert texts.admits(failed, 103.0)
    assert texts.pop_omission_report(104.0) is None
    left_out = texts.pop_omission_report(102.0 + REPEAT_SECONDS)
    assert left_out is not None and left_out.figures["count"] == quoted.count(False)
    # A calm autopilot is quoted again, and nothing more was left out.
    assert texts.admits(text, 104.0 + REPEAT_SECONDS)
    assert texts.pop_omission_report(200.0 + REPEAT_SECONDS) is None


def test_an_arming_that_flaps_is_counted_and_hides_no_change_of_mode():
    limit = ReportLimit()
    admitted = []
    for second in range(3 * MAX_REPORTS_OF_KIND):
        code = ReportedEvent.MOTORS_ARMED if second % 2 else ReportedEvent.MOTORS_DISARMED
        admitted.append(limit.admits(Fact(code, time=float(second)), 100.0 + 0.5 * second))
    assert admitted.count(True) == admitted.index(False) == MAX_REPORTS_OF_KIND
    assert limit.admits(Fact(ReportedEvent.MODE_CHANGED, time=31.0, subject="Land"), 115.0)
    left_out = limit.pop_omission_report(105.0 + REPEAT_SECONDS)
    assert left_out is not None and left_out.figures["count"] == admitted.count(False)
    # The last change that was left out armed the motors, and the last one that was shown did so too.
    assert limit.pop_omitted_states(115.0, is_at_end=True) == ()


@mark.parametrize("now, is_at_end", [(100.0 + REPEAT_SECONDS, False), (107.0, True)])
def test_the_last_report_of_a_state_that_flapped_is_its_present_state(now, is_at_end):
    limit = ReportLimit()
    for second in range(MAX_REPORTS_OF_KIND + 1):
        code = ReportedEvent.ON_GROUND if second % 2 == 0 else ReportedEvent.OFF_GROUND
        last = Fact(code, time=float(second))
        limit.admits(last, 100.0 + 0.5 * second)
    assert limit.pop_omitted_states(106.0, is_at_end=False) == ()
    assert limit.pop_omitted_states(now, is_at_end=is_at_end) == (last,)
    assert limit.pop_omitted_states(now + REPEAT_SECONDS, is_at_end=True) == ()
