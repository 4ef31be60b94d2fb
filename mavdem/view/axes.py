"""Axes of plots in the Rerun viewer: ranges with numbered ticks, and room for a legend next to the lines.

The viewer numbers an axis of values at multiples of one power of ten only, and draws the legend over the plot.
"""

from math import ceil, floor, log10

from mavdem.confidence import Interval

MIN_TICKS = 2
"""Least number of numbered ticks of an axis of values, so that values between them can be read. A choice."""

TAB_HEIGHT = 900.0
"""Height of a tab of the viewer in a window of 1600 by 1000 points, without the names of the tabs and the time line."""

PLOT_FRAME_HEIGHT = 47.0
"""Height that the title of a plot and the numbers of its time axis take, points."""

MIN_TICK_DISTANCE = 20.0
"""Least distance that the viewer leaves between two numbers of an axis, points."""

AXIS_MARGIN = 0.05
"""Space above and below the values of a plot, each as a share of the span of the values."""

SMALLEST_RELATIVE_SPAN = 0.01
"""Least span of an axis, as a share of the largest value: a smaller one would be numbered with many decimals."""

SMALLEST_SPAN = 1e-9
"""Least span of an axis of values near zero, in their unit."""

LEGEND_SHARE = 0.2
"""Share of the width of a plot that stays free of lines for its legend, on the right: as wide as the longest entry."""

WIDTH_PER_SPAN = 1 / (1 - LEGEND_SHARE)
"""Width of a plot with room for its legend, in spans of its lines."""


def tick_intervals(height_share: float) -> float:
    """Returns for how many intervals between numbered ticks the vertical axis of a plot has room.

    The plot is one of a tab of the Rerun viewer, in a window of usual size.

    Args:
        height_share: height of the plot, as a fraction of the height of its tab.

    Returns:
        The number, which need not be whole.
    """
    plot_height = height_share * TAB_HEIGHT - PLOT_FRAME_HEIGHT
    height_of_values = plot_height / (1 + 2 * AXIS_MARGIN)
    return height_of_values / MIN_TICK_DISTANCE


def range_with_ticks(low: float, high: float, intervals: float) -> Interval:
    """Widens a range of values until the viewer numbers at least ``MIN_TICKS`` ticks in it.

    The distance of the ticks is the smallest power of ten for which the range has at most ``intervals`` of them. While
    there are too few ticks, the range is extended to the next tick below or above, whichever is nearer. A range without
    negative values is not extended below zero, since such quantities are mostly magnitudes.

    Args:
        low: smallest value.
        high: largest value.
        intervals: number of intervals between ticks that the plot has room for.

    Returns:
        Ends of the widened range.
    """
    # A constant has a span of 0; a span relative to its magnitude is used instead, as the viewer does.
    smallest_span = max(SMALLEST_RELATIVE_SPAN * max(abs(low), abs(high)), SMALLEST_SPAN)
    span = max(high - low, smallest_span)
    distance = 10.0 ** ceil(log10(span / intervals))
    first_tick = ceil(low / distance)
    last_tick = floor(high / distance)
    while last_tick - first_tick + 1 < MIN_TICKS:
        distance_below = low - distance * (first_tick - 1)
        distance_above = distance * (last_tick + 1) - high
        crosses_zero = low >= 0 and first_tick <= 0
        if distance_below < distance_above and not crosses_zero:
            first_tick -= 1
        else:
            last_tick += 1
    return min(low, distance * first_tick), max(high, distance * last_tick)
