"""Resonance: the measured response of a body rate to its setpoint, and peaks of the rate that the motors share.

The response is T = S_rp / S_rr, of setpoint r and rate p, by Welch. Where the wind and not the pilot moves the vehicle,
the setpoint only answers the rate by the attitude's controller, r = −K p / s, and T would be −s / K however coherent
both are: such frequencies, where r + K p / s is less than half of r, are left out. With the controller C that the
parameters give, from the setpoint and back from the rate, L / (1 + L) = T C_back / C_forward is without its filters,
and so is the sensitivity 1 / (1 + L) = 1 − L / (1 + L).

Reference: J. S. Bendat and A. G. Piersol, Random Data, 4th ed., sec. 9.2: the error of T by its coherence.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.confidence import Interval, coverage_factor
from mavdem.dataset.intervals import intersection, split_at_gaps
from mavdem.dataset.segments import Segments, in_segments
from mavdem.dataset.signals import MIN_STREAM_RATE, Signals, rate_between_outages
from mavdem.dataset.time_series import TimeSeries
from mavdem.dem.engine.linalg import SMALLEST_POSITIVE
from mavdem.errors import NotLearnable
from mavdem.loops.controllers import Controller, controller_from_parameters
from mavdem.loops.margins import Complex, controller_response

WELCH_SECONDS = 2.0
FEWEST_WINDOWS = 10
"""Of the spectra, by Welch, half over each other: so the error of T where the coherence is a half is a fifth."""
MIN_COHERENCE = 0.5  # of the rate with its setpoint, or with the motors
# times the lowest frequency, up to which T is known without a gap between
LEAST_BAND = 2.0
STILL_RESPONSE = 2.0  # |T| at the lowest frequency, over which the setpoint does not move the rate
PROMINENT = 3.0
SIDES = 1.5
"""Times the straight line between the frequencies so many times lower and higher: a maximum sensitivity of up to 2.3
makes at most 2.5 of it, one of 4.9 makes 5 and more."""
# Hz: rate loops of multirotors cross over below, most at several Hz to half of it; motors and propellers turn above
MAX_LOOP_FREQUENCY = 40.0
USUAL_ANGLE_GAIN = 4.5
"""1/s, ArduCopter's default, where the log has none; PX4's is 6.5."""
LOWEST_RESPONSE = 1.0  # Hz, of T: below, the vehicle is moved to another place
SLOWEST_PEAK = 6.0  # Hz, of the rate's own spectrum: below, it is steered, also by sines, and moved by the wind
# of the highest frequency: above, interpolation between messages has lost a fifth of the power
HIGHEST_SHARE = 0.8


@dataclass(frozen=True)
class Resonance:
    """A peak of the rate of one axis."""

    axis: str
    peak: float
    """The largest |T|; or how many times a straight line under it, about the maximum sensitivity."""
    frequency: float
    """Hz, of the peak."""
    coherence: float
    """There, of the rate with its setpoint, or with the motors."""
    max_frequency: float
    """Hz up to which it was looked for."""
    ms_interval: Interval | None = None
    """The 90 % interval of the maximum sensitivity; None without setpoint."""
    rolls_off: bool = False
    """Whether the response was seen to fall below −3 dB."""


class Spectra(NamedTuple):
    """Of a driver r and what follows it, p, and perhaps more: summed over windows."""

    frequency: Array
    """(F,) Hz, from 0 to half of the rate of the slowest."""
    windows: int
    power: Complex
    """(k, k, F) of each pair r and p: r* p."""
    usual: Array
    """(F,) the median of |p|² over windows: that of a flight that is steered at times."""

    @property
    def driver(self) -> Array:
        """(F,) |r|²."""
        return np.maximum(self.power[0, 0].real, SMALLEST_POSITIVE)

    @property
    def response(self) -> Complex:
        """(F,) of p to r."""
        return self.power[0, 1] / self.driver

    @property
    def coherence(self) -> Array:
        """(F,) of r and p."""
        powers = self.driver * self.power[1, 1].real
        return abs(self.power[0, 1]) ** 2 / np.maximum(powers, SMALLEST_POSITIVE)


def controller_if_known(signals: Signals) -> Controller | None:
    """Returns the controller of the axis of ``signals``, of the demand itself; None where it is not known."""
    try:
        return controller_from_parameters(signals.telemetry.parameters, signals.axis, (1.0,))
    except NotLearnable:
        return None


def setpoint_resonance(signals: Signals, parts: Segments) -> Resonance | None:
    """Returns the largest response of the rate to its setpoint in ``parts`` of a flight.

    None where the messages are slower than ``MINIMUM_RATE``, or too little of the rate is by the setpoint.
    """
    if signals.rate_and_setpoint is None:
        return None
    rate, asked = signals.rate_and_setpoint
    cross = spectra((asked, rate), parts)
    if cross is None:
        return None
    hertz = np.maximum(cross.frequency, cross.frequency[1])
    response = cross.response
    gain = USUAL_ANGLE_GAIN
    without_filters = response
    controller = controller_if_known(signals)
    if controller is not None:
        gain = controller.angle_gain
        forward, back = controller_response(controller, hertz)
        without_filters = response * back / forward
    coherence = cross.coherence
    back_by_angle = gain / (2j * np.pi * hertz)
    own = abs(1 + back_by_angle * response) ** 2
    whole = cross.power[1, 1].real / cross.driver
    by_wind = whole - abs(response) ** 2
    own += abs(back_by_angle) ** 2 * by_wind
    coherent = (coherence >= MIN_COHERENCE) & (own >= 0.5)
    coherent &= (hertz >= LOWEST_RESPONSE) & (hertz <= HIGHEST_SHARE * hertz[-1])
    rows = np.flatnonzero(coherent)
    # the run of frequencies that reaches over most octaves
    ends = np.flatnonzero(np.diff(rows) > 1) + 1
    runs = filter(len, np.split(rows, ends))
    rows = max(runs, key=lambda run: hertz[run[-1]] / hertz[run[0]], default=rows)
    size = abs(response[rows])
    # A setpoint that does not move the rate, as of a heading that is held, gives far more than 1.
    if not len(rows) or hertz[rows[-1]] < LEAST_BAND * hertz[rows[0]] or size[0] > STILL_RESPONSE:
        return None
    at = rows[np.argmax(size)]
    seen = coherence[rows]
    error = np.sqrt((1 - seen) / (2 * seen * cross.windows))
    complementary = abs(without_filters[rows])
    sensitivity = abs(1 - without_filters[rows])
    half = coverage_factor() * error * complementary
    return Resonance(
        axis=signals.axis,
        peak=abs(response[at]),
        frequency=hertz[at],
        coherence=coherence[at],
        max_frequency=hertz[rows[-1]],
        ms_interval=((sensitivity - half).max(), (sensitivity + half).max()),
        rolls_off=complementary.max() > 2**-0.5 > complementary[-1],  # half of the power
    )


def spectral_resonance(signals: Signals, parts: Segments) -> Resonance | None:
    """Returns the peak of the rate's spectrum over a straight line, in ``parts`` of a flight, that the motors share.

    Wind, noise and the plant make a spectrum that is straight over the logarithm of the frequency; the loop multiplies
    it by its sensitivity. None where the messages are slow, or nothing is as much over the line as ``PROMINENT``.
    """
    attitude = signals.attitude
    drive = signals.model_inputs
    if attitude is None or drive is None:
        return None
    weights = drive.geometry.mixer_row(signals.axis)
    command = drive.outputs[:, 0] if weights is None else drive.outputs @ weights
    cross = spectra((TimeSeries(drive.time, drive.boot, command), attitude.rate_series), parts)
    if cross is None or not cross.usual.all():
        return None
    top = min(HIGHEST_SHARE * cross.frequency[-1], MAX_LOOP_FREQUENCY)
    inside = (cross.frequency >= SLOWEST_PEAK) & (cross.frequency <= top / SIDES)
    rows = np.flatnonzero(inside)
    if not len(rows):
        return None
    hertz = cross.frequency[rows]
    size = np.log(cross.usual) / 2
    beside = (np.interp(side, cross.frequency, size) for side in (hertz * SIDES, hertz / SIDES))
    over = np.exp(size[rows] - sum(beside) / 2)
    best = np.argmax(over)
    coherence = cross.coherence[rows[best]]
    if not (over[best] >= PROMINENT and coherence >= MIN_COHERENCE):
        return None
    return Resonance(
        axis=signals.axis,
        peak=over[best],
        frequency=hertz[best],
        coherence=coherence,
        max_frequency=top,
    )


def spectra(
    signals: Sequence[TimeSeries],
    parts: Segments,
    seconds: float = WELCH_SECONDS,
    least_rate: float = MIN_STREAM_RATE,
) -> Spectra | None:
    """Returns those of all windows of so many ``seconds`` without gaps in ``parts`` of a flight.

    None where a signal comes slower than ``least_rate``, Hz, or there are fewer than ``FEWEST_WINDOWS``.
    """
    sampled = evenly_sampled(signals, parts, seconds, least_rate)
    if sampled is None:
        return None
    return spectra_of_pieces(*sampled, seconds)


def spectra_of_pieces(
    sampled: float, pieces: Sequence[Array], seconds: float = WELCH_SECONDS
) -> Spectra | None:
    """Returns those of ``pieces`` (k, N) of series at so many Hz, as :func:`spectra` does."""
    size = round(seconds * sampled)
    windows = [spectra_of(piece, size) for piece in pieces if piece.shape[1] >= size]
    if sum(window.shape[1] for window in windows) < FEWEST_WINDOWS:
        return None
    transforms = np.concatenate(windows, axis=1)
    return Spectra(
        frequency=np.asarray(np.fft.rfftfreq(size, 1 / sampled), np.float64),
        windows=transforms.shape[1],
        power=np.einsum("iwf,jwf->ijf", transforms.conj(), transforms),
        usual=np.median(np.square(abs(transforms[1])), axis=0),
    )


def evenly_sampled(
    signals: Sequence[TimeSeries],
    parts: Segments,
    seconds: float,
    least_rate: float,
    most_rate: float = np.inf,
) -> tuple[float, list[Array]] | None:
    """Returns a rate, Hz, and the k ``signals`` at it, (k, N) for each stretch of so many ``seconds`` without gaps.

    That of the slowest, or ``most_rate``. None where one comes slower than ``least_rate``, Hz, or there is no stretch.
    """
    sampled = min(most_rate, *map(rate_between_outages, signals))
    if sampled < least_rate:
        return None
    pieces = []
    for part in parts:
        spans = [(part.start, part.end)]
        streams = []
        for signal in signals:
            rows = in_segments(signal, part)
            time = signal.time[rows]
            streams.append((time, signal.values[rows]))
            spans = intersection(spans, split_at_gaps(time, np.diff(time) > 4 / least_rate))
        for start, end in spans:
            grid = np.arange(start, end, 1 / sampled)
            if len(grid) > sampled * seconds:
                pieces.append(np.array([np.interp(grid, *stream) for stream in streams]))
    return (sampled, pieces) if pieces else None


def windows_of(values: Array, size: int) -> Array:
    """Returns the windows (…, W, size) of ``values`` (…, N), half over each other."""
    windows = np.lib.stride_tricks.sliding_window_view(values, size, axis=-1)
    return windows[..., :: size // 2, :]


def spectra_of(values: Array, size: int) -> Complex:
    """Returns the spectra (…, W, F) of those windows, about their means, through Hann's window."""
    windows = windows_of(values, size)
    centred = windows - windows.mean(axis=-1, keepdims=True)
    return np.fft.rfft(centred * np.hanning(size))
