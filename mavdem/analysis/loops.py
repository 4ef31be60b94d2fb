"""Loops of a log: the plant that its settled flight shows, and the controller of its parameters."""

from __future__ import annotations

from collections.abc import Sequence

from mavdem.alignment.drive import AXES
from mavdem.alignment.read import usable_segments
from mavdem.alignment.signals import Signals
from mavdem.analysis.analysis import flown_after
from mavdem.condition.loop.from_flight import loop_of
from mavdem.condition.loop.loop import Loop
from mavdem.dem import NotIdentifiable, physical
from mavdem.dem.record import Record
from mavdem.errors import NotLearnable
from mavdem.facts import Fact
from mavdem.ingest import Log


def loops_of_log(signals: Signals, log: Log, start: float = 0.0) -> Loop:
    """Returns the loops of the axis of ``signals``; raises ``NotLearnable``: why there are none."""
    segments, verdict = usable_segments(signals, log.components)
    if not segments:
        raise NotLearnable(verdict.reason)
    flights = flown_after(segments, start)
    plant = physical(flights)
    if isinstance(plant, NotIdentifiable):
        raise NotLearnable(plant.reason)
    return loop_of(plant, Record.of(flights))


def loops_of_axes(
    log: Log,
    signals: Signals,
    axes: Sequence[str] = AXES,
    start: float = 0.0,
) -> dict[str, Loop | Fact]:
    """Returns the loops of each of the ``axes``, or why there are none."""
    found = dict[str, Loop | Fact]()
    for axis in axes:
        try:
            found[axis] = loops_of_log(signals.about(axis, signals.inputs), log, start)
        except NotLearnable as error:
            found[axis] = error.fact
    return found
