"""Limits how often a live session reports what may come without end, so that a flood of it hides no other report.

These are texts of the autopilot, and states that may flap: whether it is armed, its mode, and whether it has landed.
"""

from collections import defaultdict, deque

from mavdem.assessment.repeated_reports import REPEAT_SECONDS
from mavdem.facts import Code, Fact, Facts
from mavdem.facts.events import ReportedEvent
from mavdem.facts.session import SessionFact

MAX_REPORTS_OF_KIND = 10
"""Reports of one kind in ``REPEAT_SECONDS``, at most: a choice; a screen of 24 lines still shows what was before."""

KIND_OF_STATE: dict[Code, str] = {
    ReportedEvent.MOTORS_ARMED: "arming",
    ReportedEvent.MOTORS_DISARMED: "arming",
    ReportedEvent.MODE_CHANGED: "mode",
    ReportedEvent.OFF_GROUND: "ground",
    ReportedEvent.ON_GROUND: "ground",
}
"""The state that a report is about, where that may flap."""

TEXT_KIND = "text"
"""The kind of reports that quote texts of the autopilot."""


class ReportLimit:
    """Decides which of many reports of one kind are shown to the user, and counts those that are left out.

    Only texts whose meaning is not known are quoted, and limited. A fault that the program knows, such as a failed
    motor, is always reported.
    """

    def __init__(self) -> None:
        """Begins without a report."""
        # When the latest reports of each kind were shown, s of the monotonic clock.
        self._report_times: dict[str, deque[float]] = defaultdict(
            lambda: deque(maxlen=MAX_REPORTS_OF_KIND)
        )
        # How many were left out since the last report of that, and when the first of them was, s of that clock.
        self._omitted_count = 0
        self._omitted_time = 0.0
        # The latest state of each kind that was shown, and that was left out since then.
        self._shown_states: dict[str, Fact] = {}
        self._omitted_states: dict[str, Fact] = {}

    def admits(self, fact: Fact, now: float) -> bool:
        """Returns whether a fact is to be reported now, and stores that it was reported or left out.

        It is left out if ``MAX_REPORTS_OF_KIND`` others of its kind were reported in the last ``REPEAT_SECONDS``. The
        user later reads how many were left out (:meth:`pop_omission_report`).

        Args:
            fact: a fact (coded finding) of the session, such as an alarm whose reason is a text.
            now: present time, s of the monotonic clock.
        """
        kind = _kind_of(fact)
        if kind is None:
            return True
        if self._may_show(kind, now):
            self._store_shown(kind, fact, now)
            return True
        if self._omitted_count == 0:
            self._omitted_time = now
        self._omitted_count += 1
        if kind != TEXT_KIND:
            self._omitted_states[kind] = fact
        return False

    def _may_show(self, kind: str, now: float) -> bool:
        """Returns whether another report of a kind may be shown at ``now``, s of the monotonic clock."""
        report_times = self._report_times[kind]
        is_full = len(report_times) == MAX_REPORTS_OF_KIND
        return not is_full or now - report_times[0] >= REPEAT_SECONDS

    def _store_shown(self, kind: str, fact: Fact, now: float) -> None:
        """Stores that a report of a kind is shown at ``now``, s of the monotonic clock."""
        self._report_times[kind].append(now)
        self._omitted_states.pop(kind, None)
        if kind != TEXT_KIND:
            self._shown_states[kind] = fact

    def pop_omitted_states(self, now: float, *, is_at_end: bool) -> Facts:
        """Returns states whose reports were left out, so that the last report that is shown states the present one.

        For example, a land detector flaps between ground and air. If the last report that is shown is "in the air", and
        a later one, "on the ground", was left out, this later one is returned. A state that is the same as the one that
        is shown is not reported again.

        Args:
            now: present time, s of the monotonic clock.
            is_at_end: whether the session ends; before, a state waits until there is room for its report.
        """
        due_states = []
        for kind, fact in list(self._omitted_states.items()):
            if not is_at_end and not self._may_show(kind, now):
                continue
            # The state as it was shown last.
            shown_fact = self._shown_states[kind]
            is_other_state = (fact.code, fact.subject) != (shown_fact.code, shown_fact.subject)
            if is_other_state:
                due_states.append(fact)
            self._store_shown(kind, fact, now)
        return tuple(due_states)

    def pop_omission_report(self, now: float) -> Fact | None:
        """Returns the fact how many reports were left out, once in ``REPEAT_SECONDS``; None if it is not due.

        Args:
            now: present time, s of the monotonic clock.
        """
        duration = now - self._omitted_time
        if self._omitted_count == 0 or duration < REPEAT_SECONDS:
            return None
        fact = Fact(SessionFact.REPORTS_LEFT_OUT, count=self._omitted_count, duration=duration)
        self._omitted_count = 0
        return fact


def _kind_of(fact: Fact) -> str | None:
    """Returns the kind of a report whose number is limited; None for one that is always reported.

    Args:
        fact: the report, such as a text of the autopilot, a change of a state, or an alarm.
    """
    # An alarm may have the quoted text as its reason.
    reason = fact.figures.get("reason")
    quoted_fact = reason if fact.code is SessionFact.ALARM and reason is not None else fact
    if quoted_fact.code is ReportedEvent.AUTOPILOT_SAID:
        return TEXT_KIND
    if fact.is_watch_or_bad:
        # A change of a state that is a fault, such as a mode that a failsafe has chosen, is always reported.
        return None
    return KIND_OF_STATE.get(fact.code)
