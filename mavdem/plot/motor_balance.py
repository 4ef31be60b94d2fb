"""Motor balance: what each motor does, how hard it works, and what it has left."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mavdem.condition.hover import HoverFigures
from mavdem.confidence import LEVEL
from mavdem.dem import Learned
from mavdem.plot.style import HAIRLINE, note, per, picture
from mavdem.report.names import Labels, readable
from mavdem.report.palette import COMMAND, INK_ON_LIGHT, PREDICTED

Array = NDArray[np.float64]

LEAST_IMBALANCE = 5.0  # percent, that the axis shows at least: less is not worth a look
ROW, AROUND = 0.3, 0.95  # inches: a motor, and what is above and below


def motors(learned: Learned, hover: HoverFigures | None = None) -> Figure:
    """A row a motor: its effect with the 90 % interval and, where known, its trim beyond the mean and its headroom.

    Args:
        learned: the model, whose physical parameters have the effects.
        hover: of ``mavdem.hover`` or ``mavdem.hover_figures``, for the same motors.

    Raises:
        ValueError: there are no physical parameters, and no ``hover``.
    """
    labels, read = Labels.of(learned), learned.physical
    if read is None and hover is None:
        raise ValueError("there are no motors to show: no physical parameters can be fitted to this flight")
    if hover is not None and len(hover.motors) != len(labels.input_names):
        read = None  # what drives the model is no motor but the demand, which has no row here
    names = labels.input_names if hover is None else hover.motors
    rows = np.arange(len(names))
    panels = (read is not None) + 2 * (hover is not None)
    with picture(AROUND + ROW * len(names)) as figure:
        free = list(np.atleast_1d(figure.subplots(1, panels, sharey=True)))
        free[0].set_yticks(rows, [_placed(name) for name in names])
        free[0].invert_yaxis()
        for axes in free:
            axes.grid(False, axis="y")
            axes.tick_params(axis="y", length=0)
            axes.set_ylim(len(names) - 0.4, -0.6)
        if read is not None:
            unit = readable("rad/s²")
            half = unit.scale * read.interval(LEVEL).effect
            _effects(free.pop(0), unit.scale * read.effect, half, per(unit.name, labels.input_units[0]))
            if not read.identifiable:
                note(figure, "The motors' effect is not identifiable in this flight: no intervals are given.")
        if hover is not None:
            _imbalance(free[0], hover.imbalance)
            _headroom(free[1], hover)
    return figure


def _placed(name: str) -> str:
    """Such as "1 front right", of "motor 1 (front right)"."""
    return name.removeprefix("motor ").replace(" (", " ").rstrip(")")


def _effects(axes: Axes, effect: Array, half: Array, unit: str) -> None:
    rows = np.arange(len(effect))
    axes.barh(rows, effect, 0.55, color=PREDICTED, alpha=1.0 if np.isfinite(half).all() else 0.35)
    if np.isfinite(half).all():
        axes.errorbar(effect, rows, xerr=half, fmt="none", ecolor=INK_ON_LIGHT, capsize=3, linewidth=1.2)
    axes.axvline(0, **HAIRLINE)
    largest = 1.15 * float((np.abs(effect) + np.nan_to_num(half)).max())
    axes.set(xlim=(-largest, largest), title="effect", xlabel=unit)


def _imbalance(axes: Axes, imbalance: Sequence[float]) -> None:
    axes.barh(range(len(imbalance)), imbalance, 0.55, color=COMMAND)
    axes.axvline(0, **HAIRLINE)
    largest = 1.15 * max(LEAST_IMBALANCE, *(abs(value) for value in imbalance))
    axes.set(xlim=(-largest, largest), title="trim", xlabel="beyond mean (%)")


def _headroom(axes: Axes, hover: HoverFigures) -> None:
    """The range of each motor: up to its trim, up to the highest output, and what is left."""
    rows = range(len(hover.motors))
    trim = 100 * np.array(hover.trim_of_range)
    highest = 100 * (1 - np.array(hover.headroom))
    axes.barh(rows, highest, 0.55, color=COMMAND, alpha=0.35)
    axes.plot(trim, rows, "|", color=COMMAND, markersize=13, markeredgewidth=2.2)
    for row, left in zip(rows, hover.headroom, strict=True):
        text: dict[str, Any] = {"ha": "right", "va": "center", "fontsize": 7.5}
        axes.annotate(f"{100 * left:.0f} %", (100, row), (-1, 0), textcoords="offset points", **text)
    axes.set(xlim=(0, 100), title="headroom", xlabel="output (% of full)")
