"""A lossy link: frames in order, each with a time, get lost, late or reordered, by chance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mavdem.ingest.mavlink.framing import Bytes, Frames, concatenated
from sitl_scenarios.plan import BOOT_SECONDS
from sitl_scenarios.scenario import Faults


@dataclass(frozen=True, eq=False)
class Batch:
    """N frames, one behind the other in ``data``."""

    time: NDArray[np.float64]  # (N,) s of the flight, ascending: when each was sent, or is received
    data: Bytes  # their bytes
    frames: Frames  # the table of them

    def __len__(self) -> int:
        return len(self.time)

    def taken(self, rows: NDArray[np.intp], time: NDArray[np.float64]) -> Batch:
        """The frames of these rows (M,), in this order, at the times (M,)."""
        chosen = self.frames[rows]
        length = chosen.end - chosen.start
        end = np.cumsum(length)
        start = end - length
        # Each byte's place is its frame's, and its own within it.
        places = np.repeat(chosen.start - start, length) + np.arange(end[-1] if len(end) else 0)
        moved = replace(chosen, start=start, end=end, payload=chosen.payload - chosen.start + start)
        return Batch(time, self.data[places], moved)

    def content(self) -> list[bytes]:
        """The bytes of each frame."""
        whole = self.data.tobytes()
        places = zip(self.frames.start.tolist(), self.frames.end.tolist(), strict=True)
        return [whole[start:end] for start, end in places]


def joined(batches: Sequence[Batch]) -> Batch:
    """Batches, one at least, one behind the other."""
    time, data = (np.concatenate([getattr(batch, name) for batch in batches]) for name in ("time", "data"))
    tables, by = [], 0
    for batch in batches:
        own = batch.frames
        tables.append(replace(own, start=own.start + by, end=own.end + by, payload=own.payload + by))
        by += len(batch.data)
    return Batch(time, data, concatenated(tables))


class LossyLink:
    """A link with ``faults``. What it does to a frame depends on the seed and on how many came before, nothing else.

    A frame that is late delays those behind it: only what is ``reordered`` is overtaken.
    """

    def __init__(self, faults: Faults, seed: int) -> None:
        self._faults = faults
        # The key sets it apart from everything else that begins with the seed of the flight.
        self._random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0x6C696E6B,)))
        self._latest = -np.inf
        self._held: Batch | None = None

    def pass_on(self, batch: Batch) -> Batch:
        """The frames that arrive, at the times they do; one that is to be overtaken waits for the next."""
        faults = self._faults
        lost, late, overtaken = self._random.random((len(batch), 3)).T
        there = np.flatnonzero((lost >= faults.loss) & ~self.out(batch.time))
        time = batch.time[there] + faults.delay + faults.jitter * late[there]
        time = np.maximum.accumulate(np.maximum(time, self._latest))
        self._latest = float(time[-1]) if len(time) else self._latest
        arriving = batch.taken(there, time) if len(there) < len(batch) or faults.delay or faults.jitter else batch
        waits = overtaken[there] < faults.reordered
        if self._held is not None and len(arriving):
            arriving, waits = joined([self._held, arriving]), np.concatenate([[True], waits])
            self._held = None
        return self._swapped(arriving, np.flatnonzero(waits).tolist())

    def out(self, time: NDArray[np.float64] | float) -> NDArray[np.bool_]:
        """Whether the link is lost at a time, s of the motion."""
        since = np.asarray(time) - BOOT_SECONDS - (np.inf if self._faults.outage is None else self._faults.outage)
        return (since >= 0.0) & (since < self._faults.outage_seconds)

    def rest(self) -> list[Batch]:
        """The frame that is still held, at the end."""
        held, self._held = self._held, None
        return [] if held is None else [held]

    def _swapped(self, batch: Batch, waits: list[int]) -> Batch:
        """The batch with each frame that waits behind the next; the last, if it waits, is held."""
        order = np.arange(len(batch))
        free = 0
        for row in waits:
            if row < free:
                continue  # it has itself just overtaken another
            if row + 1 == len(batch):
                last = order[-1:]
                self._held = batch.taken(last, batch.time[last])
                return batch.taken(order[:-1], batch.time[:-1])
            order[row], order[row + 1] = row + 1, row
            free = row + 2
        return batch.taken(order, batch.time) if free else batch
