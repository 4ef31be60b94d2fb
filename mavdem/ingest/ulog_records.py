"""The sound records of a ULog file: those that fit its definitions, without damaged ones, which parsers misread.

A ULog is a sequence of records, each with a header of three bytes: its length (uint16) and its type, a letter. There
are no checksums, and files before PX4 1.11 have no marks of synchronisation, so that one wrong length would shift all
that follows. Here a record must fit the definitions of the file; where one does not, the search continues byte by byte
until several records in a row fit.

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
    SUBSCRIPTION,
    SYNC,
    Fit,
    RecordDefinitions,
)
from mavdem.ingest.ulog_formats import STAMP

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

MAX_RECORD_LENGTH = 0xFFFF
"""Largest length of a record without its header, bytes: the header states it in 16 bits."""

MIN_SEQUENCE_RECORDS = 5
"""Number of records in a row that must fit the definitions for the search after damage to end: a choice.

A data record fits by chance at one place of 2^40 / (number of topics): three random records would be enough. Five cost
nothing where the file is sound.
"""

MAX_UNKNOWN_RECORDS = 20
"""Number of records without a definition that such a sequence may contain: a choice."""


class RecordLoss(NamedTuple):
    """What could not be read of a damaged file."""

    damaged_places: int = 0
    """Number of places in the file that are damaged."""
    lost_bytes: int = 0
    """Number of bytes that were left out there."""
    lost_seconds: float = 0.0
    """Sum of the times, s, between the last record before each damaged place and the first one after it."""


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
    is_cut: bool = False
    """Whether the file ends in the middle of a record."""


def sound_records(content: FileContent) -> SoundRecords:
    """Finds the records of a ULog file that fit its definitions, and leaves out everything else.

    Sound records that cannot be read are left out too: data records of a topic without a time stamp, repeated
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
        scan.is_cut,
    )


class _RecordScan:
    """One pass over a ULog file that finds its sound records, and searches for the next ones after damage.

    The file has one section, or several if data was appended to it after a crash: ``section_end`` is the offset at
    which the section ends, so that no record goes beyond it.

    Attributes:
        content: Bytes of the file.
        flags: The flags; zeros where there are none.
        loss: What was lost by damage so far.
        offsets: Offsets of the records that are kept: 64-bit numbers, of which a long log has millions.
        definitions: The definitions that were read so far.
        is_cut: Whether the latest section ended in the middle of a record.
    """

    def __init__(self, content: FileContent) -> None:
        """Prepares the pass.

        Args:
            content: A file that begins with the magic of ULog.
        """
        self.content = content
        self.loss = RecordLoss()
        self.is_cut = False
        self.offsets = array("q")
        self.definitions = RecordDefinitions(content)
        self._data_runs = RecordRuns(content, self.definitions.possible_data_records)
        self.flags = FileFlags()

    def run(self) -> None:
        """Reads the flags of the file, and finds the records of all its sections: the file, and data appended to it.

        Raises:
            EOFError: The file ends within its header, or within its flags record.
        """
        section_start = self._read_flags()
        # The first section ends where data was appended, or at the end of the file.
        for section_end in [*self._appended_offsets(section_start), len(self.content)]:
            self._scan_section(section_start, section_end)
            section_start = section_end

    def _read_flags(self) -> int:
        """Reads the flags record, which follows the header of the file unless an old version wrote it.

        Returns:
            The offset of the first record after the flags.

        Raises:
            EOFError: The file ends within its header, or within its flags record.
        """
        first_record = FILE_HEADER_BYTES
        if len(self.content) < first_record:
            raise EOFError("the file ends within its header")
        flags_start = first_record + HEADER.size
        flags_end = flags_start + FLAGS.size
        has_flags = self.content[first_record:flags_start] == HEADER.pack(FLAGS.size, FLAG_BITS)
        if not has_flags:
            return first_record
        if len(self.content) < flags_end:
            raise EOFError("the file ends within its flags record")
        flags = FLAGS.unpack_from(self.content, flags_start)
        compatible, incompatible, first_offset, second_offset, third_offset = flags
        appended_offsets = (first_offset, second_offset, third_offset)
        self.flags = FileFlags(compatible, incompatible, appended_offsets)
        return flags_end

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

    def _scan_section(self, start: int, section_end: int) -> None:
        """Finds the records between two offsets.

        A record that is cut by the end is left out; that is not damage, since logs usually end so.

        Args:
            start: Offset of the first record.
            section_end: Offset at which the section ends.
        """
        offsets = self.offsets
        offset = start
        self.is_cut = False
        # The number of records that were found before the latest omitted bytes. Those after it are the present run.
        records_before_run = len(offsets)
        while offset < section_end:
            header = self.definitions.header(offset)
            end_of_run = self._add_run(offset, section_end, header.record_type)
            if end_of_run is not None:
                offset = end_of_run
                continue
            fit = self.definitions.fit(offset, section_end, header)
            record_end = offset + HEADER.size + header.length
            if fit is Fit.UNKNOWN and not self._is_whole_unknown_record(offset, section_end):
                fit = Fit.DAMAGED
            if fit is Fit.SOUND:
                self._add_sound_record(offset, header.record_type)
                offset = record_end
                continue
            omitted_bytes = slice(offset, record_end)
            if fit is Fit.DAMAGED:
                # The last records of the run show the time before the damage, and whether a data record precedes it.
                latest_offsets = offsets[records_before_run:][-MIN_SEQUENCE_RECORDS:]
                omitted_bytes = self._damaged_bytes(offset, section_end, latest_offsets)
            elif fit is Fit.UNKNOWN and header.record_type == DATA:
                # The definition of this subscription was lost by earlier damage, which has been counted as a place.
                self._add_loss(damaged_places=0, lost_bytes=record_end - offset, lost_seconds=0.0)
            # The omitted bytes may begin before this record, at a data record that the damage has changed too. That
            # record has been added as a sound one, and is removed again.
            while len(offsets) > records_before_run and offsets[-1] >= omitted_bytes.start:
                offsets.pop()
            offset = omitted_bytes.stop
            records_before_run = len(offsets)
        if offset > section_end and len(offsets) > records_before_run:
            # The length of the last record exceeds the section: its end was never written.
            offsets.pop()
            self.is_cut = True

    def _add_sound_record(self, offset: int, record_type: int) -> None:
        """Adds a sound record to ``offsets``, and the definition or subscription in it to ``definitions``.

        Args:
            offset: Offset of the record in the file.
            record_type: Letter of its type.
        """
        if record_type in (FORMAT, SUBSCRIPTION):
            self.definitions.add(offset)
        if record_type == SUBSCRIPTION:
            # Bytes that belonged to no known subscription may now be a record of this one.
            self._data_runs.discard_search()
        self.offsets.append(offset)

    def _add_run(self, offset: int, section_end: int, record_type: int) -> int | None:
        """Adds a run of sound records to ``offsets``, if one begins at an offset.

        A run is a sequence of records without a gap, found in one pass, which is faster than a check of each record.
        There are runs of data records, and of records with a key (information and parameters).

        Args:
            offset: Offset of the first record in the file.
            section_end: Offset at which the section of the file ends.
            record_type: Type of the first record.

        Returns:
            Offset after the run; None if no run begins there.
        """
        if record_type == DATA:
            data_run = self._data_runs.run_at(offset, section_end)
            if data_run is None:
                return None
            # The array of 64-bit offsets takes the bytes of NumPy's array of 64-bit offsets.
            self.offsets.frombytes(data_run.starts.tobytes())
            return data_run.end
        if record_type in KEY_OFFSETS:
            keyed_run = self.definitions.keyed_run(offset, section_end)
            if not keyed_run.starts:
                return None
            self.offsets.extend(keyed_run.starts)
            return keyed_run.end
        return None

    def _begins_sequence(
        self, offset: int, section_end: int, *, may_begin_unknown: bool = False
    ) -> bool:
        """Returns whether a sequence of records begins at an offset, which proves that these bytes are not damaged.

        ULog has no checksums, and a single record may fit the definitions by chance. A sequence is
        ``MIN_SEQUENCE_RECORDS`` records in a row that fit, or fewer up to the end of the section. Some records of
        unknown types may lie between them. A synchronisation record, with its magic bytes, is proof by itself.

        Args:
            offset: Offset of the first record.
            section_end: Offset at which the section of the file ends; the last record may be cut off there.
            may_begin_unknown: Whether the first record may be of an unknown type.
        """
        fitting_count = 0
        unknown_count = 0
        while fitting_count < MIN_SEQUENCE_RECORDS:
            if offset >= section_end:
                return fitting_count > 0 or may_begin_unknown
            if self._is_cut_off(offset, section_end):
                return fitting_count > 0 or self._has_data_header(offset)
            fit = self.definitions.fit(offset, section_end)
            if fit is Fit.DAMAGED:
                return False
            if fit is Fit.UNKNOWN:
                unknown_count += 1
                if unknown_count > MAX_UNKNOWN_RECORDS:
                    return False
                if fitting_count == 0 and not may_begin_unknown:
                    return False
            elif self.definitions.header(offset).record_type == SYNC:
                return True
            else:
                fitting_count += 1
            offset = self.definitions.record_end(offset)
        return True

    def _is_cut_off(self, offset: int, section_end: int) -> bool:
        """Returns whether the record at an offset, or its header, goes beyond the end of the section."""
        return (
            section_end - offset < HEADER.size or self.definitions.record_end(offset) > section_end
        )

    def _has_data_header(self, offset: int) -> bool:
        """Returns whether the header of a data record is at an offset, with the length of its subscription."""
        header_bytes = self.content[offset : offset + DATA_HEADER.size]
        return self.definitions.data_length(header_bytes) is not None

    def _is_whole_unknown_record(self, offset: int, section_end: int) -> bool:
        """Returns whether the bytes at an offset are a record of an unknown type, and not damaged bytes.

        A sequence of records that fit the definitions must begin right after the record, and none inside it.

        Args:
            offset: Offset in the file at which the record would begin.
            section_end: Offset at which the section of the file ends.
        """
        record_end = self.definitions.record_end(offset)
        if not self._begins_sequence(record_end, section_end, may_begin_unknown=True):
            return False
        return self._next_sequence(offset + 1, record_end, section_end) is None

    def _next_sequence(self, start: int, stop: int, section_end: int) -> int | None:
        """Returns the first offset of a range at which a sequence of records begins that fit the definitions.

        A regular expression first finds the bytes that look like a header of a record. Only there the records are
        compared with their definitions, which takes much longer.

        Args:
            start: First offset of the range.
            stop: Offset after the range. The sequence may go beyond it.
            section_end: Offset at which the section of the file ends.

        Returns:
            The offset; None if no sequence begins in the range.
        """
        header_pattern = self.definitions.record_start_pattern()
        for header_match in header_pattern.finditer(self.content, start, stop):
            offset = header_match.start()
            if self._begins_sequence(offset, section_end):
                return offset
        return None

    def _damaged_bytes(self, offset: int, section_end: int, latest_offsets: Sequence[int]) -> slice:
        """Finds the bytes to leave out around a record that does not fit, and adds them to ``loss``.

        The data record before it may be damaged too: if bytes are missing, it contains the beginning of a later record;
        if bytes were overwritten, nothing shows it. So it is left out as well, unless only the header of the record
        after it is wrong. The usual end of a log, when the power is switched off, is not a loss: a record that is cut
        off, or memory that was never written.

        Args:
            offset: Offset of the record that does not fit.
            section_end: Offset at which the section of the file ends.
            latest_offsets: Offsets of the last sound records directly before it, ascending.

        Returns:
            The range of offsets to leave out.
        """
        start = offset
        if latest_offsets:
            record_before = latest_offsets[-1]
            if self.definitions.header(record_before).record_type == DATA:
                start = record_before
        # A later record may begin anywhere after the first byte of the first doubtful record.
        next_sound = self._next_sound_record(offset, start + 1, section_end)
        has_sound_record_after = next_sound < section_end
        if not has_sound_record_after and self._may_be_cut_off(offset, section_end):
            self.is_cut = True
            return slice(offset, section_end)
        if not has_sound_record_after and self._is_unwritten(offset, section_end):
            return slice(start, section_end)
        if self._has_wrong_header_only(offset, next_sound):
            start = offset
        records_before = [record for record in latest_offsets if record < start]
        records_after = self._next_data_offsets(next_sound, section_end)
        lost_seconds = self._seconds_between(records_before, records_after)
        self._add_loss(damaged_places=1, lost_bytes=next_sound - start, lost_seconds=lost_seconds)
        return slice(start, next_sound)

    def _next_sound_record(self, damaged_offset: int, search_start: int, section_end: int) -> int:
        """Returns the offset of the first sound (undamaged) record after a damaged one.

        There are two candidates, of which the first one in the file counts: where the damaged record ends by the length
        in its header, if a sound record begins there; and the next place at which several records follow each other.

        Args:
            damaged_offset: Offset of the damaged record.
            search_start: Offset from which on the file is searched for successive records, byte by byte.
            section_end: Offset at which the section of the file ends.

        Returns:
            The offset; ``section_end`` if there is no sound record.
        """
        next_sequence = self._next_sequence(search_start, section_end, section_end)
        next_sound = section_end if next_sequence is None else next_sequence
        record_end = self.definitions.record_end(damaged_offset)
        if record_end < section_end and record_end <= next_sound:
            if self.definitions.fit(record_end, section_end) is Fit.SOUND:
                return record_end
        return next_sound

    def _may_be_cut_off(self, offset: int, section_end: int) -> bool:
        """Returns whether the section may end within a record that begins at an offset, so that its rest is missing.

        The header of a record is its length and, in the last byte, the letter of its type. If not even the header is
        whole, these bytes may always be the beginning of a record. Otherwise the letter must be one of ULog's, and by
        the length the record must go beyond the section's end.

        Args:
            offset: Offset in the file at which the record would begin.
            section_end: Offset at which the section of the file ends.
        """
        has_whole_header = section_end - offset >= HEADER.size
        if not has_whole_header:
            return True
        type_offset = offset + HEADER.size - 1
        has_record_type = TYPE_BYTES.match(self.content, type_offset) is not None
        return has_record_type and self.definitions.record_end(offset) > section_end

    def _is_unwritten(self, offset: int, section_end: int) -> bool:
        """Returns whether only zero bits, or only one bits, follow: the content of memory that was never written."""
        unwritten = UNWRITTEN_BYTES.match(self.content, offset, section_end)
        return unwritten is not None and unwritten.end() == section_end

    def _has_wrong_header_only(self, offset: int, next_record: int) -> bool:
        """Returns whether a damaged record ends where the next sound one begins, so that only its header is wrong.

        A header is the length of the rest of the record and a letter for its type. If the length leads to the next
        record, only the letter is wrong. Otherwise the length is wrong, but it can be checked for a data record: all
        records of one subscription, whose number follows the header, have the same length.

        Args:
            offset: Offset of the damaged record.
            next_record: Offset at which the next sound record begins.
        """
        if self.definitions.record_end(offset) == next_record:
            return True
        length_after_header = next_record - offset - HEADER.size
        # The next record may also begin within this one, if bytes are missing.
        if not 0 < length_after_header <= MAX_RECORD_LENGTH:
            return False
        subscription_number = self.content[offset + HEADER.size : offset + DATA_HEADER.size]
        repaired_header = HEADER.pack(length_after_header, DATA) + subscription_number
        # The length is None unless the subscription has records of the length in this header.
        return self.definitions.data_length(repaired_header) is not None

    def _next_data_offsets(self, offset: int, section_end: int) -> list[int]:
        """Returns the offsets of the next data records from an offset on.

        Records of other types are passed over; damage ends the search.

        Args:
            offset: Offset of the first record that is looked at.
            section_end: Offset at which the section of the file ends.

        Returns:
            ``MIN_SEQUENCE_RECORDS`` offsets, or fewer.
        """
        data_offsets: list[int] = []
        while offset < section_end and len(data_offsets) < MIN_SEQUENCE_RECORDS:
            fit = self.definitions.fit(offset, section_end)
            if fit is Fit.DAMAGED:
                break
            if fit is Fit.SOUND and self.definitions.header(offset).record_type == DATA:
                data_offsets.append(offset)
            offset = self.definitions.record_end(offset)
        return data_offsets

    def _seconds_between(
        self, offsets_before: Sequence[int], offsets_after: Sequence[int]
    ) -> float:
        """Returns the time between the records before a damaged place and those after it.

        The latest stamp before it and the earliest after it may be damaged too, or much older than their neighbours, as
        the first stamp of a topic is. So if a side has more than two stamps, its second one is used.

        Args:
            offsets_before: Offsets of records before the place.
            offsets_after: Offsets of records after the place.

        Returns:
            The time, s, at least 0; 0 if one of the sides has no data record.
        """
        stamps_before = sorted(self._stamps_of_records(offsets_before), reverse=True)
        stamps_after = sorted(self._stamps_of_records(offsets_after))
        if not stamps_before or not stamps_after:
            return 0.0
        last_stamp = stamps_before[1] if len(stamps_before) > 2 else stamps_before[0]
        first_stamp = stamps_after[1] if len(stamps_after) > 2 else stamps_after[0]
        return max(first_stamp - last_stamp, 0) / MICROSECONDS

    def _stamps_of_records(self, offsets: Sequence[int]) -> list[int]:
        """Returns the time stamps of some records, µs since boot; records without a stamp are passed over.

        Args:
            offsets: Offsets of the records in the file.
        """
        stamps = []
        for offset in offsets:
            body_start = offset + DATA_HEADER.size
            length = self.definitions.data_length(self.content[offset:body_start])
            if length is None:
                # It is not a data record.
                continue
            number_bytes = self.content[offset + HEADER.size : body_start]
            subscription = int.from_bytes(number_bytes, "little")
            stamp_offset = self.definitions.topics[subscription].stamp_offset
            if stamp_offset is not None and offset + length <= len(self.content):
                stamp_start = body_start + stamp_offset
                stamp_bytes = self.content[stamp_start : stamp_start + STAMP.size]
                stamps.append(int.from_bytes(stamp_bytes, "little"))
        return stamps

    def _add_loss(self, *, damaged_places: int, lost_bytes: int, lost_seconds: float) -> None:
        """Adds a damaged place, or a record without a definition, to ``loss``, the sum of what the file has lost.

        Args:
            damaged_places: Number of damaged places: 1, or 0 for a record whose definition was lost by earlier damage.
            lost_bytes: Number of bytes that are left out.
            lost_seconds: Time between the records before and after the damaged place, s.
        """
        self.loss = RecordLoss(
            self.loss.damaged_places + damaged_places,
            self.loss.lost_bytes + lost_bytes,
            self.loss.lost_seconds + lost_seconds,
        )
