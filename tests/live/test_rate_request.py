"""Rates are asked for and given back: what is sent is read by pymavlink, and what was there is never guessed as 0."""

from collections import Counter

import numpy as np
from known_gains import ARDUPILOT, PX4
from pymavlink.dialects.v20 import all as dialect
from pytest import mark

from mavdem.assessment.lights.wind import lean_limit
from mavdem.facts import Fact
from mavdem.facts.session import RateFact
from mavdem.ingest.mavlink.payloads import FrameSender
from mavdem.ingest.motors import control_parameters, lean_limit_parameters, motor_parameters
from mavdem.ingest.vocabulary import CONTROL_PARAMETERS
from mavdem.live.clock_speed import ClockSpeed
from mavdem.live.link import SILENCE_SECONDS
from mavdem.live.messages import Message
from mavdem.live.rate_request import (
    GET_INTERVAL,
    REPEAT_SECONDS,
    SET_INTERVAL,
    STOPPED,
    ArrivalRates,
    RateRequest,
    greeting,
)

VEHICLE = FrameSender(7, 1)
US = (255, 190)
NO_VIBRATION = Fact(RateFact.MESSAGE_ABSENT, subject="VIBRATION")


def reply(name, first, second, to=US):
    """Returns a reply of the vehicle with two fields, addressed to this ground station."""
    return Message(name, 0.0, 0.0, (first, second, *(to if name == "COMMAND_ACK" else ())))


def request_of(rate, *messages):
    """Returns a request for a rate, Hz, of messages with some ids; ATTITUDE and SERVO_OUTPUT_RAW by default."""
    return RateRequest(VEHICLE, rate, messages or (30, 36), secondary_messages=())


def commands_in(frames):
    """Command and first two parameters of each, to the vehicle."""
    parser = dialect.MAVLink(None)
    messages = [message for frame in frames for message in parser.parse_buffer(frame)]
    assert [message.get_type() for message in messages] == ["COMMAND_LONG"] * len(frames)
    assert all((each.target_system, each.target_component) == (7, 1) for each in messages)
    assert all(each.get_srcSystem() == 255 for each in messages)
    return [(each.command, int(each.param1), each.param2) for each in messages]


def test_a_greeting_is_the_heartbeat_of_a_ground_station_that_nobody_misses():
    (beat,) = dialect.MAVLink(None).parse_buffer(greeting())
    said_of_it = beat.get_srcSystem(), beat.type, beat.autopilot, beat.mavlink_version
    assert said_of_it == (254, dialect.MAV_TYPE_GCS, dialect.MAV_AUTOPILOT_INVALID, 3)


def test_a_refused_rate_is_reported_and_not_requested_again():
    """One vehicle refuses the rate of a message, another sends 50 Hz where 400 Hz were requested.

    Each is reported once.
    """
    request = request_of(50.0, 375)
    request.frames_due(0.0, None)
    request.add_reply(reply("MESSAGE_INTERVAL", 375, STOPPED))
    request.frames_due(0.1, {})
    request.add_reply(reply("COMMAND_ACK", SET_INTERVAL, 4))
    assert [request.frames_due(float(second), {}) for second in range(1, 60)] == [[]] * 59
    assert request.restoring_frames() == []
    refusal = Fact(RateFact.RATE_REFUSED, subject="ACTUATOR_OUTPUT_STATUS", result=4)
    assert request.events == [refusal]
    slow = request_of(400.0, 30)
    sent = [slow.frames_due(float(second), {30: 50.0}) for second in range(60)]
    assert len([frames for frames in sent if frames]) == 6, "three queries, three settings"
    below = Fact(RateFact.RATE_BELOW_ASKED, subject="ATTITUDE", rate=50.0, needed_rate=400.0)
    assert slow.events == [below]
    assert [slow.frames_due(float(second), {30: 36.0}) for second in range(60, 90)] == [[]] * 30


@mark.parametrize("is_refused", [True, False])
def test_a_message_of_lesser_use_that_never_comes_is_reported_once(is_refused):
    """VIBRATION (message 241) is requested in vain. If the vehicle did not refuse it, it may still come later."""
    request = RateRequest(VEHICLE, 50.0, (), secondary_messages=(241,))
    assert request.absent_messages == frozenset(), "it was not requested yet"
    for second in range(60):
        if second == 10:
            # Nobody need be advised to request it, though it may still come.
            assert request.absent_messages == {"VIBRATION"}
        frames = request.frames_due(float(second), {})
        if is_refused and [
            message for message in commands_in(frames) if message[0] == SET_INTERVAL
        ]:
            request.add_reply(reply("COMMAND_ACK", SET_INTERVAL, 4))
    assert request.drain_events() == [NO_VIBRATION]
    assert request.absent_messages == {"VIBRATION"}
    request.frames_due(61.0, {241: 4.0})
    assert request.absent_messages == (request.absent_messages if is_refused else frozenset())


@mark.parametrize("interval", [0, 5, -5, -(2**31)])
def test_an_interval_that_cannot_be_is_never_restored(interval):
    request = request_of(50.0)
    for second in range(8):
        request.frames_due(float(second), {30: 4.0})
        request.add_reply(reply("MESSAGE_INTERVAL", 30, interval))
    assert commands_in(request.restoring_frames()) == [
        (SET_INTERVAL, 30, 250_000),
        (SET_INTERVAL, 36, STOPPED),
    ], "as measured"


def test_answers_to_others_and_to_other_commands_are_not_ours():
    request = request_of(100.0, 30)
    for second in range(9):
        request.frames_due(float(second), {30: 4.0})
    assert request.restoring_frames()
    others = (SET_INTERVAL, (254, 190)), (SET_INTERVAL, (255, 1)), (400, US), (GET_INTERVAL, US)
    for command, to in others:
        request.add_reply(reply("COMMAND_ACK", command, 0, to))
        assert request.restoring_frames(), "it is still awaited"
    # Older vehicles name no addressee.
    request.add_reply(reply("COMMAND_ACK", SET_INTERVAL, 0, (0, 0)))
    assert request.restoring_frames() == []


class Vehicle:
    """Sends at rates of its own until asked for others, which it forgets when it reboots; time goes by in ``run``."""

    def __init__(self, request, knows=(30, 36, 83, 245, 32, 74), **rates):
        self.request, self.arrivals, self.knows = request, ArrivalRates(), knows
        self.usual = {int(name[1:]): rate for name, rate in rates.items()}
        self.rates = dict(self.usual)
        self.now = 0.0
        self.sent = []
        self.counts = {0: 0.0}
        self.silent = False
        self.clock_speed = 1.0
        self.vehicle_time = 0.0
        self.measured_speed = ClockSpeed(lambda fact: None)

    def run(self, seconds, back_every=0.0):
        """Lets so many seconds go by; another ground station may set its own rates again now and then."""
        for _ in range(round(10 * seconds)):
            self.now += 0.1
            if back_every and self.now % back_every < 0.1:
                self.rates = dict(self.usual)
            for kind, rate in {0: 1.0, **self.rates}.items():
                self.counts[kind] = self.counts.get(kind, 0.0) + self.sent_in_a_step(rate)
            counts = {kind: int(count) for kind, count in self.counts.items()}
            self.vehicle_time += 0.1 * self.clock_speed
            self.measured_speed.update(self.now, self.vehicle_time)
            elapsed = self.measured_speed.elapsed_seconds(self.now)
            rates = self.arrivals.update(self.now, counts, elapsed)
            if not self.silent:
                for command, kind, interval in commands_in(
                    self.request.frames_due(self.now, rates)
                ):
                    self.sent.append((round(self.now, 1), command, kind))
                    self.answer(command, kind, interval)

    def sent_in_a_step(self, rate):
        """How many messages of a rate by its own clock come in 0.1 s of this computer's."""
        return 0.0 if self.silent else 0.1 * self.clock_speed * rate

    def settings(self):
        """How often an interval was set."""
        return sum(command == SET_INTERVAL for _, command, _ in self.sent)

    def restarts_after(self, silence):
        """It sends nothing for so many seconds; the session notices a long silence."""
        self.silent = True
        self.run(silence)
        self.silent = False
        if silence > SILENCE_SECONDS:
            self.arrivals = ArrivalRates()
            self.request.allow_new_requests()

    def answer(self, command, kind, interval):
        if command == GET_INTERVAL:
            rate = self.rates.get(kind, 0.0)
            self.request.add_reply(
                reply("MESSAGE_INTERVAL", kind, round(1e6 / rate) if rate else STOPPED)
            )
            return
        if kind in self.knows:
            self.rates[kind] = 1e6 / interval if interval > 0 else 0.0
        self.request.add_reply(reply("COMMAND_ACK", SET_INTERVAL, 0 if kind in self.knows else 4))

    def give_back(self):
        for command, kind, interval in commands_in(self.request.restoring_frames()):
            self.answer(command, kind, interval)


@mark.parametrize("silence", [0.0, 6.0])
def test_after_a_reboot_that_forgets_rates_they_are_asked_for_again(silence):
    vehicle = Vehicle(RateRequest(VEHICLE, 100.0), _30=4.0)
    vehicle.run(20.0)
    vehicle.rates = {}
    vehicle.restarts_after(silence)
    vehicle.run(15.0)
    assert vehicle.rates == {30: 100.0, 36: 100.0, 83: 50.0, 245: 4.0, 32: 4.0, 74: 4.0}
    vehicle.give_back()
    assert vehicle.rates == {30: 4.0, 36: 0.0, 83: 0.0, 245: 0.0, 32: 0.0, 74: 0.0}


def test_landing_messages_are_requested_only_where_they_do_not_come():
    """LOCAL_POSITION_NED or VFR_HUD shows the climb.

    The vehicle sends VFR_HUD (74), so that only the others are requested.
    """
    vehicle = Vehicle(RateRequest(VEHICLE, 100.0), knows=(30, 36, 74), _30=4.0, _36=2.0, _74=10.0)
    vehicle.run(30.0)
    assert vehicle.rates == {30: 100.0, 36: 100.0, 74: 10.0}, "what is faster stays as it is"
    requested = {kind for _, command, kind in vehicle.sent if command == SET_INTERVAL}
    vibration = 241
    assert requested == {30, 36, 83, 245, 32, vibration}
    absent = {fact.subject for fact in vehicle.request.events}
    assert absent == {"ATTITUDE_TARGET", "EXTENDED_SYS_STATE", "LOCAL_POSITION_NED", "VIBRATION"}
    vehicle.give_back()
    assert vehicle.rates == {30: 4.0, 36: 2.0, 74: 10.0}


@mark.slow
def test_rates_that_another_ground_station_sets_back_are_requested_again():
    """Another ground station sets the rates back every 15 s.

    They are requested again, but not more often than every ``REPEAT_SECONDS``.
    """
    vehicle = Vehicle(RateRequest(VEHICLE, 100.0), _30=4.0, _36=4.0, _74=4.0, _245=4.0, _32=4.0)
    vehicle.run(300.0, back_every=15.0)
    requested = [at for at, command, kind in vehicle.sent if (command, kind) == (SET_INTERVAL, 30)]
    assert 19 <= len(requested) <= 21 and min(np.diff(requested)) >= REPEAT_SECONDS
    assert len(vehicle.request.events) < 10, "nobody hears of each time"
    assert vehicle.request.events.count(Fact(RateFact.RATES_CONTESTED)) == 1
    vehicle.rates = {}
    vehicle.run(15.0)
    assert vehicle.rates[30] == 100.0, "what stops was forgotten in a reboot"
    vehicle.rates = dict(vehicle.usual)
    vehicle.run(120.0)
    assert vehicle.rates[30] == 100.0, "once it gives in, rates stay"
    vehicle.rates = {}
    vehicle.restarts_after(6.0)
    vehicle.run(1.0)
    assert vehicle.rates[30] == vehicle.rates[36] == 100.0, "a reboot needs no pause"


@mark.slow
def test_rates_are_by_the_clock_of_a_simulator_that_falls_behind():
    vehicle = Vehicle(RateRequest(VEHICLE, 100.0), _30=4.0, _36=4.0)
    for vehicle.clock_speed in (0.1, 1.0, 0.3):
        vehicle.run(60.0)
    assert vehicle.rates == {30: 100.0, 36: 100.0, 83: 50.0, 245: 4.0, 32: 4.0, 74: 4.0}
    # Two of motion, the setpoint, three of the state of flight, and the vibration, which this vehicle does not know.
    assert vehicle.settings() == 7 and vehicle.request.events == [NO_VIBRATION]


def test_rates_that_are_not_measured_yet_are_not_requested_again():
    vehicle = Vehicle(RateRequest(VEHICLE, 100.0), _30=4.0, _36=4.0)
    for _ in range(4):
        vehicle.run(20.0)
        # This computer was busy, so that the measurement begins anew.
        vehicle.arrivals = ArrivalRates()
    # Two of motion, the setpoint, three of the state of flight, and the vibration, which this vehicle does not know.
    assert vehicle.settings() == 7 and vehicle.request.events == [NO_VIBRATION]


def test_a_rate_that_was_never_reached_is_not_reported_as_lost():
    """100 Hz were requested and 60 Hz reached; a later fall to 30 Hz is reported as one from 60 Hz."""
    request = request_of(100.0, 30)
    for second in range(60):
        request.frames_due(float(second), {30: 60.0 if second < 40 else 30.0})
    below, fall, *_ = request.events
    assert (below.code, below.figures["rate"]) == (RateFact.RATE_BELOW_ASKED, 60.0)
    assert (fall.code, fall.figures["former_rate"]) == (RateFact.RATE_FELL, 60.0)


@mark.parametrize("autopilot, gains", [("ARDUPILOTMEGA", ARDUPILOT), ("PX4", PX4)])
def test_a_recording_has_the_parameters_that_the_loops_need(autopilot, gains):
    requested = {*motor_parameters(autopilot), *control_parameters(autopilot)}
    assert gains.keys() - {"CA_AIRFRAME"} <= requested
    assert len(control_parameters(autopilot)) <= 31
    assert lean_limit(dict.fromkeys(lean_limit_parameters(autopilot), 45.0))
    assert all(CONTROL_PARAMETERS.match(name) for name in control_parameters(autopilot))


def test_parameters_of_the_motors_are_asked_for_one_by_one_until_they_come():
    """Each parameter arrives after the third request only."""
    names = motor_parameters("PX4")
    request = RateRequest(VEHICLE, 100.0, (30,), (), names)
    request._intervals.clear()
    known_parameters = {}
    request_counts = Counter()
    for number in range(150):
        frames = request.frames_due(0.25 * number, None, known_parameters)
        assert len(frames) <= 1 and not request.frames_due(
            0.25 * number + 0.1, None, known_parameters
        )
        for message in dialect.MAVLink(None).parse_buffer(b"".join(frames)) or []:
            assert (message.target_system, message.target_component) == VEHICLE
            name = message.param_id.encode()
            request_counts[name] += 1
            if request_counts[name] == 3:  # The requests before, or their replies, are lost.
                known_parameters[name] = Message("PARAM_VALUE", 0.0, 0.0, (name, 1.0, 9))
    assert set(request_counts.values()) == {3} and request_counts.keys() == {
        name.encode() for name in names
    }
    assert request.frames_due(99.0, None, known_parameters) == []


def test_contested_rates_are_reported_once_although_a_second_message_is_contested_later():
    """Another ground station sets ATTITUDE back every 30 s, and from 300 s on SERVO_OUTPUT_RAW too."""
    request = request_of(50.0)
    for second in range(600):
        is_set_back = second % 30 < 10
        first_rate = 4.0 if is_set_back else 50.0
        second_rate = 4.0 if is_set_back and not 10 <= second < 300 else 50.0
        request.frames_due(float(second), {30: first_rate, 36: second_rate})
        request.add_reply(reply("COMMAND_ACK", SET_INTERVAL, 0))
    fallen = {fact.subject for fact in request.events if fact.code is RateFact.RATE_FELL}
    assert fallen == {"ATTITUDE", "SERVO_OUTPUT_RAW"}
    assert request.events.count(Fact(RateFact.RATES_CONTESTED)) == 1
