"""Flight states of a vehicle: when it is armed, in a flight mode, in a landed state, and airborne.

Each state has a set of intervals (``mavdem.dataset.intervals``) in seconds on the clock of one boot.
"""

from collections.abc import Container
from itertools import pairwise
from math import inf

import numpy as np

from mavdem.arrays import Array
from mavdem.dataset.intervals import (
    Intervals,
    complement,
    intersection,
    split_at_gaps,
    true_intervals,
    union,
)
from mavdem.dataset.landed_reports import (
    ContradictedReports,
    contradicted_reports,
    with_undefined_ground,
)
from mavdem.dataset.motor_outputs import MotorOutputs
from mavdem.dataset.signals import ModeChange, Signals
from mavdem.dataset.time_series import (
    TimeSeries,
    averaged_series,
    moving_average,
    series_of_boot,
)
from mavdem.dataset.vehicle_cache import cached_per_vehicle
from mavdem.ingest.motors import POSSIBLE_MULTIROTORS
from mavdem.ingest.telemetry import Parameters
from mavdem.ingest.vocabulary import OFF_GROUND, UNDEFINED_LANDED_STATE

MAX_IDLE_COLLECTIVE = 0.15
"""Highest fraction of the range at which motors idle on the ground: the default of ArduPilot's MOT_SPIN_MIN."""

MIN_COLLECTIVE_ABOVE_IDLE = 0.05
"""Fraction of the range above idle that a multirotor needs at least to stay in the air; a choice."""

MANUAL_THROTTLE_MODES = frozenset(
    {"Stabilize", "Acro", "Flip", "Drift", "Turtle", "Manual", "Stabilized"}
)
"""Modes of ArduPilot and PX4 in which the stick is the thrust, so that no estimate of the height is followed."""

CLIMB_STICK_MODES = frozenset(
    # ArduPilot
    ("Alt hold", "Flowhold", "Loiter", "Poshold", "Sport")
    # PX4
    + ("Altitude", "Altitude cruise", "Position", "Position slow")
)
"""Modes of ArduPilot and PX4 in which the stick commands the vertical speed, and its middle holds the height."""

POSITION_CONTROL_MODES = frozenset(
    # ArduPilot
    ("Auto", "Auto rtl", "Avoid adsb", "Brake", "Circle", "Follow", "Guided", "Land", "Loiter")
    + ("Poshold", "RTL", "Smart rtl", "Zigzag")
    # PX4
    + ("Descend", "Follow target", "Hold", "Land", "Mission", "Offboard", "Orbit", "Position")
    + ("Position slow", "Precision landing", "Return", "Takeoff")
)
"""Modes of ArduPilot and PX4 in which a controller of position or velocity determines how the vehicle leans.

Its setpoint of the attitude answers how wind moves the vehicle, as well as what a pilot or a mission asks.
"""

MAX_REPORT_INTERVAL = 10.0
"""Longest time, s, between two reports of the landed state that they cover.

Autopilots send EXTENDED_SYS_STATE at 0.2 Hz and faster. In a longer gap the collective shows better what happened.
"""

SURFACE_VEHICLES = ("GROUND_ROVER", "SURFACE_BOAT", "SUBMARINE")
"""MAV_TYPEs of vehicles that never leave the ground or the water, whatever a land detector reports."""


def airborne_intervals(signals: Signals, boot: int) -> Intervals:
    """Returns the intervals of a boot in which the vehicle is armed and off the ground, with take-off and landing.

    For a vehicle that is not a multirotor they are the intervals in which it operates.

    Args:
        signals: Logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: Number of the boot; a boot lasts from one start of the autopilot to the next.

    Returns:
        Start and end of each interval, s since boot.
    """
    if signals.telemetry.vehicle not in POSSIBLE_MULTIROTORS:
        return _operating_intervals(signals, boot)
    return intersection(
        armed_intervals(signals, boot), landed_state_intervals(signals, boot, OFF_GROUND)
    )


def _operating_intervals(signals: Signals, boot: int) -> Intervals:
    """Returns the intervals in which a vehicle other than a multirotor operates: armed and, if reported, in the air.

    Its motor outputs do not show when it flies, since a plane glides in the air and idles on the runway. So the reports
    decide. A surface vehicle, or one whose landed state is not reported, operates while it is armed.

    Args:
        signals: Logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: Number of the boot; a boot lasts from one start of the autopilot to the next.

    Returns:
        The intervals, s; none if the log does not show when the vehicle was armed.
    """
    if series_of_boot(signals.armed, boot) is None:
        return []
    armed_spans = armed_intervals(signals, boot)
    reports = series_of_boot(signals.landed_state, boot)
    if reports is None or signals.telemetry.vehicle in SURFACE_VEHICLES:
        return armed_spans
    is_undefined = reports.values == UNDEFINED_LANDED_STATE
    if is_undefined.all():
        return armed_spans
    is_off_ground = np.isin(reports.values, OFF_GROUND) | is_undefined
    return intersection(armed_spans, true_intervals(reports.time, is_off_ground))


def armed_intervals(signals: Signals, boot: int) -> Intervals:
    """Returns the intervals of a boot in which the vehicle is armed; all times where no heartbeat was recorded."""
    armed_series = series_of_boot(signals.armed, boot)
    if armed_series is None:
        return [(-inf, inf)]
    return true_intervals(armed_series.time, armed_series.values > 0)


def mode_intervals(signals: Signals, boot: int, modes: Container[str]) -> Intervals:
    """Returns the intervals of a boot in which the vehicle is in one of several flight modes, by their names."""
    # The last mode holds to the end of the boot.
    changes = [*signals.mode_changes(boot), ModeChange(inf, mode="")]
    intervals = []
    for change, next_change in pairwise(changes):
        if change.mode in modes:
            intervals.append((change.time, next_change.time))
    return intervals


def landed_state_intervals(signals: Signals, boot: int, states: tuple[int, ...]) -> Intervals:
    """Finds the intervals of a boot in which the vehicle is in one of several landed states, all of them in the air.

    Three sources decide, each where those before it say nothing:

    1. The reports in EXTENDED_SYS_STATE, where they hold (:func:`_intervals_with_reports`).
    2. The collective (mean output of all motors): the vehicle counts as in one of the states while the collective is
       high enough to keep it in the air.
    3. The last report, where motor outputs are missing too, since a missing message is no landing.

    Args:
        signals: Logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: Number of the boot; a boot lasts from one start of the autopilot to the next.
        states: Numbers of MAV_LANDED_STATE, all of them states in the air.

    Returns:
        Start and end of the intervals, s; none if neither reports nor motor outputs were recorded.
    """
    reports = _credible_landed_states(signals, boot)
    collective = _averaged_collective(signals, boot)
    if reports is None:
        return _intervals_of_high_collective(signals, collective)
    last_reported_intervals = true_intervals(
        reports.time, np.isin(_last_defined(reports.values), states)
    )
    if collective is None:
        return last_reported_intervals
    intervals_with_reports = _intervals_with_reports(
        reports, recording_start=collective.time[0], recording_end=collective.time[-1]
    )
    flights_by_reports = intersection(
        true_intervals(reports.time, np.isin(reports.values, states)), intervals_with_reports
    )
    flights_by_collective = intersection(
        _intervals_of_high_collective(signals, collective), complement(intervals_with_reports)
    )
    intervals_with_outputs = _intervals_near_samples(collective.time)
    intervals_with_neither = complement(union(intervals_with_reports, intervals_with_outputs))
    flights_by_last_report = []
    for start, end in intersection(last_reported_intervals, intervals_with_neither):
        # After the last report of all, a flight does not begin any more.
        if start < reports.time[-1]:
            flights_by_last_report.append((start, end))
    return union(union(flights_by_reports, flights_by_collective), flights_by_last_report)


def _intervals_of_high_collective(signals: Signals, collective: TimeSeries | None) -> Intervals:
    """Returns the intervals in which the collective is high enough to keep a multirotor in the air.

    Args:
        signals: logged time series of the vehicle, whose parameters state at which command its motors idle.
        collective: (N,) moving average of the collective; None if the motor outputs were not recorded.

    Returns:
        Start and end of each interval, s; none without a collective.
    """
    if collective is None:
        return []
    min_collective = min_airborne_collective(signals.telemetry.parameters)
    return true_intervals(collective.time, collective.values > min_collective)


def _intervals_with_reports(
    reports: TimeSeries, recording_start: float, recording_end: float
) -> Intervals:
    """Returns the intervals in which the reports of the landed state hold: between two that are defined and near.

    Two reports are near if they are at most ``MAX_REPORT_INTERVAL`` apart.

    Args:
        reports: (N,) MAV_LANDED_STATE as reported.
        recording_start: time of the first motor output, s. If the first report is not later, it holds before it too,
            since nothing was recorded there.
        recording_end: time of the last motor output, s. If the record ends before the next report was due, by the
            median interval between reports, the last report holds to the end.

    Returns:
        Start and end of each interval, s.
    """
    is_undefined = reports.values == UNDEFINED_LANDED_STATE
    is_far = np.diff(reports.time) > MAX_REPORT_INTERVAL
    intervals = split_at_gaps(reports.time, is_far | is_undefined[1:] | is_undefined[:-1])
    first_report_time = reports.time[0]
    if intervals and first_report_time <= recording_start:
        first_start, first_end = intervals[0]
        if first_start == first_report_time:
            intervals[0] = (-inf, first_end)
    last_report_time = reports.time[-1]
    if intervals and intervals[-1][1] == last_report_time:
        report_interval = float(np.median(np.diff(reports.time)))
        if recording_end - last_report_time <= report_interval:
            last_start, _ = intervals[-1]
            intervals[-1] = (last_start, inf)
    return intervals


@cached_per_vehicle()
def _averaged_collective(signals: Signals, boot: int) -> TimeSeries | None:
    """Returns the moving average of the collective (N,) in a boot; None if the motor outputs were not recorded."""
    collective = series_of_boot(signals.collective, boot)
    return None if collective is None else averaged_series(collective)


def _credible_landed_states(signals: Signals, boot: int) -> TimeSeries | None:
    """Returns the reports of the landed state in a boot, with "undefined" in the place of those that are wrong.

    Args:
        signals: logged time series of the vehicle, such as height and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.

    Returns:
        MAV_LANDED_STATE (N,); None if it was not recorded.
    """
    reports = series_of_boot(signals.landed_state, boot)
    if reports is None:
        return None
    for contradicted in contradicted_landings(signals, boot):
        reports = with_undefined_ground(reports, contradicted.interval)
    return reports


@cached_per_vehicle()
def contradicted_landings(signals: Signals, boot: int) -> list[ContradictedReports]:
    """Returns when a multirotor is reported on the ground in a boot although height and motors show that it flies.

    Args:
        signals: logged time series of the vehicle, such as height and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.

    Returns:
        The reports that are wrong, in the order of time; none if the landed state, the height or the motor outputs were
        not recorded, or the vehicle is no multirotor, which needs no thrust to stay in the air.
    """
    reports = series_of_boot(signals.landed_state, boot)
    height = series_of_boot(signals.height, boot)
    collective = _averaged_collective(signals, boot)
    is_multirotor = signals.telemetry.vehicle in POSSIBLE_MULTIROTORS
    if reports is None or height is None or collective is None or not is_multirotor:
        return []
    mean_collective = np.interp(reports.time, collective.time, collective.values)
    has_thrust = mean_collective > min_airborne_collective(signals.telemetry.parameters)
    return contradicted_reports(reports, height, has_thrust)


def _intervals_near_samples(time: Array) -> Intervals:
    """Finds the intervals in which some sample is at most ``MAX_REPORT_INTERVAL`` earlier or later.

    Args:
        time: Stamps (N,) of the samples, s, ascending.

    Returns:
        Start and end of each interval, s.
    """
    # Across a longer gap, the time near the sample before and the time near the sample after do not touch.
    is_gap = np.diff(time) > 2 * MAX_REPORT_INTERVAL
    recorded_spans = split_at_gaps(time, is_gap)
    return [
        (start - MAX_REPORT_INTERVAL, end + MAX_REPORT_INTERVAL) for start, end in recorded_spans
    ]


def _last_defined(landed_states: Array) -> Array:
    """Returns for each of N landed states the last one before or at it that is defined; undefined before the first."""
    rows = np.arange(len(landed_states))
    last_rows = np.maximum.accumulate(np.where(landed_states == UNDEFINED_LANDED_STATE, 0, rows))
    return landed_states[last_rows]


def min_airborne_collective(parameters: Parameters) -> float:
    """Returns the least collective, as a fraction of the range, that shows by itself that a multirotor is in the air.

    It is the one rule for flight by motor outputs alone. Where no parameter gives the command at which the motors idle,
    they may idle at ``MAX_IDLE_COLLECTIVE``. Whether a single motor runs is another question:
    :func:`min_running_command`.
    """
    return parameters.get("MOT_SPIN_MIN", MAX_IDLE_COLLECTIVE) + MIN_COLLECTIVE_ABOVE_IDLE


def min_running_command(motors: MotorOutputs) -> float:
    """Returns the least command of a motor, as a fraction of its range, that is clearly above its idle.

    The idle is the lower limit of the output's scale, which is 0 for PX4, whose range begins at the idle.
    """
    return motors.scale.lower_limit + MIN_COLLECTIVE_ABOVE_IDLE


def max_collective(signals: Signals) -> float:
    """Returns the highest sustained collective in a log; the collective is the mean output of all motors.

    It is the maximum of the moving average over ``AVERAGING_SECONDS``, since a short peak lifts no vehicle.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.

    Returns:
        The highest average of all boots, as a fraction of the range; 0 where the collective was not recorded.
    """
    collective = signals.collective
    if collective is None:
        return 0.0
    highest_of_boots = []
    for boot in np.unique(collective.boot):
        highest_of_boots.append(moving_average(collective.of_boot(boot)).max())
    return max(highest_of_boots)
