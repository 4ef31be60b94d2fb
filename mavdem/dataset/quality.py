"""Quality of a log and of one segment: rates, noise, resolution and consistency, as numbers."""

from dataclasses import dataclass, replace

import numpy as np

from mavdem.arrays import Array, Flags
from mavdem.dataset import phases
from mavdem.dataset.intervals import intersection, total_duration
from mavdem.dataset.resampling import mean_rate, resample
from mavdem.dataset.segments import Segment, in_segments, recorded_spans
from mavdem.dataset.signals import Signals, rate_between_outages
from mavdem.flight import Flight
from mavdem.ingest.output_scale import OutputScale
from mavdem.unit_errors import RATE_INTEGRATION_SPAN

OUTLIER_SHARE = 0.01
"""Share of those spans, the worst explained, that the consistency leaves out, and at least as many as one sample is in:
it is of the whole segment, and a single outlier must not decide it."""
HELD_STEPS = 1.5
"""Quantisation steps by which a value that had been constant for a message or more usually changes when it does, if it
was held. One that only moves less than a step goes on by one step."""
STOP_MARGIN = 0.01
"""Share of the range: how near to its upper stop (``OutputScale.stop``) a motor is at it."""


@dataclass(frozen=True)
class QualityFigures:
    """Measured on one segment; None where it could not be. In s, Hz, rad, rad/s, units of the stream."""

    armed: float = 0.0  # with airborne: seconds over all boots
    airborne: float = 0.0
    segments: int = 0  # of settled flight
    duration: float | None = None  # with samples, dt: of the segment, aligned
    samples: int | None = None
    dt: float | None = None
    attitude_rate: float | None = None  # with motor_rate: mean messages a second
    motor_rate: float | None = None
    # attitude_fresh and motor_fresh: new values a second; less than the rate where old ones are sent again under new
    # stamps, but not where they stand still because they are rounded
    attitude_fresh: float | None = None
    motor_fresh: float | None = None
    attitude_gap: float | None = None  # with motor_gap: the longest step between messages
    motor_gap: float | None = None
    angle_sd: float | None = None  # with rate_sd: standard deviations of the outputs
    rate_sd: float | None = None
    angle_step: float | None = None  # with rate_step: quantisation steps of the outputs, as sent
    rate_step: float | None = None
    # variance of the changes of angle or rate over 0.2 s, rounding taken off, over the variance that rounding alone
    # gives them; of whichever is less
    output_snr: float | None = None
    # standard deviation of the motors' combination that turns the axis (of one motor against the others where their
    # places are unknown)
    input_sd: float | None = None
    input_step: float | None = None  # quantisation step of the motor outputs
    # variance of that combination, rounding taken off, over the variance that rounding alone gives it
    input_snr: float | None = None
    saturation: float | None = None  # share of samples with a motor at its limit
    # share of the angle's changes over 0.2 s explained by the integrated rates, in the stream or in the flight made of
    # it, whichever is less; can be far below 0
    consistency: float | None = None


def log_quality(signals: Signals, segments: int) -> QualityFigures:
    """Returns the figures of a whole log with so many ``segments``; its rates are those between outages."""
    attitude, drive = signals.attitude_and_inputs
    armed = sum(
        total_duration(
            intersection([(part.start, part.end)], phases.armed_intervals(signals, part.boot))
        )
        for part in recorded_spans(signals)
    )
    airborne = 0.0
    for boot in np.intersect1d(attitude.boot, drive.boot):
        driven = drive.time[drive.boot == boot]
        airborne += total_duration(
            intersection(
                [(driven[0], driven[-1])], phases.free_flight_intervals(signals, int(boot))
            )
        )
    return QualityFigures(
        armed,
        airborne,
        segments,
        attitude_rate=rate_between_outages(attitude) or None,
        motor_rate=rate_between_outages(drive) or None,
    )


def segment_quality(
    signals: Signals, segment: Segment, flight: Flight, log: QualityFigures
) -> QualityFigures:
    """Returns the figures of one segment and the flight made of it, with those of the ``log`` that hold for all."""
    attitude, motors = signals.attitude_and_inputs
    here = in_segments(attitude, segment)
    there = in_segments(motors, segment)
    time = attitude.time[here]
    angle = attitude.angle[here]
    slope = attitude.euler_rate[here]
    flown, _ = resample(flight.time, flight.dt, time, np.column_stack([angle, slope]))
    flown_angle, flown_slope, flown_rate = *flown.T, flight.outputs[:, -1]
    consistencies = [
        _consistency(time, angle, slope),
        _consistency(flight.time, flown_angle, flown_slope),
    ]
    motion = np.column_stack([angle, attitude.rate[here]])
    steps = np.array([_step(column) for column in motion.T])
    measured = slice(-flight.outputs.shape[1], None)  # not the angle of yaw
    stepped = zip(motion.T[measured], steps[measured], strict=True)
    output_snrs = [_snr_of_changes(time, column, step) for column, step in stepped]
    # The motors' combination (T,) that turns the axis, and the standard deviation that rounding alone gives it.
    if (weights := motors.geometry.mixer_row(signals.axis)) is not None:
        combination = flight.inputs @ weights
        rounding = motors.scale.step * np.sqrt((weights**2).sum() / 12)
    else:
        differences = flight.inputs - flight.inputs.mean(axis=1, keepdims=True)
        combination = differences[:, np.argmax(differences.std(axis=0))]
        rounding = motors.scale.step / 12**0.5
    limited = np.logical_or(*samples_at_limits(motors.scale.fraction(flight.inputs), motors.scale))
    return replace(
        log,
        duration=flight.duration,
        samples=len(flight),
        dt=flight.dt,
        attitude_rate=mean_rate(time),
        motor_rate=mean_rate(motors.time[there]),
        attitude_fresh=_fresh_rate(time, motion[:, measured], steps[measured]),
        motor_fresh=_fresh_rate(motors.time[there], motors.outputs[there], motors.scale.step),
        attitude_gap=np.diff(time).max(),
        motor_gap=np.diff(motors.time[there]).max(),
        angle_sd=flown_angle.std(),
        rate_sd=flown_rate.std(),
        angle_step=steps[0],
        rate_step=steps[1],
        output_snr=min((snr for snr in output_snrs if snr is not None), default=None),
        input_sd=combination.std(),
        input_step=motors.scale.step,
        input_snr=(combination.var() / rounding**2) - 1 if rounding > 0 else None,
        saturation=limited.any(axis=1).mean(),
        consistency=min((share for share in consistencies if share is not None), default=None),
    )


def _step(values: Array) -> float:
    """The quantisation step: the median difference between neighbouring values; next to nothing where not rounded."""
    distinct = np.unique(values)
    return float(np.median(np.diff(distinct))) if len(distinct) > 1 else 0.0


def samples_at_limits(shares: Array, scale: OutputScale) -> tuple[Flags, Flags]:
    """Returns where motors are at the upper stop of their ``scale``, and where they idle, shaped like ``shares``."""
    return shares >= scale.stop - STOP_MARGIN, shares <= phases.MAX_IDLE_COLLECTIVE


def _snr_of_changes(time: Array, values: Array, step: float) -> float | None:
    """Of the changes, not the values: it is by them that the dynamics show, and both ends of each are rounded."""
    starts = time <= time[-1] - RATE_INTEGRATION_SPAN
    change = np.interp(time[starts] + RATE_INTEGRATION_SPAN, time, values) - values[starts]
    rounding = step**2 / 6
    return change.var() / rounding - 1 if rounding > 0 and len(change) else None


def _fresh_rate(time: Array, rows: Array, step: Array | float) -> float:
    """Rows (N, k) a second that are not the one before them sent again; ``step`` (k,): of which they are multiples."""
    rate = mean_rate(time)
    changes = abs(np.diff(rows, axis=0))
    changed = np.asarray((changes > 0).any(axis=1))
    after_standstill = changes[1:][changed[1:] & ~changed[:-1]]
    if not len(after_standstill):
        return rate
    steps = np.where(np.asarray(step) > 0, step, np.inf)
    held = np.median((after_standstill / steps).max(axis=1)) > HELD_STEPS
    return np.count_nonzero(changed) / len(changed) * rate if held else rate


def _consistency(time: Array, angle: Array, slope: Array) -> float | None:
    """1 − var(Δangle − ∫slope)/var(Δangle) over ``RATE_INTEGRATION_SPAN``, without the worst ``OUTLIER_SHARE``."""
    turned = np.concatenate([[0.0], np.cumsum(np.diff(time) * (slope[1:] + slope[:-1]) / 2)])
    starts = time <= time[-1] - RATE_INTEGRATION_SPAN
    later = time[starts] + RATE_INTEGRATION_SPAN
    change = np.interp(later, time, angle) - angle[starts]
    unexplained = change - (np.interp(later, time, turned) - turned[starts])
    off = abs(unexplained - np.median(unexplained)) if len(unexplained) else unexplained
    wild = max(
        round(OUTLIER_SHARE * len(off)),
        int(np.count_nonzero(time <= time[0] + RATE_INTEGRATION_SPAN)),
    )
    usual = np.argsort(off)[: max(len(off) - wild, 0)]
    change = change[usual]
    unexplained = unexplained[usual]
    variance = change.var() if len(change) else 0.0
    return 1 - unexplained.var() / variance if variance > 0 else None
