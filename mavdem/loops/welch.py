"""Welch's method: cross-spectra of several signals, averaged over half-overlapping windows of a flight.

Each window is taken about its mean through Hann's window. With coherence γ², the gain of a response that is averaged
over n windows has the relative error √((1 − γ²) / (2 γ² n)) (J. S. Bendat and A. G. Piersol, Random Data, 4th ed.,
sec. 9.2).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.dataset.intervals import intersection, split_at_gaps
from mavdem.dataset.segments import Segments, in_segments
from mavdem.dataset.signals import MIN_STREAM_RATE, rate_between_outages
from mavdem.dataset.time_series import TimeSeries
from mavdem.dem.engine.linalg import SMALLEST_POSITIVE
from mavdem.loops.margins import Complex

WELCH_SECONDS = 2.0
"""Length of a window, s, unless another is asked for."""
MIN_WINDOWS = 10
"""Fewest windows of an average: the error of a response with a coherence of a half is then a fifth."""
MIN_COHERENCE = 0.5
"""Coherence below which a response counts as not measured."""
MAX_GAP_STEPS = 4.0
"""Longest gap in a signal, in steps of the slowest rate that is accepted: windows do not reach across longer ones."""


class WelchSpectra(NamedTuple):
    """Averaged cross-spectra of k signals: the first, r, drives the second, p, and there may be more."""

    frequency: Array
    """(F,) Hz, from 0 to half of the sampling rate."""
    windows: int
    """How many windows were summed."""
    power: Complex
    """(k, k, F) sums over windows of conj(X_i) X_j, of the Fourier transforms X of signals i and j."""
    median_power: Array
    """(F,) median over windows of |P|², which hardly counts the moments at which the vehicle is steered."""

    @property
    def driver_power(self) -> Array:
        """(F,) |R|² summed over windows, at least ``SMALLEST_POSITIVE`` to divide by."""
        return np.maximum(self.power[0, 0].real, SMALLEST_POSITIVE)

    @property
    def response(self) -> Complex:
        """(F,) response of p to r, S_rp / S_rr."""
        return self.power[0, 1] / self.driver_power

    @property
    def coherence(self) -> Array:
        """(F,) magnitude-squared coherence of r and p, from 0 to 1."""
        product = self.driver_power * self.power[1, 1].real
        return abs(self.power[0, 1]) ** 2 / np.maximum(product, SMALLEST_POSITIVE)


class ResampledSignals(NamedTuple):
    """Signals at one rate, in pieces of a flight without gaps."""

    rate: float
    """Samples per second, Hz."""
    pieces: list[Array]
    """(k, N) samples of k signals in each piece."""


def welch_spectra(
    signals: Sequence[TimeSeries],
    segments: Segments,
    window_seconds: float = WELCH_SECONDS,
    min_rate: float = MIN_STREAM_RATE,
) -> WelchSpectra | None:
    """Returns the cross-spectra of ``signals`` in ``segments`` of a flight.

    Args:
        signals: k series of numbers; the first is the driver, the second what follows it.
        segments: of the flight.
        window_seconds: length of a window, s.
        min_rate: the slowest rate of a signal, Hz.

    Returns:
        None where a signal is slower than ``min_rate``, or there are fewer than ``MIN_WINDOWS`` windows without gaps.
    """
    resampled = resampled_signals(signals, segments, window_seconds, min_rate)
    if resampled is None:
        return None
    return welch_spectra_of_pieces(resampled.rate, resampled.pieces, window_seconds)


def welch_spectra_of_pieces(
    rate: float, pieces: Sequence[Array], window_seconds: float = WELCH_SECONDS
) -> WelchSpectra | None:
    """Returns the cross-spectra of signals that are sampled evenly already.

    Args:
        rate: of the samples, Hz.
        pieces: (k, N) samples of k signals in each piece without gaps; those shorter than a window do not count.
        window_seconds: length of a window, s.

    Returns:
        None where there are fewer than ``MIN_WINDOWS`` windows.
    """
    size = round(window_seconds * rate)
    transforms_of_pieces = [
        windowed_transforms(piece, size) for piece in pieces if piece.shape[1] >= size
    ]
    if sum(transforms.shape[1] for transforms in transforms_of_pieces) < MIN_WINDOWS:
        return None
    transforms = np.concatenate(transforms_of_pieces, axis=1)
    return WelchSpectra(
        frequency=np.asarray(np.fft.rfftfreq(size, 1 / rate), np.float64),
        windows=transforms.shape[1],
        power=np.einsum("iwf,jwf->ijf", transforms.conj(), transforms),
        median_power=np.median(np.square(abs(transforms[1])), axis=0),
    )


def resampled_signals(
    signals: Sequence[TimeSeries],
    segments: Segments,
    min_seconds: float,
    min_rate: float,
    max_rate: float = np.inf,
) -> ResampledSignals | None:
    """Returns ``signals``, linearly interpolated at the rate of the slowest, where none of them has a gap.

    Args:
        signals: k series of numbers.
        segments: of the flight.
        min_seconds: length of the shortest piece, s.
        min_rate: the slowest rate of a signal, Hz.
        max_rate: the fastest rate of the result, Hz.

    Returns:
        None where a signal is slower than ``min_rate``, or there is no piece of ``min_seconds``.
    """
    # A piece is an interval in which no signal has a gap: the intersection of the intervals of all of them.
    rate = min(max_rate, *map(rate_between_outages, signals))
    if rate < min_rate:
        return None
    pieces = []
    for segment in segments:
        spans = [(segment.start, segment.end)]
        stamps_and_values = []
        for signal in signals:
            rows = in_segments(signal, segment)
            time = signal.time[rows]
            stamps_and_values.append((time, signal.values[rows]))
            is_gap = np.diff(time) > MAX_GAP_STEPS / min_rate
            spans = intersection(spans, split_at_gaps(time, is_gap))
        for start, end in spans:
            grid = np.arange(start, end, 1 / rate)
            if len(grid) > rate * min_seconds:
                pieces.append(
                    np.array([np.interp(grid, time, values) for time, values in stamps_and_values])
                )
    return ResampledSignals(rate, pieces) if pieces else None


def half_overlapping_windows(values: Array, size: int) -> Array:
    """Returns windows of ``values``, each beginning half a window after the last.

    Args:
        values: (…, N) samples, N at least ``size``.
        size: samples of a window.

    Returns:
        (…, W, size) views of the values, not copies.
    """
    windows = np.lib.stride_tricks.sliding_window_view(values, size, axis=-1)
    return windows[..., :: size // 2, :]


def windowed_transforms(values: Array, size: int) -> Complex:
    """Returns the Fourier transforms of half-overlapping windows.

    Each window is taken about its mean and through Hann's window, so that neither a constant nor the ends of the window
    leak into other frequencies.

    Args:
        values: (…, N) samples, N at least ``size``.
        size: samples of a window.

    Returns:
        (…, W, F) complex transforms at F = size // 2 + 1 frequencies.
    """
    windows = half_overlapping_windows(values, size)
    centred = windows - windows.mean(axis=-1, keepdims=True)
    return np.fft.rfft(centred * np.hanning(size))
