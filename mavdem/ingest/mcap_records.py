"""The messages of an MCAP file in the order of the file, of cut and damaged files as far as they go.

The ``mcap`` package reads sound files; on the first wrong length it stops. Here every length is held against what is
there, a damaged record is stepped over to where records follow one another again, a cut chunk is read up to the cut,
and what the chunks unpack to is bounded. No index is needed.

Source: https://mcap.dev/spec.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import lz4.frame
import numpy as np
import zstandard

from mavdem.ingest.checksum import Bytes
from mavdem.ingest.framing import Progress

MAGIC = b"\x89MCAP0\r\n"
FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK = 0x02, 0x03, 0x04, 0x05, 0x06
LAST_OPCODE, PRIVATE_OPCODES = 0x0F, 0x80
HEAD = struct.Struct("<BQ")
"""Opcode and length before each record."""
MESSAGE_HEAD = struct.Struct("<HIQQ")
"""Channel, sequence, log time and publish time before a message's data."""
CHUNK_HEAD = struct.Struct("<QQQI")
"""First and last time, unpacked size and checksum before a chunk's compression and records."""
IN_A_ROW = 3
"""Records that must follow one another for a place behind damage to be the beginning of one."""
FIRST_SEARCH = 1 << 12
"""Bytes searched at first for the next record; doubled each time, so that a search costs what it steps over."""
PIECE = 1 << 20
MOST_TOPICS_TOLD, LONGEST_TOLD = 5, 80
"""Topics that a sentence names, and characters of each."""
MOST_IN_A_CHUNK = 1 << 28
MOST_IN_ALL, MOST_RATIO = 1 << 24, 100
"""Bytes that chunks may unpack to together: so many, and so many more a byte of the file. JSON packs to a fiftieth.

Read, the smallest messages take ten times their bytes."""


class Channel(NamedTuple):
    """Where messages come from: their ``topic``, the ``encoding`` of their data, and their ``schema`` (0 for none)."""

    topic: str
    encoding: str
    schema: int


class Schema(NamedTuple):
    """How messages are laid out: the ``name`` of their type and its definition, ``text``, in the ``encoding`` named."""

    name: str
    encoding: str
    text: str


class Message(NamedTuple):
    """One message.

    Attributes:
        channel: where it comes from.
        log_time: UNIX nanoseconds at which it was recorded.
        data: its bytes.
        vouched: False in a chunk that is damaged somewhere: its bytes may be wrong.
    """

    channel: Channel
    log_time: int
    data: bytes
    vouched: bool


@dataclass
class Damage:
    """What was found wrong: ``chunks`` that are damaged, ``skipped`` bytes of no record, whether the end is ``cut``."""

    chunks: int = 0
    skipped: int = 0
    cut: bool = False

    def sentences(self) -> tuple[str, ...]:
        """A sentence for each thing that is wrong."""
        said = []
        if self.chunks:
            said.append(f"{self.chunks} damaged chunks were read as far as they go.")
        if self.skipped:
            said.append(f"{self.skipped} damaged bytes of the recording were skipped.")
        if self.cut:
            said.append("The recording is cut off at its end; it was read up to the cut.")
        return tuple(said)


class _Chunk(NamedTuple):
    """Where a chunk's records lie in the file, packed, and how they are and what they must come to."""

    start: int
    end: int
    compression: str
    size: int
    checksum: int

    @classmethod
    def at(cls, content: bytes, start: int, stop: int) -> _Chunk | None:
        """The chunk whose record begins at ``start``; None where less of it than its head is there."""
        if start + CHUNK_HEAD.size > stop:
            return None
        _, _, size, checksum = CHUNK_HEAD.unpack_from(content, start)
        compression, place = _text(content, start + CHUNK_HEAD.size, stop)
        if compression is None or place + 8 > stop:
            return None
        first = place + 8
        return cls(first, first + int.from_bytes(content[place:first], "little"), compression, size, checksum)


@dataclass
class Recording:
    """An MCAP file.

    Attributes:
        content: its bytes.
        channels: by their number, as far as the file was read.
        schemas: likewise; none from a damaged chunk.
        damage: what was found wrong, likewise.
    """

    content: bytes
    channels: dict[int, Channel] = field(default_factory=dict)
    schemas: dict[int, Schema] = field(default_factory=dict)
    damage: Damage = field(default_factory=Damage)
    _allowance: int = 0

    def messages(self, progress: Progress | None = None) -> Iterator[Message]:
        """Every message whose channel is known, in the order of the file.

        Args:
            progress: called with the fraction done.
        """
        self._allowance = MOST_IN_ALL + MOST_RATIO * len(self.content)
        first = len(MAGIC) if self.content.startswith(MAGIC) else 0
        records = list(self._records(self.content, first))
        self.damage.cut |= not records or records[-1][0] != FOOTER
        # The summary at the end repeats channels and schemas: where their first mention is damaged they are known from
        # there.
        for opcode, start, stop in records:
            if opcode == CHANNEL:
                self._note_channel(self.content, start, stop)
            elif opcode == SCHEMA:
                self._note_schema(self.content, start, stop)
        # Behind damage, messages outside of chunks are what is left of a chunk that has lost its checksum.
        vouched = not (self.damage.skipped and any(opcode == CHUNK for opcode, _, _ in records))
        for opcode, start, stop in records:
            if opcode == CHUNK:
                yield from self._in_chunk(start, stop)
                if progress is not None:
                    progress(stop / len(self.content))
            elif opcode == MESSAGE:
                message = self._message(self.content, start, stop, vouched)
                if message is not None:
                    yield message
        if progress is not None:
            progress(1.0)

    def _records(self, content: bytes, place: int) -> Iterator[tuple[int, int, int]]:
        """Opcode, start and end of the content of each record from ``place`` on; a chunk at the end may be cut."""
        end = len(content)
        data = np.frombuffer(content, dtype=np.uint8)
        while place < end:
            if place + HEAD.size <= end:
                opcode, length = HEAD.unpack_from(content, place)
                start, stop = place + HEAD.size, place + HEAD.size + length
                if stop <= end and _is_opcode(opcode):
                    yield opcode, start, stop
                    place = stop
                    continue
                if opcode == CHUNK and _is_cut_chunk(content, start, stop):
                    self.damage.cut = True
                    yield opcode, start, end
                    return
            if content.startswith(MAGIC, place):
                place += len(MAGIC)
                continue
            following = _next_record(content, data, place + 1)
            if following < end or content is not self.content:
                self.damage.skipped += following - place
            else:
                self.damage.cut = True
            place = following

    def _in_chunk(self, start: int, stop: int) -> Iterator[Message]:
        chunk = _Chunk.at(self.content, start, stop)
        if chunk is None:
            return
        cut = self.damage.cut and stop == len(self.content) < chunk.end
        most = min(self._allowance, MOST_IN_A_CHUNK)
        records, whole = _unpacked(chunk.compression, self.content[chunk.start : min(chunk.end, stop)], most)
        self._allowance -= len(records)
        sound = cut or (whole and len(records) == chunk.size and chunk.checksum in (0, zlib.crc32(records)))
        self.damage.chunks += not sound
        for opcode, inner, end in self._records(records, 0):
            if opcode == MESSAGE:
                message = self._message(records, inner, end, sound)
                if message is not None:
                    yield message
            elif opcode == CHANNEL:
                self._note_channel(records, inner, end)
            elif opcode == SCHEMA and sound:
                # A definition that is wrong in one letter would lay out every message of a sound chunk wrongly.
                self._note_schema(records, inner, end)

    def _message(self, content: bytes, start: int, stop: int, vouched: bool) -> Message | None:
        """The message of a record; None where there is none, or its channel is not known."""
        if start + MESSAGE_HEAD.size > stop:
            return None
        number, _, log_time, _ = MESSAGE_HEAD.unpack_from(content, start)
        channel = self.channels.get(number)
        if channel is None:
            return None
        return Message(channel, log_time, content[start + MESSAGE_HEAD.size : stop], vouched)

    def _note_channel(self, content: bytes, start: int, stop: int) -> None:
        if start + 4 > stop:
            return
        number, schema = struct.unpack_from("<HH", content, start)
        topic, place = _text(content, start + 4, stop)
        encoding, _ = _text(content, place, stop)
        if topic is not None and encoding is not None:
            self.channels[number] = Channel(topic, encoding, schema)

    def _note_schema(self, content: bytes, start: int, stop: int) -> None:
        if start + 2 > stop:
            return
        (number,) = struct.unpack_from("<H", content, start)
        name, place = _text(content, start + 2, stop)
        encoding, place = _text(content, place, stop)
        text, _ = _text(content, place, stop)
        if name is not None and encoding is not None and text is not None:
            self.schemas[number] = Schema(name, encoding, text)


def listed(topics: Iterable[str]) -> str:
    """The topics as a sentence may name them: a few, in one line, whatever is in the file."""
    names = sorted(topics)
    told = [name if len(name) <= LONGEST_TOLD else f"{name[:LONGEST_TOLD]}…" for name in names[:MOST_TOPICS_TOLD]]
    told = ["".join(one if one.isprintable() else "\N{REPLACEMENT CHARACTER}" for one in name) for name in told]
    return ", ".join(told) + (", …" if len(names) > MOST_TOPICS_TOLD else "")


def _is_opcode(opcode: int) -> bool:
    return 0 < opcode <= LAST_OPCODE or opcode >= PRIVATE_OPCODES


def _is_cut_chunk(content: bytes, start: int, stop: int) -> bool:
    """Whether a chunk that should reach beyond the end of the file does so truly: its two lengths agree."""
    chunk = _Chunk.at(content, start, len(content))
    return chunk is not None and chunk.end == stop


def _next_record(content: bytes, data: Bytes, place: int) -> int:
    """The first place from ``place`` on where records follow one another; the end where there is none."""
    search = FIRST_SEARCH
    last = len(content) - HEAD.size
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
    for _ in range(IN_A_ROW):
        if place == len(content) or content.startswith(MAGIC, place):
            return True
        if place + HEAD.size > len(content):
            return False
        opcode, length = HEAD.unpack_from(content, place)
        if not 0 < opcode <= LAST_OPCODE:
            return False
        place += HEAD.size + length
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
    pieces: list[bytes] = []
    size = 0
    try:
        for piece in _pieces(compression, packed):
            size += len(piece)
            if size > most:
                return b"".join(pieces), False
            pieces.append(piece)
    except (zstandard.ZstdError, RuntimeError, MemoryError):  # RuntimeError: from lz4
        return b"".join(pieces), False
    return b"".join(pieces), compression in ("", "zstd", "lz4")


def _pieces(compression: str, packed: bytes) -> Iterator[bytes]:
    if compression == "":
        yield packed
    elif compression == "zstd":
        with zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True) as reader:
            while piece := reader.read(PIECE):
                yield piece
    elif compression == "lz4":
        unpacker = lz4.frame.LZ4FrameDecompressor()
        piece = unpacker.decompress(packed, max_length=PIECE)
        while piece:
            yield piece
            piece = b"" if unpacker.eof else unpacker.decompress(b"", max_length=PIECE)
