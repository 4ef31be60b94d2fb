"""Whether a change of the motors' balance shows at several headings, and wind is not its cause."""

from __future__ import annotations

from typing import TypeVar

import numpy as np

from mavdem.arrays import Array, Flags

HEADING_SECTORS = 6
"""Number of sectors of headings. Within half of 60° the wind comes from much the same side."""

MIN_SECTOR_BLOCKS = 2
"""Fewest blocks of steady flight in a sector whose mean counts; a choice."""

MIN_SHOWN_SHARE = 0.5
"""Share of a change that steady flight in each sector of headings must show; a choice."""

Angle = TypeVar("Angle", float, Array)


def heading_change(heading: Angle, reference: float) -> Angle:
    """Returns the change of a heading, or of several, from a reference, rad, the shorter way round: -pi to pi."""
    return (heading - reference + np.pi) % (2 * np.pi) - np.pi


def is_independent_of_heading(
    blocks: Array, headings: Array, blocks_since: int, change: Array, variance: Array
) -> bool:
    """Returns whether a change of the balance shows at several headings alike, so that no turn explains it.

    Between two headings the torque of the wind differs just as between a sound and a weak motor. So the change must
    show between flight before and after it at a common heading; without a common heading, at all of two or more
    headings after and at none before.

    Each block has a progress along the change: about -1 before it and 0 after it, by projection on the change with
    the weights of least squares.

    Args:
        blocks: (N, a) balance of blocks of flight, the latest last.
        headings: (N,) heading of each block, rad; NaN in turns, which do not count.
        blocks_since: Number of blocks since the change began.
        change: (a,) change of the balance.
        variance: (a,) variance of the change.
    """
    weights = change / variance
    mean_after = blocks[-blocks_since:].mean(axis=0)
    progress = (blocks - mean_after) @ weights / (change @ weights)
    is_after = np.arange(len(blocks)) >= len(blocks) - blocks_since
    progress_before = mean_by_sector(progress, headings, ~is_after)
    progress_after = mean_by_sector(progress, headings, is_after)
    common_sectors = progress_before.keys() & progress_after.keys()
    if common_sectors:
        return all(
            progress_after[sector] - progress_before[sector] > MIN_SHOWN_SHARE
            for sector in common_sectors
        )
    if len(progress_after) < 2 or not progress_before:
        return False
    is_absent_before = max(progress_before.values()) < -MIN_SHOWN_SHARE
    is_present_after = min(progress_after.values()) > -MIN_SHOWN_SHARE
    return is_absent_before and is_present_after


def mean_by_sector(values: Array, headings: Array, selection: Flags) -> dict[int, float]:
    """Averages values of blocks over each sector of headings in which the vehicle flew steadily.

    Args:
        values: (N,) a value of each block.
        headings: (N,) heading of each block, rad; NaN in turns. Sectors are centred on the last one and its multiples
            of 60°.
        selection: (N,) which blocks count.

    Returns:
        The mean by the number of the sector, from that of the last heading on; only sectors with
        ``MIN_SECTOR_BLOCKS`` blocks or more.
    """
    turns = heading_change(headings, headings[-1])
    sector_width = 2 * np.pi / HEADING_SECTORS
    sectors = np.round(turns / sector_width) % HEADING_SECTORS
    means = {}
    for sector in range(HEADING_SECTORS):
        rows = (sectors == sector) & selection
        if np.count_nonzero(rows) >= MIN_SECTOR_BLOCKS:
            means[sector] = values[rows].mean()
    return means
