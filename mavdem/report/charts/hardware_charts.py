"""Charts of what a vehicle's hardware did over a flight: motor speeds, current, supply, satellites, compasses, load.

They stand with the table of all instances, which has the judgement; here is only what the log has, over time.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import cycle
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment.evidence import Evidence
from mavdem.dataset.phases import series_of_boot
from mavdem.dataset.position_fix import RECEIVER_MESSAGES, UNKNOWN_SATELLITES
from mavdem.dataset.speed_controllers import speed_controllers
from mavdem.dataset.time_series import TimeSeries, recorded_series
from mavdem.report.charts.chart import Axis, Chart, Group, Line, over_time
from mavdem.report.charts.timeline import Timeline
from mavdem.report.palette import DISTINCT, MEASURED
from mavdem.witnesses.sensors import compass_fields

MIN_SAMPLES = 2
"""Samples that make a line, at least."""


class ReportedQuantity(NamedTuple):
    """A field of a message that is drawn as it is, but for its unit."""

    title: str
    """What it is."""
    unit: str
    """Unit in which it is drawn."""
    message: str
    """Name of the message."""
    field: str
    """Name of the field."""
    scale: float
    """What the field is multiplied by; MAVLink's definitions have its unit."""
    unknown: float | None
    """Value of the field that stands for "not known"; None where the definition has none, so that 0 is a 0."""


REPORTED_QUANTITIES = (
    ReportedQuantity("Battery current", "A", "SYS_STATUS", "current_battery", 0.01, -1),
    ReportedQuantity("Supply of the autopilot", "V", "POWER_STATUS", "Vcc", 0.001, None),
    ReportedQuantity("Processor load", "%", "SYS_STATUS", "load", 0.1, None),
    ReportedQuantity("Barometer temperature", "°C", "SCALED_PRESSURE", "temperature", 0.01, None),
    ReportedQuantity("IMU temperature", "°C", "SCALED_IMU", "temperature", 0.01, 0),
)
"""Fields in MAVLink's units. https://mavlink.io/en/messages/common.html gives the units, and two values that stand for
"not known": a battery current of -1, and an IMU temperature of 0."""


def hardware_groups(evidence: Evidence, timeline: Timeline) -> list[Group]:
    """Returns the charts of the hardware that the log shows, in two columns, with the events of the flight.

    Args:
        evidence: of the vehicle.
        timeline: charts of the flight over the same time.
    """
    charts = [
        timeline.marked(chart) for chart in _hardware_charts(evidence, timeline) if chart.lines
    ]
    if not charts:
        return []
    columns = (tuple(charts[::2]), tuple(charts[1::2]))
    return [Group(tuple(column for column in columns if column))]


def _hardware_charts(evidence: Evidence, timeline: Timeline) -> Iterator[Chart]:
    """Yields all charts of the hardware; one of what was not recorded has no lines."""
    signals = evidence.signals
    speeds = {controller.name: controller.speed for controller in speed_controllers(signals)}
    yield over_time("Motor speeds", "1/min", _lines(speeds, timeline))
    yield _compass_chart(evidence, timeline)
    satellites: dict[str, TimeSeries] = {}
    for number, message in enumerate(RECEIVER_MESSAGES, start=1):
        series = recorded_series(signals.telemetry, message, "satellites_visible")
        if series is not None:
            satellites[f"receiver {number}"] = _without(series, UNKNOWN_SATELLITES)
    yield over_time("Satellites", "", _lines(satellites, timeline))
    for quantity in REPORTED_QUANTITIES:
        series = recorded_series(signals.telemetry, quantity.message, quantity.field)
        if series is None:
            continue
        if quantity.unknown is not None:
            series = _without(series, quantity.unknown)
        scaled = replace(series, values=quantity.scale * series.values)
        lines = _lines({quantity.title.lower(): scaled}, timeline)
        yield over_time(quantity.title, quantity.unit, lines)


def _compass_chart(evidence: Evidence, timeline: Timeline) -> Chart:
    """Returns the chart of the size of the magnetic field at each compass, with the mean command of the motors.

    The earth's field has one size wherever the vehicle points: what follows the motors comes from their currents.
    """
    sizes = {}
    for number, field in compass_fields(evidence.signals).items():
        sizes[f"compass {number}"] = replace(field, values=np.linalg.norm(field.values, axis=1))
    lines = _lines(sizes, timeline)
    chart = over_time("Magnetic field", "mGauss", lines)
    history = evidence.time_history
    if not lines or history is None or history.motors is None:
        return chart
    outputs = history.motors.outputs
    if outputs is None:
        return chart
    mean = outputs.values.mean(axis=1)
    command = Line("motors", MEASURED, outputs.time, mean, is_on_right_axis=True)
    return chart._replace(lines=(*lines, command), right_axis=Axis("motors (%)"))


def _lines(series_by_name: dict[str, TimeSeries], timeline: Timeline) -> tuple[Line, ...]:
    """Returns a line for each series that has samples within the time of the other charts."""
    lines = []
    start, end = timeline.span
    for (name, series), colour in zip(series_by_name.items(), cycle(DISTINCT), strict=False):
        of_boot = series_of_boot(series, timeline.boot)
        if of_boot is None:
            continue
        is_shown = (of_boot.time >= start) & (of_boot.time <= end)
        if np.count_nonzero(is_shown) >= MIN_SAMPLES:
            values: Array = of_boot.values[is_shown]
            lines.append(Line(name, colour, of_boot.time[is_shown], values))
    return tuple(lines)


def _without(series: TimeSeries, unknown: float) -> TimeSeries:
    """Returns a series (N,) without the samples that stand for "not known"."""
    return series.select(series.values != unknown)
