"""The review of a log on one screen: status lights, alarms and next step, as sentences of facts (coded findings)."""

import re
from collections.abc import Iterator
from math import isfinite
from pathlib import Path
from textwrap import wrap
from types import MappingProxyType

from mavdem.assessment import Assessment
from mavdem.assessment.assess import FirstFindings
from mavdem.assessment.axis import LogAnalysis
from mavdem.assessment.axis.loop_decision import advises_to_tune
from mavdem.assessment.flown_flights import flown_flights
from mavdem.assessment.identity import day_in_file_name
from mavdem.assessment.lights import REGISTRY
from mavdem.assessment.lights.log import simulation_fact
from mavdem.dataset.signals import Signals
from mavdem.facts import Fact, Level, NamedFacts
from mavdem.facts.lights import Unjudged
from mavdem.ingest import Log
from mavdem.report.blocks import SCREEN_LINES, Sentence, shortened
from mavdem.report.brief_events import first_of_count, worst_events
from mavdem.report.gain_changes import gain_changes
from mavdem.report.lights import earlier_lights, lights_with_reason_once
from mavdem.report.templates import headline, render_section
from mavdem.report.why import cause_sentences

SCREEN_COLUMNS = 80
"""Columns of a terminal that nobody has widened."""

RESERVED_LINES = 3
"""Lines of a screen that the review leaves free: for the title, and the progress and the path of the page."""

CLOCK_BEGINS_ANEW = f"{'restart':<20}The autopilot restarted: its clock begins anew."
"""The row between events of two boots, in the columns of the other rows."""

NO_LIGHTS: NamedFacts = MappingProxyType({})
"""Lights by name that are printed above others, where there are none."""

TIME_ORIGIN = "Times are seconds since boot."
"""What the times of a review count from: the autopilot's start, as in the plots of the page."""

HARD_SPACE = "\N{NO-BREAK SPACE}"
"""A space at which no line is broken."""


def review_screen(assessment: Assessment, columns: int = SCREEN_COLUMNS) -> str:
    """Returns the review of a log as text for one screen of the terminal.

    It has the title, a line for each status light (the judgement of one subject, such as the motors), as many alarms as
    there is room for, and last, where the user looks after everything has scrolled by, the headline and the next step.
    Sentences of good lights are shortened to one line. Only lights that warn may make the text longer than
    ``SCREEN_LINES``.

    Args:
        assessment: all results on a vehicle of the log: events, status lights, model, loops and wind.
        columns: number of characters in a line.
    """
    title_lines = _title_lines(review_title(assessment), columns)
    light_lines = _lines_of_lights(lights_with_reason_once(assessment.lights), columns)
    last_lines = _last_lines(assessment, len(light_lines), columns)
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
    """Returns the second part of a review on the terminal: remaining lights, alarms, headline and next step.

    The first part (:func:`first_lines`) is printed before the control loops are identified, which takes longest.

    Args:
        assessment: all results on the flight: events, status lights, model, loops and wind.
        findings: the findings without the loops, whose lights the first part has printed.
        columns: number of characters that a line may have.
    """
    first_lights = _lights_before_loops(findings)
    further_lights = {}
    for name, fact in lights_with_reason_once(assessment.lights).items():
        if name not in first_lights:
            further_lights[name] = fact
    # All lines of lights count, since the alarms get the room that they leave on the screen.
    printed_light_lines = _lines_of_lights(first_lights, columns)
    light_lines = _lines_of_lights(further_lights, columns, first_lights)
    light_line_count = len(printed_light_lines) + len(light_lines)
    return "\n".join([*light_lines, *_last_lines(assessment, light_line_count, columns)])


def _title_lines(title: Sentence, columns: int) -> list[str]:
    """Returns the lines of a title, one or two, which also say what the times in the lines below count from."""
    return wrap(f"{title.lead} {title.text} {TIME_ORIGIN}", columns, break_on_hyphens=False)


def _lines_of_lights(
    lights: NamedFacts, columns: int, lights_before: NamedFacts = NO_LIGHTS
) -> list[str]:
    """Returns the lines of the terminal for some status lights, each the judgement of one part of the vehicle.

    A light that warns of the same as an earlier one refers to that ("See motors.") instead of repeating the sentence.

    Args:
        lights: the lights by name, such as "motors", each a finding with a level and a sentence.
        columns: number of characters that a line may have.
        lights_before: lights that are printed above these.
    """
    repeated_lights = earlier_lights({**lights_before, **lights})
    lines = []
    for name, light in lights.items():
        if name in repeated_lights:
            lines.append(f"{_label_and_level(name, light)}See {repeated_lights[name]}.")
        else:
            lines += _lines_of_light(name, light, columns)
    return lines


def _last_lines(assessment: Assessment, light_line_count: int, columns: int) -> list[str]:
    """Returns the end of a review: as many alarms as there is room for, the headline, and the next step.

    There is room for alarms as long as the whole review has no more than ``SCREEN_LINES``.

    Args:
        assessment: all results on the flight: events, status lights, model, loops and wind.
        light_line_count: number of lines of all status lights above.
        columns: number of characters in a line.
    """
    headline_and_next_step = [
        *wrap(headline(assessment.headline), columns),
        *_evidence_lines(assessment.headline, columns),
        *_wrapped_lines(f"Next: {assessment.next_step}", columns),
    ]
    # The first line of the title is counted by ``RESERVED_LINES``.
    further_title_lines = _title_lines(review_title(assessment), columns)[1:]
    other_line_count = len(further_title_lines) + light_line_count + len(headline_and_next_step)
    available_line_count = SCREEN_LINES - RESERVED_LINES - other_line_count
    alarm_lines: list[str] = []
    for lines_of_alarm in _alarm_lines(assessment, columns):
        if len(alarm_lines) + len(lines_of_alarm) > available_line_count:
            break
        alarm_lines += lines_of_alarm
    return [*alarm_lines, *headline_and_next_step]


def _evidence_lines(event: Fact, columns: int) -> Iterator[str]:
    """Yields the lines below the headline of a review that say which measurements confirm its cause.

    Args:
        event: the headline, a coded finding that may have a cause, such as a failed motor.
        columns: number of characters in a line.

    Yields:
        Wrapped lines; none if no measurement confirms the cause.
    """
    for sentence in cause_sentences(event):
        yield from wrap(f"{sentence.lead} {sentence.text}", columns)


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
        is_simulated=simulation_fact(signals) is not None,
        flight_count=len(flown_flights(signals)),
        day_in_name=day_in_file_name(Path(log.source).name),
    )
    text = " ".join(sentence.text for sentence in sentences)
    return Sentence(text, lead=_log_name(log))


def _log_name(log: Log) -> str:
    """Returns the name of a log's file, as the beginning of a title."""
    return f"{Path(log.source).name}:"


def _wrapped_lines(text: str, columns: int) -> Iterator[str]:
    """Yields the lines of a text that is wrapped for the terminal.

    A command between backquotes stays on one line, so that it can be copied. For this its spaces are replaced by ones
    at which no line is broken, and restored after that.

    Args:
        text: the text, without line breaks.
        columns: largest number of characters in a line; a longer command or word makes a longer line.
    """
    unbroken = re.sub("`.*?`", lambda command: command[0].replace(" ", HARD_SPACE), text)
    for line in wrap(unbroken, columns, break_long_words=False, break_on_hyphens=False):
        yield line.replace(HARD_SPACE, " ")


def _alarm_lines(assessment: Assessment, columns: int) -> Iterator[list[str]]:
    """Yields the lines of each alarm of a review; an alarm is a bad event, such as the failure of a motor.

    The event that is the headline already is left out. Of equal events, such as several losses of the same motor, the
    first one is shown with their number. If the autopilot restarted between two alarms, its clock began again; a line
    says so, since the times are not in order then.

    Args:
        assessment: all results on a vehicle of the log: events, status lights, model, loops and wind.
        columns: number of characters in a line of the terminal.
    """
    previous_boot = None
    for index, count in worst_events(assessment.events):
        event = assessment.events[index]
        is_headline = event.time == assessment.headline.time
        if not event.is_bad or is_headline:
            continue
        # The number of the boot, by which the autopilot's restarts are counted; only some events have it.
        boot = event.figures.get("boot", previous_boot)
        if previous_boot is not None and boot > previous_boot:
            yield [CLOCK_BEGINS_ANEW]
        previous_boot = boot
        has_time = event.time is not None and isfinite(event.time)
        label = f"{event.time:.0f} s" if has_time else "event"
        yield _wrapped_fact(label, event, columns, count_text=first_of_count(count))


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
    changes = gain_changes(
        assessment.log.source, vehicle, assessment.advised_gains, assessment.next_step
    )
    if changes is None:
        return []
    texts = []
    for name, present_value, advised_value, _ in changes.table.rows:
        # A gain and its values stay on one line.
        texts.append(f"{name} {present_value} → {advised_value}".replace(" ", HARD_SPACE))
    return [*_wrapped_lines(f"Gains: {', '.join(texts)}.", columns)]


def _lines_of_light(name: str, fact: Fact, columns: int) -> list[str]:
    """Returns the lines of one status light of a review for the terminal.

    A light that is good or not judged gets one line if its main clauses fit into that. Any other has its whole text,
    on as many lines as that needs.

    Args:
        name: name of the light, its subject, such as "motors".
        fact: the judgement of this subject, a coded finding with a level.
        columns: number of characters in a line.
    """
    may_be_shortened = fact.level == Level.GOOD or fact.code == Unjudged.NOT_JUDGED
    if may_be_shortened:
        # Whether the main clauses fit is decided for a terminal that nobody has widened: the clauses that fit into the
        # one line of a wider one may be fewer than those on several lines of a narrow one.
        narrow_line = _shortened_fact(name, fact, min(columns, SCREEN_COLUMNS))
        line = _shortened_fact(name, fact, columns)
        # An ellipsis means that a clause is cut off in its middle.
        if not narrow_line.endswith("…") and not line.endswith("…"):
            return [line]
    return _wrapped_fact(name, fact, columns)


def _wrapped_fact(label: str, fact: Fact, columns: int, count_text: str = "") -> list[str]:
    """Returns the lines of a status light or an event: its label and level, and beside them its whole sentence.

    Args:
        label: name of the light, or time of the event.
        fact: the light or event, a coded finding with a level and a sentence.
        columns: number of characters in a line.
        count_text: text after the sentence on how many equal events there are; empty for a single one.
    """
    label_and_level = _label_and_level(label, fact)
    sentence = headline(fact) + count_text
    return wrap(
        sentence,
        columns,
        initial_indent=label_and_level,
        subsequent_indent=" " * len(label_and_level),
        break_on_hyphens=False,
    )


def _shortened_fact(label: str, fact: Fact, columns: int) -> str:
    """Returns one line of a fact: its label, its level, and its sentence without the clauses that do not fit."""
    label_and_level = _label_and_level(label, fact)
    return f"{label_and_level}{shortened(headline(fact), columns - len(label_and_level))}"


def _label_and_level(label: str, fact: Fact) -> str:
    """Returns the first two columns of a fact's line: the name of a light or the time of an event, and the level."""
    level = fact.level.upper() if fact.is_bad else fact.level
    return f"{label:<11}{level:<9}"
