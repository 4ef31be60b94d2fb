"""Limits how many texts of the autopilot a live session quotes, so that a flood of them hides no other report."""

from collections import deque

from mavdem.assessment.autopilot_messages import REPEAT_SECONDS
from mavdem.facts import Fact
from mavdem.facts.events import ReportedEvent
from mavdem.facts.session import SessionFact

MAX_QUOTED_TEXTS = 10
"""Texts that are quoted in ``REPEAT_SECONDS``, at most: a choice; a screen of 24 lines still shows what was before."""


class QuotedTexts:
    """Decides which texts of the autopilot are reported, and counts those that are left out.

    They are texts whose meaning is not known, since only these are quoted. A fault that the program knows, such as a
    failed motor, is always reported.
    """

    def __init__(self) -> None:
        """Begins without a text."""
        # When the latest texts were quoted, s of the monotonic clock.
        self._quoting_times = deque[float](maxlen=MAX_QUOTED_TEXTS)
        # How many texts were left out since the last report of that, and when the first of them was, s of that clock.
        self._left_out_count = 0
        self._left_out_time = 0.0

    def admits(self, fact: Fact, now: float) -> bool:
        """Returns whether a fact is to be reported; a text that is not is counted, for a later report.

        A text of the autopilot is reported unless ``MAX_QUOTED_TEXTS`` others were in the last ``REPEAT_SECONDS``. All
        other facts are reported.

        Args:
            fact: a fact (coded finding) of the session, such as an alarm whose reason is a text.
            now: present time, s of the monotonic clock.
        """
        reason = fact.figures.get("reason")
        quoted_fact = reason if fact.code is SessionFact.ALARM and reason is not None else fact
        if quoted_fact.code is not ReportedEvent.AUTOPILOT_SAID:
            return True
        is_full = len(self._quoting_times) == MAX_QUOTED_TEXTS
        if not is_full or now - self._quoting_times[0] >= REPEAT_SECONDS:
            self._quoting_times.append(now)
            return True
        if self._left_out_count == 0:
            self._left_out_time = now
        self._left_out_count += 1
        return False

    def pop_left_out(self, now: float) -> Fact | None:
        """Returns the fact how many texts were left out, once in ``REPEAT_SECONDS``; None if it is not due.

        Args:
            now: present time, s of the monotonic clock.
        """
        duration = now - self._left_out_time
        if self._left_out_count == 0 or duration < REPEAT_SECONDS:
            return None
        fact = Fact(SessionFact.TEXTS_LEFT_OUT, count=self._left_out_count, duration=duration)
        self._left_out_count = 0
        return fact
