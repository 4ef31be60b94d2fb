"""Search for new reports of a live vehicle's autopilot, such as failsafes and crashes, in its latest messages."""

from math import inf

from mavdem.assessment.reported import reported_events
from mavdem.dataset.signals import Signals
from mavdem.facts import Fact
from mavdem.facts.events import ReportedEvent

LATE_REPORT_SECONDS = 2.0
"""How long before the latest search for reports one may be dated that is new in this one, s: a choice."""


class ReportSearch:
    """Finds the reports of the autopilot in one boot; each search returns those that are new since the last one.

    Attributes:
        reports: all reports that the last search found, new or not.
        restart: the restart of the autopilot in flight by which the boot began; None without one.
    """

    def __init__(self) -> None:
        """Begins before the first search."""
        self.reports: list[Fact] = []
        self.restart: Fact | None = None
        self._identities = set[tuple[object, ...]]()
        # Time of the last search, s of the boot clock.
        self._search_time = -inf

    def new_reports(self, signals: Signals, now: float) -> list[Fact]:
        """Searches the messages of the last minute for reports that are new since the last search.

        A report is new if the last search did not find it, and its time is not long past. Without the second condition,
        an old report would appear as new when a later one that had superseded it is more than a minute old, and is no
        longer found.

        Args:
            signals: signals of the last minute.
            now: present time on the boot clock, s.

        Returns:
            The new reports in the order of time. A restart in flight is found some seconds late, and is returned once,
            however old it is; ``restart`` has its cause, which may be found later still.
        """
        former_identities = self._identities
        self.reports = list(reported_events(signals))
        self._identities = {_identity(report) for report in self.reports}
        new_reports = []
        for report in self.reports:
            if report.code is ReportedEvent.RESTARTED_IN_FLIGHT:
                if self.restart is None:
                    new_reports.append(report)
                self.restart = report
                continue
            is_known = _identity(report) in former_identities
            is_long_past = report.start_time <= self._search_time - LATE_REPORT_SECONDS
            # These reports mean something in a log only: a stream begins anywhere, and ``BootClock`` reports restarts.
            is_restart = report.code is ReportedEvent.RESTARTED
            is_begin_of_log = bool(report.figures.get("is_begun"))
            is_for_logs_only = is_restart or is_begin_of_log
            if not is_known and not is_long_past and not is_for_logs_only:
                # A height is above the take-off, which the messages of the last minute need not contain.
                new_reports.append(report.replace(height=None))
        self._search_time = now
        return new_reports


def _identity(report: Fact) -> tuple[object, ...]:
    """Returns what the facts of two searches on the same report have in common: code, subject, text and time."""
    return report.code, report.subject, report.figures.get("text"), report.time
