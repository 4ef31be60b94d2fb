"""Style: the size, the letters and the lines that all figures share, where their legends stand, and SVG for a page.

A figure is drawn in the colours of ``mavdem.report.palette``, with angles in degrees and nothing behind it: whoever
shows it decides what it stands on. Of lines of many samples only the extremes are drawn.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO, StringIO
from pathlib import Path
from textwrap import fill
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from cycler import cycler
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from numpy.typing import ArrayLike, NDArray

from mavdem.dem.engine.linalg import Array
from mavdem.dem.record import Record
from mavdem.report.palette import BAND_OPACITY, DISTINCT, INK_ON_LIGHT, MEASURED, PAPER_LIGHT

WIDTH = 5.2  # inches: letters are read at 500 pixels, and two figures stand side by side at 1600
MAX_POINTS = 1200  # of a line or a band, beyond which the extremes of half as many parts are drawn
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

THIN = 0.9  # points: measured lines, of many samples
# of zero, bounds and the like
HAIRLINE: dict[str, Any] = {"color": MEASURED, "linewidth": 0.8, "zorder": 1.5}


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


class Room(NamedTuple):
    """Inches around a figure's axes, for their labels, and between its rows and its columns."""

    left: float = 0.62
    right: float = 0.1
    bottom: float = 0.42
    top: float = 0.26
    rows: float = 0.16
    columns: float = 0.16

    def give(self, figure: Figure) -> None:
        """Places the axes of a figure; what is written below them all has its lines beside."""
        width, height = figure.get_size_inches()
        below = figure.get_supxlabel()
        # for each line of small letters
        bottom = self.bottom + (0.16 * (1 + below.count("\n")) if below else 0.0)
        grid = figure.axes[0].get_gridspec()
        rows, columns = (1, 1) if grid is None else grid.get_geometry()
        inside = height - bottom - self.top, width - self.left - self.right
        between = zip((self.rows, self.columns), (rows, columns), inside, strict=True)
        hspace, wspace = (gap * count / (size - gap * (count - 1)) for gap, count, size in between)
        sides = self.left / width, bottom / height, 1 - self.right / width, 1 - self.top / height
        figure.subplots_adjust(*sides, wspace, hspace)


@contextmanager
def picture(
    height: float = 3.2, room: Room | None = None, width: float = WIDTH
) -> Iterator[BareFigure]:
    """Yields a new figure of this ``height``, inches, in the common style, to be drawn in the block.

    Without ``room`` matplotlib measures what labels take, which takes it longer than the drawing.
    """
    with matplotlib.rc_context(STYLE):
        layout = (
            None
            if room
            else ConstrainedLayoutEngine(w_pad=0.03, h_pad=0.03, hspace=0.04, wspace=0.05)
        )
        figure = BareFigure(figsize=(width, height), layout=layout, facecolor="none")
        yield figure
        if room is not None:
            room.give(figure)
        for axes in figure.axes:
            for line in axes.lines:
                x, y = map(np.asarray, line.get_data())
                if len(y) > MAX_POINTS:
                    kept = _extremes(y, y)
                    line.set_data(x[kept], y[kept])


def _extremes(low: Array, high: Array) -> NDArray[np.intp]:
    """Indices of what shows a band (N,), or a line: its least and largest in each of many parts, gaps, and ends."""
    gaps = np.flatnonzero(np.isnan(low + high))
    size = -(-len(low) // (MAX_POINTS // 2))
    padded = np.pad([low, -high], ((0, 0), (0, -len(low) % size)), mode="edge").reshape(2, -1, size)
    found = np.argmin(np.where(np.isnan(padded), np.inf, padded), axis=2) + size * np.arange(
        padded.shape[1]
    )
    return np.unique(np.minimum([*found.ravel(), *gaps, 0, len(low)], len(low) - 1))


def svg(figure: Figure, name: str) -> str:
    """Returns the figure as an ``<svg>`` element; its ids are unique on a page if its ``name`` is."""
    drawn = StringIO()
    with matplotlib.rc_context(STYLE | {"svg.hashsalt": name}):
        # ``savefig`` would draw twice where there is a layout.
        figure.dpi = PIXELS_PER_INCH
        canvas: Any = FigureCanvasSVG(figure)
        canvas.print_svg(drawn, metadata=dict.fromkeys(("Creator", "Date", "Format", "Type")))
    text = drawn.getvalue()[drawn.getvalue().index("<svg") :]
    # Hundredths of a point are enough of what is drawn; what is written keeps its digits.
    text = re.sub("<[^>]+>", lambda tag: re.sub(r"(\.\d\d)\d+", r"\1", tag[0]), text)
    # Groups of all figures have the same ids, to which nothing refers.
    used = set(re.findall(r"#(\w+)", text))
    return re.sub(r' id="([^"]*)"', lambda match: match[0] if match[1] in used else "", text)


def band(
    axes: Axes, x: Array, low: Array | float, high: Array | float, colour: str, label: str = ""
) -> None:
    """Draws the filled band between two lines (N,), or levels."""
    if len(x) > MAX_POINTS:
        low = np.broadcast_to(low, x.shape)
        high = np.broadcast_to(high, x.shape)
        kept = _extremes(low, high)
        x = x[kept]
        low = low[kept]
        high = high[kept]
    axes.fill_between(x, low, high, color=colour, alpha=BAND_OPACITY, linewidth=0, label=label)


def legend_above(axes: Axes, columns: int = 5) -> None:
    """Draws a legend above the axes, on the right: never over data."""
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.01), ncols=columns)


def not_blown_up(axes: Axes, values: ArrayLike, beyond: float = 0.6) -> None:
    """Limits the vertical axis to ``beyond`` spans beyond these values, however wide a band around them is."""
    shown = np.asarray(values, np.float64)
    low = float(np.nanmin(shown))
    high = float(np.nanmax(shown))
    span = high - low or max(abs(high), 1.0)
    bottom, top = axes.get_ylim()
    axes.set_ylim(max(bottom, low - beyond * span), min(top, high + beyond * span))


def note(figure: Figure, text: str) -> None:
    """Writes a remark below everything else, small."""
    figure.supxlabel(fill(text, 92), x=0.01, ha="left", fontsize=7.5)


def plain(text: str) -> str:
    """Returns a text of a log as matplotlib shows it letter by letter: as no formula."""
    return text.replace("$", r"\$")


def sample_times(record: Record) -> NDArray[np.float64]:
    """Returns (T,) s of the samples of a record: on the flight's clock or, where that is not known, since the first."""
    segments = zip(record.begins or tuple(record.dt * record.starts), record.lengths, strict=True)
    return np.concatenate([begin + record.dt * np.arange(length) for begin, length in segments])


def with_gaps(record: Record, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns (T + segments − 1,) values (T,) with NaN between segments, where a line is to break."""
    return np.insert(values, record.starts[1:], np.nan)
