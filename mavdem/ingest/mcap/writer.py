"""Writing MCAP: a recorded stream as frames and BlueOS's JSON topics, and series of numbers for viewers.

The frames, in the channel ``mavlink/raw`` with the message encoding ``mavlink``, are the recording: one message each,
with the receive stamp as log time. The JSON topics, ``mavlink/{system}/{component}/{MESSAGE}``, repeat them for
viewers; numbers that JSON lacks are null there.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from itertools import repeat
from typing import Any, BinaryIO

import numpy as np
from mcap.writer import Writer
from numpy.typing import NDArray
from pymavlink.dialects.v20 import all as dialect

from mavdem.ingest.contents import require_whole
from mavdem.ingest.mavlink.definitions import MessageDefinition, columns, definitions
from mavdem.ingest.mavlink.framing import GOOD
from mavdem.ingest.mavlink.vehicles import FrameStream

HEADER_FIELDS = ("system_id", "component_id", "sequence", "message_id")
CHUNK = 1 << 20  # Bytes that are compressed together by default
BATCH = 1 << 13  # Frames whose JSON is held at a time
MAX_STAMP = 2**64 // 1000 - 1  # The last receive stamp, µs, that 64 bits of nanoseconds hold: the year 2554
Series = tuple[NDArray[np.float64], Mapping[str, NDArray[np.float64]]]  # Times (T,), s, and columns (T,) by name


def write_mcap(file: BinaryIO, stream: FrameStream) -> int:
    """Writes every frame with its stamp, and the dialect's messages as JSON; returns the number of frames.

    A stamp beyond the year 2554, which MCAP cannot hold, becomes that of the frame before.
    """
    writer = started(file)
    raw = raw_channel(writer)
    channels: dict[str, int] = {}
    frames = stream.stamped_frames()
    rows = np.flatnonzero(stream.frames.end > stream.frames.start)
    last = 0
    for begin in range(0, len(rows), BATCH):
        batch = rows[begin : begin + BATCH]
        require_whole(stream.data, stream.source)
        for row, (topic, body) in zip(batch.tolist(), _bodies(stream, batch), strict=True):
            stamp, frame = next(frames)
            last = stamp if stamp <= MAX_STAMP else last
            write_message(writer, raw, last * 1000, frame)
            if topic is not None:
                if topic not in channels:
                    channels[topic] = _registered(writer, topic, _schema(stream, row))
                write_message(writer, channels[topic], last * 1000, json.dumps(body).encode())
    writer.finish()  # type: ignore[no-untyped-call]
    return len(rows)


def write_series(file: BinaryIO, series: Mapping[str, Series]) -> None:
    """Writes columns over time, s from 0 on, by topic as JSON, one message a row; a value not finite becomes null."""
    writer = started(file)
    queue: list[tuple[float, int, str]] = []
    for topic, (time, named) in series.items():
        channel = _registered(writer, topic, _object({name: {"type": "number"} for name in named}))
        # A column's numbers become text together; a row only puts them in their places.
        row = "{" + ", ".join(json.dumps(name).replace("%", "%%") + ": %s" for name in named) + "}"
        texts = [json.dumps(_numbers(column))[1:-1].split(", ") for column in named.values()]
        queue += zip(time.tolist(), repeat(channel), map(row.__mod__, zip(*texts, strict=True)))
    for at, channel, body in sorted(queue, key=lambda entry: entry[0]):
        write_message(writer, channel, round(at * 1e9), body.encode())
    writer.finish()  # type: ignore[no-untyped-call]


def started(file: BinaryIO, chunk: int = CHUNK) -> Writer:
    """Returns a writer of messages in chunks of ``chunk`` bytes; ``finish`` ends it."""
    writer = Writer(file, chunk_size=chunk)
    writer.start(library="mavdem")
    return writer


def raw_channel(writer: Writer) -> int:
    """Returns a new channel of frames."""
    return writer.register_channel("mavlink/raw", "mavlink", schema_id=0)


def write_message(writer: Writer, channel: int, time: int, data: bytes) -> None:
    """Writes a message of a channel, at a time in ns."""
    writer.add_message(channel, log_time=time, data=data, publish_time=time)


def _registered(writer: Writer, topic: str, schema: Mapping[str, Any]) -> int:
    """A new JSON channel; a viewer plots the fields in its schema."""
    number = writer.register_schema(topic.replace("/", "."), "jsonschema", json.dumps(schema).encode())
    return writer.register_channel(topic, "json", number)


def _bodies(stream: FrameStream, rows: NDArray[np.int64]) -> list[tuple[str | None, dict[str, Any]]]:
    frames = stream.frames[rows]
    bodies: list[tuple[str | None, dict[str, Any]]] = [(None, {})] * len(rows)
    for message_id in np.unique(frames.message_id[frames.verdict == GOOD]).tolist():
        definition = definitions()[message_id]
        same = np.flatnonzero((frames.message_id == message_id) & (frames.verdict == GOOD))
        values = columns(stream.data, frames.start[same], definition)
        values_by_row = zip(*(_values(values[name], definition, name) for name in definition.fields), strict=True)
        keys = [_key(name) for name in definition.fields]
        for at, row in zip(same.tolist(), values_by_row, strict=True):
            system, component, sequence = (int(n[at]) for n in (frames.system, frames.component, frames.sequence))
            header = dict(zip(HEADER_FIELDS, (system, component, sequence, message_id), strict=True))
            message = {"type": definition.name, **dict(zip(keys, row, strict=True))}
            bodies[at] = f"mavlink/{system}/{component}/{definition.name}", {"header": header, "message": message}
    return bodies


def _key(name: str) -> str:
    """A field's name in BlueOS's JSON, where ``type`` is the message's."""
    return "mavtype" if name == "type" else name


def _values(column: NDArray[Any], definition: MessageDefinition, name: str) -> list[Any]:
    if column.dtype.kind == "S":
        return [value.decode("utf-8", errors="replace") for value in column.tolist()]
    if column.dtype.kind == "f":
        return _numbers(column)
    entries, listed = _entries(definition, name) if column.ndim == 1 else {}, column.tolist()
    return [{"type": entries[value]} if value in entries else value for value in listed] if entries else listed


def _entries(definition: MessageDefinition, name: str) -> dict[int, str]:
    """The names of the values of an enum field; empty for a bitmask and for other fields."""
    message = dialect.mavlink_map[definition.message_id]
    enum = message.fieldenums_by_name.get(name)
    if enum is None or message.fielddisplays_by_name.get(name) == "bitmask":
        return {}
    return {value: entry.name for value, entry in dialect.enums[enum].items() if not entry.name.endswith("_ENUM_END")}


def _numbers(column: NDArray[Any]) -> list[Any]:
    """Floats in the fewest digits that are exact in their own width; None for a value that is not finite."""
    if column.ndim > 1:
        return [_numbers(row) for row in column]
    digits = column.astype("U32").tolist() if column.dtype.itemsize == 4 else column.tolist()
    return [float(text) if good else None for text, good in zip(digits, np.isfinite(column).tolist(), strict=True)]


def _schema(stream: FrameStream, row: int) -> dict[str, Any]:
    definition = definitions()[int(stream.frames.message_id[row])]
    header = _object({name: {"type": "integer"} for name in HEADER_FIELDS})
    fields = {_key(name): _field_schema(definition, name) for name in definition.fields}
    return _object({"header": header, "message": _object({"type": {"type": "string"}, **fields})})


def _field_schema(definition: MessageDefinition, name: str) -> dict[str, Any]:
    kind = definition.wire[name]
    if kind.kind == "S":
        return {"type": "string"}
    if kind.subdtype is not None:
        return {"type": "array", "items": {"type": "number"}}
    return _object({"type": {"type": "string"}}) if _entries(definition, name) else {"type": "number"}


def _object(properties: Mapping[str, Any]) -> dict[str, Any]:
    return {"type": "object", "properties": dict(properties)}
