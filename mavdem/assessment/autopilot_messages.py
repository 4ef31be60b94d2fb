"""What the autopilot itself reports as a problem, as facts (coded findings): its texts, error codes and event codes.

Texts are MAVLink's STATUSTEXT, DataFlash's MSG and ULog's logged messages; error and event codes are DataFlash's ERR
and EV. ``message_patterns.toml`` has the meaning of each.
"""

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from math import inf
from typing import Any, NamedTuple

from mavdem.facts import Fact, Level
from mavdem.facts.events import ReportedEvent
from mavdem.files import load_adjacent_toml
from mavdem.ingest.telemetry import Columns, Telemetry
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

SEVERITIES = ("emergency", "alert", "critical", "error", "warning")
"""Names of the MAV_SEVERITY values 0 to 4, which warn of something, the worst first."""

ERROR_SEVERITY = SEVERITIES[3]
"""The severity of the messages ERR, which do not contain a severity."""

PRIMARY_FILTER_SUBSYSTEM = 24
"""Subsystem EKF_PRIMARY of ERR, whose error code is the number of the new lane and not an error: 0 is a lane too."""

REPEAT_SECONDS = 30.0
"""Seconds within which the same report is a repetition of the earlier one: autopilots repeat a warning that persists
every 5 to 30 s."""

ACTIVATION_PAUSE = 5.0
"""Seconds without a state after which its next report is another event: a choice, a few reports of a state at 1 Hz.

Autopilots report a failsafe, or a state whose end they report too, when it begins and do not repeat that.
"""

CODES_WITH_TEXT = (ReportedEvent.AUTOPILOT_SAID, ReportedEvent.ARMING_REFUSED)
"""Codes whose facts quote the autopilot: two of them with different texts are different events."""


class StatusText(NamedTuple):
    """One text of the autopilot."""

    time: float
    """Time on the boot clock, s."""
    boot: int
    """Number of the boot."""
    severity: int
    """MAV_SEVERITY, 0 for an emergency to 7 for debugging; 255 if it is not known."""
    text: str
    """The text without surrounding blanks."""


class _TextChunk(NamedTuple):
    """One message STATUSTEXT: a whole text, or a chunk of one that is longer than a message."""

    time: float
    """Time on the boot clock, s."""
    boot: int
    """Number of the boot."""
    severity: int
    """MAV_SEVERITY."""
    text_id: int
    """Number that all chunks of one text have; 0 for a text in one message."""
    number: int
    """Number of the chunk in its text, from 0."""
    content: str | bytes
    """The characters."""


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


def status_texts(telemetry: Telemetry) -> list[StatusText]:
    """Returns all texts that the autopilot sent as MAVLink messages STATUSTEXT, in the order of the stream.

    One message holds 50 characters. A longer text is sent in chunks, one message each, which are joined here: the
    chunks of a text have the same ``id``, which is not 0, and are numbered by ``chunk_seq`` from 0. A text that fits
    into one message has the id 0.

    Args:
        telemetry: messages of the vehicle.

    Returns:
        The texts, each with the time (s since boot), boot and severity of its first chunk; empty if none was logged.
    """
    columns = telemetry.messages.get("STATUSTEXT", {})
    if "text" not in columns:
        return []
    texts: list[StatusText] = []
    # The index in ``texts`` of the latest text with each id.
    latest_index = dict[int, int]()
    for chunk in _text_chunks(columns):
        characters = chunk.content
        if isinstance(characters, bytes):
            characters = characters.decode(errors="replace")
        # Autopilots use an id again for another text, whose first chunk has the number 0.
        continues_text = chunk.text_id != 0 and chunk.number != 0 and chunk.text_id in latest_index
        if continues_text:
            index = latest_index[chunk.text_id]
            texts[index] = texts[index]._replace(text=texts[index].text + characters)
        else:
            latest_index[chunk.text_id] = len(texts)
            texts.append(StatusText(chunk.time, chunk.boot, chunk.severity, characters))
    return [text._replace(text=text.text.strip()) for text in texts]


def _text_chunks(columns: Columns) -> Iterator[_TextChunk]:
    """Yields the messages STATUSTEXT of a log.

    Args:
        columns: the messages as columns, by name of the field. Older logs lack some fields, such as ``id``; such a
            field is 0 in all messages.
    """
    message_count = len(columns["time"])
    fields = []
    for field_name in ("time", "boot", "severity", "id", "chunk_seq", "text"):
        if field_name in columns:
            fields.append(columns[field_name].tolist())
        else:
            fields.append([0] * message_count)
    for values in zip(*fields, strict=True):
        yield _TextChunk(*values)


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


def in_time_order(facts: Iterable[Fact]) -> list[Fact]:
    """Returns the facts (coded findings) sorted by boot and, within a boot, by time."""
    return sorted(facts, key=lambda fact: (fact.figures["boot"], fact.time))


def merge_repeats(facts: Iterable[Fact]) -> list[Fact]:
    """Merges the repetitions of a report into its first fact.

    Autopilots repeat a warning while its cause persists, and report one problem by several messages. Two facts (coded
    findings) are one report if they have the same boot and code (and text, for ``CODES_WITH_TEXT``), no contrary
    subjects, and follow each other within ``REPEAT_SECONDS``. If one of them is a failsafe or has an end of its own,
    such as a loss of GPS with its return, they must follow within ``ACTIVATION_PAUSE``: else the merged state would
    last through the pause. The merged fact has the number of reports as ``count``, and ends with the last of them.

    Args:
        facts: facts that report messages of the autopilot, in any order.

    Returns:
        The remaining facts in time order, each with its ``count``, 1 for a report without repetitions.
    """
    merged_facts: list[Fact] = []
    # The indices in ``merged_facts`` of facts with the same boot, code and quoted text.
    indices_by_kind = defaultdict[tuple[Any, ...], list[int]](list)
    # The indices in ``merged_facts`` of failsafes and of facts of which a report had an end of its own.
    state_indices = set[int]()
    for fact in in_time_order(facts):
        quoted_text = fact.figures["text"] if fact.code in CODES_WITH_TEXT else ""
        indices = indices_by_kind[fact.figures["boot"], fact.code, quoted_text]
        is_state = fact.code is ReportedEvent.FAILSAFE or fact.end_time is not None
        repeated_index = None
        # The latest report of the kind comes first: it is the one that is repeated, if any.
        for index in reversed(indices):
            concerns_state = is_state or index in state_indices
            longest_pause = ACTIVATION_PAUSE if concerns_state else REPEAT_SECONDS
            if _is_repetition(merged_facts[index], fact, longest_pause):
                repeated_index = index
                break
        if repeated_index is None:
            repeated_index = len(merged_facts)
            indices.append(repeated_index)
            merged_facts.append(fact.replace(count=1))
        else:
            merged_facts[repeated_index] = _merged_pair(merged_facts[repeated_index], fact)
        if is_state:
            state_indices.add(repeated_index)
    return merged_facts


def _last_time(fact: Fact) -> float:
    """Returns the latest time of a fact, s: its end if it has one, otherwise its time; infinite for a permanent one."""
    if "is_permanent" in fact.figures:
        return inf
    return max(time for time in (fact.time, fact.end_time) if time is not None)


def _is_repetition(earlier_report: Fact, later_report: Fact, longest_pause: float) -> bool:
    """Returns whether ``later_report`` repeats ``earlier_report``, a fact (a coded finding) of the same code.

    It does if it follows within ``longest_pause`` and is about the same subject, such as "motor 2". A report that names
    no subject may be about the subject of the other report.

    Args:
        earlier_report: the first report.
        later_report: the one that may repeat it.
        longest_pause: time, s, between the end of the first and the start of the other.
    """
    subjects_agree = (
        earlier_report.subject == later_report.subject
        or not earlier_report.subject
        or not later_report.subject
    )
    return subjects_agree and later_report.start_time - _last_time(earlier_report) <= longest_pause


def _merged_pair(first_report: Fact, repetition: Fact) -> Fact:
    """Merges the repetition of a report into the first fact of it, so that it is shown once with its count.

    Args:
        first_report: the report, with the figures ``basis`` (names of messages) and ``count``.
        repetition: a later fact of the same code, with ``basis``.

    Returns:
        A fact (coded finding) with the time of the first one, the later end, the worse level, the messages of both, a
        subject if either has one, and a count that is one higher. All other figures are taken from the first fact.
    """
    # Levels are defined in the order good, watch, bad, unknown.
    levels = list(Level)
    level = max(first_report.level, repetition.level, key=levels.index)
    end_time: float | None = max(_last_time(first_report), _last_time(repetition))
    if end_time in (first_report.time, inf):
        # Both are of one time, or the fault never ends: then the fact has no end.
        end_time = None
    message_names = (*first_report.figures["basis"], *repetition.figures["basis"])
    figures = {**repetition.figures, **first_report.figures}
    if "is_over" in figures:
        # A problem that was over and is reported again goes on.
        figures["is_over"] = repetition.figures.get("is_over", False)
    # A dictionary keeps each name once, in order.
    figures["basis"] = tuple(dict.fromkeys(message_names))
    figures["count"] = first_report.figures["count"] + 1
    return first_report.replace(
        level,
        end_time=end_time,
        subject=first_report.subject or repetition.subject,
        **figures,
    )
