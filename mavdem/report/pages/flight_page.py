"""The HTML page of a flight: headline, status lights and other facts (coded findings), then chapters of charts."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from math import nan
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mavdem.assessment import Assessment
from mavdem.assessment.axis import LogAnalysis
from mavdem.assessment.axis.findings import model_findings
from mavdem.assessment.axis.loop_decision import advises_to_tune
from mavdem.assessment.axis.lowered_gains import lowered_gains
from mavdem.assessment.axis.responses import advised_steps
from mavdem.assessment.evidence import Evidence
from mavdem.assessment.flight_verdict import FlightVerdict
from mavdem.assessment.flights import loss_onset
from mavdem.assessment.identity import day_in_file_name, utc_date
from mavdem.assessment.judgement import Judgement
from mavdem.assessment.last_position import last_position_of_loss
from mavdem.assessment.lights.motors import motor_figures_of_all_flight
from mavdem.assessment.motor_failure import failure_commands
from mavdem.assessment.status_texts import status_texts
from mavdem.containers import JsonValues, Names
from mavdem.dataset.speed_controllers import speed_controllers
from mavdem.dem import Learned
from mavdem.facts import Code, Fact, Facts, Level, NamedFacts
from mavdem.facts.assessment import Grade, NextStep, Purpose
from mavdem.facts.ending import Ending
from mavdem.facts.event import Event
from mavdem.facts.identifiability import Status
from mavdem.facts.lights import Light, Unjudged
from mavdem.facts.loops import GainFact, LoopAction
from mavdem.facts.power import PowerLight
from mavdem.facts.session import LinkFact, RowsFact, SessionFact, TimeUse
from mavdem.facts.watch import WatchFact
from mavdem.facts.wind import WindLight
from mavdem.fleet.names import NO_NAMES, GivenNames
from mavdem.ingest.telemetry import Tables, Telemetry
from mavdem.ingest.utc import utc_at_boot
from mavdem.loops.advice import AdviceByAxis, Gain
from mavdem.loops.resonance import controller_if_known
from mavdem.report.blocks import Blocks, Rated, Sentence, Table, headline_sentence, warning
from mavdem.report.brief_events import (
    distinct_events,
    event_identity,
    stated_events,
)
from mavdem.report.charts import model_charts
from mavdem.report.charts.chart import MAX_POINTS, MAX_POINTS_OF_SMALL_PAGE, Charts, Group
from mavdem.report.charts.flight_charts import fastest_loop
from mavdem.report.charts.flown_path import MapWind, flown_path
from mavdem.report.charts.plans import frame_plan, rose_of_wind
from mavdem.report.charts.timeline import (
    Timeline,
    assessment_timeline,
    live_timeline,
    rate_title,
)
from mavdem.report.condition import air_blocks, log_blocks
from mavdem.report.gain_changes import (
    GainChanges,
    gain_changes,
    gains_in_tables,
    loading_sentences,
)
from mavdem.report.heading import heading_of
from mavdem.report.instances import instance_table
from mavdem.report.labels import Labels
from mavdem.report.lights import lights_with_reason_once
from mavdem.report.loops import TRIED_HEADER, gain_row, needs_check_before_gains
from mavdem.report.notch_trial import NotchTrial, notch_trial
from mavdem.report.numbers import display_unit, with_unit
from mavdem.report.pages.hardware_chapters import HARDWARE_TITLE, hardware_chapters
from mavdem.report.pages.loop_chapters import (
    TUNING_TITLE,
    loops_chapters,
    responses_chapter,
    tuning_chapter,
)
from mavdem.report.pages.message_chapter import messages_chapter
from mavdem.report.pages.noise_chapters import (
    controller_spectra_chapter,
    vibration_chapter,
)
from mavdem.report.pages.page import (
    Chapter,
    Head,
    PageEvent,
    Provenance,
    Section,
    render_document,
)
from mavdem.report.pages.page_link import PageLink
from mavdem.report.pages.parameter_chapter import parameters_chapter
from mavdem.report.review import review_title
from mavdem.report.screen import (
    detail_blocks,
    flight_sentences,
    judgement_sentences,
    motor_blocks,
    motor_table_of_all_flight,
    prediction_blocks,
    purpose_tables,
    torque_blocks,
    vehicle_blocks,
)
from mavdem.report.templates import (
    Medium,
    as_clause,
    capitalize_first,
    first_and_further_sentences,
    headline,
    render_section,
    sentences_for,
    time_of_day,
    without_full_stop,
)
from mavdem.report.trust import trust_table
from mavdem.report.truth import truth_blocks
from mavdem.report.why import (
    evidence_texts,
    headline_evidence,
    joined_sentences,
    margin_sentences,
)
from mavdem.witnesses import SensorTrust

if TYPE_CHECKING:
    from mavdem.live.history import LiveHistory
    from mavdem.live.session_status import SessionStatus
    from mavdem.live.wind import WindEstimate

INSTANCES_TITLE = "Batteries, sensors, estimators, outputs"
"""Title of the chapter of what a vehicle has several of."""

MARGINS_TITLE = "Margins and new gains"
"""Title of the chapter with the margins of each axis, now and with the advised gains."""

LOG_TITLE = "Log and repairs"
"""Title of the chapter of the log itself."""

MOTOR_LEADS = ("Motors:", "Steady command:")
"""Leads of the sentences on the condition that are about the motors."""

CHAPTER_OF_LIGHT = {
    Light.MOTORS: "Motors",
    Light.VIBRATION: "Vibration",
    Light.TRACKING: "Three axes",
    Light.MARGINS: "Control loops",
    Light.POWER: INSTANCES_TITLE,
    Light.ESTIMATOR: INSTANCES_TITLE,
    Light.WIND: "Wind",
    Light.LOG: LOG_TITLE,
}
"""Title of the chapter with more about each light; a chapter is open where one of its lights is not good."""

SUPPLY_CODES = (PowerLight.SUPPLY_HELD, PowerLight.SUPPLY_LOW, PowerLight.SUPPLY_FELL)
"""Findings of the light of power that are about the supply of the autopilot's board, not about a battery."""

MOTORS_CHART = "Motors"
"""Title of the chart of a live page that stands first: that of the motors, as begins with this word."""

GAINS_TITLE = "Gains"
"""Title of a live page's chapter with the gains that were advised after a landing."""

EVENTS_IN_GAINS_CHAPTER = (GainFact.GAINS_ADVISED, GainFact.TWIN_ANGLE_ERROR)
"""Events of a live session that the chapter on gains has, so that the list of events leaves them out."""

SILENCES_OF_LINK = (LinkFact.LOST_IN_FLIGHT, LinkFact.CONNECTION_LOST, RowsFact.NOTHING_RECEIVED)
"""Events of a live session whose advice is out of date once messages come again."""

MAX_SHOWN_SILENCE = 3.0
"""Time for which the time axis of a live page goes on after the last message, s: a choice.

It shows that nothing comes. The plots show 30 s, most of which must be the last ones before the silence.
"""

MAX_EVENT_DELAY = 1.0
"""Longest time from the last sample of a live flight to an event that belongs to it, s.

A touchdown shows in messages that autopilots send once a second, such as HEARTBEAT.
"""

SECONDS_AROUND_LOSS = 3.0
"""Time around the loss of a flight, s, in which texts of the autopilot stand with it: a choice, as long as a fall."""

MAX_MESSAGES_AROUND_LOSS = 4
"""Texts of the autopilot that stand with the loss of a flight: a choice. A chapter has them all."""

SECONDS_PER_MINUTE = 60
"""Seconds of a minute."""

CHAPTER_LEVELS = (Level.BAD, Level.WATCH, Level.UNKNOWN, Level.GOOD)
"""Levels of a chapter from the worst to the best; one that is not known may hide a bad one."""

TRACKING_FIGURES = {
    "angle_error": "angle error (RMS)",
    "error_limit": "bad from",
    "delay": "delay",
    "rate_error": "rate error (RMS)",
}
"""Columns of the table of tracking: header by the figure of the axis's fact."""


def review_page(assessment: Assessment) -> str:
    """Returns the HTML of the full page of a log, with all that the log contains.

    Args:
        assessment: all results on a vehicle of the log, with an inventory of its contents.
    """
    return log_page(Path(assessment.log.source).name, assessment, assessment.log_contents)


def flight_page(file: str, assessment: Assessment) -> str:
    """Returns the HTML of one flight of a fleet, a small page that links to the fleet's page.

    Args:
        file: name of the log.
        assessment: all results on a vehicle of the log: events, status lights, model, loops and wind.
    """
    return log_page(file, assessment, back=PageLink("Fleet", "../index.html"))


def log_page(
    name: str,
    assessment: Assessment,
    contents: JsonValues | None = None,
    back: PageLink | None = None,
) -> str:
    """Returns the HTML of the page of one log: the result, the events with charts over time, and chapters with details.

    Args:
        name: title of the page.
        assessment: all results on a vehicle of the log: events, status lights, model, loops and wind.
        contents: inventory of the log, from ``mavdem.assessment.inventory``. Without it the page is small, for fleets
            of many flights: with fewer points, and without spectrograms and advice on gains.
        back: the page that leads here, if any.
    """
    is_full = contents is not None
    advice = assessment.advised_gains if is_full else {}
    changes = _gains_to_load(name, assessment, advice)
    # Sentences refer to parts of the page, where those of the terminal name commands.
    medium = Medium(
        has_terminal=False, has_gain_table=changes is not None, table_gains=gains_in_tables(changes)
    )
    with sentences_for(medium):
        if changes is not None and not lowered_gains(assessment.next_step):
            changes = changes._replace(loading=loading_sentences(advice))
        evidence = headline_evidence(assessment.headline, assessment.lights)
        timeline = assessment_timeline(assessment, has_all_flights=True)
        events = _listed_events(assessment, timeline, joined_sentences(evidence))
        if timeline is not None:
            timeline = timeline._replace(event_labels=_labels_in_charts(events, timeline))
        chapters = _log_chapters(name, assessment, contents, timeline, advice)
        head = _log_head(assessment, events, timeline, chapters)._replace(changes=changes)
        if is_full:
            head = head._replace(provenance=Provenance.of_log(Path(assessment.log.source)))
        subtitle = capitalize_first(review_title(assessment).text)
        max_points = MAX_POINTS if is_full else MAX_POINTS_OF_SMALL_PAGE
        summary = _summary_sentences(assessment, evidence)
        return render_document(name, subtitle, summary, chapters, back, head, max_points)


def _gains_to_load(name: str, assessment: Assessment, advice: AdviceByAxis) -> GainChanges | None:
    """Returns the table of the gains to set after a flight, with files to download; None if there are none.

    Args:
        name: title of the page.
        assessment: all results on a vehicle of the log, with its next step.
        advice: advised gains of each axis. If the next step lowers gains, it comes first, and they are left out.
    """
    if assessment.evidence is None:
        return None
    gains_to_lower = lowered_gains(assessment.next_step)
    return gain_changes(
        name,
        assessment.evidence.signals.telemetry,
        {} if gains_to_lower else advice,
        gains_to_lower,
        is_after_check=needs_check_before_gains(assessment.next_step),
    )


def _listed_events(
    assessment: Assessment, timeline: Timeline | None, evidence_of_headline: str
) -> list[PageEvent]:
    """Returns the list of events on the page of a log, such as a failsafe or the loss of a motor.

    Args:
        assessment: all results on a vehicle of the log: events, status lights, model, loops and wind.
        timeline: charts of the flight over time, in which the numbers of the events are marked; None for none.
        evidence_of_headline: sentence with the measurements that confirm the headline. It stands above the list, whose
            events do not repeat it.

    Returns:
        The events. Bad ones have their time in UTC, and a loss of the vehicle the autopilot's messages around it.
    """
    events = _numbered_events(
        assessment.events,
        timeline,
        assessment.headline,
        assessment.lights,
        str(assessment.next_step),
        evidence_of_headline,
    )
    if assessment.evidence is None:
        return events
    telemetry = assessment.evidence.signals.telemetry
    events = with_utc_of_bad_events(events, telemetry.messages)
    return with_messages_around_loss(events, telemetry)


def _log_head(
    assessment: Assessment,
    events: Sequence[PageEvent],
    timeline: Timeline | None,
    chapters: Sequence[Chapter],
) -> Head:
    """Returns the top of the page of a log: level of the headline, status lights, events, charts over time, and a map.

    Args:
        assessment: all results on a vehicle of the log, with the status lights, each the judgement of one subject.
        events: the events as the page lists them.
        timeline: charts of the flight over time, if it has any.
        chapters: chapters of the page, to which the lights link.
    """
    # Imported here: nothing else of a log's page needs live sessions.
    from mavdem.report.live import recorded_light_figures

    return Head(
        assessment.headline.level,
        light_figures=recorded_light_figures(assessment.lights),
        fault_in_full=_text_of_headline(assessment),
        lights=lights_with_reason_once(assessment.lights, assessment.headline),
        events=events,
        timeline=timeline,
        analysis=assessment.analysis,
        light_anchors=_anchors_of_lights(chapters, assessment.lights),
        path=flown_path(timeline, MapWind.of_flight(assessment.wind)),
        day_in_name=day_in_file_name(Path(assessment.log.source).name),
    )


def _log_chapters(
    name: str,
    assessment: Assessment,
    contents: JsonValues | None,
    timeline: Timeline | None,
    advice: AdviceByAxis,
) -> list[Chapter]:
    """Returns the chapters of the page of a log: on the flight, the models, the messages and the contents of the log.

    Args:
        name: title of the page.
        assessment: all results on a vehicle of the log: events, status lights, model, loops and wind.
        contents: inventory of the log; None for a small page, which has no chapter on it.
        timeline: charts of the flight over time, if it has any.
        advice: advice on the gains of each axis, or why there is none; empty for a small page.
    """
    is_full = contents is not None
    chapters = [*_flight_chapters(name, assessment, timeline, advice, is_full=is_full)]
    chapters += _model_chapters(assessment)
    if assessment.evidence is not None:
        telemetry = assessment.evidence.signals.telemetry
        charts_boot = None if timeline is None else timeline.boot
        chapters.append(messages_chapter(telemetry, charts_boot))
    if contents is not None:
        chapters.append(Chapter(LOG_TITLE, log_blocks(contents), folded=True))
    return _unfold_needed_chapters(chapters, assessment)


def _unfold_needed_chapters(chapters: Sequence[Chapter], assessment: Assessment) -> list[Chapter]:
    """Returns the chapters of a page with those unfolded that its reader needs first.

    These are the chapters that explain warnings and, if the next step is to load new gains, the chapter of the margins,
    which lists the gains. The chapter that explains the headline is marked. Folded chapters are missing on paper.

    Args:
        chapters: all chapters of the page.
        assessment: all results on a vehicle of the log, with its headline, status lights and next step.
    """
    unfolded_chapters = []
    is_tuning_advised = advises_to_tune(assessment.next_step)
    title_of_headline = _title_of_headline(assessment.headline, assessment.lights)
    for chapter in unfold_chapters_of_warnings(chapters, assessment.lights, assessment.headline):
        chapter = chapter._replace(is_of_headline=chapter.title == title_of_headline)
        if is_tuning_advised and chapter.title == MARGINS_TITLE:
            chapter = chapter._replace(folded=False)
        unfolded_chapters.append(chapter)
    return unfolded_chapters


def _summary_sentences(assessment: Assessment, evidence: Sequence[Sentence]) -> list[Sentence]:
    """Returns the sentences at the top of the page of a log. The status lights stand in a grid below them.

    Args:
        assessment: all results on a vehicle of the log: events, status lights, model, loops and wind.
        evidence: what sensors confirm of the headline, which comes right after it.
    """
    heading = heading_of(assessment.stated_headline, _text_of_headline(assessment))
    details = [Sentence(heading.details)] if heading.details else []
    return [
        headline_sentence(heading.finding),
        *details,
        *evidence,
        *_explanation_of_small_margins(assessment),
        judgement_sentences(assessment.judgement).next_step,
        *_sentences_on_last_position(assessment),
        *flight_sentences(assessment, has_headline_above=True),
    ]


def _text_of_headline(assessment: Assessment) -> str:
    """Returns the whole headline of a page; of several vehicles or flights it says which one it is about."""
    stated_headline = assessment.stated_headline
    if stated_headline == assessment.headline:
        return headline(stated_headline)
    return stated_headline.sentence


def _sentences_on_last_position(assessment: Assessment) -> list[Sentence]:
    """Returns the sentence that says where a lost flight was seen last, by satellites; none of another flight.

    Args:
        assessment: all results on a vehicle of the log, with its signals and how its flight was lost.
    """
    evidence = assessment.evidence
    if evidence is None:
        return []
    position = last_position_of_loss(evidence.signals, evidence.ending)
    if position is None:
        return []
    return render_section("last_position", position)


def _explanation_of_small_margins(assessment: Assessment) -> list[Sentence]:
    """Returns the sentence that explains a headline on too small stability margins of the control loops.

    Args:
        assessment: assessment of the log, with its headline and the identified loops.

    Returns:
        A list with the sentence; empty if the headline is about something else.
    """
    evidence = assessment.evidence
    if evidence is None:
        return []
    facts_on_margins: list[Fact] = []
    for margins in evidence.margins:
        facts_on_margins += margins.facts
    return margin_sentences(assessment.headline, evidence.identified_loops, facts_on_margins)


def unfold_chapters_of_warnings(
    chapters: Sequence[Chapter], lights: NamedFacts, headline: Fact
) -> Iterator[Chapter]:
    """Yields the chapters of a page with their levels; the bad ones are open, or else the one of a warning.

    A status light is the judgement of one part of the vehicle, such as its motors, with a level. The level of a chapter
    is the worst one of the lights that it explains. All other chapters are folded, so that the page is short.

    Args:
        chapters: the chapters.
        lights: the lights by name; each is a fact (a coded finding) with a level.
        headline: the fact in the headline, which is about a light or an event.
    """
    titles_to_open = _titles_to_open(chapters, lights, headline)
    for chapter in chapters:
        levels = _levels_of_chapter(chapter, lights)
        if levels:
            worst_level = min(levels, key=CHAPTER_LEVELS.index)
            chapter = chapter._replace(level=worst_level)
        is_open = chapter.title in titles_to_open
        yield chapter._replace(folded=not is_open)


def _titles_to_open(
    chapters: Sequence[Chapter], lights: NamedFacts, headline: Fact
) -> Collection[str]:
    """Returns the titles of the chapters that are open when a page is loaded; all others are folded.

    If something is bad, these are the chapters that show it. Otherwise they are the charts by which a pilot judges the
    tuning at a glance and, if there are warnings, one chapter with a warning: the one that the headline is about, or
    else the first. More would make the page long. The chapter on the log is not opened for a warning, since the
    sentence of its light says all that it shows.

    Args:
        chapters: the chapters, with the levels of their sections.
        lights: the judgement of each part of the vehicle by name, a fact (a coded finding) with a level.
        headline: the fact in the headline, which is about a light or an event.
    """
    bad_titles = _titles_with_level(chapters, lights, Level.BAD)
    if bad_titles:
        return bad_titles
    watched_titles = _titles_with_level(chapters, lights, Level.WATCH)
    if LOG_TITLE in watched_titles:
        watched_titles.remove(LOG_TITLE)
    for title in watched_titles:
        if _explains_headline(title, lights, headline):
            return [title, TUNING_TITLE]
    return [*watched_titles[:1], TUNING_TITLE]


def _titles_with_level(chapters: Sequence[Chapter], lights: NamedFacts, level: Level) -> list[str]:
    """Returns the titles of the chapters in which something has a certain level.

    Args:
        chapters: the chapters, with the levels of their sections.
        lights: the judgement of each part of the vehicle by name, a fact (a coded finding) with a level.
        level: the level, bad or to be watched.
    """
    return [chapter.title for chapter in chapters if level in _levels_of_chapter(chapter, lights)]


def _explains_headline(title: str, lights: NamedFacts, headline: Fact) -> bool:
    """Returns whether a chapter explains the headline of its page, as "Vibration" explains "Vibration is strong.".

    A chapter explains some of the status lights, each the judgement of one part of the vehicle. The headline may be the
    judgement of one of them, and then has its code.

    Args:
        title: title of the chapter.
        lights: the lights by name, each a fact (a coded finding) with a level.
        headline: the fact in the headline, which may also be an event.
    """
    codes_of_lights = [lights[name].code for name in lights_of_chapter(title, lights)]
    return headline.code in codes_of_lights


def _title_of_headline(headline: Fact, lights: NamedFacts) -> str:
    """Returns the title of the chapter about the fault in the headline, such as "Motors"; empty without such a chapter.

    If the flight was lost, the chapter about the cause explains most, and best of all that about the cause of the
    cause. So causes come before the loss itself: the first that the light of a chapter states decides.

    Args:
        headline: the fact in the headline, a light or an event.
        lights: the judgement of each part of the vehicle by name, a fact (a coded finding) with a level.
    """
    first_cause_first = [headline.code]
    cause = headline.figures.get("cause")
    while isinstance(cause, Fact):
        first_cause_first.insert(0, cause.code)
        cause = cause.figures.get("cause")
    for code in first_cause_first:
        for name in CHAPTER_OF_LIGHT:
            if name in lights and lights[name].code is code:
                return chapter_of_light(name, lights[name])
    return ""


def chapter_of_light(light: Light, fact: Fact) -> str:
    """Returns the title of the chapter on a flight's page that explains a status light, such as "Vibration".

    A status light is the judgement of one subject. The judgement of the power may be about a battery, or about the
    supply of the autopilot's board, which are in different chapters.

    Args:
        light: name of the light, its subject.
        fact: the judgement, a coded finding. Its code tells a battery from the supply of the board.
    """
    is_about_supply_of_board = fact.code in SUPPLY_CODES
    if is_about_supply_of_board:
        return HARDWARE_TITLE
    return CHAPTER_OF_LIGHT[light]


def lights_of_chapter(title: str, lights: NamedFacts) -> list[Light]:
    """Returns the names of the status lights that a chapter of a page explains.

    A status light is the judgement of one part of the vehicle, such as its motors.

    Args:
        title: title of the chapter.
        lights: the lights of the flight by name, each a fact (a coded finding) with a level; some may be missing.
    """
    names = []
    for name in CHAPTER_OF_LIGHT:
        if name in lights and chapter_of_light(name, lights[name]) == title:
            names.append(name)
    return names


def _levels_of_chapter(chapter: Chapter, lights: NamedFacts) -> set[Level]:
    """Returns the levels, such as good or bad, of all judgements that a chapter of the page explains.

    These are the levels of status lights, each the judgement of one part of the vehicle such as its motors, and the
    chapter's own level, that of what has no light.

    Args:
        chapter: the chapter. If it has sections, ``chapter.level`` is the worst of their levels.
        lights: the lights by name, each a fact (coded finding) with a level.

    Returns:
        The levels; empty for a chapter that nothing judges.
    """
    levels = set()
    for light in lights_of_chapter(chapter.title, lights):
        levels.add(lights[light].level)
    if chapter.level is not None:
        levels.add(chapter.level)
    return levels


def _anchors_of_lights(chapters: Sequence[Chapter], lights: NamedFacts) -> dict[str, str]:
    """Returns the anchor of the chapter about each light, as far as the page has it.

    Args:
        chapters: the chapters of the page.
        lights: the judgement of each part of the vehicle by name, a fact (a coded finding) with a level.
    """
    anchors = {}
    for chapter in chapters:
        if chapter.has_content:
            for light in lights_of_chapter(chapter.title, lights):
                anchors[str(light)] = chapter.anchor
    return anchors


def _numbered_events(
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


def _labels_in_charts(events: Sequence[PageEvent], timeline: Timeline) -> Names:
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


def _flight_chapters(
    name: str,
    assessment: Assessment,
    timeline: Timeline | None,
    advice: AdviceByAxis,
    *,
    is_full: bool,
) -> Iterator[Chapter]:
    """Yields the chapters of a flight's page that need no identified model, in the order of the page.

    A log without a flight has none of them.

    Args:
        name: title of the page.
        assessment: all results on a vehicle of the log: events, status lights, model, loops and wind.
        timeline: charts over time; None if the attitude has too few samples.
        advice: advised gains by axis, or the reason why there are none; empty without advice.
        is_full: whether it is the full page of one log, with spectrograms, notch filters to try and hardware, and not a
            small page of a fleet.
    """
    evidence = assessment.evidence
    analysis = assessment.analysis
    if evidence is None or analysis is None:
        return
    yield tuning_chapter(assessment.responses, assessment.noise)
    if timeline is not None:
        yield _axes_chapter(assessment, timeline)
    steps = advised_steps(assessment.responses, advice)
    yield responses_chapter(assessment.responses, steps, assessment.lights[Light.MARGINS])
    has_advised_gains_above = not lowered_gains(assessment.next_step)
    yield from loops_chapters(assessment, evidence, advice, has_gains_above=has_advised_gains_above)
    vibration = vibration_chapter(assessment, timeline, has_spectrograms=is_full)
    if is_full:
        vibration = vibration._replace(notch_trial=_notch_trial(name, assessment, evidence))
    yield vibration
    yield controller_spectra_chapter(assessment.noise, timeline, has_spectrograms=is_full)
    yield _motors_chapter(analysis, evidence, assessment.lights["motors"])
    yield _condition_chapter(analysis)
    yield _wind_chapter(assessment, analysis)
    if evidence.trust:
        yield _trust_chapter(evidence.trust)
    if assessment.instances:
        yield _instances_chapter(assessment, has_flown=evidence.has_flown)
    if is_full:
        yield from hardware_chapters(evidence, assessment.lights, timeline)
    yield parameters_chapter(evidence.signals.telemetry, is_full=is_full)


def _instances_chapter(assessment: Assessment, *, has_flown: bool) -> Chapter:
    """Returns the chapter on what a vehicle may have several of, such as batteries and sensors: a table of each one.

    Args:
        assessment: all results on a vehicle of the log, with these instances and the status lights.
        has_flown: whether the vehicle flew; otherwise the ranges are taken from the whole log.
    """
    vibration_light = assessment.lights[Light.VIBRATION]
    table = instance_table(assessment.instances, vibration_light, has_flown=has_flown)
    # The table shows what was measured, and not always why a light warns, such as a disagreement of two sensors.
    for name in lights_of_chapter(INSTANCES_TITLE, assessment.lights):
        light = assessment.lights[name]
        if light.is_watch_or_bad:
            cause = Rated(without_full_stop(str(light)), light.level)
            table.rows.insert(0, [str(name), "", "judgement", "", cause])
    level_scope = scope_of_instances_level(assessment.lights)
    return Chapter(INSTANCES_TITLE, [table], level_scope=level_scope)


def scope_of_instances_level(lights: NamedFacts) -> str:
    """Returns which status lights the level of the chapter of batteries, sensors, estimators and outputs comes from.

    The chapter also has the vibration of the IMUs, which has a chapter of its own, and is not meant by the level.

    Args:
        lights: the judgement of each part of the vehicle by name, a fact (a coded finding) with a level.

    Returns:
        Text that follows the level, such as " (power)"; empty if no light is about the chapter.
    """
    names = lights_of_chapter(INSTANCES_TITLE, lights)
    if not names:
        return ""
    # The level of the chapter is the worst of these. The levels are listed from the worst to the best.
    worst_level = min([lights[name].level for name in names], key=CHAPTER_LEVELS.index)
    names_of_worst = [str(name) for name in names if lights[name].level is worst_level]
    return f" ({' and '.join(names_of_worst)})"


def _trust_chapter(trust_of_boots: Sequence[SensorTrust]) -> Chapter:
    """Returns the chapter with the checks of sensors against each other, which show whose values can be trusted.

    Args:
        trust_of_boots: the checks of each boot of the autopilot.

    Returns:
        The chapter, with the level "watch" if a check warns; otherwise without a level.
    """
    level = None
    for trust in trust_of_boots:
        if any(check.is_watch_or_bad for check in trust.checks):
            level = Level.WATCH
    return Chapter("Sensor checks", [trust_table(trust_of_boots)], level=level)


def _axes_chapter(assessment: Assessment, timeline: Timeline) -> Chapter:
    """Returns the chapter of angles and rates with their setpoints, a column for each axis, and how well they track.

    If the tracking is bad, the chapter is open when the page is loaded. Then only the rates are shown at first, by
    which an axis that was lost is recognised: the plots over the flight have roll and pitch already. The other charts
    are in a part to open, so that the page stays short.

    Args:
        assessment: all results on a vehicle of the log: events, status lights, model, loops and wind.
        timeline: charts of the flight over time.
    """
    tracking_light = assessment.lights["tracking"]
    all_charts: dict[str, Charts] = {}
    rate_charts: dict[str, Charts] = {}
    other_charts: dict[str, Charts] = {}
    for axis, unmarked_charts in timeline.axis_charts.items():
        if not unmarked_charts:
            continue
        charts = tuple(timeline.marked(chart) for chart in unmarked_charts)
        all_charts[axis] = charts
        rate_charts[axis] = tuple(chart for chart in charts if chart.title == rate_title(axis))
        other_charts[axis] = tuple(chart for chart in charts if chart.title != rate_title(axis))
    blocks: Blocks = [*_tracking_sentences(tracking_light, assessment.headline)]
    error_tables = _tracking_tables(assessment.tracking)
    sections = []
    # The charts can be divided if each axis has a rate, and something else. A section is the part to open.
    can_be_divided = all(rate_charts.values()) and all(other_charts.values())
    if tracking_light.is_bad and can_be_divided:
        group = Group.of_axes(rate_charts, tracking_light)
        other_group = Group.of_axes(other_charts, tracking_light)
        sections.append(Section("Angles and errors", groups=[other_group], blocks=error_tables))
    else:
        group = Group.of_axes(all_charts, tracking_light)
        blocks += error_tables
    level_scope = _scope_of_tracking_level(assessment, tracking_light)
    return Chapter("Three axes", blocks, [group], level_scope=level_scope, sections=sections)


def _scope_of_tracking_level(assessment: Assessment, light: Fact) -> str:
    """Returns the words after the level in the title of the chapter on tracking, as in "good in settled flight, …".

    How well the attitude tracks its setpoint is judged in settled flight only, without take-off, landing and loss. But
    the charts of the chapter also show how a vehicle was lost. "Good" alone would be wrong of these, so that the words
    limit it to the time before the loss.

    Args:
        assessment: all results on a vehicle of the log, with the event by which the vehicle was lost, if it was.
        light: the judgement of how well all axes track, a fact (a coded finding) with a level.

    Returns:
        Words such as " in settled flight, until 47.2 s", a time on the boot clock. They are empty if the vehicle was
        not lost, if the tracking was not judged, and if it was judged by the loss itself.
    """
    if assessment.evidence is None:
        return ""
    loss = assessment.evidence.ending
    is_judged_before_loss = light.level is not Level.UNKNOWN and light.code not in Ending
    if loss is None or loss.time is None or not is_judged_before_loss:
        return ""
    return f" in settled flight, until {loss_onset(loss):.1f} s"


def _tracking_sentences(light: Fact, headline: Fact) -> list[Sentence]:
    """Returns the sentence on how well the attitude follows its setpoints, unless the page has it already.

    The page has it in the headline, which also says how a flight was lost, or beside the status lights, which say that
    only multirotors are judged.

    Args:
        light: the judgement of how well all axes track, a fact (a coded finding) with a level.
        headline: the headline of the page.

    Returns:
        A list with the sentence, or an empty one.
    """
    is_in_headline = light.code in Ending or light == headline
    if light.code is Unjudged.MULTIROTORS_ONLY or is_in_headline:
        return []
    return [Sentence(str(light), lead="Tracking:")]


def _tracking_tables(axes: NamedFacts) -> list[Table]:
    """Returns a table of how well each axis follows its setpoint in settled flight, without take-off and landing.

    Args:
        axes: a fact (coded finding) for each axis, whose figures are the errors and the delay, each with its unit.

    Returns:
        A list with the table, which has a row for each axis with a known figure; empty without such an axis.
    """
    rows = []
    for axis, fact in axes.items():
        cells = _tracking_cells(fact)
        if any(cells):
            rows.append([axis, *cells])
    if not rows:
        return []
    return [Table(["tracking", *TRACKING_FIGURES.values()], rows)]


def _tracking_cells(fact: Fact) -> list[str]:
    """Returns the row of one axis in the table of tracking errors: a cell for each of ``TRACKING_FIGURES``.

    Args:
        fact: how well the axis tracks its setpoint, as figures with units; a figure is None where it is not known.

    Returns:
        Values with their units. A cell is empty if its figure does not apply, and "not known" if the axis has other
        figures but not this one: a setpoint that moved too little shows no delay, for example.
    """
    cells: list[str] = []
    for key in TRACKING_FIGURES:
        value = fact.figures.get(key)
        if value is not None:
            cells.append(with_unit(value, display_unit(fact.units[key])))
        elif key in fact.figures and any(cells):
            cells.append("not known")
        else:
            cells.append("")
    return cells


def _notch_trial(name: str, assessment: Assessment, evidence: Evidence) -> NotchTrial | None:
    """Returns the notch filters whose settings a reader of the page can try, with their effect on spectrum and phase.

    Args:
        name: name of the log.
        assessment: all results on a vehicle of the log: events, status lights, model, loops and wind.
        evidence: signals, events and measurements of the vehicle.

    Returns:
        The trial of the filters; None without a spectrum or a known controller.
    """
    signals = evidence.signals
    # The gyro's filters are the same for all axes, so that the controller of any one will do.
    controller = controller_if_known(signals.for_axis("roll"))
    return notch_trial(
        name,
        signals.telemetry,
        assessment.noise,
        controller,
        fastest_loop(assessment.identified_loops),
        _motor_frequencies(evidence),
    )


def _motor_frequencies(evidence: Evidence) -> tuple[float, ...]:
    """Returns how often each motor turns in a second (Hz), the median in flight, as their speed controllers report it.

    Args:
        evidence: signals and measurements of the vehicle, with the reported speeds in revolutions per minute.

    Returns:
        The frequencies, at which notch filters that follow the motors are shown; none of motors that did not turn, or
        whose speed was not reported.
    """
    frequencies = []
    for speed_controller in speed_controllers(evidence.signals):
        speeds = evidence.values_in_flight(speed_controller.speed)
        if len(speeds) == 0:
            continue
        median_speed = float(np.median(speeds))
        if median_speed > 0:
            frequencies.append(median_speed / SECONDS_PER_MINUTE)
    return tuple(frequencies)


def _motors_chapter(analysis: LogAnalysis, evidence: Evidence, light: Fact) -> Chapter:
    """Returns the chapter on the motors of a flight: a table of the motors, and the vehicle drawn from above.

    If a motor failed, the drawing shows what the motors were commanded at that time; otherwise it shows the means of
    the hover. If the log allows no full model, sentences on the motors' condition follow the table. Without a hover the
    table is of all flight.

    Args:
        analysis: what the log shows of the chosen axis: model, physical parameters and condition.
        evidence: signals, events and measurements of the vehicle.
        light: the status light of the motors, whose level colours the drawing.
    """
    hover = analysis.condition.hover
    blocks = motor_blocks(analysis.learned, hover)
    if hover is None:
        figures_of_all_flight = motor_figures_of_all_flight(evidence)
        if figures_of_all_flight is not None:
            blocks += motor_table_of_all_flight(figures_of_all_flight)
    has_full_model = analysis.learned is not None and analysis.tier.allows_full_model
    if not has_full_model:
        for sentence in render_section("condition", analysis.condition):
            # The table of the hover has what the sentence "Motors: …" says.
            is_in_table = hover is not None and sentence.lead == MOTOR_LEADS[0]
            if sentence.lead in MOTOR_LEADS and not is_in_table:
                blocks.append(sentence)
    failure = failure_commands(evidence.signals, light)
    drawing = frame_plan(evidence.signals.motors, analysis.condition, light, failure)
    groups = [] if drawing is None else [Group.side_by_side([drawing])]
    return Chapter("Motors", blocks, groups, is_side_by_side=True)


def _condition_chapter(analysis: LogAnalysis) -> Chapter:
    """Returns the chapter of the vehicle's condition in figures: lean, vibration, batteries, and how long it flew.

    Sentences on the motors are left out, since these have a chapter of their own.

    Args:
        analysis: what the log shows of the chosen axis, with the condition of the vehicle.
    """
    blocks: Blocks = []
    for sentence in render_section("condition", analysis.condition):
        if sentence.lead not in MOTOR_LEADS:
            blocks.append(sentence)
    return Chapter("Condition in figures", blocks)


def _wind_chapter(assessment: Assessment, analysis: LogAnalysis) -> Chapter:
    """Returns the chapter of a flight's page on the wind: its speed (m/s) and direction, and the torque that it causes.

    If both speed and direction are identifiable, a wind rose shows them. For a simulated flight the chapter compares
    the estimates with the true values of the simulator.

    Args:
        assessment: all results on a vehicle of the log: events, status lights, model, loops and wind.
        analysis: analysis of the axis, with the wind torque.

    Returns:
        The chapter, with sentences, and the wind rose where it can be drawn.
    """
    blocks: Blocks = []
    # The wind is judged for multirotors alone. For other vehicles the page says so at its top, and not here again.
    if assessment.lights[Light.WIND].code is not Unjudged.MULTIROTORS_ONLY:
        blocks += air_blocks(assessment)
    if analysis.learned is not None:
        blocks += torque_blocks(analysis.learned)
    if analysis.truth:
        blocks += truth_blocks(analysis.truth)
    wind = assessment.wind
    groups = []
    if wind is not None and wind.direction_identifiable and wind.speed_identifiable:
        groups.append(Group.side_by_side([rose_of_wind(wind)]))
    return Chapter("Wind", blocks, groups, is_side_by_side=True)


def _model_chapters(assessment: Assessment) -> Iterator[Chapter]:
    """Yields two chapters for each analysed axis: the learned model and, folded, how it was learned.

    Args:
        assessment: all results on a vehicle of the log. An axis without a model has only the first chapter, which says
            why.
    """
    for axis, analysis in assessment.analyses.items():
        yield _model_chapter(axis, analysis)
        if analysis.learned is not None:
            yield _learning_chapter(axis, analysis.learned)


def _model_chapter(axis: str, analysis: LogAnalysis) -> Chapter:
    """Returns the chapter of a page on the identified model of one axis, or on the reason why there is none.

    It has, in this order, grades of the model for each purpose with warnings, physical parameters, errors of forecasts,
    and charts of the frequency response and of the forecasts. The frequency response depends on the control
    effectiveness of the motors, so it is left out where that is not identifiable.

    Args:
        axis: name of the axis.
        analysis: what the log shows of that axis: model, physical parameters and condition.
    """
    learned = analysis.learned
    findings = analysis.findings
    blocks = Blocks()
    if learned is None and analysis.reason is not None:
        blocks.append(Sentence(str(analysis.reason), lead="No model:"))
    blocks += purpose_tables(findings)
    blocks += [warning(fact) for fact in findings.warnings]
    blocks += render_section("tier", analysis.tier)
    blocks += vehicle_blocks(analysis.axes, is_doubtful=bool(findings.overrides))
    groups = []
    if learned is not None:
        labels = Labels.of(learned)
        forecasts = analysis.held_out
        blocks += prediction_blocks(labels, forecasts)
        effectiveness_grade = findings.grade(Purpose.CONTROL_EFFECTIVENESS)
        if effectiveness_grade is not Grade.NOT_IDENTIFIABLE:
            caption = "Frequency response of the vehicle without its controller, with a 90 % band."
            groups.append(Group.side_by_side(model_charts.bode_charts(learned), caption))
        if forecasts is not None and len(forecasts):
            caption = "Held-out windows, by models that were not trained on them."
            forecast_charts = model_charts.forecast_charts(forecasts, labels)
            groups.append(Group.side_by_side(forecast_charts, caption))
    return Chapter(f"Model of {axis}", blocks, groups)


def _learning_chapter(axis: str, learned: Learned) -> Chapter:
    """Returns the folded chapter on how a model was learned: poles, free energy and residuals.

    Args:
        axis: "roll", "pitch" or "yaw".
        learned: the model of that axis.
    """
    caption = "Errors one step ahead; correlations between the lines may be chance (99 %)."
    groups = [Group.side_by_side(model_charts.residual_charts(learned), caption)]
    title = f"How the model of {axis} was learned"
    return Chapter(title, detail_blocks(learned), groups, folded=True)


def live_page(
    link: str,
    axis: str,
    history: LiveHistory,
    status: SessionStatus,
    seconds_by_use: Mapping[TimeUse, float],
    learned: Learned | None,
    back: PageLink | None = None,
    links: Sequence[PageLink] = (),
    saved_flight: PageLink | None = None,
    names: GivenNames = NO_NAMES,
    files: Sequence[str] = (),
    refresh_seconds: float | None = None,
) -> str:
    """Returns the HTML of the page of a live flight.

    Args:
        link: address of the vehicle.
        axis: axis that was learned.
        history: events and signals of the live flight on one timeline.
        status: state of the session now, or at its end.
        seconds_by_use: seconds of the flight by what they were used for.
        learned: the latest model; None if there is none.
        back: the page that leads here, if any.
        links: other pages at the top, such as that of the flight before.
        saved_flight: the page of this flight in the library of a server, where it is over; None for none.
        names: names that were given to vehicles in the library of a server.
        files: sentences on the files that the session has written, once it is over.
        refresh_seconds: time after which a server has a newer page, s; None for a page that does not change.
    """
    # Imported here: a page of a log needs nothing of live sessions.
    from mavdem.report.live import live_title

    judgement = replace(status.session_judgement, headline=_headline_by_session(status))
    events = _numbered_live_events(history, judgement, status.alarms)
    timeline = _marked_live_timeline(history, axis, status, events)
    chapters = _live_chapters(axis, history, status, seconds_by_use, learned)
    head = _live_head(history, status, events, timeline)._replace(
        light_anchors=_live_anchors(timeline, chapters),
        links=links,
        saved_flight=saved_flight,
        files_of_session=files,
        refresh_seconds=refresh_seconds,
    )
    if status.is_over and saved_flight is None:
        # The page of a flight that a library has says that in its own words.
        session_end = _session_end(status, is_last=refresh_seconds is None)
        head = head._replace(session_end=session_end)
    # A page of a session that goes on is sent every few seconds, and has fewer points for that.
    max_points = MAX_POINTS if status.is_over else MAX_POINTS_OF_SMALL_PAGE
    return render_document(
        live_title(status, link, names),
        _live_subtitle(status, link),
        _live_summary(status, saved_flight),
        chapters,
        back,
        head,
        max_points,
    )


def _marked_live_timeline(
    history: LiveHistory, axis: str, status: SessionStatus, page_events: Sequence[PageEvent]
) -> Timeline | None:
    """Returns the charts of a live page over time, with marks at the take-off and at the numbered events.

    The chart of the motors comes first, since most faults that forbid flying are in the motors. The time axis ends at
    the last sample, or later: at the latest event right after it, or after a part of the silence of a lost link.

    Args:
        history: signals of the live flight on one timeline.
        axis: axis that was learned.
        status: state of the session now, or at its end.
        page_events: the events of the page in order of time, some of them numbered.

    Returns:
        The charts; None if too little was received to draw any.
    """
    timeline = live_timeline(history, axis)
    if timeline is None:
        return None
    numbered_events = [event for event in page_events if event.number is not None]
    events = [page_event.event for page_event in numbered_events]
    first_time, last_sample_time = timeline.span
    end_of_silence = last_sample_time + _shown_silence(status)
    end_time = max(end_of_silence, _time_of_last_event(events, last_sample_time))
    # The order is the same in every state of every flight, so that the chart that a reader looks at stays in its place.
    timeline = timeline.with_chart_first(MOTORS_CHART)
    return timeline._replace(
        takeoff=status.takeoff_position,
        span=(first_time, end_time),
        events=tuple(events),
        event_labels=tuple(str(page_event.number) for page_event in numbered_events),
    )


def _time_of_last_event(events: Sequence[Event], last_sample_time: float) -> float:
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


def _live_head(
    history: LiveHistory,
    status: SessionStatus,
    page_events: Sequence[PageEvent],
    timeline: Timeline | None,
) -> Head:
    """Returns the top of a live page: level of the headline, status lights, events, charts, and state of the vehicle.

    It has what the session shows. What a server adds, such as links to other pages, is not in it yet.

    Args:
        history: events and signals of the live flight on one timeline.
        status: state of the session now, or at its end.
        page_events: the events of the page in order of time. The page of a session that goes on has the newest first.
        timeline: charts over time; None without any.
    """
    # Imported here: a page of a log needs nothing of live sessions.
    from mavdem.live.session_status import cause_of_alarm
    from mavdem.report.live import (
        brief_light_figures,
        live_alarm,
        unrepaired_fault_beside_next_step,
        vehicle_state_cells,
    )

    judgement = status.session_judgement
    goes_on = not status.is_over
    judgement_with_reason = _judgement_with_reason(status)
    fault = cause_of_alarm(judgement_with_reason.headline)
    # The list of a session that is over states its events in short.
    is_event_listed = goes_on and any(page_event.is_headline for page_event in page_events)
    is_fault_in_headline = fault.sentence in headline(judgement.headline)
    reasons = _reasons_of_headline(
        status, are_details_stated=is_event_listed or is_fault_in_headline
    )
    fault_in_full = ""
    is_headline_of_fault = headline(judgement.headline) == headline(fault)
    if reasons or is_event_listed or is_headline_of_fault:
        fault_in_full = fault.sentence
    return Head(
        judgement.headline.level,
        lights_with_reason_once(judgement.lights),
        page_events[::-1] if goes_on else page_events,
        timeline,
        light_figures=brief_light_figures(status),
        timeline_title=_live_timeline_title(status),
        path=flown_path(timeline, _live_map_wind(status)),
        has_log=False,
        is_newest_first=goes_on,
        is_in_flight=status.is_in_flight,
        flight_number=history.flight.number,
        is_lost_in_air=status.is_flying and status.loss is None,
        is_link_lost=status.link_loss is not None,
        reasons=reasons,
        fault_in_full=fault_in_full,
        are_lights_of_recording=_are_lights_of_recording(judgement.lights),
        unrepaired_fault=unrepaired_fault_beside_next_step(status),
        page_of_earlier_fault=_page_of_earlier_fault(status),
        level_of_earlier_fault=_level_of_earlier_fault(status),
        statement_of_repair=_statement_of_repair(status),
        vehicle_state=vehicle_state_cells(status) if goes_on else (),
        last_position=_position_of_lost_vehicle(status),
        alarm=live_alarm(status),
        alarm_count=history.alarm_count,
    )


def _live_summary(status: SessionStatus, saved_flight: PageLink | None) -> list[Sentence]:
    """Returns the sentences at the top of a live page: the headline, what to do next, and how late estimates are.

    What to do stands right below the headline, so that a pilot need not read the reason first.

    Args:
        status: state of the session now, or at its end.
        saved_flight: the page of this flight in the library of a server, where it is over; None for none.
    """
    # Imported here: a page of a log needs nothing of live sessions.
    from mavdem.report.live import statement_of_headline, verdict_on_present_flight

    judgement = _without_place_in_headline(status.session_judgement)
    sentences = judgement_sentences(judgement)
    heading = sentences.headline
    if not status.is_over:
        heading = headline_sentence(statement_of_headline(heading.lead, judgement.headline))
    summary = [heading]
    if str(judgement.next_step) != str(judgement.headline):
        next_step = _next_step_with_link(sentences.next_step, judgement, saved_flight)
        summary += _sentences_on_next_step(next_step)
    verdict_on_flight = verdict_on_present_flight(status)
    if verdict_on_flight:
        summary.append(Sentence(verdict_on_flight))
    plots_of_worse_flight = _plots_of_worse_flight(status, saved_flight)
    if plots_of_worse_flight is not None:
        summary.append(plots_of_worse_flight)
    is_delay_in_headline = judgement.headline.code is SessionFact.ESTIMATES_LATE
    if status.delay_fact is not None and not is_delay_in_headline:
        summary.append(Sentence(str(status.delay_fact), level=Level.WATCH))
    return summary


def _without_place_in_headline(judgement: Judgement) -> Judgement:
    """Returns a judgement whose headline "link lost in flight" does not say where the vehicle was.

    Another part of the page does (:func:`mavdem.report.live.headline_reason`). Other headlines stay as they are.

    Args:
        judgement: the judgement of the vehicle in a live session.
    """
    if judgement.headline.code is not LinkFact.LOST_IN_FLIGHT:
        return judgement
    return replace(judgement, headline=judgement.headline.replace(is_place_stated=True))


def _next_step_with_link(
    next_step: Sentence, judgement: Judgement, saved_flight: PageLink | None
) -> Sentence:
    """Returns the next step of a live page, with a link to the page that has what the step is about, if there is one.

    Args:
        next_step: the sentence on the next step of the judgement.
        judgement: the judgement of the vehicle in the session, with its headline and the next step as a fact.
        saved_flight: the page of this flight in the library of a server, where it is over; None for none.
    """
    # Imported here: a page of a log needs nothing of live sessions.
    from mavdem.report.live import states_unrepaired_fault

    if states_unrepaired_fault(judgement.next_step):
        unrepaired_fault = judgement.next_step.figures["reason"]
        return next_step._replace(address=_address_of_earlier_flight(unrepaired_fault))
    if saved_flight is not None and judgement.headline.code is SessionFact.RECORDING_JUDGED:
        # The page in the library has what the step needs, such as the advised gains.
        return next_step._replace(address=saved_flight.address)
    return next_step


def _are_lights_of_recording(lights: NamedFacts) -> bool:
    """Returns whether the lights of a session, facts by name, are those of its recording, where that has judged any."""
    return any(light.code is SessionFact.LIGHT_OF_RECORDING for light in lights.values())


def _page_of_earlier_fault(status: SessionStatus) -> str:
    """Returns the address of the page of the flight whose fault may not have been repaired; empty without one.

    Args:
        status: state of the session now, or at its end.
    """
    fault = status.unrepaired_fault
    return "" if fault is None else _address_of_earlier_flight(fault)


def _level_of_earlier_fault(status: SessionStatus) -> Level:
    """Returns the level of a fault of an earlier flight that may not have been repaired: bad if it forbids to fly.

    Args:
        status: state of the session now, or at its end.
    """
    fault = status.unrepaired_fault
    forbids_flight = fault is not None and fault.figures["reason"].forbids_flight
    return Level.BAD if forbids_flight else Level.WATCH


def _statement_of_repair(status: SessionStatus) -> str:
    """Returns what a user confirms with the button that ends the warning of an earlier fault, such as its repair.

    Empty without such a fault.

    Args:
        status: state of the session now, or at its end.
    """
    # Imported here: a page of a log needs nothing of live sessions.
    from mavdem.report.live import statement_of_repair

    fault = status.unrepaired_fault
    return "" if fault is None else statement_of_repair(fault)


def _address_of_earlier_flight(unrepaired_fault: Fact) -> str:
    """Returns the address of the page of an earlier flight that had a fault; empty if that flight has no page yet.

    Args:
        unrepaired_fault: the warning that an earlier fault may not have been repaired. Its figure ``reason`` is that
            fault, which may have the address as its figure.
    """
    fault: Fact = unrepaired_fault.figures["reason"]
    address: str = fault.figures.get("address", "")
    return address


def _judgement_with_reason(status: SessionStatus) -> Judgement:
    """Returns the judgement whose findings have the evidence (measurements of sensors) for the headline of a live page.

    - If the headline is on an earlier flight of the session, it is the judgement of that flight.
    - After a flight the headline is the verdict of its recording, a text without evidence. If the session found the
      same in flight, it is the judgement by the session.
    - Otherwise it is the session's present judgement.

    Args:
        status: state of the session now, or at its end.
    """
    judgement = status.session_judgement
    worse_verdict = _verdict_of_headline(status)
    if worse_verdict is not None:
        return worse_verdict.judgement
    if judgement.headline.code is not SessionFact.RECORDING_JUDGED:
        return judgement
    judgement_by_session = _judgement_without_recording(status)
    finding = judgement_by_session.headline
    is_same_verdict = str(judgement.headline) in (headline(finding), finding.sentence)
    return judgement_by_session if is_same_verdict else judgement


def _verdict_of_headline(status: SessionStatus) -> FlightVerdict | None:
    """Returns the verdict on an earlier flight if it is the headline of a session's page; None for another headline.

    Args:
        status: state of the session now, or at its end.
    """
    verdict = status.worst_earlier_verdict
    if verdict is None or status.session_judgement.headline != verdict.fact:
        return None
    return verdict


def _reasons_of_headline(status: SessionStatus, *, are_details_stated: bool) -> list[Sentence]:
    """Returns the sentences below the headline of a live page that explain it, mostly by measurements.

    A session may have several flights. If the headline is on an earlier one, which went worse than the latest, each
    sentence begins with the number of that flight, as in "Flight 2, …".

    Args:
        status: state of the session now, or at its end.
        are_details_stated: whether the page states the details of the fault elsewhere: in its headline, or in the list
            of events.
    """
    # Imported here: a page of a log needs nothing of live sessions.
    from mavdem.report.live import headline_reason

    reasons = headline_reason(_judgement_with_reason(status), are_details_stated=are_details_stated)
    earlier_verdict = _verdict_of_headline(status)
    if earlier_verdict is None:
        return reasons
    return [
        reason._replace(lead=f"Flight {earlier_verdict.number}, {as_clause(reason.lead)}")
        for reason in reasons
    ]


def _judgement_without_recording(status: SessionStatus) -> Judgement:
    """Returns the judgement by what a session found in flight, as if its recording had not been judged afterwards."""
    return replace(status, recording_verdict=None).session_judgement


def _headline_by_session(status: SessionStatus) -> Fact:
    """Returns the headline of a session's page as the session found it in flight, to find the events that report it.

    After a flight the headline is the verdict of the recording, which may give other figures for the same motor than
    the events of the session.

    Args:
        status: state of the session now, or at its end.

    Returns:
        The finding of the session, if the recording has the same verdict or finds the same motor bad; else the headline
        of the page.
    """
    page_headline = _judgement_with_reason(status).headline
    if page_headline.code is not SessionFact.RECORDING_JUDGED:
        return page_headline
    finding = _judgement_without_recording(status).headline
    motor_name = f"motor {page_headline.figures.get('motor')}"
    # The subject of a finding may have the place of the motor, too, as in "motor 3 (front left)".
    is_on_same_motor = finding.subject.partition(" (")[0] == motor_name
    is_same_fault = finding.is_bad and page_headline.is_bad and is_on_same_motor
    return finding if is_same_fault else page_headline


def _session_end(status: SessionStatus, *, is_last: bool) -> str:
    """Returns the first sentence of a page of a session that is over: that no alarm comes any more.

    Args:
        status: state of the session at its end. A lost vehicle that has met the ground no longer flies.
        is_last: whether no page follows: neither that with the verdict on the session, nor that of another session.
    """
    if not is_last:
        return "This session ends: nothing is watched now, and no alarm comes. What follows is shown here."
    is_stated_by_headline = status.session_judgement.headline.code is SessionFact.ENDED_IN_FLIGHT
    if status.is_flying and status.ground_contact is None and not is_stated_by_headline:
        return "This session ended in flight: land by sight, no alarm comes any more."
    return "This session is over."


def _live_timeline_title(status: SessionStatus) -> str:
    """Returns the heading of events and plots of a live page.

    After a session of several flights it names the flight of the plots, since the headline may be on an earlier one.

    Args:
        status: state of the session now, or at its end.
    """
    if not status.is_over:
        return "What happens, the newest first"
    if status.flight_number > 1:
        return f"What happened; plots of flight {status.flight_number}"
    return "What happened"


def _plots_of_worse_flight(status: SessionStatus, saved_flight: PageLink | None) -> Sentence | None:
    """Returns where the plots of the earlier flight are that the headline of a session's page is about, if it is.

    A session keeps the signals of its latest flight only; its recording has those of all flights.

    Args:
        status: state of the session at its end.
        saved_flight: the page of the recording in the library of a server; None for none.

    Returns:
        The sentence; None if the headline is on the latest flight, or the session goes on.
    """
    verdict = _verdict_of_headline(status)
    if not status.is_over or verdict is None:
        return None
    flight = f"flight {verdict.number}"
    if saved_flight is not None:
        return Sentence(
            f"Plots of {flight} are on the page of the recording.", address=saved_flight.address
        )
    if status.is_recorded:
        return Sentence(f"`mavdem` plots {flight} from the recording.")
    return Sentence(f"Nothing was recorded, so that there are no plots of {flight}.")


def _sentences_on_next_step(next_step: Sentence) -> list[Sentence]:
    """Returns the next step of a live page in two sentences: what to do, which is set large, and what follows it.

    What follows are the details after the first colon, such as what to check, and the further sentences.

    Args:
        next_step: what to do, in one sentence or several, the most important first.

    Returns:
        One sentence, or two if something follows.
    """
    first_step, further_steps = first_and_further_sentences(next_step.text)
    what_to_do, _, details = first_step.partition(": ")
    sentences = [next_step._replace(text=f"{without_full_stop(what_to_do)}.")]
    what_follows = f"{capitalize_first(details)} {further_steps}".strip()
    if what_follows:
        sentences.append(Sentence(what_follows))
    return sentences


def _position_of_lost_vehicle(status: SessionStatus) -> str:
    """Returns latitude and longitude, degrees, of a vehicle that is lost or whose link is, as in a geo URI (RFC 5870).

    Args:
        status: state of the session now, or at its end.

    Returns:
        The position, such as "47.39774,8.54559"; empty without a loss, or where no position came.
    """
    position = status.last_position
    is_missed = status.link_loss is not None or status.loss is not None
    if position is None or not is_missed:
        return ""
    return f"{position.latitude:.5f},{position.longitude:.5f}"


def _shown_silence(status: SessionStatus) -> float:
    """Returns for how long the time axis of a live page goes on after the last message of a vehicle in flight, s.

    The empty part of the charts shows since when the link has been lost; it ends after ``MAX_SHOWN_SILENCE``. It is 0
    while messages come, and when the session is over.

    Args:
        status: state of the session now, or at its end.
    """
    link_loss = status.link_loss
    if link_loss is None or status.is_over:
        return 0.0
    # The duration is None if it is not known since when.
    silence = link_loss.figures["duration"] or 0.0
    return min(silence, MAX_SHOWN_SILENCE)


def _live_subtitle(status: SessionStatus, link: str) -> str:
    """Returns the text below the title of a live page: the present state of the vehicle and of its link.

    After the session it says instead what the page is about.

    Args:
        status: state of the session now, or at its end.
        link: address of the vehicle's link.
    """
    # Imported here: a page of a log needs nothing of live sessions.
    from mavdem.live import clock
    from mavdem.report.live import vehicle_text

    if status.is_over:
        return f"What was seen live of this flight over {link}."
    # The title has the name of the vehicle already.
    vehicle_state = vehicle_text(status).removeprefix(f"{status.vehicle}, ")
    present_time = time_of_day(clock.unix_time())
    return f"{capitalize_first(vehicle_state)} Link {link}, as of {present_time}."


def _live_chapters(
    axis: str,
    history: LiveHistory,
    status: SessionStatus,
    seconds_by_use: Mapping[TimeUse, float],
    learned: Learned | None,
) -> list[Chapter]:
    """Returns the chapters of a live page: motors, advised gains, predictions and link, and the model.

    Args:
        axis: axis whose model was learned.
        history: events and signals of the live flight on one timeline.
        status: state of the session now, or at its end.
        seconds_by_use: seconds of the flight by what they were used for, such as learning.
        learned: the latest model; None if there is none, and then there are no chapters on motors and model.
    """
    # Imported here: a page of a log needs nothing of live sessions.
    from mavdem.report.live import live_report

    chapters = []
    if learned is not None:
        chapters.append(Chapter("Motors", motor_blocks(learned, None)))
    # Gains are set on the ground, so that a vehicle in flight has no advice on them.
    if status.is_over or not status.is_flying:
        gain_blocks = _blocks_on_advised_gains(history)
        if gain_blocks:
            chapters.append(Chapter(GAINS_TITLE, gain_blocks))
    seconds_of_training_data = 0.0
    if learned is not None:
        seconds_of_training_data = len(learned.record) * learned.dt
    report = live_report(history, status, seconds_by_use, axis, seconds_of_training_data)
    title = f"Prediction of {axis}, and the link"
    chapters.append(Chapter(title, report, folded=True))
    if learned is not None:
        # The session may not have graded its latest model yet.
        findings = status.findings or model_findings(learned, alarms=status.motor_alarms_of_flight)
        blocks = [*purpose_tables(findings), *torque_blocks(learned)]
        chapters.append(Chapter(f"Model of {axis}", blocks))
    return chapters


def _events_on_gains(history: LiveHistory) -> list[Event]:
    """Returns the events of the latest flight of a session that advise gains, or say why there is no such advice.

    Args:
        history: the events of the whole session, and the latest flight; the times of both are on one clock.
    """
    events: list[Event] = []
    for event in history.events:
        is_about_gains = isinstance(event.fact.code, GainFact | LoopAction)
        # Such an event says only that gains are being computed, which is over when the page is written.
        says_that_gains_are_computed = event.fact.code is GainFact.ADVICE_AWAITED
        is_of_latest_flight = event.seconds >= history.flight.start
        if is_about_gains and is_of_latest_flight and not says_that_gains_are_computed:
            # What comes later ends a postponement, which would contradict it.
            events = [
                earlier for earlier in events if earlier.fact.code is not GainFact.ADVICE_WAITS
            ]
            events.append(event)
    return events


def _blocks_on_advised_gains(history: LiveHistory) -> Blocks:
    """Returns the advice on gains after the latest flight of a session: tables of the gains, and sentences on them.

    Args:
        history: the latest flight, and the events of the whole session; the times of both are on one clock.

    Returns:
        A table of the gains to set, and one of those that were tried and that another flight is to confirm; what to
        expect of them, by axis; and why other axes get no gains. Empty without advice.
    """
    rows_to_set: list[list[str]] = []
    rows_tried: list[list[str]] = []
    sentences: list[Sentence] = []
    for event in _events_on_gains(history):
        fact = event.fact
        if fact.code is not GainFact.GAINS_ADVISED:
            sentences.append(Sentence(event.sentence))
            continue
        # Gains that are not sound yet were only tried: another flight is to confirm them.
        is_sound = fact.figures["reason"].figures["is_sound"]
        rows = rows_to_set if is_sound else rows_tried
        # The changes also list the gains of the axis that stay as they are.
        for name, present_value, new_value in fact.figures["changes"]:
            if new_value != present_value:
                rows.append(gain_row(name, Gain(now=present_value, set=new_value)))
        sentences += render_section("live_gains", axis=fact.subject, **fact.figures)
    tables = []
    for header, rows in (("set", rows_to_set), (TRIED_HEADER, rows_tried)):
        if rows:
            tables.append(Table(["gain", "now", header, "times"], rows))
    return [*tables, *sentences]


def _numbered_live_events(
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
    from mavdem.live.session_status import cause_of_alarm

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


def _live_map_wind(status: SessionStatus) -> MapWind | None:
    """Returns the wind that the map of a live page shows: the present one, or else the mean of the flight.

    After a landing the mean is taken from the status light on wind (its judgement), which then may be that of the whole
    recording. So the map and the light have the same mean.

    Args:
        status: state of the session.

    Returns:
        Direction and speed interval of the wind, without the interval if the speed is not identifiable; None if the
        direction is not known.
    """
    if status.present_wind is not None:
        return _map_wind_of_estimate(status.present_wind, "wind now")
    name = "mean wind"
    light = status.overall_judgement.lights[Light.WIND]
    is_direction_in_light = (
        light.code is WindLight.WIND_BLEW and light.figures["direction"] is not None
    )
    if is_direction_in_light and not status.is_flying:
        speed_interval = (light.figures["low"], light.figures["high"])
        return MapWind(light.figures["direction"], speed_interval=speed_interval, name=name)
    if status.mean_wind is None:
        return None
    return _map_wind_of_estimate(status.mean_wind, name)


def _map_wind_of_estimate(estimate: WindEstimate, name: str) -> MapWind | None:
    """Returns the wind that a map shows for an estimate of a live session.

    Args:
        estimate: the estimate, with one or two facts (coded findings): the first one is on its speed; a second one, if
            there is any, on its direction.
        name: what the map calls it, such as "wind now".

    Returns:
        Direction and speed interval, without the interval if the speed is not identifiable; None if the direction is
        not known.
    """
    speed_fact, *direction_facts = estimate.facts
    if not direction_facts:
        return None
    speed_interval = None
    if speed_fact.figures["status"] is not Status.NOT_IDENTIFIABLE:
        speed_interval = speed_fact.figures["speed_interval"]
    direction = direction_facts[0].figures["direction"]
    return MapWind(direction, speed_interval=speed_interval, name=name)


def _live_anchors(timeline: Timeline | None, chapters: Sequence[Chapter]) -> dict[str, str]:
    """Returns the HTML anchors to which the status lights of a live page link.

    A status light is the judgement of one subject. It links to the part of the page that shows more of the subject.

    Args:
        timeline: charts over time at the top of the page, of motors and wind among others; None without any.
        chapters: chapters of the page, which may have one on advised gains.

    Returns:
        Anchors by the name of the light; a light without a link is left out.
    """
    anchors = {}
    if timeline is not None:
        anchor_of_charts = "flight"
        anchors[str(Light.MOTORS)] = anchor_of_charts
        anchors[str(Light.WIND)] = anchor_of_charts
    for chapter in chapters:
        if chapter.title == GAINS_TITLE:
            # The gains are advised for the sake of the stability margins.
            anchors[str(Light.MARGINS)] = chapter.anchor
    return anchors
