"""Figures of the paper's experiments: lines, forecasts with the measured outputs, and histograms with a Gaussian."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import norm

from mavdem.arrays import Array
from mavdem.experiments.window import Window
from mavdem.report.figures.style import legend_above, limit_to_values, new_figure
from mavdem.report.palette import BAND_OPACITY, BOUND, MEASURED, PREDICTED, distinct

TRAINING_SAMPLES_SHOWN = 100
"""Last samples of the training data that are shown before a forecast; a choice."""

ROW_HEIGHT = 1.7
"""Inches, the height of the panel of one output."""

HISTOGRAM_HEIGHT = 0.8
"""Inches, the height of one histogram."""

MAX_LEGEND_LINES = 7
"""Names that the legend inside a panel may have; more would cover its lines, and go below the panels; a choice."""

GAUSSIAN_GRID = np.linspace(-4, 4, 161)
"""Standard deviations from the mean at which the Gaussian over a histogram is drawn."""

Panels = Mapping[str, Mapping[str, Array]]
"""Series by the title of their panel and, in each panel, by the name in its legend."""


def draw_lines(
    panels: Panels,
    x_label: str,
    *,
    first_x: int = 0,
    scale: str = "linear",
    bounds: Sequence[float] = (),
) -> Figure:
    """Draws panels side by side, each with lines over whole numbers.

    Args:
        panels: values (N,) by panel and name. A panel whose series have no names has no legend. More than
            ``MAX_LEGEND_LINES`` names must be the same in all panels, which then have one legend below.
        x_label: label of the horizontal axis.
        first_x: number of the first value on the horizontal axis.
        scale: matplotlib's name of the scale of the vertical axis.
        bounds: values at which horizontal lines are drawn in every panel.

    Returns:
        The figure.
    """
    with new_figure() as figure:
        axes_of_panels = figure.subplots(1, len(panels), squeeze=False)[0]
        for axes, (title, series) in zip(axes_of_panels, panels.items(), strict=True):
            for index, (name, values) in enumerate(series.items()):
                x = first_x + np.arange(len(values))
                axes.plot(x, values, ".-", markersize=3, color=distinct(index), label=name)
            for bound in bounds:
                axes.axhline(bound, color=BOUND, linewidth=0.8)
            axes.set(title=title, xlabel=x_label, yscale=scale)
            if all(series) and len(series) <= MAX_LEGEND_LINES:
                axes.legend(fontsize=7)
        handles, names = axes_of_panels[0].get_legend_handles_labels()
        if len(names) > MAX_LEGEND_LINES:
            figure.legend(handles, names, loc="outside lower center", ncols=3, fontsize=7)
        return figure


def draw_forecasts(window: Window, panels: Panels, one_step: Array | None = None) -> Figure:
    """Draws forecasts of a test part with the measured outputs: a row for each output, a column for each panel.

    Args:
        window: T samples of training data and H of test data, with m outputs.
        panels: forecasts (H, m) of the test data, by title of the column and by name.
        one_step: (T, m) one-step predictions of the training data, all of which are then shown; None shows only the
            end of the training part.

    Returns:
        The figure.
    """
    output_count = window.train.outputs.shape[1]
    with new_figure(ROW_HEIGHT * output_count) as figure:
        axes_by_output = figure.subplots(
            output_count, len(panels), sharex=True, sharey="row", squeeze=False
        )
        for output, axes_of_output in enumerate(axes_by_output):
            for axes, (title, forecasts) in zip(axes_of_output, panels.items(), strict=True):
                _draw_output(axes, window, output, forecasts, one_step)
                axes.set_title(title if output == 0 else "")
            name = window.test.output_names[output]
            axes_of_output[0].set_ylabel(f"{name}, {window.test.output_units[output]}")
        for axes in axes_by_output[-1]:
            axes.set_xlabel("time, s")
        legend_above(axes_by_output[0, -1])
        return figure


def _draw_output(
    axes: Axes,
    window: Window,
    output: int,
    forecasts: Mapping[str, Array],
    one_step: Array | None,
) -> None:
    """Draws one output over the time from the start of training; the test part has a grey background.

    Args:
        axes: the panel.
        window: T samples of training data and H of test data.
        output: index of the output.
        forecasts: (H, m) by name.
        one_step: (T, m) predictions of the training data, or None. With them, the whole training part is shown,
            otherwise only the end of it.
    """
    train = window.train
    test = window.test
    # A negative index counts from the end.
    first_shown = 0 if one_step is not None else -TRAINING_SAMPLES_SHOWN
    start_time = train.time[0]
    time = np.concatenate([train.time[first_shown:], test.time]) - start_time
    measured_output = np.concatenate([train.outputs[first_shown:, output], test.outputs[:, output]])
    test_time = test.time - start_time
    axes.axvspan(test_time[0], test_time[-1], color=MEASURED, alpha=BAND_OPACITY, linewidth=0)
    axes.plot(time, measured_output, color=MEASURED, label="measured")
    if one_step is not None:
        # The first sample has no prediction: there is no sample before it.
        axes.plot(
            time[1 : len(train)],
            one_step[1:, output],
            color=PREDICTED,
            label="one step",
            linewidth=0.7,
        )
    for color_index, (name, forecast) in enumerate(forecasts.items(), start=1):
        axes.plot(test_time, forecast[:, output], color=distinct(color_index), label=name)
    # A forecast that diverges would flatten all others.
    limit_to_values(axes, measured_output)


def draw_histograms(series: Mapping[str, Array]) -> Figure:
    """Draws a histogram of each series, as a density, with the density of a standard Gaussian.

    Args:
        series: values (N,) by name, of mean 0 and variance 1.

    Returns:
        The figure.
    """
    with new_figure(HISTOGRAM_HEIGHT * len(series)) as figure:
        panels = figure.subplots(len(series), 1, sharex=True, squeeze=False)[:, 0]
        for axes, (name, values) in zip(panels, series.items(), strict=True):
            axes.hist(values, "auto", density=True, color=PREDICTED, alpha=0.55)
            axes.plot(GAUSSIAN_GRID, norm.pdf(GAUSSIAN_GRID), color=MEASURED)
            axes.set_title(name)
        return figure
