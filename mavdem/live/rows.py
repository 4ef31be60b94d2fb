"""The fast path: messages on the boot clock, and their samples on a uniform grid, row by row.

Time stamps of attitude are the reference, and all others are placed nearest to the latest of them, which undoes their
wraps. The grid starts where that of ``align`` would, given the first seconds of both streams, and each stream is
sampled in the way ``align`` chooses from those seconds, but where a message is lost: ``align`` interpolates the whole
segment then, this only beside the loss. A point is complete as soon as both streams have passed it.

Latency on the boot clock, beside that of the link: none where samples are kept, at most one interval of the slower
stream where they are interpolated, ``FILTER_EDGE_STEPS`` grid steps (50 ms at 100 Hz) where one is low-passed.
"""

from bisect import bisect_left
from collections.abc import Callable, Iterator, Sequence
from math import inf, isfinite, isnan, nan, nextafter
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.containers import Numbers
from mavdem.dataset import resampling, segments
from mavdem.dataset.attitude import ATTITUDE_MESSAGES
from mavdem.dataset.learnability import MAX_STEP_RATIO
from mavdem.dataset.setpoints import STAMP_ROUNDING
from mavdem.dataset.signals import MIN_STREAM_RATE
from mavdem.facts import Fact
from mavdem.facts.session import VehicleFact
from mavdem.ingest.mavlink.clocks import (
    MAX_STAMP_DEVIATION,
    MAX_WRAP_GAP,
    MIN_RESET_STAMPS,
    MIN_RESET_STEP,
)
from mavdem.ingest.telemetry import MAX_GAP_SECONDS
from mavdem.live.messages import Message

# Of each stream: enough to decide rates and steps, also of hostile stamps
KEPT_SECONDS = 4.5
MAX_SAMPLES = 8192
DECISION_SECONDS = 2.0  # Duration of both streams from which the step and the sampling are decided
# Duration of both streams after a gap, after which the grid starts again with the previous step
RESUME_SECONDS = 0.25


class AlignedRow(NamedTuple):
    """One point of the grid, as a row of the ``Flight`` that ``align`` returns.

    Attributes:
        time: s on the boot clock.
        inputs: (r,) motor outputs in the unit of the stream, or the demand.
        outputs: (2,) angle, rad, and body rate, rad/s.
        segment: its number, from 0 on; rows of one segment are one step apart.
        settled: whether the vehicle was in settled flight, as far as is known by then.
        free: whether it was, or was on its way up after take-off, which is learned from at first.
    """

    time: float
    inputs: Array
    outputs: Array
    segment: int
    settled: bool
    free: bool


class PlacedMessage(NamedTuple):
    """A ``message`` at ``time`` s of boot number ``boot``; ``stamped`` if the time is from its own stamp."""

    message: Message
    time: float
    boot: int
    stamped: bool


class BootClock:
    """Places the messages of one vehicle on its boot clock; ``report`` is called with each fact about it.

    A message whose stamp does not continue the clock is dropped. If the next attitude stamps continue from there, the
    clock has changed.
    """

    def __init__(self, report: Callable[[Fact], None]) -> None:
        # the latest reference stamp, s, and the number of the boot
        self.now = nan
        self.boot = 0
        self._latest = nan
        self._turns = 0
        self._run: list[float] = []
        self._report = report

    def place(self, message: Message) -> PlacedMessage | None:
        """Returns the message in its place; None where it has none."""
        stamped = message.stamp > 0
        if not stamped:
            time = None if isnan(self._latest) else self._latest
        elif message.name in ATTITUDE_MESSAGES:
            time = self._reference(message)
        else:
            time = self._time_of(message)
        if time is None:
            return None
        self._latest = time
        return PlacedMessage(message, time, self.boot, stamped)

    def _reference(self, message: Message) -> float | None:
        """The time of an attitude; None where it neither continues the clock nor shows that it has changed."""
        time = message.stamp + self._turns * message.period if self._turns else message.stamp
        if time < self.now - MIN_RESET_STEP and time + message.period - self.now <= MAX_WRAP_GAP:
            time += message.period
        if not _continues(time, self.now):
            time = message.stamp
            is_next = bool(self._run) and _continues(time, self._run[-1])
            self._run = [*self._run, time] if is_next else [time]
            if len(self._run) < MIN_RESET_STAMPS:
                return None
            self._restart(self._run[0])
        self._turns = (
            round((time - message.stamp) / message.period) if isfinite(message.period) else 0
        )
        self.now = max(self.now, time)
        self._run = []
        return time

    def _restart(self, first: float) -> None:
        """Starts the clock again at the ``first`` of stamps that continue each other."""
        before = self.now
        self.now = first
        if first < before:
            self.boot += 1
            self._report(Fact(VehicleFact.VEHICLE_REBOOTED, clock=before))
        elif not isnan(before):
            self._report(Fact(VehicleFact.CLOCK_JUMPED, offset=first - before, clock=before))

    def _time_of(self, message: Message) -> float | None:
        """The time of another message by the reference; None if it is far off."""
        if isnan(self.now):
            return None
        time = message.stamp
        if isfinite(message.period):
            time += message.period * round((self.now - time) / message.period)
        return time if abs(time - self.now) <= MAX_STAMP_DEVIATION else None


def _continues(time: float, before: float) -> bool:
    return -MIN_RESET_STEP < time - before <= MAX_STAMP_DEVIATION


class Samples:
    """Stamps and values of the last ``KEPT_SECONDS`` of one stream, in the order of their stamps."""

    def __init__(self) -> None:
        self.time: list[float] = []  # s, ascending
        self.values: list[Numbers] = []
        # the step, s, before the latest sample, if longer than MAX_GAP_SECONDS; else 0
        self.gap = 0.0
        # number of samples so far, and of those that came after the row they belong to
        self.added = self.late = 0
        # s; rows up to it are complete, and samples before it are late
        self.used_until = self._start = -inf

    @property
    def since(self) -> float:
        """The time, s, of the first sample since the last gap; infinite without any."""
        return max(self._start, self.time[0]) if self.time else inf

    def add(self, time: float, values: Numbers) -> bool:
        """Adds a sample; returns False for a copy, a repeated stamp, a late sample and values that are not finite."""
        stamps = self.time
        row = bisect_left(stamps, time)
        if not all(map(isfinite, values)) or stamps[row : row + 1] == [time]:
            return False
        if row < len(stamps) and time <= max(self.used_until, self.since):
            self.late += 1
            return False
        self.gap = 0.0
        if 0 < row == len(stamps) and time - stamps[-1] > MAX_GAP_SECONDS:
            self.gap = time - stamps[-1]
            self._start = time
        stamps.insert(row, time)
        self.values.insert(row, values)
        self.added += 1
        # Only now and then: deleting from the front of a list moves all of it.
        if self.added % 64 == 0:
            drop = max(bisect_left(stamps, stamps[-1] - KEPT_SECONDS), len(stamps) - MAX_SAMPLES)
            del stamps[:drop], self.values[:drop]
        return True

    def break_off(self) -> None:
        """Begins a new run of samples with the next one, as after a gap."""
        self._start = nextafter(self.time[-1], inf) if self.time else self._start

    def count(self, now: float) -> int:
        """Returns the number of samples in the ``DECISION_SECONDS`` before ``now``."""
        return len(self.time) - bisect_left(self.time, now - DECISION_SECONDS)

    def rate(self, now: float) -> float:
        """Returns the rate, Hz, over the ``DECISION_SECONDS`` before ``now``, gaps included.

        It is 0 with fewer than two samples.
        """
        return (
            resampling.mean_rate(np.array(self.time[-count:]))
            if (count := self.count(now)) > 1
            else 0.0
        )

    def steady_rate(self) -> float | None:
        """Returns the rate, Hz, over the last ``DECISION_SECONDS``, not those before a gap; None with few samples."""
        last = self.time[
            bisect_left(self.time, max(self.since, self.time[-1] - DECISION_SECONDS)) :
        ]
        return resampling.mean_rate(np.array(last)) if len(last) > segments.MEDIAN_STEPS else None

    def nearest(self, time: float) -> Numbers | None:
        """Returns the sample nearest to ``time``; None if it is farther than ``STAMP_SECONDS``."""
        after = bisect_left(self.time, time)
        rows = [row for row in (after - 1, after) if 0 <= row < len(self.time)]
        row = min(rows, key=lambda row: abs(self.time[row] - time), default=None)
        return (
            None
            if row is None or abs(self.time[row] - time) > resampling.STAMP_RESOLUTION
            else self.values[row]
        )

    def weighted(self, time: float, weights: Array, offsets: Array) -> Numbers:
        """Returns the values interpolated at ``offsets`` (L,) s from ``time``, summed by ``weights`` (L,)."""
        first = max(
            bisect_left(self.time, time + offsets[0]) - 1, bisect_left(self.time, self.since)
        )
        rows = slice(first, bisect_left(self.time, time + offsets[-1]) + 1)
        even = [
            np.interp(time + offsets, self.time[rows], column)
            for column in np.array(self.values[rows]).T
        ]
        return tuple((np.array(even) @ weights).tolist())


_Sampling = tuple[Array, Array, bool]
"""How a stream is sampled: by several weights at offsets, s, low-passed, by one interpolated; whether rows are kept."""


class Grid:
    """The grid of one boot, segment by segment."""

    def __init__(self) -> None:
        # number of the latest segment, from 0 on, and whether it continues
        self.segment = -1
        self.running = False
        self.start = 0.0  # first point of the segment's grid, s
        self.dt: float | None = None  # step, s, once it is decided
        self.rates: Numbers = ()  # Hz of the streams that decided it
        self._streams: tuple[Samples, ...] = ()
        self._samplings: tuple[_Sampling, ...] = ()
        self._next = 0
        self._latest = self._try_from = self._steady_from = -inf
        self._steps: list[float] = []  # so far

    def end(self, forget_step: bool = False) -> None:
        """Ends the segment; the step stays, or the next one decides it again."""
        self.running = False
        self._try_from = -inf
        self.dt = None if forget_step else self.dt

    def restart(self) -> None:
        """Resets the clock after a reboot; the segment's number and the steps used so far stay."""
        self.end(forget_step=True)
        self._latest = self._steady_from = -inf

    def begin(self, streams: Sequence[Samples]) -> bool:
        """Starts a segment if the streams, attitude first, are long enough; returns whether it did."""
        first = max(stream.since for stream in streams)
        last = min((stream.time[-1] if stream.time else -inf) for stream in streams)
        first = max(first, self._latest + STAMP_ROUNDING, self._steady_from)
        if last < self._try_from or last - first < (
            DECISION_SECONDS if self.dt is None else RESUME_SECONDS
        ):
            return False
        times = [np.array(stream.time) for stream in streams]
        times = [
            time[
                (time >= first - resampling.STAMP_RESOLUTION)
                & (time <= last + resampling.STAMP_RESOLUTION)
            ]
            for time in times
        ]
        if min(map(len, times)) < 3:
            return False
        if self.dt is None:
            rates = tuple(resampling.mean_rate(time) for time in times)
            if min(rates) < MIN_STREAM_RATE:
                self._try_from = last + DECISION_SECONDS / 4
                return False
            quarters = np.array(
                [np.histogram(time, bins=4, range=(first, last))[0] for time in times]
            )
            if np.any(quarters.max(axis=1) >= MAX_STEP_RATIO * quarters.min(axis=1)):
                # A rate changes: decided from stamps of both, the step would be neither's, and stay.
                self._steady_from = last
                return False
            self.dt = self._step(resampling.common_step(times))
            self.rates = rates
        grid = resampling.common_grid(times[0], times[1], self.dt)
        self._samplings = tuple(_sampling(time, grid, self.dt) for time in times)
        self._streams = tuple(streams)
        self.start = float(grid[0])
        # Only the end of the deciding seconds becomes rows: a learner must not start with seconds to catch up on.
        self._next = int(np.searchsorted(grid, last - RESUME_SECONDS - STAMP_ROUNDING))
        self.segment += 1
        self.running = True
        return True

    def points(self) -> Iterator[tuple[float, list[Numbers]]]:
        """Yields the points that all streams have passed since the last call: s, and the values of each stream."""
        assert self.dt is not None
        while self.running:
            time = self.start + self.dt * self._next
            values = []
            for stream, sampling in zip(self._streams, self._samplings, strict=True):
                if time < stream.since - resampling.STAMP_RESOLUTION:
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

    def former_rate(self, stream: Samples) -> float | None:
        """Returns the rate, Hz, of a stream when the step was decided, if it has changed since; else None."""
        if not self.running or stream not in self._streams:
            return None
        before = self.rates[self._streams.index(stream)]
        now = stream.steady_rate()
        return (
            before
            if now is not None and not 1 / MAX_STEP_RATIO < now / before < MAX_STEP_RATIO
            else None
        )

    def _step(self, new: float) -> float:
        """The step: one used before if it is about the same.

        Lost samples make the measured step a little longer, and the model learned so far has the earlier one.
        """
        former = [step for step in self._steps if 1 / MAX_STEP_RATIO < new / step < MAX_STEP_RATIO]
        self._steps += [new] * (not former)
        return [*former, new][0]


def _sampling(time: Array, grid: Array, dt: float) -> _Sampling:
    if not resampling.needs_low_pass(time, dt):
        return np.ones(1), np.zeros(1), resampling.nearest_rows(grid, time) is not None
    weights = resampling.low_pass_impulse_response(rate := resampling.mean_rate(time), dt)
    return weights, (np.arange(len(weights)) - len(weights) // 2) / rate, False


def _value_at(stream: Samples, sampling: _Sampling, time: float, dt: float) -> Numbers | None:
    """The stream's values at ``time``; None if they are not known yet."""
    (weights, offsets, kept) = sampling
    last = stream.time[-1]
    # Where two samples may lie within STAMP_SECONDS of one point, wait for the later one too.
    until = time - resampling.STAMP_RESOLUTION if dt >= 3 * resampling.STAMP_RESOLUTION else time
    if kept and last >= until and (near := stream.nearest(time)) is not None:
        return near
    ahead = (
        resampling.FILTER_EDGE_STEPS * dt - resampling.STAMP_RESOLUTION
        if len(weights) > 1
        else -STAMP_ROUNDING
    )
    return stream.weighted(time, weights, offsets) if last >= time + ahead else None
