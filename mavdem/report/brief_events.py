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
    """Selects the first event of each kind that is bad or to be watched.

    Events of one kind have the same code, level and subject. Where an event of the motion, such as a fast rotation, has
    an ending of the flight at the same time (``ENDINGS`` has its code), the ending alone is listed.

    Args:
        events: events of a log, in the order of time.

    Returns:
        The events with the count of their kind: the bad ones first, each in the given order.
    """
    codes_and_times = {(event.code, event.time) for event in events}
    counts: Counter[tuple[str, str, str]] = Counter()
    first_indices: dict[tuple[str, str, str], int] = {}
    for index, event in enumerate(events):
        has_ending = (ENDINGS.get(event.code), event.time) in codes_and_times
        if not event.warns or has_ending:
            continue
        kind = (str(event.code), str(event.level), event.subject)
        counts[kind] += 1
        first_indices.setdefault(kind, index)
    counted_events = [CountedEvent(index, counts[kind]) for kind, index in first_indices.items()]
    # Levels are listed from good to bad. The sort is stable, so that events of one level stay in the order of time.
    counted_events.sort(key=lambda counted: -LEVELS_BY_SEVERITY.index(events[counted.number].level))
    return counted_events


def first_of_count(count: int) -> str:
    """Returns how many events one stands for, to follow its sentence: " (first of 3)"; empty for a single one."""
    return f" (first of {count})" if count > 1 else ""
