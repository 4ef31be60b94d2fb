"""The review of a log on one terminal screen: title, eight lights, alarms, the headline, and what to do next."""

import re
from collections.abc import Iterator
from pathlib import Path
from textwrap import shorten, wrap

from mavdem.assessment import Assessment
from mavdem.assessment.axis import LogAnalysis
from mavdem.assessment.lights.log import simulation_fact
from mavdem.dataset.signals import Signals
from mavdem.facts import Fact
from mavdem.ingest import Log
from mavdem.report.blocks import SCREEN_LINES, Sentence, shortened
from mavdem.report.templates import headline, render_section

SCREEN_COLUMNS = 80
"""Columns of a terminal that nobody has widened."""

MAX_HEADLINE_LINES = 2
"""Lines of the headline on the screen; a longer one is cut."""

RESERVED_LINES = 3
"""Lines of a screen that the review leaves free: for the title, and the progress and the path of the page."""

HARD_SPACE = "\N{NO-BREAK SPACE}"
"""A space at which no line is broken."""


def review_screen(assessment: Assessment) -> str:
    """Returns the review as text of ``SCREEN_COLUMNS`` and at most ``SCREEN_LINES``, unless the next step is long.

    As many alarms are shown as there is room for. The most important lines are last, where somebody looks when all has
    scrolled by.
    """
    title = review_title(assessment)
    title_line = shorten(f"{title.lead} {title.text}", SCREEN_COLUMNS, placeholder=" …")
    lights = [_row(name, fact) for name, fact in assessment.lights.items()]
    headline_lines = wrap(
        headline(assessment.headline),
        SCREEN_COLUMNS,
        max_lines=MAX_HEADLINE_LINES,
        placeholder=" …",
    )
    conclusion = [*headline_lines, *_wrapped(f"Next: {assessment.next_step}")]
    room = max(SCREEN_LINES - RESERVED_LINES - len(lights) - len(conclusion), 0)
    alarms = [*_alarm_rows(assessment)][:room]
    return "\n".join([title_line, *lights, *alarms, *conclusion])


def review_title(assessment: Assessment) -> Sentence:
    """Returns the title of a review: name of the log, vehicle, duration and date."""
    if assessment.analysis is None or assessment.evidence is None:
        return Sentence("no vehicle judged.", _log_name(assessment.log))
    return vehicle_title(assessment.log, assessment.evidence.signals, assessment.analysis)


def vehicle_title(log: Log, signals: Signals, analysis: LogAnalysis) -> Sentence:
    """Returns the title of what is reported of a vehicle: name of the log, vehicle, duration and date.

    Args:
        log: the log.
        signals: of the vehicle.
        analysis: of the vehicle, with its identity and how long it was armed.
    """
    sentences = render_section(
        "review",
        analysis.identity,
        log=log,
        telemetry=signals.telemetry,
        condition=analysis.condition,
        is_simulated=simulation_fact(signals) is not None,
    )
    return Sentence(" ".join(sentence.text for sentence in sentences), _log_name(log))


def _log_name(log: Log) -> str:
    """Returns the name of a log's file, as the beginning of a title."""
    return f"{Path(log.source).name}:"


def _wrapped(text: str) -> Iterator[str]:
    """Yields the lines of a text; a command between backquotes stays on one line, so that it can be copied."""
    unbroken = re.sub("`.*?`", lambda command: command[0].replace(" ", HARD_SPACE), text)
    for line in wrap(unbroken, SCREEN_COLUMNS, break_long_words=False, break_on_hyphens=False):
        yield line.replace(HARD_SPACE, " ")


def _alarm_rows(assessment: Assessment) -> Iterator[str]:
    """Yields a row for each event that may have lost the vehicle, except the one of the headline."""
    for event in assessment.events:
        if event.is_bad and event.time != assessment.headline.time:
            name = "event" if event.time is None else f"{event.time:.0f} s"
            yield _row(name, event)


def _row(name: str, fact: Fact) -> str:
    """Returns the line of a light or an event: its name or time, its level, and its sentence as far as it fits."""
    level = fact.level.upper() if fact.is_bad else fact.level
    beginning = f"{name:<11}{level:<9}"
    return f"{beginning}{shortened(headline(fact), SCREEN_COLUMNS - len(beginning))}"
