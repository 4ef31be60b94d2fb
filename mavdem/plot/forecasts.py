"""Forecasts of held-out windows: measured and forecast outputs with the 90 % band, and the error of every window."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mavdem.evaluate.held_out import CONSTANT_MEAN, FORECAST, HeldOut
from mavdem.plot.style import legend_above, not_blown_up, picture
from mavdem.report.names import Labelled, Readable, readable
from mavdem.report.palette import BAND, BAND_OPACITY, BASELINE, HELD_OUT_OPACITY, MEASURED, PREDICTED

WINDOWS = 8  # that are shown in full
MAX_BEYOND = 0.5  # spans of the measured values, how far the band may widen the axis


def forecast(held: HeldOut, labels: Labelled, output: int = 0, windows: int = WINDOWS) -> Figure:
    """An output beside its forecasts in some windows that no model saw, and the error in every window of the flight.

    Shown in full are neighbouring windows whose errors are nearest to the median of all, not the best ones.

    Args:
        held: the windows.
        labels: names and units of the outputs.
        output: which, in the order of ``labels``.
        windows: how many are shown in full.

    Raises:
        ValueError: no windows.
    """
    if not len(held):
        raise ValueError("there is no held-out window")
    unit = readable(labels.output_units[output])
    shown = typical_windows(held, windows)
    name = labels.output_names[output]
    if len(held) == 1:
        with picture() as figure:
            axes = figure.subplots()
            _windows(axes, held, shown, output, unit)
            axes.set(xlabel="time since boot (s)", ylabel=f"{name} ({unit.name})")
            legend_above(axes)
        return figure
    with picture(4.0) as figure:
        above, below = figure.subplots(2, 1, gridspec_kw={"height_ratios": [5, 3]})
        _windows(above, held, shown, output, unit)
        above.set(ylabel=f"{name} ({unit.name})")
        legend_above(above)
        _errors(below, held, shown, output, unit)
        below.set(xlabel="time since boot (s)", ylabel=f"RMSE ({unit.name})")
    return figure


def typical_windows(held: HeldOut, windows: int) -> slice:
    """The neighbouring windows, without a gap, whose median error ratio is nearest to that of all."""
    ratios = np.nan_to_num(held.error_ratios(), posinf=np.finfo(float).max)
    count = min(windows, len(held))
    overall = np.median(ratios)
    starts = np.arange(len(held) - count + 1)
    gaps = np.diff(held.time[:, 0]) > 2 * held.seconds  # less is left over at the end of a part
    broken = np.array([gaps[start : start + count - 1].any() for start in starts])
    off = np.array([abs(np.median(ratios[start : start + count]) - overall) for start in starts])
    start = int(np.argmin(np.where(broken & ~broken.all(), np.inf, off)))
    return slice(start, start + count)


def _windows(axes: Axes, held: HeldOut, shown: slice, output: int, unit: Readable) -> None:
    """Each window by itself: a forecast begins anew where a window does."""
    for place in range(*shown.indices(len(held))):
        time, first = held.time[place], place == shown.start
        measured, mean, half = (
            unit.scale * values[place, :, output] for values in (held.measured, held.forecasts[FORECAST], held.band)
        )
        axes.plot(time, measured, color=MEASURED, linewidth=1.1, label="measured" * first, zorder=2.1)
        axes.plot(time, mean, color=PREDICTED, label="forecast" * first)
        axes.fill_between(
            time, mean - half, mean + half, color=BAND, alpha=BAND_OPACITY, linewidth=0, label="90 % band" * first
        )
        axes.axvline(time[0], color=MEASURED, linewidth=0.6, alpha=0.5, zorder=1)
    not_blown_up(axes, unit.scale * held.measured[shown, :, output], MAX_BEYOND)


def _errors(axes: Axes, held: HeldOut, shown: slice, output: int, unit: Readable) -> None:
    starts, length = held.time[:, 0], held.seconds
    ours, constant = (unit.scale * np.sqrt(held.squared_errors(name)[:, output]) for name in (FORECAST, CONSTANT_MEAN))
    axes.bar(starts, ours, 0.8 * length, align="edge", color=PREDICTED, label="forecast")
    axes.hlines(
        constant, starts, starts + 0.8 * length, color=BASELINE, linewidth=1.6, label="constant mean (baseline)"
    )
    ends = starts[shown][0], starts[shown][-1] + length
    axes.axvspan(*ends, color=MEASURED, alpha=HELD_OUT_OPACITY, linewidth=0, label="shown above")
    axes.set_xlim(starts[0], starts[-1] + length)
    axes.set_ylim(0, 1.05 * max(np.max(constant), np.percentile(ours[np.isfinite(ours)], 95)))
    legend_above(axes)
