"""Condition: what a log says of a vehicle at any rate: balance, limits, lean, vibration and battery.

Each mean comes with an interval that allows for the correlation of neighbouring samples. The error of a mean over T
seconds is decided by the slowest part of the series, below about 1/T. That part is estimated from the first cosines:
each of q projections of the series on √2 cos(π j t/T) has the mean's own variance, if the spectrum is flat up to
q/(2T). Their mean square is then its estimate, with q degrees of freedom.

References:
    E. Lazarus, D. J. Lewis, J. H. Stock and M. W. Watson, "HAR Inference: Recommendations for Practice", Journal of
    Business & Economic Statistics 36 (2018): the equal-weighted cosine estimator, and Student's t.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from scipy.fft import dct
from scipy.ndimage import median_filter

from mavdem.arrays import Array
from mavdem.confidence import half_width
from mavdem.containers import Names, Numbers
from mavdem.dataset import phases
from mavdem.dataset.axes import AXES, TILT_AXES
from mavdem.dataset.intervals import Intervals, intersection
from mavdem.dataset.phases import AVERAGING_SECONDS
from mavdem.dataset.segments import Segment, Segments, in_segments, recorded_spans, settled_segments
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import TimeSeries, clean_series, float_columns, recorded_series
from mavdem.errors import NotLearnable
from mavdem.immutable import ImmutableResult
from mavdem.ingest.motors import POSSIBLE_MULTIROTORS
from mavdem.loops.limit_cycles import Oscillation, detect_limit_cycle
from mavdem.motors.hover import HoverFigures, hover_of

FASTEST_COSINE = 0.05
"""Hz, of the fastest cosine: slower than gusts and the position loop, whose seconds are no mean of a flight."""
# Cosines; fewer than 4 make intervals that are mostly chance, more than 32 hardly change them
COSINES = (4, 32)
LEVELS = ("vibration_x", "vibration_y", "vibration_z")
CLIPS = ("clipping_0", "clipping_1", "clipping_2")


@dataclass(frozen=True)
class Steady:
    """The ``mean`` and the standard deviation ``sd`` of a quantity over settled flight.

    ``interval`` is the half width of the mean's 90 % interval, by the slow part of the series; None where too short.
    """

    mean: float
    interval: float | None
    sd: float


@dataclass(frozen=True)
class VibrationFigures:
    """The mean ``level`` of the first IMU's acceleration, m/s², and how often IMUs ``clip`` (were out of range).

    The level is x, y and z from ArduPilot, one for all axes from PX4, and not alike: compare flights of one autopilot.
    """

    level: Numbers
    clips: int


@dataclass(frozen=True)
class BatteryFigures:
    """The first battery over some time, V and A. None where it was not measured."""

    # with voltage_end: medians of the first and the last 2 s; the others are of all samples
    voltage_start: float
    voltage_end: float
    voltage_mean: float
    voltage_min: float
    current_mean: float | None = None
    current_max: float | None = None


@dataclass(frozen=True)
class Condition(ImmutableResult):
    """Figures that need no fast stream: means, spreads and limits. They hold for any rate from 1 Hz.

    All of them are of settled flight, but for the first two, and the battery where there was none. None where a figure
    was not recorded. ``duration`` is of the log over all boots, ``armed`` and ``settled`` of it, s.

    ``hover`` is what each motor does; ``share_interval`` the half widths of the 90 % intervals of its ``trim_share``,
    within this flight, not between flights. ``command`` is, for each axis known, the motors' combination that turns it,
    as a share of their range: what balances a shifted load, steady wind or a weak motor; positive to the right, nose
    up, nose to the right. ``lean`` is roll and pitch, ``tilt_mean``, ``tilt_sd`` and ``tilt_max`` are of the angle from
    level, rad. ``vibration``, ``battery``, and ``oscillation``, a limit cycle, are None where there is none.
    """

    duration: float
    armed: float | None = None
    settled: float = 0.0
    hover: HoverFigures | None = None
    share_interval: tuple[float | None, ...] = ()
    command: dict[str, Steady] = field(default_factory=dict)
    lean: dict[str, Steady] = field(default_factory=dict)
    tilt_mean: float | None = None
    tilt_sd: float | None = None
    tilt_max: float | None = None
    vibration: VibrationFigures | None = None
    battery: BatteryFigures | None = None
    oscillation: Oscillation | None = None

    @property
    def collective(self) -> float | None:
        """Mean of all motors, as a share of their range."""
        if self.hover is None:
            return None
        return float(np.mean(self.hover.trim_of_range))


def condition_of(signals: Signals) -> Condition:
    """Returns the condition of the vehicle of ``signals``, whatever they are for: it takes the motors' own messages."""
    signals = signals.about("roll", "motors") if signals.inputs != "motors" else signals
    span = recorded_spans(signals)
    settled = settled_parts(signals)
    try:
        hover = hover_of(signals)
    except NotLearnable:
        hover = None
    intervals, command = ((), {}) if hover is None else _balance(signals, settled)
    lean, tilt = _leaning(signals, settled)
    moving = signals.motors, dict(zip(TILT_AXES, signals.tilts, strict=False))
    oscillation = detect_limit_cycle(*moving, settled) or detect_limit_cycle(
        *moving, _parts(signals, phases.airborne_intervals)
    )
    return Condition(
        duration=_seconds(span),
        armed=None if signals.armed is None else _seconds(_parts(signals, phases.armed_intervals)),
        settled=_seconds(settled),
        hover=hover,
        share_interval=intervals,
        command=command,
        lean=lean,
        tilt_mean=tilt.mean() if len(tilt) else None,
        tilt_sd=tilt.std() if len(tilt) else None,
        tilt_max=tilt.max() if len(tilt) else None,
        vibration=_vibration(signals, settled),
        battery=_battery(signals, settled or span),
        oscillation=oscillation,
    )


def settled_parts(signals: Signals) -> Segments:
    """Returns settled flight with attitude and motor outputs or, where there are no motor outputs, with attitude."""
    if signals.telemetry.vehicle not in POSSIBLE_MULTIROTORS:
        return ()
    if signals.motors is not None:
        return tuple(sorted(settled_segments(signals)))
    return _parts(signals, phases.settled_intervals)


def _parts(signals: Signals, wanted: Callable[[Signals, int], Intervals]) -> Segments:
    """The ``wanted`` intervals of each boot, as far as anything was recorded."""
    recorded = (
        (part.boot, intersection([(part.start, part.end)], wanted(signals, part.boot)))
        for part in recorded_spans(signals)
    )
    return tuple(Segment(boot, *interval) for boot, intervals in recorded for interval in intervals)


def mean_interval(values: Array, seconds: float) -> Array:
    """Returns half widths (k,) of the means of ``values`` (N, k), uniform over ``seconds``: 90 %, inf if too short."""
    length = len(values)
    cosines = int(np.clip(round(2 * FASTEST_COSINE * seconds), *COSINES))
    if length <= 2 * cosines:
        return np.full(values.shape[1], np.inf)
    projections = dct(values - values.mean(axis=0), axis=0)[1 : cosines + 1] / (
        np.sqrt(2.0) * length
    )
    return half_width(np.square(projections).mean(axis=0), freedom=cosines)


def _seconds(parts: Segments) -> float:
    return float(sum(part.duration for part in parts))


def _balance(
    signals: Signals, settled: Segments
) -> tuple[tuple[float | None, ...], dict[str, Steady]]:
    """Half widths of the motors' shares, and the steady command of each axis."""
    motors = signals.motors
    seconds = _seconds(settled)
    assert motors is not None
    shares = motors.scale.fraction(motors.outputs[in_segments(motors, *settled, slack=0)])
    level = shares.mean(axis=1, keepdims=True)
    # A ratio of means: its error is the mean of these.
    mean_level = level.mean()
    balance = (shares - level * (shares.mean(axis=0) / mean_level)) / mean_level
    weights = {
        axis: effect for axis in AXES if (effect := motors.layout.mixer_row(axis)) is not None
    }
    return (
        tuple(or_none(half) for half in mean_interval(balance, seconds)),
        {axis: _steady(shares @ effect, seconds) for axis, effect in weights.items()},
    )


def _leaning(signals: Signals, settled: Segments) -> tuple[dict[str, Steady], Array]:
    """Roll and pitch, and the angle from level (N,), rad."""
    angles = [tilt.angle[in_segments(tilt, *settled, slack=0)] for tilt in signals.tilts]
    if len(angles) < len(TILT_AXES) or not all(map(len, angles)):
        return {}, np.zeros(0)
    lean = {
        axis: _steady(angle, _seconds(settled))
        for axis, angle in zip(TILT_AXES, angles, strict=True)
    }
    # Both come with the same messages, so they differ in length only where a row of one was left out.
    roll, pitch = (angle[: min(map(len, angles))] for angle in angles)
    level = np.cos(roll) * np.cos(pitch)
    return lean, np.arccos(np.clip(level, -1, 1))


def _steady(values: Array, seconds: float) -> Steady:
    return Steady(
        values.mean(),
        or_none(mean_interval(values[:, None], seconds)[0]),
        values.std(),
    )


def or_none(half_width: float) -> float | None:
    """Returns a half width, or a share; ``None`` where it is not finite."""
    if np.isfinite(half_width):
        return float(half_width)
    return None


class MeasuredVibration(NamedTuple):
    """The vibration of every IMU, the first one's axes first.

    Attributes:
        axes: of each IMU that were measured; PX4 measures all together.
        levels: (N, k) m/s², of so many axes of each IMU.
        clips: (N, 3) how often each IMU was out of range since the sample before.
    """

    axes: Names
    levels: TimeSeries
    clips: Array


def vibration_of(signals: Signals) -> MeasuredVibration | None:
    """Returns the vibration, if measured; PX4's (``streams/VIBRATION.hpp``) has acceleration in z only."""
    names = LEVELS[-1:] if signals.telemetry.autopilot == "PX4" else LEVELS
    columns = signals.telemetry.messages.get("VIBRATION")
    if columns is None or not {*names, *CLIPS} <= columns.keys():
        return None
    first = float_columns(columns, names)
    counted = float_columns(columns, CLIPS)
    measured = clean_series(columns, np.column_stack([columns.get("levels", first), counted]))
    levels, counts = np.split(measured.values, [-len(CLIPS)], axis=1)
    # The counts are of the boot so far; one that stands out from both beside it was damaged.
    sound = median_filter(counts, size=(3, 1), mode="mirror")
    rises = np.clip(np.diff(sound, axis=0, prepend=sound[:1]), 0, None)
    axes = ("",) if len(names) == 1 else tuple("xyz")
    # A firmware may send zeros.
    vibration = MeasuredVibration(axes, replace(measured, values=levels), rises)
    return vibration if levels.any() else None


def _vibration(signals: Signals, settled: Segments) -> VibrationFigures | None:
    """The vibration in settled flight, if measured."""
    measured = vibration_of(signals)
    if measured is None:
        return None
    here = in_segments(measured.levels, *settled, slack=0)
    if not here.any():
        return None
    levels = measured.levels.values[here, : len(measured.axes)]
    return VibrationFigures(tuple(levels.mean(axis=0)), int(measured.clips[here].sum()))


def _battery(signals: Signals, parts: Segments) -> BatteryFigures | None:
    voltage = signals.voltage
    if voltage is None or not (here := in_segments(voltage, *parts, slack=0)).any():
        return None
    time = voltage.time[here]
    boot = voltage.boot[here]
    volts = voltage.values[here]
    first = volts[(boot == boot[0]) & (time <= time[0] + AVERAGING_SECONDS)]
    last = volts[(boot == boot[-1]) & (time >= time[-1] - AVERAGING_SECONDS)]
    figures = [np.median(first), np.median(last), volts.mean(), volts.min()]
    load = recorded_series(signals.telemetry, "SYS_STATUS", "current_battery")
    if load is not None:
        amperes = load.values[in_segments(load, *parts, slack=0)] / 1e2
        # A negative current stands for none; a sensor that is not there, or not calibrated, reads 0 at times.
        if amperes.min(initial=np.inf) > 0 and len(amperes):
            figures += [amperes.mean(), amperes.max()]
    return BatteryFigures(*figures)
