"""Spectral lines, whose cause is identified by how their frequency depends on throttle or motor speed.

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

from mavdem.arrays import SMALLEST_POSITIVE, Array
from mavdem.confidence import SIGNIFICANT_SIGMAS
from mavdem.loops.resonance import MAX_LOOP_FREQUENCY
from mavdem.vibration.spectra import Spectrum

MIN_LINE_FREQUENCY = 15.0
"""Lowest frequency of a line, Hz: below it, vehicles are steered."""
MAX_LINE_FREQUENCY_RATIO = 0.95
"""Highest frequency of a line, relative to half of the sampling rate.

At that edge the spectrum is folded: vibration just above it is seen just below it, so that a line there may belong to
either side. Its surroundings end there too, so that a density that only rises to the edge stands out from them.
"""
MIN_LINE_RATIO = 6.0
"""Least ratio of the power of a line to that around it: a line that is smeared by alignment makes at most 5."""
MIN_PEAK_PROMINENCE = np.log(MIN_LINE_RATIO) / 2
"""Least prominence of a peak in a mean logarithmic spectrum: half of a line's, in decibels, since a mean smears it."""
SURROUNDING_WIDTH = 0.2
"""Width of the surroundings of a line to each side, relative to its frequency: a choice."""
MIN_SURROUNDING_BINS = 7
"""Least width of the surroundings to each side, in frequency bins: a choice."""
MIN_SEPARATION = 0.08
"""Relative difference of two frequencies up to which two lines are one: a choice."""
TOP_SEARCH_BINS = 3
"""Number of bins to each side of a line's frequency among which its top is looked for: a choice."""
MIN_PRESENCE = 0.7
"""Least fraction of the windows in which a line is visible; in the others, another line may cross it."""
SMEARED_RATIO = 0.01
"""Ratio of an unnamed line, relative to the strongest named line's, below which it is that line, smeared: a choice."""
MAX_LINES = 8
"""Largest number of lines of a spectrum, the strongest: a choice."""

EXPONENTS = np.round(np.arange(-6.0, 6.05, 0.1), 1)
"""Exponents γ that a line may have: its frequency is proportional to the drive to the power γ."""
SEARCH_EXPONENTS = (0.0, 0.5, 1.0, -1.0, -2.0)
"""Exponents by which spectra are aligned to find lines; the exponent of each line is determined afterwards."""
FRAME_EXPONENTS = (-0.2, 0.2)
"""Least and greatest exponent of a line of the frame, whose frequency stays."""
MOTOR_EXPONENTS = (0.4, 2.0)
"""Least and greatest exponent of a line of the motors.

The speed of a motor is proportional to the root of its thrust. So it goes with the root of the throttle, or with a
higher power where thrust begins only above a throttle of 0.
"""
ALIAS_EXPONENTS = (-0.5, 3.5)
"""Exponents at or below the first, and at or above the second, only an alias has."""
MAX_SLOW_SPECTRUM_EXPONENT = 1.2
"""Exponent beyond which a rising line of a slow spectrum may be the alias of a harmonic."""
SLOW_NYQUIST_FREQUENCY = 250.0
"""Highest frequency of a spectrum, Hz, below which it is slow: motors' harmonics lie beyond it."""

MAX_HARMONIC = 6
"""Highest multiple of a fundamental that is looked for: a choice."""
HARMONIC_TOLERANCE = 0.02
"""Largest relative distance of a harmonic from a multiple of its fundamental: a choice."""
EXPONENT_PASSES = 2
"""Number of times that exponent and frequency of a line are determined in turn: each changes the other a little."""


class LineCause(StrEnum):
    """The cause of a spectral line."""

    MOTOR = "motor"
    FRAME = "frame"
    ALIAS = "alias"
    OSCILLATION = "oscillation"
    UNNAMED = "unnamed"


class SpectralLine(NamedTuple):
    """A line of a spectrum: a narrow peak over its surroundings, with its cause."""

    cause: LineCause
    """Its cause."""
    frequency: float
    """Frequency at the median drive, Hz."""
    ratio: float
    """Power at its top over that around it."""
    density: float
    """Density of all axes at its top, unit²/Hz."""
    width: float
    """Width at half of its height in decibels, Hz."""
    exponent: float | None
    """Exponent γ, by which the frequency moves with the drive; ``None`` where the drive did not change enough."""
    harmonics: tuple[int, ...] = (1,)
    """Multiples of the frequency at which there are lines, 1 included."""
    order: float | None = None
    """Frequency over the motors' speed; ``None`` where that was not logged, or the line is not of motors."""


def find_spectral_lines(spectrum: Spectrum) -> tuple[SpectralLine, ...]:
    """Finds the lines of a spectrum, and what causes them.

    The frequency of a line may be proportional to a power of the throttle, so that a mean over windows would smear it.
    Therefore the spectra of all windows are aligned by each of ``SEARCH_EXPONENTS``, exponents of such a power, before
    they are averaged; a line stands out if the exponent is near the line's. Each peak is then tracked with a more exact
    exponent. A line of unknown cause that is much weaker than a line of known cause is that line, smeared by a wrong
    exponent, and is left out.

    Args:
        spectrum: spectrum of one sensor, in W windows.

    Returns:
        At most ``MAX_LINES`` lines, the strongest first. Harmonics of motors are part of their fundamental.
    """
    windows = _log_spectra(spectrum)
    frequency = windows.frequency
    candidates = []
    for exponent in SEARCH_EXPONENTS:
        mean_log_density = windows.aligned_mean(exponent)
        # A peak makes a candidate, whose ratio is then measured with its exponent.
        for peak in prominent_peaks(mean_log_density, MIN_PEAK_PROMINENCE):
            if frequency[peak] >= MIN_LINE_FREQUENCY:
                candidates.append(_line_near(spectrum, windows, frequency[peak]))
    # The same line may be found with several exponents. The ratio of a line is its height above the spectrum around it.
    highest_frequency = MAX_LINE_FREQUENCY_RATIO * spectrum.nyquist_frequency
    lines = _distinct_lines([line for line in candidates if line.frequency <= highest_frequency])
    ratio_of_strongest_named_line = 0.0
    for line in lines:
        if line.cause is not LineCause.UNNAMED:
            ratio_of_strongest_named_line = max(ratio_of_strongest_named_line, line.ratio)
    clear_lines = []
    for line in lines:
        is_strong = line.ratio > SMEARED_RATIO * ratio_of_strongest_named_line
        if line.cause is not LineCause.UNNAMED or is_strong:
            clear_lines.append(line)
    return _with_harmonics(clear_lines)[:MAX_LINES]


def prominent_peaks(values: Array, min_prominence: float) -> list[int]:
    """Finds the peaks of a curve that stand out from it.

    The prominence of a peak is its height above the higher of two minima: the minima of the curve on either side, up to
    the next higher point or the end of the curve. ``scipy.signal.find_peaks`` does the same, and finds flat tops too,
    but takes half a second to import.

    Args:
        values: (N,) the curve.
        min_prominence: least prominence, in the unit of the curve.

    Returns:
        Indices of the peaks, ascending.
    """
    inner_values = values[1:-1]
    is_peak = (inner_values > values[:-2]) & (inner_values > values[2:])
    peaks = []
    for peak in (np.flatnonzero(is_peak) + 1).tolist():
        # The range around the peak in which nothing is higher: between the nearest higher points on either side.
        is_higher = values > values[peak]
        higher_before = np.flatnonzero(is_higher[:peak])
        higher_after = peak + np.flatnonzero(is_higher[peak:])
        range_start = higher_before[-1] + 1 if len(higher_before) else 0
        range_end = higher_after[0] if len(higher_after) else len(values)
        lowest_before = values[range_start : peak + 1].min()
        lowest_after = values[peak:range_end].min()
        prominence = values[peak] - max(lowest_before, lowest_after)
        if prominence >= min_prominence:
            peaks.append(peak)
    return peaks


def _distinct_lines(candidates: Sequence[SpectralLine]) -> list[SpectralLine]:
    """Selects the distinct lines among candidates.

    A candidate is left out if its ratio does not exceed ``MIN_LINE_RATIO``, or if its relative distance from a stronger
    line is at most ``MIN_SEPARATION``, since it is then the same line.

    Args:
        candidates: lines in any order, of which several may be the same.

    Returns:
        The lines, the strongest first.
    """
    distinct_lines = list[SpectralLine]()
    for candidate in sorted(candidates, key=lambda line: -line.ratio):
        is_separate = True
        for stronger_line in distinct_lines:
            relative_distance = abs(candidate.frequency / stronger_line.frequency - 1)
            # The negated comparison also leaves out a distance of NaN.
            if not relative_distance > MIN_SEPARATION:
                is_separate = False
        if is_separate and candidate.ratio > MIN_LINE_RATIO:
            distinct_lines.append(candidate)
    return distinct_lines


@dataclass(frozen=True)
class _LogSpectra:
    """Logarithmic spectra of W windows, with the drive of each: motor speed or throttle over its median."""

    frequency: Array
    """Frequencies (F,), Hz, from 0 on in even steps."""
    log_density: Array
    """Natural logarithm of the density of all axes (W, F)."""
    drive: Array
    """The motors' speed, or else the throttle, over its median (W,); 1 where neither is known in all windows."""

    @property
    def frequency_step(self) -> float:
        """Step between two frequencies, Hz."""
        return self.frequency[1]

    def density_along(self, frequencies: Array) -> Array:
        """Returns the logarithmic density of each window at another frequency.

        Args:
            frequencies: (…, W) a frequency, Hz, for each of W windows; the leading dimensions are free.

        Returns:
            (…, W) natural logarithms of the density, at the higher of the two bins between which the frequency lies.
        """
        # The index of the bin below each frequency. The last bin is none, since it has no neighbour above it.
        bin_below = (frequencies / self.frequency_step).astype(int)
        bin_below = np.clip(bin_below, 0, len(self.frequency) - 2)
        # Each window has its own spectrum: the last dimension of the frequencies chooses the spectrum of that window.
        windows = np.arange(len(self.log_density))
        density_below = self.log_density[windows, bin_below]
        density_above = self.log_density[windows, bin_below + 1]
        return np.maximum(density_below, density_above)

    def aligned_mean(self, exponent: float) -> Array:
        """Returns the mean of the logarithmic spectra over the windows, each stretched so that lines are aligned.

        A line at f s_w^γ in window w, with the drive s_w, is at f in the stretched spectrum of every window. So it adds
        up in the mean, while lines of other exponents are smeared.

        Args:
            exponent: exponent γ of the lines that are aligned.

        Returns:
            Mean logarithmic density at the frequencies of the spectra (F,).
        """
        aligned_densities = []
        for drive, log_density in zip(self.drive, self.log_density, strict=True):
            frequency_in_window = self.frequency * drive**exponent
            aligned_densities.append(np.interp(frequency_in_window, self.frequency, log_density))
        return np.mean(aligned_densities, axis=0)


def _log_spectra(spectrum: Spectrum) -> _LogSpectra:
    """Returns the logarithmic spectra of all windows, with the drive of each.

    The frequency of motor lines depends on the drive: the motors' speed relative to its median if it is known in all
    windows, otherwise the throttle relative to its median. If neither is known, the drive is 1. Logarithms are used so
    that windows of strong vibration have no more weight than others.

    Args:
        spectrum: spectrum of one sensor, in W windows.

    Returns:
        Logarithms of the density (W, F), and drive (W,).
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
    """Exponent γ for which the mean logarithmic density along f · drive^γ is highest."""
    scores: Array
    """Logarithmic density of each window along f · drive^γ, for each of ``EXPONENTS`` (E, W)."""
    mean: Array
    """Mean logarithmic spectrum, aligned by γ (F,)."""
    top: int
    """Index of the highest frequency bin of the mean near the line."""
    frequency: float
    """Frequency f of the line at the median drive, Hz, interpolated between bins."""


def _track(windows: _LogSpectra, frequency: float) -> _Track:
    """Determines how the frequency of a line depends on the drive (motors' speed or throttle), and its exact value.

    A line of frequency f and exponent γ is at f · drive^γ in each window. Its exponent is the one of ``EXPONENTS`` for
    which the logarithmic density there is highest, averaged over windows. The spectra are aligned by it, and the
    frequency is the vertex of the parabola through the highest bin of their mean and its two neighbours. This is done
    ``EXPONENT_PASSES`` times, since a better frequency gives a better exponent.

    Args:
        windows: the logarithmic spectra.
        frequency: approximate frequency of the line at the median drive, Hz.

    Returns:
        Exponent, its scores, mean of the aligned spectra, top bin, and frequency at the median drive, Hz.
    """
    for _ in range(EXPONENT_PASSES):
        # Frequency of the line in each of W windows, as each of E exponents predicts it, and the density there (E, W).
        predicted_frequencies = frequency * windows.drive ** EXPONENTS[:, None]
        scores = windows.density_along(predicted_frequencies)
        exponent = EXPONENTS[np.argmax(scores.mean(axis=1))]
        mean_spectrum = windows.aligned_mean(exponent)
        # The highest of the bins that are at most ``TOP_SEARCH_BINS`` away. The first and the last bin of the spectrum
        # are left out, since the parabola needs a neighbour on each side.
        nearest_bin = round(frequency / windows.frequency_step)
        first_bin = max(nearest_bin - TOP_SEARCH_BINS, 1)
        last_bin = min(nearest_bin + TOP_SEARCH_BINS, len(mean_spectrum) - 2)
        top_bin = first_bin + int(np.argmax(mean_spectrum[first_bin : last_bin + 1]))
        top_and_neighbours = mean_spectrum[top_bin - 1 : top_bin + 2]
        frequency = (top_bin + _vertex_offset(top_and_neighbours)) * windows.frequency_step
    return _Track(exponent, scores=scores, mean=mean_spectrum, top=top_bin, frequency=frequency)


def _vertex_offset(heights: Array) -> float:
    """Returns how far the vertex of the parabola through three neighbouring bins is from the middle one, in bins.

    Args:
        heights: (3,) heights of the bins. If the parabola opens upwards, as at an end of the search range, the offset
            is 0.
    """
    height_before, height_of_top, height_after = heights.tolist()
    curvature = height_before - 2 * height_of_top + height_after
    return 0.5 * (height_before - height_after) / curvature if curvature < 0 else 0.0


def _line_near(spectrum: Spectrum, windows: _LogSpectra, frequency: float) -> SpectralLine:
    """Describes the line at a peak of a mean spectrum: its cause, frequency, height and width.

    The peak is tracked through the windows as the drive (motors' speed or throttle) changes, which gives its exact
    frequency and its cause. The ratio of a line is its height over the median density around it.

    The mean may also have a peak where lines of single windows cross, or because of one strong window. A true line
    exceeds its surroundings in at least ``MIN_PRESENCE`` of the windows. The ratio of any other peak is set to 0, so
    that the caller leaves it out.

    Args:
        spectrum: spectrum of one sensor, which gives the highest frequency and the motors' speed.
        windows: logarithmic spectra of the windows of the same sensor.
        frequency: frequency of the peak, Hz.

    Returns:
        The line, at the median drive.
    """
    track = _track(windows, frequency)
    cause = _line_cause(track)
    # In a spectrum that ends at a low frequency, a line that rises fast may be the alias of a harmonic beyond it.
    has_low_nyquist = spectrum.nyquist_frequency < SLOW_NYQUIST_FREQUENCY
    if cause is LineCause.MOTOR and track.exponent > MAX_SLOW_SPECTRUM_EXPONENT and has_low_nyquist:
        cause = LineCause.UNNAMED
    # Height of the top, and of what is around it, as natural logarithms of densities.
    height = float(track.mean[track.top])
    surrounding_bins = max(MIN_SURROUNDING_BINS, round(SURROUNDING_WIDTH * track.top))
    first_bin = max(track.top - surrounding_bins, 0)
    surrounding_height = np.median(track.mean[first_bin : track.top + surrounding_bins + 1])
    heights_in_windows = windows.density_along(track.frequency * windows.drive**track.exponent)
    # Single windows are noisy, so that half of the required ratio, in decibels, is enough there.
    presence = np.mean(heights_in_windows > surrounding_height + np.log(MIN_LINE_RATIO) / 2)
    # The order of a line is its frequency over the frequency of the motors' revolutions: 1 for unbalance, 2 for the
    # blades of a propeller with two.
    order = None
    if np.isfinite(spectrum.motor_speed).all() and cause is LineCause.MOTOR:
        order = track.frequency / np.median(spectrum.motor_speed)
    return SpectralLine(
        cause=cause,
        frequency=track.frequency,
        ratio=np.exp(height - surrounding_height) if presence >= MIN_PRESENCE else 0.0,
        density=np.exp(height),
        width=_bins_above(track, (height + surrounding_height) / 2) * windows.frequency_step,
        exponent=None if cause is LineCause.UNNAMED else track.exponent,
        order=order,
    )


def _bins_above(track: _Track, threshold: float) -> int:
    """Measures the width of a spectral line: the number of bins around its top that exceed a threshold.

    These are the bins between the last bin at or below the threshold before the top, and the first such bin after it.

    Args:
        track: track of the line, with the mean logarithmic spectrum, and the bin of the line's top in it.
        threshold: natural logarithm of a density, such as halfway between the top and the surroundings.

    Returns:
        Number of neighbouring frequency bins above the threshold.
    """
    is_below = track.mean[: track.top] <= threshold
    # Without a bin below the threshold it is bin 0, the constant part of the signal, which is never part of a line.
    last_bin_below = np.flatnonzero(is_below).max(initial=0)
    # A line may extend to the highest frequency. A bin of −∞ is appended there, which ends it.
    spectrum_from_line_on = np.append(track.mean[last_bin_below + 1 :], -np.inf)
    # The index of the first bin that is not above the threshold is the number of bins before it.
    return int(np.argmax(spectrum_from_line_on <= threshold))


def _line_cause(track: _Track) -> LineCause:
    """Identifies the cause of a line by a paired test: motors, frame or an alias.

    The frequency of a line is proportional to the drive (motors' speed or throttle) to the power of an exponent γ. Each
    cause has a range of exponents: near 0 for the frame, positive for motors. The scores of an exponent are the
    logarithmic densities of the W windows at the frequencies that it predicts; the line's exponent is the one with the
    highest mean score.

    Its cause is certain only if the best exponent of every other cause scores significantly lower: the mean of the W
    differences of the scores must exceed ``SIGNIFICANT_SIGMAS`` of its standard errors.

    Args:
        track: track of the line, with its exponent and the scores (E, W) of all E ``EXPONENTS``.

    Returns:
        The cause; UNNAMED if it is not certain.
    """
    cause = _cause_of_exponent(track.exponent, track.frequency)
    # Scores of the line's own exponent in all windows (W,).
    line_scores = track.scores[np.flatnonzero(track.exponent == EXPONENTS)[0]]
    # Rows of the scores by the cause of their exponent.
    rows_by_cause: dict[LineCause, list[int]] = {}
    for row, exponent in enumerate(EXPONENTS.tolist()):
        rows_by_cause.setdefault(_cause_of_exponent(exponent, track.frequency), []).append(row)
    for other_cause, rows in rows_by_cause.items():
        if other_cause in (cause, LineCause.UNNAMED):
            continue
        # Of all exponents of the other cause, the one with the highest mean score is its best explanation.
        scores = track.scores[rows]
        best_scores = scores[np.argmax(scores.mean(axis=1))]
        differences = line_scores - best_scores
        standard_error = differences.std() / np.sqrt(len(differences))
        if differences.mean() <= SIGNIFICANT_SIGMAS * standard_error:
            return LineCause.UNNAMED
    return cause


def _cause_of_exponent(exponent: float, frequency: float) -> LineCause:
    """Returns the cause of a line whose frequency is proportional to the drive to the power of an exponent.

    A constant frequency is a resonance of the frame. A frequency that rises like the speed of the motors is theirs. One
    that falls, or rises faster, can only be an alias. Exponents between these ranges are ambiguous.

    Args:
        exponent: exponent γ of the line.
        frequency: frequency of the line, Hz.

    Returns:
        The cause; UNNAMED for an ambiguous exponent.
    """
    lowest_of_frame, highest_of_frame = FRAME_EXPONENTS
    lowest_of_motors, highest_of_motors = MOTOR_EXPONENTS
    highest_of_falling, lowest_of_steep = ALIAS_EXPONENTS
    if lowest_of_frame <= exponent <= highest_of_frame:
        # At low frequencies, a constant line may also be the resonance of the rate loop.
        return LineCause.FRAME if frequency > MAX_LOOP_FREQUENCY else LineCause.UNNAMED
    if lowest_of_motors <= exponent <= highest_of_motors:
        return LineCause.MOTOR
    if exponent <= highest_of_falling or exponent >= lowest_of_steep:
        return LineCause.ALIAS
    return LineCause.UNNAMED


def _with_harmonics(lines: Sequence[SpectralLine]) -> tuple[SpectralLine, ...]:
    """Assigns the harmonics of motors to their fundamentals.

    A line at a multiple of a motor line's frequency is added to the ``harmonics`` of that line, unless it is of the
    frame. Lines are processed by ascending frequency, so that a fundamental precedes its harmonics.

    Args:
        lines: distinct lines, in any order.

    Returns:
        The lines that are no harmonics, the strongest first.
    """
    fundamentals = list[SpectralLine]()
    for line in sorted(lines, key=lambda line: line.frequency):
        index = _fundamental_of(line, fundamentals)
        if index is None or line.cause is LineCause.FRAME:
            fundamentals.append(line)
        else:
            fundamental = fundamentals[index]
            harmonics = (*fundamental.harmonics, _harmonic_number(fundamental, line))
            fundamentals[index] = fundamental._replace(harmonics=harmonics)
    return tuple(sorted(fundamentals, key=lambda line: -line.ratio))


def _fundamental_of(line: SpectralLine, fundamentals: Sequence[SpectralLine]) -> int | None:
    """Finds the fundamental whose harmonic a line is.

    Args:
        line: the line.
        fundamentals: lines of lower frequency; only lines of motors have harmonics.

    Returns:
        Index of the first fundamental of which the line is a harmonic; None if it is a harmonic of none.
    """
    for index, fundamental in enumerate(fundamentals):
        if fundamental.cause is LineCause.MOTOR and _harmonic_number(fundamental, line):
            return index
    return None


def _harmonic_number(fundamental: SpectralLine, line: SpectralLine) -> int:
    """Returns the number of the harmonic that a line is: its frequency over the frequency of the fundamental.

    Args:
        fundamental: a line of the motors.
        line: a line of a higher frequency.

    Returns:
        A number from 2 to ``MAX_HARMONIC``; 0 if the line is no harmonic, since the ratio of the frequencies differs
        from every such number by more than the fraction ``HARMONIC_TOLERANCE`` of it.
    """
    ratio = line.frequency / fundamental.frequency
    nearest_multiple = round(ratio)
    if (
        2 <= nearest_multiple <= MAX_HARMONIC
        and abs(ratio / nearest_multiple - 1) <= HARMONIC_TOLERANCE
    ):
        return nearest_multiple
    return 0
