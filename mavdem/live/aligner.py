"""Attitude and motor outputs on one uniform clock, row by row: ``align`` in small steps.

The grid starts where that of ``align`` would, given the first seconds of both streams, and each stream is sampled in
the way ``align`` chooses from those seconds. A point is complete as soon as both streams have passed it.

Latency on the boot clock, beside that of the link: none where samples are kept, at most one interval of the slower
stream where they are interpolated, ``FILTER_EDGE_STEPS`` grid steps (50 ms at 100 Hz) where one is low-passed.

One difference from ``align``: when a message is lost, ``align`` interpolates the whole segment, this only beside the
loss. A kept sample lies within ``STAMP_SECONDS`` of its point.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.alignment.align import (
    FILTER_EDGE_STEPS,
    STAMP_SECONDS,
    grid_of,
    impulse_response,
    is_low_passed,
    kept_rows,
    mean_rate,
    step,
)
from mavdem.alignment.signals import MINIMUM_RATE
from mavdem.ingest.motors import MotorGeometry, OutputScale
from mavdem.live.messages import Values
from mavdem.live.samples import SampleBuffer

DECISION_SECONDS = 2.0  # Duration of both streams from which the step and the sampling are decided
RESUME_SECONDS = 0.25  # Duration of both streams after a gap, after which the grid starts again with the previous step
STAMP_RESOLUTION_SECONDS = 1e-6  # The finest stamps: a point no further behind the latest sample coincides with it
OTHER_RATE_RATIO = 1.3  # A rate that differs by this factor from the one that decided the step is another rate


class AlignedRow(NamedTuple):
    """One point of the grid, as a row of the ``Flight`` that ``align`` returns.

    Attributes:
        time: s on the boot clock.
        inputs: (r,) motor outputs in the unit of the stream, or the demand.
        outputs: (2,) angle, rad, and body rate, rad/s.
        segment: number of the segment, from 0 on; rows of one segment are one step apart.
        received: UNIX s at which the bytes that completed it were received.
        settled: whether the vehicle was in settled flight, as far as is known by then.
    """

    time: float
    inputs: NDArray[np.float64]
    outputs: NDArray[np.float64]
    segment: int
    received: float
    settled: bool


@dataclass(frozen=True, eq=False)
class Setup:
    """What the rows of a segment are, like the ``provenance`` of a ``Flight``.

    Attributes:
        segment, boot: number of the segment and of the boot.
        dt: step, s.
        attitude, motors: names of the messages.
        layout, scale: of the inputs.
        rates: Hz of attitude and motors that decided the step.
        start: first point of the grid, s; the first row may be a few seconds later.
    """

    segment: int
    boot: int
    dt: float
    attitude: str
    motors: str
    layout: MotorGeometry
    scale: OutputScale
    rates: tuple[float, ...]
    start: float


@dataclass(frozen=True, eq=False)
class _Sampling:
    """How a stream is sampled: kept, interpolated, or low-passed by ``weights`` at ``offsets`` s."""

    keeps: bool
    weights: NDArray[np.float64] | None = None
    offsets: NDArray[np.float64] | None = None


class Aligner:
    """The grid of one boot, segment by segment.

    ``segment``: number of the latest segment, from 0 on; -1 before the first. ``running``: whether the segment
    continues. ``dt``: step, s; None before it is decided. ``rates``: Hz of the streams that decided it. ``start``:
    first point of the segment's grid, s.
    """

    def __init__(self) -> None:
        self.segment, self.running, self.start = -1, False, 0.0
        self.dt: float | None = None
        self.rates: tuple[float, ...] = ()
        self._streams: tuple[SampleBuffer, ...] = ()
        self._samplings: tuple[_Sampling, ...] = ()
        self._usual_steps: tuple[float | None, ...] = ()
        self._next = 0
        self._latest = -np.inf
        self._try_from = self._steady_from = -np.inf
        self._steps: list[float] = []

    def end(self) -> None:
        """Ends the segment; the step stays."""
        self.running = False
        self._try_from = -np.inf

    def forget_step(self) -> None:
        """Ends the segment; the next one decides the step again."""
        self.end()
        self.dt = None

    def restart(self) -> None:
        """Resets the clock after a reboot; the segment's number and the steps used so far stay."""
        self.forget_step()
        self._latest = self._steady_from = -np.inf

    def begin(self, streams: Sequence[SampleBuffer]) -> bool:
        """Starts a segment if the streams, attitude first, are long enough; returns whether it did."""
        first = max((stream.time[0] if stream.time else np.inf) for stream in streams)
        last = min((stream.time[-1] if stream.time else -np.inf) for stream in streams)
        first = max(first, self._latest + STAMP_RESOLUTION_SECONDS, self._steady_from)
        if last < self._try_from or last - first < (DECISION_SECONDS if self.dt is None else RESUME_SECONDS):
            return False
        times = [np.array(stream.time) for stream in streams]
        times = [time[(time >= first - STAMP_SECONDS) & (time <= last + STAMP_SECONDS)] for time in times]
        if min(map(len, times)) < 3:
            return False
        if self.dt is None:
            rates = tuple(mean_rate(time) for time in times)
            if min(rates) < MINIMUM_RATE:
                self._try_from = last + DECISION_SECONDS / 4
                return False
            if not all(_is_steady(time, first, last) for time in times):
                # Decided from stamps of both rates, the step would be neither's, and stay.
                self._steady_from = last
                return False
            self.dt, self.rates = self._step(rates), rates
            self._usual_steps = tuple(stream.usual_step() for stream in streams)
        grid = grid_of(times[0], times[1], self.dt)
        self._samplings = tuple(_sampling(time, grid, self.dt) for time in times)
        self._streams = tuple(streams)
        self.start = float(grid[0])
        # Only the end of the deciding seconds becomes rows: a learner must not start with seconds to catch up on.
        self._next = int(np.searchsorted(grid, last - RESUME_SECONDS - STAMP_RESOLUTION_SECONDS))
        self.segment += 1
        self.running = True
        return True

    def points(self) -> Iterator[tuple[float, list[Values]]]:
        """The points that all streams have passed since the last call: s, and the values of each stream."""
        assert self.dt is not None
        while self.running:
            time = self.start + self.dt * self._next
            values = []
            for stream, sampling in zip(self._streams, self._samplings, strict=True):
                if not stream.time or time < stream.time[0] - STAMP_SECONDS:
                    self.end()  # one stream was ahead of the other for longer than samples are kept
                    return
                value = _value_at(stream, sampling, time, self.dt)
                if value is None:
                    return
                values.append(value)
            self._next += 1
            self._latest = time
            for stream in self._streams:
                stream.used_until = time
            yield time, values

    def former_rate(self, stream: SampleBuffer) -> float | None:
        """The rate, Hz, of a stream when the step was decided, if it has changed since; else None."""
        if not self.running or stream not in self._streams:
            return None
        before, now = self._usual_steps[self._streams.index(stream)], stream.usual_step()
        if before is None or now is None or 1 / OTHER_RATE_RATIO < now / before < OTHER_RATE_RATIO:
            return None
        return 1 / before

    def _step(self, rates: tuple[float, ...]) -> float:
        """The step for these rates: one used before if the rates are about the same.

        Lost samples make the measured step a little longer, and the model learned so far has the earlier one.
        """
        new = step(rates)
        for before in self._steps:
            if 1 / OTHER_RATE_RATIO < new / before < OTHER_RATE_RATIO:
                return before
        self._steps.append(new)
        return new


def _is_steady(time: NDArray[np.float64], first: float, last: float) -> bool:
    """Whether as many of the stamps (N,) lie in each quarter of the time; lost messages aside."""
    counts, _ = np.histogram(time, bins=4, range=(first, last))
    return bool(counts.max() < OTHER_RATE_RATIO * counts.min())


def _sampling(time: NDArray[np.float64], grid: NDArray[np.float64], dt: float) -> _Sampling:
    if is_low_passed(time, dt):
        rate = mean_rate(time)
        weights = impulse_response(rate, dt)
        reach = len(weights) // 2
        return _Sampling(False, weights, np.arange(-reach, reach + 1) / rate)
    return _Sampling(kept_rows(grid, time) is not None)


def _value_at(stream: SampleBuffer, sampling: _Sampling, time: float, dt: float) -> Values | None:
    """The stream's values at ``time``; None if they are not known yet."""
    last = stream.time[-1]
    if sampling.weights is not None and sampling.offsets is not None:
        if last < time + FILTER_EDGE_STEPS * dt - STAMP_SECONDS:
            return None
        stamps, values = stream.between(time + sampling.offsets[0], time + sampling.offsets[-1])
        even = [np.interp(time + sampling.offsets, stamps, column) for column in values.T]
        return tuple((np.array(even) @ sampling.weights).tolist())
    # Where two samples may lie within STAMP_SECONDS of one point, wait for the later one too.
    until = time - STAMP_SECONDS if dt >= 3 * STAMP_SECONDS else time
    if sampling.keeps and last >= until and (near := stream.nearest(time, STAMP_SECONDS)) is not None:
        return near
    if last < time - STAMP_RESOLUTION_SECONDS:
        return None
    return stream.interpolate(max(min(time, last), stream.time[0]))
