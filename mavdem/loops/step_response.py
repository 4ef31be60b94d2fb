"""Step responses of the closed rate and attitude loop as a flight shows them, at any rate of its messages.

The impulse response is estimated as in ``impulse_response``. Step response, frequency response and their
characteristics follow from it, with 90 % intervals from draws of its values. A rate loop that rises within a few
messages has the step response of the identified loop instead (``identified_step``).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.random import default_rng

from mavdem.arrays import SMALLEST_POSITIVE, Array
from mavdem.confidence import IntervalEstimate, coverage_factor
from mavdem.dataset.segments import Segments
from mavdem.dataset.signals import (
    MIN_SLOW_MOTION_RATE,
    MIN_STREAM_RATE,
    Signals,
    rate_between_outages,
)
from mavdem.dataset.time_series import TimeSeries
from mavdem.dataset.vehicle_cache import cached_per_vehicle
from mavdem.dem.engine.linalg import normal_draws
from mavdem.dem.engine.model import scalar_recursion
from mavdem.facts import Fact
from mavdem.facts.loops import StepResponseFact
from mavdem.immutable import ImmutableResult
from mavdem.ingest.vocabulary import wrapped_angle
from mavdem.loops.axis_loops import Loop
from mavdem.loops.identified_step import (
    STEP_SECONDS,
    identified_steps,
    steps_from_frequency_responses,
)
from mavdem.loops.impulse_response import (
    STEADY_STATE_ERROR,
    ImpulseResponse,
    estimate_impulse_response,
)
from mavdem.loops.margins import Complex
from mavdem.loops.rate_setpoint import (
    AttitudePiece,
    rate_feedforward_if_known,
    rate_setpoint_parts,
    unwrapped,
)
from mavdem.loops.resonance import DEFAULT_ANGLE_GAIN, MAX_FREQUENCY_RATIO, controller_if_known
from mavdem.loops.step_characteristics import rise_times, step_characteristics
from mavdem.loops.welch import (
    MIN_COHERENCE,
    MIN_WINDOWS,
    ResampledSignals,
    WelchSpectra,
    resampled_signals,
    welch_spectra_of_pieces,
)
from mavdem.plant.parameters import DRAWS, ESTIMATE

MAX_SAMPLING_RATES = {"rate": 200.0, "attitude": 100.0}
"""Highest rate of the samples that a response is estimated from, Hz, by loop: it rises within three or more samples."""
SAMPLES_PER_COHERENT_PERIOD = 8.0
"""Least rate of these samples, by the highest frequency at which setpoint and response are coherent: a choice.

Beyond that frequency the signals are rounding and noise, which would be fitted too.
"""
LOW_PASS_HALF_PERIODS = 10
"""Half the length of the low-pass filter before samples are left out, in intervals of the samples that remain.

This and ``LOW_PASS_KAISER_BETA`` are the defaults of ``scipy.signal.resample_poly``.
"""
LOW_PASS_KAISER_BETA = 5.0
"""Shape of the Kaiser window of that filter, without unit: its stop band is 53 dB below its pass band."""
MAX_TIMING_ERROR_STEPS = 0.5
"""Largest error of the time of a setpoint, in intervals of its messages: a jump may have been at the time of either.

PX4's rates in ATTITUDE_TARGET are up to 8 ms newer than their stamp too (``mavdem.dataset.setpoints``).
"""
MIN_RISE_MESSAGES = 12.0
"""Least rise time of a rate that deconvolution resolves, in intervals of its messages.

A choice: at 100 Hz, 90 % bands by deconvolution of PX4's loops that rise in 20 to 80 ms held 24 to 100 % of the true
step, those of the identified loop all of it (docs/evidence/loops.md).
"""
STEP_POINTS = 200
"""Number of time steps of a step response, and of frequencies of a frequency response: more than a chart shows."""
RESPONSE_DRAWS = 300
"""Number of draws of the impulse response from which intervals are computed."""

MIN_FREQUENCY = 0.5
"""Lowest frequency of a response, Hz: a choice."""
MIN_DRIVER_POWER_RATIO = 1e-4
"""Least power of the setpoint at a frequency, relative to the largest: errors of interpolation have as much."""
MAX_GAIN_DEVIATION = 0.25
"""Largest standard deviation of |T| with which it counts as known: a choice."""
MAX_STEP_HALF_WIDTH = 0.3
"""Half width of a step's 90 % band from which on the step is not reported: an overshoot of 30 % may then be none."""
MIN_KNOWN_FREQUENCIES = 2
"""Least number of frequencies at which a response must be known for it to be reported."""
MAX_DISAGREEING_SHARE = 0.3
"""Largest share of the frequencies at which a right prediction may lie outside the 90 % band: a choice.

By chance a tenth does.
"""
MAX_RATE_AMPLIFICATION = 3.0
"""Largest gain by which a closed rate loop may amplify its setpoint for an angle's response to be one of a loop.

With the usual maximum sensitivity of at most 2, the gain |T| = |1 - S| is at most 3.
"""
MIN_PIECE_RESPONSES = 4
"""Least length of a piece of flight, in durations of the response."""
DRAWS_SEED = 31
"""Seed of the draws of impulse responses, so that the same flight has the same intervals."""

CHARACTERISTICS = ("overshoot", "rise_time", "settling", "delay", "peak", "peak_frequency")
"""Characteristics of a :class:`StepResponse`, by the names of its attributes."""

_SETPOINT, _RATE, _ANGLE, _ANGLE_SETPOINT = range(4)
"""Rows of the signals of a rate loop in a piece of flight, as far as they were recorded."""


@dataclass(frozen=True, eq=False)
class StepResponse(ImmutableResult):
    """The measured response of one axis' closed loop to its setpoint: after a step of 1, and by frequency."""

    axis: str
    """"roll", "pitch" or "yaw"."""
    loop: str
    """"rate" or "attitude"."""
    time: Array
    """Times after the step (K,), s, from 0."""
    step: Array
    """Response to the step (K,), which is 0 at time 0."""
    step_half: Array
    """Half widths of its 90 % band (K,)."""
    frequency: Array
    """Frequencies (F,), Hz, up to ``max_frequency``."""
    response: Complex
    """Frequency response T (F,)."""
    gain_half: Array
    """Half widths of the 90 % band of |T| (F,)."""
    max_frequency: float
    """Highest frequency at which the flight shows the response, Hz."""
    windows: int
    """Number of windows of flight that it was estimated from."""
    overshoot: IntervalEstimate
    """Largest value of the step less 1, corrected for what noise adds to a largest value."""
    rise_time: IntervalEstimate
    """Time from 10 to 90 % of the step, s."""
    settling: IntervalEstimate
    """Time until the step stays within 5 % of 1, s."""
    delay: IntervalEstimate
    """Time until the step is at one half, s."""
    peak: IntervalEstimate
    """The largest |T|."""
    peak_frequency: IntervalEstimate
    """Frequency of the largest |T|, Hz."""
    coherence: float
    """Coherence of setpoint and response at that frequency."""
    is_identified: bool = False
    """Whether the step is computed from the identified loop, because the rate is too fast for deconvolution."""
    unseen_part: float = 0.0
    """Largest part of the deconvolved step, at any time, that is made of frequencies above ``max_frequency``."""

    @property
    def is_doubtful(self) -> bool:
        """Whether much of the step is made of frequencies at which the flight does not show the response.

        Such a step may begin backwards or ring, as no vehicle does. From a part of ``MAX_STEP_HALF_WIDTH`` on it is as
        uncertain as a step with a 90 % band of that half width, which is not reported. The frequency response up to
        ``max_frequency`` is measured.
        """
        return not self.is_identified and self.unseen_part >= MAX_STEP_HALF_WIDTH

    @property
    def gain(self) -> Array:
        """Gain |T| of the frequency response (F,)."""
        return np.abs(self.response)

    @property
    def has_peak(self) -> bool:
        """Whether the gain |T| exceeds 1, its value at 0 Hz, and is largest above the lowest known frequency."""
        return bool(self.peak.value > 1 and self.peak_frequency.value > self.frequency[0])

    @property
    def fact(self) -> Fact:
        """The characteristics of the response as a :class:`Fact`, from which reports and documents make one sentence.

        A fact is a code with figures by name, and with a subject that it is about, here the loop, such as "roll rate".
        Each of ``CHARACTERISTICS`` (overshoot, rise time and so on) has the name and the unit of its attribute.
        Overshoot and peak also come with their 90 % intervals; ``highest`` is the highest frequency at which the loop
        was measured, Hz. Of a doubtful step only that frequency is stated.
        """
        if self.is_doubtful:
            return Fact(
                StepResponseFact.STEP_DOUBTED,
                subject=f"{self.axis} {self.loop}",
                highest=self.max_frequency,
            )
        estimates = {name: getattr(self, name).value for name in CHARACTERISTICS}
        return Fact(
            StepResponseFact.STEP_MEASURED,
            subject=f"{self.axis} {self.loop}",
            overshoot_interval=self.overshoot.interval,
            peak_interval=self.peak.interval,
            coherence=self.coherence,
            highest=self.max_frequency,
            is_identified=self.is_identified,
            has_peak=self.has_peak,
            **estimates,
        )

    def comparison(self, frequency: Array, predicted: Complex) -> Fact:
        """Compares a predicted closed loop with the measured one, by their gains.

        The two disagree at a frequency if the predicted |T| is outside the interval of the measured one. If they
        disagree at more than ``MAX_DISAGREEING_SHARE`` of the frequencies, one of them is wrong. That is the
        prediction, unless it peaks above the highest frequency that the flight shows: then the measurement may have
        missed the peak.

        Args:
            frequency: frequencies of the prediction (F′,), Hz.
            predicted: predicted response of the closed loop (F′,).

        Returns:
            Which of the three holds, as a fact (coded finding): they agree, the prediction is in doubt, or the
            measurement is. Its figures are the share of the frequencies at which they disagree, the frequency of the
            predicted peak, Hz, and whether the step is of the identified loop, so that only the gain is measured.
        """
        subject = f"{self.axis} {self.loop}"
        predicted_gain = abs(predicted)
        predicted_at_measured = np.interp(self.frequency, frequency, predicted_gain)
        # The estimate assumes |T| = 1 at 0 Hz up to this error, so that no interval is narrower.
        half_width = np.maximum(self.gain_half, STEADY_STATE_ERROR)
        disagrees = abs(predicted_at_measured - self.gain) > half_width
        share = disagrees.mean()
        if share <= MAX_DISAGREEING_SHARE:
            return Fact(
                StepResponseFact.PREDICTION_AGREES, subject=subject, highest=self.max_frequency
            )
        is_measured = frequency <= self.max_frequency
        largest_measured_gain = predicted_gain[is_measured].max(initial=0.0)
        has_peak_beyond = predicted_gain.max() > largest_measured_gain
        code = StepResponseFact.PREDICTION_DOUBTED
        if has_peak_beyond:
            code = StepResponseFact.MEASUREMENT_DOUBTED
        return Fact(
            code,
            subject=subject,
            share=share,
            frequency=frequency[np.argmax(predicted_gain)],
            highest=self.max_frequency,
            is_identified=self.is_identified,
        )


def rate_step_response(
    signals: Signals, segments: Segments, loop: Loop | None = None
) -> StepResponse | Fact:
    """Measures the response of the body rate to its setpoint in flight.

    The rate setpoint in ArduPilot's ATTITUDE_TARGET lacks the correction by the attitude controller. If it is missing
    it is added, which needs the angle and its setpoint. The rate setpoints of other autopilots contain it.

    Args:
        signals: logged time series of the vehicle, with angle, rate and setpoints of the axis.
        segments: segments of the flight to use.
        loop: the identified loop of the axis, whose response is returned if the rate rises too fast for its messages;
            None without one.

    Returns:
        The step response, or the reason why it is not known: a fact, from which reports make a sentence.
    """
    if signals.rate_and_setpoint is None:
        return _missing_setpoint(signals, "rate")
    rate, setpoint = signals.rate_and_setpoint
    series = [setpoint, rate]
    attitude = signals.attitude
    # Angles can be used only if they come with the rates, at the same times.
    if attitude is not None and rate.time is attitude.time:
        series.append(unwrapped(attitude.angle_series))
        is_ardupilot = signals.telemetry.autopilot == "ARDUPILOTMEGA"
        if is_ardupilot and signals.angle_setpoint is not None:
            series.append(unwrapped(signals.angle_setpoint))
    return _measured_step_response(signals, "rate", series, segments, MIN_STREAM_RATE, loop)


@cached_per_vehicle("axis")
def attitude_step_response(signals: Signals, segments: Segments) -> StepResponse | Fact:
    """Measures the response of the angle to its setpoint in flight.

    Slower messages suffice than for the rate, since angles change more slowly.

    Args:
        signals: logged time series of the vehicle, with angle, rate and setpoints of the axis.
        segments: segments of the flight to use.

    Returns:
        The step response, or the reason why it is not known: a fact, from which reports make a sentence.
    """
    if signals.angle_setpoint is None or signals.attitude is None:
        return _missing_setpoint(signals, "attitude")
    attitude = signals.attitude
    series = [unwrapped(signals.angle_setpoint), unwrapped(attitude.angle_series)]
    if signals.axis == "yaw":
        # How fast the heading turns beyond the body rate, because the vehicle rolls and pitches at once.
        turn_by_tilt = attitude.euler_rate - attitude.rate
        series.append(replace(attitude.rate_series, values=turn_by_tilt))
    attitude_controller = None
    controller = controller_if_known(signals)
    if controller is not None:
        attitude_controller = _AttitudeController(
            controller.angle_gain, rate_feedforward_if_known(signals, segments, controller)
        )
    return _measured_step_response(
        signals,
        "attitude",
        series,
        segments,
        MIN_SLOW_MOTION_RATE,
        attitude_controller=attitude_controller,
    )


class _AttitudeController(NamedTuple):
    """The controller of an angle, which demands the body rate gain · (setpoint - angle), and may feed forward."""

    gain: float
    """Its gain K, 1/s."""
    has_feedforward: bool | None
    """Whether the derivative of the angle's setpoint is added to the setpoint of the rate; None if not known."""

    @property
    def feedforward_gain(self) -> float | None:
        """The gain K, 1/s, if there is feed-forward; None without it, or if that is not known."""
        return self.gain if self.has_feedforward else None


def _missing_setpoint(signals: Signals, loop: str) -> Fact:
    """Returns the fact that the log has no setpoint of a loop, so that its step response cannot be measured.

    The figure ``recorder`` says in which format the autopilot recorded the log: which messages to log depends on it.

    Args:
        signals: logged time series of the vehicle for the axis of the loop.
        loop: "rate" or "attitude".
    """
    return Fact(
        StepResponseFact.NO_SETPOINT,
        subject=f"{signals.axis} {loop}",
        recorder=signals.telemetry.translated_from,
    )


def _measured_step_response(
    signals: Signals,
    loop: str,
    series: Sequence[TimeSeries],
    segments: Segments,
    min_rate: float,
    rate_loop: Loop | None = None,
    attitude_controller: _AttitudeController | None = None,
) -> StepResponse | Fact:
    """Measures the step response of the rate or the attitude loop of one axis.

    Messages are resampled to one even rate in pieces without gaps. Missing signals are computed, and angles are made
    continuous. The sampling rate is reduced to what the coherent frequencies need. The impulse response is estimated
    from these samples, and step and frequency response follow from it. Checks come first, since the estimate takes
    long.

    Args:
        signals: logged time series of the vehicle, with angle, rate and setpoints of the axis.
        loop: "rate" or "attitude".
        series: setpoint, response and, for the rate loop, the angle and its setpoint as far as they were recorded; for
            the yaw angle, the rate by which tilting turns the heading.
        segments: segments of the flight to use.
        min_rate: lowest accepted rate of messages, Hz.
        rate_loop: the identified loop, whose step is used if the rate is too fast for its messages; ``None`` if it is
            not known.
        attitude_controller: controller of the angle, for the attitude loop; None if it is not known.

    Returns:
        The step response; or the reason why there is none: messages are too slow or too few, the setpoint hardly
        varies, or it follows the vehicle, or the response is not certain enough.
    """
    subject = f"{signals.axis} {loop}"
    signals_on_grid = _signals_on_grid(signals, loop, series, segments, min_rate)
    if isinstance(signals_on_grid, Fact):
        return signals_on_grid
    sampling_rate = signals_on_grid.rate
    moving_pieces = _pieces_with_moving_setpoint(signals_on_grid, subject, STEP_SECONDS[loop])
    if isinstance(moving_pieces, Fact):
        return moving_pieces
    # The angle feeds back into the setpoint of the rate loop, but not into that of the attitude loop.
    angle_gain = 0.0
    if loop == "rate":
        angle_gain = _angle_gain_around_rate_loop(signals)
        pieces = _with_angle_and_correction(sampling_rate, moving_pieces, angle_gain)
    else:
        pieces = _corrected_attitude_pieces(
            signals.axis, sampling_rate, moving_pieces, attitude_controller
        )
    spectra = welch_spectra_of_pieces(sampling_rate, pieces)
    if spectra is None:
        return Fact(StepResponseFact.NO_RESPONSE_WINDOW, subject=subject)
    if attitude_controller is not None and _setpoint_follows_angle(spectra, attitude_controller):
        return Fact(StepResponseFact.SETPOINT_FOLLOWS, subject=subject)
    decimation = _decimation_factor(sampling_rate, min_rate, spectra)
    impulse_response = estimate_impulse_response(
        sampling_rate / decimation,
        decimated_pieces(pieces, decimation),
        angle_gain,
        STEP_SECONDS[loop],
        1 / MAX_SAMPLING_RATES[loop],
    )
    if impulse_response is None:
        return Fact(StepResponseFact.NO_RESPONSE_WINDOW, subject=subject)
    estimate = _EstimatedResponse(
        signals.axis, loop, impulse_response, spectra, message_interval=1 / sampling_rate
    )
    return _response_of_estimate(estimate, rate_loop)


def _pieces_with_moving_setpoint(
    signals_on_grid: ResampledSignals, subject: str, response_duration: float
) -> list[Array] | Fact:
    """Returns the pieces of flight in which the setpoint of a loop varies: others show no response to it.

    Args:
        signals_on_grid: pieces of evenly sampled signals, with the setpoint in their first row.
        subject: the loop, such as "roll rate".
        response_duration: length of the step response to be measured, s.

    Returns:
        The pieces; or the fact that together they are too short: the estimate needs ``MIN_WINDOWS`` windows, each twice
        as long as the response.
    """
    pieces = [piece for piece in signals_on_grid.pieces if np.ptp(piece[_SETPOINT]) != 0]
    moving_duration = sum(piece.shape[1] for piece in pieces) / signals_on_grid.rate
    least_duration = 2 * MIN_WINDOWS * response_duration
    if moving_duration < least_duration:
        return Fact(
            StepResponseFact.TOO_LITTLE_ASKED,
            subject=subject,
            moving_duration=moving_duration,
            least_duration=least_duration,
        )
    return pieces


def _angle_gain_around_rate_loop(signals: Signals) -> float:
    """Returns the gain of the attitude controller around a rate loop, 1/s: rate setpoint per error of the angle.

    Args:
        signals: logged time series of the vehicle for the axis. If the log lacks the autopilot's parameters, the gain
            is ``DEFAULT_ANGLE_GAIN``.
    """
    controller = controller_if_known(signals)
    return DEFAULT_ANGLE_GAIN if controller is None else controller.angle_gain


def _signals_on_grid(
    signals: Signals,
    loop: str,
    series: Sequence[TimeSeries],
    segments: Segments,
    min_rate: float,
) -> ResampledSignals | Fact:
    """Resamples the signals of a loop to one even rate, in pieces of the flight without gaps.

    Args:
        signals: logged time series of the vehicle, for the name of the axis and the recorder.
        loop: "rate" or "attitude".
        series: the signals of the loop, such as setpoint and response.
        segments: segments of the flight to use.
        min_rate: lowest accepted rate of messages, Hz.

    Returns:
        The samples; or the reason why there are none: messages are too slow, or all pieces too short.
    """
    subject = f"{signals.axis} {loop}"
    if min(map(rate_between_outages, series)) < min_rate:
        return Fact(
            StepResponseFact.TOO_SLOW,
            subject=subject,
            least_rate=min_rate,
            recorder=signals.telemetry.translated_from,
        )
    min_duration = MIN_PIECE_RESPONSES * STEP_SECONDS[loop]
    signals_on_grid = resampled_signals(
        series, segments, min_duration, min_rate, MAX_SAMPLING_RATES[loop]
    )
    if signals_on_grid is None:
        return Fact(
            StepResponseFact.TOO_LITTLE_FLIGHT, subject=subject, least_duration=min_duration
        )
    return signals_on_grid


def _setpoint_follows_angle(spectra: WelchSpectra, controller: _AttitudeController) -> bool:
    """Returns whether a logged setpoint of an angle follows the vehicle, as ArduPilot's heading did before version 3.4.

    The angle then agrees with its setpoint without the lag of a loop, and shows no response to it. Without feed-forward
    the open loop of an angle is L = K G / jω, with the gain K of its controller and the response G of the closed rate
    loop. The measured response T = L / (1 + L) thus implies |G| = |T / (1 - T)| ω / K. The setpoint follows the vehicle
    if the median of this gain is more than a rate loop can have.

    Args:
        spectra: cross-spectra of the setpoint and the angle.
        controller: controller of the angle. With feed-forward, or if that is not known, the result is False: an angle
            may then follow its setpoint without lag.
    """
    angular_frequency = 2 * np.pi * spectra.frequency
    is_judged = _coherence_where_driven(spectra) >= MIN_COHERENCE
    # Below ω = K any loop follows its setpoint, and small errors of T would decide.
    is_judged &= angular_frequency > controller.gain
    if controller.has_feedforward is not False or not is_judged.any():
        return False
    response = spectra.response[is_judged]
    error = np.maximum(abs(1 - response), SMALLEST_POSITIVE)
    implied_gain = abs(response) / error * angular_frequency[is_judged] / controller.gain
    return bool(np.median(implied_gain) > MAX_RATE_AMPLIFICATION)


def _corrected_attitude_pieces(
    axis: str,
    sampling_rate: float,
    pieces: Sequence[Array],
    controller: _AttitudeController | None,
) -> list[Array]:
    """Removes from the signals of an attitude loop what is no response to the setpoint: whole turns, and turns by tilt.

    Args:
        axis: "roll", "pitch" or "yaw".
        sampling_rate: rate of the samples, Hz.
        pieces: angle setpoint and angle, rad, and for yaw the rate by which tilting turns the heading, rad/s, in the
            rows of each piece (2 or 3, N).
        controller: controller of the angle; None if it is not known.

    Returns:
        Pieces (2, N) of setpoint and angle, rad.
    """
    feedforward_gain = None if controller is None else controller.feedforward_gain
    pieces = [_with_setpoint_within_half_turn(piece) for piece in pieces]
    if axis != "yaw":
        return pieces
    return [_without_turn_by_tilt(piece, sampling_rate, feedforward_gain) for piece in pieces]


def _with_setpoint_within_half_turn(piece: Array) -> Array:
    """Shifts the angle setpoint by whole turns, so that it differs from the angle by at most half a turn.

    The two angles were unwrapped separately, so that they may differ by whole turns.

    Args:
        piece: angle setpoint and angle in its first rows (2 or more, N), rad.

    Returns:
        The piece with the shifted setpoint.
    """
    setpoint, angle, *others = piece
    return np.array([angle + wrapped_angle(setpoint - angle), angle, *others])


def _without_turn_by_tilt(
    piece: Array, sampling_rate: float, feedforward_gain: float | None
) -> Array:
    """Removes from the heading, and from its setpoint, the part that is due to roll and pitch.

    A vehicle that rolls and pitches at once turns its heading ψ by d, the integral of ψ' − r, although the body rate r
    of yaw is 0. The controller sees d as a disturbance of the heading. Where manoeuvres about all axes repeat together,
    d moves with the setpoint s, and would count as response to it. With the gain K of the attitude controller and the
    response G of the rate to its setpoint K (s − ψ), the remaining heading is

        ψ − d = G / iω · K (s − ψ) = T (s − d),    T = G K / (iω + G K)

    so that ψ − d responds to s − d like the loop. Feed-forward adds iω s, but not iω d, to the setpoint of the rate.
    Then ψ − d responds to s − K / (iω + K) · d in the same way.

    Args:
        piece: setpoint and heading, rad, and ψ' − r, rad/s, in its rows (3, N).
        sampling_rate: rate of the samples, Hz.
        feedforward_gain: the gain K, 1/s, if there is feed-forward; None without it.

    Returns:
        A piece (2, N) of setpoint and heading without that part, rad.
    """
    setpoint, heading, rate_by_tilt = piece
    turn_by_tilt = np.cumsum(rate_by_tilt) / sampling_rate
    turn_in_setpoint = turn_by_tilt
    if feedforward_gain is not None:
        # The low-pass K / (iω + K) over one sample, during which its input is constant.
        decay = np.exp(-feedforward_gain / sampling_rate)
        turn_in_setpoint = scalar_recursion(decay, (1 - decay) * turn_by_tilt, start=0.0)
    return np.array([setpoint - turn_in_setpoint, heading - turn_by_tilt])


def _decimation_factor(sampling_rate: float, min_rate: float, spectra: WelchSpectra) -> int:
    """Returns the whole number by which the rate of the samples is divided before a response is estimated.

    After the division, the rate is at least ``min_rate``, and at least ``SAMPLES_PER_COHERENT_PERIOD`` times the
    highest frequency at which setpoint and response are coherent, if the samples are so fast.

    Args:
        sampling_rate: rate of the samples, Hz.
        min_rate: lowest accepted rate, Hz.
        spectra: cross-spectra of setpoint and response.

    Returns:
        The divisor, at least 1.
    """
    is_coherent = _coherence_where_driven(spectra) >= MIN_COHERENCE
    highest_coherent = spectra.frequency[is_coherent].max(initial=0.0)
    needed_rate = max(min_rate, SAMPLES_PER_COHERENT_PERIOD * highest_coherent)
    return max(int(sampling_rate / needed_rate), 1)


def decimated_pieces(pieces: list[Array], decimation: int) -> list[Array]:
    """Divides the sampling rate by a whole number, after a low-pass filter against aliasing.

    The low-pass is a windowed sinc with a Kaiser window (Oppenheim and Schafer, Discrete-Time Signal Processing, sec.
    7.6). ``scipy.signal.resample_poly`` with ``padtype="line"`` gives the same, but takes a second to import.

    Args:
        pieces: pieces (k, N) of k signals each.
        decimation: divisor of the rate; 1 leaves the pieces as they are.

    Returns:
        Pieces (k, N / decimation).
    """
    if decimation == 1:
        return pieces
    half_length = LOW_PASS_HALF_PERIODS * decimation
    low_pass = np.sinc(np.arange(-half_length, half_length + 1) / decimation)
    low_pass *= np.kaiser(len(low_pass), LOW_PASS_KAISER_BETA)
    low_pass /= low_pass.sum()
    thinned_pieces = []
    for piece in pieces:
        # The filter is linear and keeps straight lines. So only the deviation from the line through both ends is
        # filtered. It is 0 at both ends, and can be extended there by zeros without a step.
        sample_count = piece.shape[1]
        first_values, last_values = piece[:, :1], piece[:, -1:]
        slope = (last_values - first_values) / (sample_count - 1)
        line = first_values + slope * np.arange(sample_count)
        no_padding = (0, 0)
        deviation = np.pad(piece - line, (no_padding, (half_length, half_length)))
        # The samples that enter each output sample of the filter, of which only every ``decimation``-th is needed.
        windows = sliding_window_view(deviation, len(low_pass), axis=1)[:, ::decimation]
        thinned_pieces.append(windows @ low_pass + line[:, ::decimation])
    return thinned_pieces


def _with_angle_and_correction(
    sampling_rate: float, pieces: Sequence[Array], angle_gain: float
) -> list[Array]:
    """Returns the signals of a rate loop with a complete rate setpoint, and with the angle.

    The setpoint that the rate controller follows contains the correction of the attitude controller, angle gain × error
    of the angle. Some logs have the rate setpoint without it; whether a log has it, a regression decides
    (:func:`_contains_correction`). If it is missing, it is computed and added. That needs the angle setpoint: without
    it, the rate setpoint is assumed to contain the correction. An angle that was not recorded is replaced by the
    integral of the rate.

    Args:
        sampling_rate: rate of the samples, Hz.
        pieces: rate setpoint, rate and, as far as they were recorded, angle and angle setpoint in the rows of each
            piece (2 to 4, N), in the order of ``_SETPOINT`` to ``_ANGLE_SETPOINT``.
        angle_gain: gain of the attitude controller, 1/s.

    Returns:
        Pieces (3 or 4, N) of rate setpoint, rad/s, rate, rad/s, angle, rad, and angle setpoint, rad, if it was
        recorded.
    """
    signal_count = len(pieces[0])
    has_angle = signal_count > _ANGLE
    if not has_angle:
        return [np.vstack([piece, np.cumsum(piece[_RATE]) / sampling_rate]) for piece in pieces]
    has_angle_setpoint = signal_count > _ANGLE_SETPOINT
    if not has_angle_setpoint or _contains_correction(sampling_rate, pieces, angle_gain):
        return list(pieces)
    corrected_pieces = []
    for piece in pieces:
        correction = angle_gain * wrapped_angle(piece[_ANGLE_SETPOINT] - piece[_ANGLE])
        corrected_setpoint = piece[_SETPOINT] + correction
        corrected_pieces.append(np.vstack([corrected_setpoint, piece[_RATE:]]))
    return corrected_pieces


def _contains_correction(sampling_rate: float, pieces: Sequence[Array], angle_gain: float) -> bool:
    """Returns whether a logged rate setpoint contains the attitude controller's correction, by a regression.

    Args:
        sampling_rate: rate of the samples, Hz.
        pieces: rate setpoint, rad/s, rate, rad/s, angle, rad, and angle setpoint, rad, in the rows of each piece
            (4, N).
        angle_gain: gain of the attitude controller, 1/s.
    """
    attitude_pieces = []
    for rate_setpoint, _, angle, angle_setpoint in pieces:
        attitude_pieces.append(AttitudePiece(rate_setpoint, angle, angle_setpoint))
    return rate_setpoint_parts(sampling_rate, attitude_pieces, angle_gain).has_correction


class _EstimatedResponse(NamedTuple):
    """What flight shows of one loop: the estimate that its step and frequency response are computed from."""

    axis: str
    """"roll", "pitch" or "yaw"."""
    loop: str
    """"rate" or "attitude"."""
    impulse_response: ImpulseResponse
    """Response to an impulse of the setpoint, with the covariance of its values."""
    spectra: WelchSpectra
    """Cross-spectra of setpoint and response."""
    message_interval: float
    """Time between two messages, s."""

    @property
    def subject(self) -> str:
        """The loop as the subject of facts, such as "roll rate"."""
        return f"{self.axis} {self.loop}"

    @property
    def max_frequency(self) -> float:
        """Highest frequency at which the response may be known, Hz.

        Angle setpoints may not have their own time stamps, so that only the lower half of the usual band is used.
        """
        nyquist_frequency = self.impulse_response.sampling_rate / 2
        usable_frequency = nyquist_frequency if self.loop == "rate" else nyquist_frequency / 2
        return MAX_FREQUENCY_RATIO * usable_frequency


class _Responses(NamedTuple):
    """Step and frequency responses of N impulse responses: of the estimate, and then of draws."""

    time: Array
    """Times after the step (K,), s."""
    steps: Array
    """Responses to a step of 1 (N, K)."""
    frequency: Array
    """Frequencies (F,), Hz."""
    responses: Complex
    """Frequency responses (N, F)."""


def _step_and_frequency_responses(estimate: _EstimatedResponse) -> _Responses:
    """Computes step and frequency responses of an estimated impulse response, and of draws of its values.

    It is not known when between two messages a setpoint changed, so that the whole response may be earlier or later. To
    include this uncertainty, the steps of the draws are shifted by random times.

    Returns:
        Responses in rows: of the estimate first, then of ``RESPONSE_DRAWS`` draws.
    """
    impulse_response = estimate.impulse_response
    taps = impulse_response.knots[-1]
    time = np.linspace(0.0, taps / impulse_response.sampling_rate, STEP_POINTS + 1)
    frequency = np.linspace(MIN_FREQUENCY, estimate.max_frequency, STEP_POINTS)
    draws = normal_draws(
        impulse_response.values, impulse_response.covariance, RESPONSE_DRAWS, DRAWS_SEED
    )
    values = np.vstack([impulse_response.values, draws])
    steps = impulse_response.step_responses(values, time)
    # The largest shift of the setpoint to either side, s.
    timing_error = MAX_TIMING_ERROR_STEPS * estimate.message_interval
    shifts = default_rng(DRAWS_SEED).uniform(-timing_error, timing_error, RESPONSE_DRAWS)
    # Row 0 is the estimate, which is not shifted.
    for row, shift in enumerate(shifts.tolist(), start=1):
        steps[row] = np.interp(time - shift, time, steps[row])
    responses = impulse_response.frequency_responses(values, frequency)
    return _Responses(time, steps, frequency, responses)


class _ResponsePrecision(NamedTuple):
    """How well a flight shows the response of a loop: up to which frequency, and with which 90 % intervals."""

    coherence: Array
    """Coherence of setpoint and response at the frequencies of their spectra; 0 where the setpoint hardly varies."""
    coherent_count: int
    """Number of the response's frequencies below the highest at which setpoint and response are coherent."""
    certain_count: int
    """Number of its frequencies below the first at which the gain |T| is uncertain."""
    gain_half_width: Array
    """Half widths of the 90 % interval of |T| (F,)."""
    step_half_width: Array
    """Half widths of the 90 % interval of the step (K,)."""


def _response_of_estimate(
    estimate: _EstimatedResponse, rate_loop: Loop | None
) -> StepResponse | Fact:
    """Returns the step and frequency response of a loop, with 90 % intervals, from its estimated impulse response.

    The frequency response ends at the highest frequency at which the flight shows it. The identified loop is used only
    for the step, so that the measured frequency response remains a test of the loop.

    Args:
        estimate: the impulse response of the loop.
        rate_loop: the identified loop, whose step is used if the rate is too fast for its messages; ``None`` if it is
            not known.

    Returns:
        The step response; or the fact (coded finding) why it is not known (:func:`_reason_for_no_response`).
    """
    deconvolved = _step_and_frequency_responses(estimate)
    identified = _steps_of_fast_loop(rate_loop, deconvolved.time, estimate.message_interval)
    responses = deconvolved if identified is None else deconvolved._replace(steps=identified)
    precision = _response_precision(responses, estimate.spectra)
    reason = _reason_for_no_response(estimate, responses.frequency, precision)
    if reason is not None:
        return reason
    known_count = min(precision.coherent_count, precision.certain_count)
    frequency = responses.frequency[:known_count]
    known_responses = responses.responses[:, :known_count]
    characteristics = step_characteristics(
        responses.time, responses.steps, frequency, np.abs(known_responses)
    )
    peak_frequency = characteristics["peak_frequency"].value
    return StepResponse(
        axis=estimate.axis,
        loop=estimate.loop,
        time=responses.time,
        step=responses.steps[ESTIMATE],
        step_half=precision.step_half_width,
        frequency=frequency,
        response=known_responses[ESTIMATE],
        gain_half=precision.gain_half_width[:known_count],
        max_frequency=frequency[-1],
        windows=estimate.impulse_response.windows,
        coherence=np.interp(peak_frequency, estimate.spectra.frequency, precision.coherence),
        is_identified=identified is not None,
        unseen_part=_unseen_part(estimate.impulse_response, deconvolved, frequency[-1]),
        **characteristics,
    )


def _response_precision(responses: _Responses, spectra: WelchSpectra) -> _ResponsePrecision:
    """Returns how well a flight shows a response, by its draws and by the coherence of setpoint and response.

    The half width of a 90 % interval is 1.64 standard deviations of the draws.

    Args:
        responses: step and frequency responses of the estimate, and of draws.
        spectra: cross-spectra of setpoint and response.
    """
    coherence = _coherence_where_driven(spectra)
    gain_deviation = np.abs(responses.responses[DRAWS]).std(axis=0)
    return _ResponsePrecision(
        coherence,
        coherent_count=_coherent_frequency_count(responses.frequency, spectra.frequency, coherence),
        certain_count=_certain_frequency_count(gain_deviation),
        gain_half_width=coverage_factor() * gain_deviation,
        step_half_width=coverage_factor() * responses.steps[DRAWS].std(axis=0),
    )


def _reason_for_no_response(
    estimate: _EstimatedResponse, frequency: Array, precision: _ResponsePrecision
) -> Fact | None:
    """Returns why a flight does not show the response of a loop well enough for it to be reported.

    Args:
        estimate: the loop, and the spectra of its setpoint and response.
        frequency: frequencies of the response (F,), Hz.
        precision: how well the flight shows the response.

    Returns:
        The fact (coded finding) that setpoint and response are incoherent, or that the gain or the step is too
        uncertain; None if the response is known.
    """
    if precision.coherent_count < MIN_KNOWN_FREQUENCIES:
        # No coherence above the lowest frequencies is sufficient, or more frequencies would be known: the fact states
        # the highest one.
        is_above_lowest = estimate.spectra.frequency > frequency[MIN_KNOWN_FREQUENCIES - 1]
        return Fact(
            StepResponseFact.NOT_COHERENT,
            subject=estimate.subject,
            frequency=MIN_FREQUENCY,
            coherence=precision.coherence[is_above_lowest].max(initial=0.0),
            least_coherence=MIN_COHERENCE,
        )
    if precision.certain_count < MIN_KNOWN_FREQUENCIES:
        return Fact(
            StepResponseFact.GAIN_UNCERTAIN,
            subject=estimate.subject,
            frequency=MIN_FREQUENCY,
            band_half_width=precision.gain_half_width[:MIN_KNOWN_FREQUENCIES].max(),
        )
    if precision.step_half_width.max() >= MAX_STEP_HALF_WIDTH:
        return Fact(
            StepResponseFact.STEP_UNCERTAIN,
            subject=estimate.subject,
            band_half_width=precision.step_half_width.max(),
            largest_half_width=MAX_STEP_HALF_WIDTH,
            sampling_rate=1 / estimate.message_interval,
        )
    return None


def _unseen_part(estimate: ImpulseResponse, responses: _Responses, max_frequency: float) -> float:
    """Returns how much of a step response is made of frequencies at which the flight does not show the response.

    For example, 0.3 says that at some time 0.3 of a step of 1 comes from frequencies above ``max_frequency``. What
    comes from the frequencies below it is 2/π ∫ Re(T) sin(2πft) / f df (:func:`steps_from_frequency_responses`).

    Args:
        estimate: the impulse response.
        responses: its step response, and those of draws.
        max_frequency: highest frequency at which the flight shows the response, Hz.
    """
    # Frequencies above 0, at which the transform is defined.
    frequency = np.linspace(max_frequency / STEP_POINTS, max_frequency, STEP_POINTS)
    response = estimate.frequency_responses(estimate.values[None], frequency)
    (known_part,) = steps_from_frequency_responses(frequency, response, responses.time)
    return float(abs(responses.steps[ESTIMATE] - known_part).max())


def _coherence_where_driven(spectra: WelchSpectra) -> Array:
    """Returns the coherence of setpoint and response, with 0 if the setpoint has hardly any power.

    At such frequencies, errors of interpolation in both signals may be coherent without being a response.

    Args:
        spectra: cross-spectra of setpoint and response at F frequencies.

    Returns:
        The coherence (F,).
    """
    power = spectra.driver_power
    is_driven = power >= MIN_DRIVER_POWER_RATIO * power.max()
    return np.where(is_driven, spectra.coherence, 0.0)


def _coherent_frequency_count(frequency: Array, spectrum_frequency: Array, coherence: Array) -> int:
    """Returns the number of frequencies of a response below the highest at which setpoint and response are coherent.

    Args:
        frequency: (F,) frequencies of the response, Hz, ascending.
        spectrum_frequency: (F′,) frequencies of the coherence, Hz.
        coherence: (F′,) coherence of setpoint and response.

    Returns:
        The number, at most F.
    """
    highest_coherent = spectrum_frequency[coherence >= MIN_COHERENCE].max(initial=0.0)
    return int(np.searchsorted(frequency, highest_coherent))


def _certain_frequency_count(gain_deviation: Array) -> int:
    """Returns the number of frequencies before the first at which the gain is too uncertain (``MAX_GAIN_DEVIATION``).

    Args:
        gain_deviation: (F,) standard deviations of the gain |T| at ascending frequencies.

    Returns:
        The number, at most F.
    """
    is_uncertain = gain_deviation > MAX_GAIN_DEVIATION
    if not is_uncertain.any():
        return len(is_uncertain)
    # The index of the first uncertain frequency is the number of those below it.
    return int(np.argmax(is_uncertain))


def _steps_of_fast_loop(
    rate_loop: Loop | None, time: Array, message_interval: float
) -> Array | None:
    """Returns the step responses of an identified rate loop if it rises too fast for its messages to show a step.

    Args:
        rate_loop: the identified loop; None if it is not known.
        time: times after the step (K,), s.
        message_interval: time between two messages, s.

    Returns:
        Steps (N, K) of the estimate first, then of draws; None if the loop is not known, or not too fast.
    """
    if rate_loop is None:
        return None
    steps = identified_steps(rate_loop, time, RESPONSE_DRAWS)
    if steps is None:
        return None
    rise_time_of_estimate = rise_times(time, steps[:1])[0]
    is_too_fast = rise_time_of_estimate < least_rise_time(1 / message_interval)
    return steps if is_too_fast else None


def least_rise_time(message_rate: float) -> float:
    """Returns the shortest rise time (10 to 90 % of a step), s, that messages of the body rate can show.

    The estimate blurs the step of a loop that rises within fewer than ``MIN_RISE_MESSAGES`` samples.

    Args:
        message_rate: rate of the messages, Hz. There are no more samples than ``MAX_SAMPLING_RATES`` a second.
    """
    return MIN_RISE_MESSAGES / min(message_rate, MAX_SAMPLING_RATES["rate"])
