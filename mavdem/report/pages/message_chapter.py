"""The chapter of a flight's page with what the autopilot itself wrote: its texts and errors, as in its log."""

from collections.abc import Sequence
from typing import NamedTuple

from mavdem.assessment.autopilot_messages import autopilot_messages
from mavdem.assessment.status_texts import SEVERITIES, StatusText
from mavdem.facts import Level
from mavdem.ingest.telemetry import Telemetry
from mavdem.report.blocks import Moment, Rated, Sentence, Table, truncated
from mavdem.report.pages.page import Chapter

MESSAGES_TITLE = "Autopilot messages"
"""Title of the chapter."""

SEVERITY_NAMES = (*SEVERITIES, "notice", "info", "debug")
"""Names of the MAV_SEVERITY values 0 to 7."""

MAX_MESSAGES = 300
"""Largest number of messages that a page lists: a choice, four times as many as in a usual log."""

MAX_TEXT_LENGTH = 500
"""Characters of a text that a page shows: ten times those of a STATUSTEXT. Damaged logs may have far longer ones."""


class RepeatedMessage(NamedTuple):
    """A message that the autopilot wrote once, or several times in a row."""

    message: StatusText
    """The first one."""

    total: int
    """How many there are in the row."""

    @property
    def is_warning(self) -> bool:
        """Whether the severity of the message is a warning or worse."""
        return self.message.severity < len(SEVERITIES)


def messages_chapter(telemetry: Telemetry, charts_boot: int | None) -> Chapter:
    """Returns the chapter with the texts that the autopilot itself wrote into the log, in a table that can be searched.

    Paper has the warnings among them.

    Args:
        telemetry: messages of the vehicle.
        charts_boot: boot, from 0, on whose clock the plots of the page are; None without plots.

    Returns:
        The chapter; it has no content if the log has no such messages.
    """
    all_messages = _without_repetitions(autopilot_messages(telemetry))
    if not all_messages:
        return Chapter(MESSAGES_TITLE)
    messages = _most_important(all_messages)
    blocks = []
    if len(messages) < len(all_messages):
        blocks.append(
            Sentence(
                f"{len(messages)} of {len(all_messages)} messages are listed: warnings first of all, and the earliest."
            )
        )
    return Chapter(
        MESSAGES_TITLE,
        blocks,
        folded=True,
        searchable=_message_table(messages, charts_boot),
    )


def _without_repetitions(messages: Sequence[StatusText]) -> list[RepeatedMessage]:
    """Joins messages of the autopilot that repeat the one before them: one message remains of them, with their number.

    Args:
        messages: the messages in the order of time. A repetition has the same text and severity, and is of the same
            boot; only its time differs.

    Returns:
        The remaining messages, each with the time of the first of its repetitions, in the order of time.
    """
    counted_messages: list[RepeatedMessage] = []
    for message in messages:
        if counted_messages:
            previous_message, total = counted_messages[-1]
            is_repetition = message._replace(time=previous_message.time) == previous_message
            if is_repetition:
                counted_messages[-1] = RepeatedMessage(previous_message, total + 1)
                continue
        counted_messages.append(RepeatedMessage(message, 1))
    return counted_messages


def _most_important(messages: Sequence[RepeatedMessage]) -> list[RepeatedMessage]:
    """Returns at most ``MAX_MESSAGES`` in their order: warnings first of all, and of equals the earliest."""
    # The sort is stable, so that messages of one kind stay in their order.
    indices = sorted(range(len(messages)), key=lambda index: not messages[index].is_warning)
    return [messages[index] for index in sorted(indices[:MAX_MESSAGES])]


def _message_table(messages: Sequence[RepeatedMessage], charts_boot: int | None) -> Table:
    """Returns the table of messages: time, level, text, and how often each came in a row.

    The column of levels is left out if no message has one, as is that of counts if nothing was repeated.

    Args:
        messages: the messages in their order.
        charts_boot: boot on whose clock the plots are; None without plots.
    """
    boots = {entry.message.boot for entry in messages}
    has_levels = any(entry.message.severity < len(SEVERITY_NAMES) for entry in messages)
    has_repetitions = any(entry.total > 1 for entry in messages)
    header = ["time"]
    if has_levels:
        header.append("level")
    header.append("text")
    if has_repetitions:
        header.append("in a row")
    rows = []
    for entry in messages:
        row: list[str] = [_moment(entry.message, charts_boot, has_one_boot=len(boots) == 1)]
        if has_levels:
            row.append(_level(entry))
        row.append(truncated(entry.message.text, MAX_TEXT_LENGTH))
        if has_repetitions:
            row.append(f"{entry.total} times" if entry.total > 1 else "")
        rows.append(row)
    return Table(header, rows, words=True)


def _moment(message: StatusText, charts_boot: int | None, *, has_one_boot: bool) -> str:
    """Returns when a message was written, with its boot where there are several.

    It leads to the plots of the page if they are on the clock of its boot.

    Args:
        message: the message.
        charts_boot: boot on whose clock the plots are; None without plots.
        has_one_boot: whether all messages are of one boot.
    """
    text = f"{message.time:.1f} s"
    if not has_one_boot:
        text = f"boot {message.boot + 1}, {text}"
    if message.boot == charts_boot:
        return Moment(text, message.time)
    return text


def _level(entry: RepeatedMessage) -> str:
    """Returns the table cell with the severity of a message, such as "warning"; empty if the severity is not known.

    A warning, or worse, has the colour of what is to be watched. It never has the colour of what is bad, since
    autopilots call harmless events "critical", such as that they refuse to arm.

    Args:
        entry: the message, with its severity by MAVLink's numbers, from 0 (emergency) on.
    """
    severity = entry.message.severity
    if severity >= len(SEVERITY_NAMES):
        return ""
    name = SEVERITY_NAMES[severity]
    return Rated(name, Level.WATCH) if entry.is_warning else name
