"""Repeated reports of the autopilot, facts (coded findings): each is merged into the first one, which counts them."""

from collections import defaultdict
from collections.abc import Iterable
from math import inf
from typing import Any

from mavdem.facts import Fact, Level
from mavdem.facts.events import ReportedEvent

REPEAT_SECONDS = 30.0
"""Seconds within which the same report is a repetition of the earlier one: autopilots repeat a warning that persists
every 5 to 30 s."""

ACTIVATION_PAUSE = 5.0
"""Seconds without a state after which its next report is another event: a choice, a few reports of a state at 1 Hz.

Autopilots report a failsafe, or a state whose end they report too, when it begins and do not repeat that.
"""

CODES_WITH_TEXT = (ReportedEvent.AUTOPILOT_SAID, ReportedEvent.ARMING_REFUSED)
"""Codes whose facts quote the autopilot: two of them with different texts are different events."""


def in_time_order(facts: Iterable[Fact]) -> list[Fact]:
    """Returns the facts (coded findings) sorted by boot and, within a boot, by time."""
    return sorted(facts, key=lambda fact: (fact.figures["boot"], fact.time))


def merge_repeats(facts: Iterable[Fact]) -> list[Fact]:
    """Merges the repetitions of a report into its first fact.

    Autopilots repeat a warning while its cause persists, and report one problem by several messages. Two facts (coded
    findings) are one report if they have the same boot and code (and text, for ``CODES_WITH_TEXT``), no contrary
    subjects, and follow each other within ``REPEAT_SECONDS``. If one of them is a failsafe or has an end of its own,
    such as a loss of GPS with its return, they must follow within ``ACTIVATION_PAUSE``: else the merged state would
    last through the pause. The merged fact has the number of reports as ``count``, and ends with the last of them.

    Args:
        facts: facts that report messages of the autopilot, in any order.

    Returns:
        The remaining facts in time order, each with its ``count``, 1 for a report without repetitions.
    """
    merged_facts: list[Fact] = []
    # The indices in ``merged_facts`` of facts with the same boot, code and quoted text.
    indices_by_kind = defaultdict[tuple[Any, ...], list[int]](list)
    # The indices in ``merged_facts`` of failsafes and of facts of which a report had an end of its own.
    state_indices = set[int]()
    for fact in in_time_order(facts):
        quoted_text = fact.figures["text"] if fact.code in CODES_WITH_TEXT else ""
        indices = indices_by_kind[fact.figures["boot"], fact.code, quoted_text]
        is_state = fact.code is ReportedEvent.FAILSAFE or fact.end_time is not None
        repeated_index = None
        # The latest report of the kind comes first: it is the one that is repeated, if any.
        for index in reversed(indices):
            concerns_state = is_state or index in state_indices
            longest_pause = ACTIVATION_PAUSE if concerns_state else REPEAT_SECONDS
            if _is_repetition(merged_facts[index], fact, longest_pause):
                repeated_index = index
                break
        if repeated_index is None:
            repeated_index = len(merged_facts)
            indices.append(repeated_index)
            merged_facts.append(fact.replace(count=1))
        else:
            merged_facts[repeated_index] = _merged_pair(merged_facts[repeated_index], fact)
        if is_state:
            state_indices.add(repeated_index)
    return merged_facts


def _last_time(fact: Fact) -> float:
    """Returns the latest time of a fact, s: its end if it has one, otherwise its time; infinite for a permanent one."""
    if "is_permanent" in fact.figures:
        return inf
    return max(time for time in (fact.time, fact.end_time) if time is not None)


def _is_repetition(earlier_report: Fact, later_report: Fact, longest_pause: float) -> bool:
    """Returns whether ``later_report`` repeats ``earlier_report``, a fact (a coded finding) of the same code.

    It does if it follows within ``longest_pause`` and is about the same subject, such as "motor 2". A report that names
    no subject may be about the subject of the other report.

    Args:
        earlier_report: the first report.
        later_report: the one that may repeat it.
        longest_pause: time, s, between the end of the first and the start of the other.
    """
    subjects_agree = (
        earlier_report.subject == later_report.subject
        or not earlier_report.subject
        or not later_report.subject
    )
    return subjects_agree and later_report.start_time - _last_time(earlier_report) <= longest_pause


def _merged_pair(first_report: Fact, repetition: Fact) -> Fact:
    """Merges the repetition of a report into the first fact of it, so that it is shown once with its count.

    Args:
        first_report: the report, with the figures ``basis`` (names of messages) and ``count``.
        repetition: a later fact of the same code, with ``basis``.

    Returns:
        A fact (coded finding) with the time of the first one, the later end, the worse level, the messages of both, a
        subject if either has one, and a count that is one higher. All other figures are taken from the first fact.
    """
    # Levels are defined in the order good, watch, bad, unknown.
    levels = list(Level)
    level = max(first_report.level, repetition.level, key=levels.index)
    end_time: float | None = max(_last_time(first_report), _last_time(repetition))
    if end_time in (first_report.time, inf):
        # Both are of one time, or the fault never ends: then the fact has no end.
        end_time = None
    message_names = (*first_report.figures["basis"], *repetition.figures["basis"])
    figures = {**repetition.figures, **first_report.figures}
    if "is_over" in figures:
        # A problem that was over and is reported again goes on.
        figures["is_over"] = repetition.figures.get("is_over", False)
    # A dictionary keeps each name once, in order.
    figures["basis"] = tuple(dict.fromkeys(message_names))
    figures["count"] = first_report.figures["count"] + 1
    return first_report.replace(
        level,
        end_time=end_time,
        subject=first_report.subject or repetition.subject,
        **figures,
    )
