"""Figures for a page of either theme: SVG on nothing, in colours that are read on light and on dark."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

MEASURED, DEM, DEM_WITHOUT, ONE_STEP = "#d9534f", "#2f9e5f", "#d99a00", "#3f80d0"
"""Those of the paper: red, green, yellow, blue."""

SUBSPACE, PEM, EM, OTHER = "#b0673a", "#9467bd", "#4d9db5", "#888888"

_SHARED: dict[str, Any] = {
    "figure.constrained_layout.use": True,
    "savefig.transparent": True,
    "svg.fonttype": "none",
    "svg.hashsalt": "mavdem",
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans", "Helvetica", "Arial", "sans-serif"],
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.alpha": 0.25,
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.4,
    "legend.frameon": False,
    "legend.fontsize": 8,
}


def _theme(ink: str) -> dict[str, Any]:
    coloured = ("text.color", "axes.labelcolor", "axes.edgecolor", "xtick.color", "ytick.color", "grid.color")
    return _SHARED | dict.fromkeys(coloured, ink)


THEMES: dict[str, Any] = {"light": _theme("#24292f"), "dark": _theme("#d6dbe1")}


def in_both_themes(draw: Callable[[], Figure], folder: Path, name: str) -> dict[str, str]:
    """Draws a figure in each theme; returns the files' names by theme."""
    files = {}
    for theme, parameters in THEMES.items():
        files[theme] = f"{name}.{theme}.svg"
        with matplotlib.rc_context(parameters):
            figure = draw()
            figure.savefig(folder / files[theme], metadata={"Date": None})
            plt.close(figure)
    return files


def ink() -> str:
    """The colour of letters in the theme that is set."""
    return str(plt.rcParams["text.color"])


def unseen(axes: Axes, start: float, stop: float) -> None:
    """The grey background that the paper gives to test data."""
    axes.axvspan(start, stop, color="#888888", alpha=0.18, linewidth=0)
    axes.margins(x=0)
