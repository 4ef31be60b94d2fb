"""Welch's method: cross-spectra of several signals, averaged over half-overlapping windows of a flight.

The mean of each window is subtracted, and Hann's window applied.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mavdem.arrays import SMALLEST_POSITIVE, Array
from mavdem.confidence import coverage_factor
from mavdem.dataset.intervals import intersection, split_at_gaps
from mavdem.dataset.segments import Segment, Segments, rows_of_segment
from mavdem.dataset.signals import MIN_STREAM_RATE, rate_between_outages
from mavdem.dataset.time_series import TimeSeries
from mavdem.loops.margins import Complex

WELCH_SECONDS = 2.0
"""Usual length of a window, s: a choice."""
MIN_WINDOWS = 10
"""Least number of windows of an average: a response with a coherence of a half then has an error of a fifth."""
MIN_COHERENCE = 0.5
"""Coherence below which a response counts as not measured."""
MAX_GAP_STEPS = 4.0
"""Longest gap in a signal, in steps of the slowest rate that is accepted: windows do not reach across longer ones."""


class WelchSpectra(NamedTuple):
    """Averaged cross-spectra of k signals: the first, r, drives the second, p, and there may be more."""

    frequency: Array
    """Frequencies (F,), Hz, from 0 to half of the sampling rate."""
    windows: int
    """Number of windows that were summed."""
    power: Complex
    """Sums over windows of conj(X_i) X_j, with the Fourier transforms X of signals i and j (k, k, F)."""
    median_output_power: Array
    """Median over windows of the second signal's power |P|² (F,), which moments of steering hardly change."""

    @property
    def driver_power(self) -> Array:
        """Power |R|² of the first signal, summed over windows (F,); never 0, since it is divided by."""
        return np.maximum(self.power[0, 0].real, SMALLEST_POSITIVE)

    @property
    def response(self) -> Complex:
        """Response of the second signal p to the first r, S_rp / S_rr (F,)."""
        return self.power[0, 1] / self.driver_power

    @property
    def coherence(self) -> Array:
        """Magnitude-squared coherence of the first two signals, r and p, from 0 to 1 (F,)."""
        product = self.driver_power * self.power[1, 1].real
        return abs(self.power[0, 1]) ** 2 / np.maximum(product, SMALLEST_POSITIVE)


class ResampledSignals(NamedTuple):
    """Signals at one rate, in pieces of a flight without gaps."""

    rate: float
    """Rate of the samples, Hz."""
    pieces: list[Array]
    """Samples of the k signals in each piece (k, N)."""
    spans: list[Segment]
    """Boot and time, s since boot, of each piece."""


def relative_half_width(coherence: Array | float, windows: int) -> Array:
    """Returns the half width of the 90 % interval of a measured response, relative to its gain.

    The relative standard error of the response is √((1 − γ²) / (2 n γ²)) (J. S. Bendat and A. G. Piersol, Random Data,
    4th ed., sec. 9.2).

    Args:
        coherence: coherence γ² of both signals at one frequency or at F of them (F,), above 0.
        windows: number n of windows from which the spectra were averaged.

    Returns:
        The relative half width at each frequency.
    """
    standard_error = np.sqrt((1 - coherence) / (2 * windows * coherence))
    return np.asarray(coverage_factor() * standard_error)


def welch_spectra(
    signals: Sequence[TimeSeries],
    segments: Segments,
    window_seconds: float = WELCH_SECONDS,
    min_rate: float = MIN_STREAM_RATE,
) -> WelchSpectra | None:
    """Estimates the cross-spectra of several signals of a flight by Welch's method.

    Args:
        signals: k signals, such as setpoint and rate. The first is the input, and the second the output, of the
            response and coherence of the result.
        segments: segments of the flight to use.
        window_seconds: length of a window, s.
        min_rate: lowest accepted rate of a signal, Hz.

    Returns:
        The spectra; None if a signal is slower than ``min_rate``, or there are too few windows without gaps.
    """
    signals_on_grid = resampled_signals(signals, segments, window_seconds, min_rate)
    if signals_on_grid is None:
        return None
    return welch_spectra_of_pieces(signals_on_grid.rate, signals_on_grid.pieces, window_seconds)


def welch_spectra_of_pieces(
    rate: float, pieces: Sequence[Array], window_seconds: float = WELCH_SECONDS
) -> WelchSpectra | None:
    """Estimates the cross-spectra of evenly sampled signals by Welch's method.

    The first signal is the input of a response, such as a setpoint or a command, and the second its output, such as the
    body rate. Of the output, the median power over the windows is returned too: unlike the mean, it hardly contains
    moments of steering.

    Args:
        rate: rate of the samples, Hz.
        pieces: samples of the k signals (k, N) in each piece without gaps; pieces shorter than a window are left out.
        window_seconds: length of a window, s.

    Returns:
        The spectra; None if there are fewer than ``MIN_WINDOWS`` windows.
    """
    size = round(window_seconds * rate)
    transforms_of_pieces = [
        windowed_transforms(piece, size) for piece in pieces if piece.shape[1] >= size
    ]
    if sum(transforms.shape[1] for transforms in transforms_of_pieces) < MIN_WINDOWS:
        return None
    # Transforms (k, W, F) of all windows of all pieces.
    transforms = np.concatenate(transforms_of_pieces, axis=1)
    output_transforms = transforms[1]
    # Letters of einsum: signals i and j, window w, frequency f. The products are added over all windows.
    return WelchSpectra(
        frequency=np.asarray(np.fft.rfftfreq(size, 1 / rate), np.float64),
        windows=transforms.shape[1],
        power=np.einsum("iwf,jwf->ijf", transforms.conj(), transforms),
        median_output_power=np.median(np.square(abs(output_transforms)), axis=0),
    )


def resampled_signals(
    signals: Sequence[TimeSeries],
    segments: Segments,
    min_seconds: float,
    min_rate: float,
    max_rate: float = np.inf,
) -> ResampledSignals | None:
    """Interpolates several signals linearly at the same even times, in pieces of a flight in which none has a gap.

    The common rate is the rate of the slowest signal. A piece is an intersection of gapless intervals of all signals.

    Args:
        signals: k signals, each with its own time stamps.
        segments: segments of the flight to use.
        min_seconds: shortest length of a piece, s.
        min_rate: lowest accepted rate of a signal, Hz.
        max_rate: highest rate of the result, Hz.

    Returns:
        The pieces and their rate; None if a signal is slower than ``min_rate``, or no piece lasts ``min_seconds``.
    """
    # Signals that are columns of one message share their time stamps: of these one shows rate and gaps of all.
    # They are distinguished by the identity of the array of stamps, not by its values.
    signal_of_stamps = {id(signal.time): signal for signal in signals}
    rate = min(max_rate, *map(rate_between_outages, signal_of_stamps.values()))
    if rate < min_rate:
        return None
    pieces = []
    spans = []
    for segment in segments:
        gapless_intervals = [(segment.start, segment.end)]
        rows_of_stamps = {}
        for stamps, signal in signal_of_stamps.items():
            rows_in_segment = rows_of_segment(signal, segment)
            rows_of_stamps[stamps] = rows_in_segment
            time = signal.time[rows_in_segment]
            is_gap = np.diff(time) > MAX_GAP_STEPS / min_rate
            gapless_intervals = intersection(gapless_intervals, split_at_gaps(time, is_gap))
        stamps_and_values = []
        for signal in signals:
            rows_in_segment = rows_of_stamps[id(signal.time)]
            stamps_and_values.append((signal.time[rows_in_segment], signal.values[rows_in_segment]))
        for start, end in gapless_intervals:
            grid = np.arange(start, end, 1 / rate)
            if len(grid) > rate * min_seconds:
                pieces.append(
                    np.array([np.interp(grid, time, values) for time, values in stamps_and_values])
                )
                spans.append(Segment(segment.boot, start, end))
    return ResampledSignals(rate, pieces, spans) if pieces else None


def half_overlapping_windows(values: Array, size: int) -> Array:
    """Cuts samples into windows, each of which begins half a window after the one before.

    Args:
        values: samples (…, N), at least ``size`` of them; the leading dimensions are free.
        size: number of samples of a window.

    Returns:
        (…, W, size): W windows, as views of the values instead of copies.
    """
    windows = np.lib.stride_tricks.sliding_window_view(values, size, axis=-1)
    return windows[..., :: size // 2, :]


def windowed_transforms(values: Array, size: int) -> Complex:
    """Returns the Fourier transforms of half-overlapping windows.

    The mean of each window is removed, and a Hann window applied, so that neither a constant nor the ends of the window
    leak into other frequencies.

    Args:
        values: samples (…, N), at least ``size`` of them; the leading dimensions are free.
        size: number of samples of a window.

    Returns:
        Complex transforms (…, W, F) of W windows, at F = size // 2 + 1 frequencies.
    """
    windows = half_overlapping_windows(values, size)
    centred_windows = windows - windows.mean(axis=-1, keepdims=True)
    return np.fft.rfft(centred_windows * np.hanning(size))
