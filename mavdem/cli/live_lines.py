"""Lines on a live session that are printed below each other, of one form, by which programs find what they look for.

A line is ``14:03:07   182.4 s  TEXT``: the time of day, the time on the vehicle's boot clock ("-" before it is known),
and a text. After a restart of the autopilot the time names the boot: ``boot 2, 12.4 s``. Lines of alarms have ``ALARM``
before the text, those of their ends ``ALARM OVER``, and no other line has. What the pilot must know at once although it
is only to be watched has ``WARNING``, and what to do next ``NEXT``. Verdicts on flights have ``VERDICT``, and written
files ``FILE``.
"""

from math import isfinite, nan
from textwrap import fill

from rich.console import Console
from rich.text import Text

from mavdem.cli.streams import escape_unprintable
from mavdem.facts import Fact, Level
from mavdem.facts.event import Event
from mavdem.facts.session import SessionFact
from mavdem.facts.watch import WatchFact
from mavdem.live import clock
from mavdem.report.live import without_basis_of_phase
from mavdem.report.templates import (
    as_clause,
    first_and_further_sentences,
    headline,
    time_of_day,
)

ALARM_MARKER = "ALARM"
"""Word before the text of an alarm."""

ALARM_OVER_MARKER = "ALARM OVER"
"""Words before the text of an alarm that is over."""

WARNING_MARKER = "WARNING"
"""Word before the text of what the pilot must know at once although it is only to be watched."""

VERDICT_MARKER = "VERDICT"
"""Word before the verdict on a flight: at the end of a session, or once a server has judged its log."""

NEXT_MARKER = "NEXT"
"""Word before what to do next."""

FILE_MARKER = "FILE"
"""Word before the name of a file that the session has written."""

CLOCK_WIDTH = 8
"""Width of the time on the vehicle's clock, characters: "999999.9", which is 11 days."""

STAMP_WIDTH = len("14:03:07 ") + CLOCK_WIDTH + len(" s  ")
"""Width of the time of day and the vehicle's clock that begin a line, characters: a wrapped text goes on below itself.
"""

LEVEL_STYLES = {
    Level.GOOD: "green",
    Level.WATCH: "yellow",
    Level.BAD: "bold red",
    Level.UNKNOWN: "dim",
}
"""Style in which the word for each level is printed, in the notation of the library Rich."""


def stamped_line(
    text: str, reception: float | None = None, boot_clock: float = nan, boot: int = 0
) -> str:
    """Returns a line of text that begins with the time of day and the time on the vehicle's clock.

    Args:
        text: the text.
        reception: when it was found, UNIX s; None for now.
        boot_clock: when it was found, s of the vehicle's boot clock; NaN where that is not known.
        boot: number of that boot, from 0; the line names those after the first, whose clock has begun again.
    """
    moment = time_of_day(clock.unix_time() if reception is None else reception)
    boot_clock_text = f"{boot_clock:.1f}" if isfinite(boot_clock) else "-"
    if boot:
        boot_clock_text = f"boot {boot + 1}, {boot_clock_text}"
    return f"{moment} {boot_clock_text:>{CLOCK_WIDTH}} s  {text}"


def event_line(event: Event, *, has_remedy: bool = True, ends_alarm: bool = False) -> str:
    """Returns the line of an event of a live session.

    Args:
        event: what was found, and when.
        has_remedy: whether the line says what to do about it, too.
        ends_alarm: whether the event ends an alarm, although its fact (coded finding) is about something else.
    """
    fact = without_basis_of_phase(event.fact)
    marker = _marker(event)
    if ends_alarm and not marker:
        marker = ALARM_OVER_MARKER
    parts = [marker, _sentence_after_marker(fact)]
    if has_remedy:
        parts.append(fact.remedy)
    text = " ".join(part for part in parts if part)
    return stamped_line(escape_unprintable(text), event.reception, event.clock, event.boot)


def brief_alarm_line(event: Event) -> str:
    """Returns the line of an alarm without the details that a warning before it has stated: headline and first step.

    For example: "ALARM Link lost 10 s ago, in flight. Land by sight: no alarm can come while the link is lost."

    Args:
        event: what was found, and when.
    """
    first_step, _ = first_and_further_sentences(event.fact.remedy)
    text = f"{ALARM_MARKER} {headline(event.fact)} {first_step}"
    return stamped_line(escape_unprintable(text), event.reception, event.clock, event.boot)


def _marker(event: Event) -> str:
    """Returns the word at the start of an event's line, such as "ALARM", by which other programs find such lines.

    Alarms, their ends, warnings and judgements of a whole flight have such a word.

    Args:
        event: what was found, and when. Its fact (coded finding) says what it is.

    Returns:
        The word; empty for all other events, such as a take-off.
    """
    code = event.fact.code
    if _ends_an_alarm(event.fact):
        return ALARM_OVER_MARKER
    if event.is_alarm:
        return ALARM_MARKER
    if code is SessionFact.ALARM:
        # A fault of the level "watch" has the code of an alarm, but is only a warning.
        return WARNING_MARKER
    if code in (SessionFact.FLIGHT_VERDICT, SessionFact.RECORDING_JUDGED):
        return VERDICT_MARKER
    return ""


def _ends_an_alarm(fact: Fact) -> bool:
    """Returns whether a fact (coded finding) says that a fault is over which was an alarm, and not only to be watched.

    Args:
        fact: the fact of an event. If it is the end of an alarm, its figure "reason" is the fault that was the alarm.
    """
    return fact.code is WatchFact.ALARM_OVER and fact.figures["reason"].is_bad


def _sentence_after_marker(fact: Fact) -> str:
    """Returns the sentence of an event without what the marker before it says already.

    Args:
        fact: what the event reports, a coded finding.
    """
    # The sentence of an alarm begins with "Alarm:" or "Warning:", as its line does.
    is_alarm = fact.code is SessionFact.ALARM
    # The sentence on the end of an alarm says that it is over. At a landing it also says why, and is not shortened.
    is_end_without_reason = _ends_an_alarm(fact) and not fact.figures.get("is_at_landing")
    if is_alarm or is_end_without_reason:
        fault = fact.figures["reason"]
        return fault.sentence
    flight_date = fact.figures.get("flight_date")
    if fact.code is SessionFact.RECORDING_JUDGED and flight_date:
        # Another vehicle, or another flight of this one, may be watched meanwhile.
        return f"Flight of {flight_date} UTC: {as_clause(fact)}."
    return fact.sentence


def print_line(
    line: str, console: Console, style: str = "", *, indent: int = STAMP_WIDTH
) -> OSError | None:
    """Prints a line at once; where the stream is no terminal it is never wrapped, so that programs can search it.

    On a terminal a long line goes on below its text, so that the times of all lines stand alone in their columns.

    Args:
        line: the line.
        console: standard output or standard error.
        style: style of its text on a terminal, in the notation of Rich.
        indent: characters before the text of the line, which begins with its times; 0 for a line without.

    Returns:
        The error if the line could not be printed; otherwise None. A terminal that was closed, a program that reads no
        more, or a full disk does not end the session, which records the flight.
    """
    try:
        if console.is_terminal and indent:
            line = fill(line, console.width, subsequent_indent=" " * indent, break_on_hyphens=False)
        console.print(Text(line, style), soft_wrap=not console.is_terminal)
    except OSError as error:
        return error
    return None


def style_of_facts(*facts: Fact) -> str:
    """Returns the style in which Rich prints a text about facts: by the worst level that warns; empty if none warns.

    Args:
        *facts: coded findings, each with its level.
    """
    levels = {fact.level for fact in facts}
    for level in (Level.BAD, Level.WATCH):
        if level in levels:
            return LEVEL_STYLES[level]
    return ""
