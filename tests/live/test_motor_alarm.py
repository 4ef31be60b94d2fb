"""A motor that weakens in flight: the live path says which, and a log of the same stream says the same."""

from dataclasses import dataclass, replace
from io import StringIO
from itertools import pairwise
from unittest.mock import Mock

import numpy as np
from frames import geometry
from hover import Hover
from live_hover import NOW, Flight, by_time, offline, replay
from mavlink_streams import message
from numpy.testing import assert_allclose
from partial_records import partial_record
from pytest import approx, fixture, mark, param
from rich.console import Console

from mavdem.assessment.motor_alarms import _gradual_losses, motor_alarms
from mavdem.cli.live_status import StatusLines
from mavdem.dataset.motor_outputs import MotorOutputs
from mavdem.dataset.phases import settled_intervals
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import TimeSeries
from mavdem.dem import Settings
from mavdem.experiments.paper.flights import write_log
from mavdem.facts import Fact, Level
from mavdem.facts.assessment import NextStep
from mavdem.facts.lights import Light
from mavdem.facts.motors import MotorWatchFact
from mavdem.facts.session import LinkFact, SessionFact, TimeUse
from mavdem.ingest import read_log
from mavdem.ingest.formats import read_stream
from mavdem.ingest.output_scale import OutputScale
from mavdem.live import LiveStream, SessionStatus
from mavdem.live.gradual_watch import GradualLossWatch
from mavdem.live.history import LiveHistory
from mavdem.live.link import ReceivedPiece
from mavdem.live.motor_alarms import MotorAlarms
from mavdem.live.session import LiveSession
from mavdem.motors.loss_detection import MotorLossDetector
from mavdem.motors.motor_changes import MotorChange, thrust_losses
from mavdem.report.live import live_report
from mavdem.report.templates import render_section
from sitl_scenarios.mishaps.specs import MotorFade
from sitl_scenarios.scenario import Scenario, StreamSpec, TurbulentWind, VehicleSpec
from sitl_scenarios.simulation import fly

pytestmark = [mark.slow, mark.usefixtures("coarse_physics", "without_watchdog")]


def stream_and_facts(path):
    """Returns a live stream that was fed the bytes of a log, and the facts that it reported."""
    stream = LiveStream()
    data = bytes(read_stream(path).data)
    reported_facts = []
    for begin in range(0, len(data), 4096):
        stream.feed(1.7e9, data[begin : begin + 4096])
        reported_facts += [event.fact for event in stream.drain_events()]
    return stream, reported_facts


@fixture(scope="module", params=[param("px4", marks=mark.in_full), "ardupilot"])
def flown(request, tmp_path_factory, coarse_physics):
    """At 12 Hz: enough for the motors, and too slow for a model."""
    wind = (TurbulentWind(kind="dryden", speed=4.0, direction=60.0),)
    loop_rate = {"ardupilot": "SCHED_LOOP_RATE", "px4": "IMU_GYRO_RATEMAX"}[request.param]
    slower = {loop_rate: 100.0}
    vehicle = VehicleSpec(weak_motor=3, weak_from=25.0, weak_thrust=0.7, parameters=slower)
    stream = StreamSpec(autopilot=request.param, rate=12.0)
    scenario = Scenario(
        duration=45.0, height=2.0, seed=3, vehicle=vehicle, wind=wind, stream=stream
    )
    path = tmp_path_factory.mktemp("weak") / "flight.tlog"
    write_log(path, scenario, fly(scenario))
    return path


def test_a_motor_that_weakens_is_named_in_flight_and_by_its_log(flown):
    """Motor 3 of a simulated flight loses thrust 25 s after arming."""
    stream, reported_facts = stream_and_facts(flown)
    [alarm] = stream.status().motor_alarms
    logged = motor_alarms(Signals(read_log(flown).vehicles[0]))
    # Two seconds on the ground before the first arming.
    assert (alarm.motor, alarm.name) == (3, "motor 3 (front left)")
    # It leans by 10° and more, where a shifted load changes yaw too: that takes some seconds to exclude.
    assert 27.0 < alarm.time < 34.0 and alarm.onset_time == approx(27.0, abs=1.5)
    assert [
        fact.figures["reason"] for fact in reported_facts if fact.code is SessionFact.ALARM
    ] == [alarm.fact]
    assert [alarm[:4]] == [one[:4] for one in logged]
    assert_allclose([alarm[4:6]], [one[4:6] for one in logged], atol=0.01)
    status = stream.status()
    [fact] = status.active_alarms
    # The headline states it, and what stands beside the headline does not state it again.
    headline = status.overall_judgement.headline
    assert (headline.code, headline.subject) == (alarm.fact.code, fact.subject)
    texts = [block.text for block in render_section("live_status", status=status, time=0.0)]
    assert "Not learning;" in texts[0] and str(fact) not in texts
    blocks = live_report(LiveHistory(), status, dict.fromkeys(TimeUse, 0.0), "roll")
    assert any("motor 3 (front left)" in str(block).lower() for block in blocks)
    assert not SessionStatus().active_alarms


@dataclass(frozen=True)
class Trimmed(Hover):
    """Motor 1 is commanded by ``trim`` µs more than the others, and by ``rise`` more from 25 s on, up to ``until``.

    The descent is short: it takes a replay as long as other flight, and shows nothing new.
    """

    trim: float = 0.0
    rise: float = 0.0
    until: float = np.inf

    @property
    def landed(self):
        return self.sinking + 6.0

    def motors(self, t):
        outputs = super().motors(t)
        outputs[:, 0] += (outputs[:, 0] > 1000) * (
            self.trim + self.rise * ((t >= 25.0) & (t < self.until))
        )
        return outputs


def hovering(clock=0.0, start=3.0, end=None, **trims):
    """Frames of a hover from ``start`` to ``end``, without which it lands; its boot clock reads ``clock`` more.

    A replay takes as long as it has messages, of which 12 a second are enough for the motors.
    """
    hover = Trimmed(hovering=23.0, **trims)
    return Flight(hover, attitude=12.0, motors=12.0, clock=clock).frames(start, end or hover.end)


@mark.in_full
def test_an_output_range_that_becomes_known_in_flight_is_no_motor_alarm():
    """Parameters with the range of the motor outputs arrive at 25 s.

    So all outputs have other fractions from then on.
    """
    frames = hovering(trim=200.0, end=36.0)
    limits = {b"MOT_PWM_MIN": 1150.0, b"MOT_PWM_MAX": 1940.0}
    sent = [
        (25.0, message("PARAM_VALUE", param_id=name, param_type=9, param_value=at))
        for name, at in limits.items()
    ]
    place = next(number for number, (time, _) in enumerate(frames) if time >= 25.0)
    assert replay(frames[:place] + sent + frames[place:]).stream.status().motor_alarms == ()


@mark.in_full
def test_a_transient_is_no_loss_live_or_in_the_log():
    frames = hovering(rise=150.0, until=30.0)
    status = replay(frames).stream.status()
    logged = motor_alarms(Signals(offline([frame for _, frame in frames])))
    assert [change.is_weak for change in status.motor_alarms] == [True, False]
    # The log's alarms leave out a loss that was withdrawn, and its recovery.
    assert not logged
    assert thrust_losses(status.motor_alarms) == []
    assert [fact.code for fact in status.active_alarms] == [MotorWatchFact.MOTOR_RECOVERED]


def test_the_status_beside_an_alarm_states_that_alarm(monkeypatch):
    """Headline, next step and light follow at the moment of the alarm, not with the status of the next second."""
    # The session reports one status at its start, and none by this clock later on.
    monkeypatch.setattr("mavdem.live.clock.time.monotonic", lambda: 100.0)
    pieces = [[ReceivedPiece(NOW + time, frame)] for time, frame in hovering(rise=150.0, end=34.0)]
    link = Mock(dropped_datagrams=0, awaits_greeting=False, drain_events=list)
    link.receive = lambda timeout: pieces.pop(0)
    statuses = []
    judgements_at_alarms = []

    def report_event(event):
        if event.fact.code is SessionFact.ALARM:
            judgements_at_alarms.append(statuses[-1].overall_judgement)

    session = LiveSession(
        link, LiveStream(), Settings(), lambda _: None, statuses.append, report_event
    )
    while pieces:
        session.step(0.0)
    session.end()
    [judgement] = judgements_at_alarms
    assert judgement.headline.code is MotorWatchFact.MOTOR_LOST_THRUST
    assert judgement.next_step.code is NextStep.LAND_NOW
    assert judgement.lights[Light.MOTORS].is_bad


def test_the_alarm_of_the_headline_is_stated_once_after_the_landing(monkeypatch):
    """The terminal states the loss of thrust in its headline, and not again among the alarms."""
    terminal_output = StringIO()
    monkeypatch.setattr("mavdem.cli.live_status.STDERR", Console(file=terminal_output, width=100))
    screen = Mock()
    loss = MotorChange(58.0, 56.0, 1, "motor 1", 0.3, 0.99, loss=(0.2, 0.4))
    status = SessionStatus(
        "1:1",
        motor_alarms=(loss,),
        motor_alarms_of_flight=(loss,),
        active_alarms=(loss.event,),
        worst_lights={Light.MOTORS: loss.fact},
    )
    reason = Fact(LinkFact.CONNECTION_LOST, cause=None, reopening=False)
    silent = replace(status, no_model_reason=reason)
    StatusLines(screen).show_if_new(silent)
    Console(file=terminal_output, width=100).print(screen.update.call_args.args[0])
    text = " ".join(terminal_output.getvalue().split())
    assert not status.is_flying and text.count("of its thrust") == 1
    other = Fact(MotorWatchFact.MOTOR_LOST_THRUST, Level.BAD, subject="motor 2")
    assert replace(status, active_alarms=(*status.active_alarms, other)).further_alarms == (other,)


def test_an_alarm_is_of_its_flight_and_of_its_boot():
    """A motor loses thrust in the first flight, is sound in the second, and loses thrust again after a reboot.

    The alarm of a flight must not count in the next flight, nor after its landing, nor after a reboot.
    """
    replayed = replay(hovering(rise=150.0))
    (change,) = replayed.stream.motor_alarms.latest
    assert replayed.stream.motor_alarms.weak_since == change.onset_time
    status = replayed.stream.status()
    alarm = status.active_alarms
    assert [fact.subject for fact in alarm] == ["motor 1 (front right)"]
    assert status.overall_judgement.headline.code is MotorWatchFact.MOTOR_LOST_THRUST
    next_flight = hovering(clock=80.0)
    ends = [tenth * len(next_flight) // 40 for tenth in range(29)]
    flight_seconds = []
    for start, end in pairwise(ends):
        status = replay(next_flight[start:end], replayed.stream).stream.status()
        if status.is_flying:
            # From the take-off on, before the first sample of settled flight too.
            flight_seconds.append(status.flight_seconds)
            assert status.active_alarms == () and not status.overall_judgement.headline.is_bad
    assert flight_seconds[0] < 2.0
    assert status.is_flying and len(status.motor_alarms) == 1
    judgement = status.overall_judgement
    assert not judgement.headline.is_bad
    assert judgement.next_step.code is not NextStep.LAND_NOW
    assert judgement.lights[Light.MOTORS].code is not MotorWatchFact.MOTOR_LOST_THRUST
    # Nor is it one after the landing.
    replayed = replay(next_flight[7 * len(next_flight) // 10 :], replayed.stream)
    status = replayed.stream.status()
    assert not status.is_flying and status.active_alarms == ()
    light = status.overall_judgement.lights[Light.MOTORS]
    assert light.code is not MotorWatchFact.MOTOR_LOST_THRUST
    # The clock begins again; frames with the bytes of former ones would count as their copies.
    rebooted = hovering(rise=150.0, start=2.9)
    replay(rebooted[:130], replayed.stream)
    assert replayed.stream.status().active_alarms == ()
    # The reference of the former boot, which has another clock, is none of this one.
    assert replayed.stream.motor_alarms.reason_not_watched(5.0, is_flying=True) is not None
    status = replay(rebooted[130:], replayed.stream).stream.status()
    assert [one.boot for one in status.motor_alarms] == [0, 1] and status.active_alarms != alarm
    assert status.active_alarms[0].figures["reason"].figures["boot"] == 1


@mark.parametrize("mask", [0, param(128, marks=mark.in_full)])
def test_a_vehicle_that_does_not_do_what_is_asked_names_no_motor(mask):
    """From 20 s on half a radian of roll is asked for, or, with the attitude masked, nothing."""
    setpoint = {"type_mask": mask, "q": [np.cos(0.25), np.sin(0.25), 0.0, 0.0]}
    targets = [
        (time, message("ATTITUDE_TARGET", time_boot_ms=round(1e3 * time), **setpoint))
        for time in np.arange(20.0, 38.0).tolist()
    ]
    frames = by_time(hovering(rise=150.0, end=36.0), targets)
    replayed = replay(frames)
    if mask:
        assert len(replayed.stream.status().motor_alarms) == 1
    else:
        assert len(replayed.stream.status().motor_alarms) == 0
    if mask:
        assert len(motor_alarms(Signals(offline([frame for _, frame in frames])))) == 1
    else:
        assert len(motor_alarms(Signals(offline([frame for _, frame in frames])))) == 0


def test_no_motor_is_weak_before_a_loss():
    assert MotorAlarms().weak_since is None


@fixture(scope="module")
def fading(tmp_path_factory, coarse_physics):
    """A quadrotor one of whose motors loses two thirds of its thrust from 12 s after arming on, in 20 s."""
    wind = (TurbulentWind(kind="dryden", speed=3.0, direction=83.0),)
    mishap = MotorFade(kind="motor_fade", start=12.0, motor=3, seconds=20.0, thrust=0.35)
    vehicle = VehicleSpec(parameters={"SCHED_LOOP_RATE": 100.0})
    stream = StreamSpec(autopilot="ardupilot", rate=25.0, instruments=True)
    scenario = Scenario(
        duration=36.0,
        height=8.0,
        seed=4,
        vehicle=vehicle,
        wind=wind,
        stream=stream,
        mishap=mishap,
    )
    path = tmp_path_factory.mktemp("fading") / "flight.tlog"
    write_log(path, scenario, fly(scenario))
    return path


@mark.in_full
def test_a_motor_that_fades_is_reported_early_and_its_light_follows_the_newest_estimate(fading):
    """A motor loses its thrust slowly.

    The alarm must come early, repeated only after large growth, while the light always has the latest estimate.
    """
    stream = LiveStream()
    alarms = []
    rises = []
    judging_time = 0.0
    for stamp, frame in read_stream(fading).stamped_frames():
        stream.feed(stamp / 1e6, frame)
        for event in stream.drain_events():
            reason = event.fact.figures.get("reason")
            if (
                event.fact.code is SessionFact.ALARM
                and reason.code is MotorWatchFact.MOTOR_LOST_THRUST
            ):
                alarms.append((stream.now, reason))
        if alarms and stream.now > judging_time + 0.5:
            judging_time = stream.now
            light = stream.status().overall_judgement.lights[Light.MOTORS]
            if light.code is MotorWatchFact.MOTOR_LOST_THRUST:
                rises.append(light.figures["rise"])
    found_time, first = alarms[0]
    # It fades from 14 s of the boot clock on. The sequential test alone finds it two seconds later.
    assert found_time < 28.5
    assert {reason.subject for _, reason in alarms} == {"motor 3 (front left)"}
    # A loss that grows is reported again only once it has grown by half.
    reported = [reason.figures["rise"] for _, reason in alarms]
    assert all(later >= 1.5 * earlier for earlier, later in pairwise(reported))
    assert rises == sorted(rises) and rises[-1] > reported[-1]
    [change] = stream.status().motor_alarms
    assert change.onset_time == first.time


def noisy_commands(rises):
    """Commands of four motors around 0.5, ten times a second, of which each rises by its column of ``rises``."""
    noise = np.random.default_rng(1).normal(0.0, 0.003, (len(rises), 4))
    return (0.5 + noise + rises).tolist()


@mark.parametrize("is_wind", [True, False], ids=["wind", "load"])
def test_a_shift_of_the_trims_is_reported_in_flight_only_if_lean_does_not_explain_it(is_wind):
    """At 30 s the pitch trim shifts for good: the vehicle leans against a fresh wind, or its load has shifted."""
    time = np.arange(600) / 10
    gusts = np.random.default_rng(2).normal(0.0, 0.02, (15, 2))
    is_after = time >= 30.0
    lean = np.repeat(gusts, 40, axis=0) + np.outer(0.15 * is_wind * is_after, [0.0, 1.0])
    trim = 0.15 * lean[:, 1] + 0.025 * (not is_wind) * is_after
    commands = noisy_commands(np.outer(trim, [1.0, -1.0, 1.0, -1.0]))
    scale = partial_record(OutputScale, low=0.0, high=1.0)
    motors = partial_record(MotorOutputs, geometry=geometry(), scale=scale)
    alarms = MotorAlarms()
    alarms.begin_flight(0.0, 0)
    facts = []
    for sample in zip(time.tolist(), commands, lean.tolist(), strict=True):
        seconds, sample_commands, sample_lean = sample
        facts += alarms.add_sample(seconds, 0, motors, sample_commands, 0.0, sample_lean)
    # The sequential test finds it in either case.
    [change] = alarms._detector.alarms
    assert change.motor is None and change.onset_time == approx(30.0, abs=1.5)
    assert facts == ([] if is_wind else [change.event])
    assert alarms.changes_in_latest_flight == (() if is_wind else (change,))
    # Without the flight after it nothing shows more than the lean explains.
    assert alarms.withdraw_since(32.0) == () and alarms.changes_in_latest_flight == ()


def test_the_alarm_of_a_weak_motor_is_not_changed_by_motors_that_run_down_on_the_ground():
    """A motor is weak from 20 s on; at 40 s the vehicle touches down, and the others run down further than this one."""
    time = np.arange(420) / 10
    weak_motor = np.interp(
        time, [20.0, 20.1, 40.0, 40.1, 40.5, 41.0], [0.0, 0.37, 0.37, 0.2, 0.15, -0.13]
    )
    other_motors = np.interp(time, [40.0, 40.2, 40.5], [0.07, -0.2, -0.32])
    rises = np.stack([weak_motor, other_motors, other_motors, other_motors], axis=1)
    scale = partial_record(OutputScale, low=0.0, high=1.0)
    motors = partial_record(MotorOutputs, geometry=geometry(), scale=scale)
    alarms = MotorAlarms()
    alarms.begin_flight(0.0, 0)
    for seconds, commands in zip(time.tolist(), noisy_commands(rises), strict=True):
        alarms.add_sample(seconds, 0, motors, commands, 0.0)
    [change] = alarms.latest
    assert change.is_weak and change.onset_time == approx(20.0, abs=1.0)
    assert alarms.active == (change.event,)


def test_a_slow_loss_is_over_when_the_motor_gives_its_thrust_again_and_not_before():
    """The flight before the loss is out of the two minutes that are searched when the motor recovers."""
    watch = GradualLossWatch(geometry(), 0)
    time = np.arange(2600) / 10
    fade = 0.2 * np.clip((time - 8.0) / 10.0, 0.0, 1.0) * (time < 200.0)
    rises = np.outer(fade, [1.0, 0.0, 0.0, 0.0])
    weak_until = 0.0
    for seconds, commands in zip(time.tolist(), noisy_commands(rises), strict=True):
        watch.add_sample(seconds, commands)
        if watch.loss is not None:
            weak_until = seconds
            assert watch.loss.motor == 1
    assert 200.0 < weak_until < 250.0


def alarms_of_slow_loss(time, more_rises=0.0):
    """Alarms of a flight in which motor 1 fades from 8 to 68 s, at some times, and what was reported from 80 s on."""
    scale = partial_record(OutputScale, low=0.0, high=1.0)
    motors = partial_record(MotorOutputs, geometry=geometry(), scale=scale)
    alarms = MotorAlarms()
    reports = []
    fade = 0.2 * np.clip((time - 8.0) / 60.0, 0.0, 1.0)
    rises = np.outer(fade, [1.0, 0.0, 0.0, 0.0]) + more_rises
    for seconds, commands in zip(time.tolist(), noisy_commands(rises), strict=True):
        facts = alarms.add_sample(seconds, 0, motors, commands, 0.0)
        if seconds >= 80.0:
            reports += facts
    return alarms, reports


def test_a_slow_loss_of_which_a_part_was_found_as_sudden_has_its_whole_size():
    """Little noise: the sequential test names the motor before the search of the whole flight does."""
    time = np.arange(700) / 10
    scale = partial_record(OutputScale, low=0.0, high=1.0)
    motors = partial_record(MotorOutputs, geometry=geometry(), scale=scale)
    alarms = MotorAlarms()
    rises = np.outer(0.2 * np.clip((time - 20.0) / 20.0, 0.0, 1.0), [1.0, 0.0, 0.0, 0.0])
    first_rises = []
    for seconds, commands in zip(time.tolist(), noisy_commands(rises), strict=True):
        alarms.add_sample(seconds, 0, motors, commands, 0.0, (0.0, 0.0))
        first_rises += [loss.figures["rise"] for loss in thrust_losses(alarms.latest)][:1]
    # 40 % of the mean command before the loss, of which a tenth was found first.
    assert first_rises[0] < 0.12
    (loss,) = thrust_losses(alarms.latest)
    assert loss.figures["rise"] == approx(0.4, abs=0.03)
    (active,) = alarms.active
    assert active.figures["reason"].figures["rise"] == loss.figures["rise"]


def test_a_log_has_the_whole_size_of_such_a_loss_too():
    """The command of motor 1 rises by 20 % from 20 s to 40 s.

    The detector of sudden losses finds part of that, the detector of slow losses all of it.
    """
    time = np.arange(700) / 10
    rises = np.outer(0.2 * np.clip((time - 20.0) / 20.0, 0.0, 1.0), [1.0, 0.0, 0.0, 0.0])
    commands = np.array(noisy_commands(rises))
    detector = MotorLossDetector(geometry())
    for seconds, command in zip(time.tolist(), commands, strict=True):
        detector.update(seconds, command)
    part, *_, newest = detector.alarms
    assert part.size < 0.1 and newest.size > 0.3
    signals = Signals(Hover().telemetry())
    series = TimeSeries(time, np.zeros(len(time), int), commands)
    motors = partial_record(MotorOutputs, geometry=geometry())

    def slow_losses(sudden_changes):
        return _gradual_losses(signals, motors, series, 0, [(0.0, 70.0)], sudden_changes)

    (loss,) = slow_losses([part])
    assert loss.size == approx(0.4, abs=0.03)
    # What was found as sudden is nearly all of it, or is of another motor, or is over.
    assert slow_losses([newest]) == []
    assert slow_losses([part._replace(motor=2, name="motor 2 (rear left)")]) == []
    assert slow_losses([part, part._replace(size=0.0, loss=())]) == []


def test_a_sudden_loss_is_no_slow_one_and_its_end_no_slow_loss_of_the_others():
    time = np.arange(1400) / 10
    scale = partial_record(OutputScale, low=0.0, high=1.0)
    motors = partial_record(MotorOutputs, geometry=geometry(), scale=scale)
    alarms = MotorAlarms()
    is_weak = (time > 20.0) & (time < 70.0)
    rises = np.outer(0.15 * is_weak, [1.0, 0.0, 0.0, 0.0])
    for seconds, commands in zip(time.tolist(), noisy_commands(rises), strict=True):
        alarms.add_sample(seconds, 0, motors, commands, 0.0, (0.0, 0.0))
    assert [(change.motor, change.is_weak) for change in alarms.latest] == [(1, True), (1, False)]


def test_a_gap_after_a_slow_loss_is_no_recovery():
    time = np.arange(1000) / 10
    alarms, reports = alarms_of_slow_loss(time[(time < 75.0) | (time > 82.0)])
    assert not reports
    assert [loss.subject for loss in thrust_losses(alarms.latest)] == ["motor 1 (front right)"]
    assert [alarm.code for alarm in alarms.active] == [SessionFact.ALARM]


def test_a_sudden_loss_and_the_slow_one_before_it_are_both_active():
    time = np.arange(900) / 10
    alarms, _ = alarms_of_slow_loss(time, np.outer(time > 80.0, [0.0, 0.15, 0.0, 0.0]))
    motors = {alarm.subject for alarm in alarms.active}
    assert motors == {"motor 1 (front right)", "motor 2 (rear left)"}


@dataclass(frozen=True)
class Shifted(Hover):
    """The front motors, 1 and 3, are commanded by 20 µs more than the rear ones from 31 s on, as for a shifted load."""

    def motors(self, t):
        outputs = super().motors(t)
        is_shifted = (t >= 31.0)[:, None] & (outputs > 1000)
        return outputs + is_shifted * np.array([20.0, -20.0, 20.0, -20.0])


@mark.slow
def test_a_shift_shortly_before_the_descent_is_found_in_the_log(monkeypatch):
    """It must last for seconds, which end in the descent; a live session knows only later that the vehicle lands.

    The hover does not lean, so that the test by the lean, which has its own tests, would leave the cause open.
    """
    monkeypatch.setattr("mavdem.motors.lean_check.is_beyond_lean", lambda *flight: True)
    hover = Shifted(hovering=28.0)
    frames = Flight(hover, attitude=12.0, motors=12.0).frames(3.0, hover.end)
    signals = Signals(offline([frame for _, frame in frames]))
    [change] = motor_alarms(signals)
    [(_, settled_end)] = settled_intervals(signals, 0)
    assert change.onset_time < settled_end <= change.time
    assert change.fact.code is MotorWatchFact.STEADY_TORQUE_CHANGED
    assert change.onset_time == approx(31.0, abs=1.0)
