"""Charts of a flight: step responses, open loops with their margins, and the spectra and spectrograms of sensors."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment.axis.responses import NO_STEPS, LoopResponse, Responses, StepsByLoop
from mavdem.assessment.axis.tracking import AttitudeGain
from mavdem.assessment.noise_spectra import GYRO, MeasuredNoise
from mavdem.loops.axis_loops import MARGIN_TARGETS, Loop, MarginTarget
from mavdem.loops.filters import gyro_response
from mavdem.loops.margins import Complex, OpenLoop
from mavdem.loops.measured_response import MIN_COMPARED_FREQUENCY
from mavdem.loops.step_response import StepResponse
from mavdem.report.charts.chart import (
    FREQUENCY,
    TIME,
    Axis,
    Chart,
    Charts,
    Line,
    LineStyle,
    Mark,
    Spectrogram,
    step_chart,
)
from mavdem.report.charts.model_charts import line_with_quantile_band
from mavdem.report.numbers import display_density_unit, rounded
from mavdem.report.palette import COMMAND, MEASURED, PHYSICAL, PREDICTED
from mavdem.vibration.spectra import Spectrum, max_decimated
from mavdem.vibration.spectral_lines import (
    MIN_PEAK_PROMINENCE,
    MIN_SEPARATION,
    LineCause,
    SpectralLine,
    prominent_peaks,
)


class FilterStage(NamedTuple):
    """A stage of a sensor's signal whose spectrum is drawn."""

    key: str
    """Key of its spectrum in ``MeasuredNoise.spectra``, with {} for the sensor."""

    name: str
    """Name in the legend."""

    colour: str
    """Colour of the line."""


FILTER_STAGES = (
    FilterStage("{}_before", "unfiltered", MEASURED),
    FilterStage("{}", "filtered", PREDICTED),
)
"""The spectra of a sensor that are drawn, where they were measured."""

MAX_BINS = 400
"""Points of a spectrum, and columns of a spectrogram, that are drawn: about as many as pixels on a small screen."""

MIN_DENSITY = 1e-12
"""Lowest spectral density that is drawn, in the sensor's unit²/Hz, so that a logarithmic axis has no zero."""

MIN_FILTER_GAIN = 1e-4
"""Lowest gain of the filters that is drawn: −80 dB, the lower end of its axis."""

MAX_NYQUIST_FRACTION = 0.499
"""Highest frequency of the filters' response, as a fraction of the gyro's sampling rate: just below Nyquist's 0.5."""

MIN_GAIN_RATIO = 10.0
"""The lower end of the band of |T| is at least |T| divided by this: a logarithmic axis has no zero."""

HEAT_PERCENTILES = (20.0, 99.8)
"""Percentiles of the power, dB, that a spectrogram shows as its lowest and highest colour."""

ROOM_FOR_NAMES = 10.0
"""Highest power on the axis of a spectrum, relative to the highest one drawn: names of marks stand above the lines."""

CLOSED_LOOP_GAIN = Axis("gain |T|", is_logarithmic=True)
"""Axis of the gain from setpoint to response."""

LOOP_COLOURS = {"new": PHYSICAL, "now": PREDICTED}
"""Colours of loops, and of what they do, with new gains ("new") and with those that flew ("now"), as they are drawn."""

UNNAMED_LINE = "?"
"""Name at the mark of a spectral line whose cause is not known."""

NO_FEEDBACK_SENSITIVITY = 1.0
"""Sensitivity |S| without a loop, at which its chart has a horizontal line."""

ROOM_ABOVE_GOAL = 2.0
"""Highest sensitivity of a chart, relative to the goal that is drawn in it, where the lines stay below: the name of the
goal stands above its line."""

PHASE_LIMIT = -180.0
"""Phase, degrees, that an open loop must not reach before its gain is below 1."""


def step_charts(
    responses: Responses, advised_steps_by_loop: StepsByLoop = NO_STEPS, *, has_gain: bool = True
) -> dict[str, Charts]:
    """Returns charts of how the closed loops of each axis respond to their setpoints, measured and predicted.

    Each measured loop has a chart of its response to a step of the setpoint: the measured response with its 90 % band,
    the prediction of the identified loop, and that with the advised gains. A rate loop also has a chart of the gain |T|
    over frequency, where T is the closed-loop frequency response from the setpoint to the rate.

    Args:
        responses: responses by axis ("roll") and loop ("rate" or "attitude"). Those without a measured response, which
            have the reason instead, are left out.
        advised_steps_by_loop: predicted step responses with the advised gains, by axis and loop.
        has_gain: whether the gain |T| is among the charts.

    Returns:
        The charts by axis; axes without a measured response are left out.
    """
    charts_by_axis = {}
    for axis, responses_of_axis in responses.items():
        charts: list[Chart] = []
        for loop_name, response in responses_of_axis.items():
            measured_response = response.measured
            if not isinstance(measured_response, StepResponse):
                continue
            title = f"{axis.capitalize()} {loop_name}"
            advised_step = advised_steps_by_loop.get(axis, {}).get(loop_name)
            step_lines = _step_lines(response, measured_response, advised_step)
            # The title says it, since a line that is alone has no legend.
            kind = "identified step" if measured_response.is_identified else "step"
            if response.is_step_doubtful:
                kind = f"doubtful {kind}"
            charts.append(step_chart(f"{title}: {kind}", step_lines))
            if has_gain and loop_name == "rate":
                charts.append(_gain_chart(title, response, measured_response))
        if charts:
            charts_by_axis[axis] = tuple(charts)
    return charts_by_axis


def _gain_chart(title: str, response: LoopResponse, measured_response: StepResponse) -> Chart:
    """Returns the chart of the gain |T| of a closed rate loop over frequency, measured and predicted.

    T is the frequency response from the setpoint to the rate. A horizontal line at 1 marks perfect tracking.

    Args:
        title: axis and loop, such as "Roll rate".
        response: the response with its prediction, if the loop is identified.
        measured_response: the measured response, which is ``response.measured``. The caller has checked that it is a
            response, and not the reason why there is none.
    """
    lines = tuple(_gain_lines(response, measured_response))
    title_of_gain = f"{title}: |T|"
    return Chart(
        title_of_gain, FREQUENCY, CLOSED_LOOP_GAIN, lines, levels=(1.0,), group=title_of_gain
    )


def attitude_gain_chart(axis: str, measured: AttitudeGain, identified: Loop | None) -> Chart:
    """Returns the chart of the gain |T| from the setpoint of an angle to the angle, measured and identified.

    Args:
        axis: "roll" or "pitch".
        measured: the gain where the flight shows it.
        identified: the identified loops of the axis, without feed-forward; None if they are not known.
    """
    # The axis is logarithmic, so that the lower end of the band must stay above zero.
    low = np.maximum(measured.gain - measured.half_width, measured.gain / MIN_GAIN_RATIO)
    high = measured.gain + measured.half_width
    lines = [Line("measured", MEASURED, measured.frequency, measured.gain, low, high)]
    if identified is not None:
        loop = identified.attitude
        gain = np.interp(measured.frequency, loop.frequency, abs(loop.closed_loop_of_estimate))
        lines.append(
            Line("identified", PREDICTED, measured.frequency, gain, style=LineStyle.DASHES)
        )
    title = f"{axis.capitalize()} attitude: |T|"
    return Chart(
        title,
        FREQUENCY,
        CLOSED_LOOP_GAIN,
        tuple(lines),
        levels=(1.0,),
        group=title,
        caption="Measured where angle and setpoint are coherent; identified without feed-forward.",
    )


def _step_lines(
    response: LoopResponse, measured_response: StepResponse, advised_step: Array | None
) -> list[Line]:
    """Returns the lines of the chart of a step response, in the order in which they are drawn over each other.

    1. The measured response, wide, so that predictions which agree with it do not hide it.
    2. The response that is predicted with the advised gains.
    3. The response that the identified loop predicts with the present gains, dashed, so that the second one is seen
       where both are equal.

    If the messages were too slow to measure a step, the third line takes the place of the first, with its 90 % band. A
    doubtful step, measured or identified, is dashed in the colour of the first line, and has no band.

    Args:
        response: the response with its prediction, if the loop is identified.
        measured_response: the measured response or, if ``is_identified``, that of the identified loop.
        advised_step: (N,) predicted response to a step with the advised gains, at the times of the measured one; None
            if the gains are kept.
    """
    time = measured_response.time
    step = measured_response.step
    half_width = measured_response.step_half
    lines = []
    if response.is_step_doubtful:
        # Its band is that of the estimate, which does not know of what speaks against it.
        lines.append(Line("doubtful", MEASURED, time, step, style=LineStyle.DASHES))
    elif not measured_response.is_identified:
        lines.append(
            Line.with_band("measured", MEASURED, time, step, half_width, style=LineStyle.WIDE)
        )
    if advised_step is not None:
        lines.append(Line("new gains", PHYSICAL, time, advised_step))
    if measured_response.is_identified and not response.is_step_doubtful:
        lines.append(
            Line.with_band("identified", PREDICTED, time, step, half_width, style=LineStyle.DASHES)
        )
    elif not measured_response.is_identified and response.predicted_step is not None:
        predicted_step = response.predicted_step
        lines.append(Line("predicted", PREDICTED, time, predicted_step, style=LineStyle.DASHES))
    return lines


def _gain_lines(response: LoopResponse, measured_response: StepResponse) -> list[Line]:
    """Returns the lines of the chart of the closed-loop gain |T|: as measured, and predicted by the identified loop.

    Args:
        response: the response with its prediction, if the loop is identified.
        measured_response: the measured response.
    """
    frequency = measured_response.frequency
    gain = measured_response.gain
    # The axis is logarithmic, so that the lower end of the band must stay above zero.
    low = np.maximum(gain - measured_response.gain_half, gain / MIN_GAIN_RATIO)
    high = gain + measured_response.gain_half
    lines = [Line("measured", MEASURED, frequency, gain, low, high)]
    if response.predicted_gain is not None:
        predicted_gain = response.predicted_gain
        lines.append(
            Line("predicted", PREDICTED, frequency, predicted_gain, style=LineStyle.DASHES)
        )
    return lines


def loop_charts(
    loops: Mapping[str, Loop],
    loop_name: str = "rate",
    target: MarginTarget = MARGIN_TARGETS["default"],
) -> Charts:
    """Returns charts of gain, phase and sensitivity of open loops over frequency, with 90 % bands.

    With the open-loop response L the sensitivity is S = 1/(1 + L), by which feedback multiplies disturbances. A mark at
    each crossover frequency, where the gain is 1, has the phase margin beside it in the chart of the phase.

    The loop with the gains that flew is dashed and drawn last, so that it is seen where it equals the other one.

    Args:
        loops: the loops of one axis by their names in legends: "now" with the gains that flew, and "new" if any change.
        loop_name: "rate" or "attitude".
        target: the goal of the margins, whose largest sensitivity has a line.
    """
    shown_loops = []
    for name in LOOP_COLOURS:
        if name in loops:
            shown_loops.append(_ShownLoop.of(name, loops[name].open_loop(loop_name)))
    axis = next(iter(loops.values())).axis.capitalize()
    title = f"{axis} {loop_name}"
    return (
        _open_loop_gain_chart(title, shown_loops),
        _open_loop_phase_chart(title, shown_loops),
        _sensitivity_chart(title, shown_loops, target.ms),
    )


class _ShownLoop(NamedTuple):
    """An open loop as the charts of its gain, phase and sensitivity show it."""

    name: str
    """Name in the legends, "now" or "new"."""

    frequency: Array
    """The F frequencies that are shown, Hz."""

    response: Complex
    """Open-loop response (N, F): the estimate in the first row, then draws from the posterior, which give the band."""

    crossover: float
    """Frequency at which the gain is 1, Hz."""

    phase_margin: float
    """Phase margin there, degrees."""

    @classmethod
    def of(cls, name: str, open_loop: OpenLoop) -> _ShownLoop:
        """Returns a loop with its response at the frequencies that are shown.

        Args:
            name: name in the legends.
            open_loop: the loop, with its margins.
        """
        is_shown = open_loop.frequency >= MIN_COMPARED_FREQUENCY
        return cls(
            name=name,
            frequency=open_loop.frequency[is_shown],
            response=open_loop.response[:, is_shown],
            crossover=open_loop.crossover,
            phase_margin=open_loop.phase_margin,
        )

    def line(self, values: Array) -> Line:
        """Returns a line over frequency with a 90 % band, in the colour of the loop.

        Args:
            values: what the chart shows of the response (N, F).
        """
        line = line_with_quantile_band(self.name, LOOP_COLOURS[self.name], self.frequency, values)
        return line._replace(style=LineStyle.DASHES) if self.name == "now" else line

    def crossover_mark(self, words: str = "") -> Mark:
        """Returns a mark at the crossover frequency, with words beside it."""
        return Mark(self.crossover, words, LOOP_COLOURS[self.name])


def _open_loop_gain_chart(title: str, shown_loops: Sequence[_ShownLoop]) -> Chart:
    """Returns the chart of the gain of open loops, dB, in a wide range about the crossovers at 0 dB.

    Args:
        title: axis and loop, such as "Roll rate".
        shown_loops: the loops.
    """
    return Chart(
        f"{title}: gain (dB)",
        FREQUENCY,
        Axis("gain (dB)", limits=(-40.0, 30.0)),
        tuple(loop.line(20 * np.log10(abs(loop.response))) for loop in shown_loops),
        levels=(0.0,),
        marks=tuple(loop.crossover_mark() for loop in shown_loops),
        group=title,
    )


def _open_loop_phase_chart(title: str, shown_loops: Sequence[_ShownLoop]) -> Chart:
    """Returns the chart of the phase of open loops, degrees, in a wide range about −180°, with the phase margins.

    Args:
        title: axis and loop, such as "Roll rate".
        shown_loops: the loops.
    """
    return Chart(
        f"{title}: phase (°)",
        FREQUENCY,
        Axis("phase (°)", limits=(-300.0, -45.0)),
        tuple(loop.line(_unwrapped_phase(loop.response)) for loop in shown_loops),
        levels=(PHASE_LIMIT,),
        level_names=("−180°",),
        marks=tuple(loop.crossover_mark(f"{loop.phase_margin:.0f}°") for loop in shown_loops),
        group=title,
    )


def _sensitivity_chart(
    title: str, shown_loops: Sequence[_ShownLoop], largest_sensitivity: float
) -> Chart:
    """Returns the chart of the sensitivity |1/(1 + L)| of loops, with L the open-loop response.

    Args:
        title: axis and loop, such as "Roll rate".
        shown_loops: the loops.
        largest_sensitivity: the goal of the maximum sensitivity Ms, at which a line is drawn.
    """
    lines = tuple(loop.line(1 / abs(1 + loop.response)) for loop in shown_loops)
    sensitivity_axis = Axis("sensitivity |S|", is_logarithmic=True)
    is_goal_above_lines = max(line.y.max() for line in lines) < largest_sensitivity
    if is_goal_above_lines:
        # An axis that ends with the lines would not show the goal.
        highest_shown = ROOM_ABOVE_GOAL * largest_sensitivity
        sensitivity_axis = sensitivity_axis._replace(limits=(None, highest_shown))
    return Chart(
        f"{title}: sensitivity",
        FREQUENCY,
        sensitivity_axis,
        lines,
        levels=(NO_FEEDBACK_SENSITIVITY, largest_sensitivity),
        level_names=("", f"goal: Ms {largest_sensitivity:g} at most"),
        marks=tuple(loop.crossover_mark() for loop in shown_loops),
        group=title,
    )


def _unwrapped_phase(response: Complex) -> Array:
    """Returns the phase, degrees, of open-loop responses without jumps of a whole turn.

    An angle is only known up to whole turns. Phases are unwrapped along frequency, and moved so that each response
    begins between −360 and 0 degrees, as a loop with delay and integration does.

    Args:
        response: complex responses (N, F), a row for each draw.

    Returns:
        Phases (N, F).
    """
    phase = np.unwrap(np.angle(response), axis=1)
    starts_above_zero = phase[:, :1] > 0
    phase -= 2 * np.pi * starts_above_zero
    return np.degrees(phase)


def axis_spectrum_charts(
    noise: MeasuredNoise,
    loops: Mapping[str, Loop],
    name: str,
    axes: Sequence[str],
) -> dict[str, Chart]:
    """Draws the power spectrum of each axis of a sensor (``spectrum_chart``), all with the same range of power.

    Args:
        noise: spectra and spectral lines of the sensors; there is at least one of this sensor.
        loops: identified loop of each axis whose crossover frequency is marked. The filters of the fastest loop are
            drawn for all axes, since they are filters of one gyro.
        name: name of the sensor in ``noise``.
        axes: names of the axes of its spectra, such as roll, pitch and yaw.

    Returns:
        A chart over frequency, Hz, for each axis.
    """
    charts = {}
    loop_with_filters = fastest_loop(loops)
    for index, axis in enumerate(axes):
        chart = spectrum_chart(noise, loop_with_filters, name, index)
        if axis in loops:
            chart = chart._replace(marks=(*chart.marks, _crossover_mark(loops[axis])))
        charts[axis] = chart._replace(title=f"{axis.capitalize()}: {chart.title}")
    limits = _common_power_limits(charts.values())
    for axis, chart in charts.items():
        charts[axis] = chart._replace(y=chart.y._replace(limits=limits))
    return charts


def _common_power_limits(charts: Iterable[Chart]) -> tuple[float, float]:
    """Returns the lowest and the highest power that charts of spectra show, with room for the names of marks above.

    Args:
        charts: charts with the power on the left axis; a gain of filters, on the right one, does not count.
    """
    powers = []
    for chart in charts:
        powers += [line.y for line in chart.lines if not line.is_on_right_axis]
    all_powers = np.concatenate(powers)
    return float(all_powers.min()), ROOM_FOR_NAMES * float(all_powers.max())


def spectrum_chart(
    noise: MeasuredNoise, loop: Loop | None = None, name: str = GYRO, axis: int | None = None
) -> Chart:
    """Draws a sensor's power spectrum before and after its filters, with a mark at each spectral line and its cause.

    Args:
        noise: spectra and spectral lines of the sensors; there is at least one of this sensor.
        loop: control loop whose gyro filters are drawn as a gain in dB; None without.
        name: name of the sensor in ``noise``.
        axis: number of the axis whose spectrum is drawn, from 0; None for the sum of all axes.

    Returns:
        The chart over frequency, Hz.
    """
    lines, unit = _spectrum_lines(noise, name, axis)
    # Spectral lines are found before the filters if that was logged, otherwise after them.
    spectral_lines = noise.peaks.get(f"{name}_before", noise.peaks.get(name, ()))
    if axis is not None:
        spectral_lines = _lines_of_axis(spectral_lines, lines[0])
    max_frequency = max(line.x[-1] for line in lines)
    right_axis = None
    if loop is not None:
        lines.append(_filter_line(loop, max_frequency))
        # Filters hardly amplify, and what they attenuate by more than 80 dB does not matter. The names of the marks
        # stand above 0 dB.
        right_axis = Axis("(dB)", limits=(-80.0, 12.0))
    return Chart(
        f"{name.replace('_', ' ').capitalize()}, power ({unit})",
        Axis("frequency (Hz)", limits=(0.0, max_frequency)),
        Axis(f"power ({unit})", is_logarithmic=True),
        tuple(lines),
        marks=tuple(_spectral_line_mark(spectral_line) for spectral_line in spectral_lines),
        right_axis=right_axis,
    )


def _spectral_line_mark(spectral_line: SpectralLine) -> Mark:
    """Returns the mark at a narrow line of a spectrum, with its cause, such as the motors, or that this is unknown."""
    is_unnamed = spectral_line.cause is LineCause.UNNAMED
    label = UNNAMED_LINE if is_unnamed else str(spectral_line.cause)
    return Mark(spectral_line.frequency, label)


def fastest_loop(loops: Mapping[str, Loop]) -> Loop | None:
    """Returns the rate loop with the highest crossover frequency, which filters concern most; None without loops."""
    return max(loops.values(), key=lambda loop: loop.crossover, default=None)


def _crossover_mark(loop: Loop) -> Mark:
    """Returns the mark at the crossover frequency of a rate loop: noise below it moves the vehicle."""
    return Mark(loop.crossover, f"crossover {rounded(loop.crossover)} Hz", LOOP_COLOURS["now"])


class _SpectrumLines(NamedTuple):
    """The spectra of one sensor as lines."""

    lines: list[Line]
    """Power by frequency, before and after the filters, as far as measured."""

    unit: str
    """Unit of the power."""


def _spectrum_lines(noise: MeasuredNoise, name: str, axis: int | None) -> _SpectrumLines:
    """Returns the power spectral density of a sensor as lines, one before and one after its filters, where measured.

    Of neighbouring frequencies the largest density is drawn, so that no narrow peak is lost.

    Args:
        noise: spectra of all sensors.
        name: name of the sensor, such as "gyro".
        axis: number of the axis, from 0; None to add up the densities of all axes.

    Returns:
        The lines, with the unit of the density: the square of the unit in which the sensor's values are shown, per Hz.
    """
    lines = []
    slow_spectrum = noise.slow_filtered_spectrum(name)
    unit = display_density_unit("1")
    for stage in FILTER_STAGES:
        spectrum = noise.spectra.get(stage.key.format(name))
        if spectrum is None:
            continue
        unit = display_density_unit(spectrum.unit)
        density_of_axes = spectrum.mean_density
        density = density_of_axes.sum(axis=0) if axis is None else density_of_axes[axis]
        # The first frequency, 0 Hz, is the mean and no vibration.
        frequency, density = max_decimated(spectrum.frequency[1:], density[1:], MAX_BINS)
        power = unit.scale * np.maximum(density, MIN_DENSITY)
        line_name = stage.name
        if spectrum is slow_spectrum:
            # It ends at half of the rate at which the filtered signal was logged.
            sample_rate = 2 * spectrum.nyquist_frequency
            line_name = f"{stage.name} ({sample_rate:.0f} Hz only)"
        lines.append(Line(line_name, stage.colour, frequency, power))
    return _SpectrumLines(lines, unit.name)


def _lines_of_axis(
    spectral_lines: tuple[SpectralLine, ...], power: Line
) -> tuple[SpectralLine, ...]:
    """Selects the spectral lines of a sensor that are marked in the spectrum of one axis.

    A line was found in the sum of the axes. One of unknown cause is left out if it is a line of another axis: if this
    axis has no peak at its frequency, to the separation of two spectral lines.

    Args:
        spectral_lines: lines of the sensor.
        power: power spectral density over frequency, of the axis.
    """
    selected_lines = []
    peak_frequencies: Array | None = None
    for spectral_line in spectral_lines:
        if spectral_line.cause is LineCause.UNNAMED:
            if peak_frequencies is None:
                # The search for peaks takes longest, and most spectra have no such line.
                peaks = prominent_peaks(np.log(power.y), MIN_PEAK_PROMINENCE)
                peak_frequencies = power.x[peaks]
            distances = np.abs(peak_frequencies - spectral_line.frequency)
            if not np.any(distances <= MIN_SEPARATION * spectral_line.frequency):
                continue
        selected_lines.append(spectral_line)
    return tuple(selected_lines)


def _filter_line(loop: Loop, max_frequency: float) -> Line:
    """Draws the gain of the gyro's filters over frequency, for the axis on the right of a chart.

    Digital filters are defined below half of the sampling rate (the Nyquist frequency), where the line ends.

    Args:
        loop: a loop, whose controller has the gyro's filters.
        max_frequency: highest frequency of the chart, Hz.

    Returns:
        The line, dB.
    """
    # The line begins just above 0 Hz, and ends just below half of the gyro's rate.
    highest_frequency = MAX_NYQUIST_FRACTION * loop.controller.gyro_rate
    frequency = np.linspace(0.1, min(max_frequency, highest_frequency), MAX_BINS)
    # A notch filter has a gain of 0 at its centre, which has no decibels.
    gain = np.maximum(abs(gyro_response(loop.controller, frequency)), MIN_FILTER_GAIN)
    decibels = 20 * np.log10(gain)
    return Line(
        "filters", COMMAND, frequency, decibels, style=LineStyle.DASHES, is_on_right_axis=True
    )


def spectrogram_charts(spectrum: Spectrum) -> Sequence[Chart]:
    """Returns one or two spectrograms of a sensor, power in dB by frequency: over time and, if known, over throttle.

    The second one tells causes apart: over throttle, lines of motors and propellers rise with the motors' speed, while
    resonances of the frame stay at their frequency.

    Args:
        spectrum: spectra of a sensor in W windows of the flight, with the time and throttle of each.
    """
    name = spectrum.name.removesuffix("_before").replace("_", " ").capitalize()
    frequency_axis = Axis("frequency (Hz)")
    order = np.argsort(spectrum.time)
    over_time = _spectrogram_in_decibels(
        spectrum.time[order], spectrum.frequency, spectrum.total_density[order]
    )
    title = f"{name} over time (Hz)"
    charts = [Chart(title, TIME, frequency_axis, spectrogram=over_time, group="flight")]
    throttle_levels, density_by_level = spectrum.density_by_throttle
    if len(throttle_levels) > 1:
        over_throttle = _spectrogram_in_decibels(
            100 * throttle_levels, spectrum.frequency, density_by_level
        )
        title = f"{name} over throttle (Hz)"
        charts.append(Chart(title, Axis("throttle (%)"), frequency_axis, spectrogram=over_throttle))
    return charts


def _spectrogram_in_decibels(x: Array, frequency: Array, density: Array) -> Spectrogram:
    """Converts spectral densities at uneven times or throttles to a spectrogram on an even axis, in dB.

    Each even point takes the density of the nearest ``x``. The colours end at ``HEAT_PERCENTILES`` of the densities, so
    that single extremes do not use up their range.

    Args:
        x: ascending times, s, or throttle levels (W,).
        frequency: frequencies (F,), Hz.
        density: spectral density (W, F).
    """
    # Neighbouring frequencies are drawn as one, with their maximum, so that no spectral line is lost.
    frequency_bins, bin_density = max_decimated(frequency, density, MAX_BINS // 2)
    smallest_positive = np.finfo(np.float64).tiny
    decibels = 10 * np.log10(np.maximum(bin_density, smallest_positive))
    even_x = np.linspace(x[0], x[-1], int(np.clip(len(x), 2, MAX_BINS)))
    nearest_index = abs(even_x[:, None] - x).argmin(axis=1)
    low, high = np.percentile(decibels, HEAT_PERCENTILES)
    return Spectrogram(even_x, frequency_bins, np.clip(decibels[nearest_index], low, high))
