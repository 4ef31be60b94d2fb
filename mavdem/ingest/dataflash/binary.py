"""Binary DataFlash logs of ArduPilot (.bin): their messages are found first, and decoded column by column on request.

Every message begins with the bytes A3 95 and its id, and its definition gives its length (``definitions.py``). There
are no checksums. A message is accepted when its header is where the one before it ends, and another follows it; after
damage the next header with a known id is tried.
"""

import re
from array import array
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from mavdem.arrays import Integers
from mavdem.facts import Facts
from mavdem.facts.sources import Repair
from mavdem.ingest.byte_rows import Bytes, rows_of
from mavdem.ingest.contents import FileContent
from mavdem.ingest.dataflash.definitions import (
    DIVISORS,
    FORMAT,
    FORMAT_BODY,
    FORMAT_ID,
    HEADER_BYTES,
    ID_BYTE,
    MARKER,
    MESSAGE_IDS,
    FormatDefinition,
    FormatFields,
    NumberedDefinition,
    parse_definition,
)
from mavdem.ingest.dataflash.recording import EMPTY_TABLE, DataflashRecording, MessageTable
from mavdem.ingest.record_runs import PossibleRecords, RecordRuns
from mavdem.ingest.telemetry import repair_facts, rows_by_value

MARKER_SEARCH_BYTES = 1 << 20
"""Bytes that are searched for markers at once: a log may be as large as the free memory."""


def read_binary(content: FileContent) -> DataflashRecording:
    """Finds the messages of a binary log, up to where another log with other definitions was appended.

    Messages are only located here. Those of a name are decoded on request, since most of a log is never used.

    Args:
        content: The bytes of the file.

    Returns:
        The recording, with the number of messages by name, the function that decodes the messages of one name, the
        number of bytes that belong to no message, what was repaired, and the number of messages without a definition.
    """
    scan = _MessageScan(content)
    scan.run()
    data = np.frombuffer(content, dtype=np.uint8)
    starts = np.array(scan.starts, dtype=np.int64)
    definition_of_name = {}
    starts_of_name = {}
    for message_id, rows in rows_by_value(data[starts + ID_BYTE]).items():
        for definition, starts_of_message in scan.starts_by_definition(message_id, starts[rows]):
            definition_of_name[definition.name] = definition
            starts_of_name[definition.name] = starts_of_message

    def decode(name: str) -> MessageTable:
        """Decodes the messages of one name; none if the log has none."""
        if name not in definition_of_name:
            return EMPTY_TABLE
        return _message_table(data, definition_of_name[name], starts_of_name[name])

    counts = {name: len(message_starts) for name, message_starts in starts_of_name.items()}
    skipped_bytes = scan.skipped_byte_count()
    undefined_messages = 0
    # If most bytes belong to no message, the definitions of their messages may be lost. These messages are counted by
    # their markers.
    if skipped_bytes > scan.message_bytes:
        undefined_messages = max(_marker_count(data) - len(starts), 0)
    return DataflashRecording(
        counts, decode, skipped_bytes, len(data), scan.repairs, undefined_messages
    )


def _marker_count(data: Bytes) -> int:
    """Returns the number of times that the two bytes of a message's marker occur in a log.

    Args:
        data: The log (B,). It is searched in blocks of ``MARKER_SEARCH_BYTES``, to bound the memory.
    """
    first_byte, second_byte = MARKER
    count = 0
    for search_start in range(0, len(data), MARKER_SEARCH_BYTES):
        # One byte more than the block, since a marker may begin at the block's last byte.
        block = data[search_start : search_start + MARKER_SEARCH_BYTES + 1]
        is_marker = (block[:-1] == first_byte) & (block[1:] == second_byte)
        count += int(np.count_nonzero(is_marker))
    return count


DEFINITION_START = re.compile(
    MARKER + bytes([FORMAT_ID]) + rb"(?=..[^\0]{0,3}[A-Za-z0-9_])", re.DOTALL
)
"""Header of an FMT, with the id, the length and the beginning of a name after it.

A long run of headers, as damage makes it, has millions of matches without the latter.
"""

FILL_BYTES = (b"\0", b"\xff")
"""What the last page of a flash chip holds where nothing was written."""

LENGTH_VARIES = -1
"""Entry of the table of lengths for an id with several definitions: the length must be found for each message."""


class _MessageScan:
    """One pass over a binary log that finds its messages.

    Attributes:
        content: The log.
        starts: Offset of each message, ascending.
        definitions: Definition of each message by id; the first one of an id that several messages share.
        sharing_definitions: The further definitions of each id that several messages share.
        message_bytes: Number of bytes of all messages.
        repairs: What was odd about the definitions.
    """

    def __init__(self, content: FileContent) -> None:
        """Finds the definitions of messages in the log; the messages themselves are found by :meth:`run`.

        Args:
            content: The log.
        """
        self.content = content
        self.starts = array("q")
        self.message_bytes = 0
        self.repairs: Facts = ()
        self.definitions = {FORMAT_ID: FORMAT}
        self.sharing_definitions: dict[int, list[FormatDefinition]] = {}
        # The definition in each FMT by its offset: each is needed again when the messages are found.
        self._parsed_definitions: dict[int, NumberedDefinition | None] = {}
        self._learn_definitions()
        # Length of the messages by id: 0 for ids without a definition, LENGTH_VARIES for those with several.
        self._lengths = [0] * MESSAGE_IDS
        for message_id, definition in self.definitions.items():
            is_shared = message_id in self.sharing_definitions
            self._lengths[message_id] = LENGTH_VARIES if is_shared else definition.length
        # The same for a search by header alone. It finds neither definitions nor messages whose id has several
        # definitions, since more than their header must be looked at.
        self._lengths_by_header = np.array(self._lengths)
        self._lengths_by_header[self._lengths_by_header == LENGTH_VARIES] = 0
        self._lengths_by_header[FORMAT_ID] = 0
        self._runs = RecordRuns(content, self._possible_messages)

    def run(self) -> None:
        """Finds all messages, up to an FMT that contradicts the one before it: there another log was appended.

        The length in a message's definition gives the offset of the next header. If none is there, or its id has no
        definition, the search continues byte by byte. The offsets of the messages are appended to ``starts``, and their
        lengths are added to ``message_bytes``.
        """
        size = len(self.content)
        offset = 0
        while offset <= size - HEADER_BYTES:
            if not self._has_marker(offset):
                offset = self._offset_after_damage(offset)
                continue
            # Many messages that follow each other without a gap are found at once, by their headers alone.
            run = self._runs.run_at(offset, size)
            if run is not None:
                # Both are 64-bit numbers, which are copied as bytes.
                self.starts.frombytes(run.starts.tobytes())
                self.message_bytes += run.end - offset
                offset = run.end
                continue
            message_id = self.content[offset + ID_BYTE]
            if message_id == FORMAT_ID and self._is_of_another_log(offset):
                return
            length = self._lengths[message_id]
            if length == LENGTH_VARIES:
                length = self._definition_of_message(offset).length
            is_whole = length > 0 and offset + length <= size
            if is_whole:
                self.starts.append(offset)
                self.message_bytes += length
                offset += length
            else:
                offset = self._next_header(offset + 1)

    def _possible_messages(self, first: int, stop: int) -> PossibleRecords:
        """Finds all offsets in a range that look like whole messages.

        The header of a message is three bytes: the two bytes of the marker, and the message's id. All messages of an id
        have the same length, so that the header gives the length.

        Args:
            first: Offset of the first byte at which a message may begin.
            stop: Offset before which messages begin; the last may end after it.

        Returns:
            Offset (n,) of the start of each possible message, and of the byte after it.
        """
        content = np.frombuffer(self.content, dtype=np.uint8)
        # A header that begins here or later would not end within the content.
        header_stop = min(stop, len(content) - HEADER_BYTES + 1)
        first_byte, second_byte = MARKER
        starts = np.flatnonzero(content[first:header_stop] == first_byte) + first
        has_marker = content[starts + 1] == second_byte
        starts = starts[has_marker]
        message_ids = content[starts + ID_BYTE]
        lengths = self._lengths_by_header[message_ids]
        ends = starts + lengths
        # The length is 0 for an id that is not defined, or whose messages have several lengths.
        is_message = (lengths > 0) & (ends <= len(content))
        return PossibleRecords(starts[is_message], ends[is_message])

    def starts_by_definition(
        self, message_id: int, starts: Integers
    ) -> Iterator[tuple[FormatDefinition, Integers]]:
        """Yields the definition of an id with the offsets of its messages; several where messages share the id.

        Args:
            message_id: Number of the message, the third byte of its header.
            starts: Offsets (N,) of all messages with this id.

        Yields:
            Definition, and offsets of the messages that have it.
        """
        if message_id not in self.sharing_definitions:
            yield self.definitions[message_id], starts
            return
        rows_by_definition: dict[FormatDefinition, list[int]] = {}
        for row, offset in enumerate(starts.tolist()):
            definition = self._definition_of_message(offset)
            rows_by_definition.setdefault(definition, []).append(row)
        for definition, rows in rows_by_definition.items():
            yield definition, starts[rows]

    def _definition_of_message(self, offset: int) -> FormatDefinition:
        """Returns the definition of the message at an offset, by its id.

        If several definitions share the id, it is the first one by whose length the message ends at another header or
        at the end of the log. If none does, the id's first definition is returned.

        Args:
            offset: Offset of the message's header.
        """
        message_id = self.content[offset + ID_BYTE]
        first_definition = self.definitions[message_id]
        for definition in (first_definition, *self.sharing_definitions.get(message_id, ())):
            end = offset + definition.length
            if end == len(self.content) or self._has_marker(end):
                return definition
        return first_definition

    def _has_marker(self, offset: int) -> bool:
        """Returns whether the marker of a message is at an offset."""
        return self.content[offset : offset + len(MARKER)] == MARKER

    def skipped_byte_count(self) -> int:
        """Returns the number of bytes that belong to no message, without the fill of a flash chip's last page.

        Bytes after the last message count as fill where all of them are 0 or all are 255; they are not damage.
        """
        bytes_after_messages = self.content[self._end_of_messages() :]
        first_byte = bytes_after_messages[:1]
        are_all_equal = bytes_after_messages.count(first_byte) == len(bytes_after_messages)
        is_fill = first_byte in FILL_BYTES and are_all_equal
        fill_length = len(bytes_after_messages) if is_fill else 0
        return len(self.content) - self.message_bytes - fill_length

    def _learn_definitions(self) -> None:
        """Finds the first definition of each id anywhere in the log, since messages may precede their FMT.

        A definition (FMT) gives the id, name, length and fields of one message type. Messages can be read only with
        the right length, so a definition whose stated length equals the length of its fields is preferred. One whose
        stated length differs is used only if there is no other with the same id; then the length of the fields is used,
        and a fact reports it. A field of a type newer than ``FIELD_TYPES`` is not damage: the length of the fields is
        unknown then (``length_by_fields`` 0), and the stated one is used.

        The results are stored in ``definitions``, ``sharing_definitions`` and ``repairs``.
        """
        # Definitions whose stated length is not the length of their fields, by message id.
        contradictory_definitions: dict[int, FormatDefinition] = {}
        defined_names = {FORMAT.name}
        for match in DEFINITION_START.finditer(self.content):
            numbered_definition = self._definition_at(match.start())
            if numbered_definition is None:
                continue
            message_id, definition = numbered_definition
            is_new_name = definition.name not in defined_names
            defined_names.add(definition.name)
            if message_id in self.definitions:
                # A name that was not defined before shares the id. Other definitions are repeated, or of another log.
                if is_new_name and definition.length == definition.length_by_fields:
                    self.sharing_definitions.setdefault(message_id, []).append(definition)
                continue
            # Where the length of the fields is not known (0), nothing contradicts the stated length.
            is_sound = definition.length_by_fields in (0, definition.length)
            if is_sound and definition.length >= HEADER_BYTES:
                self.definitions[message_id] = definition
            elif definition.length_by_fields > HEADER_BYTES:
                contradictory_definitions.setdefault(message_id, definition)
        self._adopt_contradictory_definitions(contradictory_definitions)

    def _adopt_contradictory_definitions(
        self, contradictory_definitions: Mapping[int, FormatDefinition]
    ) -> None:
        """Uses definitions with a wrong stated length for those messages that have no other definition.

        The length of the fields replaces the stated one, which a fact in ``repairs`` reports.

        Args:
            contradictory_definitions: Definitions whose stated length is not the length of their fields, by message id.
        """
        for message_id, definition in contradictory_definitions.items():
            if message_id in self.definitions:
                continue
            field_length = definition.length_by_fields
            self.definitions[message_id] = replace(definition, length=field_length)
            self.repairs += repair_facts(
                Repair.DEFINITION_CONTRADICTED,
                name=definition.name,
                length=definition.length,
                field_length=field_length,
            )

    def _definition_at(self, offset: int) -> NumberedDefinition | None:
        """Parses the FMT at an offset, or returns the stored result of an earlier call.

        Args:
            offset: Offset of the FMT's header.

        Returns:
            The definition with its message id; None if the FMT is cut off or damaged.
        """
        if offset + FORMAT.length > len(self.content):
            return None
        if offset not in self._parsed_definitions:
            format_fields = FORMAT_BODY.unpack_from(self.content, offset + HEADER_BYTES)
            self._parsed_definitions[offset] = parse_definition(FormatFields(*format_fields))
        return self._parsed_definitions[offset]

    def _is_of_another_log(self, offset: int) -> bool:
        """Returns whether the definition (FMT) at an offset belongs to another log, which was appended to this one.

        It does if it is consistent in itself and contradicts the first definition of the same id. But in one log two
        messages may share an id; such a definition contradicts nothing.

        Args:
            offset: Offset of the FMT message in the file.
        """
        numbered_definition = self._definition_at(offset)
        if numbered_definition is None:
            return False
        message_id, definition = numbered_definition
        first_definition = self.definitions.get(message_id)
        if first_definition is None or definition == first_definition:
            return False
        shares_id = definition in self.sharing_definitions.get(message_id, ())
        is_consistent = definition.length == definition.length_by_fields
        return is_consistent and not shares_id

    def _end_of_messages(self) -> int:
        """Returns the offset after the last message; 0 without any."""
        if not self.starts:
            return 0
        last_start = self.starts[-1]
        return last_start + self._definition_of_message(last_start).length

    def _offset_after_damage(self, offset: int) -> int:
        """Returns the offset at which the search continues if no header is at ``offset``.

        A message that ends at ``offset`` should have been followed by a header. Since it is not, some of its bytes are
        missing, or its header was a chance pattern. The message is removed from ``starts``, and the search continues
        inside it, where the true next header may be. If no header follows at all, the log may have been cut off after a
        sound message, which is kept.

        Args:
            offset: Offset at which a header was expected.

        Returns:
            Offset of the next header, or the end of the log.
        """
        next_header = self._next_header(offset)
        has_header_after = next_header < len(self.content)
        follows_message = bool(self.starts) and self._end_of_messages() == offset
        if has_header_after and follows_message:
            message_before = self.starts.pop()
            self.message_bytes -= offset - message_before
            return self._next_header(message_before + 1)
        return next_header

    def _next_header(self, offset: int) -> int:
        """Returns the offset of the next header, from an offset on; the end of the log if there is none."""
        header = self.content.find(MARKER, offset)
        return header if header >= 0 else len(self.content)


def _message_table(data: Bytes, definition: FormatDefinition, starts: Integers) -> MessageTable:
    """Decodes the messages of one name, all at once: their bytes are gathered into one structured array.

    Args:
        data: The log (B,).
        definition: The definition of the messages.
        starts: Offset (N,) of each message.

    Returns:
        The messages, in the units of their fields; none if the definition is inconsistent.
    """
    body_type = definition.body_type
    is_consistent = definition.length == definition.length_by_fields
    if body_type is None or not is_consistent or not body_type.itemsize:
        return EMPTY_TABLE
    # Each message's bytes become a row of a table; the row is then read as one element of the structured type.
    bodies = rows_of(data, starts + HEADER_BYTES, body_type.itemsize)
    messages = bodies.view(body_type)[:, 0]
    columns = {}
    names_and_types = zip(definition.fields, definition.characters, strict=True)
    for number, (name, type_character) in enumerate(names_and_types):
        # The fields of the structured type are named by their numbers.
        column = np.ascontiguousarray(messages[f"{number}"])
        # Some types are integers in hundredths or 1e-7 degrees.
        if type_character in DIVISORS:
            column = column / DIVISORS[type_character]
        columns[name] = column
    return MessageTable(starts, columns)
