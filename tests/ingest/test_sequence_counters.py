"""Two sequence counters under one id: two vehicles are refused, one vehicle on two channels is read as one."""

from functools import cache
from math import cos, radians, sin

import numpy as np
from mavlink_streams import message, read, tlog
from pytest import approx, mark, param, raises
from scipy.spatial.transform import Rotation

from mavdem.errors import Unreadable
from mavdem.facts.sources import SourceFact
from mavdem.ingest.mavlink.dialect import mavlink_message_id
from mavdem.ingest.mavlink.frame_reader import FrameReader
from mavdem.ingest.mavlink.sequence_counters import (
    EULER_LAYOUT,
    AttitudeComparison,
    attitude_reading,
)
from mavdem.live.vehicle_selection import Component

SWAY = radians(1.5)
"""How far the vehicles lean to and fro."""
FREQUENCY = 3.0
"""Frequency of that, rad/s."""
HEADING = 0.5
"""Heading of all of them."""


@cache
def swaying(phase=0.0, first_sequence=0, rate=50.0, offset=0.0, start=100.0, burst=1):
    """Arrival times and frames of a vehicle that sways at a phase: attitude and motors, a heartbeat a second.

    Args:
        phase: Where in its sway it is when the clock reads 0, rad.
        first_sequence: Its first sequence number.
        rate: Attitudes a second.
        offset: Time by which the clock, and the arrival, are later, s.
        start: Clock at the beginning, s.
        burst: Number of attitudes that arrive together.
    """
    frames = []
    sequence = first_sequence
    for row in range(round(20.0 * rate)):
        clock = round(1e3 * (start + offset + row / rate)) / 1e3
        angle = FREQUENCY * clock + phase
        contents = [
            (
                "ATTITUDE",
                {
                    "time_boot_ms": round(1e3 * clock),
                    "roll": SWAY * sin(angle),
                    "rollspeed": SWAY * FREQUENCY * cos(angle),
                    "pitch": SWAY * cos(angle),
                    "pitchspeed": -SWAY * FREQUENCY * sin(angle),
                    "yaw": HEADING,
                },
            ),
            ("SERVO_OUTPUT_RAW", {"time_usec": round(1e6 * clock), "servo1_raw": 1500 + row % 9}),
        ]
        if row % round(rate) == 0:
            contents.append(("HEARTBEAT", {"type": 2, "autopilot": 3}))
        arrival = offset + row // burst * burst / rate
        for name, fields in contents:
            frames.append((arrival, message(name, sequence=sequence % 256, **fields)))
            sequence += 1
    return frames


def merged(*links):
    """The frames of links in the order of arrival."""
    frames = sorted((entry for link in links for entry in link), key=lambda entry: entry[0])
    return [frame for _, frame in frames]


def live_component(frames):
    """The sender of frames, as a live session counts them."""
    component = Component(1, 1)
    reader = FrameReader()
    for row, content in enumerate(frames):
        for frame in reader.feed(content):
            component.count_frame(frame, row / 100)
    return component


OTHER_VEHICLES = [
    {"phase": 3.0, "first_sequence": 77},
    {"phase": 2.0, "first_sequence": 5, "offset": 0.01},
    {"phase": 3.0, "first_sequence": 0, "rate": 47.0},
    {"phase": 3.0, "first_sequence": 150, "rate": 10.0},
    {"phase": 3.0, "first_sequence": 150, "start": 103.0},
    {"phase": 3.0, "first_sequence": 150, "burst": 25},
]
"""Vehicles beside one whose phase is 0: with equal clocks and headings, and without a position."""


@mark.slow
@mark.parametrize(
    "other", [OTHER_VEHICLES[0], *[param(one, marks=mark.in_full) for one in OTHER_VEHICLES[1:]]]
)
def test_two_vehicles_with_equal_clocks_and_headings_are_refused(other):
    frames = merged(swaying(burst=other.get("burst", 1)), swaying(**other))
    with raises(Unreadable) as refusal:
        read(tlog(frames))
    assert refusal.value.fact.code is SourceFact.TWO_VEHICLES_ONE_ID
    assert live_component(frames).has_two_senders


@mark.slow
@mark.parametrize(
    "rate, offset", [(4.0, 0.013), (10.0, 0.0), param(50.0, 0.013, marks=mark.in_full)]
)
def test_one_vehicle_on_two_channels_is_read_as_one(rate, offset):
    frames = merged(swaying(rate=rate), swaying(first_sequence=99, rate=rate, offset=offset))
    log = read(tlog(frames))
    assert len(log.vehicles) == 1
    assert log.components[0].lost <= 5
    assert not np.any(log.vehicles[0].messages["ATTITUDE"]["boot"])
    component = live_component(frames)
    assert not component.has_two_senders
    assert component.lost_messages == approx(log.components[0].lost)


@mark.slow
def test_a_second_vehicle_that_is_silent_again_is_forgotten_live():
    second = [entry for entry in swaying(phase=3.0, first_sequence=77) if entry[0] < 6.0]
    component = live_component(merged(swaying(), second))
    assert not component.has_two_senders


@mark.parametrize("seconds, are_two", [(0.5, False), (3.0, True)])
def test_attitudes_must_contradict_each_other_for_a_second_at_400_hz_too(seconds, are_two):
    comparison = AttitudeComparison()
    for clock in np.arange(100.0, 100.0 + seconds, 0.0025):
        for counter, roll in enumerate((0.0, 0.3)):
            comparison.add(counter, attitude([roll, 0.0, 0.0], clock))
    assert comparison.has_found_two_vehicles == are_two


@mark.slow
def test_attitudes_of_one_vehicle_that_tumbles_do_not_contradict_each_other():
    """Its frames overtake each other, which looks like a second counter."""
    comparison = AttitudeComparison()
    rates = [0.3, 5.0, 0.8]
    for row, clock in enumerate(np.arange(100.0, 106.0, 0.02)):
        rotation = Rotation.from_euler("x", 170, degrees=True) * Rotation.from_rotvec(
            np.multiply(rates, clock - 100.0)
        )
        angles = rotation.as_euler("ZYX")[::-1]
        comparison.add(row // 4 % 2, attitude(angles.tolist(), clock, rates))
    assert not comparison.has_found_two_vehicles


def attitude(angles, clock, rates=(0.0, 0.0, 0.0)):
    """What a vehicle reports with ATTITUDE of roll, pitch and yaw, rad, at a time, s."""
    payload = EULER_LAYOUT.pack(round(1e3 * clock), *angles, *rates)
    return attitude_reading(payload, mavlink_message_id("ATTITUDE"))
