"""Which vehicle is followed."""

from dataclasses import replace

from hover import Hover
from live_hover import Flight, by_time, replay
from mavlink_streams import heartbeat, message
from pytest import mark, raises

from mavdem.facts import Fact
from mavdem.facts.session import RowsFact, VehicleFact
from mavdem.ingest.mavlink.vehicles import PARAMETER_STORE_COMPONENT
from mavdem.ingest.motors import PositionSource

FLIGHT = Flight(attitude=50.0, motors=50.0)
"""A replay takes as long as it has messages, and rows of a model need 40 Hz."""


def frames_of_two_vehicles(end):
    """The beginning of the same flight of two vehicles, with the system ids 1 and 4."""
    return by_time(*(replace(FLIGHT, system=system).frames(end=end) for system in (1, 4)))


def only_heartbeats(system=1):
    """A vehicle on a link that nobody has asked for anything yet."""
    return [
        (time, data)
        for time, data in replace(FLIGHT, system=system).frames(end=10.0)
        if data[7] == 0
    ]


def with_parameters(frames, values):
    """Returns frames of a flight together with messages at 12.5 s that state parameters of the autopilot."""
    parameter_messages = [
        (12.5, message("PARAM_VALUE", param_id=name, param_value=value, param_type=9))
        for name, value in values.items()
    ]
    return by_time(frames, parameter_messages)


@mark.slow
def test_parameters_are_decoded_again_only_when_another_comes():
    stream = replay(with_parameters(only_heartbeats(), {b"A": 1.0})).stream
    before = stream.parameters
    replay([(13.0, heartbeat())], stream)
    assert stream.parameters is before and before == {"A": 1.0}
    with raises(TypeError):
        before["A"] = 2.0
    # A value may change in flight, and MAVProxy may answer for the vehicle.
    values = {"param_id": b"B", "param_value": 3.0, "param_type": 9}
    of_store = message("PARAM_VALUE", 1, PARAMETER_STORE_COMPONENT, **values)
    replay([*with_parameters([], {b"A": 2.0}), (13.0, of_store)], stream)
    assert stream.parameters == {"A": 2.0, "B": 3.0}


def test_parameters_of_another_autopilot_under_the_same_ids_are_dropped():
    """One HEARTBEAT may be forged; several are of another vehicle, which may send parameters before the first."""
    stream = replay(with_parameters(only_heartbeats(), {b"FRAME_CLASS": 1.0})).stream
    replay([(13.0, heartbeat(autopilot=12)), (13.5, heartbeat())], stream)
    assert "FRAME_CLASS" in stream.parameters
    new_parameter = message("PARAM_VALUE", param_id=b"MC_ROLL_P", param_value=6.5, param_type=9)
    of_px4 = [(14.0 + second, heartbeat(autopilot=12)) for second in range(3)]
    replaced = replay([(13.6, new_parameter), *of_px4], stream)
    assert stream.parameters == {"MC_ROLL_P": 6.5}
    assert [fact.sentence for fact in replaced.facts] == ["Following vehicle 1:1 (quadrotor, PX4)."]


def test_a_multirotor_stays_one_whatever_a_later_heartbeat_says():
    stream = replay(only_heartbeats()).stream
    replay([(13.0, heartbeat(kind=1))], stream)
    assert stream.followed_vehicle.vehicle_type == "QUADROTOR"


@mark.slow
def test_the_only_one_is_followed_beside_ground_station_gimbal_and_plane():
    """Of all senders on the link only one is a multirotor that sends its attitude."""
    others = [
        (number / 50, message("ATTITUDE", 3, 1, sequence=number % 256)) for number in range(700)
    ]
    for second in range(14):
        others += [
            (second + 0.4, heartbeat(255, 190, kind=6, autopilot=8)),
            (second + 0.4, heartbeat(1, 154, kind=26)),
            (second + 0.4, heartbeat(3, 1, kind=1)),
        ]
    replayed = replay(by_time(FLIGHT.frames(end=14.0), others))
    assert replayed.facts[0].code is VehicleFact.FOLLOWING_VEHICLE and replayed.rows
    assert replayed.facts[0].subject == "1:1 (quadrotor, ArduPilot)"
    flying = [
        (sender.system, sender.component)
        for sender in replayed.stream._vehicles
        if sender.sends_attitude
    ]
    assert flying == [(1, 1)]


@mark.slow
def test_of_several_none_is_guessed_and_all_are_listed():
    """Two multirotors send: the user has to choose one."""
    mute = by_time(only_heartbeats(), only_heartbeats(system=4))
    missing = replay(only_heartbeats(), vehicle="7").stream.status().no_model_reason
    assert missing == Fact(VehicleFact.NO_VEHICLE_YET, subject="7")
    replayed = replay(frames_of_two_vehicles(end=9.0))
    assert not replayed.rows and replayed.stream.status().vehicle is None
    (fact,) = replayed.facts
    assert fact.code is VehicleFact.VEHICLES_FOUND and fact.figures["name"] == "1:1"
    names = "1:1 (quadrotor, ArduPilot)", "4:1 (quadrotor, ArduPilot)"
    assert fact.figures["names"] == names and not fact.figures["others"]
    obstacle = replayed.stream.status().no_model_reason
    assert obstacle.code is VehicleFact.CHOOSE_VEHICLE
    assert replay(mute).stream.status().no_model_reason == obstacle


@mark.slow
def test_the_one_that_is_named_is_followed():
    replayed = replay(frames_of_two_vehicles(end=14.0), vehicle="4")
    assert replayed.stream.status().vehicle == "4:1"
    assert replayed.rows and {VehicleFact.OTHER_VEHICLE, RowsFact.ROWS_BEGIN} <= {*replayed.codes}


def test_a_vehicle_that_sends_only_heartbeats_is_followed():
    """The vehicle is identified by its heartbeats, and the missing attitude is the reason for no rows."""
    others = [
        (time + 0.5, heartbeat(255, 190, kind=6, autopilot=8)) for time, _ in only_heartbeats()
    ]
    replayed = replay(by_time(only_heartbeats(), others))
    assert replayed.codes == [VehicleFact.FOLLOWING_VEHICLE]
    assert replayed.stream.status().vehicle == "1:1"
    assert replay(only_heartbeats(), vehicle="1").stream.status().vehicle == "1:1"
    assert replayed.stream.status().no_model_reason == Fact(RowsFact.NO_LIVE_ATTITUDE, can_ask=True)
    reason_after_request = (
        replay(only_heartbeats(), rates_requested=True).stream.status().no_model_reason
    )
    assert reason_after_request.code is RowsFact.ATTITUDE_ASKED


@mark.slow
def test_a_plane_that_is_named_is_reported_to_be_none():
    frames = [
        (time, heartbeat(kind=1) if data[7] == 0 else data)
        for time, data in FLIGHT.frames(end=10.0)
    ]
    replayed = replay(frames, vehicle="1:1")
    refusal = Fact(VehicleFact.NOT_A_MULTIROTOR, vehicle_type="FIXED_WING", axis="roll")
    assert not replayed.rows and refusal in replayed.facts


@mark.slow
def test_motors_are_placed_by_parameters_when_these_come_in_flight():
    values = {b"SERVO%d_FUNCTION" % n: 32 + n for n in range(1, 5)}
    replayed = replay(with_parameters(FLIGHT.frames(end=14.0), values))
    assert RowsFact.MOTOR_ORDER_KNOWN not in replayed.codes, "their places are assumed"
    values |= {b"FRAME_CLASS": 1, b"FRAME_TYPE": 0}
    replayed = replay(with_parameters(FLIGHT.frames(end=14.0), values))
    assert replayed.segments().keys() == {0}
    assert RowsFact.MOTOR_ORDER_ASSUMED in replayed.codes
    assert replayed.facts[-1].code is RowsFact.MOTOR_ORDER_KNOWN
    assert replayed.facts[-1].figures["basis"].figures["places_by"] is PositionSource.PARAMETERS
    assert replayed.stream.row_format.geometry.names[0] == "motor 1 (right)"


@mark.slow
def test_parameters_that_name_other_channels_begin_a_new_segment():
    values = {b"SERVO%d_FUNCTION" % n: 37 - n for n in range(1, 5)}
    replayed = replay(with_parameters(FLIGHT.frames(end=16.0), values))
    assert replayed.segments().keys() == {0, 1} and replayed.setups[1].geometry.channels == (
        4,
        3,
        2,
        1,
    )
    assert RowsFact.INPUTS_CHANGED in replayed.codes
    before = replayed.segments()[0][-1]
    after = replayed.segments()[1][-1]
    assert before.inputs[0] != before.inputs[1]
    assert after.inputs[0] == after.inputs[3] != after.inputs[1]


@mark.slow
def test_two_vehicles_under_one_id_are_refused_until_one_is_silent():
    """From 8 s to 14 s a second vehicle with the same ids sends, whose clock is 500 s ahead.

    There are no rows meanwhile.
    """
    first = replace(FLIGHT, hover=Hover(hovering=40.0)).frames(end=25.0)
    second = replace(FLIGHT, hover=Hover(hovering=40.0), clock=500.0).frames(start=8.0, end=14.0)
    replayed = replay(by_time(first, second))
    refusals = [
        event.fact for event in replayed.events if event.fact.code is VehicleFact.TWO_VEHICLES_LIVE
    ]
    assert [fact.subject for fact in refusals] == ["1:1"]
    assert VehicleFact.VEHICLE_REBOOTED not in replayed.codes
    assert not replayed.stream.motor_alarms.latest
    assert replayed.stream.followed_vehicle.name == "1:1"
    times = [row.time for row in replayed.rows]
    assert not [time for time in times if 9.0 < time < 14.0 or time > 100.0]
    assert max(times) > 20.0


def test_a_plane_is_named_as_what_it_is_and_a_ground_station_is_no_vehicle():
    ticks = (1.0, 2.0, 3.0)
    plane = replay([(time, heartbeat(3, 1, kind=1)) for time in ticks]).stream
    obstacle = plane.status().no_model_reason
    assert obstacle.sentence_and_remedy == (
        "3:1 is a fixed wing: only multirotors are followed unasked. Watch its battery, vibration and warnings with "
        "`--vehicle 3:1`."
    )
    station = replay([(time, heartbeat(255, 190, kind=6, autopilot=8)) for time in ticks]).stream
    assert station.status().no_model_reason.code is VehicleFact.NO_VEHICLE_YET
