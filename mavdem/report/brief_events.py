"""A short list of a flight's events, facts (coded findings): the bad ones first, each kind once with its count."""

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from mavdem.assessment.ending import ENDINGS
from mavdem.assessment.severity import severity_rank
from mavdem.facts import Fact, Facts
from mavdem.facts.ending import MotionEvent
from mavdem.facts.motors import MotorWatchFact


class CountedEvent(NamedTuple):
    """The longest event of its kind, which stands for all of them."""

    event_index: int
    """Its index among all events of the flight."""
    event_count: int
    """Number of events of its kind, itself included."""


def worst_events(events: Sequence[Fact]) -> list[CountedEvent]:
    """Selects the events of a flight that a short list shows: one event of each kind, with the number of its kind.

    Only events that are bad or to be watched are shown. Events of one kind have the same code, level and subject, and
    the longest of them is selected; of events without a duration, the first. An event of the motion, such as a tumble,
    is left out if the flight ended at the same time by what ``ENDINGS`` lists for it, since that ending states more. So
    is a motor's stay at its limit if it was found saturated from the same time on.

    Args:
        events: events of a log, in the order of time, each a coded finding.

    Returns:
        The selected events, the worst kind first (``severity_rank``); kinds that are as bad are in the order of time.
    """
    codes_and_times = {(event.code, event.time) for event in events}
    saturated_motors = {
        (event.subject, event.time)
        for event in events
        if event.code is MotorWatchFact.MOTOR_SATURATED
    }
    counts: Counter[tuple[str, str, str]] = Counter()
    longest_indices: dict[tuple[str, str, str], int] = {}
    for index, event in enumerate(events):
        has_ending = (ENDINGS.get(event.code), event.time) in codes_and_times
        is_at_limit = event.code is MotionEvent.MOTOR_AT_ITS_STOP
        is_saturation = is_at_limit and (event.subject, event.time) in saturated_motors
        if not event.is_watch_or_bad or has_ending or is_saturation:
            continue
        kind = (str(event.code), str(event.level), event.subject)
        counts[kind] += 1
        longest_index = longest_indices.setdefault(kind, index)
        if _duration(event) > _duration(events[longest_index]):
            longest_indices[kind] = index
    counted_events = [CountedEvent(index, counts[kind]) for kind, index in longest_indices.items()]
    # The sort is stable, so that events that are as bad stay in the order of time.
    counted_events.sort(key=lambda counted: severity_rank(events[counted.event_index]))
    return counted_events


def _duration(event: Fact) -> float:
    """Returns how long an event lasted, s; 0 for a moment, and for one whose begin or end is not known."""
    if event.time is None or event.end_time is None:
        return 0.0
    return event.end_time - event.time


def count_text(event: Fact, event_count: int) -> str:
    """Returns a remark on how many events of its kind an event stands for, which follows the sentence of the event.

    Args:
        event: the event that is shown: the longest of its kind or, if they have no duration, the first.
        event_count: number of events of its kind, itself included.

    Returns:
        Text such as " (longest of 3)" or " (first of 3)"; empty for a single event.
    """
    if event_count == 1:
        return ""
    rank = "longest" if _duration(event) > 0 else "first"
    return f" ({rank} of {event_count})"


def with_saturations_counted(events: Facts) -> Iterator[Fact]:
    """Yields the events of a flight, with all saturations of a motor as one event.

    A motor may reach its output limit hundreds of times in a flight, which would fill the list of events. So its first
    saturation is yielded, with the number of all of them as the figure ``count``.

    Args:
        events: events of the flight, in the order of time.
    """
    saturation = MotionEvent.MOTOR_AT_ITS_STOP
    counts_by_motor = Counter(event.subject for event in events if event.code is saturation)
    for event in events:
        if event.code is not saturation:
            yield event
        elif event.subject in counts_by_motor:
            # The count is taken out, so that further saturations of this motor are skipped.
            yield event.replace(count=counts_by_motor.pop(event.subject))
