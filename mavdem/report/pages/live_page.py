"""The HTML page of a live session: its state, the events so far, and charts of the last seconds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from mavdem.assessment.axis.findings import model_findings
from mavdem.dem import Learned
from mavdem.facts import Level
from mavdem.facts.event import Event
from mavdem.facts.identifiability import Status
from mavdem.facts.lights import Light
from mavdem.facts.loops import GainFact, LoopAction
from mavdem.facts.session import SessionFact, TimeUse
from mavdem.facts.wind import WindLight
from mavdem.fleet.names import NO_NAMES, GivenNames
from mavdem.loops.advice import Gain
from mavdem.report.blocks import Blocks, Sentence, Table, headline_sentence
from mavdem.report.charts.chart import MAX_POINTS, MAX_POINTS_OF_SMALL_PAGE
from mavdem.report.charts.flown_path import MapWind, flown_path
from mavdem.report.charts.timeline import Timeline, live_timeline
from mavdem.report.lights import lights_with_reason_once
from mavdem.report.pages.live_event_list import numbered_live_events, time_of_last_event
from mavdem.report.pages.live_headline import (
    are_lights_of_recording,
    headline_by_session,
    judgement_of_headline,
    level_of_earlier_fault,
    next_step_with_link,
    page_of_earlier_fault,
    reasons_of_headline,
    statement_of_earlier_repair,
    verdict_of_headline,
    without_place_in_headline,
)
from mavdem.report.pages.page import Chapter, Head, PageEvent, render_document
from mavdem.report.pages.page_link import PageLink
from mavdem.report.screen import judgement_sentences, motor_blocks, purpose_tables, torque_blocks
from mavdem.report.templates import (
    capitalize_first,
    first_and_further_sentences,
    headline,
    render_section,
    time_of_day,
    without_full_stop,
)
from mavdem.report.tuning.gains import gain_row
from mavdem.report.tuning.tables import TRIED_HEADER

if TYPE_CHECKING:
    from mavdem.live.history import LiveHistory
    from mavdem.live.session_status import SessionStatus
    from mavdem.live.wind import WindEstimate

MOTORS_CHART = "Motors"
"""Title of the chart of a live page that stands first: that of the motors, as begins with this word."""

GAINS_TITLE = "Gains"
"""Title of a live page's chapter with the gains that were advised after a landing."""

MAX_SHOWN_SILENCE = 3.0
"""Time for which the time axis of a live page goes on after the last message, s: a choice.

It shows that nothing comes. The plots show 30 s, most of which must be the last ones before the silence.
"""


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

    judgement = replace(status.session_judgement, headline=headline_by_session(status))
    events = numbered_live_events(history, judgement, status.alarms)
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
    end_time = max(end_of_silence, time_of_last_event(events, last_sample_time))
    # The order is the same in every state of every flight, so that the chart that a reader looks at stays in its place.
    timeline = timeline.with_chart_first(MOTORS_CHART)
    return timeline._replace(
        takeoff=status.takeoff_position,
        span=(first_time, end_time),
        events=tuple(events),
        event_labels=tuple(str(page_event.number) for page_event in numbered_events),
    )


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
    from mavdem.live.event_cause import cause_of_alarm
    from mavdem.report.live import (
        brief_light_figures,
        live_alarm,
        unrepaired_fault_beside_next_step,
        vehicle_state_cells,
    )

    judgement = status.session_judgement
    goes_on = not status.is_over
    fault = cause_of_alarm(judgement_of_headline(status).headline)
    # The list of a session that is over states its events in short.
    is_event_listed = goes_on and any(page_event.is_headline for page_event in page_events)
    is_fault_in_headline = fault.sentence in headline(judgement.headline)
    reasons = reasons_of_headline(
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
        are_lights_of_recording=are_lights_of_recording(judgement.lights),
        unrepaired_fault=unrepaired_fault_beside_next_step(status),
        page_of_earlier_fault=page_of_earlier_fault(status),
        level_of_earlier_fault=level_of_earlier_fault(status),
        statement_of_repair=statement_of_earlier_repair(status),
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

    judgement = without_place_in_headline(status.session_judgement)
    sentences = judgement_sentences(judgement)
    heading = sentences.headline
    if not status.is_over:
        heading = headline_sentence(statement_of_headline(heading.lead, judgement.headline))
    summary = [heading]
    if str(judgement.next_step) != str(judgement.headline):
        next_step = next_step_with_link(sentences.next_step, judgement, saved_flight)
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
    verdict = verdict_of_headline(status)
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
