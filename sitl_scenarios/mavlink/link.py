"""A lossy link: frames get lost, late or reordered, by chance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sitl_scenarios.mavlink.batch import Batch, joined
from sitl_scenarios.plan import BOOT_SECONDS
from sitl_scenarios.scenario import Faults


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
