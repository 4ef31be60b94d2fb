"""The accelerometers of a boot: whether they measure gravity at rest, their peaks, and when the vehicle rested."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array, Flags
from mavdem.dataset.flight_states import min_airborne_collective
from mavdem.dataset.intervals import Intervals, TimeInterval, in_intervals
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import TimeSeries, recorded_series, series_of_boot
from mavdem.dataset.vehicle_cache import cached_per_vehicle
from mavdem.ingest.telemetry import Parameters
from mavdem.physical_constants import GRAVITY
from mavdem.witnesses.sensors import further_specific_forces, specific_force

MAX_GRAVITY_ERROR = 0.5
"""Deviation, m/s², of the specific force at rest from gravity, above which an accelerometer is not sound.

Calibrated sensors are within 0.15 m/s²; four real logs with wrong scales or offsets have 7.9 to 8.4 m/s² at rest.
"""

REST_SECONDS = 0.5
"""Length, s, of the windows in which rest is looked for."""

REST_RATE_RANGE = np.radians(6.0)
"""Range, rad/s, of each body rate within ``REST_SECONDS`` below which the vehicle may rest; idle motors shake less."""

REST_FORCE_RANGE = 2.0
"""Range, m/s², of the specific force within ``REST_SECONDS`` below which the vehicle may rest."""

MIN_PEAK_RATE = 20.0
"""Rate, Hz, from which on an accelerometer shows a knock; slower ones miss most of them."""

PEAK_ABOVE_REST = 18.0
"""Specific force above gravity, m/s², of a knock: no manoeuvre of 240 real flights reached it. A value of 14 found
one impact too many, one of 25 missed one."""

MIN_SAMPLES = 3
"""Number of samples whose median is the force at rest; a choice: the smallest number that tolerates an outlier."""


SELECTED_IMU = 0
"""Number of the series of the IMU that PX4 selects at each time, if several IMUs were logged."""

USE_PARAMETERS = {1: "INS_USE", 2: "INS_USE2", 3: "INS_USE3"}
"""ArduPilot's parameters that state whether each IMU is used, 0 or 1, by its number."""

IMU_MASK_PARAMETERS = ("EK3_IMU_MASK", "EK2_IMU_MASK")
"""ArduPilot's parameters with a bit for each IMU that has a core of the estimator, the newer first."""


class ForcePeak(NamedTuple):
    """The largest specific force in an interval of time."""

    time: float
    """When it was measured, s since boot."""

    size: float
    """Its size, m/s²."""


@dataclass(frozen=True, eq=False)
class AccelerometerRecord:
    """What one accelerometer shows in one boot."""

    number: int
    """Number of its IMU, from 1; ``SELECTED_IMU`` for that which PX4 selects."""
    is_used: bool | None
    """Whether the parameters of the autopilot use it; None if they do not state it."""
    time: Array
    """(N,) s since boot."""
    magnitude: Array
    """(N,) size of the specific force, m/s²."""
    force: Array
    """(N, 3) specific force along body x, y and z, m/s²."""
    rate: float
    """Samples per second, Hz."""
    gravity_at_rest: float | None
    """Size of the specific force while the vehicle rested, m/s²; None if it never did."""

    @property
    def name(self) -> str:
        """Name of the IMU, such as "IMU 2"."""
        return "the selected IMU" if self.number == SELECTED_IMU else f"IMU {self.number}"

    @property
    def is_sound(self) -> bool | None:
        """Whether gravity is what it should be at rest; None if the vehicle never rested."""
        if self.gravity_at_rest is None:
            return None
        return abs(self.gravity_at_rest - GRAVITY) <= MAX_GRAVITY_ERROR

    @property
    def shows_knocks(self) -> bool:
        """Whether the samples are close enough together to show a knock."""
        return self.rate >= MIN_PEAK_RATE

    def peak(self, interval: TimeInterval) -> ForcePeak | None:
        """Returns the largest specific force in an interval, and when it was measured.

        Args:
            interval: start and end, s since boot, both included.

        Returns:
            Its time, s since boot, and size, m/s²; None if the interval has no samples.
        """
        start, end = interval
        rows_in_interval = np.flatnonzero((self.time >= start) & (self.time <= end))
        if not len(rows_in_interval):
            return None
        row_of_peak = rows_in_interval[np.argmax(self.magnitude[rows_in_interval])]
        return ForcePeak(float(self.time[row_of_peak]), float(self.magnitude[row_of_peak]))

    def window_peaks(self, interval: TimeInterval, window_seconds: float) -> Array:
        """Returns the largest specific force in each of the successive windows of an interval.

        Args:
            interval: start and end, s since boot; a last window that is not whole is left out.
            window_seconds: duration of a window, s.

        Returns:
            (W,) sizes, m/s², of the windows that have samples.
        """
        start, end = interval
        whole_windows = max(int((end - start) // window_seconds), 0)
        # Number of the window in which each sample is, from 0. Samples before the interval have negative numbers.
        window_numbers = np.floor((self.time - start) / window_seconds)
        is_in_window = (window_numbers >= 0) & (window_numbers < whole_windows)
        # The windows that have samples, and for each sample the row of its window among them.
        windows_with_samples, window_rows = np.unique(
            window_numbers[is_in_window], return_inverse=True
        )
        peaks = np.full(len(windows_with_samples), -np.inf)
        # Each sample raises the peak of its window if it is larger than that.
        np.maximum.at(peaks, window_rows, self.magnitude[is_in_window])
        return peaks

    @property
    def knock_size(self) -> float:
        """Specific force, m/s², from which on a peak is a knock: gravity, as it was measured, and a margin."""
        return (self.gravity_at_rest or GRAVITY) + PEAK_ABOVE_REST


@cached_per_vehicle()
def accelerometer_records(signals: Signals, boot: int) -> tuple[AccelerometerRecord, ...]:
    """Returns what every accelerometer measured in one boot: its samples, their rate, and gravity at rest.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.

    Returns:
        The accelerometers in the order of their IMUs; empty if none was recorded.
    """
    # Specific force (acceleration less gravity) by the number of the IMU, as far as messages have the number.
    forces_by_imu = dict(further_specific_forces(signals))
    force_without_number = specific_force(signals)
    if force_without_number is not None:
        # PX4 logs the IMU that it selects at each time without a number, and all IMUs by number besides. ArduPilot logs
        # the first IMU without a number, and only the others with theirs.
        has_first_imu = 1 in forces_by_imu
        number = SELECTED_IMU if has_first_imu else 1
        forces_by_imu[number] = force_without_number
    records = []
    for number, force in sorted(forces_by_imu.items()):
        is_used = _is_used(signals.telemetry.parameters, number)
        record = _measured_accelerometer(signals, boot, number, is_used, force)
        if record is not None:
            records.append(record)
    return tuple(records)


def _is_used(parameters: Parameters, number: int) -> bool | None:
    """Returns whether ArduPilot uses an IMU: it is switched on, and an instance of the EKF runs on it.

    Args:
        parameters: values of the autopilot's parameters by their names.
        number: number of the IMU (inertial measurement unit), from 1.

    Returns:
        Whether it is used; None if the parameters do not say on which IMUs the EKF runs.
    """
    if parameters.get(USE_PARAMETERS.get(number, ""), 1) == 0:
        return False
    mask = _imu_mask(parameters)
    if mask is None:
        return None
    # IMUs are numbered from 1, bits of the mask from 0.
    bit = 1 << (number - 1)
    return bool(mask & bit)


def _imu_mask(parameters: Parameters) -> int | None:
    """Returns the bit mask of the IMUs that instances of ArduPilot's EKF run on; None if no parameter has it."""
    for name in IMU_MASK_PARAMETERS:
        if name in parameters:
            return int(parameters[name])
    return None


def _measured_accelerometer(
    signals: Signals, boot: int, number: int, is_used: bool | None, specific_forces: TimeSeries
) -> AccelerometerRecord | None:
    """Measures one accelerometer in a boot: its sample rate, its specific force, and gravity while the vehicle rests.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        number: number of the IMU (inertial measurement unit), from 1.
        is_used: whether the parameters use it; None if they do not state it.
        specific_forces: specific force (N, 3) of all boots, m/s².

    Returns:
        The record, whose gravity at rest is None if the vehicle did not rest for ``MIN_SAMPLES``. None if the boot has
        fewer samples than that.
    """
    force = series_of_boot(specific_forces, boot)
    if force is None or len(force.time) < MIN_SAMPLES:
        return None
    duration = force.time[-1] - force.time[0]
    sample_rate = 0.0
    if duration > 0:
        sample_rate = (len(force.time) - 1) / duration
    magnitude = np.linalg.norm(force.values, axis=1)
    is_at_rest = in_intervals(force.time, rest_intervals(signals, boot))
    gravity_at_rest = None
    if is_at_rest.sum() >= MIN_SAMPLES:
        gravity_at_rest = float(np.median(magnitude[is_at_rest]))
    return AccelerometerRecord(
        number=number,
        is_used=is_used,
        time=force.time,
        magnitude=magnitude,
        force=force.values,
        rate=sample_rate,
        gravity_at_rest=gravity_at_rest,
    )


@cached_per_vehicle()
def accelerometer_in_use(signals: Signals, boot: int) -> AccelerometerRecord | None:
    """Returns the accelerometer that is used for a boot.

    It is the one whose estimate the controllers use, if the log states that. Otherwise it is the first one that the
    parameters do not exclude from use, or the first of all if they exclude every one.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.

    Returns:
        The accelerometer; None if none was recorded.
    """
    records = accelerometer_records(signals, boot)
    primary_imu = _imu_of_primary_core(signals, boot)
    for record in records:
        if record.number == primary_imu:
            return record
    # Where the parameters do not state the use (None), the accelerometer may be in use.
    not_excluded = [record for record in records if record.is_used is not False]
    candidates = not_excluded or records
    return candidates[0] if candidates else None


def _imu_of_primary_core(signals: Signals, boot: int) -> int | None:
    """Returns the number of the IMU whose core of the estimator was the primary one for most of a boot.

    ArduPilot runs one instance ("core") of its estimator for each IMU in its mask: the first core has the IMU of the
    lowest bit. The primary core is the one whose estimate the controllers use.

    Args:
        signals: signals of the vehicle, with the log of the core in use and the parameters.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.

    Returns:
        The number, from 1; None if it is not known, or the autopilot is PX4, which numbers its instances otherwise.
    """
    if signals.telemetry.autopilot == "PX4":
        return None
    mask = _imu_mask(signals.telemetry.parameters)
    recorded_cores = recorded_series(
        signals.telemetry, "estimator_selector_status", "primary_instance"
    )
    primary_core = series_of_boot(recorded_cores, boot)
    if primary_core is None or mask is None:
        return None
    # Number of the IMU of each core, in the order of the cores.
    imu_of_core = []
    for bit in range(len(USE_PARAMETERS)):
        is_bit_set = bool(mask >> bit & 1)
        if is_bit_set:
            # IMUs are numbered from 1, and bits from 0.
            imu_of_core.append(bit + 1)
    # The core that was the primary one for most of the boot.
    usual_core = int(np.median(primary_core.values))
    is_core_known = 0 <= usual_core < len(imu_of_core)
    return imu_of_core[usual_core] if is_core_known else None


@cached_per_vehicle()
def rest_intervals(signals: Signals, boot: int) -> Intervals:
    """Returns the intervals in which the vehicle rested on the ground.

    It rests in windows of ``REST_SECONDS`` in which it is still while the motors idle or are off; where their outputs
    were not recorded, being still is enough. Neighbouring windows are joined to one interval.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.

    Returns:
        The intervals, s since boot.
    """
    windows = still_windows(signals, boot)
    if windows is None:
        return []
    middles = windows.start + REST_SECONDS / 2
    has_power = is_powered(signals, boot, middles)
    is_rest = windows.is_still if has_power is None else windows.is_still & ~has_power
    joined_intervals: Intervals = []
    for window_start in windows.start[is_rest].tolist():
        window_end = window_start + REST_SECONDS
        if joined_intervals:
            last_start, last_end = joined_intervals[-1]
            if window_start <= last_end:
                # This window touches the last interval, and makes it longer.
                joined_intervals[-1] = (last_start, window_end)
                continue
        joined_intervals.append((window_start, window_end))
    return joined_intervals


@dataclass(frozen=True, eq=False)
class StillWindows:
    """Windows of ``REST_SECONDS`` on an even grid that cover the attitude of one boot, but not its gaps."""

    start: Array
    """(W,) s since boot."""
    is_still: Flags
    """(W,) whether body rates and specific force hardly vary in the window."""


@cached_per_vehicle()
def still_windows(signals: Signals, boot: int) -> StillWindows | None:
    """Divides a boot into windows, and decides in which of them the vehicle is still, on the ground or in calm air.

    It is still in a window if the ranges of every body rate and of the specific force are below their limits. A gyro
    that measures the same throughout is dead and shows nothing.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.

    Returns:
        The windows (:func:`_window_starts`), with a flag for each; None without body rates.
    """
    rates = []
    for attitude in signals.attitudes:
        rate = series_of_boot(attitude.rate_series, boot)
        if rate is not None:
            rates.append(rate)
    if not rates or not any(np.ptp(rate.values) for rate in rates):
        return None
    window_starts = _window_starts(rates[0].time)
    is_still = np.ones(len(window_starts), dtype=bool)
    for rate in rates:
        is_still &= window_ranges(rate.time, rate.values, window_starts) < REST_RATE_RANGE
    force = series_of_boot(specific_force(signals), boot)
    if force is not None:
        magnitude = np.linalg.norm(force.values, axis=1)
        force_ranges = window_ranges(force.time, magnitude, window_starts)
        # A window without samples of the force has the range NaN, which is not above the limit: there only the body
        # rates decide.
        is_still &= ~(force_ranges > REST_FORCE_RANGE)
    return StillWindows(window_starts, is_still)


def _window_starts(time: Array) -> Array:
    """Returns the starts (W,), s, of windows of ``REST_SECONDS`` on an even grid, those with samples of a record.

    Windows without a sample would show nothing, and may be very many: one wrong time stamp can make a gap of weeks.

    Args:
        time: (N,) times of the samples, s, ascending.
    """
    window_numbers = np.unique((time - time[0]) // REST_SECONDS)
    return time[0] + REST_SECONDS * window_numbers


def window_ranges(time: Array, values: Array, window_starts: Array) -> Array:
    """Returns the range of a signal in each window, its largest value less its smallest one.

    Args:
        time: (N,) times of the samples, s, ascending.
        values: (N,) samples.
        window_starts: (W,) starts of windows of ``REST_SECONDS``, s, ascending.

    Returns:
        (W,) ranges, in the unit of the samples; NaN in windows with fewer than two samples.
    """
    # Indices of the first sample in each window, and of the first one after it.
    first_samples = np.searchsorted(time, window_starts)
    end_samples = np.searchsorted(time, window_starts + REST_SECONDS)
    # ``reduceat`` reduces from each index up to the next one: windows are every other of these intervals. It takes only
    # indices of samples, so that one follows for a window that ends with the record.
    bounds = np.column_stack([first_samples, end_samples]).ravel()
    samples = np.append(values, 0.0)
    largest = np.maximum.reduceat(samples, bounds)[::2]
    smallest = np.minimum.reduceat(samples, bounds)[::2]
    return np.where(end_samples - first_samples >= 2, largest - smallest, np.nan)


def is_powered(signals: Signals, boot: int, time: Array) -> Flags | None:
    """Returns at which times the mean output of the motors is high enough to carry the vehicle.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        time: (T,) s since boot.

    Returns:
        Flags (T,); None if motor outputs were not recorded.
    """
    collective = series_of_boot(signals.collective, boot)
    if collective is None:
        return None
    min_collective = min_airborne_collective(signals.telemetry.parameters)
    return np.asarray(np.interp(time, collective.time, collective.values) > min_collective)
