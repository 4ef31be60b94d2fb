"""What Ctrl-C, SIGTERM and SIGHUP do. Imports nothing that takes time."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

INTERRUPTED, OF_SIGNAL = 130, 128  # exit codes as a shell reports them: of SIGINT; of any signal, less its number


@contextmanager
def ending_at_once() -> Iterator[None]:
    """Around imports: Ctrl-C ends the process. An exception could be lost in, or changed by, what is being imported."""
    before = signal.signal(signal.SIGINT, _end)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def unwind_when_terminated() -> None:
    """Lets SIGTERM, and a closed terminal's SIGHUP, end the process as an exception does: temporary files are removed.

    A process that was started with SIGHUP ignored, as by nohup, continues.
    """
    signal.signal(signal.SIGTERM, _unwind)
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        signal.signal(signal.SIGHUP, _unwind)


@contextmanager
def asked_to_end() -> Iterator[Callable[[], bool]]:
    """Takes Ctrl-C, SIGTERM and SIGHUP as a request to end, and yields a function that returns whether there was one.

    Asking again changes nothing: what is kept at the end must not be lost to impatience. An ignored SIGHUP stays so.
    """
    asked = False

    def ask(number: int, frame: FrameType | None) -> None:
        nonlocal asked
        asked = True

    numbers = [signal.SIGINT, signal.SIGTERM]
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        numbers.append(signal.SIGHUP)
    before = {number: signal.signal(number, ask) for number in numbers}
    try:
        yield lambda: asked
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_IGN if asked else handler)


def _end(number: int, frame: FrameType | None) -> None:
    try:
        os.write(2, b"mavdem: Interrupted; nothing was written.\n")
    finally:
        os._exit(INTERRUPTED)


def _unwind(number: int, frame: FrameType | None) -> None:
    # A second one must not end the removal that the first has begun.
    for one in (signal.SIGTERM, number):
        signal.signal(one, signal.SIG_IGN)
    sys.exit(OF_SIGNAL + number)
