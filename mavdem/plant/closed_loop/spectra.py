"""Cross-spectral densities of logged messages, each quantity at its own time stamps.

Windows of a few seconds are tapered and Fourier-transformed at the stamps of the messages themselves, without
interpolation. Content above half of the message rate folds (aliases) in these spectra; the model's densities are folded
in the same way. Source: D. R. Brillinger, Time Series: Data Analysis and Theory, secs. 4.3 and 5.6.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.arrays import Array, Flags

ComplexArray = NDArray[np.complex128]
"""Complex numbers of any shape."""

SPECTRUM_SECONDS = 8.0
"""Length of a window, s: its frequencies are multiples of 1/8 Hz."""

STAMP_RESOLUTION = 2.5e-4
"""Spacing of the fine time grid onto whose points each sample is split, s.

A tenth of a control cycle of 400 Hz: messages at 100 Hz lose 0.2 % of their power by it.
"""

LOWEST_FREQUENCY = 0.8
"""Lowest frequency of the spectra, Hz. Below it position control and drag matter, which one axis does not model."""

HIGHEST_FREQUENCY = 100.0
"""Highest frequency of the spectra, Hz: a choice, far above the crossover of any rate loop."""

RELATIVE_BANDWIDTH = 0.04
"""Width of the bands over which densities are averaged, relative to their frequency: a choice."""

MAX_RELATIVE_FREQUENCY = 0.48
"""Highest frequency of the spectra, relative to the message rate: just below half of it."""

MAX_EARLINESS = 0.37
"""How long before a message of the slowest stream the matched message of another may come, in its median steps.

The number is not a simple fraction, so that streams whose stamps keep a constant distance of a half or a third of a
step are always matched to the same side.
"""

MAX_COUNTED_GAP = 1.0
"""Longest time between two messages that counts in the message rate, s: a longer gap is a loss of the link."""

MAX_SAMPLE_WEIGHT = 2.5
"""Largest weight of one sample in a transform, in median steps, so that samples next to a gap do not replace it."""

MAX_STRIDE = 4
"""Largest stride with which messages are thinned in the search for even steps: every fourth message."""

MIN_EVEN_STEPS = 3 / 5
"""Share of equal steps from which on a stream counts as evenly sampled: up to a fifth of the messages may be lost."""

STAMP_ROUNDING = 1e-3
"""Resolution of the stamps of MAVLink's messages, s: ``time_boot_ms`` counts milliseconds."""

MAX_MILLISECOND_FRACTION = 0.01
"""Largest distance of a stamp from a whole millisecond by the rounding of numbers, in milliseconds."""

MAX_ROUNDING_ERROR = 0.7 * STAMP_ROUNDING
"""Largest distance of a rounded stamp from its even time, s: half of the resolution, and a fifth for the error of the
even time."""

MIN_EXPLAINED_SHARE = 0.9
"""Share of a stamp's neighbours whose distance from even times rounding explains, for it to be restored: a choice.

A few messages may be late. More distances that are larger show that the messages themselves are uneven. Likewise it is
the share of all stamps that have a cycle of the controller in their millisecond, for them to be restored by cycles.
"""

AVERAGED_STAMPS = 41
"""Number of neighbouring stamps whose deviation from even times is averaged: a choice."""

EVEN_STEP_TOLERANCE = 5 * STAMP_RESOLUTION
"""Difference from the median step up to which a step counts as equal, s: stamps may be rounded to 1 ms."""


class Messages(NamedTuple):
    """One logged quantity at the time stamps of its messages."""

    time: Array
    """Stamps (N,), s, ascending."""

    values: Array
    """The quantity at each stamp (N,)."""


class CrossSpectra(NamedTuple):
    """Band-averaged cross-spectral densities of C quantities, in J bands and W windows."""

    frequency: Array
    """Mean frequency of each band (J,), Hz."""

    effective_samples: Array
    """Number of independent values that a window adds to each band (J,)."""

    densities: ComplexArray
    """Two-sided cross-spectral densities of each window (W, J, C, C), in unit² per Hz."""

    stamp_offsets: tuple[Array, ...]
    """For each quantity, the stamps (N,) of its matched messages minus the stamps of the first quantity, s."""

    message_rate: float
    """Rate of the slowest stream, Hz: half of it is the frequency about which the spectra fold."""

    @property
    def mean_density(self) -> ComplexArray:
        """Cross-spectral densities averaged over all windows (J, C, C)."""
        return self.densities.mean(axis=0)

    def other_cycle_share(self, first: int, second: int, cycle_time: float) -> float:
        """Returns the share of messages of two quantities that are not of the same cycle of the controller, 0 to 1.

        Args:
            first: index of one quantity.
            second: index of the other one.
            cycle_time: time between two runs of the controller, s.
        """
        distance = np.abs(self.stamp_offsets[first] - self.stamp_offsets[second])
        return float(np.mean(distance > cycle_time / 2))

    def select(self, quantities: Sequence[int]) -> CrossSpectra:
        """Returns the spectra of only the quantities with these indices, in their order."""
        densities = self.densities[:, :, quantities][:, :, :, quantities]
        offsets = tuple(self.stamp_offsets[index] for index in quantities)
        return self._replace(densities=densities, stamp_offsets=offsets)


def cross_spectra(streams: Sequence[Messages], window_starts: Array) -> CrossSpectra:
    """Estimates the cross-spectral densities of several logged quantities, such as a body rate and its setpoint.

    The steps:

    1. Stamps that were rounded to milliseconds are restored.
    2. Every stream is reduced to one message for each message of the slowest stream. Then all streams have the same
       rate, and content above half of it folds (aliases) in the same way in all of them.
    3. Each window of ``SPECTRUM_SECONDS`` of each stream is Fourier-transformed with a Hann taper.
    4. The products x yᴴ of the transforms of each pair of quantities are averaged over bands of neighbouring
       frequencies, which reduces their variance.

    Windows overlap by half, so neighbouring windows share half of their samples. The number of independent values of a
    window in a band is therefore assumed to be half of the number of frequencies in the band.

    Args:
        streams: C quantities, each with the stamps of its own messages.
        window_starts: times (W,) at which windows of ``SPECTRUM_SECONDS`` begin, s.

    Returns:
        Densities of each window in bands, with the message rate; frequencies above half of it are folded.
    """
    streams = [with_unrounded_stamps(stream) for stream in streams]
    # All streams are reduced to the same number of messages, about evenly spaced. For the message rate, a gap counts as
    # at most MAX_COUNTED_GAP.
    slowest = min((stream.time for stream in streams), key=len)
    stamps = _evenly_spaced_stamps(slowest)
    matched_streams = [_matched_messages(stream, stamps) for stream in streams]
    rate = (len(stamps) - 1) / np.diff(stamps).clip(max=MAX_COUNTED_GAP).sum()

    # Frequencies are multiples of 1 / SPECTRUM_SECONDS. The first, 0, is left out, since the trend has been removed.
    count = int(min(MAX_RELATIVE_FREQUENCY * rate, HIGHEST_FREQUENCY) * SPECTRUM_SECONDS)
    frequency = np.arange(1, count + 1) / SPECTRUM_SECONDS
    is_in_range = frequency >= LOWEST_FREQUENCY
    frequency = frequency[is_in_range]

    # The products x y* of each pair of quantities, averaged over the frequencies of each band. ``reduceat`` sums from
    # each edge to the next; the last edge only marks the end. Windows are processed one by one, since the transforms of
    # an hour of flight at all frequencies would need hundreds of megabytes.
    edges = _band_edges(frequency)
    counts = np.diff(edges)
    densities = []
    for start in window_starts:
        transforms = np.array(
            [
                _windowed_transform(stream, start)[1 : count + 1][is_in_range]
                for stream in matched_streams
            ]
        )
        # Letters of einsum: quantities c and d, frequency f.
        products = np.einsum("cf,df->fcd", transforms, transforms.conj())
        densities.append(np.add.reduceat(products, edges[:-1], axis=0) / counts[:, None, None])
    return CrossSpectra(
        frequency=np.add.reduceat(frequency, edges[:-1]) / counts,
        effective_samples=counts / 2,
        densities=np.asarray(densities, complex),
        stamp_offsets=tuple(stream.time - matched_streams[0].time for stream in matched_streams),
        message_rate=rate,
    )


def with_unrounded_stamps(stream: Messages) -> Messages:
    """Restores the even times of messages whose stamps were rounded to milliseconds.

    For example, messages at 80 Hz come every 12.5 ms, and the steps of their stamps are 12 and 13 ms in turn. At such
    stamps the rate has an error at high frequencies to which the controller did not react, which biases the
    identification: a gain margin of 4.5 dB was estimated as 9.8 dB.

    The deviation of the stamps from even times is averaged over neighbours, which follows the drift of a clock. A stamp
    is kept if it is further from its even time than rounding explains, since the message was early or late. Where many
    stamps are like that, all are kept: a sender with a cycle of 4 ms really sends after 12, 12 and 16 ms.

    ``tests/plant/test_closed_loop.py`` has rounded, exact and late stamps.

    Args:
        stream: messages, some of which may be lost.

    Returns:
        The messages at even times; with unchanged stamps if these are not rounded to milliseconds, or not even.
    """
    steps = np.diff(stream.time)
    is_even = np.abs(steps - np.median(steps)) < EVEN_STEP_TOLERANCE
    if not _is_in_milliseconds(stream.time) or is_even.mean() < MIN_EVEN_STEPS:
        return stream
    interval = steps[is_even].mean()
    # The number of each message, lost ones included.
    number = np.append(0.0, np.cumsum(np.round(steps / interval)))
    deviation = stream.time - interval * number
    even_time = interval * number + _mean_over_neighbours(deviation)
    is_explained_by_rounding = np.abs(even_time - stream.time) < MAX_ROUNDING_ERROR
    explained_fraction = _mean_over_neighbours(is_explained_by_rounding)
    is_restored = is_explained_by_rounding & (explained_fraction >= MIN_EXPLAINED_SHARE)
    return Messages(np.where(is_restored, even_time, stream.time), stream.values)


def with_stamps_of_cycles(stream: Messages, exact_stamps: Array, cycle_time: float) -> Messages:
    """Restores the times of the controller's cycles in which messages were sent whose stamps are cut to milliseconds.

    A message that is sent at 7.5 ms is stamped 7 ms: it is of the first cycle from its stamp on. The cycles are known
    from a stream with exact stamps, as the outputs of motors have them. 0.5 ms are 1.4° of phase at 8 Hz.

    Args:
        stream: messages, whose stamps may be cut to milliseconds.
        exact_stamps: stamps (M,) of other messages of the same controller, s, ascending.
        cycle_time: time between two cycles of the controller, s.

    Returns:
        The messages at the times of their cycles. Their stamps are unchanged if they are not cut to milliseconds, or if
        there is no cycle, or more than one, in the millisecond after most of them.
    """
    if not len(stream.time) or not len(exact_stamps):
        return stream
    if cycle_time < STAMP_ROUNDING or not _is_in_milliseconds(stream.time):
        return stream
    # Cycles are counted from the last exact stamp, since those of a real controller drift against its clock.
    rows = np.searchsorted(exact_stamps, stream.time, side="right") - 1
    known_cycles = exact_stamps[rows.clip(min=0)]
    tolerance = MAX_MILLISECOND_FRACTION * STAMP_ROUNDING
    cycle_number = np.ceil((stream.time - known_cycles - tolerance) / cycle_time)
    cycle_stamps = known_cycles + cycle_time * cycle_number
    is_cut = cycle_stamps - stream.time < STAMP_ROUNDING
    if is_cut.mean() < MIN_EXPLAINED_SHARE:
        return stream
    return Messages(np.where(is_cut, cycle_stamps, stream.time), stream.values)


def _is_in_milliseconds(stamps: Array) -> bool:
    """Returns whether stamps (N,), s, differ by whole milliseconds, as they do if they are rounded or cut to them."""
    milliseconds = (stamps - stamps[0]) / STAMP_ROUNDING
    return bool(np.abs(milliseconds - np.round(milliseconds)).max() < MAX_MILLISECOND_FRACTION)


def _mean_over_neighbours(values: Array | Flags) -> Array:
    """Returns the mean of each value and its neighbours, ``AVERAGED_STAMPS`` in all, which are fewer at the ends.

    Args:
        values: (N,) values or flags of successive messages.

    Returns:
        The means (N,); of flags these are the fractions of true ones.
    """
    count = len(values)
    window = np.ones(AVERAGED_STAMPS)
    # A convolution is longer than the values if these are fewer than the window.
    neighbour_counts = np.convolve(np.ones(count), window, "same")[:count]
    return np.convolve(values, window, "same")[:count] / neighbour_counts


def _band_edges(frequency: Array) -> list[int]:
    """Divides frequencies into bands of about constant relative width, in which densities are averaged.

    Bands widen with frequency (``RELATIVE_BANDWIDTH``), as resonances do: averages over wider bands scatter less.

    Args:
        frequency: (F,), Hz, in steps of 1 / ``SPECTRUM_SECONDS``.

    Returns:
        Index of the first frequency of each band, and F at the end.
    """
    edges = [0]
    while edges[-1] < len(frequency):
        first_index = edges[-1]
        bandwidth = RELATIVE_BANDWIDTH * frequency[first_index]
        # There are ``SPECTRUM_SECONDS`` frequencies per hertz.
        frequencies_in_band = max(1, round(bandwidth * SPECTRUM_SECONDS))
        edges.append(min(first_index + frequencies_in_band, len(frequency)))
    return edges


def _evenly_spaced_stamps(stamps: Array) -> Array:
    """Thins the stamps of a stream until they are evenly spaced, as the model of aliasing assumes.

    For example, a controller with a cycle of 4 ms sends messages at 100 Hz after 8 and 12 ms in turn. A signal at 2 Hz
    then also appears at 48 Hz, which aliasing at 100 Hz does not explain. Every second message is evenly spaced, by
    20 ms.

    Args:
        stamps: time stamps (N,), s, ascending.

    Returns:
        Stamps (N / n,), s: every n-th one. n is the smallest number, up to ``MAX_STRIDE``, with which they are evenly
        spaced except for lost messages; 1 if there is no such number.
    """
    for stride in range(1, MAX_STRIDE + 1):
        candidates = stamps[::stride]
        steps = np.diff(candidates)
        is_even = np.abs(steps - np.median(steps)) < EVEN_STEP_TOLERANCE
        if np.mean(is_even) >= MIN_EVEN_STEPS:
            return candidates
    return stamps


def _matched_messages(stream: Messages, stamps: Array) -> Messages:
    """Returns, for each stamp (N,) of a slower stream, the first message that is not too early for it.

    A message may be earlier than the stamp by up to ``MAX_EARLINESS`` of the stream's median step. Taking the nearest
    message would fail where the stamps of two streams differ by about half a step: small jitter would decide whether
    the message before or after the stamp is taken, and the delay between the streams would jump by a whole step.

    Args:
        stream: times and values of the messages of one quantity, such as the body rate.
        stamps: stamps to match (N,), s, ascending.

    Returns:
        N messages with their own stamps. At the end of the stream the last message is repeated.
    """
    tolerance = MAX_EARLINESS * np.median(np.diff(stream.time))
    rows = np.searchsorted(stream.time, stamps - tolerance).clip(max=len(stream.time) - 1)
    return Messages(stream.time[rows], stream.values[rows])


def _windowed_transform(stream: Messages, start: float) -> ComplexArray:
    """Returns the Fourier transform of one window of a stream, at the stamps of its messages.

    The linear trend is removed, and a Hann taper applied. As a discrete Fourier transform at uneven stamps would be
    slow, each sample is split between the two nearest points of a fine even grid, in steps of ``STAMP_RESOLUTION``, of
    which the fast Fourier transform is computed.

    Args:
        stream: stamps and values of the messages.
        start: time at which the window begins, s.

    Returns:
        (F,) transform at the frequencies from 0 in steps of 1 / ``SPECTRUM_SECONDS``, scaled so that the mean of its
        squared magnitude is the two-sided density.
    """
    first_sample, end_sample = np.searchsorted(stream.time, [start, start + SPECTRUM_SECONDS])
    time = stream.time[first_sample:end_sample] - start
    values = stream.values[first_sample:end_sample]
    trend = np.polyval(np.polyfit(time, values, 1), time)
    deviations = values - trend

    # Each sample is weighted by the time around it, as in an integral, but not by a gap next to it.
    sample_durations = np.gradient(time)
    sample_durations = sample_durations.clip(max=MAX_SAMPLE_WEIGHT * np.median(sample_durations))
    # The mean square of the taper sin² is 3/8.
    taper = np.sqrt(8 / 3 / SPECTRUM_SECONDS) * np.sin(np.pi * time / SPECTRUM_SECONDS) ** 2
    weights = taper * sample_durations

    grid_length = round(SPECTRUM_SECONDS / STAMP_RESOLUTION)
    # The position of a sample on the grid: the number of the point before it, and the fraction of the way to the next.
    whole_steps, fraction = np.divmod(time / STAMP_RESOLUTION, 1.0)
    point_before = whole_steps.astype(int)
    # The point after the last one of the grid is the first: the transform is periodic.
    point_after = (point_before + 1) % grid_length
    grid = np.bincount(point_before, weights * deviations * (1 - fraction), grid_length)
    grid += np.bincount(point_after, weights * deviations * fraction, grid_length)
    return np.fft.rfft(grid)
