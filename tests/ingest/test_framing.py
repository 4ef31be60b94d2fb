"""Any stream reads as pymavlink reads it, message for message and field for field, and better where that stumbles."""

import struct
from collections import defaultdict

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from mavlink_streams import (
    NOW,
    beginning,
    flight,
    frame,
    frames_in,
    heartbeat,
    read,
    real_logs,
    tlog,
)
from pymavlink import mavutil
from pymavlink.dialects.v20 import all as dialect
from pytest import approx, mark

from mavdem.ingest.mavlink.definitions import columns, definitions
from mavdem.ingest.mavlink.framing import FAILED, MATCHES
from mavdem.ingest.mavlink.vehicles import MAX_STAMP_JUMP
from mavdem.ingest.tlog import STAMP_BYTES, _without_carriage_returns, tlog_stream

BYTES = st.integers(0, 255)
TIMES = [20 + 0.01 * row for row in range(60)]


@st.composite
def any_frame(draw):
    """A frame of any message with any field values, of MAVLink 1 cut off anywhere."""
    version = draw(st.sampled_from([1, 2]))
    sizes = {known: message.unpacker.size for known, message in dialect.mavlink_map.items()}
    message_id = draw(st.sampled_from([id for id in sorted(sizes) if version == 2 or id < 256]))
    size = sizes[message_id]
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
@settings(max_examples=60)
def test_every_frame_is_found_and_decodes_as_pymavlink_does(frames, gap, data):
    content = b"".join(data.draw(st.binary(min_size=gap, max_size=gap)) + each for each in frames)
    table = frames_in(content, gap)
    assert [content[start:end] for start, end in zip(table.start, table.end, strict=True)] == frames
    assert (table.checksum == MATCHES).all()
    messages = [dialect.MAVLink(None).decode(bytearray(each)) for each in frames]
    assert keys(table) == [key(message) for message in messages]
    assert_fields_equal(np.frombuffer(content, dtype=np.uint8), table, messages)


def test_a_frame_carried_inside_a_damaged_one_is_not_taken():
    inner = frame(30, bytes(range(1, 29)), sequence=99)
    outer = bytearray(frame(131, bytes([1, 0]) + inner + bytes(range(1, 200)), sequence=2))
    outer[12] ^= 1
    stream = [
        frame(30, bytes(range(1, 29)), sequence=1),
        bytes(outer),
        frame(30, bytes(range(1, 29)), sequence=3),
    ]
    table = frames_in(b"".join(stream))
    assert table.checksum.tolist() == [MATCHES, FAILED, MATCHES]
    assert table.sequence.tolist() == [1, 2, 3]


@mark.parametrize("flood", [b"\xfe", b"\xfd\xfd\x00", b"\xfe\x00", b"\xfe\xff\xfe\x01\xfe\xfe\x1e"])
def test_a_flood_of_markers_hides_no_frame_and_makes_none(flood):
    frames = [frame(30, bytes(range(1, 29)), sequence=row) for row in range(3)]
    content = flood * (100_000 // len(flood))
    table = frames_in(frames[0] + content + frames[1] + frames[2])
    good = table[table.checksum == MATCHES]
    assert [row for row in good.sequence.tolist() if row < 3] and good.sequence.tolist()[-2:] == [
        1,
        2,
    ]
    assert MATCHES not in frames_in(content).checksum


def theirs(content, folder):
    path = folder / "theirs.tlog"
    path.write_bytes(content)
    reader = mavutil.mavlogfile(str(path), robust_parsing=True)
    messages = []
    while (message := reader.recv_match()) is not None:
        if message.get_type() != "BAD_DATA" and not message.get_type().startswith("UNKNOWN"):
            messages.append(message)
    reader.close()
    return messages


def key(message):
    return (
        message.get_msgId(),
        message.get_srcSystem(),
        message.get_srcComponent(),
        message.get_seq(),
    )


def keys(frames):
    columns = (frames.message_id, frames.system, frames.component, frames.sequence)
    return list(zip(*(column.tolist() for column in columns), strict=True))


def assert_fields_equal(data, frames, messages):
    """Our columns against their messages, which are the same frames in the same order."""
    by_id = defaultdict(list)
    for message in messages:
        by_id[message.get_msgId()].append(message)
    for message_id, same_kind in by_id.items():
        definition = definitions()[message_id]
        ours = columns(data, frames.start[frames.message_id == message_id], definition)
        for name in definition.fields:
            expected = [
                getattr(message, f"_{name}_raw", getattr(message, name)) for message in same_kind
            ]
            if ours[name].dtype.kind == "S":
                assert ours[name].tolist() == expected, (definition.name, name)
            else:
                values = np.array(expected, dtype=ours[name].dtype)
                assert np.array_equal(ours[name], values, equal_nan=True), (definition.name, name)


@mark.slow
@mark.parametrize("log", real_logs(), ids=lambda log: log.name)
def test_real_logs(log, tmp_path):
    data, _ = _without_carriage_returns(beginning(log, tmp_path, 300_000).read_bytes())
    found = frames_in(data.tobytes(), STAMP_BYTES)
    path = tmp_path / "ours.tlog"
    path.write_bytes(data.tobytes())
    received = (tlog_stream(path).stamps / 1e6)[found.checksum == MATCHES]
    received[received == 0.0] = np.nan
    frames = found[found.checksum == MATCHES]
    messages = theirs(data.tobytes(), tmp_path)
    kept = _rows_of(messages, frames)
    extra = np.setdiff1d(np.arange(len(frames)), kept)
    assert all(_pymavlink_stumbles(found, int(frames.start[row])) for row in extra)
    frames = frames[kept]
    received = received[kept]
    assert keys(frames) == [key(message) for message in messages]
    stamps = np.array([message._timestamp for message in messages])
    assert np.nanmax(abs(stamps - received)) < 1e-6
    assert np.isfinite(received).mean() > 0.999
    assert_fields_equal(data, frames, messages)


def _rows_of(messages, frames):
    """Our row of each of their messages; we may have more, never less and never in another order."""
    rows = []
    ours = enumerate(keys(frames))
    for message in messages:
        row = next((row for row, candidate in ours if candidate == key(message)), None)
        assert row is not None, f"pymavlink reads {message} and we do not"
        rows.append(row)
    return np.array(rows, dtype=np.int64)


def _pymavlink_stumbles(found, start):
    """Whether pymavlink is known to lose the frame at ``start``, which is sound.

    It reads 12 bytes at least, so a MAVLink 1 frame of 11 takes a byte of the next stamp along; where bytes that are
    no frame come before, it takes the length of the cut frame at its word and runs into those behind.
    """
    row = int(np.searchsorted(found.start, start))
    short = int(found.end[row - 1] - found.start[row - 1]) < 12
    previous_end = np.concatenate([[0], found.end])[:-1]
    return short or bool(
        (found.start - previous_end != STAMP_BYTES)[max(row - 8, 0) : row + 1].any()
    )


@given(st.integers(1, 118), st.binary(min_size=8, max_size=8))
@settings(max_examples=40)
def test_a_damaged_stamp_misleads_nobody(row, wrong):
    frames = [heartbeat(), *flight(TIMES)]
    place = sum(STAMP_BYTES + len(each) for each in frames[:row])
    content = bytearray(tlog(frames))
    content[place : place + STAMP_BYTES] = wrong
    log = read(bytes(content))
    first = NOW / 1e6
    last = NOW / 1e6 + 0.01 * (len(frames) - 1)
    assert (
        log.receive_time == approx((first, last))
        or abs(struct.unpack(">Q", wrong)[0] / 1e6 - first) <= MAX_STAMP_JUMP
    )
    assert np.allclose(log.vehicles[0].messages["ATTITUDE"]["time"], TIMES)


@mark.parametrize("left", range(12))
def test_a_cut_tail_costs_no_whole_message(left):
    """Nor where the cut lies in the stamp of the next, or behind it; nor what comes before all."""
    content = tlog([heartbeat(), *flight(TIMES)])
    log = read(bytes(left) + content + tlog([heartbeat()])[:left])
    assert sum(log.components[0].messages.values()) == log.frames == 1 + 2 * len(TIMES)
    assert (log.unread, log.bytes_skipped) == ((), 2 * left)
