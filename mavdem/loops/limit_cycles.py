"""Limit cycles: a vehicle that oscillates by its own controller, which no wind does.

Wind spreads over all frequencies. A loop without margin turns to and fro at one: nearly all that the body rate and the
motors do is then in one narrow band of their spectra.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from math import radians
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from mavdem.containers import JsonValues
from mavdem.dataset.attitude import Attitude
from mavdem.dataset.motor_outputs import MotorOutputs
from mavdem.dataset.quality import samples_at_limits
from mavdem.dataset.segments import Segment, Segments
from mavdem.dataset.signals import MIN_STREAM_RATE
from mavdem.dataset.time_series import TimeSeries
from mavdem.dem.engine.linalg import SMALLEST_POSITIVE
from mavdem.loops.resonance import evenly_sampled, spectra_of, windows_of

WINDOW_LENGTHS = (4.0, 8.0)
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
MIN_AT_LIMIT_SHARE = 0.05
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
    others: tuple[Oscillation, ...] = ()  # of axes that oscillate too, and turn more slowly

    @property
    def figures(self) -> JsonValues:
        """What facts say of it: axis, frequency and rate, rad/s, and the same of all axes that oscillate."""
        axes = [(each.axis, each.frequency, radians(each.rate)) for each in (self, *self.others)]
        return {
            "subject": self.axis,
            "frequency": self.frequency,
            "turn_rate": radians(self.rate),
            "axes": axes,
        }


def detect_limit_cycle(
    motors: MotorOutputs | None, tilts: Mapping[str, Attitude], parts: Segments
) -> Oscillation | None:
    """Returns the limit cycle in these ``parts`` of a flight; None where there is none, or no motor outputs.

    ``tilts``: the attitude by axis.
    """
    if motors is None:
        return None
    whole = sum(part.duration for part in parts)
    cycles = [
        cycle
        for axis, tilt in tilts.items()
        for seconds in WINDOW_LENGTHS
        for cycle in _limit_cycles(axis, tilt, motors, parts, seconds, whole)
    ]
    return _of_vehicle(cycles)


def detect_starting_limit_cycle(
    motors: MotorOutputs, tilts: Mapping[str, Attitude], boot: int, since: float, now: float
) -> Oscillation | None:
    """Returns the limit cycle that reaches the motors' limits in the last seconds before ``now``; None without one.

    Nothing before ``since``, s of the ``boot``, counts. ``tilts``: the attitude by axis.
    """
    begun = list[Oscillation]()
    for seconds in BEGUN_WINDOWS:
        part = Segment(boot, max(since, now - 2.2 * seconds), now)
        for axis, tilt in tilts.items():
            begun += _limit_cycles(axis, tilt, motors, [part], seconds, np.inf, 1.9 * seconds)
    return _of_vehicle(
        cycle
        for cycle in begun
        if cycle.at_limit >= MIN_AT_LIMIT_SHARE and cycle.rate >= LEAST_RATE
    )


def _of_vehicle(cycles: Iterable[Oscillation]) -> Oscillation | None:
    """The strongest of all ``cycles``, with the strongest of each other axis."""
    of_axes = dict[str, Oscillation]()
    for cycle in sorted(cycles, key=attrgetter("rate"), reverse=True):
        of_axes.setdefault(cycle.axis, cycle)
    if not of_axes:
        return None
    strongest, *others = of_axes.values()
    return strongest._replace(others=tuple(others))


def _limit_cycles(
    axis: str,
    tilt: Attitude,
    motors: MotorOutputs,
    parts: Segments,
    seconds: float,
    whole: float,
    least: float = 6.0,
) -> Iterator[Oscillation]:
    """Those of ``least`` s or more in ``parts`` of a flight of ``whole`` s.

    Successive windows of so many ``seconds``, half over each other, show one line. Motors that go from stop to stop for
    ``LASTING_SHARE`` of a window leave the rate to whatever else turns the vehicle: then the line is theirs alone.
    """
    shares = motors.scale.fraction(motors.outputs)
    upper, lower = (limit.any(axis=1) for limit in samples_at_limits(shares, motors.scale))
    columns = [*(shares - shares.mean(axis=1, keepdims=True)).T, upper & lower, upper | lower]
    outputs = [TimeSeries(motors.time, motors.boot, column) for column in columns]
    grid = evenly_sampled([tilt.rate_series, *outputs], parts, seconds, FEWEST_SAMPLES / seconds)
    if grid is None:
        return
    sampled, pieces = grid
    size = round(seconds * sampled)
    bins = np.fft.rfftfreq(size, 1 / sampled)
    for piece in pieces:
        powers = np.square(abs(spectra_of(piece[:-2], size)))
        power = np.array([powers[0], powers[1:].sum(axis=0)])
        slammed = windows_of(piece[-2], size).mean(axis=1) >= LASTING_SHARE
        telling = np.where(slammed[:, None], power[1], power[0])
        seen = np.where(bins >= PERIODS * bins[1], telling, 0.0)
        peak = bins[np.argmax(seen, axis=1)]
        width = np.maximum(2.01 * bins[1], LINE_WIDTH * peak)
        line = abs(bins - peak[:, None]) <= width[:, None]
        whole_power = np.maximum(power.sum(axis=-1), SMALLEST_POSITIVE)
        shown = (power * line).sum(axis=-1) / whole_power
        share = np.where(slammed, shown[1], shown.min(axis=0))
        rate = np.degrees(windows_of(piece[0], size).std(axis=1))
        rate *= np.where(slammed, np.sqrt(shown[0]), 1.0)
        at_limit = windows_of(piece[-1], size).mean(axis=1)
        sure = np.where(peak < 2 * PERIODS * bins[1], SURE_SHARE, LINE_SHARE)
        lines = (share >= sure) & (rate >= SLIGHT_RATE)
        steady = abs(np.diff(peak)) <= 2 * LINE_WIDTH * peak[1:]
        same = lines[1:] & lines[:-1] & steady
        ends = np.flatnonzero(~same) + 1
        for run in np.split(np.arange(len(lines)), ends):
            lasted = (len(run) + 1) / 2 * seconds
            frequency = np.median(peak[run])
            drift = abs(peak[run] - frequency).max()
            is_sure = len(run) > 2 or share[run].min() >= SURE_SHARE
            drifts = drift > MAX_DRIFT * frequency
            if not (lines[run[0]] and lasted >= least and is_sure) or drifts:
                continue
            third = -(-len(run) // 3)
            last = rate[run[-third:]].mean()
            first = rate[run[:third]].mean()
            growth = last / first
            growing = len(run) > 2 and growth >= GROWTH
            strength = np.sqrt(np.mean(rate[run] ** 2))
            limit = at_limit[run].mean()
            is_fast = sampled >= MIN_STREAM_RATE
            # Lines of an alias may be of any frequency.
            lasting = lasted >= LASTING_SHARE * whole and (frequency >= STEERED or not is_fast)
            if limit >= MIN_AT_LIMIT_SHARE or (strength >= LEAST_RATE and (growing or lasting)):
                seen_frequency = frequency if is_fast else None
                yield Oscillation(axis, seen_frequency, strength, limit, growing, lasted)
