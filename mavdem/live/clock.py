"""The clocks that a live session reads, in one place, so that a recorded flight can be replayed by its own time."""

import time


def monotonic() -> float:
    """Returns the monotonic clock of this computer, s; nobody sets it."""
    return time.monotonic()


def unix_time() -> float:
    """Returns the wall clock of this computer, UNIX s; it may be set."""
    return time.time()


def sleep(seconds: float) -> None:
    """Waits for so many seconds."""
    time.sleep(seconds)
