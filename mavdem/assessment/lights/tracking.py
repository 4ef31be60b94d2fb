"""Tracking: how the axes follow what was asked of them, at any rate, and the light on roll and pitch."""

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment.evidence import INJECTED, Evidence
from mavdem.assessment.lights.limits import Limits, worst
from mavdem.confidence import MIN_SAMPLES_FOR_STATISTICS
from mavdem.dataset.axes import AXES, TILT_AXES
from mavdem.dataset.segments import Segments, in_segments
from mavdem.dataset.signals import MIN_SLOW_MOTION_RATE, Signals
from mavdem.dataset.time_series import TimeSeries
from mavdem.facts import Fact, Level, NamedFacts
from mavdem.facts.margins import TrackingLight
from mavdem.loops.measured_response import MIN_COMPARED_COHERENCE
from mavdem.loops.welch import WELCH_SECONDS, welch_spectra

DELAYS = np.arange(0.0, 0.62, 0.02)
"""s, that are tried: a multirotor is behind by 0.1 to 0.4, and what was sent less often comes later."""
ERROR = Limits(np.radians(3.0), np.radians(10.0))
"""rad, RMS without the delay: sound vehicles have up to 2.5°, and 4° in steps of 45°; ArduPilot's crash check begins at
30°. An error counts only where it is over half of what was asked, and is bad where it is larger than all of that: then
no answer at all would be better. So a stick that is moved on the ground is none."""
FREE_MODES = frozenset({"Acro", "Flip", "Throw", "Turtle"})
"""ArduPilot's modes in which the angle that is logged as asked for is none."""
STEERED = np.radians(2.0)  # rad, standard deviation of a setpoint that shows it
WATCHED_OVERSHOOT = 0.3
"""Of a step: that of a damping ratio of 0.36, for which the phase margin is about 36°."""


def tracking_light(evidence: Evidence) -> Fact:
    """Returns the light on tracking: the worse of roll and pitch, or what to log; never good of what oscillates."""
    axes = tracking_of(evidence)
    tilts = [axes[axis] for axis in TILT_AXES]
    rated = [fact for fact in tilts if fact.code is not TrackingLight.TRACKING_UNKNOWN]
    light = worst(
        sorted(rated or tilts[:1], key=lambda fact: -fact.figures.get("angle_error", 0.0))
    )
    if light.code is TrackingLight.OVERSHOOTS_SETPOINT:
        alike = [fact.figures["axis"] for fact in rated if fact.code is light.code]
        return light.but(names=alike)
    if evidence.condition.oscillation is not None and light.is_good:
        return light.but(Level.WATCH)
    return light


def tracking_of(evidence: Evidence) -> NamedFacts:
    """Returns how roll, pitch and yaw follow their setpoints in settled flight, by axis."""
    parts = evidence.settled(INJECTED | FREE_MODES)
    return {axis: _tracking(evidence.signals.for_axis(axis), parts) for axis in AXES}


def _tracking(signals: Signals, parts: Segments) -> Fact:
    """How one axis follows its setpoint, by the setpoint ``delay`` s before; or the error of its rate alone."""
    asked = signals.angle_setpoint
    rate_error = _rate_error(signals, parts)
    unknown = Fact(
        TrackingLight.TRACKING_UNKNOWN,
        axis=signals.axis,
        asked=asked is not None,
        recorder=signals.telemetry.translated_from,
        rate_error=rate_error,
    )
    if signals.attitude is None or asked is None:
        return unknown
    angle = signals.attitude.angle_series
    setpoint, errors = _errors(asked, angle, parts, DELAYS)
    if len(setpoint) < MIN_SAMPLES_FOR_STATISTICS:
        return unknown
    sizes = np.sqrt(np.mean(np.square(errors), axis=1))
    best = np.argmin(sizes)
    error = sizes[best]
    asked_for = setpoint.std()
    overshoot = _overshoot(asked, angle, parts) if asked_for > STEERED else None
    limits = Limits(max(ERROR.watch, asked_for / 2), max(ERROR.bad, asked_for))
    level = limits.level(error)
    code = TrackingLight.FOLLOWS_SETPOINT
    if level is not Level.GOOD:
        code = TrackingLight.MISSES_SETPOINT
    elif overshoot is not None and overshoot > WATCHED_OVERSHOOT:
        level = Level.WATCH
        code = TrackingLight.OVERSHOOTS_SETPOINT
    return Fact(
        code,
        level,
        axis=signals.axis,
        angle_error=error,
        offset_angle=np.mean(errors[best]),
        delay=DELAYS[best],
        overshoot=overshoot,
        rate_error=rate_error,
    )


def _rate_error(signals: Signals, parts: Segments) -> float | None:
    """RMS of the body rate less its setpoint, rad/s; None where that was not recorded."""
    setpoints = [setpoint.signal for setpoint in signals.setpoints if setpoint.unit == "rad/s"]
    if signals.attitude is None or not setpoints:
        return None
    _, errors = _errors(setpoints[0], signals.attitude.rate_series, parts, DELAYS[:1])
    return np.sqrt(np.mean(np.square(errors))) if errors.size else None


def _errors(
    asked: TimeSeries, seen: TimeSeries, parts: Segments, delays: Array
) -> tuple[Array, Array]:
    """Setpoints (N,) in the ``parts``, and how far what is seen after each of the ``delays`` (D,) is off (D, N)."""
    setpoints = [np.zeros(0)]
    errors = [np.zeros((len(delays), 0))]
    for part in parts:
        rows = in_segments(asked, part, slack=0)
        there = in_segments(seen, part)
        if np.count_nonzero(there) > 1:
            setpoints.append(asked.values[rows])
            later = asked.time[rows] + delays[:, None]
            delayed = np.interp(later, seen.time[there], seen.values[there])
            errors.append(delayed - setpoints[-1])
    return np.concatenate(setpoints), np.concatenate(errors, axis=1)


def _overshoot(asked: TimeSeries, angle: TimeSeries, parts: Segments) -> float | None:
    """That of the second-order system whose response has as large a peak as the measured one; None where none shows."""
    estimate = welch_spectra((asked, angle), parts, 2 * WELCH_SECONDS, MIN_SLOW_MOTION_RATE)
    if estimate is None or not (coherent := estimate.coherence >= MIN_COMPARED_COHERENCE).any():
        return None
    peak = abs(estimate.response[coherent]).max()
    if peak <= 1:
        return 0.0
    damping = np.sqrt((1 - np.sqrt(1 - peak**-2)) / 2)
    return np.exp(-np.pi * damping / np.sqrt(1 - damping**2))
