"""Alarms in flight about faults that the autopilot itself reports (facts), if they are bad or it calls them critical.

What it reports at a lower severity is a line only. The battery has an alarm of its own (``Watchdog``).
"""

from collections.abc import Sequence

from mavdem.assessment.repeated_reports import REPEAT_SECONDS
from mavdem.assessment.reported import FAILSAFE_TRIGGERS
from mavdem.assessment.status_texts import SEVERITIES
from mavdem.facts import Code, Fact, Facts
from mavdem.facts.events import ReportedEvent
from mavdem.facts.session import SessionFact
from mavdem.facts.watch import WatchFact

CRITICAL_SEVERITIES = SEVERITIES[: 1 + SEVERITIES.index("critical")]
"""Severities of texts that are alarms whatever they say: emergency, alert and critical."""

ALARMING_STATES = frozenset((ReportedEvent.FAILSAFE, *FAILSAFE_TRIGGERS)) - {
    ReportedEvent.BATTERY_WARNED
}
"""Faults that are alarms where a state reports them, which has no severity: failsafes, and what they begin for."""

FAILSAFES_IN_WORDS = frozenset(
    {
        ReportedEvent.FAILSAFE,
        ReportedEvent.RADIO_LOST,
        ReportedEvent.GROUND_STATION_LOST,
        ReportedEvent.FENCE_BREACHED,
    }
)
"""Faults that are alarms where any text warns of them: the autopilot takes the vehicle from the pilot, and ArduPilot
reports that as a mere warning (``Copter::announce_failsafe``)."""


class ReportAlarms:
    """The alarms about faults that the autopilot reports, since it started.

    One about a bad fault, such as a motor that failed, lasts until the flight ends. One about a fault that is to be
    watched, such as a doubt about GPS, is over when the autopilot says so. Where it does not, the alarm lasts while the
    fault is reported, and for ``REPEAT_SECONDS`` after that.
    """

    def __init__(self) -> None:
        """Begins without an alarm."""
        # The latest report of each code that is an alarm, and when it was reported last, s of the boot clock.
        self._reports: dict[Code, Fact] = {}
        self._report_times: dict[Code, float] = {}

    @property
    def active(self) -> Facts:
        """The reports that are alarms now."""
        return tuple(self._reports.values())

    def add_report(self, report: Fact, now: float) -> Fact:
        """Adds a new report in flight. If it is alarming, it is active from now on.

        Args:
            report: what the autopilot reports, on anything but the battery.
            now: present time on the boot clock, s.

        Returns:
            What to report to the user: an alarm of the report's level with the report as its reason; or the report
            itself where it is not alarming.
        """
        if not is_alarming(report):
            return report
        self._reports[report.code] = report
        self._report_times[report.code] = now
        return Fact(
            SessionFact.ALARM,
            report.level,
            time=report.start_time,
            subject=report.subject,
            reason=report,
        )

    def update(self, reports: Sequence[Fact], now: float) -> list[Fact]:
        """Updates the active alarms by the reports of the last minute, and ends those whose fault is over.

        The alarm on a bad fault stays until the flight ends. Another alarm ends when the autopilot reports the end of
        its fault, or has not reported the fault for ``REPEAT_SECONDS``.

        Args:
            reports: all reports of the last minute, with repetitions merged.
            now: present time on the boot clock, s.

        Returns:
            The facts that an alarm is over, for faults whose end the autopilot has reported. An alarm that ends only
            because its fault is no longer reported has none: that does not show that the fault is over.
        """
        latest_reports: dict[Code, Fact] = {}
        for report in reports:
            has_alarm = report.code in self._reports
            if has_alarm:
                former_time = self._report_times[report.code]
                self._report_times[report.code] = max(former_time, _latest_time(report, now))
                latest_reports[report.code] = report
        ends = []
        for code, alarming_report in list(self._reports.items()):
            if alarming_report.is_bad:
                # A bad fault stays an alarm until the flight ends.
                continue
            latest_report = latest_reports.get(code, alarming_report)
            seconds_without_report = now - self._report_times[code]
            if latest_report.figures.get("is_over"):
                del self._reports[code]
                ends.append(
                    Fact(WatchFact.ALARM_OVER, time=latest_report.end_time, reason=latest_report)
                )
            elif seconds_without_report > REPEAT_SECONDS:
                del self._reports[code]
        return ends

    def end_flight(self) -> None:
        """Drops all alarms, after a landing or before a take-off."""
        self._reports.clear()


def _latest_time(report: Fact, now: float) -> float:
    """Returns the latest time at which a fault that the autopilot reported was there, s of the boot clock.

    Some faults are states, such as a failsafe: autopilots report only their beginning and their end, so that one
    without an end is still there now. Others are texts, each of which counts for the time when it was received.

    Args:
        report: the fact (coded finding) on the fault. That of a repeated text ends with its last repetition.
        now: present time on the boot clock, s.
    """
    if is_lasting_state(report):
        return now
    return report.end_time or report.start_time


def is_lasting_state(report: Fact) -> bool:
    """Returns whether a report of the autopilot is a state that still lasts, such as no fix of the GPS receiver.

    Args:
        report: a fact on the fault: a text of the autopilot, or a state, which has no end while it lasts.
    """
    is_state = isinstance(report.code, ReportedEvent) and "text" not in report.figures
    return is_state and report.end_time is None


def is_moment_or_reported_end(fault: Fact) -> bool:
    """Returns whether the end of a fault is no news: it was a moment, or the autopilot itself has reported its end.

    Args:
        fault: a fault that is no longer found. A text of the autopilot that came once, such as a reset of the
            estimator, is a moment.
    """
    if not isinstance(fault.code, ReportedEvent):
        return False
    is_moment = fault.end_time is None and not is_lasting_state(fault)
    return is_moment or bool(fault.figures.get("is_over"))


def is_alarming(report: Fact) -> bool:
    """Returns whether something that the autopilot reports is an alarm in flight.

    A report that is bad is an alarm. One that is only to be watched is an alarm in three cases: it is a text of the
    severity "critical" or higher; a text that warns of one of the ``FAILSAFES_IN_WORDS``; or a state, such as a
    failsafe, that is among the ``ALARMING_STATES``.

    Args:
        report: a coded finding: either the text of a message, with its figures "text" and "severity", or the interval
            in which a state lasts, which has neither.
    """
    if report.is_bad:
        return True
    if not report.is_watch_or_bad:
        return False
    severity = report.figures.get("severity")
    is_critical_text = severity in CRITICAL_SEVERITIES
    is_failsafe_text = severity is not None and report.code in FAILSAFES_IN_WORDS
    is_state = "text" not in report.figures
    is_alarming_state = is_state and report.code in ALARMING_STATES
    return is_critical_text or is_failsafe_text or is_alarming_state
