"""Blocks of the motors' balance in flight: samples averaged over half a second, and the sequence of these blocks."""

from __future__ import annotations

from collections.abc import Sequence
from math import floor, inf, nan
from typing import Any, NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.dataset.steady_flight import MAX_HEADING_CHANGE
from mavdem.motors.change_statistics import BLOCK_SECONDS
from mavdem.motors.heading_sectors import heading_change

MIN_BLOCK_SAMPLES = 2
"""Number of samples that a block must have: ground stations ask ArduPilot for 4 Hz.

Fewer samples only make a block noisier, and the noise is estimated from the blocks themselves.
"""

MIN_SAMPLE_RATE = MIN_BLOCK_SAMPLES / BLOCK_SECONDS
"""Rate of the samples, Hz, that the detection needs."""

SAMPLE_RATE_TOLERANCE = 0.9
"""Fraction of that rate which is still enough, for jitter."""

UNKNOWN_LEAN = (nan, nan)
"""Roll and pitch of a vehicle whose attitude is not known."""

MIN_PRESENT_FRACTION = 0.8
"""Fraction of the blocks that must be present for variances to be right. A choice."""


class CommandBlock(NamedTuple):
    """Mean of the samples of one block."""

    end: float
    """End of the block, s."""
    commands: Array
    """(k,) mean commands of the motors, as fractions of the range."""
    heading: float
    """Heading at its end, rad; NaN if the vehicle turned, or did not follow its attitude setpoint."""
    lean: Array
    """(2,) mean roll and pitch, rad; NaN where they are not known."""


class BlockAverager:
    """Averages samples over blocks of ``BLOCK_SECONDS`` of the clock, which removes fast noise.

    The first sample of a new block completes the one before.
    """

    def __init__(self) -> None:
        """Begins without a sample."""
        self.restart(0.0, nan)

    def restart(self, time: float, heading: float) -> None:
        """Discards the samples so far, and begins with the block that contains the next sample.

        Args:
            time: Time of the sample, s.
            heading: Heading, rad.
        """
        # The number of the block that is being filled, counted from time 0 of the clock.
        self._number = floor(time / BLOCK_SECONDS)
        self._samples: list[Any] = []
        self._leans: list[Any] = []
        self._start_heading = heading

    def add(
        self,
        time: float,
        commands: Sequence[float] | Array,
        heading: float,
        lean: Sequence[float] | Array = UNKNOWN_LEAN,
    ) -> CommandBlock | None:
        """Adds a sample; if it is the first one of a new block, the block before is complete and is returned.

        Args:
            time: Time of the sample, seconds on the clock of the boot.
            commands: (k,) motor outputs as fractions of the range.
            heading: Heading, rad; NaN where the attitude does not follow its setpoint.
            lean: (2,) roll and pitch, rad; NaN where they are not known.

        Returns:
            The block that this sample completes; None if it completes none, or one with too few samples.
        """
        # Blocks are numbered from time 0 of the clock.
        block_number = floor(time / BLOCK_SECONDS)
        completed_block = None
        if block_number != self._number:
            if len(self._samples) >= MIN_BLOCK_SAMPLES:
                # A comparison with NaN is false, so a heading of NaN is not steady.
                turn = heading_change(heading, self._start_heading)
                is_heading_steady = abs(turn) <= MAX_HEADING_CHANGE * BLOCK_SECONDS
                completed_block = CommandBlock(
                    end=(self._number + 1) * BLOCK_SECONDS,
                    commands=np.mean(self._samples, axis=0),
                    heading=heading if is_heading_steady else nan,
                    lean=np.mean(self._leans, axis=0),
                )
            # The sample is the first one of the next block.
            self._number = block_number
            self._samples = []
            self._leans = []
            self._start_heading = heading
        self._samples.append(commands)
        self._leans.append(lean)
        return completed_block


class SampleRate:
    """Counts samples, to decide whether their rate is high enough for blocks."""

    def __init__(self) -> None:
        """Begins without a sample."""
        self.restart(-inf)

    def restart(self, time: float) -> None:
        """Begins to count again.

        Args:
            time: Time of the next sample, s.
        """
        self._start = time
        self._count = 0

    def add_sample(self, time: float, decision_interval: float) -> bool | None:
        """Counts a sample, and decides at regular intervals whether the samples since the last decision were frequent.

        Args:
            time: Time of the sample, s.
            decision_interval: Time between two decisions, s.

        Returns:
            Whether samples came at ``MIN_SAMPLE_RATE`` or faster, with the tolerance ``SAMPLE_RATE_TOLERANCE``; None
            between decisions.
        """
        elapsed_time = time - self._start
        is_fast_enough = None
        if elapsed_time >= decision_interval:
            min_count = SAMPLE_RATE_TOLERANCE * MIN_SAMPLE_RATE * elapsed_time
            is_fast_enough = self._count > min_count
            self.restart(time)
        self._count += 1
        return is_fast_enough


class BalanceBlocks:
    """The blocks of the flight with which later flight is compared, in the order of time.

    Attributes:
        times: Ends of the blocks, s.
        balances: (a,) balance of each block: torque commands relative to the mean command.
        headings: Heading of each block, rad; NaN in turns.
        leans: (2,) roll and pitch of each block, rad; NaN where they are not known.
        steady_count: Number of all blocks at a steady heading since the last gap, also of those that were forgotten.
    """

    def __init__(self) -> None:
        """Begins without a block."""
        self.clear()

    def clear(self) -> None:
        """Forgets all blocks."""
        self.times: list[float] = []
        self.balances: list[Array] = []
        self.headings: list[float] = []
        self.leans: list[Array] = []
        self.steady_count = 0

    def __len__(self) -> int:
        return len(self.times)

    @property
    def has_gaps(self) -> bool:
        """Whether too many blocks are missing, as after lost messages."""
        expected_count = (self.times[-1] - self.times[0]) / BLOCK_SECONDS + 1
        return len(self) < MIN_PRESENT_FRACTION * expected_count

    def add(self, time: float, balance: Array, heading: float, lean: Array) -> None:
        """Adds the next block in the order of time, and counts it as steady if the vehicle did not turn.

        Args:
            time: End of the block, s.
            balance: (a,) mean balance of the block, the torque of the motors about each axis relative to their thrust.
            heading: Heading of the vehicle in the block, rad; NaN in a turn.
            lean: (2,) mean roll and pitch in the block, rad; NaN where they are not known.
        """
        self.times.append(time)
        self.balances.append(balance)
        self.headings.append(heading)
        self.leans.append(lean)
        if not np.isnan(heading):
            self.steady_count += 1

    def keep_last(self, count: int) -> None:
        """Forgets all blocks but the last ``count``."""
        excess = max(len(self) - count, 0)
        del self.times[:excess]
        del self.balances[:excess]
        del self.headings[:excess]
        del self.leans[:excess]

    def start_of_last(self, count: int) -> float:
        """Returns the time, s, at which the last ``count`` blocks began."""
        return self.times[-count] - BLOCK_SECONDS
