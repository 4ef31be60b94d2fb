"""The file of what a link receives: every frame with its stamp, whatever comes between them."""

import shutil

import numpy as np
from mavlink_streams import flight, frame, heartbeat
from pytest import approx, mark, raises
from refusals import unreadable

from mavdem.facts.session import LinkFact
from mavdem.ingest import read_log
from mavdem.ingest.formats import read_stream
from mavdem.ingest.mavlink.frame_reader import FrameReader
from mavdem.live.raw_recording import RawRecording, _stamped_records

FRAMES = [heartbeat(), *flight([20 + 0.01 * row for row in range(400)])]
# Frames of another dialect, and damaged ones.
OTHERS = [frame(64_000, b"abc", seed=3), frame(33, bytes(range(28)), seed=1)]
NOW = 1.7e9


def record(recording, pieces, step, start=0.0):
    """Records pieces of a stream that are received at a fixed step, s, from a start time, s."""
    reader = FrameReader()
    for row, piece in enumerate(pieces):
        recording.add(NOW + start + step * row, reader.feed(piece))


def recorded(path):
    """Returns the stamps and frames of a recording."""
    return list(read_stream(path).stamped_frames())


@mark.parametrize("form", [".tlog", ".mcap"])
def test_datagrams_are_kept_with_their_stamps(tmp_path, form):
    frames = [*FRAMES[:200], *OTHERS, *FRAMES[200:]]
    recording = RawRecording(tmp_path / f"flight{form}")
    record(recording, frames, 0.005)
    recording.close()
    assert (recording.frame_count, recording.first_stamp) == (len(frames), NOW)
    # What is not good comes with the good one that shows its end.
    rows = [202 if row in (200, 201) else row for row in range(len(frames))]
    expected = [
        (round((NOW + 0.005 * row) * 1e6), each) for row, each in zip(rows, frames, strict=True)
    ]
    assert recorded(tmp_path / f"flight{form}") == expected


@mark.parametrize("form", [".tlog", ".mcap"])
def test_what_was_received_is_there_before_the_end(tmp_path, form):
    path = tmp_path / f"flight{form}"
    recording = RawRecording(path)
    record(recording, FRAMES, 0.01)
    shutil.copy(path, tmp_path / f"copy{form}")  # A process that is killed leaves such a file.
    (vehicle,) = read_log(tmp_path / f"copy{form}").vehicles
    kept = sum(len(columns["time"]) for columns in vehicle.messages.values())
    assert kept >= len(FRAMES) - (60 if form == ".tlog" else 600)
    recording.close()
    recording.close()


@mark.slow
@mark.parametrize("form", [".tlog", ".mcap"])
@mark.parametrize("silence, is_ended", [(1.0, True), (10.0, False), (-3600.0, False)])
def test_a_recording_tells_whether_its_user_ended_the_record(tmp_path, form, silence, is_ended):
    path = tmp_path / f"flight{form}"
    recording = RawRecording(path)
    record(recording, FRAMES, 0.01)
    unmarked = tmp_path / f"copy{form}"
    recording._file.flush()
    shutil.copy(path, unmarked)
    recording.mark_end(NOW + 0.01 * len(FRAMES) + silence)
    recording.close()
    assert recording.frame_count == len(FRAMES)
    (vehicle,) = read_log(path).vehicles
    assert vehicle.is_ended_on_purpose is is_ended
    (vehicle,) = read_log(unmarked).vehicles
    assert not vehicle.is_ended_on_purpose


def test_it_replaces_nothing(tmp_path):
    (tmp_path / "flight.tlog").write_bytes(b"dear")
    (tmp_path / "flight-2.tlog").touch()
    exists = unreadable(RawRecording, tmp_path / "flight.tlog")
    assert exists.code is LinkFact.STREAM_FILE_EXISTS
    # The third flight of the day has a name to copy.
    assert exists.remedy.endswith("`--record {}`.".format(tmp_path / "flight-3.tlog"))
    assert (tmp_path / "flight.tlog").read_bytes() == b"dear"
    assert (
        unreadable(RawRecording, tmp_path / "none" / "flight.tlog").code
        is LinkFact.STREAM_FILE_FAILED
    )


@mark.slow
def test_what_others_sent_after_the_last_frame_of_a_vehicle_is_moved_for_its_successor(tmp_path):
    """Vehicle 1 is silent and vehicle 4 is followed.

    Frames since the last one of vehicle 1 go to the next recording.
    """
    path = tmp_path / "flight.tlog"
    recording = RawRecording(path)
    other = [heartbeat(4), *flight([1.0, 1.01, 1.02], system=4)]
    record(recording, [*FRAMES, *other], 0.005)
    recording.close()
    begin = len(FRAMES)
    full = RawRecording(tmp_path / "full.tlog")
    full.close()
    with raises(ValueError, match="closed"):
        recording.move_after(1, 1, full)
    assert len(recorded(path)) == recording.frame_count
    successor = RawRecording(tmp_path / "flight-2.tlog")
    pieces = recording.move_after(1, 1, successor)
    assert [piece.data for piece in pieces] == other
    assert [piece.arrival_time for piece in pieces] == approx(
        [NOW + 0.005 * row for row in range(begin, begin + len(other))]
    )
    assert [frame for _, frame in recorded(path)] == FRAMES
    assert recording.frame_count == len(FRAMES) and recording.move_after(9, 1, successor) == []
    # They are in the other file before it is closed.
    assert [frame for _, frame in recorded(tmp_path / "flight-2.tlog")] == other
    assert (successor.frame_count, successor.first_stamp) == (len(other), pieces[0].arrival_time)
    record(successor, FRAMES, 0.005)
    successor.close()
    third = RawRecording(tmp_path / "flight-3.tlog")
    assert [piece.data for piece in successor.move_after(4, 1, third)] == FRAMES


def test_what_a_vehicle_sent_since_its_restart_is_moved_to_its_next_flight(tmp_path):
    """Whatever others sent meanwhile."""
    recording = RawRecording(tmp_path / "flight.tlog")
    frames_before_restart, frames_after_restart, other = (
        flight([100.0, 100.1]),
        flight([0.1, 0.2]),
        [heartbeat(9)],
    )
    record(recording, frames_before_restart, 0.005)
    record(recording, other, 0.005, start=1.0)
    record(recording, [*frames_after_restart, *other], 0.005, start=3.0)
    recording.close()
    next_recording = RawRecording(tmp_path / "flight-2.tlog")
    pieces = recording.move_since_restart((NOW, NOW + 3.1), 1, 1, next_recording)
    assert [piece.data for piece in pieces] == [*frames_after_restart, *other]
    assert [frame for _, frame in recorded(tmp_path / "flight.tlog")] == [
        *frames_before_restart,
        *other,
    ]
    assert recording.frame_count == len(frames_before_restart) + 1


@mark.slow
def test_hours_before_a_restart_are_not_read_to_find_it(tmp_path, monkeypatch):
    """Of a recording with 40 s before the restart, less than a tenth of the bytes are read."""
    recording = RawRecording(tmp_path / "flight.tlog")
    frames_before_restart, frames_after_restart = flight(np.arange(400) / 10.0), flight([0.1, 0.2])
    record(recording, frames_before_restart, 40.0 / len(frames_before_restart))
    record(recording, frames_after_restart, 0.1, start=50.0)
    recording.close()
    read_bytes = []

    def counted(records):
        read_bytes.append(len(records))
        return _stamped_records(records)

    monkeypatch.setattr("mavdem.live.raw_recording._stamped_records", counted)
    next_recording = RawRecording(tmp_path / "flight-2.tlog")
    pieces = recording.move_since_restart((NOW + 39.0, NOW + 51.0), 1, 1, next_recording)
    assert [piece.data for piece in pieces] == frames_after_restart
    assert read_bytes[0] < recording._size / 10
