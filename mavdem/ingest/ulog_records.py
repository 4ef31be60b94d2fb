"""The sound records of a ULog file, without those that a parser would misread because of damage or a cut.

A ULog is a chain of records, each with a header of three bytes: its length (uint16) and its type, a letter. There are
no checksums, and files before PX4 1.11 have no marks of synchronisation, so that one wrong length would shift all that
follows. Here a record must fit the definitions of the file; where one does not, the search continues byte by byte until
several records in a row fit.

Layout: https://docs.px4.io/main/en/dev_log/ulog_file_format.html.
"""

import re
import struct
from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mavdem.ingest.byte_rows import Offsets
from mavdem.ingest.contents import FileContent
from mavdem.ingest.record_runs import RecordRuns
from mavdem.ingest.telemetry import MICROSECONDS
from mavdem.ingest.ulog_definitions import (
    DATA,
    DATA_HEADER,
    FLAG_BITS,
    FORMAT,
    HEADER,
    KEY_OFFSETS,
    STAMP,
    SUBSCRIPTION,
    SYNC,
    Fit,
    RecordDefinitions,
)

FILE_HEADER_BYTES = 16
"""Number of bytes before the first record: the magic, the version of the format and the time of the start."""

TYPE_BYTES = re.compile(b"[BFIMPQARDLCSO]")
"""Any type of a record."""

UNWRITTEN_BYTES = re.compile(rb"\0+|\xff+")
"""What a card holds where nothing was written."""

FLAGS = struct.Struct("<QQ3Q")
"""Compatible flags, incompatible flags, and the offsets of appended data, in the flags record after its header."""

APPENDED_DATA_FLAG = 1
"""Bit of the incompatible flags: data was appended, at the offsets after the flags."""

RECORDS_OF_CHAIN = 5
"""Number of records in a row that must fit the definitions for the search after damage to end: a choice.

A data record fits by chance at one place of 2^40 / (number of topics): three random records would be enough. Five cost
nothing where the file is sound.
"""

MAX_UNKNOWN_RECORDS = 20
"""Number of records without a definition that such a chain may contain: a choice."""


class RecordLoss(NamedTuple):
    """What could not be read of a damaged file."""

    places: int = 0
    """Number of damaged places."""
    lost_bytes: int = 0
    """Number of bytes that were left out there."""
    lost_seconds: float = 0.0
    """Sum of the times, s, between the last record before each place and the first one after it."""


class FileFlags(NamedTuple):
    """What the flags record of a file holds ("Flag Bits Message"); zeros where a file has none."""

    compatible: int = 0
    """Flags without which a reader can do, 64 bits; the first byte of the file is the lowest."""
    incompatible: int = 0
    """Flags that a reader must know, likewise."""
    appended_offsets: tuple[int, ...] = (0, 0, 0)
    """Offsets at which data was appended to the file, for example after a crash of the system; unused ones are 0."""


@dataclass(frozen=True)
class SoundRecords:
    """The records of a ULog file without its damaged places. The file itself is not copied."""

    content: FileContent
    """The file."""
    flags: FileFlags
    """The flags, whose record may follow the header of the file."""
    loss: RecordLoss
    """What was lost by damage."""
    offsets: Offsets
    """Where the records begin in ``content``, ascending, without the record of flags."""
    definitions: RecordDefinitions
    """The definitions of the file, with its subscriptions."""


def sound_records(content: FileContent) -> SoundRecords:
    """Leaves out the parts of a ULog file that do not fit its definitions.

    Sound records that cannot be read are left out too: those of a topic without a time stamp, repeated
    subscriptions and definitions, and types of records that this version of the format does not have. Data that was
    appended after a crash follows the other data directly.

    Args:
        content: A file that begins with the magic of ULog.

    Returns:
        The sound records, and a summary of the loss.

    Raises:
        EOFError: The file ends within its header, or within its flags record.
    """
    scan = _RecordScan(content)
    scan.run()
    return SoundRecords(
        content,
        scan.flags,
        scan.loss,
        np.array(scan.offsets, dtype=np.int64),
        scan.definitions,
    )


class _RecordScan:
    """One pass over a ULog file that finds its records.

    Attributes:
        content: Bytes of the file.
        flags: The flags; zeros where there are none.
        loss: What was lost by damage so far.
        offsets: Offsets of the records that are kept: 64-bit numbers, of which a long log has millions.
        definitions: The definitions that were read so far.
    """

    def __init__(self, content: FileContent) -> None:
        """Prepares the pass.

        Args:
            content: A file that begins with the magic of ULog.
        """
        self.content = content
        self.loss = RecordLoss()
        self.offsets = array("q")
        self.definitions = RecordDefinitions(content)
        self._data_runs = RecordRuns(content, self.definitions.possible_data_records)
        self.flags = FileFlags()

    def run(self) -> None:
        """Finds the records of the whole file, part by part where data was appended to it.

        Raises:
            EOFError: The file ends within its header, or within its flags record.
        """
        start = FILE_HEADER_BYTES
        if len(self.content) < start:
            raise EOFError("the file ends within its header")
        header = self.content[start : start + HEADER.size]
        if header == HEADER.pack(FLAGS.size, FLAG_BITS):
            flags_start = start + HEADER.size
            start = flags_start + FLAGS.size
            if len(self.content) < start:
                raise EOFError("the file ends within its flags record")
            compatible, incompatible, *offsets = FLAGS.unpack_from(self.content, flags_start)
            self.flags = FileFlags(compatible, incompatible, tuple(offsets))
        for end in [*self._appended_offsets(start), len(self.content)]:
            self._run_part(start, end)
            start = end

    def _appended_offsets(self, first_record: int) -> list[int]:
        """Returns the offsets at which data was appended to the file, if they can be right.

        Args:
            first_record: Offset after the flags, where the other records begin.

        Returns:
            The offsets, ascending; none if no data was appended, or the flags are damaged.
        """
        offsets = [offset for offset in self.flags.appended_offsets if offset]
        is_ascending = offsets == sorted(set(offsets))
        lies_in_file = all(first_record < offset < len(self.content) for offset in offsets)
        if self.flags.incompatible & APPENDED_DATA_FLAG and is_ascending and lies_in_file:
            return offsets
        return []

    def _run_part(self, start: int, end: int) -> None:
        """Finds the records between two offsets.

        A record that is cut by the end is left out; that is no damage, since logs usually end so.

        Args:
            start: Offset of the first record.
            end: Offset at which the part ends, or another one was appended.
        """
        content = self.content
        offsets = self.offsets
        position = start
        # The number of records before the present run of sound ones.
        records_before_run = len(offsets)
        while position < end:
            header = self.definitions.header(position)
            end_of_run = self._add_run(position, end, header.kind)
            if end_of_run is not None:
                position = end_of_run
                continue
            fit = self.definitions.fit(position, end, header)
            next_position = position + HEADER.size + header.length
            if fit is Fit.UNKNOWN and not self._is_whole_unknown_record(position, end):
                fit = Fit.DAMAGED
            if fit is Fit.SOUND:
                if header.kind in (FORMAT, SUBSCRIPTION):
                    self.definitions.learn(position)
                if header.kind == SUBSCRIPTION:
                    # Places that looked like nothing before may now be records of this subscription.
                    self._data_runs.discard_search()
                offsets.append(position)
                position = next_position
                continue
            omitted_bytes = slice(position, next_position)
            if fit is Fit.DAMAGED:
                recent = offsets[max(records_before_run, len(offsets) - RECORDS_OF_CHAIN) :]
                omitted_bytes = self._damaged_place(position, end, recent)
            elif fit is Fit.UNKNOWN and content[position + 2] == DATA:
                # The definition of this subscription was lost by earlier damage.
                self._add_loss(0, omitted_bytes.stop - omitted_bytes.start, 0.0)
            while len(offsets) > records_before_run and offsets[-1] >= omitted_bytes.start:
                offsets.pop()
            position = omitted_bytes.stop
            records_before_run = len(offsets)
        if position > end and len(offsets) > records_before_run:
            # The last record is cut off.
            offsets.pop()

    def _add_run(self, position: int, end: int, kind: int) -> int | None:
        """Adds the offsets of sound records of one kind that follow each other, which is faster than one by one.

        Args:
            position: Offset of the first record.
            end: Offset at which the part ends.
            kind: Kind of the first record. Only data, information and parameters have such runs.

        Returns:
            Offset after the run; None if none begins there, and nothing was added.
        """
        if kind == DATA:
            data_run = self._data_runs.run_at(position, end)
            if data_run is not None:
                self.offsets.frombytes(data_run.starts.tobytes())
                return data_run.end
        elif kind in KEY_OFFSETS:
            keyed_run = self.definitions.keyed_run(position, end)
            if keyed_run.starts:
                self.offsets.extend(keyed_run.starts)
                return keyed_run.end
        return None

    def _is_chain(self, position: int, end: int, *, may_begin_unknown: bool = False) -> bool:
        """Returns whether ``RECORDS_OF_CHAIN`` records from an offset on fit the definitions, or all up to the end.

        Up to ``MAX_UNKNOWN_RECORDS`` records of unknown kinds may lie between them. A synchronisation record, with its
        magic bytes, is proof by itself.

        Args:
            position: Offset of the first record.
            end: Offset at which the part of the file ends; the last record may be cut off there.
            may_begin_unknown: Whether the first record may be unknown too.
        """
        fitting_records = 0
        unknown_records = 0
        while fitting_records < RECORDS_OF_CHAIN:
            if position >= end:
                return fitting_records > 0 or may_begin_unknown
            if self.definitions.next_position(position) > end or end - position < HEADER.size:
                # The last record is cut off. It counts if a fitting record precedes it, or if its header is that of a
                # data record.
                data_header = self.content[position : position + DATA_HEADER.size]
                return fitting_records > 0 or self.definitions.data_length(data_header) is not None
            fit = self.definitions.fit(position, end)
            if fit is Fit.DAMAGED:
                return False
            if fit is Fit.UNKNOWN:
                unknown_records += 1
                is_first = fitting_records == 0
                if unknown_records > MAX_UNKNOWN_RECORDS or (is_first and not may_begin_unknown):
                    return False
            elif self.definitions.header(position).kind == SYNC:
                return True
            else:
                fitting_records += 1
            position = self.definitions.next_position(position)
        return True

    def _is_whole_unknown_record(self, position: int, end: int) -> bool:
        """Returns whether the bytes at an offset are a record of an unknown kind, and not damaged bytes.

        A chain of records must begin after the record, and none inside it.

        Args:
            position: Offset of the record.
            end: Offset at which this part of the file ends.
        """
        next_position = self.definitions.next_position(position)
        if not self._is_chain(next_position, end, may_begin_unknown=True):
            return False
        starts_inside = self.definitions.record_start_pattern().finditer(
            self.content, position + 1, next_position
        )
        return not any(self._is_chain(start.start(), end) for start in starts_inside)

    def _next_chain(self, start: int, end: int) -> int:
        """Returns the first offset at which a chain of records begins.

        A chain is several records in a row that fit the definitions, which proves that they are not there by chance.

        Args:
            start: Offset at which the search starts.
            end: Offset at which this part of the file ends.

        Returns:
            The offset; ``end`` without any chain.
        """
        for record_start in self.definitions.record_start_pattern().finditer(
            self.content, start, end
        ):
            position = record_start.start()
            if self._is_chain(position, end):
                return position
        return end

    def _damaged_place(self, position: int, end: int, recent: Sequence[int]) -> slice:
        """Finds the bytes to leave out around a record that does not fit, and adds them to ``loss``.

        The data record before it may be damaged too: if bytes are missing, it contains the beginning of a later record;
        if bytes were overwritten, nothing shows it. So it is left out as well, unless only the header of the record
        after it is wrong.

        Args:
            position: Offset of the record that does not fit.
            end: Offset at which this part of the file ends.
            recent: Offsets of the last records before it, ascending.

        Returns:
            The range of offsets to leave out.
        """
        start = position
        has_data_before = bool(recent) and self.definitions.header(recent[-1]).kind == DATA
        if has_data_before:
            start = recent[-1]
        next_chain = self._next_chain(start + 1, end)
        next_position = self.definitions.next_position(position)
        is_followed = next_position < end and self.definitions.fit(next_position, end) is Fit.SOUND
        if is_followed and next_position <= next_chain:
            # The length in the record's header is right, so that only this record is damaged.
            next_chain = next_position
        is_cut_record = self._is_cut_record(position, end)
        if next_chain == end and (is_cut_record or self._is_unwritten(position, end)):
            # The usual end of a log when the power is switched off; it does not count as a loss.
            return slice(position if is_cut_record else start, end)
        if self._has_wrong_header_only(position, next_chain):
            start = position
        before = [offset for offset in recent if offset < start]
        gap = self._seconds_between(before, self._data_offsets(next_chain, end))
        self._add_loss(1, next_chain - start, gap)
        return slice(start, next_chain)

    def _is_cut_record(self, position: int, end: int) -> bool:
        """Returns whether the bytes at an offset may be the beginning of a record that goes beyond the end.

        Args:
            position: Offset of the bytes.
            end: Offset at which this part of the file ends.
        """
        if end - position < HEADER.size:
            return True
        is_type = TYPE_BYTES.match(self.content, position + HEADER.size - 1) is not None
        return is_type and self.definitions.next_position(position) > end

    def _is_unwritten(self, position: int, end: int) -> bool:
        """Returns whether only zero bits, or only one bits, follow: the content of memory that was never written."""
        unwritten = UNWRITTEN_BYTES.match(self.content, position, end)
        return unwritten is not None and unwritten.end() == end

    def _has_wrong_header_only(self, position: int, next_record: int) -> bool:
        """Returns whether a damaged record ends where the next one begins, so that at most its header is wrong.

        Either the length in its header says so, and its type is wrong. Or the length of the subscription with the
        record's number does, and its length is wrong.

        Args:
            position: Offset of the record.
            next_record: Offset at which the next sound record begins.
        """
        length = next_record - position
        if position + HEADER.size + self.definitions.header(position).length == next_record:
            return True
        subscription = self.content[position + HEADER.size : position + DATA_HEADER.size]
        # The header that a data record of this length would have. The field of the length has 16 bits.
        length_field = (length - HEADER.size) % (1 << 16)
        data_header = HEADER.pack(length_field, DATA) + subscription
        return self.definitions.data_length(data_header) == length

    def _data_offsets(self, position: int, end: int) -> list[int]:
        """Returns the offsets of the first data records from an offset on.

        Other records between them are passed over; damage ends the search.

        Args:
            position: Offset of the first record.
            end: Offset at which the part of the file ends.

        Returns:
            ``RECORDS_OF_CHAIN`` offsets, or fewer.
        """
        offsets: list[int] = []
        while position < end and len(offsets) < RECORDS_OF_CHAIN:
            fit = self.definitions.fit(position, end)
            if fit is Fit.DAMAGED:
                break
            if fit is Fit.SOUND and self.definitions.header(position).kind == DATA:
                offsets.append(position)
            position = self.definitions.next_position(position)
        return offsets

    def _seconds_between(self, before: Sequence[int], after: Sequence[int]) -> float:
        """Returns the time between the records before a damaged place and those after it.

        The latest stamp before it and the earliest after it may be damaged too, or much older than their neighbours, as
        the first stamp of a topic is. So if a side has more than two stamps, its second one is used.

        Args:
            before: Offsets of records before the place.
            after: Offsets of records after the place.

        Returns:
            The time, s, at least 0; 0 if one of the sides has no data record.
        """
        stamps_before = sorted(self._stamps(before), reverse=True)
        stamps_after = sorted(self._stamps(after))
        if not stamps_before or not stamps_after:
            return 0.0
        last = stamps_before[1] if len(stamps_before) > 2 else stamps_before[0]
        first = stamps_after[1] if len(stamps_after) > 2 else stamps_after[0]
        return max(first - last, 0) / MICROSECONDS

    def _stamps(self, offsets: Sequence[int]) -> list[int]:
        """Returns the time stamps of some records, µs since boot; records without a stamp are passed over.

        Args:
            offsets: Offsets of the records.
        """
        stamps = []
        for offset in offsets:
            body_start = offset + DATA_HEADER.size
            length = self.definitions.data_length(self.content[offset:body_start])
            if length is None:
                continue
            number = int.from_bytes(self.content[offset + HEADER.size : body_start], "little")
            stamp_offset = self.definitions.topics[number].stamp_offset
            if stamp_offset is not None and offset + length <= len(self.content):
                stamp_start = body_start + stamp_offset
                stamp_bytes = self.content[stamp_start : stamp_start + STAMP.size]
                stamps.append(int.from_bytes(stamp_bytes, "little"))
        return stamps

    def _add_loss(self, places: int, lost_bytes: int, lost_seconds: float) -> None:
        """Adds a loss to the sum of the file, ``loss``.

        Args:
            places: 1 for a damaged place; 0 for sound records that cannot be read without a lost definition.
            lost_bytes: number of bytes that are left out.
            lost_seconds: time between the records before and after the place, s.
        """
        self.loss = RecordLoss(
            self.loss.places + places,
            self.loss.lost_bytes + lost_bytes,
            self.loss.lost_seconds + lost_seconds,
        )
