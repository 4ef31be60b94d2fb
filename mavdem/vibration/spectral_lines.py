"""Spectral lines, named by how their frequency moves with the throttle or with the speeds that motors report.

In windows w with relative drive s_w, the motors' speed or else the throttle over its median, a line is at f s_w^γ. The
exponent γ is that along which the windows' logarithmic spectra are highest in the mean. A line that stays is of the
frame; one that rises is of motors and propellers; one that falls, or rises faster than motors can, is folded at half of
the sampling rate: an alias. Where γ is not surely higher than others, the line has no name.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.confidence import SIGNIFICANT_SIGMAS
from mavdem.dem.engine.linalg import SMALLEST_POSITIVE
from mavdem.loops.resonance import MAX_LOOP_FREQUENCY
from mavdem.vibration.spectra import Spectrum

MIN_LINE_FREQUENCY = 15.0
"""Hz. Below, vehicles are steered."""
MIN_LINE_RATIO = 6.0
"""Power of a line over that around it, at least: a line elsewhere, smeared, makes at most 5."""
SURROUNDING_WIDTH = 0.2
"""What is around a line: so much of its frequency to each side."""
MIN_SURROUNDING_BINS = 7
"""Fewest bins of this to each side."""
MIN_SEPARATION = 0.08
"""Difference of two lines, by the frequency, below which they are one."""
TOP_SEARCH_BINS = 3
"""Bins to each side of a line's frequency among which its top is."""
MIN_PRESENCE = 0.7
"""Fraction of the windows in which a line must be; others cross it."""
SMEARED_RATIO = 0.01
"""Ratio of a line without a name by that of the strongest with a name, below which it is that line, smeared."""
MAX_LINES = 8
"""Most lines of a spectrum, the strongest."""

EXPONENTS = np.round(np.arange(-6.0, 6.05, 0.1), 1)
"""The exponents γ that a line may have."""
SEARCH_EXPONENTS = (0.0, 0.5, 1.0, -1.0, -2.0)
"""The exponents along which lines are looked for."""
FRAME_EXPONENTS = (-0.2, 0.2)
"""Least and greatest exponent of what stays."""
MOTOR_EXPONENTS = (0.4, 2.0)
"""Least and greatest exponent of motors.

Their speed goes with the root of the thrust, and so with the root of the throttle or, where that begins above 0, with a
little more than the throttle.
"""
ALIAS_EXPONENTS = (-0.5, 3.5)
"""Exponents up to and from which a line can only be an alias."""
MAX_SLOW_SPECTRUM_EXPONENT = 1.2
"""Exponent beyond which a rising line of a slow spectrum may be the alias of a harmonic."""
SLOW_NYQUIST_FREQUENCY = 250.0
"""Highest frequency of such a spectrum, Hz."""

MAX_HARMONIC = 6
"""Highest multiple of a frequency that is looked for."""
HARMONIC_TOLERANCE = 0.02
"""Distance of a line from a multiple of another, as a fraction, at most."""


class LineKind(StrEnum):
    """What makes a line."""

    MOTOR = "motor"
    FRAME = "frame"
    ALIAS = "alias"
    UNNAMED = "unnamed"


class SpectralLine(NamedTuple):
    """A line of a spectrum, a narrow peak over what is around it, with what makes it."""

    kind: LineKind
    """What makes it."""
    frequency: float
    """At the median drive, Hz."""
    ratio: float
    """Its power over that around it."""
    density: float
    """Density of all axes at its top, unit²/Hz."""
    width: float
    """Width at half of its decibels over what is around it, Hz."""
    exponent: float | None
    """γ; None where the throttle did not change enough."""
    harmonics: tuple[int, ...] = (1,)
    """Multiples of the frequency at which there are lines too."""
    order: float | None = None
    """Frequency over the motors' speed, where that was logged."""


def find_spectral_lines(spectrum: Spectrum) -> tuple[SpectralLine, ...]:
    """Returns the lines of a ``spectrum``, the strongest first; harmonics of motors with their fundamental.

    Peaks are looked for in mean spectra that are aligned by each of ``SEARCH_EXPONENTS``, so that a line that moves
    with the throttle is not smeared in one of them. Each peak is then tracked by its own exponent. A weak line without
    a name, beside a much stronger one, is what alignment by a wrong exponent makes of that one: it is left out.

    Args:
        spectrum: of one sensor, in W windows.

    Returns:
        At most ``MAX_LINES`` lines.
    """
    # It takes half a second to import.
    from scipy.signal import find_peaks

    windows = _log_spectra(spectrum)
    frequency = windows.frequency
    candidates = []
    for exponent in SEARCH_EXPONENTS:
        mean = windows.aligned_mean(exponent)
        peaks, _ = find_peaks(mean, prominence=np.log(MIN_LINE_RATIO) / 2)
        for peak in peaks.tolist():
            if frequency[peak] >= MIN_LINE_FREQUENCY:
                candidates.append(_line_near(spectrum, windows, frequency[peak]))
    # One line is found along several exponents.
    lines = _distinct(candidates)
    named = [line for line in lines if line.kind is not LineKind.UNNAMED]
    highest_ratio = max((line.ratio for line in named), default=0.0)
    # Lines that move are smeared along the exponents of others.
    clear = [
        line
        for line in lines
        if line.kind is not LineKind.UNNAMED or line.ratio > SMEARED_RATIO * highest_ratio
    ]
    return _with_harmonics(clear)[:MAX_LINES]


def _distinct(candidates: Sequence[SpectralLine]) -> list[SpectralLine]:
    """Returns the lines among the candidates, the strongest first.

    Candidates are left out that do not exceed ``MIN_LINE_RATIO``, and those within ``MIN_SEPARATION`` of a stronger
    line, which are that line once more.
    """
    lines = list[SpectralLine]()
    for candidate in sorted(candidates, key=lambda line: -line.ratio):
        is_separate = all(
            abs(candidate.frequency / stronger.frequency - 1) > MIN_SEPARATION for stronger in lines
        )
        if is_separate and candidate.ratio > MIN_LINE_RATIO:
            lines.append(candidate)
    return lines


@dataclass(frozen=True)
class _LogSpectra:
    """The logarithmic spectra of W windows, with the drive of each."""

    frequency: Array
    """(F,) Hz, from 0 on in even steps."""
    log_density: Array
    """(W, F) natural logarithm of the density of all axes."""
    drive: Array
    """(W,) the motors' speed, or else the throttle, over its median; 1 where it is not known throughout."""

    @property
    def frequency_step(self) -> float:
        """Step between two frequencies, Hz."""
        return self.frequency[1]

    def along(self, frequencies: Array) -> Array:
        """Returns the logarithmic density of each window at a frequency of its own.

        Args:
            frequencies: (…, W) one for each window, Hz.

        Returns:
            (…, W) the higher of the two bins between which the frequency lies.
        """
        # The bin below each frequency; the last one has a neighbour above it.
        bins = (frequencies / self.frequency_step).astype(int)
        low = np.clip(bins, 0, len(self.frequency) - 2)
        rows = np.arange(len(self.log_density))
        below = self.log_density[rows, low]
        above = self.log_density[rows, low + 1]
        return np.maximum(below, above)

    def aligned_mean(self, exponent: float) -> Array:
        """Returns the mean of the logarithmic spectra, each stretched so that a line of one exponent stays in place.

        A line at f s_w^γ in window w is at f in the stretched spectrum, whatever the drive s_w is. So it adds up, while
        lines of other exponents are smeared.

        Args:
            exponent: γ, by which the line moves with the drive.

        Returns:
            (F,) at the frequencies of the spectra.
        """
        aligned = [
            np.interp(self.frequency * drive**exponent, self.frequency, log_density)
            for drive, log_density in zip(self.drive, self.log_density, strict=True)
        ]
        return np.mean(aligned, axis=0)


def _log_spectra(spectrum: Spectrum) -> _LogSpectra:
    """Returns the logarithmic spectra of a ``spectrum``'s windows, with the drive of each.

    The drive is what lines of motors move with: the motors' speed where it is known in all windows, else the throttle,
    over its median; where neither is known, it is 1 in all windows. Logarithms make strong windows count no more than
    others.
    """
    log_density = np.log(np.maximum(spectrum.total_density, SMALLEST_POSITIVE))
    relative_drive = np.ones(len(spectrum.time))
    for drive in (spectrum.motor_speed, spectrum.throttle):
        if np.isfinite(drive).all() and np.all(drive > 0):
            relative_drive = drive / np.median(drive)
            break
    return _LogSpectra(spectrum.frequency, log_density, relative_drive)


class _Track(NamedTuple):
    """How a spectral line moves with the drive (motor speed or throttle) through W windows of a flight."""

    exponent: float
    """γ, along which the windows are highest in the mean."""
    scores: Array
    """(E, W) logarithmic densities of the windows along each of ``EXPONENTS``."""
    mean: Array
    """(F,) the mean logarithmic spectrum, aligned by γ."""
    top: int
    """Row of its highest frequency near the line."""
    frequency: float
    """Of the line at the median drive, Hz, between the bins."""


def _track(windows: _LogSpectra, frequency: float) -> _Track:
    """Returns how a line moves through the windows, with its frequency found more exactly.

    The exponent is the one of ``EXPONENTS`` along which the windows are highest in the mean. The spectra are aligned by
    it, and the frequency is the vertex of the parabola through the highest bin of their mean and its neighbours. All
    this is done twice, since with another exponent the line lies a little elsewhere.

    Args:
        windows: the logarithmic spectra.
        frequency: near which the line is at the median drive, Hz.
    """
    for _ in range(2):
        scores = windows.along(frequency * windows.drive ** EXPONENTS[:, None])
        exponent = EXPONENTS[np.argmax(scores.mean(axis=1))]
        mean = windows.aligned_mean(exponent)
        nearest = round(frequency / windows.frequency_step)
        first = max(nearest - TOP_SEARCH_BINS, 1)
        end = min(nearest + TOP_SEARCH_BINS + 1, len(mean) - 1)
        # Rows have a neighbour on each side.
        rows = np.arange(first, end)
        top = rows[np.argmax(mean[rows])]
        before, highest, after = mean[top - 1 : top + 2].tolist()
        curvature = before - 2 * highest + after
        # From the highest bin, in bins; a parabola that is open upwards has no vertex of use.
        offset = 0.5 * (before - after) / curvature if curvature < 0 else 0.0
        frequency = (top + offset) * windows.frequency_step
    return _Track(exponent, scores, mean, top, frequency)


def _line_near(spectrum: Spectrum, windows: _LogSpectra, frequency: float) -> SpectralLine:
    """Returns the line at a peak of a mean spectrum, with its kind, height and width.

    The peak is followed through the windows as the drive (motors' speed or throttle) changes, which gives its exact
    frequency and its kind. Its height over the median density around it is its ratio.

    A mean may have a peak where lines of single windows cross, or by one strong window. A true line rises above its
    surroundings in at least ``MIN_PRESENCE`` of the windows. The ratio of a peak that does not is set to 0, so that it
    is left out later.

    Args:
        spectrum: of one sensor, for its highest frequency and the motors' speed.
        windows: the logarithmic spectra of that spectrum.
        frequency: of the peak, Hz.
    """
    track = _track(windows, frequency)
    kind = _kind(track)
    # In a spectrum that ends at a low frequency, a line that rises fast may be the alias of a harmonic beyond the end.
    is_slow = spectrum.nyquist_frequency < SLOW_NYQUIST_FREQUENCY
    if kind is LineKind.MOTOR and track.exponent > MAX_SLOW_SPECTRUM_EXPONENT and is_slow:
        kind = LineKind.UNNAMED
    # Height of the top, and of what is around it, as natural logarithms of densities.
    height = float(track.mean[track.top])
    surrounding_bins = max(MIN_SURROUNDING_BINS, round(SURROUNDING_WIDTH * track.top))
    first = max(track.top - surrounding_bins, 0)
    base = np.median(track.mean[first : track.top + surrounding_bins + 1])
    heights = windows.along(track.frequency * windows.drive**track.exponent)
    # In a window, half of the needed ratio, in decibels, is enough, since single windows are noisy.
    presence = np.mean(heights > base + np.log(MIN_LINE_RATIO) / 2)
    # The order of a line is its frequency in turns of the motors: 1 for unbalance, 2 for a propeller of two blades.
    order = None
    if np.isfinite(spectrum.motor_speed).all() and kind is LineKind.MOTOR:
        order = track.frequency / np.median(spectrum.motor_speed)
    return SpectralLine(
        kind=kind,
        frequency=track.frequency,
        ratio=np.exp(height - base) if presence >= MIN_PRESENCE else 0.0,
        density=np.exp(height),
        width=_bins_above(track, (height + base) / 2) * windows.frequency_step,
        exponent=None if kind is LineKind.UNNAMED else track.exponent,
        order=order,
    )


def _bins_above(track: _Track, level: float) -> int:
    """Returns the width of a line at a level: how many neighbouring frequency bins about its top are higher.

    The line begins after the last bin before its top that is not above the level, and ends before the first bin from
    there on that is not.

    Args:
        track: of the line: the mean logarithmic spectrum over windows, and the bin of the line's top in it.
        level: natural logarithm of a density, usually halfway between the top and what is around the line.
    """
    is_below = track.mean[: track.top] <= level
    # Bin 0, the constant part, ends a line that nothing else ends.
    last_below = np.flatnonzero(is_below).max(initial=0)
    # The line may reach to the highest frequency: a bin below all levels, appended there, ends it.
    from_line_on = np.append(track.mean[last_below + 1 :], -np.inf)
    return int(np.argmax(from_line_on <= level))


def _kind(track: _Track) -> LineKind:
    """Returns what makes a line: motors, frame or an alias; unnamed where that is not sure.

    A line moves with the drive (motors' speed or throttle) to the power of an exponent γ. Each kind of line has a range
    of exponents: near 0 for the frame, positive for motors. The line's exponent is the one of E ``EXPONENTS`` along
    which the spectra of W windows are highest in the mean. It names the kind only if the best exponent of every other
    kind is clearly worse. To see that, the logarithmic densities along both are subtracted window by window: the mean
    of the W differences must exceed ``SIGNIFICANT_SIGMAS`` of its standard errors.

    Args:
        track: of the line, with its exponent and ``scores`` (E, W), the logarithmic densities along all exponents.
    """
    # (E,) kind of each exponent.
    kinds = np.array(
        [_kind_of_exponent(exponent, track.frequency) for exponent in EXPONENTS.tolist()]
    )
    kind = _kind_of_exponent(track.exponent, track.frequency)
    # (W,) logarithmic density of each window along the line's exponent.
    own_scores = track.scores[np.flatnonzero(track.exponent == EXPONENTS)[0]]
    for rival in set(kinds.tolist()) - {kind, LineKind.UNNAMED}:
        # Of all exponents of the other kind, the one along which the windows are highest in the mean: (W,).
        scores = track.scores[kinds == rival]
        rival_scores = scores[np.argmax(scores.mean(axis=1))]
        differences = own_scores - rival_scores
        standard_error = differences.std() / np.sqrt(len(differences))
        if differences.mean() <= SIGNIFICANT_SIGMAS * standard_error:
            return LineKind.UNNAMED
    return kind


def _kind_of_exponent(exponent: float, frequency: float) -> LineKind:
    """Returns what makes a line that moves with the drive to the power of an exponent.

    Args:
        exponent: γ. What stays (0) is of the frame; what rises as motors can is of motors; what falls or rises faster
            is an alias. Exponents between these ranges have no name.
        frequency: of the line, Hz.
    """
    if FRAME_EXPONENTS[0] <= exponent <= FRAME_EXPONENTS[1]:
        # A slow line that stays may be the loop's own resonance.
        return LineKind.FRAME if frequency > MAX_LOOP_FREQUENCY else LineKind.UNNAMED
    if MOTOR_EXPONENTS[0] <= exponent <= MOTOR_EXPONENTS[1]:
        return LineKind.MOTOR
    if exponent <= ALIAS_EXPONENTS[0] or exponent >= ALIAS_EXPONENTS[1]:
        return LineKind.ALIAS
    return LineKind.UNNAMED


def _with_harmonics(lines: Sequence[SpectralLine]) -> tuple[SpectralLine, ...]:
    """Returns ``lines`` without the harmonics of motors, the strongest first.

    A line at a multiple of a motor's frequency is added to that line's ``harmonics`` instead, unless it is of the
    frame. Lines are gone through by rising frequency, so that a fundamental comes before its harmonics.
    """
    fundamentals = list[SpectralLine]()
    for line in sorted(lines, key=lambda line: line.frequency):
        index = _fundamental_of(line, fundamentals)
        if index is None or line.kind is LineKind.FRAME:
            fundamentals.append(line)
        else:
            fundamental = fundamentals[index]
            harmonics = (*fundamental.harmonics, _multiple(fundamental, line))
            fundamentals[index] = fundamental._replace(harmonics=harmonics)
    return tuple(sorted(fundamentals, key=lambda line: -line.ratio))


def _fundamental_of(line: SpectralLine, fundamentals: Sequence[SpectralLine]) -> int | None:
    """Returns which of several fundamentals a line is a harmonic of.

    Args:
        line: of a higher frequency.
        fundamentals: lines of lower frequency; only those of motors have harmonics.

    Returns:
        Index of the first that fits; None where none does.
    """
    for index, fundamental in enumerate(fundamentals):
        if fundamental.kind is LineKind.MOTOR and _multiple(fundamental, line):
            return index
    return None


def _multiple(fundamental: SpectralLine, line: SpectralLine) -> int:
    """Returns which multiple of a ``fundamental`` a ``line`` is, from 2 to ``MAX_HARMONIC``; 0 where it is none."""
    ratio = line.frequency / fundamental.frequency
    nearest = round(ratio)
    if 2 <= nearest <= MAX_HARMONIC and abs(ratio / nearest - 1) <= HARMONIC_TOLERANCE:
        return nearest
    return 0
