"""Figures of the experiments: lines, forecasts beside what was measured, histograms."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import norm

from mavdem.arrays import Array
from mavdem.experiments.window import Window
from mavdem.report.figures.style import legend_above, limit_to_values, new_figure
from mavdem.report.palette import BAND_OPACITY, BOUND, MEASURED, PREDICTED, distinct

SHOWN_BEFORE = 100  # samples of training that are shown before a forecast
ROW_HEIGHT = 1.7  # inches

Panels = Mapping[str, Mapping[str, Array]]
"""Series by the title of their panel and by name."""


def lines(
    panels: Panels,
    x_label: str,
    *,
    first: int = 0,
    scale: str = "linear",
    bounds: Sequence[float] = (),
) -> Figure:
    """Draws panels, by title, of lines, by name; values (N,) are at whole numbers from ``first`` on."""
    with new_figure() as figure:
        row = figure.subplots(1, len(panels), squeeze=False)[0]
        for axes, (title, series) in zip(row, panels.items(), strict=True):
            for number, (name, values) in enumerate(series.items()):
                at = first + np.arange(len(values))
                axes.plot(at, values, ".-", markersize=3, color=distinct(number), label=name)
            for bound in bounds:
                axes.axhline(bound, color=BOUND, linewidth=0.8)
            axes.set(title=title, xlabel=x_label, yscale=scale)
            if all(series):
                axes.legend(fontsize=7)
        return figure


def forecasts(window: Window, panels: Panels, one_step: Array | None = None) -> Figure:
    """Draws forecasts (H, m) of the test data, by the title of their column and by name, with what was measured.

    ``one_step``: (T, m) predictions of the training data, all of which is then shown.
    """
    train = window.train
    test = window.test
    count = train.outputs.shape[1]
    before = slice(None) if one_step is not None else slice(-SHOWN_BEFORE, None)
    time = np.concatenate([train.time[before], test.time]) - train.time[0]
    with new_figure(ROW_HEIGHT * count) as figure:
        rows = figure.subplots(count, len(panels), sharex=True, sharey="row", squeeze=False)
        for output, row in enumerate(rows):
            measured = np.concatenate([train.outputs[before, output], test.outputs[:, output]])
            for axes, (title, by_name) in zip(row, panels.items(), strict=True):
                axes.axvspan(
                    *(test.time[[0, -1]] - train.time[0]),
                    color=MEASURED,
                    alpha=BAND_OPACITY,
                    linewidth=0,
                )
                axes.plot(time, measured, color=MEASURED, label="measured")
                if one_step is not None:
                    axes.plot(
                        time[1 : len(train)],
                        one_step[1:, output],
                        color=PREDICTED,
                        label="one step",
                        linewidth=0.7,
                    )
                for number, (name, forecast) in enumerate(by_name.items(), 1):
                    axes.plot(
                        test.time - train.time[0],
                        forecast[:, output],
                        color=distinct(number),
                        label=name,
                    )
                # A forecast that diverges would flatten all others.
                limit_to_values(axes, measured)
                axes.set_title(title if output == 0 else "")
            row[0].set_ylabel(f"{test.output_names[output]}, {test.output_units[output]}")
        for axes in rows[-1]:
            axes.set_xlabel("time, s")
        legend_above(rows[0, -1])
        return figure


def histograms(series: Mapping[str, Array]) -> Figure:
    """Draws the densities of series by name, each with a Gaussian of unit variance."""
    grid = np.linspace(-4, 4, 161)
    with new_figure(0.8 * len(series)) as figure:
        panels = figure.subplots(len(series), 1, sharex=True, squeeze=False)[:, 0]
        for axes, (name, values) in zip(panels, series.items(), strict=True):
            axes.hist(values, "auto", density=True, color=PREDICTED, alpha=0.55)
            axes.plot(grid, norm.pdf(grid), color=MEASURED)
            axes.set_title(name)
        return figure
