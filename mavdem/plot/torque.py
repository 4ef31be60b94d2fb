"""The disturbance: the wind's torque over time with its gusts, and its spectrum."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mavdem.dem import Learned, WindTorque
from mavdem.dem.record import Record
from mavdem.plot.style import HAIRLINE, THIN, legend_above, note, picture, sample_times, with_gaps
from mavdem.report.names import readable
from mavdem.report.palette import BAND_OPACITY, DISTURBANCE, GUST, MEASURED, TRUTH

Array = NDArray[np.float64]

HIGHEST_HERTZ = 10.0  # of the spectrum: what is faster is noise of the sensors
GUST_OPACITY = 0.3
MIN_RANGE, MAX_RANGE = 1e2, 1e5
"""Of the spectrum's axis, below its largest value."""


def disturbance(learned: Learned, truth: Array | None = None) -> Figure:
    """The wind's torque over time with its 90 % band and gusts, and its spectral density.

    Args:
        learned: the model with its training data, whose physical parameters leave this torque.
        truth: (T,) rad/s², of a simulated flight at the training samples.

    Raises:
        ValueError: there is no wind's torque, since no physical parameters can be fitted.
    """
    wind, record = learned.wind, learned.record
    if wind is None:
        raise ValueError("there is no wind's torque to show: no physical parameters can be fitted to this flight")
    unit = readable("rad/s²")
    with picture(4.0) as figure:
        above, below = figure.subplots(2, 1, gridspec_kw={"height_ratios": [3, 2]})
        above.axhline(0, **HAIRLINE)
        _torque(above, wind, record, unit.scale, truth)
        above.set(xlabel="time since boot (s)", ylabel=f"wind's torque ({unit.name})")
        legend_above(above)
        _spectrum(below, wind, unit.scale)
        below.set(xlabel="frequency (Hz)", ylabel=f"({unit.name})²/Hz")
        legend_above(below)
        if learned.physical is not None and not learned.physical.identifiable:
            note(figure, "The motors' effect is not identifiable in this flight, and so the wind's torque is not.")
        elif wind.reason is not None:
            note(figure, "Not resolved in this flight: errors about as large as the torque itself are to be expected.")
    return figure


def _torque(axes: Axes, wind: WindTorque, record: Record, scale: float, truth: Array | None) -> None:
    time, torque, band = (with_gaps(record, each) for each in (sample_times(record), wind.torque, wind.band))
    low, high = scale * (torque - band), scale * (torque + band)
    axes.fill_between(time, low, high, color=DISTURBANCE, alpha=BAND_OPACITY, linewidth=0, label="90 % band")
    if truth is not None:
        axes.plot(time, scale * with_gaps(record, truth), color=TRUTH, linewidth=1.6, label="truth")
    axes.plot(time, scale * torque, color=DISTURBANCE, linewidth=THIN, label="wind's torque")
    flown = sample_times(record)
    for number, gust in enumerate(wind.gusts):
        start = flown[gust.sample]
        axes.axvspan(
            start, start + gust.length, color=GUST, alpha=GUST_OPACITY, linewidth=0, label="" if number else "gust"
        )


def _spectrum(axes: Axes, wind: WindTorque, scale: float) -> None:
    frequency, density, model = wind.spectrum
    shown = (frequency > 0) & (frequency <= HIGHEST_HERTZ)
    for values, style in (
        (density, {"color": DISTURBANCE, "label": "wind's torque"}),
        (model, {"color": MEASURED, "label": "model of it", "dashes": (4, 2)}),
    ):
        axes.plot(frequency[shown], scale**2 * values[shown], **style)
    axes.set(xscale="log", yscale="log")
    top = scale**2 * float(max(density[shown].max(), model[shown].max()))
    axes.set_ylim(np.clip(axes.get_ylim()[0], top / MAX_RANGE, top / MIN_RANGE), 2 * top)
    axes.xaxis.set_major_formatter("{x:g}")
