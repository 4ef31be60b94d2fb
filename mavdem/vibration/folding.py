"""Folding (aliasing) in the spectrum of a slowly sampled sensor: at which frequency faster motion appears in it.

Sampled at the rate f_s, motion at f appears at |f − n f_s|, for the whole number n with which that is at most f_s / 2.
"""

import numpy as np

from mavdem.arrays import SMALLEST_POSITIVE
from mavdem.loops.resonance import MAX_LOOP_FREQUENCY, MIN_PEAK_FREQUENCY
from mavdem.vibration.spectra import Spectrum
from mavdem.vibration.spectral_lines import (
    MAX_LINE_FREQUENCY_RATIO,
    MIN_LINE_FREQUENCY,
    MIN_LINE_RATIO,
    prominent_peaks,
)


def folded_frequency(frequency: float, nyquist_frequency: float) -> float:
    """Returns at which frequency a vibration appears in a spectrum that may end below it: 70 Hz at 30 Hz of 50 Hz.

    Args:
        frequency: frequency of the vibration, Hz.
        nyquist_frequency: highest frequency of the spectrum, Hz: half of the sampling rate.
    """
    sampling_rate = 2 * nyquist_frequency
    return abs(frequency - sampling_rate * round(frequency / sampling_rate))


def faster_frequencies(frequency: float, nyquist_frequency: float) -> tuple[float, float, float]:
    """Returns the three lowest frequencies above a spectrum's end that appear in it at a given one (aliasing), Hz.

    A peak at 30 Hz in a spectrum that ends at 50 Hz may thus be a vibration of 70, 130 or 170 Hz.

    Args:
        frequency: frequency in the spectrum at which they appear, Hz.
        nyquist_frequency: highest frequency of the spectrum, Hz: half of the sampling rate.
    """
    sampling_rate = 2 * nyquist_frequency
    return sampling_rate - frequency, sampling_rate + frequency, 2 * sampling_rate - frequency


def possibly_folded_peak(spectrum: Spectrum, axis: int) -> float | None:
    """Returns the frequency of the highest peak below ``MIN_LINE_FREQUENCY`` that may be folded (aliased), Hz.

    Vehicles are steered below that frequency, so that such a peak is no spectral line. But in a spectrum that ends
    within the frequencies of control loops, it may as well be a vibration, or an oscillation, of a higher frequency.

    Args:
        spectrum: spectrum of one sensor.
        axis: number of the axis, from 0.

    Returns:
        The frequency; None without such a peak, and for a spectrum that reaches beyond the control loops.
    """
    if spectrum.nyquist_frequency > MAX_LOOP_FREQUENCY:
        return None
    highest_frequency = min(
        MIN_LINE_FREQUENCY, MAX_LINE_FREQUENCY_RATIO * spectrum.nyquist_frequency
    )
    log_density = np.log(np.maximum(spectrum.mean_density[axis], SMALLEST_POSITIVE))
    # A peak is an index of the frequencies of the spectrum.
    peaks = [
        peak
        for peak in prominent_peaks(log_density, np.log(MIN_LINE_RATIO))
        if MIN_PEAK_FREQUENCY <= spectrum.frequency[peak] < highest_frequency
    ]
    if not peaks:
        return None
    highest_peak = max(peaks, key=lambda peak: log_density[peak])
    return float(spectrum.frequency[highest_peak])
