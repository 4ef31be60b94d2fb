"""Finding runs of records that follow each other in a file without a gap, for a part of the file at once.

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
    """Finds runs of records in a file, by searching one range of offsets after the other."""

    def __init__(
        self, content: FileContent, find_records: Callable[[int, int], PossibleRecords]
    ) -> None:
        """Begins without any searched range.

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
        self._last_rows: Offsets = self._starts

    def run_at(self, position: int, end: int) -> RecordRun | None:
        """Returns the records that follow each other without a gap from an offset to the end of the searched range.

        The file is searched only as far as needed, each time twice as many bytes as the time before.

        Args:
            position: Offset of the first record.
            end: Offset from which on no record begins.

        Returns:
            The run; None if no record begins at ``position``. The last record may go beyond ``end``.
        """
        is_searched = self._searched.start <= position < self._searched.stop <= end
        if not is_searched:
            self._search(slice(position, min(position + self._search_bytes, end)))
            self._search_bytes = min(2 * self._search_bytes, MAX_SEARCH_BYTES)
        row = int(np.searchsorted(self._starts, position))
        if row == len(self._starts) or self._starts[row] != position:
            return None
        last_row = int(self._last_rows[row])
        return RecordRun(self._starts[row : last_row + 1], int(self._ends[last_row]))

    def discard_search(self) -> None:
        """Discards what was found, since a new definition changes what looks like a record."""
        self._searched = slice(0, 0)
        self._search_bytes = MIN_SEARCH_BYTES

    def _search(self, offsets: slice) -> None:
        """Finds the possible records of a range and, for each, the last row of the run to which it belongs.

        A run ends with a record after whose last byte no other record begins. The results replace those of the range
        searched before.

        Args:
            offsets: Range of offsets at which records may begin.
        """
        self._searched = offsets
        self._starts, self._ends = self._find_records(offsets.start, offsets.stop)
        ends_run = np.ones(len(self._starts), dtype=np.bool_)
        ends_run[:-1] = self._ends[:-1] != self._starts[1:]
        # The index of a row's run is the number of runs that end before the row.
        run_of_row: Offsets = np.cumsum(ends_run) - ends_run
        self._last_rows = np.flatnonzero(ends_run)[run_of_row]
        # The pages of a mapped file remain in memory until they are released.
        self._resident_bytes += offsets.stop - offsets.start
        if self._resident_bytes >= RESIDENT_BYTES:
            release_pages(self._data)
            self._resident_bytes = 0
