"""UTC of an autopilot's boots, by its messages SYSTEM_TIME, which have UNIX time and time since boot."""

from __future__ import annotations

import numpy as np

from mavdem.ingest.telemetry import MICROSECONDS, Tables

MIN_UTC = 1e9
"""UNIX time, s, from which on UTC counts as known: of the year 2001. Before its first fix a receiver counts from 0."""


def utc_at_boot(messages: Tables, boot: int) -> float | None:
    """Returns the UNIX time at which the clock of a boot read 0.

    It is the median over all messages SYSTEM_TIME of the boot, so that a damaged one does not move it.

    Args:
        messages: Columns by message, with ``time`` and ``boot``.
        boot: Number of the boot; a boot lasts from one start of the autopilot to the next.

    Returns:
        The UNIX time, s; None if the autopilot had no UTC.
    """
    calendar = messages.get("SYSTEM_TIME", {})
    if "time_unix_usec" not in calendar:
        return None
    utc = np.asarray(calendar["time_unix_usec"], np.float64) / MICROSECONDS
    is_known = (calendar["boot"] == boot) & (utc >= MIN_UTC)
    if not is_known.any():
        return None
    return float(np.median(utc[is_known] - calendar["time"][is_known]))
