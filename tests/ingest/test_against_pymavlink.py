"""Every message of real logs equals what pymavlink reads from them, field for field and in order."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mavlink_streams import beginning, frames_in, real_logs
from numpy.typing import NDArray
from pymavlink import mavutil

from mavdem.ingest.mavlink.definitions import columns, definitions
from mavdem.ingest.mavlink.framing import GOOD, Bytes, Frames
from mavdem.ingest.tlog import STAMP_BYTES, ReceiveStamps, _without_carriage_returns


@pytest.fixture(autouse=True)
def _same_dialect(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
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
def test_real_logs(log: Path, tmp_path: Path) -> None:
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
