"""Reading of long logs: mapped into memory, and column by column."""

import pickle
import re
from pathlib import Path

import numpy as np
from pytest import mark

from mavdem.ingest import byte_rows, contents
from mavdem.ingest.byte_rows import mapping_of
from mavdem.ingest.contents import mapped_bytes
from mavdem.ingest.mavlink import frame_columns, sender_streams
from mavdem.ingest.mavlink.sender_streams import sender_stream_of
from mavdem.ingest.tlog import read_tlog, tlog_stream
from tests.ingest.mavlink_streams import flight, heartbeat, tlog


def flight_log(tmp_path):
    """Writes a telemetry log of 20 s with damage in its middle."""
    path = tmp_path / "flight.tlog"
    content = tlog([heartbeat(), *flight(np.arange(0.5, 20.5, 0.02))])
    middle = len(content) // 2
    path.write_bytes(content[:middle] + b"\xfd" * 50 + content[middle + 7 :])
    return path


def columns_of(log):
    """Returns every column of a log's vehicle by message and field."""
    columns = {}
    for name, fields in log.vehicles[0].messages.items():
        columns |= {(name, field): values.copy() for field, values in fields.items()}
    return columns


@mark.slow
def test_a_mapped_log_reads_like_one_in_memory(tmp_path, monkeypatch):
    """A large log is mapped into memory and read in parts, here of 1000 bytes."""
    path = flight_log(tmp_path)
    in_memory = read_tlog(path)
    monkeypatch.setattr(contents, "MIN_MAPPED_BYTES", 1)
    monkeypatch.setattr(byte_rows, "RESIDENT_BYTES", 1000)
    assert mapping_of(mapped_bytes(path)) is not None
    mapped = read_tlog(path)
    assert mapped.receive_time == in_memory.receive_time
    assert mapped.bytes_skipped == in_memory.bytes_skipped
    columns_in_memory = columns_of(in_memory)
    mapped_columns = columns_of(mapped)
    assert mapped_columns.keys() == columns_in_memory.keys()
    for key, values in mapped_columns.items():
        np.testing.assert_array_equal(values, columns_in_memory[key])


@mark.slow
def test_columns_go_to_other_processes_without_the_recording(tmp_path):
    attitude = read_tlog(flight_log(tmp_path)).vehicles[0].messages["ATTITUDE"]
    pickled = pickle.loads(pickle.dumps(attitude))
    assert list(pickled) == list(attitude)
    np.testing.assert_array_equal(pickled["roll"], attitude["roll"])


@mark.slow
def test_a_column_is_known_before_it_is_decoded(tmp_path):
    attitude = read_tlog(flight_log(tmp_path)).vehicles[0].messages["ATTITUDE"]
    assert "pitch" in attitude
    assert "airspeed" not in attitude
    assert attitude["pitch"] is attitude["pitch"]
    assert not attitude["pitch"].flags.writeable


@mark.slow
def test_a_mapped_log_keeps_the_latest_columns_only(tmp_path, monkeypatch):
    monkeypatch.setattr(contents, "MIN_MAPPED_BYTES", 1)
    monkeypatch.setattr(frame_columns, "MAX_BYTES_OF_MAPPED_COLUMNS", 10_000)
    attitude = read_tlog(flight_log(tmp_path)).vehicles[0].messages["ATTITUDE"]
    roll = attitude["roll"]
    assert attitude["roll"] is roll
    # Each column takes 4,000 bytes, so that the first of four is forgotten.
    for name in ("pitch", "yaw", "rollspeed"):
        attitude[name]
    assert attitude["roll"] is not roll
    np.testing.assert_array_equal(attitude["roll"], roll)


def resident_bytes(path):
    """Returns how much of a mapped file is in the memory of this process."""
    mapping = Path("/proc/self/smaps").read_text(encoding="utf-8").partition(str(path))[2]
    return 1024 * int(re.search(r"^Rss: +(\d+) kB", mapping, re.MULTILINE)[1])


@mark.slow
@mark.skipif(not Path("/proc/self/smaps").exists(), reason="needs the memory maps of Linux")
def test_frames_that_are_compared_all_over_a_mapped_log_do_not_stay_in_memory(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(contents, "MIN_MAPPED_BYTES", 1)
    path = tmp_path / "flight.tlog"
    path.write_bytes(tlog(flight(np.arange(0.5, 120.5, 0.02))))
    stream = tlog_stream(path)
    byte_rows.release_pages(stream.data)
    sender_stream_of(stream.data, stream.frames, np.arange(len(stream.frames)))
    assert resident_bytes(path) < len(stream.data) / 2


def test_sequence_numbers_are_compared_across_parts(monkeypatch):
    sequence = np.random.default_rng(0).integers(0, 3, 1000).cumsum().astype(np.uint8)
    whole = sender_streams._sequence_steps(sequence)
    monkeypatch.setattr(sender_streams, "ROWS_AT_ONCE", 7)
    assert sender_streams._sequence_steps(sequence) == whole
    assert whole.irregular > 0 and whole.missing > 0
