"""Charts of a flight: step responses as measured and predicted, loops now and advised, and spectra of the gyro."""

from collections.abc import Iterator, Mapping

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment.axis.responses import LoopResponse, Responses
from mavdem.assessment.noise_spectra import GYRO, MeasuredNoise
from mavdem.loops.axis_loops import MARGIN_TARGETS, Loop
from mavdem.loops.filters import gyro_response
from mavdem.loops.margins import OpenLoop
from mavdem.loops.measured_response import MIN_COMPARED_FREQUENCY
from mavdem.loops.step_response import StepResponse
from mavdem.report.charts.chart import (
    FREQUENCY,
    TIME,
    TIME_AFTER_STEP,
    Axis,
    Chart,
    Charts,
    Heat,
    Kind,
    Line,
    Mark,
)
from mavdem.report.charts.model_charts import banded
from mavdem.report.palette import BAD, COMMAND, MEASURED, PHYSICAL, PREDICTED
from mavdem.vibration.spectra import Spectrum, max_decimated
from mavdem.vibration.spectral_lines import LineKind

SHOWN = ("{}_before", "before the filters", MEASURED), ("{}", "behind the filters", PREDICTED)
"""Name and colour of the spectra of a sensor."""
BINS = 400
"""Of a spectrum and of a spectrogram that are drawn."""
SHARE = Axis("share of the step")
GAIN = Axis("gain |T|", log=True)


def step_charts(responses: Responses) -> tuple[Charts, ...]:
    """Returns steps of rate and angle, and |T| of the rate, by axis, as measured and as predicted."""
    columns = (
        tuple(
            chart
            for loop, response in loops.items()
            if isinstance(response.measured, StepResponse)
            for chart in _of_response(f"{axis.capitalize()} {loop}", response, response.measured)
        )
        for axis, loops in responses.items()
    )
    return tuple(filter(None, columns))


def _of_response(title: str, response: LoopResponse, seen: StepResponse) -> Iterator[Chart]:
    """Yields the step and, of the rate, |T|."""
    steps = [Line.around("measured", MEASURED, seen.time, seen.step, seen.step_half)]
    least = np.maximum(seen.gain - seen.gain_half, seen.gain / 10)
    most = seen.gain + seen.gain_half
    gains = [Line("measured", MEASURED, seen.frequency, seen.gain, least, most)]
    if response.predicted_step is not None and response.predicted_gain is not None:
        dashes = Line("predicted", PREDICTED, seen.time, response.predicted_step, kind=Kind.DASHES)
        steps.append(dashes)
        gains.append(dashes._replace(x=seen.frequency, y=response.predicted_gain))
    yield Chart(f"{title}: step", TIME_AFTER_STEP, SHARE, tuple(steps), (1.0,))
    if seen.loop == "rate":
        yield Chart(f"{title}: |T|", FREQUENCY, GAIN, tuple(gains), (1.0,))


COLOURS = PREDICTED, PHYSICAL
# Levels of the sensitivity: of no loop, and the most that is allowed
MOST_SENSITIVE = 1.0, MARGIN_TARGETS["default"].ms


def loop_charts(loops: Mapping[str, Loop], which: str = "rate") -> Charts:
    """Returns gain and phase of named open loops of one axis, and their sensitivity, with 90 % bands.

    ``which`` is "rate" or "attitude". Marked is where the gain is 1, at the phase with its margin; the level is the
    largest sensitivity to have.
    """
    charts = (
        Chart("gain (dB)", FREQUENCY, Axis("gain (dB)", ends=(-40.0, 30.0)), levels=(0.0,)),
        Chart("phase (°)", FREQUENCY, Axis("phase (°)", ends=(-300.0, -45.0)), levels=(-180.0,)),
        Chart("sensitivity", FREQUENCY, Axis("sensitivity |S|", log=True), levels=MOST_SENSITIVE),
    )
    title = f"{next(iter(loops.values())).axis.capitalize()} {which}"
    lines: tuple[list[Line], ...] = ([], [], [])
    marks = []
    for (name, loop), colour in zip(loops.items(), COLOURS, strict=False):
        opened: OpenLoop = getattr(loop, which)
        shown = opened.frequency >= MIN_COMPARED_FREQUENCY
        response = opened.response[:, shown]
        turned = np.unwrap(np.angle(response), axis=1)
        turned -= 2 * np.pi * (turned[:, :1] > 0)
        drawn = 20 * np.log10(abs(response)), np.degrees(turned), 1 / abs(1 + response)
        for values, those in zip(drawn, lines, strict=True):
            those.append(banded(name, colour, opened.frequency[shown], values))
        marks.append(Mark(opened.crossover, f"{opened.phase_margin:.0f}°", colour))
    bare = [mark._replace(name="") for mark in marks]
    return tuple(
        chart._replace(title=f"{title}: {chart.title}", lines=tuple(those), marks=tuple(here))
        for chart, those, here in zip(charts, lines, (bare, marks, bare), strict=True)
    )


def spectrum_chart(noise: MeasuredNoise, loop: Loop | None = None, name: str = GYRO) -> Chart:
    """Returns the spectra of the gyro, or what ``name`` says, with their lines.

    With those of the gyro is what the filters of a ``loop`` pass.
    """
    lines = []
    peaks = noise.peaks.get(f"{name}_before", noise.peaks.get(name, ()))
    marks = [
        Mark(line.frequency, "?" if line.kind is LineKind.UNNAMED else str(line.kind))
        for line in peaks
    ]
    unit = "1/Hz"
    for key, where, colour in SHOWN:
        if (spectrum := noise.spectra.get(key.format(name))) is not None:
            if spectrum.unit != "1":
                unit = f"({spectrum.unit})²/Hz"
            frequency, density = max_decimated(
                spectrum.frequency[1:], spectrum.mean_density.sum(axis=0)[1:], BINS
            )
            lines.append(Line(where, colour, frequency, np.maximum(density, 1e-12)))
    highest = max(line.x[-1] for line in lines)
    beside = None
    if loop is not None:
        top = min(highest, 0.499 * loop.controller.gyro_rate)
        frequency = np.linspace(0.1, top, BINS)
        passed = np.maximum(abs(gyro_response(loop.controller, frequency)), 1e-4)
        decibels = 20 * np.log10(passed)
        filters = Line("filters", COMMAND, frequency, decibels, kind=Kind.DASHES, right=True)
        lines.append(filters)
        beside = Axis("(dB)", ends=(-80.0, 3.0))
        marks.append(Mark(loop.crossover, "crossover", BAD))
    return Chart(
        f"{name.replace('_', ' ').capitalize()}, power ({unit})",
        Axis("frequency (Hz)", ends=(0.0, highest)),
        Axis(f"power ({unit})", log=True),
        tuple(lines),
        marks=tuple(marks),
        beside=beside,
    )


def spectrogram(spectrum: Spectrum) -> Iterator[Chart]:
    """Yields the power of a sensor by frequency over time and, where the motors' output is known, over throttle."""
    order = np.argsort(spectrum.time)
    levels, over_levels = spectrum.density_by_throttle
    over_time = _heat(spectrum.time[order], spectrum.frequency, spectrum.total_density[order])
    hertz = Axis("frequency (Hz)")
    name = spectrum.name.removesuffix("_before").replace("_", " ").capitalize()
    yield Chart(f"{name} over time (Hz)", TIME, hertz, heat=over_time, group="flight")
    if len(levels) > 1:
        over_throttle = _heat(100 * levels, spectrum.frequency, over_levels)
        throttle = Axis("throttle (%)")
        yield Chart(f"{name} over throttle (Hz)", throttle, hertz, heat=over_throttle)


def _heat(x: Array, frequency: Array, density: Array) -> Heat:
    """Decibels on an even axis, each as wide as to the next."""
    hertz, shown = max_decimated(frequency, density, BINS // 2)
    decibels = 10 * np.log10(np.maximum(shown, np.finfo(np.float64).tiny))
    even = np.linspace(x[0], x[-1], int(np.clip(len(x), 2, BINS)))
    nearest = abs(even[:, None] - x).argmin(axis=1)
    ends = np.percentile(decibels, (20, 99.8))
    return Heat(even, hertz, np.clip(decibels[nearest], *ends))
