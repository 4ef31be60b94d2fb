"""Blocks of another log inside a DataFlash log: what was on the card before, or blocks in a wrong order.

A card that is used again, or whose file table is damaged, gives a file in which some blocks hold an older log. Their
messages are intact, but their times are of another flight: the clock goes to and fro. The blocks of one log continue
each other's clock, so that they form chains. Of two chains that cannot be of one file the one with fewer messages is
left out: they lie inside each other, or satellites show that the later one was recorded at another time.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array, Integers
from mavdem.ingest.mavlink.clocks import (
    MAX_RESTART_TIME,
    MAX_STAMP_DEVIATION,
    MIN_RESET_STEP,
    outlier_stamps,
)

CLUSTER_BYTES = 1 << 17
"""Size of the largest usual cluster of a memory card, bytes: the unit in which a file lies on it (exFAT: 128 KiB)."""

MAX_CLUSTER_SECONDS = 7.0
"""Longest time of a cluster that counts, s: at 20 kB/s. A choice: with more, blocks join another log by chance."""

MAX_HEAD_BYTES = 1 << 16
"""Distance, bytes, of a log's first messages with a time from its definitions: some hundred of 89 bytes, a choice."""

MIN_BLOCK_MESSAGES = 20
"""Number of messages of a block; fewer with a strange time are damaged stamps. A choice, some 500 bytes."""

MAX_RUNS = 5000
"""Number of runs of messages up to which blocks are sought: a choice that bounds the time for hostile files."""


MAX_UTC_DIFFERENCE = 60.0
"""Difference, s, by which the UTC of one boot may disagree within a log: leap seconds, and fixes that are late.

A choice: the logs of two flights on one card are further apart.
"""

MIN_UTC_READINGS = 3
"""Number of satellite times with which a chain's UTC counts as known: a choice, so that a damaged one does not."""

END_OF_FILE = 1 << 62
"""An offset beyond every file."""


class LeftOutBlock(NamedTuple):
    """A block that belongs to another log."""

    start: int
    """Offset of its first message in the file."""

    end: int
    """Offset of the first message after it; ``END_OF_FILE`` for the last."""

    duration: float
    """Time from its first message to its last, s."""


@dataclass(slots=True)
class _Run:
    """Messages that follow each other in the file and in time."""

    first: int
    """Row of the first message."""

    end: int
    """Row after the last."""

    start_time: float
    """Stamp of the first message, s."""

    end_time: float
    """The highest stamp, s."""


class _Chain:
    """Runs of which each continues the clock of the one before.

    Attributes:
        runs: the runs in the order of the file.
        begins_log: whether the definitions with which a log begins are near its first message.
        utc_at_boot: UTC at which its clock read 0, s; None where satellites did not give it.
    """

    def __init__(self, run: _Run, begins_log: bool) -> None:
        """Begins with its first run."""
        self.runs = [run]
        self.begins_log = begins_log
        self.utc_at_boot: float | None = None

    @property
    def end_time(self) -> float:
        """Where its clock is at its end, s."""
        return self.runs[-1].end_time

    @property
    def message_count(self) -> int:
        """Number of its messages."""
        return sum(run.end - run.first for run in self.runs)


class SatelliteTimes(NamedTuple):
    """What satellites say about when the n messages with their time were logged."""

    positions: Integers
    """Offset (n,) of each message, ascending."""

    utc_at_boot: Array
    """UTC (n,), s, less the boot clock: when this clock read 0."""

    @property
    def disagree(self) -> bool:
        """Whether they are of several boots."""
        if len(self.utc_at_boot) < 2 * MIN_UTC_READINGS:
            return False
        return bool(np.ptp(self.utc_at_boot) > MAX_UTC_DIFFERENCE)


def blocks_of_other_logs(
    positions: Integers, seconds: Array, log_starts: Integers, satellites: SatelliteTimes
) -> list[LeftOutBlock]:
    """Finds the blocks of a file whose messages are of another log.

    Args:
        positions: Offset (n,) of each message with a stamp, ascending.
        seconds: Its stamp (n,), s.
        log_starts: Offsets of the definitions (FMT), with which a log begins.
        satellites: The times that satellites give.

    Returns:
        The blocks in the order of the file; none where the clock never goes back, and satellites agree with it.
    """
    if not satellites.disagree and not (np.diff(seconds) < -MIN_RESET_STEP).any():
        return []
    sound_rows = np.flatnonzero(~outlier_stamps(seconds) & (seconds > 0))
    time = seconds[sound_rows]
    if not satellites.disagree and not (np.diff(time) < -MIN_RESET_STEP).any():
        return []
    cluster_seconds = CLUSTER_BYTES * _seconds_per_byte(positions[sound_rows], time)
    max_gap = MAX_STAMP_DEVIATION + min(cluster_seconds, MAX_CLUSTER_SECONDS)
    runs = _runs(time)
    if len(runs) > MAX_RUNS:
        return []
    kept: list[_Chain] = []
    begins_log = [
        bool((abs(log_starts - positions[sound_rows[run.first]]) <= MAX_HEAD_BYTES).any())
        for run in runs
    ]
    chains = _chains(runs, begins_log, max_gap)
    for chain in chains:
        chain.utc_at_boot = _utc_at_boot(chain, positions[sound_rows], satellites)
    for chain in sorted(chains, key=_importance, reverse=True):
        if all(_agree(chain, other) for other in kept):
            kept.append(chain)
    kept_runs = {id(run) for chain in kept for run in chain.runs}
    blocks = []
    for row, run in enumerate(runs):
        if id(run) in kept_runs:
            continue
        end = END_OF_FILE
        if row + 1 < len(runs):
            end = int(positions[sound_rows[runs[row + 1].first]])
        start = int(positions[sound_rows[run.first]])
        blocks.append(LeftOutBlock(start, end, run.end_time - run.start_time))
    return blocks


def _importance(chain: _Chain) -> int:
    """Returns by what chains are ranked: the number of messages."""
    return chain.message_count


def _utc_at_boot(chain: _Chain, positions: Integers, satellites: SatelliteTimes) -> float | None:
    """Returns the UTC at which the clock of a chain read 0, s; None where satellites did not give it.

    Args:
        chain: The chain.
        positions: Offset (n,) of each message with a sound stamp.
        satellites: The times that satellites give in the whole file.
    """
    readings = []
    for run in chain.runs:
        limits = positions[[run.first, run.end - 1]]
        first, end = np.searchsorted(satellites.positions, limits).tolist()
        readings.append(satellites.utc_at_boot[first:end])
    of_chain = np.concatenate(readings)
    return float(np.median(of_chain)) if len(of_chain) >= MIN_UTC_READINGS else None


def _seconds_per_byte(positions: Integers, time: Array) -> float:
    """Returns how long a byte of the log lasts, s: its median over the parts of the size of a cluster."""
    clusters = positions // CLUSTER_BYTES
    first_rows = np.flatnonzero(np.diff(clusters, prepend=-1))
    durations = np.diff(time[np.append(first_rows, len(time) - 1)])
    sizes = np.diff(positions[np.append(first_rows, len(time) - 1)])
    is_forward = (durations > 0) & (sizes > 0)
    if not is_forward.any():
        return 0.0
    return float(np.median(durations[is_forward] / sizes[is_forward]))


def _runs(time: Array) -> list[_Run]:
    """Cuts messages with stamps (n,), s, into runs where the clock goes back or jumps; short runs are left out."""
    steps = np.diff(time)
    cuts = 1 + np.flatnonzero(abs(steps) > MIN_RESET_STEP)
    limits = [0, *cuts.tolist(), len(time)]
    runs = []
    for first, end in zip(limits[:-1], limits[1:], strict=True):
        if end - first >= MIN_BLOCK_MESSAGES:
            runs.append(_Run(first, end, float(time[first]), float(time[first:end].max())))
    return runs


def _chains(runs: list[_Run], begins_log: list[bool], max_gap: float) -> list[_Chain]:
    """Puts together the runs of which each continues another's clock; of several, the one whose end is nearest.

    Args:
        runs: The runs in the order of the file.
        begins_log: Whether the definitions with which a log begins are near the first message of each.
        max_gap: Time, s, that may lie between two of a chain: what another block displaced is missing there.
    """
    chains: list[_Chain] = []
    for run, is_log_start in zip(runs, begins_log, strict=True):
        best_chain = None
        best_distance = max_gap
        for chain in chains:
            advance = run.start_time - chain.end_time
            if advance >= -MIN_RESET_STEP and abs(advance) <= best_distance:
                best_chain = chain
                best_distance = abs(advance)
        if best_chain is None:
            chains.append(_Chain(run, is_log_start))
        else:
            best_chain.runs.append(run)
    return chains


def _agree(chain: _Chain, kept: _Chain) -> bool:
    """Returns whether a chain can be of the same file as a larger one that is kept.

    One of both is before the other in the file. The later one goes on in time, or is another boot: its clock begins
    near zero, or a log begins there. Without the beginning of a log, its UTC must fit too.
    """
    first, second = sorted((chain, kept), key=lambda each: each.runs[0].first)
    if first.runs[-1].first > second.runs[0].first:
        return False
    if second.begins_log:
        return True
    later_begins = second.runs[0].start_time
    goes_on = later_begins >= first.end_time - MIN_RESET_STEP
    if first.utc_at_boot is None or second.utc_at_boot is None:
        return goes_on or later_begins <= MAX_RESTART_TIME
    boot_difference = second.utc_at_boot - first.utc_at_boot
    if goes_on and abs(boot_difference) <= MAX_UTC_DIFFERENCE:
        return True
    # The clock of another boot began after the end of the first one.
    begins_later = boot_difference >= first.end_time - MAX_UTC_DIFFERENCE
    return later_begins <= MAX_RESTART_TIME and begins_later
