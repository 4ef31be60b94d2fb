"""What Ctrl-C and SIGTERM do. Imports nothing that takes time."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

INTERRUPTED, TERMINATED = 130, 143
"""Exit codes, as a shell reports SIGINT and SIGTERM."""


@contextmanager
def ending_at_once() -> Iterator[None]:
    """Around imports: Ctrl-C ends the process. An exception could be lost in, or changed by, what is being imported."""
    before = signal.signal(signal.SIGINT, _end)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def unwind_when_terminated() -> None:
    """Lets SIGTERM end the process as an exception does: what is temporary is removed."""
    signal.signal(signal.SIGTERM, _unwind)


def _end(number: int, frame: FrameType | None) -> None:
    try:
        os.write(2, b"mavdem: Interrupted; nothing was written.\n")
    finally:
        os._exit(INTERRUPTED)


def _unwind(number: int, frame: FrameType | None) -> None:
    # A second one must not end the removal that the first has begun.
    signal.signal(number, signal.SIG_IGN)
    sys.exit(TERMINATED)
