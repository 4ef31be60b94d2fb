"""Limit cycles: a vehicle that oscillates by its own controller, which no wind does.

Wind spreads over all frequencies. A loop without margin turns to and fro at one: nearly all that the body rate and the
motors do is then in one narrow band of their spectra.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from mavdem.alignment.align import Segment, mean_rate, within
from mavdem.alignment.drive import TILT_AXES, Motors
from mavdem.alignment.quality import IDLE_THROTTLE, STOP_MARGIN
from mavdem.alignment.signals import MINIMUM_RATE, Attitude, Signals

WINDOWS, FEWEST_SAMPLES, PERIODS = (4.0, 8.0), 32, 8
"""Of one spectrum: seconds, samples, and periods of the slowest line that can be told from what is merely slow."""
LINE_WIDTH = (
    0.1  # Half width of a line, as a share of its frequency; two bins at least, which is what Hann's window blurs
)
LINE_SHARE = 0.7
"""Of the variance of the rate, and of the motors', that is in the line: on sound flights of over 8 °/s at most 0.55."""
LEAST_RATE = 10.0  # deg/s, standard deviation: less is no danger, and may be rounding
LEAST_SECONDS = 6.0  # Of one line without a break
LIMITED_SHARE, GROWTH, LASTING_SHARE = 0.05, 2.0, 0.5
"""What tells a limit cycle from a gust that rings: motors at a limit so much of the time, an amplitude that grows so
many times, or that it lasts so much of the flight."""


class Oscillation(NamedTuple):
    """A limit cycle."""

    axis: str  # "roll" or "pitch": the one that turns faster
    frequency: float | None  # Hz; None where messages come so slowly that what they show may be an alias
    rate: float  # standard deviation of the body rate while it oscillates, deg/s
    at_limit: float  # share of that time with a motor at a limit
    growing: bool  # whether the amplitude grew
    seconds: float  # how long it oscillates


class _Window(NamedTuple):
    start: float  # s
    end: float
    sampled: float  # Hz
    frequency: float  # Hz, of the strongest line
    share: float  # of the variance in it, of the rate or the motors', whichever is less
    rate: float  # deg/s
    limited: float  # share of the time with a motor at a limit


def oscillation_of(signals: Signals, parts: Sequence[Segment]) -> Oscillation | None:
    """Returns the limit cycle in these ``parts`` of a flight; None where there is none, or no motor outputs."""
    found: list[Oscillation] = []
    motors = signals.motors
    if motors is not None:
        for axis, tilt in zip(TILT_AXES, signals.tilts, strict=False):
            for seconds in WINDOWS:
                windows = [list(_windows(tilt, motors, part, seconds)) for part in parts]
                count = sum(map(len, windows))
                runs = (run for of_part in windows for run in _runs(of_part))
                found += [one for run in runs if (one := _limit_cycle(axis, run, len(run) / count)) is not None]
    return max(found, key=lambda one: one.rate, default=None)


def _limit_cycle(axis: str, run: list[_Window], lasting: float) -> Oscillation | None:
    """What a line in successive windows is, ``lasting`` for a share of the flight; None where it may be a gust's."""
    seconds, third = run[-1].end - run[0].start, -(-len(run) // 3)
    rates, limited = np.array([one.rate for one in run]), float(np.mean([one.limited for one in run]))
    growing = len(run) > 2 and bool(rates[-third:].mean() >= GROWTH * rates[:third].mean())
    if seconds < LEAST_SECONDS or not (limited >= LIMITED_SHARE or growing or lasting >= LASTING_SHARE):
        return None
    fast = min(one.sampled for one in run) >= MINIMUM_RATE
    frequency = float(np.median([one.frequency for one in run])) if fast else None
    return Oscillation(axis, frequency, float(np.sqrt(np.mean(rates**2))), limited, growing, seconds)


def _runs(windows: list[_Window]) -> Iterator[list[_Window]]:
    """Successive windows with one line."""
    run: list[_Window] = []
    for one in windows:
        line = one.share >= LINE_SHARE and one.rate >= LEAST_RATE
        if run and not (line and abs(one.frequency - run[-1].frequency) <= 2 * LINE_WIDTH * one.frequency):
            yield run
            run = []
        run += [one] * line
    if run:
        yield run


def _windows(tilt: Attitude, motors: Motors, part: Segment, seconds: float) -> Iterator[_Window]:
    """Windows of ``part``, half over each other."""
    turning, driven = within(tilt, part), within(motors, part)
    streams = tilt.time[turning], motors.time[driven]
    if min(map(len, streams)) < FEWEST_SAMPLES:
        return
    sampled = min(map(mean_rate, streams))
    time = np.arange(max(one[0] for one in streams), min(one[-1] for one in streams), 1 / sampled)
    shares = motors.scale.fraction(motors.outputs[driven])
    limited = np.any((shares >= motors.scale.stop - STOP_MARGIN) | (shares <= IDLE_THROTTLE), axis=1)
    apart = shares - shares.mean(axis=1, keepdims=True)
    moved = np.column_stack([np.interp(time, streams[1], column) for column in apart.T])
    table = np.column_stack([np.degrees(np.interp(time, streams[0], tilt.rate[turning])), moved])
    size = max(round(seconds * sampled), FEWEST_SAMPLES)
    hann, bins = np.hanning(size)[:, None], np.fft.rfftfreq(size, 1 / sampled)
    apparent = bins >= PERIODS * sampled / size
    for first in range(0, len(time) - size + 1, size // 2):
        window = table[first : first + size]
        power = np.square(np.abs(np.fft.rfft((window - window.mean(axis=0)) * hann, axis=0)))
        power = np.column_stack([power[:, 0], power[:, 1:].sum(axis=1)])
        frequency = float(bins[np.argmax(np.where(apparent, power[:, 0], 0.0))])
        line = np.abs(bins - frequency) <= max(2.01 * bins[1], LINE_WIDTH * frequency)
        share = power[line].sum(axis=0) / np.maximum(power.sum(axis=0), np.finfo(np.float64).tiny)
        start, end = float(time[first]), float(time[first + size - 1])
        here = (streams[1] >= start) & (streams[1] <= end)
        yield _Window(
            start, end, sampled, frequency, float(share.min()), float(window[:, 0].std()), limited[here].mean()
        )
