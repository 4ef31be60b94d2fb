"""Resampling of recorded streams to one uniform grid of time, with a low-pass filter before a slower grid."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from mavdem.arrays import Array, Flags
from mavdem.facts import Fact
from mavdem.facts.learnability import Resampling
from mavdem.ingest.telemetry import (
    interpolated,
)

pass

STEP_TOLERANCE = 1.1
"""How much longer than 1/``MINIMUM_RATE`` usual steps may be, so that jitter of the stamps does not split a stream.
Learnability decides whether the mean rate of a segment is enough."""
# Share of steps below which they are rare, and cycles of a scheduler that an interval may be.
USUAL_SHARE = 0.02
MAX_CYCLES = 3
# Resolution of ``time_boot_ms``: two stamps no further apart may belong to the same moment
STAMP_RESOLUTION = 1e-3


LOW_PASS_RATIO = 1.5
"""A stream that comes so many times as fast as the grid is low-passed first. Below that the filter would reach into the
band in which the stream itself is already aliased."""
CUTOFF_RATIO = 0.4
"""Cut-off of that filter in grid rates: 0.5 is the Nyquist frequency, and 0.1 (5 Hz at 50) passes unchanged."""
FILTER_EDGE_STEPS = 5
"""Grid steps after which the filter has forgotten its start to a hundredth. Its slowest pole, at a rate of 2 pi
``CUTOFF_RATIO`` sin(22.5°), decays by a factor e a step."""


def common_step(streams: Iterable[Array]) -> float:
    """Returns the step, s, of a grid for streams with these stamps (N,): the interval of the slowest, to 0.1 ms."""
    return max(round(max(map(_interval, streams)), 4), 1e-4)


def _interval(time: Array) -> float:
    """The mean interval, s, of stamps (N,); with jitter of a scheduler's whole cycles, the nearest two or three cycles.

    Steps of 4, 8 and 12 ms are 8 ms with jitter, whatever the mean of some seconds. 8 and 12 alone are their mean.
    """
    mean = 1 / mean_rate(time)
    since = time - time[0]
    steps, counts = np.unique(
        np.rint(np.diff(time) / STAMP_RESOLUTION).astype(int), return_counts=True
    )
    steps = steps[counts >= USUAL_SHARE * len(time)]
    cycle = STAMP_RESOLUTION * np.gcd.reduce(steps)
    usual = cycle * min(round(mean / cycle), MAX_CYCLES) if cycle else mean
    even = (
        np.mean(abs(since - cycle * np.rint(since / (cycle or 1.0))) > STAMP_RESOLUTION)
        < USUAL_SHARE
    )
    jitter = even and steps[0] * STAMP_RESOLUTION < usual - STAMP_RESOLUTION
    return usual if jitter and abs(usual / mean - 1) <= STEP_TOLERANCE - 1 else mean


def mean_rate(time: Array) -> float:
    """Returns the mean rate, samples a second, over the whole of ``time`` (N,), N ≥ 2."""
    return float((len(time) - 1) / (time[-1] - time[0]))


def resample(grid: Array, dt: float, time: Array, values: Array) -> tuple[Array, Fact]:
    """Resamples the columns of ``values`` (N, k) from ``time`` (N,) to ``grid`` (T,) of step ``dt``, and says how.

    Kept, interpolated linearly between the neighbours or, from a stream at ``LOW_PASS_RATIO`` times the rate of the
    grid or more, low-passed before: else a vibration at 49 Hz, on a grid of 50, would look slow.
    """
    way = Fact(Resampling.INTERPOLATED)
    if needs_low_pass(time, dt):
        time, values = _low_passed(time, values, CUTOFF_RATIO / dt)
        way = Fact(Resampling.LOW_PASSED, rate=CUTOFF_RATIO / dt)
    elif (rows := nearest_rows(grid, time)) is not None:
        return values[rows], Fact(Resampling.SAMPLES_KEPT)
    return interpolated(grid, time, values), way


def common_grid(attitude: Array, motors: Array, dt: float) -> Array:
    """Returns the steps of ``dt`` where both streams have samples.

    From an attitude sample when both streams then keep theirs; otherwise from a motor sample: motor outputs change more
    from one message to the next, so it is attitude that should be moved.
    """
    first = max(attitude[0], motors[0])
    last = min(attitude[-1], motors[-1])
    for stamps in (attitude, motors):
        start = min(stamps[stamps >= first - STAMP_RESOLUTION][0], last)
        grid = start + dt * np.arange(int((last - start) / dt + STAMP_RESOLUTION) + 1)
        if nearest_rows(grid, attitude) is not None and nearest_rows(grid, motors) is not None:
            break
    sure = _sure(grid, dt, attitude) & _sure(grid, dt, motors)
    return grid[sure] if sure.any() else grid


def nearest_rows(grid: Array, time: Array) -> NDArray[np.intp] | None:
    """Returns the rows of ``time`` (N,) at each point of ``grid`` (T,).

    None unless all differ and lie within ``STAMP_SECONDS``.
    """
    nearest = np.searchsorted((time[1:] + time[:-1]) / 2, grid, side="right")
    kept = np.all(abs(time[nearest] - grid) <= STAMP_RESOLUTION) and np.all(np.diff(nearest) > 0)
    return nearest if kept else None


def needs_low_pass(time: Array, dt: float) -> bool:
    """Returns whether a stream sampled at ``time`` (N,) is so much faster than a grid of ``dt`` to be low-passed."""
    return mean_rate(time) * dt >= LOW_PASS_RATIO


def _sure(grid: Array, dt: float, time: Array) -> Flags:
    """Which grid points (T,) are free of edge effects of the stream's low-pass filter, if there is one."""
    margin = FILTER_EDGE_STEPS * dt if needs_low_pass(time, dt) else 0.0
    return (grid >= time[0] + margin - STAMP_RESOLUTION) & (
        grid <= time[-1] - margin + STAMP_RESOLUTION
    )


def _low_passed(time: Array, values: Array, cutoff: float) -> tuple[Array, Array]:
    """The columns at as many even stamps, through a Butterworth filter of fourth order, forwards and then backwards.

    Flat where the dynamics are, and without phase. At the cut-off half the amplitude is left, at twice that 1/257.
    """
    even = np.linspace(time[0], time[-1], len(time))
    table = interpolated(even, time, values)
    rate = mean_rate(time)
    # A slower filter's numbers are lost in rounding; whatever is sampled on so coarse a grid is refused for its rate.
    cutoff = max(cutoff, 1e-4 * rate)
    # until it settles
    return even, _filtered(table, rate, cutoff, min(round(3 * rate / cutoff), len(table) - 1))


def low_pass_impulse_response(rate: float, dt: float) -> Array:
    """Returns (2 L + 1,) response of the low-pass filter to one sample of a stream of ``rate`` Hz.

    It is for streams as they come. It reaches ``FILTER_EDGE_STEPS`` steps ``dt`` either way; what is cut off beyond is
    less than a hundredth of it.
    """
    reach = round(FILTER_EDGE_STEPS * dt * rate)
    sample = np.zeros(8 * reach + 1)
    sample[4 * reach] = 1.0
    response = _filtered(sample, rate, CUTOFF_RATIO / dt, 0)[3 * reach : 5 * reach + 1]
    return response / response.sum()


def _filtered(values: Array, rate: float, cutoff: float, padding: int) -> Array:
    # it takes half a second to import, and few flights need it
    from scipy.signal import butter, sosfiltfilt

    return sosfiltfilt(butter(4, cutoff, fs=rate, output="sos"), values, axis=0, padlen=padding)
