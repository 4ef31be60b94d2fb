"""How an axis follows its setpoint in settled flight, as a fact (a coded finding): error, delay and overshoot.

The overshoot is taken from the measured step response. If the flight shows none, a response that is larger than its
setpoint at some frequency is called what it is, and not an overshoot.
"""

from typing import Any, NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment.axis.reached_rate import ReachedRate, reached_rate
from mavdem.assessment.limits import Limits
from mavdem.confidence import MIN_SAMPLES_FOR_STATISTICS
from mavdem.dataset.axes import AXES, TILT_AXES
from mavdem.dataset.flight_states import POSITION_CONTROL_MODES
from mavdem.dataset.intervals import Intervals, complement, intersection
from mavdem.dataset.segments import Segment, Segments, in_segments, segments_without_modes
from mavdem.dataset.signals import MIN_SLOW_MOTION_RATE, Signals, rate_between_outages
from mavdem.dataset.time_series import TimeSeries
from mavdem.facts import Fact, Level, NamedFacts
from mavdem.facts.margins import TrackingLight
from mavdem.loops.measured_response import MIN_COMPARED_COHERENCE
from mavdem.loops.step_response import attitude_step_response
from mavdem.loops.welch import WELCH_SECONDS, relative_half_width, welch_spectra

DELAYS = np.arange(0.0, 0.62, 0.02)
"""Delays of the angle behind its setpoint that are tried, s. A multirotor has 0.1 to 0.4 s; a setpoint that is sent
rarely arrives later."""

ANGLE_ERROR_LIMITS = Limits(np.radians(3.0), np.radians(10.0))
"""RMS error of the angle without the delay, rad.

Sound vehicles have up to 2.5°, and 4° in steps of 45°; ArduPilot's crash check begins at 30°. An error is watched only
where it exceeds half of the setpoint's standard deviation, and bad where it exceeds all of it: there, no response at
all would be better. So a stick that is moved on the ground is not an error.
"""

ANGLE_GAIN = 4.5
"""Body rate per error of the angle, 1/s, that an attitude controller asks for: the default of ATC_ANG_RLL_P."""

RATE_ERROR_LIMITS = Limits(
    watch=ANGLE_GAIN * ANGLE_ERROR_LIMITS.watch, bad=ANGLE_GAIN * ANGLE_ERROR_LIMITS.bad
)
"""RMS error of the body rate without the delay, rad/s: the rates that such errors of the angle ask for."""

MIN_RATE_SAMPLES_PER_SECOND = 16.0
"""Rate of body rate and its setpoint, Hz, from which they are compared.

A motion of 3 Hz, the bandwidth of a rate loop, is interpolated with an error of a sixth then.
"""

YAW_ERROR_LIMITS = Limits(np.radians(5.0), np.radians(15.0))
"""RMS error of yaw, rad: sound vehicles have up to 3.5°, and to PX4 a heading is reached within 12° (MIS_YAW_ERR)."""

MODES_WITHOUT_ANGLE_SETPOINT = frozenset({"Acro", "Flip", "Throw", "Turtle"})
"""ArduPilot's flight modes in which the logged setpoint of the angle is not used."""

MIN_SETPOINT_DEVIATION = np.radians(2.0)
"""Standard deviation of the setpoint, rad, above which it excites the axis enough to show an overshoot."""

MAX_OVERSHOOT = 0.3
"""Overshoot of a step response that is to be watched: that of a damping ratio of 0.36, for which the phase margin is
about 36°."""

MAX_RESPONSE_PEAK = 1.5
"""Largest response of the angle to its setpoint, by frequency, that is not looked into.

A second-order system with ``MAX_OVERSHOOT`` has the peak 1 / (2ζ √(1 − ζ²)) = 1.5, with ζ = 0.36 (K. Ogata, Modern
Control Engineering).
"""

MIN_PEAK_DRIVER_FRACTION = 0.01
"""Least power of the setpoint where its response counts, over its largest power: a choice.

If the setpoint hardly moves, wind and noise determine the ratio. Power at 0 Hz, which is that of trends, does not
count.
"""

YAW_MOVEMENT_SECONDS = 1.0
"""Time over which the movement of yaw's setpoint is measured, s.

A heading has no mean, so that the movement is the RMS change in this time. Headings that follow well have an RMS error
of at most a quarter of it, or of 3°.
"""

YAW_JUMP = np.radians(20.0)
"""Change of yaw's setpoint from one sample to the next, rad, that is a new heading to turn to, and not one to follow.

Autopilots that let the setpoint turn with the vehicle change it by at most 60° (ATC_SLEW_YAW) in a second. Older ones
set the heading of the next leg of a mission at once, and the vehicle turns there at its own rate.
"""

SLOWEST_TURN = np.radians(10.0)
"""Rate, rad/s, at which a vehicle turns to such a heading at least: half of the slowest default (20°/s,
MPC_YAWRAUTO_MAX of older PX4)."""

TURN_MARGIN_SECONDS = 2.0
"""Time, s, in which such a turn begins and ends."""


class SetpointErrors(NamedTuple):
    """How far a response is from the setpoint of some time before, for each of D delays."""

    times: Array
    """When they are compared (N,), s since boot."""
    setpoints: Array
    """The setpoints (N,)."""
    errors: Array
    """Response after each delay minus setpoint (D, N)."""


class _ErrorsAtBestDelay(NamedTuple):
    """Errors of an angle or a rate behind its setpoint, after the delay for which they are smallest."""

    rms_error: float
    """RMS value of the errors, rad or rad/s."""

    errors: Array
    """(N,) The errors, rad or rad/s."""

    delay: float | None
    """The delay, s; None if the smallest error is at an end of the ``DELAYS``, so that it is not measured."""


class ResponsePeak(NamedTuple):
    """The largest response of an angle to its setpoint, over all frequencies at which the two are coherent."""

    ratio: float
    """Amplitude of the angle over the amplitude of the setpoint."""
    frequency: float
    """Its frequency, Hz."""
    coherence: float
    """Coherence of angle and setpoint there, from ``MIN_COMPARED_COHERENCE`` to 1."""
    windows: int
    """Number of windows from which the spectra were averaged."""

    @property
    def lowest_ratio(self) -> float:
        """Lower end of the 90 % interval of the ratio."""
        return float(self.ratio * (1 - relative_half_width(self.coherence, self.windows)))


class AttitudeGain(NamedTuple):
    """Gain |T| from the setpoint of an angle to the angle, at the U frequencies at which the flight shows it."""

    frequency: Array
    """Frequencies (U,), Hz, ascending."""
    gain: Array
    """Amplitude of the angle over the amplitude of the setpoint (U,)."""
    coherence: Array
    """Coherence of angle and setpoint (U,), from ``MIN_COMPARED_COHERENCE`` to 1."""
    windows: int
    """Number of windows from which the spectra were averaged."""

    @property
    def half_width(self) -> Array:
        """Half width (U,) of the gain's 90 % interval."""
        return self.gain * relative_half_width(self.coherence, self.windows)

    @property
    def peak(self) -> ResponsePeak:
        """The largest gain, with its frequency and coherence."""
        index = np.argmax(self.gain)
        return ResponsePeak(
            ratio=self.gain[index],
            frequency=self.frequency[index],
            coherence=self.coherence[index],
            windows=self.windows,
        )


class _TrackingRating(NamedTuple):
    """How well an angle follows its setpoint."""

    code: TrackingLight
    """What is wrong, or that the setpoint is followed."""
    level: Level
    """How serious that is."""
    overshoot: float | None = None
    """Overshoot of a step as a fraction of it; None if it was not measured."""


def tracking_of_axes(signals: Signals, segments: Segments) -> NamedFacts:
    """Returns the tracking of roll, pitch and yaw, how they follow their setpoints, by axis.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        segments: segments of the flight that are judged.
    """
    return {axis: _axis_tracking(signals.for_axis(axis), segments) for axis in AXES}


def _axis_tracking(signals: Signals, segments: Segments) -> Fact:
    """Judges how one axis follows its setpoint: that of the angle or, for roll and pitch without one, of the rate.

    Args:
        signals: signals of the vehicle, for the axis to judge.
        segments: segments of the flight that are judged.

    Returns:
        The fact of :func:`_angle_tracking` or of :func:`_rate_tracking`. If the log shows neither, the fact that the
        tracking is unknown, with ``asked``, whether there is a setpoint of the angle, and the ``rate_error``, rad/s.
    """
    setpoint = signals.angle_setpoint
    tracking = None
    if setpoint is not None:
        tracking = _angle_tracking(signals, setpoint, segments)
    elif signals.axis in TILT_AXES:
        tracking = _rate_tracking(signals, segments)
    if tracking is not None:
        return tracking
    return Fact(
        TrackingLight.TRACKING_UNKNOWN,
        axis=signals.axis,
        asked=setpoint is not None,
        recorder=signals.telemetry.translated_from,
        rate_error=_rate_error(signals, segments),
    )


def _angle_tracking(signals: Signals, setpoint: TimeSeries, segments: Segments) -> Fact | None:
    """Judges how the angle of an axis follows its setpoint.

    A vehicle that follows well still follows with a delay. So the angle is compared with the setpoint at each of the
    ``DELAYS`` before. The delay with the smallest RMS difference is the delay of the vehicle, and this difference is
    its error. Even if the error is small, the level is "watch" if the response is doubtful (:func:`_tracking_rating`).

    Args:
        signals: signals of the vehicle, for the axis to judge.
        setpoint: setpoint of the angle, rad.
        segments: segments of the flight that are judged.

    Returns:
        None without angles, or with too few setpoints in the segments. Otherwise a fact with these figures:

        - ``angle_error``, the ``error_limit`` from which it is bad, and the mean error ``offset_angle``, rad;
        - ``largest_error``, rad, and ``largest_error_time``, when it was, s since boot;
        - ``delay``, s; None if the smallest error is at an end of the ``DELAYS``, so that the flight does not show it;
        - ``rate_error``, rad/s;
        - ``ratio`` and ``frequency``, Hz, of the largest response of the angle to its setpoint;
        - ``overshoot`` of a step as a fraction of the step, if it was measured;
        - ``rate_setpoint`` and ``reached_rate``, rad/s, and ``at_limit_share`` in turns.
    """
    if signals.attitude is None:
        return None
    angle = signals.attitude.angle_series
    is_tilt = signals.axis in TILT_AXES
    angle_segments = segments if is_tilt else _segments_without_turns(setpoint, segments)
    compared = _setpoint_errors(setpoint, angle, angle_segments, DELAYS)
    if len(compared.setpoints) < MIN_SAMPLES_FOR_STATISTICS:
        return None
    # How far the setpoint moves, rad: the larger, the larger an error may be.
    if is_tilt:
        movement = float(compared.setpoints.std())
        limits = _error_limits(movement, ANGLE_ERROR_LIMITS)
    else:
        movement = _yaw_movement(setpoint, angle_segments)
        limits = _error_limits(movement, YAW_ERROR_LIMITS)
    # If the setpoint hardly varies, the overshoot cannot be seen.
    peak = None
    if movement > MIN_SETPOINT_DEVIATION:
        gain = attitude_gain(setpoint, angle, angle_segments)
        peak = None if gain is None else gain.peak
    error_figures = _error_figures(compared)
    reached_turn = reached_rate(signals, segments)
    rating = _tracking_rating(
        signals,
        angle_segments,
        error_level=limits.level(error_figures["angle_error"]),
        turn=reached_turn,
        peak=peak,
    )
    tracking = Fact(
        rating.code,
        rating.level,
        axis=signals.axis,
        **error_figures,
        error_limit=limits.bad,
        overshoot=rating.overshoot,
        rate_error=_rate_error(signals, segments),
        ratio=None if peak is None else peak.ratio,
        frequency=None if peak is None else peak.frequency,
    )
    if reached_turn is None:
        return tracking
    return tracking.replace(
        rate_setpoint=reached_turn.setpoint,
        reached_rate=reached_turn.rate,
        at_limit_share=reached_turn.at_limit_share,
    )


def _rate_tracking(signals: Signals, segments: Segments) -> Fact | None:
    """Judges how the body rate of an axis follows its setpoint, for a vehicle that is asked for rates alone.

    As with an angle, the rate is compared with the setpoint at each of the ``DELAYS`` before, and the smallest RMS
    difference is its error.

    Args:
        signals: signals of the vehicle, for the axis to judge.
        segments: segments of the flight that are judged.

    Returns:
        A fact with the ``rate_error`` and the ``rate_error_limit`` from which it is bad, rad/s, and the ``delay``, s,
        None if the flight does not show it; None if rates or setpoints are missing, too few or too slow.
    """
    rate_setpoint = _rate_setpoint(signals)
    if signals.attitude is None or rate_setpoint is None:
        return None
    body_rate = signals.attitude.rate_series
    slowest_rate = min(rate_between_outages(rate_setpoint), rate_between_outages(body_rate))
    compared = _setpoint_errors(rate_setpoint, body_rate, segments, DELAYS)
    too_few = len(compared.setpoints) < MIN_SAMPLES_FOR_STATISTICS
    if too_few or slowest_rate < MIN_RATE_SAMPLES_PER_SECOND:
        return None
    best = _best_delay(compared)
    limits = _error_limits(float(compared.setpoints.std()), RATE_ERROR_LIMITS)
    level = limits.level(best.rms_error)
    is_good = level is Level.GOOD
    return Fact(
        TrackingLight.FOLLOWS_RATE_SETPOINT if is_good else TrackingLight.MISSES_RATE_SETPOINT,
        level,
        axis=signals.axis,
        rate_error=best.rms_error,
        rate_error_limit=limits.bad,
        delay=best.delay,
    )


def _best_delay(compared: SetpointErrors) -> _ErrorsAtBestDelay:
    """Returns the errors behind the setpoint after the delay for which their RMS value is smallest.

    Args:
        compared: errors of N samples for each of the ``DELAYS``; N is at least 1.
    """
    rms_errors = np.sqrt(np.mean(np.square(compared.errors), axis=1))
    best = np.argmin(rms_errors)
    # At an end of the range of delays, the smallest error may be outside of it.
    is_delay_measured = 0 < best < len(DELAYS) - 1
    return _ErrorsAtBestDelay(
        rms_errors[best], compared.errors[best], DELAYS[best] if is_delay_measured else None
    )


def _error_figures(compared: SetpointErrors) -> dict[str, Any]:
    """Returns the errors of an angle behind its setpoint as figures of a fact, after the delay with the smallest error.

    Args:
        compared: errors of N samples, rad, for each of the ``DELAYS``; N is at least 1.

    Returns:
        By name: the RMS ``angle_error``, the mean ``offset_angle`` and the ``largest_error``, rad; the
        ``largest_error_time``, s since boot; and the ``delay``, s, None if it is not measured.
    """
    best = _best_delay(compared)
    worst_sample = np.argmax(abs(best.errors))
    return {
        "angle_error": best.rms_error,
        "offset_angle": np.mean(best.errors),
        "largest_error": abs(best.errors[worst_sample]),
        "largest_error_time": compared.times[worst_sample],
        "delay": best.delay,
    }


def _error_limits(movement: float, least_limits: Limits) -> Limits:
    """Returns the limits of the RMS error of an angle, which grow with the movement of its setpoint.

    A vehicle that ignores its setpoint has an error as large as the movement. So an error as large as the movement is
    bad, and one of half the movement is to be watched.

    Args:
        movement: RMS movement of the setpoint, rad.
        least_limits: limits for a setpoint that hardly moves, rad.

    Returns:
        The limits, rad.
    """
    return Limits(watch=max(least_limits.watch, movement / 2), bad=max(least_limits.bad, movement))


def _tracking_rating(
    signals: Signals,
    segments: Segments,
    error_level: Level,
    turn: ReachedRate | None,
    peak: ResponsePeak | None,
) -> _TrackingRating:
    """Rates how well an axis follows its setpoint.

    The first of these cases that applies decides:

    1. The error of the angle is not small.
    2. The rate falls short of its setpoint in turns.
    3. The response is too large at some frequency (:func:`_rating_of_large_response`).
    4. The axis follows well.

    Args:
        signals: logged time series of the vehicle, with angle, rate and setpoints of the axis.
        segments: segments of the flight in which the angle is judged.
        error_level: level of the error of the angle.
        turn: the rate that was reached in turns; None if it is not known.
        peak: the largest response to the setpoint; None if the setpoint hardly moves.

    Returns:
        Code and level of the case, with the overshoot if it was measured.
    """
    if error_level is not Level.GOOD:
        return _TrackingRating(TrackingLight.MISSES_SETPOINT, error_level)
    if turn is not None and turn.falls_short:
        return _TrackingRating(TrackingLight.RATE_FALLS_SHORT, Level.WATCH)
    if peak is None or peak.ratio <= MAX_RESPONSE_PEAK:
        return _TrackingRating(TrackingLight.FOLLOWS_SETPOINT, Level.GOOD)
    return _rating_of_large_response(signals, segments, peak)


def _rating_of_large_response(
    signals: Signals, segments: Segments, peak: ResponsePeak
) -> _TrackingRating:
    """Rates an axis whose response to its setpoint exceeds ``MAX_RESPONSE_PEAK`` at some frequency.

    A step that overshoots by more than ``MAX_OVERSHOOT`` is to be watched. Estimating the step response takes long, so
    that it is done only here. If it cannot be measured, the whole confidence interval of the peak must exceed
    ``MAX_RESPONSE_PEAK``.

    Args:
        signals: logged time series of the vehicle, with angle, rate and setpoints of the axis.
        segments: segments of the flight in which the angle is judged.
        peak: the largest response to the setpoint.

    Returns:
        Code and level, with the overshoot if it was measured.
    """
    # Either the step response, or the fact that says why there is none.
    step_response = attitude_step_response(signals, segments)
    if not isinstance(step_response, Fact):
        return _rating_of_overshoot(step_response.overshoot.value)
    reliable_peak: ResponsePeak | None = peak
    if signals.axis in TILT_AXES:
        # A position controller commands roll and pitch, and not yaw.
        reliable_peak = _response_peak_without_position_control(signals, segments)
    if reliable_peak is not None and reliable_peak.lowest_ratio > MAX_RESPONSE_PEAK:
        return _TrackingRating(TrackingLight.AMPLIFIES_SETPOINT, Level.WATCH)
    return _TrackingRating(TrackingLight.FOLLOWS_SETPOINT, Level.GOOD)


def _rating_of_overshoot(overshoot: float) -> _TrackingRating:
    """Rates an axis by the measured overshoot of a step of its setpoint, as a fraction of the step."""
    if overshoot > MAX_OVERSHOOT:
        return _TrackingRating(TrackingLight.OVERSHOOTS_SETPOINT, Level.WATCH, overshoot)
    return _TrackingRating(TrackingLight.FOLLOWS_SETPOINT, Level.GOOD, overshoot)


def _response_peak_without_position_control(
    signals: Signals, segments: Segments
) -> ResponsePeak | None:
    """Returns the largest response of the angle to its setpoint in modes in which no position controller sets it.

    A position controller computes the setpoint of the angle from the motion of the vehicle, by which it counters wind.
    Then setpoint and angle form a closed loop, and their measured ratio is the inverse of that controller and not the
    response of the angle, unless something else moves the setpoint more (L. Ljung, System Identification, sec. 13.4, on
    the spectral estimate in closed loop).

    Args:
        signals: signals of the vehicle for roll or pitch, with the setpoint of the angle and the attitude.
        segments: segments of the flight in which the angle is judged.

    Returns:
        The peak; None if there is no such flight, or no frequency at which the angle is coherent with its setpoint.
    """
    assert signals.angle_setpoint is not None
    assert signals.attitude is not None
    gain = attitude_gain(
        signals.angle_setpoint,
        signals.attitude.angle_series,
        segments_without_modes(signals, segments, POSITION_CONTROL_MODES),
    )
    return None if gain is None else gain.peak


def _segments_without_turns(setpoint: TimeSeries, segments: Segments) -> Segments:
    """Returns the segments of flight without turns to a new heading that was set in one jump.

    In such a turn the heading is far from its setpoint, which is no error of the loops. A turn begins at a jump by more
    than ``YAW_JUMP``, and ends when even the slowest vehicle has reached the new heading.

    Args:
        setpoint: setpoint of yaw, rad, unwrapped.
        segments: segments of the flight that are judged.

    Returns:
        The segments, cut at the turns.
    """
    segments_without_turns = []
    for segment in segments:
        turns = _turns_to_new_headings(setpoint.of_boot(segment.boot))
        for start, end in intersection([(segment.start, segment.end)], complement(turns)):
            segments_without_turns.append(Segment(segment.boot, start, end))
    return tuple(segments_without_turns)


def _turns_to_new_headings(setpoint: TimeSeries) -> Intervals:
    """Returns the intervals, s, in which a vehicle turns to a heading that was set in one jump.

    They overlap if the heading is set again during a turn.

    Args:
        setpoint: setpoint of yaw in one boot, rad, unwrapped.
    """
    yaw = setpoint.values
    # The change from each sample to the next; after the last sample there is none.
    changes = np.abs(np.diff(yaw, append=yaw[-1:]))
    is_jump = changes > YAW_JUMP
    starts = setpoint.time[is_jump]
    ends = starts + changes[is_jump] / SLOWEST_TURN + TURN_MARGIN_SECONDS
    return list(zip(starts.tolist(), ends.tolist(), strict=True))


def _yaw_movement(setpoint: TimeSeries, segments: Segments) -> float:
    """Returns the movement of yaw's setpoint: the RMS of its change in ``YAW_MOVEMENT_SECONDS``.

    Args:
        setpoint: setpoint of yaw, rad, without jumps by a turn.
        segments: segments of the flight that are judged.

    Returns:
        The movement, rad.
    """
    # This zero makes the result 0, and not NaN, if no segment has a setpoint.
    changes = [np.zeros(1)]
    for segment in segments:
        is_in_segment = in_segments(setpoint, segment, slack=0)
        if not is_in_segment.any():
            continue
        time = setpoint.time[is_in_segment]
        yaw = setpoint.values[is_in_segment]
        changes.append(np.interp(time + YAW_MOVEMENT_SECONDS, time, yaw) - yaw)
    return float(np.sqrt(np.mean(np.square(np.concatenate(changes)))))


def _rate_error(signals: Signals, segments: Segments) -> float | None:
    """Returns the root-mean-square difference of the body rate from its setpoint.

    No delay is removed: a rate follows its setpoint within a few samples.

    Args:
        signals: logged time series of the vehicle, with angle, rate and setpoints of one axis.
        segments: segments of the flight that are judged.

    Returns:
        RMS difference, rad/s; None if rate or setpoint was not recorded in these segments.
    """
    rate_setpoint = _rate_setpoint(signals)
    if signals.attitude is None or rate_setpoint is None:
        return None
    no_delay = np.zeros(1)
    body_rate = signals.attitude.rate_series
    errors = _setpoint_errors(rate_setpoint, body_rate, segments, no_delay).errors
    return np.sqrt(np.mean(np.square(errors))) if errors.size else None


def _rate_setpoint(signals: Signals) -> TimeSeries | None:
    """Returns the setpoint of the body rate of an axis, (N,) rad/s; None if it was not recorded."""
    for setpoint in signals.setpoints:
        if setpoint.unit == "rad/s":
            return setpoint.signal
    return None


def _setpoint_errors(
    setpoint: TimeSeries, response: TimeSeries, segments: Segments, delays: Array
) -> SetpointErrors:
    """Returns the errors of a response that follows its setpoint after some delay, for each of several delays.

    Setpoint and response are compared at the samples of the slower one, and the other is interpolated. If both have the
    same rate, the setpoint is interpolated: interpolating the response would average neighbouring samples, and hide an
    oscillation at half of its sampling rate.

    Args:
        setpoint: setpoint in the unit of the response.
        response: angle, rad, or body rate, rad/s.
        segments: segments of the flight that are compared.
        delays: (D,) s.

    Returns:
        N setpoints in the segments with their times, and the errors of the response after each of the D delays.
    """
    times = [np.zeros(0)]
    setpoints = [np.zeros(0)]
    errors = [np.zeros((len(delays), 0))]
    for segment in segments:
        setpoint_in_segment = setpoint.select(in_segments(setpoint, segment, slack=0))
        # Stamps are rounded, so that samples at the ends of a segment may lie just outside it.
        response_in_segment = response.select(in_segments(response, segment))
        # One sample cannot be interpolated.
        if len(response_in_segment.time) <= 1:
            continue
        segment_errors = _errors_in_segment(setpoint_in_segment, response_in_segment, delays)
        times.append(segment_errors.times)
        setpoints.append(segment_errors.setpoints)
        errors.append(segment_errors.errors)
    return SetpointErrors(
        np.concatenate(times), np.concatenate(setpoints), np.concatenate(errors, axis=1)
    )


def _errors_in_segment(setpoint: TimeSeries, response: TimeSeries, delays: Array) -> SetpointErrors:
    """Returns the errors of a response in one segment, at the samples of the slower of setpoint and response.

    Args:
        setpoint: setpoint in the unit of the response.
        response: angle, rad, or body rate, rad/s; at least two samples.
        delays: (D,) s, by which the response is compared with an earlier setpoint.

    Returns:
        The setpoints (N,) at the N samples with their times, and the errors (D, N) of the responses for each delay.
    """
    if len(setpoint.time) >= len(response.time):
        # The response is the slower one: each of its samples is compared with the setpoint a delay before, (D, N).
        times_of_setpoints = response.time - delays[:, None]
        delayed_setpoints = np.interp(times_of_setpoints, setpoint.time, setpoint.values)
        setpoints = np.interp(response.time, setpoint.time, setpoint.values)
        errors = response.values - delayed_setpoints
        return SetpointErrors(response.time, setpoints, errors)
    # The setpoint is the slower one: each of its samples is compared with the response a delay after it, (D, N).
    times_of_responses = setpoint.time + delays[:, None]
    delayed_responses = np.interp(times_of_responses, response.time, response.values)
    errors = delayed_responses - setpoint.values
    return SetpointErrors(setpoint.time, setpoint.values, errors)


def attitude_gain(
    setpoint: TimeSeries, angle: TimeSeries, segments: Segments
) -> AttitudeGain | None:
    """Returns the gain |T| from the setpoint of an angle to the angle, from Welch spectra.

    Only frequencies are used at which the setpoint has at least ``MIN_PEAK_DRIVER_FRACTION`` of its largest power, and
    the angle is coherent with it (``MIN_COMPARED_COHERENCE``). At others the ratio is determined by wind and noise.

    Args:
        setpoint: setpoint of the angle, rad.
        angle: the response, rad.
        segments: segments of the flight that are judged.

    Returns:
        The gain; None if the setpoint moves at no frequency at which the angle is coherent with it.
    """
    estimate = welch_spectra((setpoint, angle), segments, 2 * WELCH_SECONDS, MIN_SLOW_MOTION_RATE)
    if estimate is None:
        return None
    is_above_zero = estimate.frequency > 0
    setpoint_power = np.where(is_above_zero, estimate.driver_power, 0.0)
    is_excited = setpoint_power >= MIN_PEAK_DRIVER_FRACTION * setpoint_power.max()
    is_coherent = estimate.coherence >= MIN_COMPARED_COHERENCE
    is_usable = is_above_zero & is_excited & is_coherent
    if not is_usable.any():
        return None
    return AttitudeGain(
        frequency=estimate.frequency[is_usable],
        gain=abs(estimate.response[is_usable]),
        coherence=estimate.coherence[is_usable],
        windows=estimate.windows,
    )
