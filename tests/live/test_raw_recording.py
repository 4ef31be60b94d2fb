"""The file of what a link receives: every frame with its stamp, whatever comes between them."""

import random
import shutil
import struct
from pathlib import Path

import pytest
from mavlink_streams import flight, frame, heartbeat

from mavdem.errors import Unreadable
from mavdem.facts.session import LinkFact
from mavdem.ingest import read_log
from mavdem.ingest.formats import read_stream
from mavdem.live.raw_recording import RawRecording

FRAMES = [heartbeat(), *flight([20 + 0.01 * row for row in range(400)])]
# of another dialect, and damaged
OTHERS = [frame(64_000, b"abc", seed=3), frame(33, bytes(range(28)), seed=1)]
NOW = 1.7e9


def recorded(path: Path) -> list[tuple[int, bytes]]:
    return list(read_stream(path).stamped_frames())


@pytest.mark.parametrize("form", [".tlog", ".mcap"])
def test_datagrams_are_kept_with_their_stamps(tmp_path, form):
    frames = [*FRAMES[:200], *OTHERS, *FRAMES[200:]]
    recording = RawRecording(tmp_path / f"flight{form}")
    for row, each in enumerate(frames):
        recording.take(NOW + 0.005 * row, each)
    recording.close()
    assert recording.frames == len(frames)
    expected = [(round((NOW + 0.005 * row) * 1e6), each) for row, each in enumerate(frames)]
    assert recorded(tmp_path / f"flight{form}") == expected


@pytest.mark.parametrize("seed", range(2))
def test_bytes_in_any_pieces_among_garbage_are_kept(tmp_path, seed):
    chance = random.Random(seed)
    content = b""
    for each in FRAMES:
        if chance.random() < 0.05:
            content += bytes(chance.randrange(0xFC) for _ in range(chance.randrange(1, 400)))
        content += each
    recording = RawRecording(tmp_path / "flight.tlog")
    place = 0
    now = NOW
    while place < len(content):
        step = chance.randrange(1, 90)
        recording.take(now, content[place : place + step])
        place = place + step
        now = now + 0.004
    recording.close()
    stamps, frames = zip(*recorded(tmp_path / "flight.tlog"), strict=True)
    assert list(frames) == FRAMES and list(stamps) == sorted(stamps)


@pytest.mark.parametrize("form", [".tlog", ".mcap"])
def test_what_was_received_is_there_before_the_end(tmp_path, form):
    path = tmp_path / f"flight{form}"
    recording = RawRecording(path)
    for row, each in enumerate(FRAMES):
        recording.take(NOW + 0.01 * row, each)
    shutil.copy(path, tmp_path / f"copy{form}")  # as a process that is killed leaves it
    (vehicle,) = read_log(tmp_path / f"copy{form}").vehicles
    kept = sum(len(columns["time"]) for columns in vehicle.messages.values())
    assert kept >= len(FRAMES) - (60 if form == ".tlog" else 600)
    recording.close()
    recording.close()


def test_a_clock_that_is_set_back_or_noise_without_end_hold_nothing_up(tmp_path):
    recording = RawRecording(tmp_path / "flight.tlog")
    recording.take(NOW, FRAMES[0])
    recording.take(NOW - 5000.0, FRAMES[1])
    noise = random.Random(0).randbytes(3000)
    for row in range(2000):
        recording.take(NOW + 0.01 * row, noise)
        assert sum(len(data) for _, data in recording._pieces) < 60 * len(noise)
    recording.close()
    assert [each for _, each in recorded(tmp_path / "flight.tlog")][:2] == FRAMES[:2]
    assert struct.unpack(">Q", (tmp_path / "flight.tlog").read_bytes()[:8])[0] == round(NOW * 1e6)


def test_it_replaces_nothing(tmp_path):
    (tmp_path / "flight.tlog").write_bytes(b"dear")
    with pytest.raises(Unreadable) as refusal:
        RawRecording(tmp_path / "flight.tlog")
    assert refusal.value.fact.code is LinkFact.STREAM_FILE_EXISTS
    assert (tmp_path / "flight.tlog").read_bytes() == b"dear"
    with pytest.raises(Unreadable) as refusal:
        RawRecording(tmp_path / "none" / "flight.tlog")
    assert refusal.value.fact.code is LinkFact.STREAM_FILE_FAILED
