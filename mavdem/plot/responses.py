"""Responses to the axis's command: over frequency (Bode) and over time (step), with what they may be."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator
from numpy.typing import NDArray

from mavdem.dem import Learned
from mavdem.plot.drawn import Systems, drawn_models, drawn_physical, physical_system, system
from mavdem.plot.style import HAIRLINE, legend_above, not_blown_up, note, per, picture
from mavdem.report.axis_command import AxisCommand
from mavdem.report.names import Labels, readable
from mavdem.report.palette import BAND_OPACITY, PHYSICAL, PREDICTED, TRUTH

Array = NDArray[np.float64]

EDGES = (5.0, 95.0)  # percentiles of draws: of the 90 % band
LOWEST_HERTZ, HIGHEST_HERTZ, POINTS = 0.1, 20.0, 200
HIGHEST_OF_RATE = 0.4  # of the sampling rate: the model is not asked about what is faster
MAX_WIDER = 4.0  # by which factor a band may widen the range of magnitudes
STEP_SECONDS, STEP_POINTS = 1.5, 151


class ResponseCurve(NamedTuple):
    """A system by its name and colour, and draws from its uncertainty, if it has any."""

    name: str
    colour: str
    system: Systems
    draws: Systems | None


def bode(learned: Learned, output: int = -1, truth: tuple[Array, Array, float] | None = None) -> Figure:
    """Magnitude and phase of an output over frequency, from the axis's command, with 90 % bands.

    Of the learnt model and, where all of them are reported, of the physical parameters.

    Args:
        learned: the model; the bands come from the uncertainty of its parameters.
        output: which, in the order of the flight's outputs; the last one, a rate, unless given.
        truth: A (n, n) and B (n, r) of a simulated vehicle, whose first states are the outputs, and its delay, s.
    """
    command, labels = AxisCommand.of(learned), Labels.of(learned)
    output = range(len(labels.output_names))[output]
    unit = readable(labels.output_units[output])
    frequency = np.geomspace(LOWEST_HERTZ, min(HIGHEST_HERTZ, HIGHEST_OF_RATE / learned.dt), POINTS)
    with picture(3.7) as figure:
        above, below = figure.subplots(2, 1, sharex=True, gridspec_kw={"height_ratios": [3, 2]})
        magnitudes, phases = [], []
        for curve in _curves(learned, command, truth):
            own = curve.system.over_frequency(frequency, output)[0]
            magnitudes.append(unit.scale * np.abs(own))
            phases.append(np.degrees(np.unwrap(np.angle(own))))
            _line(above, frequency, magnitudes[-1], curve)
            _line(below, frequency, phases[-1], curve)
            if curve.draws is not None:
                drawn = curve.draws.over_frequency(frequency, output)
                _band(above, frequency, unit.scale * np.abs(drawn), curve)
                _band(below, frequency, phases[-1] + np.degrees(np.angle(drawn / own)), curve)
        above.set(xscale="log", yscale="log")
        above.set_ylabel(f"{labels.output_names[output]} by {command.name}\n({per(unit.name, command.unit)})")
        lowest, highest = np.min(magnitudes) / MAX_WIDER, np.max(magnitudes) * MAX_WIDER
        above.set_ylim(*np.clip(above.get_ylim(), lowest, highest))
        below.set(xlabel="frequency (Hz)", ylabel="phase (°)")
        below.set_ylim(*np.clip(below.get_ylim(), np.min(phases) - 90, np.max(phases) + 90))
        below.yaxis.set_major_locator(MultipleLocator(45 if np.ptp(below.get_ylim()) < 200 else 90))
        for axis in (below.xaxis, above.yaxis):
            axis.set_major_formatter("{x:g}")
        legend_above(above)
        note(figure, _remark(learned))
    return figure


def step(learned: Learned, truth: tuple[Array, Array, float] | None = None) -> Figure:
    """Each output after a step of the axis's command at 0 s, from trim, with 90 % bands.

    The step is as large as the standard deviation of the command in the flight, to one digit.

    Args:
        learned: the model; the bands come from the uncertainty of its parameters.
        truth: A (n, n) and B (n, r) of a simulated vehicle, whose first states are the outputs, and its delay, s.
    """
    command, labels = AxisCommand.of(learned), Labels.of(learned)
    size = float(f"{command.series(learned.record.inputs).std():.1g}") or 1.0
    time, outputs = np.linspace(0.0, STEP_SECONDS, STEP_POINTS), len(labels.output_names)
    with picture(1.5 + 1.2 * outputs) as figure:
        rows = np.atleast_1d(figure.subplots(outputs, 1, sharex=True))
        curves = [
            (curve, curve.system.after_step(time)[0], None if curve.draws is None else curve.draws.after_step(time))
            for curve in _curves(learned, command, truth)
        ]
        for output, axes in zip(reversed(range(outputs)), rows, strict=True):
            unit = readable(labels.output_units[output])
            scale = size * unit.scale
            axes.axhline(0, **HAIRLINE)
            for curve, own, drawn in curves:
                _line(axes, time, scale * own[:, output], curve)
                if drawn is not None:
                    _band(axes, time, scale * drawn[..., output], curve)
            axes.set_ylabel(f"{labels.output_names[output]} ({unit.name})")
            not_blown_up(axes, [scale * own[:, output] for _, own, _ in curves])
        unit_of_step = f" {command.unit}" if command.unit else ""
        rows[-1].set_xlabel(f"time after a step of {size:g}{unit_of_step} in the {command.name} (s)")
        legend_above(rows[0])
        note(figure, _remark(learned))
    return figure


def _curves(
    learned: Learned, command: AxisCommand, truth: tuple[Array, Array, float] | None
) -> Iterator[ResponseCurve]:
    outputs, motors, read = learned.record.outputs.shape[1], command.motors, learned.physical
    if read is not None and set(read.status.values()) == {"reported"} and outputs <= 2:
        own, draws = physical_system(read, motors, outputs), drawn_physical(read, motors, outputs)
        yield ResponseCurve("physical parameters", PHYSICAL, own, draws)
    own, draws = system(*learned.model[:3], motors), drawn_models(learned, motors)
    yield ResponseCurve("DEM's model", PREDICTED, own, draws)
    if truth is not None:
        A, B, delay = truth
        yield ResponseCurve("truth", TRUTH, system(A, B, np.eye(outputs, len(A)), motors, delay), None)


def _line(axes: Axes, x: Array, y: Array, curve: ResponseCurve) -> None:
    axes.plot(x, y, color=curve.colour, label=curve.name, linestyle="-" if curve.draws else (0, (4, 2)))


def _band(axes: Axes, x: Array, drawn: Array, curve: ResponseCurve) -> None:
    low, high = np.percentile(drawn, EDGES, axis=0)
    axes.fill_between(x, low, high, color=curve.colour, alpha=BAND_OPACITY, linewidth=0)


def _remark(learned: Learned) -> str:
    if learned.physical is not None and not learned.physical.identifiable:
        return "The motors' effect is not identifiable in this flight: its response may be far off."
    return "Bands: 90 %. That of DEM's model leaves out the bias of the closed loop."
