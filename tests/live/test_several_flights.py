"""Several flights in one session: each is judged by its own data."""

from dataclasses import dataclass
from itertools import groupby
from unittest.mock import Mock

import numpy as np
from hover import Hover
from live_hover import Flight
from pytest import fixture, mark

from mavdem.dem import Settings
from mavdem.facts.lights import Light
from mavdem.facts.motors import MotorWatchFact
from mavdem.facts.session import SessionFact
from mavdem.live import LiveStream
from mavdem.live.link import ReceivedPiece
from mavdem.live.session import LiveSession

pytestmark = [mark.slow, mark.usefixtures("without_wind_fits")]


@dataclass(frozen=True)
class WeakHover(Hover):
    """A short hover in which one motor works harder from 19 s on."""

    motor: int = 0
    level: float = 8.0
    hovering: float = 16.0

    @property
    def landed(self):
        return self.sinking + 4.0

    def motors(self, t):
        pulse_widths = super().motors(t)
        pulse_widths[(t > 19.0) & (t < self.landed), self.motor] += 150.0
        return pulse_widths


@fixture
def session_now(monkeypatch):
    """The clock of sessions, s: it follows the messages."""
    clock = [0.0]
    monkeypatch.setattr("mavdem.live.clock.time.monotonic", lambda: clock[0])
    return clock


def fly(session_now, *flights):
    """Returns a session that has received some flights of a vehicle, and the facts that it has reported."""
    facts = []
    session_now[0] = 0.0
    link = Mock(dropped_datagrams=0, awaits_greeting=False)
    link.drain_events.return_value = []
    session = LiveSession(
        link,
        LiveStream(),
        Settings(order=2, d=1, window=5, parameter_precision=10.0),
        Mock(return_value=None),
        Mock(),
        lambda event: facts.append(event.fact),
    )
    for flight in flights:
        frames = flight.frames(end=flight.hover.end)
        for _, batch in groupby(frames, key=lambda entry: entry[0] // 0.25):
            pieces = [ReceivedPiece(1.7e9 + flight.clock + time, frame) for time, frame in batch]
            session_now[0] = pieces[-1].arrival_time - 1.7e9
            link.receive.return_value = pieces
            session.step(0.0)
    return session, facts


@mark.in_full
def test_a_flight_is_judged_as_if_it_were_the_only_one_of_its_session(session_now):
    """Motor 3 weakens in the first flight, and motor 1 in the second one."""
    first = Flight(WeakHover(motor=2), attitude=42.0, motors=42.0)
    second = Flight(WeakHover(motor=0), attitude=42.0, motors=42.0, clock=80.0)
    session, facts = fly(session_now, first, second)
    fresh_session, facts_of_fresh = fly(session_now, second)
    status = session.status
    fresh_status = fresh_session.status
    assert (status.flight_number, fresh_status.flight_number) == (2, 1)

    judgement = status.overall_judgement
    assert judgement == fresh_status.overall_judgement
    assert judgement.headline.code is MotorWatchFact.MOTOR_LOST_THRUST
    assert judgement.headline.subject == judgement.lights[Light.MOTORS].subject
    assert "motor 1" in judgement.headline.subject
    closing_lines = [fact for fact in facts if fact.code is SessionFact.FLIGHT_LEARNED]
    assert closing_lines[1:] == [
        fact for fact in facts_of_fresh if fact.code is SessionFact.FLIGHT_LEARNED
    ]
    # What the first flight has shown is reported once, when the second one begins.
    [verdict] = [fact for fact in facts if fact.code is SessionFact.FLIGHT_VERDICT]
    assert "motor 3" in str(verdict)

    # The model at the end is of the second flight; where that gives none, the first one's is kept, and not judged.
    assert session.flight.learning.learned_rows == fresh_session.flight.learning.learned_rows > 500
    record, fresh_record = (each.final_model().record for each in (session, fresh_session))
    np.testing.assert_array_equal(record.outputs, fresh_record.outputs)
    session.flight.learning.learner = None
    model = session.final_model()
    assert len(model.record.outputs) and session.judge_final_model(model) is None
    assert facts[-1].code is SessionFact.FORMER_MODEL_KEPT
