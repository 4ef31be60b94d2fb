"""Statistics of a change of the mean in a short, autocorrelated record: its size, variance and likelihood.

The record is a series of blocks. A window is a number of last blocks, in which the mean may differ from that before.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.arrays import Array, Flags

Windows = NDArray[np.int_]
"""(w,) lengths of windows, each that many of the last blocks."""

BLOCK_SECONDS = 0.5
"""Duration of a block, s: a tenth of what the detection of a change may take."""

MEMORY_SECONDS = 60.0
"""Time constant, s, with which blocks before a change lose weight: wind and battery change, and damage is sudden."""

BATCH_LENGTHS = (1, 2, 4, 8)
"""Numbers of neighbouring blocks whose means show the long-run variance; a choice."""

PRIOR_FREEDOM = 5.0
"""Degrees of freedom of the prior of the variance, before the flight has shown its own; a choice."""

PRIOR_BLOCKS_PER_FREEDOM = 2
"""Number of blocks that the prior of the long-run variance weighs as much as, for each degree of freedom: a choice."""

BLOCKS_PER_FREEDOM = 4
"""Number of blocks that count as one more degree of freedom of the variance, since blocks are correlated."""

WANDER_SD = 0.003
"""Standard deviation, relative to the mean command, of a balance that nothing changed: no mean is known better."""


class WindowMeans(NamedTuple):
    """Means of a axes in each of w windows, and before it, over N blocks."""

    lengths: Windows
    """(w,) length of each window, blocks."""
    is_in_window: Flags
    """(w, N) which blocks are in each window."""
    in_window: Array
    """(w, a) mean in the window."""
    before: Array
    """(w, a) mean before it, in which older blocks count less."""
    effective_blocks: Array
    """(w,) number of equally weighted blocks whose mean is as exact as ``before``."""


class WindowChanges(NamedTuple):
    """Change of the mean of a axes for each of w windows."""

    change: Array
    """(w, a) mean in the window less the mean before it."""
    variance: Array
    """(w, a) variance of ``change``."""
    freedom: Array
    """(w,) degrees of freedom of that variance."""
    block_variance: Array
    """(w, a) long-run variance of a block before the window."""


def window_means(blocks: Array, windows: Windows) -> WindowMeans:
    """Averages the last blocks and those before them, for several windows.

    Each window is one assumption on when a change began: so many blocks ago. In the mean before it, older blocks count
    less, by exponential weights with the time constant ``MEMORY_SECONDS``. With weights of sum 1, this mean is as exact
    as that of 1 / Σ weights² equally weighted blocks.

    Args:
        blocks: (N, a) means of successive blocks of flight on a axes, the latest last.
        windows: (w,) length of each window, blocks.

    Returns:
        For each window the means in it and before it.
    """
    # Shapes (w, 1) and (N,) make (w, N): each window by each block.
    window_lengths = windows[:, None]
    block_numbers = np.arange(len(blocks))
    is_in_window = block_numbers >= len(blocks) - window_lengths

    # The older a block is, the less it counts; blocks in the window do not count before it.
    recency = np.exp(block_numbers * (BLOCK_SECONDS / MEMORY_SECONDS))
    weights = np.where(is_in_window, 0.0, recency)
    weights /= weights.sum(axis=1, keepdims=True)
    return WindowMeans(
        windows,
        is_in_window,
        in_window=is_in_window @ blocks / window_lengths,
        before=weights @ blocks,
        effective_blocks=1 / (weights**2).sum(axis=1),
    )


def window_changes(
    blocks: Array, means: WindowMeans, prior_variance: Array, prior_freedom: float
) -> WindowChanges:
    """Compares the mean of the last blocks with the mean before them, for several windows.

    The long-run variance of a block is estimated before each window and in it.

    Args:
        blocks: (N, a) means of successive blocks of flight on a axes, the latest last.
        means: their means in w windows, and before them.
        prior_variance: (a,) prior long-run variance of a block: n times the variance of the mean of n blocks, which
            allows for their correlation.
        prior_freedom: Degrees of freedom of that prior.

    Returns:
        For each window the change, its variance with its degrees of freedom, and the long-run variance of a block.
    """
    block_variance_before = long_run_variance(
        blocks, ~means.is_in_window, means.before, prior_variance, prior_freedom
    )
    block_variance_in_window = long_run_variance(
        blocks, means.is_in_window, means.in_window, block_variance_before, PRIOR_FREEDOM
    )
    # The scatter may have grown with the change: the larger of both counts in the window.
    larger_block_variance = np.maximum(block_variance_before, block_variance_in_window)
    return _changes_of_means(means, block_variance_before, larger_block_variance, prior_freedom)


def changes_with_least_variance(
    means: WindowMeans, prior_variance: Array, prior_freedom: float
) -> WindowChanges:
    """Compares the mean of the last blocks with the mean before them, with a lower bound of the change's variance.

    A block is the mean over some seconds of flight, and a window the last blocks, in which something may have changed.
    The estimate of the long-run variance of a block (:func:`window_changes`) is never below its prior variance. So the
    prior itself gives the lower bound. This takes a fourth of the time of the estimate, and is enough to dismiss
    changes that are small even by the lower bound.

    Args:
        means: means of a axes in w windows, and before them.
        prior_variance: (a,) prior long-run variance of a block: n times the variance of the mean of n blocks.
        prior_freedom: Degrees of freedom of that prior.

    Returns:
        For each window the change, its least variance with its degrees of freedom, and the prior variance of a block.
    """
    # The prior is the same for all windows, and for the blocks before a window and in it.
    least_variance = np.broadcast_to(prior_variance, means.before.shape)
    return _changes_of_means(
        means,
        variance_before=least_variance,
        variance_in_window=least_variance,
        prior_freedom=prior_freedom,
    )


def _changes_of_means(
    means: WindowMeans, variance_before: Array, variance_in_window: Array, prior_freedom: float
) -> WindowChanges:
    """Returns the differences of the means in and before w windows, with their variances.

    The variance of the change is the sum of the variances of both means, and of the slow wander of a balance that
    nothing changed.

    Args:
        means: means of a axes in w windows, and before them.
        variance_before: (w, a) long-run variance of a block before each window.
        variance_in_window: (w, a) long-run variance of a block in each window.
        prior_freedom: Degrees of freedom of the prior of these variances.

    Returns:
        For each window the change, its variance with its degrees of freedom, and the variance of a block before it.
    """
    mean_before_variance = variance_before / means.effective_blocks[:, None]
    mean_in_window_variance = variance_in_window / means.lengths[:, None]
    return WindowChanges(
        change=means.in_window - means.before,
        variance=mean_before_variance + mean_in_window_variance + WANDER_SD**2,
        freedom=prior_freedom + means.effective_blocks / BLOCKS_PER_FREEDOM,
        block_variance=variance_before,
    )


def long_run_variance(
    blocks: Array, selection: Flags, mean: Array, prior_variance: Array, prior_freedom: float
) -> Array:
    """Estimates the long-run variance of blocks: n times the variance of the mean of n blocks.

    Blocks are correlated, so it exceeds the variance of a block. The method of overlapping batch means estimates it as
    n times the variance of the means of n neighbouring blocks, a batch. The duration of the correlation is not known,
    so several lengths n (``BATCH_LENGTHS``) are tried. Each estimate is averaged with the prior, weighted by the
    numbers of independent batches, and the largest average is returned.

    Args:
        blocks: (N, a) means of successive blocks of flight on a axes.
        selection: (w, N) which blocks count, a run without gaps for each of w windows.
        mean: (w, a) mean of those blocks.
        prior_variance: (a,) or (w, a) prior of the long-run variance.
        prior_freedom: Degrees of freedom of the prior; each weighs as much as ``PRIOR_BLOCKS_PER_FREEDOM`` blocks.

    Returns:
        (w, a) long-run variances; at least the prior.
    """
    # Cumulative sums (N + 1, a), whose differences are the sums of any run of blocks. The first one is 0.
    cumulative = np.vstack([np.zeros_like(blocks[:1]), np.cumsum(blocks, axis=0)])
    # The number of blocks that count in each window (w, 1).
    block_count = selection.sum(axis=1, keepdims=True)
    prior_block_count = PRIOR_BLOCKS_PER_FREEDOM * prior_freedom
    largest_variance = prior_variance
    for length in BATCH_LENGTHS:
        if length > len(blocks):
            break
        batch_means = (cumulative[length:] - cumulative[:-length]) / length
        batches = _batch_squares(batch_means, selection, mean, length)
        # The weights are numbers of independent batches, which do not overlap, also of the prior's blocks.
        weight = np.where(batches.batch_count > length, block_count / length, 0.0)
        prior_weight = prior_block_count / length
        # ``length`` times the mean square of the batches is their estimate of the long-run variance.
        weighted_variance = weight * length * batches.squares / np.maximum(batches.batch_count, 1)
        weighted_prior = prior_weight * prior_variance
        average = (weighted_prior + weighted_variance) / (prior_weight + weight)
        largest_variance = np.maximum(largest_variance, average)
    return largest_variance


class _BatchSquares(NamedTuple):
    """Squared deviations of the batches in each of w windows from the mean of the window."""

    batch_count: NDArray[np.int_]
    """(w, 1) number of batches in the window."""
    squares: Array
    """(w, a) sum of their squared deviations."""


def _batch_squares(batch_means: Array, selection: Flags, mean: Array, length: int) -> _BatchSquares:
    """Sums the squared deviations of overlapping batches from a mean, over each of w windows.

    Args:
        batch_means: (M, a) mean of each batch; batch i consists of ``length`` blocks from block i on.
        selection: (w, N) which blocks are in each window, a run without gaps.
        mean: (w, a) mean of each window.
        length: number of blocks of a batch.

    Returns:
        Number and squares of the batches that are wholly in each window.
    """
    # As a window has no gaps, a batch is in it if its first and last block are.
    is_batch_selected = selection[:, : len(batch_means)] & selection[:, length - 1 :]
    count = is_batch_selected.sum(axis=1, keepdims=True)
    # Σ (x − m)² = Σ x² − 2 m Σ x + n m². So no array of shape (w, M, a) is made.
    squares_about_zero = is_batch_selected @ batch_means**2
    cross_terms = 2 * mean * (is_batch_selected @ batch_means)
    return _BatchSquares(count, squares_about_zero - cross_terms + count * mean**2)


def log_t_density(
    changes: WindowChanges, expected: Array | float, extra_variance: Array | float = 0.0
) -> Array:
    """Computes the log density of changes under Student's t distribution about an expected change.

    The distribution is multivariate with a diagonal scale matrix. The axes share the degrees of freedom ν, since their
    variances were estimated from the same part of the flight. With q = Σ error² / variance over the a axes, the density
    is proportional to Π variance^(−1/2) (1 + q / ν)^(−(ν + a) / 2).

    Terms that depend only on the degrees of freedom are left out, since they cancel in Bayes factors.

    Args:
        changes: Changes of a axes for w windows.
        expected: (..., w, a) expected change, or an array or number that broadcasts to it.
        extra_variance: Variance of the expected change, (..., w, a) or what broadcasts to it.

    Returns:
        (..., w) log densities.
    """
    variance = changes.variance + extra_variance
    errors = changes.change - expected
    squares = (errors**2 / variance).sum(axis=-1)
    power = (changes.freedom + variance.shape[-1]) / 2
    return -np.log(variance).sum(axis=-1) / 2 - power * np.log1p(squares / changes.freedom)
