"""Wind in m/s: its speed over time, beside the autopilot's own estimate."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from mavdem.alignment.drive import Signal
from mavdem.condition import WindVelocity
from mavdem.report.figures.style import THIN, band, legend_above, picture
from mavdem.report.numbers import from_point
from mavdem.report.palette import BASELINE, DISTURBANCE


def wind_over_time(wind: WindVelocity, own: Signal | None = None) -> Figure:
    """Draws the speed with its 90 % band and the ``own`` estimate of the autopilot; the mean's direction above."""
    speed = np.hypot(*wind.velocity.T)
    half = np.hypot(*(wind.velocity * wind.band).T) / np.maximum(speed, 1e-9)
    with picture() as figure:
        axes = figure.subplots()
        band(axes, wind.time, np.maximum(speed - half, 0), speed + half, DISTURBANCE, "90 % band")
        axes.plot(wind.time, speed, color=DISTURBANCE, linewidth=THIN, label="wind")
        if own is not None:
            axes.plot(own.time, np.hypot(*own.values.T), color=BASELINE, linewidth=THIN, label="autopilot's own")
        axes.set(xlabel="time since boot (s)", ylabel="speed (m/s)", xlim=wind.time[[0, -1]])
        axes.set(ylim=(0, None), title="" if wind.calm else f"from {from_point(wind.direction)}")
        legend_above(axes)
    return figure
