"""Charts of the longest flights of two logs, drawn over each other from their start on."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from math import degrees
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.dataset.axes import TILT_COLUMNS
from mavdem.dataset.extreme_tilt import MAX_TILT
from mavdem.dataset.flight_states import airborne_intervals
from mavdem.dataset.intervals import TimeInterval, intersection
from mavdem.dataset.phases import TRANSIENT_SECONDS
from mavdem.dataset.signals import Signals
from mavdem.dataset.steady_flight import attitude_tracking
from mavdem.dataset.time_series import TimeSeries
from mavdem.report.charts.chart import CLIP_SPANS, Axis, Chart, Line
from mavdem.vibration.vibration_message import reported_vibration

TIME_IN_FLIGHT = Axis("recorded time in the air (s)")
"""Time axis of all charts: it begins at take-off or, of a log that begins in the air, with its first sample."""

ROLL = "Roll (°)"
PITCH = "Pitch (°)"
ROLL_ERROR = "Roll minus its setpoint (°)"
PITCH_ERROR = "Pitch minus its setpoint (°)"
ROLL_RATE = "Roll rate (°/s)"
PITCH_RATE = "Pitch rate (°/s)"
HEIGHT = "Height (m)"
HEIGHT_ABOVE_START = "Height above the start (m)"
MEAN_MOTOR_OUTPUT = "Mean motor output (%)"
BATTERY_VOLTAGE = "Battery voltage (V)"

MAX_IMUS = 3
"""IMUs whose vibration is drawn: ArduPilot logs as many, PX4 four at most."""

VIBRATIONS = tuple(
    f"Vibration of IMU {number}, worst axis (m/s²)" for number in range(1, MAX_IMUS + 1)
)
"""Titles of the charts with the vibration of each IMU."""

MAX_MOTORS = 12
"""Motors that charts have names for: those of the largest frames."""

MOTOR_OUTPUTS = tuple(f"Motor {number} output (%)" for number in range(1, MAX_MOTORS + 1))
"""Titles of the charts with the output of each motor."""

MEAN_SECONDS = 0.5
"""Time over which the output of a motor is averaged in a chart: longer than attitude control takes, and shorter than a
manoeuvre. A choice."""

FLIGHT_SERIES_TITLES = (
    ROLL,
    PITCH,
    ROLL_ERROR,
    PITCH_ERROR,
    ROLL_RATE,
    PITCH_RATE,
    HEIGHT,
    MEAN_MOTOR_OUTPUT,
    BATTERY_VOLTAGE,
    *MOTOR_OUTPUTS,
    *VIBRATIONS,
)
"""Titles of the charts of two flights over each other, in the order of a page."""

SCALED_BY_ALL = (HEIGHT, BATTERY_VOLTAGE)
"""Titles of charts that have the scale of the whole flight: height and voltage change most in climb and landing."""

MIN_WIDER_SCALE = 1.25
"""Scale of take-off and landing, in that of the flight between them, from which a chart leaves it out: a choice."""

BOOT_NUMBER = "Number of the boot"
BOOT_CLOCK = "Time since boot (s)"
"""Titles of what is known of the start of a flight alone: the boot, and the time on its clock. They are not drawn."""

PERCENT = 100.0

FlightSeries = Mapping[str, Array]
"""What is drawn of one flight: for some of the titles a (2, N) array of recorded times in the air, s, and values.

They begin at take-off or, of a log that begins in the air, with its first sample. ``BOOT_NUMBER`` and ``BOOT_CLOCK``
have that sample alone, and are missing where an earlier version stored the flight."""


class FlightInterval(NamedTuple):
    """When a vehicle flew."""

    boot: int
    """Number of the boot."""

    interval: TimeInterval
    """Take-off and landing, or the ends of the record, s on the clock of that boot."""


def longest_flight(signals: Signals) -> FlightInterval | None:
    """Returns the longest time off the ground in a log, which a comparison of two logs draws.

    A flight that began before the record counts from the first sample of the attitude on, and one that lasts longer
    than the record until the last sample.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.

    Returns:
        The flight; None if the vehicle never flew, or its attitude was not recorded.
    """
    if not signals.attitudes:
        return None
    # The first of several recorded attitudes is the preferred one.
    attitude = signals.attitudes[0]
    flights = []
    for boot in np.unique(attitude.boot).tolist():
        times = attitude.time[attitude.boot == boot]
        recorded_interval = [(float(times[0]), float(times[-1]))]
        for interval in intersection(airborne_intervals(signals, boot), recorded_interval):
            flights.append(FlightInterval(boot, interval))
    return max(flights, key=lambda flight: float(np.ptp(flight.interval)), default=None)


def flight_series(signals: Signals) -> FlightSeries:
    """Returns the time series of a log's longest flight, for charts that compare it with a flight of another log.

    A quantity that was not recorded, or has no two samples in the flight, is left out.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.

    Returns:
        Roll, pitch and how far each is from its setpoint, °; their rates, °/s; height, m; mean output of all motors,
        and the output of each motor averaged over time, % of the range; voltage of the first battery, V; and
        vibration of each IMU along its worst axis, m/s². Each is an array (2, N) of times in the air, s, and
        values. At the start of the flight also the number of its boot and the time on the boot clock, s. Empty if the
        vehicle never flew.
    """
    flight = longest_flight(signals)
    if flight is None:
        return {}
    take_off, landing = flight.interval
    series_in_flight = {
        BOOT_NUMBER: np.array([[0.0], [flight.boot]]),
        BOOT_CLOCK: np.array([[0.0], [take_off]]),
    }
    recorded_series = _recorded_series(signals) | _setpoint_errors(signals, flight.boot)
    for title, series in recorded_series.items():
        is_of_boot = series.boot == flight.boot
        is_airborne = (series.time >= take_off) & (series.time <= landing)
        in_flight = series.select(is_of_boot & is_airborne)
        if len(in_flight.time) < 2:
            # A line needs two points.
            continue
        samples = np.array([in_flight.time - take_off, in_flight.values])
        if title in MOTOR_OUTPUTS:
            samples = _block_means(samples)
        series_in_flight[title] = samples
    return series_in_flight


def start_on_boot_clock(series: FlightSeries) -> float | None:
    """Returns when the time axis of a flight's charts begins, mostly at take-off, in s on the boot clock.

    Args:
        series: time series of the flight; the one titled ``BOOT_CLOCK`` has this time as its only value.

    Returns:
        The time; None if an earlier version of the program stored the flight without it.
    """
    if BOOT_CLOCK not in series:
        return None
    _, boot_times = series[BOOT_CLOCK]
    return float(boot_times[0])


def time_in_flight(series: FlightSeries, boot_time: float, boot: int) -> float | None:
    """Converts a time on the boot clock to the time axis of the charts, which begins at take-off.

    Args:
        series: time series of the flight.
        boot_time: the time, s on the boot clock.
        boot: number of the boot.

    Returns:
        The time in the air, s; None if it is not in this flight, or if its start on the boot clock is not known.
    """
    start = start_on_boot_clock(series)
    if start is None:
        return None
    _, boot_numbers = series[BOOT_NUMBER]
    if boot_numbers[0] != boot:
        return None
    time = boot_time - start
    end_time = max(times[-1] for times, _ in series.values())
    return time if 0.0 <= time <= end_time else None


def _block_means(samples: Array) -> Array:
    """Returns the means of a time series over blocks of ``MEAN_SECONDS``, at the mean times of their samples.

    Attitude control moves the output of a motor fast and widely, which would hide how hard the motor works, and the
    line of the other flight.

    Args:
        samples: (2, N) times, s, and values.

    Returns:
        (2, M) times and values of the blocks that have samples.
    """
    block_numbers = np.floor(samples[0] / MEAN_SECONDS).astype(int)
    _, blocks = np.unique(block_numbers, return_inverse=True)
    counts = np.bincount(blocks)
    times, values = samples
    mean_times = np.bincount(blocks, times) / counts
    mean_values = np.bincount(blocks, values) / counts
    return np.array([mean_times, mean_values])


def _recorded_series(signals: Signals) -> dict[str, TimeSeries]:
    """Returns the recorded quantities that :func:`flight_series` draws, over the whole log, in the units of the charts.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
    """
    recorded_series = dict[str, TimeSeries]()
    if signals.height is not None:
        recorded_series[HEIGHT] = signals.height
    titles = ((ROLL, ROLL_RATE), (PITCH, PITCH_RATE))
    # Titles without an attitude, or below without a motor, are skipped.
    for (angle_title, rate_title), attitude in zip(titles, signals.tilts, strict=False):
        recorded_series[angle_title] = _scaled(attitude.angle_series, degrees(1))
        recorded_series[rate_title] = _scaled(attitude.rate_series, degrees(1))
    if signals.collective is not None:
        recorded_series[MEAN_MOTOR_OUTPUT] = _scaled(signals.collective, PERCENT)
    motors = signals.motors
    if motors is not None:
        outputs = PERCENT * motors.scale.fraction(motors.outputs)
        for title, output in zip(MOTOR_OUTPUTS, outputs.T, strict=False):
            recorded_series[title] = TimeSeries(motors.time, motors.boot, output)
    for battery in signals.batteries[:1]:
        recorded_series[BATTERY_VOLTAGE] = battery.voltage
    vibration = reported_vibration(signals)
    if vibration is not None:
        levels = vibration.levels
        # IMUs are mounted in different ways, so that two flights are compared by the same one.
        levels_by_imu = vibration.largest_of_axes(levels.values)
        for title, levels_of_imu in zip(VIBRATIONS, levels_by_imu.T, strict=False):
            recorded_series[title] = TimeSeries(levels.time, levels.boot, levels_of_imu)
    return recorded_series


def _setpoint_errors(signals: Signals, boot: int) -> dict[str, TimeSeries]:
    """Returns how far roll and pitch are from their setpoints, °, at times with a setpoint of the angle.

    Args:
        signals: logged time series of the vehicle, such as attitude and setpoints.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.

    Returns:
        Measured angle minus setpoint, by the title of the chart; an axis without setpoints is left out.
    """
    tracking = attitude_tracking(signals, boot)
    if tracking is None:
        return {}
    errors = np.degrees(tracking.angles[:, TILT_COLUMNS] - tracking.setpoints)
    series_by_title = {}
    for title, error in zip((ROLL_ERROR, PITCH_ERROR), errors.T, strict=True):
        has_setpoint = ~np.isnan(error)
        if has_setpoint.any():
            boots = np.full(has_setpoint.sum(), boot)
            series_by_title[title] = TimeSeries(
                tracking.time[has_setpoint], boots, error[has_setpoint]
            )
    return series_by_title


def _scaled(series: TimeSeries, factor: float) -> TimeSeries:
    """Returns a time series with its values in another unit."""
    return TimeSeries(series.time, series.boot, factor * series.values)


def flight_series_charts(
    series: Mapping[str, FlightSeries], names: Mapping[str, str], colours: Mapping[str, str]
) -> Iterator[Chart]:
    """Yields a chart of each quantity of two flights, drawn over each other from their start on.

    The start is the take-off or, of a log that begins in the air, its first sample. Heights are drawn above that of the
    start, since logs have them above different points. A quantity that neither flight has is left out. The outputs of
    all motors have one scale, so that they can be compared. Scales are those of the flight without take-off and landing
    (:func:`_limits_without_ends`).

    Args:
        series: time series of each flight (:func:`flight_series`), by side, "A" and "B".
        names: name of each side in the legend.
        colours: colour of each side.
    """
    # All charts have the same time axis, which ends with the longest series.
    end_times = []
    for series_of_flight in series.values():
        for times, _ in series_of_flight.values():
            end_times.append(times[-1])
    time_axis = TIME_IN_FLIGHT._replace(limits=(0.0, max(end_times, default=0.0)))
    motor_limits = _limits_without_ends(series.values(), MOTOR_OUTPUTS) or _whole_limits(
        series.values(), MOTOR_OUTPUTS
    )
    for title in FLIGHT_SERIES_TITLES:
        lines = []
        for side, series_of_flight in series.items():
            if title in series_of_flight:
                times, values = series_of_flight[title]
                values_above_start = values - values[0] if title == HEIGHT else values
                lines.append(Line(names[side], colours[side], times, values_above_start))
        if lines:
            # Without limits the scale is that of all values.
            limits = None
            if title in MOTOR_OUTPUTS:
                limits = motor_limits
            elif title not in SCALED_BY_ALL:
                limits = _limits_without_ends(series.values(), [title])
            chart_title = HEIGHT_ABOVE_START if title == HEIGHT else title
            axis = Axis(chart_title[0].lower() + chart_title[1:], limits=limits)
            yield Chart(chart_title, time_axis, axis, tuple(lines), group="flights")


def _limits_without_ends(
    flights: Collection[FlightSeries], titles: Sequence[str]
) -> tuple[float, float] | None:
    """Returns limits of a vertical axis that leave out take-off and landing, if these would take much of the scale.

    Args:
        flights: time series of the flights.
        titles: titles of the series that share the axis.

    Returns:
        The lowest and highest value between take-off and landing, with a margin of ``CLIP_SPANS`` of their distance.
        None if the scale of all values is less than ``MIN_WIDER_SCALE`` times as wide, or no value is known.
    """
    inner_values = _values_between_ends(flights, titles)
    whole_limits = _whole_limits(flights, titles)
    if not len(inner_values) or whole_limits is None:
        return None
    lowest, highest = float(inner_values.min()), float(inner_values.max())
    # What stays the same between take-off and landing has no scale of its own.
    if highest == lowest:
        return None
    margin = CLIP_SPANS * (highest - lowest)
    limits = (lowest - margin, highest + margin)
    is_much_wider = np.ptp(whole_limits) >= MIN_WIDER_SCALE * np.ptp(limits)
    return limits if is_much_wider else None


def _values_between_ends(flights: Collection[FlightSeries], titles: Sequence[str]) -> Array:
    """Returns the finite values of some series of all flights, joined (N,), without take-off and landing.

    Args:
        flights: time series of the flights.
        titles: titles of the series.
    """
    values_between = [np.zeros(0)]
    for flight in flights:
        start, end = _ends_of_level_flight(flight)
        for title in titles:
            if title in flight:
                times, values = flight[title]
                values_between.append(values[(times >= start) & (times <= end)])
    joined_values = np.concatenate(values_between)
    return joined_values[np.isfinite(joined_values)]


def _ends_of_level_flight(flight: FlightSeries) -> tuple[float, float]:
    """Returns when the take-off of a flight ends and when its landing begins, s from its start, such as (3.0, 417.2).

    Both last ``TRANSIENT_SECONDS``, as for settled flight. An end with a tilt beyond ``MAX_TILT`` is no landing but a
    crash, which a chart must show: then the second time is that of the last sample.

    Args:
        flight: time series of the flight.
    """
    end_time = max((float(times[-1]) for times, _ in flight.values()), default=0.0)
    last_level_time = end_time - TRANSIENT_SECONDS
    for title in (ROLL, PITCH):
        if title in flight:
            times, angles = flight[title]
            if np.any(abs(angles[times > last_level_time]) > degrees(MAX_TILT)):
                return TRANSIENT_SECONDS, end_time
    return TRANSIENT_SECONDS, last_level_time


def _whole_limits(
    flights: Collection[FlightSeries], titles: Sequence[str]
) -> tuple[float, float] | None:
    """Returns the lowest and the highest value of some series in any of the flights; None if no flight has them.

    Args:
        flights: time series of the flights.
        titles: titles of the series.
    """
    all_values = []
    for flight in flights:
        for title in titles:
            if title in flight:
                _, values = flight[title]
                all_values.append(values)
    if not all_values:
        return None
    joined_values = np.concatenate(all_values)
    return float(joined_values.min()), float(joined_values.max())


def thinned_series(series: FlightSeries, max_points: int) -> FlightSeries:
    """Reduces the number of samples of time series, so that a stored flight stays small; peaks are kept.

    Args:
        series: times, s, and values (2, N) of each quantity, by its title.
        max_points: approximate largest number of samples that a series keeps.

    Returns:
        The reduced series, (2, M) each.
    """
    thinned_by_title = {}
    for title, (times, values) in series.items():
        # Charts can thin their lines, so that each series is made a chart for this.
        chart = Chart(title, TIME_IN_FLIGHT, Axis(title), (Line("", "", times, values),))
        (line,) = chart.thinned(max_points).lines
        thinned_by_title[title] = np.array([line.x, line.y])
    return thinned_by_title
