"""The columns of one MAVLink message, each of which is decoded when it is first used."""

from collections import OrderedDict
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavdem.ingest.byte_rows import Bytes, mapping_of
from mavdem.ingest.mavlink.clock_readings import BootTimes
from mavdem.ingest.mavlink.dialect import MessageDefinition
from mavdem.ingest.mavlink.payloads import (
    SentPayloads,
    decoded_field,
    decoded_payloads,
    sent_payloads,
)
from mavdem.ingest.telemetry import Fields

MAX_BYTES_OF_MAPPED_COLUMNS = 1 << 23
"""Number of bytes of the decoded columns of a mapped recording that are kept: a choice.

All columns of hours of flight would take as much memory as the file. Of the columns that ``mavdem info`` needs of 300
MB, one in seven is decoded again; with four times this number it is one in sixteen, but the memory is 8 % more.
"""


class DecodedColumns:
    """The decoded columns of a recording: all of one in memory, the latest ones of a mapped file.

    Of a mapped file memory is scarce, while a column of hours is decoded again within a tenth of a second.

    Attributes:
        is_mapped: Whether the recording is a mapped file.
    """

    def __init__(self, data: Bytes) -> None:
        """Creates an empty cache of decoded columns of a recording.

        Args:
            data: The recording (B,).
        """
        self.is_mapped = mapping_of(data) is not None
        self._max_bytes = MAX_BYTES_OF_MAPPED_COLUMNS if self.is_mapped else np.inf
        self._bytes = 0
        # The keys are message and field; the most recently used one is last.
        self._columns: OrderedDict[tuple[str, str], NDArray[Any]] = OrderedDict()

    def column(self, message: str, name: str) -> NDArray[Any] | None:
        """Returns a stored column, and notes that it was used; None if it is not stored and must be decoded.

        Args:
            message: name of the message ("ATTITUDE").
            name: name of the field ("roll").
        """
        column = self._columns.get((message, name))
        if column is not None:
            self._columns.move_to_end((message, name))
        return column

    def store(self, message: str, name: str, column: NDArray[Any]) -> None:
        """Stores a decoded column, and discards the least recently used ones while all take too much memory.

        Args:
            message: name of the message ("ATTITUDE").
            name: name of the field ("roll").
            column: its values (n,), or (n, k) of an array field.
        """
        self._columns[message, name] = column
        self._bytes += column.nbytes
        while self._bytes > self._max_bytes and len(self._columns) > 1:
            _, discarded_column = self._columns.popitem(last=False)
            self._bytes -= discarded_column.nbytes


class FrameColumns(Mapping[str, NDArray[Any]]):
    """The columns of one message by field name, with ``time`` and ``boot``; read-only, and decoded on demand.

    A log has hundreds of fields, of which a review needs some dozens. So the recording stays where it is, in memory or
    as a mapped file. Of a mapped file a column is decoded when it is first used; of a recording in memory all fields of
    the message are decoded when the first one is. Each decoded column is cached in ``DecodedColumns``.
    """

    def __init__(
        self,
        data: Bytes,
        starts: NDArray[np.integer],
        definition: MessageDefinition,
        boot_times: BootTimes,
        decoded: DecodedColumns | None = None,
    ) -> None:
        """Decodes nothing yet.

        Args:
            data: The recording (B,).
            starts: Offset (n,) of the frame of each message.
            definition: MAVLink's definition of the message: names, types and order of its fields.
            boot_times: Time when each was sent, on the boot clock.
            decoded: The decoded columns of all messages of the recording, to be shared by them. Unless given, these
                messages have a store of their own.
        """
        self._data = data
        self._starts = starts
        self._definition = definition
        self._names = tuple(dict.fromkeys((*definition.fields, "time", "boot")))
        self._decoded = decoded or DecodedColumns(data)
        self._payloads: SentPayloads | None = None
        # All fields of the messages (n,): of a recording in memory, where another copy is of no concern.
        self._table: NDArray[np.void] | None = None
        # ``time`` and ``boot`` are no fields of the message.
        self._clock_columns: Fields = {"time": boot_times.time, "boot": boot_times.boot}
        for column in self._clock_columns.values():
            column.setflags(write=False)

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Returns a column (n,), or (n, k) of an array field, and decodes it unless it is stored.

        Raises:
            KeyError: The message has no such field.
        """
        if name in self._clock_columns:
            return self._clock_columns[name]
        message = self._definition.name
        column = self._decoded.column(message, name)
        if column is None:
            if name not in self._names:
                raise KeyError(name)
            if self._payloads is None:
                self._payloads = sent_payloads(self._data, self._starts)
            column = self._decoded_column(name, self._payloads)
            column.setflags(write=False)
            self._decoded.store(message, name, column)
        return column

    def _decoded_column(self, name: str, payloads: SentPayloads) -> NDArray[Any]:
        """Decodes a field of all messages.

        If the recording is in memory, all fields of the message are decoded when the first one is used, since this
        takes little longer than one field. If it is a mapped file, only this field is decoded, to save memory.

        Args:
            name: Name of the field ("roll").
            payloads: Offset of each message's payload in its frame, and number of its bytes that were sent.

        Returns:
            The column (n,), or (n, k) of an array field.
        """
        is_mapped_file = self._decoded.is_mapped
        if is_mapped_file:
            return decoded_field(self._data, self._starts, self._definition, name, payloads)
        if self._table is None:
            self._table = decoded_payloads(self._data, self._starts, self._definition, payloads)
        return np.ascontiguousarray(self._table[name])

    def __contains__(self, name: object) -> bool:
        """Returns whether there is such a column, without decoding it."""
        return name in self._names

    def __iter__(self) -> Iterator[str]:
        """Yields the names of the columns, the fields of the message first."""
        return iter(self._names)

    def __len__(self) -> int:
        """Returns the number of columns."""
        return len(self._names)

    def __or__(self, other: Mapping[str, NDArray[Any]]) -> Fields:
        """Returns a dictionary of all columns; where ``other`` has a column of the same name, that one is taken."""
        return {**self, **other}

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickles all columns, decoded, as a dictionary: another process need not have the recording."""
        return dict, (dict(self),)
