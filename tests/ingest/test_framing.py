"""Any frame is read as pymavlink reads it, field for field, and what is damaged costs itself only."""

import struct

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st
from mavlink_streams import (
    NOW,
    flight,
    frame,
    frames_in,
    heartbeat,
    read,
    tlog,
)
from numpy.testing import assert_equal
from pymavlink import mavutil
from pymavlink.dialects.v20 import all as dialect
from pytest import approx, mark
from recorded_flights import SAMPLE_LOGS

from mavdem.ingest.mavlink.dialect import definitions_by_id
from mavdem.ingest.mavlink.frame_reader import parse_frame
from mavdem.ingest.mavlink.framing import CHECKSUM_FAILED, CHECKSUM_MATCHES
from mavdem.ingest.mavlink.payloads import decoded_field, field_values
from mavdem.ingest.tlog import STAMP_BYTES

BYTES = st.integers(0, 255)
MESSAGE_IDS = {
    1: st.sampled_from(sorted(id for id in dialect.mavlink_map if id < 256)),
    2: st.sampled_from(sorted(dialect.mavlink_map)),
}
"""Numbers of the messages that a version of MAVLink can carry."""
TIMES = [20 + 0.01 * row for row in range(60)]


@st.composite
def any_frame(draw):
    """A frame of any message with any field values, of MAVLink 1 cut off anywhere."""
    version = draw(st.sampled_from([1, 2]))
    message_id = draw(MESSAGE_IDS[version])
    size = dialect.mavlink_map[message_id].unpacker.size
    payload = draw(
        st.one_of(
            st.binary(min_size=size, max_size=size), st.just(bytes(size)), st.just(b"\xfe" * size)
        )
    )
    zeros = draw(st.integers(0, size))
    return frame(
        message_id,
        payload[: size - zeros] + bytes(zeros if version == 2 else 0),
        system=draw(BYTES),
        component=draw(BYTES),
        sequence=draw(BYTES),
        version=version,
        signed=version == 2 and draw(st.booleans()),
    )


@mark.slow
@given(st.lists(any_frame(), min_size=1, max_size=8), st.sampled_from([0, 8]), st.data())
@settings(max_examples=40)
def test_every_frame_is_found_and_decodes_as_pymavlink_does(frames, gap, data):
    """Random frames of MAVLink, with or without the 8 bytes of a stamp between them."""
    content = b"".join(data.draw(st.binary(min_size=gap, max_size=gap)) + each for each in frames)
    table = frames_in(content, gap)
    assert [content[start:end] for start, end in zip(table.start, table.end, strict=True)] == frames
    assert (table.checksum == CHECKSUM_MATCHES).all()
    read = np.frombuffer(content, dtype=np.uint8)
    for row, each in enumerate(frames):
        expected = dialect.MAVLink(None).decode(bytearray(each))
        is_read_as(read, table[row : row + 1], expected)
        columns_are_read_as(read, table[row : row + 1], [expected])


def is_read_as(content, frames, expected):
    """Asserts that a frame in the content is the message that pymavlink reads."""
    sender = (expected.get_srcSystem(), expected.get_srcComponent(), expected.get_seq())
    assert (frames.system, frames.component, frames.sequence) == sender
    assert frames.message_id == expected.get_msgId()
    definition = definitions_by_id()[expected.get_msgId()]
    one = parse_frame(content[int(frames.start[0]) : int(frames.end[0])].tobytes())
    assert one.checksum == CHECKSUM_MATCHES
    assert_equal(
        field_values(one.payload, definition),
        {name: getattr(expected, name) for name in expected.fieldnames},
    )


def columns_are_read_as(content, frames, expected):
    """Asserts that the fields of several frames of one message are those that pymavlink reads."""
    definition = definitions_by_id()[expected[0].get_msgId()]
    for name in definition.fields:
        values = decoded_field(content, frames.start, definition, name)
        expected_values = [getattr(one, f"_{name}_raw", getattr(one, name)) for one in expected]
        np.testing.assert_array_equal(values, np.asarray(expected_values, values.dtype), name)


@mark.slow
@mark.parametrize("log", SAMPLE_LOGS, ids=lambda log: log.name)
def test_a_recorded_stream_is_read_as_pymavlink_reads_it(log, tmp_path):
    """Reads the beginning of each real log by both readers, message by message and column by column."""
    path = tmp_path / log.name
    path.write_bytes(log.read_bytes()[:50_000])
    content = np.fromfile(path, np.uint8)
    frames = frames_in(content.tobytes(), STAMP_BYTES)
    assert (frames.checksum == CHECKSUM_MATCHES).all() and len(frames) > 1000
    reader = mavutil.mavlogfile(str(path))
    expected = [reader.recv_match() for _ in range(len(frames))]
    reader.close()
    for row, message in enumerate(expected):
        is_read_as(content, frames[row : row + 1], message)
    for message_id in np.unique(frames.message_id):
        rows = np.flatnonzero(frames.message_id == message_id)
        columns_are_read_as(content, frames[rows], [expected[row] for row in rows])


def test_a_frame_carried_inside_a_damaged_one_is_not_taken():
    inner = frame(30, bytes(range(1, 29)), sequence=99)
    outer = bytearray(frame(131, bytes([1, 0]) + inner + bytes(range(1, 200)), sequence=2))
    outer[12] ^= 1
    first, third = (frame(30, bytes(range(1, 29)), sequence=number) for number in (1, 3))
    table = frames_in(first + outer + third)
    assert table.checksum.tolist() == [CHECKSUM_MATCHES, CHECKSUM_FAILED, CHECKSUM_MATCHES]
    assert table.sequence.tolist() == [1, 2, 3]
    # The damaged one is not lost before a header that is cut off either.
    cut = tlog([first, outer, third])[: 1 - len(third)]
    assert frames_in(cut, STAMP_BYTES).sequence.tolist() == [1, 2]


@mark.slow
@mark.parametrize("flood", [b"\xfe", b"\xfd\xfd\x00", b"\xfe\x00", b"\xfe\xff\xfe\x01\xfe\xfe\x1e"])
def test_a_flood_of_markers_hides_no_frame_and_makes_none(flood):
    frames = [frame(30, bytes(range(1, 29)), sequence=row) for row in range(3)]
    content = flood * (100_000 // len(flood))
    table = frames_in(frames[0] + content + frames[1] + frames[2])
    assert table.sequence[table.checksum == CHECKSUM_MATCHES].tolist()[-2:] == [1, 2]
    assert CHECKSUM_MATCHES not in frames_in(content).checksum


@mark.slow
@given(st.integers(1, 118), st.binary(min_size=8, max_size=8))
@example(60, struct.pack(">Q", NOW + 3_599_000_000))
@example(60, struct.pack(">Q", NOW + 3_601_000_000))
@settings(max_examples=20)
def test_a_damaged_stamp_misleads_nobody(row, wrong):
    """One receive stamp of a telemetry log is replaced by random bytes, or is an hour late."""
    frames = [heartbeat(), *flight(TIMES)]
    position = sum(STAMP_BYTES + len(each) for each in frames[:row])
    content = bytearray(tlog(frames))
    content[position : position + STAMP_BYTES] = wrong
    log = read(bytes(content))
    assert log.receive_time == approx((NOW / 1e6, NOW / 1e6 + 0.01 * (len(frames) - 1)))
    assert np.allclose(log.vehicles[0].messages["ATTITUDE"]["time"], TIMES)


@mark.parametrize("left", range(12))
def test_a_cut_tail_costs_no_whole_message(left):
    """Nor where the cut lies in the stamp of the next, or behind it; nor what comes before all."""
    content = tlog([heartbeat(), *flight(TIMES)])
    log = read(bytes(left) + content + tlog([heartbeat()])[:left])
    assert sum(log.components[0].messages.values()) == log.frames == 1 + 2 * len(TIMES)
    assert (log.unread, log.bytes_skipped) == ((), 2 * left)
