"""The review of a log on one screen: status lights, alarms and next step, as sentences of facts (coded findings)."""

from collections.abc import Iterator
from math import isfinite
from pathlib import Path
from types import MappingProxyType

from mavdem.assessment import Assessment
from mavdem.assessment.assess import FirstFindings
from mavdem.assessment.axis import LogAnalysis
from mavdem.assessment.axis.loop_decision import advises_to_tune
from mavdem.assessment.flown_flights import MAX_FLIGHT_SECONDS, flown_flights
from mavdem.assessment.identity import day_in_file_name
from mavdem.assessment.lights import REGISTRY
from mavdem.assessment.simulation import simulation_fact
from mavdem.dataset.signals import Signals
from mavdem.facts import Fact, Level, NamedFacts
from mavdem.facts.ending import MotionEvent
from mavdem.facts.events import ReportedEvent
from mavdem.facts.lights import Unjudged
from mavdem.ingest import Log
from mavdem.report.blocks import HARD_SPACE, Sentence, shortened, wrapped_lines
from mavdem.report.brief_events import (
    count_text,
    distinct_events,
    is_notable,
    short_list,
    stated_events,
)
from mavdem.report.gain_changes import changes_on_trial, gain_changes
from mavdem.report.lights import earlier_lights, lights_with_reason_once
from mavdem.report.screen import flight_sentences
from mavdem.report.templates import first_clause, headline, render_section, without_full_stop
from mavdem.report.why import headline_evidence

SCREEN_COLUMNS = 80
"""Columns of a terminal that nobody has widened."""

MAX_LINES_OF_GOOD_LIGHT = 2
"""Lines that a light may have with which nothing is wrong, a choice: its limits fit, and what is wrong stands out."""

CLOCK_BEGINS_ANEW = f"{'restart':<20}The autopilot restarted: its clock begins anew."
"""The row between events of two boots, in the columns of the other rows."""

NO_LIGHTS: NamedFacts = MappingProxyType({})
"""Lights by name that are printed above others, where there are none."""

TIME_ORIGIN = "Times are seconds since boot."
"""What the times of a review count from: the autopilot's start, as in the plots of the page."""

LABEL_COLUMNS = 11
"""Columns at the beginning of a line of a light or event, for its name or time."""

LEVEL_COLUMNS = 9
"""Columns after that, for its level."""


def review_screen(assessment: Assessment, columns: int = SCREEN_COLUMNS) -> str:
    """Returns the review of a log as text for one screen of the terminal.

    It has the title, a line for each status light (the judgement of one subject, such as the motors), the few events
    that matter where something is bad, and last, where the user looks after everything has scrolled by, the headline
    and the next step. Long sentences of good lights are shortened to one line, and so are those of events.

    Args:
        assessment: all results on a vehicle of the log: events, status lights, model, loops and wind.
        columns: number of characters in a line.
    """
    title_lines = _title_lines(review_title(assessment), columns)
    lights = lights_with_reason_once(assessment.lights, assessment.headline)
    light_lines = _lines_of_lights(lights, columns, headline_fact=assessment.headline)
    last_lines = _last_lines(assessment, columns)
    return "\n".join([*title_lines, *light_lines, *last_lines])


def first_lines(findings: FirstFindings, columns: int = SCREEN_COLUMNS) -> str:
    """Returns the first lines of a review, which are printed before the control loops are identified.

    To identify the loops takes longest, and the user can read these lines meanwhile: the title, and the status lights
    (the judgement of one subject each, such as the motors) before the first one that needs the loops, since lights have
    the same order everywhere. :func:`further_lines` returns the remaining lines.

    Args:
        findings: findings on the flight so far.
        columns: number of characters in a line.
    """
    evidence = findings.evidence
    title = vehicle_title(evidence.log, evidence.signals, findings.analysis)
    light_lines = _lines_of_lights(_lights_before_loops(findings), columns)
    return "\n".join([*_title_lines(title, columns), *light_lines])


def _lights_before_loops(findings: FirstFindings) -> NamedFacts:
    """Returns the status lights that can be printed before the control loops are identified, in the usual order.

    Printed lines cannot be inserted later. So these are the lights from the beginning of the list of all lights up to
    the first one that is not judged yet, even if later ones are.

    Args:
        findings: findings on the flight so far, with the lights that are judged already.
    """
    judged_lights = lights_with_reason_once(findings.lights)
    first_lights = {}
    for registered_light in REGISTRY:
        name = str(registered_light.name)
        if name not in judged_lights:
            break
        first_lights[name] = judged_lights[name]
    return first_lights


def further_lines(
    assessment: Assessment, findings: FirstFindings, columns: int = SCREEN_COLUMNS
) -> str:
    """Returns the second part of a review on the terminal: remaining lights, events, headline and next step.

    The first part (:func:`first_lines`) is printed before the control loops are identified, which takes longest. A
    status light is the judgement of one subject, such as the motors.

    Args:
        assessment: all results on the flight: events, status lights, model, loops and wind.
        findings: the findings without the loops, whose lights the first part has printed.
        columns: number of characters that a line may have.
    """
    printed_lights = _lights_before_loops(findings)
    remaining_lights = {}
    for name, light in lights_with_reason_once(assessment.lights, assessment.headline).items():
        if name not in printed_lights:
            remaining_lights[name] = light
    light_lines = _lines_of_lights(
        remaining_lights,
        columns,
        lights_before=printed_lights,
        headline_fact=assessment.headline,
    )
    return "\n".join([*light_lines, *_last_lines(assessment, columns)])


def _title_lines(title: Sentence, columns: int) -> list[str]:
    """Returns the lines of a title, one or two, which also say what the times in the lines below count from."""
    return [*wrapped_lines(f"{title.lead} {title.text} {TIME_ORIGIN}", columns)]


def _lines_of_lights(
    lights: NamedFacts,
    columns: int,
    lights_before: NamedFacts = NO_LIGHTS,
    headline_fact: Fact | None = None,
) -> list[str]:
    """Returns the lines of the terminal for some status lights, each the judgement of one part of the vehicle.

    A light that states what the headline below states refers to that ("See the headline."), and one that warns of the
    same as an earlier light to that light ("See motors."), so that no sentence is printed twice.

    Args:
        lights: the lights by name, such as "motors", each a finding with a level and a sentence.
        columns: number of characters that a line may have.
        lights_before: lights that are printed above these.
        headline_fact: the headline that follows; None if it is not known yet.
    """
    repeated_lights = earlier_lights({**lights_before, **lights})
    lines = []
    for name, light in lights.items():
        if headline_fact is not None and headline(light) == headline(headline_fact):
            lines.append(f"{_label_and_level(name, light)}See the headline.")
        elif name in repeated_lights:
            lines.append(f"{_label_and_level(name, light)}See {repeated_lights[name]}.")
        else:
            lines += _lines_of_light(name, light, columns)
    return lines


def _last_lines(assessment: Assessment, columns: int) -> list[str]:
    """Returns the end of a review: the few events that matter, the headline, and the next step.

    Args:
        assessment: all results on the flight: events, status lights, model, loops and wind.
        columns: number of characters in a line.
    """
    lines = list(_event_lines(assessment, columns))
    lines += headline_lines(assessment, columns)
    lines += _evidence_lines(assessment, columns)
    lines += wrapped_lines(f"Next: {assessment.next_step}", columns)
    for sentence in flight_sentences(assessment, has_headline_above=True):
        lines += wrapped_lines(sentence.text, columns)
    return lines


def headline_lines(assessment: Assessment, columns: int = SCREEN_COLUMNS) -> list[str]:
    """Returns the lines of the headline of a review, wrapped for the terminal.

    - If the recording has several flights or vehicles, the sentence begins with the one that the headline is about.
    - A headline that is a status light has its whole sentence, which names motors and numbers.
    - One that is an event has its short sentence, since the lines of evidence below it state the rest.

    Args:
        assessment: all results on the flight: events, status lights, model, loops and wind.
        columns: number of characters in a line.
    """
    fact = assessment.headline
    # This fact is the headline itself, unless the flight or the vehicle is one of several and must be named.
    fact_with_flight_or_vehicle = assessment.stated_headline
    is_one_of_several = fact_with_flight_or_vehicle != fact
    is_light = fact in assessment.lights.values() and fact not in assessment.events
    if is_one_of_several:
        text = fact_with_flight_or_vehicle.sentence
    elif is_light:
        text = fact.sentence
    else:
        text = headline(fact)
    return [*wrapped_lines(text, columns)]


def _evidence_lines(assessment: Assessment, columns: int) -> Iterator[str]:
    """Yields the lines below the headline of a review that say which measurements confirm it or its cause.

    Args:
        assessment: all results on the flight: events, status lights, model, loops and wind.
        columns: number of characters in a line.

    Yields:
        Wrapped lines; none if no measurement confirms the headline, or if a light above states the evidence.
    """
    light_sentences = {light.sentence for light in assessment.lights.values()}
    for sentence in headline_evidence(assessment.headline, assessment.lights):
        if sentence.text in light_sentences:
            continue
        yield from wrapped_lines(f"{sentence.lead} {sentence.text}", columns)


def review_title(assessment: Assessment) -> Sentence:
    """Returns the title of a review: name of the log, vehicle, duration and date."""
    if assessment.analysis is None or assessment.evidence is None:
        return Sentence("no vehicle judged.", _log_name(assessment.log))
    return vehicle_title(assessment.log, assessment.evidence.signals, assessment.analysis)


def vehicle_title(log: Log, signals: Signals, analysis: LogAnalysis) -> Sentence:
    """Returns the title of a report on a vehicle: name of the log, vehicle, number of flights, duration and date.

    An example is "00000012.BIN: quadrotor, 85 s armed, 2 flights, 2026-01-05, ArduPilot 4.5.1.".

    Args:
        log: the log of a flight, with the messages of each vehicle.
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        analysis: analysis of the vehicle, with its identity and the time that it was armed.

    Returns:
        The title as a sentence, with the name of the log as its lead, which is set off before the text.
    """
    # The template sections/review.toml makes the words. If the log has no date, they use that in its file's name.
    sentences = render_section(
        "review",
        analysis.identity,
        log=log,
        telemetry=signals.telemetry,
        condition=analysis.condition,
        max_duration=MAX_FLIGHT_SECONDS,
        is_simulated=simulation_fact(signals) is not None,
        flight_count=len(flown_flights(signals)),
        day_in_name=day_in_file_name(Path(log.source).name),
    )
    text = " ".join(sentence.text for sentence in sentences)
    return Sentence(text, lead=_log_name(log))


def _log_name(log: Log) -> str:
    """Returns the name of a log's file, as the beginning of a title."""
    return f"{Path(log.source).name}:"


def _event_lines(assessment: Assessment, columns: int) -> Iterator[str]:
    """Yields the lines of the events that a screen shows, in the order of time: the short list that the page has too.

    Nothing is listed if the headline is good and no event is bad, or if the only events are ordinary reports of the
    autopilot, such as a take-off: then the status lights, each the judgement of one subject, and the headline state all
    that matters.

    If the autopilot restarted between two of them, its clock began again. A line says so, since the times of the events
    do not ascend there.

    Args:
        assessment: all results on a vehicle of the log: events, status lights, model, loops and wind.
        columns: number of characters in a line of the terminal.
    """
    headline_fact = assessment.headline
    # The same events as on the page, so that both give the same time.
    events = tuple(distinct_events(assessment.events))
    stated = stated_events(events, headline_fact, assessment.lights)
    listed_events = short_list(events, stated)
    is_something_wrong = headline_fact.is_watch_or_bad or any(event.is_bad for event in events)
    is_some_event_notable = any(is_notable(events[index]) for index, _ in listed_events)
    if not (is_something_wrong and is_some_event_notable):
        return
    previous_boot = None
    for event_index, event_count in listed_events:
        event = events[event_index]
        # A boot lasts from one start of the autopilot to the next. Events without its number belong to the boot of the
        # event before them.
        boot = event.figures.get("boot", previous_boot)
        if previous_boot is not None and boot > previous_boot:
            yield CLOCK_BEGINS_ANEW
        previous_boot = boot
        if event_index == stated.headline_index:
            # The headline below states all of it, or what follows its first clause.
            clause = first_clause(str(event))
            text = "See the headline." if clause == headline(headline_fact) else clause
            yield from _wrapped_text(_label_and_level(_time_label(event), event), text, columns)
        else:
            yield from _lines_of_event(event, event_count, columns)


def _time_label(event: Fact) -> str:
    """Returns the time of an event, such as "97.2 s", or "event" if it has none."""
    has_time = event.time is not None and isfinite(event.time)
    return f"{event.time:.1f} s" if has_time else "event"


def _lines_of_event(event: Fact, event_count: int, columns: int) -> list[str]:
    """Returns the lines of one event: its time, its level and its sentence.

    Subordinate clauses that do not fit into one line are left out. If even the main clause does not fit, the whole
    sentence is wrapped onto several lines.

    Args:
        event: the event, a coded finding with a level and a sentence.
        event_count: number of events of its kind, for which it stands.
        columns: number of characters in a line of the terminal.
    """
    time_text = _time_label(event)
    remark_on_count = count_text(event, event_count)
    line = _shortened_line(_label_and_level(time_text, event), event, columns, remark_on_count)
    # A main clause that is too long was cut off, and ends with an ellipsis.
    is_cut_off = "…" in line
    if is_cut_off:
        return _wrapped_fact(time_text, event, columns, remark_on_count)
    return [line]


def gain_lines(assessment: Assessment, columns: int = SCREEN_COLUMNS) -> list[str]:
    """Returns the lines with the gains that ``mavdem tune`` advises, where the next step of a review is to load them.

    They are computed after the screen is printed, since that takes seconds.

    Args:
        assessment: all results on a vehicle of the log: events, status lights, model, loops and wind.
        columns: number of characters in a line of the terminal.

    Returns:
        Each gain with its value now and the one to set; empty where the next step is another one.
    """
    if not advises_to_tune(assessment.next_step) or assessment.evidence is None:
        return []
    vehicle = assessment.evidence.signals.telemetry
    changes = gain_changes(assessment.log.source, vehicle, assessment.advised_gains)
    if changes is None or not changes.tables:
        return []
    gain_texts = []
    # The gains of a later stage wait for the flight with the first ones.
    for name, present_value, advised_value, _ in changes.first_table.rows:
        # A gain and its values stay on one line.
        gain_texts.append(f"{name} {present_value} → {advised_value}".replace(" ", HARD_SPACE))
    change_count = changes_on_trial(assessment.advised_gains)
    sentences = render_section("review_gains", gains=gain_texts, change_count=change_count)
    return [line for sentence in sentences for line in wrapped_lines(sentence.text, columns)]


def page_lines(assessment: Assessment, columns: int) -> list[str]:
    """Returns the lines of a screen that say what only the page of the log shows, such as plots over time.

    Args:
        assessment: all results on a vehicle of the log: events, status lights, model, loops and wind.
        columns: number of characters in a line of the terminal.

    Returns:
        The lines; none where no vehicle was analysed.
    """
    if assessment.analysis is None:
        return []
    page_events = list(distinct_events(assessment.events))
    events_text = "the event" if len(page_events) == 1 else f"all {len(page_events)} events"
    text = f"The page also has plots over time, {events_text}, sensors and parameters."
    return list(wrapped_lines(text, columns))


def _lines_of_light(name: str, fact: Fact, columns: int) -> list[str]:
    """Returns the lines of one status light of a review for the terminal.

    A light that is good or not judged gets two lines at most: if its sentence needs more, it is shortened to one line,
    without remarks and subordinate clauses that do not fit. Any other light has its whole sentence, on as many lines as
    that needs.

    Args:
        name: name of the light, its subject, such as "motors".
        fact: the judgement of this subject, a coded finding with a level.
        columns: number of characters in a line.
    """
    whole_lines = _wrapped_fact(name, fact, columns)
    may_be_shortened = fact.level == Level.GOOD or fact.code == Unjudged.NOT_JUDGED
    if not may_be_shortened or len(whole_lines) <= MAX_LINES_OF_GOOD_LIGHT:
        return whole_lines
    label_and_level = _label_and_level(name, fact)
    line = _shortened_line(label_and_level, fact, columns)
    # A light that needs several lines on a terminal of the usual width gets its whole sentence on a wider one, too.
    # Otherwise a wider terminal could show less of it than a narrow one.
    line_of_usual_width = _shortened_line(label_and_level, fact, min(columns, SCREEN_COLUMNS))
    # An ellipsis at the end means that even the main clause was too long and is cut off.
    is_cut_off = line.endswith("…") or line_of_usual_width.endswith("…")
    return whole_lines if is_cut_off else [line]


def _wrapped_fact(label: str, fact: Fact, columns: int, remark: str = "") -> list[str]:
    """Returns the lines of a status light or event: its label and level, and beside them its whole sentence.

    Args:
        label: name of the light, or time of the event.
        fact: the light or event, a coded finding with a level and a sentence.
        columns: number of characters in a line.
        remark: text after the sentence, such as how many events of the same kind there are; empty for none.
    """
    text = _with_remark(headline(fact), remark)
    return _wrapped_text(_label_and_level(label, fact), text, columns)


def _wrapped_text(label_and_level: str, text: str, columns: int) -> list[str]:
    """Returns the lines of a text that stands beside a label and a level, which its further lines leave free.

    Args:
        label_and_level: the first two columns of the first line.
        text: the text.
        columns: number of characters in a line.
    """
    first_line, *further_lines_of_text = wrapped_lines(text, columns - len(label_and_level))
    indent = " " * len(label_and_level)
    return [label_and_level + first_line, *(indent + line for line in further_lines_of_text)]


def _shortened_line(label_and_level: str, fact: Fact, columns: int, remark: str = "") -> str:
    """Returns one line of a fact: its label, its level, and its sentence without the clauses that do not fit.

    Args:
        label_and_level: the first two columns of the line.
        fact: the light or event, a coded finding with a level and a sentence.
        columns: number of characters in a line.
        remark: text after the sentence, such as how many events of the same kind there are; empty for none.
    """
    available_columns = columns - len(label_and_level) - len(remark)
    sentence = shortened(headline(fact), available_columns)
    return f"{label_and_level}{_with_remark(sentence, remark)}"


def _with_remark(sentence: str, remark: str) -> str:
    """Returns a sentence with a remark in brackets before its full stop.

    Args:
        sentence: the sentence.
        remark: the remark, such as " (longest of 4)"; empty for none.
    """
    return f"{without_full_stop(sentence)}{remark}." if remark else sentence


def _label_and_level(label: str, fact: Fact) -> str:
    """Returns the first two columns of a line of the terminal, such as "motors     good     ".

    Args:
        label: name of a status light or time of an event.
        fact: the light or event, a coded finding, whose level is the second column. A bad one is in capitals.
    """
    level = str(fact.level)
    if fact.is_bad:
        level = level.upper()
    # The level of an event that is only named, such as a take-off or a change of mode, would be no judgement.
    if isinstance(fact.code, ReportedEvent | MotionEvent) and fact.is_good:
        level = ""
    # A time of a million seconds, as of a wrong clock, is as wide as its column: a space keeps it from the level.
    label_and_space = f"{label} "
    return f"{label_and_space:<{LABEL_COLUMNS}}{level:<{LEVEL_COLUMNS}}"
