"""Large files are looked at where they lie: reading them takes little memory, and none of it by surprise."""

from __future__ import annotations

import os
import tracemalloc
from pathlib import Path

import pytest
from mavlink_streams import flight, frame, heartbeat, tlog
from pymavlink.dialects.v20 import all as dialect

from mavdem.errors import Unreadable
from mavdem.files import atomic_write
from mavdem.ingest import contents as files
from mavdem.ingest import read_log
from mavdem.ingest.mcap.writer import write_mcap
from mavdem.ingest.tlog import tlog_stream

OTHERS = [
    kind
    for kind in dialect.mavlink_map.values()
    if kind.msgname in ("VFR_HUD", "SIMSTATE", "SYS_STATUS", "AHRS", "WIND")
]
TIMES = [20 + 0.01 * row for row in range(300)]


@pytest.fixture
def _mapped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "MIN_MAPPED_BYTES", 1)


def written(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


@pytest.mark.usefixtures("_mapped")
def test_a_mapped_file_that_is_cut_while_it_is_written_anew_leaves_nothing_behind(tmp_path: Path) -> None:
    path = written(tmp_path / "flight.tlog", tlog([heartbeat(), *flight(TIMES)]))
    stream = tlog_stream(path)
    os.truncate(path, 100)
    with pytest.raises(Unreadable, match="cut short"), atomic_write(tmp_path / "flight.mcap") as file:
        write_mcap(file, stream)
    assert [each.name for each in tmp_path.iterdir()] == ["flight.tlog"]


@pytest.mark.usefixtures("_mapped")
def test_a_mapped_file_that_is_cut_later_ends_in_a_sentence_and_not_the_process(tmp_path: Path) -> None:
    """Recording again under the same name does that to a log still open in a notebook."""
    path = written(tmp_path / "flight.tlog", tlog([heartbeat(), *flight(TIMES * 20)]))
    (vehicle,) = read_log(path).vehicles
    os.truncate(path, 100)
    with pytest.raises(Unreadable, match="cut short"):
        vehicle.messages["ATTITUDE"]["roll"]
    assert len(vehicle.messages["ATTITUDE"]["time"]) == 20 * len(TIMES)


@pytest.mark.slow
@pytest.mark.usefixtures("_mapped")
def test_reading_takes_less_memory_than_the_file(tmp_path: Path) -> None:
    """Counts, clocks and the columns of attitude among other messages: no copy of the file, nor of its frames."""
    others = [frame(kind.id, bytes(range(1, kind.unpacker.size + 1))) for kind in OTHERS]
    flown = flight(TIMES)
    frames = [each for row in range(0, len(flown), 2) for each in (*flown[row : row + 2], *others)]
    path = written(tmp_path / "long.tlog", tlog([heartbeat(), *frames]) * 80)
    read_log(written(tmp_path / "short.tlog", tlog(frames)))  # what is made once for all: definitions, checksum tables
    tracemalloc.start()
    try:
        (vehicle,) = read_log(path).vehicles
        assert len(vehicle.messages["ATTITUDE"]["roll"]) == 80 * len(TIMES)
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert most < path.stat().st_size, f"{most / path.stat().st_size:.2f} of the file"
