"""Quality of a log and of a segment: rates, noise, resolution and consistency of attitude and model inputs."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array, Flags
from mavdem.dataset import flight_states, phases
from mavdem.dataset.axes import TILT_AXES
from mavdem.dataset.intervals import intersection, total_duration
from mavdem.dataset.resampling import mean_rate, resample
from mavdem.dataset.segments import Segment, recorded_spans, rows_of_segment
from mavdem.dataset.signals import Signals, rate_between_outages
from mavdem.dataset.time_series import rows_of_boot
from mavdem.flight import Flight
from mavdem.ingest.output_scale import UNKNOWN_SCALE, OutputScale
from mavdem.unit_errors import RATE_INTEGRATION_SPAN

OUTLIER_SHARE = 0.01
"""Share of all spans, those explained worst, that the consistency leaves out; at least those that hold one sample.

The consistency is that of a whole segment, and a single outlier must not decide it. A choice.
"""

MIN_HELD_CHANGE_STEPS = 1.5
"""Change of a value after it stood still, in quantisation steps, from which it was sent again and not merely rounded.

A value that moves by less than a step per message goes on by a single step.
"""

LIMIT_MARGIN = 0.01
"""Distance from its upper or lower limit, as a fraction of the range, within which a motor is there; a choice."""

ROUNDING_VARIANCE_DIVISOR = 12
"""The variance of rounding to steps of size q is q² / 12, that of a uniform distribution."""


@dataclass(frozen=True)
class QualityFigures:
    """The quality of a segment and of its log; a value is None if it could not be measured."""

    armed: float = 0.0
    """Seconds that the vehicle was armed in the whole log."""
    airborne: float = 0.0
    """Seconds that it flew in the whole log."""
    segments: int = 0
    """Number of segments of settled flight in the log."""
    duration: float | None = None
    """Duration of the aligned segment, s."""
    samples: int | None = None
    """Number of samples of the aligned segment."""
    dt: float | None = None
    """Sampling step of the aligned segment, s."""
    attitude_rate: float | None = None
    """Mean rate of attitude messages, Hz."""
    motor_rate: float | None = None
    """Mean rate of messages with model inputs, Hz."""
    attitude_fresh: float | None = None
    """Rate of new attitudes, Hz: less than ``attitude_rate`` where old ones are sent again under new stamps.

    Values that stand still only because they are rounded count as new.
    """
    motor_fresh: float | None = None
    """Rate of new model inputs, Hz, in the same sense."""
    attitude_gap: float | None = None
    """Longest step between attitude messages, s."""
    motor_gap: float | None = None
    """Longest step between messages with model inputs, s."""
    angle_sd: float | None = None
    """Standard deviation of the Euler angle, rad."""
    rate_sd: float | None = None
    """Standard deviation of the body rate, rad/s."""
    angle_step: float | None = None
    """Quantisation step of the Euler angle as sent, rad."""
    rate_step: float | None = None
    """Quantisation step of the body rate as sent, rad/s."""
    output_snr: float | None = None
    """Signal-to-noise ratio of the changes of angle or rate over 0.2 s, the lower of the two.

    The noise comes from rounding: variance without it over the variance that it gives.
    """
    input_sd: float | None = None
    """Standard deviation of the motors' torque command about the axis, in the unit of the outputs.

    Where the motors' positions are not known, the command of one motor against the mean of all.
    """
    input_step: float | None = None
    """Quantisation step of the model inputs."""
    input_snr: float | None = None
    """Signal-to-noise ratio of the torque command; the noise comes from rounding."""
    saturation: float | None = None
    """Share of samples with a motor at one of its limits."""
    consistency: float | None = None
    """Share of the angle's changes over 0.2 s that the integrated rates explain; it can be far below 0.

    The lower of two: of the messages, and of the flight that was aligned from them.
    """


def log_quality(signals: Signals, segments: int) -> QualityFigures:
    """Measures a whole log with attitude and model inputs: how long it is armed and flies, and at which rates.

    Args:
        signals: Signals of the vehicle, with attitude and model inputs.
        segments: Number of the log's segments of settled flight, without climb-out, landing and gaps.

    Returns:
        The quality of the log: times in s, rates in Hz, those between outages.
    """
    attitude, inputs = signals.attitude_and_inputs
    armed_seconds = 0.0
    for span in recorded_spans(signals):
        armed_intervals = flight_states.armed_intervals(signals, span.boot)
        recorded_intervals = intersection([(span.start, span.end)], armed_intervals)
        armed_seconds += total_duration(recorded_intervals)
    airborne_seconds = 0.0
    for boot in np.intersect1d(attitude.boot, inputs.boot):
        # The time in the air counts up to the end of the longer of the two streams: if one ends early, that is no
        # landing.
        attitude_time = attitude.time[rows_of_boot(attitude.boot, boot)]
        input_time = inputs.time[rows_of_boot(inputs.boot, boot)]
        recorded_start = min(attitude_time[0], input_time[0])
        recorded_end = max(attitude_time[-1], input_time[-1])
        flights = phases.free_flight_intervals(signals, int(boot))
        airborne_seconds += total_duration(intersection([(recorded_start, recorded_end)], flights))
    return QualityFigures(
        armed=armed_seconds,
        airborne=airborne_seconds,
        segments=segments,
        attitude_rate=rate_between_outages(attitude) or None,
        motor_rate=rate_between_outages(inputs) or None,
    )


def segment_quality(
    signals: Signals, segment: Segment, flight: Flight, quality_of_log: QualityFigures
) -> QualityFigures:
    """Measures one segment.

    Args:
        signals: Signals with attitude and model inputs.
        segment: The segment.
        flight: The segment, aligned.
        quality_of_log: Quality of the whole log: its armed and airborne time and number of segments are kept.

    Returns:
        The quality of the log, with that of the segment added.
    """
    attitude, inputs = signals.attitude_and_inputs
    attitude_rows = rows_of_segment(attitude, segment)
    time = attitude.time[attitude_rows]
    angle = attitude.angle[attitude_rows]
    rate = attitude.rate[attitude_rows]
    euler_rate = attitude.euler_rate[attitude_rows]
    angle_step = _quantisation_step(angle)
    rate_step = _quantisation_step(rate)

    # The angle of yaw is no output of a model.
    measured_outputs = [angle, rate] if signals.axis in TILT_AXES else [rate]
    steps = [angle_step, rate_step] if signals.axis in TILT_AXES else [rate_step]
    output_snrs = [
        _snr_of_changes(time, values, step)
        for values, step in zip(measured_outputs, steps, strict=True)
    ]

    motion = np.column_stack([angle, euler_rate])
    aligned_motion = resample(flight.time, flight.dt, time, motion).values
    aligned_angle, aligned_euler_rate = aligned_motion.T
    consistencies = [
        _rate_consistency(time, angle, euler_rate),
        _rate_consistency(flight.time, aligned_angle, aligned_euler_rate),
    ]

    input_rows = rows_of_segment(inputs, segment)
    input_time = inputs.time[input_rows]
    command = _torque_command(signals, flight)
    input_snr = None
    if command.rounding_sd > 0:
        input_snr = (command.values.var() / command.rounding_sd**2) - 1
    is_at_upper, is_at_lower = samples_at_limits(inputs.scale.fraction(flight.inputs), inputs.scale)
    return replace(
        quality_of_log,
        duration=flight.duration,
        samples=len(flight),
        dt=flight.dt,
        attitude_rate=mean_rate(time),
        motor_rate=mean_rate(input_time),
        attitude_fresh=_fresh_rate(time, np.column_stack(measured_outputs), np.array(steps)),
        motor_fresh=_fresh_rate(input_time, inputs.outputs[input_rows], inputs.scale.step),
        attitude_gap=np.diff(time).max(),
        motor_gap=np.diff(input_time).max(),
        angle_sd=aligned_angle.std(),
        rate_sd=flight.outputs[:, -1].std(),
        angle_step=angle_step,
        rate_step=rate_step,
        output_snr=_lowest(output_snrs),
        input_sd=command.values.std(),
        input_step=inputs.scale.step,
        input_snr=input_snr,
        saturation=(is_at_upper | is_at_lower).any(axis=1).mean(),
        consistency=_lowest(consistencies),
    )


class LimitFlags(NamedTuple):
    """In which samples each motor is at a limit of its range."""

    at_upper: Flags
    """At the upper limit, where it cannot give more."""

    at_lower: Flags
    """At the lower limit, where it cannot give less."""


def samples_at_limits(fractions: Array, scale: OutputScale) -> LimitFlags:
    """Returns flags of the samples in which each motor is at the upper or the lower limit that the autopilot sets.

    The upper limit is ``scale.upper_limit`` (of ArduPilot, MOT_SPIN_MAX), the lower one ``scale.lower_limit``
    (MOT_SPIN_MIN).

    Args:
        fractions: Motor outputs as fractions of the range, of any shape.
        scale: Their scale, with both limits as fractions of the range.

    Returns:
        Flags with the shape of ``fractions``, for the upper and for the lower limit. They are all false if the range of
        the outputs is not known.
    """
    is_range_known = scale.name != UNKNOWN_SCALE
    is_at_upper = is_range_known & (fractions >= scale.upper_limit - LIMIT_MARGIN)
    is_at_lower = is_range_known & (fractions <= scale.lower_limit + LIMIT_MARGIN)
    return LimitFlags(is_at_upper, is_at_lower)


def _lowest(values: list[float | None]) -> float | None:
    """Returns the lowest of several values, without those that could not be measured (None); None if none could."""
    return min((value for value in values if value is not None), default=None)


class _TorqueCommand(NamedTuple):
    """The motors' command about an axis."""

    values: Array
    """(T,) command, in the unit of the outputs."""
    rounding_sd: float
    """Standard deviation that rounding of the outputs alone gives it."""


def _torque_command(signals: Signals, flight: Flight) -> _TorqueCommand:
    """Combines the inputs of a flight to the torque command about its axis, and computes the rounding error in it.

    Both are needed to judge whether the command is lost in the rounding of the recorded motor outputs.

    The command is the combination of the motors by the mixer row of the axis. If the positions of the motors are not
    known, the deviations of the motors from their mean are computed instead, and the one that varies most is used.

    Rounding to a step q makes a uniform error of variance q²/12 in each input. The variances of several motors add up,
    each multiplied by the square of its weight.

    Args:
        signals: logged time series of the vehicle, with angle, rate and setpoints of one axis.
        flight: T samples of the r inputs.

    Returns:
        Command (T,) in the unit of the inputs, and the standard deviation of its rounding error.
    """
    _, motors = signals.attitude_and_inputs
    mixer_row = motors.geometry.mixer_row(signals.axis)
    if mixer_row is None:
        deviations = flight.inputs - flight.inputs.mean(axis=1, keepdims=True)
        most_active_motor = np.argmax(deviations.std(axis=0))
        rounding_sd = motors.scale.step / ROUNDING_VARIANCE_DIVISOR**0.5
        return _TorqueCommand(deviations[:, most_active_motor], rounding_sd)
    command = flight.inputs @ mixer_row
    sum_of_square_weights = (mixer_row**2).sum()
    rounding_gain = np.sqrt(sum_of_square_weights / ROUNDING_VARIANCE_DIVISOR)
    return _TorqueCommand(command, motors.scale.step * rounding_gain)


def _quantisation_step(values: Array) -> float:
    """Estimates the step of the numbers to which a logged quantity was rounded.

    It is the median difference between neighbouring distinct values. If values are not rounded, the difference only
    reflects how densely they lie, so that the step is close to 0.

    Args:
        values: (N,) samples of the quantity.

    Returns:
        The step, in the unit of the values; 0 if all values are equal.
    """
    distinct = np.unique(values)
    return float(np.median(np.diff(distinct))) if len(distinct) > 1 else 0.0


def _snr_of_changes(time: Array, values: Array, step: float) -> float | None:
    """Estimates the signal-to-noise ratio of the changes of a rounded quantity over ``RATE_INTEGRATION_SPAN``.

    Changes and not values are compared, since the dynamics show in the changes. Both ends of a change are rounded, so
    the noise has twice the variance q²/12 of rounding to a step q.

    Args:
        time: (N,) stamps, s.
        values: (N,) values.
        step: quantisation step of the values, in their unit.

    Returns:
        Ratio of variances; None for values that are not rounded or too short a record.
    """
    # A change begins at each sample that is at least the span before the end of the record.
    is_start = time <= time[-1] - RATE_INTEGRATION_SPAN
    end_values = np.interp(time[is_start] + RATE_INTEGRATION_SPAN, time, values)
    changes = end_values - values[is_start]
    rounding_variance = step**2 / (ROUNDING_VARIANCE_DIVISOR / 2)
    if rounding_variance > 0 and len(changes):
        # The variance of rounded changes is the signal's variance plus the variance of rounding.
        return changes.var() / rounding_variance - 1
    return None


def _fresh_rate(time: Array, rows: Array, steps: Array | float) -> float:
    """Estimates how many messages per second have new values, instead of repeating the values before them.

    An unchanged value is either a repetition of the last measurement, or a new measurement that was rounded to the same
    value. At the next change, a repeated value jumps by several quantisation steps, a rounded one by a single step.

    Args:
        time: (N,) stamps, s.
        rows: (N, k) values of k quantities.
        steps: (k,) quantisation steps of the quantities, or one step of all; 0 for a quantity that is not rounded.

    Returns:
        Rate of new values, Hz; the rate of the messages if no values are repeated.
    """
    rate = mean_rate(time)
    changes = abs(np.diff(rows, axis=0))
    has_changed = np.asarray((changes > 0).any(axis=1))
    changes_after_standstill = changes[1:][has_changed[1:] & ~has_changed[:-1]]
    if not len(changes_after_standstill):
        return rate
    # A quantity that is not rounded has no quantisation step, and its jumps count as 0 steps.
    divisors = np.where(np.asarray(steps) > 0, steps, np.inf)
    largest_jumps = (changes_after_standstill / divisors).max(axis=1)
    if np.median(largest_jumps) > MIN_HELD_CHANGE_STEPS:
        return np.count_nonzero(has_changed) / len(has_changed) * rate
    return rate


def _rate_consistency(time: Array, angle: Array, euler_rate: Array) -> float | None:
    """Computes which fraction of the angle's changes the integrated rate explains.

    It is 1 − var(Δangle − ∫rate) / var(Δangle), over spans of ``RATE_INTEGRATION_SPAN`` from each sample on. A few of
    these spans are left out, those that are explained worst (``OUTLIER_SHARE``), since a single wrong sample spoils all
    spans that contain it.

    Args:
        time: (N,) stamps, s.
        angle: (N,) Euler angle, rad.
        euler_rate: (N,) its derivative by the body rates, rad/s.

    Returns:
        The fraction, 1 at most; None if the angle does not change or the record is too short.
    """
    # The integral of the rate from the first sample on, by the trapezoidal rule.
    trapezia = np.diff(time) * (euler_rate[1:] + euler_rate[:-1]) / 2
    integral = np.concatenate([[0.0], np.cumsum(trapezia)])
    is_start_of_span = time <= time[-1] - RATE_INTEGRATION_SPAN
    span_ends = time[is_start_of_span] + RATE_INTEGRATION_SPAN
    angle_changes = np.interp(span_ends, time, angle) - angle[is_start_of_span]
    integral_changes = np.interp(span_ends, time, integral) - integral[is_start_of_span]
    if not len(angle_changes):
        return None
    unexplained_changes = angle_changes - integral_changes
    # At least as many spans are left out as contain the same sample.
    samples_per_span = int(np.count_nonzero(time <= time[0] + RATE_INTEGRATION_SPAN))
    outlier_count = max(round(OUTLIER_SHARE * len(angle_changes)), samples_per_span)
    usual_count = len(angle_changes) - outlier_count
    if usual_count <= 0:
        return None
    errors = abs(unexplained_changes - np.median(unexplained_changes))
    usual_spans = np.argsort(errors)[:usual_count]
    variance = angle_changes[usual_spans].var()
    if not variance > 0:
        return None
    return 1 - unexplained_changes[usual_spans].var() / variance
