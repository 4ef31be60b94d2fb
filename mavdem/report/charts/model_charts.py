"""Charts of a model: forecasts, residuals, responses and the wind torque.

Each function returns charts in degrees; ``learned.plot`` draws them with matplotlib, a page with its script.
"""

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment.axis.findings import resolved_wind_torque
from mavdem.assessment.axis.residuals import residuals as residuals_of
from mavdem.confidence import INTERVAL_QUANTILES
from mavdem.dem import Learned
from mavdem.dem.record import Record
from mavdem.experiments.held_out import CONSTANT_MEAN, FORECAST, HeldOut
from mavdem.report.charts.chart import FREQUENCY, TIME, Axis, Chart, Charts, Kind, Line
from mavdem.report.charts.frequency_responses import model_response, plant_of, plant_response
from mavdem.report.labels import AxisCommand, Labels
from mavdem.report.numbers import TORQUE_UNIT, display_unit, name_with_unit, unit_per_input
from mavdem.report.palette import (
    BASELINE,
    DISTURBANCE,
    MEASURED,
    PHYSICAL,
    PREDICTED,
)

SHOWN_WINDOWS = 8  # held-out windows that are drawn in full, the first ones
FASTEST_WIND = 10.0  # Hz: what is faster is noise of sensors


def banded(name: str, colour: str, x: Array, values: Array) -> Line:
    """Returns the estimate ``values`` (N, T)[0] with the band of the others; dashed where there are none."""
    if len(values) == 1:
        return Line(name, colour, x, values[0], kind=Kind.DASHES)
    low, high = np.quantile(values[1:], INTERVAL_QUANTILES, axis=0)
    return Line(name, colour, x, values[0], low, high)


def bode(learned: Learned, output: int = -1) -> Charts:
    """Returns magnitude and phase of an ``output`` over frequency, from the axis's command, with 90 % bands.

    Of the physical plant or, where that is not identifiable, of DEM's model.
    """
    command = AxisCommand.of(learned)
    labels = Labels.of(learned)
    output = range(len(labels.output_names))[output]
    unit = display_unit(labels.output_units[output])
    # What is faster than 0.4 of the sampling rate cannot be asked of the model.
    frequency = np.geomspace(0.1, min(20.0, 0.4 / learned.dt), 200)
    physical = plant_of(learned)
    if physical is None:
        response = model_response(learned, command.motors, frequency, output)
        drawn = "DEM's model", PREDICTED, frequency
    else:
        is_angle = output + 1 < len(labels.output_names)
        response = plant_response(physical, command.motors, frequency, is_angle)
        drawn = "physical parameters", PHYSICAL, frequency
    phase = np.degrees(np.unwrap(np.angle(response[0])) + np.angle(response / response[0]))
    magnitude = Axis(unit_per_input(unit, command.unit), log=True)
    title = f"{labels.output_names[output]} by {command.name} ({magnitude.label}), by {drawn[0]}"
    gain = banded(*drawn, unit.scale * np.abs(response))
    return (
        Chart(title, FREQUENCY, magnitude, (gain,)),
        Chart("Phase (°)", FREQUENCY, Axis("phase (°)"), (banded(*drawn, phase),)),
    )


def residuals(learned: Learned, output: int = -1) -> Charts:
    """Returns one-step residuals over time, their autocorrelation, and their correlation with the command.

    Correlations beyond the 99 % bounds are what the model leaves (Ljung, System Identification, 2nd ed., sec. 16.6).
    """
    labels = Labels.of(learned)
    unit = display_unit(labels.output_units[output])
    series = residuals_of(learned, output)
    time, errors = with_gaps(learned.record, unit.scale * series.errors)
    name = labels.output_names[output]
    command = AxisCommand.of(learned).name
    line = Line("residual", PREDICTED, time, errors)
    charts = [
        Chart(
            f"Residual of {name} ({unit.name})",
            TIME,
            Axis(name_with_unit("residual", unit.name)),
            (line,),
        )
    ]
    tests = (
        ("Autocorrelation", series.autocorrelation),
        (f"Correlation with {command}", series.command_correlation),
    )
    for (title, values), bound in zip(tests, series.bounds, strict=True):
        stems = Line("correlation", PREDICTED, series.lag[1:], values[1:], kind=Kind.STEMS)
        charts.append(
            Chart(title, Axis("lag (s)"), Axis("correlation"), (stems,), (-bound, 0.0, bound))
        )
    return tuple(charts)


def disturbance(learned: Learned) -> Charts:
    """Returns the wind torque over time with band and gusts, and its spectral density.

    Raises:
        ValueError: the wind torque is not identifiable.
    """
    wind = resolved_wind_torque(learned.wind_torque, learned.physical)
    line = torque_line(learned, "wind torque", DISTURBANCE)
    if wind is None or line is None:
        raise ValueError("there is no wind torque to show: it is not identifiable in this flight")
    clock = sample_times(learned.record)
    starts = [(clock[gust.sample], gust.length) for gust in wind.gusts]
    gusts = tuple((start, start + length, "gust") for start, length in starts)
    shown = (wind.spectrum[0] > 0) & (wind.spectrum[0] <= FASTEST_WIND)
    frequency, density, model = (values[shown] for values in wind.spectrum)
    spectrum = (
        Line("wind torque", DISTURBANCE, frequency, TORQUE_UNIT.scale**2 * density),
        Line("model of it", MEASURED, frequency, TORQUE_UNIT.scale**2 * model, kind=Kind.DASHES),
    )
    unit = Axis(name_with_unit("wind torque", TORQUE_UNIT.name))
    return (
        Chart("Wind torque", TIME, unit, (line,), (0.0,), spans=gusts),
        Chart(
            f"Its spectrum (({TORQUE_UNIT.name})²/Hz)",
            FREQUENCY,
            Axis(f"({TORQUE_UNIT.name})²/Hz", log=True),
            spectrum,
        ),
    )


def torque_line(learned: Learned, name: str, colour: str) -> Line | None:
    """Returns the wind torque with its band; None where it is not identifiable."""
    wind = resolved_wind_torque(learned.wind_torque, learned.physical)
    if wind is None:
        return None
    time, torque = with_gaps(learned.record, TORQUE_UNIT.scale * wind.torque)
    _, half = with_gaps(learned.record, TORQUE_UNIT.scale * wind.band)
    return Line.around(name, colour, time, torque, half)


def forecast(held: HeldOut, labels: Labels, output: int = 0) -> Charts:
    """Returns an output beside its forecasts in the first windows that no model saw, and the error in every window.

    Shown in full are the first windows; each is forecast anew.

    Raises:
        ValueError: no windows.
    """
    if not len(held):
        raise ValueError("there is no held-out window")
    unit = display_unit(labels.output_units[output])
    name = labels.output_names[output]
    shown = slice(SHOWN_WINDOWS)
    steps = held.time.shape[1]
    ends = np.arange(steps, steps * len(held.time[shown]), steps)
    time = np.insert(held.time[shown].ravel(), ends, held.time[shown][1:, 0])

    def joined(values: Array) -> Array:
        return np.insert(unit.scale * values[shown, :, output].ravel(), ends, np.nan)

    middle = joined(held.forecasts[FORECAST])
    half = joined(held.band)
    lines = (
        Line("measured", MEASURED, time, joined(held.measured)),
        Line.around("forecast", PREDICTED, time, middle, half),
    )
    charts = [
        Chart(
            f"Forecast of {name} ({unit.name})", TIME, Axis(name_with_unit(name, unit.name)), lines
        )
    ]
    if len(held) > 1:
        errors = tuple(
            Line(
                method,
                colour,
                held.time[:, 0],
                unit.scale * np.sqrt(held.squared_errors(method)[:, output]),
                kind=Kind.DOTS,
            )
            for method, colour in ((FORECAST, PREDICTED), (CONSTANT_MEAN, BASELINE))
        )
        axis = Axis(f"RMSE ({unit.name})", ends=(0.0, None))
        charts.append(Chart(f"RMSE in every window ({unit.name})", TIME, axis, errors))
    return tuple(charts)


def sample_times(record: Record) -> Array:
    """Returns (T,) s of the samples of a record: on the flight's clock or, where that is not known, since the first."""
    segments = zip(
        record.begins or tuple(record.dt * record.segment_starts), record.lengths, strict=True
    )
    return np.concatenate([begin + record.dt * np.arange(length) for begin, length in segments])


def with_gaps(record: Record, values: Array) -> tuple[Array, Array]:
    """Returns times and values (T + segments − 1,) with NaN between segments, where a line is to break."""
    time = sample_times(record)
    starts = record.segment_starts[1:]
    return np.insert(time, starts, time[starts]), np.insert(values, starts, np.nan)
