"""The HTML page of a flight: headline, status lights and other facts (coded findings), then chapters of charts."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from mavdem.assessment import Assessment
from mavdem.assessment.axis.lowered_gains import lowered_gains
from mavdem.assessment.identity import day_in_file_name
from mavdem.assessment.last_position import last_position_of_loss
from mavdem.containers import JsonValues
from mavdem.facts import Fact
from mavdem.facts.margins import MarginsLight
from mavdem.loops.advice import AdviceByAxis
from mavdem.report.blocks import Sentence, headline_sentence
from mavdem.report.charts.chart import MAX_POINTS, MAX_POINTS_OF_SMALL_PAGE
from mavdem.report.charts.flown_path import MapWind, flown_path
from mavdem.report.charts.timeline import Timeline, assessment_timeline
from mavdem.report.condition import log_blocks
from mavdem.report.gain_changes import GainChanges, gain_changes, gains_in_tables, loading_sentences
from mavdem.report.heading import heading_of
from mavdem.report.lights import lights_with_reason_once
from mavdem.report.pages.chapter_of_light import (
    LOG_TITLE,
    anchors_of_lights,
    title_of_headline,
    unfold_chapters_of_warnings,
)
from mavdem.report.pages.event_list import (
    labels_in_charts,
    numbered_events,
    with_messages_around_loss,
    with_utc_of_bad_events,
)
from mavdem.report.pages.flight_chapters import flight_chapters, model_chapters
from mavdem.report.pages.message_chapter import messages_chapter
from mavdem.report.pages.page import Chapter, Head, PageEvent, Provenance, render_document
from mavdem.report.pages.page_link import PageLink
from mavdem.report.review import review_title
from mavdem.report.screen import flight_sentences, judgement_sentences
from mavdem.report.templates import (
    Medium,
    capitalize_first,
    headline,
    render_section,
    sentences_for,
)
from mavdem.report.tuning.repairs import needs_check_before_gains
from mavdem.report.why import headline_evidence, joined_sentences, margin_sentences


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
            timeline = timeline._replace(event_labels=labels_in_charts(events, timeline))
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
        oscillates=assessment.judgement.headline.code is MarginsLight.OSCILLATES,
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
    events = numbered_events(
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
        light_anchors=anchors_of_lights(chapters, assessment.lights),
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
    chapters = [*flight_chapters(name, assessment, timeline, advice, is_full=is_full)]
    chapters += model_chapters(assessment)
    if assessment.evidence is not None:
        telemetry = assessment.evidence.signals.telemetry
        charts_boot = None if timeline is None else timeline.boot
        chapters.append(messages_chapter(telemetry, charts_boot))
    if contents is not None:
        chapters.append(Chapter(LOG_TITLE, log_blocks(contents), folded=True))
    return _unfold_needed_chapters(chapters, assessment)


def _unfold_needed_chapters(chapters: Sequence[Chapter], assessment: Assessment) -> list[Chapter]:
    """Returns the chapters of a page with those unfolded that its reader needs first.

    These are the chapters that explain warnings. The chapter that explains the headline is marked. Folded chapters are
    missing on paper.

    Args:
        chapters: all chapters of the page.
        assessment: all results on a vehicle of the log, with its headline, status lights and next step.
    """
    unfolded_chapters = []
    headline_title = title_of_headline(assessment.headline, assessment.lights)
    for chapter in unfold_chapters_of_warnings(chapters, assessment.lights, assessment.headline):
        unfolded_chapters.append(chapter._replace(is_of_headline=chapter.title == headline_title))
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
