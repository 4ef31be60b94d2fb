"""The loop that a live session runs in."""

from __future__ import annotations

import gc
from collections.abc import Callable
from time import monotonic

from mavdem.live.session import LiveSession


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
