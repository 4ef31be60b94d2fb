"""Ticks: ranges of an axis on which the viewer writes at least two numbers, so that a picture can be read."""

from __future__ import annotations

from math import ceil, floor, log10

MARGIN = 0.05
"""Left free beyond the values, in parts of their span."""

LABELS, LABELS_IF_LOW, LABELS_ACROSS = 9, 6, 6
"""The viewer numbers the multiples of a power of ten where no more than about so many are in sight: up pictures a
quarter of the window high, up lower ones, and across."""


def readable_range(low: float, high: float, labels: int = LABELS) -> tuple[float, float]:
    """A range that holds low to high with a margin, and two multiples of the power of ten the viewer numbers."""
    span = max(high - low, 1e-9 * max(abs(low), abs(high), 1.0))
    low, high = low - MARGIN * span, high + MARGIN * span
    step = 10.0 ** floor(log10(high - low))
    if (high - low) / step > labels:
        step *= 10
    while floor(high / step) - ceil(low / step) < 1:
        below, above = (ceil(low / step) - 1) * step, (floor(high / step) + 1) * step
        # Whichever number is nearer, with room to write it.
        if low - below < above - high:
            low = below - MARGIN * (high - below)
        else:
            high = above + MARGIN * (above - low)
    return low, high
