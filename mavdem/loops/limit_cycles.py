"""Limit cycles: oscillations that a vehicle's own controller sustains, as lines in the spectra of rate and motors.

Wind spreads over all frequencies. A loop without stability margin oscillates at one: nearly all that the body rate and
the motors do is then in one narrow band of their spectra. What distinguishes a limit cycle from a gust that rings is
that motors reach their limits, that the amplitude grows, or that it lasts.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import ceil, radians
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from mavdem.arrays import SMALLEST_POSITIVE, Array, Flags, Indices
from mavdem.containers import JsonValues
from mavdem.dataset.attitude import Attitude
from mavdem.dataset.axes import TILT_AXES
from mavdem.dataset.extreme_tilt import MAX_TILT
from mavdem.dataset.motor_outputs import MotorOutputs
from mavdem.dataset.quality import samples_at_limits
from mavdem.dataset.segments import Segment, Segments, in_segments
from mavdem.dataset.signals import MIN_STREAM_RATE
from mavdem.dataset.time_series import TimeSeries
from mavdem.loops.welch import half_overlapping_windows, resampled_signals, windowed_transforms

WINDOW_LENGTHS = (4.0, 8.0)
"""Lengths of the windows of a flight, s: short ones show brief oscillations, long ones distinguish slow ones from
steering."""
MIN_WINDOW_SAMPLES = 32
"""Least number of samples of a window: a choice."""
MIN_PERIODS = 8
"""Least number of periods of an oscillation in a window: fewer cannot be distinguished from slow motion."""
MIN_LINE_WIDTH_BINS = 2.01
"""Least half width of a line, in frequency bins: Hann's window blurs a line over two bins to each side."""
LINE_WIDTH = 0.1
"""Half width of a line, relative to its frequency: a choice."""
MIN_LINE_SHARE = 0.6
"""Least share of the rate's variance, and of the motors' variance, in the spectral line of a limit cycle.

In two successive windows of sound flights it is at most 0.55.
"""
SURE_LINE_SHARE = 0.8
"""The same share if there are fewer than three windows, or fewer than twice ``MIN_PERIODS`` in each."""
MIN_DURATION = 6.0
"""Shortest duration of a limit cycle, s: a choice."""
MIN_RATE = 2.0
"""Least standard deviation of the body rate in a limit cycle, deg/s: less may be rounding."""
MIN_DANGEROUS_RATE = 10.0
"""Standard deviation of the body rate, deg/s, below which an oscillation is harmless if no motor reaches a limit."""
MIN_AT_LIMIT_SHARE = 0.05
"""Share of the time with a motor at a limit, from which on an oscillation is a limit cycle: a choice."""
MIN_GROWTH = 2.0
"""Ratio of the rates in the last and the first third of an oscillation, from which on it grows: a choice."""
MIN_AT_BOTH_LIMITS_SHARE = 0.2
"""Share of the time with motors at both limits at once, from which on an oscillation swings from stop to stop.

Two opposite motors that are commanded a sine are both beyond their limits for this share if its amplitude exceeds their
range by 5 %. So hardly any command is left to control the vehicle, however little it turns.
"""
LASTING_SHARE = 0.5
"""Share of a flight from which on an oscillation lasts, and of a window from which on motors go from stop to stop."""
MAX_DRIFT = 0.3
"""Largest deviation of the frequency from its median, relative to it: a sweep for identification wanders more."""
MIN_UPRIGHT_SECONDS = 5.0
"""Duration of a limit cycle, s, after which an upright vehicle has its motors in the right order: a choice.

With motors in a wrong order the controller's torque adds to the error, so that the vehicle turns over within about 1 s.
"""
MIN_LASTING_FREQUENCY = 3.5
"""Frequency below which a lasting oscillation that reaches no limit may be steered by the pilot, Hz."""

STEERED_SHARE = 0.5
"""Standard deviation of an angle's setpoint, relative to the angle's, from which on it is steered: a choice."""

STARTING_WINDOWS = (0.5, 1.0, 2.0)
"""Lengths of the windows in which a limit cycle that has just started is looked for, s."""
STARTING_SPAN = 2.2
"""Length of recent flight in which it is looked for, in window lengths: three half-overlapping windows and slack."""
STARTING_SECONDS = STARTING_SPAN * max(STARTING_WINDOWS)
"""Duration of flight after which each of these windows has been searched, s: before it nothing shows that a vehicle
does not oscillate."""
SPAN_SLACK = 0.2
"""Time, s, by which recent flight is longer than the windows that must fit into it: some samples of a slow stream."""
STARTING_DURATION = 1.9
"""Least duration of such a limit cycle, in window lengths: three half-overlapping windows have two."""


class Oscillation(NamedTuple):
    """A limit cycle: an oscillation of an axis that the vehicle's own controller keeps up."""

    axis: str
    """"roll", "pitch" or "yaw": the one with the largest body rate."""
    frequency: float | None
    """Frequency, Hz; ``None`` if messages come so slowly that it may be an alias."""
    rate: float
    """Standard deviation of the body rate while it oscillates, deg/s."""
    at_limit: float
    """Fraction of that time with a motor at a limit."""
    growing: bool
    """Whether the amplitude grew."""
    seconds: float
    """Duration, s."""
    span: Segment
    """Boot, and start and end, s since boot."""
    other_axes: tuple[Oscillation, ...] = ()
    """The limit cycles of other axes, which have smaller body rates."""
    at_both_limits: float = 0.0
    """Fraction of that time with one motor at its upper limit while another is at its lower limit."""
    was_upright: bool = False
    """Whether the vehicle stayed upright for at least ``MIN_UPRIGHT_SECONDS``, so that its motors' order is right."""

    @property
    def is_stop_to_stop(self) -> bool:
        """Whether motors swing from stop to stop on some axis, so that hardly any command is left to control it."""
        cycles = (self, *self.other_axes)
        return any(cycle.at_both_limits >= MIN_AT_BOTH_LIMITS_SHARE for cycle in cycles)

    @property
    def figures(self) -> JsonValues:
        """The limit cycle as values of a fact (a coded finding), from which a report makes a sentence.

        They are the axis ("subject"), the frequency, Hz, and the standard deviation of the body rate ("turn_rate"),
        rad/s. "axes" has axis, frequency and body rate of every axis that oscillates, this one first. "is_stop_to_stop"
        is whether motors swing from stop to stop on some of them, and "was_upright" whether the vehicle stayed upright.
        """
        oscillating_axes = []
        for cycle in (self, *self.other_axes):
            # Facts have angles in radians.
            oscillating_axes.append((cycle.axis, cycle.frequency, radians(cycle.rate)))
        axis, frequency, body_rate = oscillating_axes[0]
        return {
            "subject": axis,
            "frequency": frequency,
            "turn_rate": body_rate,
            "axes": oscillating_axes,
            "is_stop_to_stop": self.is_stop_to_stop,
            "was_upright": self.was_upright,
        }


def detect_limit_cycle(
    motors: MotorOutputs | None, attitudes: Mapping[str, Attitude], segments: Segments
) -> Oscillation | None:
    """Detects a limit cycle in a flight: an oscillation that the vehicle's own controller sustains.

    Each axis is analysed with short and with long windows: short ones show a brief oscillation, long ones distinguish a
    slow oscillation from steering. Yaw is reported only if roll and pitch do not oscillate, since they drive motors to
    their limits, which makes yaw oscillate too.

    Args:
        motors: outputs of the motors; None if the log has none.
        attitudes: attitude by axis, for the axes to search.
        segments: segments of the flight to use.

    Returns:
        The limit cycle of the axis with the largest body rate, with the other axes' limit cycles; None if there is
        none, or no motor outputs.
    """
    if motors is None:
        return None
    flight_duration = sum(segment.duration for segment in segments)
    motor_series = _motor_series(motors)
    cycles = list[Oscillation]()
    for axis, attitude in attitudes.items():
        for window_seconds in WINDOW_LENGTHS:
            cycles += _limit_cycles(
                axis, attitude, motor_series, segments, window_seconds, flight_duration
            )
    tilt_cycles = [cycle for cycle in cycles if cycle.axis in TILT_AXES]
    limit_cycle = _strongest_limit_cycle(tilt_cycles or cycles)
    if limit_cycle is None:
        return None
    return limit_cycle._replace(was_upright=_stayed_upright(attitudes, limit_cycle.span))


def _stayed_upright(attitudes: Mapping[str, Attitude], span: Segment) -> bool:
    """Returns whether neither roll nor pitch exceeds ``MAX_TILT`` in a span of ``MIN_UPRIGHT_SECONDS`` or more.

    Args:
        attitudes: attitude by axis.
        span: the span of a limit cycle: boot, start and end.

    Returns:
        The answer; False if the log lacks the angle of roll or pitch in the span.
    """
    if span.duration < MIN_UPRIGHT_SECONDS:
        return False
    for axis in TILT_AXES:
        if axis not in attitudes:
            return False
        angle = attitudes[axis].angle_series
        angles_in_span = angle.values[in_segments(angle, span)]
        if not angles_in_span.size or abs(angles_in_span).max() > MAX_TILT:
            return False
    return True


def detect_starting_limit_cycle(
    motors: MotorOutputs,
    tilts: Mapping[str, Attitude],
    setpoints: Mapping[str, TimeSeries],
    boot: int,
    start_time: float,
    now: float,
) -> Oscillation | None:
    """Detects a limit cycle that has just started, for a warning in flight.

    It is reported only if motors reach their limits. One with body rates of at least ``MIN_DANGEROUS_RATE``, or with
    motors at both limits at once for ``MIN_AT_BOTH_LIMITS_SHARE`` of the time, is reported at once, if its periods are
    short enough for the ``STARTING_WINDOWS``: motors that swing from stop to stop cannot control the vehicle, however
    slowly it rotates. Any other is reported if it lasts, by the same windows and ``MIN_DURATION`` as in the analysis of
    a recorded flight. Between 1 and 2 Hz, which only the long windows resolve, a pilot may steer: there its body rates
    must reach ``MIN_DANGEROUS_RATE`` while the setpoint hardly moves.

    Args:
        motors: outputs of the motors so far.
        tilts: attitude by axis, "roll" and "pitch".
        setpoints: setpoint of the angle, rad, by axis; an axis without one is left out.
        boot: number of the boot, whose clock the times are on.
        start_time: time of the first samples to use, s.
        now: time of the latest data, s.

    Returns:
        The limit cycle; None if there is none.
    """
    motor_series = _motor_series(motors)
    # The last series: whether any motor is at a limit.
    is_at_limit = motor_series[-1].values > 0
    limit_times = motors.time[is_at_limit & (motors.time <= now)]
    latest_limit_time = limit_times.max(initial=-np.inf)
    starting_cycles = list[Oscillation]()
    for window_seconds in STARTING_WINDOWS:
        # Without a motor at a limit no cycle is reported, and the search can be skipped. One window more is searched
        # for limits, because resampling spreads them.
        if latest_limit_time >= now - (STARTING_SPAN + 1) * window_seconds:
            segment = Segment(boot, max(start_time, now - STARTING_SPAN * window_seconds), now)
            min_duration = STARTING_DURATION * window_seconds
            starting_cycles += _cycles_at_limits(
                motor_series, tilts, segment, window_seconds, min_duration
            )
    dangerous_cycles = [cycle for cycle in starting_cycles if _is_dangerous_at_once(cycle)]
    if dangerous_cycles:
        return _strongest_limit_cycle(dangerous_cycles)
    short_window, long_window = WINDOW_LENGTHS
    # A cycle that the shortest windows show continues, so that a short time of the longer windows suffices to confirm
    # it. If they show none, it must last for ``MIN_DURATION`` up to now.
    span = STARTING_SPAN * short_window if starting_cycles else MIN_DURATION + SPAN_SLACK
    segment = Segment(boot, max(start_time, now - span), now)
    # If no motor was at a limit in the last half window, the oscillation is over.
    if latest_limit_time < now - short_window / 2 or segment.duration < MIN_DURATION:
        return None
    cycles = _cycles_at_limits(motor_series, tilts, segment, short_window, MIN_DURATION)
    if cycles:
        return _strongest_limit_cycle(cycles)
    segment = Segment(boot, max(start_time, now - long_window - SPAN_SLACK), now)
    slow_cycles = _cycles_at_limits(motor_series, tilts, segment, long_window, MIN_DURATION)
    dangerous_cycles = []
    for cycle in slow_cycles:
        if cycle.rate < MIN_DANGEROUS_RATE or cycle.axis not in setpoints:
            continue
        angle = tilts[cycle.axis].angle_series
        if _is_unsteered(angle, setpoints[cycle.axis], segment):
            dangerous_cycles.append(cycle)
    return _strongest_limit_cycle(dangerous_cycles)


def _is_dangerous_at_once(cycle: Oscillation) -> bool:
    """Returns whether a limit cycle that has just started turns the vehicle fast, or drives motors from stop to stop.

    Args:
        cycle: the limit cycle, in which motors reach their limits.
    """
    return cycle.rate >= MIN_DANGEROUS_RATE or cycle.is_stop_to_stop


def _is_unsteered(angle: TimeSeries, setpoint: TimeSeries, segment: Segment) -> bool:
    """Returns whether an angle moves without being steered: much more than its setpoint.

    A slow oscillation of the angle may be commanded by the pilot. Then the setpoint moves as well.

    Args:
        angle: angle of the axis, rad.
        setpoint: its setpoint, rad.
        segment: the segment in which both are compared.

    Returns:
        Whether the standard deviation of the setpoint is less than ``STEERED_SHARE`` of the angle's; False if too
        few setpoints were received to know.
    """
    is_received = in_segments(setpoint, segment)
    is_measured = in_segments(angle, segment)
    if np.count_nonzero(is_received) < MIN_PERIODS:
        return False
    angle_sd = angle.values[is_measured].std()
    return bool(setpoint.values[is_received].std() < STEERED_SHARE * angle_sd)


def _cycles_at_limits(
    motor_series: Sequence[TimeSeries],
    tilts: Mapping[str, Attitude],
    segment: Segment,
    window_seconds: float,
    min_duration: float,
) -> list[Oscillation]:
    """Returns the limit cycles of a segment of flight that the motors' limits bound, for alarms in flight.

    Other oscillations may be limit cycles as well, but they count as such only if they last for a large part of the
    flight. That cannot be known while the flight goes on, so they are left out.

    Args:
        motor_series: signals of the motors, as :func:`_motor_series` returns them.
        tilts: attitude by axis, "roll" and "pitch".
        segment: number of the boot, start and end of the segment of flight.
        window_seconds: length of the windows of the spectra, s.
        min_duration: duration that the windows of a limit cycle must cover together, s.

    Returns:
        The limit cycles, axis by axis, those of one axis in the order of time.
    """
    cycles_at_limits = list[Oscillation]()
    for axis, tilt in tilts.items():
        cycles = _limit_cycles(
            axis,
            tilt,
            motor_series,
            [segment],
            window_seconds,
            # With an infinite flight no oscillation lasts for a large part of it.
            flight_duration=np.inf,
            min_duration=min_duration,
        )
        # A cycle that grows is found even if motors are not at their limits.
        cycles_at_limits += [cycle for cycle in cycles if cycle.at_limit >= MIN_AT_LIMIT_SHARE]
    return cycles_at_limits


def continued_limit_cycle(first: Oscillation, present: Oscillation) -> Oscillation:
    """Returns a limit cycle that goes on as it was found first, so that its statement does not change all the time.

    Its axes and frequencies vary from window to window. An axis that oscillates only now is added, and one whose body
    rate has become ``MIN_GROWTH`` times as large is taken from the present. That motors swing from stop to stop is
    stated from then on.

    Args:
        first: the limit cycle as it was stated first.
        present: the limit cycle of the latest windows.
    """
    cycles = {cycle.axis: cycle for cycle in (first, *first.other_axes)}
    for cycle in (present, *present.other_axes):
        known_cycle = cycles.get(cycle.axis)
        if known_cycle is None or cycle.rate >= MIN_GROWTH * known_cycle.rate:
            cycles[cycle.axis] = cycle
        else:
            at_both_limits = max(known_cycle.at_both_limits, cycle.at_both_limits)
            cycles[cycle.axis] = known_cycle._replace(at_both_limits=at_both_limits)
    strongest = _strongest_limit_cycle(cycle._replace(other_axes=()) for cycle in cycles.values())
    assert strongest is not None
    return strongest


def _strongest_limit_cycle(cycles: Iterable[Oscillation]) -> Oscillation | None:
    """Combines limit cycles into one: that with the highest body rate, with the strongest of each other axis.

    One oscillation may be detected with several lengths of windows, and in several axes, but is reported once.

    Args:
        cycles: limit cycles of any axis.

    Returns:
        The strongest, with the others in ``other_axes``; ``None`` if there is none.
    """
    strongest_by_axis = dict[str, Oscillation]()
    for cycle in sorted(cycles, key=attrgetter("rate"), reverse=True):
        strongest_by_axis.setdefault(cycle.axis, cycle)
    if not strongest_by_axis:
        return None
    strongest, *other_cycles = strongest_by_axis.values()
    return strongest._replace(other_axes=tuple(other_cycles))


def _motor_series(motors: MotorOutputs) -> list[TimeSeries]:
    """Returns the signals of the motors in which limit cycles show.

    Args:
        motors: outputs of the k motors, N samples.

    Returns:
        The outputs of the k motors without their mean, as shares of the range; whether motors are at both limits at
        once; and whether any is at a limit, both as 0 or 1.
    """
    range_fractions = motors.scale.fraction(motors.outputs)
    motor_at_upper, motor_at_lower = samples_at_limits(range_fractions, motors.scale)
    # Whether any motor is at its upper or its lower limit, (N,) each.
    is_at_upper = motor_at_upper.any(axis=1)
    is_at_lower = motor_at_lower.any(axis=1)
    # The mean of all motors is thrust, which does not rotate the vehicle.
    differential = range_fractions - range_fractions.mean(axis=1, keepdims=True)
    # Booleans are resampled like the outputs, as 0 and 1, so that their means are fractions of time.
    columns = [*differential.T, is_at_upper & is_at_lower, is_at_upper | is_at_lower]
    return [TimeSeries(motors.time, motors.boot, column) for column in columns]


def _limit_cycles(
    axis: str,
    tilt: Attitude,
    motor_series: Sequence[TimeSeries],
    segments: Segments,
    window_seconds: float,
    flight_duration: float,
    min_duration: float = MIN_DURATION,
) -> Iterator[Oscillation]:
    """Yields the limit cycles of one axis: oscillations that the motors' limits bound, or that grow or last.

    The body rate and the motors' outputs are cut into windows. In each, the strongest spectral line that rate and
    motors have in common is found. Successive windows with a line of nearly the same frequency are an oscillation. It
    is a limit cycle if motors reach their limits, or if it turns the vehicle fast and either grows or lasts for at
    least ``LASTING_SHARE`` of the flight. A slow oscillation may be steered by the pilot, so it is not a limit cycle
    only because it lasts.

    Args:
        axis: "roll", "pitch" or "yaw".
        tilt: attitude of the axis.
        motor_series: result of ``_motor_series``.
        segments: segments of the flight to use.
        window_seconds: length of the half-overlapping windows, s.
        flight_duration: duration of the whole flight, s.
        min_duration: shortest duration of a limit cycle, s.

    Yields:
        The limit cycles in the order of time.
    """
    signals_on_grid = resampled_signals(
        [tilt.rate_series, *motor_series],
        segments,
        min_seconds=window_seconds,
        min_rate=MIN_WINDOW_SAMPLES / window_seconds,
    )
    if signals_on_grid is None:
        return
    is_fast = signals_on_grid.rate >= MIN_STREAM_RATE
    for piece, span in zip(signals_on_grid.pieces, signals_on_grid.spans, strict=True):
        lines = _lines_of_windows(piece, signals_on_grid.rate, window_seconds)
        for run in _runs_at_one_frequency(lines):
            cycle = _oscillation_in_run(lines, run, window_seconds, min_duration)
            if cycle is None:
                continue
            # Below this frequency a pilot may steer. At a low message rate frequencies are aliased, so that nothing
            # follows from them.
            may_be_steered = is_fast and cycle.frequency < MIN_LASTING_FREQUENCY
            # A limit cycle reaches the motors' limits, or turns the vehicle fast while it grows or lasts.
            lasts = cycle.duration >= LASTING_SHARE * flight_duration and not may_be_steered
            is_dangerous = cycle.rate >= MIN_DANGEROUS_RATE and (cycle.grows or lasts)
            if cycle.at_limit >= MIN_AT_LIMIT_SHARE or is_dangerous:
                # Each window begins half a window after the one before.
                start = span.start + run[0] * window_seconds / 2
                yield Oscillation(
                    axis=axis,
                    frequency=cycle.frequency if is_fast else None,
                    rate=cycle.rate,
                    at_limit=cycle.at_limit,
                    growing=cycle.grows,
                    seconds=cycle.duration,
                    at_both_limits=cycle.at_both_limits,
                    span=Segment(span.boot, start, start + cycle.duration),
                )


@dataclass(frozen=True)
class _Lines:
    """The strongest spectral line in each of W windows, shared by the body rate and the motors."""

    frequency: Array
    """Frequencies (W,), Hz."""
    share: Array
    """Fraction of the variance that is in the line (W,): the lesser of the rate's and the motors'."""
    rate: Array
    """Standard deviation of the body rate (W,), deg/s."""
    at_limit: Array
    """Fraction of the window with a motor at a limit (W,)."""
    at_both_limits: Array
    """Fraction of the window with motors at both limits at once (W,)."""
    is_clear: Flags
    """Whether the line has enough of the variance, and the vehicle turns fast enough, for a limit cycle (W,)."""


def _lines_of_windows(piece: Array, sampling_rate: float, window_seconds: float) -> _Lines:
    """Finds the strongest spectral line in each window, and how much of the variance of rate and motors is in it.

    A line is a narrow band around the frequency at which the power of the body rate is highest. Its share is the
    fraction of the variance that is in the band. The smaller of the fractions of the rate and of the motors counts,
    since in a limit cycle both oscillate.

    Windows in which motors are at both limits at once for ``LASTING_SHARE`` of the time are treated differently. The
    motors then alternate between their limits and no longer control the rate, which contains other motion as well. The
    line is then at the frequency at which the motors' power is highest, its share is the motors' share, and only the
    part of the rate in the band counts.

    Args:
        piece: samples of k + 3 signals (k + 3, N): the body rate, rad/s; the outputs of the k motors without their
            mean; whether motors are at both limits at once; and whether any is at a limit, both as 0 or 1.
        sampling_rate: rate of the samples, Hz.
        window_seconds: length of a window, s.

    Returns:
        Frequency, share, standard deviation of the rate, and time at a limit, of the line of each window (W,); and
        whether the line is clear.
    """
    rate_and_motors, is_at_both_limits, is_at_a_limit = piece[:-2], piece[-2], piece[-1]
    body_rate = rate_and_motors[0]
    size = round(window_seconds * sampling_rate)
    frequency = np.fft.rfftfreq(size, 1 / sampling_rate)
    resolution = frequency[1]
    signal_power = np.square(abs(windowed_transforms(rate_and_motors, size)))
    # Power (W, F) of the rate, and of all motors together.
    rate_power = signal_power[0]
    motor_power = signal_power[1:].sum(axis=0)
    at_both_limits = half_overlapping_windows(is_at_both_limits, size).mean(axis=1)
    is_stop_to_stop = at_both_limits >= LASTING_SHARE
    searched_power = np.where(is_stop_to_stop[:, None], motor_power, rate_power)
    is_fast_enough = frequency >= MIN_PERIODS * resolution
    searched_power = np.where(is_fast_enough, searched_power, 0.0)
    line_frequency = frequency[np.argmax(searched_power, axis=1)]
    # A window cannot resolve a line that is narrower than a few frequency steps.
    half_width = np.maximum(MIN_LINE_WIDTH_BINS * resolution, LINE_WIDTH * line_frequency)
    is_in_line = abs(frequency - line_frequency[:, None]) <= half_width[:, None]
    power = np.array([rate_power, motor_power])
    total_power = np.maximum(power.sum(axis=-1), SMALLEST_POSITIVE)
    rate_share, motor_share = (power * is_in_line).sum(axis=-1) / total_power
    share = np.where(is_stop_to_stop, motor_share, np.minimum(rate_share, motor_share))
    rate = np.degrees(half_overlapping_windows(body_rate, size).std(axis=1))
    # The standard deviation in the band is smaller by the root of the band's share of the variance.
    rate *= np.where(is_stop_to_stop, np.sqrt(rate_share), 1.0)
    # Slow motion may look like a line of few periods by chance, so such a line needs more of the variance.
    has_few_periods = line_frequency < 2 * MIN_PERIODS * resolution
    needed_share = np.where(has_few_periods, SURE_LINE_SHARE, MIN_LINE_SHARE)
    return _Lines(
        frequency=line_frequency,
        share=share,
        rate=rate,
        at_limit=half_overlapping_windows(is_at_a_limit, size).mean(axis=1),
        at_both_limits=at_both_limits,
        is_clear=(share >= needed_share) & (rate >= MIN_RATE),
    )


def _runs_at_one_frequency(lines: _Lines) -> list[Indices]:
    """Groups successive windows that have a clear line of nearly the same frequency.

    Two lines have the same frequency if they overlap: each reaches ``LINE_WIDTH`` to both sides.

    Args:
        lines: the line of each of W windows.

    Returns:
        The indices of the windows of each group, one or more.
    """
    # A group ends at each window that does not continue the one before. So a window without a clear line is a group of
    # its own, which is left out.
    steps = abs(np.diff(lines.frequency))
    is_same_frequency = steps <= 2 * LINE_WIDTH * lines.frequency[1:]
    continues = lines.is_clear[1:] & lines.is_clear[:-1] & is_same_frequency
    ends_of_runs = np.flatnonzero(~continues) + 1
    runs = np.split(np.arange(len(lines.frequency)), ends_of_runs)
    return [window_indices for window_indices in runs if lines.is_clear[window_indices[0]]]


class _RunOscillation(NamedTuple):
    """An oscillation in a run of windows, which may be a limit cycle, or steered or damped."""

    frequency: float
    """Median frequency of the windows' lines, Hz."""
    rate: float
    """Standard deviation of the body rate, deg/s."""
    at_limit: float
    """Fraction of the time with a motor at a limit."""
    at_both_limits: float
    """Fraction of the time with motors at both limits at once."""
    grows: bool
    """Whether the rate of the last third is ``MIN_GROWTH`` times the rate of the first."""
    duration: float
    """Duration, s."""


def _oscillation_in_run(
    lines: _Lines, run: Indices, window_seconds: float, min_duration: float
) -> _RunOscillation | None:
    """Computes frequency, amplitude, duration and growth of an oscillation that lasts for several windows of a flight.

    Args:
        lines: the spectral line of each window.
        run: indices (n,) of successive half-overlapping windows with one line.
        window_seconds: length of a window, s.
        min_duration: shortest duration of an oscillation, s.

    Returns:
        The oscillation; None if it is too short, may be chance, or drifts in frequency like a sweep.
    """
    window_count = len(run)
    # Windows overlap by half, so that n of them last n + 1 half windows.
    duration = (window_count + 1) / 2 * window_seconds
    frequency = np.median(lines.frequency[run])
    frequency_drift = abs(lines.frequency[run] - frequency).max()
    # Two windows may have the same line by chance: then it must have a larger share of the variance.
    is_sure = window_count > 2 or lines.share[run].min() >= SURE_LINE_SHARE
    if duration < min_duration or not is_sure or frequency_drift > MAX_DRIFT * frequency:
        return None
    rate = lines.rate[run]
    # The growth compares the first third of the windows with the last; a single window is both.
    windows_per_third = ceil(window_count / 3)
    growth = rate[-windows_per_third:].mean() / rate[:windows_per_third].mean()
    return _RunOscillation(
        frequency=frequency,
        rate=np.sqrt(np.mean(rate**2)),
        at_limit=lines.at_limit[run].mean(),
        at_both_limits=lines.at_both_limits[run].mean(),
        grows=window_count > 2 and growth >= MIN_GROWTH,
        duration=duration,
    )
