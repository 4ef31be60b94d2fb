"""The loop that runs a live session until its time is over or the user ends it."""

import gc
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import monotonic

from mavdem.dem.engine.linalg import load_libraries
from mavdem.live.session import LiveSession

OLDEST_GENERATION_THRESHOLD = 1000
"""Collections of the middle generation before Python's collector goes through all objects: so many that it hardly
happens in a flight. Python's default is 10."""

SWITCH_INTERVAL_DIVISOR = 10
"""How many times shorter than usual a thread that draws may keep the interpreter from the loop (Python: 5 ms)."""


def run_session(
    session: LiveSession,
    is_end_requested: Callable[[], bool],
    duration: float | None,
    report_period: float,
    report: Callable[[LiveSession], None],
) -> None:
    """Runs a session until it has lasted for its duration, or the user requests its end.

    The loop does not sleep, since each step of the session waits for messages itself. While it runs, garbage collection
    is rare, since a full one would delay the analysis of samples.

    Args:
        session: the session, whose ``step`` is called again and again; ending it is left to the caller.
        is_end_requested: function that returns whether the user has requested the end.
        duration: how long the session lasts, s; None for no limit.
        report_period: time between two calls of ``report``, s.
        report: function that shows the status of the session, for example on the terminal.
    """
    # Libraries are loaded now. Otherwise their first use would load them in flight, and delay samples.
    load_libraries()
    with _short_pauses():
        start_time = monotonic()
        report_time = start_time
        while not is_end_requested():
            if duration is not None and monotonic() - start_time >= duration:
                break
            session.step()
            if monotonic() - report_time >= report_period:
                report_time = monotonic()
                report(session)


@contextmanager
def _short_pauses() -> Iterator[None]:
    """Keeps pauses of the interpreter short within the block, and restores its settings afterwards.

    Two things could hold up samples: a full garbage collection, which takes longer the more objects there are, and a
    thread that draws, which keeps the interpreter's lock for one switch interval.
    """
    gc.collect()
    # Freezing moves all objects that exist now, such as modules, out of the collector's sight.
    gc.freeze()
    thresholds = gc.get_threshold()
    gc.set_threshold(thresholds[0], thresholds[1], OLDEST_GENERATION_THRESHOLD)
    switch_interval = sys.getswitchinterval()
    sys.setswitchinterval(switch_interval / SWITCH_INTERVAL_DIVISOR)
    try:
        yield
    finally:
        sys.setswitchinterval(switch_interval)
        gc.set_threshold(*thresholds)
        gc.unfreeze()
