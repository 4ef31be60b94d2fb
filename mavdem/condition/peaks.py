"""Peaks: lines in a spectrum, named by how they move with the throttle or with the speeds that motors report.

A line that stays is of the frame, one that rises with the throttle is of motors and propellers. One that falls as it
rises, or rises faster than motors can, is folded at half of the sampling rate: an alias. In windows w at throttles s a
line is at f (s / s₀)^γ; γ is that along which the windows' logarithmic spectra are highest in the mean. Where that
is not surely higher than along another, the line has no name.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import auto
from typing import NamedTuple

import numpy as np
from scipy.ndimage import median_filter

from mavdem.condition.resonance import FASTEST_LOOP
from mavdem.condition.spectra import Spectrum
from mavdem.dem.engine.linalg import Array
from mavdem.facts.fact import InWords

LOWEST = 15.0  # Hz: below, vehicles are steered
OVER = 6.0  # times what is around it, in power: a line elsewhere, smeared, makes at most 5
AROUND = 0.15  # of a frequency to each side: what is around a line
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
SURE = 3.0  # standard errors by which one exponent must be better than another
LASTING = 0.7  # of the windows, in which a line must be: others cross it
SMEARED = 0.01  # of the strongest line that has a name: what else has none is of it
HARMONIC = 0.02  # of a multiple of the frequency
MOST = 8  # peaks that are kept, the strongest
MOST_HARMONICS = 6


class PeakKind(InWords):
    """What makes a line."""

    MOTOR = auto()
    FRAME = auto()
    ALIAS = auto()
    UNNAMED = auto()


class Peak(NamedTuple):
    """A line of a spectrum."""

    kind: PeakKind
    frequency: float  # Hz, at the median throttle
    ratio: float  # power over that around it
    density: float  # of all axes there, unit²/Hz
    width: float  # Hz, at half of the power over what is around it
    exponent: float | None  # γ; None where the throttle did not change enough
    harmonics: tuple[int, ...] = (1,)  # multiples at which there are lines too
    order: float | None = None  # of the motors' speed, where that was logged


def peaks_of(spectrum: Spectrum) -> tuple[Peak, ...]:
    """Returns the lines of a ``spectrum``, the strongest first; harmonics of motors with their fundamental."""
    logarithms = np.log(np.maximum(spectrum.whole, np.finfo(np.float64).tiny))
    drive = _drive(spectrum)
    found = list[Peak]()
    for exponent in TRIED if drive is not None else (0.0,):
        tracked = _tracked(logarithms, spectrum.frequency, drive, exponent)
        for row in _lines(tracked, spectrum.frequency):
            found.append(_peak(spectrum, logarithms, drive, row, exponent))
    found.sort(key=lambda peak: -peak.ratio)
    kept = list[Peak]()
    for peak in found:
        apart = all(abs(peak.frequency / one.frequency - 1) > NEAR for one in kept)
        if apart and peak.ratio > OVER:
            kept.append(peak)
    named = [peak for peak in kept if peak.kind is not PeakKind.UNNAMED]
    highest = max((peak.ratio for peak in named), default=0.0)
    # Lines that move are smeared along others.
    clear = [peak for peak in kept if peak in named or peak.ratio > SMEARED * highest]
    return _with_harmonics(clear)[:MOST]


def _drive(spectrum: Spectrum) -> Array | None:
    """(W,) the motors' speed, or else the throttle, over its median; None where it is not known throughout."""
    for driven in (spectrum.speed, spectrum.throttle):
        if np.isfinite(driven).all() and np.all(driven > 0):
            return np.asarray(driven / np.median(driven))
    return None


def _along(
    logarithms: Array, frequency: Array, drive: Array | None, at: float, exponent: float
) -> Array:
    """(W,) the spectra at the line through ``at``, Hz, at the median throttle: the higher of the bins beside it."""
    still = np.ones(len(logarithms))
    place = at * (still if drive is None else drive**exponent) / frequency[1]
    low = np.clip(place.astype(int), 0, len(frequency) - 2)
    windows = np.arange(len(logarithms))
    return np.asarray(np.maximum(logarithms[windows, low], logarithms[windows, low + 1]))


def _tracked(logarithms: Array, frequency: Array, drive: Array | None, exponent: float) -> Array:
    """(F,) mean of the windows' spectra, each with its frequencies divided by that of the line at its throttle."""
    if drive is None or not exponent:
        return np.asarray(logarithms.mean(axis=0))
    moved = [
        np.interp(frequency * speed**exponent, frequency, one)
        for speed, one in zip(drive, logarithms, strict=True)
    ]
    return np.asarray(np.mean(moved, axis=0))


def _lines(tracked: Array, frequency: Array) -> list[int]:
    """Rows of the lines in a mean spectrum (F,)."""
    over = tracked - _around(tracked)
    highest = (over[1:-1] >= over[:-2]) & (over[1:-1] > over[2:])
    rows = 1 + np.flatnonzero(highest & (over[1:-1] > np.log(OVER)))
    rows = rows[frequency[rows] >= LOWEST]
    order = rows[np.argsort(-over[rows])]
    kept = list[int]()
    for row in order.tolist():
        if all(abs(frequency[row] / frequency[one] - 1) > NEAR for one in kept):
            kept.append(row)
    return kept


def _around(tracked: Array) -> Array:
    """(F,) what is around each frequency: the median of a share of it to each side, and of 15 bins at least."""
    rows = np.arange(len(tracked))
    widths = np.maximum(2 * AROUND * rows, 15.0)
    sizes = 15 * 2 ** np.arange(0, 8)
    smoothed = np.array([median_filter(tracked, int(size), mode="nearest") for size in sizes])
    chosen = np.clip(np.searchsorted(sizes, widths), 0, len(sizes) - 1)
    return np.asarray(smoothed[chosen, rows])


def _peak(
    spectrum: Spectrum, logarithms: Array, drive: Array | None, row: int, first: float
) -> Peak:
    """The line at a ``row`` of the mean spectrum along an exponent, ``first``."""
    frequency = spectrum.frequency
    at = float(frequency[row])
    best = first
    kind = PeakKind.UNNAMED
    # Once more about the place that the best exponent gives.
    for _ in range(2):
        if drive is not None:
            scores = np.array([_along(logarithms, frequency, drive, at, one) for one in EXPONENTS])
            best = float(EXPONENTS[np.argmax(scores.mean(axis=1))])
            kind = _kind(scores, best, at)
        tracked = _tracked(logarithms, frequency, drive, best)
        middle = round(at / frequency[1])
        rows = np.arange(max(middle - 3, 1), min(middle + 4, len(frequency) - 1))
        top = int(rows[np.argmax(tracked[rows])])
        before, here, after = tracked[top - 1 : top + 2].tolist()
        bend = before - 2 * here + after
        at = float((top + (0.5 * (before - after) / bend if bend < 0 else 0.0)) * frequency[1])
    if kind is PeakKind.MOTOR and best > STEEPEST and spectrum.highest < FOLDING:
        kind = PeakKind.UNNAMED
    exponent = None if kind is PeakKind.UNNAMED else best
    base = float(_around(tracked)[top])
    along = _along(logarithms, frequency, drive, at, best)
    present = float(np.mean(along > base + np.log(OVER) / 2))
    half = tracked > (here + base) / 2
    edges = np.flatnonzero(~half)
    low, high = edges[edges < top].max(initial=0), edges[edges > top].min(initial=len(frequency))
    order = None
    if np.isfinite(spectrum.speed).all() and kind is PeakKind.MOTOR:
        order = at / float(np.median(spectrum.speed))
    return Peak(
        kind=kind,
        frequency=at,
        ratio=float(np.exp(here - base)) if present >= LASTING else 0.0,
        density=float(np.exp(here)),
        width=float((high - low - 1) * frequency[1]),
        exponent=exponent,
        order=order,
    )


def _kind(scores: Array, best: float, at: float) -> PeakKind:
    """What moves with the ``best`` of ``EXPONENTS``, by scores (E, W); unnamed where other kinds fit nearly as well."""
    kinds = np.array([_kind_of(one, at) for one in EXPONENTS.tolist()])
    own = _kind_of(best, at)
    chosen = scores[np.flatnonzero(best == EXPONENTS)[0]]
    for other in set(kinds.tolist()) - {own, PeakKind.UNNAMED}:
        rivals = scores[kinds == other]
        rival = rivals[np.argmax(rivals.mean(axis=1))]
        better = chosen - rival
        if better.mean() < SURE * better.std() / np.sqrt(len(better)):
            return PeakKind.UNNAMED
    return own


def _kind_of(exponent: float, at: float) -> PeakKind:
    kind = PeakKind.UNNAMED
    if OF_FRAME[0] <= exponent <= OF_FRAME[1]:
        # A slow line that stays may be the loop's own resonance.
        kind = PeakKind.FRAME if at > FASTEST_LOOP else PeakKind.UNNAMED
    elif OF_MOTORS[0] <= exponent <= OF_MOTORS[1]:
        kind = PeakKind.MOTOR
    elif not OF_ALIASES[0] < exponent < OF_ALIASES[1]:
        kind = PeakKind.ALIAS
    return kind


def _with_harmonics(peaks: Sequence[Peak]) -> tuple[Peak, ...]:
    """Motors' fundamentals with their multiples, which are left out; and all else."""
    kept = list[Peak]()
    for peak in sorted(peaks, key=lambda one: one.frequency):
        parent = next(
            (one for one in kept if one.kind is PeakKind.MOTOR and _multiple(one, peak)), None
        )
        if parent is None or peak.kind is PeakKind.FRAME:
            kept.append(peak)
        else:
            multiples = (*parent.harmonics, _multiple(parent, peak))
            kept[kept.index(parent)] = parent._replace(harmonics=multiples)
    return tuple(sorted(kept, key=lambda one: -one.ratio))


def _multiple(fundamental: Peak, peak: Peak) -> int:
    """Which multiple of a fundamental a line is; 0 where it is none."""
    ratio = peak.frequency / fundamental.frequency
    near = round(ratio)
    return near if 2 <= near <= MOST_HARMONICS and abs(ratio / near - 1) <= HARMONIC else 0
