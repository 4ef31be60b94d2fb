"""The numbered list of events on the page of a live session, such as an alarm or a landing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from mavdem.assessment.judgement import Judgement
from mavdem.facts import Code, Fact, Facts
from mavdem.facts.assessment import NextStep
from mavdem.facts.event import Event
from mavdem.facts.loops import GainFact
from mavdem.facts.session import LinkFact, RowsFact, SessionFact
from mavdem.facts.watch import WatchFact
from mavdem.report.pages.page import PageEvent

if TYPE_CHECKING:
    from mavdem.live.history import LiveHistory

EVENTS_IN_GAINS_CHAPTER = (GainFact.GAINS_ADVISED, GainFact.TWIN_ANGLE_ERROR)
"""Events of a live session that the chapter on gains has, so that the list of events leaves them out."""

SILENCES_OF_LINK = (LinkFact.LOST_IN_FLIGHT, LinkFact.CONNECTION_LOST, RowsFact.NOTHING_RECEIVED)
"""Events of a live session whose advice is out of date once messages come again."""

MAX_EVENT_DELAY = 1.0
"""Longest time from the last sample of a live flight to an event that belongs to it, s.

A touchdown shows in messages that autopilots send once a second, such as HEARTBEAT.
"""


def time_of_last_event(events: Sequence[Event], last_sample_time: float) -> float:
    """Returns the time up to which the charts of a flight show its events, such as the touchdown after the last sample.

    Args:
        events: events with their times on the clock of the charts, s.
        last_sample_time: time of the last sample of the flight, s.

    Returns:
        The time, s, of the last event up to ``MAX_EVENT_DELAY`` after the last sample. It is the time of that sample if
        no event comes after it.
    """
    latest_time = last_sample_time + MAX_EVENT_DELAY
    times_of_flight = [event.seconds for event in events if event.seconds <= latest_time]
    return max([last_sample_time, *times_of_flight])


def numbered_live_events(
    history: LiveHistory, judgement: Judgement, alarms: Facts
) -> list[PageEvent]:
    """Returns the events of a live session as the list on its page shows them.

    Advised gains are left out, since their table is in the chapter on gains. The charts show the latest flight, and the
    times of all events are on their clock, that of the boot in which this flight began. Events, alarms and headline are
    matched by their causes, since the headline may state the cause of an alarm in other words than the event that
    reported it.

    Args:
        history: the events in the order in which they were reported, and the flight that the charts show.
        judgement: headline and next step of the page; an event does not repeat the next step.
        alarms: the alarms that are active.

    Returns:
        The events in this order, each with its number in the charts, whether the headline states it, and whether it is
        no longer active.
    """
    # Imported here: a page of a log needs nothing of live sessions.
    from mavdem.report.live import moment_text

    listed_events = []
    for event in history.events:
        if event.fact.code not in EVENTS_IN_GAINS_CHAPTER:
            listed_events.append(event)
    numbers = _numbers_in_live_charts(listed_events, history)
    cause_of_headline = _identity_of_cause(judgement.headline)
    active_causes = _causes_of_active_alarms(alarms)
    latest_resumption = _index_of_latest_resumption(listed_events)
    page_events = []
    for index, event in enumerate(listed_events):
        is_ended_silence = event.fact.code in SILENCES_OF_LINK and index < latest_resumption
        fact = _fact_in_live_list(event.fact, judgement)
        is_remedy_in_next_step = fact.remedy in str(judgement.next_step)
        cause = _identity_of_cause(event.fact)
        time_in_charts = event.seconds - history.flight.timeline_offset
        page_event = PageEvent(
            event._replace(seconds=time_in_charts, fact=fact),
            numbers[index],
            is_on_clock_of_charts=history.flight.contains(event.seconds),
            is_headline=cause == cause_of_headline,
            is_over=cause not in active_causes,
            is_advice_current=not is_ended_silence,
            texts_shown_before=frozenset([fact.remedy] if is_remedy_in_next_step else []),
            moment=moment_text(event),
        )
        page_events.append(page_event)
    return page_events


def _numbers_in_live_charts(events: Sequence[Event], history: LiveHistory) -> list[int | None]:
    """Returns the numbers with which the charts of a live page mark the events of the latest flight, from 1 on.

    Args:
        events: events of the session in the order of the page's list.
        history: the flight that the charts show.

    Returns:
        A number for each event. It is None for an event outside that flight, and for one on the state of the session
        itself, such as its learning.
    """
    numbers: list[int | None] = []
    last_number = 0
    for event in events:
        if history.flight.contains(event.seconds) and not event.is_session_state:
            last_number += 1
            numbers.append(last_number)
        else:
            numbers.append(None)
    return numbers


def _identity_of_cause(fact: Fact) -> tuple[Code, str]:
    """Returns by what an event, an alarm and the headline of a live page are matched: code and subject of the cause.

    Args:
        fact: one of them, a fact (a coded finding). The cause of an alarm is what it warns of, such as a weak motor;
            any other fact is its own cause.
    """
    # Imported here: a page of a log needs nothing of live sessions.
    from mavdem.live.event_cause import cause_of_alarm

    cause = cause_of_alarm(fact)
    return cause.code, cause.subject


def _causes_of_active_alarms(alarms: Facts) -> set[tuple[Code, str]]:
    """Returns code and subject of what each alarm of a live session warns of, except of alarms that have ended.

    Args:
        alarms: the latest report on each alarm: that it began, or that it is over.
    """
    active_alarms = [alarm for alarm in alarms if alarm.code is not WatchFact.ALARM_OVER]
    return {_identity_of_cause(alarm) for alarm in active_alarms}


def _index_of_latest_resumption(events: Sequence[Event]) -> int:
    """Returns the index of the last event by which messages came again after a silence of the link; 0 without any.

    Args:
        events: the events of a live session in the order in which they were reported.
    """
    latest_resumption = 0
    for index, event in enumerate(events):
        if event.fact.code is RowsFact.MESSAGES_RESUMED:
            latest_resumption = index
    return latest_resumption


def _fact_in_live_list(fact: Fact, judgement: Judgement) -> Fact:
    """Returns a reported fact as the list of events of a live page states it.

    Args:
        fact: what was reported, a coded finding. The report of a landing has the verdict on its flight, which is left
            out if it is the headline.
        judgement: headline and next step of the page, above the list. If the next step is to land now, an event that
            was reported before must not advise below it to fly on.
    """
    # Imported here: a page of a log needs nothing of live sessions.
    from mavdem.report.live import without_basis_of_phase

    shown_fact = without_basis_of_phase(fact)
    verdict = fact.figures.get("verdict")
    states_headline = (
        fact.code is SessionFact.FLIGHT_LEARNED
        and verdict is not None
        and _identity_of_cause(verdict) == _identity_of_cause(judgement.headline)
    )
    if states_headline:
        shown_fact = shown_fact.replace(verdict=None)
    if judgement.next_step.code is NextStep.LAND_NOW:
        return shown_fact.without_flight_advice
    return shown_fact
