"""What the fuzzers of files share: a corpus to begin with, the pieces of an input, and what must hold of a log.

Of any bytes: they are read, or refused with ``Unreadable`` in one sentence, within the time and the memory that
libFuzzer allows (``-timeout``, ``-rss_limit_mb``); nothing is printed; every column has as many rows as its ``time``,
and no time is infinite; what ``mavdem info`` tells of it can be told.
"""

from __future__ import annotations

import contextlib
import io
import struct
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterable
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["mavdem", "pyulog"]):
    import mavdem.ingest.dataflash
    import mavdem.ingest.mcap_log
    import mavdem.ingest.ulog  # noqa: F401
    from mavdem.errors import NotLearnable, Unreadable
    from mavdem.ingest import Log
    from mavdem.inventory import inventory

import numpy as np

BETWEEN = b"\xff\n"
"""What parts one piece of an input from the next: it hardly occurs in JSON, names and numbers."""
FLIGHT = b"~"
"""How a piece begins that stands for a whole flight: no change of single bytes would ever make one."""
MEMORY = Path("/dev/shm")
Read = Callable[[str], Log]


def pieces(data: bytes) -> list[bytes]:
    return data.split(BETWEEN)


def corpus(seeds: Iterable[tuple[int, list[bytes]]]) -> dict[str, bytes]:
    """Inputs: a first byte that says what is made of the pieces, and the pieces."""
    return {f"seed_{row}": bytes([mode]) + BETWEEN.join(parts) for row, (mode, parts) in enumerate(seeds)}


def times(piece: bytes) -> list[float]:
    """The stamps, s, of the flight that a piece stands for: its first, its step and their number."""
    first, step, count = struct.unpack_from("<IIB", piece[1:].ljust(9, b"\0"))
    return [0.001 + first / 1e4 + row * step / 1e6 for row in range(count)]


def flight(first: float, step: float, count: int) -> bytes:
    """The piece that stands for such a flight."""
    return FLIGHT + struct.pack("<IIB", round(1e4 * first), round(1e6 * step), count)


def check(read: Read, content: bytes, suffix: str) -> None:
    """Reads the content as a file and makes sure of what must hold of any."""
    printed = io.StringIO()
    with tempfile.NamedTemporaryFile(suffix=suffix, dir=MEMORY if MEMORY.exists() else None) as file:
        file.write(content)
        file.flush()
        with contextlib.redirect_stdout(printed):
            try:
                log = read(file.name)
            except Unreadable as error:
                assert "\n" not in str(error), error
                log = None
    assert not printed.getvalue(), printed.getvalue()
    if log is None:
        return
    for vehicle in log.vehicles:
        for name, columns in vehicle.messages.items():
            assert not np.isinf(columns["time"]).any(), name
            assert {len(values) for values in columns.values()} == {columns["time"].size}, name
    with contextlib.suppress(NotLearnable, Unreadable):
        inventory(log)


def run(arguments: list[str], test: Callable[[bytes], None], seeds: dict[str, bytes]) -> None:
    """Fuzzes ``test`` with libFuzzer's arguments, of which the first may be the folder of the corpus.

    atheris 3.0 keeps what every comparison of arrays that it traces came to: the memory that libFuzzer shows grows by
    up to 0.3 MB a run, and ``-max_total_time=100`` again and again with one corpus does more than one long run. Read
    without atheris, the same inputs take no more memory the second time.
    """
    if "--help" in arguments:
        print(sys.modules["__main__"].__doc__)
        return
    warnings.simplefilter("ignore")
    folders = [argument for argument in arguments[1:] if not argument.startswith("-")]
    if folders and not Path(folders[0]).is_file():
        folder = Path(folders[0])
        folder.mkdir(parents=True, exist_ok=True)
        for name, content in seeds.items():
            (folder / name).write_bytes(content)
    atheris.Setup(arguments, test)
    atheris.Fuzz()
