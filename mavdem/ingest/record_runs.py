"""Finding runs of records (records that follow each other in a file without a gap), for many records at once.

A log is a chain: the length of a record gives the offset of the next one. Following it record by record costs more than
decoding all of them. Here every place that looks like the beginning of a record is found by comparing arrays, and those
are linked of which one begins where another ends. Places that only look so, within a record, are linked to nothing
that leads to them.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from mavdem.ingest.byte_rows import RESIDENT_BYTES, Offsets, release_pages
from mavdem.ingest.contents import FileContent

MIN_SEARCH_BYTES = 1 << 16
"""Number of bytes of the file that are searched at once at first, and again after a definition: a choice.

It is small, since each definition within the searched bytes has them searched again.
"""

MAX_SEARCH_BYTES = 1 << 20
"""Number of bytes that are searched at once where no more definitions follow: a choice.

A larger number costs fewer calls, but its arrays do not fit into the cache of a processor.
"""


class PossibleRecords(NamedTuple):
    """What looks like N records in a range of offsets of a file."""

    starts: Offsets
    """Offset at which each begins (N,), ascending."""
    ends: Offsets
    """Offset after the last byte of each (N,), which follows from its length."""


class RecordRun(NamedTuple):
    """Records that follow each other without a gap."""

    starts: Offsets
    """Offset at which each begins (R,)."""
    end: int
    """Offset after the last byte of the last one."""


class RecordRuns:
    """Finds runs of records (records without a gap between them) in a file, range by range of its offsets."""

    def __init__(
        self, content: FileContent, find_records: Callable[[int, int], PossibleRecords]
    ) -> None:
        """Starts with no searched range.

        Args:
            content: Bytes of the file.
            find_records: Function that returns what looks like records that begin from a first offset on and before
                another one.
        """
        self._data = np.frombuffer(content, dtype=np.uint8)
        self._find_records = find_records
        # Number of bytes that were searched since pages of a mapped file were released.
        self._resident_bytes = 0
        self._searched = slice(0, 0)
        self._search_bytes = MIN_SEARCH_BYTES
        self._starts: Offsets = np.zeros(0, dtype=np.int64)
        self._ends: Offsets = self._starts
        # The row of the last record of its run, for each possible record of the searched range.
        self._last_row_of_run: Offsets = self._starts

    def run_at(self, offset: int, end: int) -> RecordRun | None:
        """Returns the records that follow each other without a gap from an offset on, as far as the file was searched.

        The file is searched range by range, since comparing arrays is fast only for many records at once. If the offset
        is not in the range that was searched last, a new range is searched that begins there. Each range is twice as
        long as the one before, up to ``MAX_SEARCH_BYTES``.

        Args:
            offset: Offset of the first record, bytes.
            end: Offset from which on no record begins.

        Returns:
            The run, whose last record may go beyond ``end``; None if no record begins at ``offset``.
        """
        is_in_searched_range = self._searched.start <= offset < self._searched.stop
        if not is_in_searched_range or self._searched.stop > end:
            self._search_range(slice(offset, min(offset + self._search_bytes, end)))
            self._search_bytes = min(2 * self._search_bytes, MAX_SEARCH_BYTES)
        first_row = int(np.searchsorted(self._starts, offset))
        if first_row == len(self._starts) or self._starts[first_row] != offset:
            return None
        last_row = int(self._last_row_of_run[first_row])
        return RecordRun(self._starts[first_row : last_row + 1], int(self._ends[last_row]))

    def discard_search(self) -> None:
        """Discards what was found, since a new definition changes what looks like a record."""
        self._searched = slice(0, 0)
        self._search_bytes = MIN_SEARCH_BYTES

    def _search_range(self, offsets: slice) -> None:
        """Finds what looks like a record in a range of the file and, for each, the last record of its run.

        The results replace those of the range that was searched before.

        Args:
            offsets: Range of offsets at which records may begin.
        """
        self._searched = offsets
        self._starts, self._ends = self._find_records(offsets.start, offsets.stop)
        self._last_row_of_run = _last_rows_of_runs(self._starts, self._ends)
        self._resident_bytes += offsets.stop - offsets.start
        # The searched pages of a mapped file remain in memory until they are released.
        if self._resident_bytes >= RESIDENT_BYTES:
            release_pages(self._data)
            self._resident_bytes = 0


def _last_rows_of_runs(starts: Offsets, ends: Offsets) -> Offsets:
    """Returns for each record the row of the last record of its run: if rows 0 to 2 are a run, 2 for each of them.

    Args:
        starts: Offset at which each record begins (N,), ascending.
        ends: Offset after the last byte of each (N,).

    Returns:
        The rows (N,).
    """
    # A record is the last of its run unless the next one begins where it ends.
    is_last_of_run = np.ones(len(starts), dtype=np.bool_)
    is_last_of_run[:-1] = starts[1:] != ends[:-1]
    last_rows = np.flatnonzero(is_last_of_run)
    # A run has the rows after the last one of the run before. The first run begins at row 0, that is after row −1.
    record_counts = np.diff(last_rows, prepend=-1)
    return np.repeat(last_rows, record_counts)
