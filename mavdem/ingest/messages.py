"""The messages of one component by name, decoded when first asked for."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavdem.ingest.census import Starts
from mavdem.ingest.checksum import Bytes
from mavdem.ingest.clocks import Placed, Sent, boot_clock
from mavdem.ingest.decode import Definition, columns, definitions
from mavdem.ingest.files import require_whole
from mavdem.ingest.strays import Places, Times
from mavdem.telemetry import Columns

CLOCK_UNITS = {"time_boot_ms": 1e3, "time_boot_us": 1e6, "time_usec": 1e6}
"""Fields that tell the boot clock, the surer first, and their units in a second."""


class Messages(Mapping[str, Columns]):
    """What one component sent: columns by message name, with ``time`` and ``boot`` beside the fields.

    ``repairs`` has a sentence for each thing about the clock that was mended.
    """

    def __init__(
        self, data: Bytes, sent: Mapping[int, Starts], received: Callable[[Places], Times], source: str
    ) -> None:
        """Takes the stream, where the component's good frames begin, and when each was received.

        ``sent`` holds them by message id; ``received`` answers in s, NaN where that is not known; ``source`` is the
        name of the stream.
        """
        kinds = [(definitions()[message_id], starts) for message_id, starts in sent.items()]
        clock = boot_clock([_sent(data, definition, starts, source) for definition, starts in kinds], received)
        self.repairs = clock.repairs
        self._columns = {
            definition.name: _Columns(data, starts, definition, clock.placed[definition.name], source)
            for definition, starts in kinds
        }

    def __getitem__(self, name: str) -> Columns:
        return self._columns[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        return len(self._columns)

    def count(self, name: str) -> int:
        """Messages of that name, without decoding them."""
        return self._columns[name].count


class _Columns(Mapping[str, NDArray[Any]]):
    """One message's columns: its place on the clock is known, its fields are decoded when one is first asked for."""

    def __init__(self, data: Bytes, starts: Starts, definition: Definition, placed: Placed, source: str) -> None:
        self._data, self._starts, self._definition = data, starts, definition
        self._placed, self._source = placed, source
        self._fields: dict[str, NDArray[Any]] | None = None
        self.count = len(starts)

    def __getitem__(self, name: str) -> NDArray[Any]:
        if name == "time":
            return self._placed.time
        if name == "boot":
            return self._placed.boot.astype(np.int64)
        if name not in self._definition.fields:
            raise KeyError(name)
        if self._fields is None:
            require_whole(self._data, self._source)
            self._fields = columns(self._data, self._starts, self._definition)
        return self._fields[name]

    def __iter__(self) -> Iterator[str]:
        yield from (name for name in self._definition.fields if name not in ("time", "boot"))
        yield from ("time", "boot")

    def __len__(self) -> int:
        return len(set(self._definition.fields) | {"time", "boot"})


def _sent(data: Bytes, definition: Definition, starts: Starts, source: str) -> Sent:
    for name, units in CLOCK_UNITS.items():
        if name in definition.fields:
            kind = definition.wire[name]
            period = np.inf if kind.itemsize == 8 else 2.0 ** (8 * kind.itemsize) / units

            def stamps(name: str = name, units: float = units) -> Times:
                require_whole(data, source)
                return np.asarray(columns(data, starts, definition, [name])[name] / units)

            return Sent(definition.name, starts, stamps, period)
    return Sent(definition.name, starts)
