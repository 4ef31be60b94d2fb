"""Loops: Bode plot, Nyquist plot, sensitivity and step response of the rate and the attitude loop of one axis."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from mavdem.condition.loop.loop import TARGETS, Loop
from mavdem.condition.loop.margins import OpenLoop
from mavdem.condition.step_response import step_of
from mavdem.report.figures.style import HAIRLINE, Room, legend_above, note, picture
from mavdem.report.figures.systems import draw
from mavdem.report.palette import BAD, HELD_OUT_OPACITY, PHYSICAL, PREDICTED

LOWEST = 0.2  # Hz shown
SECONDS = 0.8  # of a step response
TIME = np.linspace(0, SECONDS, 121)
# draws of a Nyquist plot, and every how many points of each
CLOUD = 40
SPARSE = 4
ROOM = Room(left=0.66, bottom=0.5, columns=0.5, rows=0.45)
LABELS = "gain (dB)", "phase (°)", "sensitivity |S|", "imaginary part", "share of the step"
MS = TARGETS["default"].ms
"""Drawn as the limit."""


def loops(loop: Loop, after: Loop | None = None) -> Figure:
    """Draws the loops of a flight and, where there are any, the same ``after`` other gains, with 90 % bands.

    From above: gain and phase of the open loops, with the phase margin; the sensitivity, what a loop leaves of a
    disturbance; the open loop about −1, with draws from the posterior; rate and angle after a step of their setpoint.
    """
    with picture(8.6, ROOM) as figure:
        rows = figure.subplots(5, 2, gridspec_kw={"height_ratios": [2, 2, 2, 3.1, 2.4]})
        for which, (gain, phase, left, plane, step) in zip(
            ("rate", "attitude"), rows.T, strict=True
        ):
            plane.add_patch(Circle((-1, 0), 1 / MS, color=BAD, alpha=HELD_OUT_OPACITY, linewidth=0))
            for one, name, colour in _curves(loop, after, which):
                draw(gain, one.frequency, 20 * np.log10(np.abs(one.response)), name, colour)
                first = np.angle(one.response[:, :1])
                turned = np.degrees(
                    np.unwrap(np.angle(one.response), axis=1) - 2 * np.pi * (first > 0)
                )
                draw(phase, one.frequency, turned, name, colour)
                phase.plot(
                    2 * [one.crossover],
                    [-180, one.phase_margin - 180],
                    "_:",
                    color=colour,
                    linewidth=1.2,
                )
                draw(left, one.frequency, 1 / np.abs(1 + one.response), name, colour)
                cloud = one.response[1 : CLOUD + 1, ::SPARSE]
                plane.plot(cloud.real.T, cloud.imag.T, color=colour, alpha=0.08, linewidth=0.8)
                plane.plot(one.response[0].real, one.response[0].imag, color=colour)
                steps = np.array([step_of(one.frequency, row, TIME) for row in one.closed])
                draw(step, TIME, steps, name, colour)
            _limits(gain, phase, left, one.frequency[-1])
            plane.plot(-1, 0, "+", color=BAD, markersize=8)
            plane.set(xlim=(-2.2, 0.6), ylim=(-1.75, 0.7), xlabel="real part", aspect="equal")
            step.axhline(1, **HAIRLINE)
            step.set(xlabel="time after the step (s)", xlim=(0, SECONDS))
            gain.set_title(which)
        for axes, label in zip(rows[:, 0], LABELS, strict=True):
            axes.set_ylabel(label)
        legend_above(rows[0, 1])
        note(
            figure,
            f"Dotted: the phase margin. Red: Ms of {MS:g}, in the disc more.",
        )
    return figure


def _limits(gain: Axes, phase: Axes, left: Axes, highest: float) -> None:
    gain.set(ylim=(-40, 30))
    phase.set(ylim=(-300, -45), yticks=[-270, -180, -90])
    left.set(yscale="log", ylim=(0.05, 4))
    left.yaxis.set_major_formatter("{x:g}")
    for axes, line in ((gain, 0), (phase, -180), (left, 1)):
        axes.set(
            xscale="log", xlim=(LOWEST, highest), xlabel="frequency (Hz)" if axes is left else ""
        )
        axes.xaxis.set_major_formatter("{x:g}")
        axes.axhline(line, **HAIRLINE)
    left.axhline(MS, color=BAD, linewidth=0.8)


def _curves(loop: Loop, after: Loop | None, which: str) -> Iterator[tuple[OpenLoop, str, str]]:
    yield getattr(loop, which), "now", PREDICTED
    if after is not None:
        yield getattr(after, which), "advised", PHYSICAL
