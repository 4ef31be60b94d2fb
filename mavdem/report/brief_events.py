"""A short list of a flight's events: what is bad first, then what is to be watched, each kind once with its number."""

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

    Events of one kind have the same code, level and subject. How a flight was lost stands for the event of the motion
    that shows it too.

    Args:
        events: events of a log, in the order of time.

    Returns:
        The events with the count of their kind: the bad ones first, each in the given order.
    """
    endings = {(event.code, event.time) for event in events}
    counts: Counter[tuple[str, str, str]] = Counter()
    first_indices: dict[tuple[str, str, str], int] = {}
    for index, event in enumerate(events):
        if not event.warns or (ENDINGS.get(event.code), event.time) in endings:
            continue
        kind = (str(event.code), str(event.level), event.subject)
        counts[kind] += 1
        first_indices.setdefault(kind, index)
    counted_events = [CountedEvent(index, counts[kind]) for kind, index in first_indices.items()]
    counted_events.sort(key=lambda counted: -LEVELS_BY_SEVERITY.index(events[counted.number].level))
    return counted_events


def first_of(total: int) -> str:
    """Returns how many events one stands for, to follow its sentence: " (first of 3)"; empty for a single one."""
    return f" (first of {total})" if total > 1 else ""
