#!/usr/bin/env python
"""Looks for a telemetry log that the reader does not survive: ``python tools/fuzz/read_tlog.py [CORPUS] [OPTIONS]``.

Coverage-guided, by atheris (``pip install atheris``, Linux and macOS). OPTIONS are libFuzzer's: ``-max_total_time=480``
stops after eight minutes, ``-artifact_prefix=FOLDER/`` says where a failing input goes. The inputs that were of use
gather in the folder CORPUS, which begins with pieces of ``logs/*.tlog``. An input that fails is run again by naming its
file, and becomes a test of ``tests/ingest``.

What must hold of any bytes: they are read, or refused with ``Unreadable``, within the time libFuzzer allows
(``-timeout``); every column can be decoded; in blocks of a few bytes they read the same as in one; no time is infinite.
The first byte of an input says whether frames get a correct checksum first: without that, hardly any change would get
past it.
"""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["mavdem.ingest"]):
    import mavdem.ingest  # noqa: F401

import numpy as np
from pymavlink.dialects.v20 import all as dialect
from pymavlink.generator.mavcrc import x25crc

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "tests/ingest"))

from whole_logs import everything, in_small_blocks, read  # noqa: E402

SAMPLES = ROOT / "logs"


def mended(content: bytes) -> bytes:
    """The stream with a correct checksum behind whatever looks like a frame of a known message."""
    stream, place = bytearray(content), 8
    while place + 8 <= len(stream):
        second = stream[place] == 0xFD
        if stream[place] not in (0xFD, 0xFE) or (second and stream[place + 2] > 1):
            place += 1
            continue
        header = 10 if second else 6
        end = place + header + stream[place + 1]
        if end + 2 > len(stream):
            break
        message_id = int.from_bytes(stream[place + 7 : place + 10], "little") if second else stream[place + 5]
        if message_id in dialect.mavlink_map:
            seed = dialect.mavlink_map[message_id].crc_extra
            stream[end : end + 2] = x25crc([*stream[place + 1 : end], seed]).crc.to_bytes(2, "little")
        place = end + 2 + (13 if second and stream[place + 2] == 1 else 0) + 8
    return bytes(stream)


def check(data: bytes) -> None:
    content = mended(data[1:]) if data[:1] and data[0] % 2 else data[1:]
    log = read(content)
    assert everything(log) == everything(in_small_blocks(content)), "blocks matter"
    if log is None:
        return
    for vehicle in log.vehicles:
        for name, columns in vehicle.messages.items():
            assert not np.isinf(columns["time"]).any(), name
            assert {len(values) for values in columns.values()} == {vehicle.messages[name]["time"].size}, name


def main(arguments: list[str]) -> None:
    if "--help" in arguments:
        print(__doc__)
        return
    warnings.simplefilter("ignore")
    folders = [argument for argument in arguments[1:] if not argument.startswith("-")]
    if folders and not Path(folders[0]).is_file():
        corpus = Path(folders[0])
        corpus.mkdir(parents=True, exist_ok=True)
        for sample in sorted(SAMPLES.glob("*.tlog")):
            content = sample.read_bytes()
            for row, place in enumerate(range(0, len(content), len(content) // 6)):
                (corpus / f"{sample.stem}_{row}").write_bytes(b"\1" + content[place : place + 600])
    atheris.Setup(arguments, check)
    atheris.Fuzz()


if __name__ == "__main__":
    main(sys.argv)
