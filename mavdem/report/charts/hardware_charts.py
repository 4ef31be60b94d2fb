"""Charts of what a vehicle's hardware did over a flight, part by part, and of setpoints and sticks."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from itertools import cycle
from math import degrees

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment.commanded_swings import POSITION_TARGET_MESSAGE
from mavdem.assessment.evidence import Evidence
from mavdem.assessment.hardware.commands import POSITION_MESSAGE
from mavdem.assessment.hardware.recording import is_attitude_resampled
from mavdem.assessment.lights.power import BOARD_VOLTAGE_LIMITS
from mavdem.assessment.lights.vibration import CLIP_LIMITS, vibration_limits
from mavdem.containers import Names
from mavdem.dataset.hardware_quantities import (
    BATTERY_CURRENT,
    DILUTION,
    HORIZONTAL_ACCURACY,
    JAMMING,
    MEMORY_FREE,
    MEMORY_USED,
    NOISE,
    PROCESSOR_LOAD,
    SERVO_RAIL,
    SUPPLY,
    TEMPERATURES,
    VERTICAL_ACCURACY,
    HardwareQuantity,
    recorded_quantity,
)
from mavdem.dataset.pilot_input import pilot_input
from mavdem.dataset.position_fix import RECEIVER_MESSAGES, UNKNOWN_SATELLITES
from mavdem.dataset.signals import Signals
from mavdem.dataset.speed_controllers import speed_controllers
from mavdem.dataset.time_series import TimeSeries, recorded_series, series_of_boot
from mavdem.facts import Fact
from mavdem.facts.hardware import HardwarePart
from mavdem.facts.setpoints import CommandPart
from mavdem.facts.vibration import VibrationLight
from mavdem.report.charts.chart import Axis, Chart, Group, Line, LineStyle, over_time
from mavdem.report.charts.timeline import Timeline
from mavdem.report.palette import BAD, DISTINCT, LIMITED, MEASURED, PREDICTED, TRUTH
from mavdem.vibration.spectra import SENSOR_MESSAGES
from mavdem.vibration.vibration_message import ReportedVibration, reported_vibration
from mavdem.witnesses.sensors import compass_fields, specific_force

MIN_SAMPLES = 2
"""Samples that make a line, at least."""

MAX_RAW_POINTS = 3000
"""Points of a line of raw samples, at most: about twice the pixels of a wide plot, so that minima and maxima remain."""

LOCAL_AXES = {"north": "x", "east": "y", "down": "z"}
"""Axes of the local position, and the names of their fields."""

SHOWN_SWITCHES = 8
"""Switches that are drawn, those that moved first: of more, the lines could not be told apart."""


def hardware_groups(evidence: Evidence, timeline: Timeline) -> dict[str, list[Group]]:
    """Returns the charts of a vehicle's hardware over a flight, by subject: power, satellite receivers, and so on.

    Setpoints of the position and the pilot's sticks are further subjects.

    Args:
        evidence: signals, events and measurements of the vehicle.
        timeline: charts of the flight over the same time, whose events are marked.

    Returns:
        For each subject with a recorded quantity, a list with one group of charts, in up to two columns.
    """
    chart_functions = {
        HardwarePart.POWER: _power_charts,
        HardwarePart.CONTROLLERS: _controller_charts,
        HardwarePart.RECEIVERS: _receiver_charts,
        HardwarePart.COMPASSES: _compass_charts,
        HardwarePart.PROCESSOR: _processor_charts,
        HardwarePart.RECORDING: _sample_interval_charts,
        HardwarePart.TEMPERATURES: _temperature_charts,
        CommandPart.TARGETS: _target_charts,
        CommandPart.STICKS: _stick_charts,
    }
    groups = {}
    for subject, charts_of_subject in chart_functions.items():
        charts = []
        for chart in charts_of_subject(evidence, timeline):
            # A chart without lines is of a quantity that was not recorded.
            if chart.lines:
                charts.append(timeline.marked(chart))
        # Charts are placed from left to right, row by row.
        left_column, right_column = tuple(charts[::2]), tuple(charts[1::2])
        columns = tuple(column for column in (left_column, right_column) if column)
        if columns:
            groups[str(subject)] = [Group(columns)]
    return groups


def vibration_charts(evidence: Evidence, timeline: Timeline, light: Fact) -> list[Chart]:
    """Returns charts of the vibration that the autopilot reports of its IMUs, and of their clips.

    ArduPilot reports three axes of each IMU, so that each IMU has a chart of its own. PX4 reports one level of each
    IMU, and one chart has them all. A clip is a sample of an accelerometer at the end of its range.

    Args:
        evidence: signals, events and measurements of the vehicle.
        timeline: the charts of the flight, whose time these charts share, and whose events are marked in them.
        light: the judgement of the vibration, a fact (a coded finding). The limits by which it judged are drawn; none
            if the vibration could not be judged.

    Returns:
        The charts; none if vibration was not recorded. IMUs that never clipped have no line.
    """
    vibration = reported_vibration(evidence.signals)
    if vibration is None:
        return []
    limit_lines: tuple[Line, ...] = ()
    clip_limit_lines: tuple[Line, ...] = ()
    if light.code is VibrationLight.VIBRATION_MEASURED:
        limits = vibration_limits(evidence.signals.telemetry)
        limit_lines = (
            _limit_line(f"watch above {limits.watch:.3g}", limits.watch, LIMITED, timeline),
            _limit_line(f"bad above {limits.bad:.3g}", limits.bad, BAD, timeline),
        )
        clip_limit_lines = (
            _limit_line(f"bad above {CLIP_LIMITS.bad:.3g}", CLIP_LIMITS.bad, BAD, timeline),
        )
    charts = []
    for title, series_by_name in _vibration_by_imu(vibration).items():
        lines = _lines_of_series(series_by_name, timeline)
        if lines:
            charts.append(over_time(title, "m/s²", (*lines, *limit_lines)))
    clip_lines = _lines_of_series(_clip_counts(vibration, timeline), timeline)
    if clip_lines:
        charts.append(over_time("Clips so far", "", (*clip_lines, *clip_limit_lines)))
    return [timeline.marked(chart) for chart in charts]


def raw_sensor_charts(
    evidence: Evidence, timeline: Timeline, axes_by_sensor: Mapping[str, Names]
) -> list[Chart]:
    """Returns charts of what accelerometer and gyro measured, from the message with the most samples of each.

    Args:
        evidence: signals, events and measurements of the vehicle.
        timeline: charts of the flight over the same time, whose events are marked.
        axes_by_sensor: names of the three axes of "accelerometer" and "gyro".

    Returns:
        The acceleration, m/s², and the angular rate, °/s; a sensor without samples in the flight has no chart.
    """
    quantities = {
        "accelerometer": ("Acceleration", "m/s²", 1.0),
        "gyro": ("Angular rate", "°/s", degrees(1.0)),
    }
    charts = []
    for sensor, (title, unit, factor) in quantities.items():
        series = _sensor_series(evidence.signals, sensor)
        if series is None:
            continue
        series_by_axis: dict[str, TimeSeries | None] = {}
        for axis, values in zip(axes_by_sensor[sensor], series.values.T, strict=True):
            series_by_axis[axis] = replace(series, values=factor * values)
        lines = _lines_of_series(series_by_axis, timeline)
        if lines:
            charts.append(timeline.marked(over_time(title, unit, lines).thinned(MAX_RAW_POINTS)))
    return charts


def _sensor_series(signals: Signals, sensor: str) -> TimeSeries | None:
    """Returns the samples of a sensor from the message that has the most of them.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        sensor: "gyro" or "accelerometer", before or after its filters.

    Returns:
        (N, 3) rad/s about roll, pitch and yaw, or m/s² along forward, right and down; None if no message has them.
    """
    longest_series = specific_force(signals) if sensor == "accelerometer" else None
    # Messages with samples before the filters have the ending "_before".
    sensor_names = (sensor, f"{sensor}_before")
    for recorded in SENSOR_MESSAGES:
        if recorded.spectrum not in sensor_names:
            continue
        series = recorded_series(signals.telemetry, recorded.message, *recorded.fields)
        is_longer = series is not None and (
            longest_series is None or len(series.time) > len(longest_series.time)
        )
        if is_longer:
            longest_series = series
    return longest_series


def _clip_counts(vibration: ReportedVibration, timeline: Timeline) -> dict[str, TimeSeries | None]:
    """Returns how often each IMU has clipped so far, over time, counted from the beginning of a timeline.

    Args:
        vibration: what the autopilot reports of its IMUs, with the new clips of each IMU at each sample.
        timeline: timeline of the flight, for its boot and its span of time.

    Returns:
        Counts by name, such as "IMU 1"; IMUs that never clipped are left out.
    """
    samples = vibration.levels
    start, end = timeline.span
    is_shown = (samples.boot == timeline.boot) & (samples.time >= start) & (samples.time <= end)
    shown_clips = np.where(is_shown[:, None], vibration.clips, 0)
    counts = np.cumsum(shown_clips, axis=0)
    counts_by_imu: dict[str, TimeSeries | None] = {}
    for number, count in enumerate(counts.T, start=1):
        if count.any():
            counts_by_imu[f"IMU {number}"] = replace(samples, values=count)
    return counts_by_imu


def _vibration_by_imu(vibration: ReportedVibration) -> dict[str, dict[str, TimeSeries | None]]:
    """Distributes the series of reported vibration over charts.

    An autopilot that reports one level for each IMU gets a single chart, with a line for each IMU. If it reports
    several axes, each IMU gets a chart, with a line for each axis.

    Args:
        vibration: levels of all axes of all IMUs, m/s²; the axes of the first IMU come first.

    Returns:
        For each title of a chart a dictionary, with the series by the name of their line.
    """
    axis_count = len(vibration.axes)
    imu_count = vibration.levels.values.shape[1] // axis_count
    charts: dict[str, dict[str, TimeSeries | None]] = {}
    for column, values in enumerate(vibration.levels.values.T):
        imu_index, axis_index = divmod(column, axis_count)
        imu_name = f"IMU {imu_index + 1}"
        title = "Vibration"
        if axis_count > 1 and imu_count > 1:
            title = f"Vibration of {imu_name}"
        line_name = vibration.axes[axis_index] if axis_count > 1 else imu_name
        charts.setdefault(title, {})[line_name] = replace(vibration.levels, values=values)
    return charts


def _limit_line(name: str, limit: float, colour: str, timeline: Timeline) -> Line:
    """Returns the dashed line of a limit over the whole time of the charts.

    Args:
        name: what is beyond the limit, such as "watch above 30".
        limit: the limit, in the unit of the chart.
        colour: colour from ``mavdem.report.palette``.
        timeline: charts of the flight over time, whose time range is used.
    """
    return Line(name, colour, np.array(timeline.span), np.full(2, limit), style=LineStyle.DASHES)


def _power_charts(evidence: Evidence, timeline: Timeline) -> Iterator[Chart]:
    """Yields the battery's current, and the voltages of the autopilot's supply and of its servo rail.

    The voltages have the limit of the supply below which the light of power warns.
    """
    yield _quantity_chart("Battery current", (BATTERY_CURRENT,), evidence, timeline)
    voltages = _quantity_chart("Board voltages", (SUPPLY, SERVO_RAIL), evidence, timeline)
    if any(line.name == SUPPLY.name for line in voltages.lines):
        limit = BOARD_VOLTAGE_LIMITS.watch
        limit_line = _limit_line(f"watch: supply below {limit:g}", limit, LIMITED, timeline)
        voltages = voltages._replace(lines=(*voltages.lines, limit_line))
    yield voltages


def _controller_charts(evidence: Evidence, timeline: Timeline) -> Iterator[Chart]:
    """Yields charts of speed, current, temperature and error count of the motors' speed controllers.

    The mean command of the motors is drawn with the speeds. Errors have a chart only if there was one.

    Args:
        evidence: signals, events and measurements of the vehicle.
        timeline: timeline of the flight, for its span of time.
    """
    # Series of all speed controllers by their names, one dictionary for each chart.
    speeds, currents, temperatures, errors = {}, {}, {}, {}
    for controller in speed_controllers(evidence.signals):
        speeds[controller.name] = controller.speed
        currents[controller.name] = controller.current
        temperatures[controller.name] = controller.temperature
        errors[controller.name] = controller.error_count
    yield _with_motor_command(
        over_time("Motor speeds", "1/min", _lines_of_series(speeds, timeline)), evidence
    )
    yield over_time("Currents of the motors", "A", _lines_of_series(currents, timeline))
    yield over_time(
        "Temperatures of the controllers", "°C", _lines_of_series(temperatures, timeline)
    )
    has_errors = any(series is not None and series.values.any() for series in errors.values())
    if has_errors:
        yield over_time("Errors counted", "", _lines_of_series(errors, timeline))


def _receiver_charts(evidence: Evidence, timeline: Timeline) -> Iterator[Chart]:
    """Yields charts of the satellite navigation (GNSS) receivers, as they report it themselves.

    They have the number of satellites of each receiver, and then the accuracy of the position, the dilution of
    precision, noise and jamming. Quantities that were not recorded make charts without lines.

    Args:
        evidence: signals, events and measurements of the vehicle.
        timeline: charts of the flight over time, whose time range is used.
    """
    satellites: dict[str, TimeSeries | None] = {}
    for number, message in enumerate(RECEIVER_MESSAGES, start=1):
        series = recorded_series(evidence.signals.telemetry, message, "satellites_visible")
        if series is not None:
            satellites[f"receiver {number}"] = series.select(series.values != UNKNOWN_SATELLITES)
    yield over_time("Satellites", "", _lines_of_series(satellites, timeline))
    yield _quantity_chart(
        "Accuracy stated", (HORIZONTAL_ACCURACY, VERTICAL_ACCURACY), evidence, timeline
    )
    yield _quantity_chart("Dilution (HDOP)", (DILUTION,), evidence, timeline)
    yield _quantity_chart("Noise and jamming", (NOISE, JAMMING), evidence, timeline)


def _compass_charts(evidence: Evidence, timeline: Timeline) -> Iterator[Chart]:
    """Yields the chart of the magnetic field's strength at each compass, mGauss, with the mean command of the motors.

    A rotation of the vehicle does not change the strength of the earth's field. If the strength follows the command of
    the motors, the compass measures the magnetic field of their currents.

    Args:
        evidence: recorded signals of the vehicle, and the mean command of its motors.
        timeline: charts of the flight over time, whose time range is used.
    """
    strength_by_compass: dict[str, TimeSeries | None] = {}
    for number, field_vector in compass_fields(evidence.signals).items():
        strength = np.linalg.norm(field_vector.values, axis=1)
        strength_by_compass[f"compass {number}"] = replace(field_vector, values=strength)
    lines = _lines_of_series(strength_by_compass, timeline)
    field_chart = over_time("Magnetic field", "mGauss", lines)
    yield _with_motor_command(field_chart, evidence)


def _processor_charts(evidence: Evidence, timeline: Timeline) -> Iterator[Chart]:
    """Yields charts of the load of the autopilot's processor, and of its used and free memory, over time.

    Args:
        evidence: signals, events and measurements of the vehicle.
        timeline: timeline of the flight, for its span of time.
    """
    yield _quantity_chart("Processor load", (PROCESSOR_LOAD,), evidence, timeline)
    yield _quantity_chart("Memory used", (MEMORY_USED,), evidence, timeline)
    yield _quantity_chart("Memory free", (MEMORY_FREE,), evidence, timeline)


def _sample_interval_charts(evidence: Evidence, timeline: Timeline) -> Iterator[Chart]:
    """Yields a chart of the time between successive samples of the attitude, ms, in which gaps of the log are peaks.

    The interval is drawn at the later sample. If body rates were recorded faster than attitudes, the attitude has been
    resampled to their times. The intervals are then those between body rates, and the title says so.

    Args:
        evidence: signals, events and measurements of the vehicle.
        timeline: charts of the flight over time, whose time range is used.
    """
    attitude = evidence.signals.attitude
    angle = None if attitude is None else series_of_boot(attitude.angle_series, timeline.boot)
    if angle is None or len(angle.time) <= MIN_SAMPLES:
        return
    milliseconds = 1000 * np.diff(angle.time)
    intervals = TimeSeries(angle.time[1:], angle.boot[1:], milliseconds)
    quantity = "body rates" if is_attitude_resampled(evidence.signals) else "attitudes"
    lines = _lines_of_series({"step": intervals}, timeline)
    yield over_time(f"Time between {quantity}", "ms", lines)


def _temperature_charts(evidence: Evidence, timeline: Timeline) -> Iterator[Chart]:
    """Yields the temperatures of processor, IMU and barometer in one chart."""
    yield _quantity_chart("Temperatures", TEMPERATURES, evidence, timeline)


def _target_charts(evidence: Evidence, timeline: Timeline) -> Iterator[Chart]:
    """Yields a chart of position and one of velocity along each axis: the setpoint, and the autopilot's estimate.

    An axis without a recorded setpoint has no chart.

    Args:
        evidence: recorded signals of the vehicle.
        timeline: timeline of the flight, for its span of time.
    """
    telemetry = evidence.signals.telemetry
    # MAVLink's messages have the position north in the field "x", and the velocity north in "vx".
    for quantity, unit, field_prefix in (("Position", "m", ""), ("Velocity", "m/s", "v")):
        for direction, axis in LOCAL_AXES.items():
            field = f"{field_prefix}{axis}"
            setpoint = recorded_series(telemetry, POSITION_TARGET_MESSAGE, field)
            setpoint_lines = _lines_of_series({"setpoint": setpoint}, timeline, [TRUTH])
            if not setpoint_lines:
                continue
            estimate = recorded_series(telemetry, POSITION_MESSAGE, field)
            estimate_lines = _lines_of_series({direction: estimate}, timeline, [PREDICTED])
            yield over_time(f"{quantity} {direction}", unit, (*setpoint_lines, *estimate_lines))


def _stick_charts(evidence: Evidence, timeline: Timeline) -> Iterator[Chart]:
    """Yields a chart of the sticks of the remote control over time, and one of its switches.

    The second one has the ``SHOWN_SWITCHES`` channels whose values changed most.

    Args:
        evidence: signals, events and measurements of the vehicle.
        timeline: timeline of the flight, for its span of time.
    """
    inputs = pilot_input(evidence.signals)
    yield over_time("Sticks", inputs.unit, _lines_of_series(inputs.sticks, timeline))
    ranges = {channel: np.ptp(series.values) for channel, series in inputs.switches.items()}
    channels_by_range = sorted(ranges, key=ranges.__getitem__, reverse=True)
    shown_switches = {}
    for channel in channels_by_range[:SHOWN_SWITCHES]:
        shown_switches[f"channel {channel}"] = inputs.switches[channel]
    yield over_time("Switches", "µs", _lines_of_series(shown_switches, timeline))


def _quantity_chart(
    title: str, quantities: Iterable[HardwareQuantity], evidence: Evidence, timeline: Timeline
) -> Chart:
    """Returns a chart over time of several recorded quantities that have the same unit, one line each.

    Args:
        title: title of the chart.
        quantities: the quantities; one that was not recorded has no line.
        evidence: signals, events and measurements of the vehicle.
        timeline: charts of the flight over time, whose time range is used.
    """
    unit = ""
    series_by_name = {}
    for quantity in quantities:
        unit = quantity.unit
        series_by_name[quantity.name] = recorded_quantity(evidence.signals, quantity)
    return over_time(title, unit, _lines_of_series(series_by_name, timeline))


def _with_motor_command(chart: Chart, evidence: Evidence) -> Chart:
    """Adds the mean command of the motors, %, to a chart, on an axis at its right.

    It shows what follows the motors, such as the magnetic field of their currents.

    Args:
        chart: the chart; without lines it is returned as it is.
        evidence: signals, events and measurements of the vehicle; without recorded motor commands none are added.
    """
    history = evidence.time_history
    if not chart.lines or history is None or history.motors is None:
        return chart
    outputs = history.motors.outputs
    if outputs is None:
        return chart
    mean_output: Array = outputs.values.mean(axis=1)
    command_line = Line("motors", MEASURED, outputs.time, mean_output, is_on_right_axis=True)
    return chart._replace(lines=(*chart.lines, command_line), right_axis=Axis("motors (%)"))


def _lines_of_series(
    series_by_name: Mapping[str, TimeSeries | None],
    timeline: Timeline,
    colours: Names | list[str] = DISTINCT,
) -> tuple[Line, ...]:
    """Returns a line for each series that has samples in the interval that all charts share.

    Args:
        series_by_name: series (N,) by the name of the line; None if it was not recorded.
        timeline: the boot and the interval that the charts show.
        colours: colours that the lines get in turn; they repeat if there are more lines.

    Returns:
        Lines in the order of the names.
    """
    lines = []
    start, end = timeline.span
    for (name, series), colour in zip(series_by_name.items(), cycle(colours), strict=False):
        samples = None if series is None else series_of_boot(series, timeline.boot)
        if samples is None:
            continue
        is_shown = (samples.time >= start) & (samples.time <= end)
        if np.count_nonzero(is_shown) >= MIN_SAMPLES:
            values: Array = samples.values[is_shown]
            lines.append(Line(name, colour, samples.time[is_shown], values))
    return tuple(lines)
