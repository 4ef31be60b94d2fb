"""Condition: what a log says of a vehicle at any rate: balance, limits, lean, vibration and battery.

Each mean comes with an interval that allows for the correlation of neighbouring samples. The error of a mean over T
seconds is decided by the slowest part of the series, below about 1/T. That part is estimated from the first cosines:
each of q projections of the series on √2 cos(π j t/T) has the mean's own variance, if the spectrum is flat up to
q/(2T). Their mean square is then its estimate, with q degrees of freedom.

References:
    E. Lazarus, D. J. Lewis, J. H. Stock and M. W. Watson, "HAR Inference: Recommendations for Practice", Journal of
    Business & Economic Statistics 36 (2018): the equal-weighted cosine estimator, and Student's t.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from mavdem.alignment import phases
from mavdem.alignment.align import settled_segments
from mavdem.alignment.drive import AXES, TILT_AXES, floats, in_order
from mavdem.alignment.phases import Intervals, both, total
from mavdem.alignment.signals import Signals
from mavdem.condition.hover import HoverFigures, hover_of
from mavdem.errors import NotLearnable
from mavdem.ingest.motors import MULTIROTORS

Periods = Mapping[int, Intervals]  # Intervals, s, by boot


def settled_flight(signals: Signals) -> Periods:
    """Settled flight with attitude and motor outputs or, where there are no motor outputs, with attitude."""
    if signals.telemetry.vehicle not in (*MULTIROTORS, "UNKNOWN"):
        return {}
    found: dict[int, Intervals] = {}
    if signals.motors is not None:
        for segment in sorted(settled_segments(signals), key=lambda segment: (segment.boot, segment.start)):
            found.setdefault(segment.boot, []).append((segment.start, segment.end))
        return found
    for boot, recorded in log_span(signals).items():
        if settled := both(recorded, phases.settled(signals, boot)):
            found[boot] = settled
    return found


def log_span(signals: Signals) -> Periods:
    """From the first message of each boot to its last."""
    ends: dict[int, tuple[float, float]] = {}
    for columns in signals.telemetry.messages.values():
        for boot in np.unique(columns["boot"]):
            time = columns["time"][columns["boot"] == boot]
            first, last = ends.get(int(boot), (np.inf, -np.inf))
            ends[int(boot)] = min(first, float(time.min())), max(last, float(time.max()))
    return {boot: [span] for boot, span in sorted(ends.items())}


def seconds_of(periods: Periods) -> float:
    """How long they last together."""
    return float(sum(total(intervals) for intervals in periods.values()))


def during(periods: Periods, time: NDArray[np.float64], boot: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which samples (N,) lie in the periods."""
    inside = np.zeros(len(time), dtype=bool)
    for number, intervals in periods.items():
        for start, end in intervals:
            inside |= (boot == number) & (time >= start) & (time <= end)
    return inside


LEVEL = 0.9
FASTEST = 0.05
"""Hz, of the fastest cosine: slower than gusts and the position loop, whose seconds are no mean of a flight."""
FEWEST, MOST = 4, 32  # Cosines; fewer than 4 make intervals that are mostly chance, more than 32 hardly change them


class MeanInterval(NamedTuple):
    """Means (k,) and the half widths (k,) of their 90 % intervals; infinite for series too short to tell."""

    mean: NDArray[np.float64]
    half_width: NDArray[np.float64]


def mean_interval(values: NDArray[np.float64], seconds: float) -> MeanInterval:
    """The means of the columns of ``values`` (N, k), uniformly sampled over so many ``seconds``."""
    length, mean = len(values), values.mean(axis=0)
    cosines = int(np.clip(round(2 * FASTEST * seconds), FEWEST, MOST))
    if length <= 2 * cosines:
        return MeanInterval(mean, np.full(values.shape[1], np.inf))
    phase = np.pi * (np.arange(length) + 0.5) / length
    basis = np.sqrt(2.0) * np.cos(np.arange(1, cosines + 1)[:, None] * phase) / length
    variance = np.square(basis @ (values - mean)).mean(axis=0)
    return MeanInterval(mean, float(student.ppf(0.5 + LEVEL / 2, cosines)) * np.sqrt(variance))


LEVELS = ("vibration_x", "vibration_y", "vibration_z")
CLIPS = ("clipping_0", "clipping_1", "clipping_2")


class VibrationFigures(NamedTuple):
    """Of the first IMU.

    Attributes:
        level: mean level of the acceleration, m/s²: x, y and z from ArduPilot, one for all axes from PX4. The levels of
            the two are not alike: compare flights of one autopilot.
        clips: how often an accelerometer was beyond its range.
    """

    level: tuple[float, ...]
    clips: int


def vibration_of(signals: Signals, periods: Periods) -> VibrationFigures | None:
    """The vibration during some periods; None where it was not measured then.

    PX4's VIBRATION (``streams/VIBRATION.hpp``) has angular levels in x and y, and that of the acceleration in z.
    """
    columns = signals.telemetry.messages.get("VIBRATION")
    if columns is None:
        return None
    names = LEVELS[-1:] if signals.telemetry.autopilot == "PX4" else LEVELS
    if not all(name in columns for name in (*names, *CLIPS)):
        return None
    table = np.column_stack([floats(columns, name) for name in (*names, *CLIPS)])
    time, boot, table, _ = in_order(columns["time"], columns["boot"], table)
    here = during(periods, time, boot)
    levels, clips = table[:, : len(names)], table[:, len(names) :]
    if not levels[here].any():  # also where a firmware sends zeros
        return None
    # The counts are of the boot so far.
    rises = np.clip(np.diff(clips, axis=0, prepend=clips[:1]), 0, None).sum(axis=1)
    return VibrationFigures(tuple(levels[here].mean(axis=0).tolist()), int(rises[here].sum()))


END_SECONDS = 2.0  # The voltage at either end is the median over so long


@dataclass(frozen=True)
class BatteryFigures:
    """The first battery over some time; V, A and Ω. None where it was not measured.

    Attributes:
        voltage_start, voltage_end: medians of the first and the last 2 s.
        voltage_mean, voltage_min: of all samples.
        current_mean, current_max: of all samples.
        resistance: how far the voltage falls with each ampere, apart from the steady discharge; None where the current
            hardly changed, so that the interval contains 0.
        resistance_interval: half width of its 90 % interval.
    """

    voltage_start: float
    voltage_end: float
    voltage_mean: float
    voltage_min: float
    current_mean: float | None = None
    current_max: float | None = None
    resistance: float | None = None
    resistance_interval: float | None = None


def battery_of(signals: Signals, periods: Periods) -> BatteryFigures | None:
    """The battery during some periods; None where no voltage was measured then."""
    voltage = signals.voltage
    if voltage is None:
        return None
    here = during(periods, voltage.time, voltage.boot)
    time, boot, volts = voltage.time[here], voltage.boot[here], voltage.values[here]
    if not len(volts):
        return None
    first, last = (
        (boot == boot[0]) & (time <= time[0] + END_SECONDS),
        (boot == boot[-1]) & (time >= time[-1] - END_SECONDS),
    )
    figures = float(np.median(volts[first])), float(np.median(volts[last])), float(volts.mean()), float(volts.min())
    measured = _volts_and_amperes(signals, periods)
    if measured is None:
        return BatteryFigures(*figures)
    seconds, volts, amperes = measured
    load = float(amperes.mean()), float(amperes.max())
    return BatteryFigures(*figures, *load, *_resistance(seconds, volts, amperes))


def _volts_and_amperes(signals: Signals, periods: Periods) -> tuple[NDArray[np.float64], ...] | None:
    """Time, voltage and current (N,) of SYS_STATUS, which has both; None where there is no current."""
    columns = signals.telemetry.messages.get("SYS_STATUS")
    if columns is None or "current_battery" not in columns:
        return None
    table = np.column_stack([floats(columns, "voltage_battery") / 1e3, floats(columns, "current_battery") / 1e2])
    time, boot, table, _ = in_order(columns["time"], columns["boot"], table)
    here = during(periods, time, boot)
    volts, amperes = table[here].T
    # A negative current stands for none, and a sensor that is not there, or not calibrated, reads 0 at times.
    return (time[here], volts, amperes) if len(amperes) and amperes.min() > 0 else None


def _resistance(
    time: NDArray[np.float64], volts: NDArray[np.float64], amperes: NDArray[np.float64]
) -> tuple[float | None, float | None]:
    """Resistance and half width: regression on the current, both without their straight line over time."""
    if len(time) < 10:
        return None, None
    line = np.column_stack([np.ones_like(time), time - time.mean()])
    fallen, load = (column - line @ np.linalg.lstsq(line, column, rcond=None)[0] for column in (-volts, amperes))
    power = float(load @ load)
    if power <= 0:
        return None, None
    resistance = float(load @ fallen) / power
    scores = load * (fallen - resistance * load) * len(load) / power
    half = float(mean_interval(scores[:, None], float(np.ptp(time))).half_width[0])
    return (resistance, half) if 0 < half < resistance else (None, None)


@dataclass(frozen=True)
class Steady:
    """A quantity over settled flight.

    Attributes:
        mean: its mean.
        interval: half width of the mean's 90 % interval, by the slow part of the series; None where too short to tell.
        sd: its standard deviation.
    """

    mean: float
    interval: float | None
    sd: float


@dataclass(frozen=True)
class Condition:
    """Figures that need no fast stream: means, spreads and limits. They hold for any rate from 1 Hz.

    All of them are of settled flight, but for the first two, and the battery where there was none. None where a figure
    was not recorded.

    Attributes:
        duration: of the log, s, over all boots.
        armed: of it armed, s; None where the log does not say.
        settled: of it in settled flight, s.
        hover: what each motor does, how hard it works, and what it has left.
        share_interval: half widths of the 90 % intervals of ``hover.trim_share``; within this flight, not between
            flights.
        command: for each axis known, the motors' combination that turns it, as a share of their range: what balances a
            shifted load, steady wind or a weak motor. Positive: to the right, nose up, nose to the right.
        lean: roll and pitch, rad.
        tilt_mean, tilt_sd, tilt_max: of the angle from level, rad.
        vibration: level and clips.
        battery: voltage and current.
    """

    duration: float
    armed: float | None
    settled: float
    hover: HoverFigures | None
    share_interval: tuple[float | None, ...]
    command: dict[str, Steady]
    lean: dict[str, Steady]
    tilt_mean: float | None
    tilt_sd: float | None
    tilt_max: float | None
    vibration: VibrationFigures | None
    battery: BatteryFigures | None

    @property
    def collective(self) -> float | None:
        """Mean of all motors, as a share of their range."""
        return None if self.hover is None else float(np.mean(self.hover.trim_of_range))

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON values; angles in rad, but for those of ``hover``."""
        return {
            **asdict(self),
            "hover": None if self.hover is None else self.hover.as_dict(),
            "share_interval": list(self.share_interval),
            "vibration": None if self.vibration is None else self.vibration._asdict(),
            "collective": self.collective,
        }


def condition_of(signals: Signals) -> Condition:
    """The condition of the vehicle of ``signals``, whatever they are for: it takes the motors' own messages."""
    signals = Signals(signals.telemetry, inputs="motors") if signals.inputs != "motors" else signals
    span, settled = log_span(signals), settled_flight(signals)
    try:
        hover = hover_of(signals)
    except NotLearnable:
        hover = None
    intervals, command = ((), {}) if hover is None else _balance(signals, settled)
    armed = sum(total(both(recorded, phases.armed(signals, boot))) for boot, recorded in span.items())
    lean, tilt = _leaning(signals, settled)
    return Condition(
        duration=seconds_of(span),
        armed=None if signals.armed is None else float(armed),
        settled=seconds_of(settled),
        hover=hover,
        share_interval=intervals,
        command=command,
        lean=lean,
        tilt_mean=float(tilt.mean()) if len(tilt) else None,
        tilt_sd=float(tilt.std()) if len(tilt) else None,
        tilt_max=float(tilt.max()) if len(tilt) else None,
        vibration=vibration_of(signals, settled),
        battery=battery_of(signals, settled or span),
    )


def _balance(signals: Signals, settled: Periods) -> tuple[tuple[float | None, ...], dict[str, Steady]]:
    """Half widths of the motors' shares, and the steady command of each axis."""
    motors, seconds = signals.motors, seconds_of(settled)
    assert motors is not None
    shares = motors.scale.fraction(motors.outputs[during(settled, motors.time, motors.boot)])
    level = shares.mean(axis=1, keepdims=True)
    # A ratio of means: its error is the mean of these.
    balance = (shares - level * (shares.mean(axis=0) / level.mean())) / level.mean()
    intervals = mean_interval(balance, seconds).half_width
    weights = {axis: effect for axis in AXES if (effect := motors.layout.effect(axis)) is not None}
    return (
        tuple(_known(half) for half in intervals),
        {axis: _steady(shares @ effect, seconds) for axis, effect in weights.items()},
    )


def _leaning(signals: Signals, settled: Periods) -> tuple[dict[str, Steady], NDArray[np.float64]]:
    """Roll and pitch, and the angle from level (N,), rad."""
    if len(signals.tilts) < len(TILT_AXES):
        return {}, np.zeros(0)
    angles = [tilt.angle[during(settled, tilt.time, tilt.boot)] for tilt in signals.tilts]
    if not all(map(len, angles)):
        return {}, np.zeros(0)
    seconds = seconds_of(settled)
    lean = {axis: _steady(angle, seconds) for axis, angle in zip(TILT_AXES, angles, strict=True)}
    # Both come with the same messages, so they differ in length only where a row of one was left out.
    roll, pitch = (angle[: min(map(len, angles))] for angle in angles)
    return lean, np.arccos(np.clip(np.cos(roll) * np.cos(pitch), -1, 1))


def _steady(values: NDArray[np.float64], seconds: float) -> Steady:
    found = mean_interval(values[:, None], seconds)
    return Steady(float(found.mean[0]), _known(found.half_width[0]), float(values.std()))


def _known(half_width: float) -> float | None:
    return float(half_width) if np.isfinite(half_width) else None
