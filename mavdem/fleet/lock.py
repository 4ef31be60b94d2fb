"""The lock of a fleet's folder: one run at a time writes to it."""

from __future__ import annotations

import fcntl
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mavdem.errors import Unreadable

LOCK = ".lock"


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keeps other runs out of a folder, which must be there; the system unlocks it however this process ends.

    Raises ``Unreadable``: another run is at work in it; ``OSError``: the folder cannot be written to.
    """
    file = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o666)
    try:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            owner = os.pread(file, 200, 0).decode(errors="replace").strip() or "a process that began just now"
            raise Unreadable(
                f"Another `mavdem track` writes to {folder} ({owner}): wait until it has ended, or name another --out."
            ) from None
        os.ftruncate(file, 0)
        os.pwrite(file, f"process {os.getpid()} on {socket.gethostname()}".encode(), 0)
        yield
    finally:
        os.close(file)
