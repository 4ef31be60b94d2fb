"""Spectra of messages, each at its own stamps: what the likelihood of a closed loop needs of a flight.

Windows of a few seconds are weighted and transformed at the stamps of the messages, without interpolation; what is
sampled at a rate is folded about its half, which the model's densities are likewise. Source: D. R. Brillinger, Time
Series: Data Analysis and Theory, secs. 4.3 and 5.6.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.arrays import Array

Complex = NDArray[np.complex128]
SPECTRUM_SECONDS = 8.0
FINE_SECONDS = 2.5e-4
"""To which stamps are split between two neighbours: a tenth of a control cycle, so that 100 Hz lose 0.2 %."""
LOWEST_FREQUENCY = 0.8
"""Hz: what is slower is of position control and drag, which the model of one axis does not have."""
HIGHEST_FREQUENCY = 100.0  # Hz
BAND = 0.04  # of a frequency, over which densities are averaged
MAX_SHARE = 0.48  # of the messages' rate
EARLY_SHARE = 0.37  # of a step, that a message may come before the one it is matched with: no whole share of it


class Messages(NamedTuple):
    """One quantity at the stamps of its messages."""

    time: Array  # (N,) s
    values: Array  # (N,)


class CrossSpectra(NamedTuple):
    """Averaged cross-spectral densities of C quantities in J bands of W windows."""

    frequency: Array  # (J,) Hz
    counts: Array  # (J,) independent values of a window in each band
    densities: Complex  # (W, J, C, C), two-sided, of a window each
    late: tuple[Array, ...]  # of each quantity: stamps after those of the first, s
    rate: float  # of the messages, Hz

    @property
    def mean(self) -> Complex:
        """(J, C, C) of all windows."""
        return self.densities.mean(axis=0)

    def of(self, some: Sequence[int]) -> CrossSpectra:
        """Returns the spectra of some of the quantities."""
        densities = self.densities[:, :, some][:, :, :, some]
        return self._replace(densities=densities, late=tuple(self.late[row] for row in some))


def spectra(streams: Sequence[Messages], starts: Array) -> CrossSpectra:
    """Returns the spectra of ``streams`` in windows that begin at ``starts`` (W,) s, at the rate of the slowest one."""
    slowest = _even(min((stream.time for stream in streams), key=len))
    matched = [_matched(stream, slowest) for stream in streams]
    rate = (len(slowest) - 1) / np.diff(slowest).clip(max=1.0).sum()
    count = int(min(MAX_SHARE * rate, HIGHEST_FREQUENCY) * SPECTRUM_SECONDS)
    frequency = np.arange(1, count + 1) / SPECTRUM_SECONDS
    transforms = np.array(
        [[_transform(stream, start)[1 : count + 1] for stream in matched] for start in starts]
    )
    kept = frequency >= LOWEST_FREQUENCY
    frequency = frequency[kept]
    transforms = transforms[:, :, kept]
    begins = [0]
    while begins[-1] < len(frequency):
        width = max(1, round(BAND * frequency[begins[-1]] * SPECTRUM_SECONDS))
        begins.append(min(begins[-1] + width, len(frequency)))
    counts = np.diff(begins)
    products = np.einsum("wcf,wdf->wfcd", transforms, transforms.conj())
    densities = np.add.reduceat(products, begins[:-1], axis=1) / counts[:, None, None]
    middle = np.add.reduceat(frequency, begins[:-1]) / counts
    # windows overlap by half
    late = tuple(stream.time - matched[0].time for stream in matched)
    return CrossSpectra(middle, counts / 2, np.asarray(densities, complex), late, rate)


def _even(stamps: Array) -> Array:
    """The ``stamps`` (N,), or every second to fourth, if only so three steps of five are even; a fifth may be lost.

    Stamps may be rounded to 1 ms. A control cycle of 4 ms sends at 100 Hz after 8 and 12 ms in turn: what is at 2 Hz is
    seen at 48 Hz too, which no fold about half of 100 Hz explains. Every other message comes after 20 ms.
    """
    for stride in range(1, 5):
        fewer = stamps[::stride]
        steps = np.diff(fewer)
        if np.mean(np.abs(steps - np.median(steps)) < 5 * FINE_SECONDS) >= 3 / 5:
            return fewer
    return stamps


def _matched(stream: Messages, stamps: Array) -> Messages:
    """The messages of a stream about the ``stamps`` (N,) of a slower one, as early for each of them.

    Neither the nearest nor the next: of two streams that keep half a step apart these would be now one, now the other.
    """
    early = EARLY_SHARE * np.median(np.diff(stream.time))
    rows = np.searchsorted(stream.time, stamps - early).clip(max=len(stream.time) - 1)
    return Messages(stream.time[rows], stream.values[rows])


def _transform(stream: Messages, start: float) -> Complex:
    """Of a window from ``start`` on, s, without its trend, such that its square's mean is the density."""
    rows = slice(*np.searchsorted(stream.time, [start, start + SPECTRUM_SECONDS]))
    time = stream.time[rows] - start
    steps = np.gradient(time)
    # what is lost counts no more than what came
    steps = steps.clip(max=2.5 * np.median(steps))
    values = stream.values[rows]
    values = values - np.polyval(np.polyfit(time, values, 1), time)
    weights = (
        np.sqrt(8 / 3 / SPECTRUM_SECONDS) * np.sin(np.pi * time / SPECTRUM_SECONDS) ** 2 * steps
    )
    length = round(SPECTRUM_SECONDS / FINE_SECONDS)
    row, share = np.divmod(time / FINE_SECONDS, 1.0)
    whole = row.astype(int)
    fine = np.bincount(whole, weights * values * (1 - share), length)
    fine += np.bincount((whole + 1) % length, weights * values * share, length)
    return np.fft.rfft(fine)
