"""The loop that a live session runs in."""

import gc
import sys
from collections.abc import Callable
from time import monotonic

from mavdem.live.session import LiveSession


def run(
    session: LiveSession,
    asked: Callable[[], bool],
    duration: float | None,
    every: float,
    report: Callable[[LiveSession], None],
) -> None:
    """Runs until the ``duration``, s, is over or the user has ``asked`` to end.

    ``report`` is called with the session ``every`` so many seconds.
    """
    # No sample waits for a long collection, which only goes through what is new, nor long for a thread that draws.
    gc.collect()
    gc.freeze()
    thresholds = gc.get_threshold()
    gc.set_threshold(*thresholds[:2], 1000)
    interval = sys.getswitchinterval()
    sys.setswitchinterval(interval / 10)
    began = reported = monotonic()
    try:
        while not asked() and (duration is None or monotonic() - began < duration):
            session.step()
            if monotonic() - reported >= every:
                reported = monotonic()
                report(session)
    finally:
        sys.setswitchinterval(interval)
        gc.set_threshold(*thresholds)
        gc.unfreeze()
