"""Spectra: the power of gyro and accelerometer by frequency, time and throttle, before the filters and behind them.

Densities are one-sided, by windows of about a second through Hann's window, half over each other. What was logged
decides the highest frequency: batches and raw samples go up to half of the sensor's rate, rates of the autopilot to a
hundred hertz or so. Vibration above that appears below it, as an alias.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mavdem.arrays import Array, ArrayPair
from mavdem.dataset.axes import AXES
from mavdem.dataset.segments import Segments, in_segments
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import TimeSeries, clean_series, recorded_series
from mavdem.immutable import ImmutableResult
from mavdem.ingest.telemetry import interpolated

SECONDS = 1.0  # of a window
FEWEST_WINDOWS = 6
SLOWEST_SENSOR = 20.0  # Hz of samples: there is nothing to see below half of that
THROTTLE_LEVELS = 12  # of the throttle, with as many windows each
SAMPLES = (
    ("gyro_before", "GYRO_BEFORE", ("x", "y", "z")),
    ("gyro_before", "HIGHRES_IMU", ("xgyro", "ygyro", "zgyro")),
    ("gyro", "GYRO_AFTER", ("x", "y", "z")),
    ("accelerometer_before", "ACCEL_BEFORE", ("x", "y", "z")),
    ("accelerometer", "ACCEL_AFTER", ("x", "y", "z")),
    ("d_term", "D_TERM", ("x", "y", "z")),
)
"""Each sensor's messages and fields; PX4 fills HIGHRES_IMU with the gyro before its filters, rad/s."""
RATE_MESSAGE = "ATTITUDE"
DEMAND_MESSAGE = "ACTUATOR_CONTROL_TARGET"


@dataclass(frozen=True, eq=False)
class Spectrum(ImmutableResult):
    """Of one sensor, of the rate controllers' D term, or of what was asked of the motors.

    Attributes:
        name: one in ``SAMPLES``, or "demand".
        unit: of what was measured: "rad/s", "m/s²" or "1".
        source: what the log calls it.
        frequency: (F,) Hz.
        time: (W,) s, of the middle of each window.
        density: (W, k, F) power of roll, pitch and yaw, or of forward, right and down; unit²/Hz.
        throttle: (W,) 0 to 1 of the motors' mean output; NaN where it is not known.
        motor_speed: (W,) turns a second of the motors in the mean; NaN where the log has none.
    """

    name: str
    unit: str
    source: str
    frequency: Array
    time: Array
    density: Array
    throttle: Array
    motor_speed: Array

    @property
    def nyquist_frequency(self) -> float:
        """Hz up to which there is anything: half of the samples' rate."""
        return self.frequency[-1]

    @property
    def mean_density(self) -> Array:
        """(k, F) mean density of each axis."""
        return self.density.mean(axis=0)

    @cached_property
    def total_density(self) -> Array:
        """(W, F) density of all axes together."""
        return self.density.sum(axis=1)

    @cached_property
    def density_by_throttle(self) -> ArrayPair:
        """(L,) throttle, and (L, F) mean density of all axes there, in windows of even number; empty without it."""
        windows = np.count_nonzero(np.isfinite(self.throttle))
        order = np.argsort(self.throttle)[:windows]
        if not len(order):
            return np.zeros(0), np.zeros((0, len(self.frequency)))
        count = min(THROTTLE_LEVELS, len(order))
        parts = np.array_split(order, count)
        levels = np.array([self.throttle[part].mean() for part in parts])
        densities = np.array([self.total_density[part].mean(axis=0) for part in parts])
        return levels, densities

    def mean_power(self, low: float, high: float) -> float:
        """Returns the mean power of all axes between two frequencies, Hz, unit²."""
        rows = (self.frequency >= low) & (self.frequency <= high)
        density = self.total_density[:, rows].mean(axis=0).sum()
        return density * self.frequency[1]


def max_decimated(frequency: Array, density: Array, most: int) -> ArrayPair:
    """Returns at ``most`` so many frequencies, Hz, and of densities (…, F) the largest of those between."""
    size = -(-len(frequency) // most)
    count = len(frequency) // size
    groups = density[..., : count * size].reshape(*density.shape[:-1], count, size)
    middles = frequency[: count * size].reshape(count, size).mean(axis=1)
    return middles, groups.max(axis=-1)


def vibration_spectra(signals: Signals, parts: Segments) -> dict[str, Spectrum]:
    """Returns what ``parts`` of a flight show, by name: of each the messages that show the highest frequency."""
    spectra = dict[str, Spectrum]()
    for name, message, sampled in _sampled(signals):
        source = signals.telemetry.name_in_source(message)
        spectrum = _spectrum(name, source, sampled, signals, parts)
        if spectrum is not None and (
            name not in spectra or spectrum.nyquist_frequency > spectra[name].nyquist_frequency
        ):
            spectra[name] = spectrum
    return spectra


def _sampled(signals: Signals) -> Iterator[tuple[str, str, TimeSeries]]:
    """Name, message and samples (N, 3) of what was recorded."""
    for name, message, fields in SAMPLES:
        values = recorded_series(signals.telemetry, message, *fields)
        if values is not None:
            yield name, message, values
    about = [signals.for_axis(axis) for axis in AXES]
    for rates in (
        [
            of_axis.rate_and_setpoint[0]
            for of_axis in about
            if of_axis.rate_and_setpoint is not None
        ],
        [of_axis.attitude.rate_series for of_axis in about if of_axis.attitude is not None],
    ):
        if len(rates) == len(AXES) and len({len(rate.time) for rate in rates}) == 1:
            table = np.column_stack([rate.values for rate in rates])
            yield "gyro", RATE_MESSAGE, TimeSeries(rates[0].time, rates[0].boot, table)
    demand = signals.telemetry.messages.get(DEMAND_MESSAGE)
    if demand is not None:
        demands = demand["controls"][:, : len(AXES)]
        yield "demand", DEMAND_MESSAGE, clean_series(demand, demands)


def _spectrum(
    name: str, source: str, sampled: TimeSeries, signals: Signals, parts: Segments
) -> Spectrum | None:
    """That of samples (N, k); None where they are few or slow."""
    from scipy.signal import spectrogram  # it takes half a second to import

    steps = np.diff(sampled.time)
    usual = np.median(steps[steps > 0]) if np.any(steps > 0) else np.inf
    if usual > 1 / SLOWEST_SENSOR or len(sampled.time) * usual < SECONDS / 2:
        return None
    octaves = np.log2(SECONDS / usual)
    size = int(2 ** np.round(octaves))
    times = []
    powers = []
    for part in parts:
        rows = np.flatnonzero(in_segments(sampled, part, slack=0))
        is_gap = np.diff(sampled.time[rows]) > 3 * usual
        gaps = np.flatnonzero(is_gap)
        for run in np.split(rows, gaps + 1):
            if len(run) >= size:
                time = sampled.time[run]
                even = np.linspace(time[0], time[-1], len(run))
                columns = interpolated(even, time, sampled.values[run])
                frequency, middle, density = spectrogram(
                    columns.T, 1 / usual, "hann", size, size // 2
                )
                times.append(even[0] + middle)
                powers.append(density)
    if sum(map(len, times)) < FEWEST_WINDOWS:
        return None
    time = np.concatenate(times)
    unit = "rad/s" if "gyro" in name else "m/s²" if "accelerometer" in name else "1"
    return Spectrum(
        name=name,
        unit=unit,
        source=source,
        frequency=frequency,
        time=time,
        density=np.concatenate(powers, axis=2).transpose(2, 0, 1),
        throttle=_at(signals.collective, time, parts),
        motor_speed=_at(_motor_speed(signals), time, parts),
    )


def _at(signal: TimeSeries | None, middle: Array, parts: Segments) -> Array:
    """(W,) means of a signal over the second about each time; NaN where there is none, or several boots."""
    boots = {part.boot for part in parts}
    if signal is None or len(boots) > 1:
        return np.full(len(middle), np.nan)
    here = np.isin(signal.boot, list(boots))
    sums = np.cumsum(signal.values[here])
    total = np.append(0.0, sums)
    window = np.array([[-SECONDS / 2], [SECONDS / 2]])
    edges = np.searchsorted(signal.time[here], middle + window)
    counts = np.ptp(edges, axis=0)
    means = np.ptp(total[edges], axis=0) / np.maximum(counts, 1)
    return np.where(counts > 0, means, np.nan)


def _motor_speed(signals: Signals) -> TimeSeries | None:
    """Turns a second of each motor that turns, one after another."""
    logged = signals.telemetry.messages.get("ESC")
    if logged is None:
        return None
    order = np.lexsort((logged["time"], logged["boot"]))
    is_turning = logged["RPM"][order] > 0
    kept = order[is_turning]
    turns = logged["RPM"][kept] / 60.0
    return TimeSeries(logged["time"][kept], logged["boot"][kept], turns)
