"""Noise and responses: measured step responses beside predicted ones, spectra with their filters, spectrograms."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mavdem.assessment.noise import BEFORE, GYRO, Noise
from mavdem.assessment.responses import LoopResponse
from mavdem.condition.loop.controllers import Controller
from mavdem.condition.loop.filters import gyro_filters, gyro_response
from mavdem.condition.peaks import PeakKind
from mavdem.condition.spectra import Spectrum, thinned
from mavdem.condition.step_response import StepResponse
from mavdem.dem.engine.linalg import Array
from mavdem.report.figures.style import HAIRLINE, Room, band, legend_above, note, picture
from mavdem.report.palette import BAD, COMMAND, MEASURED, PREDICTED

LOOPS = ("rate", "attitude")
BINS = 400
"""Of a spectrum and of a spectrogram that are drawn."""
LEAST_DECIBELS = -60.0  # below the largest, of a spectrogram
ROOM = Room(left=0.6, bottom=0.46, columns=0.42, rows=0.5)


def step_responses(responses: Mapping[str, Mapping[str, LoopResponse]]) -> Figure | None:
    """Draws steps and |T| of rate and attitude, an axis each, measured with bands and predicted; None without any."""
    known = {
        axis: {
            loop: (one, one.measured)
            for loop, one in loops.items()
            if isinstance(one.measured, StepResponse)
        }
        for axis, loops in responses.items()
    }
    shown = [loop for loop in LOOPS if any(loop in loops for loops in known.values())]
    if not shown:
        return None
    with picture(3.4 * len(shown), ROOM) as figure:
        grid = figure.subplots(2 * len(shown), len(known), squeeze=False)
        for column, (axis, loops) in enumerate(known.items()):
            for place, loop in enumerate(shown):
                step, gain = grid[2 * place : 2 * place + 2, column]
                step.set_title(f"{axis} {loop}")
                if loop in loops:
                    _response(step, gain, *loops[loop])
        grid[0, 0].set_ylabel("share of the step")
        grid[1, 0].set_ylabel("gain |T|")
        note(figure, "Grey: measured, with its 90 % band. Blue: predicted by the identified loop.")
    return figure


def _response(step: Axes, gain: Axes, found: LoopResponse, measured: StepResponse) -> None:
    low, high = measured.step - measured.step_half, measured.step + measured.step_half
    band(step, measured.time, low, high, MEASURED)
    step.plot(measured.time, measured.step, color=MEASURED)
    size = measured.gain
    least = np.maximum(size - measured.gain_half, 1e-3)
    band(gain, measured.frequency, least, size + measured.gain_half, MEASURED)
    gain.plot(measured.frequency, size, color=MEASURED)
    if found.predicted_step is not None and found.predicted_gain is not None:
        step.plot(measured.time, found.predicted_step, color=PREDICTED, linestyle="--")
        gain.plot(measured.frequency, found.predicted_gain, color=PREDICTED, linestyle="--")
    step.axhline(1, **HAIRLINE)
    step.set(xlabel="time (s)", ylim=(-0.1, max(1.4, 1.05 * float(measured.step.max()))))
    gain.set(xlabel="frequency (Hz)", xscale="log", yscale="log")
    gain.set_ylim(0.05, max(2.0, 1.3 * float(size.max())))
    gain.xaxis.set_major_formatter("{x:g}")
    gain.yaxis.set_major_formatter("{x:g}")


def spectra(
    noise: Noise, controller: Controller | None = None, crossover: float | None = None
) -> Figure | None:
    """Draws the gyro's spectra with its lines, and over them what the filters pass; None without a spectrum.

    Their phase lag is that at the ``crossover``, Hz.
    """
    shown = {name: noise.spectra[name] for name in (BEFORE, GYRO) if name in noise.spectra}
    if not shown:
        return None
    highest = max(one.highest for one in shown.values())
    with picture(2.9, Room(left=0.72, right=0.6, bottom=0.46)) as figure:
        axes = figure.subplots()
        for (name, one), colour in zip(shown.items(), (MEASURED, PREDICTED), strict=False):
            frequency, density = thinned(one.frequency[1:], one.mean.sum(axis=0)[1:], BINS)
            label = "before the filters" if name == BEFORE else "behind the filters"
            axes.plot(frequency, density, color=colour, label=label, linewidth=1.0)
        for line in noise.lines:
            axes.axvline(line.frequency, **HAIRLINE | {"linestyle": ":"})
            text = "?" if line.kind is PeakKind.UNNAMED else str(line.kind)
            place = line.frequency, 0.99
            axes.annotate(text, place, xycoords=("data", "axes fraction"), va="top", fontsize=7.5)
        axes.set(yscale="log", xlim=(0, highest), xlabel="frequency (Hz)")
        axes.set_ylabel("power ((rad/s)²/Hz)")
        if controller is not None:
            _filters(figure, axes, controller, highest, crossover)
        legend_above(axes)
    return figure


def _filters(
    figure: Figure, axes: Axes, controller: Controller, highest: float, crossover: float | None
) -> None:
    """What the gyro's filters pass, in dB, on an axis of its own."""
    top = min(highest, 0.499 * controller.gyro_rate)
    frequency = np.linspace(0.1, top, BINS)
    passed = 20 * np.log10(np.maximum(np.abs(gyro_response(controller, frequency)), 1e-4))
    beside = axes.twinx()
    beside.plot(frequency, passed, color=COMMAND, linestyle="--", linewidth=1.0)
    beside.set_ylabel("filters (dB)", color=COMMAND)
    beside.set_ylim(-80, 3)
    beside.grid(False)
    if crossover is not None:
        axes.axvline(crossover, color=BAD, linewidth=0.8)
        lag = gyro_filters(controller, crossover).phase_lag
        note(figure, f"The filters lag by {lag:.0f}° at the crossover, {crossover:.1f} Hz (red).")


def spectrogram(spectrum: Spectrum) -> Figure:
    """Draws the power of a sensor by frequency over time and, where the motors' output is known, over the throttle."""
    frequency, density = thinned(spectrum.frequency, spectrum.whole, BINS)
    levels, over_levels = spectrum.by_throttle
    with picture(2.9, ROOM) as figure:
        left, right = figure.subplots(1, 2, width_ratios=(2, 1))
        order = np.argsort(spectrum.time)
        _image(left, spectrum.time[order], frequency, density[order])
        left.set(xlabel="time (s)", ylabel="frequency (Hz)")
        if len(levels):
            _image(right, 100 * levels, *thinned(spectrum.frequency, over_levels, BINS))
        right.set(xlabel="throttle (%)")
        note(
            figure,
            f"Darker: more power, over {-LEAST_DECIBELS:.0f} dB; up to {spectrum.highest:.0f} Hz.",
        )
    return figure


def _image(axes: Axes, across: Array, frequency: Array, density: Array) -> None:
    """Columns of decibels, each as wide as to the next."""
    decibels = 10 * np.log10(np.maximum(density, np.finfo(np.float64).tiny))
    even = np.linspace(across[0], across[-1], max(len(across), 2))
    nearest = np.abs(even[:, None] - across).argmin(axis=1)
    ends = float(across[0]), float(max(across[-1], across[0] + 1e-3))
    axes.imshow(
        decibels[nearest].T,
        origin="lower",
        aspect="auto",
        extent=(*ends, 0.0, float(frequency[-1])),
        vmin=float(decibels.max() + LEAST_DECIBELS),
        vmax=float(decibels.max()),
        cmap="Greys",
        interpolation="nearest",
    )
    axes.grid(False)
