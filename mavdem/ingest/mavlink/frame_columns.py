"""The columns of one MAVLink message, each of which is decoded when it is asked for the first time."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavdem.ingest.byte_rows import Bytes
from mavdem.ingest.mavlink.clocks import BootTimes
from mavdem.ingest.mavlink.definitions import MessageDefinition, decoded_field
from mavdem.ingest.telemetry import Fields


class FrameColumns(Mapping[str, NDArray[Any]]):
    """The columns of one message by field name, with ``time`` and ``boot``; read-only, and decoded on demand.

    A log has hundreds of fields, of which a review needs some dozens. So the recording stays where it is, in memory or
    as a mapped file, and a column is decoded from it when it is asked for. It is kept from then on.
    """

    def __init__(
        self,
        data: Bytes,
        starts: NDArray[np.integer],
        definition: MessageDefinition,
        boot_times: BootTimes,
    ) -> None:
        """Decodes nothing yet.

        Args:
            data: The recording (B,).
            starts: Offset (n,) of the frame of each message.
            definition: The definition of the message.
            boot_times: When each was sent, on the boot clock.
        """
        self._data = data
        self._starts = starts
        self._definition = definition
        self._names = tuple(dict.fromkeys((*definition.fields, "time", "boot")))
        # The columns that were asked for; ``time`` and ``boot`` are no fields of the message.
        self._columns: Fields = {"time": boot_times.time, "boot": boot_times.boot}
        for column in self._columns.values():
            column.setflags(write=False)

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Returns a column (n,), or (n, k) of an array field, and decodes it if nobody has asked for it before."""
        if name not in self._columns:
            if name not in self._names:
                raise KeyError(name)
            column = decoded_field(self._data, self._starts, self._definition, name)
            column.setflags(write=False)
            self._columns[name] = column
        return self._columns[name]

    def __contains__(self, name: object) -> bool:
        """Returns whether there is such a column, without decoding it."""
        return name in self._names

    def __iter__(self) -> Iterator[str]:
        """Yields the names of the columns, those of the message first."""
        return iter(self._names)

    def __len__(self) -> int:
        """Returns the number of columns."""
        return len(self._names)

    def __or__(self, other: Mapping[str, NDArray[Any]]) -> Fields:
        """Returns a dictionary of all columns, in which those of another mapping replace these."""
        return {**self, **other}

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickles all columns, decoded, as a dictionary: another process need not have the recording."""
        return dict, (dict(self),)
