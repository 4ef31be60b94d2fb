"""HTML pages as single files that can be mailed, printed and read without a network; notebooks get parts of them.

A page has a title, the result in sentences and tables, and then chapters with charts. The templates are the HTML files
of ``mavdem/report``; charts are drawn by uPlot (MIT), which a page contains with ``charts.js``.
"""

import hashlib
import re
from collections.abc import Mapping, Sequence
from datetime import UTC, date, datetime
from itertools import chain
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple, Self

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment.axis import LogAnalysis
from mavdem.dataset.intervals import TimeInterval
from mavdem.dem import Learned
from mavdem.facts import Fact, Level, NamedFacts
from mavdem.facts.ending import Ending
from mavdem.facts.event import Event
from mavdem.facts.session import SessionFact
from mavdem.flight import Flight
from mavdem.report.blocks import Block, Rated, Sentence, Table, shortened
from mavdem.report.brief_events import StatedEvents, count_text, short_list
from mavdem.report.charts.chart import MAX_POINTS, Chart, Group, Plan
from mavdem.report.charts.timeline import Timeline
from mavdem.report.gain_changes import GainChanges, ParameterDownload
from mavdem.report.gain_overview import GainOverview
from mavdem.report.lights import earlier_lights
from mavdem.report.notch_trial import NotchTrial
from mavdem.report.numbers import display_unit, name_with_unit, rounded
from mavdem.report.pages.environment import environment, render_page
from mavdem.report.pages.page_link import PageLink
from mavdem.report.screen import flight_title, model_screen
from mavdem.report.templates import (
    first_clause,
    first_sentence,
    headline,
    period,
    without_full_stop,
)
from mavdem.report.why import evidence_text, new_evidence_text

MAX_FAULT_LENGTH = 125
"""Longest summary of an earlier flight's fault, characters: three lines of a telephone, with what failed first."""

MAX_PRINTED_ROWS = 40
"""Rows of a long table without any warning that paper has all the same: a choice, less than a sheet."""

MAX_NEWEST_EVENTS = 4
"""Events that the page of a session that goes on shows at first: a choice, so that a telephone shows the plots soon."""

_WORD = re.compile("[a-z0-9]+")
"""A word of a title in lower case."""


class Section(NamedTuple):
    """A part of a chapter that shows its title, mostly a level and one sentence, and the rest when it is opened."""

    title: str
    """Heading."""

    fact: Fact | None = None
    """What it says; a level that is unknown is not shown, since nothing was judged. None for further charts of what the
    chapter shows above; they are closed."""

    groups: Sequence[Group] = ()
    """Groups of charts."""

    blocks: Sequence[Block] = ()
    """Sentences and tables."""


class Chapter(NamedTuple):
    """A part of a page after its result, with sentences, tables and charts."""

    title: str
    """Heading."""

    blocks: Sequence[Block] = ()
    """Sentences and tables."""

    groups: Sequence[Group] = ()
    """Groups of charts, which stand before the blocks."""

    folded: bool = False
    """Whether only the title is shown until it is opened."""

    is_closed_on_phone: bool = False
    """Whether that holds on a phone alone."""

    is_side_by_side: bool = False
    """Whether charts and blocks stand beside each other where there is room."""

    level: Level | None = None
    """Level of what it is about, which is shown beside its title; None without."""

    is_of_headline: bool = False
    """Whether it is about what the headline of the page states, so that paper has it before all other chapters."""

    level_scope: str = ""
    """What of the flight the level is about, where that is not all of it."""

    searchable: Table | None = None
    """A long table above the rest, with a field to search its rows; None without.

    If it is printed, paper has only its rows with a rated cell, such as warnings; without any, all rows if they are at
    most ``MAX_PRINTED_ROWS``. A row whose first cell is a :class:`Moment` moves the plots there.
    """

    notch_trial: NotchTrial | None = None
    """A notch filter whose settings a reader tries, which is not printed; None without."""

    downloads: Sequence[ParameterDownload] = ()
    """Parameter files to download, below the rest."""

    sections: Sequence[Section] = ()
    """Parts below the rest, which are open where their facts are to be watched or bad."""

    @property
    def anchor(self) -> str:
        """Name by which links within the page lead to it: its title in lower case, with hyphens between the words."""
        return anchor_of(self.title)

    @property
    def printed_rows(self) -> Sequence[Sequence[str]]:
        """The rows of the long table ``searchable`` that are printed, each a list of cell texts; empty without a table.

        Paper cannot be searched, and hundreds of rows would fill many sheets. So only rows with a warning are printed.
        A table without any warning is printed whole if it has at most ``MAX_PRINTED_ROWS`` rows.
        """
        table = self.searchable
        if table is None or not table.is_printed:
            return ()
        rows_with_warning = []
        for row in table.rows:
            # A cell with a warning is a ``Rated`` text, which has the colour of its level.
            if any(isinstance(cell, Rated) for cell in row):
                rows_with_warning.append(row)
        if not rows_with_warning and len(table.rows) <= MAX_PRINTED_ROWS:
            return table.rows
        return rows_with_warning

    @property
    def has_charts(self) -> bool:
        """Whether it has anything that the script for charts draws."""
        return bool(self.groups or self.notch_trial)

    @property
    def has_time_charts(self) -> bool:
        """Whether it has charts over time, which a user can zoom."""
        for group in self.groups:
            for column in group.columns:
                if any(isinstance(panel, Chart) and panel.x.is_time for panel in column):
                    return True
        return False

    @property
    def has_content(self) -> bool:
        """Whether it has anything besides its title."""
        return bool(self.has_charts or self.blocks or self.searchable or self.sections)


def anchor_of(title: str) -> str:
    """Returns the name by which links within a page lead to the part with this title."""
    return "-".join(_WORD.findall(title.lower()))


class PageEvent(NamedTuple):
    """An event as a page lists it."""

    event: Event
    """The event."""

    number: int | None = None
    """Its number in the list and in the charts; None where it has none."""

    is_on_clock_of_charts: bool = True
    """Whether its time is on the clock of the charts, to which it then links: an event of another boot's is not."""

    is_headline: bool = False
    """Whether the headline of the page states it."""

    is_cause_of_headline: bool = False
    """Whether it is what failed first by the headline, or the autopilot's report of that."""

    is_light: bool = False
    """Whether a status light of the page states it."""

    is_over: bool = False
    """Whether it is an alarm of a live session that does not last any more."""

    is_advice_current: bool = True
    """Whether what to do about it is still to be done: no longer of a silence of a live link that has ended."""

    texts_shown_before: frozenset[str] = frozenset()
    """What the page shows before this event of what to do and of what sensors measured, which it does not repeat."""

    total: int = 1
    """Number of events of its kind for which it stands in a short list."""

    moment: str = ""
    """When it was reported in a live session; empty in a log, where its time is that of the charts."""

    messages: Sequence[str] = ()
    """What the autopilot sent around the loss of a flight, each text with its time; empty for other events."""

    utc: datetime | None = None
    """When a bad event of a log was in UTC, by which it is found in other records; None of others, and if not known."""

    @property
    def finding(self) -> Fact:
        """The coded finding that the event reports; for an alarm of a live session, the fault that raised the alarm."""
        fact = self.event.fact
        if fact.code is SessionFact.ALARM:
            fault: Fact = fact.figures["reason"]
            return fault
        return fact

    @property
    def brief(self) -> str:
        """What happened, for a short list of events, in which one event may stand for several of its kind."""
        sentence = self._without_time(self._brief_sentence)
        if self.total == 1:
            return sentence
        return f"{without_full_stop(sentence)}{count_text(self.finding, self.total)}."

    @property
    def _brief_sentence(self) -> str:
        """The sentence of the event, which is shortened if another part of the page states the event in full.

        Such a part is the headline, the sentence about the cause of the headline, or a status light (the judgement of
        one part of the vehicle).
        """
        # The first clause of the judgement of a whole flight is only the number of the flight.
        is_judgement_of_flight = self.finding.code is SessionFact.FLIGHT_VERDICT
        if (self.is_headline or self.is_light) and not is_judgement_of_flight:
            return first_clause(str(self.finding))
        if self.is_headline or self.is_cause_of_headline:
            return headline(self.finding)
        return str(self.event.fact)

    @property
    def sentence(self) -> str:
        """What happened, then what to do about it unless the page shows that before, or it is no longer to be done."""
        is_remedy_repeated = self.event.fact.remedy in self.texts_shown_before
        if is_remedy_repeated or not self.is_advice_current:
            return self._without_time(str(self.event.fact))
        return self._without_time(self.event.sentence)

    def _without_time(self, sentence: str) -> str:
        """Removes the event's time from a sentence: "Motor 2 failed at 114.1 s." becomes "Motor 2 failed.".

        The page of a log has this time in a column of its own. A live page has the time of day there, so that the
        sentence stays as it is. It stays too if the time of the event is not known.

        Args:
            sentence: sentence about the event.
        """
        is_on_live_page = bool(self.moment)
        if is_on_live_page or not self.has_time:
            return sentence
        # The sentence has it as " at 114.1 s", for example.
        time_in_sentence = re.escape(period(self.seconds))
        # A time within a list of times, such as " at 3.2 s and 4.0 s", stays.
        return re.sub(f"{time_in_sentence}(?=[,.:;])", "", sentence, count=1)

    @property
    def why(self) -> str:
        """What sensors measured that confirms the event; empty without any, or if the page shows it before."""
        return new_evidence_text(self.event.fact, self.texts_shown_before)

    @property
    def seconds(self) -> float:
        """When it was, s on the clock of the charts; NaN where that is not known."""
        return self.event.seconds

    @property
    def has_time(self) -> bool:
        """Whether its time is known."""
        return self.event.has_time

    @property
    def boot(self) -> int | None:
        """The boot of the autopilot, from 0, on whose clock its time is; None if that is not known."""
        boot = self.event.fact.figures.get("boot")
        if boot is None:
            return None
        return int(boot)


SECONDS_BEFORE_LOSS = 15.0
"""Time before the loss of a flight, s, with which its plots open; a choice: a motor that fails works harder for some
seconds before."""

SECONDS_AFTER_LOSS = 5.0
"""Time after the loss of a flight, s, with which its plots open; a choice: a fall takes some seconds."""


class Provenance(NamedTuple):
    """From which file a page was made, and when, for those who file it away or check it later."""

    digest: str
    """SHA-256 of the log as hexadecimal digits; empty if the log is not one file that can still be read."""

    day: date
    """Day on which the page was written, UTC."""

    @classmethod
    def of_log(cls, path: Path) -> Self:
        """Returns the provenance of a page that is written today: the digest of its log, and the present day in UTC.

        Args:
            path: the file of the log. The digest is empty if there is no such file, as for a folder.
        """
        digest = ""
        if path.is_file():
            with path.open("rb") as file:
                digest = hashlib.file_digest(file, "sha256").hexdigest()
        return cls(digest, datetime.now(UTC).date())


class Head(NamedTuple):
    """The top of a flight's page: level of the headline, status lights, events, and charts over time."""

    level: Level
    """Level of the headline, by which the page colours it."""

    lights: NamedFacts
    """The lights by name."""

    events: Sequence[PageEvent] = ()
    """What happened, in order of time."""

    timeline: Timeline | None = None
    """Charts over the flight's time; None without any."""

    analysis: LogAnalysis | None = None
    """Analysis whose vehicle, date and duration are shown; None where the log holds no flight, or of a live one."""

    light_figures: Mapping[str, str] = MappingProxyType({})
    """What each light shows in a few words, such as "motor 3: −19 to −41 %"; empty for a light without a figure. On a
    live page it stands in the place of the sentence that the headline has already, on a phone in that of any."""

    light_anchors: Mapping[str, str] = MappingProxyType({})
    """Name of the part of the page on each light, by the light; a light without a part is left out."""

    provenance: Provenance | None = None
    """From which log the page was made, and when; None where the page does not say that."""

    timeline_title: str = "What happened"
    """Heading of the charts over time and of the events."""

    path: Plan | None = None
    """Map of the flown path, which follows the cursor of the charts; None without a position."""

    changes: GainChanges | None = None
    """Gains to set before the next flight; None if none change."""

    gains: GainOverview | None = None
    """All gains with their present and new values, right below the headline, in the place of the table of ``changes``;
    None without."""

    blocks_beside_gains: Sequence[Block] = ()
    """Sentences and tables below the table of ``gains`` or, if none of them is to be loaded now, above it."""

    has_log: bool = True
    """Whether the page is of a log, any field of which can be plotted where the log is; not of a live session."""

    is_newest_first: bool = False
    """Whether the events are those of a session that goes on, the newest first."""

    is_in_flight: bool = False
    """Whether the vehicle of that session flies."""

    flight_number: int = 0
    """Number of the flight in that session, from 1, that the plots show; 0 before the first one, and of a log."""

    alarm: str = ""
    """The alarm of that vehicle in a few words, with which the page's title begins; empty without one."""

    alarm_count: int = 0
    """Number of alarms of that session so far: a page that is open sounds when it grows."""

    refresh_seconds: float | None = None
    """Time after which a browser without JavaScript loads the page of that session again, s; with it, the page takes
    over what is new by itself. None for a page that does not change."""

    links: Sequence[PageLink] = ()
    """Other pages at the top, such as that of the flight before."""

    saved_flight: PageLink | None = None
    """The page of a live flight in the library, once it is over; None without one."""

    is_lost_in_air: bool = False
    """Whether the link of that vehicle was lost in the air, so that its flight may go on."""

    is_link_lost: bool = False
    """Whether its messages have ended in flight, so that where it was seen last comes before its lights."""

    reasons: Sequence[Block] = ()
    """What shows the headline of a live session, below its lights: what to do and the lights are read before it."""

    are_lights_of_recording: bool = False
    """Whether the lights of a live session are those of its recording, which was judged as a whole after the flight."""

    fault_in_full: str = ""
    """What the headline and the text below it state in two parts, as one sentence: of a log always, of a live session
    the fault that has reasons; else empty. A light that states the same refers to the headline."""

    unrepaired_fault: str = ""
    """The fault of an earlier flight of that session that may not have been repaired, and what to do about it; empty
    without one, and if the headline states it."""

    page_of_earlier_fault: str = ""
    """Address of that earlier flight's page on the server, which can store that the fault was repaired; empty if no
    page is there, or nobody can ask for that any more."""

    level_of_earlier_fault: Level = Level.WATCH
    """Level of that fault: bad if it forbids to fly."""

    statement_of_repair: str = ""
    """What a user states with the button that ends the warning of that fault: which motor was repaired after which
    flight; empty without such a fault."""

    vehicle_state: Sequence[Sentence] = ()
    """Mode, height, battery, satellites and link of that vehicle, each a value and a remark, which a telephone always
    shows."""

    session_end: str = ""
    """That the session is over, and whether it ended in flight; empty while it or its successor goes on, and for a
    flight in a library."""

    files_of_session: Sequence[str] = ()
    """Sentences on the files that a session has written and how they are opened, once it is over."""

    last_position: str = ""
    """Latitude and longitude of that vehicle, degrees, for a link that opens a map; empty where they are not known."""

    day_in_name: date | None = None
    """Day in the name of the log's file, which is shown where the log has no date; None without one."""

    @property
    def unrepaired_fault_in_short(self) -> str:
        """That fault of an earlier flight in up to three lines of a telephone, without what to do about it."""
        return shortened(first_sentence(self.unrepaired_fault), MAX_FAULT_LENGTH)

    @property
    def opening_span(self) -> TimeInterval | None:
        """Time range, s, that the plots of a lost flight show at first: some seconds around the loss.

        On the range of the whole flight, the tumble of a second would hide the motion before it. The range begins
        ``SECONDS_BEFORE_LOSS`` before the loss, and ends ``SECONDS_AFTER_LOSS`` after it, within the record. It is None
        for a flight that was not lost, for a live session, and for a loss in another boot than the charts show.
        """
        if self.timeline is None or not self.has_log:
            return None
        start, end = self.timeline.span
        for page_event in self.events:
            is_loss = page_event.event.fact.code in Ending
            is_in_charts = page_event.has_time and page_event.is_on_clock_of_charts
            if is_loss and is_in_charts:
                first_time = page_event.seconds - SECONDS_BEFORE_LOSS
                last_time = page_event.seconds + SECONDS_AFTER_LOSS
                return (max(start, first_time), min(end, last_time))
        return None

    @property
    def whole_flight(self) -> Group | None:
        """Small plots of the whole flight, for the printed page of a lost flight; None for other pages.

        The large plots of such a page show only some seconds around the loss (``opening_span``), and paper cannot be
        zoomed. The small ones are those over the whole flight that matter most, mostly roll, pitch, height and motors,
        in which these seconds are grey. None also if the large plots show the whole flight, or nothing can be plotted.
        """
        if self.timeline is None or self.opening_span is None:
            return None
        if self.opening_span == self.timeline.span:
            return None
        return self.timeline.whole_flight_group(self.opening_span)

    @property
    def further_plots(self) -> str:
        """Heading of the plots that are folded below the first ones, such as "motors minus their mean, battery".

        It names what each of them shows; empty without plots.
        """
        if self.timeline is None:
            return ""
        names: list[str] = []
        _first_group, *further_groups = self.timeline.overview_groups
        columns = chain.from_iterable(group.columns for group in further_groups)
        for panel in chain.from_iterable(columns):
            name = panel.title[0].lower() + panel.title[1:]
            # Speed and direction of the wind are one subject: "wind from NE" begins with "wind".
            is_subject_named = any(name.startswith(earlier_name) for earlier_name in names)
            if not is_subject_named:
                names.append(name)
        return ", ".join(names)

    @property
    def earlier_lights(self) -> dict[str, str]:
        """The name of the earlier light, by the name of each light that warns of the same."""
        return earlier_lights(self.lights)

    @property
    def brief_events(self) -> Sequence[PageEvent]:
        """The short list of events, which a page shows until its reader unfolds the list of all.

        - Of a live session that goes on, it has all events, in their order: the newest first.
        - Of a flight that is over, it has the take-off, the changes of the flight mode, the landing and the worst
          events (:func:`mavdem.report.brief_events.short_list`). Of events of the same kind it has one, with their
          number as ``total``.

        Events on the state of the session itself, such as its learning, are left out of both.
        """
        events_of_flight = [shown for shown in self.events if not shown.event.is_session_state]
        if self.is_newest_first:
            return events_of_flight
        findings = [page_event.finding for page_event in events_of_flight]
        brief_events = []
        for index, total in short_list(findings, _events_stated_elsewhere(events_of_flight)):
            brief_events.append(events_of_flight[index]._replace(total=total))
        return brief_events

    @property
    def newest_events(self) -> Sequence[PageEvent]:
        """The events that the page of a live session shows before its reader asks for all: the newest, newest first.

        The newest alarm that is numbered in the plots and the first report of the headline follow the
        ``MAX_NEWEST_EVENTS`` newest events if they are older: the plots mark only events that the page shows. On the
        ground so does the report of the landing, which says what the flight has shown.
        """
        events = self.brief_events
        numbered_alarms = [
            shown for shown in events if shown.event.is_alarm and shown.number is not None
        ]
        older_events = (
            *self._report_of_landing,
            *numbered_alarms[:1],
            *self._first_report_of_headline,
        )
        newest_events = list(events[:MAX_NEWEST_EVENTS])
        for older_event in older_events:
            if older_event not in newest_events:
                newest_events.append(older_event)
        return newest_events

    @property
    def _report_of_landing(self) -> Sequence[PageEvent]:
        """The event that was reported at the landing, with what the flight has shown: a sequence of one, or empty.

        It is empty in flight, since all such events are then of earlier flights.
        """
        if self.is_in_flight:
            return []
        reports = [
            shown
            for shown in self.brief_events
            if shown.event.fact.code is SessionFact.FLIGHT_LEARNED
        ]
        # The events are the newest first.
        return reports[:1]

    @property
    def _first_report_of_headline(self) -> Sequence[PageEvent]:
        """The event that first reported what the headline of a live session states; a sequence of one, or empty.

        Several events may report it: an alarm is repeated, and its end is reported. It is the oldest one that is
        numbered in the plots. If the headline is on an earlier flight, which the plots do not show, it is the oldest
        alarm.
        """
        reports = [shown for shown in self.brief_events if shown.is_headline]
        numbered_reports = [shown for shown in reports if shown.number is not None]
        alarms = [shown for shown in reports if shown.event.is_alarm]
        # The events are the newest first.
        return (numbered_reports or alarms)[-1:]

    @property
    def earlier_events(self) -> Sequence[PageEvent]:
        """The events that the page of a live session shows once its reader unfolds them, the newest first.

        These are all ``brief_events`` that are not among its ``newest_events``.
        """
        newest_events = self.newest_events
        return [shown for shown in self.brief_events if shown not in newest_events]

    @property
    def newest_alarm(self) -> PageEvent | None:
        """The newest alarm of a live flight that is still active, which the page shows above its events.

        None if there is no such alarm, if the headline states it already, on the ground, and on the page of a log.
        """
        if not self.is_in_flight:
            return None
        # The events of a live flight are the newest first.
        for page_event in self.events:
            is_active_alarm = page_event.event.is_alarm and not page_event.is_over
            if is_active_alarm:
                return None if page_event.is_headline else page_event
        return None

    @property
    def session_events(self) -> Sequence[PageEvent]:
        """The events on the own state of a session that goes on, such as its learning; none of a log."""
        if not self.is_newest_first:
            return ()
        return [shown for shown in self.events if shown.event.is_session_state]

    @property
    def has_more_of_events(self) -> bool:
        """Whether the full list of events says more than the short one: more events, advice, or measured evidence."""
        if len(self.brief_events) < len(self.events):
            return True
        # The short list leaves out what to do about an event, and what sensors measured of it.
        facts = [page_event.event.fact for page_event in self.events]
        return any(fact.remedy or evidence_text(fact) for fact in facts)


def _events_stated_elsewhere(page_events: Sequence[PageEvent]) -> StatedEvents:
    """Returns which events of a page its headline or its status lights state, by their indices in the list.

    Args:
        page_events: events in order of time, each marked by what states it.
    """
    headline_index = None
    cause_indices = []
    light_indices = []
    for index, page_event in enumerate(page_events):
        # A live session may repeat an alarm. Its first report is then the event of the headline.
        if page_event.is_headline and headline_index is None:
            headline_index = index
        if page_event.is_cause_of_headline:
            cause_indices.append(index)
        if page_event.is_light:
            light_indices.append(index)
    return StatedEvents(headline_index, cause_indices, light_indices)


class KeyEntry(NamedTuple):
    """What a colour stands for in all charts of a page."""

    colour: str
    """Colour from ``mavdem.report.palette``."""

    name: str
    """Name in the legends of charts."""

    description: str
    """What it is."""

    address: str = ""
    """Address of its own page; empty where there is none."""


class ResultPicture(NamedTuple):
    """A picture among the sentences of a page's result."""

    group: Group
    """The charts."""

    position: int
    """Number of blocks of the result that stand above it."""


def render_document(
    title: str,
    subtitle: str,
    blocks: Sequence[Block],
    chapters: Sequence[Chapter] = (),
    back: PageLink | None = None,
    head: Head | None = None,
    max_points: int = MAX_POINTS,
    key: Sequence[KeyEntry] = (),
    picture: ResultPicture | None = None,
) -> str:
    """Renders a page as HTML, with all text escaped.

    The same arguments give the same bytes under the same versions of mavdem and Python.

    Args:
        title: heading of the page.
        subtitle: line below it; empty for none.
        blocks: the result, in sentences and tables.
        chapters: chapters below the result; those without content are left out.
        back: link to the page that leads here; None for no link.
        head: top part of a flight's page; None for other pages.
        max_points: largest number of points of a line in a chart.
        key: what colours stand for in all charts, which is shown below the title.
        picture: the picture in the result, which shows what its heading states; None without one.

    Returns:
        The page as HTML.
    """
    chapters_with_content = [chapter for chapter in chapters if chapter.has_content]
    # The head of a flight's page has charts over time.
    has_charts = any(chapter.has_charts for chapter in chapters_with_content)
    has_charts = has_charts or head is not None or picture is not None
    chapters_over_time = [chapter for chapter in chapters_with_content if chapter.has_time_charts]
    # Open chapters are read first.
    chapters_over_time.sort(key=lambda chapter: chapter.folded)
    return render_page(
        environment().get_template("document.html"),
        title=title,
        subtitle=subtitle,
        blocks=blocks,
        chapters=chapters_with_content,
        back=back,
        head=head,
        points=max_points,
        has_charts=has_charts,
        chapter_of_hint=chapters_over_time[0].anchor if chapters_over_time else "",
        key=key,
        picture=picture,
    )


def page_update(page: str) -> str:
    """Returns what an open page needs to show a newer version of itself: the title and the main part of the new page.

    The open page has the style and the scripts already. Its script ``live.js`` takes over what is new.

    Args:
        page: HTML of the new page, as ``render_document`` returns it.

    Returns:
        A short HTML document with both parts.
    """
    title = page[page.index("<title>") : page.index("</title>")]
    # All text of the page is escaped, so that each of these tags is there only once.
    main = page[page.index("<main") : page.index("</main>")]
    return f"<!doctype html>\n{title}</title>\n{main}</main>\n"


def notebook_html(blocks: Sequence[Block]) -> str:
    """Renders sentences and tables as HTML for a notebook, with all text escaped."""
    macros = environment().get_template("blocks.html").module
    html = macros.shown(blocks)  # type: ignore[attr-defined]
    return f"<div><style>.words {{ text-align: left; }}</style>{html}</div>"


def flight_html(flight: Flight) -> str:
    """Renders a flight for a notebook: its title, and a table with a row for each input and output.

    The columns are mean, standard deviation, minimum and maximum; angles are in degrees.

    Args:
        flight: uniformly sampled inputs and outputs of one segment of flight.

    Returns:
        HTML without scripts.
    """
    names = flight.input_names + flight.output_names
    units = flight.input_units + flight.output_units
    samples = np.hstack([flight.inputs, flight.outputs])
    rows = []
    for name, unit, values in zip(names, units, samples.T, strict=True):
        rows.append(_channel_row(name, unit, values))
    table = Table(["channel", "mean", "sd", "lowest", "highest"], rows)
    return notebook_html([flight_title([flight]), table])


def _channel_row(name: str, unit: str, values: Array) -> list[str]:
    """Returns the row of an input or output in a table of a flight: its name with the unit, and four statistics.

    Args:
        name: name of the input or output.
        unit: its unit; angles in radians are shown in degrees.
        values: (T,) its samples.

    Returns:
        Five cells: the name, and then mean, standard deviation, minimum and maximum of the samples.
    """
    shown_unit = display_unit(unit)
    row = [name_with_unit(name, shown_unit.name)]
    for figure in (values.mean(), values.std(), values.min(), values.max()):
        row.append(rounded(shown_unit.scale * figure, 3))
    return row


def learned_html(learned: Learned) -> str:
    """Renders a model for a notebook: its size, and the report of the model alone."""
    record = learned.record
    size = f"{len(learned.model.A)} states, from {len(record) * record.dt:.0f} s at {1 / record.dt:.0f} Hz."
    return notebook_html([Sentence(size, "Learned model:"), *model_screen(learned)])
