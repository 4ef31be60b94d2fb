"""The loop that a live session runs in, and what it computes in the background at its end."""

from __future__ import annotations

import gc
from collections.abc import Callable
from concurrent.futures import Future
from threading import Thread
from time import monotonic
from typing import TypeVar

from mavdem.live.session import LiveSession

Result = TypeVar("Result")


def run(
    session: LiveSession,
    asked: Callable[[], bool],
    duration: float | None,
    every: float,
    report: Callable[[LiveSession, str], str],
) -> None:
    """Runs until the ``duration``, s, is over or the user has ``asked`` to end.

    ``report`` is called every so many seconds with what it returned before.
    """
    # No sample waits for a long collection, which only goes through what is new.
    gc.collect()
    gc.freeze()
    line = ""
    began = reported = monotonic()
    try:
        while not asked() and (duration is None or monotonic() - began < duration):
            session.step()
            if monotonic() - reported >= every:
                reported = monotonic()
                line = report(session, line)
    finally:
        gc.unfreeze()


def in_background(work: Callable[[], Result]) -> Future[Result]:
    """Starts ``work`` in a thread; the process ends without waiting for it."""
    future: Future[Result] = Future()

    def call() -> None:
        try:
            future.set_result(work())
        except BaseException as error:  # whoever waits for the result gets it
            future.set_exception(error)

    Thread(target=call, daemon=True).start()
    return future
