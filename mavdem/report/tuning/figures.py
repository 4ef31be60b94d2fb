"""Figures of a control loop as text, such as a phase margin of "57 (50 to 63)" degrees."""

from math import nan
from typing import NamedTuple

from mavdem.loops.axis_loops import Loop
from mavdem.report.numbers import UNKNOWN_FIGURE, rounded


class LoopFigure(NamedTuple):
    """A figure of a loop as a table shows it."""

    header: str
    """Its name with the shown unit."""

    scale: float
    """Factor from its own unit to the shown one."""


LOOP_FIGURES = {
    "crossover": LoopFigure("crossover (Hz)", 1.0),
    "phase_margin": LoopFigure("phase margin (°)", 1.0),
    "gain_margin": LoopFigure("gain margin (dB)", 1.0),
    "delay_margin": LoopFigure("delay margin (ms)", 1e3),
    "ms": LoopFigure("maximum sensitivity Ms", 1.0),
    "bandwidth": LoopFigure("bandwidth, -3 dB (Hz)", 1.0),
    "rejection": LoopFigure("peak response to a disturbance of 100 °/s² (°/s, °)", 100.0),
}
"""Figures in the table of a loop, by the attribute of ``OpenLoop``."""


FIGURES_OF_STABLE_LOOPS = ("ms", "bandwidth", "rejection")
"""Figures of ``LOOP_FIGURES`` that are of a steady response, which an unstable loop never reaches."""


TUNED_FIGURES = ("phase_margin", "gain_margin", "ms", "crossover")
"""Figures of ``LOOP_FIGURES`` beside the gains to set: what the goal of tuning is made of, and the loop's speed.

The speed is the gain crossover, which follows the gains. The bandwidth jumps where the closed loop has long been flat
beside −3 dB: with two thirds of the gains it may fall to a fifth, though the step response rises as before.
"""


def figure_text(loop: Loop, loop_name: str, figure_name: str) -> str:
    """Returns a figure of a control loop with its 90 % interval as text, such as "57 (50 to 63)".

    Args:
        loop: the identified loops of an axis, for the estimated plant and draws from its posterior.
        loop_name: "rate" or "attitude".
        figure_name: name of the figure in ``LOOP_FIGURES``, such as "phase_margin"; an open loop has its interval as
            "phase_margin_interval".
    """
    if not _has_figure(loop, loop_name, figure_name):
        return rounded(nan)
    open_loop = loop.open_loop(loop_name)
    interval = getattr(open_loop, f"{figure_name}_interval")
    scale = LOOP_FIGURES[figure_name].scale
    return text_with_interval(getattr(open_loop, figure_name), interval, scale)


def value_text(loop: Loop, loop_name: str, figure_name: str) -> str:
    """Returns a figure of a control loop as text without its interval, such as "57".

    Args:
        loop: the identified loops of an axis.
        loop_name: "rate" or "attitude".
        figure_name: name of the figure in ``LOOP_FIGURES``.
    """
    if not _has_figure(loop, loop_name, figure_name):
        return rounded(nan)
    return rounded(
        LOOP_FIGURES[figure_name].scale * getattr(loop.open_loop(loop_name), figure_name)
    )


def _has_figure(loop: Loop, loop_name: str, figure_name: str) -> bool:
    """Returns whether a figure of a control loop means anything; where it does not, its formula may give a good number.

    Figures of a steady response, such as Ms, need a stable loop. All figures of the attitude loop need a gain |L| that
    stays below 1 once it has fallen below: a rate loop close to an oscillation has a peak that lifts it above 1 once
    more, and the margins there are none of the attitude.

    Args:
        loop: the identified loops of an axis.
        loop_name: "rate" or "attitude".
        figure_name: name of the figure in ``LOOP_FIGURES``.
    """
    open_loop = loop.open_loop(loop_name)
    if loop_name == "attitude" and not open_loop.has_one_crossover:
        return False
    return open_loop.is_stable or figure_name not in FIGURES_OF_STABLE_LOOPS


def text_with_interval(value: float, interval: tuple[float, float], scale: float) -> str:
    """Returns a figure with its interval as text, such as "57 (50 to 63)".

    The interval is left out if one of its ends is NaN, or if it is narrower than the last digit that is shown.

    Args:
        value: the figure, in its own unit.
        interval: lower and upper end of its interval, in the same unit.
        scale: factor from that unit to the shown one.
    """
    text = rounded(scale * value)
    low = rounded(scale * interval[0])
    high = rounded(scale * interval[1])
    is_unknown = UNKNOWN_FIGURE in (low, high)
    if is_unknown or text == low == high:
        return text
    return f"{text} ({low} to {high})"
