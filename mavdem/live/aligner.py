"""Attitude and what drives it on one uniform clock, row by row: ``align`` in small steps.

The grid begins where that of ``align`` would, from the first seconds of both streams, and its points are told as soon
as both streams have passed them. Every stream is read in the way that ``align`` chooses from those seconds: samples are
kept where each point has one within ``STAMP``; read off the line between the neighbours; or low-passed first.

Latency, from the moment a point lies in on the boot clock until it is told, beside that of the link: none where samples
are kept, at most one interval of the slower stream where they are read off the line, ``UNSURE`` grid steps (50 ms at
100 Hz) where one is low-passed.

Where ``align`` sees a whole segment, this does not: when a message is lost, ``align`` reads all of the segment off the
line, and this only what stands beside the loss. A kept sample lies within ``STAMP`` of its point, the line on it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.align import (
    MINIMUM_RATE,
    STAMP,
    UNSURE,
    decimated,
    grid_of,
    impulse_response,
    kept,
    mean_rate,
    step,
)
from mavdem.ingest.live_messages import Values
from mavdem.live.samples import Samples

DECIDING = 2.0
"""Seconds of both streams that decide step and ways."""
RESUMING = 0.25
"""Seconds of both streams after a gap, from which the grid is begun anew with the step there was."""
TOUCHING = 1e-6
"""Seconds, the resolution of the finest stamps: a point no further behind the latest sample lies on it."""
ANOTHER_RATE = 1.3
"""Times as fast or as slow as when the step was decided, which makes another rate of it."""


class Point(NamedTuple):
    """A point of the grid, ``time`` s, and what each stream reads there."""

    time: float
    values: tuple[Values, ...]


@dataclass(frozen=True, eq=False)
class _Way:
    """How a stream is read: by its samples, off the line, or through the filter's ``weights`` at ``offsets`` s."""

    keeps: bool
    weights: NDArray[np.float64] | None = None
    offsets: NDArray[np.float64] | None = None


class Aligner:
    """The grid of one boot, segment by segment.

    Attributes:
        segment: number of the latest segment, from 0 on; -1 before the first.
        running: whether the segment goes on.
        dt: step, s; None before it was decided.
        rates: Hz of the streams from which it was.
        start: first point of the segment's grid, s; told are those from ``RESUMING`` before it was decided on.
    """

    def __init__(self) -> None:
        """Begins without a grid."""
        self.segment = -1
        self.running = False
        self.dt: float | None = None
        self.rates: tuple[float, ...] = ()
        self.start = 0.0
        self._streams: tuple[Samples, ...] = ()
        self._ways: tuple[_Way, ...] = ()
        self._usual: tuple[float | None, ...] = ()
        self._next = 0
        self._told = -np.inf
        self._try_from = -np.inf
        self._steps: list[float] = []

    def end(self) -> None:
        """Ends the segment; the step stays."""
        self.running = False
        self._try_from = -np.inf

    def forget(self) -> None:
        """Ends the segment, and the step is to be decided anew, among those there were if one fits."""
        self.end()
        self.dt = None

    def begin_anew(self) -> None:
        """Forgets all but the number of the segment and the steps there were, after a reboot."""
        self.forget()
        self._told = -np.inf

    def begin(self, streams: Sequence[Samples]) -> bool:
        """Begins a segment if the streams, attitude first and what drives it second, are long enough by now."""
        first = max((stream.time[0] if stream.time else np.inf) for stream in streams)
        last = min((stream.time[-1] if stream.time else -np.inf) for stream in streams)
        first = max(first, self._told + TOUCHING)
        if last < self._try_from or last - first < (DECIDING if self.dt is None else RESUMING):
            return False
        times = [np.array(stream.time) for stream in streams]
        times = [time[(time >= first - STAMP) & (time <= last + STAMP)] for time in times]
        if min(map(len, times)) < 3:
            return False
        if self.dt is None:
            rates = tuple(mean_rate(time) for time in times)
            if min(rates) < MINIMUM_RATE:
                self._try_from = last + DECIDING / 4
                return False
            self.dt, self.rates = self._step(rates), rates
            self._usual = tuple(stream.usual_step() for stream in streams)
        grid = grid_of(times[0], times[1], self.dt)
        self._ways = tuple(self._way(time, grid) for time in times)
        self._streams = tuple(streams)
        self.start = float(grid[0])
        # What decided is not told but for its end: a learner must not begin with seconds of rows to catch up on.
        self._next = int(np.searchsorted(grid, last - RESUMING - TOUCHING))
        self.segment += 1
        self.running = True
        return True

    def points(self) -> Iterator[Point]:
        """The points that all streams have passed since the last call."""
        assert self.dt is not None
        while self.running:
            time = self.start + self.dt * self._next
            values = []
            for stream, way in zip(self._streams, self._ways, strict=True):
                if not stream.time or time < stream.time[0] - STAMP:
                    self.end()  # one stream waited for the other longer than samples are kept
                    return
                read = self._read(stream, way, time)
                if read is None:
                    return
                values.append(read)
            self._next += 1
            self._told = time
            for stream in self._streams:
                stream.told(time)
            yield Point(time, tuple(values))

    def former_rate(self, stream: Samples) -> float | None:
        """The rate, Hz, that a stream had when the step was decided, where it has another now."""
        if not self.running or stream not in self._streams:
            return None
        before, now = self._usual[self._streams.index(stream)], stream.usual_step()
        if before is None or now is None or 1 / ANOTHER_RATE < now / before < ANOTHER_RATE:
            return None
        return 1 / before

    def _step(self, rates: tuple[float, ...]) -> float:
        """The step for these rates: one there was before, where they are no other rates than then.

        Samples lost while it is decided make it a little longer, and what was learnt is of the step there was.
        """
        new = step(rates)
        for before in self._steps:
            if 1 / ANOTHER_RATE < new / before < ANOTHER_RATE:
                return before
        self._steps.append(new)
        return new

    def _way(self, time: NDArray[np.float64], grid: NDArray[np.float64]) -> _Way:
        assert self.dt is not None
        if decimated(time, self.dt):
            rate = mean_rate(time)
            weights = impulse_response(rate, self.dt)
            reach = len(weights) // 2
            return _Way(False, weights, np.arange(-reach, reach + 1) / rate)
        return _Way(kept(grid, time) is not None)

    def _read(self, stream: Samples, way: _Way, time: float) -> Values | None:
        """What the stream is at ``time``; None where that is not known yet."""
        assert self.dt is not None
        last = stream.time[-1]
        if way.weights is not None and way.offsets is not None:
            if last < time + UNSURE * self.dt - STAMP:
                return None
            stamps, values = stream.stretch(time + way.offsets[0], time + way.offsets[-1])
            even = [np.interp(time + way.offsets, stamps, column) for column in values.T]
            return tuple((np.array(even) @ way.weights).tolist())
        # Where two samples may lie within STAMP of one point, the one behind must be awaited too.
        until = time - STAMP if self.dt >= 3 * STAMP else time
        if way.keeps and last >= until and (near := stream.nearest(time, STAMP)) is not None:
            return near
        if last < time - TOUCHING:
            return None
        return stream.at(max(min(time, last), stream.time[0]))
