"""Residuals: the errors of one-step predictions, and what of them the past and the command would still predict."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mavdem.confidence import quantile
from mavdem.dem import Learned
from mavdem.plot.style import HAIRLINE, note, picture, sample_times, with_gaps
from mavdem.report.axis_command import AxisCommand
from mavdem.report.names import Labels, readable
from mavdem.report.palette import BOUND, HELD_OUT_OPACITY, PREDICTED

Array = NDArray[np.float64]

BOUND_LEVEL = 0.99  # share of the correlations at different lags that lie within the bounds by chance
LAG_SECONDS = 0.5


def residuals(learned: Learned, output: int = -1) -> Figure:
    """One-step residuals over time; their autocorrelation, and their correlation with the command before them.

    Correlations beyond the 99 % bounds are what the model leaves: of white residuals that do not depend on the command,
    one in a hundred would be. The bounds of the second allow for autocorrelation of both (Ljung, System Identification,
    2nd ed., sec. 16.6).

    Args:
        learned: the model with its training data.
        output: which, in the order of the flight's outputs; the last one, a rate, unless given.
    """
    labels, command, record = Labels.of(learned), AxisCommand.of(learned), learned.record
    output = range(len(labels.output_names))[output]
    unit, name = readable(labels.output_units[output]), labels.output_names[output]
    errors = record.outputs[:, output] - learned.one_step()[:, output]
    errors[record.starts] = np.nan  # a segment's first is not predicted
    known = ~np.isnan(errors)
    centred, driven = np.where(known, errors - errors[known].mean(), 0.0), command.series(record.inputs)
    lags = round(LAG_SECONDS / learned.dt)
    own, of_command = correlation(centred, centred, lags), correlation(driven, driven, lags)
    across = correlation(driven, centred, lags)
    width = quantile(BOUND_LEVEL) / np.sqrt(known.sum())
    time = np.arange(lags + 1.0) * learned.dt
    with picture(3.8) as figure:
        axes = figure.subplot_mosaic([["time", "time"], ["own", "across"]], height_ratios=[1, 1.25])
        flown, shown_errors = (with_gaps(record, each) for each in (sample_times(record), unit.scale * errors))
        axes["time"].plot(flown, shown_errors, color=PREDICTED, linewidth=0.6)
        shown = unit.scale * float(np.nanmax(np.abs(errors)))
        axes["time"].set(xlabel="time since boot (s)", ylabel=f"residual ({unit.name})")
        axes["time"].set_ylim(-1.15 * shown, 1.15 * shown)
        axes["time"].set_title(f"one-step residual of {name}: RMS {unit.scale * np.nanstd(errors):.2g} {unit.name}")
        _stems(axes["own"], time[1:], own[1:], width)
        axes["own"].set(xlabel="lag (s)", title="autocorrelation")
        # The variance of a correlation of two independent series.
        both = max(1 + 2 * float(own[1:] @ of_command[1:]), 1.0)
        _stems(axes["across"], time, across, width * np.sqrt(both))
        axes["across"].set(xlabel=f"after the {command.name} (s)", title=f"correlation with {command.name}")
        note(figure, f"Grey: where {100 * BOUND_LEVEL:.0f} % of such correlations lie by chance.")
    return figure


def correlation(one: Array, other: Array, lags: int) -> Array:
    """(lags + 1,) of ``one`` at a time with ``other`` 0, 1, … samples later."""
    size = 2 * len(one)
    products = np.fft.irfft(np.conj(np.fft.rfft(one, size)) * np.fft.rfft(other, size), size)[: lags + 1]
    scale = np.sqrt(float(one @ one) * float(other @ other))
    return np.asarray(products / scale if scale else np.zeros(lags + 1))


def _stems(axes: Axes, lag: Array, values: Array, bound: float) -> None:
    axes.axhspan(-bound, bound, color=BOUND, alpha=2 * HELD_OUT_OPACITY, linewidth=0)
    axes.axhline(0, **HAIRLINE)
    axes.vlines(lag, 0, values, color=PREDICTED, linewidth=1.3)
    largest = 1.1 * max(float(np.abs(values).max()), 1.5 * bound)
    axes.set(ylim=(-largest, largest), xlim=(0, LAG_SECONDS))
