"""The short list of a flight's events, facts (coded findings), which the terminal and the page of a log both show."""

from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from typing import NamedTuple

from mavdem.assessment.ending import ENDINGS
from mavdem.assessment.severity import severity_rank
from mavdem.facts import Code, Fact, Facts, NamedFacts
from mavdem.facts.ending import Ending, MotionEvent
from mavdem.facts.events import ReportedEvent
from mavdem.facts.motors import MotorWatchFact
from mavdem.facts.session import LinkFact, RowsFact

MAX_WORST_EVENTS = 3
"""Events of a short list besides those that tell the course of the flight, a choice: the page lists all of them."""

MAX_MODE_CHANGES = 3
"""Changes of the flight mode that a short list has before the event of its headline, and as many after it: a choice."""

MAX_INNER_BOUNDS = 4
"""Take-offs and landings that a short list has between its first take-off and its last landing: those of three flights.

A choice. Of more flights only the first take-off and the last landing are listed.
"""

SAME_EVENT_SECONDS = 1.0
"""Time between the headline's event and another, s, below which that is taken for a part of it: a choice."""

TOUCHDOWNS = (
    ReportedEvent.ON_GROUND,
    ReportedEvent.MOTORS_DISARMED,
    MotionEvent.LOG_ENDED_IN_AIR,
)
"""Events with which a flight ends."""


class StatedEvents(NamedTuple):
    """Which events of a flight are stated elsewhere in its report, by their indices among all events."""

    headline_index: int | None
    """The event that the headline states; None if it states none."""
    cause_indices: Collection[int]
    """Events that the headline names as causes of that."""
    light_indices: Collection[int]
    """Events that a status light, the judgement of one subject such as the power, states."""


class CountedEvent(NamedTuple):
    """The longest event of its kind, which stands for all of them."""

    event_index: int
    """Its index among all events of the flight."""
    event_count: int
    """Number of events of its kind, itself included."""


def stated_events(events: Sequence[Fact], headline: Fact, lights: NamedFacts) -> StatedEvents:
    """Finds the events that the headline of a report or one of its status lights states already.

    Args:
        events: events of the flight, in the order of time.
        headline: the fact (a coded finding) in the headline, which may be one of the events.
        lights: the status lights by name, each a fact that may be one of the events.
    """
    identity_of_headline = event_identity(headline)
    identities_of_causes = {event_identity(cause) for cause in named_causes(headline)}
    texts_of_lights = {str(light) for light in lights.values()}
    headline_index = None
    cause_indices = set()
    light_indices = set()
    for index, event in enumerate(events):
        identity = event_identity(event)
        if headline_index is None and identity == identity_of_headline:
            headline_index = index
        if identity in identities_of_causes:
            cause_indices.add(index)
        if str(event) in texts_of_lights:
            light_indices.add(index)
    return StatedEvents(headline_index, cause_indices, light_indices)


def event_identity(event: Fact) -> tuple[Code, float | None, str]:
    """Returns what an event has in common with its copies: its code, time, s, and subject.

    A copy may have further figures: a headline also has that of a motor that was weak before the event, for example.

    Args:
        event: the event, or a headline that states it.
    """
    return event.code, event.time, event.subject


def named_causes(headline: Fact) -> list[Fact]:
    """Returns the events that a headline on a lost flight names as causes: what failed first, and reports of that.

    Args:
        headline: the headline, a fact: a coded finding with figures by name, which may be facts too.

    Returns:
        The causes; empty if the headline is not about a lost flight, or if no cause is known.
    """
    first_failure = headline.figures.get("cause")
    # The figure "word" is what the autopilot itself reported about a motor.
    autopilot_report = headline.figures.get("word")
    possible_causes = [first_failure, autopilot_report]
    if isinstance(first_failure, Fact):
        # Measurements of sensors and messages of the autopilot confirm the failure. Those from an event have it as
        # their cause.
        for confirmation in first_failure.figures.get("witnesses", ()):
            possible_causes.append(confirmation.figures.get("cause"))
    # A figure that is missing is None, and some causes are plain text. Neither is an event.
    return [cause for cause in possible_causes if isinstance(cause, Fact)]


def short_list(events: Sequence[Fact], stated: StatedEvents) -> list[CountedEvent]:
    """Selects the events that tell the course of a flight: the same ones for the terminal and for the page.

    - The take-off (or else when the motors were armed) and the end: the landing, or that the log ends in the air. They
      are those of the flight in which the headline's event was; without such an event, of the whole log, and then the
      landings and take-offs between them too if they are few (``MAX_INNER_BOUNDS``).
    - The changes of the flight mode before the landing, up to ``MAX_MODE_CHANGES`` before the headline's event and as
      many after it, and always the mode in which that event began.
    - The headline's event and the causes that it names.
    - The ``MAX_WORST_EVENTS`` worst of the other events (:func:`worst_events`). Left out are those that a status light
      states, those that are a part of the headline's event, and what is only to be watched after the flight was lost.
    - After a loss of the link in flight, that messages came again.

    Args:
        events: events of the log, in the order of time, each a coded finding.
        stated: which of them the headline and the status lights state.

    Returns:
        The selected events in the order of time, each with the number of events of its kind.
    """
    indices_of_course = _indices_of_course(events, stated)
    # The number of events of its kind, by the index of each selected event.
    counts = dict.fromkeys(indices_of_course, 1)
    worst_count = 0
    for index, count in worst_events(events):
        if index in indices_of_course:
            # It is selected already, and needs no place among the worst.
            counts[index] = count
        elif worst_count < MAX_WORST_EVENTS and not _is_stated(events, index, stated):
            counts[index] = count
            worst_count += 1
    for index in _ends_of_losses(events, counts):
        counts.setdefault(index, 1)
    return [CountedEvent(index, counts[index]) for index in sorted(counts)]


def _indices_of_course(events: Sequence[Fact], stated: StatedEvents) -> set[int]:
    """Returns the indices of the events that are always listed: bounds and modes of the flight, headline and causes.

    Args:
        events: events of the log, in the order of time, each a coded finding.
        stated: which of them the headline states, and which it names as causes.
    """
    take_off, touchdown = _flight_bounds(events, stated.headline_index)
    indices = {
        *_bounds_between(events, take_off, touchdown),
        *_mode_changes(events, take_off, touchdown, stated.headline_index),
        *stated.cause_indices,
    }
    for index in (take_off, touchdown, stated.headline_index):
        # Each is None if the log has no such event.
        if index is not None:
            indices.add(index)
    return indices


def _ends_of_losses(events: Sequence[Fact], listed_indices: Collection[int]) -> list[int]:
    """Returns the indices of the events by which messages came again after losses of the link in flight.

    Args:
        events: events of the flight, in the order of time.
        listed_indices: indices of the events that are listed. Of these, a loss that has ended needs its end.
    """
    ends = []
    resumptions = _indices_of(events, (RowsFact.MESSAGES_RESUMED,))
    for loss in _indices_of(events, (LinkFact.LOST_IN_FLIGHT,)):
        later_resumptions = [index for index in resumptions if index > loss]
        if loss in listed_indices and later_resumptions:
            ends.append(later_resumptions[0])
    return ends


def _flight_bounds(
    events: Sequence[Fact], headline_index: int | None
) -> tuple[int | None, int | None]:
    """Returns the indices of the take-off and of the end of a flight among the events of a log.

    Args:
        events: events of the log, in the order of time.
        headline_index: index of the headline's event, which selects the flight; None for the whole log, from the first
            take-off to the last end.

    Returns:
        Two indices, each None if the log has no such event. Without a take-off, the first is that of the arming.
    """
    take_offs = _indices_of(events, (ReportedEvent.OFF_GROUND,))
    if not take_offs:
        take_offs = _indices_of(events, (ReportedEvent.MOTORS_ARMED,))
    ends = _indices_of(events, TOUCHDOWNS)
    if headline_index is not None:
        take_offs_before = [index for index in take_offs if index <= headline_index]
        ends_after = [index for index in ends if index >= headline_index]
        return max(take_offs_before, default=None), min(ends_after, default=None)
    # The motors are disarmed after the landing, which ends the flight.
    landings = [index for index in ends if events[index].code is not ReportedEvent.MOTORS_DISARMED]
    return min(take_offs, default=None), max(landings or ends, default=None)


def _bounds_between(
    events: Sequence[Fact], take_off: int | None, touchdown: int | None
) -> list[int]:
    """Returns the indices of landings and take-offs between a take-off and a later landing, if they are few.

    Args:
        events: events of the log, in the order of time.
        take_off: index of the first take-off; None without one.
        touchdown: index of the last landing; None without one.

    Returns:
        Indices; none if there are more than ``MAX_INNER_BOUNDS``.
    """
    if take_off is None or touchdown is None:
        return []
    bounds = _indices_of(events, (ReportedEvent.OFF_GROUND, ReportedEvent.ON_GROUND))
    inner_bounds = [index for index in bounds if take_off < index < touchdown]
    return inner_bounds if len(inner_bounds) <= MAX_INNER_BOUNDS else []


def _mode_changes(
    events: Sequence[Fact], take_off: int | None, touchdown: int | None, headline_index: int | None
) -> list[int]:
    """Selects the changes of the flight mode for a short list of events: those nearest to the event of the headline.

    They tell in which mode it happened, and to which mode pilot or autopilot then changed.

    Args:
        events: events of the log, in the order of time.
        take_off: index of the take-off; None without one.
        touchdown: index of the end of the flight, after which no mode matters any more; None without one.
        headline_index: index of the event that the headline of the log states; None if it states no event. Then the
            last changes of the flight are selected.

    Returns:
        Indices of at most ``MAX_MODE_CHANGES`` changes before the headline's event and as many after it, ascending.
    """
    changes = _indices_of(events, (ReportedEvent.MODE_CHANGED,))
    if touchdown is not None:
        changes = [index for index in changes if index < touchdown]
    # Without an event of the headline, all changes count as before it.
    centre = len(events) if headline_index is None else headline_index
    changes_before = [index for index in changes if index < centre]
    changes_after = [index for index in changes if index > centre]
    first_index_in_flight = 0 if take_off is None else take_off + 1
    changes_in_flight = [index for index in changes_before if index >= first_index_in_flight]
    selected_before = changes_in_flight[-MAX_MODE_CHANGES:]
    if not selected_before:
        # The mode did not change since the take-off: the last change before it, often long before, set the mode.
        selected_before = changes_before[-1:]
    return selected_before + changes_after[:MAX_MODE_CHANGES]


def _indices_of(events: Sequence[Fact], codes: Collection[Code]) -> list[int]:
    """Returns the indices of all events with one of some codes, in ascending order."""
    return [index for index, event in enumerate(events) if event.code in codes]


def _is_stated(events: Sequence[Fact], index: int, stated: StatedEvents) -> bool:
    """Returns whether a report states an event elsewhere, or the headline's event covers it.

    The headline's event covers those of the same second, such as the tumble in a crash. The loss of a flight also
    covers what is only to be watched after it: a sensor that then fails is a consequence.

    Args:
        events: events of the log, in the order of time.
        index: index of the event.
        stated: which events the headline and the status lights state.
    """
    if index in stated.light_indices:
        return True
    if stated.headline_index is None:
        return False
    event = events[index]
    headline = events[stated.headline_index]
    is_after_loss = isinstance(headline.code, Ending) and index > stated.headline_index
    if is_after_loss and not event.is_bad:
        return True
    if event.time is None or headline.time is None:
        # Without the times, only equal codes show that both are the same.
        return event.code is headline.code
    return abs(event.time - headline.time) < SAME_EVENT_SECONDS


def worst_events(events: Sequence[Fact]) -> list[CountedEvent]:
    """Selects the notable events of a flight: one event of each kind, with the number of its kind.

    An event is notable if it is bad, to be watched, or one of the motion, such as a swing. Events of one kind have the
    same code, level and subject, and the longest of them is selected; of events without a duration, the first. Events
    that another one includes are left out.

    Args:
        events: events of a log, in the order of time, each a coded finding.

    Returns:
        The selected events, the worst kind first (``severity_rank``); kinds that are as bad are in the order of time.
    """
    included_indices = _included_in_others(events)
    counts: Counter[tuple[str, str, str]] = Counter()
    longest_indices: dict[tuple[str, str, str], int] = {}
    for index, event in enumerate(events):
        if not is_notable(event) or index in included_indices:
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


def _included_in_others(events: Sequence[Fact]) -> set[int]:
    """Returns the indices of events that another event of the same time includes and says more about.

    - An event of the motion, such as a tumble, is included in the loss of the flight that it became.
    - A motor at its output limit is included in the event that this motor was saturated.

    Args:
        events: events of a log, each a fact: a coded finding with a time and a subject.
    """
    saturations = set()
    for event in events:
        if event.code is MotorWatchFact.MOTOR_SATURATED:
            saturations.add((event.subject, event.time))
    included_indices = set()
    for index, event in enumerate(events):
        is_at_limit = event.code is MotionEvent.MOTOR_AT_ITS_STOP
        is_in_saturation = is_at_limit and (event.subject, event.time) in saturations
        if _is_repeated_by_loss(event, events) or is_in_saturation:
            included_indices.add(index)
    return included_indices


def _is_repeated_by_loss(event: Fact, events: Sequence[Fact]) -> bool:
    """Returns whether an event is in the list once more, as the way in which the flight was lost.

    For example, the impact with which a flight ends is first an event of the motion, and then a crash at the same time.
    A short list leaves the impact out, since the crash says the same, and what failed first.

    Args:
        event: the event, a coded finding, such as the impact.
        events: all events of the log.
    """
    # ``ENDINGS`` maps each event of the motion that can end a flight to the way of its loss, such as a crash.
    code_of_loss = ENDINGS.get(event.code)
    if code_of_loss is None:
        return False
    boot = event.figures.get("boot")
    return any(
        other.code is code_of_loss
        and other.time == event.time
        and other.figures.get("boot") == boot
        for other in events
    )


def is_notable(event: Fact) -> bool:
    """Returns whether an event is bad, to be watched, or one of the motion, such as a swing, at any level."""
    return event.is_watch_or_bad or isinstance(event.code, MotionEvent)


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


def distinct_events(events: Facts) -> Iterator[Fact]:
    """Yields the events of a flight as a list shows them, each thing that happened once.

    All saturations of a motor are one event. The event of the motion with which the flight was lost is left out, since
    the loss says the same and more.

    Args:
        events: events of the flight, in the order of time.
    """
    for event in _with_saturations_counted(events):
        if not _is_repeated_by_loss(event, events):
            yield event


def _with_saturations_counted(events: Facts) -> Iterator[Fact]:
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
