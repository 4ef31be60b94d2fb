"""Frames found piece by piece are those found in files, and hostile bytes cost neither memory nor much time."""

from __future__ import annotations

import random
import time

import numpy as np
import pytest
from mavlink_streams import SAMPLES, flight, frame, frames_in, heartbeat, message
from pymavlink.generator.mavcrc import x25crc

from mavdem.ingest.formats import read_stream
from mavdem.ingest.mavlink.framing import FAILED, GOOD, UNKNOWN, frame_checksum
from mavdem.live.frames import LONGEST_CHAIN, LiveFrame, LiveFrames


def found(content: bytes, chance: random.Random | None = None) -> tuple[list[LiveFrame], LiveFrames]:
    """All frames, and the finder, from bytes in random pieces or whole."""
    finder, frames, place = LiveFrames(), [], 0
    while place < len(content):
        size = len(content) if chance is None else chance.choice((1, 3, chance.randrange(1, 400)))
        frames += finder.feed(content[place : place + size])
        place += size
    return frames, finder


def by_the_file_reader(content: bytes) -> list[LiveFrame]:
    table = frames_in(content)
    columns = (table.message_id, table.system, table.component, table.sequence, table.verdict)
    headers = zip(*(column.tolist() for column in columns), strict=True)
    payloads = zip(table.payload.tolist(), table.length.tolist(), strict=True)
    return [
        LiveFrame(*header, content[start : start + length])
        for header, (start, length) in zip(headers, payloads, strict=True)
    ]


def mixed(seed: int, count: int = 300) -> list[bytes]:
    """MAVLink 1, 2, signed, of another dialect, and long ones."""
    chance = random.Random(seed)
    frames = []
    for number in range(count):
        kind = chance.randrange(6)
        sequence = number % 256
        if kind == 0:
            frames.append(message("ATTITUDE", sequence=sequence, version=1, roll=chance.random()))
        elif kind == 1:
            frames.append(frame(30, chance.randbytes(28), sequence=sequence, signed=True))
        elif kind == 2:
            frames.append(frame(70000, chance.randbytes(chance.randrange(1, 255)), sequence=sequence, seed=7))
        elif kind == 3:
            frames.append(frame(30, chance.randbytes(28), sequence=sequence, seed=1))  # another definition
        elif kind == 4:
            frames.append(message("SERVO_OUTPUT_RAW", sequence=sequence, servo1_raw=chance.randrange(2000)))
        else:
            frames.append(frame(110, bytes(chance.choice(b"\xfe\xfd\x01") for _ in range(254)), sequence=sequence))
    return frames + [heartbeat()]


@pytest.mark.parametrize("size", [0, 1, 2, 9, 50, 262])
def test_the_checksum_is_pymavlinks(size):
    content = random.Random(size).randbytes(size)
    assert frame_checksum(content, 57) == x25crc([*content, 57]).crc


@pytest.mark.parametrize("seed", range(4))
def test_whole_frames_of_every_kind_are_those_of_the_file_reader(seed):
    content = b"".join(mixed(seed))
    frames, finder = found(content, random.Random(seed))
    assert frames == by_the_file_reader(content)
    assert finder.garbage == 0
    assert {one.verdict for one in frames} == {GOOD, UNKNOWN, FAILED}
    assert (finder.frames, finder.unread) == (len(frames), sum(one.verdict != GOOD for one in frames))


@pytest.mark.parametrize("seed", range(12))
def test_damaged_streams_hold_what_the_file_reader_finds(seed):
    chance = random.Random(seed)
    content = bytearray(b"".join(flight(np.arange(1.0, 3.0, 0.01).tolist())))
    for _ in range(40):
        place = chance.randrange(len(content))
        if chance.random() < 0.5:
            content[place] = chance.randrange(256)
        elif chance.random() < 0.5:
            del content[place : place + chance.randrange(1, 60)]
        else:
            content[place:place] = chance.randbytes(chance.randrange(1, 60))
    content += b"".join(flight(np.arange(3.0, 3.5, 0.01).tolist()))
    good = [one for one in found(bytes(content), chance)[0] if one.verdict == GOOD]
    assert good == [one for one in by_the_file_reader(bytes(content)) if one.verdict == GOOD]


@pytest.mark.parametrize("seed", range(4))
def test_the_same_is_found_however_the_bytes_are_cut(seed):
    chance = random.Random(seed)
    noise = [chance.randbytes(chance.randrange(300)) for _ in range(300)]
    content = b"".join(part for pair in zip(mixed(seed), noise, strict=False) for part in pair)
    whole, finder = found(content)
    pieces, other = found(content, chance)
    assert pieces == whole
    assert (other.garbage, other.frames, other.unread) == (finder.garbage, finder.frames, finder.unread)


@pytest.mark.parametrize("unread", [LONGEST_CHAIN - 1, LONGEST_CHAIN, LONGEST_CHAIN + 7])
def test_a_long_row_of_another_dialect_is_the_same_however_it_is_cut(unread):
    content = frame(70000, b"\1\2\3", seed=3) * unread + heartbeat() + frame(70000, b"\4", seed=3) + heartbeat()
    whole, finder = found(content)
    pieces, other = found(content, random.Random(1))
    assert pieces == whole and other.garbage == finder.garbage
    assert len(whole) == min(unread, LONGEST_CHAIN - 1) + 3


def test_a_recorded_flight_has_the_frames_of_its_file():
    stream = read_stream(SAMPLES / "px4_wind5_steps.tlog")
    content = b"".join(data for _, data in stream.stamped_frames())
    assert found(content, random.Random(1))[0] == by_the_file_reader(content)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["random", "FE", "FD", "long chain", "cut frame"])
def test_hostile_bytes_are_bounded_in_memory_and_time(kind):
    chance = random.Random(0)
    content = {
        "random": chance.randbytes(100_000),
        "FE": b"\xfe" * 100_000,
        "FD": b"\xfd\xff\x00" * 33_000,
        "long chain": frame(70000, b"\1" * 255, seed=3) * 400,
        "cut frame": frame(30, b"\1" * 28)[:-3] * 2500,
    }[kind]
    finder, waiting = LiveFrames(), 0
    begin = time.thread_time()
    for place in range(0, len(content), 1000):
        finder.feed(content[place : place + 1000])
        waiting = max(waiting, len(finder._rest))
    assert time.thread_time() - begin < 4.0
    assert waiting <= (LONGEST_CHAIN + 1) * 280
    # And what comes behind it is found.
    good = [one for one in finder.feed(heartbeat() * 40) if one.verdict == GOOD]
    assert len(good) >= 2


@pytest.mark.slow
@pytest.mark.parametrize("pattern", [b"\xfe", b"\xfe\xfe\xfe\xfe\xfe\x1e", b"\xfd\xff\x00", b"\xfe\x01"])
def test_twenty_of_the_largest_datagrams_a_second_full_of_markers_leave_time_for_others(pattern):
    finder, datagram = LiveFrames(), (pattern * 65507)[:65507]
    begin = time.thread_time()
    for _ in range(20):
        finder.feed(datagram)
    assert time.thread_time() - begin < 1.0
    assert len([one for one in finder.feed(heartbeat() * 40) if one.verdict == GOOD]) >= 2
