"""Resampling of recorded streams to a uniform grid of time, with a low-pass filter if the grid is slower."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.arrays import Array, Flags
from mavdem.facts import Fact
from mavdem.facts.learnability import Resampling
from mavdem.ingest.telemetry import interpolated

STAMP_RESOLUTION = 1e-3
"""Resolution, s, of MAVLink's ``time_boot_ms``: two stamps no further apart may mean the same moment."""

STEP_DECIMALS = 4
"""Decimals to which the step of a grid is rounded: 0.1 ms."""

MIN_STEP = 1e-4
"""Shortest step of a grid, s: one unit of the last decimal."""

RARE_STEP_SHARE = 0.02
"""Share of all steps below which a step, or a deviation from the scheduler's cycle, is an exception; a choice."""

MAX_CYCLES_PER_STEP = 3
"""Number of cycles of a scheduler up to which a usual step is recognised as a multiple of its cycle; a choice."""

MAX_MEAN_RATIO = 1.1
"""Ratio of the usual interval to the mean interval up to which jitter explains the difference; a choice."""

LOW_PASS_RATIO = 1.5
"""Rate of a stream relative to that of the grid, from which the stream is low-passed first.

Below that, the filter would reach into the band in which the stream itself is already aliased.
"""

CUTOFF_RATIO = 0.4
"""Cut-off frequency of the filter relative to the rate of the grid.

The Nyquist frequency is 0.5 of that rate, and 0.1, which is 5 Hz at 50, passes unchanged.
"""

FILTER_ORDER = 4
"""Order of the Butterworth filter, which is applied forwards and backwards."""

FILTER_EDGE_STEPS = 5
"""Grid steps after which the filter has forgotten its start to a hundredth.

Its slowest pole has the rate 2 pi ``CUTOFF_RATIO`` sin(22.5°) per step, and decays by a factor of e in each step.
"""

MIN_CUTOFF = 1e-4
"""Lowest cut-off frequency relative to the rate of the stream, below which the filter is lost in rounding errors.

It never matters: a flight on so coarse a grid is refused for its rate.
"""


def common_step(streams: Iterable[Array]) -> float:
    """Returns the step of a uniform grid for several streams: the sampling interval of the slowest, rounded to 0.1 ms.

    Args:
        streams: Stamps (N,), s, of each stream, rising.

    Returns:
        The step in seconds.
    """
    slowest = max(_sampling_interval(time) for time in streams)
    return max(round(slowest, STEP_DECIMALS), MIN_STEP)


def _sampling_interval(time: Array) -> float:
    """Estimates the nominal sampling interval of a stream.

    Autopilots sample at whole cycles of their scheduler. With a cycle of 4 ms, steps of 4, 8 and 12 ms are a nominal
    interval of 8 ms with a jitter of one cycle, even if their mean over a few seconds is another. Steps of 8 and 12 ms
    alone are an interval of 10 ms that was rounded to cycles; then the mean is the interval.

    Args:
        time: (N,) stamps, s, rising.

    Returns:
        The interval, s: where there is jitter by cycles, the multiple of the cycle nearest to the mean, up to
        ``MAX_CYCLES_PER_STEP`` cycles; otherwise the mean.
    """
    mean = 1 / mean_rate(time)
    # The steps between stamps in units of the stamps' resolution, 1 ms. Rare steps are left out, since one odd step
    # would make their greatest common divisor, the cycle, too small.
    milliseconds = np.rint(np.diff(time) / STAMP_RESOLUTION).astype(int)
    steps, counts = np.unique(milliseconds, return_counts=True)
    usual_steps = steps[counts >= RARE_STEP_SHARE * len(time)]
    cycle = STAMP_RESOLUTION * np.gcd.reduce(usual_steps)
    if not cycle:
        return mean
    cycles_per_step = min(round(mean / cycle), MAX_CYCLES_PER_STEP)
    interval = cycles_per_step * cycle
    # The stamps must be multiples of the cycle, counted from the first one.
    elapsed_time = time - time[0]
    deviations = abs(elapsed_time - cycle * np.rint(elapsed_time / cycle))
    is_on_cycles = np.mean(deviations > STAMP_RESOLUTION) < RARE_STEP_SHARE
    # Jitter makes steps that are shorter than the interval; an interval that is rounded to cycles has none.
    shortest_step = STAMP_RESOLUTION * usual_steps[0]
    has_shorter_steps = shortest_step < interval - STAMP_RESOLUTION
    is_near_mean = abs(interval / mean - 1) <= MAX_MEAN_RATIO - 1
    has_jitter_by_cycles = is_on_cycles and has_shorter_steps and is_near_mean
    return interval if has_jitter_by_cycles else mean


def mean_rate(time: Array | Sequence[float]) -> float:
    """Returns the mean rate, Hz, of samples with the stamps ``time`` (N,), s; there must be two at least."""
    return float((len(time) - 1) / (time[-1] - time[0]))


def common_grid(attitude_time: Array, motor_time: Array, dt: float) -> Array:
    """Returns a uniform grid over the time in which both streams have samples.

    It begins at an attitude sample if then both streams have a sample at every grid point. Otherwise it begins at a
    motor sample: motor outputs change more from one message to the next, so attitude is the one to interpolate.

    Args:
        attitude_time: (N,) stamps of the attitude, s.
        motor_time: (M,) stamps of the motor outputs, s.
        dt: Step of the grid, s.

    Returns:
        (T,) times, s. Points that the edges of a low-pass filter distort are left out, unless that would leave none.
    """
    # The time in which both streams have samples.
    first_time = max(attitude_time[0], motor_time[0])
    last_time = min(attitude_time[-1], motor_time[-1])
    for stamps in (attitude_time, motor_time):
        is_common = stamps >= first_time - STAMP_RESOLUTION
        start = min(stamps[is_common][0], last_time)
        # Stamps are rounded, which must not cost the last point.
        point_count = int((last_time - start) / dt + STAMP_RESOLUTION) + 1
        grid = start + dt * np.arange(point_count)
        attitude_rows = nearest_rows(grid, attitude_time)
        motor_rows = nearest_rows(grid, motor_time)
        if attitude_rows is not None and motor_rows is not None:
            break
    # The output of a low-pass filter is wrong near the ends of its stream, so grid points there are left out.
    is_valid = _is_free_of_edges(grid, dt, attitude_time)
    is_valid &= _is_free_of_edges(grid, dt, motor_time)
    return grid[is_valid] if is_valid.any() else grid


class ResampledStream(NamedTuple):
    """A stream on a uniform grid."""

    values: Array
    """Samples on the grid (T, k)."""

    method: Fact
    """How they were made."""


def resample(grid: Array, dt: float, time: Array, values: Array) -> ResampledStream:
    """Resamples a stream to a uniform grid.

    A stream whose rate is ``LOW_PASS_RATIO`` times the rate of the grid or more is low-passed and interpolated:
    otherwise a vibration at 49 Hz would appear as a slow motion on a grid of 50 Hz. A stream with a sample at every
    grid point keeps its samples. Any other is interpolated linearly.

    Args:
        grid: (T,) times of the grid, s.
        dt: Step of the grid, s.
        time: (N,) stamps of the stream, s.
        values: (N, k) samples.

    Returns:
        (T, k) values on the grid, and a fact about the method (``Resampling``).
    """
    if needs_low_pass(time, dt):
        cutoff = CUTOFF_RATIO / dt
        even_time, filtered_values = _low_passed(time, values, cutoff)
        return ResampledStream(
            interpolated(grid, even_time, filtered_values), Fact(Resampling.LOW_PASSED, rate=cutoff)
        )
    samples = nearest_rows(grid, time)
    if samples is not None:
        return ResampledStream(values[samples], Fact(Resampling.SAMPLES_KEPT))
    return ResampledStream(interpolated(grid, time, values), Fact(Resampling.INTERPOLATED))


def nearest_rows(grid: Array, time: Array) -> NDArray[np.intp] | None:
    """Assigns to each point of a uniform grid the sample of a stream that was taken at that time.

    Args:
        grid: (T,) times of the grid, s.
        time: (N,) stamps of the stream, s.

    Returns:
        (T,) indices of the samples. None if some grid point has no sample within ``STAMP_RESOLUTION``, or shares its
        sample with another.
    """
    # A stamp is nearest to the grid points between the midpoints to its two neighbours.
    midpoints = (time[1:] + time[:-1]) / 2
    samples = np.searchsorted(midpoints, grid, side="right")
    is_near = abs(time[samples] - grid) <= STAMP_RESOLUTION
    if np.all(is_near) and np.all(np.diff(samples) > 0):
        return samples
    return None


def needs_low_pass(time: Array, dt: float) -> bool:
    """Returns whether a stream with stamps (N,), s, must be low-passed before it is put on a grid of step ``dt``, s."""
    return mean_rate(time) * dt >= LOW_PASS_RATIO


def low_pass_impulse_response(rate: float, dt: float) -> Array:
    """Returns the impulse response of the low-pass filter, to filter a stream by convolution as its samples arrive.

    It is measured: the filter is applied to an impulse, and the response is cut off where it has decayed to less than a
    hundredth, ``FILTER_EDGE_STEPS`` grid steps before and after the impulse.

    Args:
        rate: Rate of the stream, Hz.
        dt: Step of the grid, s.

    Returns:
        Weights (2 L + 1,) of the L samples before, the sample itself, and the L samples after; their sum is 1.
    """
    samples_per_step = dt * rate
    half_length = round(FILTER_EDGE_STEPS * samples_per_step)
    # A signal that is four times as long as the response, so that the transients at its ends do not reach the response.
    centre = 4 * half_length
    impulse = np.zeros(2 * centre + 1)
    impulse[centre] = 1.0
    response = _butterworth_filtered(impulse, rate, CUTOFF_RATIO / dt, padding=0)
    response = response[centre - half_length : centre + half_length + 1]
    return response / response.sum()


def _is_free_of_edges(grid: Array, dt: float, time: Array) -> Flags:
    """Flags the grid points that are so far from the ends of a stream that its low-pass filter is valid there.

    Args:
        grid: (T,) times of the grid, s.
        dt: Step of the grid, s.
        time: (N,) stamps of the stream, s; one that is not low-passed has no edges.

    Returns:
        Flags (T,).
    """
    margin = FILTER_EDGE_STEPS * dt if needs_low_pass(time, dt) else 0.0
    first_valid = time[0] + margin - STAMP_RESOLUTION
    last_valid = time[-1] - margin + STAMP_RESOLUTION
    return (grid >= first_valid) & (grid <= last_valid)


def _low_passed(time: Array, values: Array, cutoff: float) -> tuple[Array, Array]:
    """Interpolates a stream to the same number of uniform stamps, and low-passes it.

    The filter has zero phase, since it runs forwards and then backwards. Its gain is near 1 in the band of the
    dynamics, 1/2 at the cut-off frequency, and 1/257 at twice that.

    Args:
        time: (N,) stamps, s.
        values: (N, k) samples.
        cutoff: Cut-off frequency, Hz.

    Returns:
        (N,) uniform stamps, s, and (N, k) filtered samples.
    """
    uniform_time = np.linspace(time[0], time[-1], len(time))
    uniform_values = interpolated(uniform_time, time, values)
    rate = mean_rate(time)
    cutoff = max(cutoff, MIN_CUTOFF * rate)
    # Padding of three periods of the cut-off frequency lets the filter settle before the first sample.
    padding = min(round(3 * rate / cutoff), len(uniform_values) - 1)
    return uniform_time, _butterworth_filtered(uniform_values, rate, cutoff, padding)


def _butterworth_filtered(values: Array, rate: float, cutoff: float, padding: int) -> Array:
    """Applies a Butterworth low-pass filter forwards and backwards (zero phase).

    Args:
        values: (N,) or (N, k) uniform samples.
        rate: Their rate, Hz.
        cutoff: Cut-off frequency, Hz.
        padding: Number of samples by which both ends are extended first.

    Returns:
        Filtered samples with the shape of ``values``.
    """
    # SciPy's filters take half a second to import, and few flights need them.
    from scipy.signal import butter, sosfiltfilt

    sections = butter(FILTER_ORDER, cutoff, fs=rate, output="sos")
    return sosfiltfilt(sections, values, axis=0, padlen=padding)
