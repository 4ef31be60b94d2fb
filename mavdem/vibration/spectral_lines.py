"""Peaks: lines in a spectrum, named by how they move with the throttle or with the speeds that motors report.

A line that stays is of the frame, one that rises with the throttle is of motors and propellers. One that falls as it
rises, or rises faster than motors can, is folded at half of the sampling rate: an alias. In windows w at throttles s a
line is at f (s / s₀)^γ; γ is that along which the windows' logarithmic spectra are highest in the mean. Where that
is not surely higher than along another, the line has no name.
"""

from collections.abc import Sequence
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.confidence import SIGNIFICANT_SIGMAS
from mavdem.dem.engine.linalg import SMALLEST_POSITIVE
from mavdem.loops.resonance import MAX_LOOP_FREQUENCY
from mavdem.vibration.spectra import Spectrum

LOWEST_LINE = 15.0  # Hz: below, vehicles are steered
OVER = 6.0  # times what is around it, in power: a line elsewhere, smeared, makes at most 5
SURROUNDINGS = 0.2
FEWEST_BINS = 7
"""What is around a line: so much of its frequency to each side, and so many bins at least."""
NEAR = 0.08  # of a frequency: two lines closer than this are one
EXPONENTS = np.round(np.arange(-6.0, 6.05, 0.1), 1)
OF_FRAME = (-0.2, 0.2)
OF_MOTORS = (0.4, 2.0)
OF_ALIASES = (-0.5, 3.5)
"""Exponents of what stays; of speeds, which go with the root of the thrust, and so with the root of the throttle or,
where that begins above 0, with a little more than the throttle; and below or above which nothing but an alias is."""
TRIED = (0.0, 0.5, 1.0, -1.0, -2.0)  # along which lines are looked for
FOLDING = 250.0
STEEPEST = 1.2
"""Hz of the highest frequency, below which a line that rises faster than this may be the alias of a harmonic."""
LASTING = 0.7  # of the windows, in which a line must be: others cross it
SMEARED = 0.01  # of the strongest line that has a name: what else has none is of it
HARMONIC = 0.02  # of a multiple of the frequency
MOST_PEAKS = 8  # peaks that are kept, the strongest
MOST_HARMONICS = 6  # multiples of a frequency that are looked for


class LineKind(StrEnum):
    """What makes a line."""

    MOTOR = "motor"
    FRAME = "frame"
    ALIAS = "alias"
    UNNAMED = "unnamed"


class SpectralLine(NamedTuple):
    """A line of a spectrum."""

    kind: LineKind
    frequency: float  # Hz, at the median throttle
    ratio: float  # power over that around it
    density: float  # of all axes there, unit²/Hz
    width: float  # Hz, at half of its decibels over what is around it
    exponent: float | None  # γ; None where the throttle did not change enough
    harmonics: tuple[int, ...] = (1,)  # multiples at which there are lines too
    order: float | None = None  # of the motors' speed, where that was logged


def find_spectral_lines(spectrum: Spectrum) -> tuple[SpectralLine, ...]:
    """Returns the lines of a ``spectrum``, the strongest first; harmonics of motors with their fundamental."""
    from scipy.signal import find_peaks  # it takes half a second to import

    frequency = spectrum.frequency
    positive = np.maximum(spectrum.total_density, SMALLEST_POSITIVE)
    logarithms = np.log(positive)
    drive = _drive(spectrum)
    peaks = []
    for exponent in TRIED:
        tracked = _tracked(logarithms, frequency, drive, exponent)
        rows = find_peaks(tracked, prominence=np.log(OVER) / 2)[0].tolist()
        for row in rows:
            if frequency[row] >= LOWEST_LINE:
                peaks.append(_peak(spectrum, logarithms, drive, row))
    kept = list[SpectralLine]()
    for peak in sorted(peaks, key=lambda peak: -peak.ratio):
        apart = all(abs(peak.frequency / higher.frequency - 1) > NEAR for higher in kept)
        if apart and peak.ratio > OVER:
            kept.append(peak)
    named = [peak for peak in kept if peak.kind is not LineKind.UNNAMED]
    highest = max((peak.ratio for peak in named), default=0.0)
    # Lines that move are smeared along others.
    clear = [peak for peak in kept if peak in named or peak.ratio > SMEARED * highest]
    return _with_harmonics(clear)[:MOST_PEAKS]


def _drive(spectrum: Spectrum) -> Array:
    """(W,) the motors' speed, or else the throttle, over its median; 1 where it is not known throughout."""
    for driven in (spectrum.motor_speed, spectrum.throttle):
        if np.isfinite(driven).all() and np.all(driven > 0):
            return driven / np.median(driven)
    return np.ones(len(spectrum.time))


def _along(logarithms: Array, frequency: Array, places: Array) -> Array:
    """(…, W) the spectra at one frequency of each window, Hz (…, W): the higher of the bins beside it."""
    bins = (places / frequency[1]).astype(int)
    low = np.clip(bins, 0, len(frequency) - 2)
    windows = np.arange(len(logarithms))
    below = logarithms[windows, low]
    above = logarithms[windows, low + 1]
    return np.maximum(below, above)


def _tracked(logarithms: Array, frequency: Array, drive: Array, exponent: float) -> Array:
    """(F,) mean of the windows' spectra, each with its frequencies divided by that of the line at its throttle."""
    moved = [
        np.interp(frequency * speed**exponent, frequency, logarithm)
        for speed, logarithm in zip(drive, logarithms, strict=True)
    ]
    return np.mean(moved, axis=0)


def _peak(spectrum: Spectrum, logarithms: Array, drive: Array, row: int) -> SpectralLine:
    """The line at a ``row`` of a mean spectrum."""
    frequency = spectrum.frequency
    at = frequency[row]
    # Once more about the place that the best exponent gives.
    for _ in range(2):
        places = at * drive ** EXPONENTS[:, None]
        scores = _along(logarithms, frequency, places)
        means = scores.mean(axis=1)
        best = EXPONENTS[np.argmax(means)]
        tracked = _tracked(logarithms, frequency, drive, best)
        middle = round(at / frequency[1])
        first = max(middle - 3, 1)
        last = min(middle + 4, len(frequency) - 1)
        rows = np.arange(first, last)
        top = rows[np.argmax(tracked[rows])]
        before, here, after = tracked[top - 1 : top + 2].tolist()
        bend = before - 2 * here + after
        beside_top = 0.5 * (before - after) / bend if bend < 0 else 0.0
        at = (top + beside_top) * frequency[1]
    kind = _kind(scores, best, at)
    if kind is LineKind.MOTOR and best > STEEPEST and spectrum.nyquist_frequency < FOLDING:
        kind = LineKind.UNNAMED
    beside = max(FEWEST_BINS, round(SURROUNDINGS * top))
    around = tracked[max(top - beside, 0) : top + beside + 1]
    base = np.median(around)
    along = _along(logarithms, frequency, at * drive**best)
    present = np.mean(along > base + np.log(OVER) / 2)
    half = (here + base) / 2
    is_below = tracked[:top] <= half
    low = np.flatnonzero(is_below).max(initial=0)
    upwards = np.append(tracked[low + 1 :], -np.inf)
    wide = np.argmax(upwards <= half)
    ratio = np.exp(here - base) if present >= LASTING else 0.0
    order = None
    if np.isfinite(spectrum.motor_speed).all() and kind is LineKind.MOTOR:
        order = at / np.median(spectrum.motor_speed)
    return SpectralLine(
        kind=kind,
        frequency=at,
        ratio=ratio,
        density=np.exp(here),
        width=wide * frequency[1],
        exponent=None if kind is LineKind.UNNAMED else best,
        order=order,
    )


def _kind(scores: Array, best: float, at: float) -> LineKind:
    """What moves with the ``best`` of ``EXPONENTS``, by scores (E, W); unnamed where other kinds fit nearly as well."""
    kinds = np.array([_kind_of(exponent, at) for exponent in EXPONENTS.tolist()])
    own = _kind_of(best, at)
    row = np.flatnonzero(best == EXPONENTS)[0]
    chosen = scores[row]
    for other in set(kinds.tolist()) - {own, LineKind.UNNAMED}:
        rivals = scores[kinds == other]
        strongest = np.argmax(rivals.mean(axis=1))
        rival = rivals[strongest]
        better = chosen - rival
        if better.mean() <= SIGNIFICANT_SIGMAS * better.std() / np.sqrt(len(better)):
            return LineKind.UNNAMED
    return own


def _kind_of(exponent: float, at: float) -> LineKind:
    kind = LineKind.UNNAMED
    if OF_FRAME[0] <= exponent <= OF_FRAME[1]:
        # A slow line that stays may be the loop's own resonance.
        kind = LineKind.FRAME if at > MAX_LOOP_FREQUENCY else LineKind.UNNAMED
    elif OF_MOTORS[0] <= exponent <= OF_MOTORS[1]:
        kind = LineKind.MOTOR
    elif not OF_ALIASES[0] < exponent < OF_ALIASES[1]:
        kind = LineKind.ALIAS
    return kind


def _with_harmonics(peaks: Sequence[SpectralLine]) -> tuple[SpectralLine, ...]:
    """Motors' fundamentals with their multiples, which are left out; and all else."""
    kept = list[SpectralLine]()
    for peak in sorted(peaks, key=lambda ranked: ranked.frequency):
        parent = next(
            (motor for motor in kept if motor.kind is LineKind.MOTOR and _multiple(motor, peak)),
            None,
        )
        if parent is None or peak.kind is LineKind.FRAME:
            kept.append(peak)
        else:
            multiples = (*parent.harmonics, _multiple(parent, peak))
            kept[kept.index(parent)] = parent._replace(harmonics=multiples)
    return tuple(sorted(kept, key=lambda ranked: -ranked.ratio))


def _multiple(fundamental: SpectralLine, peak: SpectralLine) -> int:
    """Which multiple of a fundamental a line is; 0 where it is none."""
    ratio = peak.frequency / fundamental.frequency
    near = round(ratio)
    if 2 <= near <= MOST_HARMONICS and abs(ratio / near - 1) <= HARMONIC:
        return near
    return 0
