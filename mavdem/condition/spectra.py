"""Spectra: the power of gyro and accelerometer by frequency, time and throttle, before the filters and behind them.

Densities are one-sided, by windows of about a second through Hann's window, half over each other. What was logged
decides the highest frequency: batches and raw samples go up to half of the sensor's rate, rates of the autopilot to a
hundred hertz or so. Vibration above that appears below it, as an alias.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mavdem.alignment.align import Segment, within
from mavdem.alignment.drive import AXES, Signal
from mavdem.alignment.signals import Signals
from mavdem.condition.resonance import spectra_of, windows_of
from mavdem.ingest.telemetry import Array, Columns

SECONDS = 1.0  # of a window
FEWEST_WINDOWS = 6
SLOWEST = 20.0  # Hz of samples: there is nothing to see below half of that
LEVELS = 12  # of the throttle, with as many windows each
STAGES = {
    "gyro_before": "GYRO_BEFORE",
    "gyro": "GYRO_AFTER",
    "accelerometer_before": "ACCEL_BEFORE",
    "accelerometer": "ACCEL_AFTER",
}
"""The message of each sensor's samples."""
RATE_MESSAGE = "ATTITUDE"
FELT = "HIGHRES_IMU"  # which PX4 fills with the gyro before its filters, rad/s


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Of one sensor, or of what was asked of the motors.

    Attributes:
        name: a key of ``STAGES``, or "demand".
        unit: of what was measured: "rad/s", "m/s²" or "1".
        source: what the log calls it.
        frequency: (F,) Hz.
        time: (W,) s, of the middle of each window.
        density: (W, k, F) power of roll, pitch and yaw, or of forward, right and down; unit²/Hz.
        throttle: (W,) 0 to 1 of the motors' mean output; NaN where it is not known.
        speed: (W,) turns a second of the motors in the mean; NaN where the log has none.
    """

    name: str
    unit: str
    source: str
    frequency: Array
    time: Array
    density: Array
    throttle: Array
    speed: Array

    @property
    def highest(self) -> float:
        """Hz up to which there is anything: half of the samples' rate."""
        return float(self.frequency[-1])

    @property
    def mean(self) -> Array:
        """(k, F) mean density of each axis."""
        return np.asarray(self.density.mean(axis=0))

    @cached_property
    def whole(self) -> Array:
        """(W, F) density of all axes together."""
        return np.asarray(self.density.sum(axis=1))

    @cached_property
    def by_throttle(self) -> tuple[Array, Array]:
        """(L,) throttle, and (L, F) mean density of all axes there, in windows of even number; empty without it."""
        known = np.flatnonzero(np.isfinite(self.throttle))
        order = known[np.argsort(self.throttle[known])]
        parts = [part for part in np.array_split(order, min(LEVELS, len(order) or 1)) if len(part)]
        if not parts:
            return np.zeros(0), np.zeros((0, len(self.frequency)))
        levels = np.array([self.throttle[part].mean() for part in parts])
        return levels, np.array([self.whole[part].mean(axis=0) for part in parts])

    def power(self, low: float, high: float) -> float:
        """Returns the mean power of all axes between two frequencies, Hz, unit²."""
        rows = (self.frequency >= low) & (self.frequency <= high)
        return float(self.whole[:, rows].mean(axis=0).sum() * self.frequency[1])


def thinned(frequency: Array, density: Array, most: int) -> tuple[Array, Array]:
    """Returns at ``most`` so many frequencies, Hz, and of densities (…, F) the largest of those between."""
    size = -(-len(frequency) // most)
    count = len(frequency) // size
    groups = density[..., : count * size].reshape(*density.shape[:-1], count, size)
    return frequency[: count * size].reshape(count, size).mean(axis=1), groups.max(axis=-1)


def spectra_of_flight(signals: Signals, parts: Sequence[Segment]) -> dict[str, Spectrum]:
    """Returns what ``parts`` of a flight show, by name; without samples of the gyro's own its rates as controlled."""
    found = dict[str, Spectrum]()
    messages = signals.telemetry.messages
    for name, message in STAGES.items():
        columns = messages.get(message)
        if columns is None and name == "gyro_before":
            message = FELT
            columns = _felt(messages.get(message))
        unit = "rad/s" if "gyro" in name else "m/s²"
        source = signals.telemetry.called(message)
        if columns is not None:
            values = np.column_stack([columns[axis] for axis in "xyz"]).astype(np.float64)
            sampled = Signal(columns["time"], columns["boot"], values)
            found |= _spectrum(name, unit, source, sampled, signals, parts)
    rates = _rates(signals)
    fastest = found.get("gyro")
    if rates is not None:
        source = signals.telemetry.called(RATE_MESSAGE)
        own = _spectrum("gyro", "rad/s", source, rates, signals, parts)
        if own and (fastest is None or own["gyro"].highest > fastest.highest):
            found |= own
    demand = messages.get("ACTUATOR_CONTROL_TARGET")
    if demand is not None:
        source = signals.telemetry.called("ACTUATOR_CONTROL_TARGET")
        asked = Signal(demand["time"], demand["boot"], demand["controls"][:, :3])
        found |= _spectrum("demand", "1", source, asked, signals, parts)
    return found


def _felt(logged: Columns | None) -> Columns | None:
    """HIGHRES_IMU with the names of samples; None where it has no gyro."""
    if logged is None or "xgyro" not in logged:
        return None
    return {**logged, **{axis: logged[f"{axis}gyro"] for axis in "xyz"}}


def _rates(signals: Signals) -> Signal | None:
    """(N, 3) the rates of the controller, rad/s."""
    about = [signals.about(axis) for axis in AXES]
    pairs = [one.rates for one in about]
    kept = [pair[0] for pair in pairs if pair is not None]
    if len(kept) < len(AXES):
        kept = [one.attitude.rates for one in about if one.attitude is not None]
    if len(kept) < len(AXES) or len({len(one.time) for one in kept}) > 1:
        return None
    return Signal(kept[0].time, kept[0].boot, np.column_stack([one.values for one in kept]))


def _spectrum(
    name: str,
    unit: str,
    source: str,
    sampled: Signal,
    signals: Signals,
    parts: Sequence[Segment],
) -> dict[str, Spectrum]:
    """That of samples (N, k), by its name; nothing where they are few or slow."""
    steps = np.diff(sampled.time)
    usual = float(np.median(steps[steps > 0])) if np.any(steps > 0) else np.inf
    if usual > 1 / SLOWEST:
        return {}
    size = int(2 ** np.round(np.log2(SECONDS / usual)))
    times = []
    powers = []
    for part in parts:
        rows = within(sampled, part, slack=0)
        time = sampled.time[rows]
        values = np.nan_to_num(sampled.values[rows])
        for run in np.split(
            np.arange(len(time)), np.flatnonzero(np.abs(np.diff(time)) > 3 * usual) + 1
        ):
            if len(run) >= size:
                even = np.linspace(time[run[0]], time[run[-1]], len(run))
                columns = [np.interp(even, time[run], column) for column in values[run].T]
                powers.append([np.abs(spectra_of(column, size)) ** 2 for column in columns])
                times.append(windows_of(even, size).mean(axis=1))
    if sum(map(len, times)) < FEWEST_WINDOWS:
        return {}
    middle = np.concatenate(times)
    scale = 2 * usual / np.square(np.hanning(size)).sum()
    density = scale * np.concatenate(powers, axis=1).swapaxes(0, 1)
    boots = {part.boot for part in parts}
    frequency = np.asarray(np.fft.rfftfreq(size, usual), np.float64)
    throttle = _at(signals.collective, middle, boots)
    speed = _at(_motor_speed(signals.telemetry.messages.get("ESC")), middle, boots)
    return {name: Spectrum(name, unit, source, frequency, middle, density, throttle, speed)}


def _at(signal: Signal | None, middle: Array, boots: set[int]) -> Array:
    """(W,) means of a signal over the second about each time; NaN where there is none, or several boots."""
    if signal is None or len(boots) > 1:
        return np.full(len(middle), np.nan)
    rows = np.isin(signal.boot, list(boots))
    time = signal.time[rows]
    total = np.append(0.0, np.cumsum(signal.values[rows]))
    first, last = (np.searchsorted(time, middle + side * SECONDS / 2) for side in (-1, 1))
    counts = last - first
    return np.where(counts > 0, (total[last] - total[first]) / np.maximum(counts, 1), np.nan)


def _motor_speed(logged: Columns | None) -> Signal | None:
    """Turns a second of each motor that turns, one after another."""
    if logged is None:
        return None
    turning = logged["RPM"] > 0
    if not turning.any():
        return None
    order = np.lexsort((logged["time"][turning], logged["boot"][turning]))
    columns = (logged[name][turning][order] for name in ("time", "boot", "RPM"))
    time, boot, speed = columns
    return Signal(time, boot, speed / 60.0)
