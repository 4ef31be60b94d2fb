"""The frequency of an oscillation that messages are too slow to show, found among its aliases.

Messages at f_s Hz show an oscillation of f Hz at |f - n f_s|, folded below f_s / 2. Messages at another rate fold it to
another place, so that few frequencies agree with all of them. Among these the angle decides: in an oscillation of f Hz
the amplitude of the body rate is 2 pi f times the amplitude of the angle, whatever the rate of the messages.
"""

from collections.abc import Sequence

import numpy as np

from mavdem.arrays import Array, Flags
from mavdem.dataset.attitude import Attitude
from mavdem.dataset.segments import Segment, in_segments
from mavdem.dataset.time_series import TimeSeries
from mavdem.loops.limit_cycles import Oscillation
from mavdem.loops.welch import windowed_transforms

WINDOW_SECONDS = 4.0
"""Length of the windows of the spectra, s: lines are 0.5 Hz wide on each side."""
LINE_HALF_WIDTH = 0.5
"""Half width of a line, Hz: Hann's window blurs it over two bins of 0.25 Hz."""
MIN_LINE_SHARE = 0.5
"""Least share of the variance of each signal in the line: more than in all of the rest together."""
CANDIDATE_FREQUENCIES = np.arange(2.0, 50.0, 0.05)
"""Frequencies that are tried, Hz: rate loops of multirotors oscillate at a few to some tens of Hz."""
MAX_RATIO_ERROR = 1.5
"""Largest factor between the frequency and the one that rate and angle give: a gyro filter attenuates the rate by less
than 3 dB below its corner frequency, and the rest is noise of the angle."""


def with_unaliased_frequency(
    cycle: Oscillation, attitude: Attitude, gyro: TimeSeries | None
) -> Oscillation:
    """Returns a limit cycle, an oscillation of one axis, with the frequency that its slow attitude messages hide.

    Args:
        cycle: the limit cycle of one axis; one whose frequency is known is returned as it is.
        attitude: attitude of the axis.
        gyro: body rate of the axis by the gyro, rad/s; None if it was not logged.

    Returns:
        The limit cycle with its frequency, if only one agrees with all signals, and with the body rate of the signal
        that has the most samples.
    """
    if cycle.frequency is not None:
        return cycle
    body_rates = [attitude.rate_series]
    if gyro is not None:
        body_rates.append(gyro)
    frequency = unaliased_frequency(body_rates, attitude.angle_series, cycle.span)
    # Each with its samples in the segment, rad/s. More of them show the amplitude better.
    samples_of_rates = [_values_and_sampling_rate(rate, cycle.span)[0] for rate in body_rates]
    most_samples = max(samples_of_rates, key=len)
    return cycle._replace(frequency=frequency, rate=float(np.degrees(most_samples.std())))


def unaliased_frequency(
    body_rates: Sequence[TimeSeries], angle: TimeSeries, span: Segment
) -> float | None:
    """Returns the frequency of an oscillation of one axis from messages that may come more slowly than it oscillates.

    In slow samples an oscillation shows at a lower frequency, its alias. Candidate frequencies are excluded whose
    aliases do not show in each signal, and those that do not fit the ratio of body rate and angle.

    Args:
        body_rates: the body rate of the axis, rad/s, in messages of one or several rates. The first has the stamps of
            the angle.
        angle: Euler angle of the axis, rad.
        span: segment of the flight in which the axis oscillates.

    Returns:
        The one frequency, Hz, that agrees with all signals; None if none does, or if several do.
    """
    agrees = np.full(len(CANDIDATE_FREQUENCIES), True)
    for body_rate in body_rates:
        agrees &= _share_at_aliases(body_rate, span) >= MIN_LINE_SHARE
    frequency_by_angle = _frequency_by_angle(body_rates[0], angle, span)
    ratio = CANDIDATE_FREQUENCIES / frequency_by_angle
    agrees &= (ratio > 1 / MAX_RATIO_ERROR) & (ratio < MAX_RATIO_ERROR)
    return _middle_of_only_group(agrees)


def _share_at_aliases(signal: TimeSeries, span: Segment) -> Array:
    """Returns for each of the ``CANDIDATE_FREQUENCIES`` how much of a signal's variance is at its alias.

    Args:
        signal: samples at about even times.
        span: segment of the flight to use.

    Returns:
        (F,) fractions of the variance; all are 0 if the segment is shorter than a window of the spectrum.
    """
    values, sampling_rate = _values_and_sampling_rate(signal, span)
    size = round(WINDOW_SECONDS * sampling_rate)
    if len(values) < max(size, 2):
        return np.zeros(len(CANDIDATE_FREQUENCIES))
    power = np.square(abs(windowed_transforms(values[None, :], size)[0])).sum(axis=0)
    frequency = np.fft.rfftfreq(size, 1 / sampling_rate)
    # A frequency f sampled at the rate r shows at its distance from the nearest multiple of r.
    cycles_per_sample = CANDIDATE_FREQUENCIES / sampling_rate
    alias = abs(cycles_per_sample - np.round(cycles_per_sample)) * sampling_rate
    is_in_line = abs(frequency - alias[:, None]) <= LINE_HALF_WIDTH
    return (power * is_in_line).sum(axis=1) / power.sum()


def _frequency_by_angle(body_rate: TimeSeries, angle: TimeSeries, span: Segment) -> float:
    """Returns the frequency of an oscillation by the ratio of the amplitudes of its body rate and its angle.

    The rate is the derivative of the angle, so that its amplitude is 2 π f times that of the angle. Sampling does not
    change amplitudes, so that this holds also for the aliases, of which the strongest line of the rate is used.

    Args:
        body_rate: body rate of the axis, rad/s.
        angle: angle of the axis, rad, at the same times.
        span: segment of the flight to use.

    Returns:
        The frequency, Hz; NaN if the segment is shorter than a window of the spectrum.
    """
    rates, sampling_rate = _values_and_sampling_rate(body_rate, span)
    angles, _ = _values_and_sampling_rate(angle, span)
    size = round(WINDOW_SECONDS * sampling_rate)
    if len(rates) < max(size, 2):
        return np.nan
    transforms = windowed_transforms(np.array([rates, angles]), size)
    rate_power, angle_power = np.square(abs(transforms)).sum(axis=1)
    frequency = np.fft.rfftfreq(size, 1 / sampling_rate)
    line_frequency = frequency[np.argmax(rate_power)]
    is_in_line = abs(frequency - line_frequency) <= LINE_HALF_WIDTH
    power_ratio = rate_power[is_in_line].sum() / angle_power[is_in_line].sum()
    return float(np.sqrt(power_ratio) / (2 * np.pi))


def _values_and_sampling_rate(signal: TimeSeries, span: Segment) -> tuple[Array, float]:
    """Returns the N samples of a signal in a segment of the flight, (N,), and how many come in a second, Hz.

    The sampling rate follows from the median interval; it is 0 with fewer than two samples.
    """
    is_in_span = in_segments(signal, span)
    time = signal.time[is_in_span]
    sampling_rate = 1 / float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    return signal.values[is_in_span], sampling_rate


def _middle_of_only_group(agrees: Flags) -> float | None:
    """Returns the middle of the candidate frequencies that agree, if they are of one line.

    Args:
        agrees: whether each of the ``CANDIDATE_FREQUENCIES`` agrees (F,).

    Returns:
        The middle, Hz; None if none agrees, or if they are wider apart than one line.
    """
    frequencies = CANDIDATE_FREQUENCIES[agrees]
    if not len(frequencies) or frequencies[-1] - frequencies[0] > 2 * LINE_HALF_WIDTH:
        return None
    return float((frequencies[0] + frequencies[-1]) / 2)
