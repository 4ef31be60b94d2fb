"""Wind in m/s: speed and direction over time beside a compass with its arrow, and the rose of a fleet's flights."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from mavdem.alignment.drive import Signal
from mavdem.condition import WindVelocity
from mavdem.fleet.row import Flight
from mavdem.report.figures.style import THIN, band, legend_above, picture
from mavdem.report.numbers import POINTS, speed_and_direction
from mavdem.report.palette import BAND_OPACITY, BASELINE, DISTURBANCE

CLASSES = (0.0, 2.0, 4.0, 6.0, 8.0, 10.0, np.inf)  # m/s between the colours of a rose
LEAST_SPEED = 1.0  # m/s: below, a direction is that of the errors, and is not drawn


def wind_over_time(wind: WindVelocity, own: Signal | None = None) -> Figure:
    """Draws speed and direction with 90 % bands, and the mean on a compass; ``own``: the autopilot's estimate."""
    series = [("wind", DISTURBANCE, wind.time, wind.velocity, wind.band)]
    if own is not None:
        series.append(("autopilot's own", BASELINE, own.time, own.values, np.zeros_like(own.values)))
    mosaic: Any = [["speed", "compass"], ["from", "compass"]]
    kinds: Any = {"compass": {"projection": "polar"}}
    with picture(3.4) as figure:
        panels = figure.subplot_mosaic(mosaic, width_ratios=[3, 1.3], per_subplot_kw=kinds)
        for name, colour, time, velocity, half in series:
            (speed, angle), halves = speed_and_direction(velocity, half)
            # About the mean, so that it does not jump at north.
            angle = np.where(speed < LEAST_SPEED, np.nan, (angle - wind.direction + 180) % 360 - 180 + wind.direction)
            for panel, values, width in zip(("speed", "from"), (speed, angle), halves, strict=True):
                if half.any():
                    low = values - width if panel == "from" else np.maximum(values - width, 0)
                    band(panels[panel], time, low, values + width, colour, "90 % band")
                panels[panel].plot(time, values, color=colour, linewidth=THIN, label=name)
                panels[panel].set_xlim(wind.time[0], wind.time[-1])
        panels["from"].set(xlabel="time since boot (s)", ylabel="from (°)")
        panels["from"].yaxis.set_major_formatter(lambda value, place: f"{value % 360:.0f}")
        panels["speed"].set(ylabel="speed (m/s)", ylim=(0, None), xticklabels=[])
        legend_above(panels["speed"])
        compass: Any = _north_up(panels["compass"])
        angle, turned = np.radians([wind.direction, min(wind.direction_interval, 180.0)])
        compass.bar(angle, 1.0, 2 * turned, color=DISTURBANCE, alpha=BAND_OPACITY, linewidth=0)
        if wind.status["direction"] != "not identifiable":
            arrow = {"color": DISTURBANCE, "width": 2.0, "headwidth": 8.0, "headlength": 9.0}
            compass.annotate("", xy=(angle + np.pi, 0.7), xytext=(angle, 0.97), arrowprops=arrow)
        low, high = wind.speed_interval
        said = f"below {high:.1f} m/s" if wind.calm else f"{wind.speed:.1f} m/s\n({low:.1f} to {high:.1f})"
        compass.set(ylim=(0, 1), yticks=[], xlabel=said)
    return figure


def wind_rose(flights: Sequence[Flight]) -> Figure:
    """Draws how many ``flights`` had wind from where, in classes of speed; ``ValueError`` if no direction is known."""
    winds = [(one[0].wind_direction, one[0].wind_speed) for one in flights]
    if not (known := [wind for wind in winds if None not in wind]):
        raise ValueError("no wind has a direction")
    (directions, speeds), sector = np.array(known, np.float64).T, 2 * np.pi / len(POINTS)
    places, bottom = np.round(directions / sector).astype(int) % len(POINTS), np.zeros(len(POINTS))
    with picture(2.8, width=4.4) as figure:
        axes = _north_up(figure.add_subplot(projection="polar"))
        for number, (low, high) in enumerate(zip(CLASSES[:-1], CLASSES[1:], strict=True), 1):
            count = np.bincount(places[(low <= speeds) & (speeds < high)], minlength=len(POINTS))
            look = {"color": DISTURBANCE, "alpha": number / len(CLASSES), "linewidth": 0, "width": 0.9 * sector}
            look["label"] = f"{low:g} to {high:g} m/s" if np.isfinite(high) else f"{low:g} m/s and more"
            axes.bar(sector * np.arange(len(POINTS)), count, bottom=bottom, **look)
            bottom = bottom + count
        axes.set_yticks(np.arange(step := max(1, round(bottom.max() / 4)), bottom.max() + 1, step))
        axes.set_rlabel_position(np.degrees(sector) * (1 + 2 * bottom[1::2].argmin()))  # where the fewest flights are
        axes.legend(loc="center left", bbox_to_anchor=(1.12, 0.5))
    return figure


def _north_up(axes: Any) -> Any:
    axes.set(theta_zero_location="N", theta_direction=-1)
    axes.set_xticks(np.radians(np.arange(0, 360, 45)), POINTS[::2])
    return axes
