"""The review of a log on one terminal screen: title, lights (judgements of parts), alarms, headline, next step."""

import re
from collections.abc import Iterator
from math import isfinite
from pathlib import Path
from textwrap import wrap

from mavdem.assessment import Assessment
from mavdem.assessment.assess import FirstFindings
from mavdem.assessment.axis import LogAnalysis
from mavdem.assessment.flights import flights_in_boot, segments_of_boots
from mavdem.assessment.identity import day_in_file_name
from mavdem.assessment.lights import REGISTRY
from mavdem.assessment.lights.log import simulation_fact
from mavdem.dataset.signals import Signals
from mavdem.facts import Fact, Level, NamedFacts
from mavdem.facts.lights import Unjudged
from mavdem.ingest import Log
from mavdem.report.blocks import SCREEN_LINES, Sentence, shortened
from mavdem.report.brief_events import first_of, worst_events
from mavdem.report.lights import lights_with_reason_once
from mavdem.report.templates import headline, render_section

SCREEN_COLUMNS = 80
"""Columns of a terminal that nobody has widened."""

RESERVED_LINES = 3
"""Lines of a screen that the review leaves free: for the title, and the progress and the path of the page."""

CLOCK_BEGINS_ANEW = f"{'restart':<20}The autopilot restarted: its clock begins anew."
"""The row between events of two boots, in the columns of the other rows."""

HARD_SPACE = "\N{NO-BREAK SPACE}"
"""A space at which no line is broken."""


def review_screen(assessment: Assessment, columns: int = SCREEN_COLUMNS) -> str:
    """Returns the review as text of at most ``SCREEN_LINES``; facts that are not good may need more lines.

    A light is the judgement of one part of the vehicle, such as its motors. The sentence of a good light loses
    its details where that makes it one line; that of any other light is continued on further lines. As many alarms are
    shown as fit. The most important lines come last, where the user looks after everything has scrolled by.

    Args:
        assessment: assessment of the log.
        columns: number of characters in a line.
    """
    lights = _light_lines(lights_with_reason_once(assessment.lights), columns)
    title_lines = _title_lines(review_title(assessment), columns)
    last_lines = _last_lines(assessment, len(title_lines) - 1 + len(lights), columns)
    return "\n".join([*title_lines, *lights, *last_lines])


def first_lines(findings: FirstFindings, columns: int = SCREEN_COLUMNS) -> str:
    """Returns the first lines of the review that are known before the control loops: its title, and some lights.

    A light is the judgement of one part of the vehicle. Lights have the same order everywhere. So only those are shown
    that come before the first light which needs the control loops. :func:`further_lines` returns the rest. Both
    together are the lines of :func:`review_screen`.

    Args:
        findings: findings on the flight so far.
        columns: characters of a line.
    """
    evidence = findings.evidence
    title = vehicle_title(evidence.log, evidence.signals, findings.analysis)
    lights = _light_lines(_lights_before_loops(findings), columns)
    return "\n".join([*_title_lines(title, columns), *lights])


def _lights_before_loops(findings: FirstFindings) -> NamedFacts:
    """Returns the lights that are known before the control loops, up to the first one that needs these.

    Args:
        findings: findings on the flight so far, with the lights that are judged already.
    """
    known_lights = lights_with_reason_once(findings.lights)
    first_lights = {}
    for light in REGISTRY:
        if light.name not in known_lights:
            break
        first_lights[str(light.name)] = known_lights[light.name]
    return first_lights


def further_lines(
    assessment: Assessment, findings: FirstFindings, columns: int = SCREEN_COLUMNS
) -> str:
    """Returns the lines of the review that follow :func:`first_lines`: lights that need loops, alarms and conclusion.

    Args:
        assessment: assessment of the flight.
        findings: findings that have been shown already.
        columns: characters of a line.
    """
    first_lights = _lights_before_loops(findings)
    further_lights = {
        name: fact
        for name, fact in lights_with_reason_once(assessment.lights).items()
        if name not in first_lights
    }
    lights = _light_lines(further_lights, columns)
    title_lines = _title_lines(review_title(assessment), columns)
    shown_count = len(title_lines) - 1 + len(_light_lines(first_lights, columns))
    return "\n".join([*lights, *_last_lines(assessment, shown_count + len(lights), columns)])


def _title_lines(title: Sentence, columns: int) -> list[str]:
    """Returns the lines of a title: usually one."""
    return wrap(f"{title.lead} {title.text}", columns, break_on_hyphens=False)


def _light_lines(lights: NamedFacts, columns: int) -> list[str]:
    """Returns the lines of some lights, in their order."""
    lines = []
    for name, fact in lights.items():
        lines += _light_rows(name, fact, columns)
    return lines


def _last_lines(assessment: Assessment, line_count: int, columns: int) -> list[str]:
    """Returns the lines that follow the lights: as many alarms as there is room for, the headline, and the next step.

    Args:
        assessment: assessment of the flight.
        line_count: lines of all lights, and of the title after its first.
        columns: characters of a line.
    """
    conclusion = [
        *wrap(headline(assessment.headline), columns),
        *_wrapped(f"Next: {assessment.next_step}", columns),
    ]
    room = max(SCREEN_LINES - RESERVED_LINES - line_count - len(conclusion), 0)
    alarms: list[str] = []
    for row in _alarm_rows(assessment, columns):
        if len(alarms) + len(row) > room:
            break
        alarms += row
    return [*alarms, *conclusion]


def review_title(assessment: Assessment) -> Sentence:
    """Returns the title of a review: name of the log, vehicle, duration and date."""
    if assessment.analysis is None or assessment.evidence is None:
        return Sentence("no vehicle judged.", _log_name(assessment.log))
    return vehicle_title(assessment.log, assessment.evidence.signals, assessment.analysis)


def vehicle_title(log: Log, signals: Signals, analysis: LogAnalysis) -> Sentence:
    """Returns the title of a report on a vehicle: name of the log, vehicle, duration and date.

    Args:
        log: the log.
        signals: signals of the vehicle.
        analysis: analysis of the vehicle, with its identity and the time that it was armed.

    Returns:
        The title.
    """
    sentences = render_section(
        "review",
        analysis.identity,
        log=log,
        telemetry=signals.telemetry,
        condition=analysis.condition,
        is_simulated=simulation_fact(signals) is not None,
        flight_count=len(segments_of_boots(signals, flights_in_boot)),
        day_in_name=day_in_file_name(Path(log.source).name),
    )
    return Sentence(" ".join(sentence.text for sentence in sentences), _log_name(log))


def _log_name(log: Log) -> str:
    """Returns the name of a log's file, as the beginning of a title."""
    return f"{Path(log.source).name}:"


def _wrapped(text: str, columns: int) -> Iterator[str]:
    """Yields the lines of a text, of at most so many ``columns``.

    A command between backquotes stays on one line, so that it can be copied.

    Args:
        text: the text, without line breaks.
        columns: largest number of characters of a line.
    """
    unbroken = re.sub("`.*?`", lambda command: command[0].replace(" ", HARD_SPACE), text)
    for line in wrap(unbroken, columns, break_long_words=False, break_on_hyphens=False):
        yield line.replace(HARD_SPACE, " ")


def _alarm_rows(assessment: Assessment, columns: int) -> Iterator[list[str]]:
    """Yields the lines of each kind of bad event, which may have lost the vehicle, except the event of the headline.

    If the autopilot restarted between two of them, so that its clock began again, a row says so: their times are not in
    order then.

    Args:
        assessment: assessment of the log.
        columns: number of characters of a line of the terminal.
    """
    former_boot = None
    for index, total in worst_events(assessment.events):
        event = assessment.events[index]
        if event.is_bad and event.time != assessment.headline.time:
            # The number of the boot, by which the autopilot's restarts are counted; only some events have it.
            boot = event.figures.get("boot", former_boot)
            if former_boot is not None and boot > former_boot:
                yield [CLOCK_BEGINS_ANEW]
            former_boot = boot
            has_time = event.time is not None and isfinite(event.time)
            name = f"{event.time:.0f} s" if has_time else "event"
            yield _whole_row(name, event, columns, first_of(total))


def _light_rows(name: str, fact: Fact, columns: int) -> list[str]:
    """Lays out the lines of a light.

    Args:
        name: name of the light.
        fact: its judgement.
        columns: characters of a line.

    Returns:
        One line if it is good or not judged and one line holds its main clauses, otherwise its whole text.
    """
    if fact.level == Level.GOOD or fact.code == Unjudged.NOT_JUDGED:
        row = _row(name, fact, columns)
        if not row.endswith("…"):
            return [row]
    return _whole_row(name, fact, columns)


def _whole_row(name: str, fact: Fact, columns: int, remark: str = "") -> list[str]:
    """Returns the lines of a light or an event with its whole sentence.

    Args:
        name: name of the light, or time of the event.
        fact: the light or the event.
        columns: characters of a line.
        remark: what follows the sentence.
    """
    beginning = _row_beginning(name, fact)
    return wrap(
        headline(fact) + remark,
        columns,
        initial_indent=beginning,
        subsequent_indent=" " * len(beginning),
        break_on_hyphens=False,
    )


def _row(name: str, fact: Fact, columns: int) -> str:
    """Returns the line of a light: its name, its level, and its sentence as far as it fits."""
    beginning = _row_beginning(name, fact)
    return f"{beginning}{shortened(headline(fact), columns - len(beginning))}"


def _row_beginning(name: str, fact: Fact) -> str:
    """Returns the first two columns of a row: the name of a light or the time of an event, and the level."""
    level = fact.level.upper() if fact.is_bad else fact.level
    return f"{name:<11}{level:<9}"
