"""Texts that the autopilot sent to its users: MAVLink's STATUSTEXT, DataFlash's MSG and ULog's logged messages."""

from collections.abc import Iterator
from typing import NamedTuple

from mavdem.ingest.telemetry import Columns, Telemetry

SEVERITIES = ("emergency", "alert", "critical", "error", "warning")
"""Names of the MAV_SEVERITY values 0 to 4, which warn of something, the worst first."""


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
