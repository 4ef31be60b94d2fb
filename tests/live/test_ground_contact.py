"""A vehicle that loses control and hits the ground: both are said in their order, and as its log says them."""

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from pytest import fixture, mark, param

import mavdem
from mavdem.experiments.paper.flights import write_log
from mavdem.facts.ending import Ending, MotionEvent
from mavdem.facts.session import SessionFact
from mavdem.facts.watch import WatchFact
from mavdem.ingest.formats import read_stream
from mavdem.live import LiveStream
from mavdem.report.live import vehicle_text
from sitl_scenarios.mishaps.specs import MotorFade, MotorStop
from sitl_scenarios.scenario import Scenario, StreamSpec, VehicleSpec
from sitl_scenarios.simulation import fly

pytestmark = [mark.slow, mark.usefixtures("coarse_physics")]


@fixture(scope="module", params=[2.0, param(4.0, marks=mark.in_full)])
def flown(request, tmp_path_factory, coarse_physics):
    """A quadrotor one of whose motors stops 2 m or 4 m up."""
    stream = StreamSpec(autopilot="ardupilot", rate=25.0, instruments=True)
    mishap = MotorStop(kind="motor_stop", start=10.0, motor=1)
    vehicle = VehicleSpec(parameters={"SCHED_LOOP_RATE": 100.0})
    scenario = Scenario(
        duration=16.0, height=request.param, seed=7, vehicle=vehicle, stream=stream, mishap=mishap
    )
    path = tmp_path_factory.mktemp("stopped") / "flight.tlog"
    write_log(path, scenario, fly(scenario))
    return path


def alarms_of(path):
    """The alarms of a live session that receives a log, as it reports them, and its stream."""
    stream = LiveStream()
    alarms = []
    for stamp, frame in read_stream(path).stamped_frames():
        stream.feed(stamp / 1e6, frame)
        alarms += [event.fact for event in stream.drain_events()]
    return stream, [fact for fact in alarms if fact.code is SessionFact.ALARM]


def test_a_vehicle_that_sinks_with_a_motor_at_its_limit_is_said_to_before_it_hits_the_ground(
    tmp_path,
):
    """Motor 3 loses its thrust in a simulated flight.

    The alarm that the vehicle sinks comes before the alarm of the crash, which is reported once.
    """
    stream = StreamSpec(autopilot="ardupilot", rate=25.0, instruments=True)
    mishap = MotorFade(kind="motor_fade", start=10.0, motor=3, seconds=12.0, thrust=0.3)
    vehicle = VehicleSpec(parameters={"SCHED_LOOP_RATE": 100.0})
    scenario = Scenario(
        duration=45.0, height=15.0, seed=3, vehicle=vehicle, stream=stream, mishap=mishap
    )
    path = tmp_path / "flight.tlog"
    write_log(path, scenario, fly(scenario))
    session, alarms = alarms_of(path)
    reasons = [alarm.figures["reason"] for alarm in alarms]
    codes = [reason.code for reason in reasons]
    assert codes.index(WatchFact.SINKS_AT_LIMIT) < codes.index(Ending.CRASHED)
    sinking = reasons[codes.index(WatchFact.SINKS_AT_LIMIT)]
    assert sinking.subject == "motor 3 (front left)" and sinking.figures["speed"] > 1.0
    assert "Land at once" in alarms[codes.index(WatchFact.SINKS_AT_LIMIT)].remedy
    # Which motor it was is said with the impact, and of one impact there is one alarm.
    assert codes.count(Ending.CRASHED) == 1
    assert "motor 3 (front left)" in session.status().loss.sentence


class Replay(NamedTuple):
    """What a live session says of a flight that it receives message by message."""

    path: Path
    """The log."""
    stream: LiveStream
    """The stream at the end."""
    wind_before_loss: object
    """The mean wind at the last message before the alarm of the loss."""
    losses: list
    """The alarms of losses and impacts."""
    down_texts: list
    """The texts of the vehicle after its impact, while it counts as flying."""


@fixture(scope="module")
def replayed(flown):
    """The flight, replayed once, with its status after every twentieth message in flight since its loss."""
    stream = LiveStream()
    wind_before_loss = None
    losses = []
    down_texts = []
    for number, (stamp, frame) in enumerate(read_stream(flown).stamped_frames()):
        stream.feed(stamp / 1e6, frame)
        for event in stream.drain_events():
            reason = event.fact.figures.get("reason")
            is_alarm = event.fact.code is SessionFact.ALARM
            if is_alarm and reason.code in (Ending.CONTROL_LOST, Ending.CRASHED, MotionEvent.HIT):
                losses.append(event.fact)
        if not losses:
            wind_before_loss = stream.wind.mean
        elif stream.is_flying and number % 20 == 0:
            status = replace(stream.status(), state=stream.vehicle_state())
            if status.ground_contact is not None:
                down_texts.append(vehicle_text(status))
    return Replay(flown, stream, wind_before_loss, losses, down_texts)


def test_the_wind_before_a_loss_stays_known(replayed):
    wind = replayed.stream.wind
    assert replayed.wind_before_loss is not None
    assert wind.mean is replayed.wind_before_loss and wind.latest is None
    assert wind.no_estimate_reason is None


def test_a_loss_is_said_before_its_impact_and_no_lost_vehicle_is_in_flight(replayed):
    """The alarm of a lost control comes before the impact.

    From the impact on the status says that the vehicle is down.
    """
    losses = replayed.losses
    down_texts = replayed.down_texts
    assert down_texts
    assert all("down since" in text and "in flight" not in text for text in down_texts)
    reviewed = mavdem.review(replayed.path)
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
