"""Periods: when a vehicle was in settled flight, and which samples of a stream are from then."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from mavdem.alignment import phases
from mavdem.alignment.intervals import Intervals, both, total
from mavdem.alignment.segments import settled_segments
from mavdem.alignment.signals import Signals
from mavdem.ingest.motors import MULTIROTORS

Periods = Mapping[int, Intervals]  # Intervals, s, by boot


def settled_flight(signals: Signals) -> Periods:
    """Settled flight with attitude and motor outputs or, where there are no motor outputs, with attitude."""
    if signals.telemetry.vehicle not in (*MULTIROTORS, "UNKNOWN"):
        return {}
    found: dict[int, Intervals] = {}
    if signals.motors is not None:
        for segment in sorted(settled_segments(signals), key=lambda segment: (segment.boot, segment.start)):
            found.setdefault(segment.boot, []).append((segment.start, segment.end))
        return found
    for boot, recorded in log_span(signals).items():
        if settled := both(recorded, phases.settled(signals, boot)):
            found[boot] = settled
    return found


def log_span(signals: Signals) -> Periods:
    """From the first message of each boot to its last."""
    ends: dict[int, tuple[float, float]] = {}
    for columns in signals.telemetry.messages.values():
        for boot in np.unique(columns["boot"]):
            time = columns["time"][columns["boot"] == boot]
            first, last = ends.get(int(boot), (np.inf, -np.inf))
            ends[int(boot)] = min(first, float(time.min())), max(last, float(time.max()))
    return {boot: [span] for boot, span in sorted(ends.items())}


def seconds_of(periods: Periods) -> float:
    """How long they last together."""
    return float(sum(total(intervals) for intervals in periods.values()))


def during(periods: Periods, time: NDArray[np.float64], boot: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which samples (N,) lie in the periods."""
    inside = np.zeros(len(time), dtype=bool)
    for number, intervals in periods.items():
        for start, end in intervals:
            inside |= (boot == number) & (time >= start) & (time <= end)
    return inside
