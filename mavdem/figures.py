"""Figures: what is measured of a log and of one stretch of its settled flight, for the verdict to weigh."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.signal import welch

from mavdem import phases
from mavdem.align import Segment, flight_of, mean_rate, sample, slow, usual_rate, within
from mavdem.ingest.meaning import Attitude, Motors
from mavdem.intervals import Interval, Intervals, both, total
from mavdem.telemetry import Telemetry

CONSISTENCY_SPAN = 0.2
"""Seconds: one period of 5 Hz, so that sensor noise averages out and roll dynamics do not."""

WILD = 0.01
"""Share of those spans, the worst explained, that the consistency leaves out, and at least as many as one sample is in:
it is about the whole, and a single odd sample must not speak for it."""

HELD = 1.5
"""Quantisation steps by which a value that had stood still for a message or more usually changes when it does, if it
was held. One that only moves less than a step goes on by one step."""

_FULL, _IDLE = 0.99, 0.15
"""Shares of the motors' range: at full throttle, and at the idle below which autopilots let no motor fall in flight."""


@dataclass(frozen=True)
class Figures:
    """What was measured on one segment; None where it could not be. In s, Hz, rad, rad/s, units of the stream.

    Attributes:
        armed, airborne: seconds over all boots.
        segments: settled stretches found.
        duration, samples, dt: of the segment, aligned.
        attitude_rate, motor_rate: mean messages a second.
        attitude_fresh, motor_fresh: new values a second; less than the rate where old ones are sent again under new
            stamps, but not where they stand still because they are rounded.
        attitude_jitter, motor_jitter: standard deviation of the steps between messages.
        attitude_gap, motor_gap: the longest step.
        angle_sd, rate_sd: standard deviations of the outputs.
        angle_step, rate_step: quantisation steps of the outputs, as sent.
        output_snr: variance of the changes of angle or rate over 0.2 s, rounding taken off, over the variance that
            rounding alone gives them; of whichever is less.
        input_sd: standard deviation of the motors' combination that turns the axis (of one motor against the others
            where their places are unknown).
        input_step: quantisation step of the motor outputs.
        input_snr: variance of that combination, rounding taken off, over the variance that rounding alone gives it.
        saturation: share of samples with a motor at its limit.
        upper_band: share of the rate's variance above half the Nyquist frequency.
        consistency: share of the angle's changes over 0.2 s explained by the integrated rates, in the stream or in the
            flight made of it, whichever is less; can be far below 0.
    """

    armed: float = 0.0
    airborne: float = 0.0
    segments: int = 0
    duration: float | None = None
    samples: int | None = None
    dt: float | None = None
    attitude_rate: float | None = None
    motor_rate: float | None = None
    attitude_fresh: float | None = None
    motor_fresh: float | None = None
    attitude_jitter: float | None = None
    motor_jitter: float | None = None
    attitude_gap: float | None = None
    motor_gap: float | None = None
    angle_sd: float | None = None
    rate_sd: float | None = None
    angle_step: float | None = None
    rate_step: float | None = None
    output_snr: float | None = None
    input_sd: float | None = None
    input_step: float | None = None
    input_snr: float | None = None
    saturation: float | None = None
    upper_band: float | None = None
    consistency: float | None = None


def of_log(telemetry: Telemetry, attitude: Attitude, motors: Motors, found: int) -> Figures:
    """The figures of the whole log, which has ``found`` segments; its rates are those between outages."""
    armed = airborne = 0.0
    told = phases.Told.by(telemetry)
    for boot in np.intersect1d(attitude.boot, motors.boot):
        recorded = _recorded(motors, boot)
        armed += total(both(recorded, phases.armed(told, boot)))
        airborne += total(_flown(recorded, told, boot))
    return Figures(
        armed, airborne, found, attitude_rate=usual_rate(attitude) or None, motor_rate=usual_rate(motors) or None
    )


class Slow(NamedTuple):
    """Where a stream came too slowly in the air.

    Attributes:
        seconds: in all.
        rate: messages a second in them.
        boot, start: where it began, s.
    """

    seconds: float
    rate: float
    boot: int
    start: float


def slow_in_air(telemetry: Telemetry, stream: Attitude | Motors, motors: Motors) -> Slow | None:
    """Where a stream usually came slower than ``MINIMUM_RATE`` in the air; None where it nowhere did.

    Args:
        telemetry: of one vehicle.
        stream: its attitude or motors.
        motors: of which ``airborne`` is measured too.
    """
    told = phases.Told.by(telemetry)
    found: list[tuple[int, Interval]] = []
    messages = 0
    for boot in np.intersect1d(stream.boot, motors.boot):
        time = stream.time[stream.boot == boot]
        for start, end in both(slow(time), _flown(_recorded(motors, boot), told, boot)):
            found.append((int(boot), (start, end)))
            messages += int(np.count_nonzero((time > start) & (time <= end)))
    if not found:
        return None
    seconds = total([interval for _, interval in found])
    boot, (start, _) = found[0]
    return Slow(seconds, messages / seconds, boot, start)


def _recorded(motors: Motors, boot: int) -> Intervals:
    time = motors.time[motors.boot == boot]
    return [(float(time[0]), float(time[-1]))]


def _flown(recorded: Intervals, told: phases.Told, boot: int) -> Intervals:
    return both(both(recorded, phases.armed(told, boot)), phases.airborne(told, boot))


def of_segment(
    telemetry: Telemetry, attitude: Attitude, motors: Motors, segment: Segment, axis: str, log: Figures
) -> Figures:
    """The figures of one segment, together with those ``of_log`` that hold for all."""
    flight = flight_of(telemetry, attitude, motors, segment, axis)
    here, there = within(attitude, segment), within(motors, segment)
    time, angle, slope = attitude.time[here], attitude.angle[here], attitude.slope[here]
    flown_slope, _ = sample(flight.time, flight.dt, time, slope[:, None])
    flown_angle, flown_rate = flight.outputs.T
    consistencies = [_consistency(time, angle, slope), _consistency(flight.time, flown_angle, flown_slope[:, 0])]
    attitude_steps, motor_steps = np.diff(time), np.diff(motors.time[there])
    motion = np.column_stack([angle, attitude.rate[here]])
    steps = np.array([_step(column) for column in motion.T])
    output_snrs = [_snr_of_changes(time, column, step) for column, step in zip(motion.T, steps, strict=True)]
    combination, rounding = _turning(motors, flight.inputs, axis)
    share = motors.scale.fraction(flight.inputs)
    return replace(
        log,
        duration=flight.duration,
        samples=len(flight),
        dt=flight.dt,
        attitude_rate=mean_rate(time),
        motor_rate=mean_rate(motors.time[there]),
        attitude_fresh=_fresh_rate(time, motion, steps),
        motor_fresh=_fresh_rate(motors.time[there], motors.outputs[there], motors.scale.step),
        attitude_jitter=float(attitude_steps.std()),
        motor_jitter=float(motor_steps.std()),
        attitude_gap=float(attitude_steps.max()),
        motor_gap=float(motor_steps.max()),
        angle_sd=float(flown_angle.std()),
        rate_sd=float(flown_rate.std()),
        angle_step=float(steps[0]),
        rate_step=float(steps[1]),
        output_snr=min((snr for snr in output_snrs if snr is not None), default=None),
        input_sd=float(combination.std()),
        input_step=motors.scale.step,
        input_snr=float(combination.var() / rounding**2) - 1 if rounding > 0 else None,
        saturation=float(np.mean(((share >= _FULL) | (share <= _IDLE)).any(axis=1))),
        upper_band=_upper_band(flown_rate, flight.dt),
        consistency=min((share for share in consistencies if share is not None), default=None),
    )


def _turning(motors: Motors, inputs: NDArray[np.float64], axis: str) -> tuple[NDArray[np.float64], float]:
    """The motors' combination (T,) that turns the axis, and the standard deviation that rounding alone gives it."""
    weights = motors.layout.effect(axis)
    if weights is None:
        differences = inputs - inputs.mean(axis=1, keepdims=True)
        return differences[:, np.argmax(differences.std(axis=0))], motors.scale.step / 12**0.5
    return inputs @ weights, motors.scale.step * float(np.sqrt((weights**2).sum() / 12))


def _step(values: NDArray[np.float64]) -> float:
    """The quantisation step: the median difference between neighbouring values of those seen, 0 for a constant.

    A few values between the steps do not change the median. Of values that are not rounded it is next to nothing.
    """
    distinct = np.unique(values)
    return float(np.median(np.diff(distinct))) if len(distinct) > 1 else 0.0


def _snr_of_changes(time: NDArray[np.float64], values: NDArray[np.float64], step: float) -> float | None:
    """Of the changes, not the values: it is by them that the dynamics show, and both ends of each are rounded."""
    starts = time <= time[-1] - CONSISTENCY_SPAN
    change = np.interp(time[starts] + CONSISTENCY_SPAN, time, values) - values[starts]
    rounding = step**2 / 6
    return float(change.var()) / rounding - 1 if rounding > 0 and len(change) else None


def _fresh_rate(time: NDArray[np.float64], rows: NDArray[np.float64], step: NDArray[np.float64] | float) -> float:
    """Rows (N, k) a second that are not the one before them sent again; ``step`` (k,): of which they are multiples."""
    rate, changes = mean_rate(time), np.abs(np.diff(rows, axis=0))
    changed = np.asarray((changes > 0).any(axis=1))
    after_standstill = changes[1:][changed[1:] & ~changed[:-1]]
    if not len(after_standstill):
        return rate
    steps = np.where(np.asarray(step) > 0, step, np.inf)
    held = float(np.median((after_standstill / steps).max(axis=1))) > HELD
    return float(np.count_nonzero(changed)) / len(changed) * rate if held else rate


def _upper_band(rate: NDArray[np.float64], dt: float) -> float | None:
    frequency, power = welch(rate, 1 / dt, nperseg=min(256, len(rate)), detrend="constant")
    total = float(power.sum())
    return float(power[frequency > frequency[-1] / 2].sum()) / total if total > 0 else None


def _consistency(time: NDArray[np.float64], angle: NDArray[np.float64], slope: NDArray[np.float64]) -> float | None:
    """1 − var(Δangle − ∫slope)/var(Δangle) over spans of ``CONSISTENCY_SPAN`` from every sample but ``WILD`` ones."""
    turned = cumulative_trapezoid(slope, time, initial=0)
    starts = time <= time[-1] - CONSISTENCY_SPAN
    later = time[starts] + CONSISTENCY_SPAN
    change = np.interp(later, time, angle) - angle[starts]
    unexplained = change - (np.interp(later, time, turned) - turned[starts])
    off = np.abs(unexplained - np.median(unexplained)) if len(unexplained) else unexplained
    wild = max(round(WILD * len(off)), int(np.count_nonzero(time <= time[0] + CONSISTENCY_SPAN)))
    usual = np.argsort(off)[: max(len(off) - wild, 0)]
    change, unexplained = change[usual], unexplained[usual]
    variance = float(change.var()) if len(change) else 0.0
    return 1 - float(unexplained.var()) / variance if variance > 0 else None
