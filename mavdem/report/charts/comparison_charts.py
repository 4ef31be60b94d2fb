"""Charts of the longest flights of two logs over each other, each from its own take-off on."""

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from mavdem.confidence import Interval
from mavdem.dataset.intervals import intersection
from mavdem.dataset.phases import airborne_intervals
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import TimeSeries
from mavdem.ingest.telemetry import Telemetry
from mavdem.report.charts.chart import Axis, Chart, Line

TIME_AFTER_TAKE_OFF = Axis("time since take-off (s)")


class FlightInterval(NamedTuple):
    """When a vehicle flew."""

    boot: int
    """Number of the boot."""

    interval: Interval
    """Take-off and landing, or the ends of the record, s on the clock of that boot."""


def longest_flight(signals: Signals) -> FlightInterval | None:
    """Returns the longest time off the ground in a log.

    A flight that began before the record counts from the first attitude on, one that it does not end until the last.

    Args:
        signals: signals of the vehicle.

    Returns:
        The flight; None if the vehicle never flew.
    """
    flights = []
    for attitude in signals.attitudes[:1]:
        for boot in np.unique(attitude.boot).tolist():
            times = attitude.time[attitude.boot == boot]
            recorded = [(float(times[0]), float(times[-1]))]
            for interval in intersection(airborne_intervals(signals, boot), recorded):
                flights.append(FlightInterval(boot, interval))
    return max(flights, key=lambda flight: float(np.ptp(flight.interval)), default=None)


def flight_history_charts(
    vehicles: Mapping[str, Telemetry], names: Mapping[str, str], colours: Mapping[str, str]
) -> Iterator[Chart]:
    """Yields charts of roll, pitch, height and the motors' mean output in the longest flight of each log.

    A quantity that no log has is left out.

    Args:
        vehicles: telemetry of the vehicle of each log, by side.
        names: name of each side in the legend.
        colours: colour of each side.
    """
    titles = ("Roll (°)", "Pitch (°)", "Height (m)", "Mean motor output (%)")
    lines_by_title: dict[str, list[Line]] = {title: [] for title in titles}
    for side, vehicle in vehicles.items():
        signals = Signals(vehicle)
        flight = longest_flight(signals)
        if flight is None:
            continue
        for title, attitude in zip(lines_by_title, signals.tilts, strict=False):
            angle = attitude.angle_series
            degrees = TimeSeries(angle.time, angle.boot, np.degrees(angle.values))
            lines_by_title[title].append(_line(names[side], colours[side], degrees, flight))
        if signals.height is not None:
            lines_by_title["Height (m)"].append(
                _line(names[side], colours[side], signals.height, flight)
            )
        collective = signals.collective
        if collective is not None:
            percent = TimeSeries(collective.time, collective.boot, 100 * collective.values)
            lines_by_title["Mean motor output (%)"].append(
                _line(names[side], colours[side], percent, flight)
            )
    for title, lines in lines_by_title.items():
        if lines:
            yield Chart(title, TIME_AFTER_TAKE_OFF, Axis(title.lower()), tuple(lines))


def _line(name: str, colour: str, series: TimeSeries, flight: FlightInterval) -> Line:
    """Returns a signal during a flight as a line, with the time from take-off."""
    take_off, landing = flight.interval
    is_flown = (series.boot == flight.boot) & (series.time >= take_off) & (series.time <= landing)
    return Line(name, colour, series.time[is_flown] - take_off, series.values[is_flown])
