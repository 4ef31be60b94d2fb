"""Termination by signals: how Ctrl-C, SIGTERM and SIGHUP end a command, immediately or at its next safe point.

Windows has SIGBREAK in the place of SIGHUP, and no program sends SIGTERM there.
"""

import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from mavdem.cli.exit_codes import SIGNAL_EXIT_BASE
from mavdem.processes import TERMINATION_SIGNALS


@contextmanager
def default_interrupt_action() -> Iterator[None]:
    """Context in which Ctrl-C ends the process immediately, without a ``KeyboardInterrupt``.

    It is used while modules are imported, since a library that is being imported may catch the exception, or turn it
    into another one.
    """
    handler = signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)


def raise_on_termination_signals() -> None:
    """Lets Ctrl-C, SIGTERM and SIGHUP, which a closing terminal sends, end the process by an exception.

    Only the first signal raises. Later ones are ignored, so that they cannot break off the clean-up that the exception
    has begun, for example the removal of temporary files. A signal that is ignored already, as SIGHUP under ``nohup``,
    stays ignored.
    """
    for number in TERMINATION_SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _raise_exit)


def _raise_exit(number: int, frame: FrameType | None) -> None:
    """Handles a termination signal: ignores further ones, and raises ``KeyboardInterrupt`` or ``SystemExit``.

    Args:
        number: Number of the signal.
        frame: Stack frame that the signal has interrupted; not used.
    """
    for signal_number in (signal.SIGINT, signal.SIGTERM, number):
        signal.signal(signal_number, signal.SIG_IGN)
    if number == signal.SIGINT:
        raise KeyboardInterrupt
    sys.exit(SIGNAL_EXIT_BASE + number)


@contextmanager
def termination_requests() -> Iterator[Callable[[], bool]]:
    """Treats Ctrl-C, SIGTERM and SIGHUP as requests to end, which the block handles when it is ready.

    If a signal has come, the three stay ignored after the block too: an impatient second Ctrl-C must not lose the
    results that are being written. A SIGHUP that is ignored already, as under ``nohup``, stays ignored.

    Yields:
        A function that returns whether one of the signals has come.
    """
    is_requested = False

    def request_end(number: int, frame: FrameType | None) -> None:
        nonlocal is_requested
        is_requested = True

    former_handlers = {}
    for number in TERMINATION_SIGNALS:
        is_ignored = signal.getsignal(number) is signal.SIG_IGN
        # Shells start programs in the background with SIGINT ignored; sent to such a program, it is a request too.
        if number in (signal.SIGINT, signal.SIGTERM) or not is_ignored:
            former_handlers[number] = signal.signal(number, request_end)
    try:
        yield lambda: is_requested
    finally:
        for number, handler in former_handlers.items():
            signal.signal(number, signal.SIG_IGN if is_requested else handler)
