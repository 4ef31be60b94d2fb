"""Loops: the open rate and attitude loop, how sensitive they are, and their steps, now and with other gains.

The rate loop is on the left, the attitude loop on the right; bands of 90 % are from the plant's posterior.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from mavdem.condition.loop import Loop, OpenLoop
from mavdem.dem.engine.linalg import Array
from mavdem.report.figures.style import HAIRLINE, Room, legend_above, note, picture
from mavdem.report.figures.systems import draw
from mavdem.report.palette import BAD, HELD_OUT_OPACITY, PHYSICAL, PREDICTED

LOOPS = ("rate", "attitude")
LOWEST = 0.2  # Hz shown
SECONDS, STEP_HERTZ = 0.8, 0.05  # of a step response; and the step of the frequencies that it is summed from
CLOUD = 60  # draws of a Nyquist plot
ROOM = Room(left=0.66, columns=0.5, rows=0.1)


def open_loops(loop: Loop, after: Loop | None = None) -> Figure:
    """Draws the Bode plots of the open loops; ``after`` is the same with other gains."""
    with picture(3.4, ROOM) as figure:
        above, below = figure.subplots(2, 2, sharex=True)
        for which, gain, phase in zip(LOOPS, above, below, strict=True):
            for one, name, colour in _now_and_after(loop, after, which):
                draw(gain, one.frequency, 20 * np.log10(np.abs(one.response)), name, colour)
                first = np.angle(one.response[:, :1])
                turned = np.degrees(np.unwrap(np.angle(one.response), axis=1) - 2 * np.pi * (first > 0))
                draw(phase, one.frequency, turned, name, colour)
                margin = {"color": colour, "linewidth": 1.2, "linestyle": ":"}
                phase.plot(2 * [one.crossover], [-180, one.phase_margin - 180], marker="_", **margin)
                gain.plot(one.crossover, 0, marker="o", markersize=4, color=colour)
            gain.axhline(0, **HAIRLINE)
            phase.axhline(-180, **HAIRLINE)
            gain.set(xscale="log", xlim=(LOWEST, one.frequency[-1]), ylim=(-40, 30))
            gain.set_title(which)
            phase.set(xlabel="frequency (Hz)", ylim=(-300, -45), yticks=[-270, -180, -90])
            phase.xaxis.set_major_formatter("{x:g}")
        above[0].set_ylabel("gain (dB)")
        below[0].set_ylabel("phase (°)")
        legend_above(above[1])
        note(figure, "Dotted: the phase margin, at the crossover.")
    return figure


def nyquist(loop: Loop, after: Loop | None = None, ms: float = 2.0) -> Figure:
    """Draws the open loops about −1, the point that they must keep away from by 1/``ms``."""
    with picture(2.75, ROOM) as figure:
        row = figure.subplots(1, 2)
        for which, axes in zip(LOOPS, row, strict=True):
            axes.add_patch(Circle((-1, 0), 1 / ms, color=BAD, alpha=HELD_OUT_OPACITY, linewidth=0))
            axes.add_patch(Circle((0, 0), 1, fill=False, **HAIRLINE))
            for one, name, colour in _now_and_after(loop, after, which):
                cloud = one.response[1 : CLOUD + 1]
                axes.plot(cloud.real.T, cloud.imag.T, color=colour, alpha=0.08, linewidth=0.8)
                axes.plot(one.response[0].real, one.response[0].imag, color=colour, label=name)
            axes.plot(-1, 0, "+", color=BAD, markersize=8)
            axes.set(xlim=(-2.2, 0.6), ylim=(-1.75, 0.7), xlabel="real part", aspect="equal")
            axes.set_title(which)
        row[0].set_ylabel("imaginary part")
        legend_above(row[1])
        note(figure, f"Shaded: nearer to −1 than Ms of {ms:g} allows. Thin lines: draws of the plant's posterior.")
    return figure


def sensitivity(loop: Loop, after: Loop | None = None, ms: float = 2.0) -> Figure:
    """Draws what a loop leaves of a disturbance, |S|, over frequency: below 1 it reduces it, above it adds to it."""
    return _curves(loop, after, lambda one: (one.frequency, 1 / np.abs(1 + one.response)), "sensitivity |S|", ms)


def steps(loop: Loop, after: Loop | None = None) -> Figure:
    """Draws rate and angle after a step of their setpoints at 0 s, as the identified plant has it."""
    return _curves(loop, after, step_response, "share of the step")


def step_response(one: OpenLoop) -> tuple[Array, Array]:
    """Returns time (T,) s and the closed loop's output (N, T) after a step of 1: 2/π ∫ Re(T) sin(ωt)/ω dω."""
    time, frequency = np.linspace(0, SECONDS, 121), np.arange(STEP_HERTZ / 2, one.frequency[-1], STEP_HERTZ)
    real = np.array([np.interp(frequency, one.frequency, row) for row in one.closed.real])
    return time, real @ (np.sin(2 * np.pi * np.outer(frequency, time)) / frequency[:, None]) * STEP_HERTZ * 2 / np.pi


def _curves(
    loop: Loop, after: Loop | None, curve: Callable[[OpenLoop], tuple[Array, Array]], name: str, limit: float = 0.0
) -> Figure:
    with picture(2.4, ROOM) as figure:
        row = figure.subplots(1, 2, sharey=True)
        for which, axes in zip(LOOPS, row, strict=True):
            for one, label, colour in _now_and_after(loop, after, which):
                draw(axes, *curve(one), label, colour)
            axes.axhline(1, **HAIRLINE)
            if limit:
                axes.axhline(limit, color=BAD, linewidth=0.8)
                axes.set(xscale="log", yscale="log", xlim=(LOWEST, one.frequency[-1]), ylim=(0.05, 4))
                axes.xaxis.set_major_formatter("{x:g}")
                axes.yaxis.set_major_formatter("{x:g}")
            axes.set_xlabel("frequency (Hz)" if limit else "time after the step (s)")
            axes.set_title(which)
        row[0].set_ylabel(name)
        legend_above(row[1])
        note(figure, f"Red: Ms of {limit:g}." if limit else "With the plant's posterior as a band.")
    return figure


def _now_and_after(loop: Loop, after: Loop | None, which: str) -> list[tuple[OpenLoop, str, str]]:
    found = [(getattr(loop, which), "now", PREDICTED)]
    return found if after is None else [*found, (getattr(after, which), "advised", PHYSICAL)]
