"""Reports of the landed state that are wrong: the vehicle flies, and its land detector reports the ground all the time.

A report of the ground is taken for wrong only if two witnesses contradict it for seconds. One alone may be mistaken: a
barometer drifts on the ground, somebody carries the vehicle or a balloon lifts it, and motors run on a bench.

- The height has risen by more than ``MIN_CERTAIN_RISE`` since the motors last gave too little thrust to fly.
- The motors give enough thrust to fly.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Flags
from mavdem.dataset.intervals import TimeInterval
from mavdem.dataset.time_series import TimeSeries
from mavdem.ingest.vocabulary import OFF_GROUND, ON_GROUND, UNDEFINED_LANDED_STATE

MIN_CERTAIN_RISE = 3.0
"""Rise, m, that no bench, gust or prop wash makes."""

MIN_CONTRADICTION_SECONDS = 3.0
"""Time between the first and the last of several reports that both witnesses contradict, s; a choice.

Land detectors recognise a take-off within about a second.
"""


class LandedReport(NamedTuple):
    """A report of the landed state, and what the witnesses show at its time."""

    time: float
    """Time of the report, s on the boot clock."""

    state: int
    """MAV_LANDED_STATE as reported."""

    has_thrust: bool
    """Whether the motors give enough thrust to fly."""

    height: float
    """Height, m above any level; NaN where it is not known."""


@dataclass
class LandedReportCheck:
    """Checks one report of the landed state after the other, in a log and in a live session.

    A series consists of reports of the ground without a report of flight between them.

    Attributes:
        first_time: time of the first report of the present series, s on the boot clock; None while the vehicle is
            reported in the air, or before any report.
        contradicted_rise: largest height, m, at which height and motors have contradicted the series; None if they have
            not. A series stays contradicted to its end, since a detector that is stuck in flight shows no landing
            either.
    """

    first_time: float | None = None
    contradicted_rise: float | None = None
    # Height when the motors last gave too little thrust to fly, or at the first report; None before any.
    _ground_height: float | None = None
    # Time from which on height and motors have contradicted every report; None if the latest one is right.
    _contradiction_start: float | None = None

    def add(self, report: LandedReport) -> None:
        """Checks the next report, in the order of time, and updates ``first_time`` and ``contradicted_rise``.

        A report of the ground is contradicted if the vehicle has risen and its motors give enough thrust to fly. A
        contradiction counts only after ``MIN_CONTRADICTION_SECONDS``, since a single height or thrust may be wrong.
        """
        is_on_ground = report.state == ON_GROUND
        if report.state in OFF_GROUND:
            # The series ends.
            self.first_time = None
            self.contradicted_rise = None
        elif is_on_ground and self.first_time is None:
            # A series begins.
            self.first_time = report.time
        rise = self._rise_above_ground(report)
        seems_to_fly = rise > MIN_CERTAIN_RISE and report.has_thrust
        if not (is_on_ground and seems_to_fly):
            self._contradiction_start = None
            return
        if self._contradiction_start is None:
            self._contradiction_start = report.time
        if report.time - self._contradiction_start >= MIN_CONTRADICTION_SECONDS:
            self.contradicted_rise = max(rise, self.contradicted_rise or 0.0)

    def _rise_above_ground(self, report: LandedReport) -> float:
        """Returns how far the vehicle has risen, m, since the motors last gave too little thrust to fly.

        The height of a report without such thrust is stored as the height of the ground. Until there is one, the first
        known height stands for it. If the height of the report is not known, the rise is 0.
        """
        if not np.isfinite(report.height):
            return 0.0
        if self._ground_height is None or not report.has_thrust:
            self._ground_height = report.height
        return report.height - self._ground_height


class ContradictedReports(NamedTuple):
    """Reports of the ground in a row, without a report of flight between, which height and motors contradict."""

    interval: TimeInterval
    """Time of the first and of the last of them, s on the boot clock."""

    rise: float
    """Height that the vehicle gained meanwhile, m."""


def contradicted_reports(
    reports: TimeSeries, height: TimeSeries, has_thrust: Flags
) -> list[ContradictedReports]:
    """Returns the reports of the ground that are wrong, since height and motors show a flight.

    Args:
        reports: MAV_LANDED_STATE (N,) in one boot, that is from one start of the autopilot to the next.
        height: height (K,) in this boot, m above any level.
        has_thrust: (N,) whether the motors give enough thrust to fly at the time of each report.

    Returns:
        Each unbroken series of such reports, in the order of time.
    """
    heights = np.interp(reports.time, height.time, height.values, left=np.nan, right=np.nan)
    report_check = LandedReportCheck()
    # The keys are the times of the first report of each series. Each further report of a series replaces its interval
    # by a longer one.
    contradictions: dict[float, ContradictedReports] = {}
    for row, time in enumerate(reports.time.tolist()):
        report = LandedReport(
            time,
            state=int(reports.values[row]),
            has_thrust=bool(has_thrust[row]),
            height=float(heights[row]),
        )
        report_check.add(report)
        first_time = report_check.first_time
        if first_time is not None and report_check.contradicted_rise is not None:
            contradictions[first_time] = ContradictedReports(
                (first_time, time), report_check.contradicted_rise
            )
    return list(contradictions.values())


def with_undefined_ground(reports: TimeSeries, interval: TimeInterval) -> TimeSeries:
    """Returns reports of the landed state in which "on the ground" is "undefined" within an interval.

    Args:
        reports: MAV_LANDED_STATE (N,).
        interval: times of the first and of the last report that is wrong, s on the boot clock.
    """
    start, end = interval
    is_wrong = (reports.time >= start) & (reports.time <= end) & (reports.values == ON_GROUND)
    corrected_states = np.where(is_wrong, UNDEFINED_LANDED_STATE, reports.values)
    return TimeSeries(reports.time, reports.boot, corrected_states)
