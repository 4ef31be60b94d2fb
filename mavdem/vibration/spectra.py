"""Power spectral densities of gyro and accelerometer in flight, over time and throttle, before and after the filters.

Densities are one-sided, from half-overlapping windows of about a second with Hann's taper. What was logged decides the
highest frequency: batches and raw samples go up to half of the sensor's rate, rates of the autopilot to a hundred hertz
or so. Vibration above that appears below it, as an alias.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from math import ceil
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array, ArrayPair, Indices
from mavdem.dataset.axes import AXES
from mavdem.dataset.segments import Segments, in_segments
from mavdem.dataset.signals import Signals
from mavdem.dataset.speed_controllers import speed_controllers
from mavdem.dataset.time_series import TimeSeries, clean_series, recorded_series
from mavdem.immutable import ImmutableResult
from mavdem.ingest.telemetry import interpolated
from mavdem.plant.power_density import window_densities

WINDOW_SECONDS = 1.0
"""Length of a window, s; it is rounded to a power of two of samples."""
MIN_WINDOWS = 6
"""Least number of windows of a spectrum: a choice."""
MIN_SAMPLING_RATE = 20.0
"""Lowest accepted rate of samples, Hz: slower ones show nothing but steering."""
MAX_GAP_STEPS = 3.0
"""Longest gap within a window, in usual time steps of the samples: a choice."""
THROTTLE_LEVELS = 12
"""Largest number of levels of the throttle by which spectra are averaged, with as many windows each: a choice."""
MAX_COARSE_FREQUENCIES = 240
"""Most frequencies of a coarse spectrum, which keeps a document small: a choice."""
MAX_SPECTROGRAM_FREQUENCIES = 120
"""Most frequencies of a coarse spectrogram: a choice."""
MAX_SPECTROGRAM_TIMES = 80
"""Most times of a coarse spectrogram: a choice."""


class SensorMessage(NamedTuple):
    """A message with samples of a sensor, or of a term of the controllers, about three axes."""

    spectrum: str
    """Name of the spectrum that is computed from it."""
    message: str
    """Name of the message in ``Telemetry``."""
    fields: tuple[str, str, str]
    """Its fields of the three axes."""


SENSOR_MESSAGES = (
    SensorMessage("gyro_before", "GYRO_BEFORE", ("x", "y", "z")),
    SensorMessage("gyro_before", "HIGHRES_IMU", ("xgyro", "ygyro", "zgyro")),
    SensorMessage("gyro", "GYRO_AFTER", ("x", "y", "z")),
    SensorMessage("accelerometer_before", "ACCEL_BEFORE", ("x", "y", "z")),
    SensorMessage("accelerometer", "ACCEL_AFTER", ("x", "y", "z")),
    SensorMessage("d_term", "D_TERM", ("x", "y", "z")),
)
"""The messages of each sensor. PX4 fills HIGHRES_IMU with the gyro before its filters, rad/s."""
RATE_MESSAGE = "ATTITUDE"
"""Name of the message to which body rates after the gyro's filters are attributed."""
DEMAND_MESSAGE = "ACTUATOR_CONTROL_TARGET"
"""The message with the demand of the rate controllers."""


class CoarseSpectrum(NamedTuple):
    """A spectrum of k axes with P frequencies, and spectrograms of all axes together with Q frequencies."""

    frequency: Array
    """(P,) Hz, from 0 on."""
    mean_density: Array
    """(k, P) density of each axis, the mean over windows, unit²/Hz."""
    spectrogram_frequency: Array
    """(Q,) frequencies of the spectrograms, Hz."""
    time: Array
    """(W,) middles of the windows that are kept, s."""
    throttle: Array
    """(W,) mean output of the motors in these windows, 0 to 1; NaN where it is not known."""
    density_by_time: Array
    """(W, Q) density at each time, unit²/Hz."""
    throttle_levels: Array
    """(L,) mean throttle of each level, 0 to 1; empty where the throttle is not known."""
    density_by_throttle: Array
    """(L, Q) density at each level of the throttle, unit²/Hz."""


@dataclass(frozen=True, eq=False)
class Spectrum(ImmutableResult):
    """Power spectral density of one sensor, of the rate controllers' D term, or of their demand, in W windows."""

    name: str
    """Name of the sensor or signal, one of those in ``SENSOR_MESSAGES``, or "demand"."""
    unit: str
    """Unit of what was measured: "rad/s", "m/s²" or "1"."""
    source: str
    """Name of the message in the log."""
    frequency: Array
    """Frequencies (F,), Hz, from 0 on in even steps."""
    time: Array
    """Middle of each window (W,), s."""
    density: Array
    """One-sided density (W, k, F) about roll, pitch and yaw, or along forward, right and down, unit²/Hz."""
    throttle: Array
    """Mean output of the motors in each window (W,), 0 to 1; NaN where it is not known."""
    motor_speed: Array
    """Mean speed of the motors in each window (W,), turns per second; NaN where the log has none."""

    @property
    def nyquist_frequency(self) -> float:
        """Highest frequency: half of the samples' rate, Hz."""
        return self.frequency[-1]

    @property
    def mean_density(self) -> Array:
        """Density of each axis, averaged over windows (k, F), unit²/Hz."""
        return self.density.mean(axis=0)

    @cached_property
    def total_density(self) -> Array:
        """Density of all axes together, in each window (W, F), unit²/Hz."""
        return self.density.sum(axis=1)

    @cached_property
    def density_by_throttle(self) -> ArrayPair:
        """The spectrum as a function of throttle, which shows whether the frequency of a line depends on the motors.

        Windows are sorted by throttle and divided into L levels, at most ``THROTTLE_LEVELS``, of nearly the same number
        of windows.

        Returns:
            Mean throttle of each level (L,), 0 to 1, and its mean density, summed over the axes (L, F), unit²/Hz. Both
            are empty if the throttle is not known.
        """
        known_count = int(np.count_nonzero(np.isfinite(self.throttle)))
        if known_count == 0:
            return np.zeros(0), np.zeros((0, len(self.frequency)))
        # The windows by ascending throttle. NaN is sorted to the end, and left out.
        windows_by_throttle = np.argsort(self.throttle)[:known_count]
        level_count = min(THROTTLE_LEVELS, known_count)
        mean_throttles = []
        mean_densities = []
        for windows_of_level in np.array_split(windows_by_throttle, level_count):
            mean_throttles.append(self.throttle[windows_of_level].mean())
            mean_densities.append(self.total_density[windows_of_level].mean(axis=0))
        return np.array(mean_throttles), np.array(mean_densities)

    @property
    def coarse(self) -> CoarseSpectrum:
        """The spectrum with fewer frequencies and times, for documents and plots.

        Of neighbouring frequencies only the largest density is kept, since a mean would hide narrow lines, such as
        the lines of the motors. Of the times every k-th is kept.
        """
        frequency, mean_density = max_decimated(
            self.frequency, self.mean_density, MAX_COARSE_FREQUENCIES
        )
        spectrogram_frequency, density_by_time = max_decimated(
            self.frequency, self.total_density, MAX_SPECTROGRAM_FREQUENCIES
        )
        # The spectrum by throttle is decimated like the spectrogram, so that it has the same frequencies.
        throttle_levels, fine_density_by_throttle = self.density_by_throttle
        _, density_by_throttle = max_decimated(
            self.frequency, fine_density_by_throttle, MAX_SPECTROGRAM_FREQUENCIES
        )
        # Every ``time_step``-th time is kept.
        time_step = ceil(len(self.time) / MAX_SPECTROGRAM_TIMES)
        return CoarseSpectrum(
            frequency,
            mean_density,
            spectrogram_frequency,
            time=self.time[::time_step],
            throttle=self.throttle[::time_step],
            density_by_time=density_by_time[::time_step],
            throttle_levels=throttle_levels,
            density_by_throttle=density_by_throttle,
        )

    def mean_power(self, low: float, high: float) -> float:
        """Returns the power of all axes in a band, the integral of the density over frequency.

        Args:
            low: lower end of the band, Hz.
            high: upper end of the band, Hz.

        Returns:
            Power, averaged over windows, in unit².
        """
        is_between = (self.frequency >= low) & (self.frequency <= high)
        density_sum = self.total_density[:, is_between].mean(axis=0).sum()
        # Frequencies are uniform and begin at 0, so that the second one is the step.
        frequency_step = self.frequency[1]
        return density_sum * frequency_step


def max_decimated(frequency: Array, density: Array, max_points: int) -> ArrayPair:
    """Reduces the points of a spectrum for plotting; of neighbouring densities the largest is kept, to keep lines.

    Args:
        frequency: frequencies (F,), Hz.
        density: densities (…, F) of any kind; the leading dimensions are free.
        max_points: largest number of frequencies of the result.

    Returns:
        Mean frequency (P,) and largest density (…, P) of each group of neighbours. Frequencies at the end that do not
        fill a group are left out.
    """
    group_size = ceil(len(frequency) / max_points)
    group_count = len(frequency) // group_size
    used_count = group_count * group_size
    leading_shape = density.shape[:-1]
    # The last axis becomes two: the groups, and the neighbours in each of them.
    grouped_density = density[..., :used_count].reshape(*leading_shape, group_count, group_size)
    grouped_frequency = frequency[:used_count].reshape(group_count, group_size)
    return grouped_frequency.mean(axis=1), grouped_density.max(axis=-1)


def vibration_spectra(signals: Signals, segments: Segments) -> dict[str, Spectrum]:
    """Returns the spectra of a flight by name, such as "gyro" or "gyro_before" (``SENSOR_MESSAGES``).

    Several messages may have the same quantity, at different rates. The one that shows the highest frequency is used.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        segments: segments of the flight to use.

    Returns:
        Spectra by name; a quantity that was not recorded, or was recorded too slowly or too briefly, has none.
    """
    spectra = dict[str, Spectrum]()
    for samples in _recorded_samples(signals):
        spectrum = _spectrum(samples, signals, segments)
        if spectrum is None:
            continue
        earlier = spectra.get(samples.name)
        if earlier is None or spectrum.nyquist_frequency > earlier.nyquist_frequency:
            spectra[samples.name] = spectrum
    return spectra


class _Samples(NamedTuple):
    """Samples that a spectrum can be computed from."""

    name: str
    """Name of the spectrum."""
    message: str
    """Name of the message in ``Telemetry``."""
    series: TimeSeries
    """The N samples (N, 3), about roll, pitch and yaw, or along forward, right and down."""


def _recorded_samples(signals: Signals) -> Iterator[_Samples]:
    """Yields all recorded samples of sensors, body rates and demand.

    The same quantity may be in several messages at different rates, of which the caller chooses the fastest. So several
    samples may have one name.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.

    Yields:
        The samples of each message, of all boots.
    """
    for name, message, fields in SENSOR_MESSAGES:
        series = recorded_series(signals.telemetry, message, *fields)
        if series is not None:
            yield _Samples(name, message, series)
    yield from _recorded_body_rates(signals)
    demand = signals.telemetry.messages.get(DEMAND_MESSAGE)
    if demand is not None:
        demands = demand["controls"][:, : len(AXES)]
        yield _Samples("demand", DEMAND_MESSAGE, clean_series(demand, demands))


def _recorded_body_rates(signals: Signals) -> Iterator[_Samples]:
    """Yields the body rates about all three axes, which are measured by the gyro and filtered by the autopilot.

    They are in the messages of the rate controllers, with their setpoints, and in the messages of the attitude. Either
    is used only if all three axes have the same number of samples, so that they fit into one table.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
    """
    controller_rates = []
    attitude_rates = []
    for axis in AXES:
        axis_signals = signals.for_axis(axis)
        if axis_signals.rate_and_setpoint is not None:
            rate, _ = axis_signals.rate_and_setpoint
            controller_rates.append(rate)
        if axis_signals.attitude is not None:
            attitude_rates.append(axis_signals.attitude.rate_series)
    for rates in (controller_rates, attitude_rates):
        sample_counts = {len(rate.time) for rate in rates}
        if len(rates) != len(AXES) or len(sample_counts) != 1:
            continue
        rate_table = np.column_stack([rate.values for rate in rates])
        series = TimeSeries(rates[0].time, rates[0].boot, rate_table)
        yield _Samples("gyro", RATE_MESSAGE, series)


def _spectrum(samples: _Samples, signals: Signals, segments: Segments) -> Spectrum | None:
    """Estimates the spectrum of one sensor in each window of a flight, by periodograms with Hann's taper.

    Windows overlap by half and have no gaps. Their spectra are not averaged, since spectral lines move with the
    throttle. Samples are interpolated at even times first, because their stamps are rounded. Throttle and motor speed
    are averaged over each window.

    Args:
        samples: samples of one sensor, about or along three axes.
        signals: signals of the vehicle, for throttle and motor speed.
        segments: segments of the flight to use.

    Returns:
        The spectrum; ``None`` where the samples are slower than ``MIN_SAMPLING_RATE``, or there are fewer than
        ``MIN_WINDOWS`` windows.
    """
    series = samples.series
    steps = np.diff(series.time)
    usual_step = np.median(steps[steps > 0]) if np.any(steps > 0) else np.inf
    duration = len(series.time) * usual_step
    if usual_step > 1 / MIN_SAMPLING_RATE or duration < WINDOW_SECONDS / 2:
        return None
    # The number of samples of a window is the nearest power of two, for the fast Fourier transform.
    window_octaves = np.log2(WINDOW_SECONDS / usual_step)
    size = int(2 ** np.round(window_octaves))
    times = []
    densities = []
    for rows in _rows_without_gaps(series, segments, MAX_GAP_STEPS * usual_step):
        if len(rows) < size:
            continue
        time = series.time[rows]
        even_time = np.linspace(time[0], time[-1], len(rows))
        values = interpolated(even_time, time, series.values[rows])
        frequency, density = window_densities(values.T, 1 / usual_step, size)
        # The number of samples is even, and windows begin every half of it: the first one's middle is at half of it.
        middles = (np.arange(density.shape[1]) + 1) * (size // 2) * usual_step
        times.append(even_time[0] + middles)
        densities.append(density)
    if sum(map(len, times)) < MIN_WINDOWS:
        return None
    time = np.concatenate(times)
    return Spectrum(
        name=samples.name,
        unit=_unit(samples.name),
        source=signals.telemetry.name_in_source(samples.message),
        frequency=frequency,
        time=time,
        # The k axes come first in each part, (k, W, F), and the windows first in the spectrum, (W, k, F).
        density=np.concatenate(densities, axis=1).transpose(1, 0, 2),
        throttle=_window_means(signals.collective, time, segments),
        motor_speed=_window_means(_motor_speed(signals), time, segments),
    )


def _unit(name: str) -> str:
    """Returns the unit of the samples of a spectrum by its name; D term and demand are numbers, with the unit "1"."""
    if "gyro" in name:
        return "rad/s"
    if "accelerometer" in name:
        return "m/s²"
    return "1"


def _rows_without_gaps(series: TimeSeries, segments: Segments, max_gap: float) -> Iterator[Indices]:
    """Yields the indices of uninterrupted runs of samples, since a spectrum needs uniform samples.

    Args:
        series: samples with their times.
        segments: segments of the flight; each run lies within one of them.
        max_gap: longest time between two samples of a run, s.

    Yields:
        Indices (n,) of the samples of one run, ascending; n is 0 in a segment without samples.
    """
    for segment in segments:
        rows = np.flatnonzero(in_segments(series, segment, slack=0))
        is_gap_after = np.diff(series.time[rows]) > max_gap
        # A run ends before a gap, and another begins at the sample after it.
        starts_of_runs = np.flatnonzero(is_gap_after) + 1
        yield from np.split(rows, starts_of_runs)


def _window_means(series: TimeSeries | None, middles: Array, segments: Segments) -> Array:
    """Returns the mean of a series over each window of ``WINDOW_SECONDS``.

    A mean is the difference of two cumulative sums, divided by the number of samples, which is fast for many windows.

    Args:
        series: samples (N,) of a quantity; None if the log has none.
        middles: (W,) middle of each window, s.
        segments: segments of the flight that the windows lie in.

    Returns:
        (W,) means; NaN in windows without a sample. All are NaN without a series, or if the segments are from several
        boots, since the same time may occur in each of them.
    """
    boots = {segment.boot for segment in segments}
    if series is None or len(boots) > 1:
        return np.full(len(middles), np.nan)
    is_of_boot = np.isin(series.boot, list(boots))
    time = series.time[is_of_boot]
    cumulative = np.append(0.0, np.cumsum(series.values[is_of_boot]))
    first_rows = np.searchsorted(time, middles - WINDOW_SECONDS / 2)
    rows_after = np.searchsorted(time, middles + WINDOW_SECONDS / 2)
    counts = rows_after - first_rows
    sums = cumulative[rows_after] - cumulative[first_rows]
    # The maximum avoids a division by 0, whose result would not be used.
    means = sums / np.maximum(counts, 1)
    return np.where(counts > 0, means, np.nan)


def _motor_speed(signals: Signals) -> TimeSeries | None:
    """Returns the motor speeds that electronic speed controllers (ESCs) report, for all motors in one series.

    Each sample is the speed of one motor, so that the mean over a window is also a mean over the motors. Samples of
    motors that stand still are left out.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.

    Returns:
        Speeds in the order of time, revolutions per second; None if the log has no messages of ESCs.
    """
    speeds = []
    for controller in speed_controllers(signals):
        speeds.append(controller.speed.select(controller.speed.values > 0))
    if not speeds:
        return None
    time = np.concatenate([speed.time for speed in speeds])
    boot = np.concatenate([speed.boot for speed in speeds])
    turns_per_second = np.concatenate([speed.values for speed in speeds]) / 60.0
    # The last key is the first to sort by: boot, then time.
    order = np.lexsort((time, boot))
    return TimeSeries(time[order], boot[order], turns_per_second[order])
