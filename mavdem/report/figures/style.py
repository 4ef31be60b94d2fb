"""Matplotlib's style for all figures, and charts drawn by matplotlib.

Figures have the colours of ``mavdem.report.palette``, angles in degrees, and no background: whoever shows a figure
decides what it stands on. They are made without ``pyplot``, so that they leave no state behind.
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
from mavdem.report.charts.chart import Axis, Chart, Group, Line, LineStyle, Plan
from mavdem.report.palette import BAND_OPACITY, DISTINCT, INK_ON_LIGHT, MEASURED, PAPER_LIGHT

FIGURE_WIDTH = 5.2
"""Width of a figure, inches: letters are readable at 500 pixels, and two figures stand side by side at 1600."""

PIXELS_PER_INCH = 200
"""Resolution of a saved figure: twice that of a page."""

NOTEBOOK_RESOLUTION_FACTOR = 0.65
"""Resolution of a figure in a notebook, as a fraction of ``PIXELS_PER_INCH``."""

CHART_HEIGHT = 1.7
"""Height of each chart of a figure, inches."""

MARGIN_HEIGHT = 0.4
"""Height of a figure in addition to its charts, inches."""

LINE_WIDTH = 1.1
"""Width of a line in most styles, points."""

LINE_WIDTHS = {LineStyle.BOLD: 2 * LINE_WIDTH, LineStyle.WIDE: 2.8}
"""Widths of lines in the other styles, points."""

DOT_FORMATS = {LineStyle.DOTS: "o", LineStyle.SQUARES: "s", LineStyle.JOINED_DOTS: "o-"}
"""Matplotlib's format of the styles that draw a mark for each value."""

INK_SETTINGS = (
    "text.color",
    "axes.labelcolor",
    "axes.titlecolor",
    "axes.edgecolor",
    "xtick.color",
    "ytick.color",
    "grid.color",
)
"""Settings of matplotlib that have the colour of text."""

STYLE: Any = {
    **matplotlib.rc_params_from_file(
        Path(__file__).with_name("figures.mplstyle"), use_default_template=False
    ),
    **dict.fromkeys(INK_SETTINGS, INK_ON_LIGHT),
    "axes.prop_cycle": cycler(color=DISTINCT),
}
"""Settings of matplotlib in which all figures are drawn and saved."""


class BareFigure(Figure):
    """A figure without a background; notebooks show it on white."""

    def savefig(self, fname: Any, **options: Any) -> None:
        """Saves the figure as :meth:`matplotlib.figure.Figure.savefig` does, in the common style."""
        with matplotlib.rc_context(STYLE):
            super().savefig(fname, **{"dpi": PIXELS_PER_INCH} | options)

    def _repr_png_(self) -> bytes:
        """Returns the figure as PNG, for notebooks."""
        file = BytesIO()
        resolution = NOTEBOOK_RESOLUTION_FACTOR * PIXELS_PER_INCH
        self.savefig(file, format="png", dpi=resolution, facecolor=PAPER_LIGHT)
        return file.getvalue()


class Picture(NamedTuple):
    """A figure on a page that is not a chart, such as a landscape of the free energy."""

    title: str
    """What stands above it."""

    caption: str
    """What stands below it, and describes it to readers who do not see it."""

    draw: Callable[[], Figure]
    """Draws the figure."""

    @property
    def group(self) -> Group:
        """The drawn figure as a group of a page."""
        plan = Plan(self.title, self.caption, figure_as_svg(self.draw(), self.title))
        return Group.side_by_side([plan], self.caption)


@contextmanager
def new_figure(height: float = 3.2) -> Iterator[BareFigure]:
    """Yields a new figure of this height, inches, that is drawn in the common style inside the ``with`` block."""
    with matplotlib.rc_context(STYLE):
        layout = ConstrainedLayoutEngine(w_pad=0.03, h_pad=0.03, hspace=0.04, wspace=0.05)
        yield BareFigure(figsize=(FIGURE_WIDTH, height), layout=layout, facecolor="none")


def figure_as_svg(figure: Figure, name: str) -> Markup:
    """Returns a figure as an ``<svg>`` element; the same figure gives the same bytes.

    Args:
        figure: figure to be drawn.
        name: unique on the page, so that the ids inside the element are.
    """
    file = StringIO()
    # Without metadata, such as the date, the bytes depend on the figure alone.
    no_metadata = dict.fromkeys(("Creator", "Date", "Format", "Type"))
    with matplotlib.rc_context(STYLE | {"svg.hashsalt": name}):
        figure.savefig(file, format="svg", metadata=no_metadata)
    text = file.getvalue()
    return Markup(text[text.index("<svg") :])


def legend_above(axes: Axes) -> None:
    """Draws a legend above the axes on the right, where it does not cover data."""
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.01), ncols=5)


def limit_to_values(axes: Axes, values: ArrayLike, margin: float = 0.6) -> None:
    """Limits the vertical axis of a plot to the range of a line and some space, even if its band reaches much further.

    Otherwise a line with a wide band would look flat.

    Args:
        axes: Matplotlib's axes, whose limits are only narrowed.
        values: values of the line, of any shape; NaN is ignored.
        margin: space above and below them, as a multiple of their range.
    """
    array = np.asarray(values, np.float64)
    low = np.nanmin(array)
    high = np.nanmax(array)
    # Values that are all the same have no range, and get a margin in proportion to their size.
    value_range = high - low or max(abs(high), 1.0)
    bottom, top = axes.get_ylim()
    axes.set_ylim(max(bottom, low - margin * value_range), min(top, high + margin * value_range))


def draw_charts(charts: Sequence[Chart]) -> BareFigure:
    """Draws charts below each other with matplotlib.

    Args:
        charts: at least one chart of lines.

    Returns:
        The figure, whose height grows with the number of charts.
    """
    with new_figure(MARGIN_HEIGHT + CHART_HEIGHT * len(charts)) as figure:
        axes_by_row = figure.subplots(len(charts), squeeze=False).ravel()
        for axes, chart in zip(axes_by_row, charts, strict=True):
            _draw_chart(axes, chart)
    return figure


def _draw_chart(axes: Axes, chart: Chart) -> None:
    """Draws lines, spans, levels, axes and title of a chart; with several named lines, a legend too.

    Marks, spectrograms and right axes are only drawn by pages: the charts of a learned model have none.

    Args:
        axes: Matplotlib's axes, which are empty.
        chart: the chart to draw.
    """
    for line in chart.lines:
        _draw_line(axes, line)
    for span in chart.spans:
        axes.axvspan(span.start, span.end, color=MEASURED, alpha=BAND_OPACITY, linewidth=0)
    for level in chart.levels:
        axes.axhline(level, color=MEASURED, linewidth=0.8, zorder=1.5)
    axes.set(xlabel=chart.x.label, xscale=_scale(chart.x), xlim=chart.x.limits)
    axes.set(ylabel=chart.y.label, yscale=_scale(chart.y), ylim=chart.y.limits)
    if chart.y.is_logarithmic:
        # Plain numbers in the place of powers of ten.
        axes.yaxis.set_major_formatter("{x:g}")
    axes.set_title(chart.title)
    named_lines = [line for line in chart.lines if line.name]
    if len(named_lines) > 1:
        legend_above(axes)


def _scale(axis: Axis) -> str:
    """Returns matplotlib's name of the scale of an axis."""
    return "log" if axis.is_logarithmic else "linear"


def _draw_line(axes: Axes, line: Line) -> None:
    """Draws a line of a chart as stems, dots with whiskers, or a solid or dashed line with its band.

    The style of the line decides. Whiskers and bands are drawn where the line has a lower and an upper edge; a band is
    a shaded area.

    Args:
        axes: Matplotlib's axes of the chart.
        line: the line with its samples, its band and its style.
    """
    style: JsonValues = {"color": line.colour, "label": line.name}
    if line.style is LineStyle.STEMS:
        axes.vlines(line.x, 0, line.y, linewidth=1.3, **style)
    elif line.style in DOT_FORMATS:
        whiskers = None
        if line.lower_edge is not None and line.upper_edge is not None:
            whiskers = (line.y - line.lower_edge, line.upper_edge - line.y)
        dot_format = DOT_FORMATS[line.style]
        axes.errorbar(
            line.x, line.y, whiskers, fmt=dot_format, markersize=3.5, linewidth=LINE_WIDTH, **style
        )
    else:
        dashes = (4, 2) if line.style is LineStyle.DASHES else ()
        width = LINE_WIDTHS.get(line.style, LINE_WIDTH)
        axes.plot(line.x, line.y, linewidth=width, dashes=dashes, **style)
        if line.lower_edge is not None and line.upper_edge is not None:
            shade: JsonValues = {"alpha": BAND_OPACITY, "linewidth": 0}
            axes.fill_between(line.x, line.lower_edge, line.upper_edge, color=line.colour, **shade)
