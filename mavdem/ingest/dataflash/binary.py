"""Binary DataFlash logs (.bin): finding the messages, and decoding them by column.

There are no checksums. A message is accepted when its header is where the one before it ends; after damage the next
header with a known id is tried. A message that is not followed by a header may be whole, with garbage after it, or
damaged. It is rejected when another one, itself followed by a header, begins inside it, or when bytes differ in it
that are the same in all messages of its id around it: in most messages some bytes never change.
"""

from __future__ import annotations

import re
import struct
from array import array

import numpy as np
from numpy.typing import NDArray

from mavdem.ingest.dataflash.definitions import (
    DIVISORS,
    EMPTY,
    FORMAT,
    FORMAT_ID,
    HEADER,
    HEADER_LENGTH,
    MAX_DEFINITIONS,
    MAX_MESSAGE_BYTES,
    DataflashRecording,
    FormatDefinition,
    MessageTable,
    defined,
    joined_tables,
)
from mavdem.ingest.mavlink.framing import Progress

BLOCK = 1 << 22  # Bytes between two calls of ``progress``
NEIGHBOURS, MIN_NEIGHBOURS = 8, 4
"""Messages of its id before and after a doubtful one for comparison, and how many of them there must be."""

_FORMAT_BODY = struct.Struct("<BB4s16s64s")
_FORMAT_BEGUN = re.compile(HEADER + bytes([FORMAT_ID]) + rb"(?=..[^\0]{0,3}[A-Za-z0-9_])", re.DOTALL)
"""The beginning of an FMT, long enough to skip most other matches: long runs of headers contain millions."""
_Dated = list[tuple[int, FormatDefinition]]  # The definitions of one id, each with the place from which on it is valid


def read_binary(content: bytes, progress: Progress | None = None) -> DataflashRecording:
    """The messages in the bytes of a binary log; ``progress`` is called with the fraction done."""
    scan = _Scan(content)
    scan.run(progress)
    # Padded, so that the last message may be read with any definition.
    data = np.zeros(len(content) + MAX_MESSAGE_BYTES, dtype=np.uint8)
    data[: len(content)] = np.frombuffer(content, dtype=np.uint8)
    starts = np.array(scan.starts, dtype=np.int64)
    damaged = _damaged_rows(data, starts, scan.doubtful)
    starts = np.delete(starts, damaged)
    ids = data[starts + 2]
    groups: dict[str, list[tuple[FormatDefinition, NDArray[np.int64]]]] = {}
    for kind in np.unique(ids).tolist():
        places, dated = starts[ids == kind], scan.definitions[kind]
        version = np.searchsorted([since for since, _ in dated], places, side="right") - 1
        for number in np.unique(version).tolist():
            definition = dated[number][1]
            groups.setdefault(definition.name, []).append((definition, places[version == number]))
    return DataflashRecording(
        counts={name: sum(len(places) for _, places in group) for name, group in groups.items()},
        table=lambda name: joined_tables([_decoded(data, *group) for group in groups.get(name, [])]),
        bytes_skipped=scan.skipped(),
        repairs=(*scan.repairs, *((f"{len(damaged)} damaged messages were left out.",) if damaged else ())),
    )


class _Scan:
    """One pass over a log: ``starts`` are the places of its messages, ``definitions`` theirs by id.

    ``doubtful`` has the row and the length of each message that no header follows.
    """

    def __init__(self, content: bytes) -> None:
        self.content = content
        self.starts = array("q")
        self.doubtful: list[tuple[int, int]] = []
        self.read = 0
        self.repairs: list[str] = []
        self.definitions: dict[int, _Dated] = {FORMAT_ID: [(0, FORMAT)]}
        self.lengths = [0] * 256
        self.lengths[FORMAT_ID] = FORMAT.length
        self._learn_definitions()

    def run(self, progress: Progress | None) -> None:
        """Finds the messages."""
        content, lengths, starts = self.content, self.lengths, self.starts
        size, place, reported = len(content), 0, 0
        first, second = HEADER
        while place <= size - HEADER_LENGTH:
            if progress is not None and place >= reported:
                progress(place / size)
                reported = place + BLOCK
            if content[place] == first and content[place + 1] == second:
                kind = content[place + 2]
                length = lengths[kind]
                if length and place + length <= size:
                    starts.append(place)
                    self.read += length
                    if kind == FORMAT_ID:
                        self._define(place)
                    place += length
                else:
                    place = self._next_header(place + 1)
            else:
                place = self._after_damage(place)
        if progress is not None:
            progress(1.0)

    def skipped(self) -> int:
        """Bytes that belong to no message, without the fill of a flash chip's last page."""
        end = self.starts[-1] + self.lengths[self.content[self.starts[-1] + 2]] if self.starts else 0
        tail = self.content[end:]
        filled = len(tail) if tail.count(tail[:1]) == len(tail) and tail[:1] in (b"\0", b"\xff") else 0
        return len(self.content) - self.read - filled

    def _learn_definitions(self) -> None:
        """Finds the first definition of each id anywhere in the log: messages may come before their FMT."""
        contradictory: dict[int, FormatDefinition] = {}
        for begun in _FORMAT_BEGUN.finditer(self.content):
            found = self._defined_at(begun.start())
            if found is not None and found[0] not in self.definitions:
                kind, definition = found
                if definition.length == definition.wire_length:
                    self._set(kind, definition)
                else:
                    contradictory.setdefault(kind, definition)
        unsettled = {kind: found for kind, found in contradictory.items() if kind not in self.definitions}
        if not unsettled:
            return
        data = np.frombuffer(self.content + bytes(MAX_MESSAGE_BYTES), dtype=np.uint8)
        headers = (data[:-1] == HEADER[0]) & (data[1:] == HEADER[1])
        places = np.flatnonzero(headers[: len(self.content)])
        for kind, definition in unsettled.items():
            self._settle(kind, definition, headers, places[data[places + 2] == kind])

    def _settle(
        self, kind: int, definition: FormatDefinition, headers: NDArray[np.bool_], places: NDArray[np.int64]
    ) -> None:
        """Chooses between the two lengths of a contradictory definition: more messages then end at another header.

        With FMT's length and fields of another, messages are skipped but cannot be decoded. ``headers`` (N,): whether
        there is a header at each place of the log; ``places`` (n,): those of this ``kind``.
        """
        candidates = [length for length in (definition.wire_length, definition.length) if length > HEADER_LENGTH]
        if not candidates:
            return
        at_header = {n: np.count_nonzero(headers[np.minimum(places + n, len(headers) - 1)]) for n in candidates}
        length = max(candidates, key=at_header.__getitem__)
        decodable = length == definition.wire_length
        self._set(kind, FormatDefinition(definition.name, length, definition.characters, definition.fields))
        if definition.wire is None and length == definition.length:
            return  # a field of a newer type is no damage
        self.repairs.append(
            f"The definition (FMT) of {definition.name} says {definition.length} bytes and lists fields for "
            f"{definition.wire_length}: its messages were {'read by the fields' if decodable else 'left out'}."
        )

    def _set(self, kind: int, definition: FormatDefinition, since: int = 0) -> None:
        self.definitions.setdefault(kind, []).append((since, definition))
        self.lengths[kind] = definition.length

    def _define(self, place: int) -> None:
        """Replaces a definition by one that differs: another log was appended."""
        found = self._defined_at(place)
        if found is None or found[0] == FORMAT_ID:
            return
        kind, definition = found
        if definition.length == definition.wire_length and definition != self.definitions[kind][-1][1]:
            if len(self.definitions[kind]) < MAX_DEFINITIONS:
                self._set(kind, definition, place)
            else:
                self.lengths[kind] = 0  # its messages cannot be decoded from here on

    def _defined_at(self, place: int) -> tuple[int, FormatDefinition] | None:
        if place + FORMAT.length > len(self.content):
            return None
        return defined(_FORMAT_BODY.unpack_from(self.content, place + HEADER_LENGTH))

    def _after_damage(self, place: int) -> int:
        """The place to continue from where there is no header; rejects the message before it if that is damaged."""
        if self.starts:
            previous = self.starts[-1]
            length = self.lengths[self.content[previous + 2]]
            if previous + length == place:
                inside = self._begun_inside(previous, place)
                if inside is not None:
                    self.starts.pop()
                    self.read -= length
                    return inside
                self.doubtful.append((len(self.starts) - 1, length))
        return self._next_header(place)

    def _begun_inside(self, previous: int, end: int) -> int | None:
        """A message that begins inside the one before and ends at a header, or at the end of the log."""
        place = self.content.find(HEADER, previous + 1, end + 1)
        while place >= 0:
            length = self.lengths[self.content[place + 2]] if place + 2 < len(self.content) else 0
            behind = place + length
            if length and (self.content.startswith(HEADER, behind) or behind == len(self.content)):
                return place
            place = self.content.find(HEADER, place + 1, end + 1)
        return None

    def _next_header(self, place: int) -> int:
        found = self.content.find(HEADER, place)
        return found if found >= 0 else len(self.content)


def _damaged_rows(data: NDArray[np.uint8], starts: NDArray[np.int64], doubtful: list[tuple[int, int]]) -> list[int]:
    """The rows of the doubtful messages that differ from their neighbours where these are all the same."""
    ids, suspect, damaged = data[starts + 2], {row for row, _ in doubtful}, []
    rows_of = {kind: np.flatnonzero(ids == kind) for kind in np.unique(ids[sorted(suspect)]).tolist()}
    for row, length in doubtful:
        same = rows_of[int(ids[row])]
        at = int(np.searchsorted(same, row))
        around = [
            other for other in same[max(at - NEIGHBOURS, 0) : at + NEIGHBOURS + 1].tolist() if other not in suspect
        ]
        if len(around) >= MIN_NEIGHBOURS:
            bodies = np.stack([data[start : start + length] for start in starts[around].tolist()])
            constant = (bodies == bodies[0]).all(axis=0)
            if (data[starts[row] : starts[row] + length] != bodies[0])[constant].any():
                damaged.append(row)
    return damaged


def _decoded(data: NDArray[np.uint8], definition: FormatDefinition, places: NDArray[np.int64]) -> MessageTable:
    wire = definition.wire
    if wire is None or definition.length != definition.wire_length or not wire.itemsize:
        return EMPTY
    bodies = np.lib.stride_tricks.sliding_window_view(data, wire.itemsize)[places + HEADER_LENGTH]
    messages = bodies.view(wire)[:, 0]
    columns = {}
    for i, (name, character) in enumerate(zip(definition.fields, definition.characters, strict=True)):
        column = np.ascontiguousarray(messages[f"{i}"])
        columns[name] = column / DIVISORS[character] if character in DIVISORS else column
    return MessageTable(places, columns)
