"""Blocks of another recording in a log or stream: runs (messages with a rising clock) that fit no chain of other runs.

A card that is used again, or whose file table is damaged, gives a file in which some blocks hold an older log. A stream
may hold messages that another sender replays under the vehicle's ids. They are intact, but their times are of another
flight: the clock jumps back and forth. A run is a sequence of messages with a rising clock. The runs of one recording
continue each other's clock, so that they form chains. Of two chains that cannot be of one vehicle the one with fewer
messages is left out: they lie inside each other, or the later one is not a boot that came after the first.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import inf
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array, Flags, Integers
from mavdem.ingest.contents import FileContent
from mavdem.ingest.mavlink.clock_readings import (
    MAX_STAMP_DEVIATION,
    StreamPositions,
    outlier_stamps,
)
from mavdem.ingest.mavlink.reference_clock import MAX_LATE_SECONDS, MAX_RESTART_TIME, MIN_RESET_STEP

CLUSTER_BYTES = 1 << 17
"""Size of the largest usual cluster of a memory card, bytes: the unit in which a file lies on it (exFAT: 128 KiB)."""

MAX_CLUSTER_SECONDS = 7.0
"""Longest time of a cluster that counts, s: at 20 kB/s. A choice: with more, blocks join another log by chance."""

MAX_HEAD_BYTES = 1 << 16
"""Distance, bytes, of a log's first messages with a time from its definitions: some hundred of 89 bytes, a choice."""

MIN_BLOCK_MESSAGES = 20
"""Number of messages of a block; fewer with a strange time are damaged stamps. A choice, some 500 bytes."""

COMPARED_BYTES = 256
"""Number of bytes by which a repeated block is recognised: some messages with their stamps, which never come again."""

MAX_COMPARED_BLOCKS = 100
"""Number of blocks up to which repeated ones are sought: a choice that bounds the time for hostile files."""

MAX_RUNS = 1000
"""Number of runs of messages up to which blocks are sought: a choice that bounds the time for hostile files.

Each run is compared with all others, which takes some seconds for so many.
"""

MAX_UTC_DIFFERENCE = 60.0
"""Difference, s, by which the UTC of one boot may disagree within a log: leap seconds, and fixes that are late.

A choice: the logs of two flights on one card are further apart.
"""

MIN_UTC_READINGS = 3
"""Least number of times in UTC in a run for its UTC to count as known: a choice; a single damaged time must not."""

END_OF_FILE = 1 << 62
"""An offset beyond every file."""


class LeftOutBlock(NamedTuple):
    """A block that belongs to another recording."""

    start: int
    """Offset of its first message in the file."""

    end: int
    """Offset of the first message after it; ``END_OF_FILE`` for the last."""

    duration: float
    """Time from its first message to its last, s."""


class StampedMessages(NamedTuple):
    """The n messages of a recording by whose stamps parts of another recording are found."""

    positions: StreamPositions
    """Offset (n,) of each message, ascending."""

    seconds: Array
    """Its stamp (n,), s."""

    content: FileContent = b""
    """The file, in which repeated blocks are sought; empty where positions are no offsets."""


class BootTimesInUtc(NamedTuple):
    """When the boot clock read 0, by n messages whose time is known in UTC too."""

    positions: StreamPositions
    """Offset (n,) of each message, ascending."""

    utc: Array
    """Time in UTC (n,), s, less the stamp on the boot clock."""

    @property
    def disagree(self) -> bool:
        """Whether they are of several boots: the clock of one boot reads 0 at one time in UTC."""
        # Two boots with a known UTC have so many readings at least.
        if len(self.utc) < 2 * MIN_UTC_READINGS:
            return False
        return bool(np.ptp(self.utc) > MAX_UTC_DIFFERENCE)

    def median_between(self, start: int, end: int) -> float | None:
        """Returns the median UTC, s, at which the boot clock read 0 by the messages of a part of the file.

        Args:
            start: Offset at which the part begins.
            end: Offset before which it ends.

        Returns:
            The median; None if fewer than ``MIN_UTC_READINGS`` messages of the part show it.
        """
        first, stop = np.searchsorted(self.positions, [start, end]).tolist()
        readings = self.utc[first:stop]
        if len(readings) < MIN_UTC_READINGS:
            return None
        return float(np.median(readings))


class ClockRules(NamedTuple):
    """What the clock of one recording may do."""

    max_fall: float
    """Time, s, by which it may go back: messages of a link come late."""

    max_utc_difference: float
    """Difference, s, by which the UTC of its boot may disagree where it continues: infinite for simulators, whose clock
    may run faster than time does."""

    restarts_need_utc: bool
    """Whether a clock that begins near zero must also have begun after the end of what is before it."""


DATAFLASH_RULES = ClockRules(MIN_RESET_STEP, MAX_UTC_DIFFERENCE, restarts_need_utc=True)
"""Of a DataFlash log: it is written in order, and satellites give UTC."""

STREAM_RULES = ClockRules(MAX_LATE_SECONDS, inf, restarts_need_utc=False)
"""Of a MAVLink stream: the receiver's clock gives UTC. Recordings may have been put together in any order."""


@dataclass(slots=True)
class _Run:
    """A run: messages that follow each other in the file and in time."""

    first: int
    """Row of the first message."""

    end: int
    """Row after the last."""

    start_time: float
    """Stamp of the first message, s."""

    end_time: float
    """The highest stamp, s."""

    begins_log: bool
    """Whether the definitions with which a log begins are near its first message."""

    utc_at_boot: float | None
    """UTC at which its clock read 0, s; None where that is not known."""

    is_repeated: bool = False
    """Whether the same bytes are before it in the file."""


class _Chain:
    """A chain: runs of messages, each of which continues the boot clock of the run before.

    Attributes:
        runs: the runs in the order of the file.
        utc_at_boot: UTC at which its clock read 0, s; None if that is not known.
    """

    def __init__(self, run: _Run) -> None:
        """Starts with its first run."""
        self.runs = [run]
        self.utc_at_boot = run.utc_at_boot

    @property
    def end_time(self) -> float:
        """Where its clock is at its end, s."""
        return self.runs[-1].end_time

    @property
    def message_count(self) -> int:
        """Number of its messages."""
        return sum(run.end - run.first for run in self.runs)

    def add(self, run: _Run) -> None:
        """Adds a run that continues its clock."""
        self.runs.append(run)
        if self.utc_at_boot is None:
            self.utc_at_boot = run.utc_at_boot


def blocks_of_other_recordings(
    messages: StampedMessages, log_starts: Integers, boots: BootTimesInUtc, rules: ClockRules
) -> list[LeftOutBlock]:
    """Finds the parts of a file whose messages are of another recording.

    Messages are cut into runs where the clock goes back or jumps. Runs of which each continues the clock of another are
    put together to chains. The chain with most messages is kept, and each further one that agrees with those kept: it
    continues in time, or is another boot of the same vehicle. All other runs are the blocks.

    Args:
        messages: The messages with a stamp.
        log_starts: Offsets of the definitions (FMT), with which a log begins, ascending; none of a stream.
        boots: UTC at which the boot clock read 0, where it is known.
        rules: Limits of what the clock may do.

    Returns:
        The blocks in the order of the file; none if the clock never goes back, and UTC agrees with it.
    """
    may_have_jumped = rules.max_utc_difference < inf and boots.disagree
    if not may_have_jumped and not _clock_falls(messages.seconds, rules):
        return []
    # Damaged stamps, which may be the only falls, are left out.
    is_sound = ~outlier_stamps(messages.seconds) & (messages.seconds > 0)
    positions, time = messages.positions[is_sound], messages.seconds[is_sound]
    if not may_have_jumped and not _clock_falls(time, rules):
        return []
    sound_messages = StampedMessages(positions, time, messages.content)
    runs = _runs_of_rising_clock(sound_messages, log_starts, boots, rules)
    if len(runs) > MAX_RUNS:
        # Each run is compared with all others, which would take too long.
        return []
    # Where a cluster of the memory card holds data of another file, the log lacks the messages of that time.
    cluster_seconds = CLUSTER_BYTES * _seconds_per_byte(positions, time)
    max_gap = MAX_STAMP_DEVIATION + min(cluster_seconds, MAX_CLUSTER_SECONDS)
    kept_chains = _chains_of_largest_recording(_chains_of_runs(runs, max_gap, rules), rules)
    # Runs are compared by their first message, of which each has its own.
    kept_first_rows = {run.first for chain in kept_chains for run in chain.runs}
    # A block that is left out reaches up to the next run, and so includes what lies between the two.
    block_bounds = [*(int(positions[run.first]) for run in runs), END_OF_FILE]
    blocks = []
    for run, (start, end) in zip(runs, pairwise(block_bounds), strict=True):
        if run.first not in kept_first_rows:
            blocks.append(LeftOutBlock(start, end, run.end_time - run.start_time))
    return blocks


def _clock_falls(seconds: Array, rules: ClockRules) -> bool:
    """Returns whether the clock goes back further than messages of one recording may come late.

    Args:
        seconds: Stamps (n,) in the order of the file, s.
        rules: Limits of what the clock may do.
    """
    return bool((np.diff(seconds) < -rules.max_fall).any())


def _chains_of_largest_recording(chains: Sequence[_Chain], rules: ClockRules) -> list[_Chain]:
    """Returns the chain with most messages, and all further ones that can be of the same recording as those kept.

    Args:
        chains: Chains of runs of messages, each of which continues the clock of the run before.
        rules: Limits of what the clock may do.
    """
    kept_chains: list[_Chain] = []
    for chain in sorted(chains, key=lambda chain: chain.message_count, reverse=True):
        if all(_may_be_same_recording(chain, kept_chain, rules) for kept_chain in kept_chains):
            kept_chains.append(chain)
    return kept_chains


def outside_blocks(blocks: Sequence[LeftOutBlock], positions: StreamPositions) -> Flags:
    """Flags the messages of a file that lie in none of its left-out blocks.

    Args:
        blocks: At least one block, in the order of the file.
        positions: Offset (n,) of each message, in any order.

    Returns:
        Flags (n,).
    """
    starts = np.array([block.start for block in blocks])
    block_ends = np.array([block.end for block in blocks])
    # Blocks do not overlap, so only the last one that begins at or before a message can contain it.
    row = np.searchsorted(starts, positions, side="right") - 1
    is_inside = (row >= 0) & (positions < block_ends[row])
    return ~is_inside


def _seconds_per_byte(positions: StreamPositions, time: Array) -> float:
    """Estimates how much flight time a byte of a log stands for: the median over the log's clusters.

    A cluster is the unit in which a memory card stores files. Blocks of another file begin and end with a cluster, so
    the time per byte is computed cluster by cluster, and the median is hardly affected by them.

    Args:
        positions: Offsets (N,) of messages in the file, ascending.
        time: Their stamps (N,), s.

    Returns:
        Seconds per byte; 0 if the time rises in no cluster.
    """
    clusters = positions // CLUSTER_BYTES
    # Row of the first message in each cluster, and the last row.
    first_rows = np.flatnonzero(np.diff(clusters, prepend=-1))
    bounds = np.append(first_rows, len(time) - 1)
    durations = np.diff(time[bounds])
    sizes = np.diff(positions[bounds])
    is_rising = (durations > 0) & (sizes > 0)
    if not is_rising.any():
        return 0.0
    return float(np.median(durations[is_rising] / sizes[is_rising]))


def _runs_of_rising_clock(
    messages: StampedMessages, log_starts: Integers, boots: BootTimesInUtc, rules: ClockRules
) -> list[_Run]:
    """Cuts messages into runs, in each of which the clock rises without a jump; short runs are left out.

    Args:
        messages: The messages with sound stamps.
        log_starts: Offsets of the definitions with which a log begins.
        boots: UTC at which the boot clock read 0, where it is known.
        rules: Limits of what the clock may do.

    Returns:
        The runs in the order of the file, each with its first and last time, the UTC at which its boot clock read 0,
        and whether a log begins with it.
    """
    positions, time, _ = messages
    # Step i is from message i to the next one, with which a new run begins.
    steps = np.diff(time)
    rows_after_fall = np.flatnonzero(steps < -rules.max_fall) + 1
    rows_after_jump = np.flatnonzero(steps > MIN_RESET_STEP) + 1
    end_rows_of_repeated_blocks = _repeated_blocks(messages, rows_after_fall)
    run_bounds = sorted(
        {
            0,
            *rows_after_fall.tolist(),
            *rows_after_jump.tolist(),
            *end_rows_of_repeated_blocks.values(),
            len(time),
        }
    )
    runs: list[_Run] = []
    end_of_run_before = 0
    for first, end in pairwise(run_bounds):
        if end - first < MIN_BLOCK_MESSAGES:
            continue
        first_position, last_position = int(positions[first]), int(positions[end - 1])
        runs.append(
            _Run(
                first,
                end,
                start_time=float(time[first]),
                end_time=float(time[first:end].max()),
                begins_log=_begins_log(first_position, end_of_run_before, log_starts),
                utc_at_boot=boots.median_between(first_position, last_position),
                is_repeated=first in end_rows_of_repeated_blocks,
            )
        )
        end_of_run_before = last_position
    return runs


def _begins_log(first_position: int, end_of_run_before: int, log_starts: Integers) -> bool:
    """Returns whether a log begins with a run: whether the definitions of a log are near its first message.

    Args:
        first_position: Offset of the first message of the run.
        end_of_run_before: Offset of the last message of the run before, after which the definitions must lie; 0 for the
            first run.
        log_starts: Offsets of the definitions with which a log begins, ascending.
    """
    earliest_start = max(first_position - MAX_HEAD_BYTES, end_of_run_before)
    latest_start = first_position + MAX_HEAD_BYTES
    return bool(((log_starts >= earliest_start) & (log_starts < latest_start)).any())


def _repeated_blocks(messages: StampedMessages, falls: Integers) -> dict[int, int]:
    """Finds blocks of messages that repeat bytes from earlier in the file, as if a card had stored a cluster twice.

    A repeated block begins where the clock goes back, since its messages have the stamps of the earlier copy.

    Args:
        messages: The messages with sound stamps, and the bytes of the file.
        falls: Rows of the messages at which the clock goes back.

    Returns:
        The row after the last message of each block, by the row of its first message. None are found without the bytes
        of the file.
    """
    positions, _, content = messages
    end_row_of_block: dict[int, int] = {}
    if not content:
        return end_row_of_block
    for first_row in falls[:MAX_COMPARED_BLOCKS].tolist():
        start = int(positions[first_row])
        earlier_start = content.find(content[start : start + COMPARED_BYTES], 0, start)
        if earlier_start < 0:
            continue
        # The two copies are compared byte by byte up to the first difference, which may be within a message.
        max_size = min(start - earlier_start, len(content) - start)
        earlier_bytes = np.frombuffer(content, np.uint8, max_size, earlier_start)
        repeated_bytes = np.frombuffer(content, np.uint8, max_size, start)
        differences = np.flatnonzero(earlier_bytes != repeated_bytes)
        repeated_size = int(differences[0]) if len(differences) else max_size
        end_row_of_block[first_row] = int(np.searchsorted(positions, start + repeated_size))
    return end_row_of_block


def _chains_of_runs(runs: list[_Run], max_gap: float, rules: ClockRules) -> list[_Chain]:
    """Joins runs of messages to chains: in a chain each run continues the boot clock of the run before.

    Between two runs of a recording there may be a block of another recording, with other times. Such a block becomes a
    chain of its own. If a run may continue several chains, it joins the one whose end is nearest in time.

    Args:
        runs: The runs in the order of the file; those that repeat earlier bytes are left out.
        max_gap: Longest time, s, between two runs of a chain, unless their UTC shows that they are of one boot. A gap
            is possible, since the block between may have replaced messages.
        rules: Limits of what the clock may do.

    Returns:
        The chains, in the order of their first runs.
    """
    chains: list[_Chain] = []
    for run in runs:
        if run.is_repeated:
            continue
        chain = _continued_chain(run, chains, max_gap, rules)
        if chain is None:
            chains.append(_Chain(run))
        else:
            chain.add(run)
    return chains


def _continued_chain(
    run: _Run, chains: Sequence[_Chain], max_gap: float, rules: ClockRules
) -> _Chain | None:
    """Returns the chain that a run of messages continues; of several the one whose end is nearest in time.

    Args:
        run: The run, which comes after all chains in the file.
        chains: The chains so far.
        max_gap: Longest time, s, between two runs of a chain, unless their UTC shows that they are of one boot.
        rules: Limits of what the clock may do.

    Returns:
        The chain; None if the run continues none of them.
    """
    nearest_chain = None
    nearest_gap = inf
    for chain in chains:
        gap = run.start_time - chain.end_time
        goes_back = gap < -rules.max_fall
        if goes_back or abs(gap) >= nearest_gap:
            continue
        if chain.utc_at_boot is not None and run.utc_at_boot is not None:
            is_same_boot = abs(run.utc_at_boot - chain.utc_at_boot) <= MAX_UTC_DIFFERENCE
        else:
            is_same_boot = abs(gap) <= max_gap
        if is_same_boot:
            nearest_chain = chain
            nearest_gap = abs(gap)
    return nearest_chain


def _may_be_same_recording(chain: _Chain, kept_chain: _Chain, rules: ClockRules) -> bool:
    """Returns whether a chain of messages can be of the same recording as a larger chain that is kept.

    One chain must lie before the other in the file. The later one must then continue the boot clock of the earlier one,
    or be of another boot of the vehicle.

    Args:
        chain: The chain: runs of messages, each of which continues the clock of the run before.
        kept_chain: The larger chain, which is of the recording that is read.
        rules: Limits of what the clock may do.
    """
    earlier_chain, later_chain = sorted((chain, kept_chain), key=_first_message)
    is_interleaved = earlier_chain.runs[-1].first > later_chain.runs[0].first
    if is_interleaved:
        return False
    if later_chain.runs[0].begins_log:
        return True
    later_start = later_chain.runs[0].start_time
    continues_time = later_start >= earlier_chain.end_time - rules.max_fall
    starts_near_zero = later_start <= MAX_RESTART_TIME
    # UTC at which the boot clock read 0 is the same throughout a boot, and shows which boot came first.
    if earlier_chain.utc_at_boot is None or later_chain.utc_at_boot is None:
        return continues_time or starts_near_zero
    seconds_between_boots = later_chain.utc_at_boot - earlier_chain.utc_at_boot
    if continues_time and abs(seconds_between_boots) <= rules.max_utc_difference:
        return True
    if starts_near_zero and not rules.restarts_need_utc:
        return True
    has_booted_afterwards = seconds_between_boots >= earlier_chain.end_time - MAX_UTC_DIFFERENCE
    return has_booted_afterwards


def _first_message(chain: _Chain) -> int:
    """Returns the row of the first message of a chain."""
    return chain.runs[0].first
