"""Position: whether the estimator reports that it has one, and whether GPS had a fix."""

from dataclasses import dataclass, replace

import numpy as np

from mavdem.arrays import Array
from mavdem.dataset.intervals import in_intervals
from mavdem.dataset.position_fix import RECEIVER_MESSAGES, has_position_fix
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import (
    TimeSeries,
    clean_series,
    float_column,
    recorded_series,
    series_of_boot,
)
from mavdem.dataset.vehicle_cache import cached_per_vehicle
from mavdem.ingest.mavlink.dialect import mavlink_constant
from mavdem.ingest.telemetry import Telemetry
from mavdem.wind_velocity.from_log import STANDSTILL_ASSUMED
from mavdem.witnesses.flight_check import powered_intervals

POSITION_FLAGS = {
    "EKF_STATUS_REPORT": ("EKF_POS_HORIZ_ABS", "EKF_POS_HORIZ_REL"),
    "ESTIMATOR_STATUS": ("ESTIMATOR_POS_HORIZ_ABS", "ESTIMATOR_POS_HORIZ_REL"),
}
"""Messages with ``flags`` of the estimator, and the bits that it has a horizontal position, the preferred first.

A relative position, of optical flow, counts for vehicles that never have an absolute one.
"""


@cached_per_vehicle()
def position_validity(signals: Signals) -> TimeSeries | None:
    """Determines at which times the estimator reports a horizontal position.

    PX4's vehicle_local_position has a flag for that; otherwise the flags of the estimator's status are used. If none of
    them is ever set, this estimator may not fill them in, so that nothing is known. But an ArduPilot whose flags also
    report, at any time, that it assumes a standstill does fill them in: it never had a position in the whole record.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.

    Returns:
        (N,) 1 or 0; None if nothing reports it.
    """
    columns = signals.telemetry.messages.get("LOCAL_POSITION_NED", {})
    if "valid" in columns:
        return clean_series(columns, float_column(columns, "valid"))
    for message, names in POSITION_FLAGS.items():
        flags = recorded_series(signals.telemetry, message, "flags")
        if flags is None:
            continue
        for name in names:
            has_position = flags.values.astype(np.int64) & mavlink_constant(name) > 0
            # A flag that is never set is not filled in by this estimator.
            if has_position.any():
                return TimeSeries(flags.time, flags.boot, has_position.astype(float))
    standstill = assumed_standstill(signals)
    if standstill is not None and standstill.values.any():
        return replace(standstill, values=np.zeros_like(standstill.values))
    return None


def assumed_standstill(signals: Signals) -> TimeSeries | None:
    """Determines at which times ArduPilot's estimator assumes a standstill, since nothing measures the position.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.

    Returns:
        (N,) 1 or 0; None if it does not report its status.
    """
    flags = recorded_series(signals.telemetry, "EKF_STATUS_REPORT", "flags")
    if flags is None:
        return None
    is_assumed = flags.values.astype(np.int64) & STANDSTILL_ASSUMED > 0
    return TimeSeries(flags.time, flags.boot, is_assumed.astype(float))


def receiver_message(telemetry: Telemetry) -> str | None:
    """Returns the message of the first satellite receiver whose fixes were recorded; None without one."""
    for message in RECEIVER_MESSAGES:
        if recorded_series(telemetry, message, "fix_type") is not None:
            return message
    return None


@cached_per_vehicle()
def position_fix(signals: Signals) -> TimeSeries | None:
    """Determines at which times any GPS receiver had a position fix.

    The N samples are at the messages of the first receiver that was recorded, in all boots.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.

    Returns:
        (N,) 1 or 0; None if no receiver was recorded.
    """
    message = receiver_message(signals.telemetry)
    if message is None:
        return None
    fix_types = recorded_series(signals.telemetry, message, "fix_type")
    assert fix_types is not None
    has_fix = np.zeros(len(fix_types.time))
    for boot in np.unique(fix_types.boot).tolist():
        is_of_boot = fix_types.boot == boot
        has_fix[is_of_boot] = has_position_fix(signals.telemetry, boot, fix_types.time[is_of_boot])
    return TimeSeries(fix_types.time, fix_types.boot, has_fix)


@dataclass(frozen=True, eq=False)
class PositionRecord:
    """What is known of the horizontal position in one boot."""

    fix: TimeSeries | None
    """Whether any GPS receiver had a fix (N,), 1 or 0; None if no receiver was recorded."""
    validity: TimeSeries | None
    """Whether the estimator reports a position (M,), 1 or 0; None if nothing reports it."""
    fix_fraction: float | None
    """Fraction of the time under power with a fix of GPS; None if no receiver was recorded."""


@cached_per_vehicle()
def position_record(signals: Signals, boot: int) -> PositionRecord:
    """Collects what receivers and estimator report on the position during one boot.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.

    Returns:
        The fixes, the validity of the position estimate, and the fraction of the powered time with a fix.
    """
    fix = series_of_boot(position_fix(signals), boot)
    return PositionRecord(
        fix=fix,
        validity=series_of_boot(position_validity(signals), boot),
        fix_fraction=None if fix is None else _fraction_under_power(signals, boot, fix),
    )


def _fraction_under_power(signals: Signals, boot: int, state: TimeSeries) -> float | None:
    """Returns the fraction of the time under power in which a state was 1.

    Under power means that the motors could carry the vehicle. Without motor outputs all samples count.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        state: samples (N,) of that boot, 0 or 1.

    Returns:
        The fraction, 0 to 1; None without samples under power.
    """
    intervals_under_power = powered_intervals(signals, boot)
    counted_states: Array = np.asarray(state.values, dtype=float)
    if intervals_under_power:
        is_under_power = in_intervals(state.time, intervals_under_power)
        counted_states = counted_states[is_under_power]
    if not len(counted_states):
        return None
    # The mean of zeros and ones is the fraction of ones.
    return float(counted_states.mean())
