"""Limit cycles: oscillations that a vehicle's own controller keeps up, as lines in the spectra of rate and motors.

Wind spreads over all frequencies. A loop without stability margin oscillates at one: nearly all that the body rate and
the motors do is then in one narrow band of their spectra. What tells a limit cycle from a gust that rings is that
motors reach their limits, that the amplitude grows, or that it lasts.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from math import radians
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array, Flags, Indices
from mavdem.containers import JsonValues
from mavdem.dataset.attitude import Attitude
from mavdem.dataset.motor_outputs import MotorOutputs
from mavdem.dataset.quality import samples_at_limits
from mavdem.dataset.segments import Segment, Segments
from mavdem.dataset.signals import MIN_STREAM_RATE
from mavdem.dataset.time_series import TimeSeries
from mavdem.dem.engine.linalg import SMALLEST_POSITIVE
from mavdem.loops.welch import half_overlapping_windows, resampled_signals, windowed_transforms

WINDOW_LENGTHS = (4.0, 8.0)
"""Lengths of the windows of a flight, s: with long ones, slow oscillations are distinguished from steering."""
MIN_WINDOW_SAMPLES = 32
"""Fewest samples of a window."""
MIN_PERIODS = 8
"""Periods of the slowest oscillation in a window: fewer are not distinguished from slow motion."""
MIN_LINE_WIDTH_BINS = 2.01
"""Least half width of a line, in bins: Hann's window blurs a line over two to each side."""
LINE_WIDTH = 0.1
"""Half width of a line, as a fraction of its frequency."""
MIN_LINE_SHARE = 0.6
"""Fraction of the variance of the rate, and of the motors', in the line of a limit cycle.

In two successive windows of sound flights it is at most 0.55.
"""
SURE_LINE_SHARE = 0.8
"""The same fraction where there are fewer than three windows, or fewer than twice ``MIN_PERIODS`` in each."""
MIN_DURATION = 6.0
"""Shortest limit cycle that counts, s."""
MIN_RATE = 2.0
"""Least body rate of a limit cycle, deg/s, standard deviation: less may be rounding."""
MIN_DANGEROUS_RATE = 10.0
"""Body rate, deg/s, standard deviation: less is no danger while motors do not reach their limits."""
MIN_AT_LIMIT_SHARE = 0.05
"""Fraction of the time with a motor at a limit, from which on an oscillation is a limit cycle."""
MIN_GROWTH = 2.0
"""Rate in the last third of an oscillation over that in the first, from which on it grows."""
LASTING_SHARE = 0.5
"""Fraction of the flight from which on an oscillation lasts; and of a window in which motors go from stop to stop."""
MAX_DRIFT = 0.3
"""Deviation of the frequency from its median, as a fraction, at most: what wanders more is a sweep to identify."""
MIN_LASTING_FREQUENCY = 3.5
"""Hz, below which a lasting oscillation that reaches no limit may be steered."""

STARTING_WINDOWS = (0.5, 1.0, 2.0)
"""Lengths of the windows in which a limit cycle that has just started is looked for, s."""
STARTING_SPAN = 2.2
"""Window lengths of recent flight in which it is looked for: three windows, half over each other, and some slack."""
STARTING_DURATION = 1.9
"""Window lengths that it must have lasted."""


class Oscillation(NamedTuple):
    """A limit cycle: an oscillation of roll or pitch that the vehicle's own controller keeps up."""

    axis: str
    """"roll" or "pitch": the one that turns faster."""
    frequency: float | None
    """Hz; None where messages come so slowly that it may be an alias."""
    rate: float
    """Standard deviation of the body rate while it oscillates, deg/s."""
    at_limit: float
    """Fraction of that time with a motor at a limit."""
    growing: bool
    """Whether the amplitude grew."""
    seconds: float
    """How long it oscillates, s."""
    other_axes: tuple[Oscillation, ...] = ()
    """The limit cycles of other axes, which turn more slowly."""

    @property
    def figures(self) -> JsonValues:
        """The figures of a fact about it, by the names that sentences use.

        "subject" is the axis, "frequency" in Hz, "turn_rate" the body rate in rad/s; "axes" has axis, frequency and
        rate of all axes that oscillate.
        """
        axes = [
            (cycle.axis, cycle.frequency, radians(cycle.rate)) for cycle in (self, *self.other_axes)
        ]
        return {
            "subject": self.axis,
            "frequency": self.frequency,
            "turn_rate": radians(self.rate),
            "axes": axes,
        }


def detect_limit_cycle(
    motors: MotorOutputs | None, tilts: Mapping[str, Attitude], segments: Segments
) -> Oscillation | None:
    """Returns the limit cycle in ``segments`` of a flight.

    Each axis is looked at with short and with long windows: short ones show a brief oscillation, long ones tell a slow
    oscillation from steering.

    Args:
        motors: the motors' outputs.
        tilts: the attitude by axis.
        segments: of the flight.

    Returns:
        The limit cycle of the axis that turns fastest; None where there is none, or no motor outputs.
    """
    if motors is None:
        return None
    flight_duration = sum(segment.duration for segment in segments)
    cycles = [
        cycle
        for axis, tilt in tilts.items()
        for window_seconds in WINDOW_LENGTHS
        for cycle in _limit_cycles(axis, tilt, motors, segments, window_seconds, flight_duration)
    ]
    return _strongest(cycles)


def detect_starting_limit_cycle(
    motors: MotorOutputs, tilts: Mapping[str, Attitude], boot: int, start_time: float, now: float
) -> Oscillation | None:
    """Returns the limit cycle that reached the motors' limits in the last seconds; None without one.

    For a warning in flight, there is no time to see whether an oscillation lasts. So it counts only if it turns the
    vehicle fast (``MIN_DANGEROUS_RATE``) and motors reach their limits.

    Args:
        motors: the motors' outputs so far.
        tilts: the attitude by axis.
        boot: whose clock counts.
        start_time: nothing before it is looked at, s.
        now: the end of the data, s.
    """
    cycles = list[Oscillation]()
    for window_seconds in STARTING_WINDOWS:
        segment = Segment(boot, max(start_time, now - STARTING_SPAN * window_seconds), now)
        min_duration = STARTING_DURATION * window_seconds
        for axis, tilt in tilts.items():
            # In a flight of infinite duration, nothing lasts: only limits and growth count.
            cycles += _limit_cycles(
                axis, tilt, motors, [segment], window_seconds, np.inf, min_duration
            )
    dangerous = [
        cycle
        for cycle in cycles
        if cycle.at_limit >= MIN_AT_LIMIT_SHARE and cycle.rate >= MIN_DANGEROUS_RATE
    ]
    return _strongest(dangerous)


def _strongest(cycles: Iterable[Oscillation]) -> Oscillation | None:
    """Returns the limit cycle with the highest body rate, with the strongest of each other axis in ``other_axes``.

    One oscillation may be found with several lengths of windows, and often shows in roll and pitch: it is reported
    once. None where ``cycles`` is empty.
    """
    strongest_by_axis = dict[str, Oscillation]()
    for cycle in sorted(cycles, key=attrgetter("rate"), reverse=True):
        strongest_by_axis.setdefault(cycle.axis, cycle)
    if not strongest_by_axis:
        return None
    strongest, *further = strongest_by_axis.values()
    return strongest._replace(other_axes=tuple(further))


def _limit_cycles(
    axis: str,
    tilt: Attitude,
    motors: MotorOutputs,
    segments: Segments,
    window_seconds: float,
    flight_duration: float,
    min_duration: float = MIN_DURATION,
) -> Iterator[Oscillation]:
    """Yields the limit cycles of one axis: oscillations that the motors' limits bound, or that grow or last.

    The body rate and the motors' outputs are cut into windows. In each, the strongest spectral line that rate and
    motors share is found. Successive windows with a line of nearly one frequency are an oscillation. It counts as a
    limit cycle if motors reach their limits, or if it turns the vehicle fast while it grows or lasts for a good part of
    the flight. A slow oscillation that lasts may be steered by the pilot, and does not count for lasting alone.

    Args:
        axis: "roll" or "pitch".
        tilt: its attitude.
        motors: the motors' outputs.
        segments: of the flight.
        window_seconds: length of the half-overlapping windows, s.
        flight_duration: of all segments, s.
        min_duration: shortest limit cycle, s.
    """
    # (N, k) outputs as fractions of the range, and (N,) whether any motor is at its upper or lower limit.
    shares = motors.scale.fraction(motors.outputs)
    at_upper, at_lower = (
        is_at_limit.any(axis=1) for is_at_limit in samples_at_limits(shares, motors.scale)
    )
    # What all motors do together is thrust, and turns nothing.
    differential = shares - shares.mean(axis=1, keepdims=True)
    # Booleans are resampled like the outputs, as 0 and 1: their means are fractions of time.
    columns = [*differential.T, at_upper & at_lower, at_upper | at_lower]
    motor_series = [TimeSeries(motors.time, motors.boot, column) for column in columns]
    resampled = resampled_signals(
        [tilt.rate_series, *motor_series],
        segments,
        window_seconds,
        MIN_WINDOW_SAMPLES / window_seconds,
    )
    if resampled is None:
        return
    is_fast = resampled.rate >= MIN_STREAM_RATE
    for piece in resampled.pieces:
        lines = _lines_of_windows(piece, resampled.rate, window_seconds)
        for run in _runs_at_one_frequency(lines):
            cycle = _oscillation_in_run(lines, run, window_seconds, min_duration)
            if cycle is None:
                continue
            # An alias may have any frequency, so that slow messages do not show whether it is steered.
            may_be_steered = is_fast and cycle.frequency < MIN_LASTING_FREQUENCY
            # A limit cycle reaches the motors' limits, or turns the vehicle fast while it grows or lasts.
            lasts = cycle.duration >= LASTING_SHARE * flight_duration and not may_be_steered
            is_dangerous = cycle.rate >= MIN_DANGEROUS_RATE and (cycle.grows or lasts)
            if cycle.at_limit >= MIN_AT_LIMIT_SHARE or is_dangerous:
                yield Oscillation(
                    axis=axis,
                    frequency=cycle.frequency if is_fast else None,
                    rate=cycle.rate,
                    at_limit=cycle.at_limit,
                    growing=cycle.grows,
                    seconds=cycle.duration,
                )


@dataclass(frozen=True)
class _Lines:
    """The strongest line in each of W windows, shared by the body rate and the motors."""

    frequency: Array
    """(W,) Hz."""
    share: Array
    """(W,) fraction of the variance that is in the line: the lesser of the rate's and the motors'."""
    rate: Array
    """(W,) standard deviation of the body rate, deg/s."""
    at_limit: Array
    """(W,) fraction of the window with a motor at a limit."""
    is_clear: Flags
    """(W,) whether the line has enough of the variance, and the vehicle turns fast enough, for a limit cycle."""


def _lines_of_windows(piece: Array, sampling_rate: float, window_seconds: float) -> _Lines:
    """Returns the strongest spectral line in each window, and how much of the variance of rate and motors is in it.

    A line is a narrow band about one frequency. It is where the power of the body rate is highest; its share is the
    fraction of the variance in the band, the lesser of the rate's and the motors', since in a limit cycle both
    oscillate. But where motors are at both limits at once for ``LASTING_SHARE`` of a window, they no longer control the
    rate, and other motion adds to it: there the line is where the motors' power is highest, its share is theirs, and
    of the rate only the part in the band counts.

    Args:
        piece: (k + 3, N) the body rate, rad/s, k motors' outputs without their mean, whether motors are at both limits
            at once, and whether one is at a limit.
        sampling_rate: Hz.
        window_seconds: length of the windows, s.
    """
    # The first signal is the body rate, the others are the motors.
    signals, at_both_limits, at_a_limit = piece[:-2], piece[-2], piece[-1]
    body_rate = signals[0]
    size = round(window_seconds * sampling_rate)
    frequency = np.fft.rfftfreq(size, 1 / sampling_rate)
    resolution = frequency[1]
    signal_power = np.square(abs(windowed_transforms(signals, size)))
    # Power of the rate, and of all motors together: (2, W, F).
    power = np.array([signal_power[0], signal_power[1:].sum(axis=0)])
    is_slammed = half_overlapping_windows(at_both_limits, size).mean(axis=1) >= LASTING_SHARE
    searched_power = np.where(is_slammed[:, None], power[1], power[0])
    is_fast_enough = frequency >= MIN_PERIODS * resolution
    searched_power = np.where(is_fast_enough, searched_power, 0.0)
    line_frequency = frequency[np.argmax(searched_power, axis=1)]
    # A window resolves no line narrower than a few of its frequency steps.
    half_width = np.maximum(MIN_LINE_WIDTH_BINS * resolution, LINE_WIDTH * line_frequency)
    is_in_line = abs(frequency - line_frequency[:, None]) <= half_width[:, None]
    total_power = np.maximum(power.sum(axis=-1), SMALLEST_POSITIVE)
    rate_share, motor_share = (power * is_in_line).sum(axis=-1) / total_power
    share = np.where(is_slammed, motor_share, np.minimum(rate_share, motor_share))
    rate = np.degrees(half_overlapping_windows(body_rate, size).std(axis=1))
    # The standard deviation of a part of the variance is its root.
    rate *= np.where(is_slammed, np.sqrt(rate_share), 1.0)
    # A line of few periods per window may look like one by chance, so that it needs more of the variance.
    has_few_periods = line_frequency < 2 * MIN_PERIODS * resolution
    needed_share = np.where(has_few_periods, SURE_LINE_SHARE, MIN_LINE_SHARE)
    return _Lines(
        frequency=line_frequency,
        share=share,
        rate=rate,
        at_limit=half_overlapping_windows(at_a_limit, size).mean(axis=1),
        is_clear=(share >= needed_share) & (rate >= MIN_RATE),
    )


def _runs_at_one_frequency(lines: _Lines) -> list[Indices]:
    """Returns the runs of successive windows that have a clear line of nearly the same frequency.

    Two lines have the same frequency if they overlap: each reaches ``LINE_WIDTH`` to both sides.

    Args:
        lines: the line of each of W windows.

    Returns:
        The indices of the windows of each run, one or more.
    """
    # Windows are split wherever one does not continue the one before. An unclear window is then alone, and left out.
    steps = abs(np.diff(lines.frequency))
    is_same_frequency = steps <= 2 * LINE_WIDTH * lines.frequency[1:]
    continues = lines.is_clear[1:] & lines.is_clear[:-1] & is_same_frequency
    ends_of_runs = np.flatnonzero(~continues) + 1
    runs = np.split(np.arange(len(lines.frequency)), ends_of_runs)
    return [run for run in runs if lines.is_clear[run[0]]]


class _RunOscillation(NamedTuple):
    """A limit cycle, or a steered or damped oscillation, in a run of windows."""

    frequency: float
    """Median of the windows, Hz."""
    rate: float
    """Standard deviation of the body rate, deg/s."""
    at_limit: float
    """Fraction of the time with a motor at a limit."""
    grows: bool
    """Whether the rate of the last third is ``MIN_GROWTH`` times that of the first."""
    duration: float
    """Seconds."""


def _oscillation_in_run(
    lines: _Lines, run: Indices, window_seconds: float, min_duration: float
) -> _RunOscillation | None:
    """Returns the oscillation in a run of windows; None where it is short, unsure, or drifts like a sweep.

    Args:
        lines: the line of each window.
        run: indices of successive windows, half over each other, with one line.
        window_seconds: length of a window, s.
        min_duration: shortest oscillation, s.
    """
    # Each further window, half over the one before, adds half of its length.
    duration = (len(run) + 1) / 2 * window_seconds
    frequency = np.median(lines.frequency[run])
    drift = abs(lines.frequency[run] - frequency).max()
    # Two windows may look alike by chance: then the line must have more of the variance.
    is_sure = len(run) > 2 or lines.share[run].min() >= SURE_LINE_SHARE
    if duration < min_duration or not is_sure or drift > MAX_DRIFT * frequency:
        return None
    rate = lines.rate[run]
    # Rounded up, so that one window is a third of itself.
    third = -(-len(run) // 3)
    growth = rate[-third:].mean() / rate[:third].mean()
    return _RunOscillation(
        frequency=frequency,
        rate=np.sqrt(np.mean(rate**2)),
        at_limit=lines.at_limit[run].mean(),
        grows=len(run) > 2 and growth >= MIN_GROWTH,
        duration=duration,
    )
