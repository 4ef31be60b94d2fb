"""Style: the size, the letters and the lines that all figures of matplotlib share, and charts drawn by it.

A figure is drawn in the colours of ``mavdem.report.palette``, with angles in degrees and nothing behind it: whoever
shows it decides what it stands on.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from io import BytesIO, StringIO
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from cycler import cycler
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from numpy.typing import ArrayLike

from mavdem.containers import JsonValues
from mavdem.report.charts.chart import Axis, Chart, Group, Kind, Line, Plan
from mavdem.report.palette import BAND_OPACITY, DISTINCT, INK_ON_LIGHT, MEASURED, PAPER_LIGHT

FIGURE_WIDTH = (
    5.2  # inches: letters are read at 500 pixels, and two figures stand side by side at 1600
)
PIXELS_PER_INCH = 200  # of figures that a notebook shows: twice what a page shows
INKED = (
    "text.color",
    "axes.labelcolor",
    "axes.titlecolor",
    "axes.edgecolor",
    "xtick.color",
    "ytick.color",
    "grid.color",
)
STYLE: Any = {
    **matplotlib.rc_params_from_file(
        Path(__file__).with_name("figures.mplstyle"), use_default_template=False
    ),
    **dict.fromkeys(INKED, INK_ON_LIGHT),
    "axes.prop_cycle": cycler(color=DISTINCT),
}


class BareFigure(Figure):
    """A figure without a background, made without ``pyplot``, which notebooks show on white."""

    def savefig(self, fname: Any, **options: Any) -> None:
        """Saves the figure as :meth:`matplotlib.figure.Figure.savefig` does, in its own style."""
        with matplotlib.rc_context(STYLE):
            super().savefig(fname, **{"dpi": PIXELS_PER_INCH} | options)

    def _repr_png_(self) -> bytes:
        file = BytesIO()
        self.savefig(file, format="png", dpi=0.65 * PIXELS_PER_INCH, facecolor=PAPER_LIGHT)
        return file.getvalue()


class Picture(NamedTuple):
    """A figure of a page that is no chart, as of a landscape; ``draw`` makes it."""

    title: str
    caption: str
    draw: Callable[[], Figure]

    @property
    def group(self) -> Group:
        """What a page shows."""
        drawn = Plan(self.title, self.caption, svg_of(self.draw(), self.title))
        return Group.of([drawn], self.caption)


@contextmanager
def new_figure(height: float = 3.2) -> Iterator[BareFigure]:
    """Yields a new figure of this ``height``, inches, in the common style, to be drawn in the block."""
    with matplotlib.rc_context(STYLE):
        layout = ConstrainedLayoutEngine(w_pad=0.03, h_pad=0.03, hspace=0.04, wspace=0.05)
        yield BareFigure(figsize=(FIGURE_WIDTH, height), layout=layout, facecolor="none")


def svg_of(figure: Figure, name: str) -> Markup:
    """Returns the figure as an ``<svg>`` element; its ids are unique on a page if its ``name`` is."""
    drawn = StringIO()
    with matplotlib.rc_context(STYLE | {"svg.hashsalt": name}):
        unsaid = dict.fromkeys(("Creator", "Date", "Format", "Type"))
        figure.savefig(drawn, format="svg", metadata=unsaid)
    text = drawn.getvalue()
    return Markup(text[text.index("<svg") :])


def legend_above(axes: Axes) -> None:
    """Draws a legend above the axes, on the right: never over data."""
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.01), ncols=5)


def limit_to_values(axes: Axes, values: ArrayLike, beyond: float = 0.6) -> None:
    """Limits the vertical axis to ``beyond`` spans beyond these values, however wide a band around them is."""
    shown = np.asarray(values, np.float64)
    low = np.nanmin(shown)
    high = np.nanmax(shown)
    span = high - low or max(abs(high), 1.0)
    bottom, top = axes.get_ylim()
    axes.set_ylim(max(bottom, low - beyond * span), min(top, high + beyond * span))


def draw_charts(charts: Sequence[Chart]) -> BareFigure:
    """Returns ``charts`` below each other."""
    with new_figure(0.4 + 1.7 * len(charts)) as figure:
        grid = figure.subplots(len(charts), squeeze=False).ravel()
        for axes, chart in zip(grid, charts, strict=True):
            _draw(axes, chart)
    return figure


def _draw(axes: Axes, chart: Chart) -> None:
    for line in chart.lines:
        _draw_line(axes, line)
    for start, end, _ in chart.spans:
        axes.axvspan(start, end, color=MEASURED, alpha=BAND_OPACITY, linewidth=0)
    for level in chart.levels:
        axes.axhline(level, color=MEASURED, linewidth=0.8, zorder=1.5)
    axes.set(xlabel=chart.x.label, xscale="log" if chart.x.log else "linear", xlim=chart.x.ends)
    _label(axes, chart.y)
    axes.set_title(chart.title)
    if sum(bool(line.name) for line in chart.lines) > 1:
        legend_above(axes)


def _label(axes: Axes, axis: Axis) -> None:
    axes.set(ylabel=axis.label, yscale="log" if axis.log else "linear", ylim=axis.ends)
    if axis.log:
        axes.yaxis.set_major_formatter("{x:g}")


def _draw_line(axes: Axes, line: Line) -> None:
    x, y = line.x, line.y
    style: JsonValues = {"color": line.colour, "label": line.name}
    if line.kind is Kind.STEMS:
        axes.vlines(x, 0, y, linewidth=1.3, **style)
    elif line.kind is Kind.DOTS:
        ends = None if line.low is None or line.high is None else (y - line.low, line.high - y)
        axes.errorbar(x, y, ends, fmt="o", markersize=3.5, linewidth=1.1, **style)
    else:
        axes.plot(x, y, linewidth=1.1, dashes=(4, 2) if line.kind is Kind.DASHES else (), **style)
        if line.low is not None and line.high is not None:
            shade: JsonValues = {"alpha": BAND_OPACITY, "linewidth": 0}
            axes.fill_between(x, line.low, line.high, color=line.colour, **shade)
