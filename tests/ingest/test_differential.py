"""Any stream reads as pymavlink reads it, message for message, and better where that is known to stumble.

``test_framing`` sees to single frames and to real logs; here whole logs are made up.
"""

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mavlink_streams import NOW, flight, frame, frames_in, heartbeat, tlog
from pymavlink import mavutil
from pymavlink.dialects.v20 import all as dialect
from whole_logs import everything, in_small_blocks, read

from mavdem.ingest.mavlink.framing import GOOD
from mavdem.ingest.tlog import MAX_STAMP_JUMP, STAMP_BYTES

IDS = sorted(dialect.mavlink_map)
MARKERS = [0, 1, 9, 0x0A, 0x0D, 0xFD, 0xFE, 0xFF]
TIMES = [20 + 0.01 * row for row in range(60)]


@pytest.fixture(autouse=True, scope="module")
def _same_dialect():
    usual = mavutil.current_dialect
    mavutil.set_dialect("all")
    yield
    mavutil.set_dialect(usual)


@st.composite
def any_message(draw: st.DrawFn) -> bytes:
    """A frame of any message with any field values, from one of two vehicles.

    MAVLink 1 frames of fewer than 12 bytes are left out: pymavlink reads 12 at least, and the next stamp with them.
    """
    version = draw(st.sampled_from([1, 2]))
    kinds = [known for known in IDS if version == 2 or (known < 256 and dialect.mavlink_map[known].unpacker.size >= 4)]
    message_id = draw(st.sampled_from(kinds))
    size = dialect.mavlink_map[message_id].unpacker.size
    values = draw(st.one_of(st.binary(min_size=size, max_size=size), st.just(bytes(size)), st.just(b"\xfe" * size)))
    zeros = draw(st.integers(0, size)) if version == 2 else 0
    return frame(
        message_id,
        values[: size - zeros] + bytes(zeros),
        system=draw(st.sampled_from([1, 2])),
        sequence=draw(st.integers(0, 255)),
        version=version,
        signed=version == 2 and draw(st.booleans()),
    )


STAMPS = st.lists(st.sampled_from(MARKERS), min_size=6, max_size=6).map(lambda low: b"\0\5" + bytes(low))
"""Receive stamps, full of markers; the first two bytes keep them in the years 2014 to 2023."""
GARBAGE = st.one_of(st.binary(max_size=40), st.lists(st.sampled_from(MARKERS), max_size=40).map(bytes))
INTRODUCED = [each for system in (1, 2) for each in (*[heartbeat(system)] * 9, *flight(TIMES[:1], system))]
"""More HEARTBEATs than a made-up stream can hold, so that both vehicles stay what they are."""


def theirs(content: bytes, folder: Path) -> list[Any]:
    path = folder / "theirs.tlog"
    path.write_bytes(content)
    reader, messages = mavutil.mavlogfile(str(path), robust_parsing=True), []
    while (read := reader.recv_match()) is not None:
        if read.get_type() != "BAD_DATA" and not read.get_type().startswith("UNKNOWN"):
            messages.append(read)
    reader.close()
    return messages


@given(st.lists(st.tuples(GARBAGE, STAMPS, any_message()), min_size=1, max_size=6), any_message(), st.data())
@settings(max_examples=40)
def test_among_garbage_none_is_missed_that_was_sent_or_that_pymavlink_finds(tmp_path_factory, sent, last, data):
    """The other way round pymavlink loses frames behind garbage that looks like the header of a long one.

    A header in garbage whose frame would end exactly where the next begins is taken for a damaged frame. What was sent
    inside it is lost to it, and accounted for as damage.
    """
    cut = last[: data.draw(st.integers(0, len(last) - 1))]
    content = tlog(INTRODUCED) + b"".join(b"".join(each) for each in sent) + bytes(8) + cut
    table = frames_in(content, STAMP_BYTES)
    good = table[table.verdict == GOOD]
    found = [content[start:end] for start, end in zip(good.start, good.end, strict=True)]
    damaged, place, kept, lost = table[table.verdict != GOOD], len(tlog(INTRODUCED)), [*INTRODUCED], []
    for garbage, stamp, each in sent:
        start = place + len(garbage) + len(stamp)
        place = start + len(each)
        (lost if ((damaged.start < start) & (damaged.end >= place)).any() else kept).append(each)
    assert in_order(kept, found)
    seen = [bytes(each.get_msgbuf()) for each in theirs(content, tmp_path_factory.mktemp("garbage"))]
    assert in_order([each for each in seen if each not in lost], found)


def in_order(some: list[bytes], all_of_them: list[bytes]) -> bool:
    rest = iter(all_of_them)
    return all(any(each == other for other in rest) for each in some)


@given(st.integers(1, 118), st.binary(min_size=8, max_size=8))
@settings(max_examples=40)
def test_a_damaged_stamp_misleads_pymavlink_and_not_us(tmp_path_factory, row, wrong):
    frames = [heartbeat(), *flight(TIMES)]
    place = sum(STAMP_BYTES + len(each) for each in frames[:row])
    content = bytearray(tlog(frames))
    content[place : place + STAMP_BYTES] = wrong
    log = read(bytes(content))
    first, last = NOW / 1e6, NOW / 1e6 + 0.01 * (len(frames) - 1)
    assert (
        log.receive_time == pytest.approx((first, last))
        or abs(struct.unpack(">Q", wrong)[0] / 1e6 - first) <= MAX_STAMP_JUMP
    )
    assert np.allclose(log.vehicles[0].messages["ATTITUDE"]["time"], TIMES)
    messages = theirs(bytes(content), tmp_path_factory.mktemp("stamp"))
    assert messages[row]._timestamp == pytest.approx(struct.unpack(">Q", wrong)[0] / 1e6)


@given(st.integers(1, 117), st.integers(1, 8))
@settings(max_examples=40)
def test_a_stamp_with_bytes_missing_costs_us_no_message(row, missing):
    frames = [heartbeat(), *flight(TIMES)]
    place = sum(STAMP_BYTES + len(each) for each in frames[:row])
    content = tlog(frames)
    log = read(content[:place] + content[place + missing :])
    assert log.components[0].messages == {"HEARTBEAT": 1, "ATTITUDE": len(TIMES), "SERVO_OUTPUT_RAW": len(TIMES)}
    assert log.receive_time == pytest.approx((NOW / 1e6, NOW / 1e6 + 0.01 * (len(frames) - 1)))


UNREADABLE = [frame(64_000, b"abc", seed=3), frame(33, bytes(range(28)), seed=1)]
"""Of another dialect, and damaged."""


@pytest.mark.slow
@given(
    st.lists(
        st.tuples(st.one_of(st.just(b""), GARBAGE), STAMPS, st.one_of(any_message(), st.sampled_from(UNREADABLE))),
        min_size=1,
        max_size=12,
    )
)
@settings(max_examples=40)
def test_blocks_of_a_few_bytes_read_as_one_block(sent):
    content = tlog([heartbeat(), *flight(TIMES[:4])]) + b"".join(b"".join(each) for each in sent)
    for stream in (content, content.replace(b"\n", b"\r\n")):
        assert everything(in_small_blocks(stream)) == everything(read(stream))


@pytest.mark.parametrize("left", range(12))
def test_a_cut_tail_costs_no_whole_message(left):
    """Nor where the cut lies in the stamp of the next, or behind it."""
    content = tlog([heartbeat(), *flight(TIMES)])
    log = read(content + tlog([heartbeat()])[:left])
    assert sum(log.components[0].messages.values()) == log.frames == 1 + 2 * len(TIMES)
    assert (log.unread, log.bytes_skipped) == ((), left)


def test_a_burst_of_late_and_repeated_messages_costs_none(tmp_path):
    """As links that retry and loggers that hear two radios have them."""
    frames = flight(TIMES)
    jumbled = [heartbeat(), *frames[:40], *frames[30:70], *reversed(frames[70:90]), *frames[90:]]
    log = read(tlog(jumbled))
    attitude = log.vehicles[0].messages["ATTITUDE"]
    assert len(attitude["time"]) == sum(each in frames[::2] for each in jumbled)
    assert np.array_equal(attitude["time"], attitude["time_boot_ms"] / 1e3) and not attitude["boot"].any()
