"""The messages of an MCAP file in the order of the file, also of cut and damaged files as far as possible.

The ``mcap`` package reads sound files and stops at the first wrong length. Here every length is checked, a damaged
record is skipped up to the next place where records follow one another, a cut chunk is read up to the cut, and the
unpacked size of the chunks is bounded. No index is needed. Source: https://mcap.dev/spec.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from typing import NamedTuple

import lz4.frame
import numpy as np
import zstandard

from mavdem.ingest.mavlink.framing import Bytes, Progress, no_progress
from mavdem.ingest.telemetry import repair_sentences

MAGIC = b"\x89MCAP0\r\n"
FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK = 0x02, 0x03, 0x04, 0x05, 0x06
LAST_OPCODE, PRIVATE_OPCODES = 0x0F, 0x80
RECORD_HEAD = struct.Struct("<BQ")  # Opcode and length before each record
MESSAGE_HEAD = struct.Struct("<HIQQ")  # Channel, sequence, log time and publish time before a message's data
CHUNK_HEAD = struct.Struct("<QQQI")
"""First and last time, unpacked size and checksum before a chunk's compression and records."""
PIECE_BYTES = 1 << 20
MAX_CHUNK_BYTES = 1 << 28  # Unpacked bytes of one chunk
MAX_BYTES, MAX_RATIO = 1 << 24, 100
"""Unpacked bytes of all chunks: so many, plus so many per byte of the file. JSON packs to a fiftieth. In memory, the
smallest messages take ten times their bytes."""


class Channel(NamedTuple):
    """The ``topic`` of messages, the ``encoding`` of their data, and the number of their ``schema`` (0 for none)."""

    topic: str
    encoding: str
    schema: int


class Schema(NamedTuple):
    """The type of messages, with its definition, ``text``."""

    name: str
    encoding: str
    text: str


class McapMessage(NamedTuple):
    """One message; ``log_time`` is in UNIX ns, and ``sound`` False in a damaged chunk: the bytes may be wrong."""

    channel: Channel
    log_time: int
    data: bytes
    sound: bool


class _Chunk(NamedTuple):
    """Where a chunk's packed records lie in the file, their compression, unpacked size and checksum."""

    start: int
    end: int
    compression: str
    size: int
    checksum: int

    @classmethod
    def at(cls, content: bytes, start: int, stop: int) -> _Chunk | None:
        """The chunk whose record begins at ``start``; None where its head is cut."""
        if start + CHUNK_HEAD.size > stop:
            return None
        _, _, size, checksum = CHUNK_HEAD.unpack_from(content, start)
        compression, place = _text(content, start + CHUNK_HEAD.size, stop)
        if compression is None or place + 8 > stop:
            return None
        first = place + 8
        return cls(first, first + int.from_bytes(content[place:first], "little"), compression, size, checksum)


@dataclass
class McapRecording:
    """An MCAP file; ``channels`` and ``schemas`` by their number, as far as it was read.

    ``damaged`` is the number of damaged chunks, ``skipped`` that of bytes of no record, ``cut`` whether the end is.
    """

    content: bytes
    channels: dict[int, Channel] = field(default_factory=dict)
    schemas: dict[int, Schema] = field(default_factory=dict)
    damaged: int = 0
    skipped: int = 0
    cut: bool = False
    _allowance: int = 0

    def messages(self, progress: Progress = no_progress) -> Iterator[McapMessage]:
        """Every message whose channel is known, in the order of the file."""
        self._allowance = MAX_BYTES + MAX_RATIO * len(self.content)
        first = len(MAGIC) if self.content.startswith(MAGIC) else 0
        records = list(self._records(self.content, first))
        self.cut |= not records or records[-1][0] != FOOTER
        # The summary at the end repeats channels and schemas, which helps where the first record is damaged.
        for opcode, start, stop in records:
            if opcode in (CHANNEL, SCHEMA):
                self._note(opcode, self.content, start, stop)
        # After damage, messages outside of chunks are the rest of a chunk that has lost its checksum.
        sound = not (self.skipped and any(opcode == CHUNK for opcode, _, _ in records))
        for opcode, start, stop in records:
            if opcode == CHUNK:
                yield from self._in_chunk(start, stop)
                progress(stop / len(self.content))
            elif opcode == MESSAGE:
                message = self._message(self.content, start, stop, sound)
                if message is not None:
                    yield message
        progress(1.0)

    def repairs(self) -> tuple[str, ...]:
        """A sentence for each kind of damage."""
        return repair_sentences(
            (self.damaged, f"{self.damaged} damaged chunks were read as far as possible."),
            (self.skipped, f"{self.skipped} damaged bytes of the recording were skipped."),
            (self.cut, "The recording is cut off at its end; it was read up to the cut."),
        )

    def _records(self, content: bytes, place: int) -> Iterator[tuple[int, int, int]]:
        """Opcode, start and end of the content of each record from ``place`` on; a chunk at the end may be cut."""
        end = len(content)
        data = np.frombuffer(content, dtype=np.uint8)
        while place < end:
            if place + RECORD_HEAD.size <= end:
                opcode, length = RECORD_HEAD.unpack_from(content, place)
                start, stop = place + RECORD_HEAD.size, place + RECORD_HEAD.size + length
                if stop <= end and (0 < opcode <= LAST_OPCODE or opcode >= PRIVATE_OPCODES):
                    yield opcode, start, stop
                    place = stop
                    continue
                # A chunk whose two lengths agree extends beyond the end of the file.
                cut = _Chunk.at(content, start, end) if opcode == CHUNK else None
                if cut is not None and cut.end == stop:
                    self.cut = True
                    yield opcode, start, end
                    return
            if content.startswith(MAGIC, place):
                place += len(MAGIC)
                continue
            following = _next_record(content, data, place + 1)
            if following < end or content is not self.content:
                self.skipped += following - place
            else:
                self.cut = True
            place = following

    def _in_chunk(self, start: int, stop: int) -> Iterator[McapMessage]:
        chunk = _Chunk.at(self.content, start, stop)
        if chunk is None:
            return
        cut = self.cut and stop == len(self.content) < chunk.end
        most = min(self._allowance, MAX_CHUNK_BYTES)
        records, whole = _unpacked(chunk.compression, self.content[chunk.start : min(chunk.end, stop)], most)
        self._allowance -= len(records)
        sound = cut or (whole and len(records) == chunk.size and chunk.checksum in (0, zlib.crc32(records)))
        self.damaged += not sound
        for opcode, inner, end in self._records(records, 0):
            if opcode == MESSAGE:
                message = self._message(records, inner, end, sound)
                if message is not None:
                    yield message
            elif opcode == CHANNEL or (opcode == SCHEMA and sound):
                # One wrong letter in a schema makes every message of a sound chunk wrong.
                self._note(opcode, records, inner, end)

    def _message(self, content: bytes, start: int, stop: int, sound: bool) -> McapMessage | None:
        if start + MESSAGE_HEAD.size > stop:
            return None
        number, _, log_time, _ = MESSAGE_HEAD.unpack_from(content, start)
        if number not in self.channels:
            return None
        return McapMessage(self.channels[number], log_time, content[start + MESSAGE_HEAD.size : stop], sound)

    def _note(self, opcode: int, content: bytes, start: int, stop: int) -> None:
        """Keeps a channel or a schema, if its record is long enough for its texts."""
        number, schema = (int.from_bytes(content[at : at + 2], "little") for at in (start, start + 2))
        name, place = _text(content, start + (4 if opcode == CHANNEL else 2), stop)
        encoding, place = _text(content, place, stop)
        if name is None or encoding is None:
            return
        if opcode == CHANNEL:
            self.channels[number] = Channel(name, encoding, schema)
        elif (text := _text(content, place, stop)[0]) is not None:
            self.schemas[number] = Schema(name, encoding, text)


def _next_record(content: bytes, data: Bytes, place: int) -> int:
    """The first place from ``place`` on where records follow one another; the end without one."""
    search = 1 << 12  # bytes, doubled each time, so that the cost is that of the skipped bytes
    last = len(content) - RECORD_HEAD.size
    while place <= last:
        stop = min(place + search, last + 1)
        opcodes = data[place:stop]
        likely = place + np.flatnonzero((opcodes > 0) & (opcodes <= LAST_OPCODE))
        for high in range(5, 9):  # no record is as long as 4 GiB
            likely = likely[data[likely + high] == 0]
        for candidate in likely.tolist():
            if _follow_one_another(content, candidate):
                return candidate
        place, search = stop, 2 * search
    return len(content)


def _follow_one_another(content: bytes, place: int) -> bool:
    """Whether three records follow one another at a place, or fewer up to the end."""
    for _ in range(3):
        if place == len(content) or content.startswith(MAGIC, place):
            return True
        if place + RECORD_HEAD.size > len(content):
            return False
        opcode, length = RECORD_HEAD.unpack_from(content, place)
        if not 0 < opcode <= LAST_OPCODE:
            return False
        place += RECORD_HEAD.size + length
    return place <= len(content)


def _text(content: bytes, place: int, stop: int) -> tuple[str | None, int]:
    """The text that begins with its length at ``place``, and where it ends; None where it does not fit."""
    if place + 4 > stop:
        return None, stop
    end = place + 4 + int.from_bytes(content[place : place + 4], "little")
    if end > stop:
        return None, stop
    return content[place + 4 : end].decode("utf-8", errors="replace"), end


def _unpacked(compression: str, packed: bytes, most: int) -> tuple[bytes, bool]:
    """The records of a chunk as far as they can be unpacked, and whether they are whole; ``most`` of their bytes."""
    records, whole = bytearray(), compression in ("", "zstd", "lz4")
    with suppress(zstandard.ZstdError, RuntimeError, MemoryError):  # RuntimeError: from lz4
        for piece in _pieces(compression, packed):
            if len(records) + len(piece) > most:
                break
            records += piece
        else:
            return bytes(records), whole
    return bytes(records), False


def _pieces(compression: str, packed: bytes) -> Iterator[bytes]:
    if compression == "":
        yield packed
    elif compression == "zstd":
        with zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True) as reader:
            while piece := reader.read(PIECE_BYTES):
                yield piece
    elif compression == "lz4":
        unpacker = lz4.frame.LZ4FrameDecompressor()
        piece = unpacker.decompress(packed, max_length=PIECE_BYTES)
        while piece:
            yield piece
            piece = b"" if unpacker.eof else unpacker.decompress(b"", max_length=PIECE_BYTES)
