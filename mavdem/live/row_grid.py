"""The uniform time grid of a live flight, at whose points attitude and motor outputs are resampled, one by one.

The grid starts where ``mavdem.dataset.alignment`` would start one, given the first seconds of both streams, and each
stream is sampled in the way that is chosen from those seconds: its samples are kept, interpolated or low-passed. Only
where a message is lost the two differ: a log then interpolates the whole segment, the live grid only beside the loss.

A point is complete as soon as all streams have passed it. Its latency on the boot clock is none where samples are kept,
at most one interval of the slower stream where they are interpolated, and ``FILTER_EDGE_STEPS`` grid steps (50 ms at
100 Hz) where a stream is low-passed.
"""

from collections.abc import Sequence
from math import inf
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.containers import Numbers
from mavdem.dataset import resampling
from mavdem.dataset.segment_learnability import MAX_STEP_RATIO
from mavdem.dataset.setpoints import STAMP_ROUNDING
from mavdem.dataset.signals import MIN_STREAM_RATE
from mavdem.live.samples import DECISION_SECONDS, SampleStream

RESUME_SECONDS = 0.25
"""Duration of all streams after a gap, after which the grid goes on with the same step, s: a choice.

Also how much of the deciding seconds becomes rows: a learner must not begin with seconds of rows to catch up on.
"""

RETRY_SECONDS = DECISION_SECONDS / 4
"""Time until a grid is tried again where rates were too low, s: a choice."""

MIN_SAMPLES = 3
"""Samples of each stream, at least, that a grid begins with: two steps, so that a rate is a mean."""

RATE_BINS = 4
"""Parts of the deciding seconds whose numbers of samples are compared, so that a rate that changes is noticed."""


class StreamSampling(NamedTuple):
    """How one stream is sampled at the points of a grid."""

    weights: Array
    """(L,) Impulse response of the low-pass filter; a single 1 where values are interpolated."""

    offsets: Array
    """(L,) Times that the weights apply to, relative to a point, s."""

    keeps_samples: bool
    """Whether the stream's own samples are kept, which lie on the grid."""


class GridPoint(NamedTuple):
    """A point of the grid that all streams have passed."""

    time: float
    """Time, s of the boot clock."""

    values: list[Numbers]
    """The values of each stream, in the order of the streams."""


class RowGrid:
    """The time grid of the samples (rows) that a live model is learned from; a gap or another rate ends its segment.

    Attributes:
        segment: number of the latest segment, from 0 on; −1 before the first.
        is_running: whether that segment goes on.
        start_time: first point of the segment's grid, s.
        dt: step, s; None before it is decided.
        rates: rates of the streams when the step was decided, Hz.
    """

    def __init__(self) -> None:
        """Makes a grid without points: its first segment begins with :meth:`begin`."""
        self.segment = -1
        self.is_running = False
        self.start_time = 0.0
        self.dt: float | None = None
        self.rates: Numbers = ()
        # The streams of the present segment, and how each of them is sampled.
        self._streams: tuple[SampleStream, ...] = ()
        self._samplings: tuple[StreamSampling, ...] = ()
        # Number of the next point to complete, 0 at the beginning of the grid: its time is start_time + dt · number.
        self._next_index = 0
        # Time of the latest completed point, s of the boot clock.
        self._latest_time = -inf
        # Where streams were too slow: the time from which on a new segment is tried again, s.
        self._next_attempt_time = -inf
        # Where a stream changed its rate: the end of the seconds in which it did, s. Only later samples decide about
        # the step.
        self._rate_change_time = -inf
        # All steps that segments have had, s, of which one is taken again where a measured step is nearly the same.
        self._former_steps: list[float] = []

    def end(self, *, forget_step: bool = False) -> None:
        """Ends the segment: until the next one begins, no points are completed.

        Args:
            forget_step: whether the time step is decided again for the next segment; otherwise it stays.
        """
        self.is_running = False
        self._next_attempt_time = -inf
        if forget_step:
            self.dt = None

    def restart(self) -> None:
        """Ends the segment at a reboot, whose clock begins again; numbers of segments and former steps stay."""
        self.end(forget_step=True)
        self._latest_time = -inf
        self._rate_change_time = -inf

    def begin(self, streams: Sequence[SampleStream]) -> bool:
        """Begins a segment if all streams have samples of enough seconds in common; called with each new sample.

        The first ``DECISION_SECONDS`` decide the time step and how each stream is sampled. After a gap the step is
        known already, so ``RESUME_SECONDS`` are enough. The grid is laid over all these seconds, as for a log, but only
        the last ``RESUME_SECONDS`` become rows: a learner must not begin with seconds of rows to catch up on.

        Args:
            streams: those that rows are made of: attitude first, then that with most motors, then others.

        Returns:
            Whether the segment has begun.
        """
        # Samples from before a gap, before the end of the former segment or at a former rate do not count.
        start_time = max(
            *(stream.start_time for stream in streams),
            self._latest_time + STAMP_ROUNDING,
            self._rate_change_time,
        )
        # Every stream has samples until this time.
        end_time = min((stream.time[-1] if stream.time else -inf) for stream in streams)
        needed_seconds = DECISION_SECONDS if self.dt is None else RESUME_SECONDS
        if end_time < self._next_attempt_time or end_time - start_time < needed_seconds:
            return False
        times = [_times_between(stream, start_time, end_time) for stream in streams]
        if min(len(time) for time in times) < MIN_SAMPLES:
            return False
        if self.dt is None:
            self.dt = self._decided_step(times, start_time, end_time)
            if self.dt is None:
                return False
        attitude_times, motor_times = times[:2]
        grid = resampling.common_grid(attitude_times, motor_times, self.dt)
        self._samplings = tuple(_sampling(time, grid, self.dt) for time in times)
        self._streams = tuple(streams)
        self.start_time = float(grid[0])
        first_row_time = end_time - RESUME_SECONDS - STAMP_ROUNDING
        self._next_index = int(np.searchsorted(grid, first_row_time))
        self.segment += 1
        self.is_running = True
        return True

    def _decided_step(
        self, times: Sequence[Array], start_time: float, end_time: float
    ) -> float | None:
        """Decides the time step of the grid by the rates of the streams, as for a log.

        The decision is put off in two cases. If a stream is slower than ``MIN_STREAM_RATE``, the next attempt is made
        after ``RETRY_SECONDS``. If a rate changes within these seconds, only later samples decide. A change is
        recognised by the numbers of samples in ``RATE_BINS`` equal parts of these seconds.

        Args:
            times: stamps of each stream between the limits, (N,) each, s.
            start_time: lower limit, s of the boot clock.
            end_time: upper limit, s.

        Returns:
            The step, s; None if the decision is put off.
        """
        rates = tuple(resampling.mean_rate(time) for time in times)
        if min(rates) < MIN_STREAM_RATE:
            self._next_attempt_time = end_time + RETRY_SECONDS
            return None
        for time in times:
            counts, _edges = np.histogram(time, bins=RATE_BINS, range=(start_time, end_time))
            has_rate_changed = counts.max() >= MAX_STEP_RATIO * counts.min()
            if has_rate_changed:
                # A step decided from stamps of both rates would be neither's, and would stay.
                self._rate_change_time = end_time
                return None
        self.rates = rates
        return self._reused_step(resampling.common_step(times))

    def _reused_step(self, step: float) -> float:
        """Replaces a measured step by the step of an earlier segment, if they differ by less than ``MAX_STEP_RATIO``.

        Lost samples make the measured step a little longer. The model that was learned so far has the earlier step, and
        can only go on with rows of the same one.

        Args:
            step: measured step, s. If no earlier one is near it, it is noted for later segments.

        Returns:
            The earlier step, s, or else the measured one.
        """
        for former_step in self._former_steps:
            ratio = step / former_step
            is_nearly_the_same = 1 / MAX_STEP_RATIO < ratio < MAX_STEP_RATIO
            if is_nearly_the_same:
                return former_step
        self._former_steps.append(step)
        return step

    def completed_points(self) -> list[GridPoint]:
        """Returns the points of the grid that all streams have passed since the last call, with their values.

        A point is complete when no later sample can change any stream's value at it. Samples that come for an earlier
        time afterwards are late, and dropped (``completed_time``). The segment ends where one stream is so far ahead of
        another that its samples at the next point were dropped already. A segment must be running, since its beginning
        decides the step.
        """
        assert self.dt is not None
        points: list[GridPoint] = []
        while self.is_running:
            time = self.start_time + self.dt * self._next_index
            values = []
            for stream, sampling in zip(self._streams, self._samplings, strict=True):
                # The samples at this point are gone: they were dropped, or lie before a gap.
                if time < stream.start_time - resampling.STAMP_RESOLUTION:
                    self.end()
                    return points
                value = value_at(stream, sampling, time, self.dt)
                # This stream has not passed the point yet; the next call tries again.
                if value is None:
                    return points
                values.append(value)
            self._next_index += 1
            self._latest_time = time
            for stream in self._streams:
                stream.completed_time = time
            points.append(GridPoint(time, values))
        return points

    def changed_rate(self, stream: SampleStream) -> float | None:
        """Returns the former rate of a stream whose rate has changed since the step was decided.

        Args:
            stream: a stream; its rate now is that since the last gap, over ``DECISION_SECONDS`` at most.

        Returns:
            The rate by which the step was decided, Hz; None if the present one differs by less than ``MAX_STEP_RATIO``,
            or is not known yet.
        """
        if not self.is_running or stream not in self._streams:
            return None
        decided_rate = self.rates[self._streams.index(stream)]
        present_rate = stream.rate_since_gap()
        if present_rate is None:
            return None
        is_nearly_the_same = 1 / MAX_STEP_RATIO < present_rate / decided_rate < MAX_STEP_RATIO
        return None if is_nearly_the_same else decided_rate


def _times_between(stream: SampleStream, start_time: float, end_time: float) -> Array:
    """Returns the times of a stream's samples between two limits, s of the boot clock.

    Both limits are widened by the resolution of stamps, since the samples that define them may be rounded.

    Args:
        stream: samples of one message, such as the attitude.
        start_time: lower limit, s of the boot clock.
        end_time: upper limit, s.
    """
    time = np.array(stream.time)
    is_after_start = time >= start_time - resampling.STAMP_RESOLUTION
    is_before_end = time <= end_time + resampling.STAMP_RESOLUTION
    return time[is_after_start & is_before_end]


def _sampling(time: Array, grid: Array, dt: float) -> StreamSampling:
    """Decides how one stream is resampled to the grid, from its stamps in the first seconds.

    A stream that is faster than the grid is low-passed, so that frequencies above the grid's Nyquist frequency are not
    aliased. One with a sample at every grid point keeps its samples. Others are interpolated.

    Args:
        time: stamps of the stream, (N,), s.
        grid: points of the grid in these seconds, (T,), s.
        dt: step of the grid, s.

    Returns:
        Weights of the low-pass and their times, or that samples are kept or interpolated.
    """
    if not resampling.needs_low_pass(time, dt):
        keeps_samples = resampling.nearest_rows(grid, time) is not None
        return StreamSampling(np.ones(1), np.zeros(1), keeps_samples)
    rate = resampling.mean_rate(time)
    weights = resampling.low_pass_impulse_response(rate, dt)
    # The response is centred on the point, and has one weight for each sample of the stream.
    offsets = (np.arange(len(weights)) - len(weights) // 2) / rate
    return StreamSampling(weights, offsets, keeps_samples=False)


def value_at(
    stream: SampleStream, sampling: StreamSampling, time: float, dt: float
) -> Numbers | None:
    """Returns the values of a stream of samples at one point of the time grid.

    If the samples lie on the grid, it is the sample at the point. If they do not, or that sample is lost, the values
    are interpolated from the samples around it, or a weighted mean of them, which acts as a low-pass filter.

    Args:
        stream: samples of attitude or motor outputs in the order of time, at least one.
        sampling: how the stream is resampled: whether samples are kept as they are, and the weights of the mean.
        time: the point, s of the boot clock.
        dt: step of the grid, s.

    Returns:
        The values; None as long as later samples may change them.
    """
    latest_stamp = stream.time[-1]
    is_sample_certain = latest_stamp >= _needed_time_of_sample(time, dt)
    if sampling.keeps_samples and is_sample_certain:
        nearest_values = stream.nearest(time)
        if nearest_values is not None:
            return nearest_values
    # A single weight means interpolation.
    has_low_pass = len(sampling.weights) > 1
    if latest_stamp < _needed_time_of_sum(time, dt, has_low_pass=has_low_pass):
        return None
    return stream.weighted_sum(time, sampling.weights, sampling.offsets)


def _needed_time_of_sample(time: float, dt: float) -> float:
    """Returns the time, s, that the latest stamp must have reached so that the sample nearest to a point is certain.

    Stamps are rounded to ``STAMP_RESOLUTION``. If grid points are at least three such units apart, a stamp up to one
    unit before the point is its sample; on finer grids a later stamp may be nearer, and is waited for.

    Args:
        time: the point, s of the boot clock.
        dt: step of the grid, s.
    """
    if dt >= 3 * resampling.STAMP_RESOLUTION:
        return time - resampling.STAMP_RESOLUTION
    return time


def _needed_time_of_sum(time: float, dt: float, *, has_low_pass: bool) -> float:
    """Returns the time, s, that the latest stamp must have reached so that later samples do not change a value.

    The value at a point of the grid is a weighted sum of samples around it: by a low-pass filter, whose response
    reaches ``FILTER_EDGE_STEPS`` steps beyond the point, or by interpolation between its two neighbours.

    Args:
        time: the point, s of the boot clock.
        dt: step of the grid, s.
        has_low_pass: whether samples are low-passed, and not interpolated.
    """
    # Stamps are rounded, so that one just before the needed time may be of that time.
    if has_low_pass:
        return time + (resampling.FILTER_EDGE_STEPS * dt - resampling.STAMP_RESOLUTION)
    return time - STAMP_ROUNDING
