"""Copies over a second link are dropped, what is missing is counted once, and two vehicles under one id are refused."""

import random
from functools import cache

import numpy as np
from mavlink_streams import heartbeat, message, read, tlog
from pytest import approx, mark, raises

from mavdem.errors import Unreadable
from mavdem.facts.sources import Repair, SourceFact

STEP = 0.02


@cache
def sent(duration=20.0, start=100.0, heading=0.5, latitude=47.0, first_sequence=0, system=1):
    """Times, s, and frames of one vehicle: attitude and motors at 50 Hz, a heartbeat and a position a second."""
    frames = []
    sequence = first_sequence
    for row in range(round(duration / STEP)):
        time = start + row * STEP
        contents = [("ATTITUDE", {"time_boot_ms": round(time * 1e3), "yaw": heading})]
        contents.append(("SERVO_OUTPUT_RAW", {"time_usec": round(time * 1e6), "servo1_raw": 1500}))
        if row % 50 == 0:
            contents.append(("HEARTBEAT", {"type": 2, "autopilot": 3}))
            position = {"lat": round(latitude * 1e7), "lon": 8 * 10**7}
            contents.append(("GLOBAL_POSITION_INT", {"time_boot_ms": round(time * 1e3)} | position))
        for name, fields in contents:
            frames.append((time - start, message(name, system, sequence=sequence % 256, **fields)))
            sequence += 1
    return frames


def merged(*links):
    """The frames of links, each of arrival times and frames, in the order of arrival."""
    frames = sorted((entry for link in links for entry in link), key=lambda entry: entry[0])
    return [frame for _, frame in frames]


def late(frames, delay):
    return [(time + delay, frame) for time, frame in frames]


def without(frames, share, seed):
    """The frames of a link that loses a share of them, none of the first ones."""
    chance = random.Random(seed)
    return frames[:20] + [entry for entry in frames[20:] if chance.random() >= share]


def component_and_vehicle(frames):
    log = read(tlog(frames))
    return log.components[0], log.vehicles[0]


@mark.slow
@mark.parametrize("delay", [0.0, 3.0, 60.0])
def test_a_second_link_changes_nothing(delay):
    """The same frames are received over two links, one of which is later by up to 60 s."""
    once = sent()
    component, vehicle = component_and_vehicle(merged(once, late(once, delay)))
    usual_component, usual_vehicle = component_and_vehicle(merged(once))
    assert component.messages == usual_component.messages
    assert component.lost == 0
    for name, columns in usual_vehicle.messages.items():
        assert vehicle.messages[name]["time"].tolist() == approx(columns["time"].tolist(), abs=0.1)
        assert not vehicle.messages[name]["boot"].any()
    (repair,) = vehicle.repairs
    assert repair.code is Repair.COPIES_LEFT_OUT
    assert repair.figures["count"] == len(once)
    assert repair.figures["delay"] == approx(min(delay, 20.0), abs=0.05)


@mark.slow
def test_what_one_link_lost_comes_over_the_other():
    """Each of two links loses a tenth of the frames, not the same ones."""
    once = sent()
    first = without(once, 0.1, seed=1)
    second = without(once, 0.1, seed=2)
    component, vehicle = component_and_vehicle(merged(first, late(second, 2.0)))
    received = {frame for _, frame in (*first, *second)}
    assert component.lost == approx(len(once) - len(received), abs=8)
    attitude_time = vehicle.messages["ATTITUDE"]["time"]
    assert (np.diff(attitude_time) > 0).all()
    assert not vehicle.messages["ATTITUDE"]["boot"].any()


def jittered(frames, seed):
    """The frames of a link on which they overtake each other by up to 20 ms."""
    chance = random.Random(seed)
    return [(time + 0.02 * chance.random(), frame) for time, frame in frames]


@mark.slow
@mark.parametrize("share", [0.0, 0.3])
def test_frames_that_overtake_each_other_on_two_links_are_counted_once(share):
    """Frames arrive out of order on both links, with or without losses."""
    once = sent()
    first = jittered(without(once, share, seed=1), seed=3)
    second = jittered(without(once, share, seed=2), seed=4)
    component, vehicle = component_and_vehicle(merged(first, late(second, 2.0)))
    received = {frame for _, frame in (*first, *second)}
    # Of a hundred frames one, such as a HEARTBEAT, may be taken for a copy or for a new one.
    assert component.lost == approx(len(once) - len(received), abs=0.01 * len(once))
    assert not vehicle.messages["ATTITUDE"]["boot"].any()


@mark.slow
def test_the_second_link_goes_on_where_the_first_breaks_off():
    once = sent()
    first = [entry for entry in once if entry[0] < 8.0]
    component, vehicle = component_and_vehicle(merged(first, late(once, 2.0)))
    assert component.lost == 0
    assert len(vehicle.messages["ATTITUDE"]["time"]) == round(20.0 / STEP)


def test_equal_heartbeats_after_a_turn_of_the_numbers_are_no_copies():
    frames = [message("HEARTBEAT", sequence=row % 256, type=2) for row in range(600)]
    frames += [message("ATTITUDE", sequence=88, time_boot_ms=5000)]
    assert read(tlog(frames)).components[0].messages["HEARTBEAT"] == 600


@mark.slow
@mark.parametrize(
    "other, share",
    [
        ({"start": 160.0, "first_sequence": 77}, 0.0),
        ({"start": 160.0, "first_sequence": 77}, 0.3),
        ({"start": 100.01, "first_sequence": 3, "latitude": 47.001}, 0.3),
        ({"start": 100.012, "first_sequence": 100, "heading": 2.5}, 0.3),
    ],
)
def test_two_vehicles_under_one_id_are_refused(other, share):
    """The second vehicle has another clock, position or heading."""
    frames = merged(without(sent(), share, seed=1), without(sent(**other), share, seed=2))
    with raises(Unreadable) as refusal:
        read(tlog(frames))
    assert refusal.value.fact.code is SourceFact.TWO_VEHICLES_ONE_ID
    assert refusal.value.fact.figures["names"] == ("1:1",)
    assert "MAV_SYS_ID" in refusal.value.fact.sentence_and_remedy


@mark.slow
def test_another_vehicle_beside_two_under_one_id_is_read():
    shared = merged(sent(), sent(start=160.0, first_sequence=77), sent(system=2))
    log = read(tlog([heartbeat(), *shared]))
    assert [vehicle.system for vehicle in log.vehicles] == [2]


@mark.slow
def test_a_reboot_and_a_yaw_reset_are_no_second_vehicle():
    frames = merged(
        sent(10.0, heading=0.5),
        late(sent(10.0, start=110.0, heading=2.5), 10.0),
        late(sent(10.0, start=4.0, heading=1.0), 30.0),
    )
    vehicle = read(tlog(frames)).vehicles[0]
    assert np.unique(vehicle.messages["ATTITUDE"]["boot"]).tolist() == [0, 1]
