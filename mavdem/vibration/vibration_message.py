"""Vibration and clipping of each IMU as measured by the autopilot and reported in VIBRATION."""

from dataclasses import dataclass, replace

import numpy as np
import scipy

from mavdem.arrays import Array, Flags
from mavdem.containers import Names
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import TimeSeries, clean_series, float_columns
from mavdem.ingest.telemetry import Telemetry, firmware_version
from mavdem.physical_constants import GRAVITY

LEVEL_FIELDS = ("vibration_x", "vibration_y", "vibration_z")
"""Fields with the vibration of the first IMU along each body axis, m/s²."""

FIRST_ACCELERATION_VERSION = (1, 13)
"""First version of PX4 whose level is that of the acceleration, m/s². Before, it was that of the increments of the
velocity from one sample of the IMU to the next, m/s, whose limits are not known."""

CLIPPING_FIELDS = ("clipping_0", "clipping_1", "clipping_2")
"""Fields that count since boot how often the accelerometer of each IMU was out of its range."""


MAX_LEVEL = 32 * GRAVITY
"""Vibration, m/s², beyond which a value is no measurement: the accelerometers of autopilots end at 16 or 32 g."""


@dataclass(frozen=True, eq=False)
class ReportedVibration:
    """Vibration and clipping of all IMUs at N samples."""

    axes: Names
    """Names of the k measured axes of an IMU: x, y and z; one empty name where all axes are measured together."""
    levels: TimeSeries
    """Vibration of all axes of all IMUs (N, k · IMUs), m/s², the axes of the first IMU first."""
    clips: Array
    """Number of times that each IMU was out of its range since the sample before (N, 3)."""

    def most_clips(self, samples: Flags) -> int:
        """Returns the number of clips of the IMU that clipped most, for which autopilots have limits.

        Args:
            samples: the samples to count (N,).
        """
        return most_clips(self.clips[samples])

    def largest_of_axes(self, levels: Array) -> Array:
        """Returns the vibration of each IMU along the axis that vibrates most.

        Args:
            levels: vibration of all axes of all IMUs (..., k · IMUs), m/s², in the order of ``levels``, such as its
                samples or their mean.

        Returns:
            The largest level of the k axes of each IMU (..., IMUs), m/s².
        """
        axis_count = len(self.axes)
        imu_count = levels.shape[-1] // axis_count
        levels_by_imu = levels.reshape(*levels.shape[:-1], imu_count, axis_count)
        return np.asarray(levels_by_imu.max(axis=-1))


def most_clips(clips: Array) -> int:
    """Returns the number of clips of the IMU that clipped most.

    Args:
        clips: number of times that each IMU was out of its range since the sample before (N, 3).
    """
    return int(clips.sum(axis=0).max())


def measures_acceleration(telemetry: Telemetry) -> bool:
    """Returns whether the reported levels are accelerations, m/s²; older PX4 reports increments of the velocity.

    Args:
        telemetry: autopilot, firmware and messages of the vehicle. A firmware of unknown version counts as a new one.
    """
    version = firmware_version(telemetry)
    return telemetry.autopilot != "PX4" or version is None or version >= FIRST_ACCELERATION_VERSION


def reported_vibration(signals: Signals) -> ReportedVibration | None:
    """Returns the vibration that the autopilot reports.

    ArduPilot reports three axes of each IMU, PX4 one level for all axes, in the field of z (``streams/VIBRATION.hpp``).
    Clipping is reported as counters since boot, of which the differences are returned.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.

    Returns:
        Vibration and clipping; ``None`` if they were not recorded, all levels are 0, or levels are no accelerations.
    """
    samples = _levels_and_clips(signals)
    if samples is None or not measures_acceleration(signals.telemetry):
        return None
    # The last columns are the clips of each IMU, those before are levels.
    levels, clips = np.split(samples.values, [-len(CLIPPING_FIELDS)], axis=1)
    axes = ("",) if signals.telemetry.autopilot == "PX4" else tuple("xyz")
    return ReportedVibration(axes, replace(samples, values=levels), clips)


def reported_clips(signals: Signals) -> TimeSeries | None:
    """Returns how often the accelerometers clipped, of every firmware.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.

    Returns:
        The number of times that each IMU was out of its range since the sample before (N, 3); ``None`` if it was not
        recorded, or all levels of vibration are 0.
    """
    samples = _levels_and_clips(signals)
    if samples is None:
        return None
    return replace(samples, values=samples.values[:, -len(CLIPPING_FIELDS) :])


def _levels_and_clips(signals: Signals) -> TimeSeries | None:
    """Returns the vibration levels of all IMUs, and how often each IMU clipped since the sample before.

    An accelerometer clips when the acceleration is beyond its range.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.

    Returns:
        Samples (N, k + 3): k levels, then the clips of three IMUs; ``None`` if VIBRATION was not recorded, or all
        levels are 0.
    """
    is_px4 = signals.telemetry.autopilot == "PX4"
    level_fields = LEVEL_FIELDS[-1:] if is_px4 else LEVEL_FIELDS
    columns = signals.telemetry.messages.get("VIBRATION")
    needed_fields = {*level_fields, *CLIPPING_FIELDS}
    if columns is None or not needed_fields <= columns.keys():
        return None
    # DataFlash logs have the levels of all IMUs, MAVLink has only the levels of the first.
    all_levels = columns.get("levels", float_columns(columns, level_fields))
    possible_levels = np.where(abs(all_levels) <= MAX_LEVEL, all_levels, np.nan)
    recorded_counts = float_columns(columns, CLIPPING_FIELDS)
    samples = clean_series(columns, np.column_stack([possible_levels, recorded_counts]))
    levels, counts = np.split(samples.values, [-len(CLIPPING_FIELDS)], axis=1)
    # A firmware without the measurement may send zeros.
    if not levels.any():
        return None
    # A single count that differs from both its neighbours is damaged; a median of three removes it.
    undamaged_counts = scipy.ndimage.median_filter(counts, size=(3, 1), mode="mirror")
    # The first sample has no clips. Counts begin at 0 in each boot; the negative difference there is set to 0.
    increases = np.diff(undamaged_counts, axis=0, prepend=undamaged_counts[:1])
    clips = np.maximum(increases, 0)
    return replace(samples, values=np.column_stack([levels, clips]))
