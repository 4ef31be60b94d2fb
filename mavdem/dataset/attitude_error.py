"""How far roll and pitch are from their setpoints, with a second of tolerance for the vehicle to follow them."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from mavdem.arrays import Array, Flags
from mavdem.dataset.axes import PITCH, ROLL
from mavdem.dataset.extreme_tilt import MAX_TILT
from mavdem.dataset.grounded import MAX_SETPOINT_DELAY
from mavdem.dataset.intervals import TimeInterval, in_intervals
from mavdem.dataset.signals import Signals
from mavdem.dataset.steady_flight import attitude_tracking
from mavdem.ingest.telemetry import rate_without_gaps
from mavdem.ingest.vocabulary import wrapped_angle


@dataclass(frozen=True, eq=False)
class AttitudeError:
    """The error of roll and pitch at N samples of one boot."""

    time: Array
    """(N,) times, s on the boot clock."""
    lean: NDArray[np.complex128]
    """(N,) rad, direction and size of the error as a lean of the body's vertical axis: the real part is forward, the
    imaginary part to the right."""
    magnitude: Array
    """(N,) rad, absolute value of the lean."""
    is_toppled: Flags
    """(N,) whether the vehicle itself is tilted by more than ``MAX_TILT``, with any setpoint."""
    has_setpoint: Flags
    """(N,) whether the setpoint of the angle is known."""


WITHOUT_SETPOINT_SHARE = 0.5
"""Fraction of an angle that counts as its error where its setpoint was not recorded: the rest may be intended.

A choice, in the middle, since such an angle may be intended wholly or not at all.
"""


class LargestError(NamedTuple):
    """The largest error of roll and pitch in an interval; its fields are the figures of a fact that states it."""

    angle: float
    """The error, rad. If the setpoint is not known, it is the whole lean, of which only half counts as error."""
    has_setpoint: bool
    """Whether the setpoint was known at that time."""
    time: float
    """When it was so large, s since boot."""

    @property
    def counted_angle(self) -> float:
        """What counts as error of the angle, rad: all of it with a setpoint, ``WITHOUT_SETPOINT_SHARE`` without."""
        return self.angle if self.has_setpoint else WITHOUT_SETPOINT_SHARE * self.angle


def largest_error(error: AttitudeError, interval: TimeInterval) -> LargestError | None:
    """Returns the largest error of roll and pitch in an interval.

    Args:
        error: error of the attitude in a boot, rad.
        interval: start and end, s since boot.

    Returns:
        The error, rad; if the setpoint was not recorded, the whole lean. None without a sample in the interval.
    """
    samples = np.flatnonzero(in_intervals(error.time, [interval]))
    if not len(samples):
        return None
    worst_sample = samples[error.magnitude[samples].argmax()]
    angle = float(error.magnitude[worst_sample])
    has_setpoint = bool(error.has_setpoint[worst_sample])
    if not has_setpoint:
        # Without a setpoint ``attitude_error`` counts only this fraction of the lean as error. Dividing restores the
        # lean.
        angle /= WITHOUT_SETPOINT_SHARE
    return LargestError(angle, has_setpoint, float(error.time[worst_sample]))


def attitude_error(signals: Signals, boot: int) -> AttitudeError | None:
    """Computes the error of roll and pitch in a boot.

    The error is the distance of an angle from the range of its setpoints in the last ``MAX_SETPOINT_DELAY`` seconds. So
    a step of the setpoint is not an error until the vehicle had time to follow it. If the setpoint was not recorded,
    the fraction ``WITHOUT_SETPOINT_SHARE`` of the angle counts as error, and the rest as intended. If body rates are
    commanded instead of angles, as in Acro mode, every angle counts as intended.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.

    Returns:
        The error (N,), rad, at the samples of the attitude; None if fewer than two were recorded.
    """
    tracking = attitude_tracking(signals, boot)
    if tracking is None or len(tracking.time) < 2:
        return None
    window = samples_to_follow(tracking.time)
    errors = []
    for column in (ROLL, PITCH):
        angle_error = _angle_error(
            tracking.angles[:, column],
            tracking.setpoints[:, column],
            tracking.is_rate_controlled[:, column],
            window,
        )
        errors.append(angle_error)
    roll_error, pitch_error = errors
    roll = tracking.angles[:, ROLL]
    pitch = tracking.angles[:, PITCH]
    # The lean as a complex number: forward is real, right is imaginary. Positive pitch is nose up and leans the vehicle
    # backward. The more the vehicle is pitched, the less does roll lean it sideways.
    lean = np.asarray(1j * roll_error * np.cos(pitch) - pitch_error, np.complex128)
    return AttitudeError(
        time=tracking.time,
        lean=lean,
        magnitude=np.abs(lean),
        is_toppled=np.cos(roll) * np.cos(pitch) < np.cos(MAX_TILT),
        has_setpoint=~np.isnan(tracking.setpoints[:, PITCH]),
    )


def _angle_error(angle: Array, setpoint: Array, is_rate_controlled: Flags, window: int) -> Array:
    """Computes the error of roll or pitch as :func:`attitude_error` defines it.

    Each angle has a call of its own, since the temporary arrays of both would take much memory in hours of flight.

    Args:
        angle: (N,) rad.
        setpoint: (N,) setpoint of the angle, rad; NaN where there is none.
        is_rate_controlled: (N,) whether the rate of the angle had a setpoint.
        window: number of samples in the time within which the vehicle must follow a setpoint.

    Returns:
        The error (N,), rad.
    """
    is_unknown = np.isnan(setpoint)
    known_setpoint = np.where(is_unknown, 0.0, setpoint)
    lowest_setpoint, highest_setpoint = recent_range(known_setpoint, window)
    error_without_setpoint = np.where(is_rate_controlled, 0.0, WITHOUT_SETPOINT_SHARE * angle)
    error_with_setpoint = angle - np.clip(angle, lowest_setpoint, highest_setpoint)
    return wrapped_angle(np.where(is_unknown, error_without_setpoint, error_with_setpoint))


def samples_to_follow(time: Array) -> int:
    """Returns the number of samples, at least 1, in the ``MAX_SETPOINT_DELAY`` in which a vehicle follows a setpoint.

    Args:
        time: (N,) times of the samples, s, at least two, ascending.
    """
    return max(1, round(MAX_SETPOINT_DELAY * rate_without_gaps(np.diff(time))))


class RecentRange(NamedTuple):
    """The range of a setpoint in a window that ends with each of N samples."""

    lowest: Array
    """(N,) the lowest value, in the unit of the setpoint."""
    highest: Array
    """(N,) the highest value, in the same unit."""


def recent_range(setpoint: Array, window: int) -> RecentRange:
    """Returns the lowest and the highest value of a setpoint in the window that ends with each sample.

    Args:
        setpoint: (N,) values, without NaN.
        window: number of samples in the window.
    """
    # SciPy centres its windows on the samples. Shifted by half of their length, they end with the samples.
    shift = (window - 1) // 2
    return RecentRange(
        scipy.ndimage.minimum_filter1d(setpoint, window, origin=shift),
        scipy.ndimage.maximum_filter1d(setpoint, window, origin=shift),
    )
