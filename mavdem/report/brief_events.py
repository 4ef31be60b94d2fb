"""A short list of a flight's events, facts (coded findings): the bad ones first, each kind once with its count."""

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

from mavdem.assessment.ending import ENDINGS
from mavdem.assessment.limits import LEVELS_BY_SEVERITY
from mavdem.facts import Fact


class CountedEvent(NamedTuple):
    """The first event of its kind, which stands for all of them."""

    number: int
    """Its index among all events, from 0."""
    total: int
    """Number of events of its kind, which are as bad."""


def worst_events(events: Sequence[Fact]) -> list[CountedEvent]:
    """Selects the events of a flight that a short list shows: of each kind that warns the first one, with their number.

    Events of one kind have the same code, level and subject; they warn if they are bad or to be watched. An event of
    the motion, such as a fast rotation, is left out if the flight ended at the same time by what ``ENDINGS`` lists for
    it, since that ending states more.

    Args:
        events: events of a log, in the order of time, each a coded finding.

    Returns:
        Index of the first event of each kind, and their number: the bad kinds first, each in the order of time.
    """
    codes_and_times = {(event.code, event.time) for event in events}
    counts: Counter[tuple[str, str, str]] = Counter()
    first_indices: dict[tuple[str, str, str], int] = {}
    for index, event in enumerate(events):
        has_ending = (ENDINGS.get(event.code), event.time) in codes_and_times
        if not event.is_watch_or_bad or has_ending:
            continue
        kind = (str(event.code), str(event.level), event.subject)
        counts[kind] += 1
        first_indices.setdefault(kind, index)
    counted_events = [CountedEvent(index, counts[kind]) for kind, index in first_indices.items()]

    def severity(counted: CountedEvent) -> int:
        """Returns the position of an event's level in the list of levels, which goes from good to bad."""
        return LEVELS_BY_SEVERITY.index(events[counted.number].level)

    # The sort is stable, also in reverse, so that events of one level stay in the order of time.
    counted_events.sort(key=severity, reverse=True)
    return counted_events


def first_of_count(count: int) -> str:
    """Returns how many events one stands for, to follow its sentence: " (first of 3)"; empty for a single one."""
    return f" (first of {count})" if count > 1 else ""
