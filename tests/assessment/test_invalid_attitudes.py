"""Attitudes that are not numbers: a log and a live flight say so, not that messages are slow or the log has ended."""

from dataclasses import dataclass
from math import inf, nan

from hover import Hover
from live_hover import Flight, replay
from mavlink_streams import read, tlog
from pytest import approx, mark, param

from mavdem.assessment.assess import assess
from mavdem.facts.ending import MotionEvent
from mavdem.facts.lights import Light
from mavdem.facts.session import SessionFact
from mavdem.facts.watch import WatchedQuantity, WatchFact

pytestmark = mark.slow


@dataclass(frozen=True)
class FailingFlight(Flight):
    """A flight 10 m up whose attitude is not a number from 15 s until ``end_time``, s."""

    end_time: float = inf

    def _attitude(self, start, end):
        for time, name, values in super()._attitude(start, end):
            is_invalid = 15.0 <= time < self.end_time
            yield time, name, values | ({"roll": nan, "pitch": nan} if is_invalid else {})

    def _climb(self, start, end):
        for time, name, values in super()._climb(start, end):
            yield time, name, values | {"z": -2.0 * min(max(time - 6.0, 0.0), 5.0)}


def frames_of_flight(**options):
    return FailingFlight(Hover(hovering=30.0), attitude=20.0, motors=20.0, **options).frames(
        end=24.0
    )


def test_a_log_and_a_live_flight_say_that_the_attitude_is_not_a_number():
    """From 15 s on the attitude is NaN until the end."""
    frames = frames_of_flight()
    replayed = replay(frames)
    [alarm] = [fact for fact in replayed.facts if fact.code is SessionFact.ALARM]
    event = alarm.figures["reason"]
    assert (event.code, event.time) == (MotionEvent.ATTITUDE_INVALID, approx(15.0))
    assert alarm.time <= 16.6
    status = replayed.stream.status()
    assert status.no_model_reason == event and status.overall_judgement.headline == event
    reasons = {fact.subject: fact.figures["reason"] for fact in status.watch_facts}
    assert reasons[WatchedQuantity.CONTROL] == reasons[WatchedQuantity.TRACKING] == event

    assessment = assess(read(tlog(content for _, content in frames)))
    assert assessment.judgement.headline == event == assessment.lights[Light.ESTIMATOR]
    codes = [fact.code for fact in assessment.evidence.events]
    assert MotionEvent.LOG_ENDED_IN_AIR not in codes


@mark.parametrize("end_time", [param(15.5, marks=mark.in_full), 18.0])
def test_the_event_ends_with_the_next_number_and_needs_a_second(end_time):
    """The attitude is NaN from 15 s to its end time: only a second or more is an alarm."""
    replayed = replay(frames_of_flight(end_time=end_time))
    alarms = [fact for fact in replayed.facts if fact.code is SessionFact.ALARM]
    assert len(alarms) == (0 if end_time < 16.0 else 1)
    if alarms:
        control = [fact for fact in replayed.stream.watch_facts if fact.subject == "control"]
        assert [fact.code for fact in control] == [WatchFact.WATCHED]
