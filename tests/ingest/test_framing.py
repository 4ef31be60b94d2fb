"""Frames are found in any stream and in real logs, and decode as pymavlink decodes them, field for field."""

from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mavlink_streams import beginning, frame, frames_in, real_logs
from numpy.typing import NDArray
from pymavlink import mavutil
from pymavlink.dialects.v20 import all as dialect
from pymavlink.generator.mavcrc import x25crc

from mavdem.ingest.mavlink import framing
from mavdem.ingest.mavlink.definitions import columns, definitions
from mavdem.ingest.mavlink.framing import FAILED, GOOD, Bytes, Frames
from mavdem.ingest.tlog import STAMP_BYTES, ReceiveStamps, _without_carriage_returns

IDS = sorted(dialect.mavlink_map)


@st.composite
def any_frame(draw: st.DrawFn) -> bytes:
    version = draw(st.sampled_from([1, 2]))
    message_id = draw(st.sampled_from([known for known in IDS if version == 2 or known < 256]))
    size = dialect.mavlink_map[message_id].unpacker.size
    payload = draw(st.binary(min_size=size, max_size=size))
    zeros = draw(st.integers(0, size))
    return frame(
        message_id,
        payload[: size - zeros] + bytes(zeros) if version == 2 else payload[: size - zeros],
        system=draw(st.integers(0, 255)),
        component=draw(st.integers(0, 255)),
        sequence=draw(st.integers(0, 255)),
        version=version,
        signed=version == 2 and draw(st.booleans()),
    )


def same(one: object, other: object) -> bool:
    return bool(np.array_equal(np.asarray(one), np.asarray(other), equal_nan=not isinstance(one, bytes)))


@given(st.lists(any_frame(), min_size=1, max_size=8), st.sampled_from([0, 8]), st.data())
@settings(max_examples=60)
def test_every_frame_is_found_and_decodes_as_pymavlink_does(frames, gap, data):
    content = b"".join(data.draw(st.binary(min_size=gap, max_size=gap)) + each for each in frames)
    table = frames_in(content, gap)
    assert [content[start:end] for start, end in zip(table.start, table.end, strict=True)] == frames
    assert (table.verdict == GOOD).all()
    for row, each in enumerate(frames):
        message = dialect.MAVLink(None).decode(bytearray(each))
        assert (table.message_id[row], table.system[row], table.component[row], table.sequence[row]) == (
            message.get_msgId(),
            message.get_srcSystem(),
            message.get_srcComponent(),
            message.get_seq(),
        )
        definition = definitions()[message.get_msgId()]
        ours = columns(np.frombuffer(content, dtype=np.uint8), table.start[row : row + 1], definition)
        for name in definition.fields:
            theirs = getattr(message, f"_{name}_raw", getattr(message, name))
            assert same(ours[name][0], theirs), (definition.name, name)


def test_a_frame_carried_inside_a_damaged_one_is_not_taken():
    inner = frame(30, bytes(range(1, 29)), sequence=99)
    outer = bytearray(frame(131, bytes([1, 0]) + inner + bytes(range(1, 200)), sequence=2))
    outer[12] ^= 1
    stream = [frame(30, bytes(range(1, 29)), sequence=1), bytes(outer), frame(30, bytes(range(1, 29)), sequence=3)]
    table = frames_in(b"".join(stream))
    assert table.verdict.tolist() == [GOOD, FAILED, GOOD]
    assert table.sequence.tolist() == [1, 2, 3]


def test_one_wrong_bit_anywhere_is_noticed():
    sound = frame(30, bytes(range(1, 29)))
    for bit in range(8, 8 * len(sound)):
        broken = bytearray(sound)
        broken[bit // 8] ^= 1 << bit % 8
        if bit // 8 not in (2, 3):  # the flags: an unknown one hides the frame, the compatible ones are checked too
            assert GOOD not in frames_in(bytes(broken)).verdict, bit


@pytest.mark.parametrize("flood", [b"\xfe", b"\xfd\xfd\x00", b"\xfe\x00", b"\xfe\xff\xfe\x01\xfe\xfe\x1e"])
def test_a_flood_of_markers_hides_no_frame_and_makes_none(flood):
    frames = [frame(30, bytes(range(1, 29)), sequence=row) for row in range(3)]
    content = flood * (100_000 // len(flood))
    table = frames_in(frames[0] + content + frames[1] + frames[2])
    good = table[table.verdict == GOOD]
    assert [row for row in good.sequence.tolist() if row < 3] and good.sequence.tolist()[-2:] == [1, 2]
    assert GOOD not in frames_in(content).verdict


@given(st.binary(min_size=300, max_size=2000), st.data())
def test_checksums_are_pymavlinks_however_they_are_made(content, data):
    behind = np.frombuffer(content + bytes(framing.MAX_CHECKSUM_BYTES), dtype=np.uint8)
    count = np.array(data.draw(st.lists(st.integers(5, 264), min_size=1, max_size=40)))
    start = np.array(data.draw(st.lists(st.integers(0, len(content) - 1), min_size=len(count), max_size=len(count))))
    theirs = [x25crc(behind[a : a + b].tolist()).crc for a, b in zip(start, count, strict=True)]
    assert framing._by_words(behind, start, count).tolist() == theirs
    assert framing._by_doubling(behind, start, count).tolist() == theirs


def test_every_message_of_the_dialect_has_the_size_pymavlink_unpacks():
    sizes = {message_id: definition.wire.itemsize for message_id, definition in definitions().items()}
    assert sizes == {message_id: message.unpacker.size for message_id, message in dialect.mavlink_map.items()}
    assert x25crc(b"123456789").crc == 0x6F91


@pytest.fixture(autouse=True)
def _same_dialect(monkeypatch: pytest.MonkeyPatch):
    # With the extension fields, which pymavlink's MAVLink 1 messages lack.
    monkeypatch.setenv("MAVLINK20", "1")
    usual = mavutil.current_dialect
    mavutil.set_dialect("all")
    yield
    mavutil.set_dialect(usual)


def theirs(path: Path) -> Iterator[Any]:
    reader = mavutil.mavlogfile(str(path), robust_parsing=True)
    while (message := reader.recv_match()) is not None:
        if message.get_type() != "BAD_DATA" and not message.get_type().startswith("UNKNOWN"):
            yield message


def key(message: Any) -> tuple[int, int, int, int]:
    return message.get_msgId(), message.get_srcSystem(), message.get_srcComponent(), message.get_seq()


def keys(frames: Frames) -> list[tuple[int, int, int, int]]:
    columns = (frames.message_id, frames.system, frames.component, frames.sequence)
    return list(zip(*(column.tolist() for column in columns), strict=True))


def assert_fields_equal(data: Bytes, frames: Frames, messages: list[Any]) -> None:
    """Our columns against their messages, which are the same frames in the same order."""
    by_id: dict[int, list[Any]] = defaultdict(list)
    for message in messages:
        by_id[message.get_msgId()].append(message)
    for message_id, same_kind in by_id.items():
        definition = definitions()[message_id]
        ours = columns(data, frames.start[frames.message_id == message_id], definition)
        for name in definition.fields:
            expected = [getattr(message, f"_{name}_raw", getattr(message, name)) for message in same_kind]
            if ours[name].dtype.kind == "S":
                assert ours[name].tolist() == expected, (definition.name, name)
            else:
                values = np.array(expected, dtype=ours[name].dtype)
                assert np.array_equal(ours[name], values, equal_nan=True), (definition.name, name)


@pytest.mark.slow
@pytest.mark.parametrize("log", real_logs(), ids=lambda log: log.name)
def test_real_logs(log, tmp_path):
    path = beginning(log, tmp_path)
    data, repairs = _without_carriage_returns(path.read_bytes())
    if repairs:
        path = tmp_path / "restored.tlog"
        path.write_bytes(data.tobytes())
    found = frames_in(data.tobytes(), STAMP_BYTES)
    receipts = ReceiveStamps(data)
    receipts.add(found)
    receipts.close()
    frames = found[found.verdict == GOOD]
    received = receipts.at(frames.start)
    messages = list(theirs(path))
    kept = _rows_of(messages, frames)
    extra = np.setdiff1d(np.arange(len(frames)), kept)
    assert all(_pymavlink_stumbles(found, int(frames.start[row])) for row in extra)
    frames, received = frames[kept], received[kept]
    assert keys(frames) == [key(message) for message in messages]
    stamps = np.array([message._timestamp for message in messages])
    assert np.nanmax(np.abs(stamps - received)) < 1e-6
    assert np.isfinite(received).mean() > 0.999
    assert_fields_equal(data, frames, messages)


def _rows_of(messages: list[Any], frames: Frames) -> NDArray[np.int64]:
    """Our row of each of their messages; we may have more, never less and never in another order."""
    rows, ours = [], enumerate(keys(frames))
    for message in messages:
        row = next((row for row, candidate in ours if candidate == key(message)), None)
        assert row is not None, f"pymavlink reads {message} and we do not"
        rows.append(row)
    return np.array(rows, dtype=np.int64)


def _pymavlink_stumbles(found: Frames, start: int) -> bool:
    """Whether pymavlink is known to lose the frame at ``start``, which is sound.

    It reads 12 bytes at least, so a MAVLink 1 frame of 11 takes a byte of the next stamp along; where bytes that are
    no frame come before, it takes the length of the cut frame at its word and runs into those behind.
    """
    row = int(np.searchsorted(found.start, start))
    short = int(found.end[row - 1] - found.start[row - 1]) < 12
    previous_end = np.concatenate([[0], found.end])[:-1]
    return short or bool((found.start - previous_end != STAMP_BYTES)[max(row - 8, 0) : row + 1].any())
