"""The numbered list of events on a page, such as a failsafe, with their labels in the charts over time."""

from __future__ import annotations

from collections.abc import Sequence
from math import nan

from mavdem.assessment.identity import utc_date
from mavdem.assessment.status_texts import status_texts
from mavdem.containers import Names
from mavdem.facts import Fact, Facts, NamedFacts
from mavdem.facts.ending import Ending
from mavdem.facts.event import Event
from mavdem.ingest.telemetry import Tables, Telemetry
from mavdem.ingest.utc import utc_at_boot
from mavdem.report.brief_events import distinct_events, event_identity, stated_events
from mavdem.report.charts.timeline import Timeline
from mavdem.report.pages.page import PageEvent
from mavdem.report.why import evidence_texts

SECONDS_AROUND_LOSS = 3.0
"""Time around the loss of a flight, s, in which texts of the autopilot stand with it: a choice, as long as a fall."""

MAX_MESSAGES_AROUND_LOSS = 4
"""Texts of the autopilot that stand with the loss of a flight: a choice. A chapter has them all."""


def numbered_events(
    events: Facts,
    timeline: Timeline | None,
    headline: Fact | None = None,
    lights: NamedFacts | None = None,
    next_step: str = "",
    evidence_of_headline: str = "",
) -> list[PageEvent]:
    """Returns the list of events on the page of a log; those with a time are numbered from 1 on, as in its charts.

    The list does not repeat what the page states elsewhere. So each event says whether the headline or a light (the
    judgement of one part of the vehicle) states it too, and has the texts that the page shows above it.

    Args:
        events: events of all boots of the autopilot, each a fact (a coded finding) with its time.
        timeline: charts of one of these boots; events of other boots are not on its clock. None without charts.
        headline: the headline of the page, which may be one of the events; None for a page without one.
        lights: status lights of the page, each the judgement of one part of the vehicle, which may be one of the
            events; None for a page without them.
        next_step: text of the next step, which the page shows above the events.
        evidence_of_headline: sentence with the measurements that confirm the headline, which is above the events too.

    Returns:
        The events in the order of ``events``, each thing that happened once.
    """
    facts = tuple(distinct_events(events))
    page_events = _events_with_numbers(facts, timeline)
    if headline is not None:
        page_events = _events_with_mentions(page_events, headline, lights or {})
    return _events_with_shown_texts(page_events, evidence_of_headline, next_step)


def _events_with_numbers(facts: Facts, timeline: Timeline | None) -> list[PageEvent]:
    """Returns the events of a log for the list on its page, in which those with a time are numbered from 1 on.

    Args:
        facts: what happened, each a fact (a coded finding), in the order of the list.
        timeline: charts of one boot of the autopilot; events of other boots are not on its clock. None without charts.
    """
    page_events = []
    last_number = 0
    for fact in facts:
        if fact.time is None:
            # An event without a known time has NaN.
            page_events.append(PageEvent(Event(nan, fact)))
            continue
        last_number += 1
        # An event that names no boot counts as one of the boot of the charts.
        boot = fact.figures.get("boot")
        has_clock_of_charts = timeline is not None and boot in (None, timeline.boot)
        page_event = PageEvent(
            Event(fact.time, fact),
            number=last_number,
            is_on_clock_of_charts=has_clock_of_charts,
        )
        page_events.append(page_event)
    return page_events


def _events_with_mentions(
    page_events: Sequence[PageEvent], headline: Fact, lights: NamedFacts
) -> list[PageEvent]:
    """Marks the events that the page states above their list already, so that the list can be brief on them.

    An event may be the headline, a cause that the headline names, or the judgement of a part of the vehicle (a status
    light).

    Args:
        page_events: the events in the order of the list.
        headline: the fact (a coded finding) in the headline.
        lights: the judgement of each part of the vehicle by name, a fact too.

    Returns:
        The same events, each with three marks that are true or false.
    """
    facts = [page_event.event.fact for page_event in page_events]
    stated = stated_events(facts, headline, lights)
    marked_events = []
    for index, page_event in enumerate(page_events):
        marked_event = page_event._replace(
            is_headline=index == stated.headline_index,
            is_cause_of_headline=index in stated.cause_indices,
            is_light=index in stated.light_indices,
        )
        marked_events.append(marked_event)
    return marked_events


def _events_with_shown_texts(
    page_events: Sequence[PageEvent], evidence_of_headline: str, next_step: str
) -> list[PageEvent]:
    """Adds to each event the texts that the page shows above it, which the event does not repeat.

    Several events may have the same remedy (what to do) or the same evidence (what sensors measured). The page shows
    each of these texts only once: in the next step, as evidence of the headline, or else with the first event.

    Args:
        page_events: the events in the order of the list.
        evidence_of_headline: sentence with the measurements that confirm the headline, above the events.
        next_step: text of the next step, above the events, which contains the remedy of some of them.
    """
    shown_texts = {evidence_of_headline}
    events_with_texts = []
    for page_event in page_events:
        fact = page_event.event.fact
        if fact.remedy in next_step:
            shown_texts.add(fact.remedy)
        events_with_texts.append(page_event._replace(texts_shown_before=frozenset(shown_texts)))
        # The event itself shows its remedy and evidence, so that later events do not.
        shown_texts.add(fact.remedy)
        shown_texts.update(evidence_texts(fact))
    return events_with_texts


def with_messages_around_loss(
    page_events: Sequence[PageEvent], telemetry: Telemetry
) -> list[PageEvent]:
    """Adds what the autopilot reported around the loss of a flight to the event of the loss; other events stay.

    Args:
        page_events: the events of a log. One that names no boot of the autopilot counts as one of the first.
        telemetry: the vehicle's messages, with the status texts of its autopilot.

    Returns:
        All events in the same order. A loss has up to ``MAX_MESSAGES_AROUND_LOSS`` texts from at most
        ``SECONDS_AROUND_LOSS`` before or after it, such as "“Crash: Disarming” at 114.1 s".
    """
    events_with_messages = []
    for page_event in page_events:
        is_loss_of_flight = page_event.event.fact.code in Ending
        if is_loss_of_flight and page_event.has_time:
            messages = []
            for text in status_texts(telemetry):
                is_of_boot = text.boot == (page_event.boot or 0)
                if is_of_boot and abs(text.time - page_event.seconds) <= SECONDS_AROUND_LOSS:
                    messages.append(f"“{text.text}” at {text.time:.1f} s")
            page_event = page_event._replace(messages=messages[:MAX_MESSAGES_AROUND_LOSS])
        events_with_messages.append(page_event)
    return events_with_messages


def with_utc_of_bad_events(page_events: Sequence[PageEvent], messages: Tables) -> list[PageEvent]:
    """Adds the date and time in UTC to the bad events of a log, by which they are found in other records.

    Args:
        page_events: the events. One that names no boot of the autopilot counts as one of the first.
        messages: the vehicle's messages by name, among which SYSTEM_TIME has UTC and time since boot.

    Returns:
        All events in the same order; without UTC where the log does not show it.
    """
    events_with_utc = []
    for page_event in page_events:
        if page_event.event.fact.is_bad and page_event.has_time:
            utc_at_start_of_boot = utc_at_boot(messages, page_event.boot or 0)
            if utc_at_start_of_boot is not None:
                utc = utc_date(utc_at_start_of_boot + page_event.seconds)
                page_event = page_event._replace(utc=utc)
        events_with_utc.append(page_event)
    return events_with_utc


def labels_in_charts(events: Sequence[PageEvent], timeline: Timeline) -> Names:
    """Returns the labels of the events in the charts over time: their numbers in the list of events below.

    Args:
        events: the numbered list of events on the page.
        timeline: charts of the flight over time, with the events that they mark.

    Returns:
        One label for each event of the timeline, in its order; empty for an event that is not in the list.
    """
    labels_by_event = {}
    for page_event in events:
        labels_by_event[event_identity(page_event.event.fact)] = str(page_event.number)
    labels = [labels_by_event.get(event_identity(event.fact), "") for event in timeline.events]
    return tuple(labels)
