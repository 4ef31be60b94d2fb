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


def found(content, random_generator=None):
    """All frames, and the finder, from bytes in random pieces or whole."""
    finder = FrameReader()
    frames = []
    position = 0
    while position < len(content):
        size = (
            len(content)
            if random_generator is None
            else random_generator.choice((1, 3, random_generator.randrange(1, 400)))
        )
        frames += finder.feed(content[position : position + size])
        position += size
    return frames, finder


def by_the_file_reader(content):
    """Returns the frames that the reader of files finds in the same bytes, to compare with the reader of links."""
    table = frames_in(content)
    header = table.message_id, table.system, table.component, table.sequence, table.checksum
    rows = zip(*(column.tolist() for column in (*header, table.start, table.end)), strict=True)
    frames = []
    for *header_fields, start, end in rows:
        frame_bytes = content[start:end]
        size = HEADER_BYTES_V2 if frame_bytes[0] == MARKER_V2 else HEADER_BYTES_V1
        frames.append(Frame(*header_fields, frame_bytes[size:][: frame_bytes[1]], frame_bytes))
    return frames


def mixed(seed):
    """Returns 300 random frames of MAVLink 1 and 2.

    Some are signed, long, of another dialect, or have a wrong checksum.
    """
    random_generator = random.Random(seed)
    kinds = (
        lambda number: message(
            "ATTITUDE", sequence=number, version=1, roll=random_generator.random()
        ),
        lambda number: frame(30, random_generator.randbytes(28), sequence=number, signed=True),
        lambda number: frame(
            70000,
            random_generator.randbytes(random_generator.randrange(1, 255)),
            sequence=number,
            seed=7,
        ),
        # The seed is that of another definition of the message.
        lambda number: frame(30, random_generator.randbytes(28), sequence=number, seed=1),
        lambda number: message(
            "SERVO_OUTPUT_RAW", sequence=number, servo1_raw=random_generator.randrange(2000)
        ),
        lambda number: frame(
            110, bytes(random_generator.choices(b"\xfe\xfd\x01", k=254)), sequence=number
        ),
    )
    return [random_generator.choice(kinds)(number % 256) for number in range(300)] + [heartbeat()]


@mark.parametrize("seed", range(2))
def test_whole_frames_of_every_kind_are_those_of_the_file_reader(seed):
    content = b"".join(mixed(seed))
    frames, finder = found(content, random.Random(seed))
    assert frames == by_the_file_reader(content)
    assert {frame_bytes.checksum for frame_bytes in frames} == {
        CHECKSUM_MATCHES,
        MESSAGE_UNKNOWN,
        CHECKSUM_FAILED,
    }
    assert finder.undecoded_frames == sum(
        frame_bytes.checksum != CHECKSUM_MATCHES for frame_bytes in frames
    )


@mark.slow
@mark.parametrize("kind", ["random", "FE", "FD", "long chain", "cut frame"])
def test_hostile_bytes_are_bounded_in_memory_and_time(kind):
    """Bytes that look like the beginnings of frames must not pile up, and valid frames after them must be found."""
    random_generator = random.Random(0)
    content = {
        "random": random_generator.randbytes(50_000),
        "FE": b"\xfe" * 50_000,
        "FD": b"\xfd\xff\x00" * 16_000,
        "long chain": frame(70000, b"\1" * 255, seed=3) * 200,
        "cut frame": frame(30, b"\1" * 28)[:-3] * 1250,
    }[kind]
    finder = FrameReader()
    max_pending_bytes = 0
    for position in range(0, len(content), 1000):
        finder.feed(content[position : position + 1000])
        max_pending_bytes = max(max_pending_bytes, len(finder._pending))
    assert max_pending_bytes <= MAX_UNDECIDED_BYTES + 1000
    # And what comes behind it is found.
    valid_frames = [
        frame_bytes
        for frame_bytes in finder.feed(heartbeat() * 40)
        if frame_bytes.checksum == CHECKSUM_MATCHES
    ]
    assert len(valid_frames) >= 2


DEFINITIONS = {definition.name: definition for definition in definitions_by_id().values()}


@mark.parametrize("version", [1, 2])
@mark.parametrize("name", MESSAGE_FIELDS)
def test_fields_and_stamps_are_those_of_columns(name, version):
    """The decoders of single messages and of files return the same values for random payloads."""
    random_generator = random.Random(name)
    definition = DEFINITIONS[name]
    if definition.message_id > 255 and version == 1:
        skip("MAVLink 1 has no such ids")
    size = definition.payload_type.itemsize
    sent_frames = [
        frame(
            definition.message_id,
            random_generator.randbytes(random_generator.choice((size, size, 5, 255))),
            version=version,
        )
        for _ in range(50)
    ]
    content = np.frombuffer(b"".join(sent_frames), dtype=np.uint8)
    starts = np.cumsum([0] + [len(frame_bytes) for frame_bytes in sent_frames[:-1]])
    table = {
        field: decoded_field(content, starts, definition, field) for field in definition.fields
    }
    clock = next((field for field in BOOT_CLOCK_UNITS if field in table), None)
    for row, frame_bytes in enumerate(FrameReader().feed(content.tobytes())):
        decoded = decode_message(frame_bytes)
        assert decoded.name == name
        for value, field in zip(decoded.values, MESSAGE_FIELDS[name], strict=True):
            assert_equal(value, table[field][row])
        assert decoded.stamp == (table[clock][row] / BOOT_CLOCK_UNITS[clock] if clock else 0.0)
        # Milliseconds of 32 bits wrap after 49.7 days, microseconds of these after 71.6 minutes.
        short = {"time_boot_ms": 2**32 / 1e3, "SERVO_OUTPUT_RAW": 2**32 / 1e6}
        assert decoded.wrap_period == short.get(clock, short.get(name, np.inf))
