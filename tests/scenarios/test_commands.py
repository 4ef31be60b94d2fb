"""What a ground station asks is done and answered, and what is no question changes nothing."""

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
    """A vehicle that answers, and the part of a simulation that can be armed."""

    def __init__(self, autopilot="px4", armable=True):
        self.transmitter = Transmitter(Scenario(stream=StreamSpec(autopilot=autopilot)))
        self.commands = CommandHandler(self.transmitter, self)
        self.asked = []
        self._armable = armable
        self._motion = made_up_motion(autopilot=autopilot)
        self._row = 1
        self.flown(1.0)

    def set_armed(self, armed, force=False):
        self.asked.append((armed, force))
        return self._armable or force

    def set_parameter(self, name, value):
        """The controller's part: a gain is set, unless it is negative."""
        self.asked.append((name, value))
        return name in GAINS and value >= 0

    def flown(self, seconds):
        """Returns the messages of the next seconds, by name."""
        rows = slice(
            self._row, self._row + round(seconds / CYCLES[self.transmitter.autopilot.name])
        )
        self._row = rows.stop
        sent = b"".join(frame for _, frame in self.transmitter.send(self._motion[rows]))
        messages_by_name = {}
        for message in dialect.MAVLink(None).parse_buffer(sent) or []:
            messages_by_name.setdefault(message.get_type(), []).append(message)
        return messages_by_name

    def hears(self, message):
        for one in addressed_messages(bytes(message.pack(GROUND)), 1, 1):
            self.commands.handle(one)

    def command(self, number, *parameters, seconds=1.0):
        """Sends a command, and returns its result and the messages of the second after it."""
        parameters = (*parameters, *[0.0] * (7 - len(parameters)))
        self.hears(dialect.MAVLink_command_long_message(1, 1, number, 0, *parameters))
        messages_by_name = self.flown(seconds)
        (ack,) = messages_by_name["COMMAND_ACK"]
        assert (ack.command, ack.target_system, ack.target_component) == (number, 255, 190)
        return ack.result, messages_by_name


@mark.slow
@each_autopilot
def test_intervals_are_set_at_once_reported_and_restored(autopilot):
    """Commands 511 and 510 set and get the interval of a message. Message 30 is ATTITUDE."""
    vehicle = Vehicle(autopilot)

    def attitudes(interval):
        result, messages_by_name = vehicle.command(511, 30, interval)
        assert result == 0
        return len(messages_by_name.get("ATTITUDE", ()))

    def told(number):
        result, messages_by_name = vehicle.command(510, number)
        (message,) = messages_by_name["MESSAGE_INTERVAL"]
        assert (result, message.message_id) == (0, number)
        return message.interval_us

    assert attitudes(20_000) == approx(50, abs=1) and told(30) == 20_000
    assert attitudes(-1) == 0 and told(30) == -1
    attitudes(1e30)
    assert told(30) == 2**31 - 1
    loop = {"px4": 250, "ardupilot": 400}[autopilot]
    for interval, rate in ((0, 100), (1, loop)):
        assert attitudes(interval) == approx(rate, abs=1)
    wrong = [(number, 10_000) for number in (77, 999_999, 1e30, float("nan"))]
    for parameters in (*wrong, (30, float("nan"))):
        assert vehicle.command(511, *parameters)[0] == 2
    assert told(77) == 0


@mark.slow
@each_autopilot
def test_arming_is_passed_on_and_refused_in_the_air(autopilot):
    """COMPONENT_ARM_DISARM (400): 21196 forces it; results are 0 accepted, 2 denied and 4 failed."""
    vehicle = Vehicle(autopilot)
    assert vehicle.command(400, 1)[0] == 0
    assert vehicle.command(400, 0)[0] == 0
    assert vehicle.asked == [(True, False), (False, False)]
    vehicle = Vehicle(autopilot, armable=False)
    assert vehicle.command(400, 0)[0] == 4
    for parameters, result in (((0, 21196), 0), ((1,), 4), ((7,), 2), ((float("inf"),), 2)):
        assert vehicle.command(400, *parameters)[0] == result


@mark.slow
@each_autopilot
def test_parameters_are_listed_and_read(autopilot):
    vehicle = Vehicle(autopilot)
    vehicle.hears(dialect.MAVLink_param_request_list_message(1, 1))
    listed = vehicle.flown(1.0)["PARAM_VALUE"]
    assert [message.param_index for message in listed] == list(range(listed[0].param_count))
    for name in (listed[3].param_id.encode(), b"NOTHING"):
        vehicle.hears(dialect.MAVLink_param_request_read_message(1, 1, name, -1))
    (read,) = vehicle.flown(0.1)["PARAM_VALUE"]
    assert (read.param_id, read.param_value) == (listed[3].param_id, listed[3].param_value)


@mark.slow
@each_autopilot
def test_a_parameter_is_set_and_its_value_is_the_answer(autopilot):
    """A valid gain is set and confirmed; an invalid one is refused with the present value."""
    vehicle = Vehicle(autopilot)
    gain = GAINS[0 if autopilot == "px4" else 1]

    def answered(name, value):
        vehicle.hears(dialect.MAVLink_param_set_message(1, 1, name.encode(), value, 9))
        return [message.param_value for message in vehicle.flown(0.1).get("PARAM_VALUE", ())]

    assert answered(gain, 0.25) == [0.25]
    assert answered(gain, -1.0) == [0.25]
    assert answered("NOTHING", 1.0) == []
    vehicle.hears(dialect.MAVLink_param_request_read_message(1, 1, gain.encode(), -1))
    assert vehicle.flown(0.1)["PARAM_VALUE"][0].param_value == 0.25


@each_autopilot
def test_ground_stations_find_an_ordinary_vehicle_without_mission_and_logs(autopilot):
    vehicle = Vehicle(autopilot)
    vehicle.hears(dialect.MAVLink_mission_request_list_message(1, 1, 0))
    vehicle.hears(dialect.MAVLink_mission_count_message(1, 1, 3, 0))
    vehicle.hears(dialect.MAVLink_log_request_list_message(1, 1, 0, 0xFFFF))
    vehicle.hears(dialect.MAVLink_timesync_message(0, 12345))
    messages_by_name = vehicle.flown(0.1)
    assert messages_by_name["MISSION_COUNT"][0].count == 0
    assert messages_by_name["MISSION_ACK"][0].type == dialect.MAV_MISSION_UNSUPPORTED
    assert messages_by_name["LOG_ENTRY"][0].num_logs == 0
    (answer,) = messages_by_name["TIMESYNC"]
    assert answer.ts1 == 12345 and answer.tc1 == approx(1e9, rel=0.2)


@mark.slow
@each_autopilot
def test_a_message_is_sent_once_on_request(autopilot):
    vehicle = Vehicle(autopilot)
    assert len(vehicle.command(512, 148)[1]["AUTOPILOT_VERSION"]) == 1
    assert len(vehicle.command(520, 1)[1]["AUTOPILOT_VERSION"]) == 1
    vehicle.command(511, 30, -1)
    assert len(vehicle.command(512, 30)[1]["ATTITUDE"]) == 1
    assert "ATTITUDE" not in vehicle.flown(1.0)
    assert vehicle.command(512, 77)[0] == 2


@mark.slow
def test_streams_are_asked_of_ardupilot_as_ground_stations_do():
    """REQUEST_DATA_STREAM sets the rates of groups of messages; PX4 ignores it."""

    def asked(vehicle, *streams):
        """How many messages come in two seconds, after groups were asked for with a rate, Hz, on or off."""
        for group, rate, on in streams:
            vehicle.hears(dialect.MAVLink_request_data_stream_message(1, 1, group, rate, on))
        messages_by_name = vehicle.flown(2.0)
        names = ("ATTITUDE", "SERVO_OUTPUT_RAW", "LOCAL_POSITION_NED")
        return [len(messages_by_name.get(name, ())) for name in names]

    vehicle = Vehicle("ardupilot")
    assert asked(vehicle, (0, 4, 1)) == approx([8, 8, 8], abs=1)
    assert asked(vehicle, (0, 65535, 1))[0] == approx(800, abs=1)
    attitudes, servos, _ = asked(vehicle, (10, 50, 1), (3, 50, 0))
    assert attitudes == approx(100, abs=1) and servos == 0
    assert asked(Vehicle("px4"), (0, 4, 1))[0] == 200


def test_what_is_meant_for_others_is_not_heard():
    targets = {(2, 1): 0, (1, 2): 0, (2, 0): 0, (1, 1): 3, (1, 0): 3, (0, 0): 3}
    for target, heard in targets.items():
        message = dialect.MAVLink_command_long_message(*target, 400, *[0] * 8)
        assert len(addressed_messages(bytes(message.pack(GROUND)) * 3, 1, 1)) == heard
