"""The messages of one component by name, decoded when first asked for."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from mavdem.ingest.clocks import Stamps, Times, boot_clock
from mavdem.ingest.decode import Definition, columns, decode, definitions
from mavdem.ingest.framing import Bytes, Frames
from mavdem.telemetry import Columns

CLOCK_UNITS = {"time_boot_ms": 1e3, "time_boot_us": 1e6, "time_usec": 1e6}
"""Fields that tell the boot clock, the surer first, and their units in a second."""


class Messages(Mapping[str, Columns]):
    """What one component sent: columns by message name, with ``time`` and ``boot`` beside the fields.

    ``repairs`` has a sentence for each thing about the clock that was mended.
    """

    def __init__(self, data: Bytes, frames: Frames, received: Times) -> None:
        """Takes the component's good frames and when each was received, s, NaN where that is not known."""
        self._data = data
        self._frames = frames
        self._decoded: dict[str, Columns] = {}
        order = np.argsort(frames.message_id, kind="stable")
        ids, first = np.unique(frames.message_id[order], return_index=True)
        self._rows = {
            definitions()[message_id].name: (definitions()[message_id], rows)
            for message_id, rows in zip(ids.tolist(), np.split(order, first[1:]), strict=True)
        }
        stamps = [self._stamps(definition, rows) for definition, rows in self._rows.values()]
        self._clock = boot_clock([kind for kind in stamps if kind is not None], received)
        self.repairs = self._clock.repairs

    def __getitem__(self, name: str) -> Columns:
        if name not in self._decoded:
            definition, rows = self._rows[name]
            decoded = columns(decode(self._data, self._frames[rows], definition), definition)
            self._decoded[name] = decoded | {"time": self._clock.time[rows], "boot": self._clock.boot[rows]}
        return self._decoded[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._rows)

    def __len__(self) -> int:
        return len(self._rows)

    def count(self, name: str) -> int:
        """Messages of that name, without decoding them."""
        return len(self._rows[name][1])

    def _stamps(self, definition: Definition, rows: NDArray[np.int64]) -> Stamps | None:
        for name, units in CLOCK_UNITS.items():
            if name in definition.fields:
                kind = definition.wire[name]
                raw = decode(self._data, self._frames[rows], definition)[name]
                period = np.inf if kind.itemsize == 8 else 2.0 ** (8 * kind.itemsize) / units
                return Stamps(definition.name, rows, raw / units, period)
        return None
