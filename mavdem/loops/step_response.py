"""Step responses of the closed rate and attitude loop as a flight shows them, at any rate of its messages.

The impulse response is estimated as in ``impulse_response``; steps, frequency responses and their figures follow from
it, with 90 % intervals from draws of its weights.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.confidence import INTERVAL_QUANTILES, Interval, coverage_factor
from mavdem.dataset.segments import Segments
from mavdem.dataset.signals import (
    MIN_SLOW_MOTION_RATE,
    MIN_STREAM_RATE,
    Signals,
    rate_between_outages,
)
from mavdem.dataset.time_series import TimeSeries
from mavdem.dem.engine.linalg import normal_draws
from mavdem.facts import Fact
from mavdem.facts.loops import StepResponses
from mavdem.immutable import ImmutableResult
from mavdem.loops.impulse_response import (
    STEADY_STATE_ERROR,
    ImpulseResponse,
    estimate_impulse_response,
)
from mavdem.loops.margins import Complex
from mavdem.loops.resonance import DEFAULT_ANGLE_GAIN, MAX_FREQUENCY_RATIO, controller_if_known
from mavdem.loops.welch import (
    MIN_COHERENCE,
    MIN_WINDOWS,
    WelchSpectra,
    resampled_signals,
    welch_spectra_of_pieces,
)

RESPONSE_SECONDS = {"rate": 0.5, "attitude": 2.0}
"""Duration of a step response until it has settled, s, by loop."""
MAX_TAPS = 100
"""Weights of an impulse response at most: of rates up to 200 Hz, for resonances of up to half of that."""
MIN_CORRECTION = 0.5
"""Fraction of the attitude controller's correction in a rate setpoint, from which on it is taken to be in it."""
RESPONSE_DRAWS = 300
"""Draws of the weights that intervals are made of."""

MIN_FREQUENCY = 0.5
"""Lowest frequency of a response, Hz."""
MIN_DRIVER_POWER_RATIO = 1e-4
"""Least power of the setpoint at a frequency, by its largest: interpolation between samples leaves as much."""
MAX_GAIN_DEVIATION = 0.25
"""Standard deviation of |T| beyond which it is not known."""
MAX_STEP_HALF_WIDTH = 1.0
"""Half width of the band of a step from which on nothing is known: it holds no response, and twice the step."""
SETTLING_BAND = 0.05
"""Distance from 1 within which a step has settled."""
FREQUENCY_STEP = 0.05
"""Step of the integral over a predicted frequency response, Hz."""
MAX_DISAGREEING_SHARE = 0.3
"""Fraction of the frequencies at which prediction and band may lie apart; a tenth does by chance alone."""

FIGURES = ("overshoot", "rise_time", "settling", "delay", "peak", "peak_frequency")
"""Figures of a :class:`StepResponse`, by the names of its attributes."""


class IntervalEstimate(NamedTuple):
    """A figure with its 90 % interval."""

    value: float
    """The estimate."""
    low: float
    """Lower end of the interval."""
    high: float
    """Upper end of the interval."""

    @property
    def interval(self) -> Interval:
        """The ends of the interval."""
        return self.low, self.high


@dataclass(frozen=True, eq=False)
class StepResponse(ImmutableResult):
    """The closed loop of one axis as measured: after a step of 1 of its setpoint, and by frequency."""

    axis: str
    """"roll", "pitch" or "yaw"."""
    loop: str
    """"rate" or "attitude"."""
    time: Array
    """(K,) s after the step."""
    step: Array
    """(K,) response to the step."""
    step_half: Array
    """(K,) half widths of its 90 % band."""
    frequency: Array
    """(F,) Hz up to ``max_frequency``."""
    response: Complex
    """(F,) T, the frequency response."""
    gain_half: Array
    """(F,) half widths of the 90 % band of |T|."""
    max_frequency: float
    """Hz up to which the flight shows the response."""
    windows: int
    """How many windows of flight it was estimated from."""
    overshoot: IntervalEstimate
    """The largest value of the step less 1, and less what noise adds to it."""
    rise_time: IntervalEstimate
    """Time from 10 to 90 % of the step, s."""
    settling: IntervalEstimate
    """Time until the step stays within ``SETTLING_BAND``, s."""
    delay: IntervalEstimate
    """Time until the step is at one half, s."""
    peak: IntervalEstimate
    """The largest |T|."""
    peak_frequency: IntervalEstimate
    """Frequency of the largest |T|, Hz."""
    coherence: float
    """Coherence of setpoint and response at that frequency."""

    @property
    def gain(self) -> Array:
        """(F,) |T|."""
        return np.abs(self.response)

    @property
    def fact(self) -> Fact:
        """The fact with the figures of the response, and the intervals of overshoot and peak."""
        figures = {name: getattr(self, name).value for name in FIGURES}
        return Fact(
            StepResponses.STEP_MEASURED,
            subject=f"{self.axis} {self.loop}",
            overshoot_interval=self.overshoot.interval,
            peak_interval=self.peak.interval,
            coherence=self.coherence,
            highest=self.max_frequency,
            **figures,
        )

    def comparison(self, frequency: Array, closed: Complex) -> Fact:
        """Returns whether a predicted closed loop agrees with the measured one, by gain.

        The two disagree at a frequency if the predicted |T| is outside the band of the measured one. Where that is so
        at more than ``MAX_DISAGREEING_SHARE`` of the frequencies, one of them is wrong. It is the prediction, unless it
        peaks beyond the frequencies that the flight shows: then the measurement may have missed the peak.

        Args:
            frequency: (F′,) of the prediction, Hz.
            closed: (F′,) predicted response.
        """
        subject = f"{self.axis} {self.loop}"
        predicted_gain = abs(closed)
        predicted_here = np.interp(self.frequency, frequency, predicted_gain)
        # The estimate assumes |T| ≈ 1 at 0 Hz to this error, so no band is narrower.
        half_width = np.maximum(self.gain_half, STEADY_STATE_ERROR)
        disagrees = abs(predicted_here - self.gain) > half_width
        share = disagrees.mean()
        if share <= MAX_DISAGREEING_SHARE:
            return Fact(
                StepResponses.PREDICTION_AGREES, subject=subject, highest=self.max_frequency
            )
        is_shown = frequency <= self.max_frequency
        code = StepResponses.PREDICTION_DOUBTED
        if predicted_gain.max() > predicted_gain[is_shown].max(initial=0.0):
            code = StepResponses.MEASUREMENT_DOUBTED
        return Fact(
            code,
            subject=subject,
            share=share,
            frequency=frequency[np.argmax(predicted_gain)],
            highest=self.max_frequency,
        )


def rate_step_response(signals: Signals, segments: Segments) -> StepResponse | Fact:
    """Returns the response of the body rate to its setpoint in ``segments`` of a flight, or why it is not known.

    ArduPilot's ATTITUDE_TARGET lacks the attitude controller's correction of the rate. It is added where it is missing,
    for which the angle and its setpoint are needed.

    Args:
        signals: of the vehicle and the axis.
        segments: of the flight.

    Returns:
        The step response, or a fact with the reason.
    """
    if signals.rate_and_setpoint is None:
        return Fact(StepResponses.NO_SETPOINT, subject=f"{signals.axis} rate")
    rate, setpoint = signals.rate_and_setpoint
    series = [setpoint, rate]
    attitude = signals.attitude
    # Angles help only if they come with the rates, at the same times.
    if attitude is not None and rate.time is attitude.time:
        for angle_series in (attitude.angle_series, signals.angle_setpoint):
            if angle_series is not None:
                series.append(angle_series)
    return _measured(signals, "rate", series, segments, MIN_STREAM_RATE)


def attitude_step_response(signals: Signals, segments: Segments) -> StepResponse | Fact:
    """Returns the response of the angle to its setpoint in ``segments`` of a flight, or why it is not known.

    Angles move more slowly than rates, so slower messages are enough.

    Args:
        signals: of the vehicle and the axis.
        segments: of the flight.

    Returns:
        The step response, or a fact with the reason.
    """
    if signals.angle_setpoint is None or signals.attitude is None:
        return Fact(StepResponses.NO_SETPOINT, subject=f"{signals.axis} attitude")
    series = [signals.angle_setpoint, signals.attitude.angle_series]
    return _measured(signals, "attitude", series, segments, MIN_SLOW_MOTION_RATE)


def _measured(
    signals: Signals,
    loop: str,
    series: Sequence[TimeSeries],
    segments: Segments,
    min_rate: float,
) -> StepResponse | Fact:
    """Returns a step response; or the fact that messages are too slow or too few, or that the setpoint hardly moves.

    Messages are resampled to one even rate in pieces without gaps, the impulse response is estimated from these, and
    step and frequency response follow from it. The checks before it save the estimate where nothing can come of it.

    Args:
        signals: of the axis.
        loop: "rate" or "attitude".
        series: setpoint, response and, of the rate, perhaps the angle and its setpoint.
        segments: of the flight.
        min_rate: slowest rate of messages, Hz.
    """
    subject = f"{signals.axis} {loop}"
    seconds = RESPONSE_SECONDS[loop]
    min_duration = 4 * seconds
    if min(map(rate_between_outages, series)) < min_rate:
        return Fact(StepResponses.TOO_SLOW, subject=subject, least_rate=min_rate)
    resampled = resampled_signals(series, segments, min_duration, min_rate, MAX_TAPS / seconds)
    if resampled is None:
        return Fact(StepResponses.TOO_LITTLE_FLIGHT, subject=subject, least_duration=min_duration)
    sampling_rate = resampled.rate
    # Pieces whose setpoint, the first row, never moves show no response to it.
    pieces = [piece for piece in resampled.pieces if np.ptp(piece[0])]
    samples = sum(piece.shape[1] for piece in pieces)
    if samples < 2 * MIN_WINDOWS * seconds * sampling_rate:
        return Fact(StepResponses.TOO_LITTLE_ASKED, subject=subject)
    angle_gain = 0.0
    if loop == "rate":
        controller = controller_if_known(signals)
        angle_gain = DEFAULT_ANGLE_GAIN if controller is None else controller.angle_gain
        pieces = _with_angle_and_correction(sampling_rate, pieces, angle_gain)
    impulse_response = estimate_impulse_response(sampling_rate, pieces, angle_gain, seconds)
    spectra = welch_spectra_of_pieces(sampling_rate, pieces)
    if spectra is None:
        return Fact(StepResponses.TOO_LITTLE_ASKED, subject=subject)
    return _described(signals.axis, loop, sampling_rate, impulse_response, spectra)


def _with_angle_and_correction(
    sampling_rate: float, pieces: Sequence[Array], angle_gain: float
) -> list[Array]:
    """Returns pieces of a rate's setpoint, with the attitude controller's correction in it, the rate and the angle.

    The correction is angle gain × error of the angle. Some messages have it in the setpoint, others leave it out; the
    controller follows the setpoint with it. An angle that was not recorded is the integral of the rate. Without a
    setpoint of the angle, the rate's is taken to have the correction.

    Args:
        sampling_rate: Hz.
        pieces: (2 to 4, N) setpoint of the rate, rate and, as far as recorded, angle and setpoint of the angle. The
            correction is added in place.
        angle_gain: of the attitude controller, 1/s.

    Returns:
        (3 or 4, N) each: setpoint of the rate, rad/s, rate, angle, rad, and its setpoint if it was recorded.
    """
    rows = len(pieces[0])
    has_angle = rows >= 3
    has_angle_setpoint = rows > 3
    if not has_angle:
        return [np.vstack([piece, np.cumsum(piece[1]) / sampling_rate]) for piece in pieces]
    if has_angle_setpoint and not _is_corrected(sampling_rate, pieces, angle_gain):
        for piece in pieces:
            angle, angle_setpoint = piece[2], piece[3]
            piece[0] += angle_gain * (angle_setpoint - angle)
    return list(pieces)


def _is_corrected(sampling_rate: float, pieces: Sequence[Array], angle_gain: float) -> bool:
    """Returns whether a rate's setpoint has the attitude controller's correction in it, by a regression on both terms.

    Setpoint = a · slope of the angle's setpoint + b · angle gain · error of the angle: it is in it where b is near 1.

    Args:
        sampling_rate: Hz.
        pieces: (4, N) each: setpoint of the rate, rate, angle and setpoint of the angle.
        angle_gain: 1/s.
    """
    rate_setpoint, _, angle, angle_setpoint = np.concatenate(pieces, axis=1)
    slope = sampling_rate * np.gradient(angle_setpoint)
    correction = angle_gain * (angle_setpoint - angle)
    _, correction_factor = np.linalg.lstsq(np.column_stack([slope, correction]), rate_setpoint)[0]
    return correction_factor > MIN_CORRECTION


class _Responses(NamedTuple):
    """Step and frequency responses of N impulse responses: of the estimate, and then of draws."""

    time: Array
    """(K,) s after the step."""
    steps: Array
    """(N, K) responses to a step of 1."""
    frequency: Array
    """(F,) Hz."""
    responses: Complex
    """(N, F) frequency responses."""


def _responses(estimate: ImpulseResponse, sampling_rate: float, max_frequency: float) -> _Responses:
    """Returns the responses of an ``estimate`` and of ``RESPONSE_DRAWS`` draws of its weights.

    A step response is the integral of the impulse response by the trapezoidal rule with the end correction of Euler and
    Maclaurin, since between two weights it is not straight.

    Args:
        estimate: K weights, and their covariance.
        sampling_rate: Hz.
        max_frequency: of the frequency responses, Hz.
    """
    taps = len(estimate.weights)
    time = np.arange(1, taps + 1) / sampling_rate
    frequency = np.linspace(MIN_FREQUENCY, max_frequency, 2 * taps)
    draws = normal_draws(estimate.weights, estimate.covariance, RESPONSE_DRAWS, seed=31)
    weights = np.vstack([estimate.weights, draws])
    # Steps are sums of the weights before, half of the last weight (trapezoidal rule), and the end correction, by the
    # slope of the impulse response, as half of a central difference, over 12.
    central_difference = np.eye(taps, k=-1) - np.eye(taps, k=1)
    end_correction = weights @ central_difference / 24
    steps = np.cumsum(weights, axis=1) - weights / 2 - end_correction
    cycles = np.outer(time, frequency)
    responses = weights @ np.exp(-2j * np.pi * cycles)
    return _Responses(time, steps, frequency, responses)


def _described(
    axis: str, loop: str, sampling_rate: float, estimate: ImpulseResponse, spectra: WelchSpectra
) -> StepResponse | Fact:
    """Returns the step response that follows from an impulse response, with its figures; or that it is too uncertain.

    Step and frequency responses are computed of the estimated impulse response, and of random draws from its normal
    distribution. The spread of the draws shows the error: a 90 % interval is ± their standard deviation times a factor.
    The frequency response is cut off where it is not known any more, since the setpoint does not move so fast. If fewer
    than two frequencies are left, or the interval of the step is too wide, the result is the fact that setpoints moved
    too little.

    Args:
        axis: "roll", "pitch" or "yaw".
        loop: "rate" or "attitude".
        sampling_rate: of the impulse response, Hz.
        estimate: the impulse response.
        spectra: of setpoint and response, for their coherence.
    """
    # Setpoints of the angle may come without stamps of their own, so only half of the usual band is trusted for them.
    nyquist_frequency = sampling_rate / (2 if loop == "rate" else 4)
    responses = _responses(estimate, sampling_rate, MAX_FREQUENCY_RATIO * nyquist_frequency)
    gains = np.abs(responses.responses)
    coherence = _coherence_where_driven(spectra)
    # Row 0 of all responses is the estimate, the others are draws.
    known_count = _known_frequencies(responses.frequency, gains, spectra.frequency, coherence)
    step_half_width = coverage_factor() * responses.steps[1:].std(axis=0)
    if known_count < 2 or step_half_width.max() >= MAX_STEP_HALF_WIDTH:
        return Fact(StepResponses.TOO_LITTLE_ASKED, subject=f"{axis} {loop}")
    frequency = responses.frequency[:known_count]
    gains = gains[:, :known_count]
    figures = _figures(responses.time, responses.steps, frequency, gains)
    return StepResponse(
        axis=axis,
        loop=loop,
        time=responses.time,
        step=responses.steps[0],
        step_half=step_half_width,
        frequency=frequency,
        response=responses.responses[0, :known_count],
        gain_half=coverage_factor() * gains[1:].std(axis=0),
        max_frequency=frequency[-1],
        windows=estimate.windows,
        coherence=np.interp(figures["peak_frequency"].value, spectra.frequency, coherence),
        **figures,
    )


def _coherence_where_driven(spectra: WelchSpectra) -> Array:
    """Returns (F,) the coherence of setpoint and response, 0 where the setpoint has hardly any power.

    There, what is left of both signals by interpolation may be coherent without being a response.
    """
    power = spectra.driver_power
    is_driven = power >= MIN_DRIVER_POWER_RATIO * power.max()
    return np.where(is_driven, spectra.coherence, 0.0)


def _known_frequencies(
    frequency: Array, gains: Array, spectrum_frequency: Array, coherence: Array
) -> int:
    """Returns how many of the first frequencies of a response are known.

    They end where the deviation of |T| exceeds ``MAX_GAIN_DEVIATION``, and at the highest frequency at which setpoint
    and response are coherent.

    Args:
        frequency: (F,) of the response, Hz.
        gains: (N, F) |T| of the estimate, and then of draws.
        spectrum_frequency: (F′,) of the coherence, Hz.
        coherence: (F′,) of setpoint and response.
    """
    # Row 0 is the estimate.
    deviation = gains[1:].std(axis=0)
    uncertain = np.flatnonzero(deviation > MAX_GAIN_DEVIATION)
    # The first uncertain frequency, or the number of all if there is none.
    certain = np.append(uncertain, len(frequency))[0]
    highest_coherent = spectrum_frequency[coherence >= MIN_COHERENCE].max(initial=0.0)
    return min(certain, np.searchsorted(frequency, highest_coherent))


def _figures(
    time: Array, steps: Array, frequency: Array, gains: Array
) -> dict[str, IntervalEstimate]:
    """Returns each of ``FIGURES`` with its 90 % interval, from the figures of the estimate and of the draws.

    Args:
        time: (K,) s after the step.
        steps: (N, K) responses to a step, of the estimate and then of draws.
        frequency: (F,) Hz.
        gains: (N, F) |T|, likewise.
    """
    to_tenth = _first_times(time, steps, 0.1)
    to_half = _first_times(time, steps, 0.5)
    to_nine_tenths = _first_times(time, steps, 0.9)
    # A step that never reaches 90 % rises for all the time there is.
    has_risen = to_nine_tenths < time[-1]
    is_unsettled = abs(steps - 1) > SETTLING_BAND
    overshoot = np.maximum(steps.max(axis=1) - 1, 0.0)
    # Noise adds to the highest value of a step: as much as each draw adds to it again.
    added_by_noise = overshoot - overshoot[0]
    added_by_noise[0] = added_by_noise[1:].mean()
    values = {
        "overshoot": np.maximum(overshoot[0] - added_by_noise, 0.0),
        "rise_time": np.where(has_risen, to_nine_tenths - to_tenth, to_nine_tenths),
        # The last time at which the step is outside its band.
        "settling": np.where(is_unsettled, time, 0.0).max(axis=1, initial=time[0]),
        "delay": to_half,
        "peak": gains.max(axis=1),
        "peak_frequency": frequency[gains.argmax(axis=1)],
    }
    return {name: _with_interval(figure) for name, figure in values.items()}


def _first_times(time: Array, steps: Array, level: float) -> Array:
    """Returns the times at which responses to a step first exceed a ``level``, linearly interpolated.

    Args:
        time: (K,) s after the step.
        steps: (N, K) responses, which are 0 at time 0.
        level: to be exceeded.

    Returns:
        (N,) s; the last of ``time`` where a response never exceeds the level.
    """
    running_maximum = np.maximum.accumulate(steps, axis=1)
    is_below = running_maximum <= level
    # The values between which the level is exceeded; the first is that at time 0 if no sample is below.
    value_before = running_maximum.max(axis=1, where=is_below, initial=0.0)
    value_after = running_maximum.min(axis=1, where=~is_below, initial=np.inf)
    samples_before = is_below.sum(axis=1)
    sample = samples_before + (level - value_before) / (value_after - value_before)
    times_from_zero = [0.0, *time]
    return np.interp(sample, np.arange(len(times_from_zero)), times_from_zero)


def _with_interval(values: Array) -> IntervalEstimate:
    """Returns a figure with its 90 % interval.

    Args:
        values: (N,) the figure of the estimate, then those of draws. The interval has 5 % of the draws below and above
            it, and is widened to hold the estimate.
    """
    low, high = np.quantile(values[1:], INTERVAL_QUANTILES).tolist()
    value = values[0]
    return IntervalEstimate(value, min(low, value), max(high, value))


def step_from_frequency_response(frequency: Array, closed: Complex, time: Array) -> Array:
    """Returns the response of a closed loop to a step of 1 of its setpoint: 2/π ∫ Re(T) sin(ωt) / ω dω.

    This inverse Fourier transform of a causal, stable response needs its real part only. The integral is a sum over
    midpoints of even steps of ``FREQUENCY_STEP``, up to the highest frequency.

    Args:
        frequency: (F,) Hz.
        closed: (F,) frequency response T.
        time: (K,) s after the step.

    Returns:
        (K,) step response.
    """
    uniform = np.arange(FREQUENCY_STEP / 2, frequency[-1], FREQUENCY_STEP)
    real_part = np.interp(uniform, frequency, closed.real)
    phases = 2 * np.pi * np.outer(time, uniform)
    kernel = np.sin(phases) / uniform
    return kernel @ real_part * FREQUENCY_STEP * 2 / np.pi
