"""How long tests wait for what other threads and processes do."""

import time

PATIENCE = 300.0
"""Seconds, however busy the machine is."""


def until(happens):
    """What ``happens`` answers, as soon as it is something."""
    deadline = time.monotonic() + PATIENCE
    while not (answer := happens()):
        assert time.monotonic() < deadline, "it never happened"
        time.sleep(0.02)
    return answer
