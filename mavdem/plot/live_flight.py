"""A live flight: what was measured and predicted ahead while it flew, the wind's torque, and what was learnt from."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from mavdem.live.history import LiveHistory
from mavdem.plot.style import HAIRLINE, THIN, legend_above, not_blown_up, picture
from mavdem.report.names import readable
from mavdem.report.palette import BAND_OPACITY, DISTURBANCE, HELD_OUT_OPACITY, MEASURED, PREDICTED


def live_flight(history: LiveHistory, name: str) -> Figure:
    """The first output with its predictions and their 90 % band; below, the wind's torque. Learnt parts are shaded.

    Args:
        history: of the flight.
        name: of the output, an angle.

    Raises:
        ValueError: there was no row.
    """
    lines = history.lines
    if not np.isfinite(lines.measured).any():
        raise ValueError("no attitude came")
    angle, torque = readable("rad"), readable("rad/s²")
    with picture(3.4) as figure:
        above, below = figure.subplots(2, 1, sharex=True, gridspec_kw={"height_ratios": [3, 2]})
        for axes in (above, below):
            for place, (first, last) in enumerate(history.learnt):
                axes.axvspan(
                    first,
                    last,
                    color=MEASURED,
                    alpha=HELD_OUT_OPACITY,
                    linewidth=0,
                    label="" if place or axes is below else "learned from",
                )
        for axes, mean, half, unit, colour, label in (
            (above, lines.predicted, lines.predicted_band, angle, PREDICTED, f"{history.horizon:g} s ahead"),
            (below, lines.torque, lines.torque_band, torque, DISTURBANCE, ""),
        ):
            mean, half = unit.scale * mean, unit.scale * half
            axes.fill_between(lines.time, mean - half, mean + half, color=colour, alpha=BAND_OPACITY, linewidth=0)
            axes.plot(lines.time, mean, color=colour, linewidth=THIN, label=label)
        above.plot(lines.time, angle.scale * lines.measured, color=MEASURED, linewidth=THIN, label="measured")
        not_blown_up(above, angle.scale * lines.measured)
        below.axhline(0, **HAIRLINE)
        if np.isfinite(lines.torque).any():
            not_blown_up(below, torque.scale * lines.torque)
        above.set(ylabel=f"{name} ({angle.name})")
        below.set(xlabel="time since the beginning (s)", ylabel=f"wind's torque ({torque.name})")
        legend_above(above)
    return figure
