"""Innovations of a state estimator: measurement minus prediction, and how long the filter rejected measurements.

Each innovation is divided by the limit of the filter's test, so that the filter rejects the measurement at a ratio of 1
or more.
"""

from dataclasses import dataclass

import numpy as np

from mavdem.arrays import Array, Flags
from mavdem.dataset.intervals import (
    intersection,
    longest_true_duration,
    total_duration,
    true_intervals,
)
from mavdem.dataset.time_series import (
    TimeSeries,
    clean_series,
    float_column,
    float_columns,
)
from mavdem.ingest.mavlink.dialect import mavlink_constant
from mavdem.ingest.px4_instances import RATIO_FIELDS, UNFILTERED_ENDING
from mavdem.ingest.telemetry import Telemetry, firmware_version
from mavdem.ingest.vocabulary import EstimatorRatio

INNOVATIONS = tuple(EstimatorRatio)
"""The innovations that are judged, in the order of the columns of :func:`innovation_ratios`."""

GLITCH_COLUMN = len(INNOVATIONS)
"""Index of the column of :func:`innovation_ratios` with the filter's flag for a glitch of GPS, after the ratios."""

INNOVATION_FIELDS = {
    "EKF_STATUS_REPORT": (
        "velocity_variance",
        "pos_horiz_variance",
        "pos_vert_variance",
        "compass_variance",
    ),
    "ESTIMATOR_STATUS": ("vel_ratio", "pos_horiz_ratio", "pos_vert_ratio", "mag_ratio"),
}
"""Messages with the ``INNOVATIONS``, each as a ratio to what the filter accepts."""

GLITCH_FLAGS = {
    "EKF_STATUS_REPORT": mavlink_constant("EKF_GPS_GLITCHING"),
    "ESTIMATOR_STATUS": mavlink_constant("ESTIMATOR_GPS_GLITCH"),
}
"""Bits of the ``flags`` of these messages by which the filter says that it does not agree with GPS ("glitch")."""

INNOVATION_LIMIT = 1.0
"""Innovation ratio at which the filters of PX4 and ArduPilot reject a measurement."""

MAX_RATIO = 1000.0
"""Innovation ratio to which larger ones are limited, also infinite ones: a choice; the filter is lost long before."""

ARDUPILOT_FAILSAFE_LIMIT = 0.8
"""Innovation ratio from which ArduCopter's ``ekf_check.cpp`` doubts the filter: the default of FS_EKF_THRESH."""

FAILSAFE_SECONDS = 1.0
"""Time, s, for which ArduCopter's ``ekf_check.cpp`` doubts the filter before its failsafe."""

FIRST_FILTERING_VERSION = (1, 15)
"""First version of PX4 whose estimator_status has low-passed ratios (``test_ratio_filtered`` of the aiding sources)."""


@dataclass(frozen=True)
class Rejection:
    """Which innovation of a filter exceeded its limit longest in one flight, or was the largest.

    If ArduCopter's failsafe would have acted, it is one of the innovations that the failsafe checks.
    """

    name: EstimatorRatio
    """The innovation."""
    ratio: float
    """Its largest value, as a ratio to the ``INNOVATION_LIMIT``."""
    time: float
    """When it was that large, s."""
    duration: float
    """For how long, s, it exceeded the limit without a break."""
    total_duration: float
    """For how long, s, it exceeded the limit in all; single accepted samples, as after a reset, part the times."""
    failsafe_duration: float
    """For how long, s, ArduCopter's failsafe would have counted without a break."""

    @property
    def is_rejected_long(self) -> bool:
        """Whether the filter rejected the measurement for ``FAILSAFE_SECONDS`` or longer."""
        return self.duration >= FAILSAFE_SECONDS

    @property
    def triggers_failsafe(self) -> bool:
        """Whether ArduCopter's failsafe would have acted."""
        return self.failsafe_duration >= FAILSAFE_SECONDS


def innovation_ratios(telemetry: Telemetry) -> TimeSeries | None:
    """Returns the estimator's innovations divided by the limits of its tests (innovation ratios).

    An innovation is a measurement minus its prediction by the filter. At a ratio of 1 the filter's test just accepts
    the measurement. ArduPilot and PX4 have different messages with these ratios; the first that has all of them is
    used.

    Args:
        telemetry: messages of the vehicle.

    Returns:
        Samples (N, 5): the ratios of velocity, position, height and compass, 0 for one that is not known, and the
        filter's flag for a glitch of GPS, 0 or 1. None if no message has them, or if they are all 0 because the filter
        does not run.
    """
    for message, fields in INNOVATION_FIELDS.items():
        columns = telemetry.messages.get(message, {})
        if not all(field in columns for field in fields):
            continue
        ratios = finite_ratios(float_columns(columns, fields))
        is_filter_running = ratios.any()
        if not is_filter_running:
            continue
        flags = np.zeros(len(ratios))
        if "flags" in columns:
            flags = np.nan_to_num(float_column(columns, "flags"))
        is_glitching = flags.astype(np.int64) & GLITCH_FLAGS[message] > 0
        return clean_series(columns, np.column_stack([ratios, is_glitching]))
    return None


def finite_ratios(ratios: Array) -> Array:
    """Returns innovation ratios with 0 in the place of ones that are not known (NaN), and at most ``MAX_RATIO``."""
    return np.minimum(np.nan_to_num(ratios, posinf=MAX_RATIO, neginf=0.0), MAX_RATIO)


def failsafe_innovation_limit(telemetry: Telemetry) -> float:
    """Looks up the innovation ratio from which on the autopilot's failsafe counts an innovation.

    It is the limit of the filter's own test for PX4, and the parameter FS_EKF_THRESH for ArduPilot. If that was not
    logged, or is 0, which disables the failsafe, its default is used.

    Args:
        telemetry: autopilot and parameters of the vehicle.

    Returns:
        The ratio, without unit.
    """
    if telemetry.autopilot == "PX4":
        return INNOVATION_LIMIT
    return telemetry.parameters.get("FS_EKF_THRESH", 0.0) or ARDUPILOT_FAILSAFE_LIMIT


def longest_rejection(time: Array, ratios: Array, failsafe_limit: float) -> Rejection:
    """Finds the innovation that exceeded its limit longest, or the largest one if none did.

    An innovation is a measurement minus its prediction by the filter, here divided by the limit of the filter's test.
    ArduCopter's failsafe has another limit, and does not check the height (:func:`_meets_failsafe`).

    Args:
        time: (N,) times of the samples, s since boot.
        ratios: (N, 4) innovations of velocity, position, height and compass, over the limit of the filter's own test.
        failsafe_limit: ratio from which on ArduCopter's failsafe counts an innovation, as by
            :func:`failsafe_innovation_limit`.

    Returns:
        The innovation with its largest ratio, the time of that, s since boot, and how long it exceeded its limit
        without a break and in all, s; and how long the failsafe's condition held, s.
    """
    # The longest time, s, for which each of the four innovations exceeded the filter's own limit.
    is_rejected = ratios >= INNOVATION_LIMIT
    durations = [longest_true_duration(time, is_exceeded) for is_exceeded in is_rejected.T]
    largest_ratios = ratios.max(axis=0)
    failsafe_duration = longest_true_duration(time, _meets_failsafe(ratios, failsafe_limit))
    # If the failsafe would have acted, the worst innovation must be one that it checks: not that of the height.
    has_failsafe_acted = failsafe_duration >= FAILSAFE_SECONDS
    candidates = []
    for column, name in enumerate(INNOVATIONS):
        if not (has_failsafe_acted and name is EstimatorRatio.HEIGHT):
            candidates.append(column)
    # The largest is the worst of innovations that exceeded the limit equally long, or not at all.
    worst_column = max(candidates, key=lambda column: (durations[column], largest_ratios[column]))
    rejected_intervals = true_intervals(time, is_rejected[:, worst_column])
    return Rejection(
        INNOVATIONS[worst_column],
        ratio=float(largest_ratios[worst_column] / INNOVATION_LIMIT),
        time=float(time[ratios[:, worst_column].argmax()]),
        duration=durations[worst_column],
        total_duration=total_duration(intersection(rejected_intervals, [(time[0], time[-1])])),
        failsafe_duration=failsafe_duration,
    )


def _meets_failsafe(ratios: Array, failsafe_limit: float) -> Flags:
    """Determines at which samples the condition of ArduCopter's EKF failsafe holds (``ekf_check.cpp``).

    Two of the innovations of velocity, position and compass must exceed its limit; a velocity innovation of twice the
    limit counts as two.

    Args:
        ratios: (N, 4) innovations of velocity, position, height and compass, over the limit of the filter's own test.
        failsafe_limit: ratio from which on the failsafe counts an innovation.

    Returns:
        (N,) whether it holds.
    """
    velocity_ratio, position_ratio, _, compass_ratio = ratios.T
    exceeding_count = np.zeros(len(ratios))
    exceeding_count += velocity_ratio >= failsafe_limit
    exceeding_count += velocity_ratio >= 2 * failsafe_limit
    exceeding_count += position_ratio >= failsafe_limit
    exceeding_count += compass_ratio >= failsafe_limit
    return exceeding_count >= 2


def latest_time_above(telemetry: Telemetry, name: EstimatorRatio, limit: float) -> float | None:
    """Returns when an innovation was last at or above a limit.

    Args:
        telemetry: messages of the vehicle.
        name: the innovation.
        limit: its ratio to the limit of the filter's test.

    Returns:
        The time, s since boot; None if it never was, or is not recorded.
    """
    ratios = innovation_ratios(telemetry)
    if ratios is None:
        return None
    is_above = ratios.values[:, INNOVATIONS.index(name)] >= limit
    return float(ratios.time[is_above][-1]) if is_above.any() else None


def is_low_passed(telemetry: Telemetry, name: EstimatorRatio) -> bool:
    """Returns whether the ratios of an innovation are low-passed, so that single samples may have been larger.

    PX4 filters them before it sends them, from ``FIRST_FILTERING_VERSION`` on. A log may have the unfiltered ratios of
    its aiding sources too, such as GPS, which are used instead.

    Args:
        telemetry: autopilot, firmware and messages of the vehicle.
        name: the innovation.
    """
    if telemetry.autopilot != "PX4":
        return False
    version = firmware_version(telemetry)
    if version is None or version < FIRST_FILTERING_VERSION:
        return False
    columns = telemetry.messages.get("ESTIMATOR_STATUS", {})
    # Flags of the samples whose ratio is unfiltered.
    is_unfiltered = columns.get(RATIO_FIELDS[name] + UNFILTERED_ENDING)
    has_unfiltered_ratios = is_unfiltered is not None and bool(is_unfiltered.any())
    return not has_unfiltered_ratios


def instance_name(telemetry: Telemetry, number: int) -> str:
    """Returns the autopilot's name of an instance of its estimator: "core 1" of ArduPilot, "instance 1" of PX4."""
    kind = "instance" if telemetry.autopilot == "PX4" else "core"
    return f"{kind} {number}"
