"""The memory of a stream: its latest samples, in blocks of which the oldest is dropped for each new one."""

from collections import deque
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.dem.record import Record, SegmentSamples


class MemoryBlock(NamedTuple):
    """Consecutive samples of one segment that are remembered and dropped together.

    Attributes:
        inputs: (b, r) motor outputs, in the unit of the stream.
        outputs: (b, m) measured motion of the same samples: angle (rad) and rate (rad/s).
        starts_segment: Whether a gap lies before the first sample; otherwise it follows the block before.
        end_time: Time of the last sample, s.
    """

    inputs: Array
    outputs: Array
    starts_segment: bool
    end_time: float


def record_from_blocks(
    blocks: Iterable[MemoryBlock], dt: float, effect_directions: Array | None
) -> Record:
    """Joins blocks to a record for a fit, with a segment for each run of blocks without a gap.

    Args:
        blocks: Blocks in the order of time, at least one. The first begins a segment, even if it is the rest of a
            segment whose earlier blocks have been dropped.
        dt: Sampling step, s.
        effect_directions: (r,) relative effect of each input on the axis; None if it is not known.

    Returns:
        The samples of all blocks in order, with the lengths of the segments and the times at which they begin.
    """
    blocks = list(blocks)
    # Number of samples, and time of the first one, of each segment.
    lengths: list[int] = []
    start_times: list[float] = []
    for block in blocks:
        if block.starts_segment or not lengths:
            lengths.append(0)
            start_times.append(block.end_time - dt * (len(block.outputs) - 1))
        lengths[-1] += len(block.outputs)
    inputs = np.concatenate([block.inputs for block in blocks])
    outputs = np.concatenate([block.outputs for block in blocks])
    return Record(
        inputs,
        outputs=outputs,
        dt=dt,
        lengths=tuple(lengths),
        effect_directions=effect_directions,
        begins=tuple(start_times),
    )


def drop_blocks_since(blocks: deque[MemoryBlock], time: float) -> bool:
    """Drops the latest blocks that end after a time.

    The clock starts again at each boot of the autopilot. If the times decrease from one block to the next, a boot lies
    between, and the blocks before it are kept.

    Args:
        blocks: Blocks in the order in which they were recorded; changed in place.
        time: Time on the clock of the latest block, s.

    Returns:
        Whether any block was dropped.
    """
    # End of the earliest block that was dropped. A block that ends later is of an earlier boot.
    earliest_dropped = np.inf
    while blocks and time < blocks[-1].end_time < earliest_dropped:
        earliest_dropped = blocks.pop().end_time
    return earliest_dropped < np.inf


class SampleMemory:
    """The latest samples of a stream, from several segments with gaps between.

    Attributes:
        blocks: Complete blocks in the order of time. The last block of a segment may be shorter than the others.
        dt: Sampling step, s.
        block_size: Number of samples of a full block.
        effect_directions: (r,) relative effect of each input on the axis, if it is known.
    """

    def __init__(
        self,
        dt: float,
        block_size: int,
        max_blocks: int,
        effect_directions: Array | None = None,
    ) -> None:
        """Begins without samples.

        Args:
            dt: Sampling step, s.
            block_size: Number of samples of a full block.
            max_blocks: Number of blocks that are kept.
            effect_directions: (r,) relative effect of each input on the axis, if it is known.
        """
        self.effect_directions = effect_directions
        self.blocks: deque[MemoryBlock] = deque(maxlen=max_blocks)
        self.dt = dt
        self.block_size = block_size
        # Inputs and outputs of the samples since the last gap, also of those within blocks: (2N, r) and (2N, m) for the
        # N latest, so that they lie in one piece. If the tables are full, the latest N move to their beginning.
        self._max_samples = max_blocks * block_size
        self._input_table: Array = np.empty((0, 0))
        self._output_table: Array = np.empty((0, 0))
        self._samples_since_gap = 0
        # The latest so many of them belong to no block yet.
        self._samples_without_block = 0
        self._next_block_starts_segment = True
        self._latest_time = np.nan

    def add(self, inputs: Array, outputs: Array, time: float) -> bool:
        """Adds the next sample.

        Args:
            inputs: Motor outputs, (r,).
            outputs: Measured motion, (m,).
            time: Time of the sample, s.

        Returns:
            Whether the sample has completed a block, which is now the last of ``blocks``.
        """
        # The tables contain the samples since the last gap; all rows before this one are filled.
        row = self._samples_since_gap
        if row == len(self._input_table):
            row = self._make_room(len(inputs), len(outputs))
        self._input_table[row] = inputs
        self._output_table[row] = outputs
        self._samples_since_gap = row + 1
        self._samples_without_block += 1
        self._latest_time = time
        if self._samples_without_block < self.block_size:
            return False
        self._complete_block()
        return True

    def end_segment(self) -> bool:
        """Ends the segment because a gap follows: the next sample begins another one.

        Returns:
            Whether this has completed a block, which contains the samples that belonged to none yet and may be short.
        """
        has_samples_without_block = self._samples_without_block > 0
        if has_samples_without_block:
            self._complete_block()
        self._next_block_starts_segment = True
        self._samples_since_gap = 0
        return has_samples_without_block

    def record(self) -> Record:
        """Returns the samples of all blocks, of which there must be at least one, as a record for a fit."""
        return record_from_blocks(self.blocks, self.dt, self.effect_directions)

    def latest_samples(self, number: int) -> SegmentSamples:
        """Returns the latest consecutive samples, for example to start a forecast from them.

        Samples before the last gap in time are not among them. Samples that do not yet fill a block of the memory are.

        Args:
            number: Number of samples. If there are fewer since the gap, those are returned.

        Returns:
            The samples in the order of time, as views that are valid until the next sample is added.
        """
        end = self._samples_since_gap
        start = max(end - min(number, self._max_samples), 0)
        return SegmentSamples(self._input_table[start:end], self._output_table[start:end])

    def _make_room(self, inputs: int, outputs: int) -> int:
        """Makes tables for the samples if there are none yet; otherwise moves the latest samples to their beginning.

        Args:
            inputs: Number of inputs, r.
            outputs: Number of outputs, m.

        Returns:
            Row of the tables for the next sample.
        """
        if not len(self._input_table):
            self._input_table = np.empty((2 * self._max_samples, inputs))
            self._output_table = np.empty((2 * self._max_samples, outputs))
            return 0
        kept_samples = self._max_samples
        for table in (self._input_table, self._output_table):
            table[:kept_samples] = table[-kept_samples:]
        return kept_samples

    def _complete_block(self) -> None:
        """Moves the samples that belong to no block yet to a new block, the last of ``blocks``.

        If there are ``max_blocks`` already, the oldest one is dropped.
        """
        inputs, outputs = self.latest_samples(self._samples_without_block)
        # The tables of the memory will be overwritten, so that a block needs copies.
        block = MemoryBlock(
            inputs.copy(), outputs.copy(), self._next_block_starts_segment, self._latest_time
        )
        self.blocks.append(block)
        self._samples_without_block = 0
        self._next_block_starts_segment = False
