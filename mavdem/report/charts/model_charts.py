"""Charts of a learned model: forecasts, residuals, frequency responses and the wind torque, in degrees.

``learned.plot`` draws them with matplotlib, a page with its script.
"""

from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment.axis.residuals import residuals as residuals_of
from mavdem.confidence import INTERVAL_QUANTILES
from mavdem.dem import Learned
from mavdem.dem.record import Record
from mavdem.experiments.held_out import CONSTANT_MEAN, FORECAST, HeldOut
from mavdem.loops.margins import Complex
from mavdem.plant.parameters import ESTIMATE
from mavdem.plant.wind_torque import WindSpectrum
from mavdem.report.charts.chart import FREQUENCY, TIME, Axis, Chart, Charts, Line, LineStyle, Span
from mavdem.report.charts.frequency_responses import (
    identified_plant,
    model_response,
    plant_response,
)
from mavdem.report.labels import AxisCommand, Labels
from mavdem.report.numbers import TORQUE_UNIT, display_unit, name_with_unit, unit_per_input
from mavdem.report.palette import (
    BASELINE,
    DISTURBANCE,
    MEASURED,
    PHYSICAL,
    PREDICTED,
)

MAX_DRAWN_WINDOWS = 8
"""Held-out windows that are drawn in full, the first ones; of the others only the error is shown."""

MAX_WIND_FREQUENCY = 10.0
"""Highest frequency of the wind torque's spectrum that is drawn, Hz: what is faster is noise of sensors."""

MIN_RESPONSE_FREQUENCY = 0.1
"""Lowest frequency of a Bode chart, Hz."""

MAX_RESPONSE_FREQUENCY = 20.0
"""Highest frequency of a Bode chart, Hz."""

MAX_SAMPLING_FRACTION = 0.4
"""Highest frequency of a Bode chart as a fraction of the sampling rate: a model cannot be asked about faster motion."""

RESPONSE_POINTS = 200
"""Frequencies of a Bode chart."""


def line_with_quantile_band(name: str, colour: str, x: Array, values: Array) -> Line:
    """Returns the line of an estimate with the 90 % band of draws from its posterior.

    The band holds at each point the middle 90 % of the draws.

    Args:
        name: name in the legend.
        colour: colour of line and band.
        x: abscissae (T,).
        values: (N, T): the estimate in the first row, then the draws. Without draws the line is dashed.
    """
    estimate = values[0]
    draws = values[1:]
    if len(draws) == 0:
        return Line(name, colour, x, estimate, style=LineStyle.DASHES)
    low, high = np.quantile(draws, INTERVAL_QUANTILES, axis=0)
    return Line(name, colour, x, estimate, low, high)


def bode_charts(learned: Learned, output: int = -1) -> Charts:
    """Returns the Bode diagram of a vehicle: magnitude and phase of an output per command of the axis, with 90 % bands.

    The response is computed from the physical plant or, if its parameters are not identifiable, from DEM's model. The
    bands hold the middle 90 % of the responses for draws of the physical parameters from their posterior.

    Args:
        learned: the linear model that was learned from a flight, with its training data.
        output: index of the output; the last one, a rate, unless given.

    Returns:
        A chart of the magnitude, and one of the phase, degrees.
    """
    command = AxisCommand.of(learned)
    labels = Labels.of(learned)
    output_count = len(labels.output_names)
    # A negative index counts from the end.
    output_index = range(output_count)[output]
    output_name = labels.output_names[output_index]
    unit = display_unit(labels.output_units[output_index])
    max_frequency = min(MAX_RESPONSE_FREQUENCY, MAX_SAMPLING_FRACTION / learned.dt)
    frequency = np.geomspace(MIN_RESPONSE_FREQUENCY, max_frequency, RESPONSE_POINTS)
    physical = identified_plant(learned)
    # Responses (N, F): of the estimate in the first row, and then of the draws; DEM's model has no draws.
    if physical is None:
        responses = model_response(learned, command.motors, frequency, output_index)
        source, colour = "DEM's model", PREDICTED
    else:
        is_angle = output_index + 1 < output_count
        responses = plant_response(physical, command.motors, frequency, is_angle=is_angle)
        source, colour = "physical parameters", PHYSICAL
    magnitudes = unit.scale * np.abs(responses)
    gain_axis = Axis(unit_per_input(unit, command.unit), is_logarithmic=True)
    title = f"{output_name} by {command.name} ({gain_axis.label}), by {source}"
    gain_line = line_with_quantile_band(source, colour, frequency, magnitudes)
    phase_line = line_with_quantile_band(source, colour, frequency, _phases(responses))
    return (
        Chart(title, FREQUENCY, gain_axis, (gain_line,)),
        Chart("Phase (°)", FREQUENCY, Axis("phase (°)"), (phase_line,)),
    )


def _phases(responses: Complex) -> Array:
    """Returns the phases of frequency responses, degrees, without jumps by whole turns.

    Unwrapping makes the phase of the estimate continuous in frequency. The phases of the draws are given by their
    differences from it, which are less than half a turn.

    Args:
        responses: (N, F) responses at F frequencies: the estimate in the row ``ESTIMATE``, and the draws.

    Returns:
        Phases (N, F).
    """
    estimated_phase = np.unwrap(np.angle(responses[ESTIMATE]))
    phase_differences = np.angle(responses / responses[ESTIMATE])
    return np.degrees(estimated_phase + phase_differences)


def residual_charts(learned: Learned, output: int = -1) -> Charts:
    """Returns charts of one-step residuals, their autocorrelation, and their correlation with the command.

    The residuals of a good model are white and independent of the command; the model does not explain a remaining
    correlation. For a good model, about one correlation in a hundred is beyond the 99 % bounds (L. Ljung, System
    Identification, 2nd ed., sec. 16.6).

    Args:
        learned: the linear model that was learned from a flight, with its training data.
        output: index of the output; the last one, a rate, unless given.

    Returns:
        Three charts.
    """
    labels = Labels.of(learned)
    name = labels.output_names[output]
    unit = display_unit(labels.output_units[output])
    residuals = residuals_of(learned, output)
    series = series_with_gaps(learned.record, unit.scale * residuals.errors)
    charts = [
        Chart(
            f"Residual of {name} ({unit.name})",
            TIME,
            Axis(name_with_unit("residual", unit.name)),
            (Line("residual", PREDICTED, series.time, series.values),),
        )
    ]
    command_name = AxisCommand.of(learned).name
    correlations = {
        "Autocorrelation": residuals.autocorrelation,
        f"Correlation with {command_name}": residuals.command_correlation,
    }
    for (title, values), bound in zip(correlations.items(), residuals.bounds, strict=True):
        # The autocorrelation at lag 0 is always 1 and says nothing.
        stems = Line("correlation", PREDICTED, residuals.lag[1:], values[1:], style=LineStyle.STEMS)
        levels = (-bound, 0.0, bound)
        # The bounds are always in sight, since a correlation means nothing without them.
        largest = 1.1 * max(bound, float(abs(values[1:]).max(initial=0.0)))
        correlation_axis = Axis("correlation", limits=(-largest, largest))
        charts.append(Chart(title, Axis("lag (s)"), correlation_axis, (stems,), levels))
    return tuple(charts)


def wind_torque_charts(learned: Learned) -> Charts:
    """Returns a chart of the wind torque over time with its gusts, and one of its spectral density.

    The wind torque is the angular acceleration that the model does not explain by the motors, shown in °/s². It was
    smoothed with a model of its spectrum, which is drawn for comparison.

    Args:
        learned: the linear model that was learned from a flight, with its training data.

    Raises:
        ValueError: the wind torque is not identifiable.
    """
    wind_torque = learned.resolved_wind_torque
    line = torque_line(learned, "wind torque", DISTURBANCE)
    if wind_torque is None or line is None:
        raise ValueError("there is no wind torque to show: it is not identifiable in this flight")
    time = sample_times(learned.record)
    gusts = []
    for gust in wind_torque.gusts:
        start = time[gust.sample]
        gusts.append(Span(start, start + gust.length, "gust"))
    torque_axis = Axis(name_with_unit("wind torque", TORQUE_UNIT.name))
    torque_chart = Chart("Wind torque", TIME, torque_axis, (line,), (0.0,), spans=tuple(gusts))
    return (torque_chart, _torque_spectrum_chart(wind_torque.spectrum))


def _torque_spectrum_chart(spectrum: WindSpectrum) -> Chart:
    """Returns the chart of the wind torque's power spectral density over frequency, up to ``MAX_WIND_FREQUENCY``.

    A dashed line is the model of the spectrum with which the torque was smoothed: where the two agree, it fits.

    Args:
        spectrum: estimated density and its model at the same frequencies, Hz. The wind torque is in the unit of the
            training data, rad/s², and the chart shows it in ``TORQUE_UNIT``.
    """
    is_shown = (spectrum.frequency > 0) & (spectrum.frequency <= MAX_WIND_FREQUENCY)
    frequency = spectrum.frequency[is_shown]
    # The unit of a power spectral density is the square of the signal's unit per Hz.
    scale = TORQUE_UNIT.scale**2
    density = scale * spectrum.density[is_shown]
    model_density = scale * spectrum.model[is_shown]
    density_lines = (
        Line("wind torque", DISTURBANCE, frequency, density),
        Line("model of it", MEASURED, frequency, model_density, style=LineStyle.DASHES),
    )
    density_unit = f"({TORQUE_UNIT.name})²/Hz"
    density_axis = Axis(density_unit, is_logarithmic=True)
    return Chart(f"Its spectrum ({density_unit})", FREQUENCY, density_axis, density_lines)


def torque_line(learned: Learned, name: str, colour: str) -> Line | None:
    """Returns the wind torque of a model over time with its 90 % band.

    Args:
        learned: the linear model that was learned from a flight, with its training data.
        name: name of the line in the legend.
        colour: its colour.

    Returns:
        The wind torque, °/s²; None if it is not identifiable.
    """
    wind = learned.resolved_wind_torque
    if wind is None:
        return None
    torque = series_with_gaps(learned.record, TORQUE_UNIT.scale * wind.torque)
    band = series_with_gaps(learned.record, TORQUE_UNIT.scale * wind.band)
    return Line.with_band(name, colour, torque.time, torque.values, band.values)


def forecast_charts(held_out: HeldOut, labels: Labels, output: int = 0) -> Charts:
    """Returns charts of an output with its forecasts in the first held-out windows, and of the RMSE in every window.

    The forecast restarts in each window. With a single window there is no chart of the RMSE.

    Args:
        held_out: W windows that no model was trained on.
        labels: names and units of the outputs.
        output: index of the output.

    Returns:
        One chart or two.

    Raises:
        ValueError: there are no windows.
    """
    if not len(held_out):
        raise ValueError("there is no held-out window")
    name = labels.output_names[output]
    unit = display_unit(labels.output_units[output])
    time = held_out.time[:MAX_DRAWN_WINDOWS]
    window_count, steps = time.shape
    # A NaN at the beginning of each window but the first breaks the lines.
    window_starts = np.arange(steps, steps * window_count, steps)
    line_time = np.insert(time.ravel(), window_starts, time[1:, 0])

    def concatenated(windows: Array) -> Array:
        """Returns the output in the shown unit, of all drawn windows in a row, from windows (W, H, m)."""
        values = unit.scale * windows[:MAX_DRAWN_WINDOWS, :, output]
        return np.insert(values.ravel(), window_starts, np.nan)

    forecast = concatenated(held_out.forecasts[FORECAST])
    band = concatenated(held_out.band)
    lines = (
        Line("measured", MEASURED, line_time, concatenated(held_out.measured)),
        Line.with_band("forecast", PREDICTED, line_time, forecast, band),
    )
    output_axis = Axis(name_with_unit(name, unit.name))
    chart = Chart(f"Forecast of {name} ({unit.name})", TIME, output_axis, lines)
    if len(held_out) == 1:
        return (chart,)
    errors = []
    for method, colour in ((FORECAST, PREDICTED), (CONSTANT_MEAN, BASELINE)):
        rmse = unit.scale * np.sqrt(held_out.squared_errors(method)[:, output])
        errors.append(Line(method, colour, held_out.time[:, 0], rmse, style=LineStyle.DOTS))
    rmse_axis = Axis(f"RMSE ({unit.name})", limits=(0.0, None))
    rmse_chart = Chart(f"RMSE in every window ({unit.name})", TIME, rmse_axis, tuple(errors))
    return (chart, rmse_chart)


def sample_times(record: Record) -> Array:
    """Returns the times of the T samples of a record.

    Samples are ``record.dt`` apart within a segment. The start times of the segments are on the flight's clock. If the
    record was made of arrays without times, the first segment starts at 0, and the others follow without gaps.

    Args:
        record: the training data of a model.

    Returns:
        The times (T,), s.
    """
    segment_times = record.begins or tuple(record.dt * record.segment_starts)
    times = []
    for start, length in zip(segment_times, record.lengths, strict=True):
        times.append(start + record.dt * np.arange(length))
    return np.concatenate(times)


class GappedSeries(NamedTuple):
    """A series over time with a NaN between segments, where its line is to break; N = T + segments − 1."""

    time: Array
    """Times (N,), s."""

    values: Array
    """Values (N,)."""


def series_with_gaps(record: Record, values: Array) -> GappedSeries:
    """Returns values over the time of a record, with a NaN between segments, at which a drawn line breaks.

    Args:
        record: training data of a model, in one or several segments with gaps between.
        values: (T,) a value for each sample of the record.
    """
    time = sample_times(record)
    # The NaN before a segment has the time of the segment's first sample.
    starts = record.segment_starts[1:]
    time_with_gaps = np.insert(time, starts, time[starts])
    values_with_gaps = np.insert(values, starts, np.nan)
    return GappedSeries(time_with_gaps, values_with_gaps)
