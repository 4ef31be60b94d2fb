"""A vehicle that loses control and hits the ground: both are said in their order, and as its log says them."""

from dataclasses import replace

from pytest import fixture, mark

import mavdem
from mavdem.experiments.paper.flights import write_log
from mavdem.facts.ending import Ending, MotionEvent
from mavdem.facts.session import SessionFact
from mavdem.ingest.formats import read_stream
from mavdem.live import LiveStream
from mavdem.report.live import vehicle_text
from sitl_scenarios.mishaps.specs import MotorStop
from sitl_scenarios.scenario import Scenario, StreamSpec
from sitl_scenarios.simulation import fly

pytestmark = [mark.slow, mark.usefixtures("coarse_physics")]


@fixture(scope="module", params=[2.0, 4.0])
def flown(request, tmp_path_factory, coarse_physics):
    """A quadrotor one of whose motors stops 2 m or 4 m up."""
    stream = StreamSpec(autopilot="ardupilot", rate=50.0, instruments=True)
    mishap = MotorStop(kind="motor_stop", start=10.0, motor=1)
    scenario = Scenario(duration=16.0, height=request.param, seed=7, stream=stream, mishap=mishap)
    path = tmp_path_factory.mktemp("stopped") / "flight.tlog"
    write_log(path, scenario, fly(scenario))
    return path


def test_a_loss_is_said_before_its_impact_and_no_lost_vehicle_is_in_flight(flown):
    stream = LiveStream()
    losses = []
    down_texts = []
    for stamp, frame in read_stream(flown).stamped_frames():
        stream.feed(stamp / 1e6, frame)
        for event in stream.drain_events():
            reason = event.fact.figures.get("reason")
            is_alarm = event.fact.code is SessionFact.ALARM
            if is_alarm and reason.code in (Ending.CONTROL_LOST, Ending.CRASHED, MotionEvent.HIT):
                losses.append(event.fact)
        status = replace(stream.status(), state=stream.vehicle_state())
        if status.ground_contact is not None and status.is_flying:
            down_texts.append(vehicle_text(status))
    assert down_texts
    assert all("down since" in text and "in flight" not in text for text in down_texts)
    reviewed = mavdem.review(flown)
    [hit] = [event for event in reviewed.events if event.code is MotionEvent.HIT]
    codes = [alarm.figures["reason"].code for alarm in losses]
    if reviewed.headline.code is Ending.CRASHED:
        assert codes == [Ending.CRASHED]
    else:
        assert codes == [Ending.CONTROL_LOST, MotionEvent.HIT]
        assert losses[0].time < hit.time
    contact = losses[-1].figures["reason"]
    assert abs(contact.time - hit.time) < 0.1 and contact.is_bad
    assert losses[-1].time < hit.time + 1.0
    assert "Stop the motors" in losses[-1].remedy
