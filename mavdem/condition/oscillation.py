"""Limit cycles: a vehicle that oscillates by its own controller, which no wind does.

Wind spreads over all frequencies. A loop without margin turns to and fro at one: nearly all that the body rate and the
motors do is then in one narrow band of their spectra.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from mavdem.alignment.align import Segment, mean_rate, within
from mavdem.alignment.drive import Motors
from mavdem.alignment.quality import at_limits
from mavdem.alignment.signals import MINIMUM_RATE, Attitude
from mavdem.condition.resonance import spectra_of, windows_of

WINDOWS = (4.0, 8.0)
FEWEST_SAMPLES = 32
PERIODS = 8
"""Of one spectrum: seconds, samples, and periods of the slowest line that can be told from what is merely slow."""
# Half width of a line, as a share of its frequency, and two bins at least, as Hann's window blurs
LINE_WIDTH = 0.1
LINE_SHARE = 0.6
SURE_SHARE = 0.8
"""Of the variance of the rate, and of the motors', that is in the line: in two successive windows of sound flights at
most 0.55. Fewer than three windows must show it surely, and so must those with fewer than 2 ``PERIODS`` of it."""
SLIGHT_RATE = 2.0
LEAST_RATE = 10.0
"""deg/s, standard deviations: less may be rounding; and less is no danger where motors do not reach their limits."""
LIMITED_SHARE = 0.05
GROWTH = 2.0
LASTING_SHARE = 0.5
"""What tells a limit cycle from a gust that rings: motors at a limit so much of the time, an amplitude that grows so
many times, or that it lasts so much of the flight."""
# From its frequency, as a share of the median: what wanders more is a sweep, flown to identify
MAX_DRIFT = 0.3
BEGUN_WINDOWS = (
    0.5,
    1.0,
    2.0,
)  # s, of a limit cycle that has begun, of which twice as much must show it
STEERED = 3.5  # Hz, below which a lasting line that reaches no limit may be steered


class Oscillation(NamedTuple):
    """A limit cycle."""

    axis: str  # "roll" or "pitch": the one that turns faster
    # Hz; None where messages come so slowly that what they show may be an alias
    frequency: float | None
    rate: float  # standard deviation of the body rate while it oscillates, deg/s
    at_limit: float  # share of that time with a motor at a limit
    growing: bool  # whether the amplitude grew
    seconds: float  # how long it oscillates


def oscillation_of(
    motors: Motors | None, tilts: Mapping[str, Attitude], parts: Sequence[Segment]
) -> Oscillation | None:
    """Returns the limit cycle in these ``parts`` of a flight; None where there is none, or no motor outputs.

    ``tilts``: the attitude by axis.
    """
    found: list[Oscillation] = []
    whole = sum(part.duration for part in parts)
    if motors is not None:
        for axis, tilt in tilts.items():
            for part, seconds in product(parts, WINDOWS):
                found += _limit_cycles(axis, tilt, motors, part, seconds, whole)
    return max(found, key=lambda one: one.rate, default=None)


def begun_oscillation(
    motors: Motors, tilts: Mapping[str, Attitude], boot: int, since: float, now: float
) -> Oscillation | None:
    """Returns the limit cycle that reaches the motors' limits in the last seconds before ``now``; None without one.

    Nothing before ``since``, s of the ``boot``, counts. ``tilts``: the attitude by axis.
    """
    found: list[Oscillation] = []
    for (axis, tilt), seconds in product(tilts.items(), BEGUN_WINDOWS):
        part = Segment(boot, max(since, now - 2.2 * seconds), now)
        turned = tilt.rate[within(tilt, part)]
        # Spectra take their time, and in most of a flight nothing turns so fast.
        if len(turned) and np.degrees(turned.std()) >= LEAST_RATE:
            found += _limit_cycles(axis, tilt, motors, part, seconds, np.inf, 1.9 * seconds)
    strong = [one for one in found if one.at_limit >= LIMITED_SHARE and one.rate >= LEAST_RATE]
    return max(strong, key=lambda one: one.rate, default=None)


def _limit_cycles(
    axis: str,
    tilt: Attitude,
    motors: Motors,
    part: Segment,
    seconds: float,
    whole: float,
    least: float = 6.0,
) -> Iterator[Oscillation]:
    """Those of ``least`` s or more in a ``part`` of ``whole`` s.

    Successive windows of so many ``seconds``, half over each other, show one line.
    """
    turning = within(tilt, part)
    driven = within(motors, part)
    streams = tilt.time[turning], motors.time[driven]
    if min(map(len, streams)) < FEWEST_SAMPLES:
        return
    sampled = min(map(mean_rate, streams))
    time = np.arange(max(one[0] for one in streams), min(one[-1] for one in streams), 1 / sampled)
    shares = motors.scale.fraction(motors.outputs[driven])
    limited = np.any(np.logical_or(*at_limits(shares, motors.scale)), axis=1)
    series = np.column_stack([shares - shares.mean(axis=1, keepdims=True), limited])
    moved = np.column_stack([np.interp(time, streams[1], column) for column in series.T])
    table = np.column_stack([np.degrees(np.interp(time, streams[0], tilt.rate[turning])), moved])
    size = max(round(seconds * sampled), FEWEST_SAMPLES)
    if len(time) < size:
        return
    bins = np.fft.rfftfreq(size, 1 / sampled)
    turned, *outputs = (np.square(np.abs(spectra_of(column, size))) for column in table[:, :-1].T)
    power = np.array([turned, sum(outputs)])
    peak = bins[np.argmax(np.where(bins >= PERIODS * bins[1], turned, 0.0), axis=1)]
    width = np.maximum(2.01 * bins[1], LINE_WIDTH * peak)
    line = np.abs(bins - peak[:, np.newaxis]) <= width[:, np.newaxis]
    whole_power = np.maximum(power.sum(axis=-1), np.finfo(np.float64).tiny)
    share = np.min(np.where(line, power, 0.0).sum(axis=-1) / whole_power, axis=0)
    start = windows_of(time, size)[:, 0]
    rate = windows_of(table[:, 0], size).std(axis=1)
    at_limit = windows_of(table[:, -1], size).mean(axis=1)
    sure = np.where(peak < 2 * PERIODS * bins[1], SURE_SHARE, LINE_SHARE)
    lines = (share >= sure) & (rate >= SLIGHT_RATE)
    same = lines[1:] & lines[:-1] & (np.abs(np.diff(peak)) <= 2 * LINE_WIDTH * peak[1:])
    for run in np.split(np.arange(len(lines)), np.flatnonzero(~same) + 1):
        lasted = float(np.ptp(start[run])) + size / sampled if len(run) and lines[run[0]] else 0.0
        if lasted < least or (len(run) < 3 and share[run].min() < SURE_SHARE):
            continue
        line = np.median(peak[run])
        third = -(-len(run) // 3)
        if np.abs(peak[run] - line).max() > MAX_DRIFT * line:
            continue
        early = rate[run[:third]].mean()
        late = rate[run[-third:]].mean()
        growing = len(run) > 2 and bool(late >= GROWTH * early)
        strength = float(np.sqrt(np.mean(rate[run] ** 2)))
        limit = float(at_limit[run].mean())
        # Lines of an alias may be of any frequency.
        lasting = lasted >= LASTING_SHARE * whole and (line >= STEERED or sampled < MINIMUM_RATE)
        if limit >= LIMITED_SHARE or (strength >= LEAST_RATE and (growing or lasting)):
            frequency = float(line) if sampled >= MINIMUM_RATE else None
            yield Oscillation(axis, frequency, strength, limit, growing, lasted)
