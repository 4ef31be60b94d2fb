"""Requests of a ground station are executed and answered; other messages change nothing."""

from made_up_motion import made_up_motion
from pymavlink.dialects.v20 import all as dialect
from pytest import approx, mark

from sitl_scenarios.mavlink.commands import CommandHandler, addressed_messages
from sitl_scenarios.mavlink.transmitter import Transmitter
from sitl_scenarios.scenario import Scenario, StreamSpec

CYCLES = {"px4": 0.004, "ardupilot": 0.0025}
GROUND = dialect.MAVLink(None, srcSystem=255, srcComponent=190)
GAINS = ("MC_ROLLRATE_P", "ATC_RAT_RLL_P")
each_autopilot = mark.parametrize("autopilot", CYCLES)


class Vehicle:
    """A simulated vehicle that replies to commands; it also stands for the simulation, which is armed and tuned."""

    def __init__(self, autopilot="px4", armable=True):
        self.transmitter = Transmitter(Scenario(stream=StreamSpec(autopilot=autopilot)))
        self.commands = CommandHandler(self.transmitter, self)
        self.requests = []
        self._armable = armable
        self._motion = made_up_motion(autopilot=autopilot)
        self._cycle = 1
        self.fly(1.0)

    def set_armed(self, armed, force=False):
        self.requests.append((armed, force))
        return self._armable or force

    def set_parameter(self, name, value):
        """Sets a gain as the controller does, unless it is negative."""
        self.requests.append((name, value))
        return name in GAINS and value >= 0

    def fly(self, seconds):
        """Flies on, and returns the messages of these seconds by name."""
        cycles = slice(
            self._cycle, self._cycle + round(seconds / CYCLES[self.transmitter.autopilot.name])
        )
        self._cycle = cycles.stop
        sent = b"".join(frame for _, frame in self.transmitter.send(self._motion[cycles]))
        messages = {}
        for message in dialect.MAVLink(None).parse_buffer(sent) or []:
            messages.setdefault(message.get_type(), []).append(message)
        return messages

    def receive(self, message):
        for request in addressed_messages(bytes(message.pack(GROUND)), 1, 1):
            self.commands.handle(request)

    def command(self, number, *parameters, seconds=1.0):
        """Sends a command, and returns its result and the messages of the second after it."""
        parameters = (*parameters, *[0.0] * (7 - len(parameters)))
        self.receive(dialect.MAVLink_command_long_message(1, 1, number, 0, *parameters))
        messages = self.fly(seconds)
        (ack,) = messages["COMMAND_ACK"]
        assert (ack.command, ack.target_system, ack.target_component) == (number, 255, 190)
        return ack.result, messages


@mark.slow
@each_autopilot
def test_intervals_are_set_at_once_reported_and_restored(autopilot):
    vehicle = Vehicle(autopilot)

    def attitudes_with_interval(interval):
        """Sets the interval of ATTITUDE, µs, and returns how many come in a second."""
        result, messages = vehicle.command(511, 30, interval)
        assert result == 0
        return len(messages.get("ATTITUDE", ()))

    def reported_interval(number):
        result, messages = vehicle.command(510, number)
        (report,) = messages["MESSAGE_INTERVAL"]
        assert (result, report.message_id) == (0, number)
        return report.interval_us

    assert attitudes_with_interval(20_000) == approx(50, abs=1)
    assert reported_interval(30) == 20_000
    # −1 stops the message.
    assert attitudes_with_interval(-1) == 0
    assert reported_interval(30) == -1
    attitudes_with_interval(1e30)
    assert reported_interval(30) == 2**31 - 1
    # 0 restores the default rate, and no message is faster than the loop of the autopilot.
    loop_rate = {"px4": 250, "ardupilot": 400}[autopilot]
    for interval, rate in ((0, 100), (1, loop_rate)):
        assert attitudes_with_interval(interval) == approx(rate, abs=1)
    unknown_messages = [(number, 10_000) for number in (77, 999_999, 1e30, float("nan"))]
    for parameters in (*unknown_messages, (30, float("nan"))):
        assert vehicle.command(511, *parameters)[0] == 2
    assert reported_interval(77) == 0


@mark.slow
@each_autopilot
def test_arming_is_passed_on_and_refused_in_the_air(autopilot):
    vehicle = Vehicle(autopilot)
    assert vehicle.command(400, 1)[0] == 0
    assert vehicle.command(400, 0)[0] == 0
    assert vehicle.requests == [(True, False), (False, False)]
    vehicle = Vehicle(autopilot, armable=False)
    assert vehicle.command(400, 0)[0] == 4
    for parameters, result in (((0, 21196), 0), ((1,), 4), ((7,), 2), ((float("inf"),), 2)):
        assert vehicle.command(400, *parameters)[0] == result


@each_autopilot
def test_parameters_are_listed_and_read(autopilot):
    vehicle = Vehicle(autopilot)
    vehicle.receive(dialect.MAVLink_param_request_list_message(1, 1))
    listed = vehicle.fly(1.0)["PARAM_VALUE"]
    assert [parameter.param_index for parameter in listed] == list(range(listed[0].param_count))
    # An unknown parameter is not answered.
    for name in (listed[3].param_id.encode(), b"NOTHING"):
        vehicle.receive(dialect.MAVLink_param_request_read_message(1, 1, name, -1))
    (parameter,) = vehicle.fly(0.1)["PARAM_VALUE"]
    assert parameter.param_id == listed[3].param_id
    assert parameter.param_value == listed[3].param_value


@each_autopilot
def test_a_parameter_is_set_and_its_value_is_the_answer(autopilot):
    vehicle = Vehicle(autopilot)
    gain = GAINS[0 if autopilot == "px4" else 1]

    def values_after_setting(name, value):
        vehicle.receive(dialect.MAVLink_param_set_message(1, 1, name.encode(), value, 9))
        replies = vehicle.fly(0.1).get("PARAM_VALUE", ())
        return [reply.param_value for reply in replies]

    assert values_after_setting(gain, 0.25) == [0.25]
    # A value that the controller refuses is not set.
    assert values_after_setting(gain, -1.0) == [0.25]
    assert values_after_setting("NOTHING", 1.0) == []
    vehicle.receive(dialect.MAVLink_param_request_read_message(1, 1, gain.encode(), -1))
    assert vehicle.fly(0.1)["PARAM_VALUE"][0].param_value == 0.25


@each_autopilot
def test_ground_stations_find_an_ordinary_vehicle_without_mission_and_logs(autopilot):
    vehicle = Vehicle(autopilot)
    vehicle.receive(dialect.MAVLink_mission_request_list_message(1, 1, 0))
    vehicle.receive(dialect.MAVLink_mission_count_message(1, 1, 3, 0))
    vehicle.receive(dialect.MAVLink_log_request_list_message(1, 1, 0, 0xFFFF))
    vehicle.receive(dialect.MAVLink_timesync_message(0, 12345))
    messages = vehicle.fly(0.1)
    assert messages["MISSION_COUNT"][0].count == 0
    assert messages["MISSION_ACK"][0].type == dialect.MAV_MISSION_UNSUPPORTED
    assert messages["LOG_ENTRY"][0].num_logs == 0
    (answer,) = messages["TIMESYNC"]
    assert answer.ts1 == 12345 and answer.tc1 == approx(1e9, rel=0.2)


@mark.slow
@each_autopilot
def test_a_message_is_sent_once_on_request(autopilot):
    vehicle = Vehicle(autopilot)
    assert len(vehicle.command(512, 148)[1]["AUTOPILOT_VERSION"]) == 1
    assert len(vehicle.command(520, 1)[1]["AUTOPILOT_VERSION"]) == 1
    vehicle.command(511, 30, -1)
    assert len(vehicle.command(512, 30)[1]["ATTITUDE"]) == 1
    assert "ATTITUDE" not in vehicle.fly(1.0)
    assert vehicle.command(512, 77)[0] == 2


@mark.slow
def test_ardupilot_obeys_requests_of_data_streams_and_px4_ignores_them():
    def message_counts(vehicle, *streams):
        """Numbers of messages in two seconds after requests of groups: rate, Hz, and whether to start or stop."""
        for group, rate, on in streams:
            vehicle.receive(dialect.MAVLink_request_data_stream_message(1, 1, group, rate, on))
        messages = vehicle.fly(2.0)
        names = ("ATTITUDE", "SERVO_OUTPUT_RAW", "LOCAL_POSITION_NED")
        return [len(messages.get(name, ())) for name in names]

    vehicle = Vehicle("ardupilot")
    assert message_counts(vehicle, (0, 4, 1)) == approx([8, 8, 8], abs=1)
    assert message_counts(vehicle, (0, 65535, 1))[0] == approx(800, abs=1)
    attitudes, servos, _ = message_counts(vehicle, (10, 50, 1), (3, 50, 0))
    assert attitudes == approx(100, abs=1)
    assert servos == 0
    assert message_counts(Vehicle("px4"), (0, 4, 1))[0] == 200


def test_messages_to_other_systems_or_components_are_ignored():
    targets = {(2, 1): 0, (1, 2): 0, (2, 0): 0, (1, 1): 3, (1, 0): 3, (0, 0): 3}
    for target, count in targets.items():
        message = dialect.MAVLink_command_long_message(*target, 400, *[0] * 8)
        assert len(addressed_messages(bytes(message.pack(GROUND)) * 3, 1, 1)) == count
