"""What the autopilot itself reports as a problem, as facts (coded findings): its texts, error codes and event codes.

Texts are MAVLink's STATUSTEXT, DataFlash's MSG and ULog's logged messages; error and event codes are DataFlash's ERR
and EV. ``message_patterns.toml`` has the meaning of each.
"""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from mavdem.assessment.repeated_reports import REPEAT_SECONDS
from mavdem.assessment.status_texts import SEVERITIES, StatusText, status_texts
from mavdem.facts import Fact, Level
from mavdem.facts.events import ReportedEvent
from mavdem.files import load_adjacent_toml
from mavdem.ingest.telemetry import Telemetry
from mavdem.ingest.vocabulary import NO_SEVERITY


class TextPattern(NamedTuple):
    """What a text of the autopilot means if a regular expression is found in it."""

    expression: re.Pattern[str]
    """Named groups: numbers (``motor``, ``lane``, ``battery``), the ``watchdog``, what the text is about (``subject``),
    the autopilot's reason (``cause``), its gist (``text``)."""
    code: str
    """Value of the code of :class:`ReportedEvent`; empty for a text that reports the end of a problem."""
    level: Level | None = None
    """Level of the fact; None for the usual level of the code."""
    ended_code: str = ""
    """Value of the code of the problem whose end the text reports; empty for any other text, or where no fact has that
    end."""


def _text_patterns(rows: Iterable[list[str]]) -> list[TextPattern]:
    """Compiles the rows of the table ``texts``.

    Args:
        rows: expression and code of each text. Some have a level besides or, without a code, that of the problem which
            is over.
    """
    patterns = []
    for text, code, *further_values in rows:
        pattern = TextPattern(re.compile(text, re.IGNORECASE), code)
        if further_values and code:
            pattern = pattern._replace(level=Level(further_values[0]))
        elif further_values:
            pattern = pattern._replace(ended_code=further_values[0])
        patterns.append(pattern)
    return patterns


_MEANINGS = load_adjacent_toml(__file__, "message_patterns.toml")
"""The tables ``texts``, ``old_scale``, ``subsystems``, ``events`` and ``reasons`` of the file."""

PATTERNS = _text_patterns(_MEANINGS["texts"])
"""Patterns of texts in order: the first that is found in a text decides what the text means."""

ERROR_SEVERITY = SEVERITIES[3]
"""The severity of the messages ERR, which do not contain a severity."""

PRIMARY_FILTER_SUBSYSTEM = 24
"""Subsystem EKF_PRIMARY of ERR, whose error code is the number of the new lane and not an error: 0 is a lane too."""


class _ProblemEnd(NamedTuple):
    """A text of the autopilot by which a problem is over."""

    time: float
    """Time on the boot clock, s."""
    boot: int
    """Number of the boot."""
    code: str
    """Value of the code of the problem."""


class _Subsystem(NamedTuple):
    """One of ArduPilot's subsystems, which report errors by ERR messages."""

    name: str
    """Its name in ArduPilot's source."""
    event_code: str
    """Code of the event as which its errors are reported."""
    subject: str
    """What such an event is about, such as "compass"."""


class _ErrorMessage(NamedTuple):
    """One ERR message of a DataFlash log."""

    time: float
    """Time on the boot clock, s."""
    boot: int
    """Number of the boot."""
    subsystem: int
    """Number of the subsystem, from 1."""
    error_code: int
    """Number of the error; 0 when the subsystem is without error again."""


def autopilot_messages(telemetry: Telemetry) -> list[StatusText]:
    """Returns all that the autopilot wrote for its users: its texts and, of DataFlash logs, its errors (ERR).

    An error is written as numbers, with the name of its subsystem in ArduPilot's source: "ERR: Subsys 16 (EKFCHECK),
    ECode 2". It has the severity of an error, except with the code 0, by which the subsystem reports that it is over.

    Args:
        telemetry: messages of the vehicle.

    Returns:
        The messages in the order of time; those of an old firmware, whose severities have another scale, without
        severity.
    """
    messages = status_texts(telemetry)
    if _has_old_severities(messages):
        messages = [text._replace(severity=NO_SEVERITY) for text in messages]
    for error in _error_messages(telemetry):
        subsystem = _known_subsystem(error.subsystem)
        subsystem_text = f"{error.subsystem}"
        if subsystem is not None:
            subsystem_text = f"{error.subsystem} ({subsystem.name})"
        is_over = error.error_code == 0 and error.subsystem != PRIMARY_FILTER_SUBSYSTEM
        severity = NO_SEVERITY if is_over else SEVERITIES.index(ERROR_SEVERITY)
        text = f"ERR: Subsys {subsystem_text}, ECode {error.error_code}"
        messages.append(StatusText(error.time, error.boot, severity, text))
    return sorted(messages, key=lambda message: (message.boot, message.time))


def _has_old_severities(texts: Iterable[StatusText]) -> bool:
    """Returns whether the texts are of ArduPilot before 3.4, whose severities have another scale than MAV_SEVERITY."""
    return any(text.text in _MEANINGS["old_scale"] for text in texts)


def reported_problems(telemetry: Telemetry) -> list[Fact]:
    """Collects what the autopilot itself reports as a problem, in texts and in DataFlash's errors and events.

    Args:
        telemetry: messages of the vehicle.

    Returns:
        A fact (coded finding) for each report. It has the figures ``boot`` and ``basis``, the names of the messages
        that it rests on. Facts of texts have the ``text`` itself and the name of its ``severity`` too.
    """
    problems = [
        *_problems_of_texts(telemetry),
        *_problems_of_errors(telemetry),
        *_problems_of_events(telemetry),
    ]
    # Errors do not state whether a battery is low or critical; a text at the same time does.
    return _with_battery_levels(problems)


def _with_battery_levels(facts: Sequence[Fact]) -> list[Fact]:
    """Turns battery failsafes into warnings if a text at the time calls the battery low, not critical.

    ArduPilot reports the same failsafe, by an ERR message or a text, for a low and for a critical battery. A text about
    the battery near it (:func:`_is_close`) says which of the two it was; without a text it counts as critical.

    Args:
        facts: facts (coded findings) on problems that the autopilot reports.

    Returns:
        The same facts in the same order. A failsafe of a low battery has the code ``BATTERY_WARNED`` instead of
        ``BATTERY_ALARMED``, and the level of that code.
    """
    low_battery_texts = [fact for fact in facts if fact.code is ReportedEvent.BATTERY_WARNED]
    corrected_facts = []
    for fact in facts:
        is_failsafe = fact.code is ReportedEvent.BATTERY_ALARMED and reports_failsafe(fact)
        if is_failsafe and any(_is_close(fact, text) for text in low_battery_texts):
            fact = fact.with_code(ReportedEvent.BATTERY_WARNED)
        corrected_facts.append(fact)
    return corrected_facts


def reports_failsafe(alarm: Fact) -> bool:
    """Returns whether an alarm of the battery is an act of the autopilot: a failsafe, by an error code or in words."""
    text = alarm.figures.get("text") or ""
    return "error_code" in alarm.figures or "failsafe" in text.lower()


def _is_close(earlier_fact: Fact, later_fact: Fact) -> bool:
    """Returns whether two facts (coded findings) are of one boot, and begin within ``REPEAT_SECONDS`` of each other."""
    is_same_boot = earlier_fact.figures["boot"] == later_fact.figures["boot"]
    distance = abs(earlier_fact.start_time - later_fact.start_time)
    return is_same_boot and distance <= REPEAT_SECONDS


def _problems_of_texts(telemetry: Telemetry) -> Iterator[Fact]:
    """Yields the problems that the autopilot's texts report, each as a fact: a code with figures.

    The meaning of known texts is recognised by patterns. Other texts are quoted if their severity is a warning or
    worse. ArduPilot before 3.4 had severities on another scale, so that they do not show which of its texts warn;
    such a firmware is recognised by texts that only it sends. A problem whose end a later text reports has that time as
    its end, and the figure ``is_over``.

    Args:
        telemetry: messages of the vehicle.
    """
    message_name = telemetry.name_in_source("STATUSTEXT")
    texts = status_texts(telemetry)
    has_old_scale = _has_old_severities(texts)
    problem_ends = _problem_ends(texts)
    for text in texts:
        severity = None
        # Severities count from 0, an emergency. ``SEVERITIES`` are the names of those that are a warning or worse.
        is_warning = text.severity < len(SEVERITIES)
        if is_warning and not has_old_scale:
            severity = SEVERITIES[text.severity]
        fact = _problem_of_text(text, warns=severity is not None)
        if fact is None:
            continue
        fact = fact.replace(boot=text.boot, basis=(message_name,), severity=severity)
        end_time = _end_of_problem(fact, problem_ends)
        if end_time is not None:
            fact = fact.replace(end_time=end_time, is_over=True)
        yield fact


def _problem_ends(texts: Iterable[StatusText]) -> list[_ProblemEnd]:
    """Returns the texts of the autopilot by which a problem is over, such as "Glitch cleared".

    Args:
        texts: all texts, in the order of the stream.
    """
    problem_ends = []
    for text in texts:
        pattern = _first_pattern(text)
        if pattern is not None and pattern.ended_code:
            problem_ends.append(_ProblemEnd(text.time, text.boot, pattern.ended_code))
    return problem_ends


def _end_of_problem(problem: Fact, problem_ends: Iterable[_ProblemEnd]) -> float | None:
    """Returns when a problem was over by a text of the autopilot, s since boot; None without such a text.

    Args:
        problem: fact that was made from a text.
        problem_ends: all texts by which a problem is over, in the order of the stream.
    """
    for problem_end in problem_ends:
        is_same_problem = problem_end.code == problem.code
        is_same_boot = problem_end.boot == problem.figures["boot"]
        if is_same_problem and is_same_boot and problem_end.time >= problem.start_time:
            return problem_end.time
    return None


def _first_pattern(message: StatusText) -> TextPattern | None:
    """Returns the first of the ``PATTERNS`` that is found in a text; None if none is."""
    for pattern in PATTERNS:
        if pattern.expression.search(message.text):
            return pattern
    return None


def _problem_of_text(message: StatusText, *, warns: bool) -> Fact | None:
    """Returns the problem that a text reports, by the first of the ``PATTERNS`` found in it.

    Args:
        message: text that the autopilot sent, with its time and severity.
        warns: whether its severity is a warning or worse. Such a text is quoted if no pattern fits.

    Returns:
        The fact (coded finding); None for a text that reports no problem, or the end of one.
    """
    pattern = _first_pattern(message)
    if pattern is None:
        if warns:
            return Fact(ReportedEvent.AUTOPILOT_SAID, time=message.time, text=message.text)
        return None
    if not pattern.code:
        # The text reports the end of a problem.
        return None
    match = pattern.expression.search(message.text)
    assert match is not None
    captured_texts = match.groupdict()
    problem = Fact(
        ReportedEvent(pattern.code),
        pattern.level,
        time=message.time,
        subject=_subject_of_text(captured_texts),
        text=captured_texts.get("text", message.text),
    )
    if captured_texts.get("cause"):
        return problem.replace(cause=captured_texts["cause"])
    return problem


def _subject_of_text(groups: Mapping[str, str | None]) -> str:
    """Returns what a text is about, such as "motor 2" or "watchdog", in lower case; empty if it names nothing.

    Args:
        groups: named groups of the pattern that fits the text (:attr:`TextPattern.expression`); None for a group that
            was not found in it.
    """
    if groups.get("watchdog"):
        return "watchdog"
    subject = groups.get("subject")
    if subject:
        return subject.lower()
    for numbered_part in ("motor", "lane", "battery"):
        number = groups.get(numbered_part)
        if number:
            return f"{numbered_part} {number}".lower()
    return ""


def _problems_of_errors(telemetry: Telemetry) -> Iterator[Fact]:
    """Yields the problems that ArduPilot logs as ERR messages, each as a fact (coded finding) with its start and end.

    An ERR message has the number of a subsystem and an error code. The code 0 means that an error of this subsystem is
    over, so a problem lasts until the same subsystem logs 0 in the same boot. One subsystem is different: it reports
    which lane (instance) of the EKF is the primary one, with the number of the lane as code. There 0 is a lane too, and
    the change has no end.

    Args:
        telemetry: messages of the vehicle.
    """
    messages = _error_messages(telemetry)
    for message in messages:
        problem = _problem_of_error(message)
        if message.subsystem == PRIMARY_FILTER_SUBSYSTEM:
            yield problem.replace(subject=f"lane {message.error_code}")
        elif message.error_code != 0:
            yield problem.replace(end_time=_end_of_error(message, messages))


def _problem_of_error(message: _ErrorMessage) -> Fact:
    """Returns the problem that an ERR message of ArduPilot reports, without its end.

    Args:
        message: the message. If the table of meanings lacks its subsystem, the problem is a general error of the
            autopilot, whose subject is the number of the subsystem.
    """
    event_code = ReportedEvent.AUTOPILOT_ERROR
    subject = f"{message.subsystem}"
    subsystem = _known_subsystem(message.subsystem)
    if subsystem is not None:
        event_code = ReportedEvent(subsystem.event_code)
        subject = subsystem.subject
    return Fact(
        event_code,
        time=message.time,
        subject=subject,
        error_code=message.error_code,
        boot=message.boot,
        basis=("ERR",),
        severity=ERROR_SEVERITY,
    )


def _error_messages(telemetry: Telemetry) -> list[_ErrorMessage]:
    """Returns the ERR messages of a DataFlash log in their order; empty for other logs."""
    rows = _rows_of_message(telemetry, "ERR", "Subsys", "ECode")
    return [_ErrorMessage(*row) for row in rows]


def _known_subsystem(number: int) -> _Subsystem | None:
    """Returns one of ArduPilot's subsystems by its number in ERR messages, from 1; None if it is not in the table."""
    subsystems = _MEANINGS["subsystems"]
    if not 1 <= number <= len(subsystems):
        return None
    return _Subsystem(*subsystems[number - 1])


def _end_of_error(error: _ErrorMessage, messages: Sequence[_ErrorMessage]) -> float | None:
    """Returns when an error of a subsystem was over: at its next message with the error code 0 in the same boot.

    Args:
        error: the message that reported it.
        messages: all ERR messages of the log, in any order.

    Returns:
        The time, s since boot; None if the log does not show it.
    """
    end_times = []
    for message in messages:
        is_same_source = message.subsystem == error.subsystem and message.boot == error.boot
        if is_same_source and message.error_code == 0 and message.time > error.time:
            end_times.append(message.time)
    return min(end_times, default=None)


def _problems_of_events(telemetry: Telemetry) -> Iterator[Fact]:
    """Yields the problems that ArduPilot logs as EV messages.

    An EV message has the number of an event. The table ``events`` of ``message_patterns.toml`` has the meaning of
    events that report a problem; all others, such as "armed", are skipped.

    Args:
        telemetry: messages of the vehicle.
    """
    for time, boot, number in _rows_of_message(telemetry, "EV", "Id"):
        meaning = _MEANINGS["events"].get(str(number))
        if meaning:
            code, subject = meaning
            yield Fact(ReportedEvent(code), time=time, subject=subject, boot=boot, basis=("EV",))


class ModeChangeReason(NamedTuple):
    """Why the autopilot changed the flight mode."""

    text: str
    """The reason in words; empty if it is not known."""

    level: Level
    """How serious it is: a mode that the pilot selected is good, one that a failsafe selected is not."""


def mode_change_reason(number: float | None) -> ModeChangeReason:
    """Looks up why ArduPilot changed the flight mode.

    Args:
        number: the field ``Rsn`` of the message MODE, ArduPilot's ModeReason; None or 0 if it is not known.
    """
    # The table of ``message_patterns.toml`` has the reasons by their number.
    reasons = _MEANINGS["reasons"]
    if not number or int(number) >= len(reasons):
        return ModeChangeReason("", Level.GOOD)
    text, level = reasons[int(number)]
    return ModeChangeReason(text, Level(level))


def _rows_of_message(telemetry: Telemetry, message: str, *fields: str) -> Iterator[Any]:
    """Yields each message of one type in a DataFlash log as a tuple of values; nothing for other logs.

    Args:
        telemetry: messages of the vehicle.
        message: name of the message, such as "ERR".
        fields: names of its fields, whose values follow time (s since boot) and boot in the tuple.
    """
    columns = telemetry.messages.get(message)
    if columns is None:
        return
    values_of_fields = [columns[name].tolist() for name in ("time", "boot", *fields)]
    yield from zip(*values_of_fields, strict=True)
