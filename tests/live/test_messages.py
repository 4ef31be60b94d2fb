"""Frames and messages one at a time are those of files, and hostile bytes cost neither memory nor much time."""

import random

import numpy as np
from mavlink_streams import frame, frames_in, heartbeat, message
from numpy.testing import assert_equal
from pytest import mark, skip

from mavdem.ingest.mavlink.dialect import definitions_by_id
from mavdem.ingest.mavlink.frame_reader import MAX_UNDECIDED_BYTES, Frame, FrameReader
from mavdem.ingest.mavlink.framing import (
    CHECKSUM_FAILED,
    CHECKSUM_MATCHES,
    HEADER_BYTES_V1,
    HEADER_BYTES_V2,
    MARKER_V2,
    MESSAGE_UNKNOWN,
)
from mavdem.ingest.mavlink.payloads import decoded_field
from mavdem.ingest.mavlink.vehicles import BOOT_CLOCK_UNITS
from mavdem.live.messages import MESSAGE_FIELDS, decode_message


def found(content, chance=None):
    """All frames, and the finder, from bytes in random pieces or whole."""
    finder = FrameReader()
    frames = []
    place = 0
    while place < len(content):
        size = len(content) if chance is None else chance.choice((1, 3, chance.randrange(1, 400)))
        frames += finder.feed(content[place : place + size])
        place += size
    return frames, finder


def by_the_file_reader(content):
    table = frames_in(content)
    header = table.message_id, table.system, table.component, table.sequence, table.checksum
    rows = zip(*(column.tolist() for column in (*header, table.start, table.end)), strict=True)
    frames = []
    for *known, start, end in rows:
        whole = content[start:end]
        size = HEADER_BYTES_V2 if whole[0] == MARKER_V2 else HEADER_BYTES_V1
        frames.append(Frame(*known, whole[size:][: whole[1]], whole))
    return frames


def mixed(seed):
    """MAVLink 1, 2, signed, of another dialect, and long ones."""
    chance = random.Random(seed)
    kinds = (
        lambda number: message("ATTITUDE", sequence=number, version=1, roll=chance.random()),
        lambda number: frame(30, chance.randbytes(28), sequence=number, signed=True),
        lambda number: frame(
            70000, chance.randbytes(chance.randrange(1, 255)), sequence=number, seed=7
        ),
        # The seed is that of another definition of the message.
        lambda number: frame(30, chance.randbytes(28), sequence=number, seed=1),
        lambda number: message(
            "SERVO_OUTPUT_RAW", sequence=number, servo1_raw=chance.randrange(2000)
        ),
        lambda number: frame(110, bytes(chance.choices(b"\xfe\xfd\x01", k=254)), sequence=number),
    )
    return [chance.choice(kinds)(number % 256) for number in range(300)] + [heartbeat()]


@mark.parametrize("seed", range(2))
def test_whole_frames_of_every_kind_are_those_of_the_file_reader(seed):
    content = b"".join(mixed(seed))
    frames, finder = found(content, random.Random(seed))
    assert frames == by_the_file_reader(content)
    assert {one.checksum for one in frames} == {CHECKSUM_MATCHES, MESSAGE_UNKNOWN, CHECKSUM_FAILED}
    assert finder.undecoded_frames == sum(one.checksum != CHECKSUM_MATCHES for one in frames)


@mark.slow
@mark.parametrize("kind", ["random", "FE", "FD", "long chain", "cut frame"])
def test_hostile_bytes_are_bounded_in_memory_and_time(kind):
    chance = random.Random(0)
    content = {
        "random": chance.randbytes(100_000),
        "FE": b"\xfe" * 100_000,
        "FD": b"\xfd\xff\x00" * 33_000,
        "long chain": frame(70000, b"\1" * 255, seed=3) * 400,
        "cut frame": frame(30, b"\1" * 28)[:-3] * 2500,
    }[kind]
    finder = FrameReader()
    waiting = 0
    for place in range(0, len(content), 1000):
        finder.feed(content[place : place + 1000])
        waiting = max(waiting, len(finder._pending))
    assert waiting <= MAX_UNDECIDED_BYTES + 1000
    # And what comes behind it is found.
    good = [one for one in finder.feed(heartbeat() * 40) if one.checksum == CHECKSUM_MATCHES]
    assert len(good) >= 2


DEFINITIONS = {definition.name: definition for definition in definitions_by_id().values()}


@mark.parametrize("version", [1, 2])
@mark.parametrize("name", MESSAGE_FIELDS)
def test_fields_and_stamps_are_those_of_columns(name, version):
    chance = random.Random(name)
    definition = DEFINITIONS[name]
    if definition.message_id > 255 and version == 1:
        skip("MAVLink 1 has no such ids")
    size = definition.payload_type.itemsize
    sent = [
        frame(
            definition.message_id,
            chance.randbytes(chance.choice((size, size, 5, 255))),
            version=version,
        )
        for _ in range(50)
    ]
    content = np.frombuffer(b"".join(sent), dtype=np.uint8)
    starts = np.cumsum([0] + [len(one) for one in sent[:-1]])
    table = {
        field: decoded_field(content, starts, definition, field) for field in definition.fields
    }
    clock = next((field for field in BOOT_CLOCK_UNITS if field in table), None)
    for row, one in enumerate(FrameReader().feed(content.tobytes())):
        told = decode_message(one)
        assert told.name == name
        for value, field in zip(told.values, MESSAGE_FIELDS[name], strict=True):
            assert_equal(value, table[field][row])
        assert told.stamp == (table[clock][row] / BOOT_CLOCK_UNITS[clock] if clock else 0.0)
        # Milliseconds of 32 bits wrap after 49.7 days, microseconds of these after 71.6 minutes.
        short = {"time_boot_ms": 2**32 / 1e3, "SERVO_OUTPUT_RAW": 2**32 / 1e6}
        assert told.wrap_period == short.get(clock, short.get(name, np.inf))
