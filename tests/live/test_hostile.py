"""Whatever comes over the link: no exception, bounded memory, and the vehicle that is followed stays."""

import random

import numpy as np
from hover import Hover
from live_hover import Flight, by_time, replay, settled_uniform
from mavlink_streams import frame, message
from numpy.testing import assert_array_equal
from pytest import mark, raises

from mavdem.facts.session import VehicleFact
from mavdem.ingest.mavlink.dialect import definitions_by_id
from mavdem.live import LiveStream
from mavdem.live.messages import MESSAGE_FIELDS
from mavdem.live.samples import MAX_SAMPLES, MEMORY_SECONDS, SampleStream
from mavdem.loops.limit_cycles import STARTING_SPAN, WINDOW_LENGTHS

FLIGHT = Flight(hover=Hover(hovering=30.0), attitude=50.0, motors=50.0)


@mark.slow
def test_frames_of_random_content_from_the_vehicle_itself_raise_nothing():
    """Among the frames of a flight are 1500 with valid checksums and random payloads, some of NaN or huge numbers."""
    random_generator = random.Random(0)
    ids = [
        definition.message_id
        for definition in definitions_by_id().values()
        if definition.name in MESSAGE_FIELDS
    ]
    forged_frames = []
    for _ in range(1500):
        payload = random_generator.choice(
            (
                random_generator.randbytes(70),
                b"\xff" * 70,
                b"\0\0\xc0\x7f" * 17,
                b"\x99\x76\x96\x7e" * 17,
            )
        )
        forged_frames.append(
            (
                random_generator.uniform(0.0, 16.0),
                frame(
                    random_generator.choice(ids), payload, sequence=random_generator.randrange(256)
                ),
            )
        )
    replayed = replay(by_time(FLIGHT.frames(end=16.0), forged_frames), vehicle="1:1")
    # A forged heartbeat may give the vehicle another number of motors, and so another segment.
    assert replayed.rows
    for row in replayed.rows:
        assert np.isfinite([row.time, *row.inputs, *row.outputs]).all()
    assert replayed.stream.status().vehicle == "1:1"
    replayed.stream.parameters  # noqa: B018
    settled_uniform(replayed)


@mark.in_full
def test_impossible_values_stray_stamps_and_too_many_ports_change_nothing():
    """Impossible roll angles, stamps of other times and motor outputs on 250 ports do not change the rows."""
    odd_frames = []
    values = [float("nan"), 1e38, float("inf"), -700.0] * 5
    stamps = [1, 2**32 - 1, 900_000, 123_456_789] * 5
    for time, value, stamp in zip(np.arange(8.0, 15.0, 0.35), values, stamps, strict=True):
        odd_frames.append(
            (time + 0.0001, message("ATTITUDE", time_boot_ms=round(time * 1e3) + 5, roll=value))
        )
        odd_frames.append((time, message("ATTITUDE", time_boot_ms=stamp, roll=0.5)))
        odd_frames.append((time + 0.1, message("SERVO_OUTPUT_RAW", time_usec=2**31)))
    for port, time in enumerate(np.linspace(1.0, 15.5, 250), 1):
        sent = {"time_usec": round(time * 1e6), "port": port, "servo1_raw": 1500}
        odd_frames.append((time, message("SERVO_OUTPUT_RAW", **sent)))
    frames = FLIGHT.frames(3.0, 16.0)
    replayed = replay(by_time(frames, odd_frames))
    assert_array_equal(replayed.table(), replay(frames).table())
    assert VehicleFact.VEHICLE_REBOOTED not in replayed.codes


@mark.slow
def test_parameters_and_events_are_bounded(monkeypatch):
    """Of a vehicle that sends 2500 parameters, and whose clock jumps 52 times, no more is kept than was set."""
    monkeypatch.setattr("mavdem.live.stream.MAX_EVENTS", 32)
    stream = LiveStream(vehicle="1:1")
    sent = [
        message("PARAM_VALUE", param_id=b"P%d" % number, param_value=1.0, param_type=9)
        for number in range(2500)
    ]
    stream.feed(0.0, b"".join(sent))
    assert len(stream.parameters) <= 2048
    # A jump of the clock every six messages.
    sent = [
        message("ATTITUDE", time_boot_ms=1000 + 100_000 * (number // 6) + number % 6)
        for number in range(6 * 52)
    ]
    stream.feed(0.0, b"".join(sent))
    assert len(stream.drain_events()) == 32
    assert stream.drain_events() == []


@mark.slow
def test_close_stamps_take_bounded_memory():
    samples = SampleStream()
    assert samples.recent_rate(100.0) == 0.0
    for number in range(3 * MAX_SAMPLES):
        samples.add(100.0 + 1e-6 * number, (0.5,))
    assert len(samples.time) <= MAX_SAMPLES + 64
    assert samples.recent_count(samples.time[-1]) <= MAX_SAMPLES + 64
    # What is kept must cover the recent flight in which a limit cycle is looked for.
    assert STARTING_SPAN * WINDOW_LENGTHS[0] <= MEMORY_SECONDS


def test_another_axis_is_refused():
    with raises(ValueError, match="must be one of"):
        LiveStream(axis="yaw")
