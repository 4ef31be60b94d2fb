"""Frames are found in any stream, whatever lies between them, and decode as pymavlink decodes them."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from mavlink_streams import frame
from pymavlink.dialects.v20 import all as dialect
from pymavlink.generator.mavcrc import x25crc

from mavdem.ingest.decode import decode, definitions, seeds
from mavdem.ingest.framing import FAILED, GOOD, UNKNOWN, Frames, find_frames, padded

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


def found(content: bytes, gap: int = 0) -> Frames:
    return find_frames(padded(content), seeds(), gap)


def same(one: object, other: object) -> bool:
    return bool(np.array_equal(np.asarray(one), np.asarray(other), equal_nan=not isinstance(one, bytes)))


@given(st.lists(any_frame(), min_size=1, max_size=8), st.sampled_from([0, 8]), st.data())
@settings(max_examples=150, deadline=None)
def test_every_frame_is_found_and_decodes_as_pymavlink_does(frames: list[bytes], gap: int, data: st.DataObject) -> None:
    content = b"".join(data.draw(st.binary(min_size=gap, max_size=gap)) + each for each in frames)
    table = found(content, gap)
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
        ours = decode(padded(content), table[row : row + 1], definition)[0]
        for name in definition.fields:
            theirs = getattr(message, f"_{name}_raw", getattr(message, name))
            assert same(ours[name], theirs), (definition.name, name)


@given(st.lists(st.tuples(st.binary(max_size=40), any_frame()), min_size=1, max_size=6), st.data())
@settings(max_examples=100, deadline=None)
def test_garbage_between_frames_and_a_cut_tail_lose_no_whole_frame(
    pieces: list[tuple[bytes, bytes]], data: st.DataObject
) -> None:
    whole = b"".join(garbage + each for garbage, each in pieces[:-1])
    last = pieces[-1][1]
    cut = last[: data.draw(st.integers(0, len(last) - 1))]
    content = whole + cut
    table = found(content)
    good = [content[a:b] for a, b in zip(table.start, table.end, strict=True)]
    frames = [each for _, each in pieces[:-1]]
    assert [each for each in good if each in frames] == frames


def test_a_marker_inside_a_time_stamp_is_no_frame() -> None:
    frames = [frame(30, bytes(range(1, 29)), sequence=row) for row in range(50)]
    stamps = [b"\x00\xfd\x09\x00\xfe\x09\xfd\xfe"] * 50
    table = found(b"".join(stamp + each for stamp, each in zip(stamps, frames, strict=True)), 8)
    assert table.sequence.tolist() == list(range(50))


def test_a_frame_carried_inside_a_damaged_one_is_not_taken() -> None:
    inner = frame(30, bytes(range(1, 29)), sequence=99)
    outer = bytearray(frame(131, bytes([1, 0]) + inner + bytes(range(1, 200)), sequence=2))
    outer[12] ^= 1
    stream = [frame(30, bytes(range(1, 29)), sequence=1), bytes(outer), frame(30, bytes(range(1, 29)), sequence=3)]
    table = found(b"".join(stream))
    assert table.verdict.tolist() == [GOOD, FAILED, GOOD]
    assert table.sequence.tolist() == [1, 2, 3]


def test_frames_of_another_dialect_are_told_from_known_ones() -> None:
    known, strange = frame(0, bytes(range(9))), frame(64_000, b"abcd", seed=7)
    renamed = frame(30, bytes(range(28)), seed=1)
    table = found(known + strange + renamed + known)
    assert table.verdict.tolist() == [GOOD, UNKNOWN, FAILED, GOOD]


def test_one_wrong_bit_anywhere_is_noticed() -> None:
    sound = frame(30, bytes(range(1, 29)))
    for bit in range(8, 8 * len(sound)):
        broken = bytearray(sound)
        broken[bit // 8] ^= 1 << bit % 8
        if bit // 8 not in (2, 3):  # the flags: an unknown one hides the frame, the compatible ones are checked too
            assert GOOD not in found(bytes(broken)).verdict, bit


def test_only_markers_is_no_log_and_takes_little_memory() -> None:
    table = found(b"\xfe" * 300_000)
    assert GOOD not in table.verdict


def test_nothing_in_nothing_out() -> None:
    assert len(found(b"")) == 0
    assert len(found(b"\xfd")) == 0


def test_every_message_of_the_dialect_has_the_size_pymavlink_unpacks() -> None:
    sizes = {message_id: definition.wire.itemsize for message_id, definition in definitions().items()}
    assert sizes == {message_id: message.unpacker.size for message_id, message in dialect.mavlink_map.items()}
    assert x25crc(b"123456789").crc == 0x6F91
