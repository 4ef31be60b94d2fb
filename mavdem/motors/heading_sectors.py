"""Test whether a change of the motors' balance shows at several headings, so that wind is not its cause."""

from __future__ import annotations

from typing import TypeVar

import numpy as np

from mavdem.arrays import Array, Flags

HEADING_SECTORS = 6
"""Number of sectors of headings. Within half of 60° the wind blows from much the same side."""

MIN_SECTOR_BLOCKS = 2
"""Fewest blocks of steady flight in a sector whose mean counts; a choice."""

MIN_SHOWN_FRACTION = 0.5
"""Fraction of a change that steady flight in each sector of headings must show; a choice."""

Angle = TypeVar("Angle", float, Array)


def heading_change(heading: Angle, reference: float) -> Angle:
    """Returns the change of a heading, or of several, from a reference, rad, the shorter way round: -pi to pi."""
    return (heading - reference + np.pi) % (2 * np.pi) - np.pi


def is_independent_of_heading(
    blocks: Array, headings: Array, changed_block_count: int, change: Array, variance: Array
) -> bool:
    """Returns whether a change of the motors' balance holds at each heading, so that no turn explains it.

    The balance is the torque that the motors make about each axis, relative to their thrust. Wind from another side
    changes it too: a vehicle that turns may look as if a motor had become weak. So flight before and after the change
    is compared at the same heading. Headings are sorted into six sectors:

    1. If the vehicle flew in some sectors both before and after the change, each of them must show the change.
    2. Otherwise all sectors after the change, at least two, must show it, and no sector before it.

    How far a block is in the change is its progress: the projection of its balance, relative to the mean after the
    change, on the change, by weighted least squares. It is about −1 before the change, and about 0 after it.

    Args:
        blocks: (N, a) balance about a axes in N successive blocks of flight, the latest last.
        headings: (N,) heading of each block, rad; NaN in turns, which are ignored.
        changed_block_count: Number of the last blocks, those since the change began.
        change: (a,) mean balance after the change less that before it.
        variance: (a,) variance of the change.

    Returns:
        Whether the change shows at each heading.
    """
    # Weighted least squares: axes on which the change is known precisely count more.
    weights = change / variance
    first_changed_block = len(blocks) - changed_block_count
    mean_after = blocks[first_changed_block:].mean(axis=0)
    progress = (blocks - mean_after) @ weights / (change @ weights)
    is_after = np.arange(len(blocks)) >= first_changed_block
    progress_before = mean_by_sector(progress, headings, ~is_after)
    progress_after = mean_by_sector(progress, headings, is_after)
    common_sectors = progress_before.keys() & progress_after.keys()
    if common_sectors:
        for sector in common_sectors:
            # A full change is a step of 1, from -1 to 0.
            step = progress_after[sector] - progress_before[sector]
            if not step > MIN_SHOWN_FRACTION:
                return False
        return True
    if len(progress_after) < 2 or not progress_before:
        return False
    # Without a common sector, each side is compared with the level halfway between "before" (-1) and "after" (0).
    is_absent_before = max(progress_before.values()) < -MIN_SHOWN_FRACTION
    is_present_after = min(progress_after.values()) > -MIN_SHOWN_FRACTION
    return is_absent_before and is_present_after


def mean_by_sector(values: Array, headings: Array, selection: Flags) -> dict[int, float]:
    """Averages values of blocks of flight over each sector of headings.

    The circle has six sectors of 60°. Sector 0 is centred on the heading of the last block, so that the current heading
    never lies on a border; the others follow clockwise.

    Args:
        values: (N,) value of each block.
        headings: (N,) heading of each block, rad; NaN if the vehicle turned, and the block belongs to no sector.
        selection: (N,) whether a block is used.

    Returns:
        The mean by the number of the sector, 0 to 5. Sectors with fewer than ``MIN_SECTOR_BLOCKS`` blocks are left out,
        since one block is too noisy.
    """
    # Angle from the current heading. If that is NaN, in a turn, so are all of them, and no sector has blocks.
    turns = heading_change(headings, headings[-1])
    sector_width = 2 * np.pi / HEADING_SECTORS
    sectors = np.round(turns / sector_width) % HEADING_SECTORS
    means = {}
    for sector in range(HEADING_SECTORS):
        is_selected = (sectors == sector) & selection
        if np.count_nonzero(is_selected) >= MIN_SECTOR_BLOCKS:
            means[sector] = values[is_selected].mean()
    return means
