"""Review of a log on one screen: what it is of, the headline, eight lights, what happened, and what to do next."""

import re
from collections.abc import Iterator
from pathlib import Path
from textwrap import shorten, wrap

from mavdem.assessment import Assessment
from mavdem.facts import Fact
from mavdem.report.blocks import SCREEN_LINES, Sentence, shortened
from mavdem.report.templates import headline, render_section

SCREEN_COLUMNS = 80
"""Of a terminal that nobody has widened."""
HARD_SPACE = "\xa0"


def review_screen(assessment: Assessment) -> str:
    """Returns the screen of an ``assessment``: of ``SCREEN_COLUMNS``, ``LINES``; a long next step takes more."""
    lead = review_title(assessment)
    first = shorten(f"{lead.lead} {lead.text}", SCREEN_COLUMNS, placeholder=" …")
    lights = [_row(name, fact) for name, fact in assessment.lights.items()]
    # What somebody reads when all has scrolled by is last.
    headlines = wrap(headline(assessment.headline), SCREEN_COLUMNS, max_lines=2, placeholder=" …")
    last = [*headlines, *_wrapped(f"Next: {assessment.next_step}")]
    room = max(SCREEN_LINES - 3 - len(lights) - len(last), 0)
    alarms = [*_alarms(assessment)][:room]
    return "\n".join([first, *lights, *alarms, *last])


def review_title(assessment: Assessment) -> Sentence:
    """Returns which log it is, and of what."""
    analysis = assessment.analysis
    name = f"{Path(assessment.log.source).name}:"
    if analysis is None:
        return Sentence("no vehicle judged.", name)
    sentences = render_section(
        "review",
        analysis.identity,
        assessment=assessment,
    )
    return Sentence(" ".join(sentence.text for sentence in sentences), name)


def _wrapped(text: str) -> Iterator[str]:
    """The lines of a ``text``, with each command, as "`mavdem tune LOG`", whole on one, to be pasted."""
    whole = re.sub("`.*?`", lambda command: command[0].replace(" ", HARD_SPACE), text)
    for line in wrap(whole, SCREEN_COLUMNS, break_long_words=False, break_on_hyphens=False):
        yield line.replace(HARD_SPACE, " ")


def _row(name: str, fact: Fact) -> str:
    """A light by its name, or an event by its time."""
    mark = fact.level.upper() if fact.is_bad else fact.level
    beginning = f"{name:<11}{mark:<9}"
    return f"{beginning}{shortened(headline(fact), SCREEN_COLUMNS - len(beginning))}"


def _alarms(assessment: Assessment) -> Iterator[str]:
    """What happened that may have lost the vehicle, but for what the headline says."""
    for event in assessment.events:
        if event.is_bad and event.time != assessment.headline.time:
            yield _row("event" if event.time is None else f"{event.time:.0f} s", event)
